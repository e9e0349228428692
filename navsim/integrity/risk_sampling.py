"""Integrity risk by importance sampling: a position error beyond a limit without an alarm, too rare to count.

Source: `docs/theory/integrity.md`, section 4. Whitened ranging errors z ~ N(0, I) are drawn and shifted to the event:
the estimate to its limit, and the residuals back to where the tests miss them. Weights correct for the shift. Some
samples are not shifted, so that no weight is large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from navsim.integrity.araim import FixLevels
from navsim.integrity.residuals import Monitor
from navsim.integrity.solution import Independent, MonitoredFix
from navsim.statistics import chi_square, normal

NOT_SHIFTED = 0.1
"""Share of the draws that are not moved; no weight is above one over it."""
_AT_ONCE = 50_000
"""Draws that are made together."""
_PLACES = 400
"""Sizes of a bias among which the worst is sought first."""
_FARTHEST = 12.0
"""Sigmas beyond limit and threshold in which it is sought."""


class FixTest(Protocol):
    """A test of the whitened errors of ranges."""

    def silent(self, errors: np.ndarray) -> np.ndarray:
        """(m,) bool, whether errors (n, m) cause no alarm."""

    def largest_undetected(self, direction: np.ndarray) -> float:
        """Largest size of errors along a direction (n,) of size 1 without an alarm."""

    def missed_probability(self, size: float, direction: np.ndarray) -> float:
        """The chance of no alarm, or more, with a bias of this size along a direction of the residuals (n,)."""


@dataclass(frozen=True)
class SquareTest:
    """The sum of the residuals' squares against a threshold. residual: (n, n) makes residuals of errors, degrees: of
    freedom."""

    residual: np.ndarray
    threshold: float
    degrees: int

    def silent(self, errors: np.ndarray) -> np.ndarray:
        """See `FixTest`."""
        return np.asarray(((self.residual @ errors) ** 2).sum(axis=0) <= self.threshold)

    def largest_undetected(self, direction: np.ndarray) -> float:
        """See `FixTest`."""
        return math.sqrt(self.threshold)

    def missed_probability(self, size: float, direction: np.ndarray) -> float:
        """See `FixTest`; exact."""
        return chi_square.probability_below(self.threshold, self.degrees, size * size)


@dataclass(frozen=True)
class SeparationTest:
    """Differences of fixes against their thresholds. separators: (t, n) make differences, by their thresholds, of
    errors."""

    separators: np.ndarray

    def silent(self, errors: np.ndarray) -> np.ndarray:
        """See `FixTest`."""
        return np.asarray((np.abs(self.separators @ errors) <= 1.0).all(axis=0))

    def largest_undetected(self, direction: np.ndarray) -> float:
        """See `FixTest`."""
        return 1.0 / max(float(np.abs(self.separators @ direction).max(initial=0.0)), 1e-12)

    def missed_probability(self, size: float, direction: np.ndarray) -> float:
        """See `FixTest`; only for the difference that shows the bias best."""
        steepest = self.separators[np.argmax(np.abs(self.separators @ direction))]
        spread = float(np.linalg.norm(steepest))
        moved = float(np.abs(steepest @ direction)) * size
        return 1.0 - float(normal.exceedance(np.array(1.0), moved, spread))


@dataclass(frozen=True)
class TailCase:
    """A fix of an epoch, in terms of the whitened errors of its n ranges."""

    estimate: np.ndarray
    """(n,) effect on the position along an axis, m."""
    residual: np.ndarray
    """(n, n) matrix from errors to residuals."""
    unwhitened: np.ndarray
    """(n,) their 1 sigma, m."""
    test: FixTest
    """Test of the fix."""
    used: np.ndarray
    """(n,) numbers of the ranges."""

    @property
    def sigma(self) -> float:
        """1 sigma of the position along the axis, m."""
        return float(np.linalg.norm(self.estimate))

    def biases(self, of_ranges: np.ndarray) -> np.ndarray:
        """Whitened biases (n,) of biases of all ranges (s,), m."""
        return np.asarray(of_ranges[self.used] / self.unwhitened)

    def least_visible_bias(self, sources: np.ndarray) -> np.ndarray:
        """Bias of ranges (s,) bool, whitened and of size 1 (n,), with the largest position effect relative to the
        residuals.

        0 if they do not affect the position.
        """
        among = sources[self.used]
        shown = self.residual[:, among]
        # an invisible direction would be unlimited: the least eigenvalue replaces it
        strength, axes = np.linalg.eigh(shown.T @ shown)
        inverse = axes / np.maximum(strength, 1e-12) @ axes.T
        found = np.zeros(self.used.size)
        found[among] = inverse @ self.estimate[among]
        size = float(np.linalg.norm(found))
        return found / size if size else found


def under_squares(monitor: Monitor, epoch: int, axis: int) -> TailCase:
    """The fix of an epoch under the test of its residuals, which are of independent ranges; axis: east, north, up."""
    threshold, degrees = float(monitor.threshold[epoch]), int(monitor.solution.degrees[epoch])
    estimate, residual, sigma, used = _whitened(monitor.solution, epoch, axis)
    return TailCase(estimate, residual, sigma, SquareTest(residual, threshold, degrees), used)


def under_separations(fix: MonitoredFix, found: FixLevels, epoch: int, axis: int) -> TailCase:
    """The fix of an epoch under the test of its separations `found`; axis: east, north, up."""
    estimate, residual, sigma, used = _whitened(fix, epoch, axis)
    seen = found.monitored[:, epoch]
    separators = found.separator[seen, epoch][..., used] * sigma / found.threshold[seen, epoch][..., None]
    is_tested = np.isfinite(separators).all(axis=2) & (found.threshold[seen, epoch] > 0.0)
    return TailCase(estimate, residual, sigma, SeparationTest(separators[is_tested]), used)


def _whitened(fix: MonitoredFix, epoch: int, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Effects of the range errors of an epoch, their 1 sigma, and numbers of the ranges.

    Raises ValueError for correlated ranges.
    """
    if not isinstance(fix.noise, Independent):
        raise ValueError("tails are sampled of independent ranges alone")
    used = np.flatnonzero(fix.used[epoch])
    sigma, rows = fix.noise.sigma[epoch, used], fix.rows[epoch, used]
    residual = np.eye(used.size) - rows @ fix.cofactor[epoch] @ rows.T
    return fix.estimator[epoch, axis, used] * sigma, residual, sigma, used


