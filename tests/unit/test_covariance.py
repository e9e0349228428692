"""The covariance kernels against dense algebra, and Phi against the mechanisation it linearises."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from navsim.filter import covariance, interval, states, strapdown
from navsim.geodesy import attitude_kernels as attitude
from navsim.geodesy import earth_kernels as earth

DT = 0.01
NOISE = np.array([2e-7, 3e-4])
BIASES = states.biases((1 / 300.0, 1e-9), (1 / 100.0, 1e-6))
BLOCKS = {"biases": BIASES, "scale factors too": (*BIASES, *states.SCALE_FACTORS)}
BLOCKS["misalignments too"] = (*BLOCKS["scale factors too"], *states.MISALIGNMENTS)
"""What filters follow: fifteen states, twenty-one, and thirty-three."""
N = states.N_BASE
SIZES = {"m": 20.0, "m/s": 1.0, "rad": 1e-4, "rad/s": 1e-4, "m/s2": 1e-2, "1": 1e-3}
"""Errors that are small enough to be linear and large enough to be seen, by the unit of the state."""
SPREAD = {"m": 5.0, "m/s": 0.5, "rad": 0.05, "rad/s": 1e-3, "m/s2": 1e-2, "1": 1e-3}


def size(blocks: Sequence[states.Block]) -> int:
    return len(states.names(blocks))


def some_covariance(seed: int = 0, blocks: Sequence[states.Block] = BIASES) -> np.ndarray:
    n = size(blocks)
    a = np.random.default_rng(seed).standard_normal((n, n))
    scale = np.array([SPREAD[unit] for unit in states.units(blocks)])
    p = scale[:, None] * (a @ a.T / n + 0.1 * np.eye(n)) * scale
    return 0.5 * (p + p.T)


def some_state(blocks: Sequence[states.Block] = BIASES) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A fast, turning vehicle, so that no term of the error model is lost in rounding."""
    nav = np.zeros(states.NAV_SENSORS + 3 * len(blocks))
    nav[states.NAV_LLH : states.NAV_VEL] = 0.98, 0.64, 2500.0
    nav[states.NAV_VEL : states.NAV_QUAT] = 180.0, -140.0, 25.0
    nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = Rotation.from_euler("ZYX", [2.0, 0.2, -0.4]).as_quat()[[3, 0, 1, 2]]
    sensors = [1e-3, -2e-3, 5e-4, 0.02, -0.01, 0.03, 2e-3, -1e-3, 3e-3, 1e-3, 2e-3, -1e-3]
    sensors += [1e-4, -1e-4, 5e-5, 1e-4, 5e-5, -5e-5, -5e-5, 1e-4, 5e-5, 5e-5, -1e-4, 1e-4]
    nav[states.NAV_SENSORS :] = sensors[: 3 * len(blocks)]
    return nav, np.array([2e-3, -1e-3, 1.5e-3]), np.array([0.03, -0.02, -0.11])


