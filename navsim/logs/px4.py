"""PX4 logs (`.ulg`), by the `pyulog` package.

Samples are in body axes: the autopilot has applied the board's orientation. Source: [1] PX4, "uORB Message Reference":
SensorCombined, VehicleImu, SensorGps, VehicleAttitude, VehicleAirData, DistanceSensor, VehicleMagnetometer, Airspeed,
RangingBeacon.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navsim.geodesy.attitude import dcm_from_rpy
from navsim.gnss.timescales import gps_from_utc
from navsim.logs.contents import (
    BODY_AXES,
    FixRecord,
    ImuRecord,
    LogContents,
    RangeRecord,
    Topic,
    foreign_reader,
    interpolated,
    lever_parameters,
    numbers,
    quaternion_angles,
)

TITLE = "a PX4 log"
GIVES = "all IMUs and receivers with accuracies, barometer, range finder, magnetometer, airspeed, beacons, attitude"
_HEAD = b"ULog\x01\x12\x35"
TOPICS = (
    Topic("vehicle_air_data", "barometer", {
        "pressure_pa": ("baro_pressure_pa", 1.0), "height_m": ("baro_alt_meter", 1.0),
        "temperature_c": ("baro_temp_celcius", 1.0),
    }),
    Topic("distance_sensor", "rangefinder", {"distance_m": ("current_distance", 1.0)}),
    Topic("vehicle_magnetometer", "magnetometer", {
        f"m{axis}_ut": (f"magnetometer_ga[{i}]", 100.0) for i, axis in enumerate("xyz")
    }),
    Topic("airspeed", "airspeed", {
        "airspeed_m_s": ("true_airspeed_m_s", 1.0), "indicated_m_s": ("indicated_airspeed_m_s", 1.0),
    }),
)  # fmt: skip
"""Topics that become tables [1]; magnetometers have gauss."""
_RECEIVERS = ("sensor_gps", "vehicle_gps_position")
"""Topics of fixes, by preference: the second is blended from all receivers."""
_IMUS = ("sensor_combined", "vehicle_imu")
_USUAL_DELAY_MS = 110.0
"""Default of EKF2_GPS_DELAY."""
_INVALID = 0x7FFFFFFF
"""Relative time of an accelerometer sample that is not new."""
_FIX_3D = 3
_RAW = ("sensor_gyro", "sensor_accel")
"""Samples before the board's orientation, for logs that have no others of a useful rate."""
_OTHERS = ("sensor_gyro_fifo", "sensor_accel_fifo")
"""Topics with measurements that navsim does not take."""
_ORIENTATIONS = (
    *((0, 0, yaw) for yaw in range(0, 360, 45)),
    *((180, 0, yaw) for yaw in range(0, 180, 45)), (0, 180, 0), *((180, 0, yaw) for yaw in range(225, 360, 45)),
    *((90, 0, yaw) for yaw in range(0, 180, 45)), *((270, 0, yaw) for yaw in range(0, 180, 45)),
    (0, 90, 0), (0, 270, 0), (0, 180, 90), (0, 180, 270), (90, 90, 0), (180, 90, 0), (270, 90, 0), (90, 180, 0),
    (270, 180, 0), (90, 270, 0), (180, 270, 0), (270, 270, 0), (90, 180, 90), (90, 0, 270),
)  # fmt: skip
"""Roll, pitch, yaw, deg, from the board to the body, by the number of SENS_BOARD_ROT."""
_WANTED = [
    *_IMUS, *_RAW, *_RECEIVERS, *(topic.message for topic in TOPICS), "vehicle_attitude", "ranging_beacon",
]  # fmt: skip


def matches(head: bytes, path: Path) -> bool:
    """Whether a file begins as such a log does."""
    return head.startswith(_HEAD)


def read(path: Path) -> LogContents:
    """Read a log. Raises FileError, OSError."""
    with foreign_reader(path, "pyulog"):
        from pyulog import ULog

        log = ULog(str(path), _WANTED)
        contents = _contents(log)
    if log.file_corruption:
        contents.left_out.append("damaged places of the log, as pyulog reports them")
    return contents


