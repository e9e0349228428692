"""Steps of a process on the files of a folder; at one step it gets a signal, or the disk is full from then on.

A step is the creating of a file, each half of what is written to one, its going to the disk, a renaming, the making
and removing of files and folders. HDF5 writes by itself only what is too large for memory, and is not seen here.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path
from typing import Any
from unittest.mock import patch

COUNT, KILL, FULL = "count", "SIGKILL", "full"
"""What happens at a step: nothing, a signal (any, by its name), no more space from there on."""
PIECE = "replace *.npz"
"""Steps in which a piece of partial work gets its name, and counts from then on."""

_FREEING = {"fsync", "remove", "rename", "replace", "rmdir", "unlink"}
"""Steps for which a full disk has space."""
_NAMING = {"rename", "replace"}
"""Steps that are known by the name they give."""


class _Steps:
    def __init__(self, folder: Path, what: str, at: int, of: str) -> None:
        self._folder, self._what, self._at, self._of = os.path.realpath(folder), what, at, of
        self._lock = threading.Lock()
        self._descriptors: dict[int, Any] = {}
        self.count = 0

    def inside(self, path: Any) -> bool:
        return os.path.realpath(os.fsdecode(path)).startswith(self._folder + os.sep)

    def step(self, name: str, path: Any) -> None:
        """Count a step that is about to be taken, and do there what was asked for. Raises OSError."""
        if not fnmatch(f"{name} {os.path.basename(os.fsdecode(path))}", self._of):
            return
        with self._lock:
            self.count += 1
            number = self.count
        if self._what == FULL:
            if number >= self._at > 0 and name not in _FREEING:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        elif self._what != COUNT and number == self._at:
            os.kill(os.getpid(), signal.Signals[self._what])

    def opened(self, path: Any, flags: int, *rest: Any, real: Callable[..., int], **named: Any) -> int:
        inside = flags & os.O_CREAT and self.inside(path)
        if inside:
            self.step("create", path)
        descriptor = real(path, flags, *rest, **named)
        if inside:
            self._descriptors[descriptor] = path
        else:
            self._descriptors.pop(descriptor, None)  # the number of a file that was closed
        return descriptor

    def written(self, descriptor: int, data: Any, *, real: Callable[..., int]) -> int:
        if descriptor not in self._descriptors:
            return real(descriptor, data)
        view, path = memoryview(data).cast("B"), self._descriptors[descriptor]
        self.step("write", path)
        done = real(descriptor, view[: len(view) // 2])
        self.step("write", path)
        return done + real(descriptor, view[len(view) // 2 :])

    def file(self, path: Any, mode: str = "r", *rest: Any, real: Callable[..., Any], **named: Any) -> Any:
        if not set(mode) & set("wax+") or isinstance(path, int) or not self.inside(path):
            return real(path, mode, *rest, **named)
        self.step("create", path)
        return _File(real(path, mode, *rest, **named), self, path)

    def named(self, path: Any, *rest: Any, name: str, real: Callable[..., Any], **others: Any) -> Any:
        if isinstance(path, int):
            self.step(name, self._descriptors.get(path, ""))
        elif self.inside(path):
            self.step(name, rest[0] if name in _NAMING else path)
        return real(path, *rest, **others)


class _File:
    """A file whose writing is two steps."""

    def __init__(self, file: Any, steps: _Steps, path: Any) -> None:
        self._file, self._steps, self._path = file, steps, path

    def write(self, data: Any) -> int:
        half = len(data) // 2
        self._steps.step("write", self._path)
        self._file.write(data[:half])
        self._file.flush()
        self._steps.step("write", self._path)
        self._file.write(data[half:])
        return len(data)

    def __enter__(self) -> _File:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._file)


@contextmanager
def watched(folder: Path, what: str = COUNT, at: int = 0, of: str = "*") -> Iterator[Callable[[], int]]:
    """While it lasts, steps on files under `folder` are counted, from 1; gives what tells how many there were.

    what: `COUNT`, `FULL` or a signal's name, at step number `at` (0: never). of: pattern of the steps that count, each
    being its sort and the file's name.
    """
    steps = _Steps(folder, what, at, of)

    def wrapped(function: Callable[..., Any], real: Callable[..., Any], **fixed: Any) -> Callable[..., Any]:
        return lambda *arguments, **named: function(*arguments, real=real, **fixed, **named)

    real_open = builtins.open
    patches = [
        patch.object(builtins, "open", wrapped(steps.file, real_open)),
        patch.object(io, "open", wrapped(steps.file, real_open)),
        patch.object(os, "open", wrapped(steps.opened, os.open)),
        patch.object(os, "write", wrapped(steps.written, os.write)),
        *(
            patch.object(os, name, wrapped(steps.named, getattr(os, name), name=name))
            for name in ("fsync", "mkdir", "posix_fallocate", "remove", "rename", "replace", "rmdir", "unlink")
        ),
    ]
    for one in patches:
        one.start()
    try:
        yield lambda: steps.count
    finally:
        for one in reversed(patches):
            one.stop()
