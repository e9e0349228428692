"""Recorded ranges, positions of their sources, and a reference trajectory, read from tables and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from navsim.formats.conventions import ANGLE_UNITS, TIME_UNITS
from navsim.formats.nmea import one_recording
from navsim.formats.tables import TextTable
from navsim.formats.text import Dropped, FileError, read_lines
from navsim.geodesy import earth
from navsim.ranging.scenario import (
    LENGTH_UNITS,
    RANGE_UNITS,
    RECEIVER,
    RangesSection,
    RecordedRanges,
    ReferenceSection,
    SourceTable,
)
from navsim.results.findings import several
from navsim.scenario_files.source import Document, InputError, Problem
from navsim.statistics.rounding import digits

LOCAL, GEODETIC = ("x_m", "y_m", "z_m"), ("lat_deg", "lon_deg", "h_m")
"""Columns of positions."""
FARTHEST = 1e6
"""Largest distance between two sources, m, that is no mistake."""
FEWEST_SOURCES = {"two_way": 3, "one_way": 4}
"""Number of sources below which the horizontal position cannot be found."""
SAME_POSITION = 0.01
"""Distance, m, between rows of one source above which they contradict each other."""
LONGEST_RANGE = 1e7
"""Largest absolute range, m, that is no mistake."""
SAME_TIME, FEWEST_PAIRS = 2.0, 10
"""Ranges of two sources are compared if they lie at most SAME_TIME, s, apart, and if there are FEWEST_PAIRS of them."""


@dataclass(frozen=True)
class Sources:
    """Sources: names, positions (s, 3) east, north, up, m; origin: latitude, longitude, height of the local axes (3,),
    None for positions that are given in local axes."""

    names: tuple[str, ...]
    position: np.ndarray
    origin: np.ndarray | None


@dataclass(frozen=True)
class RangeLog:
    """Ranges in order of time: time (m,) s, source (m,) index, range (m,) m, sigma (m,) m and signal (m,) dBm, nan if
    the table has none. warnings: about the files."""

    sources: Sources
    time: np.ndarray
    source: np.ndarray
    range: np.ndarray
    sigma: np.ndarray
    signal: np.ndarray
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class ReferenceTrack:
    """Reference trajectory: time (t,) s, position (t, 3) m."""

    time: np.ndarray
    position: np.ndarray

    def at(self, time: np.ndarray) -> np.ndarray:
        """Positions (m, 3) at times (m,), nan outside of the table."""
        inside = (time >= self.time[0]) & (time <= self.time[-1])
        out = np.stack([np.interp(time, self.time, self.position[:, i]) for i in range(3)], axis=1)
        return np.where(inside[:, None], out, np.nan)


def read_log(scenario: RecordedRanges, document: Document) -> RangeLog:
    """Read and check ranges and sources. Raises InputError, also for fewer sources than a position needs."""
    begin = -np.inf if scenario.start_s is None else scenario.start_s
    end = np.inf if scenario.end_s is None else scenario.end_s
    log = read_ranges(scenario.ranges, scenario.sources, (begin, end), document)
    fewest, heard = FEWEST_SOURCES[scenario.ranges.measurement], log.sources.names
    if len(heard) < fewest:
        raise _refuse(
            document,
            "ranges.file",
            f"ranges of {several(len(heard), 'source')} ({', '.join(heard)}); a position from "
            f"{scenario.ranges.measurement} ranges needs {fewest} at least. Fewer can aid an IMU in `kind: replay` "
            "(docs/replay.md), or be simulated along a recorded flight (docs/recorded-path.md)",
        )
    return log


def read_ranges(ranges: RangesSection, places: SourceTable, span: tuple[float, float], document: Document) -> RangeLog:
    """Read and check ranges in a span of time, s, and their sources. Raises InputError."""
    sources = _sources(places, document)
    if ranges.measurement == "one_way" and RECEIVER in sources.names:
        key = "sources.positions" if places.positions else "sources.file"
        message = f"a source is named {RECEIVER}, as the clock of the receiver is; give it another name"
        raise _refuse(document, key, message)
    tables = [_ranges(ranges, document, k, sources) for k in range(len(ranges.file))]
    time, index, values, sigma, signal = (np.concatenate(part) for part in zip(*tables, strict=True))
    warnings = []
    backwards = int(np.sum(np.diff(time) < 0.0))
    if backwards > max(1, len(tables) - 1) and backwards > 0.02 * time.size:
        raise _refuse(
            document,
            "ranges.columns",
            f"{several(backwards, 'time')} of {time.size} in {', '.join(ranges.file)}"
            " run backwards: is another column the time? Name it with `ranges.columns: {t_s: ...}`",
        )
    if backwards:
        warnings.append(f"{several(backwards, 'range')} out of order of time, sorted")
    order = np.argsort(time, kind="stable")
    order = order[(time[order] >= span[0]) & (time[order] <= span[1])]
    if not order.size:
        raise _refuse(
            document,
            "start_s",
            f"no range lies between start_s and end_s; the ranges are from {time.min():.1f} to {time.max():.1f} s",
        )
    heard = np.unique(index[order])
    silent = [name for i, name in enumerate(sources.names) if i not in heard]
    if silent:
        of_zeros = ": a column of zeros has none" if ranges.source_columns else ""
        warnings.append(f"no range is from {', '.join(silent)}{of_zeros}")
    kept = np.searchsorted(heard, index[order])
    there = Sources(tuple(sources.names[i] for i in heard), sources.position[heard], sources.origin)
    log = RangeLog(there, time[order], kept, values[order], sigma[order], signal[order], tuple(warnings))
    _check_ranges(log, ranges, document)
    return log


def read_reference(reference: ReferenceSection, sources: Sources, document: Document) -> ReferenceTrack:
    """The reference trajectory in the axes of the sources. Raises InputError."""
    key = "reference"
    path = document.resolve((key, "file"), reference.file)
    try:
        table = TextTable.of(path, read_lines(path))
        columns = reference.columns
        names = _position_columns(table, columns)
        values, lines = table.read([columns.get("t_s", "t_s"), *names], (), (), Dropped())
        _finite(path, values, lines)
    except (FileError, OSError) as error:
        raise _file_error(document, f"{key}.file", error) from None
    time = values[:, 0] * TIME_UNITS[str(reference.time_unit)]
    if np.any(np.diff(time) <= 0.0):
        at = int(np.argmax(np.diff(time) <= 0.0)) + 1
        raise _refuse(document, f"{key}.file", f"line {lines[at]}: the time does not increase ({time[at]:.12g} s)")
    is_geodetic = _is_geodetic(table, columns)
    if is_geodetic != (sources.origin is not None):
        kind = ("geodetic", "local")[not is_geodetic]
        raise _refuse(document, f"{key}.file", f"its positions are {kind}, those of the sources are not")
    position = _in_si(values[:, 1:], is_geodetic, str(reference.length_unit), str(reference.angle_unit))
    if sources.origin is not None:
        position = _local(position, sources.origin)
    return ReferenceTrack(time, position)


def _sources(section: SourceTable, document: Document) -> Sources:
    """The sources of the list or the table."""
    if section.positions:
        names = [one.name for one in section.positions]
        geodetic = [one.position_m is None for one in section.positions]
        if len(set(geodetic)) > 1:
            raise _refuse(document, "sources.positions", "some positions are local, others geodetic; write all alike")
        position = np.array([
            (one.lat_deg, one.lon_deg, one.height_m) if one.position_m is None else one.position_m
            for one in section.positions
        ], dtype=float)  # fmt: skip
        key, is_geodetic = "sources.positions", geodetic[0]
        if is_geodetic:
            position = _in_si(position, True, "m", "deg")
    else:
        names, position, is_geodetic = _source_table(section, document)
        key = "sources.file"
    origin = None
    if is_geodetic:
        if np.any(np.abs(position[:, 0]) > 0.5 * np.pi):
            worst = int(np.argmax(np.abs(position[:, 0])))
            raise _refuse(
                document,
                key,
                f"the latitude of {names[worst]} is {np.degrees(position[worst, 0]):g} deg: are the "
                "columns of latitude and longitude swapped?",
            )
        origin = position.mean(axis=0)
        position = _local(position, origin)
    apart = np.linalg.norm(position[:, None] - position[None], axis=2)
    if apart.max() > FARTHEST:
        a, b = np.unravel_index(int(np.argmax(apart)), apart.shape)
        raise _refuse(
            document,
            key,
            f"{names[a]} and {names[b]} are {apart.max() / 1e3:.0f} km apart; check the units "
            "(length_unit, angle_unit) and the order of the columns",
        )
    near = np.argwhere((apart < SAME_POSITION) & np.triu(np.ones(apart.shape, bool), 1))
    if near.size:
        a, b = near[0]
        raise _refuse(document, key, f"{names[a]} and {names[b]} have the same position; correct one of them")
    return Sources(tuple(names), position, origin)


def _source_table(section: SourceTable, document: Document) -> tuple[list[str], np.ndarray, bool]:
    assert section.file is not None
    path = document.resolve(("sources", "file"), section.file)
    try:
        table = TextTable.of(path, read_lines(path))
        names = table.texts(section.columns.get("source", "source"))
        columns = _position_columns(table, section.columns)
        values, lines = table.read(columns, (), (), Dropped())
        _finite(path, values, lines)
    except (FileError, OSError) as error:
        raise _file_error(document, "sources.file", error) from None
    geodetic = _is_geodetic(table, section.columns)
    values = _in_si(values, geodetic, str(section.length_unit), str(section.angle_unit))
    first = {name: names.index(name) for name in names}
    scale = np.array([earth.A, earth.A, 1.0]) if geodetic else np.ones(3)
    for row, name in enumerate(names):
        if np.abs((values[row] - values[first[name]]) * scale).max() > SAME_POSITION:
            raise _refuse(
                document,
                "sources.file",
                f"line {lines[row]}: {name} has another position than on line "
                f"{lines[first[name]]}; give each source one",
            )
    return list(first), values[list(first.values())], geodetic


def _ranges(
    section: RangesSection, document: Document, number: int, sources: Sources
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, source, range, sigma and signal of one file."""
    path = document.resolve(("ranges", "file"), section.file[number])
    names = {name: section.columns.get(name, name) for name in ("t_s", "source", "range_m", "sigma_m", "signal_dbm")}
    try:
        table = TextTable.of(path, read_lines(path))
        table.check_unit(names["t_s"], str(section.time_unit), TIME_UNITS, "ranges.time_unit")
        for name in section.source_columns or (names["range_m"], names["sigma_m"]):
            table.check_unit(name, str(section.range_unit), RANGE_UNITS, "ranges.range_unit")
        if section.source_columns:
            whole, lines = table.read(
                [names["t_s"], *section.source_columns], (), list(section.source_columns), Dropped()
            )
            texts = list(section.source_columns.values())
            heard = np.isfinite(whole[:, 1:])
            if section.measurement == "two_way" and (some := (heard & (whole[:, 1:] != 0.0)).any(axis=0)).any():
                heard &= some  # autopilots write 0 for a beacon that is not there
            row, column = np.nonzero(heard)
            values = np.full((row.size, 4), np.nan)
            values[:, 0], values[:, 1] = whole[row, 0], whole[:, 1:][heard]
            text = [texts[c] for c in column]
            lines = lines[row]
        else:
            optional = (names["sigma_m"], names["signal_dbm"])
            values, lines = table.read((names["t_s"], names["range_m"]), optional, optional, Dropped())
            text = table.texts(names["source"])
        time = values[:, 0] * TIME_UNITS[str(section.time_unit)]
        one_recording(path, time, lines.tolist())
    except (FileError, OSError) as error:
        raise _file_error(document, "ranges.file", error) from None
    index = {name: i for i, name in enumerate(sources.names)}
    unknown = sorted({name for name in text if name not in index})
    if unknown:
        at = lines[next(i for i, name in enumerate(text) if name in unknown)]
        hint = ""
        if len(unknown) > len(sources.names) + 5:
            hint = "; is another column the source? Name it with `ranges.columns: {source: ...}`"
        raise _refuse(
            document,
            "ranges.file",
            f"{path.name}, line {at}: no position is known of {', '.join(unknown[:8])}; "
            f"`sources` has {', '.join(sources.names[:20])}{hint}",
        )
    factor = RANGE_UNITS[str(section.range_unit)]
    return time, np.array([index[name] for name in text]), values[:, 1] * factor, values[:, 2] * factor, values[:, 3]


