"""`navsim replay`: recorded flights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import (
    BAD_INPUT,
    RUN_FAILED,
    FiguresOption,
    OutputOption,
    QuietOption,
    SetOption,
    announce_compiling,
    draw,
    figure_folder,
    leave,
    print_console,
    progress,
    say,
    target_of,
)


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG.yaml", help="The recorded flight.", show_default=False)],
    output: OutputOption = None,
    set_: SetOption = None,
    figures: FiguresOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read, check and align; fly nothing.")] = False,
    quiet: QuietOption = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON, and nothing else, on stdout.")
    ] = False,
) -> None:
    """Fly recorded IMU and GNSS data through the filter: alignment, tuning, innovations, outages."""
    from navsim.scenario.load import read_replay
    from navsim.scenario.source import InputError

    try:
        section, document = read_replay(log, set_ or [])
        target = target_of(log, output, "replay")
        from navsim.core import jit
        from navsim.io.results import ResultError, write
        from navsim.report import replay as report
        from navsim.study import replay as flying

        recording = flying.prepare(section, document)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except flying.ReplayError as error:
        leave(RUN_FAILED, f"{log}: {error}")
    if dry_run:
        for warning in recording.warnings:
            say(f"warning: {warning}")
        aligned = recording.alignment
        say(
            f"{log}: {recording.samples.time.size} samples, {recording.fixes.time.size} fixes, aligned at "
            f"{aligned.time:.2f} s with data up to {aligned.until:.2f} s; would write {target}"
        )
        return
    announce_compiling()
    drawing = figure_folder(figures, target, 1, quiet)
    try:
        with progress(flying.extent(recording), not quiet, "tuning flights") as done:
            result = flying.compute(recording, done)
        write(target, result)
        written = draw(result, drawing, target.stem)
    except ResultError as error:
        leave(RUN_FAILED, error)
    jit.mark_warm()
    if json_:
        import json

        from navsim.report.tables import plain_tree

        print(json.dumps(plain_tree(result, ("/summary", "/tuning", "/outages")), indent=1, allow_nan=False))
    elif not quiet:
        print_console(report.console(result), 110)
        print(f"result   {target}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")
    for warning in flying.findings(recording, result):
        say(f"warning: {warning}")
