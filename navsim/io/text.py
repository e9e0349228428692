"""Text files of others: opened whatever their packing, and refused with a line.

Hatanaka-compressed RINEX (`.crx`, `.??d`) and Unix `.Z` are unpacked by the `hatanaka` package; gzip, bzip2 and zip
archives of one file by Python. Packing is told by the content, not by the name.
"""

from __future__ import annotations

import bz2
import io
import lzma
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from navsim.models import timescales

MOST_BYTES = 2_000_000_000
"""Larger texts are refused: a damaged header of a packed file may promise anything."""
_MOST_LAYERS = 4
"""Packings one in another that are undone; an archive can be made that holds itself."""
_MOST_EPOCH_LINES = 100
"""Lines of a Hatanaka-compressed epoch, at most, in search of the last whole one."""


class FileError(ValueError):
    """A file that cannot be used; `line` counts from 1, 0 for the file as a whole.

    salvageable: whether a lenient reader would have left the damaged part out and read the rest.
    """

    def __init__(self, line: int, message: str, path: Path | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.line = line
        self.path = path
        self.salvageable = False

    def __str__(self) -> str:
        if self.path is None:
            return self.message
        return f"{self.path}:{self.line}: {self.message}" if self.line else f"{self.path}: {self.message}"


@dataclass
class Dropped:
    """What a reader left out or moved: how often, by reason. Damaged parts are left out only by a `lenient` reader.

    outside: the first value outside of physical limits, where the reader was told to go on with it.
    """

    lenient: bool = False
    counts: dict[str, int] = field(default_factory=dict)
    outside: FileError | None = None
    _reasons: dict[str, str] = field(default_factory=dict)

    def add(self, reason: str, count: int) -> None:
        """Count some more."""
        if count:
            self.counts[reason] = self.counts.get(reason, 0) + int(count)

    def damaged(self, what: str, error: FileError) -> None:
        """Leave one of `what` out for an error, the first of which is quoted. Raises the error if not lenient."""
        if not self.lenient:
            error.salvageable = True
            raise error
        self.add(self._reasons.setdefault(what, f"{what}; the first: {error}"), 1)

    def said(self) -> tuple[str, ...]:
        """A line for each reason."""
        return tuple(f"{count} {reason}" for reason, count in self.counts.items())


def read_lines(path: Path, dropped: Dropped | None = None) -> list[str]:
    """The lines of a text file, without their ends; gzip, bzip2, zip, Unix compress and Hatanaka are unpacked.

    dropped: a lenient one takes what a packed file holds that is cut at its end, up to the last whole line. Raises
    FileError where the file is no text or cannot be unpacked, OSError where it cannot be read.
    """
    dropped = Dropped() if dropped is None else dropped
    data = path.read_bytes()
    for _ in range(_MOST_LAYERS):
        unpack = _unpacker(data)
        if unpack is None:
            break
        data = unpack(path, data, dropped)
    else:
        raise FileError(0, f"packed more than {_MOST_LAYERS - 1} times", path)
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


def _unpacker(data: bytes) -> Callable[[Path, bytes, Dropped], bytes] | None:
    """What undoes the outermost packing; None for data that are not packed."""
    if data[:2] == b"\x1f\x8b":
        return _gunzip
    if data[:3] == b"BZh" and data[3:4].isdigit():
        return _bunzip
    if data[:4] in (b"PK\x03\x04", b"PK\x05\x06", b"PK\x07\x08"):
        return _unzip
    if data[:2] == b"\x1f\x9d" or b"CRINEX VERS" in data[:80]:
        return _by_hatanaka
    return None


def _gunzip(path: Path, data: bytes, dropped: Dropped) -> bytes:
    return _inflated(path, data, dropped, "gzip", b"\x1f\x8b", lambda: zlib.decompressobj(wbits=31))


def _bunzip(path: Path, data: bytes, dropped: Dropped) -> bytes:
    return _inflated(path, data, dropped, "bzip2", b"BZh", bz2.BZ2Decompressor)


def _inflated(path: Path, data: bytes, dropped: Dropped, kind: str, magic: bytes, unpacker: Callable[[], Any]) -> bytes:
    """All members of a packed file: several one after another are rare, and legal."""
    out, size = [], 0
    while data:
        if not data.startswith(magic):
            raise FileError(0, f"cannot be unpacked: {len(data)} bytes after the end of the {kind} data", path)
        member = unpacker()
        try:
            out.append(member.decompress(data, MOST_BYTES + 1 - size))
        except (zlib.error, OSError, EOFError) as error:
            raise FileError(0, f"cannot be unpacked: {error}", path) from None
        size += len(out[-1])
        if size > MOST_BYTES:
            raise _too_large(path)
        if not member.eof:
            dropped.damaged("end of a packed file", FileError(0, f"the {kind} file ends too early", path))
            whole = b"".join(out)
            return whole[: whole.rfind(b"\n") + 1]
        data = member.unused_data.lstrip(b"\x00")  # tapes and disks pad with zeros
    return b"".join(out)


def _unzip(path: Path, data: bytes, dropped: Dropped) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
            if len(members) != 1:
                some = ", ".join(member.filename for member in members[:3]) + (", ..." if len(members) > 3 else "")
                said = f"{len(members)} files ({some})" if members else "no file"
                raise FileError(0, f"the zip archive holds {said}; allowed is exactly one", path)
            with archive.open(members[0]) as file:
                out = file.read(MOST_BYTES + 1)
    except FileError:
        raise
    except (
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, OSError, EOFError, RuntimeError, ValueError
    ) as error:  # fmt: skip
        # damaged lists of members make zipfile raise nearly anything; RuntimeError: encrypted, or unknown methods
        raise FileError(0, f"cannot be unpacked: {error}", path) from None
    if len(out) > MOST_BYTES:
        raise _too_large(path)
    return out


def _too_large(path: Path) -> FileError:
    return FileError(0, f"unpacks to more than {MOST_BYTES:,} bytes", path)


def _by_hatanaka(path: Path, data: bytes, dropped: Dropped) -> bytes:
    try:
        return _hatanaka(data)
    except _Refused as refused:
        error = FileError(0, f"cannot be unpacked: {refused}", path)
        if "truncated" not in str(refused):
            raise error from None
    dropped.damaged("end of a Hatanaka-compressed file", error)
    # differences build on one another from the beginning, so a cut file is whole up to its last whole epoch
    lines = data.split(b"\n")
    for last in range(len(lines) - 1, max(len(lines) - 1 - _MOST_EPOCH_LINES, 0), -1):
        try:
            return _hatanaka(b"\n".join(lines[:last]) + b"\n")
        except _Refused:
            continue
    raise error


class _Refused(Exception):
    """What the programs for Hatanaka's compression said."""


def _hatanaka(data: bytes) -> bytes:
    import hatanaka

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a repaired file would be wrong numbers without a word
            return hatanaka.decompress(data)
    except (hatanaka.HatanakaException, UserWarning, ValueError, OSError) as error:
        said = str(error).strip().splitlines()
        raise _Refused(said[-1][:200] if said else type(error).__name__) from None


def column(path: Path, line: int, text: str, start: int, width: int, name: str) -> float:
    """The finite number in fixed columns of a line, which must not end within it. Raises FileError."""
    piece = text[start : start + width]
    if len(piece) < width and piece.strip():
        raise ends_within(path, line, piece, name)
    return number(path, line, piece, name)


def ends_within(path: Path, line: int, piece: str, name: str) -> FileError:
    """The error for a line that is cut off within a value: the rest of its digits would be a wrong number."""
    return FileError(line, f"the line ends within {name}: '{piece.strip()}'", path)


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
