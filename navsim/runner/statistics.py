"""Statistics of ensembles: root mean squares with confidence intervals, consistency bands.

Sources: [1] Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
section 5.4.2 (NEES and NIS tests). [2] Satterthwaite, Biometrics Bulletin 2 (1946) (effective degrees of
freedom of a sum of squares).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.statistics import chi_square
from navsim.statistics.importance_sampling import LEAST, TWO_SIDED, relative_error

CONFIDENCE = 0.95
_TAIL = 0.5 * (1.0 - CONFIDENCE)


def poisson_exceedance(count: int, expected: float) -> float:
    """Probability of so many or more events of a Poisson distribution with this expectation."""
    from scipy.special import gammainc

    return float(gammainc(count, expected)) if count else 1.0


def rms_interval(mean_squares: np.ndarray) -> np.ndarray:
    """Root mean square over runs and components with its two-sided 95 % interval: value, low, high.

    mean_squares: (run, component) mean square of each error component of one run, averaged within the run. See
    `rms_interval_of_means`.
    """
    return rms_interval_of_means(np.mean(mean_squares, axis=0), mean_squares.shape[0])


def rms_interval_of_means(per_component: np.ndarray, runs: int) -> np.ndarray:
    """`rms_interval` from the means (component,) over so many runs.

    Errors within a run are taken as fully correlated, so only runs and components count as independent. The interval is
    exact for errors that are constant over a run and conservative otherwise. Components of different size share the
    degrees of freedom of [2]. All nan if nothing is defined.
    """
    total = float(np.sum(per_component))
    if not np.isfinite(total):
        return np.full(3, np.nan)
    if total == 0.0:
        return np.zeros(3)
    degrees = runs * total**2 / float(np.sum(per_component**2))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = chi_square.quantile(1.0 - tail, degrees)
    high = chi_square.quantile(tail, degrees)
    return np.sqrt(total * np.array([1.0, degrees / low, degrees / high]))


def share_interval(count: float, runs: float, tail: float = _TAIL) -> np.ndarray:
    """A share of runs, or of an effective number of them, with its two-sided interval (Clopper and Pearson 1934):
    value, low, high. tail: probability beyond each end, 2.5 % by default."""
    from scipy.special import betaincinv

    low = float(betaincinv(count, runs - count + 1, tail)) if count else 0.0
    high = float(betaincinv(count + 1, runs - count, 1.0 - tail)) if count < runs else 1.0
    return np.array([count / runs, low, high])


def percentile_interval(values: np.ndarray, level: float) -> np.ndarray:
    """A percentile over runs with its two-sided 95 % interval, of order statistics: value, low, high.

    values: (run,). level: 0 to 1. Where so few runs have no order statistic beyond the percentile, the interval ends at
    the least or the largest value.
    """
    from scipy.special import bdtrik

    ordered, runs = np.sort(values), values.size
    low, high = (math.ceil(bdtrik(tail, runs, level)) for tail in (_TAIL, 1.0 - _TAIL))
    ends = ordered[np.clip([low - 1, high], 0, runs - 1)]
    return np.array([np.quantile(values, level), *ends])


def weighted_share(
    log_weights: np.ndarray, hits: np.ndarray, most: float, most_else: float
) -> tuple[np.ndarray, float, float]:
    """Probability of a hit, estimated from runs of another density.

    Returns the value with its two-sided 95 % interval (3,), its relative standard error, and the effective number of
    hits (Kish).

    - `log_weights` (run,): logarithm of the density in question over that of the runs. Hits have at most the weight of
      `most`, others that of `most_else`.
    - `hits` (run,): bool.

    The interval is symmetric on the logarithm of the probability, or of its complement if that is smaller. Without a
    hit, or with hits only, it reaches to what so many runs exclude even if all have the largest weight; the relative
    error is nan. A probability below `LEAST` is nan, and its interval reaches from 0 to at least that.
    """
    runs = hits.size
    weights = np.exp(log_weights)
    # hits of small weight do not make the complement rare, even without a complement
    if weights @ hits > max(weights @ ~hits, 0.5 * runs):
        return *_of_the_rest(*_rare_share(log_weights, ~hits, most_else)), _kish(log_weights[hits])
    value, relative = _rare_share(log_weights, hits, most)
    effective = _kish(log_weights[hits]) if hits.any() else 0.0
    if 0.0 <= value[0] < LEAST and effective > 0.0:
        value = np.array([np.nan, 0.0, np.fmax(value[2], LEAST)])
    return value, relative, effective


def _of_the_rest(value: np.ndarray, relative: float) -> tuple[np.ndarray, float]:
    """The complement of a chance with its interval (3,) and relative standard error."""
    error = relative * value[0] / (1.0 - value[0]) if value[0] < 1.0 else np.nan
    return 1.0 - value[[0, 2, 1]], float(error)


def _rare_share(log_weights: np.ndarray, hits: np.ndarray, most: float) -> tuple[np.ndarray, float]:
    """Value and interval (3,) of `weighted_share` for a chance that is not near 1, and its relative standard error."""
    runs = hits.size
    if not hits.any():
        return np.array([0.0, 0.0, min(1.0, most * (1.0 - _TAIL ** (1.0 / runs)))]), np.nan
    largest = float(log_weights[hits].max())
    scaled = np.exp(log_weights[hits] - largest)
    value = min(1.0, float(np.exp(largest) * (scaled.sum() / runs)))
    if runs < 2:
        return np.array([value, np.nan, np.nan]), np.nan
    relative = float(relative_error(scaled.sum(), (scaled**2).sum(), runs))
    reach = np.exp(TWO_SIDED * relative)
    return np.array([value, value / reach, min(1.0, value * reach)]), relative


def _kish(log_weights: np.ndarray) -> float:
    scaled = np.exp(log_weights - log_weights.max())
    return float(scaled.sum() ** 2 / (scaled**2).sum())


def consistency_band(degrees: int, runs: int) -> tuple[float, float]:
    """Two-sided 95 % band of the ensemble mean of a normalised square per degree of freedom [1]."""
    total = degrees * runs
    tail = 0.5 * (1.0 - CONFIDENCE)
    return chi_square.quantile(tail, total) / total, chi_square.quantile(1.0 - tail, total) / total


def ellipsoid_probability(level: float, dimensions: int) -> float:
    """Chance that a Gaussian error lies within its `level`-sigma ellipsoid."""
    return chi_square.probability_below(level**2, dimensions)


def mean_interval(values: np.ndarray) -> np.ndarray:
    """Mean over runs with its two-sided 95 % interval (normal approximation): value, low, high.

    values: (run,). The interval of a single run is not defined.
    """
    from scipy.special import ndtri

    mean = float(np.mean(values))
    if values.size < 2:
        return np.array([mean, np.nan, np.nan])
    reach = float(ndtri(0.5 + 0.5 * CONFIDENCE)) * float(np.std(values, ddof=1)) / np.sqrt(values.size)
    return np.array([mean, mean - reach, mean + reach])
