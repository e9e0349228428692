"""Files from outside, opened in one way: regular files alone, since devices and pipes may never end, or never begin.

Results are opened by `results`; what `navsim live` listens to, which may well be a pipe, by `stream`.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
from pathlib import Path

_NAMES = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device or terminal"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
MOST_ON_DISK = 10_000_000_000
"""Bytes; larger files are refused before anything is read or summed of them."""


def opened(path: Path, most: int = MOST_ON_DISK) -> io.BufferedReader:
    """A regular file of at most `most` bytes, open for reading.

    Raises OSError, whose `strerror` says what is wrong: not there, a folder, no regular file, too large.
    """
    # without waiting: a named pipe would keep us until somebody writes to it
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
    return os.fdopen(descriptor, "rb")


def content(path: Path, most: int) -> bytes:
    """The bytes of a regular file, at most `most` of them. Raises OSError as `opened`."""
    with opened(path, most) as file:
        data = file.read(most + 1)  # files of the kernel's say that they have no bytes, and have some
    if len(data) > most:
        raise _too_large(path, most)
    return data


def checksum(path: Path) -> str:
    """SHA-256 of a regular file. Raises OSError as `opened`."""
    with opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"it has more than {most:,} bytes", str(path))
