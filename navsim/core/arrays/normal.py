"""The normal distribution, for arrays."""

from __future__ import annotations

import numpy as np


def exceedance(limit: np.ndarray, mean: np.ndarray | float, sigma: np.ndarray | float) -> np.ndarray:
    """Chance that the size of a value of this mean and 1 sigma is above a limit, far into the tails."""
    from scipy.special import ndtr

    return np.asarray(ndtr((mean - limit) / sigma) + ndtr((-limit - mean) / sigma))


def quantile(chance: float) -> float:
    """What a normal value of mean 0 and sigma 1 is below with this chance."""
    from scipy.special import ndtri

    return float(ndtri(chance))
