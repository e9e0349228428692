"""States without any uncertainty, as of perfect sensors, are no degrees of freedom of normalised squared errors."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.landing.case import Case
from navsim.landing.result import result
from navsim.landing.study import covariance_analysis, covariance_result, fly_all
from navsim.report import summary_tables
from navsim.results.findings import of
from navsim.runner.executor import threads
from tests.helpers import case

BRIEF = ("imu.rate_hz=20", "receiver.rate_hz=1", "duration_s=40")
PERFECT = "imu.preset=perfect"
START = "initial_errors={{position_m: {}, velocity_m_s: {}, attitude_deg: {}}}"


def nees(flown: Case) -> tuple[np.ndarray, int]:
    found = covariance_result(flown, covariance_analysis(flown), 1)
    variable = found.variables["/summary/consistency/nees"]
    return np.asarray(variable.data), int(variable.attributes["degrees_of_freedom"])


@pytest.mark.parametrize(
    ("settings", "degrees"),
    [
        ((), 15),
        ((PERFECT,), 9),
        ((PERFECT, "imu.gyro.drift_deg_h=10"), 12),
        ((PERFECT, "imu.accelerometer.bias_fixed_mg=[1, 0, 0]"), 12),
        ((PERFECT, "imu.gyro={markov_deg_h: 3, markov_time_s: 100}"), 12),
        ((PERFECT, START.format(10, 1, 0)), 6),
        ((PERFECT, START.format(10, 0, 0)), 3),
        ((PERFECT, START.format(0, 0, 2)), 9),
        ((PERFECT, START.format(0, 0, 0), "imu.accelerometer.noise_mg=1"), 6),
        ((PERFECT, START.format(0, 0, 0)), 0),
        ((PERFECT, "filter.imu.gyro.drift_deg_h=5"), 12),
        ((PERFECT, "filter.coupling=tight"), 11),
        ((PERFECT, "signals.preset=open-sky"), 15),
    ],
)
def test_degrees_of_freedom(settings: tuple[str, ...], degrees: int) -> None:
    """Biases without sigma and drive, and navigation states that nothing makes uncertain, are left out."""
    assert case(*BRIEF, *settings).degrees() == degrees


@pytest.mark.parametrize("settings", [(), (START.format(10, 1, 0),), ("imu.gyro.drift_deg_h=10",)])
def test_the_expected_square_is_one(settings: tuple[str, ...]) -> None:
    """It was 0.6 over 15 states with perfect sensors."""
    found, _ = nees(case(*BRIEF, PERFECT, *settings))
    np.testing.assert_allclose(found, 1.0, atol=0.02)


def test_nothing_uncertain_has_no_number() -> None:
    found, degrees = nees(case(*BRIEF, PERFECT, START.format(0, 0, 0)))
    assert degrees == 0
    assert np.isnan(found).all()
    exact = case(*BRIEF, PERFECT, START.format(0, 0, 0))
    flown = result(exact, fly_all(exact, 1, 0, 2, threads(1), keep="none"), 1, keep="none")
    assert str(flown["/summary/consistency/verdict"]) == "none: no uncertainty"


def test_runs_of_perfect_sensors() -> None:
    """The mean of 200 runs is one over nine states, groups without uncertainty have no number, and nothing is found."""
    flown = case(*BRIEF, PERFECT, START.format(10, 1, 0.5))
    found = result(flown, fly_all(flown, 1, 0, 200, threads(1), keep="none"), 1, keep="none")
    of_all = found.variables["/summary/consistency/nees"]
    assert of_all.attributes["degrees_of_freedom"] == 9
    assert np.nanmean(of_all.data) == pytest.approx(1.0, abs=0.13)  # sampling: 4 sigma
    groups = dict(zip(found["/summary/consistency/group"], found["/summary/consistency/mean_group"], strict=True))
    assert np.isnan(groups["gyro_bias"])
    assert np.isfinite(groups["attitude"])
    worst = dict(zip(found["/summary/consistency/state"], found["/summary/consistency/worst_z"], strict=True))
    assert np.isnan(worst["gyro_bias_x"])
    assert np.isfinite(worst["attitude_down"])
    assert "no uncertainty" not in str(found["/summary/consistency/verdict"])
    assert not [one for one in of(found) if one.name.startswith("sigma")]
    texts = {
        row.cells[0].strip(): row.texts()[1]
        for row in summary_tables.summary_table([("x", found)]).rows
        if row.cells[1:]
    }
    assert texts["NEES, 9 states"].startswith(f"{np.nanmean(of_all.data):.3f}")


def test_a_bias_that_the_filter_knows_nothing_of_counts() -> None:
    """Uncertain in truth: the finding stays, which it would not if these states were left out."""
    flown = case(*BRIEF, PERFECT, "imu.gyro.drift_deg_h=500", "filter.imu.gyro.drift_deg_h=0")
    assert flown.degrees() == 12
    found = covariance_result(flown, covariance_analysis(flown), 1)
    assert "sigma_all_states" in [one.name for one in of(found)]
