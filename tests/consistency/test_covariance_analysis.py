"""The linear covariance analysis against Monte Carlo: two computations that share no formula for accuracy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from navsim.gnss.signals import build_signals
from navsim.landing.study import Case, covariance_analysis, covariance_result, fly_all
from navsim.runner.batches import Ensemble
from navsim.runner.executor import threads
from navsim.simulation import landing_covariance
from navsim.simulation.error_sources import SOURCES
from tests.helpers import case, in_brief, outputs_at, ratios

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1")
MISTUNED = (
    "filter.fix_sigma_scale=2",
    "filter.velocity=false",
    "filter.imu={gyro: {drift_deg_h: 20, noise_deg_h: 90}}",
)


def ratios_at_tens(flown: Case, flights: Ensemble) -> np.ndarray:
    """See `ratios`, at 10, 20, ... 120 s."""
    return ratios(flights, covariance_analysis(flown), outputs_at(flown, range(10, 121, 10)))


@pytest.mark.parametrize("settings", in_brief([(), MISTUNED], 1, whole=True), ids=["matched", "mistuned"])
def test_runs_agree(settings: tuple[str, ...]) -> None:
    """Every component of position and velocity at every 10 s, 1 degree and 70 deg/h: 600 runs within 13 %.

    That is 4.5 sigma of the sampling; `make validate` takes 2000 runs, and 8 %.
    """
    flown = case(*GENTLE, *settings)
    ratio = ratios_at_tens(flown, fly_all(flown, 1, 0, 600, threads()))
    assert np.all(np.abs(ratio - 1.0) < 0.13), ratio


@pytest.mark.long
def test_a_mistuned_filter_is_shown_right() -> None:
    """Its sigma is wrong by far more than the 13 % of the test before, and the analysis says by how much."""
    flown = case(*GENTLE, *MISTUNED)
    analysis = covariance_analysis(flown)
    believed = np.sqrt(np.diagonal(analysis.assumed, axis1=1, axis2=2))[-1]
    true = np.sqrt(analysis.variance.sum(axis=0))[-1]
    assert believed[0] / true[0] > 1.3
    assert believed[8] / true[8] < 0.95 or believed[11] / true[11] < 0.5
    ensemble = fly_all(flown, 1, 0, 500, threads())
    np.testing.assert_allclose(ensemble["nees"].mean(axis=0)[20:] / 15, analysis.expected_square(slice(0, 15))[20:],
                               rtol=0.15)  # fmt: skip


@pytest.mark.parametrize(
    "settings",
    in_brief(
        [
            ("pseudolites.survey_error_m=[15, -10, 3]", "pseudolites.clock_offset_ns=30"),
            ("receiver.lever_arm_m=[2.0, 0.5, -1.0]", "filter.lever_arm_m=[0, 0, 0]", "filter.gate.probability=0"),
            ("receiver.latency_s=0.25", "filter.latency_s=0.05", "filter.gate.probability=0"),
            pytest.param(
                ("imu.gyro.drift_fixed_deg_h=[50, -60, 40]", "initial_errors.fixed={attitude_deg: [1, -1, 0.5]}"),
                marks=pytest.mark.long,
            ),
            pytest.param(
                ("imu.gyro.drift_deg_h=0", "imu.gyro.markov_deg_h=100", "imu.gyro.markov_time_s=40"),
                marks=pytest.mark.long,
            ),
            ("imu.gyro.markov_deg_h=100", "imu.gyro.markov_time_s=40", "filter.imu={gyro: {drift_deg_h: 0}}"),
        ],
        0,
        whole=True,
    ),
    ids=["survey and clock", "lever arm", "latency", "fixed values", "Markov", "Markov believed, constant beside it"],
)
def test_systematic_and_correlated_errors(settings: tuple[str, ...]) -> None:
    """Errors the filter knows nothing of: RMS of 600 runs within 13 % (4.5 sigma of the sampling) at every 10 s."""
    flown = case(*GENTLE, *settings)
    ratio = ratios_at_tens(flown, fly_all(flown, 1, 0, 600, threads()))
    assert np.all(np.abs(ratio - 1.0) < 0.13), ratio


@pytest.mark.parametrize(
    "settings",
    in_brief(
        [
            ("signals.ephemeris={orbit_sigma_m: [2, 5, 3], clock_sigma_m: 3}",),
            pytest.param(("receiver.smoothing_s=20", "signals.ionosphere={truth_scale: 3}"), marks=pytest.mark.long),
            ("receiver.smoothing_s=60", "signals.ephemeris={}", "pseudolites.count=1", "filter.velocity=false"),
        ],
        0,
        whole=True,
    ),
    ids=["messages", "smoothed code", "both, fixes of position"],
)
def test_errors_correlated_in_time(settings: tuple[str, ...]) -> None:
    """Orbits and clocks constant over a run, noise that Hatch's filter drags along: as the runs show, within 13 %."""
    flown = case(*GENTLE, *settings)
    runs = fly_all(flown, 1, 0, 600, threads())
    ratio = ratios_at_tens(flown, runs)
    assert np.all(np.abs(ratio - 1.0) < 0.13), ratio
    analysis = covariance_analysis(flown)
    # innovations too: with the range noise counted twice, 1.1 was expected where runs show 0.66
    shown = np.nanmean(runs["innovation_squared"], axis=0) / analysis.degrees
    for stretch in (slice(0, 20), slice(20, 60), slice(60, 120)):
        assert np.mean(analysis.nis[stretch] / analysis.degrees[stretch]) == pytest.approx(
            np.mean(shown[stretch]), rel=0.04
        )
    # the filter takes errors for new at each fix: its own sigma is far too small, and the analysis says so
    believed = np.sqrt(np.diagonal(analysis.assumed, axis1=1, axis2=2))
    assert believed[-1, 0] < 0.7 * np.sqrt(analysis.covariance[-1, 0, 0])


