"""Text files from other programs: decompress and decode them; errors name the line.

All readers of text use this module. It removes what programs and editors leave around a text: byte order marks, Ctrl-Z
or zero bytes after its end, invisible characters. Blanks of all kinds become plain ones. Marks identify UTF-8, UTF-16
and UTF-32; a line that is not UTF-8 is read as Latin-1.

The program of the `hatanaka` package decompresses RINEX (`.crx`, `.??d`), `ncompress` Unix `.Z`; Python gzip, bzip2 and
zip archives of one file. The content determines the compression, not the name. All are decompressed piece by piece, and
refused as soon as they need more memory than allowed.
"""

from __future__ import annotations

import bz2
import codecs
import importlib.resources
import io
import itertools
import lzma
import math
import re
import string
import struct
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from navsim.gnss import timescales
from navsim.results import files

INSTALL_LOGS = "pip install '.[logs]' in the folder of navsim"
"""Command that installs the libraries of logs."""
MOST_BYTES = 800_000_000
"""Largest memory for the lines of a file: their bytes, and `LINE` for each. All readers refuse larger files before they
decompress more."""
LINE = 100
"""Overhead of a line in memory, bytes: a Python string, its place in the list, and data of the reader."""
MOST_RATIO, _FREE = 200, 50_000_000
"""Largest compression ratio of files above `_FREE` bytes. Text shrinks by 3 to 30 with any compression; malicious files
expand by a thousand and more."""
_LONGEST_LINE = 1_000_000
"""Bytes; no format has longer ones."""
_MOST_MEMBERS = 100_000
"""Files in an archive, or parts that a packed file is put together of; some programs begin one each 64 kB."""
_CHUNK, _SLICE = 1 << 20, 1 << 14
"""Bytes read at once, and unpacked at once."""
_MOST_LAYERS = 4
"""Packings one in another that are undone; an archive can be made that holds itself."""
_MOST_EPOCH_LINES = 100
"""Largest number of lines of a Hatanaka-compressed epoch, in the search for the last complete one."""
_MARK = codecs.BOM_UTF8
_MARKS = (
    (_MARK, "utf-8"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
"""Byte order marks and their encodings; that of UTF-32 begins like that of UTF-16."""
_PADDING = b"\x00\x1a"
"""Zero bytes, of loggers without power and of tapes, and Ctrl-Z, of DOS: no part of a text at its end."""
_BLANKS = "\xa0\u1680\u2000\u2001\u2002\u2003\u2004\u2005\u2006\u2007\u2008\u2009\u200a\u202f\u205f\u3000"
_INVISIBLE = "\ufeff\u200b\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2060"
_PLAIN = str.maketrans(_BLANKS, " " * len(_BLANKS), _INVISIBLE)
"""Blanks that do not break or have a width of their own become plain ones; invisible characters are removed."""
MINUS_SIGNS = "\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d\x96"
"""Signs that editors and spreadsheets write for a minus; the last is the dash of Windows-1252."""
_MINUS = str.maketrans(dict.fromkeys(MINUS_SIGNS, "-"))


class FileError(ValueError):
    """A file that cannot be used; `line` counts from 1, 0 for the file as a whole.

    salvageable: whether a lenient reader would have omitted the damaged part and read the rest. outside: column, value
    and limits of a value outside of physical limits.
    """

    def __init__(self, line: int, message: str, path: Path | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.line = line
        self.path = path
        self.salvageable = False
        self.outside: tuple[str, float, tuple[float, float]] | None = None

    def __str__(self) -> str:
        if self.path is None:
            return self.message
        return f"{self.path}:{self.line}: {self.message}" if self.line else f"{self.path}: {self.message}"


@dataclass
class Dropped:
    """Omissions of a reader and their number, by reason. Only a `lenient` reader omits damaged parts.

    outside: first value outside of physical limits, if the reader keeps such values. lines: messages of readers of
    other files.
    """

    lenient: bool = False
    counts: dict[str, int] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    outside: FileError | None = None
    _reasons: dict[str, str] = field(default_factory=dict)

    def add(self, reason: str, count: int) -> None:
        """Count some more."""
        if count:
            self.counts[reason] = self.counts.get(reason, 0) + int(count)

    def damaged(self, what: str, error: FileError) -> None:
        """Omit one of `what` because of an error; the first error is quoted. Raises the error if not lenient."""
        if not self.lenient:
            error.salvageable = True
            raise error
        self.add(self._reasons.setdefault(what, f"{what}; the first: {error}"), 1)

    def reasons(self) -> tuple[str, ...]:
        """A line for each reason."""
        return (*self.lines, *(f"{count} {reason}" for reason, count in self.counts.items()))


def read_lines(path: Path, dropped: Dropped | None = None) -> list[str]:
    """Lines of a text file, without their ends; gzip, bzip2, zip, Unix compress and Hatanaka are decompressed.

    dropped: a lenient one accepts a truncated compressed file, up to the last complete line. Raises FileError if the
    file is not text, cannot be decompressed, or needs more memory than `MOST_BYTES`; OSError if it cannot be read.
    """
    with files.open_regular(path) as file:
        reading = _Reading(path, file, Dropped() if dropped is None else dropped)
        return reading.lines()


def decoded(content: bytes) -> str:
    """Text of a file in UTF-8, or with a mark of UTF-16 or UTF-32.

    Marks and everything after the end are removed, and blanks are plain, as of `read_lines`. Raises UnicodeDecodeError.
    """
    encoding = next((encoding for mark, encoding in _MARKS if content.startswith(mark)), "utf-8")
    return _without_padding(content.decode(encoding).encode()).decode().translate(_PLAIN)


def _without_padding(tail: bytes) -> bytes:
    """A text, or its end, without padding after it."""
    end = len(tail.rstrip(_PADDING + string.whitespace.encode()))
    return tail[:end] + re.split(b"[\x00\x1a]", tail[end:], maxsplit=1)[0]


def check_table(path: Path, *shape: int) -> None:
    """Refuse a file whose numbers need a table of this shape, 8 bytes each, that takes more than `MOST_BYTES`.

    Raises FileError.
    """
    if 8 * math.prod(shape) > MOST_BYTES:
        rows = " x ".join(f"{n:,}" for n in shape)
        raise FileError(0, f"its table of {rows} needs more than {MOST_BYTES:,} bytes of memory; split the file", path)


class _Reading:
    """Unpacks a file piece by piece and never holds more of it than is allowed."""

    def __init__(self, path: Path, file: BinaryIO, dropped: Dropped) -> None:
        self.path = path
        self.file = file
        self.dropped = dropped
        self.cut = False
        self.packed = False
        self.cost = 0
        self.on_disk = file.seek(0, io.SEEK_END)
        file.seek(0)

    @property
    def most(self) -> int:
        """Bytes in memory that this file may take."""
        return min(MOST_BYTES, _FREE + MOST_RATIO * self.on_disk) if self.packed else MOST_BYTES

    def lines(self) -> list[str]:
        out: list[str] = []
        held, data = b"", b""
        for chunk in _gathered_to(_CHUNK, self._unpadded(self._counted(self._unpacked()))):
            data = held + chunk
            if b"\x00" in chunk:
                before = data[: data.index(b"\x00")]
                ends = before.replace(b"\r\n", b"\n").replace(b"\r", b"\n").count(b"\n")
                raise FileError(len(out) + ends + 1, f"not a text file{_of_two_bytes(data)}", self.path)
            held = b""
            if data.endswith(b"\r"):  # of a line end that the next piece may complete
                data, held = data[:-1], b"\r"
            complete, end, last = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").rpartition(b"\n")
            if end:
                out += self._decoded(complete)
            held = last + held
            if len(held) > _LONGEST_LINE:
                raise FileError(len(out) + 1, f"a line of more than {_LONGEST_LINE:,} bytes", self.path)
        if not out and not held and self.cost:
            raise FileError(1, "not a text file: it has zero bytes only", self.path)
        if self.cut:
            return [*out, ""]
        return out + self._decoded(held.replace(b"\r", b"\n"))

    def _decoded(self, data: bytes) -> list[str]:
        """Lines of complete lines of bytes, whose ends are those of Unix."""
        if data.isascii():
            return data.decode("ascii").split("\n")
        # concatenated files contain the marks of each; names in comments are often in Latin-1
        lines = [_text(line.removeprefix(_MARK)) for line in data.split(b"\n")]
        self.cost += sum(sys.getsizeof(line) for line in lines if not line.isascii())  # up to four bytes a character
        self.check(self.cost)
        return lines

    def _counted(self, pieces: Iterator[bytes]) -> Iterator[bytes]:
        """The pieces; raises FileError if they need too much memory."""
        for piece in pieces:
            self.cost += len(piece) + LINE * max(piece.count(b"\n"), piece.count(b"\r"))
            self.check(self.cost)
            yield piece

    def _unpadded(self, pieces: Iterator[bytes]) -> Iterator[bytes]:
        """The pieces without padding after the end of the text."""
        tail: list[bytes] = []
        for piece in pieces:
            if end := len(piece.rstrip(_PADDING + string.whitespace.encode())):
                yield b"".join((*tail, piece[:end]))
                tail = []
            tail.append(piece[end:])
        yield _without_padding(b"".join(tail))

    def check(self, size: int) -> None:
        """Raise FileError for more bytes in memory than this file may take."""
        if size > self.most:
            how = "unpacks to" if self.packed else "takes"
            text = f"{how} more than {self.most:,} bytes in memory"
            raise FileError(0, f"{text} ({self.on_disk:,} on the disk)" if self.packed else text, self.path)

    def gathered(self, pieces: Iterator[bytes]) -> bytes:
        """All pieces at once, for formats that cannot be decompressed piece by piece."""
        out, size = [], 0
        for piece in pieces:
            size += len(piece)
            self.check(size)
            out.append(piece)
        return b"".join(out)

    def _unpacked(self) -> Iterator[bytes]:
        pieces = iter(lambda: self.file.read(_CHUNK), b"")
        for _ in range(_MOST_LAYERS):
            head, pieces = _with_head(pieces)
            marked = next(((mark, encoding) for mark, encoding in _MARKS if head.startswith(mark)), None)
            if marked:
                head, pieces = _with_head(_as_utf_8(self, pieces, *marked))
            unpack = _unpacker(head)
            if unpack is None:
                return pieces
            self.packed = True
            pieces = unpack(self, pieces)
        raise FileError(0, f"the file is compressed more than {_MOST_LAYERS - 1} times; decompress it", self.path)

    def ends_early(self, what: str, message: str) -> None:
        """Truncated compressed file: raise its error, or continue with what there is. Raises FileError."""
        self.dropped.damaged(what, FileError(0, message, self.path))
        self.cut = True


def _with_head(pieces: Iterator[bytes]) -> tuple[bytes, Iterator[bytes]]:
    """The first bytes, 80 if there are so many, and all pieces."""
    head = b""
    while len(head) < 80 and (piece := next(pieces, b"")):
        head += piece
    return head, itertools.chain([head] if head else [], pieces)


def _as_utf_8(reading: _Reading, pieces: Iterator[bytes], mark: bytes, encoding: str) -> Iterator[bytes]:
    """A text without its byte order mark, in UTF-8."""
    if mark == _MARK:
        first = next(pieces).removeprefix(mark)
        return itertools.chain([first] if first else [], pieces)
    return _recoded(reading, pieces, encoding)


def _recoded(reading: _Reading, pieces: Iterator[bytes], encoding: str) -> Iterator[bytes]:
    decoder = codecs.getincrementaldecoder(encoding)()
    try:
        for piece in pieces:
            if text := decoder.decode(piece):
                yield text.encode()
        decoder.decode(b"", True)
    except UnicodeDecodeError as error:
        message = f"not a text file: it begins like {encoding.upper()}, but is not ({error.reason})"
        raise FileError(0, message, reading.path) from None


def _text(line: bytes) -> str:
    """A line of UTF-8, or else of Latin-1, with plain blanks."""
    try:
        return line.decode().translate(_PLAIN)
    except UnicodeDecodeError:
        return line.decode("latin-1").translate(_PLAIN)


def _of_two_bytes(data: bytes) -> str:
    """Addition to a message about data that seem to be UTF-16 without its mark."""
    for first, order in ((1, "little"), (0, "big")):
        zeros, others = data[first:100:2], data[1 - first : 100 : 2]
        if zeros and not zeros.strip(b"\x00") and b"\x00" not in others:
            return f": it seems to be UTF-16 ({order}-endian) without a byte order mark; save it as UTF-8"
    return ""


def _gathered_to(size: int, pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Pieces joined to at least this size, except the last."""
    out, gathered = [], 0
    for piece in pieces:
        out.append(piece)
        gathered += len(piece)
        if gathered >= size:
            yield b"".join(out)
            out, gathered = [], 0
    if out:
        yield b"".join(out)


_Unpacker = Callable[[_Reading, Iterator[bytes]], Iterator[bytes]]


def _unpacker(head: bytes) -> _Unpacker | None:
    """Decompressor for the outermost compression; None for uncompressed data."""
    if head[:2] == b"\x1f\x8b":
        return _gunzip
    if head[:3] == b"BZh" and head[3:4].isdigit():
        return _bunzip
    if head[:4] in (b"PK\x03\x04", b"PK\x05\x06", b"PK\x07\x08"):
        return _unzip
    if head[:2] == b"\x1f\x9d":
        return _uncompress
    if b"CRINEX VERS" in head[:80]:
        return _by_hatanaka
    return None


def _gunzip(reading: _Reading, pieces: Iterator[bytes]) -> Iterator[bytes]:
    return _inflated(reading, pieces, "gzip", b"\x1f\x8b", lambda: _Inflate(wbits=31))


def _bunzip(reading: _Reading, pieces: Iterator[bytes]) -> Iterator[bytes]:
    return _inflated(reading, pieces, "bzip2", b"BZh", bz2.BZ2Decompressor)


class _Inflate:
    """zlib's decompressor with the interface of bzip2's; it does not report unused input."""

    def __init__(self, wbits: int) -> None:
        self._inner = zlib.decompressobj(wbits=wbits)

    def decompress(self, data: bytes, most: int) -> bytes:
        return self._inner.decompress(self._inner.unconsumed_tail + data, most)

    @property
    def needs_input(self) -> bool:
        return not self._inner.unconsumed_tail

    @property
    def eof(self) -> bool:
        return self._inner.eof

    @property
    def unused_data(self) -> bytes:
        return self._inner.unused_data


def _inflated(
    reading: _Reading, pieces: Iterator[bytes], kind: str, magic: bytes, unpacker: Callable[[], Any]
) -> Iterator[bytes]:
    """All members of a packed file: several one after another are rare, and legal."""
    # in small pieces: data after a member are copied at its end
    pieces = (piece[at : at + _SLICE] for piece in pieces for at in range(0, len(piece), _SLICE))
    rest, member, members = b"", None, 0
    while True:
        if member is None:
            while len(rest) < len(magic) and (piece := next(pieces, b"")):
                rest += piece
                rest = rest.lstrip(b"\x00") if members else rest  # tapes and disks pad with zeros
            if not rest:
                return
            if not rest.startswith(magic):
                after = len(rest) + sum(map(len, pieces))
                message = f"cannot be unpacked: {after} bytes follow the end of the {kind} data"
                raise FileError(0, message, reading.path)
            member, members = unpacker(), members + 1
            if members > _MOST_MEMBERS:
                raise FileError(0, f"the {kind} file has more than {_MOST_MEMBERS:,} members", reading.path)
        ended = False
        if not rest and member.needs_input:
            rest = next(pieces, b"")
            ended = not rest
        try:
            out = member.decompress(rest, _CHUNK)
        except (zlib.error, OSError, EOFError) as error:
            raise FileError(0, f"cannot be unpacked: {error}", reading.path) from None
        rest = b""
        if out:
            yield out
        elif ended and not member.eof:
            reading.ends_early("end of a packed file", f"the {kind} file ends too early")
            return
        if member.eof:
            rest, member = member.unused_data.lstrip(b"\x00"), None


def _unzip(reading: _Reading, pieces: Iterator[bytes]) -> Iterator[bytes]:
    path = reading.path
    data = reading.gathered(pieces)
    if data.count(_ENTRY) > _MOST_MEMBERS:  # each would take half a kilobyte
        raise FileError(0, f"the zip archive has more than {_MOST_MEMBERS:,} files; give one with a single file", path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [member for member in archive.infolist() if not member.is_dir()]
            if len(members) != 1:
                some = ", ".join(member.filename for member in members[:3]) + (", ..." if len(members) > 3 else "")
                text = f"{len(members)} files ({some})" if members else "no file"
                raise FileError(0, f"the zip archive has {text}; give one with a single file", path)
            with archive.open(members[0]) as file:
                while out := file.read(_CHUNK):
                    yield out
    except FileError:
        raise
    except (
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, OSError, EOFError, RuntimeError, ValueError
    ) as error:  # fmt: skip
        # damaged lists of members make zipfile raise nearly anything; RuntimeError: encrypted, or unknown methods
        raise FileError(0, f"cannot be unpacked: {error}", path) from None


_ENTRY = b"PK\x01\x02"
"""Signature of a file in the directory of a zip archive."""


def _uncompress(reading: _Reading, pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Unix compress, into a file: its programs unpack all at once."""
    import ncompress

    with tempfile.TemporaryFile() as out:
        bounded = _Bounded(reading, out)
        try:
            ncompress.decompress(io.BytesIO(reading.gathered(pieces)), bounded)
        except (ValueError, OSError, RuntimeError) as error:
            raise bounded.refused or FileError(0, f"cannot be unpacked: {error}", reading.path) from None
        out.seek(0)
        yield from iter(lambda: out.read(_CHUNK), b"")


class _Bounded(io.RawIOBase):
    """A file to write to that takes no more than a reading may."""

    def __init__(self, reading: _Reading, out: BinaryIO) -> None:
        self._reading, self._out, self._size = reading, out, 0
        self.refused: FileError | None = None

    def write(self, data: Any) -> int:
        self._size += len(data)
        try:
            self._reading.check(self._size)
        except FileError as error:
            self.refused = error
            raise OSError("refused") from None
        return self._out.write(data)


def _by_hatanaka(reading: _Reading, pieces: Iterator[bytes]) -> Iterator[bytes]:
    data = reading.gathered(pieces)
    try:
        return iter([_hatanaka(reading, data)])
    except _Damaged as damaged:
        message = f"cannot be unpacked: {damaged}"
        if "truncated" not in str(damaged):
            raise FileError(0, message, reading.path) from None
    reading.ends_early("end of a Hatanaka-compressed file", message)
    # differences build on one another from the beginning, so a cut file is intact up to its last complete epoch
    lines = data.split(b"\n")
    for last in range(len(lines) - 1, max(len(lines) - 1 - _MOST_EPOCH_LINES, 0), -1):
        try:
            return iter([_hatanaka(reading, b"\n".join(lines[:last]) + b"\n")])
        except _Damaged:
            continue
    raise FileError(0, message, reading.path)


class _Damaged(Exception):
    """Error message of the program for Hatanaka's compression."""


def _hatanaka(reading: _Reading, data: bytes) -> bytes:
    """Output of the program for Hatanaka's compression, with a size limit. Raises _Damaged, FileError.

    Its Python interface has no limit: a hundred bytes may become a hundred kilobytes.
    """
    with (
        importlib.resources.as_file(importlib.resources.files("hatanaka.bin") / "crx2rnx") as program,
        tempfile.TemporaryFile() as source,
        tempfile.TemporaryFile() as text,
    ):
        source.write(data)
        source.seek(0)
        with subprocess.Popen([str(program), "-"], stdin=source, stdout=subprocess.PIPE, stderr=text) as running:
            assert running.stdout is not None
            output = running.stdout
            try:
                out = reading.gathered(iter(lambda: output.read(_CHUNK), b""))
            except FileError:
                running.kill()
                raise
        text.seek(0)
        words = re.sub(r"^ *(ERROR|WARNING) *:? *", "", text.read(10_000).decode("ascii", "replace"), flags=re.M)
    last = [line.strip() for line in words.splitlines() if line.strip()]
    if running.returncode or last:  # a warning is of a repaired file: wrong numbers without a word
        raise _Damaged(" ".join(last)[:200] if last else f"status {running.returncode}")
    return out


def column(path: Path, line: int, text: str, start: int, width: int, name: str) -> float:
    """The finite number in fixed columns of a line, which must not end within it. Raises FileError."""
    piece = text[start : start + width]
    if len(piece) < width and piece.strip():
        raise ends_within(path, line, piece, name)
    return number(path, line, piece, name)


def ends_within(path: Path, line: int, piece: str, name: str) -> FileError:
    """The error for a line that is cut off within a value: the rest of its digits would be a wrong number."""
    return FileError(line, f"the line ends within {name}: '{piece.strip()}'", path)


def plain_number(text: str) -> float:
    """A number in Python's syntax without underscores and non-ASCII digits; the minus may be any of `MINUS_SIGNS`.

    Raises ValueError.
    """
    plain = as_ascii(text)
    if "_" in plain or not plain.isascii():
        raise ValueError(f"could not convert string to float: {text!r}")
    return float(plain)


def as_ascii(text: str) -> str:
    """A text with plain minus signs."""
    return text if text.isascii() else text.translate(_MINUS)


def number(path: Path, line: int, text: str, name: str) -> float:
    """A finite number, also with Fortran's D for the exponent. Raises FileError."""
    try:
        value = plain_number(text)
    except ValueError:
        try:
            value = plain_number(text.strip().replace("D", "E").replace("d", "e"))
        except ValueError:
            said = repr(text.strip()[:30]) if text.strip() else "nothing"
            raise FileError(line, f"expected a number for {name}, found {said}", path) from None
    if not math.isfinite(value):
        raise FileError(line, f"{name} is not a finite number", path)
    return value


def integer(path: Path, line: int, text: str, name: str) -> int:
    """An integer. Raises FileError."""
    value = number(path, line, text, name)
    if value != int(value):
        raise FileError(line, f"{name} must be an integer, not {text.strip()[:30]}", path)
    return int(value)


def within(path: Path, line: int, value: float, low: float, high: float, name: str) -> float:
    """The value, when it is in the range. Raises FileError."""
    if not low <= value <= high:
        raise FileError(line, f"{name} is {value:g}; allowed: {low:g} to {high:g}", path)
    return value


def date_and_time(path: Path, line: int, parts: list[str]) -> float:
    """Year (two digits count from 1980 to 2079), month, day, hour, minute, second as if they were UTC, POSIX s.

    Raises FileError.
    """
    year, month, day, hour, minute = (integer(path, line, part, "the epoch") for part in parts[:5])
    if len(parts[0].strip()) <= 2:
        within(path, line, year, 0, 99, "the year")
        year += 1900 if year >= 80 else 2000
    second = number(path, line, parts[5], "the epoch")
    try:
        return timescales.posix(year, month, day, hour, minute, second)
    except (ValueError, OverflowError) as error:
        raise FileError(line, f"invalid time: {error}", path) from None
