"""The importance sampling of `--method rare` against the normal distribution, which a linear landing has."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from navsim.runner.statistics import weighted_share
from navsim.simulation.importance_sampling import proposal
from tests.conftest import Within


@pytest.mark.validates("Probability of leaving a box by importance sampling, linear errors",
                       "normal distribution (scipy)", "standard errors, at 1e-3, 1e-5 and 1e-7",
                       difference="3")  # fmt: skip
@pytest.mark.parametrize("chance", [1e-3, 1e-5, 1e-7])
def test_probability_of_a_box(chance: float, within: Within) -> None:
    """Two independent errors with means, limited to both sides, the less likely one to one side."""
    mean, sigma = np.array([0.2, -0.5]), np.array([0.4, 3.0])
    faces = norm.isf(np.array([0.7, 0.2]) * chance / 2.0)
    lower, upper = mean - sigma * faces, np.array([mean[0] + sigma[0] * faces[0], 40.0])
    inside = np.prod(norm.cdf((upper - mean) / sigma) - norm.cdf((lower - mean) / sigma))
    mix = proposal(mean, np.diag(sigma**2), lower, upper)
    rng = np.random.default_rng(1407)
    component = rng.choice(mix.shares.size, 40_000, p=mix.shares)
    off = sigma[:, None] * rng.standard_normal((2, component.size)) + mix.covariance @ mix.shifts[component].T
    error = mean[:, None] + off
    outside = ((error < lower[:, None]) | (error > upper[:, None])).any(axis=0)
    (found, low, high), relative, _ = weighted_share(mix.log_weights(off), outside, mix.most_weight, mix.most_weight)
    truth = 1.0 - inside
    assert relative < 0.02
    assert abs(found - truth) < within["difference"] * relative * truth
    assert low < truth < high
