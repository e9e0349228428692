"""RINEX navigation files, versions 2, 3 and 4: broadcast messages of GPS, GLONASS, Galileo, BeiDou and QZSS.

Why not georinex, the known reader: it needs half a minute for a day of mixed messages, fails on the five-line GLONASS
records of version 3.05 and does not read version 4. Messages of other systems and kinds are counted and skipped.

Sources:

- [1] RINEX 2.11 (2007), tables A3-A5, A10, A11.
- [2] RINEX 3.05 (2020), section 8 and tables A5, A6, A10.
- [3] RINEX 4.02 (2024), section 5.4 and the tables of navigation records (they begin with `> EPH`, `> STO`, `> EOP`,
  `> ION`).
- [4] Galileo OS SIS ICD, issue 2.0 (2021), section 5.1.5 (group delays).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from navsim.formats.rinex_write import INAV_SOURCES
from navsim.formats.text import Dropped, FileError, date_and_time, integer, number, read_lines, within
from navsim.gnss import timescales
from navsim.gnss.constellations import gps
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.constellations.glonass_broadcast import StateVectorEphemerides, StateVectors
from navsim.gnss.constellations.systems import BEIDOU, BY_LETTER, GALILEO, GLONASS, GPS, QZSS, SYSTEMS, USUAL, System

_LATEST = 5.0
_NAVIGATION = "N"
"""Type of files of messages, from version 3 on of all systems."""
_KINDS = ("EPH", "STO", "EOP", "ION")
"""Kinds of records of version 4: ephemerides, offsets of time systems, Earth orientation, ionosphere."""
_LARGEST_DELAY_M = 8
"""Largest group delay that satellites send, m: 25 ns of BeiDou's."""
_SAME = {"D2": BEIDOU.message}
"""Messages with the same content as others: that of geostationary BeiDou satellites."""
_KLOBUCHAR = ("LNAV", "CNVX")
"""Messages of GPS that send Klobuchar's coefficients; they are the same ones."""


_TIME_OFFSETS = {"GAGP": GALILEO, "GPGA": GALILEO, "QZGP": QZSS}
"""Offsets of times of systems to that of GPS in headers of version 3, by their codes; GPGA is an older name [2]."""


@dataclass(frozen=True)
class TimeOffset:
    """System time minus GPS time according to its messages: a0, s, and its rate a1 at `reference`, gpst, s."""

    a0: float
    a1: float
    reference: float

    def at(self, gpst: float) -> float:
        """The offset at a time, s."""
        return self.a0 + self.a1 * (gpst - self.reference)


@dataclass(frozen=True)
class Navigation:
    """Messages of a navigation file."""

    elements: Mapping[tuple[System, str], gps.Elements]
    """By system and message."""
    glonass: StateVectors | None
    """None if the file has none."""
    klobuchar: tuple[np.ndarray, np.ndarray] | None
    """alpha, beta (4,) or None; the newest of several."""
    leap_seconds: int | None
    """GPS - UTC in s, None if no line contains it."""
    skipped: dict[str, int] = field(default_factory=dict)
    """Records that are not modelled or not wanted: by letter of the system, in version 4 by system and message (`G
    CNAV`, `STO G LNAV`)."""
    left_out: tuple[str, ...] = ()
    """Messages about omitted parts of a damaged file."""
    offsets: Mapping[System, tuple[int, str]] = field(default_factory=dict)
    """Header lines of version 3 with the offset of a system's time from GPS time, with their numbers
    (`time_offset`)."""

    @property
    def gps(self) -> gps.Elements | None:
        """Elements of GPS; None where the file has none."""
        return self.elements.get((GPS, GPS.message))

    def without_usual(self) -> dict[System, str]:
        """Systems that sent none of the messages that they are flown by, and one that they sent instead."""
        return {of: sent for of, sent in self.elements if (of, of.message) not in self.elements}

    def constellations(self, others: Mapping[System, str] = MappingProxyType({})) -> list[Constellation]:
        """Constellations of these messages, each of its system's usual message type; others: systems with another
        type."""
        out: list[Constellation] = []
        if self.glonass is not None:
            out.append(StateVectorEphemerides(self.glonass))
        for system in SYSTEMS:
            if (records := self.elements.get((system, others.get(system, system.message)))) is not None:
                out.append(gps.KeplerianEphemerides.sent(records, system))
        return out