def _contents(log: Any) -> LogContents:
    out = LogContents(TITLE)
    parameters = {str(key): value for key, value in log.initial_parameters.items()}
    topics: dict[str, list[tuple[int, dict[str, np.ndarray]]]] = {}
    for data in log.data_list:
        topics.setdefault(data.name, []).append((data.multi_id, data.data))
    place = lever_parameters(parameters, ("EKF2_IMU_POS",))
    for number, found in topics.get("sensor_combined", []):
        _add_combined(out, number, found, place)
    for number, found in topics.get("vehicle_imu", []):
        _add_increments(out, number, found, place)
    receivers = next((topics[name] for name in _RECEIVERS if name in topics), [])
    for number, found in receivers:
        _add_receiver(out, number, found, parameters, log)
    if all(name in topics for name in _RECEIVERS):
        out.left_out.append("vehicle_gps_position: blended from the receivers, which are taken one by one")
    for topic in TOPICS:
        parts = [
            topic.rows(_seconds(found), found, np.full(found["timestamp"].size, number))
            for number, found in topics.get(topic.message, [])
        ]
        if parts := [part for part in parts if part]:
            out.add_table(topic.table, {key: np.concatenate([part[key] for part in parts]) for key in parts[0]})
    for _, found in topics.get("vehicle_attitude", [])[:1]:
        q = numbers(found, *(f"q[{i}]" for i in range(4)))
        if q is not None:
            out.add_table("attitude", {"t_s": _seconds(found), **quaternion_angles(q)})
    out.add_magnetic_heading()
    for _, found in topics.get("ranging_beacon", [])[:1]:
        out.ranges = _ranges(found)
    there = "SENS_BOARD_ROT" in parameters
    usual = log.get_default_parameters(0).get("SENS_BOARD_ROT", 0)
    turned = int(parameters.get("SENS_BOARD_ROT", usual))
    known = f"SENS_BOARD_ROT {'is' if there else 'is not in the log; its default is'} {turned}"
    if out.imus or there:
        out.imu_keys += BODY_AXES
    if not out.imus:
        _add_raw(out, topics.get("sensor_gyro", []), topics.get("sensor_accel", []), turned, known, place)
    else:
        out.left_out += [f"{name}: raw samples of the board's axes" for name in _RAW if name in topics]
        out.decided.append(f"axes forward-right-down: the autopilot has applied the board's orientation ({known})")
    out.left_out += [f"{name}: raw samples" for name in _OTHERS if name in log.message_formats]
    return out


def _seconds(found: Mapping[str, np.ndarray]) -> np.ndarray:
    """Times of measurement, else of the messages."""
    stamp = found["timestamp"].astype(float)
    sample = found.get("timestamp_sample")
    if sample is not None and np.all(sample > 0) and np.all(sample <= found["timestamp"]):
        stamp = sample.astype(float)
    return 1e-6 * stamp


def _add_combined(out: LogContents, number: int, found: dict[str, np.ndarray], place: Any) -> None:
    rate = numbers(found, *(f"gyro_rad[{i}]" for i in range(3)))
    force = numbers(found, *(f"accelerometer_m_s2[{i}]" for i in range(3)))
    if rate is None or force is None:
        out.left_out.append("sensor_combined: it lacks fields of the gyros or accelerometers")
        return
    time = 1e-6 * found["timestamp"].astype(float)
    shift = found.get("accelerometer_timestamp_relative")
    if shift is not None:
        new = shift < _INVALID
        if new.sum() > 1 and np.any(shift[new] != 0):
            force = interpolated(time, time[new] + 1e-6 * shift[new], force[new])
            out.decided.append("sensor_combined: specific force interpolated to the times of the gyros")
    out.add_imu(ImuRecord(_numbered("sensor_combined", number), time, rate, force, "averaged", place))


def _add_increments(out: LogContents, number: int, found: dict[str, np.ndarray], place: Any) -> None:
    name = f"vehicle_imu {number}"
    turn = numbers(found, *(f"delta_angle[{i}]" for i in range(3)))
    speed = numbers(found, *(f"delta_velocity[{i}]" for i in range(3)))
    over = [found.get(key) for key in ("delta_angle_dt", "delta_velocity_dt")]
    if turn is None or speed is None or over[0] is None or over[1] is None:
        out.left_out.append(f"{name}: it lacks increments or their intervals")
        return
    span = [1e-6 * np.where(each > 0, each, np.nan).astype(float)[:, None] for each in over if each is not None]
    out.add_imu(ImuRecord(name, _seconds(found), turn / span[0], speed / span[1], "averaged", place))


def _add_raw(out: LogContents, gyros: Any, accelerometers: Any, turned: int, known: str, place: Any) -> None:
    """Take raw samples, turned into body axes: gyros and accelerometers of the same number belong together.

    turned: orientation of the board by its number, `known` in words."""
    if not gyros or not accelerometers:
        return
    if not 0 <= turned < len(_ORIENTATIONS):
        out.left_out.append(f"sensor_gyro, sensor_accel: navsim does not know the orientation SENS_BOARD_ROT {turned}")
        return
    matrix = dcm_from_rpy(np.radians(_ORIENTATIONS[turned]))
    for (number, gyro), (_, accelerometer) in zip(gyros, accelerometers, strict=False):
        rate, force = numbers(gyro, "x", "y", "z"), numbers(accelerometer, "x", "y", "z")
        if rate is None or force is None:
            continue
        time = _seconds(gyro)
        force = interpolated(time, _seconds(accelerometer), force)
        out.add_imu(ImuRecord(f"sensor_gyro {number}", time, rate @ matrix.T, force @ matrix.T, "instantaneous", place))
    out.decided.append(
        f"samples of sensor_gyro and sensor_accel, the log has no faster ones; turned by SENS_BOARD_ROT {turned} "
        f"({known}), and specific force interpolated to the times of the gyros"
    )


