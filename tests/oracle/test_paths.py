"""Paths by waypoints: turns against closed forms, the error-free mechanisation against the path."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from navsim.landing import study as landing
from navsim.landing.case import crossing_times
from navsim.results.schema import HEIGHTS
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.trajectory.path import NoSuchPath, Path, ended
from navsim.trajectory.waypoints import Turn, Waypoint, cruise, turn
from tests.conftest import DATA, Within
from tests.helpers import case, scenario
from tests.oracle.test_strapdown import mechanised


@pytest.fixture(scope="module")
def published() -> dict[str, Any]:
    return dict(json.loads((DATA / "paths.json").read_text()))


def joins(path: Path) -> float:
    """The largest jump of position, velocity or acceleration where segments meet."""
    pairs = zip(path.knots, path.segments[:-1], path.segments[1:], strict=True)
    return float(max(np.abs(ended(a, knot)[:3] - ended(b, knot)[:3]).max() for knot, a, b in pairs))


@pytest.mark.validates("Radius, rate and load factor of a level turn", "closed form", radius="1e-3 m",
                       rate="1e-4 deg/s", load_factor="1e-6")  # fmt: skip
def test_level_turn(published: dict[str, Any], within: Within) -> None:
    """The steady part of a turn, as it is flown, and as it is felt."""
    entry = published["level_turn"]
    bend = turn(entry["V"], math.radians(90.0), math.radians(entry["bank_deg"]), 2.0)
    steady = bend.flown(0.0, np.zeros(3), 0.0)[1].jet(np.linspace(2.0, 2.0 + bend.steady, 9))
    speed = np.linalg.norm(steady[:, 1], axis=1)
    across = np.cross(steady[:, 1], steady[:, 2])[:, 2] / speed
    np.testing.assert_allclose(speed**2 / across, entry["radius_m"], rtol=0.0, atol=within["radius"])
    rate = np.degrees(across / speed)
    np.testing.assert_allclose(rate, entry["rate_deg_s"], rtol=0.0, atol=within["rate"])
    load = np.hypot(across, 9.80665) / 9.80665
    np.testing.assert_allclose(load, entry["load"], rtol=0.0, atol=within["load_factor"])


@pytest.mark.validates("Distance before the corner at which a fly-by turn begins", "closed form",
                       "(rolling in no time)", distance="0.02 m")  # fmt: skip
@pytest.mark.parametrize("degrees", [30.0, -90.0, 140.0])
def test_lead_of_an_ideal_turn(degrees: float, within: Within) -> None:
    """Rolling takes a hundredth, a thousandth of a second: the lead falls to the ideal one as fast."""
    radius = 30.0**2 / (9.80665 * math.tan(math.radians(30.0)))
    ideal = radius * math.tan(math.radians(abs(degrees)) / 2.0)
    over = [turn(30.0, math.radians(degrees), math.radians(30.0), roll).lead() - ideal for roll in (1e-2, 1e-3)]
    assert 0.0 < over[1] < within["distance"]
    assert over[0] / over[1] == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize("degrees", [0.01, 3.0, -47.0, 90.0, 170.0])
@pytest.mark.parametrize("roll", [0.5, 4.0])
def test_a_turn_ends_on_the_next_leg(degrees: float, roll: float) -> None:
    """Through the whole angle, as far behind the corner as it began before it, with the bank that it says."""
    bend = turn(30.0, math.radians(degrees), math.radians(40.0), roll)
    segments = bend.flown(0.0, np.zeros(3), 0.0)
    at, lead, angle = ended(segments[-1], bend.duration), bend.lead(), math.radians(degrees)
    there = lead * np.array([1.0 + math.cos(angle), math.sin(angle), 0.0])
    np.testing.assert_allclose(at[0], there, atol=1e-9 * lead + 1e-9)
    np.testing.assert_allclose(at[1], 30.0 * np.array([math.cos(angle), math.sin(angle), 0.0]), atol=1e-9)
    assert joins(Path(tuple(segments), {})) < 1e-9
    t = np.linspace(0.0, bend.duration, 4001)
    jet = Path(tuple(segments), {}).jet(t)
    bank = np.degrees(np.arctan(np.cross(jet[:, 1], jet[:, 2])[:, 2] / 30.0 / 9.80665))
    assert np.abs(bank).max() == pytest.approx(math.degrees(bend.bank), rel=1e-4)
    assert bend.bank <= math.radians(40.0)
    # the jerk is continuous, too: the bank has a rate everywhere
    slope = np.diff(jet[:, 2], axis=0) / (t[1] - t[0])
    middle = 0.5 * (jet[1:, 3] + jet[:-1, 3])
    assert np.abs(slope - middle).max() < 0.02 * max(np.abs(jet[:, 3]).max(), 1e-6)


def test_the_attitude_shows_the_bank() -> None:
    """By coordination: 30 deg in the turns of the circuit, none on its legs, rolled to smoothly."""
    trajectory = scenario("wind.speed_m_s=0", "approach.angle_of_attack_deg=0", name="circuit").trajectory()
    knots = trajectory.path.knots
    t = np.arange(0.0, 125.0, 0.02)
    roll = np.degrees(trajectory.motion(t).rpy[:, 0])
    steady = (t > knots[1]) & (t < knots[2])
    np.testing.assert_allclose(roll[steady], -30.0, atol=0.05)  # gravity there is not the standard one
    assert np.abs(roll[(t < knots[0]) | (t > knots[7])]).max() < 0.05
    rates = np.diff(roll) / 0.02
    assert np.abs(rates).max() == pytest.approx(30.0 * 1.875 / 3.0, rel=0.01)
    assert np.abs(np.diff(rates) / 0.02).max() < 1.05 * 30.0 * 10.0 / math.sqrt(3.0) / 3.0**2


@pytest.mark.parametrize("ending", ["flare", "paper"])
def test_a_circuit_comes_back(ending: str) -> None:
    settings = (f"approach.ending={ending}", "wind={speed_m_s: 5, from_deg: 40}")
    trajectory = scenario(*settings, name="circuit").trajectory()
    assert joins(trajectory.path) < 1e-8
    place, attitude = mechanised(trajectory, 100.0, 210.0)
    assert np.linalg.norm(place) < 1e-2
    assert np.linalg.norm(attitude) < 1e-5


def test_speeds_and_heights_of_waypoints() -> None:
    """Each passed level at its height and speed, between them without a jump of the acceleration."""
    points = [Waypoint(-9000.0, 3000.0, 400.0, 40.0), Waypoint(-6000.0, 3000.0, 300.0, 30.0)]
    points += [Waypoint(-6000.0, 0.0, 350.0, 35.0), Waypoint(-3000.0, 0.0, 350.0, 25.0)]
    path = cruise(points, math.radians(30.0), 2.0)
    assert joins(path) < 1e-8
    for begin, height, speed in zip((1, 5), (300.0, 350.0), (30.0, 35.0), strict=True):
        jet = path.jet(np.linspace(path.segments[begin].start, path.segments[begin + 3].start, 20))
        np.testing.assert_allclose(-jet[:, 0, 2], height, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(jet[:, 1], axis=1), speed, atol=1e-9)
    end = path.jet(path.knots[-1:] + 10.0)[0]
    np.testing.assert_allclose(end[0], [-2750.0, 0.0, -350.0], atol=1e-7)


def test_waypoints_by_coordinates_are_those_on_the_axes() -> None:
    """The same way, its places told as latitudes and longitudes."""
    base = scenario(name="circuit")
    frame, aim = base.trajectory().frame, base.runway.aim_point_m
    from navsim.geodesy.earth import llh_from_ecef

    def lat_lon(x: float, y: float) -> str:
        # down to the runway's height, from which places are seen
        ecef = frame.origin + frame.axes @ np.array([x - aim, y, 0.0])
        lat, lon, _ = np.degrees(llh_from_ecef(ecef))
        return f"{{lat_deg: {lat:.10f}, lon_deg: {lon:.10f}}}"

    there = [(0.0, -800.0), (-2500.0, -800.0), (-2500.0, 0.0)]
    given = ", ".join(lat_lon(x, y) for x, y in there)
    other = scenario("approach.circuit=~", f"approach.points=[{given}]", name="circuit").path()
    t = np.linspace(0.0, 200.0, 50)
    np.testing.assert_allclose(other.jet(t)[:, 0], base.path().jet(t)[:, 0], atol=2e-3)


@pytest.mark.parametrize(
    ("settings", "place", "words"),
    [
        (("circuit={offset_m: 300}",), "approach.circuit", "2 to 3 is 300.0 m long, too short for the turn"),
        (("circuit={final_m: 1600}",), "approach.circuit", "m too late: there the glide-slope capture has begun"),
        (("circuit=~",), "approach.points", "exactly one of points and circuit"),
        (("points=[{along_m: 0, right_m: 0}, {along_m: 9, right_m: 9}]",), "approach.points", "exactly one"),
        (("circuit=~", "points=[{along_m: 0, right_m: 0}]"), "approach.points", "at least two"),
        (("circuit=~", "points=[{along_m: 0}, {along_m: 9, right_m: 9}]"), "approach.points.0", "along_m and"),
        (
            ("circuit=~", "points=[{along_m: -9000, right_m: 0}, {along_m: -5000, right_m: 8}]"),
            "approach.points.1", "lies 8.0 m off the extended centre line",
        ),
        (
            ("circuit=~", "ending=none",
             "points=[{along_m: 0, right_m: 0}, {along_m: 2000, right_m: 0}, {along_m: 0, right_m: 10}]"),
            "approach.points.1", "turns back by 180 deg at waypoint 2",
        ),
        (
            ("circuit=~", "ending=none", "points=[{along_m: 0, right_m: 0}, {along_m: 0, right_m: 0.5}]"),
            "approach.points.1", "waypoints 1 and 2 lie 0.50 m apart",
        ),
        (
            ("circuit=~", "ending=none", "points=[{along_m: 0, right_m: 0}, {along_m: 300, right_m: 0, height_m: 9}]"),
            "approach.points.1", "height changes by up to 41 deg between waypoints 1 and 2",
        ),
        (
            ("circuit=~", "ending=none",
             "points=[{along_m: 0, right_m: 0}, {along_m: 90, right_m: 0, speed_kmh: 180}]"),
            "approach.points.1", "speed changes by up to",
        ),
    ],
)  # fmt: skip
def test_ways_that_cannot_be_flown(settings: tuple[str, ...], place: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        scenario(*(f"approach.{each}" for each in settings), name="circuit")
    assert place in {problem.key for problem in refused.value.problems}


def test_coordinates_need_a_threshold() -> None:
    way = "points=[{lat_deg: 56, lon_deg: 37}, {lat_deg: 56.1, lon_deg: 37}]"
    settings = (
        "approach.circuit=~",
        f"approach.{way}",
        "runway.threshold=~",
        "approach.start={lat_deg: 56, lon_deg: 37}",
    )
    with pytest.raises(InputError, match=r"give runway\.threshold"):
        scenario(*settings, name="circuit")


def test_no_way_is_left_between_two_turns() -> None:
    """Just enough for the turns at both ends, and not for another speed."""
    bend = Turn(30.0, math.pi / 2.0, 0.5, 1.0, 1.0)
    assert bend.duration == 3.0
    lead = turn(30.0, math.pi / 2.0, 0.5, 1.0).lead()
    corner = [
        Waypoint(-500.0, 0.0, 100.0, 30.0),
        Waypoint(0.0, 0.0, 100.0, 30.0),
        Waypoint(0.0, 2.0 * lead - 1e-6, 100.0, 30.0),
    ]
    with pytest.raises(NoSuchPath, match=r"too short for the turn of 90 deg at waypoint 2, .* and the turn of 90"):
        cruise([*corner, Waypoint(-900.0, 2.0 * lead, 100.0, 30.0)], 0.5, 1.0)


TAXIED = ("approach.rollout_deceleration_m_s2=1.5", "duration_s=150")


@pytest.mark.parametrize(
    "settings",
    [
        ("approach.taxi_speed_kmh=0",),
        ("approach.taxi_speed_kmh=18", "approach.taxi_s=5"),
        ("approach.taxi_speed_kmh=18", "approach.taxi_s=5", "approach.brake_ease_s=8"),
        ("approach.taxi_speed_kmh=76",),
    ],
)
def test_taxiing(settings: tuple[str, ...]) -> None:
    """Down to its speed and to a stand, as far as the work of the brakes says, on the runway's axis, without a jump."""
    path = scenario(*TAXIED, *settings, name="landing_smooth").path()
    assert isinstance(path, Path)
    assert joins(path) < 1e-9
    t = np.arange(path.events["roll_out"], 150.0, 1e-3)
    jet = path.jet(t)
    assert not jet[:, :, 1:].any()
    assert jet[:, 2, 0].min() >= -1.5 - 1e-12
    assert jet[:, 2, 0].max() <= 1e-12
    assert jet[:, 1, 0].min() >= -1e-12
    assert np.abs(np.diff(jet[:, 3, 0])).max() < 0.02 * np.abs(jet[:, 3, 0]).max()  # no step of the jerk, too
    wanted = float(settings[0].partition("=")[2]) / 3.6
    slowed = path.events["taxi" if wanted else "stand"]
    assert path.jet(np.array([slowed]))[0, 1, 0] == pytest.approx(wanted, abs=1e-12)
    assert not path.jet(np.array([slowed]))[0, 2].any()
    if len(settings) > 1:
        assert not path.jet(np.linspace(path.events["stand"], 1e4, 9))[:, 1:].any()
        assert path.events["stand"] > slowed + 5.0


