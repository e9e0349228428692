"""Partial work on disk: finished pieces of a study, so that the same command continues after a kill.

The partial work of a study is in the folder `RESULT.partial`. `key.json` identifies the study, `command.json` has its
command line. Every piece is a file of arrays, written atomically. The key comes first, and folders are deleted by one
renaming, so no piece is ever without a key.

A piece is a `.npz`, that is a zip archive, which holds a CRC-32 of each array. Its comment is the SHA-256 of the study,
the piece's name and the names, sizes and CRC-32 of all arrays. Comment and CRC-32 must match, so a piece that is
damaged, of another study or under another name does not count.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import shlex
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np

import navsim
from navsim.compiler.jit import digest
from navsim.results.atomic_write import discard, replacing, write_atomically
from navsim.results.files import open_regular

_HASHED = {
    "scenario_sha256": "settings of the scenario",
    "study_sha256": "settings of the study",
    "kernels": "compiled code",
    "sources": "code of navsim",
    "files": "satellite files",
}
"""Parts of keys that are meaningless to a reader."""
_KEY_FILE = "key.json"
_COMMAND_FILE = "command.json"
_LARGEST_COMMAND = 1_000_000
"""Bytes of a command or a key."""
_BY_HAND = "repeat the command by hand"
JOURNAL = "journal.txt"
"""The file of `optimization.search_log` in the folder."""

_OWN = re.compile(
    rf"{re.escape(_KEY_FILE)}|{re.escape(_COMMAND_FILE)}|{re.escape(JOURNAL)}|[a-z0-9_-]+\.(npz|sha256)|\..*"
)
"""Names of partial work (`.sha256` in earlier versions), and of temporary files and those of file managers (with a
dot)."""

_LOCAL_HEADER = struct.Struct("<26xHH")
"""Header before an array in a zip archive; it ends with the lengths of the name and the extra field that follow."""
_NPY_LENGTH = slice(8, 10)
"""Position of the length of an array's own header, of version 1.0; little-endian."""

_DAMAGED = (OSError, ValueError, zipfile.BadZipFile, NotImplementedError, struct.error)
"""Errors of reading a lost, unreadable or damaged piece; the last three of a bad directory."""

Arrays = dict[str, np.ndarray]


class CheckpointError(Exception):
    """A folder of partial work that belongs to another study, or cannot be written."""


@cache
def code_digest() -> str:
    """SHA-256 of all sources of the package, as they were when it was first asked for: those that run."""
    package = Path(navsim.__file__).parent
    sources = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):  # a piece depends on more than the kernels
        sources.update(f"{source.relative_to(package)}\0".encode() + source.read_bytes())
    return sources.hexdigest()


def code_key() -> dict[str, object]:
    """Part of every key that identifies the code."""
    return {"navsim_version": navsim.__version__, "kernels": digest(), "sources": code_digest()[:16]}


@dataclass(frozen=True, slots=True)
class StoredArray:
    """An array of a piece that this process has found intact, or written.

    start, size: of its bytes in the file. crc: their CRC-32.
    """

    piece: Path
    start: int
    size: int
    crc: int

    def read(self) -> np.ndarray:
        """The array. Raises CheckpointError if it has changed."""
        try:
            with open_regular(self.piece) as file:
                return self.read_from(file)
        except (OSError, ValueError) as error:
            what = f"was damaged or removed while the study ran ({error})"
            raise CheckpointError(f"{self.piece}: {what}; the same command computes it again") from None

    def read_from(self, file: io.BufferedReader) -> np.ndarray:
        """The array, from the open file of the piece. Raises OSError, ValueError if it is damaged."""
        content = np.empty(self.size, np.uint8)
        file.seek(self.start)
        if file.readinto(content.data) != self.size or zlib.crc32(content.data) != self.crc:
            raise ValueError("a checksum does not fit")
        header = io.BytesIO(content.data[: _NPY_LENGTH.stop + int.from_bytes(content.data[_NPY_LENGTH], "little")])
        np.lib.format.read_magic(header)
        shape, _, dtype = np.lib.format.read_array_header_1_0(header)
        return content[header.tell() :].view(dtype).reshape(shape)


