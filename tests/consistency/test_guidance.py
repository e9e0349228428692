"""Aircraft that their own estimates steer: the autopilot against scipy, and the closed loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from scipy.signal import cont2discrete

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.landing.ensemble import LandingStudy
from navsim.landing.result import result as summarised
from navsim.landing.study import fly_all
from navsim.runner.executor import threads
from navsim.runner.findings import open_loops
from navsim.simulation import landing as simulation
from navsim.simulation.landing import LOOP_TOLERANCE, fly
from navsim.trajectory.autopilot import Autopilot, Channel
from navsim.trajectory.guidance import GuidanceErrors, steered
from navsim.trajectory.track_frame import Course
from tests.conftest import Within
from tests.consistency.test_flown_ways import GENTLE, mechanised, ways_of
from tests.helpers import case
from tests.layout import as_declared

STEERED = "approach.guidance=estimate"
AUTOPILOT = Autopilot((
    Channel(5.0, 1.0, 0.3, 4.0, 3.0), Channel(4.0, None, 0.5, 1.5), Channel(6.0, 0.8, 0.4, 2.0),
))  # fmt: skip
STEP = 0.01


def level_course(samples: int) -> Course:
    """North at 25 m/s, high up."""
    right, ahead = np.zeros((2, 3, samples, 3))
    right[0, :, 1], ahead[0, :, 0] = 1.0, 1.0
    height, slowness, airborne = np.zeros((3, samples)), np.zeros((2, samples)), np.zeros((3, samples))
    height[0], slowness[0], airborne[0] = 100.0, 0.04, 1.0
    return Course(right, ahead, height, slowness, airborne)


def motion(
    known: GuidanceErrors,
    samples: int,
    climb: float = 0.0,
    autopilot: Autopilot = AUTOPILOT,
    step: float = STEP,
    displaced: np.ndarray | None = None,
) -> np.ndarray:
    """What the autopilot flies lateral, along, up, with rates and accelerations (3, 3, samples, W); displaced: by gusts
    (samples, 3, 2, W)."""
    lanes = known.values.shape[2]
    way, turn, slope = np.zeros((samples, 9, lanes)), np.zeros((samples, 6, lanes)), np.zeros((2, samples))
    slope[0], course = climb, level_course(samples)
    for own in (slice(first, first + WIDTH) for first in range(0, lanes, WIDTH)):
        parts = [np.ascontiguousarray(m[..., own]) for m in (known.values, way, turn)]
        of_gusts = None if displaced is None else displaced[..., own]
        steered(autopilot, GuidanceErrors(known.first, parts[0]), course, slope, step, True, *parts[1:], of_gusts)
        way[..., own], turn[..., own] = parts[1:]
    np.testing.assert_allclose(turn[:, 0], 0.5 / 9.80665 * way[:, 7], atol=1e-15)  # bank
    np.testing.assert_allclose(turn[:, 2], 0.5 * 0.04 * way[:, 4], atol=1e-15)  # nose
    of_axes = way.reshape(samples, 3, 3, lanes)[:, :, [1, 0, 2]].transpose(2, 1, 0, 3)
    return of_axes * np.array([1.0, 1.0, -1.0])[:, None, None, None]


def drawn(samples: int, lanes: int, sigma: float = 3.0) -> GuidanceErrors:
    first = np.arange(0, samples, 7)
    return GuidanceErrors(first, np.random.default_rng(4).normal(0.0, sigma, (first.size, 6, lanes)))


def responses() -> list[tuple[np.ndarray, np.ndarray]]:
    """Transition (4, 4) and drive (4, 1) of each axis over a sample, by scipy."""
    a, b, out = np.zeros((4, 4)), np.zeros((4, 1)), []
    a[0, 1] = a[1, 2] = a[2, 3] = 1.0
    for lag in (0.3, 0.5, 0.4):
        a[3, 2:], b[3] = [-1.0 / lag**2, -2.0 / lag], 1.0 / lag**2
        out.append(cont2discrete((a, b, np.eye(4), np.zeros((4, 1))), STEP)[:2])
    return out


def flown_by_numpy(
    known: GuidanceErrors, samples: int, climb: float, displaced: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same motion, and commands, of an autopilot that is given nothing but estimates (3, 2, W)."""
    lanes, signs = known.values.shape[2], np.array([1.0, 1.0, -1.0])
    out, commands = np.zeros((samples, 3, 4, lanes)), np.zeros((samples, 3, lanes))
    held, steps = np.zeros((3, lanes)), responses()

    def asked(estimate: np.ndarray) -> np.ndarray:
        lateral, along, up = estimate
        up = up - climb * along
        return np.stack([
            -lateral[0] / 25.0 - 0.4 * lateral[1], -along[1] / 4.0, -up[0] / 36.0 - 1.6 / 6.0 * up[1]
        ])  # fmt: skip

    for k in range(samples - 1):
        row = np.searchsorted(known.first, k, side="right") - 1
        wrong = known.values[row].reshape(2, 3, lanes)[:, [1, 0, 2]] * signs[:, None]
        now = asked(out[k, :, :2] + displaced[k] - wrong.transpose(1, 0, 2))
        now[0] = np.clip(now[0], held[0] - 3.0 * STEP, held[0] + 3.0 * STEP)
        held = np.clip(now, [[-4.0], [-1.5], [-2.0]], [[4.0], [1.5], [2.0]])
        commands[k] = held
        for axis, (transition, drive) in enumerate(steps):
            out[k + 1, axis] = transition @ out[k, axis] + drive * held[axis]
    return out[:, :, :3].transpose(1, 2, 0, 3), commands


