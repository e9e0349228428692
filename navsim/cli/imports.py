"""`navsim import`: logs of other programs as tables for `navsim replay`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import AT_TERMINAL, leave
from navsim.cli.exit_status import BAD_INPUT
from navsim.cli.options import number_option

FORMATS = ("ardupilot", "px4", "ublox", "nmea", "rtklib", "kf-gins", "comma2k19")
"""As of `formats.logs.reading`, which `--help` does without."""


@dataclass(frozen=True)
class ImportOptions:
    """Format of a log, and its sensors for log.yaml."""

    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder for the files. Default: <log stem>_log.",
                     show_default=False),
    ] = None  # fmt: skip
    format_: Annotated[
        str | None,
        typer.Option("--format", metavar="|".join(FORMATS), help="Format of the log. Default: what the file shows.",
                     show_default=False, autocompletion=lambda: [*FORMATS]),
    ] = None  # fmt: skip
    imu: Annotated[int, number_option(int, 0, "The IMU that log.yaml names.", show_default=True)] = 0
    receiver: Annotated[int, number_option(int, 0, "The receiver that log.yaml names.", show_default=True)] = 0
    force: Annotated[bool, typer.Option("--force", help="Overwrite files of an earlier import.")] = False


def import_log(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG", help="A log; several files of one recording if they have GPS time.",
                       show_default=False),
    ],
    given: ImportOptions,
) -> None:  # fmt: skip
    """Turn a log of an autopilot or a receiver into a recorded flight.

    Writes tables and a commented log.yaml for `navsim replay`. Lists the data taken, the data left out, and decisions.
    """
    from navsim.formats.logs.reading import read_logs
    from navsim.formats.logs.tables import LOG, RANGES, log_files
    from navsim.formats.text import FileError
    from navsim.scenario.base import hint

    if given.format_ is not None and given.format_ not in FORMATS:
        leave(BAD_INPUT, f"--format {given.format_}: not a format of logs; {hint(given.format_, list(FORMATS))}")
    try:
        contents = read_logs(logs, given.format_)
    except FileError as error:
        leave(BAD_INPUT, error)
    except OSError as error:
        leave(BAD_INPUT, f"{error.filename or logs[0]}: cannot be read: {error.strerror or error}")
    for option, number, names, what in (
        ("--imu", given.imu, [each.name for each in contents.imus], "IMU"),
        ("--receiver", given.receiver, [each.name for each in contents.receivers], "receiver"),
    ):
        if number >= max(len(names), 1):
            there = ", ".join(f"{i}: {name}" for i, name in enumerate(names)) or "none"
            leave(BAD_INPUT, f"{option} {number}: the log has no such {what}; it has {there}")
    files = log_files(contents, ", ".join(path.name for path in logs), given.imu, given.receiver)
    folder = given.output or Path(f"{logs[0].resolve().stem}_log")
    if not given.force and (old := [name for name in files.names if (folder / name).exists()]):
        leave(BAD_INPUT, f"{folder} has {', '.join(old)} already; choose another folder with -o, or --force")
    try:
        files.write(folder)
    except OSError as error:
        leave(BAD_INPUT, f"{folder}: cannot be written: {error.strerror or error}")
    print(f"{logs[0]}: {contents.format}")
    for line in files.account.lines():
        print(line)
    for text in files.account.missing:
        AT_TERMINAL.warn(f"{logs[0]}: {text}")
    if LOG in files.texts and not files.account.missing:
        print(f"go on with: navsim replay {folder / LOG}")
    if RANGES in files.texts:
        print(f"go on with: navsim run {folder / RANGES}")
