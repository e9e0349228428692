"""Statistics of ensembles: root mean squares with confidence intervals, consistency bands.

Sources: [1] Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
section 5.4.2 (NEES and NIS tests). [2] Satterthwaite, Biometrics Bulletin 2 (1946) (effective degrees of
freedom of a sum of squares).
"""

from __future__ import annotations

import numpy as np

CONFIDENCE = 0.95


def chi_square_quantile(probability: float, degrees: float) -> float:
    """Quantile of the chi-square distribution; scipy.special only, since scipy.stats takes half a second."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(0.5 * degrees, probability))


def chi_square_exceedance(probability: float, degrees: int) -> float:
    """The value a chi-square variable exceeds with this small probability; inf for 0."""
    from scipy.special import gammainccinv

    return float(2.0 * gammainccinv(0.5 * degrees, probability)) if probability > 0.0 else np.inf


def gate_limits(probability: float) -> np.ndarray:
    """The largest normalised innovation squared that a gate lets pass, by the number of measurements (7,)."""
    return np.array([np.inf, *(chi_square_exceedance(probability, m) for m in range(1, 7))])


def rms_interval(mean_squares: np.ndarray) -> np.ndarray:
    """Root mean square over runs and components with its two-sided 95 % interval: value, low, high.

    mean_squares: (run, component) each the mean square of one error component of one run, over whatever was
    averaged within the run. Errors within a run are taken as fully correlated, so only runs and components
    count as independent: the interval is exact for errors that stay constant over a run and cautious else.
    Components of different size share the degrees of freedom of [2]. All nan where nothing is defined.
    """
    per_component = np.mean(mean_squares, axis=0)
    total = float(np.sum(per_component))
    if not np.isfinite(total):
        return np.full(3, np.nan)
    if total == 0.0:
        return np.zeros(3)
    degrees = mean_squares.shape[0] * total**2 / float(np.sum(per_component**2))
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = chi_square_quantile(1.0 - tail, degrees)
    high = chi_square_quantile(tail, degrees)
    return np.sqrt(total * np.array([1.0, degrees / low, degrees / high]))


def consistency_band(degrees: int, runs: int) -> tuple[float, float]:
    """Two-sided 95 % band of the ensemble mean of a normalised square per degree of freedom [1]."""
    total = degrees * runs
    tail = 0.5 * (1.0 - CONFIDENCE)
    return chi_square_quantile(tail, total) / total, chi_square_quantile(1.0 - tail, total) / total


def ellipsoid_probability(level: float, dimensions: int) -> float:
    """Chance that a Gaussian error lies within its `level`-sigma ellipsoid."""
    return chi_square_probability(level**2, dimensions)


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


def verdict(mean: float, band: tuple[float, float]) -> str:
    """What a mean normalised square per degree of freedom says about the sigma it was normalised by."""
    if not np.isfinite(mean):
        return "undefined"
    if mean > band[1]:
        return "sigma too small"
    return "sigma too large" if mean < band[0] else "true"


def chi_square_probability(value: float, degrees: float) -> float:
    """Chance that a chi-square variable stays below a value."""
    from scipy.special import gammainc

    return float(gammainc(0.5 * degrees, 0.5 * value))