@pytest.mark.validates("an aircraft that is steered by its estimate", "zero-order hold (scipy)", value="1e-9 m")
@pytest.mark.parametrize("sigma", [0.5, 60.0])
def test_autopilot(sigma: float, within: Within) -> None:
    """Commands from estimates alone, with and without limits, on a slope."""
    known, gusts = drawn(900, WIDTH, sigma), np.random.default_rng(5).normal(0.0, 0.1 * sigma, (900, 3, 2, WIDTH))
    for displaced in (0.0 * gusts, gusts):
        expected, commands = flown_by_numpy(known, 900, -0.09, displaced)
        found = motion(known, 900, -0.09, displaced=displaced)
        np.testing.assert_allclose(found, expected, atol=within["value"])
    np.testing.assert_array_equal(motion(known, 900, -0.09, displaced=0.0 * gusts), motion(known, 900, -0.09))
    assert (np.abs(commands[:, 1]).max() == 1.5) == (sigma == 60.0)  # whether limits are reached


def test_guidance_never_reads_the_truth() -> None:
    """Estimates that stand still, half a metre off, ask for the same as long as they do: the truth runs away, and gusts
    take it further."""
    due, commands = np.zeros((3000, 3, 4)), (-0.5 / 25.0, -0.5 / 4.0, -0.5 / 36.0)
    for axis, (transition, drive) in enumerate(responses()):
        for k in range(2999):
            due[k + 1, axis] = transition @ due[k, axis] + drive[:, 0] * commands[axis]
    gusts = 30.0 * np.sin(STEP * np.arange(3000))[:, None, None] * np.ones((3, 2))
    # truth - estimate: m, and m/s along the course
    wrong = due[:, :, :2] + gusts - [[0.5, 0.0], [0.5, 0.5], [0.5, 0.0]]
    up = [[[1.0], [1.0], [-1.0]]]
    values = (wrong[:, [1, 0, 2]] * up).transpose(0, 2, 1).reshape(3000, 6, 1) + np.zeros(WIDTH)
    way = motion(GuidanceErrors(np.arange(3000), values), 3000, displaced=gusts[..., None] + np.zeros(WIDTH))
    np.testing.assert_allclose(way, due[:, :, :3].transpose(1, 2, 0)[..., None] + np.zeros(WIDTH), atol=1e-9)
    assert way[0, 0, -1].max() < -8.0


def test_estimates_without_error_steer_to_nothing() -> None:
    """Nor does an estimate that is unknown from the start."""
    first, values = np.array([0, 10]), np.full((2, 6, WIDTH), np.nan)
    values[:, :, 1] = 0.0
    assert not motion(GuidanceErrors.of(first, values), 300).any()


@pytest.mark.long
def test_a_loop_closes_that_leaves_the_glide_path() -> None:
    """Run 774 leaves the sector of the glide path for good. Each flight knows that for some seconds more, 22 in all."""
    flown = case(STEERED, name="landing_ils")
    (run,) = flown.fly_runs(1, 774, 1, measured=False)
    assert run.loop_gap.max() <= LOOP_TOLERANCE


