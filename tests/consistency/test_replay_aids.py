"""Headings, rest and wheels in a replay, on simulated recordings with known truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats.recorded_data import Fixes, Headings, Samples
from navsim.geodesy.attitude import dcm_from_quaternion, dcm_from_rpy, quaternion_from_dcm, roll_pitch_yaw
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.replays import study
from navsim.replays.aids import OwnNoise, pieces_at_rest
from navsim.replays.alignment import Alignment, propagate_axis, update_heading
from navsim.replays.findings import warn_of_headings
from navsim.replays.flight import within_outages
from navsim.results.findings import of
from navsim.results.result import Result
from navsim.scenario.load import read_replay
from navsim.scenario_files.source import InputError
from navsim.statistics.chi_square import quantile
from tests.recordings import drive, quadrotor, record, write_recording

SHORT = ("gnss.latency_s=0.1", "filter.output_rate_hz=fixes", "checks=off")  # which are those of `test_diagnosis`


def flown(log: Path, *settings: str) -> tuple[Result, study.Recording]:
    recording = study.prepare(*read_replay(log, [*SHORT, *settings]))
    return study.compute(recording), recording


def test_a_measured_heading_aligns_and_aids(tmp_path: Path) -> None:
    """A quadrotor on the ground: the second of two antennas is to the right; a heading is missing, another 90 deg
    off."""
    trajectory = quadrotor()
    samples, fixes = record(trajectory, 5, fix_rate=4.0)
    time, rng = np.arange(1.0, 60.0, 0.5), np.random.default_rng(1)
    shaken = samples.time > 5.0
    samples.force[shaken] += 0.8 * rng.standard_normal((shaken.sum(), 3))  # rotors
    log = write_recording(tmp_path, samples, fixes)
    yaw = np.degrees(roll_pitch_yaw(trajectory.motion(time).c_nb)[:, 2])
    turned = yaw + 90.0 + rng.normal(0.0, 1.5, yaw.size)
    turned[60], turned[70] = np.nan, turned[70] + 90.0
    turned = (turned + 180.0) % 360.0 - 180.0
    np.savetxt(tmp_path / "heading.csv", np.c_[time, turned], "%.6g", ",", header="t_s,heading_deg", comments="")
    log.write_text(log.read_text() + "heading: {file: heading.csv, source: antennas, mounting_deg: 90}\n")
    found, recording = flown(log, "heading.sigma_deg=1.5", "end_s=60", "imu.accelerometer.vrw_m_s_sqrt_h=7")
    assert recording.alignment.time < 8.0
    true = roll_pitch_yaw(trajectory.motion(found["/filter/time"]).c_nb)[:, 2]
    off = np.angle(np.exp(1j * (found["/filter/attitude_rpy"][:, 2] - true)))
    assert np.all(np.abs(off) < 4.0 * found["/filter/sigma"][:, 8])
    assert int(found["/summary/aid_rejected"][0]) == 1
    used = int(found["/summary/aid_used"][0])
    assert found["/summary/aid_nis"][0, 0] * used < quantile(0.9999, used)
    assert found["/summary/aid_nis"][0, 0] * used > quantile(0.0001, used)


def test_an_update_by_a_heading_is_that_of_bayes() -> None:
    """By the information form; the lasting error counts, and a heading that is not known takes the measured one."""
    turn, axis = dcm_from_rpy(np.array([0.2, -0.1, 0.4])), np.array([0.6, 0.8, 0.0])
    prior = np.array([[4e-4, 1e-5, 2e-5], [1e-5, 3e-4, -1e-5], [2e-5, -1e-5, 1e-2]])
    found = Alignment(0.0, quaternion_from_dcm(turn), prior, np.zeros(3), np.zeros(3), 0.0, 0.0)
    headings = Headings(np.zeros(1), np.zeros(1), np.ones(1), axis, 0.05)
    u = turn @ axis
    at = float(np.arctan2(u[1], u[0]))
    after = update_heading(found, headings, (at + 0.02, 0.03, 0.0))
    h = np.array([-u[0] * u[2], -u[1] * u[2], 1.0 - u[2] ** 2]) / (1.0 - u[2] ** 2)
    noise = 0.03**2 + 0.05**2
    expected = np.linalg.inv(np.linalg.inv(prior) + np.outer(h, h) / noise)
    np.testing.assert_allclose(after.covariance, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(after.by_heading, expected @ h / noise, rtol=1e-9)
    unknown = Alignment(0.0, found.quaternion, np.diag([1e-4, 1e-4, 1e4]), np.zeros(3), np.zeros(3), 0.0, 0.0)
    turned = dcm_from_quaternion(update_heading(unknown, headings, (at + 2.5, 0.03, 0.0)).quaternion) @ axis
    away = np.angle(np.exp(1j * (np.arctan2(turned[1], turned[0]) - at - 2.5)))
    assert abs(away) < 1e-4


def test_an_alignment_takes_a_heading_that_the_filter_does_not_take_again() -> None:
    """Not one after its time, nor an old one."""
    headings = Headings(np.array([0.0, 1.0]), np.array([0.5, 0.7]), np.array([0.1, 0.2]), np.array([1.0, 0.0, 0.0]))
    assert headings.at(0.9) == (0.5, 0.1, 0.0)
    assert headings.at(1.0) == (0.7, 0.2, 1.0)
    assert headings.at(-0.1) is headings.at(2.1) is None


def test_a_heading_before_the_start_turns_with_the_body() -> None:
    """The axis stays in space while the body rolls and turns."""
    trajectory, bias = quadrotor(), np.array([0.01, -0.02, 0.03])
    samples, _ = record(trajectory, 5, rate=100.0, gyro_bias=0.0, gyro_noise=0.0)
    samples.rate[:] += bias
    before, after = trajectory.motion(np.array([35.0, 36.0])).c_nb
    axis = np.array([0.6, 0.8, 0.0])
    later = propagate_axis(axis, samples, 35.0, 36.0, bias)
    assert np.linalg.norm(before @ axis - after @ axis) > 0.3
    np.testing.assert_allclose(after @ later, before @ axis, atol=2e-4)


def test_rest_is_what_the_samples_show() -> None:
    """Of 40 s: rest, vibration, a steady turn, rest with one fix that moves, a brake that ends without a jerk."""
    rng, rate = np.random.default_rng(2), 100.0
    time = np.arange(0.0, 40.0, 1.0 / rate)
    gyro, force = 1e-3 * rng.standard_normal((time.size, 3)), 0.02 * rng.standard_normal((time.size, 3)) - [0, 0, 9.8]
    force[(time >= 10.0) & (time < 16.0)] *= 1.0 + 0.02 * rng.standard_normal((600, 1))
    gyro[(time >= 18.0) & (time < 24.0), 2] += 0.05
    force[time >= 34.0, 0] -= np.interp(time[time >= 34.0], [34.0, 40.0], [0.3, 0.0])
    stamp = np.array([5.0, 30.5])
    fixes = Fixes(stamp, np.zeros((2, 3)), np.array([[0.1, 0.0, 0.0], [0.45, 0.0, 0.0]]))
    own = OwnNoise(np.full(3, 1e-3), np.full(3, 0.02), np.zeros(1), np.zeros((1, 3)), 1e-4)
    rests = pieces_at_rest(Samples(time, gyro, force), fixes, own, 0.1)
    # a piece needs one at rest on both sides
    assert rests[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 25.0, 26.0, 27.0, 28.0, 32.0]


def test_rest_and_wheels_keep_a_car_in_an_outage(tmp_path: Path) -> None:
    """Drifts fall by half, with the axes of a board that is mounted askew as states; their sigmas hold."""
    samples, fixes = record(drive(), 3, gyro_noise=3e-3, accel_noise=0.02, fix_rate=4.0, position_noise=0.1)
    board = dcm_from_rpy(np.radians([2.0, -3.0, 4.0]))
    log = write_recording(tmp_path, Samples(samples.time, samples.rate @ board, samples.force @ board), fixes)
    away = ["outages=[{start_s: [60, 70, 80, 90, 95], duration_s: 15}]", "gnss.position_sigma_m=[0.1, 0.15]"]
    alone = flown(log, *away)[0]
    aided = flown(log, *away, "standstill={}", "side_slip={mounting_sigma_deg: 4}")[0]
    assert aided["/summary/drift_median"][0] < 0.5 * alone["/summary/drift_median"][0]
    assert aided["/summary/drift_nees"][0] < 2.5
    assert aided["/summary/aid"].tolist() == ["side slip", "zero velocity", "zero rotation"]
    assert aided["/summary/aid_rejected"].sum() == 0
    assert np.all(aided["/summary/aid_used"] > [90, 3, 3])


def test_headings_of_antennas_are_missing_with_the_fixes() -> None:
    """From the first withheld fix to the next one that is not."""
    withheld, time = np.array([False, True, True, False]), np.array([-1.0, 0.5, 1.0, 1.5, 2.9, 3.0])
    missing = within_outages(withheld, np.arange(4.0), time)
    assert missing.tolist() == [False, False, True, True, True, False]


@pytest.mark.long
def test_the_noise_of_headings_is_tuned(tmp_path: Path) -> None:
    """By one factor on what the table says, three times too much."""
    trajectory, rng = quadrotor(), np.random.default_rng(4)
    log = write_recording(tmp_path, *record(trajectory, 5, fix_rate=4.0))
    time = np.arange(1.0, 148.0, 0.5)
    yaw = np.degrees(roll_pitch_yaw(trajectory.motion(time).c_nb)[:, 2]) + rng.normal(0.0, 1.0, time.size)
    rows = np.c_[time, yaw, np.full(time.size, 3.0)]
    names = "t_s,heading_deg,sigma_heading_deg"
    np.savetxt(tmp_path / "heading.csv", rows, "%.6g", ",", header=names, comments="")
    log.write_text(log.read_text().replace("tuning: none", "heading: {file: heading.csv, source: other}"))
    found, _ = flown(log, "gnss.velocity_sigma_m_s=[0.1, 0.1]", "imu.gyro.arw_deg_sqrt_h=1")
    assert np.degrees(found["/tuning/heading_sigma"]) == pytest.approx(1.0, rel=0.15)


def test_headings_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    """A declination, or the time of no error, of true headings; magnetic ones of a year without a model. Those of
    another clock are told."""
    log = write_recording(tmp_path, *record(quadrotor(30.0), 5))
    (tmp_path / "heading.csv").write_text("t_s,heading_deg\n1,20\n2,21\n")
    plain = log.read_text()
    for key, message in (("declination_deg: 3", "from true north have none"), ("correlation_time_s: 9", "that lasts")):
        log.write_text(f"{plain}heading: {{file: heading.csv, source: other, {key}}}\n")
        with pytest.raises(InputError, match=message):
            read_replay(log)
    log.write_text(plain + "heading: {file: heading.csv}\nepoch: 1990-01-01T00:00:00Z\n")
    with pytest.raises(InputError, match=r"heading\.declination_deg"):
        study.prepare(*read_replay(log))
    headings = Headings(np.array([1.0, 2.0]), np.zeros(2), np.ones(2), np.array([1.0, 0.0, 0.0]))
    assert "none is used" in warn_of_headings(headings, 2.0, 9.0)[0]
    assert warn_of_headings(headings, 1.5, 9.0) == warn_of_headings(None, 1.5, 9.0) == []


def test_ranges_of_beacons_keep_a_car_in_outages(tmp_path: Path) -> None:
    """Three around the drive; one that is 40 m off in height is told. Local positions, positions alone, and a filter
    that ranges mislead, are refused."""
    trajectory, rng = drive(), np.random.default_rng(9)
    log = write_recording(tmp_path, *record(trajectory, 3, fix_rate=4.0, position_noise=0.1))
    time = np.arange(1.0, 118.0, 0.25)
    antenna = ecef_from_llh(trajectory.motion(time).llh)
    beside = np.array([40.0, -80.0, -20.0]) @ ned_matrix(trajectory.motion(time[:1]).llh[0])
    sites = antenna[[0, time.size // 2, -1]] + beside
    asked = np.arange(time.size) % 3
    measured = np.linalg.norm(sites[asked] - antenna, axis=1) + np.array([0.3, -0.2, 0.0])[asked]
    measured += rng.normal(0.0, 0.1, time.size)
    np.savetxt(tmp_path / "r.csv", np.c_[time, asked, measured], ["%.3f", "%d", "%.4f"], ",", comments="",
               header="t_s,source,range_m")  # fmt: skip
    lat, lon, height = llh_from_ecef(sites).T

    def places(higher: float = 0.0) -> str:
        every = [f"{{name: '{i}', lat_deg: {np.degrees(lat[i])}, lon_deg: {np.degrees(lon[i])}, "
                 f"height_m: {height[i] + higher * (i == 1)}}}" for i in range(3)]  # fmt: skip
        return f"sources={{positions: [{', '.join(every)}]}}"

    ranges = f"ranges={{file: {tmp_path}/r.csv, sigma_m: 0.1, bias_sigma_m: 0.3}}"
    away = ["outages=[{start_s: [60, 70, 80, 90, 95], duration_s: 15}]", "gnss.position_sigma_m=[0.1, 0.15]"]
    alone = flown(log, *away)[0]
    aided = flown(log, *away, ranges, places())[0]
    assert aided["/summary/drift_median"][0] < 0.2 * alone["/summary/drift_median"][0]
    assert aided["/summary/drift_nees"][0] < 2.5
    off = (aided["/summary/beacon_bias"] - [0.3, -0.2, 0.0]) / aided["/summary/beacon_bias_sigma"]
    assert np.all(np.abs(off) < 3.0)
    used = aided["/summary/aid_used"]
    assert quantile(1e-4, used.sum()) < aided["/summary/aid_nis"][:, 0] @ used < quantile(0.9999, used.sum())
    told = [found.text for found in of(flown(log, ranges, places(40.0), "end_s=60")[0])]
    assert any("of the range of 1 were rejected by the innovation gate" in text for text in told)
    for settings, message in (
        ((places(),), "belong together"),
        ((ranges, places(), "filter.kind=first-estimates"), "change of specific force"),
        ((ranges, "sources={positions: [{name: '0', position_m: [0, 0, 0]}, {name: '1', position_m: [370, 0, 0]}, "
                  "{name: '2', position_m: [250, 520, 0]}]}"), "local axes"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            study.prepare(*read_replay(log, settings))