@dataclass(frozen=True)
class TailDraws:
    """log_weights: (m,) of draws, hits: (m,) bool, which of them are off by more than the limit, and silent."""

    log_weights: np.ndarray
    hits: np.ndarray

    @property
    def probability(self) -> float:
        """Probability of the event."""
        return float(np.exp(self.log_weights) @ self.hits) / self.hits.size

    @property
    def error(self) -> float:
        """Its standard error."""
        values = np.exp(self.log_weights) * self.hits
        return float(values.std(ddof=1)) / math.sqrt(values.size)

    @property
    def effective(self) -> float:
        """Effective number of hits of equal weight."""
        weights = np.exp(self.log_weights[self.hits])
        return float(weights.sum() ** 2 / (weights @ weights)) if weights.size else 0.0


def proposal_shifts(case: TailCase, bias: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Shifts of the samples (c, n) and their shares (c,).

    Shifts bring the estimate to either limit, including its bias, and the residuals, along those of the bias, to the
    edge of the test. The last share is not shifted.
    """
    sigma = case.sigma
    off = float(case.estimate @ bias)
    along = case.estimate / sigma
    seen = case.residual @ bias
    size = float(np.linalg.norm(seen))
    back = np.zeros_like(bias)
    if size > 0.0:
        direction = seen / size
        back = -max(0.0, size - case.test.largest_undetected(direction)) * direction
    far = np.array([(limit - off) / sigma, (limit + off) / sigma])
    sides = np.array([1.0, -1.0])[:, None] * np.maximum(far, 0.0)[:, None] * along + back
    tails = -0.5 * np.maximum(far, 0.0) ** 2
    likely = np.exp(tails - tails.max())
    return np.vstack([sides, np.zeros_like(bias)]), np.append((1.0 - NOT_SHIFTED) * likely / likely.sum(), NOT_SHIFTED)


def sampled(case: TailCase, bias: np.ndarray, limit: float, count: int, rng: np.random.Generator) -> TailDraws:
    """Draws of fixes whose ranges have these whitened biases (n,); limit: of the error along the axis, m."""
    places, shares = proposal_shifts(case, bias, limit)
    squares = 0.5 * (places**2).sum(axis=1)
    weights, hits = np.empty(count), np.empty(count, bool)
    for first in range(0, count, _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, count))
        which = rng.choice(shares.size, part.stop - first, p=shares)
        z = rng.standard_normal((bias.size, which.size)) + places[which].T
        exponents = places @ z - squares[:, None]
        most = exponents.max(axis=0)
        weights[part] = -(most + np.log(shares @ np.exp(exponents - most)))
        errors = z + bias[:, None]
        hits[part] = (np.abs(case.estimate @ errors) > limit) & case.test.silent(errors)
    return TailDraws(weights, hits)


def worst_size(case: TailCase, direction: np.ndarray, nominal: np.ndarray, limit: float) -> float:
    """Size of a bias along a direction (n,), beside nominal ones (n,), with the largest integrity risk.

    From `FixTest.missed_probability`, which is a bound for several simultaneous tests.
    """
    moved, shown = float(case.estimate @ direction), float(np.linalg.norm(case.residual @ direction))
    if moved == 0.0 or shown < 1e-9:
        return 0.0
    along = case.residual @ direction / shown
    off, sigma = float(case.estimate @ nominal), case.sigma
    before = float(along @ (case.residual @ nominal))

    def risk(size: float) -> float:
        beyond = float(normal.exceedance(np.array(limit), off + moved * size, sigma))
        return beyond * case.test.missed_probability(abs(before + shown * size), along)

    most = min((limit + abs(off)) / abs(moved) + _FARTHEST * sigma / abs(moved),
               (case.test.largest_undetected(along) + abs(before) + _FARTHEST) / shown)  # fmt: skip
    sizes = np.linspace(0.0, most, _PLACES + 1)
    around = sizes[int(np.argmax([risk(size) for size in sizes]))]
    finer = around + np.linspace(-1.0, 1.0, 41) * sizes[1]
    return float(max(finer[finer >= 0.0], key=risk))
