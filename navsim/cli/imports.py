"""`navsim import`, `navsim imu`: logs of other programs as recorded flights, and the noise of their sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import AT_TERMINAL, Shown, leave, leaving, make_folder, print_parts
from navsim.cli.exit_status import BAD_INPUT, RUN_FAILED
from navsim.cli.options import argument, number_option, value_option

FORMATS = ("ardupilot", "px4", "ublox", "nmea", "rtklib", "kf-gins", "comma2k19")
"""As of `logs.reading`, which `--help` does without."""


@dataclass(frozen=True)
class ImportOptions:
    """Format of a log, and its sensors for log.yaml."""

    output: Annotated[
        Path | None,
        value_option("FOLDER", "Folder for the files. Default: <log stem>_log.", "--output", "-o"),
    ] = None  # fmt: skip
    format_: Annotated[
        str | None,
        value_option(
            "|".join(FORMATS), "Format of the log. Default: what the file shows.", "--format",
            autocompletion=lambda: [*FORMATS],
        ),
    ] = None  # fmt: skip
    imu: Annotated[int, number_option(int, 0, "The IMU that log.yaml names.", show_default=True)] = 0
    receiver: Annotated[int, number_option(int, 0, "The receiver that log.yaml names.", show_default=True)] = 0
    force: Annotated[bool, typer.Option("--force", help="Overwrite files of an earlier import.")] = False


def import_log(
    logs: Annotated[
        list[Path],
        argument("LOG", "A log; several files of one recording if they have GPS time."),
    ],
    given: ImportOptions,
) -> None:  # fmt: skip
    """Turn a log of an autopilot or a receiver into a recorded flight.

    navsim writes tables and a commented log.yaml for `navsim replay`. It lists the data that it took and left out, and
    its assumptions. It exits with 3 if an autopilot's log has too little for a log.yaml.
    """
    from navsim.runner.log_import import import_files

    with leaving():
        made = import_files(logs, given.output, given.format_, given.imu, given.receiver, given.force)
    print(f"{logs[0]}: {made.format}")
    for line in made.account.lines():
        print(line)
    for text in made.account.missing:
        AT_TERMINAL.warn(f"{logs[0]}: {text}")
    for file in made.replayable:
        print(f"go on with: navsim replay {file}")
    if made.account.missing and not made.of_receiver:
        raise typer.Exit(RUN_FAILED)


@dataclass(frozen=True)
class SheetOptions:
    """Part of a log, and its sensor."""

    output: Annotated[
        Path | None,
        value_option("FOLDER", "Folder for the files. Default: <log stem>_imu.", "--output", "-o"),
    ] = None  # fmt: skip
    imu: Annotated[int, number_option(int, 0, "The IMU of a log with several.", show_default=True)] = 0
    start: Annotated[float | None, number_option(float, 0, "Begin at this time of the log.")] = None
    end: Annotated[float | None, number_option(float, 0, "End at this time of the log.")] = None
    force: Annotated[bool, typer.Option("--force", help="Overwrite files of an earlier call.")] = False


def imu_sheet(
    log: Annotated[
        Path,
        argument("LOG", "A log that `navsim import` reads, a log.yaml, or a table of samples."),
    ],
    given: SheetOptions,
) -> None:  # fmt: skip
    """Measure the noise of inertial sensors in a log at rest.

    navsim prints white noise, bias instability and random walk with intervals. It writes a block for `imu:` of a
    scenario, and the overlapping Allan deviation as a table and a figure. It refuses a log of a moving sensor.
    """
    from navsim.formats.text import FileError
    from navsim.replays.imu_sheet import StaticError, curve, figure, measure, read_static, sheet, tables
    from navsim.results.atomic_write import write_atomically
    from navsim.scenario_files.source import InputError

    folder = given.output or Path(f"{log.resolve().stem}_imu")
    names = ("imu.yaml", "allan.csv", "allan.png")
    if not given.force and (old := [name for name in names if (folder / name).exists()]):
        leave(BAD_INPUT, f"{folder} has {', '.join(old)} already; choose another folder with -o, or --force")
    try:
        samples, source = read_static(log, given.imu)
        first = -math.inf if given.start is None else given.start
        last = math.inf if given.end is None else given.end
        noise = measure(samples, source, first, last)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except FileError as error:
        leave(BAD_INPUT, error)
    except StaticError as error:
        leave(BAD_INPUT, f"{log}: {error}")
    except OSError as error:
        leave(BAD_INPUT, f"{error.filename or log}: cannot be read: {error.strerror or error}")
    make_folder(folder)
    heads, rows = curve(noise)
    text = "\n".join([",".join(heads), *(",".join(f"{x:.6g}" for x in row) for row in rows)]) + "\n"
    try:
        folder.mkdir(exist_ok=True)
        for name, content in zip(names, (sheet(noise).encode(), text.encode(), figure(noise)), strict=True):
            write_atomically(folder / name, content)
    except OSError as error:
        leave(BAD_INPUT, f"{folder}: cannot be written: {error.strerror or error}")
    print_parts(tables(noise), Shown())
    print(f"written  {', '.join(str(folder / name) for name in names)}")
