"""A radio altimeter over ground of a known profile: what it reads, when it reads nothing, what a filter makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.filter import records, states
from navsim.landing.study import covariance_analysis, fly_all
from navsim.results.findings import of
from navsim.results.result import read
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from tests.conftest import SCENARIOS
from tests.helpers import case
from tests.layout import as_declared
from tests.product.test_run import navsim

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1", "duration_s=61")
RADIO = "radio_altimeter={sigma_floor_m: 0.3, sigma_share: 0.02, lever_arm_m: [0.3, 0.1, 0.2], latency_s: 0.1, %s}"
SLOPE = "ground: [[-600, -6], [0, 0]]"
DOWN = states.R_D


def test_rising_ground_reads_3_m_off() -> None:
    """Ground that rises by 1 % up to the threshold: 3 m too high 300 m before it, right over the runway."""
    flown = case("runway.aim_point_m=200", *GENTLE, RADIO % SLOPE)
    level = case("runway.aim_point_m=200", *GENTLE, RADIO % "ground: []")
    (over_slope,), (over_level,) = flown.shared.aids, level.shared.aids
    jet = flown.trajectory.path.jet(over_slope.time)[:, 0]
    beyond = jet[:, 0] + 200.0
    off = (over_slope.exact - over_level.exact)[:, 0]
    antenna = 0.3  # its arm is about as far ahead
    expected = np.clip(-0.01 * (beyond + antenna), 0.0, 6.0)
    seen = np.isfinite(off)
    np.testing.assert_allclose(off[seen], expected[seen], atol=2e-3)
    assert np.interp(-300.0 - antenna, beyond[seen], off[seen]) == pytest.approx(3.0, abs=0.002)


def test_it_measures_the_height_of_its_antenna() -> None:
    """The arm turns with the aircraft: with the nose 12 degrees below the path's level, what is ahead is lower."""
    arm = case(*GENTLE, "radio_altimeter={sigma_floor_m: 0.3, lever_arm_m: [4, 0, 1.5]}")
    (with_arm,), (without,) = arm.shared.aids, case(*GENTLE, "radio_altimeter.sigma_floor_m=0.3").shared.aids
    c_nb = arm.trajectory.motion(with_arm.time).c_nb
    off = (with_arm.exact - without.exact)[:, 0]
    seen = np.isfinite(off)
    np.testing.assert_allclose(off[seen], -(c_nb @ [4.0, 0.0, 1.5])[seen, 2], atol=1e-9)


def test_where_it_measures_nothing() -> None:
    """Beyond its heights, and while the aircraft leans more than it can: no numbers, counted, and not used."""
    settings = (*GENTLE, "radio_altimeter={sigma_floor_m: 0.3, highest_m: 100, lowest_m: 5}")
    (aid,) = case(*settings).shared.aids
    height = case(*settings).trajectory.motion(aid.time).llh[:, 2]
    there = (height <= 100.0) & (height >= 5.0)
    np.testing.assert_array_equal(np.isfinite(aid.exact[:, 0]), there)
    assert aid.missing == np.sum(~there)
    leaning = ("approach={profile: s-turn, start: {lat_deg: 56, lon_deg: 37}}", "duration_s=40")
    turning = case(*leaning, "pseudolites.count=0", "radio_altimeter={sigma_floor_m: 0.3, attitude_limit_deg: 10}")
    (aid,) = turning.shared.aids
    tilt = np.degrees(np.arccos(turning.trajectory.motion(aid.time).c_nb[:, 2, 2]))
    np.testing.assert_array_equal(np.isnan(aid.exact[:, 0]), tilt > 10.0)
    assert 0 < aid.missing < aid.time.size


def test_it_comes_late_and_is_used_for_its_time() -> None:
    """What arrives after the end is left out; the filter dates a height back by the latency that it believes in."""
    late = "radio_altimeter={sigma_floor_m: 0.3, latency_s: 0.35, rate_hz: 4}"
    (aid,) = case(*GENTLE, late).shared.aids
    assert aid.arrival[-1] <= 61.0
    assert aid.time[-1] == 60.5
    np.testing.assert_allclose(aid.valid, aid.time, atol=1e-12)
    (aid,) = case(*GENTLE, late, "filter.radio_altimeter.latency_s=0.1").shared.aids
    np.testing.assert_allclose(aid.valid, aid.time + 0.25, atol=1e-12)
    assert not aid.sensor.is_true_model


@pytest.mark.parametrize(
    ("settings", "share"),
    [
        pytest.param((RADIO % SLOPE, "filter.kind=eskf"), 1.0, id="as believed"),
        pytest.param(
            (RADIO % SLOPE, "filter.radio_altimeter={sigma_floor_m: 0.6, ground: []}", "filter.kind=eskf"), None,
            id="believed worse, over level ground", marks=pytest.mark.long,
        ),
    ],
)  # fmt: skip
def test_runs_agree_with_the_analysis_near_the_ground(settings: tuple[str, ...], share: float | None) -> None:
    """The vertical error below 30 m, over the runs: within 6 % of the analysis, and as large as the filter believes
    where it knows what is true."""
    flown = case(*GENTLE, *settings)
    height = np.interp(flown.shared.filter_time, flown.shared.truth.time, flown.shared.truth.llh[:, 2])
    low = (height < 30.0) & (height > 0.1)
    runs = fly_all(flown, 5, 0, 800, threads())
    analysis = covariance_analysis(flown)
    assert analysis.sources[-1] == "radio_altimeter"
    expected = (analysis.variance.sum(axis=0) + analysis.mean**2)[low, DOWN]
    square = np.mean(runs["error"][:, low, DOWN] ** 2, axis=0)
    assert np.sqrt(square.mean() / expected.mean()) == pytest.approx(1.0, abs=0.06)
    if share is not None:
        believed = analysis.assumed[low, DOWN, DOWN]
        assert 0.9 < np.mean(square / believed) < 1.15
        nees = runs["nees_position_velocity"].mean(axis=0)[low] / 6
        assert 0.9 < nees.mean() < 1.15, nees


