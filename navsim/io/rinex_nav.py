"""RINEX navigation files, versions 2 and 3: GPS and GLONASS broadcast messages.

Ours because georinex, the known reader, needs half a minute for a day of mixed messages and stumbles over the
five-line GLONASS records of version 3.05. Messages of other systems are counted and skipped.

Sources: [1] RINEX 2.11 (2007), tables A3-A5, A10, A11. [2] RINEX 3.05 (2020), section 8 and tables A5, A6, A10.
[3] IS-GPS-200, section 20.3.3.3.1.3 (URA index).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from navsim.io.text import FileError, date_and_time, number, read_lines, whole, within
from navsim.models import gps, timescales
from navsim.models.glonass_broadcast import StateVectors

_LINES = {"G": 8, "R": 4}
_LATEST = 4.0
_URA = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0, 3072.0, 6144.0)


@dataclass(frozen=True)
class Navigation:
    """Messages of a navigation file: gps, glonass (None where the file has none), Klobuchar coefficients alpha, beta
    (4,) or None, GPS - UTC in s or None, how many records of other systems were skipped, by letter."""

    gps: gps.Elements | None
    glonass: StateVectors | None
    klobuchar: tuple[np.ndarray, np.ndarray] | None
    leap_seconds: int | None
    skipped: dict[str, int] = field(default_factory=dict)


def read_nav(path: Path) -> Navigation:
    """Read a RINEX 2 or 3 navigation file, packed or not.

    Raises FileError, naming the line, for anything but whole and plausible records; OSError where the file cannot be
    read.
    """
    lines = read_lines(path)
    version, system, klobuchar, leap, first = _header(path, lines)
    records: dict[str, list[tuple[float, ...]]] = {"G": [], "R": []}
    skipped: dict[str, int] = {}
    for letter, block in _blocks(path, lines, first, version, system):
        if letter not in records:
            skipped[letter] = skipped.get(letter, 0) + 1
        elif len(block) < _LINES[letter]:
            raise FileError(
                block[-1][0], f"the record breaks off: {_LINES[letter]} lines are due, here are {len(block)}", path
            )
        else:
            parse = _gps if letter == "G" else _glonass
            records[letter].append(parse(path, block, version))
    if not records["G"] and not records["R"]:
        raise FileError(0, "holds no GPS and no GLONASS message", path)
    return Navigation(
        _elements(records["G"]) if records["G"] else None,
        _state_vectors(records["R"]) if records["R"] else None,
        klobuchar,
        leap,
        skipped,
    )


def _header(path: Path, lines: list[str]) -> tuple[float, str, tuple[np.ndarray, np.ndarray] | None, int | None, int]:
    """Version, system letter, Klobuchar coefficients, leap seconds, index of the first line after the header."""
    version, system = rinex_version(path, lines)
    kind = lines[0][20:21]
    if kind not in "NG" or (version >= 3.0 and kind != "N"):
        raise FileError(1, f"a RINEX file of type '{lines[0][20:40].strip()}', not navigation data", path)
    if version < 3.0:
        system = "R" if kind == "G" else "G"
    corrections: dict[str, np.ndarray] = {}
    leap = None
    for index, line in enumerate(lines[1:], 2):
        label = line[60:80].strip()
        if label in ("ION ALPHA", "ION BETA"):
            name = "GPSA" if label.endswith("ALPHA") else "GPSB"
            corrections[name] = np.array([number(path, index, line[2 + 12 * i : 14 + 12 * i], label) for i in range(4)])
        elif label == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
            values = [number(path, index, line[5 + 12 * i : 17 + 12 * i], label) for i in range(4)]
            corrections[line[:4]] = np.array(values)
        elif label == "LEAP SECONDS":
            leap = int(within(path, index, whole(path, index, line[:6], "leap seconds"), 0, 100, "leap seconds"))
        elif label == "END OF HEADER":
            both = {"GPSA", "GPSB"} <= corrections.keys()
            return version, system, (corrections["GPSA"], corrections["GPSB"]) if both else None, leap, index
    raise FileError(len(lines), "the file ends within its header: no END OF HEADER", path)


def rinex_version(path: Path, lines: list[str]) -> tuple[float, str]:
    """Version and satellite system of the first line. Raises FileError for anything but RINEX 2 and 3."""
    if lines[0][60:80].strip() != "RINEX VERSION / TYPE":
        raise FileError(1, "not a RINEX file: the first line is no RINEX VERSION / TYPE", path)
    version = number(path, 1, lines[0][:9], "the RINEX version")
    if not 2.0 <= version < _LATEST:
        raise FileError(1, f"RINEX version {version:g} is not read; 2 and 3 are", path)
    return version, lines[0][40:41].strip() or "G"


def _blocks(
    path: Path, lines: list[str], first: int, version: float, system: str
) -> Iterator[tuple[str, list[tuple[int, str]]]]:
    """Records as a system letter and their numbered lines: a record begins where the satellite's columns are filled."""
    old = version < 3.0
    start = 0
    letter = ""
    end = len(lines)
    while end > first and not lines[end - 1].strip():
        end -= 1
    for index in range(first, end):
        line = lines[index]
        # a continuation line has its first columns blank
        if not line[:3].strip():
            if not letter:
                raise FileError(index + 1, "expected a record that begins with a satellite", path)
            continue
        if letter:
            yield letter, list(enumerate(lines[start:index], start + 1))
        start = index
        letter = system if old else line[0]
        if not letter.isalpha():
            raise FileError(index + 1, f"expected a satellite such as G01, found '{line[:3]}'", path)
    if letter:
        yield letter, list(enumerate(lines[start:end], start + 1))


