"""Chances of the normal distribution far into its tails."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from navsim.statistics import normal


def test_chance_outside_limits() -> None:
    """Of which each has its own side, far into the tails."""
    low, high = np.array([-3.0, 0.5, -60.0, -np.inf]), np.array([5.0, 2.0, 40.0, np.inf])
    mean, sigma = np.array([0.4, -1.0, 2.0, 0.0]), np.array([2.0, 0.3, 1.5, 1.0])
    of = norm(mean, sigma)
    np.testing.assert_allclose(normal.outside(low, high, mean, sigma), of.cdf(low) + of.sf(high), rtol=1e-10)
    size = np.array([1.0, 30.0])
    two = norm(0.5, 2.0)
    np.testing.assert_allclose(normal.exceedance(size, 0.5, 2.0), two.cdf(-size) + two.sf(size), rtol=1e-10)