@dataclass(frozen=True)
class _Record:
    """A record: kind, system, message (none before version 4), numbered lines; ends_file: whether its last line is the
    file's."""

    kind: str
    letter: str
    message: str
    lines: list[tuple[int, str]]
    ends_file: bool


def read_nav(path: Path, lenient: bool = False, systems: Sequence[System] = USUAL) -> Navigation:
    """Read a RINEX 2, 3 or 4 navigation file, compressed or not.

    - `systems`: systems to read; others are skipped.
    - `lenient`: omit incomplete or implausible records, with messages in `left_out`.

    Raises FileError with the line for such records otherwise, and for a damaged header in any case; OSError if the file
    cannot be read.
    """
    dropped = Dropped(lenient)
    lines = read_lines(path, dropped)
    version, system, klobuchar, leap, offsets, first = _header(path, lines)
    wanted = [of for of in _READ if of in systems]
    records: dict[tuple[System, str], list[tuple[float, ...]]] = {}
    usual = dict.fromkeys(_READ, 0)
    skipped: dict[str, int] = {}
    newest = -np.inf
    for record in (_framed if version >= 4.0 else _blocks)(path, lines, first, version, system, dropped):
        kind, letter, message = record.kind, record.letter, record.message
        of = BY_LETTER.get(letter)
        try:
            if kind == "EPH" and of in wanted and _SAME.get(message, message) in ("", of.message, *of.other_messages):
                sent, values = _READ[of](path, record, version, usual[of], dropped)
                records.setdefault((of, sent), []).append(values)
                usual[of] = len(record.lines)
            elif kind == "ION" and of is GPS and message in _KLOBUCHAR:
                time, coefficients = _ionosphere(path, record, version)
                if time >= newest:
                    newest, klobuchar = time, coefficients
            else:
                name = " ".join(part for part in (kind if kind != "EPH" else "", letter, message) if part)
                skipped[name] = skipped.get(name, 0) + 1
        except FileError as error:
            dropped.damaged("messages left out", error)
    if not records:
        none = " and ".join(f"no {of.title}" for of in wanted)
        sought = ", ".join(dict.fromkeys(m for of in wanted for m in (of.message, *of.other_messages)))
        others = f"; navsim skipped {', '.join(skipped)}" if skipped else ""
        has = [of.name for of in _READ if of not in wanted and any(name.split()[0] == of.letter for name in skipped)]
        cure = f"; write `systems: [{', '.join(has)}]` to use them" if has and set(wanted) == set(USUAL) else ""
        raise FileError(0, f"the file has {none} message ({sought}){others}{cure}", path)
    elements = {key: _elements(found) for key, found in records.items() if key[0] is not GLONASS}
    for (of, message), rows in elements.items():
        unknown = np.isnan(rows.tgd)
        names = ", ".join(of.satellite(prn) for prn in np.unique(rows.prn[unknown]))
        what = f"{message} messages with a blank group delay; navsim takes it as 0, so ranges of {names} may be off by"
        dropped.add(f"{what} up to {_LARGEST_DELAY_M} m", unknown.sum())
    return Navigation(
        elements,
        _state_vectors(vectors) if (vectors := records.get((GLONASS, GLONASS.message))) else None,
        klobuchar,
        leap,
        skipped,
        dropped.reasons(),
        offsets,
    )


_Header = tuple[float, str, tuple[np.ndarray, np.ndarray] | None, int | None, dict[System, tuple[int, str]], int]


