"""Heights by pressure against the standard atmosphere, and the geoid against NGA's test points."""

from __future__ import annotations

import importlib.util
import json
import sys
import types
from typing import Any

import numpy as np
import pytest

from navsim.filter import states
from navsim.geodesy import geoid
from navsim.geodesy.earth import llh_from_ecef
from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.sensors import barometer
from tests.conftest import DATA, Within
from tests.helpers import case, in_brief, scenario

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1")
BARO = "barometric_altimeter={sigma_m: 0.5, %s}"
UNDULATION = "runway.geoid_undulation_m=15.5"
HAS_GRID = importlib.util.find_spec("egm96") is not None


def oracle(name: str) -> dict[str, Any]:
    return json.loads((DATA / "heights.json").read_text())[name]


@pytest.mark.validates("Static pressure up to 11 km", "ISO 2533, the standard atmosphere", pressure="0.02 Pa")
def test_standard_atmosphere(within: Within) -> None:
    given = oracle("isa")
    heights = np.array(given["h_m"], float)
    found = barometer.standard_pressure(heights)
    np.testing.assert_allclose(found, given["p_pa"], rtol=0, atol=within["pressure"])
    np.testing.assert_allclose(barometer.pressure_altitude(found), heights, atol=1e-8)
    assert abs(barometer.SLOPE - given["m_per_hpa_sea_level"]) < 1e-3


@pytest.mark.validates("Barometric height over a cold aerodrome", "formula: true height = shown height × T / T_ISA",
                       height="0.01 m")  # fmt: skip
def test_cold_air(within: Within) -> None:
    given = oracle("isa")["cold"]
    cold = barometer.AirColumn(0.0, given["surface_c"] + 273.15 - 288.15)
    assert cold.height(np.array(float(given["indicated_m"]))) == pytest.approx(given["true_m"], abs=within["height"])
    for air in (cold, barometer.AirColumn(800.0, 20.0)):  # what the pressure shows is that straight line
        true = air.elevation + np.array([0.0, 60.0, 300.0])
        np.testing.assert_allclose(air.height(barometer.pressure_altitude(air.pressure(true))), true, atol=1e-7)


def test_a_lag_reads_high_on_the_way_down() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    np.testing.assert_allclose(barometer.late(time, 500.0 - 3.0 * time, 0.5) - (500.0 - 3.0 * time), 1.5, atol=1e-9)
    step = np.where(time < 1.0, 0.0, 1.0)
    late = barometer.late(time, step, 2.0)
    assert late[np.searchsorted(time, 2.995)] == pytest.approx(1.0 - np.exp(-1.0), abs=3e-3)


def test_what_it_shows() -> None:
    """Height above sea level, with the lag, a setting 1 hPa too high, and the filter's corrections undoing it."""
    plain = case(*GENTLE, UNDULATION, "barometric_altimeter.sigma_m=0.5")
    (aid,) = plain.shared.aids
    height = plain.trajectory.motion(aid.time).llh[:, 2]
    np.testing.assert_allclose(aid.exact[:, 0], height - 15.5, atol=1e-6)
    (late,) = case(*GENTLE, UNDULATION, BARO % "lag_s: 0.5").shared.aids
    sink = plain.trajectory.motion(aid.time).velocity_ned[:, 2]
    gliding = aid.time < 50.0
    np.testing.assert_allclose((late.exact - aid.exact)[gliding, 0], 0.5 * sink[gliding], atol=0.08)
    (wrong,) = case(*GENTLE, UNDULATION, BARO % "qnh_error_hpa: 1").shared.aids
    np.testing.assert_allclose(wrong.exact - aid.exact, 8.32, atol=0.01)
    (warm,) = case(*GENTLE, UNDULATION, "runway.height_m=515.5", BARO % "isa_deviation_k: 20").shared.aids
    table = warm.table(warm.exact)
    np.testing.assert_allclose(table.height, plain.trajectory.motion(aid.time).llh[:, 2] + 515.5, atol=0.01)
    assert warm.sensor.is_true_model
    assert not wrong.sensor.is_true_model


