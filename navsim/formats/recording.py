"""Recorded flights: tables of inertial samples and of fixes [1], or fixes from NMEA sentences.

Empty rows are removed and counted: repetitions, power-up zeros, a receiver's placeholder before its first fix. Rows out
of order are sorted. Source: [1] `docs/replay-files.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import (
    FIX_ACCURACIES,
    FIX_AXES,
    FIX_CORRELATIONS,
    FIX_SIGMAS,
    GNSS_AS_DUE,
    GNSS_COLUMNS,
    GNSS_OPTIONAL,
    HEADING_COLUMNS,
    IMU_AS_DUE,
    IMU_COLUMNS,
    LEAST_QUALITY,
    TRACK_ATTITUDE,
    TRACK_COLUMNS,
    ColumnUnit,
    GnssConvention,
    ImuConvention,
)
from navsim.formats.nmea import has_sentences, one_recording, read_nmea
from navsim.formats.recorded_data import Fixes, Samples
from navsim.formats.tables import TextTable, bracketed_unit, column_base
from navsim.formats.text import Dropped, FileError, read_lines, within
from navsim.geodesy import earth
from navsim.results.findings import several
from navsim.statistics.rounding import digits

_MAY_BE_EMPTY = ("vn_m_s", "ve_m_s", "vd_m_s", *GNSS_OPTIONAL, *HEADING_COLUMNS[1:])
_IMU_LIMITS = ((-1e12, 1e12), *((-100.0, 100.0),) * 3, *((-2000.0, 2000.0),) * 3)
_GNSS_LIMITS = ((-1e12, 1e12), (-90.0, 90.0), (-180.0, 360.0), (-1e4, 1e5), *((-2000.0, 2000.0),) * 3, (0, 1000),
                *((1e-9, 1e6),) * len(FIX_SIGMAS), *((-1.0, 1.0),) * len(FIX_CORRELATIONS),
                *((1e-9, 1e6),) * len(FIX_ACCURACIES), (0, 100))  # fmt: skip
_CONTRADICTORY = -1e-6
"""Smallest eigenvalue of a correlation matrix, which rounding may bring below zero."""

_TRACK_LIMITS = (*_GNSS_LIMITS[:4], *((-360.0, 360.0),) * 3)


def read_imu(
    path: Path, lenient: bool = False, convention: ImuConvention = IMU_AS_DUE, limited: bool = True
) -> tuple[Samples, Dropped]:
    """Read inertial samples of a table, in order of time; returns them and what was omitted.

    - `lenient`: omit rows that cannot be read or are outside of physical limits.
    - `limited`: refuse or omit those outside; otherwise keep them, and note the first in `Dropped.outside`.

    Raises FileError with the line; OSError if the file cannot be read.
    """
    dropped = Dropped(lenient)
    there = TextTable.of(path, read_lines(path, dropped))
    table, lines = _columns(there, IMU_COLUMNS, (), dropped, convention.columns, convention.units, "imu")
    table[:, 0] *= conventions.TIME_UNITS[convention.time_unit]
    for first, axes, factor in (
        (1, convention.gyro_axes, conventions.GYRO_UNITS[convention.gyro_unit]),
        (4, convention.accelerometer_axes, conventions.ACCELEROMETER_UNITS[convention.accelerometer_unit]),
    ):
        turned = table[:, first : first + 3] @ conventions.axes_matrix(axes, conventions.BODY_AXES).T
        table[:, first : first + 3] = factor * turned
    table, lines = _limited(path, table, lines, IMU_COLUMNS, _IMU_LIMITS, dropped, limited)
    silent = np.all(table[:, 1:] == 0.0, axis=1)
    dropped.add("samples that are all zero (the sensor was starting)", silent.sum())
    table = _in_order(path, table[~silent], lines[~silent], dropped, "samples")
    if table.shape[0] < 10:
        raise _too_few(path, table, "sample", dropped)
    if convention.increments:
        table[:, 1:] = increments_as_rates(table[:, 0], table[:, 1:])
    return Samples(table[:, 0], table[:, 1:4].copy(), table[:, 4:7].copy()), dropped


def increments_as_rates(time: np.ndarray, gathered: np.ndarray) -> np.ndarray:
    """Mean rates (n, 6) from increments since the sample before; time (n,) s, increasing.

    The first sample, and one after missing samples, has increments over one usual interval.
    """
    step = np.diff(time, prepend=time[0])
    usual = float(np.median(step[1:]))
    step[0] = usual
    return gathered / np.where(step > 1.5 * usual, usual, step)[:, None]


def read_fixes(
    path: Path,
    min_satellites: int = 4,
    lenient: bool = False,
    convention: GnssConvention = GNSS_AS_DUE,
    limited: bool = True,
    simulated: bool = False,
) -> tuple[Fixes, Dropped]:
    """Read fixes of a table or of NMEA sentences, in order of time; returns them and what was omitted.

    The covariance of a fix is that of its columns of sigmas and correlations, if present.

    - `min_satellites`: rows with fewer in the column `nsat`, if present, are omitted.
    - `lenient`: as of `read_imu`. Corrupt NMEA sentences are always omitted, those without a checksum accepted.
    - `limited`: as of `read_imu`; `simulated`: accept NMEA fixes that the receiver marks as a simulator's.

    Raises FileError with the line, OSError if the file cannot be read.
    """
    dropped = Dropped(lenient)
    lines = read_lines(path, dropped)
    if has_sentences(lines):
        if replace(convention, time_offset=0.0) != GNSS_AS_DUE:
            message = "NMEA fixes units and columns; you can only shift its times"
            raise FileError(0, message, path)
        table = read_nmea(path, lines, dropped, simulated)
        numbers = None
    else:
        effects, due = convention.effects, len(GNSS_COLUMNS)
        wanted = (*GNSS_COLUMNS, *effects)
        table, numbers = _columns(
            TextTable.of(path, lines), wanted, GNSS_OPTIONAL, dropped, convention.columns, convention.units, "gnss"
        )
        table = np.hstack([table[:, :due], table[:, due + len(effects) :], table[:, due : due + len(effects)]])
        table[:, 0] *= conventions.TIME_UNITS[convention.time_unit]
        signs = np.array(conventions.POSITION_AXES[convention.position_axes])
        table[:, 1:3] *= signs * conventions.ANGLE_UNITS[convention.angle_unit]
        if signs[1] < 0.0:
            table[table[:, 2] < -180.0, 2] += 360.0  # west longitudes from 0 to 360
        table[:, 3] *= conventions.HEIGHT_UNITS[convention.height_unit]
        axes = conventions.axes_matrix(convention.velocity_axes, conventions.LEVEL_AXES)
        # by columns, since a matrix product would spread an unknown component over all
        source, sign = np.argmax(np.abs(axes), axis=1), axes.sum(axis=1)
        vertical = convention.vertical_speed_unit or convention.speed_unit
        units = [*[conventions.SPEED_UNITS[convention.speed_unit]] * 2, conventions.VERTICAL_SPEED_UNITS[vertical]]
        table[:, 4:7] = units * sign * table[:, 4 + source]
        names, limits = (*GNSS_COLUMNS, *GNSS_OPTIONAL, *effects), (*_GNSS_LIMITS, *((-1e6, 1e6),) * len(effects))
        table, numbers = _limited(path, table, numbers, names, limits, dropped, limited)
        agreeing = _agreeing(path, table[:, _SPREAD], numbers, dropped)
        table, numbers = table[agreeing], numbers[agreeing]
    table[:, 0] += convention.time_offset
    few = table[:, 7] < min_satellites
    dropped.add(f"fixes with fewer than {min_satellites} satellites", few.sum())
    flat = ~few & (table[:, _ACCURACY.stop :][:, :1] < LEAST_QUALITY).any(axis=1)
    dropped.add(f"fixes of a quality below {LEAST_QUALITY}, which have no height", flat.sum())
    good = ~(few | flat)
    table, numbers = table[good], None if numbers is None else numbers[good]
    if numbers is not None:  # a receiver without a fix may have no time either: a step from there on is none
        began = int(np.argmax(np.any(table[:, 1:4] != table[:1, 1:4], axis=1))) if table.size else 0
        one_recording(path, table[began:, 0], numbers[began:].tolist())
    table = _in_order(path, table, None, dropped, "fixes")
    # a receiver without a fix repeats one invented place until its first change of position
    if table.shape[0] > 1:
        moved = np.flatnonzero(np.any(table[:, 1:4] != table[0, 1:4], axis=1))
        first = int(moved[0]) if moved.size else 0
        if first > 1 or (first == 1 and _far(table[0], table[1])):
            dropped.add("placeholders before the first fix", first)
            table = table[first:]
        same = np.isclose(table[1:, 1:7], table[:-1, 1:7], rtol=0.0, atol=0.0, equal_nan=True).all(axis=1)
        # parked fixes without all velocities may be the same
        telling = np.isfinite(table[1:, 4:7]).all(axis=1) | (np.nansum(table[1:, 4:7] ** 2, axis=1) > 0.0)
        stale = np.concatenate([[False], same & telling])
        dropped.add("repeated fixes", stale.sum())
        table = table[~stale]
    if table.shape[0] < 2:
        raise _too_few(path, table, "fix", dropped)
    llh = np.column_stack([np.radians(table[:, 1:3]), table[:, 3]])
    spread = table[:, _SPREAD]
    covariance = _covariances(spread) if np.isfinite(spread).any() else None
    claimed = table[:, _ACCURACY]
    accuracy = claimed.copy() if np.isfinite(claimed).any() else None
    effect = None
    if convention.errors:
        effects_first = len(GNSS_COLUMNS) + len(GNSS_OPTIONAL)
        effect = np.swapaxes(table[:, effects_first:].reshape(-1, convention.errors, len(FIX_AXES)), 1, 2).copy()
    return Fixes(table[:, 0], llh, table[:, 4:7].copy(), covariance, effect, accuracy), dropped


_SPREAD = slice(len(GNSS_COLUMNS) + 1, len(GNSS_COLUMNS) + 1 + len(FIX_SIGMAS) + len(FIX_CORRELATIONS))
_ACCURACY = slice(_SPREAD.stop, _SPREAD.stop + len(FIX_ACCURACIES))
"""Columns of a row of fixes: with 1 sigmas and correlations; with the accuracies that the receiver claims. The quality
follows, then effects of time-correlated errors."""


def _covariances(spread: np.ndarray) -> np.ndarray:
    """Covariance (m, 6, 6) of fixes by their 1 sigmas and correlations (m, 21); nan where a sigma is not known."""
    sigma, axes = spread[:, : len(FIX_AXES)], np.arange(len(FIX_AXES))
    known = np.where(np.isnan(spread[:, len(FIX_AXES) :]), 0.0, spread[:, len(FIX_AXES) :])
    correlation = np.zeros((spread.shape[0], axes.size, axes.size))
    above = np.triu_indices(axes.size, 1)
    correlation[:, *above] = correlation[:, *above[::-1]] = known
    correlation[:, axes, axes] = 1.0
    return np.asarray(correlation * sigma[:, :, None] * sigma[:, None, :])


def _agreeing(path: Path, spread: np.ndarray, numbers: np.ndarray, dropped: Dropped) -> np.ndarray:
    """Which rows of 1 sigmas and correlations (m, 21) are those of a covariance; others are damaged."""
    keep = np.ones(numbers.size, bool)
    if np.isnan(spread).all():
        return keep
    sigma = spread[:, : len(FIX_AXES)]
    for part in (slice(0, 3), slice(3, 6)):
        missing = np.isnan(sigma[:, part])
        for row in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1)):
            names = FIX_SIGMAS[part]
            there = ", ".join(name for name, gone in zip(names, missing[row], strict=True) if not gone)
            message = f"the fix has only {there}; give all of {', '.join(names)}, or none"
            dropped.damaged("rows left out", FileError(int(numbers[row]), message, path))
            keep[row] = False
    correlation = _covariances(np.column_stack([np.ones_like(sigma), spread[:, len(FIX_AXES) :]]))
    smallest = np.linalg.eigvalsh(correlation)[:, 0]
    for row in np.flatnonzero(keep & (smallest < _CONTRADICTORY)):
        given = np.flatnonzero(np.isfinite(spread[row, len(FIX_AXES) :]))
        names = ", ".join(FIX_CORRELATIONS[i] for i in given)
        message = f"the correlations {names} of this fix are impossible: their matrix has the negative eigenvalue "
        message += f"{digits(smallest[row], 2)}; leave them out, or give those of the receiver"
        dropped.damaged("rows left out", FileError(int(numbers[row]), message, path))
        keep[row] = False
    return keep


def read_track(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, Dropped]:
    """Trajectory of a table: times (n,), s, ascending; positions (n, 3), rad, rad, m; roll, pitch, yaw (n, 3), rad, if
    present.

    Also returns what was omitted. Raises FileError with the line; OSError.
    """
    dropped = Dropped(False)
    there = TextTable.of(path, read_lines(path, dropped))
    turned = any(there.find(name) is not None for name in TRACK_ATTITUDE)
    names = (*TRACK_COLUMNS, *TRACK_ATTITUDE) if turned else TRACK_COLUMNS
    table, numbers = _columns(there, names, (), dropped, {}, {})
    table, numbers = _limited(path, table, numbers, names, _TRACK_LIMITS[: len(names)], dropped, True)
    table = _in_order(path, table, numbers, dropped, "places")
    llh = np.column_stack([np.radians(table[:, 1:3]), table[:, 3]])
    return table[:, 0].copy(), llh, np.radians(table[:, 4:]) if turned else None, dropped


def read_attitude(path: Path) -> tuple[np.ndarray, np.ndarray, Dropped]:
    """Attitude of a table: times (n,), s, ascending; roll, pitch, yaw (n, 3), rad.

    Also returns what was omitted. Raises FileError with the line; OSError.
    """
    dropped, names = Dropped(False), ("t_s", *TRACK_ATTITUDE)
    table, numbers = _columns(TextTable.of(path, read_lines(path, dropped)), names, (), dropped, {}, {})
    limits = (_TRACK_LIMITS[0], *_TRACK_LIMITS[-3:])
    table, numbers = _limited(path, table, numbers, names, limits, dropped, True)
    table = _in_order(path, table, numbers, dropped, "attitudes")
    if table.shape[0] < 2:
        raise _too_few(path, table, "attitude", dropped)
    return table[:, 0].copy(), np.radians(table[:, 1:]), dropped


def read_headings(
    path: Path, lenient: bool, columns: Mapping[str, str], time_unit: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Dropped]:
    """Headings of a table: times (k,), s, ascending; headings and 1 sigma (k,), rad, nan without a sigma.

    Rows without a heading do not count. Also returns what was omitted. Raises FileError with the line; OSError.
    """
    dropped = Dropped(lenient)
    table, numbers = _columns(
        TextTable.of(path, read_lines(path, dropped)),
        HEADING_COLUMNS[:2],
        HEADING_COLUMNS[2:],
        dropped,
        columns,
        conventions.heading_units(time_unit),
        "heading",
    )
    table[:, 0] *= conventions.TIME_UNITS[time_unit]
    limits = (_GNSS_LIMITS[0], (-360.0, 360.0), (1e-6, 180.0))
    table, numbers = _limited(path, table, numbers, HEADING_COLUMNS, limits, dropped, True)
    there = np.isfinite(table[:, 1])
    table = _in_order(path, table[there], numbers[there], dropped, "headings")
    if table.shape[0] < 2:
        raise _too_few(path, table, "heading", dropped)
    return table[:, 0].copy(), *np.radians(table[:, 1:]).T, dropped


def is_nmea(path: Path, lenient: bool = False) -> bool:
    """Whether `read_fixes` takes a file for NMEA sentences. Raises FileError, OSError as it does."""
    return has_sentences(read_lines(path, Dropped(lenient)))


def _far(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two rows of fixes lie farther apart than anything flies."""
    ecef = earth.ecef_from_llh(np.column_stack([np.radians([a[1:3], b[1:3]]), [a[3], b[3]]]))
    return bool(np.linalg.norm(ecef[0] - ecef[1]) > 1000.0 * max(b[0] - a[0], 1.0))


