"""A simulated run, exported as a recorded flight and replayed: the filter of the replay is that of the run, so its
estimates are the run's, within the rounding of decimal digits in the files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from navsim.filter.estimate import FILTER_KINDS
from navsim.formats.export import export
from navsim.formats.simulated_log import differences
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.landing import study as landing
from navsim.replays import study as replay
from navsim.results import findings
from navsim.results.result import Result
from navsim.runner.executor import threads
from navsim.scenario.load import read_replay
from tests.helpers import case

POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCELEROMETER_BIAS, SIGMA = 1e-7, 1e-8, 1e-9, 1e-11, 1e-10, 1e-8
"""Largest differences, m, m/s, rad, rad/s, m/s2, and of sigmas by their size. Digits of a latitude in degrees are good
to 1e-9 m; the filter's gains and what follows from them are below a thousand."""


def flown(name: str, *assignments: str) -> Result:
    c = case(*assignments, name=name)
    return landing.result(c, landing.fly_all(c, 3, 0, 1, threads(1), keep="all"), 3, keep="all")


def replayed(run: Result, folder: Path, *assignments: str) -> Result:
    export(run, folder / "r.h5", ["imu"])
    return replay.compute(replay.prepare(*read_replay(folder / "r_replay.yaml", assignments)))


def apart(run: Result, again: Result) -> np.ndarray:
    """Estimates of the replay less those of the run (t, 15) at the outputs of the replay, which are among the run's:
    its errors are known; of biases, which truly are constant here, what their estimates do beside the run's."""
    time = again["/filter/time"]
    at = np.searchsorted(run["/filter/time"], time - 1e-6)
    np.testing.assert_allclose(run["/filter/time"][at], time, atol=1e-9)
    of_truth = np.searchsorted(run["/truth/time"], time - 1e-6)
    np.testing.assert_allclose(run["/truth/time"][of_truth], time, atol=1e-9)
    llh, velocity, rpy = (run[f"/truth/{name}"][of_truth] for name in ("position_llh", "velocity_ned", "attitude_rpy"))
    error = run["/filter/error"][0][at]
    out = np.empty((time.size, 15))
    estimate = again["/filter/position_llh"]
    meridian, transverse = radii_of_curvature(estimate[:, 0])
    out[:, 0] = (estimate[:, 0] - llh[:, 0]) * (meridian + estimate[:, 2]) + error[:, 0]
    out[:, 1] = (estimate[:, 1] - llh[:, 1]) * (transverse + estimate[:, 2]) * np.cos(estimate[:, 0]) + error[:, 1]
    out[:, 2] = llh[:, 2] - estimate[:, 2] + error[:, 2]
    out[:, 3:6] = again["/filter/velocity_ned"] + error[:, 3:6] - velocity
    c = dcm_from_rpy(rpy) @ np.swapaxes(dcm_from_rpy(again["/filter/attitude_rpy"]), 1, 2)
    turn = 0.5 * np.stack([c[:, 2, 1] - c[:, 1, 2], c[:, 0, 2] - c[:, 2, 0], c[:, 1, 0] - c[:, 0, 1]], axis=1)
    sine = np.linalg.norm(turn, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(c, axis1=1, axis2=2) - 1.0))
    out[:, 6:9] = turn * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 0.0)[:, None] - error[:, 6:9]
    biases = np.hstack([again["/filter/gyro_bias"], again["/filter/accelerometer_bias"]])
    true = biases + error[:, 9:15]
    out[:, 9:] = true - true[0]
    return out


