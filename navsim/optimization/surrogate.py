"""Surrogate of an expensive objective, fitted to the placements that were evaluated.

Source: [1] Jones, Schonlau & Welch, Efficient global optimization of expensive black-box functions, J. Global
Optimization 13 (1998).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import PENALTY_CONSTRAINT, PENALTY_UNSOLVED, Evaluated, PlacementProblem, penalised

if TYPE_CHECKING:
    from navsim.optimization.evaluator import Evaluator

_INITIAL_SAMPLES = 40
"""Placements the surrogate learns from at least."""
_HEAVY = 30.0
"""Loads beyond are taken for this: how far beyond does not lead on."""


class Surrogate:
    """Surrogate of a filter error from coarse analyses.

    Its logarithm is a linear function of features, with a Gaussian process for the rest [1].
    """

    _RIDGE = 0.01
    _LENGTH = 4.0
    """Distance over which the rest is alike, in standard deviations of the features."""
    _NUGGET = 1e-2
    """Variance that the features do not explain, as a fraction of that of the rest."""

    def __init__(self, features: np.ndarray, values: np.ndarray) -> None:
        self._middle, spread = features.mean(axis=0), features.std(axis=0)
        self._spread = np.where(spread > 0.0, spread, 1.0)
        self._known = (features - self._middle) / self._spread
        y = np.log(values)
        self._mean = y.mean()
        n = self._known.shape[1]
        self._slope = np.linalg.solve(
            self._known.T @ self._known + self._RIDGE * len(y) * np.eye(n), self._known.T @ (y - self._mean)
        )
        rest = y - self._mean - self._known @ self._slope
        self._scale = rest.std()
        self._inverse = np.linalg.inv(self._alike(self._known) + self._NUGGET * np.eye(len(y)))
        self._weights = self._inverse @ rest

    def __call__(self, features: np.ndarray, hope: float) -> np.ndarray:
        """Expected errors (n,) of placements with features (n, f), minus `hope` standard deviations of their
        uncertainty."""
        x = (features - self._middle) / self._spread
        alike = self._alike(x)
        unknown = np.maximum(1.0 - np.einsum("ij,ij->i", alike @ self._inverse, alike), 0.0)
        return np.exp(self._mean + x @ self._slope + alike @ self._weights - hope * self._scale * np.sqrt(unknown))

    def _alike(self, x: np.ndarray) -> np.ndarray:
        square = np.sum((x[:, None] - self._known[None]) ** 2, axis=2)
        return np.exp(-0.5 * square / self._LENGTH**2)


class SurrogateFit:
    """Placements analysed so far and the surrogate they make."""

    def __init__(self, problem: PlacementProblem, trials: Evaluator) -> None:
        self._here, self._trials = problem, trials
        self.places: list[np.ndarray] = []
        self._found: list[Evaluated] = []
        self.most = 1.0
        """Largest coarse load, such that the full analysis finds a load of at most 1."""

    def analyse(self, places: Iterable[np.ndarray]) -> None:
        """Coarse analyses of placements (k, 2)."""
        if some := list(places):
            found = self._trials.coarse(np.array(some))
            self.places += some
            self._found += [Evaluated(*(column[i : i + 1] for column in found)) for i in range(len(some))]

    def _column(self, name: str) -> np.ndarray:
        return np.array([getattr(one, name)[0] for one in self._found])

    @property
    def loads(self) -> np.ndarray:
        """Loads of the placements (n,)."""
        return self._column("load")

    @property
    def values(self) -> np.ndarray:
        """Minimised values (n,), with `most`."""
        values = self._column("value")
        return np.where(
            values < PENALTY_CONSTRAINT, penalised(self._column("objective"), self.loads, self.most), values
        )

    def surrogate(self, hope: float, around: np.ndarray | None = None) -> ObjectiveFunction:
        """Surrogate from the better half of the feasible placements, or from those nearest to a placement."""
        features, values = self._here.features, self.values
        assert features is not None
        order = np.argsort(values, kind="stable")
        order = order[values[order] < PENALTY_UNSOLVED]
        if around is not None:
            gaps = [largest_shift(self.places[i], around) for i in order]
            order = order[np.argsort(gaps, kind="stable")]
        known = order[: max(_INITIAL_SAMPLES, order.size // 2)]
        taught = features(np.array(self.places)[known])
        objective = Surrogate(taught, self._column("objective")[known])
        if self._here.requirements is None:
            return lambda places: objective(features(places), hope)
        load, most = Surrogate(taught, np.minimum(self.loads[known], _HEAVY)), self.most

        def expected(places: np.ndarray) -> np.ndarray:
            described = features(places)
            return penalised(objective(described, hope), load(described, hope), most)

        return expected

    @property
    def solved(self) -> int:
        """Placements with a value."""
        return int(np.sum(self.values < PENALTY_UNSOLVED))

    def load_of(self, places: np.ndarray) -> float:
        """The load found of one of the placements."""
        return float(self.loads[next(i for i, one in enumerate(self.places) if one is places)])

    def ranked(self) -> list[np.ndarray]:
        """Placements, the best first."""
        return [self.places[i] for i in np.argsort(self.values, kind="stable")]

    def spaced(self, number: int, gap: float) -> list[np.ndarray]:
        """The best placement and the next best ones more than `gap` metres away from the better, up to a number."""
        out: list[np.ndarray] = []
        for places in self.ranked():
            if all(largest_shift(places, other) > gap for other in out):
                out.append(places)
                if len(out) == number:
                    break
        return out

    def new(self, candidates: Iterable[np.ndarray], number: int, gap: float) -> list[np.ndarray]:
        """The first `number` of the candidates that are `gap` metres away from each other and from all analysed."""
        out: list[np.ndarray] = []
        for candidate in candidates:
            if all(largest_shift(candidate, other) > gap for other in (*self.places, *out)):
                out.append(candidate)
                if len(out) == number:
                    break
        return out


def largest_shift(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance that a pseudolite moves between two placements (k, 2), with the best assignment, m."""
    from scipy.optimize import linear_sum_assignment

    gap = np.linalg.norm(a[:, None] - b[None], axis=2)
    return float(gap[linear_sum_assignment(gap)].max())
