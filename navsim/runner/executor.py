"""Interfaces of executors: threads of this machine, and remote workers."""

from __future__ import annotations

import contextvars
import os
import sys
from collections.abc import Callable
from concurrent import futures
from dataclasses import dataclass
from types import TracebackType
from typing import Any, ParamSpec, Self, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

SWITCH = 5e-4
"""Longest time for which a thread keeps the interpreter while another waits, s. Between kernels of a millisecond,
Python's default of 5 ms left the processors idle for a fifth of the time."""


class Threads(futures.ThreadPoolExecutor):
    """Threads that release the interpreter quickly, and write messages in the style of their creator (`words`)."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> futures.Future[T]:
        context = contextvars.copy_context()
        return super().submit(lambda: context.run(fn, *args, **kwargs))

    def __enter__(self) -> Self:
        self._usual = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        return super().__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> bool | None:
        try:
            return super().__exit__(kind, error, place)
        finally:
            sys.setswitchinterval(self._usual)


class WorkerLost(Exception):
    """Workers, or their scheduler, are gone; finished work is kept."""


@dataclass(frozen=True)
class Executor:
    """Workers and their pool.

    Threads are enough, since the kernels release the GIL. Any pool with the interface of `concurrent.futures` works if
    its workers can access the folder of partial work.
    """

    workers: int
    """Number of workers."""
    pool: Callable[[int], futures.Executor] = Threads
    """Creates the pool."""
    name: str = ""
    """Place of a `RemoteExecutor`, "" for this machine."""

    @property
    def away(self) -> bool:
        """Whether the workers have memory and disk of their own."""
        return bool(self.name)


class RemoteExecutor(futures.Executor):
    """A pool of remote workers that share neither memory nor disk with this machine.

    They come and go; inputs are sent, and results are kept here. Raises `WorkerLost` if no worker is left.
    """

    @property
    def workers(self) -> int:
        """Present number of workers."""
        raise NotImplementedError

    def share(self, what: Any) -> Any:
        """Send an object once for any number of tasks; returns the argument that replaces it."""
        raise NotImplementedError


def threads(workers: int | None = None) -> Executor:
    """Threads of this process; by default as many as it may use cores."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Executor(workers)
