"""Almanac files: GLONASS and GPS of the Russian IAC (`.agl`, `.agp`), YUMA, SEM (`.al3`), two-line elements.

IAC files [1] have three lines a satellite.

- Line a: day month year, seconds of receipt.
- Line b of `.agl`: slot, frequency channel, health (1 = healthy), day month year, t_lambda s (Moscow time), tau_UTC,
  tau_GPS, tau.
- Line c of `.agl`: lambda, delta i, omega (semicircles), eccentricity, delta T (s), rate of delta T.
- Line b of `.agp`: PRN, health (0 = healthy), week, t_alm s, day month year, t_alm, af0, af1, rate of the node
  (semicircles/s).
- Line c of `.agp`: node, inclination, omega (semicircles), eccentricity, sqrt(A), M0 (semicircles).

Sources:

- [1] the IAC's description of its files.
- [2] ICD-GPS-870, appendices (YUMA, SEM).
- [3] IS-GPS-200, table 20-VI.
- [4] Vallado et al., Revisiting Spacetrack Report 3, AIAA 2006-6753 (two-line elements).
"""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navsim.formats.text import FileError, integer, number, read_lines, within
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, gps, tle
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.constellations.systems import GLONASS, GPS, SYSTEMS, UNTITLED, System

_Row = tuple[tuple[int, int], tuple[float, ...]]
"""A record: lines of its head and of its orbit, its numbers."""
_EPOCH = datetime.date(1970, 1, 1)
_AGL_FIELDS, _AGP_FIELDS = {"b": 10, "c": 6}, {"b": 11, "c": 6}
_MOST_LINES = 200_000
"""Two-line elements of everything in orbit have less than half of that."""
ALMANAC_REACH = np.inf
"""Reach of an almanac: unlimited; the caller checks its age."""


@dataclass(frozen=True)
class AlmanacFile:
    """Content of an almanac file.

    constellations: one a system; not_used: messages about unused parts; untitled: number of two-line elements of
    unknown systems, which are in no constellation.
    """

    constellations: tuple[Constellation, ...]
    not_used: tuple[str, ...] = ()
    untitled: int = 0


def read_almanac(path: Path, near: float, untitled: System | None = None) -> AlmanacFile:
    """Read an almanac file of any known format, recognised by its content.

    near: UTC (POSIX s) that decides between GPS weeks that differ by a multiple of 1024. untitled: the system of
    two-line elements without names. Raises FileError with the line, or OSError.
    """
    lines = _numbered(path)
    first = lines[0][1]
    if re.match(r"\s*\**\s*Week\s+\d+\s+almanac", first, re.IGNORECASE):
        return AlmanacFile((_yuma(path, lines, near),))
    plain = [(n, line) for n, line in lines if not line.startswith("#")]
    if any(re.match(r"1 [ 0-9A-Z]\d{4}[A-Z ]", line) and len(line) >= 68 for _, line in plain[:2]):
        return _split(_tle(path, plain), untitled)
    if re.match(r"\s*\d+\s+\S*[A-Za-z]", first):
        return AlmanacFile((_sem(path, lines, near),))
    if len(lines) > 1 and len(lines[1][1].split()) == _AGP_FIELDS["b"]:
        return AlmanacFile((_agp(path, lines, near),))
    return AlmanacFile((_agl(path, lines),))


def _numbered(path: Path) -> list[tuple[int, str]]:
    """Lines that are not blank, each with its number. Raises FileError if there is none, or too many."""
    lines = read_lines(path)
    if len(lines) > _MOST_LINES:
        raise FileError(0, f"the file has {len(lines):,} lines; an almanac has at most {_MOST_LINES:,}", path)
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip()]
    if not numbered:
        raise FileError(0, "the file is empty", path)
    return numbered