def _numbered(name: str, number: int) -> str:
    return name if number == 0 else f"{name} {number}"


def _add_receiver(
    out: LogContents, number: int, found: dict[str, np.ndarray], parameters: Mapping[str, float], log: Any
) -> None:
    name = f"GPS {number}"
    llh = numbers(found, "latitude_deg", "longitude_deg", "altitude_ellipsoid_m")
    above_sea = found.get("altitude_msl_m")
    if llh is None:
        whole = numbers(found, "lat", "lon", "alt_ellipsoid")
        llh = None if whole is None else whole * (1e-7, 1e-7, 1e-3)
        above_sea = None if "alt" not in found else 1e-3 * found["alt"]
    if llh is None or "fix_type" not in found:
        out.left_out.append(f"{name}: its messages lack fields of the position")
        return
    at_sea_level = above_sea is not None and not np.any(llh[:, 2])
    if at_sea_level:
        llh[:, 2] = above_sea
    fix = found["fix_type"] >= _FIX_3D
    velocity = numbers(found, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
    if velocity is None:
        velocity = np.full((fix.size, 3), np.nan)
    elif "vel_ned_valid" in found:
        velocity[found["vel_ned_valid"] == 0] = np.nan
    further = {"quality": found["fix_type"].astype(float)}
    for column, field in (
        ("nsat", "satellites_used"), ("sigma_horizontal_m", "eph"), ("sigma_vertical_m", "epv"),
        ("sigma_speed_m_s", "s_variance_m_s"),
    ):  # fmt: skip
        if field in found:
            value = found[field].astype(float)
            further[column] = value if column == "nsat" else np.where(value > 0.0, value, np.nan)
    time = _seconds(found)
    utc = found.get("time_utc_usec")
    if out.start is None and utc is not None and (fix & (utc > 0)).any():
        posix = 1e-6 * utc[fix & (utc > 0)].astype(float)
        out.start = round(float(np.median(gps_from_utc(posix) - time[fix & (utc > 0)])), 3)
    if "heading" in found:
        sigma = found.get("heading_accuracy")
        out.add_antenna_heading(time, np.degrees(found["heading"]), None if sigma is None else np.degrees(sigma))
    delay, remark = _delay(parameters, log)
    place = lever_parameters(parameters, ("EKF2_GPS_POS",))
    if out.add_receiver(FixRecord(name, time, llh, velocity, further, place, delay, remark), fix) and at_sea_level:
        out.decided.append(f"heights of {name} above mean sea level used as ellipsoidal ones: the log has no others")


def _delay(parameters: Mapping[str, float], log: Any) -> tuple[float | None, str]:
    """Latency by EKF2_GPS_DELAY in s, and a remark where it is not used; a default is nobody's knowledge."""
    delay = parameters.get("EKF2_GPS_DELAY")
    if delay is None:
        return None, ""
    usual = log.get_default_parameters(0).get("EKF2_GPS_DELAY", _USUAL_DELAY_MS)
    if abs(delay - usual) < 1e-6:
        return None, f"EKF2_GPS_DELAY has its default, {delay:g} ms"
    return 1e-3 * float(delay), ""


def _ranges(found: Mapping[str, np.ndarray]) -> RangeRecord | None:
    place = numbers(found, "lat", "lon", "alt_ellipsoid" if "alt_ellipsoid" in found else "alt")
    if place is None or "range" not in found or "beacon_id" not in found:
        return None
    beacon = found["beacon_id"].astype(str)
    unknown = np.full(beacon.size, np.nan)
    sigma = found.get("range_accuracy", unknown).astype(float)
    signal = found.get("rssi_node", unknown).astype(float)
    positions = {}
    for name in np.unique(beacon):
        lat, lon, height = np.median(place[beacon == name], axis=0)
        positions[str(name)] = (float(lat), float(lon), float(height))
    time = _seconds(found)
    return RangeRecord(time, beacon, found["range"].astype(float), np.where(sigma > 0.0, sigma, np.nan),
                       np.where(signal == 0.0, np.nan, signal), positions, True)  # fmt: skip