def _header(path: Path, lines: list[str]) -> _Header:
    """Version, system letter, Klobuchar coefficients, leap seconds, offsets of times of systems, index of the first
    line after the header."""
    version, system = rinex_version(path, lines)
    kind = lines[0][20:21]
    of_old_files = {of.old_file: of.letter for of in SYSTEMS if of.old_file}
    if kind not in of_old_files or (version >= 3.0 and kind != _NAVIGATION):
        raise FileError(1, f"a RINEX file of '{lines[0][20:40].strip()}'; give one of navigation messages", path)
    if version < 3.0:
        system = of_old_files[kind]
    corrections: dict[str, np.ndarray] = {}
    offsets: dict[System, tuple[int, str]] = {}
    leap = None
    for index, line in enumerate(lines[1:], 2):
        label = line[60:80].strip()
        if label in ("ION ALPHA", "ION BETA"):
            name = "GPSA" if label.endswith("ALPHA") else "GPSB"
            corrections[name] = np.array([number(path, index, line[2 + 12 * i : 14 + 12 * i], label) for i in range(4)])
        elif label == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
            values = [number(path, index, line[5 + 12 * i : 17 + 12 * i], label) for i in range(4)]
            corrections[line[:4]] = np.array(values)
        elif label == "TIME SYSTEM CORR" and (of := _TIME_OFFSETS.get(line[:4])) is not None:
            offsets[of] = index, line
        elif label == "LEAP SECONDS":
            if line[:6].strip() and _counts_from_gps(line):
                leap = int(within(path, index, integer(path, index, line[:6], "leap seconds"), 0, 100, "leap seconds"))
        elif label == "END OF HEADER":
            both = {"GPSA", "GPSB"} <= corrections.keys()
            ionosphere = (corrections["GPSA"], corrections["GPSB"]) if both else None
            return version, system, ionosphere, leap, offsets, index
    raise FileError(len(lines), "the file ends within its header: no END OF HEADER", path)


def _counts_from_gps(line: str) -> bool:
    """Whether a line LEAP SECONDS has GPS minus UTC: those of other systems are counted from other dates [2]."""
    scale = line[24:27].strip().upper() or GPS.time_system
    return timescales.BEHIND_GPS.get(scale) == 0.0


def time_offset(path: Path, index: int, line: str) -> TimeOffset:
    """Offset of a line TIME SYSTEM CORR [2, table A5]. Raises FileError, also if it has no reference time."""
    names = ("a0", "a1", "reference time", "week")
    places = ((5, 22), (22, 38), (38, 45), (45, 50))
    a0, a1, second, week = (
        number(path, index, line[first:last], f"TIME SYSTEM CORR, {name}")
        for (first, last), name in zip(places, names, strict=True)
    )
    if week == 0.0:
        raise FileError(index, "TIME SYSTEM CORR has no reference time: its week is 0", path)
    return TimeOffset(a0, a1, week * timescales.WEEK + second)


def rinex_version(path: Path, lines: list[str]) -> tuple[float, str]:
    """Version and satellite system of the first line. Raises FileError for anything but RINEX 2, 3 and 4."""
    if lines[0][60:80].strip() != "RINEX VERSION / TYPE":
        raise FileError(1, "not a RINEX file: the first line is not RINEX VERSION / TYPE", path)
    version = number(path, 1, lines[0][:9], "the RINEX version")
    if not 2.0 <= version < _LATEST:
        raise FileError(1, f"RINEX version {version:g}; navsim reads versions 2, 3 and 4", path)
    return version, lines[0][40:41].strip() or GPS.letter


def _end(lines: list[str], first: int, end: int) -> int:
    """Index after the last line from `first` up to `end` that is not blank."""
    while end > first and not lines[end - 1].strip():
        end -= 1
    return end


def _blocks(
    path: Path, lines: list[str], first: int, version: float, system: str, dropped: Dropped
) -> Iterator[_Record]:
    """Records of versions 2 and 3: one begins where the satellite's columns are filled."""
    end = _end(lines, first, len(lines))
    starts = [index for index in range(first, end) if lines[index][:3].strip()]
    if end > first and (not starts or starts[0] > first):
        error = FileError(first + 1, "expected a message that begins with a satellite such as G01", path)
        dropped.damaged("messages left out", error)
    for start, stop in itertools.pairwise([*starts, end]):
        letter = system if version < 3.0 else lines[start][0]
        if letter.isalpha():
            yield _Record("EPH", letter, "", _numbered(lines, start, stop), stop == end)
        else:
            found = lines[start][:3]
            error = FileError(start + 1, f"expected a satellite such as G01, found '{found}'", path)
            dropped.damaged("messages left out", error)


