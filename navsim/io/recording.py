"""Recorded flights: tables of inertial samples and of fixes [1], or fixes from NMEA sentences.

Rows that say nothing are taken out and counted: repetitions, power-up zeros, a receiver's placeholder before its first
fix. Rows that came out of order are sorted. Source: [1] `interface.md`, recorded flight.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from navsim.core import wgs84
from navsim.io.text import FileError, number, read_lines, within
from navsim.models import conventions
from navsim.models.conventions import (
    GNSS_AS_DUE,
    GNSS_COLUMNS,
    IMU_AS_DUE,
    IMU_COLUMNS,
    GnssConvention,
    ImuConvention,
)
from navsim.models.recording import Fixes, Samples

_MAY_BE_EMPTY = ("vn_m_s", "ve_m_s", "vd_m_s", "nsat")
_IMU_LIMITS = ((-1e12, 1e12), *((-100.0, 100.0),) * 3, *((-2000.0, 2000.0),) * 3)
_GNSS_LIMITS = ((-1e12, 1e12), (-90.0, 90.0), (-180.0, 360.0), (-1e4, 1e5), *((-2000.0, 2000.0),) * 3, (0, 1000))


@dataclass(frozen=True)
class Dropped:
    """How many rows were left out or moved, by reason; and the first value outside physical limits, where the reader
    was told not to raise it."""

    counts: dict[str, int] = field(default_factory=dict)
    outside: FileError | None = None

    def add(self, reason: str, count: int) -> None:
        """Count some more."""
        if count:
            self.counts[reason] = self.counts.get(reason, 0) + int(count)


def read_imu(path: Path, convention: ImuConvention = IMU_AS_DUE, limited: bool = True) -> tuple[Samples, Dropped]:
    """Inertial samples of a table, in order of time, and what was left out.

    limited: refuse values outside physical limits; otherwise the first of them is left in `Dropped.outside`. Raises
    FileError, naming the line; OSError where the file cannot be read.
    """
    table, lines = _table(path, IMU_COLUMNS, (), columns=convention.columns)
    table[:, 0] *= conventions.TIME_UNITS[convention.time_unit]
    for first, axes, factor in (
        (1, convention.gyro_axes, conventions.GYRO_UNITS[convention.gyro_unit]),
        (4, convention.accelerometer_axes, conventions.ACCELEROMETER_UNITS[convention.accelerometer_unit]),
    ):
        turned = table[:, first : first + 3] @ conventions.axes_matrix(axes, conventions.BODY_AXES).T
        table[:, first : first + 3] = factor * turned
    dropped = Dropped(outside=_outside(path, table, lines, IMU_COLUMNS, _IMU_LIMITS, limited))
    silent = np.all(table[:, 1:] == 0.0, axis=1)
    dropped.add("samples of zeros alone (a sensor not yet awake)", silent.sum())
    table = _in_order(table[~silent], dropped, "samples")
    if table.shape[0] < 10:
        raise FileError(0, f"only {table.shape[0]} usable samples", path)
    if convention.increments:
        table[:, 1:] = increments_as_rates(table[:, 0], table[:, 1:])
    return Samples(table[:, 0], table[:, 1:4].copy(), table[:, 4:7].copy()), dropped


def increments_as_rates(time: np.ndarray, gathered: np.ndarray) -> np.ndarray:
    """Mean rates (n, 6) of what sensors gathered since the sample before; time (n,) s, increasing.

    A sample after missing ones has gathered over one usual interval, as has the first.
    """
    step = np.diff(time, prepend=time[0])
    usual = float(np.median(step[1:]))
    step[0] = usual
    return gathered / np.where(step > 1.5 * usual, usual, step)[:, None]


def read_fixes(
    path: Path, min_satellites: int = 4, convention: GnssConvention = GNSS_AS_DUE, limited: bool = True
) -> tuple[Fixes, Dropped]:
    """Fixes of a table or of NMEA sentences, in order of time, and what was left out.

    min_satellites: rows with fewer in the column `nsat` are left out, where there is that column. limited: as of
    `read_imu`. Raises FileError, naming the line; OSError where the file cannot be read.
    """
    lines = read_lines(path)
    if any(line.startswith(("$", "!")) for line in lines[:5]):
        from navsim.io.nmea import read_nmea

        if replace(convention, time_offset=0.0) != GNSS_AS_DUE:
            message = "NMEA sentences have units and columns of their own; only their times may be shifted"
            raise FileError(0, message, path)
        table, dropped = read_nmea(path, lines)
    else:
        table, numbers = _table(path, GNSS_COLUMNS, ("nsat",), lines, convention.columns)
        table[:, 0] *= conventions.TIME_UNITS[convention.time_unit]
        table[:, 1:3] *= conventions.ANGLE_UNITS[convention.angle_unit]
        table[:, 3] *= conventions.HEIGHT_UNITS[convention.height_unit]
        axes = conventions.axes_matrix(convention.velocity_axes, conventions.LEVEL_AXES)
        # by columns, since a matrix product would spread an unknown component over all
        source, sign = np.argmax(np.abs(axes), axis=1), axes.sum(axis=1)
        table[:, 4:7] = conventions.SPEED_UNITS[convention.speed_unit] * sign * table[:, 4 + source]
        dropped = Dropped(outside=_outside(path, table, numbers, (*GNSS_COLUMNS, "nsat"), _GNSS_LIMITS, limited))
    table[:, 0] += convention.time_offset
    few = table[:, 7] < min_satellites
    dropped.add(f"fixes with fewer than {min_satellites} satellites", few.sum())
    table = _in_order(table[~few], dropped, "fixes")
    # a receiver without a fix repeats one invented place until its first change of position
    if table.shape[0] > 1:
        moved = np.flatnonzero(np.any(table[:, 1:4] != table[0, 1:4], axis=1))
        first = int(moved[0]) if moved.size else 0
        if first > 1 or (first == 1 and _far(table[0], table[1])):
            dropped.add("placeholders before the first fix", first)
            table = table[first:]
        stale = np.concatenate([[False], np.all(table[1:, 1:7] == table[:-1, 1:7], axis=1)])
        dropped.add("repeated fixes", stale.sum())
        table = table[~stale]
    if table.shape[0] < 2:
        raise FileError(0, f"only {table.shape[0]} usable fixes", path)
    llh = np.column_stack([np.radians(table[:, 1:3]), table[:, 3]])
    return Fixes(table[:, 0], llh, table[:, 4:7].copy()), dropped


def _far(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two rows of fixes lie farther apart than anything flies."""
    ecef = wgs84.ecef_from_llh(np.column_stack([np.radians([a[1:3], b[1:3]]), [a[3], b[3]]]))
    return bool(np.linalg.norm(ecef[0] - ecef[1]) > 1000.0 * max(b[0] - a[0], 1.0))


