"""What is measured together, and how it is said: ratios of jobs that take turns, and curves with their slopes."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SCENARIO = ROOT / "scenarios" / "landing.yaml"
WORK = ROOT / "results" / "bench"
"""What a run of the benchmarks makes for itself; not kept in git."""
STEPS = 12_000
"""Intervals of the IMU in the reference job: 120 s at 100 Hz."""

Job = Callable[[], float]
"""Something to be measured: does its work and returns what it took, seconds where nothing else is said."""


@dataclass(frozen=True)
class Plan:
    """How much is measured: in full, or so little that everything can be tried in two minutes. before, original: the
    commits of the version before and of the first one."""

    quick: bool
    before: str
    original: str

    def rounds(self, full: int) -> int:
        """How often jobs take turns."""
        return 1 if self.quick else full

    def size(self, full: int, quick: int) -> int:
        """The size of a job."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Line:
    """A line of the table: ratios of rounds, none where there is nothing to measure by; beside: seconds, or why there
    are none; must, aim: limits of their median, from below or from above (at_most)."""

    what: str
    ratios: tuple[float, ...]
    beside: str
    must: float | None = None
    aim: float | None = None
    at_most: bool = False

    @property
    def holds(self) -> bool:
        """Whether the must is kept, or there is none."""
        if self.must is None or not self.ratios:
            return True
        middle = statistics.median(self.ratios)
        return middle <= self.must if self.at_most else middle >= self.must

    def cells(self) -> tuple[str, ...]:
        """The line as it is printed."""
        if self.must is None:
            verdict = ""
        elif not self.ratios:
            verdict = "not measured"
        else:
            verdict = "holds" if self.holds else "**misses**"
        limit = "at most " if self.at_most else ""
        must, aim = (f"{limit}{number(x)}×" if x is not None else "" for x in (self.must, self.aim))
        return self.what, spread(self.ratios, "×"), must, aim, verdict, self.beside


@dataclass(frozen=True)
class Curve:
    """Cost against size: seconds (round) of each size, of one like job after another. share: what the seconds are
    divided by in the table, such as runs, by size."""

    what: str
    unit: str
    seconds: Mapping[float, Sequence[float]]
    per: str = "job"
    share: Mapping[float, float] = field(default_factory=dict)

    def cost(self, size: float) -> list[float]:
        """Seconds of each round for one of what the cost is told of."""
        return [s / self.share.get(size, 1.0) for s in self.seconds[size]]

    def slope(self) -> float:
        """d log cost / d log size, by least squares through the medians: 1 where twice the size costs twice as much."""
        x = [math.log(size) for size in self.seconds]
        y = [math.log(statistics.median(self.cost(size))) for size in self.seconds]
        mean_x, mean_y = statistics.mean(x), statistics.mean(y)
        return sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / sum((a - mean_x) ** 2 for a in x)

    def against_first(self, size: float) -> tuple[float, ...]:
        """The cost of a size against that of the first, round by round."""
        return ratios(self.cost(size), self.cost(next(iter(self.seconds))))


def timed(work: Callable[[], Any]) -> Job:
    """A job that takes as long as its work."""

    def job() -> float:
        start = time.perf_counter()
        work()
        return time.perf_counter() - start

    return job


def alternate(rounds: int, *jobs: Job) -> list[list[float]]:
    """What each job took in each round. They take turns, every other round backwards, so that what else the machine
    does meanwhile meets them all alike."""
    out: list[list[float]] = [[] for _ in jobs]
    for k in range(rounds):
        for i in range(len(jobs))[:: 1 if k % 2 == 0 else -1]:
            out[i].append(jobs[i]())
    return out


def ratios(over: Iterable[float], under: Iterable[float]) -> tuple[float, ...]:
    """Ratios of two jobs, round by round."""
    return tuple(a / b for a, b in zip(over, under, strict=True))


def number(x: float) -> str:
    """Three digits, whole from a hundred on."""
    return f"{x:.0f}" if abs(x) >= 100.0 else f"{x:.3g}"


def spread(values: Sequence[float], unit: str) -> str:
    """Median and range."""
    if not values:
        return "-"
    text = f"{number(statistics.median(values))}{unit}"
    return text if len(values) == 1 else f"{text} ({number(min(values))} to {number(max(values))})"


_UNITS = ((1.0, " s"), (1e-3, " ms"), (1e-6, " µs"), (0.0, " ns"))


def seconds(name: str, values: Sequence[float], of: float = 1.0, per: str = "") -> str:
    """Seconds of a job, or of one part of so many, in words."""
    each = [v / of for v in values]
    size, unit = next(u for u in _UNITS if statistics.median(each) >= u[0])
    return f"{name} {spread([v / (size or 1e-9) for v in each], unit)}{per}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown."""
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)]
