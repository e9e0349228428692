"""Gusts and turbulence in flight: what they make of the ways of runs, by closed forms and by equations solved anew."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from navsim.compiler.lanes import WIDTH
from navsim.scenario_files.source import InputError
from navsim.trajectory import air
from navsim.trajectory.dispersion import Disturbance, PathDeviation, _slowed
from tests.conftest import Within
from tests.consistency.test_flown_ways import FTE, WIND, mechanised, most_off, ways_of
from tests.helpers import case, scenario

STEP = 0.01
STRONG = "wind.turbulence={severity: moderate}"
GUSTS = (
    "wind.gusts=[{amplitude_m_s: 5, towards: right, start_s: 10, ramp_s: 2, hold_s: 5}, "
    "{amplitude_m_s: -4, towards: up, start_s: 30, ramp_m: 60}]"
)
STEADY = "wind.gusts=[{{amplitude_m_s: 5, towards: {0}, start_s: 1, ramp_s: 2}}]"
LEVEL = ("wind.speed_m_s=0", "approach.pitch=path", "duration_s=30")
RIGHT, ALONG, UP = range(3)


def departed(*settings: str, seconds: float, runs: int = WIDTH, name: str = "landing_smooth") -> PathDeviation:
    """Of runs that share nothing, over the first seconds of a flight that begins level."""
    flown = scenario(*settings, name=name)
    what = flown.air()
    assert what is not None
    time = STEP * np.arange(round(seconds / STEP) + 1)
    disturbance = Disturbance.of(what[0], flown.trajectory(), time)
    drawn = []
    for first in range(0, runs, WIDTH):
        rngs = {
            n: tuple(np.random.default_rng((n, run)) for run in range(first, first + WIDTH)) for n in disturbance.walks
        }
        drawn.append(disturbance.drawn(rngs, WIDTH, WIDTH))
    parts = ("way", "turn", "gust")
    return PathDeviation(time, *(np.concatenate([getattr(d, part) for d in drawn], axis=2) for part in parts))


def predicted(world: Any, height: np.ndarray, airspeed: np.ndarray) -> np.ndarray:
    """1 sigma (k,) of the acceleration off the route, m/s2, by the closed forms of a lagged gust and of a third-order
    process: without what guidance does against it."""
    what = ways_of(world).disturbance.air
    assert what.turbulence is not None
    scales, sigmas = what.turbulence.time_scales(height, airspeed), what.turbulence.sigmas(height)
    across, along, up = what.response.lags(airspeed)
    out = np.zeros(height.size)
    for t, sigma, lag, transverse in zip(scales.T, sigmas.T, (along, across, up), (0, 1, 1), strict=True):
        first, second = 1.0 / (lag * (t + lag)), (3.0 * t + 2.0 * lag) / (2.0 * lag * (t + lag) ** 2)
        out += sigma**2 * (second if transverse else first)
    for part in (what.lateral, what.along, what.vertical):
        assert part is not None
        out += (part.scale(np.stack([height, 0.0 * height, 0.0 * height]))[0] * part.beta**2) ** 2
    return np.sqrt(out)


@pytest.mark.validates("a flown way in gusts and turbulence, mechanised without errors", "its own truth",
                       "the sum of its corrections for coning and sculling", sigmas="5")  # fmt: skip
def test_everything_on_is_mechanised_and_felt_as_predicted(within: Within) -> None:
    """Over 120 s at 100 Hz, in wind, gusts and turbulence, off the route besides; specific force within 5 sigma."""
    world = case(FTE, *WIND, STRONG, GUSTS, name="landing_smooth").shared
    ways = ways_of(world)
    assert world.filter_time[-1] == pytest.approx(world.imu_time[-1])
    flown = ways.flown(ways.departure(1, range(WIDTH), WIDTH))
    for lane in range(WIDTH):
        assert np.less(mechanised(world, flown, lane), most_off(world, flown, lane)).all()
    middle = 0.5 * (ways.disturbance.time[1:] + ways.disturbance.time[:-1])
    flying = middle < ways.trajectory.path.events["touchdown"]
    jet = ways.trajectory.path.jet(middle[flying])
    airspeed = np.linalg.norm(jet[:, 1] - ways.trajectory.wind.mean(middle[flying]), axis=1)
    sigma = predicted(world, -jet[:, 0, 2], airspeed)
    met = [one.moved(None)[0][2, :, 0] for one in calm(ways.disturbance)]
    gusts = np.sqrt(np.sum(np.square(met), axis=0))[1:][flying]
    of_route, felt = (
        np.linalg.norm(dv, axis=1)[flying] / STEP for dv in (world.dv[..., None], flown.dv)
    )  # fmt: skip
    more = (np.abs(felt - of_route) - gusts[:, None]) / sigma[:, None]
    assert 2.0 < more.max() < within["sigmas"]


def calm(disturbance: Disturbance) -> list[Any]:
    """What the gusts alone do along each axis."""
    return list(Disturbance.of(
        air.Air(disturbance.air.response, gusts=disturbance.air.gusts), _trajectory(), disturbance.time
    ).buffeting.values())  # fmt: skip


def _trajectory() -> Any:
    return scenario(*WIND, name="landing_smooth").trajectory()


@pytest.mark.validates("ways of runs in turbulence", "stationary covariance of the process", sigma="6 %")
def test_sigmas_in_turbulence(within: Within) -> None:
    """Of place, speed, acceleration and of the nose, at the begin and later, at one height and airspeed."""
    way = departed(*LEVEL, STRONG, seconds=20.0, runs=400)
    some = [0, 1000, 2000]
    flown = scenario(*LEVEL, STRONG, name="landing_smooth")
    height, speed = np.array(flown.approach.start_height_m), np.array(flown.approach.speed_start_kmh / 3.6)
    turbulence = air.Turbulence(30.0 * air.KNOT)
    response = flown.wind.response.model()
    scales, sigmas, lags = turbulence.time_scales(height, speed), turbulence.sigmas(height), response.lags(speed)
    for axis, gust, place, body in ((RIGHT, 1, 1, 2), (ALONG, 0, 0, None), (UP, 2, 2, 1)):
        process, row = air.dryden(float(scales[gust]), gust > 0)
        felt = air.through(process, sigmas[gust] * row, air.carried(float(lags[axis]), response.loop, 0.5))
        first, p = row.size, felt.covariance
        acceleration = felt.a[first + 2]
        expected = [p[first + 1, first + 1], p[first + 2, first + 2], acceleration @ p @ acceleration]
        found = [way.way[some][:, place + 3 * order].std() for order in range(3)]
        np.testing.assert_allclose(found, np.sqrt(expected), rtol=within["sigma"])
        if body is not None:
            nose = 0.5 * np.sqrt([p[first + 3, first + 3], p[first + 4, first + 4]]) / speed
            found = [way.turn[some][:, body + 3 * order].std() for order in range(2)]
            np.testing.assert_allclose(found, nose, rtol=within["sigma"])


@pytest.mark.parametrize("guidance", ["reference", "estimate"])
@pytest.mark.parametrize(("towards", "place", "sign"), [("right", 1, 1.0), ("along", 0, 1.0), ("up", 2, -1.0)])
def test_a_gust_is_answered(towards: str, place: int, sign: float, guidance: str) -> None:
    """As its equations are solved by another program; at last it has turned nothing but the nose, into the wind. With
    guidance by the estimate nothing answers the true displacement: it is left to the autopilot."""
    settings = STEADY.format(towards), "wind.response={guidance_s: 3}", f"approach.guidance={guidance}"
    way, answer = departed(*LEVEL, *settings, seconds=30.0), float(guidance == "reference")
    assert not np.ptp(way.way, axis=2).any()
    flown = scenario(*LEVEL, "wind.gusts=[]", name="landing_smooth")
    speed = flown.approach.speed_start_kmh / 3.6
    slope = {"right": 0.98, "along": 0.12, "up": 5.0}[towards]
    lag = 2.0 * 200.0 / (1.225 * 9.80665 * speed * slope)

    def rates(t: float, x: np.ndarray) -> list[float]:
        gust = 2.5 * (1.0 - math.cos(math.pi * min(max((t - 1.0) / 2.0, 0.0), 1.0)))
        lift = (gust - x[0]) / lag
        nose = ((x[2] - gust) - x[3] - 2.0 * 0.5 * x[4]) / 0.5**2
        return [lift, x[2], lift - answer * (x[1] / 9.0 + 2.0 * x[2] / 3.0), x[4], nose]

    solved = solve_ivp(rates, (0.0, 30.0), np.zeros(5), t_eval=way.time, rtol=1e-10, atol=1e-10, max_step=0.05)
    np.testing.assert_allclose(sign * way.way[:, place, 0], solved.y[1], atol=1e-6)
    np.testing.assert_allclose(sign * way.way[:, place + 3, 0], solved.y[2], atol=1e-6)
    assert np.abs(solved.y[1]).max() > 2.0
    body = {"right": 2, "up": 1}.get(towards)
    if body is None:
        assert not way.turn.any()
        return
    if answer:
        assert abs(way.way[-1, place, 0]) < 0.02
        assert way.turn[-1, body, 0] == pytest.approx(-2.5 / speed, rel=0.02)
    np.testing.assert_allclose(way.turn[:, body, 0], 0.5 * solved.y[3] / speed, atol=1e-8)
    np.testing.assert_allclose(way.turn[:, 3 + body, 0], 0.5 * solved.y[4] / speed, atol=1e-8)


def test_what_fades_near_the_ground_loses_its_velocity() -> None:
    """The motion sin t, whose velocity is multiplied by cos t: the integral of cos^2."""
    t = np.linspace(0.0, 3.0, 301)
    cos, sin = np.cos(t)[:, None], np.sin(t)[:, None]
    place, speed, acceleration = _slowed(np.stack([cos, -sin, -cos]), np.stack([sin, cos, -sin]), 0.01)
    np.testing.assert_allclose(place[:, 0], 0.5 * t + 0.25 * np.sin(2.0 * t), atol=1e-10)
    np.testing.assert_allclose(speed, cos**2, atol=1e-15)
    np.testing.assert_allclose(acceleration, -2.0 * sin * cos, atol=1e-15)


def test_where_gusts_go() -> None:
    """On a runway that points east a gust to the north is one to the left; the wind's own goes with it; they add up."""
    heading = ("runway.heading_deg=90", "duration_s=12", "approach.lead_in_s=30")
    left = departed(*heading, "wind.speed_m_s=0", STEADY.format("north"), seconds=10.0).way[-1, :2, 0]
    assert left[1] < -1.0
    assert abs(left[0]) < 1e-3 * abs(left[1])
    ahead = departed(*heading, "wind.speed_m_s=0", STEADY.format("east"), seconds=10.0).way[-1, :2, 0]
    assert ahead[0] > 1.0
    assert abs(ahead[1]) < 1e-3 * ahead[0]
    wind = ("wind.speed_m_s=2", "wind.from_deg=180")
    own, same = (departed(*heading, *wind, STEADY.format(to), seconds=10.0).way[-1] for to in ("wind", "north"))
    np.testing.assert_allclose(own, same, atol=1e-9)
    two = "{amplitude_m_s: 2.5, towards: north, start_s: 1, ramp_s: 2}"
    both = departed(*heading, *wind, f"wind.gusts=[{two}, {two}]", seconds=10.0).way[-1]
    np.testing.assert_allclose(both, same, atol=1e-9)


