"""Control variates: estimates from runs whose first-order error is known.

A control is a number of each run with a known mean that is correlated with the number of interest. The estimate is
corrected by the deviation of the controls from their means in these runs.

- Means: the coefficients are estimated by cross-fitting. Those for a run come from all others, so they are independent
  of the controls that they multiply, and the estimate has no bias.
- Probabilities and percentiles: the control is the same indicator of the first-order error, with coefficient 1. Nothing
  is estimated, so there is no bias. The rest, the runs for which both disagree, is a difference of paired shares.

Derivation: `docs/theory/control-variates.md`.

Sources:

- [1] Glasserman, Monte Carlo Methods in Financial Engineering (2003), section 4.1 (control variates).
- [2] Avramidis & Wilson, Operations Research Letters 14 (1993) (splitting, for estimates without bias).
- [3] Peherstorfer, Willcox & Gunzburger, SIAM Review 60 (2018) (multi-fidelity Monte Carlo).
- [4] Tango, Statistics in Medicine 17 (1998) (interval of a difference of paired shares).
- [5] Hesterberg & Nelson, Management Science 44 (1998) (probabilities and quantiles).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from navsim.runner.statistics import percentile_interval, share_interval
from navsim.statistics.importance_sampling import TWO_SIDED

LEAST_RUNS = 64
"""Fewest runs with which a controlled estimate is made."""
_OFF = 8.0
"""Largest deviation of the mean of a control from the exact one, in standard errors, before the control is not used."""
_STEPS = 44
"""Halvings of an interval in the search of its ends: down to rounding."""


class Controlled(NamedTuple):
    """A controlled estimate. value: (3,) with its 95 % interval; gain: how many times as many runs would be as precise
    without the control; nan where there is none. For means (and RMS) that is the ratio of the variances by the scatter
    of these runs, for shares and percentiles the squared ratio of the intervals' widths."""

    value: np.ndarray
    gain: float

    @property
    def helps(self) -> bool:
        """Whether it is better than the plain estimate."""
        return self.gain > 1.0

    @property
    def correlation(self) -> float:
        """Correlation of the number of interest with its controls."""
        return math.sqrt(max(0.0, 1.0 - 1.0 / self.gain)) if self.gain > 0.0 else math.nan

    def root(self) -> Controlled:
        """That of the root of a mean square. Its interval is symmetric on the logarithm: mean squares of few runs are
        skew. nan where the estimate of the mean square is not positive."""
        square, _, high = self.value
        if not square > 0.0:
            return NONE
        reach = math.exp(0.5 * (high - square) / square)
        return Controlled(math.sqrt(square) * np.array([1.0, 1.0 / reach, reach]), self.gain)

    def with_runs(self, runs: int, more: int) -> np.ndarray:
        """The interval (3,) that so many runs would give, if they were like these."""
        value = self.value[0]
        return value + (self.value - value) * math.sqrt(runs / more)


NONE = Controlled(np.full(3, np.nan), math.nan)
"""Estimate of a quantity without a control."""


def mean(values: np.ndarray, controls: np.ndarray, exact: np.ndarray) -> Controlled:
    """Estimate a mean without bias, by cross-fitted coefficients.

    Parameters
    ----------
    values : array (run,)
    controls : array (run, k) of the same runs
    exact : array (k,), means of the controls
    """
    from scipy.special import stdtrit

    runs, count = controls.shape
    if runs < LEAST_RUNS or not np.isfinite(values).all() or not _agrees(controls, exact):
        return NONE
    off = controls - exact
    scale = np.sqrt(np.mean(off**2, axis=0))
    off = off[:, scale > 0.0] / scale[scale > 0.0]
    design = np.concatenate([np.ones((runs, 1)), off], axis=1)
    inverse = np.linalg.pinv(design.T @ design)
    by_value = design @ inverse
    fit = by_value.T @ values
    # what is left of each run by the coefficients of all others, which multiply its controls
    left = (values - design @ fit) / (1.0 - np.sum(by_value * design, axis=1))
    middle = float(np.mean(values - np.sum(off * (fit[1:] - by_value[:, 1:] * left[:, None]), axis=1)))
    variance = float(np.sum((by_value[:, 0] * left) ** 2))
    reach = float(-stdtrit(runs - 1 - count, 0.025)) * math.sqrt(variance)
    plain = float(values.var(ddof=1)) / runs
    gain = plain / variance if variance > 0.0 else math.inf if plain > 0.0 else math.nan
    return Controlled(np.array([middle, middle - reach, middle + reach]), gain)


