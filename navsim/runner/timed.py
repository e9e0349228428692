"""Estimate the time of a job from a timed block."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navsim.runner.executor import Executor
    from navsim.runner.job import Job

BLOCK_S = 1.0
"""Least duration of the block, s, once the kernels are loaded; pieces that have begun are finished."""


class _Enough(Exception):
    """The block is done."""


class _Stopwatch:
    """Time between the first progress report of a job and one `BLOCK_S` later. clock: seconds, monotonic."""

    def __init__(self, extent: int, clock: Callable[[], float]) -> None:
        self._extent, self._clock = extent, clock
        self._begun = clock()
        self._first: tuple[int, float] | None = None
        self.seconds: float | None = None

    @property
    def used(self) -> float:
        return self._clock() - self._begun

    def __call__(self, finished: int, words: str = "") -> None:
        used = self.used
        if self._first is None:
            if finished:  # up to here kernels were loaded as well
                self._first = finished, used
            return
        before, at = self._first
        if used - at >= BLOCK_S and finished > before:
            self.seconds = at + (used - at) * (self._extent - before) / (finished - before)
            raise _Enough


def seconds_of(job: Job, executor: Executor, clock: Callable[[], float] = time.monotonic) -> float | None:
    """Seconds of a prepared job, from a block that is computed now and discarded; None for work in one piece, or in
    uneven ones.

    Raises errors of the work.
    """
    if job.extent == 1 or not job.even:
        return None
    watch = _Stopwatch(job.extent, clock)
    try:
        job.run(executor, None, watch)
    except _Enough:
        return watch.seconds
    return watch.used  # all of it was no more than a block
