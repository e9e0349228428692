"""Text files of others: opened whatever their packing, and refused with a line.

Hatanaka-compressed RINEX (`.crx`, `.??d`) and Unix `.Z` are unpacked by the `hatanaka` package, gzip by Python.
"""

from __future__ import annotations

import gzip
import math
import zlib
from pathlib import Path

from navsim.models import timescales

MOST_BYTES = 2_000_000_000
"""Larger texts are refused: a damaged header of a packed file may promise anything."""


class FileError(ValueError):
    """A file that cannot be used; `line` counts from 1, 0 for the file as a whole."""

    def __init__(self, line: int, message: str, path: Path | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.line = line
        self.path = path

    def __str__(self) -> str:
        if self.path is None:
            return self.message
        return f"{self.path}:{self.line}: {self.message}" if self.line else f"{self.path}: {self.message}"


def read_lines(path: Path) -> list[str]:
    """The lines of a text file, without their ends; gzip, Unix compress and Hatanaka are unpacked.

    Raises FileError where the file is no text or cannot be unpacked, OSError where it cannot be read.
    """
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        data = _gunzip(path, data)
    if data[:2] == b"\x1f\x9d" or b"CRINEX VERS" in data[:80]:
        data = _unpack(path, data)
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as error:
        # names of places and people in comments are often in Latin 1; binary files have zeros
        if b"\x00" in data:
            line = data[: error.start].count(b"\n") + 1
            raise FileError(line, "not a text file", path) from None
        text = data.decode("latin-1")
    if "\x00" in text:
        raise FileError(text[: text.index("\x00")].count("\n") + 1, "not a text file", path)
    return text.split("\n") if "\r" not in text else text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _gunzip(path: Path, data: bytes) -> bytes:
    unpacker = zlib.decompressobj(wbits=31)
    try:
        out = unpacker.decompress(data, MOST_BYTES)
        if unpacker.unconsumed_tail:
            raise FileError(0, f"unpacks to more than {MOST_BYTES // 10**9} GB", path)
        if not unpacker.eof:
            raise FileError(0, "the gzip file ends too early", path)
        # several members in one file are rare, and legal
        return out if not unpacker.unused_data else gzip.decompress(data)
    except (zlib.error, OSError, EOFError) as error:
        raise FileError(0, f"cannot be unpacked: {error}", path) from None


def _unpack(path: Path, data: bytes) -> bytes:
    import warnings

    import hatanaka

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a repaired file would be wrong numbers without a word
            return hatanaka.decompress(data)
    except (hatanaka.HatanakaException, UserWarning, ValueError, OSError) as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
        raise FileError(0, f"cannot be unpacked: {reason[:200]}", path) from None


def number(path: Path, line: int, text: str, name: str) -> float:
    """A finite number, also with Fortran's D for the exponent. Raises FileError."""
    try:
        value = float(text)
    except ValueError:
        try:
            value = float(text.strip().replace("D", "E").replace("d", "e"))
        except ValueError:
            said = repr(text.strip()[:30]) if text.strip() else "nothing"
            raise FileError(line, f"expected a number for {name}, found {said}", path) from None
    if not math.isfinite(value):
        raise FileError(line, f"{name} is not a finite number", path)
    return value


def whole(path: Path, line: int, text: str, name: str) -> int:
    """A whole number. Raises FileError."""
    value = number(path, line, text, name)
    if value != int(value):
        raise FileError(line, f"{name} must be a whole number, not {text.strip()[:30]}", path)
    return int(value)


def within(path: Path, line: int, value: float, low: float, high: float, name: str) -> float:
    """The value, when it is in the range. Raises FileError."""
    if not low <= value <= high:
        raise FileError(line, f"{name} is {value:g}, allowed is {low:g} to {high:g}", path)
    return value


def date_and_time(path: Path, line: int, parts: list[str]) -> float:
    """Year (two digits count from 1980 to 2079), month, day, hour, minute, second as if they were UTC, POSIX s.

    Raises FileError.
    """
    year, month, day, hour, minute = (whole(path, line, part, "the epoch") for part in parts[:5])
    if len(parts[0].strip()) <= 2:
        within(path, line, year, 0, 99, "the year")
        year += 1900 if year >= 80 else 2000
    second = number(path, line, parts[5], "the epoch")
    try:
        return timescales.posix(year, month, day, hour, minute, second)
    except (ValueError, OverflowError) as error:
        raise FileError(line, f"no such time: {error}", path) from None
