"""The magnetometer in filter and covariance analysis: errors as large as both say, and what straight flight hides."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.filter import states
from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from tests.helpers import case

FIELD = "declination_deg: 11, dip_deg: 71, intensity_ut: 52.5"
ALIGNED = ("duration_s=40", "receiver.rate_hz=1", "initial_errors.attitude_deg=1")
HEADING = states.PHI_D


def magnetometer(*keys: str) -> str:
    """Section with hard iron of 2 uT and these keys."""
    return f"magnetometer={{rate_hz: 2, noise_ut: 0.3, hard_iron_ut: 2, {', '.join((FIELD, *keys))}}}"


@pytest.mark.parametrize("filter_", [("tfg", "loose"), ("eskf", "tight")], ids=["loose", "tight"])
def test_runs_agree_with_filter_and_analysis(filter_: tuple[str, str]) -> None:
    """300 runs of an aligned start, all errors there: each state's error over the filter's sigma, and over that of the
    analysis, is 1 within 8 % in the mean of the outputs (2 sigma of the sampling of one state at one time)."""
    kind, coupling = filter_
    more = "scale_percent: 1, misalignment_mrad: 5, disturbance_ut: 1, mounting_deg: [5, 10, 90]"
    flown = case(*ALIGNED, magnetometer(more), f"filter.kind={kind}", f"filter.coupling={coupling}")
    runs = fly_all(flown, 20, 0, 300, threads())
    analysis = covariance_analysis(flown)
    own = ("magnetometer_hard_iron", "magnetometer_field_model", "magnetometer_soft_iron", "magnetometer_disturbance")
    assert set(own) < set(analysis.sources)
    assert analysis.sources[-1] == "magnetometer"
    rms = np.sqrt(np.mean(runs["error"] ** 2, axis=0))[5:]
    predicted = np.sqrt(analysis.variance.sum(axis=0) + analysis.mean**2)[5:]
    z = np.sqrt(np.mean((runs["error"] / runs["sigma"]) ** 2, axis=0))[5:]
    of_groups = np.arange(len(flown.states) - flown.flight.model.clock_states).reshape(-1, 3)
    for ratio in (rms / predicted, z):
        groups = np.sqrt(np.mean(ratio[:, of_groups] ** 2, axis=(0, 2)))
        np.testing.assert_allclose(groups, 1.0, atol=0.08)
    squares, weighed = (runs.per_run(f"aided_{name}").sum() for name in ("innovations", "weighed"))
    assert squares / weighed == pytest.approx(1.0, abs=0.02)


def test_it_shows_the_heading() -> None:
    """At the end of 40 s the heading is as good as the hard iron over the horizontal field, 17.1 uT; its error in the
    truth alone is told by the budget."""
    settings = ("duration_s=40", "receiver.rate_hz=1", "filter.kind=tfg")
    without = np.sqrt(covariance_analysis(case(*settings)).assumed[-1, HEADING, HEADING])
    analysis = covariance_analysis(case(*settings, magnetometer()))
    found = np.sqrt(analysis.assumed[-1, HEADING, HEADING])
    iron = 2.0 / 17.1
    start = np.radians(5.0)
    assert found == pytest.approx(1.0 / np.hypot(1.0 / iron, 1.0 / start), rel=0.06)
    assert found < 0.5 * without
    share = analysis.variance[analysis.sources.index("magnetometer_hard_iron"), -1, HEADING] / found**2
    assert share > 0.2


def test_straight_flight_does_not_separate_heading_from_hard_iron() -> None:
    """With iron that hides the heading, the filter's sigma stays what start and fixes give (`eskf`: 0.7 of it)."""
    gyro = "imu.gyro={drift_deg_h: 1, noise_deg_h: 1}"
    settings = ("duration_s=40", "receiver.rate_hz=1", "filter.kind=tfg", gyro)
    hidden = magnetometer().replace("hard_iron_ut: 2", "hard_iron_ut: 50")
    sigma = [fly_all(case(*settings, *m), 3, 0, 16, threads())["sigma"][:, -1, HEADING] for m in ((), (hidden,))]
    without, with_it = (np.sqrt(np.mean(s**2)) for s in sigma)
    assert with_it == pytest.approx(without, rel=0.02)
