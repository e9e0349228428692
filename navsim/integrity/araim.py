"""Protection levels by solution separation: largest effect of each fault that the test against the fix without it
misses.

Source: `docs/theory/integrity.md`, section 3; Blanch et al., IEEE Transactions on Aerospace and Electronic Systems 51
(2015); WG-C ARAIM Technical Subgroup, Reference Airborne Algorithm Description Document v3.0 (2017).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import WIDTH, as_simd, in_lanes, where
from navsim.defect import Defect
from navsim.integrity.solution import MonitoredFix, Noise, solve, turned

EAST, NORTH, UP = 0, 1, 2
_MOST_STEPS = 100
_SMALL = 1e-9
"""A step of a level's solution that is small enough, m."""


@dataclass(frozen=True)
class Fault:
    """Sources that fail together."""

    sources: tuple[int, ...]
    """Indices of their ranges."""
    prior: float
    """Probability."""
    of: tuple[int, ...] = ()
    """Numbers, in the list of faults, of the independent faults that coincide; empty for a single fault."""


MOST_PAIRS = 60
"""Largest number of monitored coincidences of two faults."""


def coincidences(priors: Sequence[float], tolerated: float) -> list[tuple[int, int]]:
    """Pairs of independent faults to monitor, the most probable first.

    The list ends when the remaining coincidences have half of the tolerated probability. The other half is for what
    cannot be monitored.
    """
    pairs = sorted(itertools.combinations(range(len(priors)), 2), key=lambda pair: -priors[pair[0]] * priors[pair[1]])
    there = np.ones((len(priors), 1), bool)
    chosen: list[tuple[int, int]] = []
    while len(chosen) < min(len(pairs), MOST_PAIRS):
        if float(_several_at_once(np.array(priors), there, chosen)[0]) <= 0.5 * tolerated:
            break
        chosen.append(pairs[len(chosen)])
    return chosen


@dataclass(frozen=True)
class Allocation:
    """Probabilities that levels and tests share; defaults of LPV-200."""

    p_hmi_vertical: float = 9.8e-8
    """Probability of hazardous misleading information, vertical; `p_hmi_horizontal` likewise."""
    p_hmi_horizontal: float = 2e-9
    p_fa_vertical: float = 3.9e-6
    """Probability of an alarm without a fault, vertical; `p_fa_horizontal` likewise."""
    p_fa_horizontal: float = 9e-8
    p_unmonitored: float = 8e-8
    """Tolerated probability of unmonitored faults."""
    p_emt: float = 1e-5
    """Smallest prior of a fault that counts for the effective monitor threshold."""
    samples: float = 1.0
    """Effective independent samples of an exposure; they divide the budgets of what each sample risks."""

    @property
    def p_hmi(self) -> np.ndarray:
        """Probability of misleading information at a sample (3,), east, north, up."""
        return np.array([*[0.5 * self.p_hmi_horizontal] * 2, self.p_hmi_vertical]) / self.samples

    @property
    def total(self) -> float:
        """Probability of any misleading information in an exposure, which unmonitored faults take from but once."""
        return self.p_hmi_horizontal + self.p_hmi_vertical


@dataclass(frozen=True)
class SolutionSpread:
    """Fault-free errors of the full solution and of the solutions without each fault; axes east, north, up; m.

    nan without a solution.
    """

    solved: np.ndarray
    """(e,) bool, whether the full solution exists."""
    separate_solved: np.ndarray
    """(k, e) bool, whether the solution without each fault exists."""
    sigma: np.ndarray
    """(e, 3) 1 sigma."""
    separate_sigma: np.ndarray
    """(k, e, 3) 1 sigma."""
    separation_sigma: np.ndarray
    """(k, e, 3) 1 sigma of the differences."""
    bias: np.ndarray
    """(e, 3) largest effect of nominal biases."""
    separate_bias: np.ndarray
    """(k, e, 3) likewise."""


@dataclass(frozen=True)
class Levels:
    """Protection levels by solution separation; axes east, north, up; nan without a level."""

    available: np.ndarray
    """(e,) whether there is a level."""
    unmonitored: np.ndarray
    """(e,) probability of unmonitored faults."""
    monitored: np.ndarray
    """(k, e) monitored faults."""
    threshold: np.ndarray
    """(k, e, 3) largest accepted difference of the solutions with and without a fault, m."""
    level: np.ndarray
    """(e, 3) m."""
    spread: SolutionSpread
    """Spread of the solutions."""
    emt: np.ndarray
    """(e,) effective monitor threshold, m."""

    @property
    def horizontal(self) -> np.ndarray:
        """HPL (e,), m."""
        return np.hypot(self.level[:, EAST], self.level[:, NORTH])

    @property
    def vertical(self) -> np.ndarray:
        """VPL (e,), m."""
        return self.level[:, UP]


