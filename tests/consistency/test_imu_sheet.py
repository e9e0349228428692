"""`navsim imu`: noise of sensors from logs at rest, with allantools as judge."""

from __future__ import annotations

from pathlib import Path

import allantools
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner, Result

from navsim.cli.main import app
from navsim.formats.recorded_data import Samples
from navsim.replays.imu_sheet import StaticError, measure, sheet
from navsim.scenario.load import read
from navsim.statistics.allan import FLAT, cluster_counts, fit, overlapping_deviation, spectra
from tests import logs

RATE = 20.0
GYRO = (8.7e-5, 6e-5, 0.0)
ACCELEROMETER = (8e-4, 0.0, 2e-4)
"""White noise, flicker noise, random walk of the rate, SI."""


def noise(rng: np.random.Generator, seconds: float, terms: tuple[float, float, float]) -> np.ndarray:
    """A record with a spectrum of these terms; flicker noise by its spectrum, over a period four times as long."""
    count, step = int(seconds * RATE), 1.0 / RATE
    white, flicker, walk = terms
    out = white / np.sqrt(step) * rng.standard_normal(count)
    out += walk * np.sqrt(step) * np.cumsum(rng.standard_normal(count))
    frequency = np.fft.rfftfreq(4 * count, step)[1:]
    phases = (rng.standard_normal((2, frequency.size)) / np.sqrt(2.0)).T @ [1.0, 1.0j]
    spectrum = np.sqrt(flicker**2 / (2.0 * np.pi * frequency) * 4 * count / step)
    return np.asarray(out + np.fft.irfft(np.concatenate([[0.0], phases * spectrum]), 4 * count)[:count])


def static(seed: int, seconds: float) -> Samples:
    rng = np.random.default_rng(seed)
    rate, force = (
        np.column_stack([noise(rng, seconds, terms) for _ in range(3)]) for terms in (GYRO, ACCELEROMETER)
    )  # fmt: skip
    time = np.arange(rate.shape[0]) / RATE
    return Samples(time, rate + np.array([1e-3, -2e-3, 5e-4]), force + np.array([0.1, -0.2, -9.79]))


def write(samples: Samples, path: Path) -> Path:
    header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    np.savetxt(
        path, np.column_stack([samples.time, samples.rate, samples.force]), "%.9g", ",", header=header, comments=""
    )
    return path


@pytest.fixture(scope="module")
def hour(tmp_path_factory: pytest.TempPathFactory) -> tuple[Samples, Path]:
    samples = static(1, 3600.0)
    return samples, write(samples, tmp_path_factory.mktemp("static") / "rest.csv")


def measured(*options: object, code: int = 0) -> Result:
    done = CliRunner().invoke(app, ["imu", *map(str, options)])
    assert done.exit_code == code, done.output
    return done


def test_deviation_is_that_of_allantools() -> None:
    """The overlapping deviation of each cluster time, and its longest."""
    record = noise(np.random.default_rng(2), 600.0, (1e-2, 2e-3, 1e-4))
    counts = cluster_counts(record.size)
    tau, expected, _, _ = allantools.oadev(record, rate=RATE, data_type="freq", taus=counts / RATE)
    found = overlapping_deviation(record[:, None], 1.0 / RATE, counts)[:, 0]
    np.testing.assert_allclose(tau, counts / RATE)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    assert counts[-1] == record.size // 10


def check_intervals(runs: int) -> None:
    """Intervals of 95 % hold the truth as often as they say; a term that is not there is not shown."""
    for terms in ((1e-2, 5e-3, 0.0), (1e-2, 0.0, 1e-3)):
        within, held, gone = np.zeros(3), np.zeros(3), 0
        for seed in range(runs):
            record = noise(np.random.default_rng([7, seed]), 1800.0, terms)
            found = fit(spectra(record[:, None], 1.0 / RATE)[0])
            parts = (found.white, found.flicker, found.walk)
            within += [part.low <= true <= part.high for part, true in zip(parts, terms, strict=True)]
            held += [part.held for part in parts]
            gone += found.ambiguous
        there = np.array(terms) > 0.0
        assert within.sum() >= 3 * runs * (0.95 - 2.5 * np.sqrt(0.05 * 0.95 / (3 * runs))), within
        assert (held[~there] <= 1 + 0.05 * runs).all(), held
        assert (held[there] + gone >= 0.9 * runs - 1).all(), (held, gone)


