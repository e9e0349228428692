"""Values within their bounds that no aircraft, sensor, wind or site has: warnings with key, value and what to write."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from navsim.landing.clock_gain import fix_sigmas
from navsim.runner.errors import BadInput
from navsim.runner.opening import checked
from navsim.scenario.load import resolved_yaml
from navsim.scenario_files.source import InputError
from tests.conftest import SCENARIOS
from tests.helpers import case, scenario

SITES = "pseudolites={{frame: runway, sites: [{{name: A, s_m: 300, l1_m: 400}}, {{name: B, s_m: {}, l1_m: {}}}]}}"
CASES = [
    (SITES.format(300, 400), ["B is 0.0 m from A", "no geometry"]),
    (SITES.format(300.5, 400.5), ["B is 0.7 m from A", "no geometry"]),
    ("receiver.lever_arm_m=[1000,0,0]", ["receiver.lever_arm_m: the antenna is 1000 m", "give metres"]),
    ("filter.lever_arm_m=[0,60,0]", ["filter.lever_arm_m: the antenna is 60 m"]),
    ("wind={speed_m_s: 49, from_deg: 355}", ["wind.speed_m_s:", "wind of 49.0 m/s", "% of the airspeed", "unit"]),
    ("approach={speed_start_kmh: 80, speed_touchdown_kmh: 130}",
     ["approach.speed_touchdown_kmh: 130 km/h is faster than approach.speed_start_kmh, 80 km/h", "swap the two"]),
    ("imu.gyro={drift_deg_h: 1e6}", ["imu.gyro.drift_deg_h: 1e+06 deg/h", "more than a revolution", "give deg/h"]),
    ("imu.gyro={drift_deg_h: null, drift_fixed_deg_h: [0, 0, -2e5]}", ["imu.gyro.drift_fixed_deg_h: 200000 deg/h"]),
    ("pseudolites={clock_sigma_ns: 1e-8}", ["pseudolites.clock_sigma_ns: 1e-08 ns are 3e-09 m", "in nanoseconds"]),
    ("imu.accelerometer={bias_mg: 2e3}", ["imu.accelerometer.bias_mg: 2000 mg is more than gravity", "give mg"]),
]  # fmt: skip


def spread(setting: str) -> list[str]:
    """Settings of single keys, of one of a section that leaves the others as they are."""
    section, _, value = setting.partition("=")
    if not value.startswith("{") or "sites" in value:
        return [setting]
    pairs = value[1:-1].split(", ") if "[" not in value else ["drift_fixed_deg_h: [0, 0, -2e5]"]
    return [f"{section}.{key}={what}" for key, what in (pair.split(": ", 1) for pair in pairs)]


@pytest.mark.parametrize(("setting", "said"), CASES, ids=[given.partition("=")[0] for given, _ in CASES])
def test_values_that_no_landing_has(setting: str, said: list[str]) -> None:
    _, _, warnings = checked(SCENARIOS / "landing_smooth.yaml", spread(setting))
    (found,) = [text for text in warnings if said[0] in text]
    assert [part for part in said if part not in found] == []


@pytest.mark.parametrize(
    ("setting", "cause"),
    [("filter.fix_errors=none", "With filter.fix_errors: none"),
     ("integrity={method: chi2, exclusion: residual}", "With integrity.exclusion"),
     ("integrity.method=chi2", ""),
     ("filter.coupling=tight", ""), ("filter.fix_errors=inflate", "")],
)  # fmt: skip
def test_free_clocks(setting: str, cause: str) -> None:
    """Fixes that are weighted each for itself make bad use of a pseudolite whose clock runs free."""
    drift = "pseudolites.clock_drift_sigma_ppb=1"
    warned = [text for text in checked(SCENARIOS / "landing_smooth.yaml", [drift, setting])[2] if "clocks" in text]
    assert len(warned) == bool(cause)
    assert all(text.startswith("pseudolites: their clocks wander by 36 m") and cause in text for text in warned)


@pytest.mark.parametrize(
    ("given", "share"),
    [(["clock_noise.oscillator=ocxo", "clock_age_s=300"], "1.7 %"),
     (["clock_noise.oscillator=tcxo", "clock_age_s=60"], "0.4 %"),
     (["clock_drift_sigma_ppb=0.1", "clock_age_s=1e5"], "0.0 %"),
     (["clock_noise.oscillator=ocxo", "clock_age_s=120"], ""), (["clock_noise.oscillator=tcxo"], ""),
     (["clock_drift_sigma_ppb=0.03", "clock_age_s=1e5"], ""), (["clock_sigma_ns=1000"], ""),
     (["clock_noise.oscillator=rubidium", "clock_age_s=1e6"], "")],
)  # fmt: skip
def test_clocks_that_were_set_long_before(tmp_path: Path, given: list[str], share: str) -> None:
    """In the tutorial's landing. By covariance analysis the pseudolites of the cases that warn improve the RMS errors
    at touchdown by at most 2 %, those of the others at least one of the three by 26 %."""
    block = (SCENARIOS.parent / "docs" / "tutorial.md").read_text().partition("# runway.yaml")[2].partition("```")[0]
    (tmp_path / "runway.yaml").write_text(block)
    settings = [f"pseudolites.{each}" for each in given]
    for coupling in ("loose", "tight"):
        every = checked(tmp_path / "runway.yaml", [*settings, f"filter.coupling={coupling}"])[2]
        warned = [text for text in every if "hardly better than without pseudolites" in text]
        assert len(warned) == (bool(share) and coupling == "loose")
        assert all(f"at most {share} smaller" in text and "filter.coupling: tight" in text for text in warned)


def test_sigmas_of_weighted_fixes() -> None:
    """Those of a sum over sources by hand; none for three sources, and one source more on its own clock changes
    nothing."""
    los = np.array([[[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0.6, 0, 0.8]]])
    scale, sigma, used = np.array([0, 0, 0, 0, 0, 0, 3]), np.full((1, 7), 2.0), np.ones((1, 7), bool)
    for least in (6, 7):
        found = fix_sigmas(los, scale, sigma, used & (np.arange(7) < least))
        np.testing.assert_allclose(found, [[2.0, np.sqrt(2.0)]], rtol=1e-12)
    assert np.isinf(fix_sigmas(los, scale, sigma, used & (np.arange(7) < 3))).all()


@pytest.mark.parametrize(
    ("given", "times"),
    [(["integrity.method=mhss", "filter.coupling=tight"], 1),
     (["integrity.method=chi2", "filter.coupling=tight", "method=covariance"], 1),
     (["integrity.method=mhss"], 0), (["integrity.method=chi2"], 0), (["filter.coupling=tight"], 0),
     (["integrity.method=filter", "filter.coupling=tight", "filter.fix_errors=inflate"], 0)],
)  # fmt: skip
def test_levels_of_fixes_that_the_filter_does_not_use(given: list[str], times: int) -> None:
    """`validate`, runs and covariance analysis say once that they don't bound a tight filter."""
    every = given if "filter.fix_errors=inflate" not in given else [*given, "signals.preset=open-sky"]
    foreseen = checked(SCENARIOS / "landing_smooth.yaml", every)[2]
    for warnings in (foreseen, case(*every, name="landing_smooth").warnings):
        assert sum("No level bounds its errors" in text for text in warnings) == times


