"""Published data of runways: aim points, declinations, directions between thresholds."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
import types
from typing import Any

import numpy as np
import pytest
from pymap3d.vincenty import vdist

from navsim.geodesy.earth import llh_from_ecef
from navsim.geodesy.magnetic import declination, field_ned
from navsim.scenario.aerodrome import between
from navsim.scenario_files.source import InputError
from tests.conftest import DATA, Within
from tests.helpers import case, scenario

HAS_FIELD = importlib.util.find_spec("pygeomag") is not None
ODENSE = ((55.479801177978516, 10.340499877929688), (55.471500396728516, 10.315299987792969))
"""Thresholds 24 and 06 of EKOD, as OurAirports' runways.csv has them, whose heading of 24 is 239.8 deg."""


def published() -> dict[str, Any]:
    return dict(json.loads((DATA / "paths.json").read_text()))


def point(place: tuple[float, float]) -> str:
    return f"{{lat_deg: {place[0]!r}, lon_deg: {place[1]!r}}}"


BOTH = f"runway={{threshold: {point(ODENSE[0])}, end: {point(ODENSE[1])}%s}}"


@pytest.mark.validates("Distance of the aim point by the threshold crossing height", "formula: TCH / tan(glide)",
                       distance="5e-3 m")  # fmt: skip
@pytest.mark.parametrize("glide", [3, 5])
def test_aim_point(glide: int, within: Within) -> None:
    given = published()["runway"]
    landing = scenario(f"runway.tch_m={given['tch_m']}", f"approach.glide_slope_deg={glide}")
    assert landing.runway.aim_point_m == pytest.approx(given[f"aim_{glide}deg_m"], abs=within["distance"])
    # the line down the slope passes the threshold at that height
    frame = landing.trajectory().frame
    up = -((0.0 - landing.runway.aim_point_m) * math.tan(math.radians(glide)))
    assert up == pytest.approx(given["tch_m"])
    assert frame is not None


@pytest.mark.validates("Magnetic fields", "test values of WMM2020 (NOAA, December 2019)", field="6e-5 uT")
def test_magnetic_field(within: Within) -> None:
    """Rows of the published table at 2020.0: north, east, down, nT."""
    if not HAS_FIELD:
        pytest.skip("the extra `magnetic` (pygeomag) is not installed")
    for lat, lon, published in ((80.0, 0.0, (6570.4, -146.3, 54606.0)), (0.0, 120.0, (39624.3, 109.9, -10932.5))):
        found = field_ned(lat, lon, 0.0, 2020.0)
        np.testing.assert_allclose(found, 1e-3 * np.array(published), atol=within["field"], rtol=0.0)


@pytest.mark.validates("Magnetic declinations", "pygeomag 1.1.0 with WMM2015v2, WMM2020, WMM2025", angle="1e-3 deg")
def test_declinations(within: Within) -> None:
    if not HAS_FIELD:
        pytest.skip("the extra `magnetic` (pygeomag) is not installed")
    for lat, lon, height, year, expected in published()["magnetic_declination"]["rows"]:
        assert declination(lat, lon, 1000.0 * height, year) == pytest.approx(expected, abs=within["angle"])


@pytest.mark.validates("Runway direction by its two thresholds", "pymap3d's geodesics; OurAirports' heading",
                       angle="1e-4 deg")  # fmt: skip
def test_direction_between_thresholds(within: Within) -> None:
    _, azimuth = vdist(*ODENSE[0], *ODENSE[1])
    found = between(*ODENSE)
    assert found == pytest.approx(float(azimuth), abs=within["angle"])
    assert found == pytest.approx(239.8, abs=0.15)


def test_thresholds_overrule_what_is_published() -> None:
    """A wrong direction is warned of beyond 1 deg, and the stored scenario reads back to the same."""
    flown = between(*ODENSE)
    for printed, warned in ((239.0, False), (241.5, True)):
        for extra in (f", heading_deg: {printed}", f", bearing_deg: {printed}"):
            ready = case("approach={profile: paper}", BOTH % extra, "pseudolites={count: 0}")
            assert ready.scenario.runway.heading_deg == flown
            assert any("published direction is" in text for text in ready.warnings) == warned
            again = type(ready.scenario).model_validate(ready.scenario.model_dump(mode="json", exclude_none=True))
            assert again == ready.scenario


SLOPING = ("runway.slope_percent=1.5", "runway.height_m=14", "runway.aim_point_m=200", "pseudolites={count: 0}")


