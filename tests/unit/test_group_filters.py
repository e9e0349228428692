"""Feedback and reset of the group filters against finite differences of their own definition."""

from __future__ import annotations

from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navsim.filter import covariance, eskf, evaluation, filter_loop, left_invariant, records, smoother, states, tfg
from navsim.filter.estimate import FILTER_KINDS
from navsim.filter.strapdown import MID_N
from navsim.geodesy import attitude_kernels as attitude
from navsim.scenario import filter as scenario_filter
from tests.helpers import cross
from tests.unit.test_covariance import error, some_covariance, some_sums

N = states.N_BASE
HELD = slice(states.NAV_BIAS_FRAME, states.NAV_SENSORS)
FIRST = states.NAV_SENSORS
FIXED = "tfg, fixed axes of gyro biases"
"""The chart of a component in straight flight."""


def test_every_register_of_aligned_zeros_lies_in_one_line_of_the_cache() -> None:
    for shape in ((), (1, 8), (3, 15, 15, 8), (32, 15, 15, 8)):
        lanes = records.aligned_zeros(*shape)
        assert lanes.shape == shape
        assert lanes.flags.c_contiguous
        assert lanes.ctypes.data % 64 == 0
        np.testing.assert_array_equal(lanes, np.zeros(shape))


@pytest.mark.parametrize("first", [0, 1, 2])
def test_a_transported_covariance_is_that_of_the_whole_matrix(first: int) -> None:
    """Blocks before the first, and states after the last, do not change."""
    rng = np.random.default_rng(41)
    n, blocks = N + 2, N // 3
    root, diagonal, column = (rng.normal(size=shape) for shape in ((n, n), (blocks, 3, 3), (blocks, 3, 3)))
    p = root @ root.T
    column[states.ATT // 3] = 0.0
    whole = np.eye(n)
    for block in range(first, blocks):
        own = slice(3 * block, 3 * block + 3)
        whole[own, states.ATT : states.ATT + 3] = column[block]
        whole[own, own] = diagonal[block]
    expected, before, out = whole @ p @ whole.T, p.copy(), np.full((n, n), np.nan)
    covariance.transported(p, diagonal, column, first, np.empty((n, N)), out)
    np.testing.assert_array_equal(p, before)
    np.testing.assert_allclose(np.tril(out), np.tril(expected), rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    covariance.transport(p, diagonal, column, first, np.empty((n, N)))
    np.testing.assert_array_equal(np.tril(out), np.tril(p))


def start(kind: str = "tfg") -> np.ndarray:
    nav = np.zeros(states.NAV_N)
    nav[:3] = 0.98, 0.64, 150.0
    nav[3:6] = 30.0, -4.0, 3.0
    nav[6:10] = Rotation.from_euler("ZYX", [0.4, 0.1, -0.2]).as_quat()[[3, 0, 1, 2]]
    nav[states.NAV_SENSORS :] = 3e-3, -2e-3, 1e-3, 0.02, -0.01, 0.03
    nav[HELD] = Rotation.from_rotvec([0.1, 0.3, -0.2]).as_quat()[[3, 0, 1, 2]]  # bias axes held back
    if kind == FIXED:
        nav[HELD] = -1.0, 0.0, 0.0, 0.0
    return nav


def bias_axes(nav: np.ndarray) -> Rotation:
    return rotation(nav) * Rotation.from_quat(nav[states.NAV_BIAS_FRAME + np.array([1, 2, 3, 0])]).inv()


def rotation(nav: np.ndarray) -> Rotation:
    return Rotation.from_quat(nav[[7, 8, 9, 6]])


def jacobian(theta: np.ndarray) -> np.ndarray:
    out = np.empty((3, 3))
    attitude.left_jacobian(*theta, out)
    return out


def retract(kind: str, nav: np.ndarray, x: np.ndarray, straight: int = 0) -> np.ndarray:
    """The state reached from `nav` by the plain tangent x, by the definition of each kind."""
    theta = x[6:9]
    j = jacobian(theta)
    c = rotation(nav)
    after = Rotation.from_rotvec(theta) * c
    out = nav.copy()
    shift = j @ x[0:3] if kind != "eskf" and not straight else x[0:3]
    eskf.move(out, *shift)
    out[3:6] += j @ x[3:6] if kind != "eskf" else x[3:6]
    out[6:10] = after.as_quat()[[3, 0, 1, 2]]
    for first in (0, 3):
        b, db = nav[FIRST + first : FIRST + 3 + first], x[9 + first : 12 + first]
        if kind in ("tfg", FIXED):
            axes = bias_axes(nav)
            big = axes.as_matrix() @ b
            y = axes.as_matrix() @ db - cross(big) @ theta
            moved = big + j @ y if kind == "tfg" or first else Rotation.from_rotvec(theta).apply(big) + axes.apply(db)
            out[FIRST + first : FIRST + 3 + first] = (Rotation.from_rotvec(theta) * axes).as_matrix().T @ moved
        else:
            out[FIRST + first : FIRST + 3 + first] = b + db
    return out


KINDS: dict[str, Callable[..., None]] = {
    "eskf": eskf.correct,
    "left-invariant": left_invariant.correct,
    "tfg": tfg.correct,
    FIXED: tfg.correct,
}
X = np.array([3.0, -2.0, 1.0, 0.4, -0.3, 0.2, 0.05, -0.12, 0.25, 1e-3, -2e-3, 1.5e-3, 0.02, 0.01, -0.03])


def workshop(straight: int = 0) -> filter_loop.PropagationBuffers:
    shapes = ((MID_N,), (9, N), (N, 9), (3, 3), (5, 3, 3), (5, 3, 3), (N, N), (N, 3))
    sums = some_sums(states.declared(states.biases()))
    return filter_loop.PropagationBuffers(sums, *(np.empty(shape) for shape in shapes), straight)


def own(kind: str, nav: np.ndarray, plain: np.ndarray, straight: int = 0) -> np.ndarray:
    out = np.empty(N)
    if kind == "eskf":
        return plain
    if kind == "left-invariant":
        left_invariant.error_in_filter_coordinates(plain, out, straight)
    else:
        tfg.error_in_filter_coordinates(nav, plain, out, straight, 0)
    return out


@pytest.mark.parametrize("straight", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_feedback_is_the_retraction(kind: str, straight: int) -> None:
    nav = start(kind)
    expected = retract(kind, nav, X, straight)
    KINDS[kind](nav, some_covariance(), X, workshop(straight))
    sign = np.sign(nav[6] * expected[6])
    np.testing.assert_allclose(nav[6:10], sign * expected[6:10], atol=1e-12)
    np.testing.assert_allclose(np.delete(nav, range(6, 10)), np.delete(expected, range(6, 10)), rtol=1e-10, atol=1e-12)


def test_without_its_chart_left_invariant_is_the_error_state_filter() -> None:
    """With positions and velocities added, nothing is left of the group: same estimate, same covariance."""
    reached = []
    for correct in (left_invariant.correct, eskf.correct):
        nav, p = start(), some_covariance()
        correct(nav, p, X, workshop(2))
        reached.append((nav, p))
    np.testing.assert_array_equal(reached[0][0], reached[1][0])
    np.testing.assert_allclose(reached[0][1], reached[1][1], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("straight", [0, 2])
def test_without_bias_axes_the_two_frames_filter_is_left_invariant(straight: int) -> None:
    """Biases in body axes are added: same estimate, covariance, and error in its own coordinates."""
    reached = []
    for kind in ("tfg", "left-invariant"):
        nav, p = start(), some_covariance()
        nav[HELD] = 0.0
        KINDS[kind](nav, p, X, workshop(straight))
        reached.append((nav, p, own(kind, nav, X, straight)))
    for ours, expected in zip(*reached, strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("straight", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_own_error_inverts_the_retraction(kind: str, straight: int) -> None:
    nav = start(kind)
    truth = retract(kind, nav, X, straight)
    np.testing.assert_allclose(own(kind, nav, error(truth, nav), straight), X, rtol=1e-6, atol=2e-6)


@pytest.mark.parametrize("straight", [0, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_reset_is_the_derivative_of_the_error_left(kind: str, straight: int) -> None:
    """G by central differences: truth = nav + (X + epsilon), estimate = nav + X, error left in own coordinates."""
    estimate = retract(kind, start(kind), X, straight)
    g = np.empty((N, N))
    sizes = np.repeat([1e-2, 1e-3, 1e-5, 1e-6, 1e-5], 3)
    for i in range(N):
        ends = []
        for sign in (1, -1):
            x = X.copy()
            x[i] += sign * sizes[i]
            truth = retract(kind, start(kind), x, straight)
            ends.append(own(kind, estimate, error(truth, estimate), straight))
        g[:, i] = (ends[0] - ends[1]) / (2 * sizes[i])
    p = some_covariance(7)
    ours = p.copy()
    KINDS[kind](start(kind), ours, X, workshop(straight))
    expected = g @ p @ g.T
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(ours / scale / scale[:, None], expected / scale / scale[:, None], atol=3e-5)
    np.testing.assert_array_equal(ours, ours.T)


@pytest.mark.parametrize("size", [1e-8, 1e-3, 0.0999, 0.1001, 1.5])
def test_derivative_of_the_left_jacobian(size: float) -> None:
    theta, u = size * np.array([0.6, -0.64, 0.48]), np.array([0.7, -1.3, 2.0])
    out = np.empty((3, 3))
    attitude.left_jacobian_derivative(*theta, u, out)
    for i in range(3):
        step = np.zeros(3)
        step[i] = 1e-5
        slope = (jacobian(theta + step) - jacobian(theta - step)) @ u / 2e-5
        np.testing.assert_allclose(out[:, i], slope, atol=1e-9)


def test_bias_axes_are_held_through_quick_turns_only() -> None:
    """Quick turns with an uncertain heading are held back; slow ones and those with a known heading are not."""
    p = np.diag(np.repeat([1.0, 1.0, 0.04, 1e-6, 1e-4], 3))
    nav = start()
    nav[HELD] = 1.0, 0.0, 0.0, 0.0
    turn = np.array([0.0, 0.002, 0.0])
    tfg.freeze_bias_frame(nav, p, turn, 0.01)
    np.testing.assert_allclose(nav[HELD], Rotation.from_rotvec(turn).as_quat()[[3, 0, 1, 2]], atol=1e-15)
    tfg.freeze_bias_frame(nav, p, turn, 1.0)
    np.testing.assert_allclose(nav[states.NAV_BIAS_FRAME + 2], 0.001, rtol=1e-5)
    known = np.diag(np.repeat([1.0, 1.0, 1e-4, 1e-6, 1e-4], 3))
    tfg.freeze_bias_frame(nav, known, turn, 0.01)
    np.testing.assert_array_equal(nav[HELD], [1.0, 0.0, 0.0, 0.0])


def test_the_kinds_of_a_scenario_are_those_of_estimators() -> None:
    assert set(get_args(scenario_filter.Kind)) == set(FILTER_KINDS)
    assert sorted(FILTER_KINDS.values()) == sorted((*records.FILTERS, *records.SMOOTHERS))
    assert {name for name, kind in FILTER_KINDS.items() if kind in records.SMOOTHERS} == set(scenario_filter.SMOOTHERS)
    assert set(smoother.PASSES) == set(records.SMOOTHERS)


def test_no_kind_is_judged_or_flown_as_another() -> None:
    history = records.empty_history(1, 0, states.N_BASE)
    truth = records.Truth(*(np.zeros((1, m)) for m in (3, 3, 4, 6)))
    declared = np.empty(0, states.DECLARED)
    none = records.FilterModel(
        max(records.SMOOTHERS) + 1, np.zeros((1, 2)), declared, np.ones(states.MAX_MEASUREMENT_SIZE + 1), 0
    )
    with pytest.raises(ValueError, match="no kind"):
        evaluation.evaluate(none, history, truth)


@pytest.mark.parametrize("steady_force", [True, False])
def test_a_sum_is_judged_in_the_coordinates_of_its_covariance(steady_force: bool) -> None:
    """Positions and velocities of its output are plain: where heading is 30 degrees off and one direction of position
    is known ten times as well as the other, NEES is that of the plain error, whatever chart the components have."""
    nav, truth = start(), start()
    plain = np.concatenate([[0.1, 20.0, 0.0, 0.1, 2.0, 0.0, 0.0, 0.0, 0.5], np.zeros(6)])
    eskf.inject(truth, plain)
    p = np.diag([0.1, 20.0, 0.1, 0.1, 2.0, 0.1, 0.01, 0.01, 0.5, *np.full(6, 0.1)]) ** 2
    history = records.empty_history(1, 0, N)
    history.navigation[0], history.covariance[0] = nav, p
    model = records.FilterModel(
        records.GAUSSIAN_SUM, np.zeros((1, 2)), states.declared(states.biases()),
        np.ones(states.MAX_MEASUREMENT_SIZE + 1), 0, steady_force=steady_force,
    )  # fmt: skip
    parts = slice(0, 3), slice(3, 6), slice(6, 10), slice(states.NAV_SENSORS, None)
    judged = evaluation.evaluate(model, history, records.Truth(*(truth[None, part] for part in parts)))
    assert judged.nees[0] == pytest.approx(5.0, abs=0.1)
