"""`navsim show`, `navsim plot`, `navsim export`: result files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navsim.cli.common import (
    AT_TERMINAL,
    Shown,
    called,
    leave,
    leaving,
    make_folder,
    print_json,
    print_parts,
    print_tables,
    read_result,
)
from navsim.cli.completion import drawn_figures
from navsim.cli.exit_status import BAD_INPUT, print_message
from navsim.cli.findings import warn
from navsim.cli.options import argument, number_option, value_option
from navsim.runner.target import figure_folder
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.results.result import Result


def show(
    files: Annotated[list[Path], argument("RESULT.h5", "Results of the same kind.")],
    json_: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON; a list for several results.")
    ] = False,
    format_: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="terminal|markdown|csv|tex",
            help="Format of the tables.",
            autocompletion=lambda: ["terminal", "markdown", "csv", "tex"],
        ),
    ] = "terminal",
    compare: Annotated[
        bool,
        typer.Option("--compare", help="Add differences and ratios to the first result, and the settings that differ."),
    ] = False,
    rows: Annotated[
        str | None,
        value_option("PATTERN", "Print only rows or groups whose name contains PATTERN; * and ? are wildcards."),
    ] = None,
    provenance: Annotated[
        bool,
        typer.Option(
            "--provenance",
            help="Print the origin of results instead: files and checksums, version, seed, runs, time of computation. "
            "The results may differ in kind.",
        ),
    ] = False,
) -> None:
    """Print the summary tables of results side by side, and their warnings."""
    if format_ not in ("terminal", "markdown", "csv", "tex"):
        leave(BAD_INPUT, f"--format {format_}: allowed are terminal, markdown, csv, tex")
    if json_ and (format_ != "terminal" or compare or rows is not None or provenance):
        leave(BAD_INPUT, "--json prints whole summaries: not with --format, --compare, --rows or --provenance")
    if rows is not None and not rows.strip():
        leave(BAD_INPUT, "--rows: give a pattern; without --rows navsim prints all rows")
    if provenance and compare:
        leave(BAD_INPUT, "--provenance has no numbers to compare: not with --compare")
    if compare and len(files) < 2:
        leave(BAD_INPUT, "--compare needs two results or more; it compares the others with the first")
    results = list(zip(called(files), map(read_result, files), strict=True))
    from navsim.report.view import plain, view
    from navsim.results.result import ResultError

    for file, (_, result) in zip(files, results, strict=True):
        try:
            view(result.attributes["kind"])
        except ResultError as error:
            leave(BAD_INPUT, f"{file}: {error}")
    with shown_as_stored([result for _, result in results], files):
        if provenance:
            from navsim.report.provenance import Read
            from navsim.report.provenance import provenance as table_of

            read = [Read(name, file, result) for file, (name, result) in zip(files, results, strict=True)]
            print_parts([table_of(read)], Shown(format_, rows=rows))
            return
        if json_:
            summaries = [plain(result) for _, result in results]
            print_json(summaries[0] if len(summaries) == 1 else summaries)
        else:
            print_tables(results, Shown(format_, compare, rows))
        for name, result in results:
            warn(result, name if len(results) > 1 else "")


def _layout(result: Result) -> int | None:
    """Layout version of a result; None if its file has none."""
    version = result.attributes.get("schema_version")
    return int(version) if isinstance(version, Integral) else None


@contextmanager
def shown_as_stored(results: list[Result], files: list[Path]) -> Iterator[None]:
    """Exit with a message if the contents of result files do not fit together, or lack data that this version shows."""
    from navsim.results.result import ResultError
    from navsim.results.schema import SCHEMA_VERSION
    from navsim.runner.errors import BadInput

    for file, result in zip(files, results, strict=True):
        if (version := _layout(result)) is None:
            text = f"{file}: has no layout version; this navsim shows version {SCHEMA_VERSION}"
            AT_TERMINAL.warn(text)
        elif version > SCHEMA_VERSION:
            AT_TERMINAL.warn(
                f"{file}: has version {version} of the layout, this navsim version {SCHEMA_VERSION}: parts "
                "that are stored elsewhere there are not shown; a newer navsim shows them"
            )
        elif version < SCHEMA_VERSION:
            box = any(path.startswith("/summary/box/") for path in result.variables)
            lost = ", as its box," if box and "/summary/box/upper" not in result else ""
            AT_TERMINAL.warn(
                f"{file}: has version {version} of the layout, this navsim version {SCHEMA_VERSION}: what stood "
                f"elsewhere then{lost} is not shown; compute it again to see it"
            )
    try:
        yield
    except ResultError as error:
        named = any(str(file) in str(error) for file in files)
        leave(BAD_INPUT, error if named else f"{', '.join(map(str, files))}: {error}")
    except (typer.Exit, BadInput, OSError, UnicodeEncodeError):
        raise  # left already, an option, or the terminal's
    except Exception as error:  # only the file's content decides, since anybody may have written it
        of_others = []
        for result, file in zip(results, files, strict=True):
            if (version := _layout(result)) != SCHEMA_VERSION:
                by = result.attributes.get("navsim_version")
                written = "does not name the program that wrote it" if by is None else f"written by navsim {by}"
                newer = version is not None and version > SCHEMA_VERSION
                helps = "read it with a newer navsim" if newer else "compute it again with this version"
                of_others.append(f"{file}: {written}; {helps}")
        if of_others:
            leave(BAD_INPUT, *of_others)
        said = (str(error).splitlines() or [""])[0]
        names = ", ".join(map(str, files))
        cause = f"{type(error).__name__}: {said}"
        leave(BAD_INPUT, f"{names}: the contents are inconsistent, or navsim has a defect ({cause})")


def plot(
    files: Annotated[list[Path], argument("RESULT.h5", "One or more results to draw.")],
    figures: Annotated[
        str | None,
        value_option(
            "FOLDER|none",
            "Folder for figures; created if missing. Default: that of the result.",
            "--figures",
            "--output",
            "-o",
        ),
    ] = None,
    format_: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="png|svg|pdf",
            help="Format of the files; one figure per file.",
            autocompletion=lambda: ["png", "svg", "pdf"],
        ),
    ] = "png",
    width: Annotated[
        str | None,
        value_option(
            "LENGTH",
            "Width of each figure in mm, cm, in or pt: 85mm for a column of a journal, 170mm for a page. Default: "
            "3.5in or 7in, as the figure needs.",
        ),
    ] = None,
    only: Annotated[
        str | None,
        value_option("NAME,...", "Draw only these figures. Default: all.", autocompletion=drawn_figures),
    ] = None,
    run: Annotated[
        int | None, number_option(int, 0, "Draw one run of an ensemble. Default: all runs together.")
    ] = None,
    dpi: Annotated[
        int | None, number_option(int, 30, "Resolution of PNG files, dots per inch. Default: 200.", most=2400)
    ] = None,
) -> None:
    """Draw the figures of results and print the file names."""
    inches = None if width is None else _inches(width)
    if format_ not in ("png", "svg", "pdf"):
        leave(BAD_INPUT, f"--format {format_}: allowed are png, svg, pdf")
    names = None if only is None else [name.strip() for name in only.split(",") if name.strip()]
    if names == []:
        leave(BAD_INPUT, "--only: name one or more figures, with commas between")
    if figures not in (None, "none") and len({file.stem for file in files}) < len(set(files)):
        leave(BAD_INPUT, f"--output {figures}: two results have one name, and their figures would, too")
    for file in dict.fromkeys(files):
        with leaving():
            folder = figure_folder(figures, file, skipped=False)
        result = read_result(file)
        if folder is None:
            print_message(f"{file}: no figures (--figures none)")
            continue
        with shown_as_stored([result], [file]):
            from navsim.report.printing import Print
            from navsim.report.view import draw

            how = Print(format_, inches, None if dpi is None else float(dpi))
            for path in draw(result, folder, file.stem, how, names or (), run):
                print(path)


_UNITS = {"mm": 25.4, "cm": 2.54, "in": 1.0, "pt": 72.0}
"""Units in an inch; TeX's points of 72.27 to the inch differ by 0.4 %."""
_NARROWEST, _WIDEST = 2.0, 40.0
"""Widths of figures, inches: with letters that can be read there is no room on less."""