def test_errors_of_a_run_that_last() -> None:
    """A setting and a drift drawn for each run, beside the same white noise; their sizes and how they last."""
    (plain,) = case(*GENTLE, UNDULATION, BARO % "rate_hz: 1").shared.aids
    runs = range(2000)

    def added(*settings: str) -> np.ndarray:
        flown = case(*GENTLE, UNDULATION, BARO % ", ".join(("rate_hz: 1", *settings)))
        (aid,) = flown.shared.aids
        assert not aid.sensor.is_true_model
        return np.array([(aid.measured(1, run) - plain.measured(1, run))[:, 0] for run in runs])

    setting = added("qnh_sigma_hpa: 0.5")
    np.testing.assert_allclose(setting, setting[:, :1] * np.ones(setting.shape[1]), atol=1e-9)
    assert setting[:, 0].std() == pytest.approx(0.5 * barometer.SLOPE, rel=0.05)  # 3 sigma of 2000 runs
    drift = added("drift_m: 3", "drift_time_s: 40")
    np.testing.assert_allclose(drift.std(axis=0), 3.0, rtol=0.07)
    for lag in (10, 40):
        found = np.mean(drift[:, lag:] * drift[:, :-lag]) / np.mean(drift**2)
        assert found == pytest.approx(np.exp(-lag / 40.0), abs=0.05)


def test_a_drift_goes_on_between_measurements() -> None:
    """As the process does: covariances of its values at all times, sampled or in between."""
    (aid,) = case(*GENTLE, UNDULATION, BARO % "rate_hz: 1, drift_m: 2, drift_time_s: 12").shared.aids
    time, at = np.array([0.0, 10.0, 20.0]), np.array([0.0, 4.0, 7.0, 10.0, 13.0, 26.0])
    rng = np.random.default_rng(5)
    every = []
    for _ in range(4000):
        drawn = aid.sensor.drawn_errors(time, rng)
        _, later = aid.sensor.errors_between(at, time, drawn, rng)
        every.append([*drawn[1][0], *later[0]])
    values, times = np.array(every), np.append(time, at)
    np.testing.assert_allclose(values[:, [3, 6]], values[:, [0, 1]], rtol=1e-12)
    expected = 4.0 * np.exp(-np.abs(times[:, None] - times) / 12.0)
    np.testing.assert_allclose(values.T @ values / len(values), expected, atol=0.3)


LASTING = BARO % "rate_hz: 2, drift_m: 3, drift_time_s: 40, qnh_sigma_hpa: 0.5, qnh_error_hpa: 0.2"
FOLLOWED = ("filter.barometric_altimeter={errors: states, qnh_sigma_hpa: 0.5}", "duration_s=61")


@pytest.mark.parametrize("kind", in_brief([("eskf", "loose"), ("gaussian-sum", "tight")], 1, whole=True))
def test_a_filter_follows_errors_that_last(kind: tuple[str, str]) -> None:
    """Errors of all states are as large as the filter believes, and as the covariance analysis says; without the
    states those of velocity and position are not, and the analysis says so too."""
    chosen = (*GENTLE, UNDULATION, f"filter.kind={kind[0]}", f"filter.coupling={kind[1]}")
    flown = case(*chosen, LASTING.replace(", qnh_error_hpa: 0.2", ""), *FOLLOWED)
    assert flown.states[15:17] == ("barometric_setting", "barometric_drift")
    assert len(flown.groups) == 5
    runs = fly_all(flown, 8, 0, 240, threads())
    assert runs["error"].shape[2] == len(flown.states) == flown.scenario.filter.states(1, 0) + 2
    for name, size in (("nees_position_velocity", 6), ("nees", len(flown.states))):
        nees = runs[name].mean(axis=0)[5:] / size
        assert 0.9 < nees.mean() < 1.15, (name, nees)
    analysis = covariance_analysis(flown)  # whose own check is that innovations are as the filter expects
    down = [states.R_D, states.V_D, 15, 16]
    expected = np.sqrt(np.diagonal(analysis.covariance, axis1=1, axis2=2))
    found = np.sqrt(np.mean(runs["error"] ** 2, axis=0))
    np.testing.assert_allclose((found / expected)[10:, down].mean(axis=0), 1.0, atol=0.1)
    if kind[1] == "tight":
        return
    blind = case(*chosen, LASTING, "duration_s=61")
    runs, analysis = fly_all(blind, 8, 0, 240, threads()), covariance_analysis(blind)
    assert runs["nees_position_velocity"].mean(axis=0)[5:].mean() / 6 > 50.0
    variance = np.diagonal(analysis.covariance, axis1=1, axis2=2) + analysis.mean**2
    found = np.sqrt(np.mean(runs["error"] ** 2, axis=0))
    np.testing.assert_allclose((found / np.sqrt(variance))[10:, states.R_D].mean(), 1.0, atol=0.1)


