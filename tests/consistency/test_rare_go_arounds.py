"""Ranging errors that are drawn given an alarm: against closed forms, and against errors that are drawn as they are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.gnss import dll
from navsim.integrity.residuals import Monitor
from navsim.landing import rare_events
from navsim.landing.study import fly_all
from navsim.landing.total_errors import went_around
from navsim.runner.executor import threads
from navsim.simulation.alarm_events import SHARE, AlarmProposal
from navsim.simulation.flight import Flight
from navsim.simulation.measurements import smoothed
from navsim.simulation.sensitivity import Slopes, of_ranges, range_covariance
from navsim.statistics.importance_sampling import FEW
from tests.consistency.test_rare_events import LINEAR
from tests.helpers import case

BRIEF = (
    *LINEAR, "imu.rate_hz=50", "duration_s=61", "box={height_m: 30, lateral_m: 3}",
    "approach.go_around={on_alarm: true, delay_s: 1}", "requirements=[{what: go_around, at_most: 0.001}]",
)  # fmt: skip
LASTING = (
    "receiver.smoothing_s=20", "signals.errors={multipath: {sigma_m: 3, correlation_time_s: 8}}",
    "pseudolites={count: 2, frame: runway, s_m: 200, l1_m: 1000, survey_sigma_m: 0.5}",
)  # fmt: skip


def covariance(flight: Flight) -> np.ndarray:
    """Covariance (e s, e s) of the errors of smoothed ranges, by unit slopes."""
    signals, out = flight.shared.signals, []
    for unit in np.eye(signals.used.size).reshape(-1, 1, *signals.used.shape):
        slopes, phases, none = unit, None, np.zeros((1, 0, 3))
        if signals.smoothing is not None:
            slopes, phases = dll.smoothing_slopes(unit, signals.smoothing)
        moved = of_ranges(flight, Slopes(none[0], none, none, slopes, np.zeros_like(slopes), phases, ()))
        out.append(smoothed_sum(flight, moved[0][0], None if moved[2] is None else moved[2][0]).ravel())
    return np.array(out)


def smoothed_sum(flight: Flight, ranges: np.ndarray, phases: np.ndarray | None) -> np.ndarray:
    """Errors of smoothed ranges (e, s) by those of codes and carriers."""
    each = smoothed(flight.shared, ranges[..., None], None if phases is None else phases[..., None])[..., 0]
    return np.where(flight.shared.signals.used, each, 0.0)


def alarms(found: AlarmProposal, errors: np.ndarray) -> np.ndarray:
    """Whether errors (m, e, s) of ranges make the monitor alarm at an epoch that breaks a run off (m,)."""
    monitor, each = found.flight.snapshot, np.moveaxis(errors, 0, -1)
    assert monitor is not None
    if isinstance(monitor, Monitor):
        statistic = (monitor.solution.residuals(each) ** 2).sum(axis=1)
    else:
        statistic = np.concatenate(
            [monitor.statistic(each[..., i : i + WIDTH]) for i in range(0, len(errors), WIDTH)], axis=1
        )
    return np.asarray((statistic > monitor.threshold[:, None])[found.epoch].any(axis=0))


@pytest.mark.parametrize(
    ("integrity", "settings", "bias"),
    [
        ("{method: chi2, p_fa: 3e-3}", (), 0.0),
        ("{method: chi2, p_fa: 1e-3}", LASTING, 3.0),
        ("{method: mhss, p_fa_v: 5e-3, p_fa_h: 2e-3}", LASTING, 0.0),
    ],
)
def test_alarms_that_are_drawn(integrity: str, settings: tuple[str, ...], bias: float) -> None:
    """Weighted errors alarm as often as those that are drawn as they are: white ones in closed form, or errors that
    last, of the covariance of all epochs, with a bias of one range; each epoch's covariance is a block of that one."""
    flown = case(*BRIEF, "receiver.rate_hz=0.2", f"integrity={integrity}", *settings, "method=rare")
    flight, (found, _) = flown.flight, AlarmProposal.of(flown.flight)
    assert found is not None
    used, rng = flight.shared.signals.used, np.random.default_rng(5)
    every = covariance(flight)
    blocks = np.einsum("esez->esz", every.reshape(*used.shape, *used.shape))
    np.testing.assert_allclose(blocks, range_covariance(flight), atol=1e-9)
    biases = np.where(np.arange(used.shape[1]) == np.argmax(used.all(axis=0)), bias, 0.0) * used
    found = replace(found, mean=found.mean + np.einsum("nfs,ns->nf", found.rows, biases[found.epoch]))
    variance, axes = np.linalg.eigh(every)
    root = axes * np.sqrt(np.maximum(variance, 0.0))
    plain, drawn = (np.reshape(rng.standard_normal((n, len(root))) @ root.T, (n, *used.shape)) for n in (8000, 480))
    weights, count = np.empty(len(drawn)), float(alarms(found, plain + biases).mean())
    for i, errors in enumerate(drawn):
        if i < SHARE * len(drawn):
            ranges, _, phases = found._drawn(rng, errors)
            errors += smoothed_sum(flight, ranges, phases)
        weights[i] = 1.0 / (1.0 - SHARE + SHARE * (found.shares @ found._densities(errors)))
    hits = weights * alarms(found, drawn + biases)
    value, error = hits.mean(), hits.std() / math.sqrt(hits.size)
    assert hits.sum() ** 2 / (hits**2).sum() > 0.4 * SHARE * hits.size
    expected, spread = count, math.sqrt(count * (1.0 - count) / len(plain))
    if not settings:
        expected, spread = 1.0 - 0.997 ** np.unique(found.epoch).size, 0.0
    assert abs(value - expected) < 3.0 * math.hypot(error, spread)
    assert error < 0.15 * value


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (("integrity={method: chi2, p_fa: 0.1}",), "probabilities of alarms of all tests add up to 1.1"),
        (("integrity={method: chi2, p_fa: 1e-6}", "signals.range_sigma_m=0.1",
          "signals.troposphere={correction: none}"), "systematic errors alone let a test of fixes alarm"),
        (("integrity={method: filter}",), "not those of the filter"),
    ],
)  # fmt: skip
def test_why_no_alarms_are_drawn(settings: tuple[str, ...], why: str) -> None:
    """Alarms that plain runs have often enough, by noise or by what lasts, and alarms of another monitor."""
    found, told = AlarmProposal.of(case(*BRIEF, "receiver.rate_hz=0.2", *settings, "method=rare").flight)
    assert found is None
    assert why in told


