"""A simulated run as MAVLink 2 messages: a telemetry log (`.tlog`), or datagrams in real time.

| message | contents |
|---|---|
| HIL_SENSOR (107) | each IMU sample; readings of magnetometer and barometric altimeter since the last one |
| HIL_GPS (113), GPS_INPUT (232) | each fix of the receiver, when it arrives |
| RANGING_BEACON (513) | each range of a beacon |

Units, scales and marks of unknown values are those of the definitions [1]. `time_usec` is the time of validity, UTC. A
log has before each frame its time of arrival in microseconds, as 8 bytes, most significant first [2].

Sources: [1] `common.xml` and `development.xml` of the MAVLink project, as `pymavlink` contains them. [2]
`pymavlink.mavutil`, `mavlogfile`.
"""

from __future__ import annotations

import ipaddress
import math
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navsim.formats import simulated_log
from navsim.formats.export import lacking, start_of
from navsim.formats.export_maps import undulation_of
from navsim.formats.text import INSTALL_LOGS
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.gnss import timescales
from navsim.results.atomic_write import replacing
from navsim.results.result import Result, ResultError, scenario_of

_SYSTEM, _COMPONENT = 1, 191
"""Of the sender: the vehicle's number, MAV_COMP_ID_ONBOARD_COMPUTER [1]."""
_UNKNOWN_8, _UNKNOWN_16 = 0xFF, 0xFFFF
"""UINT8_MAX, UINT16_MAX: unknown [1]."""
_FIX_3D, _NO_FIX = 3, 1
_IGNORE_SPEED_ACCURACY, _IGNORE_ALL = 32, 255
"""GPS_INPUT_IGNORE_FLAGS [1]."""
_IMU_UPDATED, _MAGNETIC_UPDATED, _PRESSURE_UPDATED = 0b111111, 0b111000000, (1 << 9) | (1 << 11)
"""HIL_SENSOR_UPDATED_FLAGS: acceleration and angular rate; magnetic field; pressure and its altitude [1]."""
_GAUSS = 0.01
"""Gauss in a microtesla."""
_FASTEST = 327.67
"""Fastest velocity that HIL_GPS holds, m/s."""
_WEEK_MS = 604_800_000


@dataclass(frozen=True)
class Message:
    """A MAVLink 2 frame and its time of arrival."""

    seconds: float
    """Since the start of the flight."""
    utc: int
    """Microseconds since 1970."""
    frame: bytes


def assumptions(result: Result) -> list[str]:
    """Values of the messages that the result does not contain, and what they have instead."""
    out = []
    if undulation_of(result) is None:
        text = "altitudes of HIL_GPS and GPS_INPUT (MSL) are heights above the ellipsoid: the scenario has no "
        out.append(text + "runway.geoid_undulation_m")
    return out


