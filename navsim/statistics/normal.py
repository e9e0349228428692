"""The normal distribution, for arrays."""

from __future__ import annotations

import numpy as np


def exceedance(limit: np.ndarray, mean: np.ndarray | float, sigma: np.ndarray | float) -> np.ndarray:
    """Chance that the size of a value of this mean and 1 sigma is above a limit, far into the tails."""
    return outside(-limit, limit, mean, sigma)


def outside(low: np.ndarray, high: np.ndarray, mean: np.ndarray | float, sigma: np.ndarray | float) -> np.ndarray:
    """Chance that a value of this mean and 1 sigma is below the one limit or above the other, far into the tails."""
    from scipy.special import ndtr

    return np.asarray(ndtr((mean - high) / sigma) + ndtr((low - mean) / sigma))


def quantile(chance: float) -> float:
    """Quantile of the standard normal distribution."""
    from scipy.special import ndtri

    return float(ndtri(chance))
