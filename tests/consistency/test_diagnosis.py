"""The diagnosis of recordings: each usual mistake named, with what to write; nothing said of recordings in order."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from navsim.cli.main import app
from navsim.formats import conventions
from navsim.formats.conventions import BODY_AXES, GnssConvention, ImuConvention
from navsim.formats.recorded_data import Fixes, Samples
from navsim.formats.recording import read_fixes, read_imu
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.logs.reading import read_logs
from navsim.logs.tables import log_files
from navsim.recording_checks.diagnosis import NEVER_JUDGED, diagnose, examine
from navsim.recording_checks.fix_checks import interpretations, lag_of_velocities
from navsim.recording_checks.mistakes import Log
from navsim.recording_checks.wild_fixes import plausible
from navsim.replays import study as replay
from navsim.scenario.load import read_replay
from navsim.scenario_files.source import InputError
from tests.helpers import in_brief
from tests.mistakes import MISTAKES, Made
from tests.recordings import circuit, drive, hills, quadrotor, record, ride, straight
from tests.recordings import write_recording as table

ROOT = Path(__file__).resolve().parents[2]
BY_NAME = {made.name: made for made in MISTAKES}
SEEDS = (11, pytest.param(12, marks=pytest.mark.long))
"""Of recordings in which nothing is to be found."""


@cache
def aircraft() -> tuple[Samples, Fixes]:
    return record(circuit(), 1)


@cache
def car() -> tuple[Samples, Fixes]:
    return record(drive(), 1, velocities="horizontal")


@cache
def level() -> tuple[Samples, Fixes]:
    return record(straight(), 1)


def named(made: Made, recording: tuple[Samples, Fixes]) -> list[Any]:
    """The mistakes found, each as its remedies."""
    return [mistake.remedies for mistake in diagnose(Log(*made.make(*recording)))]


def test_the_table_is_long_enough() -> None:
    assert len(MISTAKES) >= 35
    assert len({str(made.remedy) for made in MISTAKES}) >= 35


@pytest.mark.parametrize("name", in_brief(BY_NAME, *range(0, len(BY_NAME), 9)))
def test_each_mistake_of_a_flight_is_named(name: str) -> None:
    assert named(BY_NAME[name], aircraft()) == [(BY_NAME[name].remedy,)]


@pytest.mark.parametrize(
    "name",
    in_brief(["FLU for FRD", "gyro in deg/s", "accelerometer y negated", "radians", "speed in knots",
              "latitude and longitude", "GPS time for UTC", "accelerometer's sign"], 2, 5),
)  # fmt: skip
def test_each_mistake_of_a_drive_is_named(name: str) -> None:
    assert named(BY_NAME[name], car()) == [(BY_NAME[name].remedy,)]


@pytest.mark.parametrize("name", in_brief(["FLU for FRD", "gyro z negated", "radians", "latitude and longitude"], 1, 3))
def test_mistakes_show_without_velocities(name: str) -> None:
    samples, fixes = aircraft()
    fixes = replace(fixes, velocity=np.full_like(fixes.velocity, np.nan))
    assert named(BY_NAME[name], (samples, fixes)) == [(BY_NAME[name].remedy,)]


def test_two_mistakes_are_both_named() -> None:
    samples, fixes = BY_NAME["accelerometer in g"].make(*BY_NAME["speed in km/h"].make(*aircraft()))
    found = diagnose(Log(*BY_NAME["FLU for FRD"].make(samples, fixes)))
    assert [m.remedies for m in found] == [
        ({"imu.accelerometer_unit": "g"},), ({"gnss.speed_unit": "km/h"},), ({"imu.axes": "FLU"},)
    ]  # fmt: skip


def test_a_mistake_is_told_in_numbers_with_the_line_to_write() -> None:
    (found,) = diagnose(Log(*BY_NAME["accelerometer in g"].make(*aircraft())))
    assert str(found) == (
        "the mean specific force is 1.019 where gravity is 9.8 m/s2: the accelerometers seem to be in g; write "
        "`imu: {accelerometer_unit: g}`"
    )
    (found,) = diagnose(Log(*BY_NAME["GPS time for UTC"].make(*aircraft())))
    assert "GPS time is 18 s from UTC" in str(found)
    assert "`gnss: {time_offset_s: -18.0}`" in str(found)


def test_what_a_straight_flight_cannot_tell_is_left_open() -> None:
    """Upside down it is for certain, but without a turn one mistake is as good as another; of the gyros it shows
    nothing."""
    (found,) = named(BY_NAME["FLU for FRD"], level())
    assert {"imu.axes": "FLU"} in found
    assert {"imu.accelerometer_axes": "BLU"} in found
    for name in ("gyro z negated", "gyro x and y", "GPS time for UTC", "vertical sign", "accelerometer y negated"):
        assert named(BY_NAME[name], level()) == [], name
    (either,) = named(BY_NAME["vn and ve"], level())
    assert either == ({"gnss.velocity_axes": "END"}, {"gnss.velocity_axes": "ENU"})


@pytest.mark.parametrize("ride", ["circuit", "circuit at once", "drive", "straight", "straight for longer"])
@pytest.mark.parametrize("grade", in_brief(["fine", "poor", "worse"], 2))
@pytest.mark.parametrize("seed", SEEDS)
def test_recordings_in_order_raise_no_alarm(seed: int, ride: str, grade: str) -> None:
    """Gyros up to 700 deg/h and accelerometers up to 10 mg (1 sigma), receivers of all kinds."""
    path = {"circuit": circuit, "circuit at once": lambda: circuit(0.0), "drive": drive, "straight": straight,
            "straight for longer": lambda: straight(100.0)}[ride]()  # fmt: skip
    sensors: dict[str, Any] = {
        "fine": {"gyro_bias": 1e-5, "accel_bias": 1e-3, "gyro_noise": 1e-4, "velocity_noise": 0.03, "rate": 100.0},
        "poor": {"gyro_bias": 3.4e-3, "accel_bias": 0.1, "velocities": "horizontal", "latency": 0.5},
        "worse": {"gyro_bias": 3.4e-3, "accel_bias": 0.1, "accel_noise": 0.5, "position_noise": 2.5,
                  "velocities": "none", "fix_rate": 5.0},
    }[grade]  # fmt: skip
    assert diagnose(Log(*record(path, seed, **sensors))) == []


@cache
def hilly() -> tuple[Samples, Fixes]:
    """Climbs of 8 m, heights that wander by 2 m: single pieces tell little, all of them enough."""
    return record(hills(), 3, rate=20.0, position_noise=1.4)


def of_fixes(fixes: Fixes, gnss: GnssConvention = conventions.GNSS_AS_DUE) -> list[Any]:
    """The remedies of what positions and velocities show."""
    return [mistake.remedies for mistake in interpretations(Log(hilly()[0], fixes, gnss=gnss), [])[0]]


def test_noisy_heights_show_their_unit_and_the_sign_of_the_vertical_velocity() -> None:
    fixes = hilly()[1]
    assert of_fixes(fixes) == []
    feet = replace(fixes, llh=fixes.llh / [1.0, 1.0, 0.3048])
    assert of_fixes(feet) == [({"gnss.height_unit": "ft"},)]
    climb = replace(fixes, velocity=fixes.velocity * [1.0, 1.0, -1.0])
    assert of_fixes(climb) == [({"gnss.velocity_axes": "NEU"},)]


def test_units_of_speed_that_are_near_each_other() -> None:
    """Knots in a log that says miles an hour, and the other way."""
    fixes = hilly()[1]
    ratio = conventions.KNOT / conventions.SPEED_UNITS["mph"]
    for written, due, factor in (("mph", "kn", 1.0 / ratio), ("kn", "mph", ratio)):
        wrong = replace(fixes, velocity=factor * fixes.velocity * [1.0, 1.0, np.nan])
        assert of_fixes(wrong, GnssConvention(speed_unit=written)) == [({"gnss.speed_unit": due},)]


@pytest.mark.parametrize(
    ("given", "late", "remedies"),
    [
        (5.0, 0.0, ({"gnss.latency_s": 0.1}, {"gnss.time_offset_s": 5.0})),
        (0.1, 1.5, ({"gnss.time_offset_s": -1.5}, {"gnss.latency_s": 1.6})),
        (0.1, -1.5, ({"gnss.time_offset_s": 1.5},)),
    ],
)
def test_a_latency_and_the_clocks_are_both_named(given: float, late: float, remedies: tuple[Any, ...]) -> None:
    """The motion shows only their sum: a latency as receivers have it comes first, else the clocks."""
    samples, fixes = aircraft()
    (found,) = diagnose(Log(samples, replace(fixes, time=fixes.time + late), latency=given))
    assert found.remedies == remedies
    assert (f"a latency of {0.1 + late:g} s, not of {given:g} s" in str(found)) == (len(remedies) == 2)


def test_clocks_that_do_not_meet() -> None:
    samples, fixes = aircraft()
    (found,) = diagnose(Log(samples, replace(fixes, time=fixes.time + 1.4e9)))
    assert "no common time" in str(found)
    assert found.remedies[0]["gnss.time_offset_s"] == pytest.approx(-1.4e9, abs=2.0)
    begun = fixes.take(fixes.time > samples.time[0] + 0.6)  # their first one belongs to a later sample than the first
    (found,) = diagnose(Log(samples, replace(begun, time=begun.time + 1.4e9)))
    assert found.remedies == ({"gnss.time_offset_s": -1.4e9},)


def test_an_offset_within_the_latency_is_no_mistake_unless_the_latency_is_given() -> None:
    samples, fixes = aircraft()
    late = replace(fixes, time=fixes.time + 1.4)
    assert diagnose(Log(samples, late)) == []
    (found,) = diagnose(Log(samples, late, latency=0.1))
    assert found.remedies == ({"gnss.time_offset_s": -1.4}, {"gnss.latency_s": 1.5})


@cache
def weaving() -> tuple[Samples, Fixes]:
    """The shipped flight: turns that repeat themselves every 30 s."""
    data = ROOT / "scenarios" / "data"
    return read_imu(data / "flight_imu.csv.gz")[0], read_fixes(data / "flight_gnss.csv")[0]


@pytest.mark.parametrize(("begin", "length"), in_brief([(20.0, 40.0), (60.0, 25.0), (60.0, 10.0), (75.0, 25.0)], 2))
def test_a_gap_of_the_fixes_is_no_offset_of_the_clocks(begin: float, length: float) -> None:
    """However few windows are left around it: in a flight that repeats itself they fit elsewhere as well."""
    samples, fixes = weaving()
    fixes = fixes.take((fixes.time < begin) | (fixes.time > begin + length))
    for first in (-np.inf, begin - 10.0, begin, begin + length - 5.0, begin + length + 8.0):
        assert diagnose(Log(samples, fixes, first=first)) == []


def test_offsets_that_fit_as_well_are_named_together() -> None:
    samples, fixes = weaving()
    for kept in (fixes.time > 0.0, (fixes.time < 60.0) | (fixes.time > 85.0)):
        late = replace(fixes, time=fixes.time + 18.0).take(kept)
        (found,) = diagnose(Log(samples, late))
        assert {each["gnss.time_offset_s"] for each in found.remedies} == {-18.0, 12.0}


@pytest.mark.parametrize(
    "name",
    in_brief(["RFU for FRD", "mounted backwards", "gyro's sign", "gyro x negated", "gyro z negated", "gyro x and y",
              "GPS time for UTC", "a second early"], 0, 6),
)  # fmt: skip
def test_noisy_heights_do_not_hide_what_horizontal_velocities_show(name: str) -> None:
    """Without vertical velocities, as NMEA is, in shallow turns: changes of height scatter by metres a second."""
    samples, fixes = weaving()
    made = BY_NAME[name]
    (remedies,) = named(made, (samples, replace(fixes, velocity=fixes.velocity * [1.0, 1.0, np.nan])))
    assert made.remedy in remedies
    assert all(each.keys() == made.remedy.keys() for each in remedies)


# --- slow flights

SHOWN_AT_WALKING_PACE = (
    "FLU for FRD", "accelerometer's sign", "accelerometer x negated", "accelerometer y negated",
    "accelerometer z negated", "accelerometer x and y", "accelerometer x and z", "accelerometer in g", "gyro's sign",
    "gyro z negated", "gyro x and y", "gyro y and z", "gyro in deg/s", "radians", "latitude and longitude",
    "height in feet", "vertical sign", "vn and ve", "ENU for NED", "speed in km/h", "speed in knots",
    "GPS time for UTC",
)  # fmt: skip


@cache
def drone() -> tuple[Samples, Fixes]:
    return record(quadrotor(), 1, fix_rate=5.0, velocity_noise=0.05, position_noise=0.5)


@pytest.mark.parametrize("name", in_brief(SHOWN_AT_WALKING_PACE, 4, 9, 17))
def test_each_mistake_of_a_slow_flight_is_named(name: str) -> None:
    """No fix is faster than 2.5 m/s, the drone hovers for half of the time, and its nose points anywhere."""
    assert np.nanmax(np.linalg.norm(drone()[1].velocity[:, :2], axis=1)) < 2.5
    assert named(BY_NAME[name], drone()) == [(BY_NAME[name].remedy,)]


@pytest.mark.parametrize("velocities", in_brief(["ned", "horizontal", "none"], 2))
@pytest.mark.parametrize("seed", SEEDS)
def test_a_slow_flight_in_order_raises_no_alarm(seed: int, velocities: Any) -> None:
    """Parked for the most part, too, by a receiver whose positions wander."""
    for poor in ({}, {"position_noise": 3.0, "velocity_noise": 0.2, "accel_bias": 0.1}):
        samples, fixes = record(quadrotor(), seed, velocities=velocities, **poor)
        assert diagnose(Log(samples, fixes)) == []
        assert diagnose(Log(samples.between(0.0, 45.0), fixes.take(fixes.time < 45.0))) == []


def test_a_usual_mistake_that_fits_worse_is_not_named_alone() -> None:
    """Columns x and y of both triads exchanged, in a noisy hover: seen before, one reversed axis of the gyros alone."""
    samples, fixes = record(
        quadrotor(110.0), 77, rate=60.0, fix_rate=5.0, velocity_noise=0.15, gyro_bias=0.001, accel_bias=0.03
    )
    order = [1, 0, 2]
    (found,) = diagnose(Log(replace(samples, rate=samples.rate[:, order], force=samples.force[:, order]), fixes))
    assert found.remedies[0].keys() == {"imu.axes"}


def test_what_cannot_be_judged_is_listed() -> None:
    assert examine(Log(*aircraft())).not_judged == [NEVER_JUDGED]
    _, nose = examine(Log(*drone())).not_judged
    assert nose.startswith("another horizontal axis forward: ")
    samples, fixes = drone()
    _, vertical, motion = examine(Log(samples, replace(fixes, velocity=fixes.velocity * [1.0, 1.0, np.nan]))).not_judged
    assert vertical == "sign of the vertical velocity, unit of the height: the fixes have no such velocity"
    assert motion == nose.replace(":", ", heights in ft:", 1)
    _, horizontal, _, sensors = examine(Log(samples.between(0.0, 15.0), fixes.take(fixes.time < 15.0))).not_judged
    assert horizontal.startswith("unit and axes of the horizontal velocity, unit of the angles: fewer than three")
    assert sensors.startswith("signs, columns and axes of the sensors, unit of the gyros, clocks: fewer than two")
    straight_on = "; ".join(examine(Log(*level())).not_judged)
    for name in ("the gyro's z axis reversed", "the columns x and y of the gyros exchanged", "clock offsets",
                 "sign of the vertical velocity", "the accelerometer's y axis reversed"):  # fmt: skip
        assert name in straight_on, name


@pytest.mark.parametrize(("heading", "name"), [(0.04, "longitude"), (1.53, "latitude")])
def test_a_way_along_a_meridian_or_parallel_does_not_show_one_sign(heading: float, name: str) -> None:
    """A car on a motorway for a minute; wrong or right, the sign is listed."""
    path = ride(60.0, lambda t: np.full_like(t, 25.0), np.zeros_like, np.zeros_like, heading=heading)
    samples, fixes = record(path, 1, rate=10.0)
    for sign in (1.0, -1.0):
        mirror = np.where(np.array(["latitude", "longitude", ""]) == name, sign, 1.0)
        found = examine(Log(samples, replace(fixes, llh=fixes.llh * mirror)))
        assert found.mistakes == []
        assert [each[: each.index(":")] for each in found.not_judged if each.startswith("sign of the l")] == [
            f"sign of the {name}"
        ]


def test_velocities_are_judged_where_some_are_missing() -> None:
    samples, fixes = BY_NAME["speed in knots"].make(*aircraft())
    some = np.where(np.arange(fixes.time.size)[:, None] % 20 == 7, np.nan, fixes.velocity)
    (found,) = diagnose(Log(samples, replace(fixes, velocity=some)))
    assert found.remedies == ({"gnss.speed_unit": "kn"},)


# --- wild fixes


def wild(fixes: Fixes, begins: list[float], length: float, away: list[float], velocity: list[float]) -> Fixes:
    """The fixes, those of `length` seconds from each of the times on moved by so many metres and metres a second, NED,
    every other time to the other side."""
    ecef, moved = ecef_from_llh(fixes.llh), fixes.velocity.copy()
    for k, begin in enumerate(begins):
        rows = (fixes.time >= begin) & (fixes.time < begin + length)
        ecef[rows] += (-1.0) ** k * np.einsum("nji,j->ni", ned_matrix(fixes.llh[rows]), away)
        moved[rows] += (-1.0) ** k * np.array(velocity)
    return replace(fixes, llh=llh_from_ecef(ecef), velocity=moved)


BURSTS: dict[str, tuple[list[float], float, list[float], list[float]]] = {
    "half a second of 1.1 km": ([60.3], 0.6, [1100.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "six bursts": ([30.0, 45.0, 52.0, 70.0, 77.0, 90.0], 2.5, [900.0, 400.0, -50.0], [30.0, -20.0, 5.0]),
    "every eight seconds": ([*np.arange(24.0, 118.0, 8.0)], 2.5, [300.0, 0.0, 40.0], [0.0, 25.0, 0.0]),
    "wild velocities": ([*np.arange(24.0, 118.0, 8.0)], 2.5, [0.0, 0.0, 0.0], [60.0, -80.0, 20.0]),
    "25 m for 30 s": ([50.0], 30.0, [25.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("name", BURSTS)
@pytest.mark.parametrize("ride", in_brief(["aircraft", "car", "drone", "level"], 2))
def test_wild_fixes_are_no_mistake_of_the_log(ride: str, name: str) -> None:
    """However many bursts: units and axes are wrong in all fixes, or in none."""
    samples, fixes = {"aircraft": aircraft, "car": car, "drone": drone, "level": level}[ride]()
    assert diagnose(Log(samples, wild(fixes, *BURSTS[name]))) == []


@pytest.mark.parametrize(
    "name", in_brief(["FLU for FRD", "gyro z negated", "speed in knots", "vn and ve", "radians"], 1, 2)
)
def test_wild_fixes_do_not_hide_mistakes(name: str) -> None:
    samples, fixes = aircraft()
    assert named(BY_NAME[name], (samples, wild(fixes, *BURSTS["six bursts"]))) == [(BY_NAME[name].remedy,)]


def test_no_fix_of_a_sound_recording_is_wild() -> None:
    for _, fixes in (aircraft(), car(), level(), drone(), weaving()):
        assert plausible(fixes).all()
        assert plausible(fixes.take((fixes.time < 40.0) | (fixes.time > 52.0))).all()
    _, fixes = aircraft()
    moved = wild(fixes, *BURSTS["six bursts"])
    np.testing.assert_array_equal(plausible(moved), (moved.velocity == fixes.velocity).all(axis=1))


MIRROR_EAST = np.array([1.0, -1.0, 1.0])


@pytest.mark.parametrize("axes", in_brief(["NWD", "SED"], 0))
def test_gyros_tell_mirrored_velocities_from_a_wrong_sign_of_the_position(axes: str) -> None:
    """The velocities contradict the positions alike in both; the sensors agree with one of the two."""
    samples, fixes = aircraft()
    mirror = np.diag(conventions.axes_matrix(axes, conventions.LEVEL_AXES))
    (found,) = diagnose(Log(samples, replace(fixes, velocity=fixes.velocity * mirror)))
    assert found.remedies == ({"gnss.velocity_axes": axes},)
    (found,) = diagnose(Log(samples, replace(fixes, llh=fixes.llh * mirror)))
    assert found.remedies == ({"gnss.position_axes": axes[:2]},)


def test_two_wrong_signs_of_the_position_are_a_half_turn() -> None:
    samples, fixes = aircraft()
    (found,) = diagnose(Log(samples, replace(fixes, llh=fixes.llh * [-1.0, -1.0, 1.0])))
    assert found.remedies == ({"gnss.velocity_axes": "SWD"}, {"gnss.position_axes": "SW"})


def test_without_velocities_either_sign_mirrors_the_positions() -> None:
    samples, fixes = aircraft()
    fixes = replace(fixes, llh=fixes.llh * MIRROR_EAST, velocity=np.full_like(fixes.velocity, np.nan))
    (found,) = diagnose(Log(samples, fixes))
    assert sorted(each["gnss.position_axes"] for each in found.remedies) == ["NW", "SE"]


def test_at_the_equator_exchanged_angles_are_told_from_exchanged_velocities() -> None:
    samples, fixes = aircraft()
    lat, lon, height = fixes.llh.T
    stretched = (lon - lon[0]) * np.cos(lat[0])
    at_equator = np.column_stack([lat - lat[0], stretched, height])
    exchanged = replace(fixes, llh=at_equator[:, [1, 0, 2]])
    (found,) = diagnose(Log(samples, exchanged))
    assert found.remedies == ({"gnss.columns": {"lat_deg": "lon_deg", "lon_deg": "lat_deg"}},)
    (found,) = diagnose(Log(samples, replace(fixes, llh=at_equator, velocity=fixes.velocity[:, [1, 0, 2]])))
    assert found.remedies == ({"gnss.velocity_axes": "END"},)


EAST_NORTH = {"gnss.columns": {"lat_deg": "lon_deg", "lon_deg": "lat_deg"}, "gnss.velocity_axes": "END"}


def test_columns_in_the_order_east_north_are_named() -> None:
    """At 10 E, where exchanged latitudes stay valid, the length of a degree of longitude tells. At the equator the
    gyros tell, but not from wrong signs; without turns it is listed."""
    samples, fixes = aircraft()
    lat, lon, height = fixes.llh.T
    order = [1, 0, 2]
    for there, others in (
        (np.column_stack([lat, lon - lon[0] + np.radians(10.0), height]), 0),
        (np.column_stack([lat - lat[0], (lon - lon[0]) * np.cos(lat[0]), height]), 3),
    ):
        (found,) = diagnose(Log(samples, Fixes(fixes.time, there[:, order], fixes.velocity[:, order])))
        assert found.remedies[0] == EAST_NORTH
        assert len(found.remedies) == 1 + others
    samples, fixes = level()
    near = replace(fixes, llh=fixes.llh - [*fixes.llh[0, :2], 0.0])
    assert any(each.startswith("order of the columns") for each in examine(Log(samples, near)).not_judged)


def test_left_handed_axes_that_the_motion_does_not_show_are_listed() -> None:
    """In the shallow turns of the shipped flight."""
    made = BY_NAME["left-handed axes"]
    found = examine(Log(*made.make(*weaving())))
    assert found.mistakes == []
    assert "left-handed axes FLD of gyros and accelerometers" in "; ".join(found.not_judged)


@pytest.mark.parametrize("mounted", in_brief(["FRD", "FLU"], 1))
@pytest.mark.parametrize("sensors", [False, True])
def test_axes_that_mirror_the_world_together_are_a_wrong_sign(mounted: str, sensors: bool) -> None:
    """Left-handed axes of velocities and accelerometers with gyros of the other sense make everything agree."""
    samples, fixes = aircraft()
    fixes = replace(fixes, llh=fixes.llh * MIRROR_EAST, velocity=fixes.velocity * MIRROR_EAST)
    gnss = GnssConvention(velocity_axes="NWD")
    written = conventions.axes_matrix(mounted, BODY_AXES)
    imu = ImuConvention(gyro_axes=mounted, accelerometer_axes=mounted)
    if sensors:
        mirror = np.diag(MIRROR_EAST)
        samples = Samples(samples.time, -samples.rate * MIRROR_EAST, samples.force * MIRROR_EAST)
        gyro, force = (conventions.axes_letters(m @ written, BODY_AXES) for m in (-mirror, mirror))
        imu = ImuConvention(gyro_axes=gyro, accelerometer_axes=force)
    (found,) = diagnose(Log(samples, fixes, imu, gnss))
    (remedy,) = found.remedies
    assert remedy["gnss.position_axes"] == "NW"
    assert remedy["gnss.velocity_axes"] == "NED"
    assert remedy.get("imu.gyro_axes", mounted) == mounted
    assert remedy.get("imu.accelerometer_axes", mounted) == mounted
    assert "mirror the world" in str(found)


def test_left_handed_axes_of_one_instrument_are_no_mirror() -> None:
    """Accelerometers that give gravity, beside velocities north, east, up: each is usual."""
    samples, fixes = aircraft()
    imu = ImuConvention(accelerometer_axes="BLU")
    assert diagnose(Log(samples, fixes, imu, GnssConvention(velocity_axes="NEU"))) == []
    imu = ImuConvention(gyro_axes="BRU", accelerometer_axes="FLD")
    assert diagnose(Log(samples, fixes, imu)) == []


def test_west_longitudes_from_0_to_360(tmp_path: Path) -> None:
    samples, fixes = aircraft()
    table(tmp_path, samples, fixes)
    read, _ = read_fixes(tmp_path / "gnss.csv")
    rows = (tmp_path / "gnss.csv").read_text().splitlines()
    at = rows[0].split(",").index("lon_deg")
    for row, line in enumerate(rows[1:], 1):
        cells = line.split(",")
        cells[at] = repr((-float(cells[at])) % 360.0)
        rows[row] = ",".join(cells)
    (tmp_path / "gnss.csv").write_text("\n".join(rows) + "\n")
    again, _ = read_fixes(tmp_path / "gnss.csv", convention=GnssConvention(position_axes="NW"))
    np.testing.assert_allclose(again.llh, read.llh, rtol=1e-12)


# --- what is declared


@pytest.mark.parametrize("name", BY_NAME)
def test_the_remedy_cures(name: str, tmp_path: Path) -> None:
    """What the diagnosis says to write makes of the file what it was before the mistake."""
    from dataclasses import fields

    samples, fixes = aircraft()
    samples, fixes = samples.between(80.0, 90.0), fixes.take((fixes.time > 80.0) & (fixes.time < 90.0))
    assert np.ptp(fixes.velocity, axis=0).min() > 1.0, "it turns and climbs"
    table(tmp_path, *BY_NAME[name].make(samples, fixes))
    imu: dict[str, Any] = {}
    gnss: dict[str, Any] = {}
    for key, value in BY_NAME[name].remedy.items():
        section, _, leaf = key.partition(".")
        (imu if section == "imu" else gnss)[leaf] = value
    log = read_replay(tmp_path / "log.yaml", tuple(f"imu.{k}={v}" for k, v in imu.items() if k != "columns"))[0]
    sensors = log.imu.model_copy(update={k: v for k, v in imu.items() if k == "columns"})
    receiver = log.gnss.model_validate({**log.gnss.model_dump(), **gnss})
    again, _ = read_imu(tmp_path / "imu.csv", convention=sensors.convention())
    fixed, _ = read_fixes(tmp_path / "gnss.csv", convention=receiver.convention())
    for a, b in ((again, samples), (fixed, fixes)):
        for each in fields(a):
            one, other = getattr(a, each.name), getattr(b, each.name)
            if other is None:
                assert one is None
            else:
                np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)


def test_a_wrong_declaration_is_named_as_well(tmp_path: Path) -> None:
    """A table in order under a log that declares other units and axes: the diagnosis finds back to it."""
    table(tmp_path, *aircraft())
    imu = ImuConvention(accelerometer_unit="g", gyro_unit="deg/s", gyro_axes="FLU", accelerometer_axes="FLU")
    gnss = GnssConvention(speed_unit="kn", velocity_axes="ENU", time_offset=7.0)
    samples, fixes = (read_imu(tmp_path / "imu.csv", convention=imu, limited=False)[0],
                      read_fixes(tmp_path / "gnss.csv", convention=gnss, limited=False)[0])  # fmt: skip
    written: dict[str, Any] = {}
    for mistake in diagnose(Log(samples, fixes, imu, gnss)):
        written |= mistake.remedies[0]
    expected = {"imu.accelerometer_unit": "m/s2", "gnss.speed_unit": "m/s", "gnss.velocity_axes": "NED"}
    assert {key: written[key] for key in expected} == expected


def test_columns_of_other_names(tmp_path: Path) -> None:
    samples, fixes = aircraft()
    table(tmp_path, samples, fixes)
    text = (tmp_path / "imu.csv").read_text().replace("gx_rad_s", "GyrX").replace("t_s", "TimeUS", 1)
    (tmp_path / "imu.csv").write_text(text)
    log = tmp_path / "log.yaml"
    with pytest.raises(InputError, match="lacks t_s, gx_rad_s"):
        replay.prepare(*read_replay(log))
    named_so = ImuConvention(columns={"gx_rad_s": "GyrX", "t_s": "TimeUS"})
    read, _ = read_imu(tmp_path / "imu.csv", convention=named_so)
    np.testing.assert_allclose(read.rate, samples.rate, rtol=1e-6, atol=1e-9)


def test_axes_are_letters_and_matrices() -> None:
    for letters in conventions.all_axes(BODY_AXES):
        matrix = conventions.axes_matrix(letters, BODY_AXES)
        assert conventions.axes_letters(matrix, BODY_AXES) == letters
        np.testing.assert_array_equal(matrix @ matrix.T, np.eye(3))
    assert len(set(conventions.all_axes(BODY_AXES))) == 48
    up = conventions.axes_matrix("FLU", BODY_AXES) @ [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(up, [1.0, -2.0, -3.0])


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("imu.axes=FLX", "expected three letters"),
        ("imu.gyro_unit=deg", "did you mean 'deg/s'"),
        ("gnss.velocity_axes=XYZ", "N/S or E/W or D/U"),
        ("imu.columns={gx: a}", "'gx' is not a column"),
        ("checks=maybe", "refuse, warn, off"),
    ],
)
def test_what_is_declared_wrongly_is_refused(assignment: str, message: str, tmp_path: Path) -> None:
    log = table(tmp_path, *level())
    with pytest.raises(InputError) as caught:
        read_replay(log, (assignment,))
    assert message in str(caught.value.problems[0])


# --- the command


def test_a_mistake_is_refused_unless_it_is_to_be_flown(tmp_path: Path) -> None:
    log = table(tmp_path, *BY_NAME["FLU for FRD"].make(*aircraft()))
    run = CliRunner().invoke(app, ["replay", str(log), "--dry-run", "-o", str(tmp_path / "out.h5")])
    assert run.exit_code == 2
    assert "log.yaml:3:7: imu.file: " in run.output
    assert "write `imu: {axes: FLU}`" in run.output
    assert "checks: warn" in run.output
    arguments = ["replay", str(log), "--dry-run", "-o", str(tmp_path / "out.h5"), "--set"]
    warned = CliRunner().invoke(app, [*arguments, "checks=warn"])
    assert warned.exit_code == 0
    assert "warning: " in warned.output
    assert "forward-left-up" in warned.output
    silent = CliRunner().invoke(app, [*arguments, "checks=off"])
    assert silent.exit_code == 0
    assert "warning" not in silent.output
    cured = CliRunner().invoke(app, [*arguments, "imu.axes=FLU"])
    assert cured.exit_code == 0
    assert "warning" not in cured.output


@pytest.mark.parametrize("name", ["1e-7 degrees", "gyro in deg/h", "samples' time in ms", "fixes' time in ms"])
def test_values_outside_of_limits_are_explained_first(name: str, tmp_path: Path) -> None:
    """What used to be refused at its first line only, or to end in a traceback, is named."""
    log = table(tmp_path, *BY_NAME[name].make(*aircraft()))
    run = CliRunner().invoke(app, ["replay", str(log), "--dry-run", "-o", str(tmp_path / "out.h5")])
    assert run.exit_code == 2
    ((key, value),) = BY_NAME[name].remedy.items()
    assert f"{key.partition('.')[2]}: {value}" in run.output


def test_a_single_value_outside_of_limits_is_refused_at_its_line(tmp_path: Path) -> None:
    log = table(tmp_path, *aircraft())
    lines = (tmp_path / "imu.csv").read_text().splitlines()
    cells = lines[700].split(",")
    lines[700] = ",".join([cells[0], "777", *cells[2:]])
    (tmp_path / "imu.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as caught:
        replay.prepare(*read_replay(log))
    assert "imu.csv:701" in str(caught.value.problems[0])
    assert "gx_rad_s is 777" in str(caught.value.problems[0])
    hint = "if the column is not in rad/s, write `imu: {gyro_unit: deg/s}` (or deg/h, mrad/s); `skip_bad_records"
    assert hint in str(caught.value.problems[0])


def test_radians_of_a_flight_that_hardly_moves() -> None:
    """Its pieces are too short to compare, but as degrees the positions lie in the ocean; beside 0, 0 nothing is said,
    where simulated flights are."""
    samples, fixes = drone()
    rows = fixes.take(fixes.time < 60.0)
    here = np.tile(fixes.llh[0], (rows.time.size, 1))
    still = samples.between(0.0, 60.0), replace(rows, llh=here, velocity=0.0 * rows.velocity)
    assert ({"gnss.angle_unit": "rad"},) in named(BY_NAME["radians"], still)
    beside = still[0], replace(still[1], llh=here * [1e-3, 1e-3, 1.0])
    assert ({"gnss.angle_unit": "rad"},) not in named(BY_NAME["radians"], beside)


def test_a_lag_of_the_velocities_shows_in_the_fixes() -> None:
    _, fixes = aircraft()
    assert np.isnan(lag_of_velocities(fixes))
    later = np.stack([np.interp(fixes.time - 1.6, fixes.time, each) for each in fixes.velocity.T], axis=1)
    assert lag_of_velocities(replace(fixes, velocity=later)) == pytest.approx(1.6, abs=0.2)


def test_nmea_takes_no_units(tmp_path: Path) -> None:
    table(tmp_path, *level())
    (tmp_path / "gnss.csv").write_text("$GPGGA,000000.00,4500.0000,N,00900.0000,E,1,09,0.9,50.0,M,0.0,M,,*5F\n" * 3)
    with pytest.raises(InputError, match="NMEA fixes units"):
        replay.prepare(*read_replay(tmp_path / "log.yaml", ("gnss.speed_unit=kn",)))


# --- real flights


@pytest.fixture(scope="module")
def whole_thor(shared: Path) -> tuple[Samples, Fixes]:
    folder = shared / "data/fw_thor75"
    return read_imu(folder / "imu.csv.gz")[0], read_fixes(folder / "gnss.csv")[0]


@pytest.fixture(scope="module")
def thor(whole_thor: tuple[Samples, Fixes]) -> tuple[Samples, Fixes]:
    """The last circuits, landing, taxi."""
    samples, fixes = whole_thor
    return samples.between(430.0, 620.0), fixes.take((fixes.time > 430.0) & (fixes.time < 620.0))


@pytest.fixture(scope="module")
def comma(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Samples, Fixes]:
    out = tmp_path_factory.mktemp("comma")
    folder = shared / "data/comma2k19_ex1"
    log_files(read_logs([folder]), folder.name).write(out)
    return read_imu(out / "imu.csv")[0], read_fixes(out / "gnss.csv")[0]


def test_real_flights_raise_no_alarm(
    whole_thor: tuple[Samples, Fixes], thor: tuple[Samples, Fixes], comma: tuple[Samples, Fixes]
) -> None:
    assert diagnose(Log(*whole_thor)) == []
    assert diagnose(Log(*thor)) == []
    assert diagnose(Log(*comma)) == []


@pytest.mark.parametrize(("written", "due"), [("m/s", "kn"), ("kn", "m/s")])
@pytest.mark.parametrize("columns", [slice(0, 3), slice(0, 2)])
@pytest.mark.parametrize("first", in_brief([0.0, 150.0], 1))
def test_knots_of_a_whole_real_flight_are_named(
    written: str, due: str, columns: slice, first: float, whole_thor: tuple[Samples, Fixes]
) -> None:
    """From take-off to landing, of all velocities or of the horizontal ones alone."""
    samples, fixes = whole_thor
    fixes = fixes.take(fixes.time >= first)
    velocity = fixes.velocity.copy()
    velocity[:, columns] *= conventions.SPEED_UNITS[written] / conventions.SPEED_UNITS[due]
    log = Log(samples.between(first, 1e4), replace(fixes, velocity=velocity), gnss=GnssConvention(speed_unit=written))
    found, _ = interpretations(log, [])
    assert found[0].remedies == ({"gnss.speed_unit": due},)


EVERY_TWELFTH = [pytest.param(name, marks=() if i % 12 == 0 else pytest.mark.long) for i, name in enumerate(BY_NAME)]
"""Mistakes of real recordings: of a simulated one each is tried every time."""


@pytest.mark.parametrize("name", EVERY_TWELFTH)
def test_each_mistake_of_a_real_flight_is_named(name: str, thor: tuple[Samples, Fixes]) -> None:
    (found,) = named(BY_NAME[name], thor)
    # heights that wander do not tell km/h from ft/s, which are 9 % apart
    several = name == "vertical velocity in km/h"
    assert found == (BY_NAME[name].remedy,) or (several and BY_NAME[name].remedy in found)


SHOWN_BY_A_MOTORWAY = {
    "accelerometer in g", "accelerometer in mg", "accelerometer in ft/s2", "increments for rates",
    "gyro and accelerometer", "radians", "1e-7 degrees", "latitude and longitude", "vn and ve", "speed in km/h",
    "speed in knots", "speed in cm/s", "samples' time in ms", "samples' time in us", "fixes' time in ms",
    "FLU for FRD", "accelerometer's sign", "accelerometer z negated", "gyro in deg/s", "gyro in deg/h",
    "accelerometer x and z",
}  # fmt: skip


@pytest.mark.parametrize("name", EVERY_TWELFTH)
def test_each_mistake_that_a_motorway_shows_is_named(name: str, comma: tuple[Samples, Fixes]) -> None:
    """A car that hardly turns for a minute: what it shows is named, if need be among others; of the rest nothing is
    said, and nothing wrong."""
    found = named(BY_NAME[name], comma)
    if name in SHOWN_BY_A_MOTORWAY or found:
        assert len(found) == 1
        assert BY_NAME[name].remedy in found[0]


@pytest.mark.parametrize(("given", "shift"), [(-1.0, -1.0), (2.0, 2.0)])
def test_a_wrong_latency_is_no_period_of_the_motion(given: float, shift: float) -> None:
    """Turns that repeat themselves fit clocks that are 30 s further off, too, which a usual latency makes unlikely."""
    samples, fixes = weaving()
    (found,) = diagnose(Log(samples, fixes, latency=given))
    assert found.remedies == ({"gnss.latency_s": 0.0}, {"gnss.time_offset_s": shift})
    (found,) = diagnose(Log(samples, replace(fixes, time=fixes.time + 18.0), latency=0.1))
    assert {"gnss.time_offset_s": -18.0} in found.remedies