@pytest.mark.parametrize(
    ("given", "text"),
    [(["filter.kind=observability-constrained"], "its sigma of heading is far too small with beacons"),
     (["filter.gate.probability=0"], "0.02 of the ranges of the beacons are outliers, which"),
     (["beacons.long_share=0.1", "beacons.outlier_share=0.1", "beacons.outlier_sigma_m=1"], "0.2 of the ranges are"),
     ([], "")],
)  # fmt: skip
def test_beacons_that_the_filter_does_not_model(given: list[str], text: str) -> None:
    every = checked(SCENARIOS / "beacons_uav.yaml", given)[2]
    warned = [found for found in every if "outliers" in found or "too small" in found]
    assert len(warned) == bool(text)
    assert all(text in found and "consistent" in found.against for found in warned)


@pytest.mark.parametrize(
    ("given", "text"),
    [("sigma_m=10", "beacons.sigma_m: a noise of 10 m is 71 times"),
     ("sites.3={name: SE, s_m: -60, l1_m: 150, height_m: 2}", "beacons: SE is 0.0 m from NW, and"),
     ("range_limit_m=5", "They reach 5 m, and the nearest passes at ")],
)  # fmt: skip
def test_beacons_that_nobody_has(given: str, text: str) -> None:
    """One clear line each; beacons out of reach have no other."""
    said = [each for each in checked(SCENARIOS / "beacons_uav.yaml", [f"beacons.{given}"])[2] if "beacons" in each]
    assert [text in each for each in said].count(True) == 1
    assert len(said) == 1 or "range_limit" not in given


def test_covariance_analysis_and_runs_warn_of_them_too() -> None:
    """`Case.warnings` is what runs, covariance analysis, rare events and the planner print."""
    found = case(*spread(CASES[2][0]), name="landing_smooth").warnings
    assert [text for text in found if text.startswith(CASES[2][1][0])]


@pytest.mark.parametrize(
    "setting",
    [
        SITES.format(300, -400),
        "receiver.lever_arm_m=[-30,0,10]",
        "wind={speed_m_s: 12, from_deg: 40}",
        "approach={speed_start_kmh: 80, speed_touchdown_kmh: 80}",
        "imu.gyro={drift_deg_h: 2000}",
    ],
)
def test_values_that_some_have(setting: str) -> None:
    assert checked(SCENARIOS / "landing_smooth.yaml", spread(setting))[2] == []


