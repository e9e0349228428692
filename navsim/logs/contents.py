"""Contents of a log in one form: inertial samples, fixes, ranges, further sensors; what was left out and decided.

Times are s of the log's own clock (`Clock`), axes forward-right-down and north-east-down, units SI and degrees.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.ndimage import median_filter

from navsim.formats.conventions import FIX_SIGMAS, TRACK_ATTITUDE
from navsim.formats.text import INSTALL_LOGS, MOST_BYTES, FileError
from navsim.geodesy.attitude import dcm_from_quaternion, dcm_from_rpy, roll_pitch_yaw
from navsim.gnss.timescales import DAY, WEEK, utc_from_gps
from navsim.results import files
from navsim.statistics.rounding import digits

Clock = Literal["own", "week"]
"""own: s since the start of the device. week: GPS s since the beginning of a week, which `LogContents.start` tells."""
SLOWEST_IMU_HZ = 20.0
"""Slower inertial samples cannot be integrated."""
_TIME_TOLERANCE = 1.0
"""A time farther than this from the median of its five neighbours is damaged, s,"""
_INTERVALS = 1.5
"""or farther than this many usual intervals: beside a damaged time the median is that of the next one."""
_HELD = 0.1
"""The first and the last sample of a sensor stand for the time before and after it as far as this, s."""
_LATEST = 200.0 * 365.25 * DAY
"""GPS s of a date that no recording has yet."""
_LIMITS = {
    "rate": (-100.0, 100.0), "force": (-2000.0, 2000.0), "lat_deg": (-90.0, 90.0), "lon_deg": (-180.0, 180.0),
    "h_m": (-1e4, 1e5), "velocity": (-2000.0, 2000.0),
}  # fmt: skip
"""Physical limits: rad/s, m/s2, deg, m, m/s."""
MEANINGS = {
    "nsat": "satellites", "quality": "quality", "sigma_horizontal_m": "horizontal accuracy",
    "sigma_vertical_m": "vertical accuracy", "sigma_speed_m_s": "accuracy of speed",
    **dict.fromkeys(FIX_SIGMAS, "accuracy by axis"),
}  # fmt: skip
"""Meaning of the further columns of fixes."""
MAGNETIC_HEADING, ANTENNA_HEADING = "magnetic_heading", "antenna_heading"
"""Tables of headings."""
BODY_AXES = ("gyro_axes: FRD  # known: the board's orientation is applied", "accelerometer_axes: FRD")
"""Lines of the section `imu` for samples in the axes of the body."""
QUALITY = {"no fix": 0, "2D": 2, "3D": 3, "differential": 4, "float": 5, "fixed": 6}
"""Column `quality`: how the receiver found a fix, as MAVLink and the autopilots number it."""


@dataclass(frozen=True)
class ImuRecord:
    """Samples of one inertial sensor: time (n,), rate (n, 3), force (n, 3)."""

    name: str
    time: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    samples: Literal["instantaneous", "averaged", "increments"] = "instantaneous"
    """As of the key `imu.samples`."""
    position_m: tuple[float, float, float] | None = None
    """Position in the body, forward, right, down, as the log's parameters give it; None if they do not."""

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        return 1.0 / float(np.median(np.diff(self.time))) if self.time.size > 1 else 0.0


@dataclass(frozen=True)
class FixRecord:
    """Fixes of one receiver: time (m,), latitude and longitude in deg, height in m (m, 3), velocity (m, 3), nan if
    unknown."""

    name: str
    time: np.ndarray
    llh: np.ndarray
    velocity: np.ndarray
    further: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Columns of `MEANINGS`, nan where the receiver says nothing."""
    position_m: tuple[float, float, float] | None = None
    """Position of the antenna in the body, as of `ImuRecord`."""
    latency_s: float | None = None
    """Delay that the log's parameters give; None: the tuning finds it."""
    remark: str = ""
    """Why the latency is not used, as a comment."""

    def take(self, keep: np.ndarray) -> FixRecord:
        """Some of the fixes."""
        further = {name: column[keep] for name, column in self.further.items()}
        return replace(self, time=self.time[keep], llh=self.llh[keep], velocity=self.velocity[keep], further=further)