def _agl(path: Path, lines: list[tuple[int, str]]) -> glonass.GlonassAlmanac:
    records = [_agl_record(path, block) for block in _threes(path, lines)]
    _once(path, [r[0] for r in records], [lines[3 * i + 1][0] for i in range(len(records))], "slot")
    slot, channel, health, day, time, lam, di, omega, ecc, dt, dt_rate = np.array(records, dtype=float).T
    return glonass.GlonassAlmanac(
        slot=slot.astype(int),
        healthy=health == 1.0,
        day=day,
        node_time=time,
        node_longitude=lam * np.pi,
        inclination=glonass.FDMA_MEAN_INCLINATION + di * np.pi,
        perigee=omega * np.pi,
        eccentricity=ecc,
        period=glonass.FDMA_MEAN_PERIOD + dt,
        period_rate=dt_rate,
        channel=channel.astype(int),
    )


def _threes(path: Path, lines: list[tuple[int, str]]) -> list[list[tuple[int, str]]]:
    blocks = [lines[first : first + 3] for first in range(0, len(lines), 3)]
    if len(blocks[-1]) < 3:
        raise FileError(blocks[-1][-1][0], "the file ends within a satellite: each has three lines", path)
    return blocks


def _once(path: Path, names: list[float], where: list[int], what: str) -> None:
    for index, name in enumerate(names):
        if name in names[:index]:
            raise FileError(where[index], f"{what} {name:.0f} occurs twice in the file", path)


def _agl_record(path: Path, block: list[tuple[int, str]]) -> tuple[float, ...]:
    numbers = _iac_numbers(path, block, _AGL_FIELDS)
    line_b, line_c = block[1][0], block[2][0]
    slot, channel, health, day, month, year, time = numbers["b"][:7]
    lam, di, omega, ecc, dt, dt_rate = numbers["c"]
    date = _date(path, line_b, year, month, day)
    within(path, line_b, slot, 1, GLONASS.slots, "slot")
    within(path, line_b, channel, -7, 24, "frequency channel")
    within(path, line_b, time, 0.0, timescales.DAY, "time of the ascending node in s")
    within(path, line_c, lam, -1.0, 1.0, "longitude of the node in semicircles")
    within(path, line_c, di, -0.1, 0.1, "correction to inclination in semicircles")
    within(path, line_c, omega, -1.0, 1.0, "argument of perigee in semicircles")
    within(path, line_c, ecc, 0.0, 0.05, "eccentricity")
    within(path, line_c, dt, -3.6e3, 3.6e3, "correction to the period in s")
    within(path, line_c, dt_rate, -0.01, 0.01, "rate of the period in s per orbit")
    return slot, channel, health, float((date - _EPOCH).days), time, lam, di, omega, ecc, dt, dt_rate


def _agp(path: Path, lines: list[tuple[int, str]], near: float) -> gps.KeplerianEphemerides:
    rows: list[_Row] = []
    for block in _threes(path, lines):
        numbers = _iac_numbers(path, block, _AGP_FIELDS)
        line_b, line_c = block[1][0], block[2][0]
        prn, health, week, toa, day, month, year, _, af0, af1, omega_dot = numbers["b"]
        omega0, i, omega, e, sqrt_a, m0 = numbers["c"]
        _date(path, line_b, year, month, day)
        rows.append(((line_b, line_c), (prn, health, week, toa, e, np.pi * i, np.pi * omega_dot, sqrt_a,
                     np.pi * omega0, np.pi * omega, np.pi * m0, af0, af1)))  # fmt: skip
    return _gps(path, rows, near)


def _iac_numbers(path: Path, block: list[tuple[int, str]], due: dict[str, int]) -> dict[str, list[float]]:
    (line_a, a), (line_b, b), (line_c, c) = block
    if len(_numbers(path, line_a, a)) != 4:
        raise FileError(line_a, "expected day, month, year and seconds of receipt", path)
    out = {}
    for line, text, name in ((line_b, b, "b"), (line_c, c, "c")):
        out[name] = _numbers(path, line, text)
        if len(out[name]) != due[name]:
            raise FileError(line, f"expected {due[name]} numbers, found {len(out[name])}", path)
    return out


def _numbers(path: Path, line: int, text: str) -> list[float]:
    return [number(path, line, word, "an element") for word in text.split()]