class Silent:
    """A constellation of whose satellites some send no message."""

    def __init__(self, constellation: Any, silent: list[int]) -> None:
        self.constellation, self.silent = constellation, silent

    def __getattr__(self, name: str) -> Any:
        return getattr(self.constellation, name)

    def state(self, utc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As the constellation's, nan for the silent."""
        position, velocity = self.constellation.state(utc)
        position[:, self.silent], velocity[:, self.silent] = np.nan, np.nan
        return position, velocity


EFFECTS = (
    "signals.ionosphere={}", "signals.troposphere={}", "signals.ephemeris={}", "signals.range_law=cn0",
    "receiver.smoothing_s=20", "pseudolites.differential={}",
)  # fmt: skip


@pytest.mark.parametrize("settings", [(), *((e,) for e in EFFECTS), EFFECTS], ids=lambda s: " ".join(s) or "none")
def test_a_satellite_without_message_is_as_if_it_were_not_there(settings: tuple[str, ...]) -> None:
    """Its undefined sigma once turned the noise of all satellites into nothing: 0.150 m where runs showed 0.209."""
    sky = ("sky.source=nominal", "pseudolites.count=1", "duration_s=40", *GENTLE)
    without = case(*sky, "sky.exclude=[R01, R02, G05]", *settings)
    silent = case(*sky, *settings)
    numbers = [[group.names.index(n) for n in ("R01", "R02", "G05") if n in group.names]
               for group in silent.environment.satellites]  # fmt: skip
    assert [len(n) for n in numbers] == [2, 1]
    groups = tuple(
        replace(g, constellation=Silent(g.constellation, n))
        for g, n in zip(silent.environment.satellites, numbers, strict=True)
    )
    environment = replace(silent.environment, satellites=groups)
    scenario = silent.scenario
    motion = silent.trajectory.motion(silent.shared.signals.time)
    world = replace(silent.shared, signals=build_signals(motion, scenario.epoch.timestamp(), environment))
    silent = replace(silent, environment=environment).over(world)
    assert not world.signals.used[:, [0, 1]].any()
    expected, found = covariance_analysis(without), covariance_analysis(silent)
    np.testing.assert_array_equal(found.variance, expected.variance)
    np.testing.assert_array_equal(found.nis, expected.nis)
    assert expected.variance[SOURCES.index("satellite_range"), -1, 0] > 1e-4


def test_a_matched_filter_with_a_wrong_expectation_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expected NIS off 1 by more than 1 % is navsim's mistake: with the noise lost, as once, the analysis raises."""
    flown = case(*GENTLE, "duration_s=20")
    covariance_analysis(flown)
    lost = landing_covariance.white_noise

    def quieter(*arguments: np.ndarray) -> np.ndarray:
        return 0.97 * lost(*arguments)

    monkeypatch.setattr(landing_covariance, "white_noise", quieter)
    with pytest.raises(landing_covariance.AnalysisError, match=r"NIS is 0\.9"):
        covariance_analysis(flown)
    # a filter that believes otherwise may be off
    covariance_analysis(case(*GENTLE, "duration_s=20", "filter.fix_sigma_scale=2"))
    monkeypatch.setattr(landing_covariance, "white_noise", lambda *arguments: np.nan * lost(*arguments))
    with pytest.raises(landing_covariance.AnalysisError, match="undefined"):
        covariance_analysis(case(*GENTLE, "duration_s=20", "filter.fix_sigma_scale=2"))


@pytest.mark.parametrize("sensor", ["gyro.markov_deg_h=700", "accelerometer.markov_mg=5"])
def test_a_bias_that_one_state_cannot_follow_is_no_contradiction(sensor: str) -> None:
    """A constant beside a correlated bias: the filter has one state for both, and its expected NIS may be off 1."""
    name = sensor.partition(".")[0]
    flown = case("receiver.rate_hz=1", "duration_s=30", f"imu.{sensor}", f"imu.{name}.markov_time_s=5")
    analysis = covariance_analysis(flown)
    assert np.abs(analysis.nis / analysis.degrees - 1.0).max() > 0.01


def test_smoothers_are_refused() -> None:
    """Their accuracy is another one: no figure of the filter is given out for theirs."""
    with pytest.raises(ValueError, match="rts is a smoother"):
        covariance_analysis(case(*GENTLE, "duration_s=20", "filter.kind=rts"))


ALONE = {
    "initial_attitude": ("initial_errors.attitude_deg", "1"),
    "gyro_bias": ("imu.gyro.drift_deg_h", "70"),
    "accelerometer_noise": ("imu.accelerometer.noise_mg", "10"),
}
"""Keys that switch one source on."""


@pytest.mark.parametrize("source", in_brief(ALONE, 1))
def test_each_share_is_what_that_source_does_alone(source: str) -> None:
    """With all other sources switched off in the truth, and kept in the filter, runs show that share."""
    quiet = {
        "imu.gyro.drift_deg_h": "0", "imu.gyro.noise_deg_h": "0", "imu.accelerometer.bias_mg": "0",
        "imu.accelerometer.noise_mg": "0", "initial_errors.attitude_deg": "0", "initial_errors.position_m": "0",
        "initial_errors.velocity_m_s": "0",
    }  # fmt: skip
    # ranging noise cannot be switched off: it is made small in truth and believed large by the filter
    ranging = (
        "signals.range_sigma_m=0.0022", "signals.range_rate_sigma_m_s=0.0001", "pseudolites.range_sigma_m=0.0022",
        "pseudolites.range_rate_sigma_m_s=0.0001", "filter.fix_sigma_scale=1000",
    )  # fmt: skip
    believed = (
        "filter.initial={attitude_deg: 1, position_m: 10, velocity_m_s: 1}",
        "filter.imu={gyro: {drift_deg_h: 70, noise_deg_h: 30}, accelerometer: {bias_mg: 1, noise_mg: 10}}",
    )
    key, value = ALONE[source]
    quiet[key] = value
    flown = case(
        "receiver.rate_hz=1", "filter.velocity=false", *(f"{k}={v}" for k, v in quiet.items()), *ranging, *believed
    )
    error = fly_all(flown, 1, 0, 400, threads())["error"]
    whole = case(*GENTLE, "filter.velocity=false")
    budget = np.sqrt(covariance_analysis(whole).variance[SOURCES.index(source)])
    at = [20, 60, 100]
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0))[at, :6], budget[at, :6], rtol=0.16, atol=2e-3)


def test_result_has_the_same_table() -> None:
    """Names of a Monte Carlo result, the budget adds up, and the percentiles are Gaussian ones."""
    flown = case(*GENTLE)
    result = covariance_result(flown, covariance_analysis(flown), 1)
    assert result["/filter/sigma"].shape == (1, 121, 15)
    np.testing.assert_allclose(np.sqrt((result["/budget/rms"] ** 2).sum(axis=0)), result["/covariance/rms"])
    assert result["/summary/budget/horizontal_share"].sum() == pytest.approx(1.0)
    value, low, high = result["/summary/rms/horizontal"]
    assert value == low == high
    assert value == pytest.approx(np.sqrt((result["/summary/budget/horizontal"] ** 2).sum()))
    np.testing.assert_allclose(
        result["/summary/at/lateral_percentile"], result["/summary/at/lateral"][:, :1] * [0.67449, 1.95996, 2.57583],
        rtol=1e-4,
    )  # fmt: skip
    # runway to the north: lateral is east, along is north
    at = np.interp(60.1869, result["/covariance/time"], result["/covariance/rms"][:, 1])
    assert result["/summary/at/lateral"][0, 0] == pytest.approx(at, rel=1e-3)