def _check_ranges(log: RangeLog, section: RangesSection, document: Document) -> None:
    """Refuse ranges whose unit, sign or columns cannot be right.

    Two ranges of one time differ at most by the distance of their sources, and add up to it at least.
    """
    two_way = section.measurement == "two_way"
    middle = np.array([np.median(log.range[log.source == i]) for i in range(len(log.sources.names))])
    if np.abs(middle).max() > LONGEST_RANGE:
        raise _refuse(
            document,
            "ranges.range_unit",
            f"ranges are {digits(np.abs(middle).max())} m long (median of a source); check "
            "ranges.range_unit, and that the column is the range",
        )
    if two_way and np.mean(log.range < 0.0) > 0.01:
        raise _refuse(
            document,
            "ranges.columns",
            f"{np.mean(log.range < 0.0):.0%} of the two-way ranges are negative; is another "
            "column the range, or are they pseudoranges (`measurement: one_way`)?",
        )
    if two_way and middle.max() == middle.min() == 0.0:
        raise _refuse(document, "ranges.columns", "all ranges are zero; is another column the range?")
    if np.any(log.sigma <= 0.0):
        raise _refuse(document, "ranges.columns", "a sigma of a range is not positive; is another column the sigma?")
    if not two_way:
        return
    difference, total = _pairs(log)
    shortest = float(middle.min())
    contradiction = _contradiction(log.sources, difference, total, shortest)
    if contradiction is None:
        return
    unit = str(section.range_unit)
    scales = {other: factor / RANGE_UNITS[unit] for other, factor in RANGE_UNITS.items()}
    fitting = [
        other
        for other, scale in sorted(scales.items(), key=lambda pair: abs(np.log(pair[1])))
        if _contradiction(log.sources, difference * scale, total * scale, shortest * scale) is None
    ]
    cure = f"they would fit in {fitting[0]}. " if fitting else ""
    raise _refuse(
        document,
        "ranges.range_unit",
        f"{contradiction}: {cure}Check ranges.range_unit ({unit}), the unit of the positions, and which range is whose",
    )


