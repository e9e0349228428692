"""Attitude, rates and increments of a trajectory over the Earth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navsim.geodesy import earth
from tests.helpers import scenario

T = np.linspace(1.0, 118.0, 60)


def test_start_stands_where_the_scenario_says() -> None:
    motion = scenario("runway.heading_deg=77").trajectory().motion(np.zeros(1))
    np.testing.assert_allclose(np.degrees(motion.llh[0, :2]), [56.0, 37.0], atol=1e-12)
    # 153 m above the tangent plane of a point 1749 m away: the Earth falls off by 0.24 m
    assert motion.llh[0, 2] == pytest.approx(153.0 + 1748.8**2 / (2 * 6.38e6), abs=0.01)


def test_threshold_and_aim_point() -> None:
    s = scenario(name="landing_smooth")
    frame = s.trajectory().frame
    np.testing.assert_allclose(np.degrees(s.threshold(frame)[:2]), [56.02, 37.01], atol=1e-9)
    threshold = earth.ecef_from_llh(np.array([*np.radians([56.02, 37.01]), 120.0]))
    assert np.linalg.norm(frame.origin - threshold) == pytest.approx(100.0, abs=0.01)


@pytest.mark.parametrize("name", ["landing", "landing_smooth"])
def test_coordinated_flight(name: str) -> None:
    motion = scenario("wind.speed_m_s=7", "wind.from_deg=100", name=name).trajectory().motion(T)
    np.testing.assert_allclose(motion.specific_force[:, 1], 0.0, atol=1e-9)
    roll, pitch, _ = motion.rpy.T
    assert np.abs(roll).max() < np.radians(0.5)  # Coriolis, and braking along a track that the nose does not point to
    assert np.abs(pitch).max() < np.radians(10.0)


def test_no_wind_means_no_crab_and_constant_angle_of_attack() -> None:
    motion = (
        scenario("approach.angle_of_attack_deg=4", "runway.heading_deg=200")
        .trajectory()
        .motion(np.array([20.0, 100.0]))
    )
    v = motion.velocity_ned
    path_angle = np.degrees(np.arctan2(-v[:, 2], np.hypot(v[:, 0], v[:, 1])))
    np.testing.assert_allclose(np.degrees(motion.rpy[:, 1]) - path_angle, 4.0, atol=1e-6)
    assert np.degrees(motion.rpy[0, 2]) % 360 == pytest.approx(200.0, abs=0.05)


def test_crab_angle_is_that_of_the_wind_triangle() -> None:
    """Wind from the right of the landing direction turns the nose to the right; gone at touchdown."""
    s = scenario(
        "runway.heading_deg=0",
        "wind.speed_m_s=6",
        "wind.from_deg=90",
        "approach.angle_of_attack_deg=0",
        name="landing_smooth",
    )
    motion = s.trajectory().motion(np.array([10.0, 110.0]))
    ground = motion.velocity_ned[0, 0]
    assert np.degrees(motion.rpy[0, 2]) == pytest.approx(np.degrees(np.arctan2(6.0, ground)), abs=0.02)
    assert np.degrees(motion.rpy[1, 2]) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("name", ["landing", "landing_smooth"])
def test_rates_are_derivatives_of_the_attitude(name: str) -> None:
    trajectory = scenario("wind.speed_m_s=7", "wind.from_deg=100", name=name).trajectory()
    step = 1e-4
    ahead, behind, here = (trajectory.motion(T + d) for d in (step, -step, 0.0))

    def inertial(m: object, t: np.ndarray) -> Rotation:
        c_eb = np.swapaxes(earth.ned_matrix(m.llh), 1, 2) @ m.c_nb
        return Rotation.from_rotvec(np.outer(t, [0, 0, earth.RATE])) * Rotation.from_matrix(c_eb)

    turn = (inertial(behind, T - step).inv() * inertial(ahead, T + step)).as_rotvec() / (2 * step)
    np.testing.assert_allclose(turn, here.angular_rate, atol=3e-8)


def test_increments_add_up() -> None:
    """Increments of fine samples add up to those of coarse ones, across the corner too."""
    trajectory = scenario().trajectory()
    fine = trajectory.increments(np.arange(6001) / 100)
    coarse = trajectory.increments(np.arange(601) / 10)
    for a, b in zip(fine, coarse, strict=True):
        np.testing.assert_allclose(a.reshape(600, 10, 3).sum(axis=1), b, atol=1e-12)
