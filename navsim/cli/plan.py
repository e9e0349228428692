"""`navsim plan`: the aerodrome in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import leave, make_folder
from navsim.cli.exit_status import BAD_INPUT, print_message
from navsim.cli.options import argument, number_option, value_option
from navsim.cli.reports import INSTALL

_TEMPLATE = "landing"


def plan(
    scenario: Annotated[
        Path | None,
        argument("[SCENARIO.yaml]", "The landing to plan. Default: the shipped landing.yaml."),
    ] = None,
    output: Annotated[
        Path | None,
        value_option(
            "FILE.yaml",
            "The file that Save writes. Default: <stem>_planned.yaml in the scenario's folder; for the shipped "
            "scenario in the working folder.",
            "--output",
            "-o",
        ),
    ] = None,
    overlay: Annotated[
        Path | None,
        value_option("FILE.geojson", "Outlines to draw over the map, in longitude and latitude."),
    ] = None,
    port: Annotated[
        int, number_option(int, 0, "Port at 127.0.0.1; 0 takes a free one.", most=65535, show_default=True)
    ] = 5006,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address and open no browser.")] = False,
) -> None:
    """Place pseudolites or beacons in the browser: drag them, see DOPs and accuracy, save the scenario.

    navsim serves the page on this machine, at 127.0.0.1, until Ctrl-C.
    """  # fmt: skip
    from navsim.scenario_files.source import MOST_BYTES, InputError, load

    try:
        from navsim.planner.server import ADDRESS, Planner, outlines
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] not in ("bokeh", "jinja2", "markupsafe", "tornado"):
            raise
        leave(BAD_INPUT, f"navsim plan draws with Bokeh, which is not installed here: {INSTALL}")
    from navsim.formats import geojson
    from navsim.formats.text import decoded
    from navsim.planner.outlook import Outlook
    from navsim.planner.proposal import PlannedScenario
    from navsim.results import files
    from navsim.results.result import ResultError, check_writable
    from navsim.scenario.load import read
    from navsim.scenario_files import shipped

    path = scenario or shipped.path(_TEMPLATE)
    target = output or (path.with_name(f"{path.stem}_planned.yaml") if scenario else Path(f"{_TEMPLATE}_planned.yaml"))
    make_folder(target)
    try:
        read(path)
        document, text = load(path), decoded(files.content(path, MOST_BYTES))
        proposal = PlannedScenario(document, text)
        Outlook(proposal)
        drawn = []
        if overlay is not None:
            try:
                drawn = outlines(proposal, geojson.lines(files.content(overlay, geojson.MOST_BYTES)))
            except (ValueError, OSError) as error:
                why = error.strerror if isinstance(error, OSError) else error
                leave(BAD_INPUT, f"--overlay {overlay}: {why}")
        check_writable(target)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except ResultError as error:
        leave(BAD_INPUT, error)
    named = [name for name in proposal.file_names() if not Path(name).expanduser().is_absolute()]
    if named and target.resolve().parent != document.folder:
        text = f"{path} names files by relative paths ({', '.join(named)}), which are wrong in another folder"
        leave(BAD_INPUT, f"{text}; choose an -o/--output in {document.folder}")

    def serving(address: str) -> None:
        print(f"{address}  Ctrl-C ends it; Save writes {target}", flush=True)

    try:
        Planner(document, text, target, drawn).serve(
            port, not no_browser, serving, lambda words: print_message(f"warning: {words}")
        )
    except OSError as error:
        leave(BAD_INPUT, f"--port {port}: cannot be had at {ADDRESS}: {error.strerror or error}")
