"""`navsim import`: logs of other programs become recorded flights that give the same estimate."""

from __future__ import annotations

import gzip
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyubx2 import GET, UBXMessage
from typer.testing import CliRunner, Result

from navsim.cli import imports
from navsim.cli.main import app
from navsim.formats.conventions import FIX_ACCURACIES, FIX_SIGMAS
from navsim.formats.recorded_data import Fixes, Samples
from navsim.formats.recording import read_fixes, read_imu
from navsim.formats.rinex_obs import read_obs
from navsim.formats.text import FileError
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.timescales import WEEK
from navsim.logs import reading
from navsim.logs.contents import QUALITY, FixRecord, LogContents, interpolated
from navsim.logs.reading import read_logs
from navsim.logs.tables import log_files
from navsim.replays import study as replay
from navsim.runner.opening import stem_of_log
from navsim.scenario.load import read_any, read_replay
from navsim.scenario_files.source import InputError
from tests import logs
from tests.conftest import ROOT
from tests.recordings import LATENCY, LEVER, sentences_of, write_flight

GIVEN = ("tuning=none", f"gnss.latency_s={LATENCY}", "gnss.velocity_sigma_m_s=[0.1, 0.1]", "imu.samples=averaged",
         f"gnss.lever_arm_m={LEVER.tolist()}", "checks=off")  # fmt: skip
ANTENNA = {"GPS_POS1_X": 1.4, "GPS_POS1_Y": -0.2, "GPS_POS1_Z": -0.3, "INS_POS1_X": 1.0}
DAY = 86400.0
"""Time of week of time 0, s: `logs.GPS_START`."""


@dataclass(frozen=True)
class Flight:
    """A recorded flight and its attitudes."""

    folder: Path
    samples: Samples
    fixes: Fixes
    rpy: np.ndarray


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    folder = tmp_path_factory.mktemp("flight")
    _, _, _, rpy = write_flight(folder, 30.0)
    return Flight(folder, read_imu(folder / "imu.csv")[0], read_fixes(folder / "gnss.csv")[0], rpy)


def imported(*options: object, code: int = 0) -> Result:
    done = CliRunner().invoke(app, ["import", *map(str, options)])
    assert done.exit_code == code, done.output
    assert code or done.exception is None
    return done


def dataflash(of: Flight) -> dict[str, list[list[Any]]]:
    out = logs.dataflash_of(of.samples, of.fixes, ANTENNA)
    out["ATT"] = [[round(1e6 * t), *np.degrees(a)] for t, a in zip(of.samples.time, of.rpy, strict=True)]
    return out


def in_dataflash(of: Flight, folder: Path) -> list[Path]:
    logs.write_dataflash(folder / "log.bin", dataflash(of))
    return [folder / "log.bin"]


def in_ulog(of: Flight, folder: Path) -> list[Path]:
    topics = logs.ulog_of(of.samples, of.fixes, dcm_from_rpy(of.rpy))
    logs.write_ulog(folder / "log.ulg", topics, {"EKF2_GPS_POS_X": 0.4, "EKF2_GPS_DELAY": 110.0, "SENS_BOARD_ROT": 0})
    return [folder / "log.ulg"]


def increments(of: Flight, folder: Path) -> Path:
    """The samples as KF-GINS has them, with times of GPS."""
    step = np.diff(of.samples.time, prepend=of.samples.time[0] - 0.02)[:, None]
    table = np.column_stack([of.samples.time + DAY, of.samples.rate * step, of.samples.force * step])
    np.savetxt(folder / "imu.txt", table, "%.12g")
    return folder / "imu.txt"


def in_ubx(of: Flight, folder: Path) -> list[Path]:
    (folder / "log.ubx").write_bytes(logs.ubx_of(of.fixes))
    return [folder / "log.ubx", increments(of, folder)]


def in_kf_gins(of: Flight, folder: Path) -> list[Path]:
    degrees = np.degrees(of.fixes.llh[:, :2])
    sigma = np.full((degrees.shape[0], 3), 0.3)
    velocity = np.hstack([of.fixes.velocity, np.full_like(sigma, 0.1)])
    table = np.column_stack([of.fixes.time + DAY, degrees, of.fixes.llh[:, 2], sigma, velocity])
    np.savetxt(folder / "gnss.txt", table, "%.12f")
    settings = folder / "kf-gins.yaml"
    increments(of, folder)
    settings.write_text(f'imupath: "imu.txt"\ngnsspath: "gnss.txt"\nantlever: {LEVER.tolist()}\n')
    return [settings]