@dataclass(frozen=True)
class FixLevels(Levels):
    """Protection levels of fixes."""

    separator: np.ndarray
    """(k, e, 3, s) from ranging errors to differences of the fixes."""
    accuracy: np.ndarray
    """(e, 3) 1 sigma of a fault-free fix, m."""


def levels(
    rows: np.ndarray,
    used: np.ndarray,
    noise: Noise,
    accuracy: Noise,
    nominal: np.ndarray,
    faults: Sequence[Fault],
    allocation: Allocation,
    unlisted: float | None = None,
) -> FixLevels:
    """Protection levels of fixes.

    - `rows` (e, s, u), `used` (e, s): see `solution.solve`.
    - `noise`: bounds the ranging errors; `accuracy`: describes them without faults.
    - `nominal` (e, s): bound of their biases, m.
    - `unlisted`: probability of faults outside `faults`, if it is not that of several of them at once.
    """
    whole = solve(rows, used, noise)
    without = [_without(rows, used, noise, fault) for fault in faults]
    shape = len(faults), used.shape[0]
    separator = np.array([s.estimator - whole.estimator for s in without]).reshape(*shape, 3, used.shape[1])
    spread = SolutionSpread(
        whole.solved,
        np.array([s.solved for s in without], bool).reshape(shape),
        _sigma(whole),
        np.array([_sigma(s) for s in without]).reshape(*shape, 3),
        np.array([np.sqrt(accuracy.variance(one)) for one in separator]).reshape(*shape, 3),
        _bias_effect(whole, nominal),
        np.array([_bias_effect(s, nominal) for s in without]).reshape(*shape, 3),
    )
    found = allocated_risk(spread, used, faults, allocation, unlisted)
    of_fix = np.where(whole.solved[:, None], np.sqrt(accuracy.variance(whole.estimator)), np.nan)
    return FixLevels(**vars(found), separator=separator, accuracy=of_fix)


def allocated_risk(
    spread: SolutionSpread,
    used: np.ndarray,
    faults: Sequence[Fault],
    allocation: Allocation,
    unlisted: float | None = None,
    idle: np.ndarray | None = None,
) -> Levels:
    """Protection levels of solutions that use ranges (e, s), from their spread; other arguments as of `levels`.

    idle (k, e) bool: faults that need not be monitored while half of the tolerated probability has room for them. The
    costliest go first: those with separate sigmas larger by powers of two, of these the least probable.
    """
    priors = np.array([fault.prior for fault in faults])
    touched = np.array([used[:, list(fault.sources)].any(axis=1) for fault in faults], bool)
    touched = touched.reshape(len(faults), len(used))
    for k, fault in enumerate(faults):
        if fault.of:  # where one of them is not there, it is the other alone
            touched[k] = touched[list(fault.of)].all(axis=0)
    monitored = touched & spread.separate_solved
    if unlisted is None:
        alone = [not fault.of for fault in faults]
        listed = [fault.of for fault in faults if fault.of]
        unmonitored = _several_at_once(priors[alone], touched[alone], listed)
    else:
        unmonitored = np.full(used.shape[0], unlisted)
    unmonitored = unmonitored + np.where(touched & ~monitored, priors[:, None], 0.0).sum(axis=0)
    p_hmi, total = allocation.p_hmi, allocation.total
    if idle is not None:
        every, spared = np.arange(len(used)), idle & monitored
        for k in _dearest_first(spread, priors, spared):
            left = spared[k, every]
            left &= unmonitored + priors[k] <= min(allocation.p_unmonitored, 0.5 * total)
            monitored[k, every] &= ~left
            unmonitored = unmonitored + np.where(left, priors[k], 0.0)

    threshold = _factors(allocation, monitored.sum(axis=0)) * spread.separation_sigma
    threshold[~monitored] = np.nan

    share = 1.0 - unmonitored / total
    available = spread.solved & (unmonitored <= allocation.p_unmonitored) & (share > 0.0)
    level = np.full((used.shape[0], 3), np.nan)
    at = np.flatnonzero(available)
    for axis in (EAST, NORTH, UP):
        level[at, axis] = _level(
            p_hmi[axis] * share[at], spread.bias[at, axis], spread.sigma[at, axis],
            np.where(monitored, priors[:, None], 0.0)[:, at], (threshold + spread.separate_bias)[:, at, axis],
            spread.separate_sigma[:, at, axis],
        )  # fmt: skip
    counted = np.where(monitored & (priors[:, None] >= allocation.p_emt), threshold[..., UP], 0.0)
    emt = np.where(spread.solved, counted.max(axis=0, initial=0.0), np.nan)
    return Levels(available, unmonitored, monitored, threshold, level, spread, emt)


