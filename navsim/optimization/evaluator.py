"""Evaluation of placements during a search: by geometry, by levels at some epochs, by coarse and full analysis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import PENALTY_UNSOLVED, Evaluated, PlacementProblem
from navsim.optimization.progress import SearchMonitor

GEOMETRY, LEVELS, COARSE, FULL = "geometry", "levels", "coarse", "full"
"""Types of evaluation of a placement: geometry kernel, levels at some epochs, coarse and full analysis."""
CHOOSING, EVOLVING, SCREENING = "choosing", "searching", "screening by geometry"
LEARNING, DECIDING = "coarse analysis", "full analysis"
"""Names of the steps of a search."""


class PlacementWithRivals(NamedTuple):
    """A placement (k, 2) with its value; others, every: as of `Found`."""

    places: np.ndarray
    value: float
    others: tuple[np.ndarray, ...] = ()
    every: bool = False


def step_name(problem: PlacementProblem, count: int, what: str) -> str:
    """Name of a step of the search for `count` pseudolites."""
    return f"{problem.study.named(count)}, {what}"


class Evaluator:
    """Evaluates placements as `PlacementProblem` does, and reports to a monitor. searching: report the best ones,
    too."""

    def __init__(self, problem: PlacementProblem, watch: SearchMonitor, searching: bool) -> None:
        self._here, self._watch, self._searching = problem, watch, searching

    def at_once(self, places: np.ndarray, judge: ObjectiveFunction | None = None, way: str = GEOMETRY) -> np.ndarray:
        """Values (n,) of placements (n, k, 2) by the objective of geometry or a replacement."""
        with self._watch.trying(way, len(places)):
            values = self._here.value(places) if judge is None else self._here.rough_value(places, judge)
        if judge is None:
            self._offer(places, values)
        return values

    def by(self, judge: ObjectiveFunction, way: str = GEOMETRY) -> ObjectiveFunction:
        """Function that evaluates placements with a replacement of the objective."""
        return lambda places: self.at_once(places, judge, way)

    def coarse(self, places: np.ndarray) -> Evaluated:
        """Placements (n, k, 2) by coarse analysis."""
        return self._one_by_one(places, COARSE)

    def full(self, places: np.ndarray) -> Evaluated:
        """Values by full analysis."""
        return self._one_by_one(places, FULL)

    def _one_by_one(self, places: np.ndarray, fidelity: str) -> Evaluated:
        ahead, out = self._here.ahead, []
        together = 1 if ahead is None else len(places)
        for first in range(0, len(places), together):
            some = places[first : first + together]
            with self._watch.trying(fidelity, len(some)):
                if ahead is not None:
                    ahead(some, fidelity)
                for i in range(len(some)):
                    out.append(self._here.judged(some[i : i + 1], coarse=fidelity == COARSE))
                    self._offer(some[i : i + 1], out[-1].value)
        return Evaluated(*map(np.concatenate, zip(*out, strict=True)))

    def _offer(self, places: np.ndarray, values: np.ndarray) -> None:
        best = int(np.argmin(values))
        if self._searching and values[best] < PENALTY_UNSOLVED:
            self._watch.offer(places[best], float(values[best]))
