"""Rare total errors and touchdowns: first order against the flight forward, a Lyapunov equation, and counting."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import cont2discrete
from scipy.special import ndtri

from navsim.compiler.lanes import WIDTH
from navsim.filter.records import OUTPUT
from navsim.gnss.fix_states import FIXED, FLOAT, SINGLE, WRONG
from navsim.landing import rare_events
from navsim.landing.ensemble import interpolate_outputs, to_runway
from navsim.landing.rare_events import LimitState
from navsim.landing.study import Case, fly_all
from navsim.landing.total_errors import went_around
from navsim.report.rare import table
from navsim.runner.executor import threads
from navsim.runner.statistics import weighted_share
from navsim.simulation.along_truth import along_truth
from navsim.simulation.importance_sampling import PushedRuns
from navsim.simulation.landing_covariance import analyse
from navsim.simulation.measurements import smoothed
from navsim.simulation.run_inputs import draw_inputs
from navsim.statistics.importance_sampling import FEW
from tests.consistency.test_rare_events import LINEAR
from tests.helpers import case
from tests.layout import as_declared

AT, TOTAL = 58.0, "error: total, height_m: 4.285493775748449"
"""When the box is passed, s, at an output of the filter; the box, whose limits are missing."""
STEERED = (*LINEAR, "approach.guidance=estimate", "imu.rate_hz=50", "receiver.rate_hz=2")
PART = "{sigma_m: 0.4, correlation_time_s: 8}"
TECHNICAL = f"approach.flight_technical_error={{lateral: {PART}, along: {PART}, vertical: {PART}}}"
SCALED = (
    "imu.accelerometer.scale_ppm=3000", "imu.accelerometer.noise_mg=0", "imu.accelerometer.bias_mg=0",
    "radio_altimeter={sigma_floor_m: 0.3, sigma_share: 0.03}",
)  # fmt: skip
GUSTS = ("wind.speed_m_s=5", "wind.from_deg=60", "wind.turbulence={severity: light}")


def steered(box: str, *settings: str, method: str = "rare") -> Case:
    return case(f"box={{{box}}}", f"method={method}", *STEERED, *settings, name="landing_gnss_only")


def by_lyapunov(flown: Case) -> np.ndarray:
    """Sigma (3,), m, of the lateral, along-track and vertical deviation of steered runs at `AT`: the covariance of
    filter errors and motion, forward from output to output.

    No true sensor state may vary: filter errors are then a Markov chain, with the covariance of the analysis."""
    shared, ways, flight = flown.shared, flown.shared.dispersion, flown.flight
    assert ways is not None
    along = along_truth(flight)
    lin, steps, events = along.lin, along.steps, flight.events
    s = analyse(flight, np.zeros(len(shared.signals.names), bool), along).covariance
    n, step, autopilot = s.shape[1], 1.0 / 50.0, ways.disturbance.air.autopilot
    assert autopilot is not None
    moved, gain = np.zeros((12, 12)), np.zeros((3, 6))
    drive = np.zeros((12, 3))
    for axis, channel in enumerate(autopilot.channels):
        part = slice(4 * axis, 4 * axis + 4)
        a, b = channel.aircraft
        moved[part, part], drive[part, axis : axis + 1] = cont2discrete((a, b[:, None], a, b[:, None]), step)[:2]
        gain[axis, 2 * axis : 2 * axis + 2] = channel.gain
    estimate = np.zeros((6, 12))  # lateral, along, up and their rates
    estimate[range(6), [0, 1, 4, 5, 8, 9]] = 1.0
    heading = math.radians(flown.scenario.runway.heading_deg)
    c, s_ = math.cos(heading), math.sin(heading)
    seen = np.zeros((6, n))
    for axis, unit in enumerate(np.array([[-s_, c, 0.0], [c, s_, 0.0], [0.0, 0.0, -1.0]])):
        seen[2 * axis, :3] = seen[2 * axis + 1, 3:6] = unit
    since = np.searchsorted(ways.disturbance.time, shared.filter_time - 1e-9)
    at = int(np.argmin(np.abs(shared.filter_time - AT)))
    mm, mx = np.zeros((12, 12)), np.zeros((12, n))
    f = np.eye(n)
    for i in range(events.time.size):
        if steps.interval[i] >= 0:
            f = lin.transition[steps.interval[i]] @ f
        if events.kind[i] == OUTPUT:
            row = events.row[i]
            if row:
                mx = mx @ f.T
            if row == at:
                break
            for k in range(since[row], since[row + 1]):
                slope, rate = ways.disturbance.slope[:, k]
                law = gain.copy()
                law[2, 2] -= gain[2, 4] * slope + gain[2, 5] * rate
                law[2, 3] -= gain[2, 5] * slope
                a, b = moved - drive @ law @ estimate, drive @ law @ seen
                mm = a @ mm @ a.T + b @ s[row] @ b.T + a @ mx @ b.T + b @ mx.T @ a.T
                mx = a @ mx + b @ s[row]
            f = np.eye(n)
        elif (w := steps.measurement[i]) >= 0:
            there = lin.have[w] > 0.0
            f = f - lin.gain[w][:, there] @ lin.h[w, there] @ f
    return np.sqrt(np.diagonal(mm)[[0, 4, 8]])


def prepared(box: str, *settings: str) -> tuple[Case, LimitState]:
    flown = steered(box, *settings)
    return flown, rare_events.prepare(flown)


@pytest.mark.parametrize(
    ("guidance", "coupling"),
    [("estimate", "loose"), ("estimate", "tight"), pytest.param("reference", "loose", marks=pytest.mark.long)],
)
def test_first_order_is_the_flight_forward(guidance: str, coupling: str) -> None:
    """Each pushed run's first-order error by slopes, and by its first-order estimates that fly through the autopilot;
    pushes move it by what they say. One of a scale factor is of the run's own increments, that of a noise has the run's
    own sigma."""
    flown, edge = prepared(
        f"{TOTAL}, lateral_m: 3, vertical_m: 4",
        TECHNICAL,
        *GUSTS,
        *SCALED,
        f"approach.guidance={guidance}",
        f"filter.coupling={coupling}",
    )
    flight, ways, runs = flown.flight, flown.shared.dispersion, range(WIDTH)
    linear, tilt = flown.first_order, edge.tilt
    assert ways is not None
    assert linear is not None
    pushes = PushedRuns(flight, tilt, 3)
    along = flight.along_route
    inputs = pushes.inputs(runs, draw_inputs(along, 3, runs))
    errors = linear.errors(along, inputs, smoothed(along.shared, inputs.ranges, inputs.phases))
    drawn = ways.departure(3, runs, WIDTH, pushes.walks(runs))
    way = ways.commanded(drawn, WIDTH, ways.known(errors) if ways.steered else None)
    outputs = flown.shared.filter_time
    turned = way.at(outputs)[0][:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    if not ways.steered:
        turned = turned + to_runway(flown) @ errors[:, :3]
    off = interpolate_outputs(flown, [edge.box.time], turned.transpose(2, 0, 1))[:, 0].T
    np.testing.assert_allclose(tilt.mean[:, None] + pushes.off(runs), off, atol=1e-3)
    still = PushedRuns(flight, replace(tilt, proposal=replace(tilt.proposal, shifts=0.0 * tilt.proposal.shifts)), 3)
    each = tilt.proposal.shifts[pushes.components(runs)]
    np.testing.assert_allclose(pushes.off(runs) - still.off(runs), tilt.proposal.covariance @ each.T, atol=1e-9)
    assert np.abs(each).max() > 0.0
    own, route = (draw_inputs(f, 3, runs) for f in (flight, along))
    assert own.flown is not None
    moved = pushes.inputs(runs, own)
    gain = (moved.dv - own.dv) / own.flown.dv
    np.testing.assert_allclose(gain[1:], np.broadcast_to(gain[:1], gain[1:].shape), rtol=1e-6, atol=1e-15)
    here, there = ((a.aided[0] - b.aided[0]) for a, b in ((moved, own), (inputs, route)))
    sensor = flown.shared.aids[0].sensor
    here /= sensor.noise_sigma(own.aided_exact[0])
    there /= sensor.noise_sigma(route.aided_exact[0])
    both = np.isfinite(here) & np.isfinite(there)
    np.testing.assert_allclose(here[both], there[both], rtol=1e-6, atol=1e-12)
    assert min(np.abs(gain[:, 2]).max(), np.abs(there[both]).max()) > 1e-8


def test_first_order_of_touchdowns() -> None:
    """Small deviations end where the runs' own touchdowns are."""
    flown, edge = prepared("error: touchdown, lateral_m: 3, along_m: 200", *GUSTS, "approach.guidance=reference")
    ways, air = flown.shared.dispersion, edge.tilt.air
    assert ways is not None
    assert air is not None
    drawn = ways.departure(3, range(WIDTH), WIDTH)
    small = replace(drawn, way=1e-3 * drawn.way)
    _, along, right, _ = ways.end.endings(small).touchdown
    np.testing.assert_allclose(edge.tilt.mean[:2, None] + air.off(small)[:2], [right, along], rtol=5e-3, atol=1e-5)


