"""Partial work on disk: what a study has finished, so that after a kill the same command goes on from there.

The work of a study lies in the folder `RESULT.partial`. `key.json` says whose it is; every piece is a file of arrays
and beside it a checksum of its content, its name and the study, so a piece that is damaged, of another study or under
another name does not count. Files are written whole, a piece's checksum last; the key comes first, and folders go by
one renaming, so there are no pieces without a key.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import navsim
from navsim.core.jit import digest
from navsim.io.whole import discard, write_whole

_CHECKSUM = ".sha256"
_HASHED = {
    "scenario_sha256": "settings of the scenario",
    "study_sha256": "settings of the study",
    "kernels": "compiled code",
    "sources": "code of navsim",
    "files": "satellite files",
}
"""Parts of keys that tell a reader nothing."""
_KEY_FILE = "key.json"
JOURNAL = "journal.txt"
"""The file of `study.journal` in the folder."""

_OWN = re.compile(rf"{re.escape(_KEY_FILE)}|{re.escape(JOURNAL)}|[a-z0-9-]+(\.npz|{re.escape(_CHECKSUM)})|\..*")
"""Names that partial work has, and those that begin with a dot: temporary files, and what file managers leave."""

Arrays = dict[str, np.ndarray]


class PartialError(Exception):
    """A folder of partial work that belongs to another study, or cannot be written."""


def code_key() -> dict[str, object]:
    """The part of every key that says which code the work was done by."""
    package = Path(navsim.__file__).parent
    sources = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):  # what a piece holds is decided by more than the kernels
        sources.update(f"{source.relative_to(package)}\0".encode() + source.read_bytes())
    return {"navsim_version": navsim.__version__, "kernels": digest(), "sources": sources.hexdigest()[:16]}


class Store:
    """The folder of partial work of one study.

    identity: of the study, 32 bytes. redone: pieces that were there and did not count.
    """

    def __init__(self, folder: Path, key: dict[str, Any], fresh: bool) -> None:
        """Open or create the folder. Raises PartialError where another study's work lies there."""
        self.folder = folder
        self.redone = 0
        mine = json.dumps(key, sort_keys=True, indent=1)
        self.identity = hashlib.sha256(mine.encode()).digest()
        try:
            if others := _others(folder):
                raise PartialError(
                    f"{folder}: partial work is to lie there, but it holds {others[0]!r}, which is not navsim's; move "
                    "that away, or choose another -o/--output"
                )
            if fresh:
                discard(folder)
            if any(file.stat().st_size for kind in (f"*{_CHECKSUM}", JOURNAL) for file in folder.glob(kind)):
                _compare(folder, mine, key)
            else:  # at most a key, perhaps cut: nobody's work
                folder.mkdir(parents=True, exist_ok=True)
                write_whole(folder / _KEY_FILE, mine.encode())
            for leftover in folder.glob(".*.tmp"):
                leftover.unlink()
            self._known = {file.name for file in folder.glob(f"*{_CHECKSUM}")}
        except OSError as error:
            raise PartialError(f"{folder}: partial work cannot be kept there: {error.strerror or error}") from None

    def file(self, name: str) -> Path:
        """Where a piece is kept."""
        return self.folder / f"{name}.npz"

    def read(self, name: str, wanted: Callable[[str], bool] = lambda _: True) -> Arrays | None:
        """The wanted arrays of a piece; None where there is none that counts."""
        path = self.file(name)
        if path.with_suffix(_CHECKSUM).name not in self._known:
            return None
        try:
            content = path.read_bytes()
            if path.with_suffix(_CHECKSUM).read_text() == self._checksum(name, content):
                return _arrays(io.BytesIO(content), wanted)
        except (OSError, UnicodeDecodeError):  # lost or unreadable: as good as damaged
            pass
        self.redone += 1
        return None

    def write(self, name: str, arrays: Arrays) -> Path:
        """Keep a finished piece. Raises PartialError where the disk does not take it."""
        path = self.file(name)
        memory = io.BytesIO()
        np.savez(memory, allow_pickle=False, **arrays)
        content = memory.getbuffer()
        try:
            write_whole(path, content)
            write_whole(path.with_suffix(_CHECKSUM), self._checksum(name, content).encode())
        except OSError as error:
            raise PartialError(
                f"{path}: cannot be written: {error.strerror or error}; what was finished before is kept and the same "
                "command goes on from there"
            ) from None
        return path

    def remove(self) -> None:
        """Delete the folder: the result is complete."""
        with contextlib.suppress(OSError):  # what stays is whole, and the same command would only be quicker
            if not _others(self.folder):
                discard(self.folder)

    def _checksum(self, name: str, content: bytes | memoryview) -> str:
        digest = hashlib.sha256(self.identity)
        digest.update(name.encode() + b"\0")
        digest.update(content)
        return digest.hexdigest()


def _arrays(content: io.BytesIO | Path, wanted: Callable[[str], bool]) -> Arrays:
    with np.load(content, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files if wanted(name)}


def array_of(piece: Path, name: str) -> np.ndarray:
    """One array of a piece that was found whole, or written, by this process. Raises PartialError where it is so no
    more: the file holds a checksum of each array."""
    try:
        return _arrays(piece, lambda member: member == name)[name]
    # the last three: of a header that says there were more, or other, than there is
    except (
        OSError,
        EOFError,
        KeyError,
        ValueError,
        zipfile.BadZipFile,
        zlib.error,
        RuntimeError,
        MemoryError,
    ) as error:
        raise PartialError(
            f"{piece}: was damaged or removed while the study ran ({error}); the same command computes it again"
        ) from None


def _others(folder: Path) -> list[str]:
    """Names in a folder that no partial work has, if there is such a folder; without those that file managers and
    network disks put anywhere, which begin with a dot."""
    names = os.listdir(folder) if folder.is_dir() else []
    return [name for name in sorted(names) if not _OWN.fullmatch(name)]


def _compare(folder: Path, mine: str, key: dict[str, Any]) -> None:
    """Raise PartialError where the folder's key is not this one."""
    try:
        theirs = (folder / _KEY_FILE).read_text()
        if theirs == mine:
            return
        other = json.loads(theirs)
        parts = [
            f"other {_HASHED[k]}" if k in _HASHED else f"{k} {other[k]!r} there, {v!r} here"
            for k, v in key.items()
            if k in other and other[k] != v
        ]
        if other.keys() != key.keys():
            parts.insert(0, "a study of another kind, or of an earlier version")
        whose = f"partial work of another study lies there ({'; '.join(parts)})"
    except (OSError, ValueError, AttributeError, TypeError):
        whose = f"partial work lies there whose {_KEY_FILE} is missing or damaged"
    raise PartialError(f"{folder}: {whose}; --fresh discards it")