def test_strengths_and_specifications() -> None:
    """Both forms make one flight; a wind at 20 ft is that of a severity, or of the mean wind's profile there."""

    def place(*settings: str) -> np.ndarray:
        return departed(*LEVEL[1:], *settings, seconds=2.0).way[-1]

    moderate = place(STRONG)
    other = place("wind.turbulence={severity: moderate, specification: mil-hdbk-1797}")
    np.testing.assert_allclose(other, moderate, rtol=1e-9, atol=1e-12)
    knots = 30.0 * 1852.0 / 3600.0
    np.testing.assert_allclose(place(f"wind.turbulence={{w20_m_s: {knots!r}}}"), moderate, rtol=1e-9)
    log = ("wind.profile=log", "wind.from_deg=0", "wind.turbulence={}")
    given = place(*log[:2], "wind.speed_m_s=6", "wind.turbulence={w20_m_s: 6}")
    np.testing.assert_allclose(place(*log, "wind.speed_m_s=6"), given, rtol=1e-9)


def test_the_ground_ends_it() -> None:
    """Nobody is below the runway before touchdown, however strong it is; no height and no attitude are left of it 5 s
    after touchdown; sideways guidance brings the rest back."""
    flown = scenario(name="landing_smooth")
    touchdown = flown.trajectory().path.events["touchdown"]
    severe = "wind.turbulence={severity: severe}"
    way = departed(severe, GUSTS, seconds=touchdown + 25.0)
    route = -flown.trajectory().path.jet(way.time)[:, 0, 2]
    high, before, down = np.searchsorted(way.time, [touchdown - 20.0, touchdown - 10.0, touchdown + 5.01])
    assert np.abs(way.way[high, 2]).max() > 2.0
    assert np.all((route[:, None] - way.way[:, 2])[before : down - 501] > 0.0)
    assert not way.way[down:, 2].any()
    assert not way.turn[down:, 0].any()
    assert not way.turn[down:, 1].any()
    assert np.abs(way.way[down, 1]).max() > 0.1
    assert np.std(way.way[-1, 1]) < 0.2 * np.std(way.way[down, 1])
    assert np.std(way.turn[-1, 2]) < 0.2 * np.std(way.turn[down, 2])