class CheckpointStore:
    """The folder of partial work of one study.

    identity: of the study, 32 bytes. redone: pieces that were there and did not count.
    """

    def __init__(self, folder: Path, key: dict[str, Any], fresh: bool) -> None:
        """Open or create the folder. Raises CheckpointError where another study's work lies there."""
        self.folder = folder
        self.redone = 0
        mine = json.dumps(key, sort_keys=True, indent=1)
        self.identity = hashlib.sha256(mine.encode()).digest()
        try:
            if others := _others(folder):
                raise CheckpointError(
                    f"{folder}: partial work is to lie there, but it holds {others[0]!r}, which is not navsim's; move "
                    f"that away, or choose another -o/--output"
                )
            if fresh:
                discard(folder)
            if _has_work(folder):
                _compare(folder, mine, key)
            else:  # at most a key, perhaps incomplete: no work
                folder.mkdir(parents=True, exist_ok=True)
                write_atomically(folder / _KEY_FILE, mine.encode())
            for leftover in folder.glob(".*.tmp"):
                leftover.unlink()
            self._known = {file.name for file in folder.glob("*.npz")}
        except OSError as error:
            raise CheckpointError(f"{folder}: partial work cannot be kept there: {error.strerror or error}") from None

    def note(self, command: Sequence[str]) -> None:
        """Keep the command line by which the study is computed, its words after the program, for `command_of`. Raises
        CheckpointError where the disk does not take it, or the working folder was removed."""
        try:
            told = {"command": list(command), "folder": os.getcwd(), "work": str(self.folder.absolute())}
            write_atomically(self.folder / _COMMAND_FILE, json.dumps(told, indent=1).encode())
        except OSError as error:
            raise CheckpointError(f"{self.folder}: the command cannot be kept: {error.strerror or error}") from None

    def file(self, name: str) -> Path:
        """Path of a piece."""
        path = self.folder / f"{name}.npz"
        assert _OWN.fullmatch(path.name), f"{path.name} would be taken for the file of another program"
        return path

    def find(self, name: str) -> dict[str, StoredArray] | None:
        """Arrays of a piece, after a complete check; None without a valid one."""
        path = self.file(name)
        if path.name not in self._known:
            return None
        try:
            with open_regular(path) as file:
                found = self._found(name, file)
                for kept in found.values():
                    kept.read_from(file)
            return found
        except _DAMAGED:
            self.redone += 1
            return None

    def read(self, name: str) -> Arrays | None:
        """Arrays of a piece in memory; None without a valid one. Raises CheckpointError if it is damaged meanwhile."""
        found = self.find(name)
        return None if found is None else {array: kept.read() for array, kept in found.items()}

    def write(self, name: str, arrays: Arrays) -> dict[str, StoredArray]:
        """Keep a finished piece. Raises CheckpointError where the disk does not take it."""
        path = self.file(name)
        try:
            # a piece that a loss of power cut does not count; waiting for the disk would keep a worker from flying
            with replacing(path, durable=False) as temporary, zipfile.ZipFile(temporary, "w") as archive:
                for member, array in arrays.items():
                    with archive.open(f"{member}.npy", "w", force_zip64=True) as file:
                        _write_array(file, np.asarray(array, order="C"))
                archive.comment = self._checksum(name, archive)
        except OSError as error:
            raise CheckpointError(f"{path}: cannot be written: {error.strerror or error}") from None
        try:
            with open(path, "rb") as written:
                return self._found(name, written)
        except _DAMAGED as error:
            raise CheckpointError(
                f"{path}: was damaged or removed while the study ran ({error}); the same command computes it again"
            ) from None

    def holds_work(self) -> bool:
        """Whether it contains finished work."""
        try:
            return _has_work(self.folder)
        except OSError:  # the content cannot be read now, nor continued
            return False

    def remove(self) -> None:
        """Delete the folder: the result is complete."""
        with contextlib.suppress(OSError):  # remaining files are intact, and only make the same command quicker
            if not _others(self.folder):
                discard(self.folder)

    def remove_if_empty(self) -> None:
        """Delete the folder of a study that failed or was stopped before it finished anything."""
        with contextlib.suppress(OSError):  # a folder that cannot be read is left alone
            if not _has_work(self.folder):
                self.remove()

    def _checksum(self, name: str, archive: zipfile.ZipFile) -> bytes:
        """Comment that an archive must have."""
        members = [(member.filename, member.file_size, member.CRC) for member in archive.infolist()]
        return hashlib.sha256(self.identity + repr((name, members)).encode()).hexdigest().encode()

    def _found(self, name: str, file: io.BufferedReader) -> dict[str, StoredArray]:
        """Arrays of a piece. Raises OSError, ValueError for a wrong comment, and errors of `zipfile` for a bad
        archive."""
        found = {}
        with zipfile.ZipFile(file) as archive:
            if archive.comment != self._checksum(name, archive):
                raise ValueError("the checksum does not fit")
            for member in archive.infolist():
                file.seek(member.header_offset)
                lengths = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
                start = member.header_offset + _LOCAL_HEADER.size + sum(lengths)
                found[member.filename.removesuffix(".npy")] = StoredArray(
                    self.file(name), start, member.file_size, member.CRC
                )
        return found


@dataclass(frozen=True)
class Command:
    """Command that began a study: command line after the program, and its working folder."""

    words: tuple[str, ...]
    folder: Path


def _check_owner(file: Path) -> None:
    """Raise CheckpointError if a folder or file is another user's, who could then decide what this user computes."""
    status = file.stat()
    if status.st_uid not in (0, os.geteuid()):
        raise CheckpointError(f"{file}: belongs to user {status.st_uid}, who could decide what you compute; {_BY_HAND}")
    if status.st_mode & 0o002:
        raise CheckpointError(f"{file}: everybody may write it, and could decide what you compute; {_BY_HAND}")