def test_the_way_of_a_stop() -> None:
    """Full brakes until they are let go, and the double integral of letting go."""
    path = scenario(*TAXIED, "approach.taxi_speed_kmh=0", name="landing_smooth").path()
    begin, end = path.jet(np.array([path.events["roll_out"], path.events["stand"]]))[:, :2, 0]
    d, ease = 1.5, 1.0
    full = begin[1] / d - 0.5 * ease
    left = begin[1] - d * full
    assert left == pytest.approx(0.5 * d * ease)
    by_hand = begin[1] * full - 0.5 * d * full**2 + left * ease - d * ease**2 * (0.5 - 0.25 + 0.1)
    assert end[0] - begin[0] == pytest.approx(by_hand, abs=1e-9)


def test_pull_up() -> None:
    """By its load factor, up to its angle, straight ahead, at the speed of the glide."""
    settings = (
        "approach.go_around={height_m: 30, load_factor: 1.3, climb_deg: 8}",
        "wind.speed_m_s=0",
        "duration_s=150",
    )
    whole = scenario(*settings, "approach.angle_of_attack_deg=0", name="landing_smooth")
    trajectory, path = whole.trajectory(), whole.path()
    assert isinstance(path, Path)
    assert joins(path) < 1e-9
    begin = path.events["go_around"]
    assert -path.jet(np.array([begin]))[0, 0, 2] == pytest.approx(30.0, abs=1e-9)
    assert not {"touchdown", "flare"} & path.events.keys()
    on, off = path.knots[-3:-1]
    assert on == pytest.approx(begin + 1.0)
    t = np.linspace(on, off, 200)
    jet = path.jet(t)
    speed = np.linalg.norm(jet[:, 1], axis=1)
    np.testing.assert_allclose(speed, speed[0], rtol=1e-12)
    climb = np.arctan2(-jet[:, 1, 2], jet[:, 1, 0])
    curved = np.linalg.norm(np.cross(jet[:, 1], jet[:, 2]), axis=1) / speed
    np.testing.assert_allclose(np.cos(climb) + curved / 9.80665, 1.3, rtol=1e-10)
    # what is felt along the aircraft's own vertical; gravity there is not the standard one, and the Earth turns
    np.testing.assert_allclose(-trajectory.motion(t).specific_force[:, 2] / 9.80665, 1.3, atol=2e-3)
    end = path.jet(np.array([path.knots[-1], 150.0]))
    np.testing.assert_allclose(np.degrees(np.arctan2(-end[:, 1, 2], end[:, 1, 0])), 8.0, atol=1e-12)
    # the way is straight in the tangent plane; heading follows from it, and slowly the meridians converge
    assert not path.jet(np.linspace(begin, 150.0, 50))[:, :, 1].any()
    heading = trajectory.motion(np.linspace(begin, 150.0, 50)).rpy[:, 2]
    np.testing.assert_allclose(heading, heading[0], atol=3e-4)
    # the height that is lost at constant load: V^2 (1 - cos slope) / (g (n - 1)) is below what easing on adds
    lost = 30.0 + path.jet(np.linspace(begin, off, 2000))[:, 0, 2].max()
    sink, slow = math.radians(5.0), float(speed[0])
    assert slow**2 * (1.0 - math.cos(sink)) / (9.80665 * 0.3) < lost
    assert lost < slow**2 * (1.0 - math.cos(sink)) / (9.80665 * 0.3) + 0.55 * slow * math.sin(sink)


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (("approach.go_around={height_m: 30}", "wind={speed_m_s: 5, from_deg: 40}"), "landing_smooth"),
        pytest.param(("approach.go_around={height_m: 2, load_factor: 1.6, climb_deg: 12}",), "landing_smooth",
                     marks=pytest.mark.long),
        (("approach.go_around={at_s: 40, climb_deg: 0, ease_s: 5}",), "landing"),
        ((*TAXIED, "approach.taxi_speed_kmh=18", "approach.taxi_s=5", "wind.speed_m_s=5", "runway.slope_percent=-2"),
         "landing_smooth"),
        (("approach.glide_slope_deg=20", "approach.nose_deg=200", "approach.angle_of_attack_deg=4"), "beacons_pad"),
    ],
)  # fmt: skip
def test_they_come_back(settings: tuple[str, ...], name: str) -> None:
    trajectory = scenario(*settings, name=name).trajectory()
    place, attitude = mechanised(trajectory, 100.0, 120.0)
    assert np.linalg.norm(place) < 1e-2
    assert np.linalg.norm(attitude) < 1e-5