def radii_of_curvature(latitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the meridian and across it, m, WGS-84."""
    flattening = 1.0 / 298.257223563
    square = flattening * (2.0 - flattening)
    w = 1.0 - square * np.sin(latitude) ** 2
    return 6378137.0 * (1.0 - square) / w**1.5, 6378137.0 / np.sqrt(w)


def assert_same(run: Result, again: Result) -> None:
    """Estimates and sigmas."""
    off = np.abs(apart(run, again)).max(axis=0)
    limits = np.repeat([POSITION, VELOCITY, ATTITUDE, GYRO_BIAS, ACCELEROMETER_BIAS], 3)
    assert np.all(off < limits), off / limits
    at = np.searchsorted(run["/filter/time"], again["/filter/time"] - 1e-6)
    np.testing.assert_allclose(again["/filter/sigma"], run["/filter/sigma"][0][at], rtol=SIGMA)


LATE = ("receiver.latency_s=0.2", "receiver.lever_arm_m=[1, 0, -0.5]")
VELOCITIES = "filter.velocity=true"


@pytest.mark.parametrize(
    ("name", "assignments"),
    [
        ("s_turn", ("filter.kind=eskf", VELOCITIES)),
        ("s_turn", ("filter.kind=left-invariant", VELOCITIES, *LATE)),
        ("s_turn", ("filter.kind=tfg", *LATE)),
        ("s_turn", (VELOCITIES, *LATE)),
        ("s_turn", ("filter.kind=rts", VELOCITIES, *LATE)),
        ("s_turn", ("filter.kind=map", VELOCITIES)),
        ("landing", ("receiver.rate_hz=2", "receiver.latency_s=3.5")),
        ("landing", ("filter.steady_force=false", "receiver.rate_hz=5")),
        ("landing_open_sky", ("receiver.rate_hz=2", "filter.fix_errors=inflate")),
        ("landing_open_sky", ("receiver.rate_hz=2", "filter.kind=tfg")),
        ("landing_open_sky", ("receiver.rate_hz=5", "pseudolites.count=1")),
    ],
    ids=lambda value: value if isinstance(value, str) else "-".join(a.split("=")[1] for a in value[:1]),
)
def test_a_replay_gives_the_estimates_of_the_run(name: str, assignments: tuple[str, ...], tmp_path: Path) -> None:
    """Every kind of filter, with the velocities of fixes and without, late fixes, lever arms."""
    run = flown(name, "duration_s=30", *assignments)
    assert not differences(run)
    again = replayed(run, tmp_path)
    assert again["/filter/time"].size > 25
    assert again["/filter/time"][0] == 0.0
    assert_same(run, again)
    assert not findings.of(again)


@pytest.mark.parametrize("velocity", ["true", "false"])
def test_no_flight_is_steady_without_velocities(velocity: str, tmp_path: Path) -> None:
    """A replay of fixes of position alone keeps the measured force, as the filter of the run does."""
    run = flown("landing", "duration_s=20", "receiver.rate_hz=2", f"filter.velocity={velocity}")
    export(run, tmp_path / "r.h5", ["imu"])
    recording = replay.prepare(*read_replay(tmp_path / "r_replay.yaml", ()))
    model = recording.design(recording.settings, FILTER_KINDS["tfg"]).model()
    assert model.steady_force == (velocity == "true")


def test_the_noise_of_the_log_is_what_the_filter_believes(tmp_path: Path) -> None:
    """Sensors that the filter takes for others than they are, flicker noise, a scaled covariance of fixes, a lever arm
    and a latency that it takes for others: all of it is in the log, by the keys of a recorded flight."""
    run = flown(
        "s_turn", "duration_s=30", "filter.kind=tfg", "receiver.latency_s=0.4", "filter.latency_s=0.3",
        "filter.lever_arm_m=[0.5, 0.1, 0]", "imu.preset=adis16488", "filter.imu.gyro.arw_deg_sqrt_h=0.5",
        "filter.fix_sigma_scale=2", "filter.gate.probability=0.001", "filter.gate.max_rejected=3",
    )  # fmt: skip
    again = replayed(run, tmp_path)
    log = yaml.safe_load((tmp_path / "r_replay.yaml").read_text())
    assert log["gnss"]["latency_s"] == 0.3
    assert log["gnss"]["lever_arm_m"] == [0.5, 0.1, 0.0]
    assert log["imu"]["gyro"]["arw_deg_sqrt_h"] == pytest.approx(0.5)
    assert log["filter"]["gate"] == {"probability": 0.001, "max_rejected": 3, "restart_s": 31.0}
    at = np.searchsorted(run["/filter/time"], again["/filter/time"] - 1e-6)
    np.testing.assert_allclose(again["/filter/sigma"], run["/filter/sigma"][0][at], rtol=SIGMA)
    off = np.abs(apart(run, again)).max(axis=0)
    assert np.all(off[:9] < np.repeat([POSITION, VELOCITY, ATTITUDE], 3)), off


@pytest.mark.parametrize(
    ("name", "assignments", "words"),
    [
        ("s_turn", ("filter.coupling=tight",), "takes ranges (filter.coupling: tight)"),
        ("s_turn", ("filter.scale_factors=true", "imu.gyro.scale_ppm=300"), "follows 3 scale factors"),
        ("landing", ("radio_altimeter={sigma_floor_m: 0.3}",), "uses the radio altimeter"),
        ("s_turn", ("receiver.latency_s=0.1", "filter.latency_s=1.5"), "takes 1 fix, by filter.latency_s"),
        ("landing", ("events=[{what: silence, sources: [all], at_s: 5, until_s: 9}]",), "has 4 epochs without a fix"),
        ("beacons_pad", ("events=[{what: silence, sources: [all], at_s: 25}]",), "uses the beacons"),
    ],
)
def test_what_a_recorded_flight_cannot_have_is_named(
    name: str, assignments: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    """In the export and in its log, which flies nevertheless."""
    run = flown(name, "duration_s=30", "receiver.rate_hz=1", *assignments)
    assert [text for text in differences(run) if words in text]
    again = replayed(run, tmp_path)
    assert words in (tmp_path / "r_replay.yaml").read_text().split("kind:")[0]
    assert again["/filter/time"][0] == 0.0
    assert again["/filter/time"].size > 20


@pytest.mark.parametrize("kind", ["eskf", "rts"])
def test_ranges_of_beacons_aid_a_replay(kind: str, tmp_path: Path) -> None:
    """Two-way ranges with biases, survey errors and an antenna of its own, in a table beside the exported log."""
    run = flown(
        "landing", "duration_s=30", "receiver.rate_hz=2", f"filter.kind={kind}",
        "filter.beacons.second_order=false", "beacons={sites: [{name: NW, s_m: -60,"
        " l1_m: 2500}, {name: SE, s_m: 90, l1_m: 900, height_m: 9}], rate_hz: 8, range_limit_m: 9000, sigma_m: 0.3,"
        " bias_sigma_m: 0.2, survey_sigma_m: 0.1, growth_sigma_m: 0.1, growth_distance_m: 900,"
        " lever_arm_m: [0.5, 0, 1]}",
    )  # fmt: skip
    export(run, tmp_path / "r.h5", ["imu"])
    measured, sites = run["/aiding/beacons/measured"][0, :, 0], run["/beacons/position_llh"]
    rows = [f"{t!r},{('NW', 'SE')[k % 2]},{r!r}" for k, (t, r) in enumerate(
        zip(run["/aiding/beacons/time"].tolist(), measured.tolist(), strict=True)) if np.isfinite(r)]  # fmt: skip
    assert len(rows) == measured.size == 240
    (tmp_path / "ranges.csv").write_text("\n".join(["t_s,source,range_m", *rows]))
    log = yaml.safe_load((tmp_path / "r_replay.yaml").read_text())
    log["ranges"] = {"file": "ranges.csv", "sigma_m": 0.3, "bias_sigma_m": 0.2, "survey_sigma_m": 0.1,
                     "growth": {"sigma_m": 0.1, "distance_m": 900}, "lever_arm_m": [0.5, 0, 1]}  # fmt: skip
    log["sources"] = {"positions": [
        {"name": name, "lat_deg": float(np.degrees(lat)), "lon_deg": float(np.degrees(lon)), "height_m": float(height)}
        for name, (lat, lon, height) in zip(("NW", "SE"), sites, strict=True)
    ]}  # fmt: skip
    (tmp_path / "r_replay.yaml").write_text(yaml.safe_dump(log))
    again = replay.compute(replay.prepare(*read_replay(tmp_path / "r_replay.yaml", ())))
    assert again["/filter/state"].tolist() == run["/filter/state"].tolist()
    assert_same(run, again)
    assert again["/summary/aid"].tolist() == ["range of NW", "range of SE"]
    assert again["/summary/aid_used"].sum() == len(rows)
    assert again["/summary/beacon"].tolist() == ["NW", "SE"]
    of_bias = [list(again["/filter/state"]).index(f"beacons_bias_{name}") for name in ("NW", "SE")]
    np.testing.assert_array_equal(again["/summary/beacon_bias_sigma"], again["/filter/sigma"][-1][of_bias])
    true = again["/summary/beacon_bias"] + run["/filter/error"][0, -1, of_bias]
    np.testing.assert_allclose(true, [0.149409, 0.076821], atol=1e-6)  # by the seed, whatever the filter
