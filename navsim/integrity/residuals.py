"""Snapshot RAIM: the square of the residuals against a threshold, and the levels that it protects.

Source: `docs/theory/integrity.md`, section 2; Brown & Chin (1994), Walter & Enge (1995).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.integrity.solution import MonitoredFix, turned
from navsim.statistics import chi_square

BLIND = 1e-9
"""Smallest redundancy of a range that the others check, and smallest effect of its error on the position beyond
rounding."""


@dataclass(frozen=True)
class ChiSquareTest:
    """The chi-square test of residuals. p_fa: probability of an alarm without a fault, p_md: of none with the bias that
    the levels are of."""

    p_fa: float
    p_md: float

    def threshold(self, degrees: np.ndarray) -> np.ndarray:
        """(e,) largest sum of squares without an alarm; inf without redundancy."""
        return _by_degrees(degrees, lambda n: chi_square.exceeded(self.p_fa, n), np.inf)

    def bias(self, degrees: np.ndarray) -> np.ndarray:
        """The root of the noncentrality that is missed with p_md (e,); inf without redundancy."""
        return _by_degrees(
            degrees,
            lambda n: chi_square.noncentrality(chi_square.exceeded(self.p_fa, n), n, self.p_md) ** 0.5,
            np.inf,
        )


def _by_degrees(degrees: np.ndarray, value: Callable[[int], float], without: float) -> np.ndarray:
    out = np.full(degrees.shape, without)
    for n in np.unique(degrees[degrees > 0]):
        out[degrees == n] = value(int(n))
    return out


@dataclass(frozen=True)
class Monitor:
    """Residual test of solutions, and its protection levels."""

    solution: MonitoredFix
    test: ChiSquareTest

    @cached_property
    def slopes(self) -> np.ndarray:
        """Position error (e, s, 2), horizontal and vertical, per bias in the residuals, for a fault of one range.

        inf for a fault that the residuals do not show, 0 for one that does not affect the position.
        """
        of_fault = self.solution.estimator
        return self._by_residuals(np.hypot(of_fault[:, 0], of_fault[:, 1]), of_fault[:, 2])

    def _by_residuals(self, *moved: np.ndarray) -> np.ndarray:
        """Slopes (e, s, m) of m directions of ranging errors (e, s)."""
        size = np.abs(np.stack(moved, axis=2))
        seen = (self.solution.redundancy > BLIND)[..., None]
        shown = np.sqrt(np.where(seen, self.solution.visibility[..., None], 1.0))
        return np.where(seen, size / shown, np.where(size > BLIND, np.inf, 0.0))

    @property
    def minimal_bias(self) -> np.ndarray:
        """Smallest bias of each range (e, s), m, that is missed with at most p_md.

        inf if the test cannot detect it, nan for unused ranges.
        """
        seen = self.solution.redundancy > BLIND
        shown = np.sqrt(np.where(seen, self.solution.visibility, 1.0))
        bias = self.test.bias(self.solution.degrees)[:, None]
        return np.where(self.solution.used, np.where(seen, bias / shown, np.inf), np.nan)

    @property
    def levels(self) -> np.ndarray:
        """Protection levels (e, 2), m, horizontal and vertical: the largest slope times the bias that is missed with
        p_md; inf where a range is not checked, nan without a fix."""
        return self._reached(self.slopes)

    def along(self, bearing: float) -> np.ndarray:
        """Levels (e, 2) across and along a horizontal direction of a bearing, rad."""
        return self._reached(self._by_residuals(*turned(self.solution.estimator, bearing).swapaxes(0, 1)))

    def _reached(self, slopes: np.ndarray) -> np.ndarray:
        """Levels (e, m) by slopes (e, s, m)."""
        largest = slopes.max(axis=1)
        bias = np.broadcast_to(self.test.bias(self.solution.degrees)[:, None], largest.shape)
        # without a slope there is no error, whatever the bias
        reach = np.multiply(largest, bias, out=np.zeros_like(largest), where=largest > 0.0)
        return np.where(self.solution.solved[:, None], reach, np.nan)

    @property
    def threshold(self) -> np.ndarray:
        """(e,) largest `statistic` without an alarm."""
        return self.test.threshold(self.solution.degrees)

    @property
    def tested(self) -> np.ndarray:
        """(e,) whether there are residuals to test."""
        return self.solution.degrees > 0

    @property
    def size(self) -> int:
        """Approximate memory, bytes."""
        return 3 * self.solution.rows.nbytes

    def statistic(self, residuals: np.ndarray) -> np.ndarray:
        """Sums of squares (e, m) of the residuals of fixes (e, s, m), m."""
        return np.asarray((self.solution.whitened(residuals) ** 2).sum(axis=1))

    def each(self, errors: np.ndarray) -> np.ndarray:
        """Test statistic for a fault of each range (e, s, m), standard normal without one, from ranging errors (e, s,
        m).

        nan without redundancy.
        """
        seen = self.solution.redundancy > BLIND
        size = np.sqrt(np.where(seen, self.solution.visibility, np.nan))
        return np.asarray(self.solution.shown.swapaxes(1, 2) @ self.solution.residuals(errors) / size[..., None])
