"""Wind from behind, gusts and turbulence that are faster than the aircraft: refused with place and value."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from navsim.runner.errors import BadInput
from navsim.runner.opening import checked
from navsim.scenario_files.source import InputError
from navsim.trajectory import air
from tests.conftest import SCENARIOS
from tests.helpers import case, scenario

PROFILES = ("landing", "landing_smooth", "circuit", "s_turn")
TAIL = "wind.from_deg={}"


def runway_heading(name: str) -> float:
    return scenario(name=name).runway.heading_deg


@pytest.mark.parametrize("name", PROFILES)
def test_wind_from_behind_is_no_faster_than_the_aircraft(name: str) -> None:
    """The message has the time, the wind along the course, the speed over ground and the airspeed; what passes flies
    nose first everywhere."""
    behind = f"wind.from_deg={(runway_heading(name) + 180.0) % 360.0}"
    with pytest.raises(InputError, match=r"wind\.speed_m_s.*airspeed ahead would be -?\d+\.\d m/s") as caught:
        scenario(behind, "wind.speed_m_s=50", "wind.profile=constant", name=name)
    said = r"at (\S+) s the wind blows with (\S+) m/s along the course.* at (\S+) m/s over"
    found = re.search(said, str(caught.value))
    assert found
    _, wind, speed = map(float, found.groups())
    assert speed - wind < 2.0
    flown = scenario(behind, "wind.speed_m_s=8", "wind.profile=constant", name=name).trajectory()
    triangle = air.triangle_along(flown, np.arange(0.0, 60.0, 0.5))
    assert (np.abs(triangle.crab) < np.pi / 2.0).all()


def test_the_bound_is_that_of_the_slowest_moment() -> None:
    """Touchdown at 22.2 m/s: wind of 20.1 m/s leaves 2.1 m/s of airspeed, 20.3 m/s does not leave 2."""
    behind = ("wind.from_deg=180", "runway.heading_deg=0")
    scenario(*behind, "wind.speed_m_s=20.1")
    with pytest.raises(InputError, match=r"20\.3 m/s along the course"):
        scenario(*behind, "wind.speed_m_s=20.3")


def test_held_airspeed_may_have_any_wind_from_behind() -> None:
    flown = scenario("wind.from_deg=180", "runway.heading_deg=0", "wind.speed_m_s=50", "approach.speed_is=air")
    triangle = air.triangle_along(flown.trajectory(), np.arange(0.0, 15.0, 0.5))
    assert (np.abs(triangle.crab) < 0.1).all()


def test_shear_is_looked_at_all_along() -> None:
    """Weak on the ground, too strong 100 m up; the levels are blamed."""
    levels = "wind.levels=[{height_m: 0, speed_m_s: 2, from_deg: 180}, {height_m: 100, speed_m_s: 40, from_deg: 180}]"
    with pytest.raises(InputError, match=r"wind\.levels: at .* s the wind blows with 40\.0"):
        scenario("wind.profile=table", levels, "runway.heading_deg=0")


def gust(amplitude: float, start: float, more: str = "ramp_s: 2", towards: str = "along") -> str:
    return f"{{amplitude_m_s: {amplitude}, towards: {towards}, start_s: {start}, {more}}}"


REFUSED = [
    ([gust(-50, 10)] * 20, "wind.gusts", "gusts of 1000.0 m/s"),
    ([gust(-50, 10)], "wind.gusts", "gusts of 50.0 m/s"),
    ([gust(50, 10, "ramp_m: 5, hold_s: 0", "up")], "wind.gusts", "gusts of 50.0 m/s"),
    ([gust(30, 10, "ramp_s: 0.1, hold_s: 0", "right")] * 2, "wind.gusts", "gusts of 60.0 m/s"),
    ([gust(18, 10, towards="north"), gust(18, 11, towards="east"), gust(18, 12, towards="up")], "wind.gusts", "31.2"),
]
PASSED = [
    [gust(18, 5, "ramp_s: 1, hold_s: 1"), gust(18, 20, "ramp_s: 1, hold_s: 1")],
    [gust(-18, 5), gust(18, 5)],
    [gust(-50, 110)],
]


@pytest.mark.parametrize(("gusts", "key", "said"), REFUSED)
@pytest.mark.parametrize("name", ["landing", "landing_smooth"])
def test_gusts_are_slower_than_the_aircraft(name: str, gusts: list[str], key: str, said: str) -> None:
    """The sum of those that blow at the same time, in all directions."""
    settings = [f"wind.gusts=[{', '.join(gusts)}]", "wind.speed_m_s=0"]
    with pytest.raises(BadInput) as caught:
        checked(SCENARIOS / f"{name}.yaml", settings)
    (problem,) = caught.value.problems
    assert problem.key == key
    assert said in problem.message
    assert re.search(r"at \d+\.\d s there are .*and the airspeed is \d+\.\d m/s", problem.message)


@pytest.mark.parametrize("gusts", PASSED)
def test_gusts_one_after_another_and_on_the_ground(gusts: list[str]) -> None:
    """Those of the ground do not count: at 110 s landing_smooth rolls."""
    scenario(f"wind.gusts=[{', '.join(gusts)}]", "duration_s=120", name="landing_smooth")


def test_turbulence_counts_by_three_sigma() -> None:
    """sigma_u = 0.2 W20 near the ground: 3 sigma of 50 m/s are 29 m/s, those of `severe` 14 m/s."""
    scenario("wind.turbulence={severity: severe}")
    with pytest.raises(InputError, match=r"wind\.turbulence: at .* turbulence of 2\d\.\d m/s \(3 sigma\)"):
        scenario("wind.turbulence={w20_m_s: 50}")
    with pytest.raises(InputError, match=r"gusts of 15\.0 m/s and turbulence of"):
        scenario("wind.turbulence={severity: severe}", f"wind.gusts=[{gust(15, 50)}]")


def test_a_planned_track_in_wind(tmp_path: Path) -> None:
    """A table without attitudes takes them from the wind; the scenario's track lands at 30 degrees."""
    with pytest.raises(InputError, match=r"wind\.speed_m_s: at .* along the course"):
        case("wind.speed_m_s=50", "wind.from_deg=210", name="track")