def test_intervals_hold_the_truth() -> None:
    check_intervals(6)


@pytest.mark.long
def test_intervals_hold_the_truth_at_length() -> None:
    check_intervals(100)


def test_sheet_of_an_hour(hour: tuple[Samples, Path], tmp_path: Path) -> None:
    """Values within their intervals of the truth, a block that `imu:` takes, a table and a figure."""
    samples, path = hour
    said = measured(path, "-o", tmp_path / "out").stdout
    assert "3600 s at rest, 20 Hz" in said
    found = measure(samples, "rest.csv")
    for sensor, terms in zip(found.sensors, (GYRO, ACCELEROMETER), strict=True):
        for part, true in zip(
            (sensor.together.white, sensor.together.flicker, sensor.together.walk), terms, strict=True
        ):
            assert 0.9 * part.low <= true <= 1.1 * part.high
    block = yaml.safe_load((tmp_path / "out/imu.yaml").read_text())["imu"]
    lowest = np.degrees(np.sqrt(FLAT) * GYRO[1]) * 3600.0
    assert block["gyro"]["bias_instability_deg_h"] == pytest.approx(lowest, rel=0.15)
    assert block["gyro"]["arw_deg_sqrt_h"] == pytest.approx(np.degrees(GYRO[0]) * 60.0, rel=0.03)
    assert block["accelerometer"]["bias_random_walk_mg_sqrt_h"] == pytest.approx(60e3 * 2e-4 / 9.80665, rel=0.4)
    assert "bias_instability_mg" not in block["accelerometer"]
    scenario = tmp_path / "a.yaml"
    approach = "approach: {profile: smooth, start: {lat_deg: 48.23, lon_deg: 11.4}}\n"
    scenario.write_text(f"kind: landing\nversion: 1\nepoch: 2026-05-01T09:00:00Z\n{approach}{sheet(found)}")
    section, _ = read(scenario)
    assert section.imu.gyro.bias_instability_deg_h == block["gyro"]["bias_instability_deg_h"]
    assert section.imu.gyro.triad(RATE).markov > 0.0
    table = np.genfromtxt(tmp_path / "out/allan.csv", delimiter=",", names=True)
    assert table["gyro_x"][0] == pytest.approx(np.std(np.diff(samples.rate[:, 0])) / np.sqrt(2.0), rel=1e-4)
    assert (tmp_path / "out/allan.png").read_bytes().startswith(b"\x89PNG")
    assert "--force" in measured(path, "-o", tmp_path / "out", code=2).stderr


def test_a_short_log_has_no_bias_instability(hour: tuple[Samples, Path]) -> None:
    """Two minutes cannot hold the level: the sheet says so, with a limit, and has no key."""
    found = measure(hour[0], "rest.csv", 100.0, 220.0)
    assert not found.sensors[0].holds_flicker()
    assert any("bias instability" in remark and "gyro" in remark for remark in found.remarks)
    text = sheet(found)
    assert "bias_instability_deg_h:" not in text
    assert "arw_deg_sqrt_h:" in text