def command_of(folder: Path) -> Command:
    """Command line of the work in a folder.

    `check_key` and the command's own target tell whether it belongs to this work. Raises CheckpointError if none is
    known, or if it would not continue this work.
    """
    if not folder.is_dir():
        beside = folder.with_name(f"{folder.name}.partial")
        if beside.is_dir():
            raise CheckpointError(f"{folder}: no folder of partial work; its own is {beside}: give that")
        raise CheckpointError(f"{folder}: no folder of partial work, RESULT.h5.partial; a complete result has none")
    file = folder / _COMMAND_FILE
    if not file.exists():
        begun = "it was begun from Python, or by an earlier version"
        what = begun if (folder / _KEY_FILE).exists() else "no partial work of navsim lies there"
        raise CheckpointError(f"{folder}: {what}: there is no {_COMMAND_FILE}, so no command is known")
    try:
        for each in (folder, file):
            _check_owner(each)
        with open_regular(file, _LARGEST_COMMAND) as content:
            told = json.load(content)
        words, place, work = tuple(told["command"]), Path(told["folder"]), Path(told["work"])
        if not words or not all(isinstance(word, str) and word.isprintable() for word in words):
            raise ValueError
        if not place.is_absolute() or not work.is_absolute():
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise CheckpointError(f"{file}: cannot be read or is damaged; {_BY_HAND}") from None
    command = f"in {place}: navsim {shlex.join(words)}"
    if folder.resolve() != work.resolve():
        raise CheckpointError(f"{folder}: was moved there from {work}, where its command would look for it ({command})")
    if not place.is_dir():
        raise CheckpointError(f"{folder}: the folder in which its command was given is gone ({command})")
    return Command(words, place)


@dataclass(frozen=True)
class BegunWork:
    """Remains of an earlier attempt. pieces: finished ones. analyses: lines of the journal of a search."""

    pieces: int
    analyses: int


def earlier_work(folder: Path, key: dict[str, Any]) -> BegunWork | None:
    """Partial work of a study in its folder, which does not change; None without any.

    Pieces are checked when they are used. Raises CheckpointError for another study's work, or if it cannot be read.
    """
    try:
        if not _has_work(folder):
            return None
        _compare(folder, json.dumps(key, sort_keys=True, indent=1), key)
        journal = folder / JOURNAL
        analyses = 0
        if journal.exists():
            with open_regular(journal) as lines:
                analyses = sum(line.endswith(b"\n") for line in lines)
        return BegunWork(sum(1 for _ in folder.glob("*.npz")), analyses)
    except OSError as error:
        raise CheckpointError(f"{folder}: partial work cannot be read there: {error.strerror or error}") from None


def check_key(folder: Path, key: dict[str, Any]) -> None:
    """Raise CheckpointError where the work in a folder is not of the study with this key."""
    _compare(folder, json.dumps(key, sort_keys=True, indent=1), key)


def _has_work(folder: Path) -> bool:
    """Whether something finished lies in a folder of partial work."""
    return any(file.stat().st_size for kind in ("*.npz", JOURNAL) for file in folder.glob(kind))


def _write_array(file: IO[bytes], array: np.ndarray) -> None:
    """`numpy.save` without its copy. Raises ValueError for objects."""
    if array.dtype.hasobject:
        raise ValueError("partial work holds numbers and text, no objects")
    np.lib.format.write_array_header_1_0(file, np.lib.format.header_data_from_array_1_0(array))
    file.write(array.reshape(-1).view(np.uint8).data)


def _others(folder: Path) -> list[str]:
    """Names in a folder that no partial work has, if there is such a folder; without those that file managers and
    network disks put anywhere, which begin with a dot."""
    names = os.listdir(folder) if folder.is_dir() else []
    return [name for name in sorted(names) if not _OWN.fullmatch(name)]


def _compare(folder: Path, mine: str, key: dict[str, Any]) -> None:
    """Raise CheckpointError where the folder's key is not this one."""
    try:
        with open_regular(folder / _KEY_FILE, _LARGEST_COMMAND) as file:
            theirs = file.read().decode()
        if theirs == mine:
            return
        other = json.loads(theirs)
        parts = [
            f"other {_HASHED[k]}" if k in _HASHED else f"{k} {other[k]!r} there, {v!r} here"
            for k, v in key.items()
            if k in other and other[k] != v
        ]
        if other.keys() != key.keys():
            parts.insert(0, "another kind of study, or an earlier version")
        whose = f"partial work of another study lies there ({'; '.join(parts)})"
    except (OSError, ValueError, AttributeError, TypeError):
        whose = f"partial work lies there whose {_KEY_FILE} is missing or damaged"
    raise CheckpointError(f"{folder}: {whose}; --fresh discards it")
