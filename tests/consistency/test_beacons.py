"""Ranging beacons in filter, smoother and covariance analysis: each state's errors are as large as its sigma says."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from tests.helpers import case, in_brief

BRIEF = ("duration_s=40", "receiver.rate_hz=1", "imu.rate_hz=20", "initial_errors.attitude_deg=1")
SITES = (
    "{s_m: 120, l1_m: 300, height_m: 10}, {s_m: -120, l1_m: 300}, {s_m: 150, l1_m: -400}, "
    "{s_m: -150, l1_m: -400, height_m: 15}"
)
ERRORS = (
    "weak_sigma_m: 0.2", "bias_sigma_m: 0.3", "growth_m: 0.4", "growth_sigma_m: 0.2", "growth_distance_m: 300",
    "survey_sigma_m: 0.2", "lever_arm_m: [1, 0.5, -0.3]",
)  # fmt: skip
NO_SATELLITES = "events=[{what: silence, sources: [all], at_s: 12}]"


def beacons(*keys: str) -> str:
    """Section of four beacons with these keys."""
    return f"beacons={{sites: [{SITES}], rate_hz: 10, range_limit_m: 3000, sigma_m: 0.1, {', '.join(keys)}}}"


@pytest.mark.parametrize(
    ("kind", "coupling", "runs"),
    in_brief([("eskf", "tight", 120), ("gaussian-sum", "loose", 1000), ("gaussian-sum", "tight", 1000),
              ("left-invariant", "loose", 1000), ("rts", "loose", 500)], 0),
)  # fmt: skip
def test_every_state_is_consistent(kind: str, coupling: str, runs: int) -> None:
    """Satellites are lost on the way. RMS of error / sigma of every state, and sigma of the analysis over the filter's.

    Biases and survey errors are the same all the way, so each state has as many independent errors as there are runs.
    """
    flown = case(*BRIEF, beacons(*ERRORS, "latency_s: 0.1"), NO_SATELLITES, f"filter.kind={kind}",
                 f"filter.coupling={coupling}")  # fmt: skip
    names = list(flown.states)
    assert sum(name.startswith("beacons_") for name in names) == 20
    result = fly_all(flown, 31, 0, runs, threads())
    z = np.sqrt(np.mean((result["error"] / result["sigma"]) ** 2, axis=0))[5:]
    z = np.sqrt(np.mean(z**2, axis=0))
    if kind == "rts":  # heading and gyro biases are off without beacons, too
        z = np.delete(z, [i for i, name in enumerate(names) if name.startswith(("attitude_", "gyro_"))])
    wide = 4.0 / np.sqrt(2.0 * runs)
    assert np.abs(z - 1.0).max() < max(0.07, wide), z.round(3)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.03 + 0.1 * wide)
    squares, weighed = (result.per_run(f"aided_{name}").sum() for name in ("innovations", "weighed"))
    assert squares / weighed == pytest.approx(1.0, abs=0.02)
    if kind == "rts":  # a smoother has no covariance analysis
        return
    analysis = covariance_analysis(flown)
    assert {"beacons_bias", "beacons_bias_growth", "beacons_survey", "beacons"} < set(analysis.sources)
    ratio = np.sqrt(np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed))
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)


def test_they_hold_the_position_when_satellites_are_lost() -> None:
    """Sigmas at the end with and without beacons; a beacon without states for its bias believes itself too well."""
    lost = (*BRIEF, NO_SATELLITES, "filter.kind=eskf")
    without, held, bold = (
        covariance_analysis(case(*lost, *more))
        for more in ((), (beacons(*ERRORS),), (beacons(*ERRORS), "filter.beacons.errors=none"))
    )
    assert np.sqrt(held.assumed[-1, 0, 0]) < 0.2 * np.sqrt(without.assumed[-1, 0, 0])
    true, assumed = (np.sqrt(np.trace(m[-1, :2, :2])) for m in (bold.covariance, bold.assumed))
    assert true > 3.0 * assumed


def test_outliers_and_lost_answers() -> None:
    """The gate keeps reflections out that are far longer than the noise."""
    keys = ("long_share: 0.05", "long_m: 400", "loss: 0.3")
    flown = case(*BRIEF, beacons(*ERRORS, *keys), "filter.kind=eskf", "filter.gate={probability: 1e-4}")
    result = fly_all(flown, 5, 0, 24, threads())
    questions = 24 * flown.shared.aids[0].time.size
    weighed, rejected = (result.per_run(f"aided_{name}").sum() for name in ("weighed", "rejected"))
    assert weighed / questions == pytest.approx(0.7, abs=0.02)
    assert rejected / weighed == pytest.approx(0.05, abs=0.01)
    z = np.sqrt(np.mean((result["error"][:, -1, :6] / result["sigma"][:, -1, :6]) ** 2))
    assert z == pytest.approx(1.0, abs=0.25)


def test_shipped_share_of_outliers() -> None:
    """NEES of position and velocity without satellites is right in spite of 2 % of reflections; 5 without a gate."""
    flown = case("filter.kind=eskf", "imu.rate_hz=20", name="beacons_uav")
    alone = flown.shared.filter_time > 43.0
    nees = [run.nees_position_velocity[:, alone] for run in flown.fly_runs(9021, 0, 24, measured=False)]
    assert np.concatenate(nees).mean() / 6.0 == pytest.approx(1.0, abs=0.2)