def _table(
    path: Path,
    wanted: tuple[str, ...],
    optional: tuple[str, ...],
    lines: list[str] | None = None,
    columns: Mapping[str, str] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Columns `wanted` and `optional` (nan where absent) of a comma-separated table, and each row's line number;
    columns: those of them that have another name in the file."""
    lines = read_lines(path) if lines is None else lines
    if columns:
        wanted, optional = (tuple(columns.get(name, name) for name in names) for names in (wanted, optional))
    header = [name.strip() for name in lines[0].lstrip("\ufeff").split(",")]
    missing = [name for name in wanted if name not in header]
    if missing:
        raise FileError(1, f"the header lacks {', '.join(missing)}; needed are {', '.join(wanted)}", path)
    place = [header.index(name) for name in wanted] + [header.index(n) for n in optional if n in header]
    numbers = np.array([n for n, line in enumerate(lines[1:], 2) if line.strip()])
    if not numbers.size:
        raise FileError(1, "the table has no rows", path)
    try:  # the fast way; it cannot tell where it fails, nor read empty cells
        table = np.loadtxt(io.StringIO("\n".join(lines[1:])), delimiter=",", usecols=place, ndmin=2, comments=None)
    except ValueError:
        names = (*wanted, *(n for n in optional if n in header))
        may_be_empty = {columns.get(name, name) for name in _MAY_BE_EMPTY} if columns else set(_MAY_BE_EMPTY)
        table = np.array([_row(path, n, lines[n - 1], place, names, len(header), may_be_empty) for n in numbers])
    if len(place) < len(wanted) + len(optional):
        table = np.column_stack([table, np.full(table.shape[0], np.nan)])
    return table, numbers


def _row(
    path: Path, line: int, text: str, place: list[int], names: tuple[str, ...], width: int, may_be_empty: set[str]
) -> list[float]:
    cells = next(csv.reader([text]))
    if len(cells) != width:
        raise FileError(line, f"{width} cells are due by the header, here are {len(cells)}", path)
    out = []
    for index, name in zip(place, names, strict=True):
        empty = cells[index].strip().lower() in ("", "nan")
        out.append(np.nan if empty and name in may_be_empty else number(path, line, cells[index], name))
    return out


def _outside(
    path: Path, table: np.ndarray, lines: np.ndarray, names: tuple[str, ...], limits: tuple, limited: bool
) -> FileError | None:
    """The first value outside of physical limits; raised where limited, and always for what is no finite number."""
    found = None
    for column, (name, (low, high)) in enumerate(zip(names, limits, strict=True)):
        values = table[:, column]
        bad = ~((values >= low) & (values <= high))
        if name in _MAY_BE_EMPTY:
            bad &= ~np.isnan(values)
        # what is no number is refused whatever its unit
        for row in (*np.flatnonzero(bad & ~np.isfinite(values))[:1], *np.flatnonzero(bad)[:1]):
            try:
                within(path, int(lines[row]), float(values[row]), low, high, name)
            except FileError as error:
                if limited or not np.isfinite(values[row]):
                    raise
                found = error if found is None else found
    return found


def _in_order(table: np.ndarray, dropped: Dropped, what: str) -> np.ndarray:
    """Rows by time, each time once."""
    dropped.add(f"{what} out of order, sorted", int(np.sum(np.diff(table[:, 0]) < 0.0)))
    table = table[np.argsort(table[:, 0], kind="stable")]
    twice = np.concatenate([[False], np.diff(table[:, 0]) <= 0.0])
    dropped.add(f"{what} with the time of another", twice.sum())
    return table[~twice]