@pytest.mark.parametrize(
    ("p_fa", "runs", "counted"),
    [(1e-6, 24, 0), pytest.param(1e-6, 480, 0, marks=pytest.mark.long),
     pytest.param(7e-4, 640, 8000, marks=pytest.mark.long)],
)  # fmt: skip
def test_rare_go_arounds(p_fa: float, runs: int, counted: int) -> None:
    """As often as any of the independent fixes that matter alarms, far beyond what plain runs can count."""
    settings = *BRIEF, "receiver.rate_hz=2", f"integrity={{method: chi2, p_fa: {p_fa}}}"
    flown = case(*settings, "method=rare", name="landing_gnss_only")
    edge = rare_events.prepare(flown)
    assert edge.alarms is not None
    gone = -math.expm1(edge.alarms.epoch.size * math.log1p(-p_fa))
    pushed = rare_events.fly_all(flown, edge, 8, 0, runs, threads(1))
    (value, *_), relative, effective = rare_events.go_around_probability(edge, pushed)
    assert abs(value / gone - 1.0) < 3.0 * relative
    assert 0.1 * runs < effective
    assert relative < 2.5 / math.sqrt(runs)
    verdict = rare_events.result(flown, edge, pushed, 8)["/summary/requirements/verdict"][0]
    assert verdict == ("undecided" if effective < FEW else "met" if p_fa < 1e-5 else "not met")
    if counted:
        plain = case(*settings, "method=monte-carlo", name="landing_gnss_only")
        count = float(went_around(fly_all(plain, 7, 0, counted, threads(1), keep="none")).mean())
        assert abs(count - value) < 3.0 * math.hypot(relative * value, math.sqrt(count / counted))
