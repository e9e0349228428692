"""How long a job is said to take, by a block of it that was timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from navsim.runner.executor import Executor, threads
from navsim.runner.job import JobError, Progress
from navsim.runner.timed import BLOCK_S, seconds_of


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Working:
    """A job whose pieces take their time. lasts: seconds of the n-th piece."""

    clock: Clock
    extent: int
    lasts: Callable[[int], float]
    size: int = 1
    done: int = 0
    even: bool = True

    def run(self, executor: Executor, store: object, tell: Progress) -> None:
        assert store is None
        tell(0)
        while self.done < self.extent:
            self.clock.now += self.lasts(self.done)
            self.done = min(self.done + self.size, self.extent)
            tell(self.done)


def told(job: Any) -> float | None:
    return seconds_of(job, threads(1), job.clock)


def test_the_first_piece_loads_kernels_and_is_counted_once() -> None:
    job = Working(Clock(), 1000, lambda done: 0.1 if done else 5.0)
    assert told(job) == pytest.approx(5.0 + 999 * 0.1)
    assert job.done == pytest.approx(1 + BLOCK_S / 0.1, abs=1)


def test_long_pieces_are_finished() -> None:
    job = Working(Clock(), 640, lambda done: 30.0, size=32)
    assert told(job) == pytest.approx(20 * 30.0)
    assert job.done == 64


def test_work_shorter_than_a_block_is_done_to_its_end() -> None:
    job = Working(Clock(), 5, lambda done: 0.1)
    assert told(job) == pytest.approx(0.5)
    assert job.done == 5


def test_what_an_earlier_telling_had_is_not_counted() -> None:
    """Two workers finish at nearly the same time: the second's is no measure."""
    times = iter([1.0, 0.001, 0.999, 0.001, 0.999])
    job = Working(Clock(), 320, lambda done: next(times), size=32)
    assert told(job) == pytest.approx(1.0 + 288 / 64 * 1.0)


@pytest.mark.parametrize(("extent", "even"), [(1, True), (20, False)])
def test_work_in_one_piece_or_in_uneven_ones_is_not_begun(extent: int, even: bool) -> None:
    job = Working(Clock(), extent, lambda done: 1.0, even=even)
    assert told(job) is None
    assert job.done == 0


def test_what_goes_wrong_is_raised() -> None:
    def fail(done: int) -> float:
        raise JobError("no")

    with pytest.raises(JobError):
        told(Working(Clock(), 10, fail))