def test_a_small_pull_up_has_less_load() -> None:
    """Levelling off within 6 s each way needs less than 1.5."""
    settings = ("approach.go_around={height_m: 80, load_factor: 1.5, climb_deg: 0, ease_s: 6}", "duration_s=150")
    path = scenario(*settings, name="landing_smooth").path()
    assert isinstance(path, Path)
    assert joins(path) < 1e-9
    t = np.linspace(path.events["go_around"], path.knots[-1], 500)
    jet = path.jet(t)
    speed = np.linalg.norm(jet[:, 1], axis=1)
    load = np.cos(np.arctan2(-jet[:, 1, 2], jet[:, 1, 0])) + np.cross(jet[:, 1], jet[:, 2])[:, 1] / speed / 9.80665
    assert 1.02 < load.max() < 1.1
    np.testing.assert_allclose(path.jet(np.array([150.0]))[0, 1, 2], 0.0, atol=1e-12)


def test_what_results_say_of_a_go_around() -> None:
    """Heights passed before it have their numbers, those below and touchdown none, and a warning says why."""
    settings = ("approach.go_around={height_m: 30}", "duration_s=130")
    case_ = case(*settings, name="landing_smooth")
    assert any("there is no touchdown" in text for text in case_.warnings)
    passed = dict(zip(HEIGHTS, crossing_times(case_), strict=True))
    assert np.isnan(passed["touchdown"])
    assert np.isnan(passed["50ft"])
    begin = case_.trajectory.path.events["go_around"]
    assert passed["200ft"] < passed["100ft"] < begin < 130.0
    at = case_.trajectory.path.jet(np.array([passed["200ft"], passed["100ft"]]))
    np.testing.assert_allclose(-at[:, 0, 2], [60.96, 30.48], atol=5e-3)
    with pytest.raises(InputError, match="never touches down"):
        case(*settings, "box={lateral_m: 1, vertical_m: 1}", name="landing_smooth")


