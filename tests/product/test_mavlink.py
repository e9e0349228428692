"""MAVLink logs and datagrams, and motion files of signal simulators, read back by other code."""

from __future__ import annotations

import csv
import datetime
import socket
import struct
import threading
import tracemalloc
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
import typer
from pymavlink import mavutil
from pymavlink.dialects.v20 import development

from navsim.cli.results import ExportFormats, _destination
from navsim.formats import mavlink
from navsim.formats.export import export
from navsim.landing import study as landing
from navsim.results.result import Result, ResultError
from navsim.runner.executor import threads
from tests.consistency.test_beacons import ERRORS, beacons
from tests.helpers import case

EPOCH = datetime.datetime(2018, 9, 13, 12, tzinfo=datetime.UTC).timestamp()
KEYS = (
    "epoch=2018-09-13T12:00:00Z", "duration_s=40", "imu.rate_hz=250", "receiver={rate_hz: 4, lever_arm_m: [3, 0, -2]}",
    "receiver.latency_s=0.1", "filter.kind=eskf", "runway.geoid_undulation_m=14",
    beacons(*ERRORS, "loss: 0.2", "latency_s: 0.05", "carrier_mhz: 868"),
    "magnetometer={noise_ut: 0.1, hard_iron_ut: 1, mounting_deg: [0, 0, 90], declination_deg: 5, dip_deg: 70, "
    "intensity_ut: 50}",
    "barometric_altimeter={rate_hz: 5, sigma_m: 0.5, qnh_sigma_hpa: 1}",
    "events=[{what: silence, sources: [all], at_s: 30}]",
)  # fmt: skip


@pytest.fixture(scope="module")
def flown() -> Result:
    c = case(*KEYS)
    return landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all")