def _columns(
    table: TextTable,
    wanted: tuple[str, ...],
    optional: tuple[str, ...],
    dropped: Dropped,
    columns: Mapping[str, str],
    units: Mapping[str, ColumnUnit],
    section: str = "",
) -> tuple[np.ndarray, np.ndarray]:
    """Columns of a table as of `TextTable.read`; columns: those of them that have another name in the file; units: that
    each is to have. section: of the log, whose key `columns` gives other names."""
    ours = wanted
    for name, unit in units.items():
        key = f"{section}.{unit.key}" if unit.key else ""
        table.check_unit(columns.get(name, name), unit.due, unit.known, key)
    wanted, optional, may_be_empty = (
        tuple(columns.get(name, name) for name in names) for names in (wanted, optional, _MAY_BE_EMPTY)
    )
    try:
        return table.read(wanted, optional, may_be_empty, dropped)
    except FileError as error:
        missing = [name for name, there in zip(ours, wanted, strict=True) if table.find(there) is None]
        if not section or not missing:
            raise
        cure = f"write the file's names: `{section}: {{{_naming(table, missing, units)}}}`"
        raise FileError(error.line, f"{error.message}; {cure}", error.path) from None


def _naming(table: TextTable, missing: list[str], units: Mapping[str, ColumnUnit]) -> str:
    """Keys for columns that the header lacks: names and units of those that have another unit in brackets."""
    names, keys = [], {}
    for name in missing:
        unit = units.get(name, ColumnUnit("", "", ()))
        for there in table.names if unit.key else ():
            found = bracketed_unit(there)
            if found in unit.known and column_base(there) in (name, name.split("_")[0]):
                names.append(f'{name}: "{there}"')
                keys[unit.key] = found
    names = names or [f"{missing[0]}: NAME, ..."]
    return ", ".join([f"columns: {{{', '.join(names)}}}", *(f"{key}: {unit}" for key, unit in keys.items())])