def test_its_matrix_is_the_slope_of_what_it_expects() -> None:
    """Innovations of a filter that is off by a little in each state, against H."""
    from navsim.filter.eskf import displace
    from navsim.filter.measurement_kinds import ABOVE_GROUND, Measurements
    from navsim.filter.measurement_models import observe
    from navsim.filter.states import NAV_LLH, NAV_N, NAV_QUAT, NAV_VEL

    flown = case(*GENTLE, RADIO % SLOPE, "runway.heading_deg=70")
    (aid,) = flown.shared.aids
    row = 480
    motion = flown.trajectory.motion(aid.time[row : row + 1])
    nav = np.zeros(NAV_N)
    nav[NAV_LLH:NAV_VEL], nav[NAV_VEL:NAV_QUAT] = motion.llh[0], motion.velocity_ned[0]
    nav[NAV_QUAT : NAV_QUAT + 4] = motion.quaternion[0]
    tables = Measurements.of({ABOVE_GROUND: aid.table(aid.exact)})
    declared = flown.flight.model.declared

    def seen(at: np.ndarray) -> tuple[float, np.ndarray, float]:
        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, states.N_BASE)), np.zeros((6, 6))
        assert observe(ABOVE_GROUND, row, tables, at, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r) == 1
        return z[0], h[0], r[0, 0]

    z, h, r = seen(nav)
    assert abs(z) < 1e-9
    assert r == pytest.approx(max(0.3, 0.02 * aid.exact[row, 0]) ** 2)
    for state in range(states.SENSORS):
        step = 1e-4
        off = nav.copy()
        error = np.zeros(states.N_BASE)
        error[state] = step
        displace(off, -error)
        assert (seen(off)[0] - z) / step == pytest.approx(h[state], abs=1e-4), state


def test_result_counts_what_is_missing(tmp_path: Path) -> None:
    brief = ("--set", "duration_s=20", "--set", "radio_altimeter={sigma_floor_m: 0.5, highest_m: 140}")
    brief += ("--set", "runway.geoid_undulation_m=15.5")
    quiet = ("--figures", "none", "--keep", "all", "-q")
    navsim("run", SCENARIOS / "landing.yaml", *brief, "--runs", 2, *quiet, "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    measured = result["/aiding/radio_altimeter/measured"][..., 0]
    missing = np.isnan(measured)
    assert missing.any()
    assert int(result["/summary/aiding/radio_altimeter/missing"]) == missing.sum()
    status = result["/aiding/radio_altimeter/status"]
    assert np.all(status[missing] == records.NOT_USED)
    assert np.all(status[~missing] == records.USED)
    navsim("export", "a.h5", "--nmea", "--kml", cwd=tmp_path)
    sea = result["/receiver/position_llh"][0, 0, 2] - 15.5
    gga = (tmp_path / "a.nmea").read_text().split("\n")[0].split(",")
    assert (float(gga[9]), gga[11]) == (pytest.approx(sea, abs=1e-3), "15.500")
    track = (tmp_path / "a.kml").read_text().split("<coordinates>")
    begin = result["/truth/position_llh"][0, 2] - 15.5
    assert any(float(line.split()[0].split(",")[2]) == pytest.approx(begin, abs=1e-3) for line in track[1:])
    never = ("--set", "duration_s=10", "--set", "radio_altimeter={sigma_floor_m: 0.5, highest_m: 50}")
    navsim("run", SCENARIOS / "landing.yaml", *never, *quiet, "-o", "b.h5", cwd=tmp_path)
    assert any("measures nothing on this flight" in finding.text for finding in of(read(tmp_path / "b.h5")))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("radio_altimeter={}",), "sigma_floor_m"),
        (("radio_altimeter={sigma_floor_m: 1, ground: [[0, 0], [0, 1]]}",), "must increase"),
        (("radio_altimeter={sigma_floor_m: 1, lowest_m: 800}",), "below highest_m"),
        (("radio_altimeter={sigma_floor_m: 1, rate_hz: 100}", "imu.rate_hz=10", "receiver.rate_hz=1"), "imu.rate_hz"),
        (("radio_altimeter={sigma_floor_m: 1, rate_hz: 0.2, latency_s: 4}", "duration_s=6"), "nothing within"),
        (("filter.radio_altimeter={sigma_floor_m: 1}",), "there is none"),
        (("radio_altimeter={sigma_floor_m: 1}", "filter.radio_altimeter={ground: [[3, 0], [1, 1]]}"), "must increase"),
    ],
)
def test_what_cannot_be_is_refused(settings: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError) as caught:
        case(*settings)
    assert said in str(caught.value.problems[0])