def test_the_runway_rises() -> None:
    """The touchdown point lies higher, and what rolls on stays on the surface, by the ground that a radio altimeter
    meets; a slope of nothing changes nothing."""
    taxiing = ("approach.taxi_speed_kmh=18", "approach.rollout_deceleration_m_s2=2.5")
    for name, taxi in (("landing", ()), ("landing_smooth", taxiing)):
        landing = scenario(*SLOPING, *taxi, "radio_altimeter={sigma_floor_m: 0.1}", name=name)
        trajectory = landing.trajectory()
        touchdown = trajectory.path.events["touchdown"]
        after = trajectory.motion(touchdown + np.linspace(1.5, 12.0, 22))
        x, y, z = np.transpose((after.position_ecef - trajectory.frame.origin) @ trajectory.frame.axes)
        np.testing.assert_allclose(-z / x, 0.015, rtol=1e-9)
        assert not np.any(np.abs(y) > 1e-9)
        assert llh_from_ecef(trajectory.frame.origin)[2] == pytest.approx(14.0 + 3.0, abs=1e-6)
        np.testing.assert_allclose(after.rpy[:, 1], math.atan(0.015) + math.radians(3.0), atol=2e-4)
        (radio,) = landing.aiding()
        above = radio.exact(trajectory.frame, after)
        np.testing.assert_allclose(above, x**2 / (2.0 * 6.378e6), atol=1e-4)  # the earth bends away from the plane


@pytest.mark.parametrize("slope", [-3.0, -1.0, 0.0, 1.5])
def test_a_flare_comes_down_to_the_surface(slope: float) -> None:
    """Never below it but for what the gear takes up, and with the sink rate that is asked for, against it; the wind is
    by the height above it, and what is flown stays smooth."""
    wind = ("wind={speed_m_s: 8, from_deg: 0, profile: log}",)
    landing = scenario(*SLOPING, f"runway.slope_percent={slope}", *wind, name="landing_smooth")
    path, rise = landing.path(), 0.01 * slope
    down = path.events["touchdown"]
    jet = path.jet(np.linspace(path.events["flare"] + 1.0, down, 400))
    height, sink = -jet[:, 0, 2] - rise * jet[:, 0, 0], jet[:, 1, 2] + rise * jet[:, 1, 0]
    assert height.min() > -1e-9
    assert sink.min() > 0.5 - 1e-6
    assert sink[-1] == pytest.approx(0.5, abs=1e-6)
    after = path.jet(np.linspace(down, down + 3.0, 300))
    assert -0.11 < (-after[:, 0, 2] - rise * after[:, 0, 0]).min() <= 0.0
    for knot in path.knots:  # to the acceleration
        np.testing.assert_allclose(*(path.jet(np.array([knot + d]))[0, :3] for d in (-1e-10, 1e-10)), atol=1e-7)
    rolled = landing.trajectory().wind.mean(np.array([down + 15.0]))
    np.testing.assert_allclose(rolled, scenario(*SLOPING, "runway.slope_percent=0", *wind, name="landing_smooth")
                               .trajectory().wind.mean(np.array([down + 15.0])), rtol=1e-3)  # fmt: skip


def test_a_runway_that_rises_faster_than_the_aircraft_sinks() -> None:
    with pytest.raises(InputError, match=r"rises under the aircraft by 0\.89 m/s, no less than it is to sink"):
        scenario("runway.slope_percent=4", name="landing_smooth")


def test_slope_from_both_ends() -> None:
    """By the way between thresholds (pymap3d); with it the line down the slope passes the threshold at its height."""
    length, _ = vdist(*ODENSE[0], *ODENSE[1])
    both = BOTH % ", height_m: 14, end_height_m: 17.5, tch_m: 15.24"
    landing = scenario("approach={profile: paper, glide_slope_deg: 4}", both, "pseudolites={count: 0}")
    assert landing.runway.slope_percent == pytest.approx(100.0 * 3.5 / float(length), rel=1e-4)
    assert landing.runway.surface[1] == pytest.approx((float(length), 3.5), rel=1e-4)
    assert landing.runway.length_m == pytest.approx(float(length), rel=1e-4)
    aim = landing.runway.aim_point_m
    assert aim * math.tan(math.radians(4.0)) + landing.runway.rise_m == pytest.approx(15.24)
    again = type(landing).model_validate(landing.model_dump(mode="json", exclude_none=True))
    assert again == landing