def _limited(
    path: Path,
    table: np.ndarray,
    numbers: np.ndarray,
    names: tuple[str, ...],
    limits: tuple[tuple[float, float], ...],
    dropped: Dropped,
    limited: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Rows within physical limits, and their line numbers.

    A lenient reader omits the rows outside, another refuses the first. If not `limited` both keep them, and note the
    first. Numbers that are not finite are never kept.
    """
    low, high = np.array(limits).T
    good = ((table >= low) & (table <= high)) | (np.isnan(table) & np.isin(names, _MAY_BE_EMPTY))
    keep = np.all(good, axis=1)
    for row in np.flatnonzero(~keep):
        first = int(np.argmin(good[row]))
        value = float(table[row, first])
        try:
            within(path, int(numbers[row]), value, *limits[first], names[first])
        except FileError as error:
            if limited or not np.all(np.isfinite(table[row]) | good[row]):
                dropped.damaged("rows left out", error)
            else:
                keep[row] = True
                error.salvageable, error.outside = True, (names[first], value, limits[first])
                dropped.outside = dropped.outside or error
    return table[keep], numbers[keep]


def _too_few(path: Path, table: np.ndarray, what: str, dropped: Dropped) -> FileError:
    """The error for a file that leaves too few rows, and where the others went."""
    return FileError(0, "; ".join([f"only {several(table.shape[0], f'usable {what}')}", *dropped.reasons()]), path)


def _in_order(path: Path, table: np.ndarray, numbers: np.ndarray | None, dropped: Dropped, what: str) -> np.ndarray:
    """Rows by time, each time once; numbers: of their lines, None where the times are checked already.

    Raises FileError where the time goes back by more than a minute, or on by days.
    """
    if numbers is not None:
        one_recording(path, table[:, 0], numbers.tolist())
    dropped.add(f"{what} out of order; navsim sorted them", int(np.sum(np.diff(table[:, 0]) < 0.0)))
    table = table[np.argsort(table[:, 0], kind="stable")]
    twice = np.diff(table[:, 0], prepend=-np.inf) <= 0.0
    dropped.add(f"{what} with the time of another one", twice.sum())
    return table[~twice]