@pytest.mark.parametrize(
    ("settings", "key", "said"),
    [
        (("wind.turbulence={}", "wind.speed_m_s=0"), "wind.turbulence", "severity"),
        (("wind.turbulence={severity: light, w20_m_s: 5}",), "wind.turbulence.w20_m_s", "one of both"),
        ((STRONG, "approach.start_height_m=400"), "wind.turbulence", "304.8"),
        ((STEADY.format("wind"), "wind.speed_m_s=0"), "towards", "no mean wind"),
        (("wind.gusts=[{amplitude_m_s: 5, towards: up, start_s: 1}]",), "ramp_s", "exactly one"),
        (("wind.gusts=[{amplitude_m_s: 0, towards: up, start_s: 1, ramp_s: 1}]",), "amplitude_m_s", "none"),
        (("wind.gusts=[{amplitude_m_s: 1, towards: up, start_s: 500, ramp_s: 1}]",), "start_s", "duration_s"),
        (("wind.response={drag: 0.1}",), "wind.response", "gusts"),
        ((STRONG, "method=covariance", "box={lateral_m: 3, error: total}"), "box.error", "use method rare"),
    ],
)
def test_what_is_refused(settings: tuple[str, ...], key: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        scenario(*settings)
    assert key in str(caught.value)
    assert said in str(caught.value)