def _framed(
    path: Path, lines: list[str], first: int, version: float, system: str, dropped: Dropped
) -> Iterator[_Record]:
    """Records of version 4: one begins with a line such as `> EPH G01 LNAV`, or `> STO R FDMA` of a whole system."""
    end = _end(lines, first, len(lines))
    starts = [index for index in range(first, end) if lines[index].startswith(">")]
    if end > first and (not starts or starts[0] > first):
        error = FileError(first + 1, "expected a line such as > EPH G01 LNAV, which begins a message", path)
        dropped.damaged("messages left out", error)
    for start, stop in itertools.pairwise([*starts, end]):
        try:
            words = lines[start][1:].split()
            if len(words) < 3 or words[0] not in _KINDS or not words[1][0].isalpha():
                kinds = ", ".join(_KINDS)
                message = f"expected > and one of {kinds}, a satellite, a message; found '{lines[start][:30]}'"
                raise FileError(start + 1, message, path)
            block = _numbered(lines, start + 1, stop)
            if not block:
                raise FileError(start + 1, "no lines follow this line", path)
            satellite = block[0][1][:3].replace(" ", "0")
            if words[0] == "EPH" and satellite != words[1]:
                raise FileError(start + 2, f"the line before announces {words[1]}, here is '{satellite}'", path)
        except FileError as error:
            dropped.damaged("messages left out", error)
            continue
        yield _Record(words[0], words[1][0], words[2], block, stop == end)


def _numbered(lines: list[str], start: int, stop: int) -> list[tuple[int, str]]:
    """Lines with their numbers, less blank ones at the end."""
    return list(enumerate(lines[start : _end(lines, start, stop)], start + 1))


def _check_length(path: Path, record: _Record, due: tuple[int, ...], margin: int) -> None:
    """Whether a record has as many lines as are due, and none breaks off. Raises FileError."""
    there = len(record.lines)
    last, text = record.lines[-1]
    lines_due = " or ".join(str(number_of) for number_of in due)
    if there < min(due):
        raise FileError(last, f"the message ends early: it has {there} of {lines_due} lines", path)
    if there not in due:
        line = record.lines[max(due)][0]
        raise FileError(line, f"the message is too long: it has {there} lines, allowed are {lines_due}", path)
    if record.ends_file and (len(text.rstrip()) - margin) % 19:
        raise FileError(last, "the file ends within a value", path)


def _margin(version: float) -> int:
    """Columns before the first of four values of a line."""
    return 3 if version < 3.0 else 4


def _satellite(path: Path, block: list[tuple[int, str]], version: float, most: int) -> int:
    line, text = block[0]
    satellite = integer(path, line, text[:2] if version < 3.0 else text[1:3], "the satellite")
    within(path, line, satellite, 1, most, "the satellite's number")
    return satellite


def _time(path: Path, block: list[tuple[int, str]], version: float) -> float:
    """A record's epoch as if it were UTC (POSIX s)."""
    line, text = block[0]
    if version < 3.0:
        parts = [text[3:5], text[6:8], text[9:11], text[12:14], text[15:17], text[17:22]]
    else:
        parts = [text[4:8], text[9:11], text[12:14], text[15:17], text[18:20], text[21:23]]
    return date_and_time(path, line, parts)