@pytest.fixture(scope="module")
def log(flown: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mavlink") / "flight.tlog"
    mavlink.write_log(flown, path)
    return path


@pytest.fixture(scope="module")
def read(log: Path) -> dict[str, dict[str, np.ndarray]]:
    """Fields of each message as pymavlink reads the log."""
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    mavutil.set_dialect("development")
    reader = mavutil.mavlink_connection(str(log))
    while (message := reader.recv_msg()) is not None:
        rows[message.get_type()].append(message.to_dict() | {"arrived": message._timestamp})
    return {name: {key: np.array([row[key] for row in each]) for key in each[0]} for name, each in rows.items()}


def test_a_log_has_all_messages_in_sequence(log: Path, read: dict[str, dict[str, np.ndarray]], flown: Result) -> None:
    """Frame by frame: time, version, sequence, checksum."""
    answered = int(np.isfinite(flown["/aiding/beacons/measured"]).sum())
    numbers = {name: each["time_usec"].size for name, each in read.items()}
    assert numbers == {"HIL_SENSOR": 10000, "HIL_GPS": 159, "GPS_INPUT": 159, "RANGING_BEACON": answered}
    assert 0.7 < answered / flown["/aiding/beacons/time"].size < 0.9
    content, at, count, before = log.read_bytes(), 0, 0, 0
    parser = development.MAVLink(None)
    while at < len(content):
        when, magic, length, _, _, sequence = struct.unpack_from(">QBBBBB", content, at)
        frame = content[at + 8 : at + 8 + 12 + length]
        assert (magic, sequence) == (0xFD, count % 256)
        assert parser.decode(bytearray(frame)) is not None  # raises for a wrong checksum
        assert when >= before
        at, count, before = at + 8 + len(frame), count + 1, when
    assert count == sum(numbers.values())
    assert count > 10_000


def test_inertial_samples_field_and_pressure(read: dict[str, dict[str, np.ndarray]], flown: Result) -> None:
    sent = read["HIL_SENSOR"]
    np.testing.assert_array_equal(sent["time_usec"], np.rint(1e6 * (EPOCH + flown["/imu/time"])))
    step = np.diff(flown["/imu/time"], prepend=0.0)[:, None]
    for names, of in (("xacc yacc zacc", "velocity"), ("xgyro ygyro zgyro", "angle")):
        got = np.stack([sent[name] for name in names.split()], axis=1)
        np.testing.assert_allclose(got, flown[f"/imu/delta_{of}"][0] / step, rtol=6e-8, atol=1e-12)
    turned = (sent["fields_updated"] & 0b111000000) > 0
    field = np.stack([sent[f"{axis}mag"] for axis in "xyz"], axis=1)[turned]
    x, y, z = flown["/aiding/magnetometer/measured"][0].T  # x of the sensor points right
    np.testing.assert_allclose(field, 0.01 * np.stack([-y, x, z], axis=1), rtol=1e-6, atol=1e-9)
    assert np.isnan(sent["xmag"][~turned]).all()
    pressed = (sent["fields_updated"] & (1 << 9)) > 0
    height = flown["/aiding/barometric_altimeter/measured"][0, :, 0]
    np.testing.assert_allclose(sent["pressure_alt"][pressed], height, rtol=1e-7)
    standard = 1013.25 * (1.0 - 2.25577e-5 * height) ** 5.25588
    np.testing.assert_allclose(sent["abs_pressure"][pressed], standard, rtol=1e-5)
    assert np.isnan([sent["temperature"], sent["diff_pressure"]]).all()
    assert not (sent["fields_updated"] & ((1 << 10) | (1 << 12))).any()


def test_fixes(read: dict[str, dict[str, np.ndarray]], flown: Result) -> None:
    """Within each field's resolution; heights over the geoid; without a fix marked so."""
    llh, velocity, time = (
        flown["/receiver/position_llh"][0], flown["/receiver/velocity_ned"][0], flown["/geometry/time"],
    )  # fmt: skip
    known = np.isfinite(llh[:, 0])
    assert 0 < known.sum() < known.size
    gps, hil = read["GPS_INPUT"], read["HIL_GPS"]
    for sent in (gps, hil):
        np.testing.assert_array_equal(sent["time_usec"], np.rint(1e6 * (EPOCH + time)))
        np.testing.assert_allclose(sent["arrived"] - EPOCH, time + 0.1, atol=1e-6)
        np.testing.assert_array_equal(sent["fix_type"], np.where(known, 3, 1))
        where = np.stack([sent["lat"], sent["lon"]], axis=1)[known] * 1e-7
        np.testing.assert_allclose(where, np.degrees(llh[known, :2]), rtol=0, atol=0.51e-7)
    np.testing.assert_allclose(1e-3 * hil["alt"][known], llh[known, 2] - 14.0, rtol=0, atol=0.51e-3)
    np.testing.assert_allclose(gps["alt"][known], llh[known, 2] - 14.0, rtol=1e-7)
    for axis, name in enumerate(("vn", "ve", "vd")):
        np.testing.assert_allclose(0.01 * hil[name][known], velocity[known, axis], rtol=0, atol=0.0051)
        np.testing.assert_allclose(gps[name][known], velocity[known, axis], rtol=1e-7, atol=1e-9)
    course = np.degrees(np.arctan2(velocity[known, 1], velocity[known, 0])) % 360.0
    np.testing.assert_allclose(0.01 * hil["cog"][known], course, rtol=0, atol=0.0051)
    np.testing.assert_allclose(0.01 * hil["eph"][known], flown["/geometry/hdop"][known], rtol=0, atol=0.0051)
    gone = ~known
    for name in ("eph", "epv", "vel", "cog"):
        assert (hil[name][gone] == 65535).all()
    assert (gps["ignore_flags"][gone] == 255).all()
    assert (gps["ignore_flags"][known] == 32).all()  # no accuracy of the speed
    np.testing.assert_array_equal(gps["time_week"], 2018)
    np.testing.assert_array_equal(gps["time_week_ms"], np.rint(1e3 * (4 * 86400 + 43200 + 18 + time)))
    satellite = [name[:2] != "PL" for name in flown["/measurements/source"]]
    in_view = np.isfinite(flown["/measurements/pseudorange"][0][:, satellite]).sum(axis=1)
    np.testing.assert_array_equal(gps["satellites_visible"], in_view)


def test_ranges_of_beacons(read: dict[str, dict[str, np.ndarray]], flown: Result) -> None:
    sent, measured = read["RANGING_BEACON"], flown["/aiding/beacons/measured"][0, :, 0]
    question = np.flatnonzero(np.isfinite(measured))
    np.testing.assert_array_equal(sent["beacon_id"], question % 4 + 1)
    np.testing.assert_array_equal(sent["sequence"], question % 256)
    np.testing.assert_allclose(1e-3 * sent["range"], measured[question], rtol=0, atol=0.51e-3)
    np.testing.assert_allclose(
        sent["time_usec"] * 1e-6 - EPOCH, flown["/aiding/beacons/time"][question], rtol=0, atol=1e-6
    )
    llh = flown["/beacons/position_llh"][question % 4]
    np.testing.assert_allclose(sent["lat"] * 1e-7, np.degrees(llh[:, 0]), rtol=0, atol=0.51e-7)
    np.testing.assert_allclose(sent["alt"], llh[:, 2], rtol=1e-7, atol=1e-6)
    sigma = flown["/aiding/beacons/sigma"][question, 0]  # of the range without its errors, up to 1.5 m
    np.testing.assert_allclose(sigma, np.hypot(0.1, 0.2 / 3000.0 * measured[question]), rtol=0, atol=1e-4)
    np.testing.assert_allclose(1e-3 * sent["range_accuracy"], sigma, rtol=0, atol=0.51e-3)
    assert (sent["hacc_est"] == 200).all()
    assert (sent["carrier_freq"] == 868).all()
    assert not sent["alt_type"].any()  # above the ellipsoid
    earlier = {path: values for path, values in flown.variables.items() if path != "/aiding/beacons/sigma"}
    with pytest.raises(ResultError, match="of an earlier version"):
        next(mavlink.messages(Result(flown.attributes, earlier)))


def test_a_log_takes_little_memory(flown: Result, tmp_path: Path) -> None:
    """The frames go to the file one by one."""
    development  # noqa: B018  # its import is not measured
    tracemalloc.start()
    mavlink.write_log(flown, tmp_path / "flight.tlog")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    arrays = 10_000 * 8 * (13 + 3 + 3 + 8)
    assert most < 2 * arrays


def test_datagrams_keep_the_time(flown: Result) -> None:
    """The flight of 40 s at 20 times its speed, on a free port of this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        line.settimeout(10.0)
        sent: list[int] = []
        sender = threading.Thread(target=lambda: sent.append(mavlink.send(flown, line.getsockname(), 20.0)))
        begun = datetime.datetime.now(datetime.UTC)
        sender.start()
        last, frames = round(1e6 * (EPOCH + 39.95)), [line.recv(300)]
        while int.from_bytes(frames[-1][10:18], "little") < last:
            frames.append(line.recv(300))
        took = (datetime.datetime.now(datetime.UTC) - begun).total_seconds()
        sender.join()
    assert took > 1.9
    assert all(frame[0] == 0xFD for frame in frames)


@pytest.mark.parametrize(
    ("given", "text"),
    [("udp:10.0.0.1:14550", "not this machine"), ("udp:0.0.0.0:14550", "not this machine"),
     ("udp:autopilot.example:14550", "not this machine"), ("udp:127.0.0.1", "no port"),
     ("udp:127.0.0.1:70000", "no port")],
)  # fmt: skip
def test_only_this_machine_gets_datagrams(given: str, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        mavlink.loopback_address(given)
    assert mavlink.loopback_address("udp:localhost:14550") == ("127.0.0.1", 14550)


def test_the_result_is_not_overwritten(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit):
        _destination(ExportFormats(mavlink="r.h5"), Path("r.h5"))
    assert "another name" in capsys.readouterr().err


def test_what_lacks_samples_is_refused() -> None:
    c = case("duration_s=1")
    bare = landing.result(c, landing.fly_all(c, 1, 0, 2, threads(1), keep="errors"), 1, keep="errors")
    with pytest.raises(ResultError, match="a result of kind replay has no inertial samples"):
        next(mavlink.messages(Result({"kind": "replay"}, {})))
    with pytest.raises(ResultError, match="--keep all"):
        next(mavlink.messages(bare))


def test_motion_files(flown: Result, tmp_path: Path) -> None:
    """Each as its program reads it, against the receiver's true antenna, to a millimetre."""
    files = export(flown, tmp_path / "r.h5", ["motion"])
    assert [path.name for path in files] == ["r_ecef.csv", "r_llh.csv", "r_skydel.csv"]
    truth, arm = flown["/truth/time"], (3.0, 0.0, -2.0)
    ten = np.arange(401) * 25
    roll, pitch, yaw = flown["/truth/attitude_rpy"][ten].T
    assert np.allclose(truth[ten], 0.1 * np.arange(401))
    # lever arm to north, east, down: yaw, pitch, roll in turn
    forward = np.cos(pitch) * arm[0] + np.sin(pitch) * np.cos(roll) * arm[2]
    right, down = -np.sin(roll) * arm[2], -np.sin(pitch) * arm[0] + np.cos(pitch) * np.cos(roll) * arm[2]
    north, east = np.cos(yaw) * forward - np.sin(yaw) * right, np.sin(yaw) * forward + np.cos(yaw) * right
    lat, lon, height = flown["/truth/position_llh"][ten].T
    expected = np.stack(pymap3d.ned2ecef(north, east, down, lat, lon, height, deg=False), axis=1)
    ecef, llh = (np.loadtxt(path, delimiter=",") for path in files[:2])
    np.testing.assert_allclose(ecef[:, 0], 0.1 * np.arange(401), atol=1e-9)
    np.testing.assert_allclose(ecef[:, 1:], expected, rtol=0, atol=1e-3)
    there = np.stack(pymap3d.geodetic2ecef(*llh[:, 1:].T), axis=1)
    np.testing.assert_allclose(there, expected, rtol=0, atol=1e-3)
    assert max(map(len, files[0].read_text().splitlines())) < 100  # MAX_CHAR of gps-sdr-sim
    with open(files[2]) as file:
        rows = list(csv.reader(file))[1:]
    times = [datetime.datetime.strptime(row[0], "%d %b %Y %H:%M:%S.%f") for row in rows]
    assert [round((t - times[0]).total_seconds() * 1000) for t in times] == list(range(0, 40001, 100))
    numbers = np.array([row[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(1e3 * numbers[:, :3], expected, rtol=0, atol=1e-3)
    np.testing.assert_allclose(numbers[:, 3], np.degrees(yaw) % 360.0, rtol=0, atol=1e-4)
    np.testing.assert_allclose(numbers[:, 4:], np.degrees(np.stack([pitch, roll], axis=1)), rtol=0, atol=1e-4)
