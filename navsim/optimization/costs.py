"""What placements cost, and the front of accuracy against cost.

The front is found by the constraint method [1]: the objective is minimised again and again, each time below a lower
limit of the cost. A placement is on the front if no other one is at least as good and as cheap, and one of both better.

Source: [1] Haimes, Lasdon & Wismer, On a bicriterion formulation of the problems of integrated system identification
and system optimization, IEEE Trans. Systems, Man and Cybernetics 1 (1971).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from navsim.optimization.best_placement import Found, NoPlacement
from navsim.optimization.scenario import Costs, Optimize

HALVINGS = 3
"""Searches that narrow down the least cost that meets requirements; without any one is enough."""


class Permitted(NamedTuple):
    """A polygon in (s, l1) where sources may stand, and what permission costs there for each."""

    area: Any
    cost: float


@dataclass(frozen=True)
class CostModel:
    """Costs of the sources of a study that all have one transmitter power.

    power: what that costs a source. sites: (n, 2 or 3), with an area (0, 2); permission and ground (n,) of each: cost,
    and height under the mast, m. permitted: polygons; without any, permission in an area costs nothing.
    """

    given: Costs
    power: float
    sites: np.ndarray
    permission: np.ndarray
    ground: np.ndarray
    permitted: tuple[Permitted, ...]

    @classmethod
    def of(cls, study: Optimize, power: float, permitted: tuple[Permitted, ...]) -> CostModel | None:
        """The costs of a study; None where it has none."""
        if study.costs is None:
            return None
        sites = np.array([[s.s_m, s.l1_m, study.height_m if s.height_m is None else s.height_m] for s in study.sites])
        sites = sites.reshape(-1, 3)[:, : 3 if study.has_heights else 2]
        permission, ground = (
            np.array([0.0 if value is None else value for value in given])
            for given in ([s.cost for s in study.sites], [s.ground_m for s in study.sites])
        )
        return cls(study.costs, power, sites, permission, ground, permitted)

    def each(self, places: np.ndarray, heights: np.ndarray | float) -> np.ndarray:
        """Cost (n, k) of each source of placements (n, k, c) with antennas at `heights`, m.

        In overlapping polygons the cheapest permission counts, outside of all of them none.
        """
        mast, permission = np.broadcast_to(heights, places.shape[:2]), np.zeros(places.shape[:2])
        nearest = np.full(places.shape[:2], np.inf)
        ground = np.zeros(places.shape[:2])
        for site, cost, height in zip(self.sites, self.permission, self.ground, strict=True):
            distance = ((places - site) ** 2).sum(axis=2)
            here, nearest = distance < nearest, np.minimum(distance, nearest)
            permission, ground = np.where(here, cost, permission), np.where(here, height, ground)
        if self.permitted:
            import shapely

            s, l1 = places[..., 0], places[..., 1]
            inside = [np.where(shapely.contains_xy(area, s, l1), cost, np.inf) for area, cost in self.permitted]
            least = np.min(inside, axis=0)
            permission = permission + np.where(np.isfinite(least), least, 0.0)
        return self.given.each + self.power + permission + self.given.mast_per_metre * np.maximum(mast - ground, 0.0)

    def total(self, places: np.ndarray, heights: np.ndarray | float) -> np.ndarray:
        """Cost (n,) of placements (n, k, c)."""
        return np.asarray(self.each(places, heights).sum(axis=1))

    def least(self, count: int, lowest: float) -> float:
        """No placement of `count` sources costs less. lowest: height of the lowest antenna, m."""
        if len(self.sites):
            own = self.sites[:, 2] if self.sites.shape[1] == 3 else np.full(len(self.sites), lowest)
            return float(np.sort(self.each(self.sites[:, None], own[:, None])[:, 0])[:count].sum())
        permission = min((cost for _, cost in self.permitted), default=0.0)
        each = self.given.each + self.power + permission + self.given.mast_per_metre * max(lowest, 0.0)
        return count * each


@dataclass(frozen=True, order=True)
class Member:
    """A search of a study, and its placement: number of sources, and number of the transmitter power, from 0.

    number: 0 for any cost, else of the searches with a limit of the cost, from 1.
    """

    count: int
    power: int = 0
    number: int = 0
    limit: float = math.inf

    @property
    def suffix(self) -> str:
        """Mark of its steps in the partial work, where the number of sources does not tell them apart."""
        return f"-{self.power}-{self.number}" if self.power or self.number else ""


def cheaper(
    best: Found,
    least: float,
    steps: int,
    halvings: int,
    cost: Callable[[Found], float],
    seek: Callable[[int, float, Found], Found],
) -> Iterator[tuple[int, float, Found]]:
    """Placements below ever lower limits of the cost, each with its number, from 1, and its limit.

    From the best placement down in steps of a share of what it costs above `least`. After the first limit that none
    keeps, or with which none meets the requirements, the gap to the limit before is halved so many times.

    seek: searches with a number, a limit, and the placement before; raises NoPlacement.
    """
    if not best.met:
        return
    dearest = lowest = cost(best)
    step = (dearest - least) / steps
    if step <= 1e-9 * dearest:  # all places cost alike
        return
    failed, number, narrowing = least, 0, False
    while halvings:
        limit = lowest - step
        narrowing = narrowing or limit <= failed
        if narrowing:
            halvings -= 1
            limit = 0.5 * (lowest + failed)
        if lowest - limit <= 1e-3 * step:
            return
        number += 1
        try:
            found = seek(number, limit, best)
        except NoPlacement:
            found = None
        if found is not None and found.met:
            best, lowest = found, cost(found)
            yield number, limit, found
        else:
            failed, narrowing = limit, True


def on_front(cost: np.ndarray, value: np.ndarray, met: np.ndarray) -> np.ndarray:
    """Which placements (n,) bool are on the front: of those that meet the requirements, none is at least as cheap and
    as good, and one of both better."""
    at_least = (cost[:, None] <= cost) & (value[:, None] <= value) & met[:, None]
    better = at_least & ((cost[:, None] < cost) | (value[:, None] < value))
    return np.asarray(met & ~better.any(axis=0))