def _values(path: Path, block: list[tuple[int, str]], version: float, wanted: tuple[str, ...]) -> dict[str, float]:
    """Named fields, four a line (three in the first), `-` for ignored ones. Blank fields are errors, except
    `_IF_UNKNOWN`."""
    margin = _margin(version)
    out = {}
    for place, name in enumerate(wanted, 1):
        if name == "-":
            continue
        line, text = block[place // 4]
        start = margin + 19 * (place % 4)
        piece = text[start : start + 19]
        known = bool(piece.strip()) or name not in _IF_UNKNOWN
        value = number(path, line, piece, name) if known else _UNKNOWN
        out[name] = _IF_UNKNOWN.get(name, value) if value == _UNKNOWN else value
    return out


_ORBIT_FIELDS = (
    "af0", "af1", "af2",
    "iode", "crs", "delta_n", "m0",
    "cuc", "e", "cus", "sqrt_a",
    "toe", "cic", "omega0", "cis",
    "i0", "crc", "omega", "omega_dot",
)  # fmt: skip
_GPS_FIELDS = (
    *_ORBIT_FIELDS,
    "i_dot", "-", "week", "-",
    "ura", "health", "tgd", "iodc",
)  # fmt: skip
_GALILEO_FIELDS = (
    *_ORBIT_FIELDS,
    "i_dot", "source", "week", "-",
    "sisa", "health", "bgd_e5a", "bgd_e5b",
)  # fmt: skip
_BEIDOU_FIELDS = (
    *_ORBIT_FIELDS,
    "i_dot", "-", "week", "-",
    "ura", "health", "tgd", "-",
    "-", "iodc",
)  # fmt: skip
_KEPLERIAN_LIMITS = {
    "e": (0.0, 0.2), "sqrt_a": (4000.0, 8000.0), "toe": (0.0, timescales.WEEK), "i0": (-np.pi, np.pi),
    "omega0": (-2 * np.pi, 2 * np.pi), "omega": (-2 * np.pi, 2 * np.pi), "m0": (-2 * np.pi, 2 * np.pi),
    "delta_n": (-1e-6, 1e-6), "omega_dot": (-1e-6, 1e-6), "i_dot": (-1e-6, 1e-6), "af0": (-0.1, 0.1),
    "af1": (-1e-6, 1e-6), "af2": (-1e-9, 1e-9), "tgd": (-1e-6, 1e-6), "week": (0, 10000), "ura": (0.0, 1e5),
    "sisa": (-1.0, 1e5), "bgd_e5a": (-1e-6, 1e-6), "bgd_e5b": (-1e-6, 1e-6), "source": (0, 1023),
    "cuc": (-1e-3, 1e-3), "cus": (-1e-3, 1e-3), "cic": (-1e-3, 1e-3), "cis": (-1e-3, 1e-3),
    "crc": (-5e3, 5e3), "crs": (-5e3, 5e3),
}  # fmt: skip
_IF_UNKNOWN = {"tgd": np.nan, "bgd_e5a": np.nan, "bgd_e5b": np.nan, "ura": -1.0, "sisa": -1.0}
"""Fields that may be blank, and their values then, as `gps.Elements` has them."""
_ELEMENTS_ORDER = (
    "prn", "healthy", "toe", "toc", "sqrt_a", "e", "i0", "omega0", "omega", "m0", "delta_n", "omega_dot", "i_dot",
    "cuc", "cus", "crc", "crs", "cic", "cis", "af0", "af1", "af2", "tgd", "ura", "iode", "iodc",
)  # fmt: skip


def _keplerian(
    path: Path, record: _Record, version: float, system: System, wanted: tuple[str, ...]
) -> dict[str, float]:
    """Wanted fields of a record of orbital elements, with the further ones of `_ELEMENTS_ORDER`."""
    block = record.lines
    _check_length(path, record, (8,), _margin(version))
    prn, toc = _satellite(path, block, version, system.highest), _time(path, block, version)
    v = _values(path, block, version, wanted)
    for name, (low, high) in _KEPLERIAN_LIMITS.items():
        if name in v and not np.isnan(v[name]) and v[name] != _IF_UNKNOWN.get(name):
            within(path, block[(wanted.index(name) + 1) // 4][0], v[name], low, high, name)
    toc -= timescales.GPS_EPOCH  # the epoch is the system's time, without leap seconds
    # some files give the week modulo 1024, and a message near midnight may belong to the other week: the clock's
    # epoch, a complete date, decides
    toe = v["toe"] + timescales.WEEK * round((toc - v["toe"]) / timescales.WEEK)
    behind = timescales.BEHIND_GPS[system.time_system]
    return v | {"prn": prn, "healthy": float(v["health"] == 0.0), "toe": toe + behind, "toc": toc + behind}


def _in_order(v: dict[str, float]) -> tuple[float, ...]:
    return tuple(v[name] for name in _ELEMENTS_ORDER)


_Read = tuple[str, tuple[float, ...]]
"""Which message a record is of, and its numbers."""


def _gps(path: Path, record: _Record, version: float, _: int, __: Dropped) -> _Read:
    """The fields of a GPS record."""
    return GPS.message, _in_order(_keplerian(path, record, version, GPS, _GPS_FIELDS))


def _qzss(path: Path, record: _Record, version: float, _: int, __: Dropped) -> _Read:
    """The fields of a QZSS record, which are those of GPS."""
    return QZSS.message, _in_order(_keplerian(path, record, version, QZSS, _GPS_FIELDS))


_INAV_CLOCK, _FNAV_CLOCK = 1 << 9, 1 << 8
"""Data sources with the signals of the clock: E5b and E1, E5a and E1 [2]."""
_FNAV_SOURCES = _FNAV_CLOCK | 1 << 1
"""Data sources of a record of F/NAV: its clock, and E5a-I [2]."""


def _galileo(path: Path, record: _Record, version: float, _: int, dropped: Dropped) -> _Read:
    """The fields of a Galileo record: the group delay is that of E1 against the other signal of the message's clock,
    E5b of I/NAV, E5a of F/NAV [4]."""
    v = _keplerian(path, record, version, GALILEO, _GALILEO_FIELDS)
    line = record.lines[(_GALILEO_FIELDS.index("source") + 1) // 4][0]
    source = integer(path, line, f"{v['source']:.10g}", "the data sources")
    by_inav = _is_of_inav(path, line, source, dropped)
    v |= {"tgd": v["bgd_e5b" if by_inav else "bgd_e5a"], "ura": v["sisa"], "iodc": v["iode"]}
    return GALILEO.message if by_inav else GALILEO.other_messages[0], _in_order(v)


def _is_of_inav(path: Path, line: int, source: int, dropped: Dropped) -> bool:
    """Whether data sources mark I/NAV, else F/NAV.

    If they mark both, as by some simulators, the clock's signals decide; otherwise a lenient reader assumes I/NAV.
    Raises FileError.
    """
    by_inav, by_fnav = source & INAV_SOURCES > 0, source & _FNAV_SOURCES > 0
    if by_inav != by_fnav:
        return by_inav
    inav_clock, fnav_clock = source & _INAV_CLOCK > 0, source & _FNAV_CLOCK > 0
    if inav_clock != fnav_clock:
        taken = "I/NAV" if inav_clock else "F/NAV"
        dropped.add(f"Galileo messages whose data sources, {source}, name both kinds; the clock is {taken}", 1)
        return inav_clock
    scale = "both I/NAV and F/NAV" if by_inav else "neither I/NAV nor F/NAV"
    message = f"the data sources {source} name {scale}, and bits 8 and 9 do not name the clock"
    dropped.damaged("Galileo messages taken as I/NAV", FileError(line, message, path))
    return True


def _beidou(path: Path, record: _Record, version: float, _: int, __: Dropped) -> _Read:
    """The fields of a BeiDou record; clocks are those of B3I, the group delay is that of B1I against it."""
    return BEIDOU.message, _in_order(_keplerian(path, record, version, BEIDOU, _BEIDOU_FIELDS))


_ION_FIELDS = ("alpha0", "alpha1", "alpha2", "alpha3", "beta0", "beta1", "beta2", "beta3")


def _ionosphere(path: Path, record: _Record, version: float) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
    """Time of transmission (POSIX s of GPS time) and Klobuchar's coefficients of an ION record of GPS [3]."""
    _check_length(path, record, (3,), _margin(version))
    v = list(_values(path, record.lines, version, _ION_FIELDS).values())
    return _time(path, record.lines, version), (np.array(v[:4]), np.array(v[4:]))


def _elements(records: list[tuple[float, ...]]) -> gps.Elements:
    columns = dict(zip(_ELEMENTS_ORDER, np.array(records).T, strict=True))
    columns["prn"] = columns["prn"].astype(int)
    columns["healthy"] = columns["healthy"] == 1.0
    return gps.Elements(**columns)


_GLONASS_FIELDS = ("tau", "gamma", "-", "x", "vx", "ax", "health", "y", "vy", "ay", "channel", "z", "vz", "az", "age")
_GLONASS_LIMITS = {
    "tau": (-0.1, 0.1), "gamma": (-1e-6, 1e-6), "channel": (-7, 13),
    "x": (-3e4, 3e4), "y": (-3e4, 3e4), "z": (-3e4, 3e4), "vx": (-10.0, 10.0), "vy": (-10.0, 10.0), "vz": (-10.0, 10.0),
    "ax": (-1e-7, 1e-7), "ay": (-1e-7, 1e-7), "az": (-1e-7, 1e-7),
}  # fmt: skip
_GLONASS_RADIUS = (24.0e3, 27.0e3)


def _glonass(path: Path, record: _Record, version: float, usual: int, _: Dropped) -> _Read:
    """The fields of a GLONASS record; usual: lines of the one before, 0 for none."""
    block = record.lines
    _check_length(path, record, _glonass_lines(record, version, usual), _margin(version))
    slot, time = _satellite(path, block, version, GLONASS.highest), _time(path, block, version)
    v = _values(path, block, version, _GLONASS_FIELDS)
    if v["channel"] > 128.0:  # an unsigned octet that meant to be signed
        v["channel"] -= 256.0
    for name, (low, high) in _GLONASS_LIMITS.items():
        within(path, block[(_GLONASS_FIELDS.index(name) + 1) // 4][0], v[name], low, high, name)
    radius = float(np.sqrt(v["x"] ** 2 + v["y"] ** 2 + v["z"] ** 2))
    within(path, block[1][0], radius, *_GLONASS_RADIUS, "distance of the satellite from the centre of the Earth in km")
    healthy = v["health"] == 0.0 and _flags_healthy(path, block, version)
    return GLONASS.message, (
        slot, v["channel"], float(healthy), time, v["x"], v["y"], v["z"], v["vx"], v["vy"], v["vz"],
        v["ax"], v["ay"], v["az"], v["tau"], v["gamma"], v["age"],
    )  # fmt: skip


def _glonass_lines(record: _Record, version: float, usual: int) -> tuple[int, ...]:
    """Allowed numbers of lines of a GLONASS record: version 3.05 added the fifth, but programs deviate."""
    if version < 3.0:
        return (4,)
    if version >= 4.0:
        return (5,)
    if usual:
        return (usual,)
    return (5,) if version >= 3.05 and record.ends_file else (4, 5)


def _flags_healthy(path: Path, block: list[tuple[int, str]], version: float) -> bool:
    """Whether the flags of the fifth line allow a GLONASS satellite; without them it is up to B_n alone.

    Health flags are three bits [2, table A10]: l(3), unhealthy by string 3, which satellites before GLONASS-M do not
    send; A_C, whether the almanac's health is reported; C, healthy by the almanac. Bits 7 and 8 of the status flags
    are the kind of satellite, 0 before GLONASS-M.
    """
    if len(block) < 5:
        return True
    health = _flags(path, block[4], _margin(version) + 3 * 19, 7, "the health flags")
    if health is None:
        return True
    status = _flags(path, block[4], _margin(version), 511, "the status flags")
    sends_l = status is None or status >> 7 > 0
    return not (health & 4 and sends_l) and (not health & 2 or bool(health & 1))


def _flags(path: Path, numbered: tuple[int, str], start: int, most: int, name: str) -> int | None:
    """Bits of a number; None if it is blank or unknown."""
    line, text = numbered
    piece = text[start : start + 19]
    if not piece.strip() or number(path, line, piece, name) == _UNKNOWN:
        return None
    return int(within(path, line, integer(path, line, piece, name), 0, most, name))


_UNKNOWN = 0.999999999999e9
"""Code of an unknown value [2]."""


_READ: dict[System, Callable[[Path, _Record, float, int, Dropped], _Read]] = {
    GPS: _gps, GLONASS: _glonass, GALILEO: _galileo, BEIDOU: _beidou, QZSS: _qzss,
}  # fmt: skip
"""Readers of the systems' messages: path, record, version, lines of the system's record before, omissions and
doubts."""


def _state_vectors(records: list[tuple[float, ...]]) -> StateVectors:
    table = np.array(records)
    return StateVectors(
        slot=table[:, 0].astype(int),
        channel=table[:, 1].astype(int),
        healthy=table[:, 2] == 1.0,
        time=table[:, 3],
        position=1e3 * table[:, 4:7],
        velocity=1e3 * table[:, 7:10],
        acceleration=1e3 * table[:, 10:13],
        tau=-table[:, 13],
        gamma=table[:, 14],
        age=table[:, 15],
    )