@dataclass(frozen=True)
class RangeRecord:
    """Ranges to beacons: time, beacon (n,), range (n,) m, sigma (n,) m or nan, signal (n,) dBm or nan."""

    time: np.ndarray
    beacon: np.ndarray
    range_m: np.ndarray
    sigma_m: np.ndarray
    signal_dbm: np.ndarray
    positions: dict[str, tuple[float, float, float]]
    """Of each beacon: latitude, longitude, height (deg, m), or x, y, z (east, north, up, m)."""
    is_geodetic: bool


@dataclass
class LogContents:
    """Contents of one or more logs."""

    format: str
    """What the log is, in words."""
    imus: list[ImuRecord] = field(default_factory=list)
    receivers: list[FixRecord] = field(default_factory=list)
    ranges: RangeRecord | None = None
    tables: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    """Further sensors: name of the table, columns by name; the first is t_s."""
    texts: dict[str, str] = field(default_factory=dict)
    """Further files: name, content."""
    clock: Clock = "own"
    start: float | None = None
    """GPS s of time 0, if known."""
    left_out: list[str] = field(default_factory=list)
    decided: list[str] = field(default_factory=list)
    imu_keys: list[str] = field(default_factory=list)
    """Further lines of the section `imu` of the log file."""

    def add_imu(self, record: ImuRecord) -> None:
        """Take an inertial sensor, without damaged samples; one that is too slow is left out."""
        bad = _outside(record.rate, "rate") | _outside(record.force, "force")
        keep = self._kept(record.name, "samples", record.time, bad)
        kept = replace(record, time=record.time[keep], rate=record.rate[keep], force=record.force[keep])
        if kept.time.size < 2:
            self.left_out.append(f"{record.name}: fewer than two samples")
            return
        if kept.rate_hz < SLOWEST_IMU_HZ:
            why = f"{digits(kept.rate_hz)} samples a second are too few; log at {SLOWEST_IMU_HZ:g} Hz or more"
            self.left_out.append(f"{record.name}: {why}")
            return
        self.imus.append(kept)

    def add_receiver(self, record: FixRecord, fix: np.ndarray | None = None) -> bool:
        """Take a receiver, without damaged fixes; false if it has fewer than two. fix (m,): which messages have a 3D
        fix; None: all."""
        if fix is not None:
            self.count_omitted(int((~fix).sum()), f"messages of {record.name} without a 3D fix")
            record = record.take(fix)
        bad = _outside(record.velocity, "velocity", unknown=True)
        for column, name in enumerate(("lat_deg", "lon_deg", "h_m")):
            bad |= _outside(record.llh[:, column : column + 1], name)
        keep = self._kept(record.name, "fixes", record.time, bad)
        if keep.sum() < 2:
            self.left_out.append(f"{record.name}: fewer than two fixes")
            return False
        self.receivers.append(record.take(keep))
        return True

    def add_table(self, name: str, columns: dict[str, np.ndarray]) -> None:
        """Take a table of another sensor."""
        bad = ~np.isfinite(np.column_stack(list(columns.values()))).any(axis=1)
        keep = self._kept(name, "rows", columns["t_s"], bad)
        if keep.any():
            self.tables[name] = {key: column[keep] for key, column in columns.items()}

    def add_antenna_heading(self, time: np.ndarray, heading: np.ndarray, sigma: np.ndarray | None) -> None:
        """Take headings of the nose by two antennas (m,), deg, nan where there is none, with their 1 sigma."""
        known = np.isfinite(heading)
        if ANTENNA_HEADING in self.tables or not known.any():
            return
        columns = {"t_s": time, "heading_deg": heading}
        if sigma is not None:
            columns["sigma_heading_deg"] = np.where(sigma > 0.0, sigma, np.nan)
        self.add_table(ANTENNA_HEADING, {name: column[known] for name, column in columns.items()})
        self.decided.append(f"{ANTENNA_HEADING}.csv: the driver has turned the antennas' heading to that of the nose")

    def add_magnetic_heading(self) -> None:
        """Take headings from magnetic north by the first magnetometer and the autopilot's roll and pitch, if there are
        both."""
        if "magnetometer" not in self.tables or "attitude" not in self.tables:
            return
        field, attitude = self.tables["magnetometer"], self.tables["attitude"]
        first = field["instance"] == field["instance"].min()
        time = field["t_s"][first]
        roll, pitch = np.radians(
            interpolated(time, attitude["t_s"], np.column_stack([attitude[name] for name in TRACK_ATTITUDE[:2]]))
        ).T
        level = dcm_from_rpy(np.column_stack([roll, pitch, np.zeros(time.size)]))
        x, y, _ = np.einsum("nij,jn->in", level, np.array([field[f"m{axis}_ut"][first] for axis in "xyz"]))
        self.add_table(MAGNETIC_HEADING, {"t_s": time, "heading_deg": np.degrees(np.arctan2(-y, x))})
        if MAGNETIC_HEADING in self.tables:
            self.decided.append(
                f"{MAGNETIC_HEADING}.csv: headings from magnetic north by magnetometer "
                f"{field['instance'].min():.0f}, levelled by the autopilot's roll and pitch: a tilt that is wrong by 1 "
                "degree turns them by the tangent of the dip, 2 degrees in Europe"
            )

    def count_omitted(self, count: int, what: str) -> None:
        """Note a number of omitted records."""
        if count:
            self.left_out.append(f"{count} {what}")

    def _kept(self, name: str, what: str, time: np.ndarray, bad: np.ndarray) -> np.ndarray:
        """Records with a plausible time and values."""
        if time.size == 0:
            return np.zeros(0, bool)
        wild = ~np.isfinite(time)
        typical = median_filter(np.where(wild, 0.0, time), min(5, time.size), mode="nearest")
        usual = float(np.median(np.abs(np.diff(time[~wild])))) if (~wild).sum() > 1 else 0.0
        wild |= np.abs(np.where(wild, 0.0, time) - typical) > max(_TIME_TOLERANCE, _INTERVALS * usual)
        self.count_omitted(int(wild.sum()), f"{what} of {name} with a damaged time")
        self.count_omitted(int((bad & ~wild).sum()), f"{what} of {name} outside of physical limits")
        return np.asarray(~(wild | bad))

    def merge(self, other: LogContents, name: str) -> None:
        """Add the contents of another file of the same recording. Raises FileError where their clocks differ."""
        if self.clock != "week" or other.clock != "week":
            message = "its times count from the start of a device: files with different clocks cannot be joined"
            raise FileError(0, f"{message}; import them one by one", Path(name))
        if self.start is not None and other.start is not None and self.start != other.start:
            weeks = (other.start - self.start) / WEEK
            raise FileError(0, f"it begins {weeks:.0f} weeks after the first file", Path(name))
        if both := sorted({*self.tables, *self.texts} & {*other.tables, *other.texts}):
            raise FileError(0, f"it gives {', '.join(both)}, as a file before it; import them one by one", Path(name))
        self.format = f"{self.format}; {other.format}"
        self.start = other.start if self.start is None else self.start
        for list_ in ("imus", "receivers", "left_out", "decided", "imu_keys"):
            getattr(self, list_).extend(getattr(other, list_))
        self.tables.update(other.tables)
        self.texts.update(other.texts)

    def place_antenna(self, arm: tuple[float, float, float]) -> None:
        """Use this lever arm, from the IMU to the antenna."""
        self.imus = [replace(imu, position_m=(0.0, 0.0, 0.0)) for imu in self.imus]
        self.receivers = [replace(receiver, position_m=arm) for receiver in self.receivers]

    @property
    def epoch(self) -> float | None:
        """UTC of time 0, POSIX s, if known and possible."""
        return None if self.start is None or not 0.0 <= self.start < _LATEST else float(utc_from_gps(self.start))

    def found(self) -> bool:
        """Whether the log has anything."""
        return bool(self.imus or self.receivers or self.ranges or self.tables or self.texts)