def _pairs(log: RangeLog) -> tuple[np.ndarray, np.ndarray]:
    """Medians, m, of the difference (s, s) and of the sum (s, s) of ranges of two sources at nearly the same time.

    The motion between them, at the speed that 90 % of the ranges of all sources change with at most, is subtracted from
    differences and added to sums. Zero and infinite for sources without enough ranges at the same time.
    """
    number = len(log.sources.names)
    each = [(log.time[log.source == i], log.range[log.source == i]) for i in range(number)]
    steps = np.concatenate([[np.diff(t), np.abs(np.diff(r))] for t, r in each], axis=1)
    steps = steps[:, steps[0] > 0.0]
    speed = float(np.quantile(steps[1] / steps[0], 0.9)) if steps.size else 0.0
    difference, total = np.zeros((number, number)), np.full((number, number), np.inf)
    for a, b in combinations(range(number), 2):
        (t, r), (other_t, other_r) = each[a], each[b]
        after = np.clip(np.searchsorted(other_t, t), 1, max(other_t.size - 1, 1))
        nearest = np.where(t - other_t[after - 1] < other_t[after % other_t.size] - t, after - 1, after % other_t.size)
        apart = np.abs(t - other_t[nearest])
        near = apart <= SAME_TIME
        if near.sum() >= FEWEST_PAIRS:
            one, two, motion = r[near], other_r[nearest[near]], speed * apart[near]
            difference[a, b] = difference[b, a] = np.median(np.abs(one - two) - motion)
            total[a, b] = total[b, a] = np.median(one + two + motion)
    return difference, total