def messages(result: Result) -> Iterator[Message]:
    """Messages of the first run of a landing, as they arrive.

    Raises ResultError if the result has no inertial samples and fixes, or pymavlink lacks a message.
    """
    if any(path not in result for path in simulated_log.NEEDED[:2]):
        raise lacking(result, "inertial samples and fixes")
    dialect = _dialect()
    scenario, start = scenario_of(result), start_of(result)
    sender = dialect.MAVLink(None, srcSystem=_SYSTEM, srcComponent=_COMPONENT)
    imu, fixes = _inertial(result, scenario), _fixes(result, scenario)
    streams = [(imu["time"], imu["time"]), (fixes["time"] + scenario["receiver"]["latency_s"], fixes["time"])]
    if "/aiding/beacons/measured" in result:
        if not hasattr(dialect, "MAVLink_ranging_beacon_message"):
            raise ResultError("this pymavlink has no message RANGING_BEACON; 2.4.50 has it")
        ranges = _ranges(result, scenario)
        streams.append((ranges["time"] + scenario["beacons"]["latency_s"], ranges["time"]))
    arrival = np.concatenate([each for each, _ in streams])
    valid = np.concatenate([each for _, each in streams])
    kind = np.repeat(np.arange(len(streams)), [each.size for each, _ in streams])
    row = np.concatenate([np.arange(each.size) for each, _ in streams])
    arrived, stamp = (np.rint(1e6 * timescales.utc_from_gps(start + t)).astype(np.int64) for t in (arrival, valid))
    for i in np.lexsort((kind, arrival)):
        k, when = int(row[i]), int(stamp[i])
        if kind[i] == 0:
            made = [dialect.MAVLink_hil_sensor_message(when, *map(float, imu["values"][k]), int(imu["updated"][k]))]
        elif kind[i] == 1:
            made = [
                dialect.MAVLink_hil_gps_message(when, **_hil_gps(fixes, k)),
                dialect.MAVLink_gps_input_message(when, **_gps_input(fixes, k, start)),
            ]
        else:
            if not math.isfinite(ranges["range"][k]):
                continue  # no answer
            made = [dialect.MAVLink_ranging_beacon_message(when, 0, 0, **_ranging_beacon(ranges, k))]
        for message in made:
            frame = bytes(message.pack(sender))
            sender.seq = (sender.seq + 1) % 256
            yield Message(float(arrival[i]), int(arrived[i]), frame)


def write_log(result: Result, path: Path) -> None:
    """Write a telemetry log. Raises ResultError."""
    try:
        with replacing(path) as temporary, open(temporary, "wb") as file:
            for message in messages(result):
                file.write(struct.pack(">Q", message.utc) + message.frame)
    except OSError as error:
        raise ResultError(f"{path}: cannot be written: {error.strerror or error}") from None


def loopback_address(text: str) -> tuple[str, int]:
    """Host and port of `udp:HOST:PORT`. Raises ValueError unless the host is an IPv4 address of this machine."""
    host, _, port = text.removeprefix("udp:").rpartition(":")
    host = "127.0.0.1" if host == "localhost" else host
    if not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
        raise ValueError(f"'{port[:20]}' is no port; write it as in udp:127.0.0.1:14550")
    try:
        inside = ipaddress.IPv4Address(host).is_loopback
    except ValueError:
        inside = False
    if not inside:
        text = f"'{host[:60]}' is not this machine: navsim sends simulated sensors to 127.0.0.1 alone, since a real "
        raise ValueError(text + "autopilot would take them for its own")
    return host, int(port)


def send(result: Result, address: tuple[str, int], speed: float) -> int:
    """Send each message as a datagram when it arrives, in real time times `speed`; returns their number.

    Raises ResultError, also if the datagrams cannot be sent.
    """
    count, begun = 0, time.monotonic()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            for message in messages(result):
                time.sleep(max(begun + message.seconds / speed - time.monotonic(), 0.0))
                line.sendto(message.frame, address)
                count += 1
    except OSError as error:
        raise ResultError(f"udp:{address[0]}:{address[1]}: cannot send: {error.strerror or error}") from None
    return count


def _dialect() -> Any:
    """The messages of MAVLink 2 with those under development. Raises ResultError."""
    try:
        from pymavlink.dialects.v20 import development
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] != "pymavlink":
            raise
        raise ResultError(f"pymavlink writes these messages, and is not installed here: {INSTALL_LOGS}") from None
    return development


