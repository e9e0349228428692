"""RINEX observation files, versions 2 and 3, also Hatanaka-compressed.

Ours because georinex needs seconds a megabyte; the Hatanaka compression is undone by the `hatanaka` package.

Sources: [1] RINEX 2.11 (2007), tables A1, A2. [2] RINEX 3.05 (2020), section 5 and tables A2, A3.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navsim.io.rinex_nav import rinex_version
from navsim.io.text import FileError, date_and_time, number, read_lines, whole, within
from navsim.models import timescales

_SYSTEMS = "GRECJIS"
_SCALES = {"GPS": "gps", "GAL": "gps", "QZS": "gps", "IRN": "gps", "GLO": "utc", "BDT": "bdt", "": "gps"}
_MOST_SATELLITES = 999


@dataclass(frozen=True)
class Observations:
    """What a receiver recorded.

    time: (e,) by the receiver's clock, GPS s. satellites: (s,) names. values: by code (such as C1C), (e, s) in
    m, cycles, Hz, dB-Hz as RINEX has them; nan where there is none. lost_lock: by phase code, (e, s) bool. position:
    (3,) ECEF approximate position of the marker, m, or None; antenna: (3,) up, east, north of the antenna, m.
    channels: GLONASS frequency channels by satellite. events: epochs skipped because they are no observations.
    """

    time: np.ndarray
    satellites: tuple[str, ...]
    values: dict[str, np.ndarray]
    lost_lock: dict[str, np.ndarray]
    position: np.ndarray | None
    antenna: np.ndarray
    channels: dict[str, int]
    events: int

    def of(self, *codes: str) -> np.ndarray:
        """(e, s): for each value the first of the codes that has it; nan without. Codes not in the file are none."""
        out = np.full((self.time.size, len(self.satellites)), np.nan)
        for code in codes:
            if code in self.values:
                out = np.where(np.isnan(out), self.values[code], out)
        return out


@dataclass
class _Header:
    version: float
    system: str
    codes: dict[str, list[str]]
    scale: str
    position: np.ndarray | None
    antenna: np.ndarray
    channels: dict[str, int]
    end: int


def read_obs(path: Path) -> Observations:
    """Read a RINEX 2 or 3 observation file, packed or not.

    Raises FileError, naming the line, for anything but whole records; OSError where the file cannot be read.
    """
    lines = read_lines(path)
    while len(lines) > 1 and not lines[-1].strip():
        lines.pop()
    header = _header(path, lines)
    reader = _Reader(path, lines, header)
    if header.version < 3.0:
        reader.read_2()
    else:
        reader.read_3()
    return reader.observations()


def _header(path: Path, lines: list[str]) -> _Header:
    version, system = rinex_version(path, lines)
    if lines[0][20:21] != "O":
        raise FileError(1, f"a RINEX file of type '{lines[0][20:40].strip()}', not observations", path)
    h = _Header(version, system, {}, "gps", None, np.zeros(3), {}, 0)
    code_system, due = "", 0
    for index, line in enumerate(lines[1:], 2):
        label = line[60:80].strip()
        if label == "END OF HEADER":
            h.end = index
            break
        if label == "SYS / # / OBS TYPES":
            if line[0] != " ":
                code_system = line[0]
                if code_system not in _SYSTEMS:
                    raise FileError(index, f"no such satellite system: {code_system}", path)
                h.codes[code_system] = []
                due = _count(path, index, line[3:6])
            if not code_system:
                raise FileError(index, "observation types without a satellite system", path)
            h.codes[code_system] += line[6:60].split()
        elif label == "# / TYPES OF OBSERV":
            if line[:6].strip():
                h.codes[""], due = [], _count(path, index, line[:6])
            if "" not in h.codes:
                raise FileError(index, "observation types without their number", path)
            h.codes[""] += line[6:60].split()
        elif label == "TIME OF FIRST OBS":
            scale = line[48:51].strip()
            if scale not in _SCALES:
                raise FileError(
                    index, f"time system {scale} is not known; {', '.join(filter(None, _SCALES))} are", path
                )
            h.scale = "utc" if not scale and system == "R" else _SCALES[scale]
        elif label == "APPROX POSITION XYZ":
            h.position = np.array([number(path, index, line[14 * i : 14 * i + 14], label) for i in range(3)])
        elif label == "ANTENNA: DELTA H/E/N":
            h.antenna = np.array([number(path, index, line[14 * i : 14 * i + 14], label) for i in range(3)])
        elif label == "GLONASS SLOT / FRQ #":
            for place in range(4, 60, 7):
                if line[place : place + 3].strip():
                    h.channels[line[place : place + 3].replace(" ", "0")] = whole(
                        path, index, line[place + 3 : place + 6], "the frequency channel"
                    )
        if due and len(h.codes.get(code_system, h.codes.get("", []))) > due:
            raise FileError(index, f"more observation types than the {due} announced", path)
    else:
        raise FileError(len(lines), "the file ends within its header: no END OF HEADER", path)
    if not h.codes:
        raise FileError(h.end, "the header names no observation types", path)
    return h


def _count(path: Path, line: int, text: str) -> int:
    return int(within(path, line, whole(path, line, text, "the number of types"), 1, 200, "the number of types"))


class _Reader:
    """Gathers (epoch, satellite, code) values while it walks the lines."""

    def __init__(self, path: Path, lines: list[str], header: _Header) -> None:
        self.path, self.lines, self.header = path, lines, header
        self.time: list[float] = []
        self.rows: list[tuple[int, str, list[float], list[str]]] = []
        self.events = 0

    def read_3(self) -> None:
        """Epochs of version 3: `>` lines, then a line a satellite [2]."""
        path, lines, at = self.path, self.lines, self.header.end
        while at < len(lines):
            line = lines[at]
            if not line.startswith(">"):
                raise FileError(at + 1, "expected an epoch, a line that begins with >", path)
            flag = whole(path, at + 1, line[31:32], "the epoch flag")
            count = self._satellites(at, line[32:35])
            if at + count >= len(lines):
                raise FileError(len(lines), f"the file ends within an epoch: {count} lines are due", path)
            if flag in (0, 1):
                self._epoch(at, [line[2:6], line[7:9], line[10:12], line[13:15], line[16:18], line[18:29]])
                for row in range(at + 1, at + 1 + count):
                    text = lines[row]
                    name = text[:3].replace(" ", "0")
                    codes = self.header.codes.get(name[:1])
                    if codes is None or not name[1:].isdecimal():
                        raise FileError(row + 1, f"expected one of the header's satellites, found '{text[:3]}'", path)
                    self._row(row, name, codes, text[3:])
            else:
                self.events += 1
            at += 1 + count

    def read_2(self) -> None:
        """Epochs of version 2: satellites listed twelve a line, values five a line [1]."""
        path, lines, at = self.path, self.lines, self.header.end
        codes = self.header.codes[""]
        per_satellite = -(-len(codes) // 5)
        while at < len(lines):
            line = lines[at].ljust(80)
            flag = whole(path, at + 1, line[28:29].strip() or "0", "the epoch flag")
            count = self._satellites(at, line[29:32])
            if flag > 1:
                if at + count >= len(lines):
                    raise FileError(len(lines), f"the file ends within an event: {count} lines are due", path)
                self.events += 1
                at += 1 + count
                continue
            listing = max(1, -(-count // 12))
            if at + listing + count * per_satellite > len(lines):
                raise FileError(len(lines), "the file ends within an epoch", path)
            self._epoch(at, [line[1:3], line[4:6], line[7:9], line[10:12], line[13:15], line[15:26]])
            names = "".join(text.ljust(80)[32:68] for text in lines[at : at + listing])
            at += listing
            for index in range(count):
                name = names[3 * index : 3 * index + 3]
                name = (name[0] if name[0] != " " else self.header.system) + name[1:].replace(" ", "0")
                if name[0] not in _SYSTEMS or not name[1:].isdecimal():
                    raise FileError(at, f"expected a satellite, found '{names[3 * index : 3 * index + 3]}'", path)
                text = "".join(part.ljust(80)[:80] for part in lines[at : at + per_satellite])
                self._row(at, name, codes, text)
                at += per_satellite

    def observations(self) -> Observations:
        """All that was read, by epoch and satellite. Raises FileError where that is nothing."""
        h, path = self.header, self.path
        if not self.time:
            raise FileError(len(self.lines), "the file has no epoch", path)
        satellites = tuple(sorted({name for _, name, _, _ in self.rows}))
        column = {name: i for i, name in enumerate(satellites)}
        shape = len(self.time), len(satellites)
        codes = sorted({c for name in satellites for c in h.codes.get(name[0], h.codes.get("", []))})
        values = {c: np.full(shape, np.nan) for c in codes}
        lost = {c: np.zeros(shape, dtype=bool) for c in codes if c.startswith("L")}
        for epoch, name, numbers, flags in self.rows:
            i = column[name]
            for code, value, flag in zip(h.codes.get(name[0], h.codes.get("", [])), numbers, flags, strict=False):
                values[code][epoch, i] = value
                if flag and code in lost:
                    lost[code][epoch, i] = flag.isdecimal() and int(flag) & 1
        return Observations(
            np.array(self.time), satellites, values, lost, h.position, h.antenna, h.channels, self.events
        )

    def _satellites(self, at: int, text: str) -> int:
        count = whole(self.path, at + 1, text, "the number of satellites")
        return int(within(self.path, at + 1, count, 0, _MOST_SATELLITES, "the number of satellites"))

    def _epoch(self, at: int, parts: list[str]) -> None:
        time = date_and_time(self.path, at + 1, parts)
        if self.header.scale == "utc":
            # seconds from 60 on may be those of a leap second
            over = float(number(self.path, at + 1, parts[5], "the epoch") >= 60.0)
            time = float(timescales.gps_from_utc(time - over)) + over
        else:
            time += (14.0 if self.header.scale == "bdt" else 0.0) - timescales.GPS_EPOCH
        if self.time and time <= self.time[-1]:
            raise FileError(at + 1, "the epoch is not later than the one before", self.path)
        self.time.append(time)

    def _row(self, at: int, name: str, codes: list[str], text: str) -> None:
        numbers, flags = [], []
        for place in range(0, min(16 * len(codes), len(text)), 16):
            field = text[place : place + 14]
            if field.strip():
                value = number(self.path, at + 1, field, codes[place // 16])
                # RINEX writes a missing value as blank or as 0
                numbers.append(value if value != 0.0 else np.nan)
            else:
                numbers.append(np.nan)
            flags.append(text[place + 14 : place + 15].strip())
        self.rows.append((len(self.time) - 1, name, numbers, flags))
