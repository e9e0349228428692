"""First-order errors of runs: against the adjoint slopes, their exact moments, and the errors that the filter makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.landing.study import Case
from navsim.simulation.along_truth import along_truth
from navsim.simulation.first_order import FirstOrder
from navsim.simulation.landing import fly
from navsim.simulation.landing_covariance import analyse
from navsim.simulation.measurements import smoothed
from navsim.simulation.run_inputs import draw_inputs
from navsim.simulation.sensitivity import deviations
from tests.helpers import case
from tests.unit.test_sensitivity import CASES, ready

BRIEF = ("duration_s=20", "receiver.rate_hz=2")
TIGHT = (*BRIEF, "filter.coupling=tight")
ANY = {
    "eskf": (*BRIEF, "filter.kind=eskf"),
    "gaussian-sum": BRIEF,
    "tight": TIGHT,
    "tight with clock noise": (*TIGHT, "receiver.clock={h0: 2e-20, h_minus2: 1e-22}"),
    "lasting errors": (*BRIEF, "signals.preset=open-sky", "filter.kind=eskf"),
    "smoothed": (*BRIEF, "receiver.smoothing_s=20", "filter.kind=eskf"),
    "late fixes and an altimeter": (
        *BRIEF, "receiver.latency_s=0.253", "altimeter.sigma_m=1.0", "receiver.lever_arm_m=[1, 0.5, -0.7]",
    ),
    "gusts": (*BRIEF, "wind={speed_m_s: 5, from_deg: 60, turbulence: {severity: light}}", "altimeter.sigma_m=1.0"),
    "fixed values": (*BRIEF, "imu.gyro.drift_fixed_deg_h=[300, -200, 100]", "pseudolites.clock_offset_ns=5"),
}  # fmt: skip


def errors(flown: Case, seed: int, runs: range) -> np.ndarray:
    """First-order errors (run, o, 3) of runs without flying them."""
    first_order, out = flown.first_order, []
    assert first_order is not None
    for first in range(runs.start, runs.stop, WIDTH):
        inputs = draw_inputs(flown.flight, seed, range(first, first + WIDTH))
        found = first_order.errors(flown.flight, inputs, smoothed(flown.shared, inputs.ranges, inputs.phases))
        out.append(np.moveaxis(found[:, :3], -1, 0))
    return np.concatenate(out)


@pytest.mark.parametrize("name", CASES)
def test_they_are_the_slopes_times_all_that_is_drawn(name: str) -> None:
    """Forward through the matrices, and backward."""
    flown, _, slopes, at = ready(name)
    inputs = draw_inputs(flown.flight, 5, range(WIDTH))
    first_order = FirstOrder.of(flown.flight)
    found = first_order.errors(flown.flight, inputs, smoothed(flown.shared, inputs.ranges, inputs.phases))[at, :3]
    mean = first_order.mean[at, :3, None]
    assert slopes.mean is not None
    assert np.abs(slopes.mean - mean[:, 0]).max() < 1e-6 * max(1.0, float(np.abs(mean).max()))
    expected = mean + slopes.times(deviations(flown.flight, inputs))
    scale = np.sqrt(np.mean((expected - mean) ** 2))
    assert np.abs(found - expected).max() < 2e-3 * scale


@pytest.mark.parametrize("name", ANY)
def test_their_mean_and_covariance_are_those_of_the_analysis(name: str) -> None:
    """400 draws, over all outputs but the start: means within 4.5 standard errors, and second moments."""
    flown = case(*ANY[name])
    assert flown.first_order is not None
    found = errors(flown, 9, range(400))[:, 5:] - flown.first_order.mean[5:, :3]
    variance = np.diagonal(flown.first_order_covariance, axis1=1, axis2=2)[5:]
    assert np.abs(found.mean(axis=0) / np.sqrt(variance / 400)).max() < 4.5
    assert np.abs(np.mean(found**2, axis=0) / variance - 1.0).max() < 4.5 * np.sqrt(2.0 / 400)


@pytest.mark.parametrize("name", ANY)
def test_the_filter_makes_these_errors(name: str) -> None:
    """What they leave of the errors of runs is small, whatever the filter."""
    flown = case(*ANY[name])
    run = fly(flown.flight, 3, range(WIDTH), False, flown.first_order)
    left, error = run.error[:, 10:, :3] - run.first_order[:, 10:], run.error[:, 10:, :3]
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(error**2))
    inputs = draw_inputs(flown.flight, 3, range(WIDTH))
    assert flown.first_order is not None
    linear = flown.first_order.errors(flown.flight, inputs, smoothed(flown.shared, inputs.ranges, inputs.phases))
    left, error = run.error[:, 10:, 3:6] - np.moveaxis(linear[10:, 3:], -1, 0), run.error[:, 10:, 3:6]
    assert np.sqrt(np.mean(left**2)) < 0.25 * np.sqrt(np.mean(error**2))


def test_the_mean_is_that_of_the_analysis() -> None:
    flown = case(*ANY["fixed values"])
    along = along_truth(flown.flight)
    of_pseudolites = np.isin(flown.shared.signals.names, flown.pseudolites.names)
    analysis = analyse(flown.flight, of_pseudolites, along, second_order=False)
    assert flown.first_order is not None
    np.testing.assert_allclose(flown.first_order.mean, analysis.mean[:, :6], rtol=1e-12)


def test_none_where_the_covariance_analysis_says_nothing() -> None:
    smoother = case(*BRIEF, "filter.kind=rts")
    assert smoother.first_order is None
    assert "smoother" in smoother.why_not_linear


def test_runs_without_them_are_the_same() -> None:
    flown = case(*BRIEF)
    alone, both = (fly(flown.flight, 3, range(3), False, one) for one in (None, flown.first_order))
    assert alone.first_order.size == 0
    for name in type(alone).__dataclass_fields__:
        if name != "first_order":
            np.testing.assert_array_equal(getattr(alone, name), getattr(both, name))
    one = fly(flown.flight, 3, [1], False, flown.first_order)
    np.testing.assert_array_equal(one.first_order[0], both.first_order[1])


def test_an_error_of_one_draw_is_not_lost() -> None:
    """An altimeter's number that is off by 1 m moves the height error by the gain, on the run's own trajectory."""
    flown = case(*ANY["gusts"])
    assert flown.first_order is not None
    inputs = draw_inputs(flown.flight, 1, range(WIDTH))
    ranges = smoothed(flown.shared, inputs.ranges, inputs.phases)
    off = replace(inputs, aided=tuple(a + 1.0 for a in inputs.aided))
    moved = flown.first_order.errors(flown.flight, off, ranges) - flown.first_order.errors(flown.flight, inputs, ranges)
    assert np.ptp(moved, axis=2).max() < 1e-9
    assert 0.05 < abs(moved[-1, 2, 0]) < 1.0
