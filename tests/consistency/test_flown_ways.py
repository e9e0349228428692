"""Runs that deviate from the route: their sensors, their truth and their errors belong to the way that each flies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, binomtest, norm

from navsim.compiler.lanes import WIDTH
from navsim.filter import states, strapdown
from navsim.geodesy import attitude_kernels as attitude
from navsim.geodesy import earth
from navsim.gnss.signals import build_signals
from navsim.landing.result import result as summarised
from navsim.landing.study import covariance_analysis, fly_all
from navsim.results.result import read
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.simulation.dispersed_trajectory import DispersedTrajectories, Dispersion
from navsim.simulation.shared_truth import SharedTruth
from navsim.trajectory.dispersion import PathDeviation
from navsim.trajectory.kinematics import integrate
from tests.conftest import SCENARIOS
from tests.helpers import case, scenario
from tests.layout import as_declared
from tests.product.test_run import navsim

PART = "{sigma_m: 3, correlation_time_s: 10}"
SHRINKING = "{sigma_m: 2, reference_height_m: 100, floor_m: 0.5}"
FTE = f"approach.flight_technical_error={{lateral: {PART}, along: {{sigma_m: 2}}, vertical: {SHRINKING}}}"
WIND = ("wind.speed_m_s=8", "wind.from_deg=60", "wind.profile=log")
GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1", "duration_s=61")

GRAVITY = 9.84
"""Nowhere on the ground is it more, m/s2."""


def ways_of(world: SharedTruth) -> Dispersion:
    assert world.dispersion is not None
    return world.dispersion


def mechanised(world: SharedTruth, flown: DispersedTrajectories, lane: int) -> tuple[float, float]:
    """How far an error-free mechanisation of a run ends from its truth, m, and how much it is turned, rad."""
    nav = np.zeros(states.NAV_N)
    nav[:3], nav[3:6], nav[6:10] = (m[0, :, lane] for m in (flown.llh, flown.velocity, flown.quaternion))
    increments = (np.ascontiguousarray(m[..., lane]) for m in (flown.dtheta, flown.dv))
    step, count = world.imu_time[1] - world.imu_time[0], flown.dtheta.shape[0]
    out = np.empty((2, states.NAV_N))
    strapdown.navigate(nav, states.declared(states.biases()), *increments, step, count, out)
    turn = np.empty(3)
    attitude.difference(flown.quaternion[-1, :, lane].copy(), out[1, 6:10], turn)
    off = earth.ecef_from_llh(flown.llh[-1, :, lane]) - earth.ecef_from_llh(out[1, :3])
    return float(np.linalg.norm(off)), float(np.linalg.norm(turn))


def most_off(world: SharedTruth, flown: DispersedTrajectories, lane: int) -> tuple[float, float]:
    """What `mechanised` may find where nothing is wrong, from the order of the integration.

    Two samples correct for coning and sculling exactly where rates change linearly. A jerk that jumps at samples makes
    rates jump there: each correction, a twelfth of a cross product, may be wrong by as much as itself. Summed up by
    their sizes these bound the turn; for the position each is an error of velocity, and a tilt that turns gravity,
    from then on.
    """
    dtheta, dv, left = flown.dtheta[..., lane], flown.dv[..., lane], (world.imu_time[-1] - world.imu_time[1:-1])
    coning = np.linalg.norm(np.cross(dtheta[:-1], dtheta[1:]), axis=1) / 12.0
    sculling = np.linalg.norm(np.cross(dtheta[:-1], dv[1:]) + np.cross(dv[:-1], dtheta[1:]), axis=1) / 12.0
    return float((0.5 * GRAVITY * left**2 * coning + left * sculling).sum()), float(coning.sum())


@pytest.mark.parametrize(("name", "seconds"), [("landing", 59.0), ("landing_smooth", 120.0)])
@pytest.mark.validates(
    "a flown way, mechanised without errors", "its own truth", "the sum of its corrections for coning and sculling"
)
def test_the_mechanised_way_is_the_flown_one(name: str, seconds: float) -> None:
    """At 100 Hz, in wind; where the approach ends in a bend, which no two samples follow, up to it."""
    world = case(FTE, *WIND, f"duration_s={seconds}", name=name).shared
    assert world.filter_time[-1] == pytest.approx(world.imu_time[-1])
    flown = ways_of(world).flown(ways_of(world).departure(1, range(WIDTH), WIDTH))
    assert np.abs(flown.deviation).max() > 3.0
    for lane in range(WIDTH):
        assert np.less(mechanised(world, flown, lane), most_off(world, flown, lane)).all()


def test_increments_are_integrals_of_the_motion() -> None:
    """The kernel's against Gauss' rule over the motion that numpy makes of the same departure."""
    world = case(FTE, *WIND, "duration_s=20").shared
    ways = ways_of(world)
    flown = ways.flown(ways.departure(3, [5], WIDTH))
    way = ways.of_run(flown, 0)
    dtheta, dv = integrate(way.motion, ways.trajectory.path.knots, world.imu_time)
    np.testing.assert_allclose(flown.dtheta[..., 0], dtheta, atol=2e-12)
    np.testing.assert_allclose(flown.dv[..., 0], dv, atol=3e-8)  # rough accelerations in turning axes, of zero mean


def test_what_is_felt_is_the_derivative_of_the_way() -> None:
    """Velocity, specific force and angular rate by differences of positions and attitudes, between samples too."""
    world = case(FTE, *WIND, "duration_s=20").shared
    ways = ways_of(world)
    way = ways.of_run(ways.flown(ways.departure(3, [5], WIDTH)), 0)
    t, step = 0.5033 + 0.5 * np.arange(38), 1e-4  # a jerk jumps at samples
    ahead, behind, here = (way.motion(t + d) for d in (step, -step, 0.0))
    np.testing.assert_array_equal(way.llh(t), here.llh)
    velocity = (ahead.position_ecef - behind.position_ecef) / (2.0 * step)
    np.testing.assert_allclose(velocity, here.velocity_ecef, atol=2e-5)
    acceleration = (ahead.velocity_ecef - behind.velocity_ecef) / (2.0 * step)
    turning = 2.0 * np.cross([0.0, 0.0, earth.RATE], here.velocity_ecef)
    force = acceleration + turning - earth.gravity_ecef(here.position_ecef)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", here.c_eb, here.specific_force), force, atol=2e-4)
    turn = np.einsum("nji,njk->nik", here.c_eb, (ahead.c_eb - behind.c_eb) / (2.0 * step))
    rate = here.angular_rate - here.c_eb.swapaxes(1, 2) @ [0.0, 0.0, earth.RATE]
    np.testing.assert_allclose(np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1), rate, atol=1e-5)


def test_ranges_are_those_of_the_antenna() -> None:
    """Against the signals that are built anew along the flown way: satellites move while light travels, 1 mm."""
    flown_case = case(FTE, "duration_s=20", "receiver.lever_arm_m=[2, 0.5, -1]", "pseudolites.height_m=20")
    world = flown_case.shared
    ways = ways_of(world)
    flown = ways.flown(ways.departure(3, [5], WIDTH))
    motion = ways.of_run(flown, 0).motion(world.signals.time)
    anew = build_signals(motion, flown_case.scenario.epoch.timestamp(), flown_case.environment)
    there = world.signals.used & anew.used
    assert there.any()
    np.testing.assert_allclose(flown.antenna[..., 0], anew.antenna, atol=1e-8)
    np.testing.assert_allclose(flown.ranges[..., 0][there], anew.range[there], atol=1e-3)
    np.testing.assert_allclose(flown.rates[..., 0][there], anew.range_rate[there], atol=1e-4)
    assert np.abs(flown.ranges[..., 0] - world.signals.range)[there].max() > 0.5


def test_sigmas_of_deviations() -> None:
    """Of place, velocity and acceleration: those of the process, by height where it shrinks; it ends on the ground."""
    world = case(FTE, "imu.rate_hz=20", "receiver.rate_hz=1").shared
    ways = ways_of(world)
    time = ways.disturbance.time
    some = np.searchsorted(time, [0.0, 20.0, 40.0])
    drawn = [ways.departure(7, range(first, first + WIDTH), WIDTH) for first in range(0, 400, WIDTH)]
    way = np.concatenate([d.way for d in drawn], axis=2)
    lateral = way[some][:, [1, 4, 7]].swapaxes(0, 1).reshape(3, -1)
    expected = np.array([3.0, 3.0 * 0.8 / 3.0 / np.sqrt(3.0), 3.0 * (0.8 / 3.0) ** 2])
    np.testing.assert_allclose(lateral.std(axis=1), expected, rtol=0.07)
    height = -ways.trajectory.path.jet(time[some])[:, 0, 2]
    shrunk = np.hypot(2.0 * height / 100.0, 0.5)
    np.testing.assert_allclose(way[some, 2].std(axis=1), shrunk, rtol=0.12)
    assert not way[time > 66.0, 2].any()
    assert way[time > 66.0, 1].any()


def test_a_run_is_its_own() -> None:
    """Its way depends on its number alone, not on those that fly beside it; lanes left over repeat the last."""
    ways = ways_of(case(FTE, "duration_s=10").shared)
    alone, beside = ways.flown(ways.departure(1, [2], WIDTH)), ways.flown(ways.departure(1, range(WIDTH), WIDTH))
    np.testing.assert_array_equal(alone.dv[..., 0], beside.dv[..., 2])
    np.testing.assert_array_equal(alone.dv[..., 0], alone.dv[..., WIDTH - 1])
    assert np.abs(beside.deviation[..., 0] - beside.deviation[..., 2]).max() > 0.1


@pytest.mark.parametrize("runs", [320, pytest.param(1000, marks=pytest.mark.long)])
def test_errors_are_of_the_flown_way(runs: int) -> None:
    """The filter is as good and as honest as on the route; TSE^2 = NSE^2 + FTE^2, within their 99 % band; a box of
    total errors, with a zone to touch down in, is left as often as their Gaussian says."""
    boxed = case(*GENTLE, FTE, "runway.aim_point_m=150", "box={error: total, lateral_m: [-3, 5], "
                 "from_threshold_m: [146.5, 156], vertical_m: 20}")  # fmt: skip
    deviating, route = (fly_all(one, 1, 0, runs, threads(2), keep="none") for one in (boxed, case(*GENTLE)))
    nees = deviating.per_run("nees_position_velocity_mean").mean()
    assert nees == pytest.approx(route.per_run("nees_position_velocity_mean").mean(), abs=0.05)
    nse, fte = deviating.per_run("at_height"), deviating.per_run("at_deviation")
    np.testing.assert_allclose(nse.std(axis=0), route.per_run("at_height").std(axis=0), rtol=0.1)
    product = nse * fte
    beyond = product.sum(axis=0) / np.sqrt((product**2).sum(axis=0))
    assert np.abs(beyond).max() < 3.3  # of twelve numbers: 99 %
    judged = summarised(boxed, deviating, 1, keep="none")
    np.testing.assert_array_equal(judged["/summary/box/error_run"], (nse + fte)[:, 0])  # touchdown
    assert judged["/summary/box/place"] == pytest.approx(150.0, abs=0.01)  # of some 0.1 ms
    np.testing.assert_allclose(judged["/summary/box/lower"], [-3.0, -3.5, -20.0], atol=0.01)
    np.testing.assert_allclose(judged["/summary/box/upper"], [5.0, 6.0, 20.0], atol=0.01)
    of_gaussian, inside = judged["/summary/box/axis_gaussian"], 1.0
    for axis, (technical, least, most) in enumerate(((3.0, -3.0, 5.0), (2.0, -3.5, 6.0))):
        of_total = norm(scale=np.hypot(technical, route.per_run("at_height")[:, 0, axis].std()))
        chance = of_total.cdf(least) + of_total.sf(most)
        inside *= 1.0 - chance
        _, low, high = judged["/summary/box/axis_probability"][axis]
        assert low < chance < high
        assert of_gaussian[axis] == pytest.approx(chance, rel=0.4)  # by the mean and sigma of the runs
    assert of_gaussian[2] < 1e-12  # nobody is outside
    few, many = binom.interval(0.99, runs, 1.0 - inside)
    assert few <= judged["/summary/box/outside"] <= many
    value, low, high = judged["/summary/box/probability"]
    of_binomial = binomtest(int(judged["/summary/box/outside"]), runs).proportion_ci(0.95, "exact")
    np.testing.assert_allclose((low, high), of_binomial)
    assert value == judged["/summary/box/outside"] / runs


def test_sensors_beside_the_receiver_are_on_the_way() -> None:
    """Heights above the ground are those of the run."""
    radio = "radio_altimeter={sigma_floor_m: 0.001}"
    flown_case = case(FTE, *GENTLE, radio)
    run = flown_case.fly(1, 0)
    (aid,) = flown_case.shared.aids
    seen = np.isfinite(run.aided[:, 0]) & np.isfinite(aid.exact[:, 0])
    off = (run.aided[:, 0] - aid.exact[:, 0])[seen]
    way = np.interp(aid.time[seen], flown_case.shared.filter_time, run.deviation[:, 2])
    assert np.abs(way).max() > 0.5
    assert np.abs(off - way)[aid.time[seen] < 59.0].max() < 0.2  # the ground is level, the nose turns the arm


def test_covariance_analysis_is_of_the_route() -> None:
    one, other = (covariance_analysis(case(*GENTLE, *more)) for more in ((FTE,), ()))
    np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (("box={lateral_m: 3, error: total}",), "box.error"),
        (("box={lateral_m: 3, error: total}", "method=covariance", FTE), "box.error"),
        (("approach.flight_technical_error={}",), "approach.flight_technical_error"),
        (("approach.guidance=estimate", "filter.kind=rts"), "approach.guidance"),
        (("approach.flight_technical_error={follow_estimate_s: 5}",),
         "approach.flight_technical_error.follow_estimate_s"),
        (("approach.autopilot={lateral_time_constant_s: 7}",), "approach.autopilot"),
        (("approach.guidance=estimate", "approach.autopilot={lateral_time_constant_s: 1, bank_lag_s: 1}"),
         "approach.autopilot.lateral_time_constant_s"),
        (("approach.flight_technical_error={lateral: {sigma_m: 30, correlation_time_s: 2}}",),
         "approach.flight_technical_error.lateral.correlation_time_s"),
        (("approach.flight_technical_error={vertical: {sigma_m: 3, floor_m: 1}}",),
         "approach.flight_technical_error.vertical.floor_m"),
    ],
)  # fmt: skip
def test_what_is_refused(settings: tuple[str, ...], key: str) -> None:
    with pytest.raises(InputError, match=key):
        scenario(*settings)


def test_the_result(tmp_path: Path) -> None:
    """All that is declared, the same in tables; fixes are judged by where the antenna was."""
    target = tmp_path / "r.h5"
    settings = [f"--set={one}" for one in (FTE, *GENTLE)]
    done = navsim("run", str(SCENARIOS / "landing.yaml"), "--runs", "8", "--keep", "all", "-o", str(target), *settings,
                  "--figures", "none", cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "System errors at height, m" in done.stdout
    result = read(target)
    as_declared(result)
    for axis in ("lateral", "along", "vertical"):
        at = {kind: result[f"/summary/at/{axis}{kind}_run"] for kind in ("", "_fte", "_tse")}
        np.testing.assert_array_equal(at["_tse"], at[""] + at["_fte"])
    fixed, true = (earth.ecef_from_llh(result[f"/receiver/{name}position_llh"]) for name in ("", "true_"))
    assert np.sqrt(np.nanmean((fixed - true) ** 2)) < 5.0
    live = navsim("live", str(SCENARIOS / "landing.yaml"), "--set", FTE, "--receiver", "-", cwd=tmp_path, code=2)
    assert "flight_technical_error" in live.stderr


def test_departures_meet_at_samples() -> None:
    """What is interpolated has the values of the samples at both ends of an interval."""
    rng = np.random.default_rng(1)
    time = 0.01 * np.arange(5)
    departure = PathDeviation(time, *(rng.standard_normal((5, k, WIDTH)) for k in (9, 6, 3)))
    for near in (0.0, -1e-12):
        way, turn = departure.at(time[1:4] + near)
        np.testing.assert_allclose(way, departure.way[1:4], atol=1e-6)
        np.testing.assert_allclose(turn, departure.turn[1:4], atol=1e-6)
