"""Quaternion kernels against scipy's rotations and against each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from navsim.geodesy import attitude
from navsim.geodesy import attitude_kernels as point
from tests.helpers import cross

component = st.floats(-3.0, 3.0)
vector = st.tuples(component, component, component).map(np.array)


def scalar_first(r: Rotation) -> np.ndarray:
    q = r.as_quat()[[3, 0, 1, 2]]
    return q if q[0] >= 0 else -q


@given(vector, vector)
def test_turning_agrees_with_scipy(start: np.ndarray, turn: np.ndarray) -> None:
    before = Rotation.from_rotvec(start)
    for kernel, expected in (
        (point.rotate_in_nav_axes, Rotation.from_rotvec(turn) * before),
        (point.rotate_in_body_axes, before * Rotation.from_rotvec(turn)),
    ):
        q = scalar_first(before)
        kernel(q, *turn)
        matrix = np.empty((3, 3))
        point.dcm(q, matrix)
        np.testing.assert_allclose(matrix, expected.as_matrix(), atol=1e-14)
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)


@given(vector)
def test_difference_is_the_left_error(theta: np.ndarray) -> None:
    size = np.linalg.norm(theta)
    if size > 3.0:
        theta = theta * (3.0 / size)
    estimate = Rotation.from_rotvec([0.3, -1.1, 2.0])
    truth = Rotation.from_rotvec(theta) * estimate
    out = np.empty(3)
    point.difference(scalar_first(truth), scalar_first(estimate), out)
    np.testing.assert_allclose(out, theta, atol=1e-13)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 1.0, 3.0])
def test_left_jacobian_is_the_derivative_of_the_exponential(size: float) -> None:
    theta = size * np.array([0.6, -0.64, 0.48])
    jacobian = np.empty((3, 3))
    point.left_jacobian(*theta, jacobian)
    step = 1e-5
    for i in range(3):
        ahead, behind = theta.copy(), theta.copy()
        ahead[i] += step
        behind[i] -= step
        delta = (Rotation.from_rotvec(ahead) * Rotation.from_rotvec(behind).inv()).as_rotvec() / (2 * step)
        np.testing.assert_allclose(jacobian[:, i], delta, atol=1e-9)


@given(st.floats(0.0, 0.2))
def test_series_meet_the_closed_forms(t: float) -> None:
    """To one unit in the last place."""
    s, c = point.half_sinc(t * t)
    assert c == pytest.approx(np.cos(t / 2), rel=2.0**-52, abs=0.0)
    assert s * t == pytest.approx(np.sin(t / 2), rel=2.0**-52, abs=0.0)


@given(vector)
def test_quaternion_and_angles_of_a_matrix(theta: np.ndarray) -> None:
    r = Rotation.from_rotvec(theta)
    np.testing.assert_allclose(attitude.quaternion_from_dcm(r.as_matrix()), scalar_first(r), atol=1e-7)
    q = attitude.quaternion_from_dcm(r.as_matrix())
    matrix = np.empty((3, 3))
    point.dcm(q, matrix)
    np.testing.assert_allclose(matrix, r.as_matrix(), atol=1e-14)
    roll, pitch, yaw = attitude.roll_pitch_yaw(r.as_matrix())
    again = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(again, r.as_matrix(), atol=1e-7)


def test_normalise_pulls_back_to_unit_length() -> None:
    q = np.array([0.5, 0.5, -0.5, 0.5]) * (1 + 1e-7)
    point.normalise(q)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-13)


def test_cross_helper() -> None:
    a, b = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 0.5, 4.0])
    np.testing.assert_allclose(cross(a) @ b, np.cross(a, b))


angle = st.floats(-1.4, 1.4)


@given(st.tuples(component, angle, component).map(np.array), vector)
def test_errors_of_roll_pitch_yaw_agree_with_scipy(rpy: np.ndarray, theta: np.ndarray) -> None:
    """True minus estimated angles of an attitude that the error turns into the true one."""
    theta = theta * 0.1
    truth = Rotation.from_euler("ZYX", rpy[::-1])
    estimate = (Rotation.from_rotvec(-theta) * truth).as_euler("ZYX")[::-1]
    difference = attitude.rpy_error(rpy[None], theta[None])[0] - (rpy - estimate)
    np.testing.assert_allclose((difference + np.pi) % (2 * np.pi), np.pi, atol=1e-9)


@given(st.tuples(component, angle, component).map(np.array), vector)
def test_small_errors_of_roll_pitch_yaw_are_linear(rpy: np.ndarray, theta: np.ndarray) -> None:
    linear = attitude.rpy_jacobian(rpy[None])[0] @ theta * 1e-6
    np.testing.assert_allclose(attitude.rpy_error(rpy[None], 1e-6 * theta[None])[0], linear, atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-9, 9.99e-4, 1.01e-3, 0.05, 1.0, 3.0])
def test_matrices_of_rotation_vectors_have_the_bits_of_scipy(size: float) -> None:
    theta = np.random.default_rng(1).standard_normal((2000, 3))
    theta *= size / np.linalg.norm(theta, axis=1, keepdims=True)
    expected = Rotation.from_rotvec(theta).as_matrix()
    found = attitude.dcm_from_rotation_vector(theta.reshape(40, 50, 3)).reshape(-1, 3, 3)
    np.testing.assert_array_equal(found, expected)
    for lost in ((np.inf, 0.0, 0.0), (0.0, np.nan, 1.0), (1e200, 1.0, 1.0)):
        assert np.isnan(attitude.dcm_from_rotation_vector(np.array(lost))).all()