def along(
    found: FixLevels,
    whole: MonitoredFix,
    nominal: np.ndarray,
    priors: np.ndarray,
    allocation: Allocation,
    bearing: float,
) -> np.ndarray:
    """Levels (e, 2) of fixes across and along a horizontal direction of a bearing, rad.

    found: levels east and north. whole: the fixes. nominal, priors, allocation: those of `levels`.
    """
    own = turned(whole.estimator, bearing)

    def spread(estimator: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma, and how far nominal biases reach, (e, 2)."""
        return np.sqrt(whole.noise.variance(estimator)), (np.abs(estimator) * nominal[:, None]).sum(axis=2)

    of_solutions = [spread(own), *(spread(own + one) for one in turned(found.separator, bearing))]
    return across(found, of_solutions, priors, allocation, bearing)


def across(
    found: Levels,
    spreads: Sequence[tuple[np.ndarray, np.ndarray]],
    priors: np.ndarray,
    allocation: Allocation,
    bearing: float,
) -> np.ndarray:
    """Levels (e, 2) across and along a horizontal direction, under the tests east and north. Equation (8a).

    Together they use the risk of the levels east and north.

    - `found`: levels east and north; `bearing`: of the direction, rad.
    - `spreads`: 1 sigma along both directions and the largest effect of nominal biases, (e, 2) each, m, of the full
      solution and of those without each fault.
    - `priors`, `allocation`: those of the levels.
    """
    share = np.abs(turned(np.eye(2), bearing))
    between = found.threshold[..., :UP] @ share.T
    at = np.flatnonzero(found.available)
    budget = allocation.p_hmi[EAST] * (1.0 - found.unmonitored[at] / allocation.total)
    counted = np.where(found.monitored, priors[:, None], 0.0)[:, at]
    (sigma, bias), *each = spreads
    shape = len(priors), len(sigma), 2
    separate_sigma = np.array([one for one, _ in each]).reshape(shape)
    reach = between + np.array([one for _, one in each]).reshape(shape)
    level = np.full(shape[1:], np.nan)
    for axis in range(shape[2]):
        level[at, axis] = _level(
            budget, bias[at, axis], sigma[at, axis], counted, reach[:, at, axis], separate_sigma[:, at, axis]
        )
    return level


def _without(rows: np.ndarray, used: np.ndarray, noise: Noise, fault: Fault) -> MonitoredFix:
    left = used.copy()
    left[:, list(fault.sources)] = False
    return solve(rows, left, noise)


def _dearest_first(spread: SolutionSpread, priors: np.ndarray, idle: np.ndarray) -> np.ndarray:
    """Faults (k, e) of each epoch in the order of their omission; see `allocated_risk`."""
    sigma = np.where(idle, spread.separate_sigma.max(axis=2), 1.0)
    return np.lexsort((np.broadcast_to(priors[:, None], sigma.shape), -np.round(np.log2(sigma))), axis=0)


def _several_at_once(priors: np.ndarray, there: np.ndarray, but: Sequence[tuple[int, ...]]) -> np.ndarray:
    """Probability (e,) of more than one of the independent faults (k,) that exist (k, e), except coincidences of `but`
    alone."""
    each = np.where(there, priors[:, None], 0.0)
    odds = each / (1.0 - each)
    listed = odds.sum(axis=0)
    for together in but:
        listed = listed + odds[list(together)].prod(axis=0)
    # 1 - (none + one of them + ...), by logarithms: it is as small as the square of a prior
    return np.asarray(-np.expm1(np.log1p(-each).sum(axis=0) + np.log1p(listed)))


def _sigma(solution: MonitoredFix) -> np.ndarray:
    """1 sigma of position (e, 3); nan without a fix."""
    return np.sqrt(np.diagonal(solution.covariance, axis1=1, axis2=2))


def _bias_effect(solution: MonitoredFix, nominal: np.ndarray) -> np.ndarray:
    """Largest effect of biases of ranges (e, s) on the position (e, 3); nan without a fix."""
    reach = (np.abs(solution.estimator) * nominal[:, None]).sum(axis=2)
    return np.where(solution.solved[:, None], reach, np.nan)


def _factors(allocation: Allocation, monitored: np.ndarray) -> np.ndarray:
    """Largest accepted difference of fixes in sigmas (e, 3), by the number of monitored faults (e,)."""
    from scipy.special import ndtri

    count = np.maximum(monitored, 1)[:, None] * np.array([4.0, 4.0, 2.0])
    p_fa = np.array([*[allocation.p_fa_horizontal] * 2, allocation.p_fa_vertical]) / allocation.samples
    return np.asarray(-ndtri(p_fa / count))


def _level(
    budget: np.ndarray, bias: np.ndarray, sigma: np.ndarray, priors: np.ndarray, reach: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """Solution x of 2 Q((x - bias)/sigma) + sum of priors Q((x - reach)/spread) = budget (e,).

    bias, sigma: (e,). priors, reach, spread: (k, e); faults of prior 0 do not count.
    """
    from scipy.special import ndtr, ndtri

    count = (priors > 0.0).sum(axis=0) + 1.0
    counts = priors > 0.0
    reach, spread = np.where(counts, reach, 0.0), np.where(counts, spread, 1.0)

    def alone(share: np.ndarray) -> np.ndarray:
        """Value at which every term is below this share of the budget, and the largest of them equals it."""
        own = bias - sigma * ndtri(0.5 * budget * share)
        with np.errstate(divide="ignore"):
            chance = np.where(counts, budget * share / priors, 1.0)
        others = np.where(chance < 1.0, reach - spread * ndtri(np.minimum(chance, 1.0 - 1e-16)), -np.inf)
        return np.maximum(own, others.max(axis=0, initial=-np.inf))

    low, high = alone(np.ones_like(budget)), alone(1.0 / count)
    x = low
    for _ in range(_MOST_STEPS):
        a, b = (x - bias) / sigma, (x - reach) / spread
        value = 2.0 * ndtr(-a) + (priors * ndtr(-b)).sum(axis=0)
        slope = 2.0 * np.exp(-0.5 * a * a) / sigma + (priors * np.exp(-0.5 * b * b) / spread).sum(axis=0)
        above = value > budget
        low, high = np.where(above, x, low), np.where(above, high, x)
        # Newton's step of the logarithm; if it leaves the bracket of the root, the middle of the bracket
        step = x + np.log(value / budget) * value / (slope / np.sqrt(2.0 * np.pi))
        nearer = np.where((step > low) & (step < high), step, 0.5 * (low + high))
        if (np.abs(nearer - x) < _SMALL).all():
            return nearer
        x = nearer
    raise Defect(f"a level was not found in {_MOST_STEPS} steps")


@kernel
def _farthest(separator: np.ndarray, residual: Any, out: Any) -> None:
    """Largest size (e,) of separators (k, e, 3, s) times residuals (e, s) of one run, or of lanes."""
    residual, out = as_simd(residual), as_simd(out)
    faults, epochs, axes, sources = separator.shape
    for e in range(epochs):
        farthest = 0.0 * residual[e, 0]
        for k in range(faults):
            for q in range(axes):
                apart = 0.0 * farthest
                for s in range(sources):
                    apart += separator[k, e, q, s] * residual[e, s]
                size = where(apart < 0.0, -apart, apart)
                farthest = where(size > farthest, size, farthest)
        out[e] = farthest


class SeparationDistances:
    """Test of the distance of solutions without the sources of a fault from the full one; found: the levels."""

    found: Levels

    @property
    def levels(self) -> np.ndarray:
        """Protection levels (e, 2), m, horizontal and vertical; nan without."""
        return np.stack([self.found.horizontal, self.found.vertical], axis=1)

    @property
    def tested(self) -> np.ndarray:
        """(e,) whether a fault is monitored."""
        return np.asarray(self.found.monitored.any(axis=0))

    @property
    def threshold(self) -> np.ndarray:
        """(e,) largest `statistic` without an alarm."""
        return np.ones(self.tested.size)


class SeparationMonitor(SeparationDistances):
    """The test of fixes."""

    found: FixLevels

    def __init__(self, found: FixLevels) -> None:
        self.found = found
        there = found.monitored[..., None] & (found.threshold > 0.0)
        # residuals serve instead of errors: the full fix maps residuals to zero
        by_threshold = found.separator / np.where(there, found.threshold, np.inf)[..., None]
        self.separator = np.ascontiguousarray(by_threshold)

    @property
    def size(self) -> int:
        """Approximate memory, bytes."""
        return 3 * self.separator.nbytes

    def statistic(self, residuals: np.ndarray) -> np.ndarray:
        """The largest difference of fixes, by its threshold, of residuals (e, s, WIDTH) of fixes, m."""
        out = np.zeros((residuals.shape[0], WIDTH))
        if residuals.shape[1]:
            left = np.ascontiguousarray(np.where(np.isnan(residuals), 0.0, residuals))
            _farthest(self.separator, in_lanes(left), in_lanes(out))
        return out