def _outside(values: np.ndarray, name: str, unknown: bool = False) -> np.ndarray:
    """Rows (n,) of values (n, k) outside of physical limits; unknown: nan is allowed."""
    low, high = _LIMITS[name]
    inside = (values >= low) & (values <= high)
    return np.asarray(~(inside | np.isnan(values) if unknown else inside).all(axis=1))


@dataclass(frozen=True)
class Topic:
    """Messages of a log that become a table: their name, and by column of the table the field and its factor."""

    message: str
    table: str
    columns: Mapping[str, tuple[str, float]]

    def rows(self, time: np.ndarray, fields: Mapping[str, np.ndarray], instance: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of the table, of the fields that the log has."""
        there = {name: factor * fields[of] for name, (of, factor) in self.columns.items() if of in fields}
        return {"t_s": time, "instance": instance.astype(float), **there} if there else {}


def lever_parameters(parameters: Mapping[str, float], names: Sequence[str]) -> tuple[float, float, float] | None:
    """Position by three parameters of a log, the first spelling that it has; None where it has none."""
    for stem in names:
        if f"{stem}_X" in parameters:
            x, y, z = (float(parameters.get(f"{stem}_{axis}", 0.0)) for axis in "XYZ")
            return x, y, z
    return None


def check_size(path: Path) -> int:
    """Bytes of a log. Raises FileError where it is larger than what readers hold in memory; OSError."""
    with files.open_regular(path) as file:
        size = file.seek(0, io.SEEK_END)
    if size > MOST_BYTES:
        raise FileError(0, f"it has {size:,} bytes, more than the {MOST_BYTES:,} that navsim reads", path)
    if size == 0:
        raise FileError(0, "the file is empty", path)
    return size


@contextmanager
def foreign_reader(path: Path, library: str) -> Iterator[None]:
    """Context in which another library reads a log: what it prints is dropped, its errors are raised as FileError."""
    try:
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
            yield
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] != library:
            raise
        raise FileError(0, f"{library} reads this log, and is not installed here: {INSTALL_LOGS}", path) from None
    except (FileError, OSError, MemoryError):
        raise
    except Exception as error:  # a damaged log may raise anything in a library that expects sound ones
        what = f"{type(error).__name__}: {error}"
        raise FileError(0, f"the log is damaged, {library} cannot read it ({what[:200]})", path) from None


def quaternion_angles(q: np.ndarray) -> dict[str, np.ndarray]:
    """Roll, pitch, yaw, deg, of quaternions (n, 4), scalar first, from body to north-east-down."""
    length = np.linalg.norm(q, axis=1, keepdims=True)
    unit = np.divide(q, length, out=np.full_like(q, np.nan), where=length > 0.0)
    return dict(zip(TRACK_ATTITUDE, np.degrees(roll_pitch_yaw(dcm_from_quaternion(unit))).T, strict=True))


def interpolated(time: np.ndarray, theirs: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, k) of another sensor, with times `theirs` (n,) in any order, at times (m,): linear; nan beyond their
    ends."""
    known = np.isfinite(theirs)
    order = np.argsort(theirs[known], kind="stable")
    if not order.size:
        return np.full((time.size, values.shape[1]), np.nan)
    at, values = theirs[known][order], values[known][order]
    out = np.column_stack([np.interp(time, at, column) for column in values.T])
    out[(time < at[0] - _HELD) | (time > at[-1] + _HELD)] = np.nan
    return out


def numbers(fields: Mapping[str, Any], *names: str) -> np.ndarray | None:
    """Fields side by side as floats; None where the log lacks one."""
    if any(name not in fields for name in names):
        return None
    return np.column_stack([np.asarray(fields[name], dtype=float) for name in names])