def _inches(given: str) -> float:
    """A length as text, in inches."""
    import re

    found = re.fullmatch(r"([0-9]+\.?[0-9]*|\.[0-9]+) ?([a-z]+)", given.strip())
    if found is None or found[2] not in _UNITS:
        leave(BAD_INPUT, f"--width {given}: a number with its unit is needed, one of {', '.join(_UNITS)}, as 85mm")
    inches = float(found[1]) / _UNITS[found[2]]
    if not _NARROWEST <= inches <= _WIDEST:
        least, most = (f"{digits(end * _UNITS[found[2]], 4)}{found[2]}" for end in (_NARROWEST, _WIDEST))
        leave(BAD_INPUT, f"--width {given}: from {least} to {most} can be drawn with letters of 7 points")
    return inches


@dataclass(frozen=True)
class ExportFormats:
    """Formats to write."""

    rinex: Annotated[bool, typer.Option("--rinex", help="RINEX observations and messages; pseudolites as CSV.")] = False
    nmea: Annotated[bool, typer.Option("--nmea", help="NMEA sentences GGA, RMC, VTG of the fixes.")] = False
    kml: Annotated[bool, typer.Option("--kml", help="Track, runway, pseudolites, error ellipses as KML.")] = False
    geojson: Annotated[bool, typer.Option("--geojson", help="The same as GeoJSON.")] = False
    csv: Annotated[bool, typer.Option("--csv", help="Truth, fixes, errors of the filter and of runs at heights.")] = (
        False
    )
    imu: Annotated[bool, typer.Option("--imu", help="Inertial samples and fixes, and the log for navsim replay.")] = (
        False
    )
    motion: Annotated[bool, typer.Option("--motion", help="True motion of the antenna for gps-sdr-sim and Skydel.")] = (
        False
    )
    fas: Annotated[bool, typer.Option("--fas", help="FAS data block of the approach, as hexadecimal digits.")] = False
    mavlink: Annotated[
        str | None,
        value_option(
            "FILE.tlog|udp:127.0.0.1:PORT",
            "Write inertial samples, fixes and ranges of beacons as a MAVLink log, or send them in real time.",
        ),
    ] = None
    speed: Annotated[
        float | None,
        value_option("FACTOR", "Send MAVLink messages this many times faster. Default: 1."),
    ] = None

    def chosen(self) -> list[str]:
        """Names of the formats of `formats.export.export`."""
        names = ("rinex", "nmea", "kml", "geojson", "csv", "imu", "motion", "fas")
        return [name for name in names if getattr(self, name)]


