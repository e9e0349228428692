"""`navsim show`, `navsim plot`, `navsim export`: result files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import (
    BAD_INPUT,
    figure_folder,
    lacks,
    leave,
    print_table,
    read_result,
    say,
)
from navsim.cli.findings import warn


def show(
    files: Annotated[
        list[Path], typer.Argument(metavar="RESULT.h5", help="One result, or more of one kind.", show_default=False)
    ],
    json_: Annotated[
        bool, typer.Option("--json", help="Print the summaries as JSON, a list of them for several results.")
    ] = False,
) -> None:
    """Print the summary tables of results, side by side, and what their studies warned of."""
    from navsim.io.results import ResultError

    results = [(path.stem, read_result(path)) for path in files]
    if json_:
        import json

        from navsim.report.tables import summary_json

        summaries = [summary_json(result) for _, result in results]
        print(json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=1, allow_nan=False))
    else:
        try:
            print_table(results)
        except KeyError as error:
            leave(BAD_INPUT, *(lacks(result, name, error) for name, result in results))
    try:
        for name, result in results:
            warn(result, name if len(results) > 1 else "")
    except ResultError as error:
        leave(BAD_INPUT, error)


def plot(
    file: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="The result to draw.", show_default=False)],
    figures: Annotated[
        str | None,
        typer.Option(metavar="FOLDER|none", help="Where figures go. Default: beside the result.", show_default=False),
    ] = None,
) -> None:
    """Draw the figures of a result again and print their names."""
    from navsim.io.results import ResultError

    folder = figure_folder(figures, file, runs=1, quiet=False)
    result = read_result(file)
    if folder is None:
        say(f"{file}: no figures, as --figures none says")
        return
    try:
        from navsim.report.views import save

        for path in save(result, folder, file.stem):
            print(path)
    except ResultError as error:
        leave(BAD_INPUT, error)
    except KeyError as error:
        leave(BAD_INPUT, lacks(result, file, error))


def export(
    file: Annotated[
        Path, typer.Argument(metavar="RESULT.h5", help="The result of a landing or a replay.", show_default=False)
    ],
    rinex: Annotated[
        bool, typer.Option("--rinex", help="RINEX observations and messages; pseudolites as CSV.")
    ] = False,
    nmea: Annotated[bool, typer.Option("--nmea", help="NMEA sentences GGA, RMC, VTG of the fixes.")] = False,
    kml: Annotated[bool, typer.Option("--kml", help="Track, runway, pseudolites, error ellipses as KML.")] = False,
    geojson: Annotated[bool, typer.Option("--geojson", help="The same as GeoJSON.")] = False,
    csv: Annotated[bool, typer.Option("--csv", help="Truth, fixes, filter errors as tables.")] = False,
    run: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="K", help="Which run of an ensemble, by its number. Default: the first.", show_default=False
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER/STEM",
            help="Start of the files' names. Default: the result's, without .h5.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a result in the formats of other programs.

    Choose one or more of them.
    """
    from navsim.io.export import approximate_systems, choose_run
    from navsim.io.export import export as convert
    from navsim.io.results import ResultError

    chosen = [name for name, wanted in (("rinex", rinex), ("nmea", nmea), ("kml", kml), ("geojson", geojson),
                                        ("csv", csv)) if wanted]  # fmt: skip
    if not chosen:
        leave(BAD_INPUT, "choose one or more of --rinex, --nmea, --kml, --geojson, --csv")
    target = (output or file).with_suffix(".h5")
    if not target.parent.is_dir():
        leave(BAD_INPUT, f"{target.parent}: no such folder; create it first or choose another -o/--output")
    result = read_result(file)
    try:
        chosen_run, several = choose_run(result, run)
        for path in convert(chosen_run, target, chosen):
            print(path)
        if several is not None:
            say(f"{file}: {several}; --run K takes another")
    except ResultError as error:
        leave(BAD_INPUT, f"{file}: {error}" if str(file) not in str(error) else error)
    except KeyError as error:
        leave(BAD_INPUT, lacks(result, file, error))
    if rinex:
        for system in approximate_systems(result):
            say(
                f"warning: the {system} satellites flew by an almanac, and the exported messages only resemble it; fly "
                "with sky.broadcast: true for exact ones"
            )
