"""Verdicts on a sigma: significant and large are two questions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from navsim.core.arrays import normal
from navsim.study.statistics import SIGMA_TOLERANCE, consistency_band, sigma_error, verdict


def test_chance_outside_limits() -> None:
    """Of which each has its own side, far into the tails."""
    low, high = np.array([-3.0, 0.5, -60.0, -np.inf]), np.array([5.0, 2.0, 40.0, np.inf])
    mean, sigma = np.array([0.4, -1.0, 2.0, 0.0]), np.array([2.0, 0.3, 1.5, 1.0])
    of = norm(mean, sigma)
    np.testing.assert_allclose(normal.outside(low, high, mean, sigma), of.cdf(low) + of.sf(high), rtol=1e-10)
    size = np.array([1.0, 30.0])
    two = norm(0.5, 2.0)
    np.testing.assert_allclose(normal.exceedance(size, 0.5, 2.0), two.cdf(-size) + two.sf(size), rtol=1e-10)


@pytest.mark.parametrize("share", [-0.3, -0.08, 0.0, 0.12, 1.5])
def test_the_error_of_a_sigma_is_found(share: float) -> None:
    """A sigma that is 8 % small normalises errors to squares of 1 / 0.92^2; the interval covers nine drawn of ten."""
    rng = np.random.default_rng(7)
    runs, inside = 400, 0
    for _ in range(200):
        squares = (rng.standard_normal((runs, 3)) / (1.0 + share)) ** 2
        value, low, high = sigma_error(float(squares.mean()), consistency_band(3, runs))
        assert low < value < high
        assert value == pytest.approx(share, abs=0.15 * (1.0 + share))
        inside += low <= share <= high
    assert 180 <= inside <= 199


@pytest.mark.parametrize(
    ("sigma_over_right", "runs", "words"),
    [
        (0.92, 2000, "sigma 8 % small"),
        (1.12, 2000, "sigma 12 % large"),
        (3.0, 2000, "sigma 3.0 times the right one"),
        (1.0, 2000, "sigma right within 2 %"),
        (0.97, 20000, "sigma 3 % small (significant, within the 5 % tolerance)"),
        (0.92, 20, "sigma right within 24 %; more runs would tell"),
    ],
)
def test_words(sigma_over_right: float, runs: int, words: str) -> None:
    assert SIGMA_TOLERANCE == 0.05
    assert verdict(sigma_error(sigma_over_right**-2.0, consistency_band(3, runs))) == words


def test_without_errors_there_is_no_verdict() -> None:
    for mean in (np.nan, 0.0):
        assert verdict(sigma_error(mean, consistency_band(3, 10))) == "undefined"