def in_rtklib(of: Flight, folder: Path) -> list[Path]:
    header = "%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s) "
    header += "ratio vn(m/s) ve(m/s) vu(m/s)"
    week = int(logs.GPS_START // WEEK)
    rows = [
        f"{week} {t + DAY:.4f} {np.degrees(p[0]):.10f} {np.degrees(p[1]):.10f} {p[2]:.4f} 1 9 0.3 0.2 0.5 0.1 -0.1 0.2 "
        f"0 0 {v[0]:.5f} {v[1]:.5f} {-v[2]:.5f}"
        for t, p, v in zip(of.fixes.time, of.fixes.llh, of.fixes.velocity, strict=True)
    ]
    (folder / "log.pos").write_text("\n".join(["% program: demo5", header, *rows]) + "\n")
    return [folder / "log.pos", increments(of, folder)]


def in_comma2k19(of: Flight, folder: Path) -> list[Path]:
    segment = folder / "segment"
    segment.mkdir()
    speed, course = np.hypot(*of.fixes.velocity[:, :2].T), np.degrees(np.arctan2(*of.fixes.velocity[:, 1::-1].T))
    fix = np.column_stack([np.degrees(of.fixes.llh[:, :2]), speed, 0 * speed, of.fixes.llh[:, 2], course])
    for name, at, values in (
        ("IMU_gyro", of.samples.time, of.samples.rate), ("IMU_accelerometer", of.samples.time, of.samples.force),
        ("GNSS_live_gnss_ublox", of.fixes.time, fix),
    ):  # fmt: skip
        np.save(segment / f"{name}_t.npy", at)
        np.save(segment / f"{name}_value.npy", values)
    return [segment]


FORMATS: dict[str, tuple[Callable[[Flight, Path], list[Path]], float, float]] = {
    "ardupilot": (in_dataflash, 0.0, 0.006), "px4": (in_ulog, 0.0, 1e-4), "ublox": (in_ubx, DAY, 0.006),
    "kf-gins": (in_kf_gins, DAY, 1e-5), "rtklib": (in_rtklib, DAY, 1e-4), "comma2k19": (in_comma2k19, 0.0, 1e-5),
}  # fmt: skip
"""Writer, time that the format adds, half the last digit of its positions, m."""


def estimate(log: Path, *assignments: str) -> Any:
    return replay.compute(replay.prepare(*read_replay(log, (*GIVEN, *assignments))))


@cache
def direct(log: Path, *assignments: str) -> Any:
    return estimate(log, *assignments)


@pytest.mark.parametrize("name", FORMATS)
def test_a_flight_survives_each_format(flight: Flight, tmp_path: Path, name: str) -> None:
    """The tables are the flight's to the digits of the format, and the replay's estimate is the same to them."""
    write, shift, digit = FORMATS[name]
    said = imported(*write(flight, tmp_path), "-o", tmp_path / "out").stdout
    log = tmp_path / "out/log.yaml"
    assert f"go on with: navsim replay {log}" in said
    samples, fixes = read_imu(tmp_path / "out/imu.csv")[0], read_fixes(tmp_path / "out/gnss.csv")[0]
    np.testing.assert_allclose(samples.time - shift, flight.samples.time, atol=1e-6)
    np.testing.assert_allclose(samples.rate, flight.samples.rate, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(samples.force, flight.samples.force, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(fixes.time - shift, flight.fixes.time, atol=1e-6)
    apart = np.linalg.norm(ecef_from_llh(fixes.llh) - ecef_from_llh(flight.fixes.llh), axis=1)
    assert apart.max() < 2.0 * digit
    across = slice(0, 2 if name == "comma2k19" else 3)
    np.testing.assert_allclose(fixes.velocity[:, across], flight.fixes.velocity[:, across], atol=6e-4)
    # sigmas and accuracies of the fixes, and a missing vertical velocity, are differences that the formats do have
    weights = [f"gnss.columns={{{', '.join(f'{key}: absent_{key}' for key in (*FIX_SIGMAS, *FIX_ACCURACIES))}}}"]
    if name == "comma2k19":
        original = flight.folder / "level.yaml"
        rows = (flight.folder / "gnss.csv").read_text().splitlines()
        level = [rows[0], *(f"{row.rpartition(',')[0]}," for row in rows[1:])]
        (flight.folder / "level.csv").write_text("\n".join(level))
        original.write_text((flight.folder / "log.yaml").read_text().replace("gnss.csv", "level.csv"))
    else:
        original = flight.folder / "log.yaml"
    expected, found = direct(original), estimate(log, *weights)
    np.testing.assert_allclose(found["/filter/time"] - shift, expected["/filter/time"], atol=1e-5)
    off = ecef_from_llh(found["/filter/position_llh"]) - ecef_from_llh(expected["/filter/position_llh"])
    assert np.linalg.norm(off, axis=1).max() < 2.0 * digit + 1e-4
    turned = np.abs(found["/filter/attitude_rpy"] - expected["/filter/attitude_rpy"])
    assert np.degrees(np.minimum(turned, 2.0 * np.pi - turned)).max() < 0.02
    if name in ("ardupilot", "px4"):  # the autopilot's attitude is the truth here
        apart = np.interp(found["/filter/time"], flight.samples.time, np.unwrap(flight.rpy[:, 2]))
        apart = np.angle(np.exp(1j * (found["/filter/attitude_rpy"][:, 2] - apart)))
        assert found["/summary/attitude_difference_mean"][2] == pytest.approx(apart.mean(), abs=2e-3)
        assert found["/summary/attitude_difference_scatter"][2] == pytest.approx(apart.std(), abs=2e-3)


def test_sentences_are_the_fixes_of_the_replay(flight: Flight, tmp_path: Path) -> None:
    """NMEA: the same fixes as the replay reads by itself, with accuracies of GST and qualities of GGA."""
    lines = sentences_of(flight.folder / "gnss.csv")
    of_day = lines[0].split(",")[1]
    body = f"GPGST,{of_day},1.0,,,,0.3,0.4,0.7"
    check = 0
    for letter in body:
        check ^= ord(letter)
    path = tmp_path / "log.nmea"
    damaged = body.replace(",0.3,", ",9.3,")
    path.write_text("\n".join([*lines, f"${body}*{check:02X}", f"${damaged}*{check:02X}"]) + "\n")
    told = imported(path, "-o", tmp_path / "out")
    assert "no sentence has a date" in told.stdout
    assert "warning: " in told.stderr
    assert "no inertial samples (1 corrupt NMEA" in told.stderr
    assert "so there is no log.yaml" in told.stderr
    assert not (tmp_path / "out/log.yaml").exists()
    found, expected = read_fixes(tmp_path / "out/gnss.csv")[0], read_fixes(path)[0]
    np.testing.assert_allclose(found.llh, expected.llh, atol=1e-9)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-9)
    table = np.genfromtxt(tmp_path / "out/gnss.csv", delimiter=",", names=True)
    assert table["quality"][0] == QUALITY["3D"]
    assert table["sigma_horizontal_m"][0] == pytest.approx(np.hypot(0.3, 0.4) / np.sqrt(2))
    assert table["sigma_vertical_m"][0] == 0.7
    assert np.isnan(table["sigma_vertical_m"][1])


def test_a_drone_log_gives_all_that_it_has(flight: Flight, tmp_path: Path) -> None:
    """All instances, further sensors, the attitude, parameters; what was taken and decided is told and in log.yaml."""
    messages = dataflash(flight) | {"BARO": [[round(1e6 * t), 0, 101.5, 99e3, 20.0] for t in flight.fixes.time]}
    two = logs.dataflash_of(flight.samples, flight.fixes, ANTENNA | {"GPS_DELAY_MS": 200.0, "INS_POS2_X": 1.2}, 2, 2)
    messages |= {name: two[name] for name in ("IMU", "GPS", "GPA", "PARM")}
    messages["GPS"][7][2] = 1
    messages["GPS"][3][-2], field = 40.0, np.einsum("nji,j->ni", dcm_from_rpy(flight.rpy), [180.0, 0.0, 400.0])
    messages["MAG"] = [[round(1e6 * t), 0, *map(round, b)] for t, b in zip(flight.samples.time, field, strict=True)]
    logs.write_dataflash(tmp_path / "log.bin", messages)
    said = imported(tmp_path / "log.bin", "-o", tmp_path / "out", "--imu", 1, "--receiver", 1).stdout
    text = (tmp_path / "out/log.yaml").read_text()
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "imu0.csv", "imu1.csv", "gnss0.csv", "gnss1.csv", "barometer.csv", "attitude.csv", "log.yaml",
        "magnetometer.csv", "magnetic_heading.csv", "antenna_heading.csv",
    }  # fmt: skip
    assert "file: imu1.csv" in text
    assert "file: gnss1.csv" in text
    for line in ("1 messages of GPS 0 without a 3D fix", "heights of GPS 1 above the ellipsoid: GPS.Alt less GPA.Und"):
        assert line in said
        assert line in text
    assert "epoch: 2024-02-04T23:59:42" in text
    imported(tmp_path / "log.bin", "-o", tmp_path / "out", "--force")
    text = (tmp_path / "out/log.yaml").read_text()
    assert "lever_arm_m: [0.4, -0.2, -0.3]" in text
    assert "latency_s: 0.2" in text
    table = np.genfromtxt(tmp_path / "out/gnss0.csv", delimiter=",", names=True)
    assert table["sigma_horizontal_m"][0] == pytest.approx(0.9)
    assert table["quality"][0] == QUALITY["3D"]
    attitude = np.genfromtxt(tmp_path / "out/attitude.csv", delimiter=",", names=True)
    np.testing.assert_allclose(attitude["roll_deg"], np.degrees(flight.rpy[:, 0]), atol=1e-4)
    headings = np.genfromtxt(tmp_path / "out/magnetic_heading.csv", delimiter=",", names=True)
    away = np.radians(headings["heading_deg"]) - flight.rpy[:, 2]
    assert np.abs(np.angle(np.exp(1j * away))).max() < 0.006  # rounded to 1 mG
    assert "source: antennas" in text
    antennas = np.genfromtxt(tmp_path / "out/antenna_heading.csv", delimiter=",", names=True)
    assert antennas["heading_deg"] == 40.0


def test_samples_of_a_turned_board(flight: Flight, tmp_path: Path) -> None:
    """Raw samples alone, SENS_BOARD_ROT 2 (yaw 90): navsim turns them into body axes and says so."""
    topics = logs.ulog_of(flight.samples, flight.fixes, dcm_from_rpy(flight.rpy))
    stamp = topics.pop("sensor_combined")["timestamp"]
    back = dcm_from_rpy(np.array([0.0, 0.0, np.pi / 2]))
    for topic, values in (("sensor_gyro", flight.samples.rate), ("sensor_accel", flight.samples.force)):
        topics[topic] = {"timestamp": stamp, **{axis: ("f", (values @ back)[:, i]) for i, axis in enumerate("xyz")}}
    logs.write_ulog(tmp_path / "log.ulg", topics, {"SENS_BOARD_ROT": 2})
    assert "SENS_BOARD_ROT is 2" in imported(tmp_path / "log.ulg", "-o", tmp_path / "out").stdout
    logs.write_ulog(tmp_path / "default.ulg", topics, {})
    said = imported(tmp_path / "default.ulg", "-o", tmp_path / "own").stdout
    assert "SENS_BOARD_ROT is not in the log; its default is 0" in said
    known = ["gyro_axes: FRD" in (tmp_path / folder / "log.yaml").read_text() for folder in ("out", "own")]
    assert known == [True, False], "axes by a default are assumed"
    samples = read_imu(tmp_path / "out/imu.csv")[0]
    np.testing.assert_allclose(samples.rate, flight.samples.rate, atol=1e-6)
    np.testing.assert_allclose(samples.force, flight.samples.force, atol=1e-5)


def test_increments_of_px4(flight: Flight, tmp_path: Path) -> None:
    """vehicle_imu has angles and velocities by interval, each with its duration, us; one without it has no sample."""
    topics = logs.ulog_of(flight.samples, flight.fixes, dcm_from_rpy(flight.rpy))
    stamp, micro = topics.pop("sensor_combined")["timestamp"], np.where(flight.samples.time < 5.0, 5000, 4000)
    micro[-1] = 0
    topics["vehicle_imu"] = {
        "timestamp": stamp, "delta_angle": ("f", flight.samples.rate * 1e-6 * micro[:, None]),
        "delta_velocity": ("f", flight.samples.force * 1e-6 * micro[:, None]),
        "delta_angle_dt": ("I", micro), "delta_velocity_dt": ("I", micro),
    }  # fmt: skip
    logs.write_ulog(tmp_path / "log.ulg", topics, {})
    (taken,) = read_logs([tmp_path / "log.ulg"]).imus
    np.testing.assert_allclose(taken.rate, flight.samples.rate[:-1], rtol=1e-6)
    np.testing.assert_allclose(taken.force, flight.samples.force[:-1], rtol=1e-6)
    del topics["vehicle_imu"]["delta_angle_dt"]
    logs.write_ulog(tmp_path / "lacks.ulg", topics, {})
    assert "vehicle_imu 0: it lacks increments or their intervals" in read_logs([tmp_path / "lacks.ulg"]).left_out


def test_covariances_of_rtklib(flight: Flight, tmp_path: Path) -> None:
    """The roots of covariances, with their signs, become correlations in north, east, down."""
    imported(*in_rtklib(flight, tmp_path), "-o", tmp_path / "out")
    covariance = read_fixes(tmp_path / "out/gnss.csv")[0].covariance
    assert covariance is not None
    expected = np.array([[0.09, 0.01, -0.04], [0.01, 0.04, 0.01], [-0.04, 0.01, 0.25]])
    np.testing.assert_allclose(covariance[0, :3, :3], expected, rtol=1e-6)


@pytest.mark.parametrize("geodetic", [True, False], ids=["px4", "ardupilot"])
def test_beacons_become_a_ranges_study(flight: Flight, tmp_path: Path, geodetic: bool) -> None:
    """Ranges to beacons are a table and a file that `navsim replay` takes."""
    names = np.tile([1, 2, 3, 4], 60)
    at = 1.0 + 0.1 * np.arange(names.size)
    east_north_up = {1: (0.0, 0.0, 3.0), 2: (40.0, 0.0, 5.0), 3: (0.0, 50.0, 4.0), 4: (40.0, 50.0, 9.0)}
    here = np.array([15.0, 20.0, 1.0])
    ranges = np.array([np.linalg.norm(np.array(east_north_up[n]) - here) for n in names])
    if geodetic:
        lat, lon = 45.0 + 0 * at, 10.0 + 0 * at
        place = np.array([east_north_up[n] for n in names])
        lat, lon = lat + place[:, 1] / 111132.0, lon + place[:, 0] / 78847.0
        topic = {
            "timestamp": ("Q", 1e6 * at), "timestamp_sample": ("Q", 1e6 * at), "beacon_id": ("B", names),
            "range": ("f", ranges), "lat": ("d", lat), "lon": ("d", lon),
            "alt": ("f", place[:, 2]), "alt_ellipsoid": ("f", place[:, 2]), "range_accuracy": ("f", 0.1 + 0 * at),
        }  # fmt: skip
        path = tmp_path / "log.ulg"
        logs.write_ulog(path, {"ranging_beacon": topic}, {})
    else:
        path = tmp_path / "log.bin"
        rows = [
            [round(1e6 * t), core, n, r, 0.0, 0.1, 0.0, east_north_up[n][1], east_north_up[n][0], -east_north_up[n][2]]
            for core in (0, 1)
            for t, n, r in zip(at, names.tolist(), ranges, strict=True)
        ]
        logs.write_dataflash(path, {"XKF0": rows})
    said = imported(path, "-o", tmp_path / "out").stdout
    assert "240 ranges to 4 beacons" in said
    assert f"go on with: navsim replay {tmp_path / 'out/ranges.yaml'}" in said
    done = CliRunner().invoke(app, ["validate", str(tmp_path / "out/ranges.yaml")])
    assert done.exit_code == 0, done.output


def test_raw_measurements_as_rinex(tmp_path: Path) -> None:
    """RXM-RAWX becomes observations that navsim reads back."""
    out = []
    for k in range(4):
        measured = {"gnssId": [0, 6, 2, 0], "svId": [5, 3, 11, 5], "sigId": [0, 0, 0, 3], "freqId": [0, 9, 0, 0]}
        values: dict[str, Any] = {"prMes": [2.2e7 + k, 2.1e7, 2.4e7, 2.2e7], "doMes": [-1000.0, 500.0, 20.0, 0.0]}
        values |= {"cno": [45, 40, 38, 30], "prValid": [1, 1, 1, 1], "cpMes": [1.0] * 4, **measured}
        flat = {f"{key}_{i:02d}": each for key, row in values.items() for i, each in enumerate(row, 1)}
        out.append(UBXMessage("RXM", "RXM-RAWX", GET, rcvTow=DAY + k + 0.25, week=2300, leapS=18, numMeas=4, **flat))
    path = tmp_path / "log.ubx"
    path.write_bytes(b"".join(message.serialize() for message in out))
    assert "4 raw measurements of other frequencies" in imported(path, "-o", tmp_path / "out").stdout
    seen = read_obs(tmp_path / "out/gnss.obs")
    assert sorted(seen.satellites) == ["E11", "G05", "R03"]
    assert np.nanmax(np.abs(np.sort(seen.of("C1C")[-1]) - [2.1e7, 2.2e7 + 3, 2.4e7])) < 1e-3


def test_refusals(flight: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each says what is wrong and what to do."""
    path = in_dataflash(flight, tmp_path)[0]
    out = tmp_path / "out"
    for name, content, text in (
        ("empty.bin", b"", "the file is empty"),
        ("noise.bin", bytes(range(256)) * 9, "nor a log that navsim knows"),
        ("words.txt", b"nothing here\n" * 9, "name its format with --format ardupilot|px4|ublox|nmea|"),
        ("log.yaml", b"kind: replay\nversion: 1\n", "needs no import"),
        ("table.csv", b"t,x\n1,2\n" * 9, "declare the columns in a log.yaml"),
        ("a.tlog", bytes(9), "does not read MAVLink logs"),
        ("cut.ulg", b"ULog\x01\x12\x35\x01", "damaged"),
    ):
        (tmp_path / name).write_bytes(content)
        assert text in imported(tmp_path / name, "-o", out, code=2).stderr, name
    assert "cannot be read: No such file" in imported(tmp_path / "none.bin", code=2).stderr
    assert "the folder is not a segment of comma2k19" in imported(tmp_path, code=2).stderr
    assert "ardupilot" in imported(path, "--format", "ardupilott", code=2).stderr
    assert "--imu 3: the log has no such IMU; it has 0: IMU 0" in imported(path, "--imu", 3, code=2).stderr
    assert "files with different clocks" in imported(path, path, code=2).stderr
    imported(path, "-o", out)
    assert "--force" in imported(path, "-o", out, code=2).stderr
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    assert "pip install '.[logs]'" in imported(path, "-o", out, code=2).stderr


@pytest.mark.parametrize("lacking", ["3D fixes", "samples"])
def test_what_a_replay_lacks_is_said_with_its_cause(flight: Flight, tmp_path: Path, lacking: str) -> None:
    """An autopilot's log without log.yaml fails, and a later replay says why there is none."""
    messages = dataflash(flight)
    if lacking == "3D fixes":
        messages["GPS"] = [[*row[:2], 1, *row[3:]] for row in messages["GPS"]]
    else:
        del messages["IMU"]
    logs.write_dataflash(tmp_path / "log.bin", messages)
    done = imported(tmp_path / "log.bin", "-o", tmp_path / "out", code=3)
    with pytest.raises(InputError, match="`navsim import` found no samples or no fixes"):
        read_replay(tmp_path / "out/log.yaml")
    if lacking == "3D fixes":
        count = len(messages["GPS"])
        assert f"no fixes ({count} messages of GPS 0 without a 3D fix; GPS 0: fewer than two fixes)" in done.stderr
        assert "heights of" not in done.stdout


def test_replays_of_two_imports_have_two_results() -> None:
    stems = [stem_of_log(Path(name)) for name in ("a_log/log.yaml", "b_log/log.yaml", "b_log/ranges.yaml", "log.yaml")]
    assert stems == ["a_log", "b_log", "b_ranges", "log"]


def test_files_of_one_recording(flight: Flight, tmp_path: Path) -> None:
    """Receivers of the same name stay two; a second file of raw measurements does not replace the first one."""
    name = in_rtklib(flight, tmp_path)[0]
    other = tmp_path / "other.pos"
    other.write_text(name.read_text())
    imported(name, other, increments(flight, tmp_path), "--receiver", 1, "-o", tmp_path / "out")
    assert "file: gnss1.csv" in (tmp_path / "out/log.yaml").read_text()
    first, second = (LogContents("log", clock="week", texts={"gnss.obs": text}) for text in "ab")
    with pytest.raises(FileError, match="as a file before it; import them one by one"):
        first.merge(second, "second.ubx")


def test_odd_logs_are_read_or_refused(tmp_path: Path) -> None:
    """None ends in an error of Python: fixes months apart, a header that changes, settings of settings, no samples."""
    header = "%  GPST latitude(deg) longitude(deg) height(m) Q"
    rows = [f"2024/0{month}/01 00:00:00 48 11 500 1" for month in (1, 6)]
    (tmp_path / "apart.pos").write_text("\n".join([header, *rows]) + "\n")
    assert read_logs([tmp_path / "apart.pos"]).receivers[0].time.size == 2
    (tmp_path / "joined.pos").write_text("\n".join([header, *rows, f"{header} ns", f"{rows[1]} 9"]) + "\n")
    (tmp_path / "own.yaml").write_text("imupath: own.yaml\ngnsspath: own.yaml\n")
    for name, width in (("IMU_gyro", 3), ("IMU_accelerometer", 3), ("GNSS_live_gnss_ublox", 6)):
        np.save(tmp_path / f"{name}_t.npy", np.zeros(0))
        np.save(tmp_path / f"{name}_value.npy", np.zeros((0, width)))
    for path, text in (
        (tmp_path / "joined.pos", "split the file here"), (tmp_path / "own.yaml", "the settings name settings"),
        (tmp_path, "IMU: fewer than two samples"),
    ):  # fmt: skip
        with pytest.raises(FileError, match=text):
            read_logs([path])


def test_times_of_slow_and_long_logs(flight: Flight, tmp_path: Path) -> None:
    """A damaged time takes no slow record beside it with it; a time of week that comes again is not the first one."""
    out, time = LogContents("log"), 10.0 * np.arange(12.0)
    time[5] = 3.0
    out.add_receiver(FixRecord("slow", time, np.zeros((12, 3)), np.zeros((12, 3))))
    assert out.receivers[0].time.size == 11
    week = replace(flight.fixes.take(np.array([0, 0])), time=np.array([100.0, 100.0 + WEEK]))
    middle = replace(week, time=week.time[0] + np.array([0.45, 0.9]) * WEEK)
    precise = [
        UBXMessage("NAV", "NAV-HPPOSLLH", GET, iTOW=round(1000 * (DAY + 100)), lat=lat, lon=10.0, height=1000)
        for lat in (48.0, 49.0)
    ]
    first, last = logs.ubx_of(week)[:100], logs.ubx_of(week)[100:]
    log = [first, precise[0].serialize(), logs.ubx_of(middle), last, precise[1].serialize()]
    (tmp_path / "log.ubx").write_bytes(b"".join(log))
    (fixes,) = read_logs([tmp_path / "log.ubx"]).receivers
    assert fixes.llh[0, 0] == pytest.approx(48.0)
    assert fixes.llh[3, 0] == pytest.approx(49.0)
    np.testing.assert_allclose(np.diff(fixes.time), np.array([0.45, 0.45, 0.1]) * WEEK)


def test_samples_of_two_clocks_that_end_apart() -> None:
    """Accelerometers out of order are sorted; a stream that has ended is not held at its last value."""
    time = np.arange(0.0, 4.0, 0.01)
    theirs = np.roll(np.arange(-0.003, 2.0, 0.01), 7)
    on_gyro = interpolated(time, theirs, np.column_stack([theirs, -theirs]))
    there = time <= theirs.max()
    assert np.abs(on_gyro[there] - time[there, None] * [1.0, -1.0]).max() < 1e-12
    assert np.isnan(on_gyro[time > theirs.max() + 0.11]).all()


def test_the_formats_are_declared_once() -> None:
    """The command's list and the page have what each module declares."""
    assert tuple(reading.FORMATS) == imports.FORMATS
    page = (ROOT / "docs/how-to/log.md").read_text()
    for form in reading.FORMATS.values():
        assert f"| {form.GIVES} |" in page


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A log that is cut off, lacks a piece, or has wrong bytes."""
    kind = rng.integers(3)
    at = int(rng.integers(len(content)))
    if kind == 0:
        return content[:at]
    if kind == 1:
        return content[:at] + content[at + int(rng.integers(1, 4000)) :]
    wrong = bytearray(content)
    for place in rng.integers(len(content), size=int(rng.integers(1, 60))):
        wrong[place] = int(rng.integers(256))
    return bytes(wrong)


def check_damaged(flight: Flight, tmp_path: Path, count: int) -> None:
    """Every damaged log is read in part or refused with a message, in time; no table has an impossible value."""
    rng = np.random.default_rng(4)
    refused: list[str] = []
    whole = [(write(flight, tmp_path)[0], name) for name, (write, *_) in FORMATS.items() if name not in ("comma2k19",)]
    whole = [(path, path.read_bytes()) for path, name in whole if name != "kf-gins"]
    whole.append((tmp_path / "imu.txt", (tmp_path / "imu.txt").read_bytes()))
    whole.append((tmp_path / "log.nmea", "\n".join(sentences_of(flight.folder / "gnss.csv")).encode()))
    for k in range(count):
        path, content = whole[k % len(whole)]
        hurt = tmp_path / f"hurt{path.suffix}"
        hurt.write_bytes(damaged(content, rng))
        begun = time.process_time()
        try:
            contents = read_logs([hurt])
            files = log_files(contents, hurt.name)
        except FileError as error:
            refused.append(str(error))
            continue
        finally:
            assert time.process_time() - begun < 10.0
        for columns, rows in files.tables.values():
            assert np.isfinite(rows[:, 0]).all(), columns
        for sensor in contents.imus:
            assert np.abs(sensor.rate).max() <= 100.0
            assert np.abs(sensor.force).max() <= 2000.0
        assert contents.found()
    assert len(refused) < 0.7 * count
    assert all(len(text) > 20 for text in refused)


def test_damaged_logs(flight: Flight, tmp_path: Path) -> None:
    check_damaged(flight, tmp_path, 20)


@pytest.mark.long
def test_five_hundred_damaged_logs(flight: Flight, tmp_path: Path) -> None:
    check_damaged(flight, tmp_path, 500)


def test_a_real_flight_through_an_autopilots_log(shared: Path, tmp_path: Path) -> None:
    """The samples and fixes of a real aircraft, written as DataFlash messages, come back to the log's digits."""
    folder = shared / "data/fw_thor75"
    samples = read_imu(folder / "imu.csv.gz")[0].between(240.0, 300.0)
    fixes, _ = read_fixes(folder / "gnss.csv")
    keep = (fixes.time > 240.0) & (fixes.time < 300.0)
    fixes = Fixes(fixes.time[keep], fixes.llh[keep], fixes.velocity[keep])
    logs.write_dataflash(tmp_path / "log.bin", logs.dataflash_of(samples, fixes, {}))
    said = imported(tmp_path / "log.bin", "-o", tmp_path / "out").stdout
    assert "lever_arm_m: not in the log" in said
    back = read_imu(tmp_path / "out/imu.csv")[0]
    np.testing.assert_allclose(back.time, samples.time, atol=1e-6)
    np.testing.assert_allclose(back.rate, samples.rate, atol=1e-6)
    again = read_fixes(tmp_path / "out/gnss.csv")[0]
    assert np.abs(ecef_from_llh(again.llh) - ecef_from_llh(fixes.llh)).max() < 0.02


def test_real_ranges_through_an_autopilots_log(shared: Path, tmp_path: Path) -> None:
    """The ranges of real beacons, as the EKF logs them, become the table of the original to the log's centimetres."""
    with gzip.open(shared / "data/uwb_yard/ranges.csv.gz", "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True, max_rows=2000)
    rows = [
        [round(1e6 * r["t_s"]), 0, int(r["anchor"]), r["range_m"], 0.0, 0.1, 0.0, r["anchor_y_m"], r["anchor_x_m"],
         -r["anchor_z_m"]]
        for r in table
    ]  # fmt: skip
    logs.write_dataflash(tmp_path / "log.bin", {"XKF0": rows})
    said = imported(tmp_path / "log.bin", "-o", tmp_path / "out").stdout
    assert "lever_arm_m" not in said
    found = np.genfromtxt(tmp_path / "out/ranges.csv", delimiter=",", names=True)
    np.testing.assert_allclose(found["t_s"], table["t_s"], atol=1e-6)
    np.testing.assert_array_equal(found["source"], table["anchor"])
    np.testing.assert_allclose(found["range_m"], table["range_m"], atol=0.006)
    section, _ = read_any(tmp_path / "out/ranges.yaml")
    assert {one.name: one.position_m for one in section.sources.positions}["12"] == (0.69, 0.87, 0.5)
