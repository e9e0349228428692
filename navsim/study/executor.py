"""Where the work of a study is done."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent import futures
from dataclasses import dataclass


@dataclass(frozen=True)
class Executor:
    """So many workers, and what makes their pool. Threads serve, since the kernels release the GIL; whatever else has
    the interface of `concurrent.futures` does too, where its workers reach the folder of partial work."""

    workers: int
    pool: Callable[[int], futures.Executor] = futures.ThreadPoolExecutor


def threads(workers: int | None = None) -> Executor:
    """Threads of this process; by default as many as it may use cores."""
    if workers is None:
        workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Executor(workers)
