"""The covariance of an interval against the recursion by samples, in dense algebra: what the sums leave out is nothing.

The judge takes every step for an interval by itself. Its Phi is compared with the mechanisation and with a matrix
exponential in `test_covariance`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from navsim.filter import covariance, interval, states, strapdown
from tests.unit.test_covariance import BLOCKS, NOISE, add, dense_transition, size, some_covariance, some_state
from tests.unit.test_covariance import some_sums as begun

STEP = 0.01
DRIVEN = states.biases((1 / 20.0, 1e-9), (1 / 5.0, 1e-5))
WALKING = states.biases((0.0, 1e-9), (0.0, 1e-5))
ALL = {**BLOCKS, "driven": DRIVEN, "walking": WALKING}

Step = tuple[np.ndarray, float, np.ndarray]
"""What a step of the mechanisation leaves: mid, its length, compensated increments."""


def flown(blocks: Sequence[states.Block], lengths: Sequence[float]) -> list[Step]:
    """Steps of a fast vehicle whose rate and force change with each: noise of 10 mg a sample, and a roll."""
    nav, dtheta, dv = some_state(blocks)
    declared, rng = states.declared(blocks), np.random.default_rng(7)
    inverse, previous, out = np.empty((6, 3)), np.zeros(6), []
    strapdown.unmixing(nav, declared, inverse)
    for k, dt in enumerate(lengths):
        rate = dtheta / STEP + [0.3 * np.sin(0.2 * k), 0.1, 0.0]
        force = dv / STEP + 0.1 * rng.standard_normal(3) + [0.0, 0.0, 2.0 * np.cos(0.1 * k)]
        felt = strapdown.compensated(nav, strapdown.is_mixed(declared), inverse, *rate * dt, *force * dt, dt)
        mid = np.zeros(strapdown.MID_N)
        strapdown.step(nav, *felt, previous, dt, np.empty((3, 3)), mid)
        out.append((mid, dt, previous.copy()))
    return out


def by_interval(p: np.ndarray, steps: Sequence[Step], blocks: Sequence[states.Block]) -> np.ndarray:
    declared, n = states.declared(blocks), size(blocks)
    sums, phi, ours = begun(declared), np.zeros((9, n)), p.copy()
    for step in steps:
        add(sums, *step)
    interval.transition(sums, steps[-1][0], phi)
    covariance.predict(ours, sums, NOISE, declared, phi, np.empty((n, 9)))
    np.testing.assert_array_equal(ours, ours.T)
    return ours


def by_samples(p: np.ndarray, steps: Sequence[Step], blocks: Sequence[states.Block]) -> np.ndarray:
    declared, n, i = states.declared(blocks), size(blocks), np.arange(3)
    for mid, dt, increments in steps:
        phi, q = dense_transition(mid, dt, increments, blocks), np.zeros((n, n))
        q[i, i] = dt**2 / 4 * NOISE[1] * dt
        q[i, i + 3] = q[i + 3, i] = dt / 2 * NOISE[1] * dt
        q[i + 3, i + 3] = NOISE[1] * dt
        q[i + 6, i + 6] = NOISE[0] * dt
        q[9:, 9:] = np.diag(declared["drive"]) * dt
        p = phi @ p @ phi.T + q
    return p


def misfit(ours: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference of sigmas, in them, and of correlations."""
    a, b = np.sqrt(np.diag(ours)), np.sqrt(np.diag(expected))
    return max(float(np.abs(a / b - 1).max()), float(np.abs(ours / np.outer(a, a) - expected / np.outer(b, b)).max()))


TEN, TWENTY = [STEP] * 10, [STEP] * 20
CUT = [0.004, *[STEP] * 9, 0.006]
"""A measurement inside a sample at either end."""


@pytest.mark.parametrize("lengths", [TEN, TWENTY, CUT], ids=["0.1 s", "0.2 s", "cut"])
@pytest.mark.parametrize("followed", ALL)
def test_an_interval_is_the_recursion_by_samples(followed: str, lengths: list[float]) -> None:
    """From correlated errors, and from errors of which nothing is known but the noise."""
    blocks = ALL[followed]
    steps = flown(blocks, lengths)
    p = some_covariance(3, blocks)
    assert misfit(by_interval(p, steps, blocks), by_samples(p, steps, blocks)) < 2e-6
    nearly_known = 1e-12 * np.diag(np.diag(p))
    ours, expected = by_interval(nearly_known, steps, blocks), by_samples(nearly_known, steps, blocks)
    # noise of the mean force, of equal steps, and of a drive without what velocity has of a gyro's
    assert misfit(ours, expected) < 1e-2
    assert np.linalg.eigvalsh(ours / np.sqrt(np.outer(np.diag(ours), np.diag(ours)))).min() > -1e-12


def test_an_interval_of_one_step_is_that_step() -> None:
    steps = flown(DRIVEN, [STEP])
    p = some_covariance(3, DRIVEN)
    np.testing.assert_allclose(by_interval(p, steps, DRIVEN), by_samples(p, steps, DRIVEN), rtol=1e-12, atol=1e-16)
