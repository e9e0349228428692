"""Where the work of a study is done."""

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
"""How long a thread may keep the interpreter while another waits for it, s. Between kernels of a millisecond a wait of
Python's usual 5 ms left the processors idle for a fifth of the time."""


class Threads(futures.ThreadPoolExecutor):
    """Threads that hand on the interpreter quickly while they work, and speak as who gave it to them (`words`)."""

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
    """Workers, or what leads them, are gone; what was finished before is kept."""


@dataclass(frozen=True)
class Executor:
    """So many workers, and what makes their pool. Threads serve, since the kernels release the GIL; whatever else has
    the interface of `concurrent.futures` does too, where its workers reach the folder of partial work. name: of another
    place whose pool is `RemoteExecutor`, "" for this machine."""

    workers: int
    pool: Callable[[int], futures.Executor] = Threads
    name: str = ""

    @property
    def away(self) -> bool:
        """Whether the workers have memory and disk of their own."""
        return bool(self.name)


class RemoteExecutor(futures.Executor):
    """A pool whose workers have neither the memory nor the disk of this machine: they come and go, what they need is
    sent, and what they find is kept here. `WorkerLost` is raised where nobody is left to work."""

    @property
    def workers(self) -> int:
        """How many there are now."""
        raise NotImplementedError

    def share(self, what: Any) -> Any:
        """What is sent once, whatever number of tasks is submitted with it: an argument that stands for it."""
        raise NotImplementedError


def threads(workers: int | None = None) -> Executor:
    """Threads of this process; by default as many as it may use cores."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Executor(workers)
