"""Progress of a search: placements tried, the best so far, time used and remaining, and the time limit."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

_MEMORY = 0.2
"""Weight of the newest batch in the running mean of the cost of an evaluation."""

PREPARING = "preparing"
"""Name of what precedes the first step."""


class TimeUp(Exception):
    """The time limit has passed."""


class ShareUp(TimeUp):
    """The share of the time limit that one search may take has passed."""


@dataclass(frozen=True)
class Step:
    """A part of the remaining work: its name, and the largest number of placements, by type of evaluation."""

    name: str
    most: dict[str, int]


@dataclass(frozen=True)
class SearchProgress:
    """Progress of a search."""

    step: str
    tried: dict[str, int]
    """Placements evaluated so far, by type of evaluation."""
    best: float | None
    """Best value for the present number of pseudolites; None before there is one."""
    places: np.ndarray | None
    """Its sites (k, 2) s and l1 in m."""
    used: float
    remaining: float | None
    """Largest remaining time, s; None while the cost of a later step is unknown."""


class SearchMonitor:
    """Counts and reports placements; raises TimeUp once `time_limit` seconds have passed.

    The time counts from its creation. clock: seconds, monotonic.
    """

    def __init__(
        self,
        tell: Callable[[SearchProgress], None] = lambda _: None,
        time_limit: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.tell, self._limit, self._clock = tell, time_limit, clock
        self._started = clock()
        self._until: float | None = None
        self._cost: dict[str, float] = {}
        self._to_come: list[Step] = []
        self._now = Step("", {})
        self.prepared: float | None = None
        """Time that `PREPARING` took, s; None while it lasts."""
        self._anew = False
        self._before: dict[str, int] = {}
        self.tried: dict[str, int] = {}
        self.best: float | None = None
        self.places: np.ndarray | None = None

    def plan(self, steps: Iterable[Step]) -> None:
        """The steps of the work, in their order."""
        self._to_come = list(steps)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Work on the step of that name; steps planned before it are over."""
        names = [step.name for step in self._to_come]
        planned = self._to_come[names.index(name)]
        self._now = Step(planned.name, dict(planned.most))
        self._to_come = self._to_come[names.index(name) + 1 :]
        self.look()
        yield
        self._now = Step("", {})

    def allot(self, parts: int) -> None:
        """What follows takes one of so many equal parts of the time that is left; `look` then raises ShareUp, once
        there is a placement."""
        used = self._clock() - self._started
        self._until = None if self._limit is None or parts < 2 else used + (self._limit - used) / parts

    def begin(self) -> None:
        """A new number of pseudolites: its best is still to be found."""
        self.best = self.places = None
        self._before = dict(self.tried)

    def tried_since(self) -> dict[str, int]:
        """Placements evaluated for the present number of pseudolites, by type of evaluation."""
        return {fidelity: count - self._before.get(fidelity, 0) for fidelity, count in self.tried.items()}

    def judge_anew(self) -> None:
        """Forget the best value at the next offer, since a stricter evaluation begins."""
        self._anew = True

    def offer(self, places: np.ndarray, value: float) -> None:
        """A placement (k, 2) with its value, which may be the best so far."""
        if self.best is None or self._anew or value < self.best:
            self.best, self.places, self._anew = value, places, False

    @contextmanager
    def trying(self, fidelity: str, count: int) -> Iterator[None]:
        """Count `count` placements of a type of evaluation."""
        self.look()
        begun = self._clock()
        yield
        cost = (self._clock() - begun) / count
        self._cost[fidelity] = (1.0 - _MEMORY) * self._cost.get(fidelity, cost) + _MEMORY * cost
        self.tried[fidelity] = self.tried.get(fidelity, 0) + count
        if fidelity in self._now.most:
            self._now.most[fidelity] = max(self._now.most[fidelity] - count, 0)
        self.look()

    @property
    def doing(self) -> str:
        """Name of the present step."""
        return self._now.name or PREPARING

    def conclude(self, name: str) -> None:
        """Report work that follows a search that its limit has ended."""
        self._limit, self._to_come, self._now = None, [], Step(name, {})
        self.look()

    def look(self) -> None:
        """Report progress. Raises TimeUp, ShareUp."""
        used = self._clock() - self._started
        if self.prepared is None and self._now.name:
            self.prepared = used
        self.tell(SearchProgress(self._now.name, dict(self.tried), self.best, self.places, used, self._remaining(used)))
        if self._limit is not None and used >= self._limit:
            raise TimeUp
        if self._until is not None and used >= self._until and self.places is not None:
            raise ShareUp

    def _remaining(self, used: float) -> float | None:
        left = 0.0
        for step in (self._now, *self._to_come):
            for fidelity, most in step.most.items():
                left += self._cost.get(fidelity, math.inf) * most if most else 0.0
        if self._limit is not None:
            left = min(left, max(self._limit - used, 0.0))
        return left if math.isfinite(left) else None
