"""Mean wind along a path, airspeed held, and what is refused of them."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.geodesy import earth
from navsim.scenario_files.source import InputError
from navsim.trajectory import air
from navsim.trajectory.airspeed_path import Retimed
from tests.helpers import scenario

T = np.linspace(1.0, 59.0, 40)
LOG = ("wind.profile=log", "wind.speed_m_s=6", "wind.from_deg=60")
LEVELS = (
    "wind.profile=table",
    "wind.levels=[{height_m: 0, speed_m_s: 2, from_deg: 350}, {height_m: 60, speed_m_s: 6, from_deg: 10}, "
    "{height_m: 120, speed_m_s: 9, from_deg: 30}]",
)


def test_a_table_of_levels() -> None:
    """Linear between levels, directions by the short way, held beyond the ends; corners rounded within a foot."""
    wind = scenario(*LEVELS).wind.mean(0.0).profile
    speed, _, direction, _ = wind.at(np.array([30.0, 90.0, 500.0, -5.0]))
    assert speed == pytest.approx([4.0, 7.5, 9.0, 2.0])
    assert np.degrees(direction) % 360.0 == pytest.approx([0.0, 20.0, 30.0, 350.0])
    h = np.linspace(-1.0, 130.0, 4001)
    for profile in (wind, scenario(*LOG).wind.mean(0.0).profile):
        for value, slope in (profile.at(h)[:2], profile.at(h)[2:]):
            found = np.gradient(value, h)
            assert np.abs(found - slope)[2:-2].max() < 0.1 * np.abs(slope).max() + 1e-12  # no jump of the slope


@pytest.mark.parametrize("settings", [LOG, LEVELS])
@pytest.mark.parametrize("speed_is", ["ground", "air"])
def test_rates_are_derivatives_of_the_attitude(settings: tuple[str, ...], speed_is: str) -> None:
    """Also where the wind changes on the way, and where the path is flown at its airspeed."""
    trajectory = scenario(*settings, f"approach.speed_is={speed_is}").trajectory()
    step = 1e-4
    ahead, behind, here = (trajectory.motion(T + d) for d in (step, -step, 0.0))
    change = (ahead.c_eb - behind.c_eb) / (2.0 * step)
    turn = np.einsum("nji,njk->nik", here.c_eb, change)
    against_earth = here.angular_rate - here.c_eb.swapaxes(1, 2) @ [0.0, 0.0, earth.RATE]
    found = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
    np.testing.assert_allclose(found, against_earth, atol=2e-6)


@pytest.mark.parametrize("name", ["landing", "landing_smooth", "s_turn"])
def test_the_airspeed_is_held(name: str) -> None:
    """Everywhere on the path, which stays where it was; without wind nothing changes."""
    flown = scenario(*LOG, "approach.speed_is=air", name=name)
    trajectory, given = flown.trajectory(), flown.approach.path()
    path = trajectory.path
    assert isinstance(path, Retimed)
    t = np.linspace(0.0, flown.duration_s, 2001)
    jet, own = path.jet(t), path._own(t)[:, 0]
    np.testing.assert_allclose(jet[:, 0], given.jet(own)[:, 0], atol=1e-9)
    airspeed = np.linalg.norm(jet[:, 1] - trajectory.wind.mean(t), axis=1)
    np.testing.assert_allclose(airspeed, np.linalg.norm(given.jet(own)[:, 1], axis=1), atol=1e-3)
    for order in range(3):  # each derivative is that of the one before
        found = (path.jet(T + 1e-5)[:, order] - path.jet(T - 1e-5)[:, order]) / 2e-5
        np.testing.assert_allclose(found, path.jet(T)[:, order + 1], atol=2e-4)
    for event, time in path.events.items():
        if time < flown.duration_s:
            assert path._own(np.array([time]))[0, 0] == pytest.approx(given.events[event], abs=1e-9)
    still = scenario("approach.speed_is=air", "wind.speed_m_s=0", name=name).trajectory()
    np.testing.assert_array_equal(still.path.jet(t), given.jet(t))


def test_triangle_along_a_flight() -> None:
    """A wind from the left of the course holds the nose left of it."""
    trajectory = scenario("runway.heading_deg=0", "wind.speed_m_s=5", "wind.from_deg=300").trajectory()
    found = air.triangle_along(trajectory, np.array([1.0]))
    assert found.headwind[0] == pytest.approx(2.5)
    assert found.crosswind[0] == pytest.approx(5.0 * np.sin(np.radians(60.0)))
    assert found.crab[0] < 0.0


@pytest.mark.parametrize(
    ("settings", "key", "said"),
    [
        (("wind.exponent=0.2",), "wind.exponent", "power"),
        (("wind.profile=table",), "wind.levels", "two levels"),
        ((LEVELS[0], LEVELS[1], "wind.speed_m_s=3"), "wind.speed_m_s", "levels"),
        (("wind.profile=table", "wind.levels=[{height_m: 9, speed_m_s: 1, from_deg: 0}, "
          "{height_m: 3, speed_m_s: 1, from_deg: 0}]"), "height_m", "rise"),
        ((*LOG, "approach.start_height_m=400"), "wind.profile", "304.8"),
        (("approach.speed_is=air", "wind.speed_m_s=40", "wind.from_deg=90"), "wind.speed_m_s", "cannot be flown"),
        (("approach.speed_is=air", "wind.speed_m_s=21.5", "wind.from_deg=0", "runway.heading_deg=0", "duration_s=400"),
         "wind.speed_m_s", "2 m/s"),
    ],
)  # fmt: skip
def test_what_is_refused(settings: tuple[str, ...], key: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        scenario(*settings)
    assert key in str(caught.value)
    assert said in str(caught.value)
