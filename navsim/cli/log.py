"""`--log FILE`: append events and messages of a command to a file, one JSON object a line.

Every line has `time` (UTC) and `event`: `start` (command, version, process, folder), `said`, `warning` and `error`
(text), `progress` (text, finished, extent, unit, used_s, left_s), `end` (code, seconds, text).
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import RLock
from typing import IO, Any

_files: list[IO[str]] = []
_lock = RLock()
_KINDS = ("warning", "error")


class NoLog(Exception):
    """A file that cannot be a log."""


def is_open() -> bool:
    """Whether a log is open."""
    return bool(_files)


def note(event: str, **members: Any) -> None:
    """A line of the log. One that the disk does not take ends the log, and not the work."""
    import json
    from datetime import UTC, datetime

    at = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    _write(json.dumps({"time": at, "event": event, **members}) + "\n")


def _write(text: str) -> None:
    """Write to the log; a failure is reported, and ends it."""
    with _lock:
        for file in _files:
            try:
                file.write(text)
            except OSError as error:
                _files.clear()
                print(f"warning: {file.name}: {error.strerror}; the log ends here", file=sys.stderr)


def note_message(message: str) -> None:
    """Log a message, whose beginning marks it as a warning or an error."""
    kind, _, text = message.partition(": ")
    if kind in _KINDS:
        note(kind, text=text)
    else:
        note("said", text=message)


@contextmanager
def logged(path: Path, command: list[str]) -> Iterator[None]:
    """Context with a log in a file. Raises NoLog if the file is not a log, or cannot be written."""
    import navsim

    try:
        file = open(path, "a+", encoding="utf-8", buffering=1, errors="replace")  # noqa: SIM115 - closed below
        whole = _ends_with_newline(file)
    except OSError as error:
        raise NoLog(f"{path}: {error.strerror or error}") from None
    with _closing(file):
        if whole is None:
            raise NoLog(f"{path}: is there already and no log; choose another file")
        begun = time.monotonic()
        code, text = 0, ""
        _files.append(file)
        try:
            if not whole:  # the last line was cut off
                _write("\n")
            note("start", command=command, version=navsim.__version__, process=os.getpid(), folder=os.getcwd())
            yield
        except BaseException as error:
            code, text = _end_of(error)
            raise
        finally:
            note("end", code=code, seconds=round(time.monotonic() - begun, 3), text=text)
            _files.clear()


@contextmanager
def _closing(file: IO[str]) -> Iterator[None]:
    """Close a file at the end, which tries again to write what the disk did not take: `_write` has reported it."""
    try:
        yield
    finally:
        with suppress(OSError):
            file.close()


def _ends_with_newline(file: IO[str]) -> bool | None:
    """Whether a log, which may be empty, ends with a complete line; None for another file."""
    import json

    file.seek(0)
    first = file.readline()
    if not first:
        return True
    try:
        ours = {"time", "event"} <= json.loads(first).keys()
    except (ValueError, AttributeError):
        return None
    if not ours:
        return None
    rest = file.read()
    return (rest or first).endswith("\n")


def _end_of(error: BaseException) -> tuple[int, str]:
    """Exit code of a command that ends by this error, and the reason, if no error was printed."""
    from navsim.cli.exit_status import OK, RUN_FAILED, WORDS, signal_that_came

    for name in ("exit_code", "code"):  # of typer, of the interpreter
        if isinstance(known := getattr(error, name, None), int):
            return known, ""
    if isinstance(error, KeyboardInterrupt):
        number = signal_that_came()
        return 128 + number, WORDS[number]
    if isinstance(error, BrokenPipeError):  # the reader went away
        return OK, ""
    return RUN_FAILED, f"{type(error).__name__}: {error}"