CHANCE = 1e-5


@pytest.mark.parametrize(("runs", "counted"), [(64, 0), pytest.param(4000, 20_000, marks=pytest.mark.long)])
def test_steered_runs(runs: int, counted: int) -> None:
    """Sigma by a Lyapunov equation, and the closed form of flight-technical error; a chance of 1e-5 within 3 standard
    errors of the Gaussian one; and the same pushed runs have the chance of a smaller error that plain runs count."""
    sigma = by_lyapunov(steered(f"{TOTAL}, lateral_m: 3"))
    lateral, _, vertical = (-ndtri(CHANCE / 4.0) * np.hypot(sigma, 0.4)).tolist()
    flown, edge = prepared(f"{TOTAL}, lateral_m: {lateral}, vertical_m: {vertical}", TECHNICAL)
    assert edge.tilt.air is not None
    np.testing.assert_allclose(edge.tilt.air.covariance, 0.16 * np.eye(3), rtol=1e-4, atol=1e-4)
    without = np.diagonal(edge.tilt.proposal.covariance - edge.tilt.air.covariance)
    np.testing.assert_allclose(np.sqrt(without), sigma, rtol=2e-4)
    pushed = rare_events.fly_all(flown, edge, 6, 0, runs, threads(1))
    (value, *_), relative, effective = rare_events.probability(edge, pushed)
    assert abs(value / CHANCE - 1.0) < 3.0 * relative
    assert relative < 4.0 / math.sqrt(runs)
    assert effective > 0.1 * runs
    assert rare_events.not_linear(edge, pushed).max() < 0.02
    if not counted:
        return
    plain = steered(f"{TOTAL}, lateral_m: 3", TECHNICAL, method="monte-carlo")
    errors = fly_all(plain, 7, 0, counted, threads(1), keep="none").per_run("at_box")[:, 0]
    for chance in (1e-2, 1e-1):
        limit = -ndtri(0.5 * chance) * math.hypot(sigma[0], 0.4)
        share = float((np.abs(errors[:, 0]) > limit).mean())
        outside = np.abs(pushed.per_run("error")[:, 0]) > limit
        (found, *_), relative, _ = weighted_share(pushed.per_run("log_weight"), outside, 10.0, 10.0)
        assert abs(share - found) < 3.0 * math.hypot(relative * found, math.sqrt(share * (1.0 - share) / counted))


