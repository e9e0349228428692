"""Units and axes of recordings, and their conversion to SI, forward-right-down and north-east-down.

Sources: [1] BIPM, The International System of Units, 9th ed. (2019): standard gravity, knot. [2] NIST Special
Publication 811 (2008), appendix B: foot, mile.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from navsim.geodesy.earth import STANDARD_GRAVITY

IMU_COLUMNS = ("t_s", "gx_rad_s", "gy_rad_s", "gz_rad_s", "ax_m_s2", "ay_m_s2", "az_m_s2")
GNSS_COLUMNS = ("t_s", "lat_deg", "lon_deg", "h_m", "vn_m_s", "ve_m_s", "vd_m_s")
"""Names of the columns of both tables."""
FIX_AXES = ("n", "e", "d", "vn", "ve", "vd")
FIX_SIGMAS = ("sigma_n_m", "sigma_e_m", "sigma_d_m", "sigma_vn_m_s", "sigma_ve_m_s", "sigma_vd_m_s")
"""Names of the columns of 1 sigma of each fix, along north, east, down."""
FIX_CORRELATIONS = tuple(f"corr_{one}_{other}" for one, other in itertools.combinations(FIX_AXES, 2))
"""Names of the columns of their correlations, as the upper triangle of a matrix has them."""


def effects_of(state: int) -> tuple[str, ...]:
    """Names of the columns with the effect of one time-correlated error, numbered from 1, on each fix."""
    return tuple(f"error{state}_{axis}" for axis in FIX_AXES)


FIX_ACCURACIES = ("sigma_horizontal_m", "sigma_vertical_m", "sigma_speed_m_s")
"""Names of the columns of the accuracies that a receiver claims: horizontal, vertical, of the velocity."""
LEAST_QUALITY = 3
"""Least number in the column `quality` of a fix with a height: 3 or more is 3D, as MAVLink numbers fixes."""
GNSS_OPTIONAL = ("nsat", *FIX_SIGMAS, *FIX_CORRELATIONS, *FIX_ACCURACIES, "quality")
"""Names of optional columns of fixes."""
HEADING_COLUMNS = ("t_s", "heading_deg", "sigma_heading_deg")
"""Names of the columns of headings, clockwise from north; the last one is optional."""
TRACK_COLUMNS, TRACK_ATTITUDE = ("t_s", "lat_deg", "lon_deg", "h_m"), ("roll_deg", "pitch_deg", "yaw_deg")
"""Names of the columns of trajectories, and of those that they may have."""
KNOT = 1852.0 / 3600.0
"""In m/s."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Each in s."""
GYRO_UNITS = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "deg/h": math.pi / 648000.0, "mrad/s": 1e-3}
"""Each in rad/s."""
ACCELEROMETER_UNITS = {
    "m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY, "ft/s2": 0.3048, "cm/s2": 0.01,
}  # fmt: skip
"""Each in m/s2."""
ANGLE_UNITS = {"deg": 1.0, "rad": 180.0 / math.pi, "1e-7 deg": 1e-7}
"""Each in degrees."""
POSITION_AXES = {"NE": (1.0, 1.0), "NW": (1.0, -1.0), "SE": (-1.0, 1.0), "SW": (-1.0, -1.0)}
"""Directions in which latitude and longitude increase, and their signs."""
HEIGHT_UNITS = {"m": 1.0, "ft": 0.3048, "mm": 1e-3}
"""Each in m."""
SPEED_UNITS = {
    "m/s": 1.0, "km/h": 1.0 / 3.6, "kn": KNOT, "mph": 0.44704, "ft/s": 0.3048, "cm/s": 0.01, "mm/s": 1e-3,
}  # fmt: skip
"""Each in m/s."""
VERTICAL_SPEED_UNITS = {**SPEED_UNITS, "ft/min": 0.3048 / 60.0}
"""Units of the vertical velocity alone, each in m/s."""
BODY_AXES, LEVEL_AXES = ("FB", "RL", "DU"), ("NS", "EW", "DU")
"""Positive and negative direction of each axis: forward, right, down; north, east, down."""


def axes_matrix(letters: str, axes: tuple[str, str, str]) -> np.ndarray:
    """Rotation (3, 3) of columns along `letters`, such as FLU, to `axes`: a signed permutation."""
    out = np.zeros((3, 3))
    for column, letter in enumerate(letters):
        row = next(i for i, pair in enumerate(axes) if letter in pair)
        out[row, column] = 1.0 if axes[row][0] == letter else -1.0
    return out


