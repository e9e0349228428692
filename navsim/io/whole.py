"""Files that are there whole or not at all, and one process at a time that writes them."""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import os
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path

_GONE = ".gone"
"""How the name of a folder ends that is being deleted."""


class Occupied(Exception):
    """Another process works on the same output."""


def write_whole(path: Path, *pieces: bytes | memoryview) -> None:
    """Write a file under a temporary name beside `path`, see it on the disk, rename it. Raises OSError."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            for piece in pieces:
                file.write(piece)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):  # what went wrong before is what is told
            temporary.unlink(missing_ok=True)
        raise


def discard(folder: Path) -> None:
    """Delete a folder, which is gone from its name at once: a kill under way leaves nothing that looks like work.

    Raises OSError where it cannot be renamed; what cannot be deleted after that stays as a leftover.
    """
    if not folder.is_dir():
        return
    gone = folder.with_name(f"{folder.name}.{os.getpid()}{_GONE}")
    shutil.rmtree(gone, ignore_errors=True)
    folder.rename(gone)
    shutil.rmtree(gone, ignore_errors=True)


def clean(path: Path) -> None:
    """Delete what killed processes left of their work on `path`; only its `locked` owner may."""
    for leftover in path.parent.glob(f".{path.name}.*.tmp"):
        leftover.unlink(missing_ok=True)
    for leftover in path.parent.glob(f"{path.name}.partial.*{_GONE}"):
        shutil.rmtree(leftover, ignore_errors=True)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """While it lasts, no other process works on `path`. Raises Occupied, which says who does; OSError.

    The lock is the kernel's, on a file beside `path`, so it ends with its process, however that ends.
    """
    lock = path.with_name(f".{path.name}.lock")
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
        os.close(descriptor)  # its last owner removed it between our opening and our locking
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