def _satellite_and_time(path: Path, block: list[tuple[int, str]], version: float, most: int) -> tuple[int, float]:
    """Number of the satellite and the record's epoch as if it were UTC (POSIX s)."""
    line, text = block[0]
    satellite = whole(path, line, text[:2] if version < 3.0 else text[1:3], "the satellite")
    within(path, line, satellite, 1, most, "the satellite's number")
    if version < 3.0:
        parts = [text[3:5], text[6:8], text[9:11], text[12:14], text[15:17], text[17:22]]
    else:
        parts = [text[4:8], text[9:11], text[12:14], text[15:17], text[18:20], text[21:23]]
    return satellite, date_and_time(path, line, parts)


def _values(path: Path, block: list[tuple[int, str]], version: float, wanted: tuple[str, ...]) -> dict[str, float]:
    """The named fields, four a line (three in the first), `-` for those not looked at. Blank fields are errors."""
    margin = 3 if version < 3.0 else 4
    out = {}
    for place, name in enumerate(wanted, 1):
        if name == "-":
            continue
        line, text = block[place // 4]
        start = margin + 19 * (place % 4)
        out[name] = number(path, line, text[start : start + 19], name)
    return out


_GPS_FIELDS = (
    "af0", "af1", "af2",
    "iode", "crs", "delta_n", "m0",
    "cuc", "e", "cus", "sqrt_a",
    "toe", "cic", "omega0", "cis",
    "i0", "crc", "omega", "omega_dot",
    "i_dot", "-", "week", "-",
    "ura", "health", "tgd", "iodc",
)  # fmt: skip
_GPS_LIMITS = {
    "e": (0.0, 0.2), "sqrt_a": (4000.0, 8000.0), "toe": (0.0, timescales.WEEK), "i0": (-np.pi, np.pi),
    "omega0": (-2 * np.pi, 2 * np.pi), "omega": (-2 * np.pi, 2 * np.pi), "m0": (-2 * np.pi, 2 * np.pi),
    "delta_n": (-1e-6, 1e-6), "omega_dot": (-1e-6, 1e-6), "i_dot": (-1e-6, 1e-6), "af0": (-0.1, 0.1),
    "af1": (-1e-6, 1e-6), "af2": (-1e-9, 1e-9), "tgd": (-1e-6, 1e-6), "week": (0, 10000), "ura": (0.0, 1e5),
    "cuc": (-1e-3, 1e-3), "cus": (-1e-3, 1e-3), "cic": (-1e-3, 1e-3), "cis": (-1e-3, 1e-3),
    "crc": (-5e3, 5e3), "crs": (-5e3, 5e3),
}  # fmt: skip
_GPS_ORDER = (
    "prn", "healthy", "toe", "toc", "sqrt_a", "e", "i0", "omega0", "omega", "m0", "delta_n", "omega_dot", "i_dot",
    "cuc", "cus", "crc", "crs", "cic", "cis", "af0", "af1", "af2", "tgd", "ura", "iode", "iodc",
)  # fmt: skip


def _gps(path: Path, block: list[tuple[int, str]], version: float) -> tuple[float, ...]:
    prn, toc = _satellite_and_time(path, block, version, 63)
    v = _values(path, block, version, _GPS_FIELDS)
    for name, (low, high) in _GPS_LIMITS.items():
        within(path, block[(_GPS_FIELDS.index(name) + 1) // 4][0], v[name], low, high, name)
    toc -= timescales.GPS_EPOCH  # the epoch is GPS time
    # some files give the week modulo 1024, and a message near midnight may belong to the other week: the clock's
    # epoch, a whole date, decides
    toe = v["toe"] + timescales.WEEK * round((toc - v["toe"]) / timescales.WEEK)
    v |= {"prn": prn, "healthy": float(v["health"] == 0.0), "toe": toe, "toc": toc}
    return tuple(v[name] for name in _GPS_ORDER)


def _elements(records: list[tuple[float, ...]]) -> gps.Elements:
    columns = dict(zip(_GPS_ORDER, np.array(records).T, strict=True))
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


def _glonass(path: Path, block: list[tuple[int, str]], version: float) -> tuple[float, ...]:
    slot, time = _satellite_and_time(path, block, version, 32)
    v = _values(path, block, version, _GLONASS_FIELDS)
    if v["channel"] > 128.0:  # an unsigned octet that meant to be signed
        v["channel"] -= 256.0
    for name, (low, high) in _GLONASS_LIMITS.items():
        within(path, block[(_GLONASS_FIELDS.index(name) + 1) // 4][0], v[name], low, high, name)
    radius = float(np.sqrt(v["x"] ** 2 + v["y"] ** 2 + v["z"] ** 2))
    within(path, block[1][0], radius, *_GLONASS_RADIUS, "distance of the satellite from the centre of the Earth in km")
    return (
        slot, v["channel"], float(v["health"] == 0.0), time, v["x"], v["y"], v["z"], v["vx"], v["vy"], v["vz"],
        v["ax"], v["ay"], v["az"], v["tau"], v["gamma"], v["age"],
    )  # fmt: skip


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
