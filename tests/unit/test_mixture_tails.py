"""The page of the mixture's tails: samples have the mixture's density, outputs are those of the runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from navsim.filter.states import N_BASE
from navsim.landing.study import fly_all
from navsim.runner.executor import threads
from tests.helpers import case, load_script

tails: Any = load_script("mixture_tails")


def test_samples_exceed_a_limit_as_the_mixture_does() -> None:
    """Two components in one dimension: the share beyond 3 sigma of the whole is a sum of two normal ones."""
    weight, sigma, offset, samples = np.array([0.9, 0.1]), np.array([1.0, 3.0]), np.array([0.4, -3.6]), 200_000
    part, error = tails.sampled(weight, sigma[:, None, None] ** 2, samples, np.random.default_rng(1))
    truth = offset[part] + error[:, 0]
    limit = 3.0 * np.sqrt(weight @ (sigma**2 + offset**2))
    expected = weight @ (norm.sf((limit - offset) / sigma) + norm.sf((limit + offset) / sigma))
    assert expected > 4.0 * norm.sf(3.0)
    assert abs((np.abs(truth) > limit).mean() - expected) < 4.0 * np.sqrt(expected / samples)


def test_an_excess_by_chance_is_not_explained() -> None:
    """Of 10 000 runs 40 are beyond the limit, 25 are predicted: half of the excess. Of 100 runs one is, by chance."""

    def found(runs: int, beyond: int) -> Any:
        nees, predicted = np.where(np.arange(runs) < beyond, 1e3, 0.0)[None], np.full((1, runs), 0.0025)
        return tails.Judged(nees, *[predicted] * 5)

    assert tails.explained(found(10_000, 40)) == "50"
    assert tails.explained(found(100, 1)) == "-"


@pytest.mark.long
def test_outputs_are_those_of_the_runs_and_samples_have_their_moments() -> None:
    """NEES of samples has the mean of chi-square; in another chart it would be 9 % larger at 20 s."""
    short = case("duration_s=20", "imu.accelerometer.noise_mg=1")
    rows, found = tails.outputs(short), tails.fly(short, 3821, 0)
    flown = np.asarray(fly_all(short, 3821, 0, tails.WIDTH, threads(), keep="errors")["nees"])
    np.testing.assert_array_equal([at[0] for at in found], flown[:, rows].T)
    assert min(at[4].min() for at in found) > 1
    np.testing.assert_allclose(np.mean([at[1] for at in found], axis=1), N_BASE, rtol=0.02)
