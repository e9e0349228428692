"""Logs of autopilots and receivers as recorded flights, for `navsim import` and `navsim.import_log`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from navsim.formats.text import FileError
from navsim.logs.reading import FORMATS, RECEIVERS, read_logs
from navsim.logs.tables import LOG, RANGES, Account, log_files
from navsim.runner.errors import BadInput, as_problems
from navsim.runner.target import make_folder
from navsim.scenario_files.base import hint


@dataclass(frozen=True)
class ImportedLog:
    """Files of a recorded flight that were written from a log."""

    format: str
    """Title of the log's format."""
    files: list[Path]
    """Tables and texts."""
    account: Account
    """Lists of texts: data `taken` and `left_out`, assumptions (`decided`), and what is `missing` for a replay."""

    @property
    def of_receiver(self) -> bool:
        """Whether the log has fixes, and is of a receiver alone, which has no inertial samples."""
        has_fixes = any(file.name.startswith("gnss") for file in self.files)
        return has_fixes and all(part in RECEIVERS for part in self.format.split("; "))

    @property
    def replayable(self) -> list[Path]:
        """Files that `navsim replay` takes."""
        return [file for name in (LOG, RANGES) for file in self.files if file.name == name]


def import_files(
    logs: Sequence[Path], output: Path | None, form: str | None, imu: int, receiver: int, force: bool
) -> ImportedLog:
    """Write the files of one recording.

    output: folder, by default <log stem>_log. form: format of the logs; None: what each file shows. imu, receiver:
    numbers of the sensors that log.yaml names. force: overwrite. Raises BadInput.
    """
    if form is not None and form not in FORMATS:
        raise BadInput(as_problems(f"--format {form}: not a format of logs; {hint(form, list(FORMATS))}"))
    try:
        contents = read_logs([*logs], form)
    except FileError as error:
        raise BadInput(as_problems(error)) from None
    except OSError as error:
        text = f"{error.filename or logs[0]}: cannot be read: {error.strerror or error}"
        raise BadInput(as_problems(text)) from None
    for option, number, names, what in (
        ("--imu", imu, [each.name for each in contents.imus], "IMU"),
        ("--receiver", receiver, [each.name for each in contents.receivers], "receiver"),
    ):
        if number >= max(len(names), 1):
            there = ", ".join(f"{i}: {name}" for i, name in enumerate(names)) or "none"
            raise BadInput(as_problems(f"{option} {number}: the log has no such {what}; it has {there}"))
    files = log_files(contents, ", ".join(path.name for path in logs), imu, receiver)
    folder = output or Path(f"{logs[0].resolve().stem}_log")
    if not force and (old := [name for name in files.names if (folder / name).exists()]):
        text = f"{folder} has {', '.join(old)} already; choose another folder with -o, or --force"
        raise BadInput(as_problems(text))
    make_folder(folder)
    try:
        files.write(folder)
    except OSError as error:
        raise BadInput(as_problems(f"{folder}: cannot be written: {error.strerror or error}")) from None
    return ImportedLog(contents.format, [folder / name for name in files.names], files.account)
