"""Open files from outside: regular files only, since devices and pipes may block or never end.

Files of the kernel (/proc) claim to be regular and empty: bytes are counted while they are read. `results` opens
results; `stream` opens the sources of `navsim live`, which may be pipes.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
from pathlib import Path
from typing import Any

_NAMES = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device or terminal"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
MOST_ON_DISK = 10_000_000_000
"""Bytes; larger files are refused before anything is read or summed of them."""
MOST_UNSIZED = 16_000_000
"""Bytes that are read of a file with a stated size of zero."""


class _CountedFile(io.FileIO):
    """A file that gives no more bytes than allowed, and never nothing for now. Its reads raise OSError."""

    def __init__(self, descriptor: int, path: Path, most: int) -> None:
        super().__init__(descriptor, "rb")
        self._path, self._most, self._at = path, most, 0

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        self._at = super().seek(offset, whence)
        return self._at

    def readinto(self, buffer: Any, /) -> int:
        count = super().readinto(buffer)
        if count is None:
            raise OSError(errno.EINVAL, "it has nothing to read for now; a regular file is needed", str(self._path))
        self._at += count
        if self._at > self._most:
            raise _too_large(self._path, self._most)
        return count

    def read(self, size: int | None = -1, /) -> bytes:
        return io.RawIOBase.read(self, -1 if size is None else size) or b""

    def readall(self) -> bytes:
        return io.RawIOBase.readall(self) or b""


def open_regular(path: Path, most: int = MOST_ON_DISK) -> io.BufferedReader:
    """Open a regular file of at most `most` bytes for reading.

    Raises OSError with a message in `strerror`: missing, a folder, not a regular file, too large. Its reads raise it,
    too, for a file that turns out to be larger, or has no data for now.
    """
    # without waiting: opening a named pipe would block until there is a writer
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    about = os.fstat(descriptor)
    problem: OSError | None = None
    if stat.S_ISDIR(about.st_mode):
        problem = IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    elif not stat.S_ISREG(about.st_mode):
        what = next((name for test, name in _NAMES if test(about.st_mode)), "nothing known")
        problem = OSError(errno.EINVAL, f"it is {what}; a regular file is needed", str(path))
    elif about.st_size > most:
        problem = _too_large(path, most)
    if problem is not None:
        os.close(descriptor)
        raise problem
    return io.BufferedReader(_CountedFile(descriptor, path, most if about.st_size else min(most, MOST_UNSIZED)))


def content(path: Path, most: int) -> bytes:
    """The bytes of a regular file, at most `most` of them. Raises OSError as `open_regular`."""
    with open_regular(path, most) as file:
        data = file.read(most + 1)  # files of the kernel have a stated size of zero, but contain data
    if len(data) > most:
        raise _too_large(path, most)
    return data


def checksum(path: Path) -> str:
    """SHA-256 of a regular file. Raises OSError as `open_regular`."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
