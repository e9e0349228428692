"""Paths: continuity, the numbers of `docs/theory/trajectory.md`, sections 1 to 3, derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.trajectory.approach import GLIDE_START, TOUCHDOWN
from navsim.trajectory.path import blend, uniform
from tests.helpers import scenario


@pytest.mark.parametrize("name", ["landing", "landing_smooth", "s_turn"])
def test_continuous_to_the_acceleration(name: str) -> None:
    path = scenario(name=name).approach.path()
    assert path.knots.size > 1
    for knot, before, after in zip(path.knots, path.segments[:-1], path.segments[1:], strict=True):
        left, right = before.jet(np.array([knot]))[0], after.jet(np.array([knot]))[0]
        np.testing.assert_allclose(left[:3], right[:3], atol=1e-9)


@pytest.mark.parametrize("name", ["landing", "landing_smooth", "s_turn"])
def test_jets_are_derivatives(name: str) -> None:
    path = scenario(name=name).approach.path()
    t = np.linspace(0.3, 119.7, 777)
    t = t[np.min(np.abs(t[:, None] - path.knots), axis=1) > 0.01]
    ahead, behind, here = path.jet(t + 1e-4), path.jet(t - 1e-4), path.jet(t)
    slope = (ahead[:, :3] - behind[:, :3]) / 2e-4
    # the corner's quintic has a fifth derivative of 1e5 m/s5
    np.testing.assert_allclose(slope, here[:, 1:], atol=2e-3)


def test_paper_profile_has_the_paper_s_numbers() -> None:
    path = scenario().approach.path()
    assert path.events[TOUCHDOWN] == pytest.approx(60.19, abs=0.005)
    start, mid, late = path.jet(np.array([0.0, 30.0, 100.0]))
    np.testing.assert_allclose(start[0], [-1748.8, 0.0, -153.0], atol=0.05)
    assert np.linalg.norm(start[1]) * 3.6 == pytest.approx(130.0)
    assert np.arctan2(start[1, 2], start[1, 0]) == pytest.approx(np.radians(5.0))
    # on the line, all the way
    assert -mid[0, 2] == pytest.approx(-mid[0, 0] * np.tan(np.radians(5.0)))
    np.testing.assert_allclose(late[1] * 3.6, [80.0, 0.0, 0.0], atol=1e-12)
    assert late[0, 2] == 0.0
    assert late[0, 0] == pytest.approx((100.0 - path.events[TOUCHDOWN]) * 80 / 3.6)


def test_smooth_profile_has_the_shape_described() -> None:
    path = scenario("approach.speed_start_kmh=130", name="landing_smooth").approach.path()
    touchdown = path.events[TOUCHDOWN]
    assert 95.0 < touchdown < 105.0
    at = path.jet(np.array([touchdown]))[0]
    np.testing.assert_allclose(at[0], 0.0, atol=1e-9)
    assert at[1, 2] == pytest.approx(0.5)
    assert at[1, 0] * 3.6 == pytest.approx(80.0)
    level = path.jet(np.linspace(0, path.events[GLIDE_START], 20))
    np.testing.assert_allclose(level[:, 0, 2], -153.0, atol=1e-9)
    np.testing.assert_allclose(level[:, 1, 0] * 3.6, 130.0, atol=1e-9)
    glide = path.jet(np.linspace(path.events[GLIDE_START] + 6, path.events["flare"] - 0.6, 30))
    np.testing.assert_allclose(np.arctan2(glide[:, 1, 2], glide[:, 1, 0]), np.radians(5.0), atol=1e-12)
    # uniform deceleration along the slope
    along = np.linalg.norm(glide[:, 2], axis=1)
    np.testing.assert_allclose(along, along[0], rtol=1e-12)
    # exponential flare: sink rate falls linearly with height
    flare = path.jet(np.linspace(path.events["flare"] + 0.6, touchdown, 30))
    fit = np.polyfit(-flare[:, 0, 2], flare[:, 1, 2], 1)
    np.testing.assert_allclose(np.polyval(fit, -flare[:, 0, 2]), flare[:, 1, 2], atol=1e-10)
    rest = path.jet(np.linspace(touchdown + 1.0, 120.0, 30))
    np.testing.assert_allclose(rest[:, 0, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(rest[:, 2, 0], -0.5, atol=1e-9)


def test_blend_meets_both_states() -> None:
    before = uniform(1.0, np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), np.array([7.0, 8, 9]))
    after = uniform(3.0, np.array([9.0, 8, 7]), np.array([6.0, 5, 4]), np.array([3.0, 2, 1]))
    joint = blend(2.0, 3.0, before.jet(np.array([2.0]))[0], after.jet(np.array([3.0]))[0])
    np.testing.assert_allclose(joint.jet(np.array([2.0]))[0, :3], before.jet(np.array([2.0]))[0, :3], atol=1e-12)
    np.testing.assert_allclose(joint.jet(np.array([3.0]))[0, :3], after.jet(np.array([3.0]))[0, :3], atol=1e-12)


def test_s_turn_keeps_speed_and_rate() -> None:
    """30 m/s and 6 deg/s right and left but for the rolls, in which the speed stays within 1 %."""
    path = scenario(name="s_turn").approach.path()
    t = np.linspace(0.0, 120.0, 2401)
    jet = path.jet(t)
    speed = np.linalg.norm(jet[:, 1], axis=1)
    np.testing.assert_allclose(speed, 30.0, rtol=0.01)
    np.testing.assert_allclose(jet[:, 0, 2], -150.0, atol=1e-9)
    rate = np.degrees(jet[:, 1, 0] * jet[:, 2, 1] - jet[:, 1, 1] * jet[:, 2, 0]) / speed**2
    steady = np.min(np.abs(t[:, None] - path.knots), axis=1) > 2.0
    np.testing.assert_allclose(np.abs(rate[steady]), 6.0, rtol=1e-9)
    assert np.abs(rate).max() < 7.0  # a C2 roll overshoots the turn rate by a sixth
    track = np.degrees(np.unwrap(np.arctan2(jet[:, 1, 1], jet[:, 1, 0])))
    assert -50 < track.min() < -40
    assert 40 < track.max() < 50
