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


def inside_box(low: np.ndarray, high: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> float:
    """Chance that three normal values lie within a box; low, high: (3,), infinite for no limit; mean (3,), covariance
    (3, 3). nan where these are not finite.

    The first two are integrated by Gauss-Legendre rules over what matters of them, the third is known by them.
    """
    from scipy.special import ndtr

    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        return float("nan")
    root = np.linalg.cholesky(covariance)
    points, weights = np.polynomial.legendre.leggauss(_NODES)

    def piece(axis: int, before: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Ends of the standard normal value that puts an error inside, by what the values before it do."""
        ends = ((end[axis] - mean[axis] - before) / root[axis, axis] for end in (low, high))
        least, most = (np.clip(end, -_FAR, _FAR) for end in ends)
        return least, most

    def rule(least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points in pieces, and their weights by the density."""
        half = 0.5 * (most - least)[..., None]
        x = least[..., None] + half * (1.0 + points)
        return x, half * weights * np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)

    x, of_x = rule(*(np.asarray(end) for end in piece(0, 0.0)))
    y, of_y = rule(*piece(1, root[1, 0] * x))
    least, most = piece(2, root[2, 0] * x[:, None] + root[2, 1] * y)
    return float(np.sum(of_x[:, None] * of_y * (ndtr(most) - ndtr(least))))


_NODES = 96
"""Of a Gauss-Legendre rule over a piece of a normal density."""
_FAR = 9.0
"""Sigmas beyond which nothing matters."""