def _inertial(result: Result, scenario: Any) -> dict[str, np.ndarray]:
    """Fields of HIL_SENSOR: time (n,), s; values (n, 13) from xacc to temperature, nan where not updated; updated
    (n,), the flags of the updated fields."""
    instant = result["/imu/time"]
    step = np.diff(instant, prepend=0.0)[:, None]
    values = np.full((instant.size, 13), np.nan)
    values[:, :3] = result["/imu/delta_velocity"][0] / step
    values[:, 3:6] = result["/imu/delta_angle"][0] / step
    updated = np.full(instant.size, _IMU_UPDATED)

    def newest(sensor: str, latency: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows of IMU samples with a new reading by then, and the readings (m, k)."""
        arrival = result[f"/aiding/{sensor}/time"] + latency
        read = result[f"/aiding/{sensor}/measured"][0]
        known = np.isfinite(read).all(axis=1)
        at = np.searchsorted(instant, arrival[known] - 1e-9)
        last = np.flatnonzero(np.diff(at, append=instant.size + 1))
        return at[last], read[known][last]

    if "/aiding/magnetometer/measured" in result:
        at, field = newest("magnetometer", scenario["magnetometer"]["latency_s"])
        to_body = dcm_from_rpy(np.radians(scenario["magnetometer"]["mounting_deg"]))
        values[at, 6:9] = _GAUSS * field @ to_body.T
        updated[at] |= _MAGNETIC_UPDATED
    if "/aiding/barometric_altimeter/measured" in result:
        from navsim.sensors.barometer import HECTOPASCAL, standard_pressure

        at, height = newest("barometric_altimeter", 0.0)
        values[at, 9], values[at, 11] = standard_pressure(height[:, 0]) / HECTOPASCAL, height[:, 0]
        updated[at] |= _PRESSURE_UPDATED
    return {"time": instant, "values": values, "updated": updated}


def _fixes(result: Result, scenario: Any) -> dict[str, np.ndarray]:
    """Fixes of the antenna by epoch: validity, position, velocity, DOPs, 1 sigma, number of satellites."""
    llh, velocity = result["/receiver/position_llh"][0], result["/receiver/velocity_ned"][0]
    speed = float(np.max(np.abs(velocity[np.isfinite(velocity)]), initial=0.0))
    if speed > _FASTEST:
        raise ResultError(f"a fix has a velocity of {speed:.0f} m/s; HIL_GPS holds up to {_FASTEST:g} m/s")
    east, north, up = np.diagonal(result["/receiver/covariance_enu"], axis1=1, axis2=2).T
    own = set(result["/pseudolites/name"].tolist())
    satellite = np.array([name not in own for name in result["/measurements/source"]])
    altitude = llh[:, 2] - (undulation_of(result) or 0.0)  # without one above the ellipsoid, as `assumptions` says
    return {
        "time": result["/geometry/time"], "degrees": np.degrees(llh[:, :2]), "altitude": altitude,
        "velocity": velocity, "hdop": result["/geometry/hdop"], "vdop": result["/geometry/vdop"],
        "horizontal": np.sqrt(0.5 * (east + north)), "vertical": np.sqrt(up),
        "satellites": np.isfinite(result["/measurements/pseudorange"][0][:, satellite]).sum(axis=1),
    }  # fmt: skip


def _hil_gps(fixes: dict[str, np.ndarray], k: int) -> dict[str, int]:
    """Fields of HIL_GPS but the time."""
    satellites = min(int(fixes["satellites"][k]), _UNKNOWN_8 - 1)
    known, moves = math.isfinite(fixes["altitude"][k]), bool(np.isfinite(fixes["velocity"][k]).all())
    lat, lon = fixes["degrees"][k] if known else (0.0, 0.0)
    vn, ve, vd = fixes["velocity"][k] if moves else (0.0, 0.0, 0.0)
    course = round(100.0 * math.degrees(math.atan2(ve, vn))) % 36000
    return {
        "fix_type": _FIX_3D if known else _NO_FIX,
        "lat": round(1e7 * lat), "lon": round(1e7 * lon),
        "alt": round(1e3 * fixes["altitude"][k]) if known else 0,
        "eph": _hundredths(fixes["hdop"][k]), "epv": _hundredths(fixes["vdop"][k]),
        "vel": _hundredths(math.hypot(vn, ve)) if moves else _UNKNOWN_16,
        "vn": round(100.0 * vn), "ve": round(100.0 * ve), "vd": round(100.0 * vd),
        "cog": course if moves else _UNKNOWN_16, "satellites_visible": satellites,
    }  # fmt: skip


def _hundredths(value: float) -> int:
    """A value in hundredths as 16 bits hold it; unknown if nan or beyond."""
    return round(100.0 * value) if math.isfinite(value) and round(100.0 * value) < _UNKNOWN_16 else _UNKNOWN_16


def _gps_input(fixes: dict[str, np.ndarray], k: int, start: float) -> dict[str, float]:
    """Fields of GPS_INPUT but the time. The receiver reports no accuracy of its speed."""
    satellites = min(int(fixes["satellites"][k]), _UNKNOWN_8)
    week, of_week = divmod(round(1e3 * (start + float(fixes["time"][k]))), _WEEK_MS)
    when = {"gps_id": 0, "time_week_ms": of_week, "time_week": week, "satellites_visible": satellites}
    numbers = ("altitude", "hdop", "vdop", "horizontal", "vertical")
    alt, hdop, vdop, horizontal, vertical = (float(fixes[name][k]) for name in numbers)
    if not math.isfinite(alt):
        nothing = dict.fromkeys(("lat", "lon", "alt", "vn", "ve", "vd", "speed_accuracy", "horiz_accuracy",
                                 "vert_accuracy"), 0)  # fmt: skip
        return {**when, **nothing, "ignore_flags": _IGNORE_ALL, "fix_type": _NO_FIX, "hdop": _UNKNOWN_16,
                "vdop": _UNKNOWN_16}  # fmt: skip
    lat, lon = fixes["degrees"][k]
    moves = bool(np.isfinite(fixes["velocity"][k]).all())
    vn, ve, vd = fixes["velocity"][k].tolist() if moves else (0.0, 0.0, 0.0)
    return {
        **when, "ignore_flags": _IGNORE_SPEED_ACCURACY | (0 if moves else 8 | 16), "fix_type": _FIX_3D,
        "lat": round(1e7 * lat), "lon": round(1e7 * lon), "alt": alt, "hdop": hdop, "vdop": vdop,
        "vn": vn, "ve": ve, "vd": vd, "speed_accuracy": 0.0, "horiz_accuracy": horizontal, "vert_accuracy": vertical,
    }  # fmt: skip


def _ranges(result: Result, scenario: Any) -> dict[str, Any]:
    """Ranges (m,) of the beacons asked in turn, nan without an answer, and what their messages say of the beacons."""
    its = scenario["beacons"]
    if its.get("clock") is not None:
        raise ResultError("beacons.clock makes one-way ranges, and RANGING_BEACON is of two-way ones")
    if "/aiding/beacons/sigma" not in result:
        raise ResultError("the result is of an earlier version, without the noise of its ranges: run it again")
    return {
        "time": result["/aiding/beacons/time"], "range": result["/aiding/beacons/measured"][0, :, 0],
        "llh": result["/beacons/position_llh"], "sigma": result["/aiding/beacons/sigma"][:, 0],
        "survey": its["survey_sigma_m"], "carrier": its.get("carrier_mhz"),
    }  # fmt: skip


def _ranging_beacon(ranges: dict[str, Any], k: int) -> dict[str, float]:
    """Fields of RANGING_BEACON but the time and the receiver of the message. The number of the question is its
    sequence: a lost answer leaves a gap."""
    beacon = k % len(ranges["llh"])
    lat, lon, height = ranges["llh"][beacon]
    survey = round(1e3 * ranges["survey"])
    return {
        "beacon_id": beacon + 1, "range": round(1e3 * max(float(ranges["range"][k]), 0.0)),
        "lat": round(1e7 * math.degrees(lat)), "lon": round(1e7 * math.degrees(lon)), "alt": float(height),
        "alt_type": 0, "hacc_est": survey, "vacc_est": survey,
        "carrier_freq": 0 if ranges["carrier"] is None else round(ranges["carrier"]),
        "range_accuracy": round(1e3 * float(ranges["sigma"][k])), "sequence": k % 256, "status": 0,
    }  # fmt: skip