def step(
    nav: np.ndarray, dtheta: np.ndarray, dv: np.ndarray, dt: float, blocks: Sequence[states.Block] = BIASES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The state after an interval, its mid-interval quantities, and its compensated increments."""
    after, mid, increments = nav.copy(), np.zeros(strapdown.MID_N), np.zeros(6)
    inverse = np.empty((6, 3))
    declared = states.declared(blocks)
    strapdown.unmixing(nav, declared, inverse)
    compensated = strapdown.compensated(nav, strapdown.is_mixed(declared), inverse, *dtheta, *dv, dt)
    strapdown.step(after, *compensated, increments, dt, np.empty((3, 3)), mid)
    return after, mid, increments


def perturbed(nav: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The state whose error against `nav` is x: truth = nav moved by x."""
    out = nav.copy()
    meridian, transverse = earth.radii(np.sin(nav[0]))
    out[0] += x[0] / (meridian + nav[2])
    out[1] += x[1] / ((transverse + nav[2]) * np.cos(nav[0]))
    out[2] -= x[2]
    out[3:6] += x[3:6]
    q = out[6:10].copy()
    attitude.rotate_in_nav_axes(q, *x[6:9])
    out[6:10] = q
    out[states.NAV_SENSORS :] += x[states.SENSORS :]
    return out


def error(truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    meridian, transverse = earth.radii(np.sin(estimate[0]))
    x = np.empty(states.SENSORS + truth.size - states.NAV_SENSORS)
    x[0] = (truth[0] - estimate[0]) * (meridian + estimate[2])
    x[1] = (truth[1] - estimate[1]) * (transverse + estimate[2]) * np.cos(estimate[0])
    x[2] = estimate[2] - truth[2]
    x[3:6] = truth[3:6] - estimate[3:6]
    attitude.difference(truth[6:10], estimate[6:10], x[6:9])
    x[states.SENSORS :] = truth[states.NAV_SENSORS :] - estimate[states.NAV_SENSORS :]
    return x


def dense_transition(mid: np.ndarray, dt: float, increments: np.ndarray, blocks: Sequence[states.Block]) -> np.ndarray:
    n, declared = size(blocks), states.declared(blocks)
    sums = some_sums(declared)
    add(sums, mid, dt, increments)
    phi = np.zeros((9, n))
    interval.transition(sums, mid, phi)
    out = np.eye(n)
    out[:9] += phi
    out[9:, 9:] = np.diag(sums.decay)
    return out


def some_sums(declared: np.ndarray) -> interval.StepSums:
    """Sums of no step yet."""
    of_size = (np.empty(size) for size in (9 + 12 * declared.size, 2, *[declared.size] * 3))
    sums = interval.StepSums(declared, *of_size, interval.rows_of_sums(declared))
    interval.reset_sums(sums)
    return sums


def add(sums: interval.StepSums, mid: np.ndarray, dt: float, increments: np.ndarray) -> None:
    """A step, as `filter_loop.mechanise` adds it."""
    interval.add_step(sums.total, sums.decay, sums.row, mid, dt, increments, sums.declared)
    interval.accumulate_markov(sums, dt)
    sums.length[...] += dt, 1.0


def undriven(blocks: Sequence[states.Block]) -> list[states.Block]:
    """The same states, constant."""
    return [replace(b, decay=0.0, drive=0.0) for b in blocks]


@pytest.mark.parametrize("followed", BLOCKS)
def test_transition_is_the_derivative_of_the_mechanisation(followed: str) -> None:
    """Central differences of `strapdown.step` itself, error by error: every sign and term of Phi."""
    blocks = undriven(BLOCKS[followed])
    nav, dtheta, dv = some_state(blocks)
    after, mid, increments = step(nav, dtheta, dv, DT, blocks)
    phi = dense_transition(mid, DT, increments, blocks)
    sizes = np.array([SIZES[unit] for unit in states.units(blocks)])
    n = size(blocks)
    for j in range(n):
        x = np.zeros(n)
        x[j] = sizes[j]
        ends = []
        for sign in (1.0, -1.0):
            # the true increments are the same; the estimate takes off its own biases
            moved, *_ = step(perturbed(nav, sign * x), dtheta, dv, DT, blocks)
            ends.append(error(moved, after))
        column = (ends[0] - ends[1]) / (2 * sizes[j])
        # 2e-4 of the largest effect of a block, 4e-3 where the effect itself is of second order in the interval
        # and the turn within it (3e-3 rad) is felt; 1e-12 for the terms that Phi leaves out
        for first in range(0, n, 3):
            block = slice(first, first + 3)
            largest = np.abs(phi[block, j]).max()
            small = (first, j // 3) in ((0, 2), (0, 3), (0, 4), (3, 3))
            # Phi leaves out that estimated scale factors, here up to 3e-3, are taken off what a sensor error does
            share = 4e-3 if small or (n > N and j >= states.SENSORS) else 2e-4
            rounding = (2e-9 if first == 0 else 2e-13) / sizes[j]
            np.testing.assert_allclose(
                column[block],
                phi[block, j],
                rtol=0,
                atol=share * largest + 1e-12 + rounding,
                err_msg=f"{first},{j}",
            )


@pytest.mark.parametrize("followed", BLOCKS)
def test_transition_is_of_second_order(followed: str) -> None:
    """Against the matrix exponential of F, the error of Phi falls with the third power of the interval."""
    blocks = BLOCKS[followed]
    nav, dtheta, dv = some_state(blocks)
    misfit = []
    for dt in (0.04, 0.02):
        scale = dt / DT
        _, mid, increments = step(nav, dtheta * scale, dv * scale, dt, blocks)
        phi = dense_transition(mid, dt, increments, blocks)
        # F by extrapolation to zero interval at the same mid-point quantities
        mid[strapdown.MID_FELT : strapdown.MID_SIN] *= 1e-7 / dt
        f = (dense_transition(mid, 1e-7, increments * 1e-7 / dt, blocks) - np.eye(size(blocks))) / 1e-7
        by_unit = {"m": 1.0, "m/s": 1.0, "rad": 0.1, "rad/s": 0.01, "m/s2": 0.1, "1": 0.01}
        scales = np.array([by_unit[unit] for unit in states.units(blocks)])
        difference = (phi - expm(f * dt)) / scales[:, None] * scales
        misfit.append(np.abs(difference).max())
    assert misfit[1] < 1e-6
    assert np.log2(misfit[0] / misfit[1]) > 2.7


@pytest.mark.parametrize("followed", BLOCKS)
def test_predict_agrees_with_dense_algebra(followed: str) -> None:
    blocks = BLOCKS[followed]
    declared, n = states.declared(blocks), size(blocks)
    nav, dtheta, dv = some_state(blocks)
    _, mid, increments = step(nav, dtheta, dv, DT, blocks)
    p = some_covariance(0, blocks)
    phi = dense_transition(mid, DT, increments, blocks)
    q = np.zeros((n, n))
    i = np.arange(3)
    q[i, i] = DT**2 / 4 * NOISE[1] * DT
    q[i, i + 3] = q[i + 3, i] = DT / 2 * NOISE[1] * DT
    q[i + 3, i + 3] = NOISE[1] * DT
    q[i + 6, i + 6] = NOISE[0] * DT
    q[9:, 9:] = np.diag(declared["drive"]) * DT
    ours, sums, rows = p.copy(), some_sums(declared), np.zeros((9, n))
    add(sums, mid, DT, increments)
    interval.transition(sums, mid, rows)
    covariance.predict(ours, sums, NOISE, declared, rows, np.empty((n, 9)))
    np.testing.assert_array_equal(ours, ours.T)
    np.testing.assert_allclose(ours, phi @ p @ phi.T + q, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("m", [3, 6])
def test_update_agrees_with_dense_algebra(m: int) -> None:
    rng = np.random.default_rng(5)
    p = some_covariance(1)
    h = rng.standard_normal((m, N))
    a = rng.standard_normal((m, m))
    r = a @ a.T + np.eye(m)
    ours = p.copy()
    h6, r6 = np.zeros((6, N)), np.zeros((6, 6))
    h6[:m], r6[:m, :m] = h, r
    pht, s, k = np.empty((N, 6)), np.empty((6, 6)), np.empty((N, 6))
    assert covariance.gain(ours, h6, r6, m, pht, s, k)
    covariance.joseph(ours, h6, r6, m, pht, k, np.empty((N, 6)))
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    left = np.eye(N) - gain @ h
    np.testing.assert_allclose(k[:, :m], gain, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ours, left @ p @ left.T + gain @ r @ gain.T, rtol=1e-9, atol=1e-13)
    np.testing.assert_array_equal(ours, ours.T)


def exactly(p: np.ndarray, h: np.ndarray, r: np.ndarray) -> np.ndarray:
    """(P^-1 + H' R^-1 H)^-1 = P - P H' S^-1 H P in fractions."""
    whole = [[[Fraction(float(x)) for x in row] for row in matrix] for matrix in (p, h, r)]
    a, b, noise = (np.array(matrix, dtype=object) for matrix in whole)
    pht = a @ b.T
    s = b @ pht + noise
    m = s.shape[0]
    rows = np.concatenate([s, pht.T], axis=1)
    for i in range(m):
        rows[i] = rows[i] / rows[i, i]
        for j in range(m):
            if j != i:
                rows[j] = rows[j] - rows[j, i] * rows[i]
    out: np.ndarray = (a - pht @ rows[:, m:]).astype(float)
    return out


@pytest.mark.parametrize("precise", [1e4, 1e8, 1e12, 1e16])
def test_a_measurement_far_more_precise_than_what_is_known(precise: float) -> None:
    """What the Joseph form is for: P stays right and positive where P - K H P is neither, against exact fractions."""
    rng = np.random.default_rng(8)
    p = some_covariance(4)
    h = np.zeros((6, N))
    h[:, :6] = np.eye(6)
    a = rng.standard_normal((6, 6))
    r = (a @ a.T + np.eye(6)) * np.trace(p[:6, :6]) / 6.0 / precise
    ours = p.copy()
    pht, s, k = np.empty((N, 6)), np.empty((6, 6)), np.empty((N, 6))
    assert covariance.gain(ours, h, r, 6, pht, s, k)
    covariance.joseph(ours, h, r, 6, pht, k, np.empty((N, 6)))
    expected = exactly(p, h, r)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(ours / scale / scale[:, None], expected / scale / scale[:, None], atol=1e-10)
    assert np.linalg.eigvalsh(ours / scale / scale[:, None]).min() > 0.0


def test_update_with_a_useless_measurement_is_refused() -> None:
    ours = some_covariance()
    out = covariance.gain(
        ours, np.zeros((6, N)), np.zeros((6, 6)), 3, np.empty((N, 6)), np.empty((6, 6)), np.empty((N, 6))
    )
    assert not out


def test_reset_is_the_change_of_the_attitude_error() -> None:
    """exp(delta) exp(theta) = exp(theta + epsilon): delta by scipy's rotations, for small epsilon."""
    theta = np.array([0.05, -0.12, 0.31])
    g = np.eye(N)
    step_size = 1e-6
    for i in range(3):
        turned = []
        for sign in (1, -1):
            epsilon = np.zeros(3)
            epsilon[i] = sign * step_size
            turned.append((Rotation.from_rotvec(theta + epsilon) * Rotation.from_rotvec(theta).inv()).as_rotvec())
        g[6:9, 6 + i] = (turned[0] - turned[1]) / (2 * step_size)
    p = some_covariance(2)
    ours = p.copy()
    covariance.reset(ours, *theta, np.empty((3, 3)), np.empty((N, 3)))
    np.testing.assert_allclose(ours, g @ p @ g.T, rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(ours, ours.T)


def test_normalised_square() -> None:
    p = some_covariance(3)
    e = np.random.default_rng(1).standard_normal(N)
    factor, x = np.empty((N, N)), np.empty(N)
    assert covariance.normalised_square(p, e, 0, N, factor, x) == pytest.approx(e @ np.linalg.solve(p, e), rel=1e-9)
    part = e[:6] @ np.linalg.solve(p[:6, :6], e[:6])
    assert covariance.normalised_square(p, e, 0, 6, factor, x) == pytest.approx(part, rel=1e-9)
    p[4, 4] = -1.0
    assert np.isnan(covariance.normalised_square(p, e, 0, N, factor, x))