def test_moving_and_unusable_logs_are_refused(hour: tuple[Samples, Path], tmp_path: Path) -> None:
    """With the time of the motion and the part at rest; other units; too few samples; a hole is told."""
    samples, _ = hour
    bumped = Samples(samples.time, samples.rate.copy(), samples.force)
    bumped.rate[20000:20060, 1] += 0.05
    text = r"the gyros change by 2\.\d+ deg/s at 100\d\.\d s.*longest rest is 1003 to 3600 s"
    with pytest.raises(StaticError, match=text):
        measure(bumped, "")
    measure(bumped, "", first=1010.0, last=1200.0)
    with pytest.raises(StaticError, match="never lies still for the 60 s"):
        measure(bumped, "", first=970.0, last=1035.0)
    tilted = Samples(samples.time, samples.rate, samples.force.copy())
    tilted.force[30000:, 0] += 0.8
    with pytest.raises(StaticError, match="the accelerometers change"):
        measure(tilted, "")
    with pytest.raises(StaticError, match=r"the mean specific force is 0\.998\d? m/s2"):
        measure(Samples(samples.time, samples.rate, samples.force / 9.81), "")
    with pytest.raises(StaticError, match=r"50\.0 s of samples; the noise needs 60 s"):
        measure(samples, "", last=50.0)
    keep = (samples.time < 2000.0) | (samples.time > 2100.0)
    holed = measure(Samples(samples.time[keep], samples.rate[keep], samples.force[keep]), "")
    assert any("the piece from 0.0 to 2000.0 s" in remark for remark in holed.remarks)
    (tmp_path / "one.csv").write_text("".join(hour[1].read_text().splitlines(keepends=True)[:99]))
    table = measured(tmp_path / "one.csv", "--imu", 1, "-o", tmp_path / "o", code=2).stderr
    assert "it has the samples of one IMU, number 0; leave --imu out" in table
    assert "no IMU 1" in measured(_dataflash(samples, tmp_path), "--imu", 1, "-o", tmp_path / "o", code=2).stderr
    assert "cannot be read" in measured(tmp_path / "none.csv", code=2).stderr
    (tmp_path / "words.csv").write_text("nothing\n")
    assert "error: " in measured(tmp_path / "words.csv", code=2).stderr


def test_logs_of_all_kinds_are_read(hour: tuple[Samples, Path], tmp_path: Path) -> None:
    """A log of an autopilot, and a log.yaml that declares units: the same sheet."""
    samples = hour[0].between(0.0, 200.0)
    measured(_dataflash(samples, tmp_path), "-o", tmp_path / "bin")
    table = np.column_stack([samples.time, np.degrees(samples.rate), samples.force / 9.80665])
    header = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    np.savetxt(tmp_path / "own.csv", table, "%.9g", ",", header=header, comments="")
    (tmp_path / "log.yaml").write_text(
        "kind: replay\nversion: 1\nimu: {file: own.csv, gyro_unit: deg/s, accelerometer_unit: g}\n"
        "gnss: {file: none.csv}\n"
    )
    measured(tmp_path / "log.yaml", "-o", tmp_path / "yaml")
    one, other = (yaml.safe_load((tmp_path / name / "imu.yaml").read_text())["imu"] for name in ("bin", "yaml"))
    assert one["gyro"] == pytest.approx(other["gyro"], rel=2e-3)
    assert one["accelerometer"] == pytest.approx(other["accelerometer"], rel=2e-3)


def test_a_flight_is_no_static_log(shared: Path) -> None:
    """A real aircraft, parked and flying: refused; its first minutes on the ground are not."""
    path = shared / "data/fw_thor75/imu.csv.gz"
    assert "moves" in measured(path, code=2).stderr


def _dataflash(samples: Samples, folder: Path) -> Path:
    rows = [
        [round(1e6 * t), 0, *w, *f] for t, w, f in zip(samples.time, samples.rate, samples.force, strict=True)
    ]  # fmt: skip
    logs.write_dataflash(folder / "rest.bin", {"IMU": rows})
    return folder / "rest.bin"


def test_a_dead_axis_is_refused() -> None:
    """Samples that never change have no spectrum to fit."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 100.0, 0.02)
    rate, force = rng.normal(0.0, 1e-3, (time.size, 3)), np.tile([0.0, 0.0, -9.80665], (time.size, 1))
    with pytest.raises(StaticError, match="the accelerometer of the x axis never changes"):
        measure(Samples(time, rate, force), "log")