def _date(path: Path, line: int, year: float, month: float, day: float) -> datetime.date:
    try:
        return datetime.date(int(year), int(month), int(day))
    except (ValueError, OverflowError) as error:
        raise FileError(line, f"no such date: {error}", path) from error


_YUMA = (
    "ID", "Health", "Eccentricity", "Time of Applicability", "Orbital Inclination", "Rate of Right Ascen", "SQRT(A)",
    "Right Ascen at", "Argument of Perigee", "Mean Anom", "Af0", "Af1", "week",
)  # fmt: skip


def _yuma(path: Path, lines: list[tuple[int, str]], near: float) -> gps.KeplerianEphemerides:
    """[2]: a headline of asterisks, then thirteen lines `name: value` a satellite."""
    rows: list[_Row] = []
    at = 0
    while at < len(lines):
        if "almanac" not in lines[at][1].lower():
            raise FileError(
                lines[at][0], "expected a headline such as ******** Week 866 almanac for PRN-01 ********", path
            )
        if "GLO" in lines[at][1].upper():
            raise FileError(lines[at][0], "YUMA files of GLONASS give no slots; use an .agl file", path)
        block = lines[at + 1 : at + 1 + len(_YUMA)]
        values = []
        for due, (line, text) in zip(_YUMA, block, strict=False):
            name, colon, value = text.partition(":")
            if not colon or not name.strip().lower().startswith(due.lower()):
                raise FileError(line, f"expected '{due}: value'", path)
            values.append(number(path, line, value, due))
        if len(values) < len(_YUMA):
            raise FileError(lines[-1][0], f"the satellite has too few lines: {len(_YUMA)} follow each headline", path)
        prn, health, e, toa, i, omega_dot, sqrt_a, omega0, omega, m0, af0, af1, week = values
        rows.append(((block[0][0], block[2][0]), (prn, health, week, toa, e, i, omega_dot, sqrt_a, omega0, omega, m0,
                     af0, af1)))  # fmt: skip
        at += 1 + len(_YUMA)
    return _gps(path, rows, near)


_SEM_LINES = (1, 1, 1, 3, 3, 3, 1, 1)
"""Number of values in each line of a SEM record: PRN, SVN, URA, (e, i, node rate), (sqrt(A), node, perigee), (M0, af0,
af1), health, configuration."""
_SEM_INCLINATION = 0.30
"""Semicircles that SEM's inclination is counted from [2, 3]."""


def _sem(path: Path, lines: list[tuple[int, str]], near: float) -> gps.KeplerianEphemerides:
    count = integer(path, lines[0][0], lines[0][1].split()[0], "the number of records")
    within(path, lines[0][0], count, 1, GPS.highest, "the number of records")
    if len(lines) < 2:
        raise FileError(lines[0][0], "the file ends after its headline", path)
    head = _numbers(path, *lines[1])
    if len(head) != 2:
        raise FileError(lines[1][0], "expected the week and the time of applicability", path)
    week, toa = head
    rows: list[_Row] = []
    for record in range(count):
        block = lines[2 + len(_SEM_LINES) * record : 2 + len(_SEM_LINES) * (record + 1)]
        if len(block) < len(_SEM_LINES):
            raise FileError(lines[-1][0], f"the headline announces {count} satellites, {record} are complete", path)
        values: list[float] = []
        for due, (line, text) in zip(_SEM_LINES, block, strict=True):
            found = _numbers(path, line, text)
            if len(found) != due:
                raise FileError(line, f"expected {due} number(s), found {len(found)}", path)
            values += found
        prn, _, _, e, i, omega_dot, sqrt_a, omega0, omega, m0, af0, af1, health, _ = values
        rows.append(((block[0][0], block[3][0]), (prn, health, week, toa, e, np.pi * (_SEM_INCLINATION + i),
                     np.pi * omega_dot, sqrt_a, np.pi * omega0, np.pi * omega, np.pi * m0, af0, af1)))  # fmt: skip
    if len(lines) > 2 + len(_SEM_LINES) * count:
        raise FileError(lines[2 + len(_SEM_LINES) * count][0], f"more satellites than the announced {count}", path)
    return _gps(path, rows, near)