def axes_letters(matrix: np.ndarray, axes: tuple[str, str, str]) -> str:
    """Letters of a signed permutation (3, 3): inverse of `axes_matrix`."""
    rows = np.argmax(np.abs(matrix), axis=0)
    return "".join(axes[row][0 if matrix[row, column] > 0.0 else 1] for column, row in enumerate(rows))


def all_axes(axes: tuple[str, str, str]) -> list[str]:
    """All 48 assignments of three columns to three axes, including left-handed ones (columns exchanged)."""
    return ["".join(p) for order in itertools.permutations(axes) for p in itertools.product(*order)]


@dataclass(frozen=True)
class ColumnUnit:
    """Unit that a column is due to have, those that are known, and the key that declares it, "" for none."""

    key: str
    due: str
    known: Collection[str]


def heading_units(time_unit: str) -> dict[str, ColumnUnit]:
    """Unit of each column of headings whose times are in `time_unit`."""
    angles = dict.fromkeys(HEADING_COLUMNS[1:], ColumnUnit("", "deg", ANGLE_UNITS))
    return {"t_s": ColumnUnit("time_unit", time_unit, TIME_UNITS), **angles}


@dataclass(frozen=True)
class ImuConvention:
    """Units, axes and columns of recorded inertial samples.

    Axes: directions of the columns x, y, z. increments: a row holds the integral since the row before, in the units
    times s. columns: name in the file of each column of `docs/replay-files.md`.
    """

    time_unit: str = "s"
    gyro_unit: str = "rad/s"
    accelerometer_unit: str = "m/s2"
    gyro_axes: str = "FRD"
    accelerometer_axes: str = "FRD"
    increments: bool = False
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def units(self) -> dict[str, ColumnUnit]:
        """Unit of each column."""
        gyro = ColumnUnit("gyro_unit", self.gyro_unit, GYRO_UNITS)
        accelerometer = ColumnUnit("accelerometer_unit", self.accelerometer_unit, ACCELEROMETER_UNITS)
        time = ColumnUnit("time_unit", self.time_unit, TIME_UNITS)
        return dict(zip(IMU_COLUMNS, (time, *(gyro,) * 3, *(accelerometer,) * 3), strict=True))


@dataclass(frozen=True)
class GnssConvention:
    """Units, axes and columns of recorded fixes."""

    time_unit: str = "s"
    time_offset: float = 0.0
    """Added to their times, s."""
    angle_unit: str = "deg"
    position_axes: str = "NE"
    """Directions in which the columns of latitude and longitude increase."""
    height_unit: str = "m"
    speed_unit: str = "m/s"
    vertical_speed_unit: str | None = None
    """None: speed_unit."""
    velocity_axes: str = "NED"
    """Directions of the columns vn, ve, vd."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Name in the file of each column of `docs/replay-files.md`."""
    errors: int = 0
    """Number of time-correlated errors with columns of their effects on each fix (`effects_of`)."""

    @property
    def units(self) -> dict[str, ColumnUnit]:
        """Unit of each column that has one; accuracies are always in m and m/s."""
        time, height = ColumnUnit("time_unit", self.time_unit, TIME_UNITS), self.height_unit
        angle, speed = ColumnUnit("angle_unit", self.angle_unit, ANGLE_UNITS), self.speed_unit
        level, down = ColumnUnit("speed_unit", speed, SPEED_UNITS), self.vertical_speed_unit or speed
        upright = ColumnUnit("vertical_speed_unit", down, VERTICAL_SPEED_UNITS)
        units = (time, angle, angle, ColumnUnit("height_unit", height, HEIGHT_UNITS), level, level, upright)
        sigmas = (*FIX_SIGMAS, *FIX_ACCURACIES)
        meters, rates = ColumnUnit("", "m", HEIGHT_UNITS), ColumnUnit("", "m/s", SPEED_UNITS)
        accuracies = {name: rates if name.endswith("_m_s") else meters for name in sigmas}
        return {**dict(zip(GNSS_COLUMNS, units, strict=True)), **accuracies}

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the columns of these effects."""
        return tuple(name for state in range(self.errors) for name in effects_of(state + 1))


IMU_AS_DUE, GNSS_AS_DUE = ImuConvention(), GnssConvention()
"""The tables as of `docs/replay-files.md`."""