def _agrees(controls: np.ndarray, exact: np.ndarray) -> bool:
    """Whether the means of controls (run, k) agree with the exact ones (k,)."""
    if not (np.isfinite(controls).all() and np.isfinite(exact).all()):
        return False
    error = controls.std(axis=0, ddof=1) / math.sqrt(len(controls))
    return bool((np.abs(controls.mean(axis=0) - exact) <= _OFF * error).all())


def share(hits: np.ndarray, expected: np.ndarray, exact: float) -> Controlled:
    """Estimate the probability of a hit.

    Parameters
    ----------
    hits : array (run,), bool
    expected : array (run,), bool, hits of the first-order errors
    exact : probability of those
    """
    runs = hits.size
    if runs < LEAST_RUNS or not math.isfinite(exact) or _is_off(int(expected.sum()), runs, exact):
        return NONE
    pair = int((hits & ~expected).sum()), int((expected & ~hits).sum())
    middle = (pair[0] - pair[1]) / runs
    ends = [_end(lambda difference: _score(*pair, runs, difference), middle, far) for far in (-1.0, 1.0)]
    value = np.clip(exact + np.array([middle, *ends]), 0.0, 1.0)
    return Controlled(value, _gain(share_interval(int(hits.sum()), runs), value))


def percentile(sizes: np.ndarray, expected: np.ndarray, level: float, below: Callable[[float], float]) -> Controlled:
    """Estimate a percentile of sizes: where the controlled probability of smaller ones is the level, 0 to 1. Its
    interval has the sizes at which that probability may be the level.

    Parameters
    ----------
    sizes : array (run,), not negative
    expected : array (run,), of the first-order errors
    level : of the percentile, 0 to 1
    below : the exact probability of a smaller first-order size
    """
    runs, most = sizes.size, float(max(sizes.max(), expected.max()))
    if runs < LEAST_RUNS or not math.isfinite(most) or not math.isfinite(below(most)):
        return NONE
    at = float(np.quantile(expected, level))
    if _is_off(int((expected <= at).sum()), runs, below(at)):
        return NONE
    smaller, larger = sizes < expected, sizes > expected
    begin = [np.sort(part) for part in (sizes[smaller], expected[larger])]
    end = [np.sort(part) for part in (expected[smaller], sizes[larger])]

    def score(size: float) -> float:
        """Standard errors by which the probability of sizes below this one is above the level."""
        pair = [int(np.searchsorted(b, size, side="right") - np.searchsorted(e, size, side="right"))
                for b, e in zip(begin, end, strict=True)]  # fmt: skip
        return _score(pair[0], pair[1], runs, level - below(size))

    low, high = 0.0, 2.0 * most
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if score(middle) < 0.0 else (low, middle)
    value = np.array([high, *(_end(score, high, far) for far in (0.0, 2.0 * most))])
    return Controlled(value, _gain(percentile_interval(sizes, level), value))


def _is_off(count: int, runs: int, exact: float) -> bool:
    """Whether so many hits of the control cannot be by its exact probability."""
    error = math.sqrt(max(exact * (1.0 - exact), 0.0) / runs)
    return abs(count / runs - exact) > _OFF * error + 1.0 / runs


def _gain(plain: np.ndarray, value: np.ndarray) -> float:
    """Factor on the number of runs that would make an interval (3,) as narrow as another."""
    return float(((plain[2] - plain[1]) / (value[2] - value[1])) ** 2)


def _score(more: int, less: int, runs: int, difference: float) -> float:
    """Standard errors by which the paired shares of the runs, `more` and `less` of them, are further apart than by this
    difference [4]."""
    b = -more - less + (2.0 * runs - more + less) * difference
    c = -less * difference * (1.0 - difference)
    q = (math.sqrt(max(0.0, b * b - 8.0 * runs * c)) - b) / (4.0 * runs)
    variance = runs * (2.0 * q + difference * (1.0 - difference))
    distance = more - less - runs * difference
    return distance / math.sqrt(variance) if variance > 0.0 else math.copysign(math.inf, distance) if distance else 0.0


def _end(score: Callable[[float], float], middle: float, far: float) -> float:
    """The end of an interval between its middle and what is far beyond it: as far as the score is believed."""
    near = middle
    for _ in range(_STEPS):
        at = 0.5 * (near + far)
        near, far = (at, far) if abs(score(at)) <= TWO_SIDED else (near, at)
    return near