_GPS_LIMITS = (
    ("PRN", 1, GPS.highest),
    ("health", 0, 255),
    ("week", 0, 10000),
    ("time of applicability in s", 0, timescales.WEEK),
    ("eccentricity", 0.0, 0.2),
    ("inclination in rad", 0.0, np.pi),
    ("rate of the node in rad/s", -1e-6, 1e-6),
    ("sqrt(A)", 4000.0, 8000.0),
    ("node in rad", -20.0, 20.0),
    ("perigee in rad", -20.0, 20.0),
    ("mean anomaly in rad", -20.0, 20.0),
    ("af0", -0.1, 0.1),
    ("af1", -1e-6, 1e-6),
)


def _gps(path: Path, rows: list[_Row], near: float) -> gps.KeplerianEphemerides:
    """Numbers of a row: PRN, health, week, toa, e, i, node rate, sqrt(A), node, perigee, M0, af0, af1; SI and rad."""
    for (head, orbit), values in rows:
        for index, (value, (name, low, high)) in enumerate(zip(values, _GPS_LIMITS, strict=True)):
            within(path, head if index < 4 else orbit, value, low, high, name)
    _once(path, [values[0] for _, values in rows], [lines[0] for lines, _ in rows], "PRN")
    table = np.array([values for _, values in rows], dtype=float)
    # old almanacs give the week modulo 1024 (or 256): the nearest such week
    week = np.array([w if w >= 1024 else timescales.full_week(int(w), near) for w in table[:, 2]], dtype=float)
    toe = week * timescales.WEEK + table[:, 3]
    return gps.KeplerianEphemerides(
        gps.Elements.of(
            prn=table[:, 0].astype(int), healthy=table[:, 1] == 0.0, toe=toe, toc=toe, e=table[:, 4], i0=table[:, 5],
            omega_dot=table[:, 6], sqrt_a=table[:, 7], omega0=table[:, 8], omega=table[:, 9], m0=table[:, 10],
            af0=table[:, 11], af1=table[:, 12],
        ),
        reach=ALMANAC_REACH,
    )  # fmt: skip


def _split(found: tle.TwoLineSets, untitled: System | None) -> AlmanacFile:
    """Two-line elements by system."""
    parts = [found.of(system, untitled=system is untitled) for system in SYSTEMS]
    left = found.systems.count(UNTITLED) if untitled is None else 0
    return AlmanacFile(tuple(part for part in parts if part.names), found.strangers, left)


def _tle(path: Path, lines: list[tuple[int, str]]) -> tle.TwoLineSets:
    """[4]: two lines of elements a satellite, after a line with its name if present; lines without comments."""
    names: dict[str, None] = {}
    titles, firsts, seconds, begins = [], [], [], []
    at = 0
    while at < len(lines):
        begins.append(lines[at][0])
        title = ""
        if not lines[at][1].startswith("1 "):
            title = lines[at][1].removeprefix("0 ").strip()
            at += 1
        pair = lines[at : at + 2]
        if len(pair) < 2:
            raise FileError(lines[-1][0], "the file ends within a satellite: each has two lines of elements", path)
        for due, (line, text) in zip("12", pair, strict=True):
            text = text.rstrip()
            if not text.startswith(due + " ") or len(text) != 69 or "_" in text:
                raise FileError(line, f"expected line {due} of two-line elements with 69 characters", path)
            digits = sum(int(c) if c.isdecimal() else c == "-" for c in text[:68])
            if text[68] != str(digits % 10):
                raise FileError(line, f"the checksum is {text[68]}, the sum of the line {digits % 10}", path)
        name = tle.short_name(title, pair[0][1])
        if name in names:
            raise FileError(pair[0][0], f"{name} occurs twice in the file", path)
        names[name] = None
        titles.append(title)
        firsts.append(pair[0][1].rstrip())
        seconds.append(pair[1][1].rstrip())
        at += 2
    try:
        return tle.TwoLineSets.of_lines(titles, firsts, seconds, begins)
    except ValueError as error:
        raise FileError(0, str(error), path) from None
