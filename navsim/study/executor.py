"""Where the work of a study is done."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent import futures
from dataclasses import dataclass
from types import TracebackType
from typing import Self

SWITCH = 5e-4
"""How long a thread may keep the interpreter while another waits for it, s. Between kernels of a millisecond a wait of
Python's usual 5 ms left the processors idle for a fifth of the time."""


class Threads(futures.ThreadPoolExecutor):
    """Threads that hand on the interpreter quickly while they work."""

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


@dataclass(frozen=True)
class Executor:
    """So many workers, and what makes their pool. Threads serve, since the kernels release the GIL; whatever else has
    the interface of `concurrent.futures` does too, where its workers reach the folder of partial work."""

    workers: int
    pool: Callable[[int], futures.Executor] = Threads


def threads(workers: int | None = None) -> Executor:
    """Threads of this process; by default as many as it may use cores."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Executor(workers)