STATED = ("receiver.fix_states={}", "imu.rate_hz=50", "receiver.rate_hz=2", "duration_s=61")
LIMITS = "vertical_m: 1"


@pytest.mark.parametrize(
    ("settings", "runs", "counted"),
    [
        (("filter.fix_flag=ignore",), 48, 0),
        pytest.param((), 1600, 20_000, marks=pytest.mark.long),
        pytest.param(
            ("approach.guidance=estimate", "initial_errors.attitude_deg=1"), 1600, 8000, marks=pytest.mark.long
        ),  # with 5 degrees the gate rejects the first fixes of some runs, which leave the route
    ],
)
def test_fixes_that_have_a_state(settings: tuple[str, ...], runs: int, counted: int) -> None:
    """Weighted histories are in a state as often as the chain is; first-order errors of pushed runs, weighted, leave
    the box as often as Gaussian errors of other histories do; the first runs, flown, have them; plain runs count the
    same."""
    box = f"{LIMITS}, error: total" if "approach.guidance=estimate" in settings else LIMITS
    stated, plain = (case(f"box={{{box}}}", f"method={m}", *STATED, *settings) for m in ("rare", "monte-carlo"))
    edge = rare_events.prepare(stated)
    assert edge.histories is not None
    assert edge.tilt.mean == pytest.approx(0.0, abs=0.01)
    model, several = edge.histories.shifts.model, [edge.histories.drawn(5, run) for run in range(2000)]
    weight = np.exp([one.log_weight for one in several])
    for state, since, until in ((FIXED, 0.0, 0.0), (FLOAT, 50.0, 57.0), (SINGLE, 35.0, 60.0), (WRONG, 20.0, 58.0)):
        place = np.array([one.history.at(np.array([since, until])) for one in several])
        has = [one.history.state[p] == state and p == q for one, (p, q) in zip(several, place, strict=True)]
        chance = float(model.shares[state] * np.exp((since - until) / model.mean_time[state]))
        assert abs(np.mean(weight * has) - chance) < 4.0 * np.std(weight * has) / math.sqrt(weight.size)
    pushes, off, weights = PushedRuns(stated.flight, edge.tilt, 3, edge.histories), [], []
    for first in range(0, runs, WIDTH):
        pack = range(first, first + WIDTH)
        own = pushes.off(pack)
        weights.append(pushes.log_weights(pack, own))
        off.append(own + np.stack([tilt.mean for tilt in pushes.tilts(pack)], axis=1))
    outside = edge.box.beyond(np.concatenate(off, axis=1).T).any(axis=1)
    (found, *_), relative, _ = weighted_share(np.concatenate(weights), outside, 1.0, 1.0)
    drawn = [edge.histories.drawn(4, run)[:2] for run in range(runs)]
    chance = [math.exp(w) * edge.histories.shifts.chances(edge.histories.shifts.of(h)).sum() for h, w in drawn]
    error = math.hypot(relative * found, float(np.std(chance)) / math.sqrt(runs))
    assert abs(found - np.mean(chance)) < 3.0 * error
    assert error < 3.0 * found / math.sqrt(runs)
    flown = rare_events.fly_all(stated, edge, 3, 0, runs if counted else 4 * WIDTH, threads(1))
    assert rare_events.not_linear(edge, flown).max() < 0.7
    if counted:
        (found, *_), relative, _ = rare_events.probability(edge, flown)
        share = fly_all(plain, 7, 0, counted, threads(1), keep="none").per_run("at_box")[:, 0]
        count = float(edge.box.beyond(share).any(axis=1).mean())
        assert abs(count - found) < 3.0 * math.hypot(relative * found, math.sqrt(count / counted))