def test_runways_above_sea_level() -> None:
    """The same runway, by its height above the ellipsoid and above the geoid."""
    ellipsoid = case(*GENTLE, "runway.height_m=200.5")
    sea = case(*GENTLE, "runway={height_m: 185, height_above: geoid, geoid_undulation_m: 15.5, heading_deg: 0}")
    np.testing.assert_allclose(sea.shared.truth.llh, ellipsoid.shared.truth.llh, rtol=0, atol=1e-9)
    threshold = llh_from_ecef(sea.trajectory.frame.origin)
    assert threshold[2] == pytest.approx(200.5, abs=1e-6)
    assert sea.scenario.runway.elevation_m == 185.0


@pytest.mark.validates("Undulations of the geoid", "NGA's test points of EGM96", height="0.05 m")
def test_undulations(within: Within) -> None:
    if not HAS_GRID:
        pytest.skip("the extra `geoid` (egm96, Python 3.12) is not installed")
    rows = [*oracle("geoid_egm96")["rows"], *oracle("geoid_egm96")["sites"]["rows"]]
    for lat, lon, expected in rows:
        assert geoid.undulation(lat, lon) == pytest.approx(expected, abs=within["height"])


def test_auto_writes_the_number(monkeypatch: pytest.MonkeyPatch) -> None:
    model = types.ModuleType("egm96")
    monkeypatch.setitem(sys.modules, "egm96", model)
    auto = ("runway={height_m: 185, height_above: geoid, geoid_undulation_m: auto}",)
    with pytest.raises(InputError, match=r"0\.3 or later"):
        scenario(*auto)
    seen = []

    def undulation(lat: float, lon: float) -> float:
        seen.append((lat, lon))
        return 15.504

    model.undulation = undulation
    assert scenario(*auto).runway.geoid_undulation_m == 15.5
    assert seen == [(56, 37)]
    monkeypatch.setitem(sys.modules, "egm96", None)
    with pytest.raises(InputError, match=r"pip install '\.\[geoid\]'"):
        scenario(*auto)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("runway.height_above=geoid",), "needs the geoid's own"),
        (("barometric_altimeter.sigma_m=1",), "above sea level"),
        (("barometric_altimeter={}", UNDULATION), "sigma_m"),
        (("filter.barometric_altimeter={lag_s: 1}",), "there is none"),
        ((BARO % "lag_s: 1", UNDULATION, "filter.barometric_altimeter.errors=states"), "there are none"),
        ((BARO % "drift_m: 1", UNDULATION, "filter.barometric_altimeter.drift_m=2"), "is for `errors: states`"),
        (
            (BARO % "qnh_sigma_hpa: 1", UNDULATION, "filter.barometric_altimeter={errors: states, drift_time_s: 9}"),
            "there is no drift",
        ),
        (
            (
                BARO % "drift_m: 1",
                UNDULATION,
                "integrity={method: filter, p_constellation: 1.0e-8}",
                "method=covariance",
            ),
            "use filter.barometric_altimeter.errors: states, or mhss",
        ),
        (("runway.geoid_undulation_m=much",), "geoid_undulation_m"),
    ],
)
def test_what_is_missing_is_said(settings: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError) as caught:
        case(*settings)
    assert said in str(caught.value.problems[0])