def test_a_magnetic_bearing(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = ("runway={bearing_deg: 355, bearing_is: magnetic}",)
    assert scenario(*settings, "runway.declination_deg=11.2").runway.heading_deg == pytest.approx(6.2)
    seen: list[Any] = []

    class GeoMag:
        def __init__(self, base_year: float) -> None:
            seen.append(base_year)

        def calculate(self, glat: float, glon: float, alt: float, time: float) -> Any:
            seen.append((glat, glon, alt, time))
            return types.SimpleNamespace(d=11.2434)

    model = types.ModuleType("pygeomag")
    model.GeoMag = GeoMag
    monkeypatch.setitem(sys.modules, "pygeomag", model)
    auto = scenario(*settings, "runway.declination_deg=auto", "runway.bearing_year=2018.5", "runway.height_m=150")
    assert (auto.runway.declination_deg, auto.runway.heading_deg) == (11.243, pytest.approx(6.243))
    assert seen == [2018.5, (56.0, 37.0, 0.15, 2018.5)]
    assert scenario(*settings, "runway.declination_deg=auto") is not None
    assert seen[-2] == pytest.approx(2018.7, abs=0.01)
    monkeypatch.setitem(sys.modules, "pygeomag", None)
    with pytest.raises(InputError, match=r"\.\[magnetic\]"):
        scenario(*settings, "runway.declination_deg=auto")


@pytest.mark.parametrize(
    ("settings", "place", "words"),
    [
        (("runway.bearing_deg=355", "runway.bearing_is=magnetic"), "runway.declination_deg", "needs the declination"),
        (("runway.declination_deg=3",), "runway.declination_deg", "give bearing_deg"),
        (("runway.heading_deg=240", "runway.bearing_is=magnetic"), "runway.bearing_is", "as bearing_deg, with declin"),
        (("runway.bearing_deg=5", "runway.heading_deg=7"), "runway.heading_deg", "is 5 by bearing_deg"),
        (("runway.tch_m=15.24", "runway.aim_point_m=300"), "runway.aim_point_m", "is 174.194 by tch_m"),
        ((f"runway.end={point(ODENSE[0])}",), "runway.end", "give runway.threshold"),
        (("runway.end_height_m=20",), "runway.end_height_m", "give runway.end"),
        (
            ("approach={profile: paper}", BOTH % ", height_m: 0, end_height_m: 3.5, slope_percent: 1"),
            "runway.slope_percent",
            "by end_height_m",
        ),
        (("runway.slope_percent=6",), "runway.slope_percent", "must be at most 5 %"),
        (
            ("approach={profile: paper}", BOTH % ", height_m: 14, end_height_m: 300"),
            "runway.end_height_m",
            "a slope of",
        ),
        (("approach={profile: paper}", BOTH % ", end_height_m: 14"), "runway.end_height_m", "give runway.height_m"),
        (("runway.tch_m=15", "approach.glide_slope_deg=2", "runway.slope_percent=-5"), "runway.tch_m", "does not meet"),
    ],
)
def test_what_does_not_go_together(settings: tuple[str, ...], place: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        scenario(*settings)
    assert place in {problem.key for problem in refused.value.problems}


def test_numbers_of_a_real_runway_are_not_assumed_silently() -> None:
    """A runway with a position has a direction and a height; defaults of the paper's abstract runway are not its."""
    threshold = f"threshold: {point(ODENSE[0])}"
    settings = ("approach.start=~", "pseudolites={count: 0}")
    bare = case(*settings, f"runway={{{threshold}}}").warnings
    assert [text.partition(" is not given")[0] for text in bare[:2]] == ["runway.heading_deg", "runway.height_m"]
    given = case(*settings, f"runway={{{threshold}, end: {point(ODENSE[1])}, height_m: 14}}").warnings
    assert not any("is not given" in text for text in given)


def test_a_real_aerodrome() -> None:
    """The shipped plan: direction, aim point and heights of its published data; its pseudolite is not too near."""
    ready = case(name="odense")
    # PL1 is passed at 261 m with a position sigma of 3.9 m across the line of sight. The filter knows errors of ranges
    # to second order, so a warning is due only from 0.1 of the distance on, 26 m
    assert not ready.warnings
    runway = ready.scenario.runway
    assert runway.heading_deg == pytest.approx(239.9, abs=0.01)
    assert runway.aim_point_m == pytest.approx(15.24 / math.tan(math.radians(4.5)), abs=1e-9)
    threshold = ready.scenario.threshold(ready.trajectory.frame)
    assert threshold[2] == pytest.approx(14.0 + 39.41, abs=1e-9)
    assert [math.degrees(each) for each in threshold[:2]] == pytest.approx([55.4798, 10.3405], abs=1e-7)
    assert {name[0] for name in ready.environment.names if name != "PL1"} == {"E", "G"}