def test_an_estimate_that_is_lost_is_held() -> None:
    """Guidance keeps the error that it had last; of two outputs at one sample the later counts."""
    first, values = np.array([0, 0, 10, 20]), np.zeros((4, 6, 2))
    values[0], values[1], values[2], values[3] = 9.0, 1.0, np.nan, 3.0
    values[:2, :, 1] = np.nan
    held = GuidanceErrors.of(first, values)
    np.testing.assert_array_equal(held.first, [0, 10, 20])
    np.testing.assert_array_equal(held.values[:, 0], [[1.0, 0.0], [1.0, 0.0], [3.0, 3.0]])


@pytest.mark.validates("covariance of steered aircraft", "Lyapunov equation (scipy)", value="3 %")
def test_total_errors_of_a_linear_loop(within: Within) -> None:
    """Errors of Gauss-Markov processes: position of 8 s, velocity of 3 s, in steps of the outputs. The total error lags
    behind the navigation error and is smaller, by less than 30 %."""
    lanes, samples, every, step = 1504, 1200, 2, 0.05
    first, rng = np.arange(0, samples, every), np.random.default_rng(8)
    decay = np.exp(-every * step / np.array([8.0, 8.0, 8.0, 3.0, 3.0, 3.0]))[:, None]
    sigma = np.array([2.0, 2.0, 2.0, 0.2, 0.2, 0.2])[:, None]
    values = np.empty((first.size, 6, lanes))
    values[0] = sigma * rng.standard_normal((6, lanes))
    for k in range(1, first.size):
        values[k] = decay * values[k - 1] + sigma * np.sqrt(1.0 - decay**2) * rng.standard_normal((6, lanes))
    lateral, along, vertical = (Channel(c.time, c.damping, c.lag, np.inf) for c in AUTOPILOT.channels)
    free = Autopilot((lateral, along, vertical))
    way = motion(GuidanceErrors(first, values), samples, autopilot=free, step=step)[:, :, 800:]
    for axis, channel in ((0, AUTOPILOT.channels[0]), (2, AUTOPILOT.channels[2])):
        a, effect = np.zeros((6, 6)), np.zeros((6, 6))
        a[0, 1] = a[1, 2] = a[2, 3] = 1.0
        lag, own = channel.lag, np.array([1.0 / channel.time**2, 2.0 * channel.damping / channel.time])
        a[3, 2:4] = [-1.0 / lag**2, -2.0 / lag]
        a[3, :2] -= own / lag**2
        a[3, 4:] = own / lag**2
        a[4, 4], a[5, 5] = -1.0 / 8.0, -1.0 / 3.0
        effect[4, 4], effect[5, 5] = 2.0 * 2.0**2 / 8.0, 2.0 * 0.2**2 / 3.0
        due = solve_continuous_lyapunov(a, -effect)
        off = way[axis, 0]
        assert np.sqrt(np.mean(off**2)) == pytest.approx(np.sqrt(due[0, 0]), rel=within["value"])
        assert np.sqrt(np.mean(way[axis, 1] ** 2)) == pytest.approx(np.sqrt(due[1, 1]), rel=within["value"])
        assert 0.7 * 2.0 < np.sqrt(due[0, 0]) < 2.0
        own = values[800 // every :, 2 if axis == 2 else 1].repeat(every, axis=0)
        before, now = (np.abs(np.mean(off[160:] * own[160 - k : 400 - k])) for k in (160, 0))  # of 8 s
        assert before > 1.3 * now


def test_the_least_damped_mode() -> None:
    """Of the closed loop, by its characteristic polynomial."""
    channel = Channel(2.0, 0.7, 0.5, 1.0)
    lags = np.polymul([0.5, 1.0], [0.5, 1.0])
    roots = np.roots(np.polyadd(np.polymul([1.0, 0.0, 0.0], lags), [2.0 * 0.7 / 2.0, 0.25]))
    assert channel.least_damping == pytest.approx(np.min(-roots.real / np.abs(roots)))


def test_the_loop_closes() -> None:
    """What a run flies is where its own estimate steers it, its sensors are on that way, and it is its own: the same
    bits, whoever flies beside it."""
    guided = case(STEERED, *GENTLE, "runway.heading_deg=75")
    ways, runs = ways_of(guided.shared), range(WIDTH)
    flown = fly(guided.flight, 1, runs, measured=False)
    assert flown.loop_gap.max() <= LOOP_TOLERANCE
    known = ways.known(flown.error[..., states.POS : states.ATT].transpose(1, 2, 0))
    again = ways.commanded(ways.departure(1, runs, WIDTH), WIDTH, known)
    there = again.at(guided.shared.filter_time)[0]
    deviation = np.stack([there[:, 1], there[:, 0], -there[:, 2]], axis=1).transpose(2, 0, 1)
    np.testing.assert_allclose(deviation, flown.deviation, atol=LOOP_TOLERANCE)
    assert np.abs(flown.deviation).max() > 0.3
    position, turn = mechanised(guided.shared, ways.flown(again), 0)
    assert position < 0.01
    assert turn < 1e-6
    alone = fly(guided.flight, 1, [2], measured=False)
    np.testing.assert_array_equal(alone.error[0], flown.error[2])


def test_open_and_closed_loops_agree_where_guidance_is_perfect() -> None:
    """Estimates a millionth as wrong as usual: both fly the route, with the same errors."""
    perfect = (
        "imu.gyro={drift_deg_h: 1.0e-6, arw_deg_sqrt_h: 1.0e-7}", "signals={range_sigma_m: 1.0e-5}", "filter.kind=eskf",
        "imu.accelerometer={bias_mg: 1.0e-6, vrw_m_s_sqrt_h: 1.0e-8}", "duration_s=40", "imu.rate_hz=25",
        "initial_errors={attitude_deg: 1.0e-6, position_m: 1.0e-5, velocity_m_s: 1.0e-6}", "receiver.rate_hz=2",
    )  # fmt: skip
    ways = ("reference", "estimate")
    along, closed = (next(case(*perfect, f"approach.guidance={way}").fly_runs(1, 0, WIDTH, False)) for way in ways)
    assert 0.0 < np.abs(closed.deviation).max() < 1e-3
    np.testing.assert_allclose(closed.error, along.error, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(closed.sigma, along.sigma, rtol=1e-6)


def test_first_order_errors_predict_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two flights close the loops of nearly all runs; one that needs more flies them beside those of other lanes, with
    the same bits as alone."""
    guided, flights = case(STEERED, *GENTLE), []
    fly_filter = simulation._filter
    monkeypatch.setattr(simulation, "_filter", lambda *inputs: (flights.append(1), fly_filter(*inputs))[1])
    flown = list(guided.fly_runs(1, 0, 2 * WIDTH, measured=False))
    together, count = np.concatenate([pack.error for pack in flown]), len(flights)
    assert max(pack.loop_gap.max() for pack in flown) <= LOOP_TOLERANCE
    assert 4 <= count <= 6
    monkeypatch.setattr(simulation, "TOGETHER", 1)
    again = list(guided.fly_runs(1, 0, 2 * WIDTH, measured=False))
    np.testing.assert_array_equal(np.concatenate([pack.error for pack in again]), together)
    along_route = fly(guided.flight, 1, range(WIDTH), measured=False)
    np.testing.assert_allclose(along_route.deviation, flown[0].deviation, atol=2.0 * LOOP_TOLERANCE)
    np.testing.assert_array_equal(guided.fly(1, WIDTH + 3).error, together[WIDTH + 3])


def test_errors_of_steered_runs() -> None:
    """What the truth is off the route is the total system error, and what the estimate is off it flight-technical."""
    guided = case(STEERED, *GENTLE, "box={error: total, lateral_m: 5, vertical_m: 5}")
    flown = fly_all(guided, 1, 0, WIDTH, threads(2), keep="all")
    judged = summarised(guided, flown, 1, keep="all")
    as_declared(judged)
    at = LandingStudy(guided, 1, "all").crossings
    for axis, name in enumerate(("lateral", "along", "vertical")):
        off = [np.interp(at, guided.shared.filter_time, one) for one in judged[f"/filter/deviation_{name}"]]
        np.testing.assert_allclose(judged[f"/summary/at/{name}_tse_run"], off, atol=1e-9)
        np.testing.assert_allclose(judged["/summary/box/error_run"][:, axis], np.array(off)[:, 0], atol=1e-9)
        parts = judged[f"/summary/at/{name}_fte_run"] + judged[f"/summary/at/{name}_run"]
        np.testing.assert_allclose(judged[f"/summary/at/{name}_tse_run"], parts, atol=1e-12)
    assert float(judged["/summary/guidance/loop_gap"]) <= LOOP_TOLERANCE


def test_a_loop_that_stays_open_is_found() -> None:
    (found,) = open_loops(np.array([0.001, 0.3, np.nan]), 0.01)
    assert (found.name, found.count) == ("open_loop", 2)
    assert open_loops(np.array([0.001]), 0.01) == []
