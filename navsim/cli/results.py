"""`navsim show`, `navsim plot`, `navsim export`: result files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import (
    BAD_INPUT,
    lacks,
    leave,
    print_table,
    read_result,
    say,
)


def show(
    files: Annotated[
        list[Path], typer.Argument(metavar="RESULT.h5", help="One result, or more of one kind.", show_default=False)
    ],
    json_: Annotated[
        bool, typer.Option("--json", help="Print the summaries as JSON, a list of them for several results.")
    ] = False,
) -> None:
    """Print the summary tables of results, side by side."""
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


def plot(
    file: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="The result to draw.", show_default=False)],
    figures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Where figures go. Default: beside the result.", show_default=False),
    ] = None,
) -> None:
    """Draw the figures of a result again and print their names."""
    from navsim.io.results import ResultError

    result = read_result(file)
    try:
        from navsim.report.views import save

        for path in save(result, figures or file.parent, file.stem):
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
    from navsim.io.export import approximate_systems
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
        for path in convert(result, target, chosen):
            print(path)
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