def export(
    file: Annotated[
        Path,
        argument("RESULT.h5", "The result of a landing, a replay, a sweep or a search."),
    ],
    formats: ExportFormats,
    run: Annotated[
        int | None, number_option(int, 0, "Number of the run to write, of an ensemble. Default: the first.")
    ] = None,
    output: Annotated[
        Path | None,
        value_option(
            "FOLDER/STEM", "Beginning of the file names. Default: the result's name without .h5.", "--output", "-o"
        ),
    ] = None,
) -> None:
    """Write a result in the formats of other programs.

    Choose one or more of them.
    """
    from navsim.formats.export import approximate_systems, choose_run
    from navsim.formats.export import export as convert
    from navsim.formats.simulated_log import differences

    chosen, mavlink = formats.chosen(), formats.mavlink
    if not chosen and mavlink is None:
        leave(
            BAD_INPUT,
            "choose one or more of --rinex, --nmea, --kml, --geojson, --csv, --imu, --motion, --fas, --mavlink",
        )
    address = _destination(formats, file)
    target = (output or file).with_suffix(".h5")
    result = read_result(file)
    make_folder(target)
    with shown_as_stored([result], [file]):
        chosen_run, several = choose_run(result, run)
        for path in convert(chosen_run, target, chosen, result) if chosen else ():
            print(path)
        if mavlink is not None:
            _export_mavlink(chosen_run, mavlink, address, formats.speed or 1.0)
        if several is not None:
            print_message(f"{file}: {several}; --run K takes another")
        approximate = approximate_systems(result) if formats.rinex else []
        otherwise = differences(result) if formats.imu else []
    for system in approximate:
        print_message(
            f"warning: the {system} satellites flew by an almanac, and the exported messages only resemble it; fly "
            "with sky.broadcast: true for exact ones"
        )
    for text in otherwise:
        print_message(
            f"warning: the run's filter {text}; navsim replay of the exported log gives other estimates than the run"
        )


def _destination(formats: ExportFormats, file: Path) -> tuple[str, int] | None:
    """Address to which MAVLink messages go, None for a file; exits if the options do not fit together."""
    from navsim.formats.mavlink import loopback_address

    mavlink, speed = formats.mavlink, formats.speed
    if mavlink is not None and mavlink.startswith("udp:"):
        if speed is not None and not speed > 0.0:
            leave(BAD_INPUT, f"--speed {speed}: a number above 0 is needed")
        try:
            return loopback_address(mavlink)
        except ValueError as error:
            leave(BAD_INPUT, f"--mavlink: {error}")
    if speed is not None:
        leave(BAD_INPUT, "--speed is for --mavlink udp:127.0.0.1:PORT")
    if mavlink is not None and re.match(r"[a-z]{3,}:", mavlink):
        leave(BAD_INPUT, f"--mavlink {mavlink}: allowed are a file, and udp:127.0.0.1:PORT")
    if mavlink is not None and (not mavlink or Path(mavlink).resolve() == file.resolve()):
        leave(BAD_INPUT, f"--mavlink {mavlink}: give the log another name than the result, as flight.tlog")
    return None


def _export_mavlink(result: Result, mavlink: str, address: tuple[str, int] | None, speed: float) -> None:
    """Write or send MAVLink messages and say how many."""
    from navsim.formats import mavlink as link

    if address is not None:
        print_message(f"{link.send(result, address, speed)} messages sent to {mavlink}")
    else:
        make_folder(Path(mavlink))
        link.write_log(result, Path(mavlink))
        print(mavlink)
    for text in link.assumptions(result):
        print_message(f"warning: {text}")