@pytest.mark.parametrize("moved", [False, True])
def test_studies_warn_of_them_once(tmp_path: Path, moved: bool) -> None:
    """A sweep by geometry alone says it of its base; where it moves pseudolites itself, DOPs judge their directions."""
    key, values = ("pseudolites.sites.1.s_m", [299, 300]) if moved else ("sky.mask_deg", [5, 10])
    given = [SITES.format(300, 400), "receiver.lever_arm_m=[1000,0,0]"]
    (tmp_path / "base.yaml").write_text(resolved_yaml(scenario(*given, name="landing_smooth")))
    (tmp_path / "sweep.yaml").write_text(
        f"kind: sweep\nversion: 1\nbase: base.yaml\nvary: [{{key: {key}, values: {values}}}]\nmethod: dop\n"
    )
    warnings = checked(tmp_path / "sweep.yaml", [])[2]
    assert sum("receiver.lever_arm_m: the antenna is 1000 m" in text for text in warnings) == 1
    assert sum("B is 0.0 m from A" in text for text in warnings) == (0 if moved else 1)


def test_an_optimization_warns_of_its_base(tmp_path: Path) -> None:
    given = ["pseudolites.count=0", "receiver.lever_arm_m=[1000,0,0]"]
    (tmp_path / "base.yaml").write_text(resolved_yaml(scenario(*given)))
    warnings = checked(SCENARIOS / "placement_optimum.yaml", [f"base={tmp_path / 'base.yaml'}"])[2]
    assert any("receiver.lever_arm_m: the antenna is 1000 m" in text for text in warnings)


def test_a_geoid_of_another_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against EGM96, where it is installed."""
    monkeypatch.setitem(sys.modules, "egm96", SimpleNamespace(undulation=lambda lat, lon: 46.6))
    wrong, right = (
        checked(SCENARIOS / "landing_smooth.yaml", [f"runway.geoid_undulation_m={value}"])[2] for value in (-46.6, 46.0)
    )
    assert right == []
    assert "runway.geoid_undulation_m: -46.6 m, and EGM96 has 46.6 m at the threshold, with the other sign" in wrong[0]


def test_names_stand_once() -> None:
    with pytest.raises(InputError, match=r"sky\.systems: gps is given twice; write it once"):
        scenario("sky.systems=[gps,gps]", "sky.source=nominal")


def test_thresholds_are_no_further_apart_than_a_runway_is_long() -> None:
    """Of swapped coordinates the message says so, with the distance in km."""
    runway = "runway={{threshold: {{lat_deg: {}, lon_deg: {}}}, end: {{lat_deg: 48.42361, lon_deg: 10.9225}}}}"
    with pytest.raises((InputError, BadInput), match=r"runway\.end: is 4787 km from runway\.threshold.*: swap lat_deg"):
        scenario(runway.format(10.94333, 48.42639), "approach.start=null")


def test_bounds_have_units_and_values_that_follow_their_key() -> None:
    with pytest.raises(InputError, match=r"duration_s: must be at most 1000000 s, not 10000000 s"):
        scenario("duration_s=1e7")
    with pytest.raises(InputError, match=r"aim_point_m: follows from .* must be at most 3000 m, not 5\d+\.\d+ m"):
        scenario("runway.tch_m=99", "approach.glide_slope_deg=1.1")


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (("wind.from_deg=90",), "wind.from_deg"),
        (("imu.gyro.markov_time_s=100",), "imu.gyro.markov_time_s"),
        (("imu.accelerometer.markov_time_s=100",), "imu.accelerometer.markov_time_s"),
        (("sky.almanac_system=glonass",), "sky.almanac_system"),
        (("sky.almanac_warning_days=3",), "sky.almanac_warning_days"),
    ],
)
def test_keys_that_need_another_key_are_told(settings: tuple[str, ...], key: str) -> None:
    """They were found by changing each key of a shipped landing alone, and comparing results."""
    (text,) = scenario(*settings).unused()
    assert text.startswith(f"{key} ")


def test_more_than_two_pseudolites_are_sites() -> None:
    with pytest.raises(InputError, match=r"pseudolites.count: 3 is not allowed: .*; list more in `sites: "):
        scenario("pseudolites.count=3")


def test_shipped_landings_have_no_key_without_effect() -> None:
    assert scenario().unused() == []
    settings = ("wind.speed_m_s=3", "wind.from_deg=90", "imu.gyro={markov_deg_h: 5, markov_time_s: 9}")
    assert scenario(*settings).unused() == []
