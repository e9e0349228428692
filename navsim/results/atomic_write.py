"""Atomic writing of files, with a lock for one process at a time."""

from __future__ import annotations

import contextlib
import datetime
import errno
import fcntl
import os
import re
import shutil
import socket
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path

_GONE = ".gone"
"""Suffix of the name of a folder that is being deleted."""
_TEMPORARY = ".tmp"
"""Suffix of the name of a file that is being written."""
_LONG = 60
"""Largest number of characters of a name in a temporary one."""


class Occupied(Exception):
    """Another process works on the same output."""


def destination(path: Path) -> Path:
    """The file to write for `path`: behind symbolic links, which stay. Raises OSError unless it is a file."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        mode = stat.S_IFREG
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is a pipe, a device or a socket; a file is needed")
    return Path(os.path.realpath(path))


@contextlib.contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Temporary name for a file that replaces `path`, with its mode, once it is complete.

    durable: it is on the disk by then; otherwise a loss of power may truncate it. Raises OSError.
    """
    target = destination(path)
    temporary = target.with_name(f"{_stem(target)}{os.getpid()}{_TEMPORARY}")
    try:
        mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
        if mode is not None:  # the new file has the permissions of the old one
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600))
        yield temporary
        if durable:
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
        if mode is not None:
            with contextlib.suppress(PermissionError):  # some file systems have no modes
                temporary.chmod(mode)
        os.replace(temporary, target)
    finally:
        with contextlib.suppress(OSError):  # it is gone, or its error is being reported
            temporary.unlink(missing_ok=True)


def write_atomically(path: Path, *pieces: bytes | memoryview) -> None:
    """Write a file atomically. Raises OSError."""
    with replacing(path) as temporary, open(temporary, "wb") as file:
        for piece in pieces:
            file.write(piece)


def settle(path: Path) -> None:
    """Have the name of a file, too, on the disk, where the file system can be asked for that."""
    with contextlib.suppress(OSError):  # some file systems cannot; the file itself is intact and on the disk either way
        descriptor = os.open(destination(path).parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _stem(target: Path) -> str:
    """Prefix of temporary files beside a file or folder; a long name is cut, since names have a limit (255 bytes,
    usually)."""
    name = target.name
    if len(name) > _LONG:
        name = f"{name[: _LONG - 9]}-{zlib.crc32(name.encode(errors='surrogateescape')):08x}"
    return f".{name}."


def discard(folder: Path) -> None:
    """Delete a folder, whose name disappears at once: a kill meanwhile leaves nothing that looks like work.

    Raises OSError if it cannot be renamed; files that cannot be deleted afterwards remain.
    """
    if not folder.is_dir():
        return
    gone = folder.with_name(f"{_stem(folder)}{os.getpid()}{_GONE}")
    shutil.rmtree(gone, ignore_errors=True)
    folder.rename(gone)
    shutil.rmtree(gone, ignore_errors=True)


def clean(path: Path, *, owned: bool) -> None:
    """Delete remains of killed processes for `path`, if possible. Raises OSError unless it is a file.

    owned: the caller has `locked` it, so that no other process works on it; otherwise files of running processes stay.
    """
    target = destination(path)
    for process, leftover in _beside(target, _TEMPORARY):
        if owned or _is_dead(process):
            with contextlib.suppress(OSError):  # another user's, or a folder; it does no harm
                leftover.unlink()
    if owned:
        for _, leftover in _beside(partial_folder(path), _GONE):
            shutil.rmtree(leftover, ignore_errors=True)


def partial_folder(target: Path) -> Path:
    """Folder of a result's partial work."""
    return target.with_name(f"{target.name}.partial")


def _beside(path: Path, ending: str) -> list[tuple[int, Path]]:
    """Files of processes beside a file or folder with this suffix, with the process numbers."""
    pattern = re.compile(f"{re.escape(_stem(path))}([0-9]{{1,10}}){re.escape(ending)}")
    try:
        names = os.listdir(path.parent)
    except OSError:  # not there, or not to be read: nothing that could be deleted
        return []
    found = ((pattern.fullmatch(name), path.parent / name) for name in names)
    return [(int(match[1]), there) for match, there in found if match]


def _is_dead(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:
        pass  # another user's
    return False


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Context in which no other process works on `path`. Raises Occupied, with that process; OSError.

    The lock is the kernel's, on a file beside `path`, so it ends with its process.
    """
    target = destination(path)
    lock = target.with_name(f"{_stem(target)}lock")
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(descriptor, 1000).decode(errors="replace").strip()
            os.close(descriptor)
            raise Occupied(f"{path}: {owner or 'another process'} is at work on it") from None
        except OSError:
            os.close(descriptor)
            raise
        if _same(descriptor, lock):
            break
        os.close(descriptor)  # its last owner removed it between open and lock
    try:
        os.ftruncate(descriptor, 0)
        since = datetime.datetime.now(datetime.UTC)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}, since {since:%H:%M:%S} UTC,".encode())
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def _same(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