def _contradiction(sources: Sources, difference: np.ndarray, total: np.ndarray, shortest: float) -> str | None:
    """Contradiction of the triangle inequality by two-way ranges, None if there is none.

    difference, total: of `_pairs`. shortest: the smallest median of a source's ranges, m.
    """
    names, apart = sources.names, np.linalg.norm(sources.position[:, None] - sources.position[None], axis=2)
    tolerance = 1.0 + 0.2 * shortest
    for excess, length, words in (
        (difference - apart, difference, "differ by {} m or more"), (apart - total, total, "add up to {} m or less"),
    ):  # fmt: skip
        excess = np.where(np.eye(len(names), dtype=bool), -np.inf, excess)
        a, b = np.unravel_index(int(np.argmax(excess)), excess.shape)
        if excess[a, b] > tolerance:
            return (
                f"the ranges of {names[a]} and {names[b]} at the same time {words.format(digits(length[a, b], 4))} "
                f"(median), but these are {digits(apart[a, b], 4)} m apart"
            )
    return None


def _position_columns(table: TextTable, columns: Mapping[str, str]) -> list[str]:
    """Names in the file of the columns of positions."""
    names = GEODETIC if _is_geodetic(table, columns) else LOCAL
    return [columns.get(name, name) for name in names]


def _is_geodetic(table: TextTable, columns: Mapping[str, str]) -> bool:
    """Whether positions are geodetic: by the columns that are named, else by those that there are."""
    if any(name in columns for name in (*LOCAL, *GEODETIC)):
        return any(name in columns for name in GEODETIC)
    return table.find("lat_deg") is not None


def _in_si(position: np.ndarray, geodetic: bool, length: str, angle: str) -> np.ndarray:
    """Positions (n, 3) in m, or latitude and longitude in rad and height in m."""
    out = position * LENGTH_UNITS[length]
    if geodetic:
        out[:, :2] = np.radians(position[:, :2] * ANGLE_UNITS[angle])
    return out


def _local(llh: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """East, north, up (n, 3) of geodetic positions from an origin, m."""
    ned = (earth.ecef_from_llh(llh) - earth.ecef_from_llh(origin)) @ earth.ned_matrix(origin).T
    return np.stack([ned[:, 1], ned[:, 0], -ned[:, 2]], axis=1)


def _finite(path: Path, values: np.ndarray, lines: np.ndarray) -> None:
    """Raise FileError at the first row with a number that is not finite."""
    good = np.isfinite(values).all(axis=1)
    if not good.all():
        raise FileError(int(lines[int(np.argmin(good))]), "a position or time is not a number", path)


def _refuse(document: Document, key: str, message: str) -> InputError:
    return InputError([Problem(document.place(tuple(key.split("."))), key, message)])


def _file_error(document: Document, key: str, error: FileError | OSError) -> InputError:
    return _refuse(document, key, str(error))
