"""`navsim show`, `navsim plot`, `navsim export`: result files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navsim.cli.common import (
    figure_folder,
    leave,
    print_json,
    print_tables,
    read_result,
)
from navsim.cli.ending import BAD_INPUT, say
from navsim.cli.findings import warn
from navsim.cli.options import number_option

if TYPE_CHECKING:
    from navsim.io.results import Result


def show(
    files: Annotated[
        list[Path], typer.Argument(metavar="RESULT.h5", help="One result, or more of one kind.", show_default=False)
    ],
    json_: Annotated[
        bool, typer.Option("--json", help="Print the summaries as JSON, a list of them for several results.")
    ] = False,
) -> None:
    """Print the summary tables of results, side by side, and what their studies warned of."""
    results = [(path.stem, read_result(path)) for path in files]
    from navsim.io.results import ResultError
    from navsim.report.view import plain, view

    for file, (_, result) in zip(files, results, strict=True):
        try:
            view(result.attributes["kind"])
        except ResultError as error:
            leave(BAD_INPUT, f"{file}: {error}")
    with shown_as_stored([result for _, result in results], files):
        if json_:
            summaries = [plain(result) for _, result in results]
            print_json(summaries[0] if len(summaries) == 1 else summaries)
        else:
            print_tables(results)
        for name, result in results:
            warn(result, name if len(results) > 1 else "")


@contextmanager
def shown_as_stored(results: list[Result], files: list[Path]) -> Iterator[None]:
    """Leave with words where the contents of result files do not fit together, or lack what this version shows."""
    from navsim.io.results import ResultError
    from navsim.io.schema import SCHEMA_VERSION

    try:
        yield
    except ResultError as error:
        named = any(str(file) in str(error) for file in files)
        leave(BAD_INPUT, error if named else f"{', '.join(map(str, files))}: {error}")
    except (typer.Exit, OSError, UnicodeEncodeError):
        raise  # left already, or the terminal's
    except Exception as error:  # the file's content alone decides what happens here, and it may be anybody's
        earlier = [
            f"{file}: written by navsim {result.attributes['navsim_version']}; compute it again with this version"
            for result, file in zip(results, files, strict=True)
            if result.attributes.get("schema_version") != SCHEMA_VERSION
        ]
        if earlier:
            leave(BAD_INPUT, *earlier)
        said = (str(error).splitlines() or [""])[0]
        names = ", ".join(map(str, files))
        cause = f"{type(error).__name__}: {said}"
        leave(BAD_INPUT, f"{names}: what it holds does not fit together, or navsim is wrong about it ({cause})")


def plot(
    file: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="The result to draw.", show_default=False)],
    figures: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|none",
            help="Where figures go, made where it is not there. Default: beside the result.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Draw the figures of a result again and print their names."""
    folder = figure_folder(figures, file, skipped=False)
    result = read_result(file)
    if folder is None:
        say(f"{file}: no figures, as --figures none says")
        return
    with shown_as_stored([result], [file]):
        from navsim.report.view import draw

        for path in draw(result, folder, file.stem):
            print(path)


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
        int | None, number_option(int, 0, "Which run of an ensemble, by its number. Default: the first.")
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

    chosen = [name for name, wanted in (("rinex", rinex), ("nmea", nmea), ("kml", kml), ("geojson", geojson),
                                        ("csv", csv)) if wanted]  # fmt: skip
    if not chosen:
        leave(BAD_INPUT, "choose one or more of --rinex, --nmea, --kml, --geojson, --csv")
    target = (output or file).with_suffix(".h5")
    if not target.parent.is_dir():
        leave(BAD_INPUT, f"{target.parent}: no such folder; create it first or choose another -o/--output")
    result = read_result(file)
    with shown_as_stored([result], [file]):
        chosen_run, several = choose_run(result, run)
        for path in convert(chosen_run, target, chosen):
            print(path)
        if several is not None:
            say(f"{file}: {several}; --run K takes another")
        approximate = approximate_systems(result) if rinex else []
    for system in approximate:
        say(
            f"warning: the {system} satellites flew by an almanac, and the exported messages only resemble it; fly "
            "with sky.broadcast: true for exact ones"
        )