@pytest.mark.parametrize(("since", "until", "size"), [(35, 57, 4), (45, 52, 6)])
def test_a_gate_holds_a_filter_to_a_wrong_fix(
    since: int, until: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mean error to first order, of a wrong fix that ended before the box, is that of plain runs: the gate rejects
    later fixes, and further ones after the first that it accepts, since velocity is then wrong."""
    monkeypatch.setattr(rare_events, "HistoryProposal", SimpleNamespace(of=lambda *_: None))
    wrong = f"{{state: wrong, at_s: {since}, until_s: {until}, error_ned_m: [0, 0, {size}]}}"
    settings = f"receiver.fix_states={{forced: [{wrong}]}}", "initial_errors.attitude_deg=1", *STATED[1:]
    stated, plain = (case(f"box={{{LIMITS}}}", f"method={m}", *settings) for m in ("rare", "monte-carlo"))
    mean = rare_events.prepare(stated).tilt.mean[2]
    flown = fly_all(plain, 7, 0, 2 * WIDTH, threads(1), keep="none").per_run("at_box")[:, 0, 2]
    assert mean == pytest.approx(float(np.median(flown)), abs=0.15)
    assert abs(mean) > 3.0


ALARMS = "approach.go_around={on_alarm: true, delay_s: 1}", "integrity={method: chi2, p_fa: 4e-3}"


@pytest.mark.parametrize(
    ("chance", "runs", "counted"),
    [
        (CHANCE, 64, 0),
        pytest.param(CHANCE, 1920, 0, marks=pytest.mark.long),
        pytest.param(1e-2, 960, 20_000, marks=pytest.mark.long),
    ],
)
def test_alarms_that_break_landings_off(chance: float, runs: int, counted: int) -> None:
    """Residuals of least squares are independent of its solution, and of each other: runs leave the box without an
    alarm as often as Gaussian errors do times (1 - p_fa) to the number of fixes. Alarms are as frequent."""
    sigma = by_lyapunov(steered(f"{TOTAL}, lateral_m: 3"))
    limits = "lateral_m: {}, vertical_m: {}".format(*(-ndtri(chance / 4.0) * sigma[[0, 2]]).tolist())
    flown, edge = prepared(f"{TOTAL}, {limits}", *ALARMS, "requirements=[{what: go_around, at_most: 0.1}]")
    ways = flown.shared.dispersion
    assert ways is not None
    each = np.eye(ways.at_fixes.time.size, dtype=bool)
    begin = np.concatenate([ways.begins(each[:, i : i + WIDTH]) for i in range(0, len(each), WIDTH)])
    gone, quiet = 1.0 - 0.996 ** np.isfinite(begin).sum(), 0.996 ** (begin < edge.box.time).sum()
    pushed = rare_events.fly_all(flown, edge, 8, 0, runs, threads(1))
    out = rare_events.result(flown, edge, pushed, 8)
    as_declared(out)
    found, share = out["/summary/rare/probability"][0], out["/summary/rare/go_around"][0]
    errors = [one(edge, pushed)[1] for one in (rare_events.probability, rare_events.go_around_probability)]
    errors[1] *= share
    assert abs(found / (chance * quiet) - 1.0) < 3.0 * errors[0]
    assert errors[0] < 5.0 / math.sqrt(runs)
    assert abs(share - gone) < 3.0 * errors[1]
    assert rare_events.not_linear(edge, pushed).max() < 0.02
    few = out["/summary/rare/go_around_effective_samples"] < FEW
    told = [one.text for one in rare_events.findings(flown, edge, pushed) if one.name == "few_go_arounds"]
    assert few == ("few_go_arounds" in out["/findings/finding"]) == bool(told)
    assert not few or "add up to 0.48," in told[0]
    shown = str(table([("", out)]))
    assert shown.index("The same to first order") < shown.index("Go-around after an alarm"), "the same as outside"
    if counted:
        plain = steered(f"{TOTAL}, {limits}", *ALARMS, method="monte-carlo")
        ended = fly_all(plain, 7, 0, counted, threads(1), keep="none")
        outside = edge.box.beyond(ended.per_run("at_box")[:, 0]).any(axis=1) & ~went_around(ended, edge.box.time)
        for one, value, error in ((outside, found, found * errors[0]), (went_around(ended), share, errors[1])):
            count = float(one.mean())
            assert abs(count - value) < 3.0 * math.hypot(error, math.sqrt(count * (1.0 - count) / counted))