@pytest.mark.parametrize(
    ("settings", "name", "place", "words"),
    [
        (("go_around={height_m: 200}",), "landing_smooth", "approach", "200 m above the runway are not passed"),
        (("go_around={at_s: 20}",), "landing_smooth", "approach", "20 s is not within the glide"),
        (("go_around={height_m: 0.2, load_factor: 1.02}",), "landing_smooth", "approach", "would go down to"),
        (("go_around={at_s: 80, height_m: 30}",), "landing_smooth", "approach.go_around.height_m", "exactly one"),
        (("go_around={at_s: 80}", "speed_is=air"), "landing_smooth", "approach.go_around.at_s", "give height_m"),
        (("go_around={height_m: 30}", "ending=none"), "circuit", "approach.go_around", "no landing to break off"),
        (("taxi_speed_kmh=10", "ending=paper"), "circuit", "approach.taxi_speed_kmh", "is for a roll-out"),
        (("taxi_s=10",), "landing_smooth", "approach.taxi_s", "give taxi_speed_kmh"),
        (("taxi_speed_kmh=0", "taxi_s=10"), "landing_smooth", "approach.taxi_s", "the aircraft has stopped"),
        (("taxi_speed_kmh=90",), "landing_smooth", "approach", "no faster than taxi_speed_kmh"),
        (("taxi_speed_kmh=9", "rollout_deceleration_m_s2=0"), "landing_smooth", "approach", "is not braked"),
        (("taxi_speed_kmh=9", "speed_is=air"), "landing_smooth", "approach.taxi_speed_kmh", "no airspeed is held"),
    ],
)
def test_no_such_endings(settings: tuple[str, ...], name: str, place: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        scenario(*(f"approach.{each}" for each in settings), name=name)
    assert place in {problem.key for problem in refused.value.problems}


def test_an_aircraft_that_brakes_stops_and_stands() -> None:
    """Without a taxi speed, too: the path is that of `taxi_speed_kmh: 0` where it would stop within the flight, and the
    same to the bit as ever before the brakes are let go."""
    brakes = ("approach.rollout_deceleration_m_s2=2", "duration_s=140")
    stops = scenario(*brakes, name="landing_smooth").path()
    given = scenario(*brakes, "approach.taxi_speed_kmh=0", name="landing_smooth").path()
    short = scenario(*brakes[:1], "duration_s=96", name="landing_smooth").path()
    times = np.linspace(0.0, 140.0, 1401)
    np.testing.assert_array_equal(stops.jet(times), given.jet(times))
    assert np.abs(stops.jet(np.array([139.0]))[0, 1]).max() == 0.0
    rolling = times[times < stops.events["stand"] - 1.01]
    np.testing.assert_array_equal(short.jet(rolling)[:, :3], stops.jet(rolling)[:, :3])


def test_a_landing_on_a_pad() -> None:
    """Straight down the slope to a hover, straight down to rest at the pad's centre, without a jump; lengths and times
    by hand; the attitude is kept, and an accelerometer at rest feels gravity alone."""
    whole = scenario("approach.glide_slope_deg=20", "approach.nose_deg=200", "wind={speed_m_s: 12, from_deg: 150}",
                     name="beacons_pad")  # fmt: skip
    trajectory, path = whole.trajectory(), whole.path()
    assert isinstance(path, Path)
    assert joins(path) < 1e-9
    begins = path.events
    sin, cos = math.sin(math.radians(20.0)), math.cos(math.radians(20.0))
    slant = (80.0 - 20.0 * sin * 2.0 - 15.0) / sin
    assert begins["hover"] == pytest.approx(10.0 + 4.0 + 2.0 * slant / 20.0)  # the mean speed is half the first one
    assert begins["touchdown"] - begins["descent"] == pytest.approx(15.0 / 1.0 + 2.0)  # half of each ease is lost
    glide = path.jet(np.linspace(14.0, begins["hover"], 50))
    np.testing.assert_allclose(glide[:, 1] @ [-sin, 0.0, cos], 0.0, atol=1e-12)
    assert -np.diff(glide[:, 1, 0]).max() >= 0.0
    still = path.jet(np.array([*np.linspace(begins["hover"], begins["descent"], 9), begins["touchdown"], 1e4]))
    assert np.abs(still[:, 1:3]).max() < 1e-12
    np.testing.assert_allclose(still[:9, 0], np.tile([0.0, 0.0, -15.0], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(still[9:, 0], 0.0, atol=1e-12)
    down = path.jet(np.linspace(begins["descent"], begins["touchdown"], 99))
    assert not down[:, :, :2].any()
    assert down[:, 1, 2].max() == pytest.approx(1.0)
    motion = trajectory.motion(np.array([0.0, 30.0, begins["hover"], begins["touchdown"] + 5.0]))
    np.testing.assert_allclose(np.degrees(motion.rpy[-2:]), [[0.0, 0.0, -160.0]] * 2, atol=1e-9)
    np.testing.assert_allclose(np.degrees(motion.rpy), [[0.0, 0.0, -160.0]] * 4, atol=6e-3)  # meridians converge
    np.testing.assert_allclose(motion.specific_force[-1, :2], 0.0, atol=2e-4)  # plumb line and normal differ
    assert -motion.specific_force[-1, 2] == pytest.approx(9.8157, abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(motion.angular_rate, axis=1), 7.292115e-5, rtol=1e-9)


@pytest.mark.parametrize(
    ("settings", "name", "words"),
    [
        (("approach.glide_slope_deg=20",), "landing_smooth", "`profile: pad` flies up to 80 deg"),
        (("approach.glide_slope_deg=12",), "odense", "s after touchdown, on the roll-out: give duration_s 143 or less"),
        (("approach.glide_slope_deg=9",), "odense", "give duration_s 129 or less, or `approach.speed_is: ground`"),
        (("approach.speed_start_kmh=200",), "beacons_pad", "brakes at up to .* m/s2, at most 5"),
        (("approach.hover_height_m=78",), "beacons_pad", "below the hover at 78 m"),
        (("approach.sink_m_s=9",), "beacons_pad", "takes 18 m; hover_height_m is 15"),
        (("approach.guidance=estimate",), "beacons_pad", "reference"),
        (("approach.flight_technical_error={lateral: {sigma_m: 3}}",), "beacons_pad", "no course to be off"),
        (("approach.indicator={}",), "beacons_pad", "does not lead to the touchdown point"),
        (("wind={speed_m_s: 5, from_deg: 0, turbulence: {severity: light}}",), "beacons_pad", "no course to be off"),
        (("runway.tch_m=15",), "beacons_pad", "onto a pad, has no slope"),
    ],
)
def test_what_flies_instead(settings: tuple[str, ...], name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        scenario(*settings, name=name)


def test_what_results_say_of_a_landing_on_a_pad_in_wind() -> None:
    """The wind has a headwind and no crab, since the nose keeps its heading."""
    here = case("wind={speed_m_s: 12, from_deg: 150}", "filter.kind=eskf", "imu.rate_hz=20", name="beacons_pad")
    (told,) = [text for text in here.warnings if "wind" in text]
    assert told.startswith("wind.speed_m_s is not used")  # the errors are those without it
    result = landing.result(here, landing.fly_all(here, 1, 0, 1, threads(1), keep="errors"), 1, keep="errors")
    assert np.isnan(result["/summary/at/crab"]).all()
    assert np.isfinite(result["/summary/at/headwind"]).any()
    assert np.isfinite(result["/truth/airspeed"]).all()
    passed = dict(zip(HEIGHTS, crossing_times(here), strict=True))
    assert passed["touchdown"] == pytest.approx(here.trajectory.path.events["touchdown"], abs=1e-6)
    assert passed["200ft"] < passed["100ft"] < passed["50ft"] < passed["touchdown"]
