"""The usual mistakes of recorded flights, made on purpose: what a log would hold if it were written otherwise than it
is read, and what has to be written into LOG.yaml then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.formats.recorded_data import Fixes, Samples

Recording = tuple[Samples, Fixes]


@dataclass(frozen=True)
class Made:
    """A mistake: what it does to a recording, the remedy that is due, and what a flight must have to show it: `turns`,
    `rolls`, `sideways` specific force, `climbs`, `velocities`, `vertical` ones."""

    name: str
    make: Callable[[Samples, Fixes], Recording]
    remedy: dict[str, Any]
    needs: frozenset[str] = frozenset()


def _imu(
    rate: Callable[[Any], Any] = lambda w: w, force: Callable[[Any], Any] = lambda f: f
) -> Callable[..., Recording]:
    return lambda s, g: (Samples(s.time, rate(s.rate), force(s.force)), g)


def _velocity(change: Callable[[Any], Any]) -> Callable[..., Recording]:
    return lambda s, g: (s, replace(g, velocity=change(g.velocity)))


def _place(change: Callable[[Any], Any]) -> Callable[..., Recording]:
    return lambda s, g: (s, replace(g, llh=change(g.llh)))


def _times(imu: float = 1.0, gnss: float = 1.0, shift: float = 0.0) -> Callable[..., Recording]:
    return lambda s, g: (replace(s, time=imu * s.time), replace(g, time=gnss * g.time + shift))


def _increments(s: Samples, g: Fixes) -> Recording:
    step = float(np.median(np.diff(s.time)))
    return Samples(s.time, step * s.rate, step * s.force), g


def needs(*words: str) -> frozenset[str]:
    return frozenset(words)


G = 9.80665
FEET = 0.3048
X, Y, Z = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, 1.0]), np.array([1.0, 1.0, -1.0])
XY, XZ, YZ = [1, 0, 2], [2, 1, 0], [0, 2, 1]
FLU = np.array([1.0, -1.0, -1.0])


def _rfu(v: Any) -> Any:
    return v[:, [1, 0, 2]] * [1.0, 1.0, -1.0]


MISTAKES = [
    Made("FLU for FRD", _imu(lambda w: w * FLU, lambda f: f * FLU), {"imu.axes": "FLU"}, needs("turns")),
    Made("RFU for FRD", _imu(_rfu, _rfu), {"imu.axes": "RFU"}, needs("turns")),
    Made("mounted backwards", _imu(lambda w: w * X * Y, lambda f: f * X * Y), {"imu.axes": "BLD"}, needs("turns")),
    Made("gyro in deg/s", _imu(np.degrees), {"imu.gyro_unit": "deg/s"}, needs("turns")),
    Made("gyro in deg/h", _imu(lambda w: 3600.0 * np.degrees(w)), {"imu.gyro_unit": "deg/h"}, needs("turns")),
    Made("accelerometer in g", _imu(force=lambda f: f / G), {"imu.accelerometer_unit": "g"}),
    Made("accelerometer in mg", _imu(force=lambda f: 1e3 * f / G), {"imu.accelerometer_unit": "mg"}),
    Made("accelerometer in ft/s2", _imu(force=lambda f: f / FEET), {"imu.accelerometer_unit": "ft/s2"}),
    Made("increments for rates", _increments, {"imu.samples": "increments"}),
    Made("accelerometer's sign", _imu(force=lambda f: -f), {"imu.accelerometer_axes": "BLU"}, needs("turns")),
    Made("gyro's sign", _imu(lambda w: -w), {"imu.gyro_axes": "BLU"}, needs("turns")),
    Made("gyro x negated", _imu(lambda w: w * X), {"imu.gyro_axes": "BRD"}, needs("turns", "rolls")),
    Made("gyro y negated", _imu(lambda w: w * Y), {"imu.gyro_axes": "FLD"}, needs("turns", "rolls")),
    Made("gyro z negated", _imu(lambda w: w * Z), {"imu.gyro_axes": "FRU"}, needs("turns")),
    Made("accelerometer x negated", _imu(force=lambda f: f * X), {"imu.accelerometer_axes": "BRD"}, needs("turns")),
    Made("accelerometer y negated", _imu(force=lambda f: f * Y), {"imu.accelerometer_axes": "FLD"}, needs("sideways")),
    Made("accelerometer z negated", _imu(force=lambda f: f * Z), {"imu.accelerometer_axes": "FRU"}, needs("turns")),
    Made("gyro x and y", _imu(lambda w: w[:, XY]), {"imu.gyro_axes": "RFD"}, needs("turns", "rolls")),
    Made("gyro y and z", _imu(lambda w: w[:, YZ]), {"imu.gyro_axes": "FDR"}, needs("turns")),
    Made("accelerometer x and y", _imu(force=lambda f: f[:, XY]), {"imu.accelerometer_axes": "RFD"}, needs("turns")),
    Made("accelerometer x and z", _imu(force=lambda f: f[:, XZ]), {"imu.accelerometer_axes": "DRF"}, needs("turns")),
    Made(
        "gyro and accelerometer",
        lambda s, g: (Samples(s.time, s.force, s.rate), g),
        {
            "imu.columns": {
                "gx_rad_s": "ax_m_s2", "gy_rad_s": "ay_m_s2", "gz_rad_s": "az_m_s2",
                "ax_m_s2": "gx_rad_s", "ay_m_s2": "gy_rad_s", "az_m_s2": "gz_rad_s",
            }
        },
    ),
    Made("radians", _place(lambda p: p * np.radians([1.0, 1.0, 180.0 / np.pi])), {"gnss.angle_unit": "rad"}),
    Made("1e-7 degrees", _place(lambda p: p * [1e7, 1e7, 1.0]), {"gnss.angle_unit": "1e-7 deg"}),
    Made(
        "latitude and longitude",
        _place(lambda p: p[:, [1, 0, 2]]),
        {"gnss.columns": {"lat_deg": "lon_deg", "lon_deg": "lat_deg"}},
    ),
    Made("longitude's sign", _place(lambda p: p * [1, -1, 1]), {"gnss.position_axes": "NW"}, needs("turns")),
    Made("latitude's sign", _place(lambda p: p * [-1, 1, 1]), {"gnss.position_axes": "SE"}, needs("turns")),
    Made(
        "height in feet", _place(lambda p: p / [1.0, 1.0, FEET]), {"gnss.height_unit": "ft"},
        needs("climbs", "vertical"),
    ),
    Made(
        "ENU for NED", _velocity(lambda v: v[:, XY] * Z), {"gnss.velocity_axes": "ENU"},
        needs("velocities", "climbs", "vertical"),
    ),
    Made("vn and ve", _velocity(lambda v: v[:, XY]), {"gnss.velocity_axes": "END"}, needs("velocities")),
    Made("vertical sign", _velocity(lambda v: v * Z), {"gnss.velocity_axes": "NEU"}, needs("climbs", "vertical")),
    Made(
        "vertical velocity in km/h", _velocity(lambda v: v * [1.0, 1.0, 3.6]), {"gnss.vertical_speed_unit": "km/h"},
        needs("climbs", "vertical"),
    ),
    Made(
        "vertical velocity in ft/min", _velocity(lambda v: v * [1.0, 1.0, 60.0 / FEET]),
        {"gnss.vertical_speed_unit": "ft/min"}, needs("climbs", "vertical"),
    ),
    Made(
        "climb in ft/min", _velocity(lambda v: v * [1.0, 1.0, -60.0 / FEET]),
        {"gnss.velocity_axes": "NEU", "gnss.vertical_speed_unit": "ft/min"}, needs("climbs", "vertical"),
    ),
    Made("speed in km/h", _velocity(lambda v: 3.6 * v), {"gnss.speed_unit": "km/h"}, needs("velocities")),
    Made("speed in knots", _velocity(lambda v: v * 3600.0 / 1852.0), {"gnss.speed_unit": "kn"}, needs("velocities")),
    Made("speed in cm/s", _velocity(lambda v: 100.0 * v), {"gnss.speed_unit": "cm/s"}, needs("velocities")),
    Made("samples' time in ms", _times(imu=1e3), {"imu.time_unit": "ms"}),
    Made("samples' time in us", _times(imu=1e6), {"imu.time_unit": "us"}),
    Made("fixes' time in ms", _times(gnss=1e3), {"gnss.time_unit": "ms"}),
    Made("GPS time for UTC", _times(shift=18.0), {"gnss.time_offset_s": -18.0}, needs("turns")),
    Made("UTC for GPS time", _times(shift=-18.0), {"gnss.time_offset_s": 18.0}, needs("turns")),
    Made("five seconds late", _times(shift=5.0), {"gnss.time_offset_s": -5.0}, needs("turns")),
    Made("a second early", _times(shift=-1.0), {"gnss.time_offset_s": 1.0}, needs("turns")),
    Made("left-handed axes", _imu(lambda w: w * Y, lambda f: f * Y), {"imu.axes": "FLD"}, needs("turns")),
    Made(
        "heights and climbs in feet",
        lambda s, g: (s, replace(g, llh=g.llh / [1.0, 1.0, FEET], velocity=g.velocity / [1.0, 1.0, FEET])),
        {"gnss.height_unit": "ft", "gnss.vertical_speed_unit": "ft/s"}, needs("climbs", "vertical"),
    ),
]  # fmt: skip
