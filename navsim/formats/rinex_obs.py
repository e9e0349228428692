"""RINEX observation files, versions 2, 3 and 4, packed or not.

Ours because georinex needs seconds a megabyte; the Hatanaka compression is undone by the `hatanaka` package.

Sources: [1] RINEX 2.11 (2007), tables A1, A2, and 2.20 for OBS SCALE FACTOR. [2] RINEX 3.05 (2020), section 5 and
tables A2, A3. [3] RINEX 4.02 (2024), tables A2, A3: observations as in version 3.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navsim.formats.rinex_nav import rinex_version
from navsim.formats.text import (
    Dropped,
    FileError,
    check_table,
    date_and_time,
    ends_within,
    integer,
    number,
    read_lines,
    within,
)  # fmt: skip
from navsim.gnss import timescales
from navsim.gnss.constellations.systems import BY_LETTER, GPS, LETTERS

_MOST_SATELLITES = 999
_FACTORS = (1, 10, 100, 1000)
"""Scale factors that the format allows: values were multiplied by them when they were written."""
_PER_LINE_2 = 5
"""Values a line of version 2; later versions have all of a satellite's in one."""
_CYCLE_SLIPS = 6
"""Event flag of records like observations, with slips in place of values."""
_EPOCH_2 = re.compile(r" [ \d]\d(?: [ \d]\d){4}[ \d.]{11}  [ \d][ \d]{2}\d")
"""Pattern of an epoch line, which no line of values matches: those have no blanks between digits of one value."""
_CUT_EPOCH_2 = " dd dd dd dd dd" + 11 * "d" + "  dddd"
_EVENT_2 = re.compile(r" {28}[2-6][ \d]{2}\d")
_MORE_SATELLITES_2 = re.compile(r" {32}(?:[A-Z ][ \d]\d)+\s*$")


@dataclass(frozen=True)
class Observations:
    """Recorded observations of a receiver."""

    time: np.ndarray
    """(e,) by the receiver clock, GPS s."""
    satellites: tuple[str, ...]
    """(s,) names."""
    values: dict[str, np.ndarray]
    """By code (such as C1C), (e, s) in m, cycles, Hz, dB-Hz, without scale factors; nan if missing."""
    lost_lock: dict[str, np.ndarray]
    """By phase code, (e, s) bool."""
    position: np.ndarray | None
    """(3,) ECEF approximate position of the marker, m, or None."""
    antenna: np.ndarray
    """(3,) up, east, north of the antenna, m."""
    channels: dict[str, int]
    """GLONASS frequency channels by satellite."""
    events: int
    """Number of skipped epochs without observations."""
    left_out: tuple[str, ...] = ()
    """Messages about omitted parts of a damaged file."""

    def of(self, *codes: str) -> np.ndarray:
        """(e, s): for each value the first of the codes that has it; nan without. Codes not in the file are none."""
        out = np.full((self.time.size, len(self.satellites)), np.nan)
        for code in codes:
            if code in self.values:
                out = np.where(np.isnan(out), self.values[code], out)
        return out


def read_obs(path: Path, lenient: bool = False) -> Observations:
    """Read a RINEX 2, 3 or 4 observation file, compressed or not.

    lenient: read the intact part of a file with wrong counts, broken lines or no end, with messages in `left_out`.
    Raises FileError with the line for damaged records otherwise, and for a damaged header in any case; OSError if the
    file cannot be read.
    """
    dropped = Dropped(lenient)
    lines = read_lines(path, dropped)
    version, system = rinex_version(path, lines)
    if lines[0][20:21] != "O":
        raise FileError(1, f"a RINEX file of '{lines[0][20:40].strip()}'; give one of observations", path)
    header = _Header(path, version, system)
    first = header.read(lines)
    reader = _Reader(path, lines, header, dropped)
    if version < 3.0:
        reader.read_2(first)
    else:
        reader.read_3(first)
    return reader.observations()


@dataclass(frozen=True)
class _Layout:
    """Layout of a satellite's record: codes in their order; line, columns and factor of each value."""

    codes: tuple[str, ...]
    fields: list[tuple[int, int, int]]
    per_satellite: int

    @classmethod
    def of(cls, codes: list[str], factors: list[int], per_line: int) -> _Layout:
        """Layout with so many values a line."""
        fields = [(i // per_line, 16 * (i % per_line), factor) for i, factor in enumerate(factors)]
        return cls(tuple(codes), fields, -(-len(codes) // per_line))


class _Header:
    """Header, including changes by header lines between the epochs."""

    def __init__(self, path: Path, version: float, system: str) -> None:
        self.path, self.version, self.system = path, version, system
        self.scale = GPS.time_system
        self.position: np.ndarray | None = None
        self.antenna = np.zeros(3)
        self.channels: dict[str, int] = {}
        # observation types by system ("" for all of version 2), and where how many were announced
        self._codes: dict[str, list[str]] = {}
        self._due: dict[str, tuple[int, int]] = {}
        # scale factors of all types of a system, and of single types
        self._of_system: dict[str, int] = {}
        self._of_code: dict[tuple[str, str], int] = {}
        # the record that a continuation line continues: system, factor, types still due, its line
        self._types_of: str | None = None
        self._scaling: tuple[str, int, int, int] | None = None
        self._layouts: dict[str, _Layout] = {}

    def read(self, lines: list[str]) -> int:
        """Take the lines up to END OF HEADER; returns how many they are. Raises FileError."""
        for index, line in enumerate(lines[1:], 2):
            if line[60:80].strip() == "END OF HEADER":
                if not self._codes:
                    raise FileError(index, "the header names no observation types", self.path)
                self.close(index)
                return index
            self._take(index, line)
        raise FileError(len(lines), "the file ends within its header: no END OF HEADER", self.path)

    def change(self, first: int, lines: list[str]) -> None:
        """Apply header lines between the epochs: observation types, scale factors and channels.

        Positions stay those of the beginning. Raises FileError.
        """
        meant = ("OBS TYPES", "TYPES OF OBSERV", "SCALE FACTOR", "SLOT / FRQ #")
        for index, line in enumerate(lines, first):
            if line[60:80].strip().endswith(meant):
                self._take(index, line)
        self.close(first + len(lines))

    def layout(self, letter: str) -> _Layout | None:
        """Layout of a satellite's record; None for systems that the header does not have."""
        return self._layouts.get(letter)

    def close(self, line: int) -> None:
        """Check that everything announced is present, and complete the layouts. Raises FileError."""
        self._check_scaled()
        for letter, (where, due) in self._due.items():
            codes = self._codes[letter]
            if len(codes) != due:
                of = f" of {letter}" if letter else ""
                message = f"the header announces {due} observation types{of} and names {len(codes)} up to line {line}"
                raise FileError(where, message, self.path)
            twice = sorted({code for code in codes if codes.count(code) > 1})
            if twice:
                raise FileError(where, f"the header names observation types twice: {', '.join(twice)}", self.path)
        self._due = {}
        for letter, codes in self._codes.items():
            whole_system = self._of_system.get(letter, 1)
            factors = [self._of_code.get((letter, code), whole_system) for code in codes]
            self._layouts[letter] = _Layout.of(codes, factors, _PER_LINE_2 if self.version < 3.0 else len(codes))

    def _take(self, index: int, line: str) -> None:
        label = line[60:80].strip()
        new = self.version >= 3.0
        if label != "COMMENT" and not label.endswith("SCALE FACTOR"):
            self._check_scaled()
        if label == "SYS / # / OBS TYPES" and new:
            if line[0] != " ":
                self._announce(index, self._system(index, line[0]), line[3:6])
            self._types(index, line)
        elif label == "# / TYPES OF OBSERV" and not new:
            if line[:6].strip():
                self._announce(index, "", line[:6])
            self._types(index, line)
        elif label == "SYS / SCALE FACTOR" and new:
            self._scaled(index, line[:1].strip(), line[2:6], line[8:10], line[10:60].split())
        elif label == "OBS SCALE FACTOR" and not new:
            self._scaled(index, "", line[:6], line[6:12], line[12:60].split())
        elif label == "TIME OF FIRST OBS":
            scale = line[48:51].strip()
            if scale and scale not in timescales.NAMES:
                known = ", ".join(timescales.NAMES)
                raise FileError(index, f"unknown time system {scale}; navsim knows {known}", self.path)
            self.scale = scale or BY_LETTER.get(self.system, GPS).time_system
        elif label == "APPROX POSITION XYZ":
            self.position = self._three(index, line, label)
        elif label == "ANTENNA: DELTA H/E/N":
            self.antenna = self._three(index, line, label)
        elif label == "GLONASS SLOT / FRQ #":
            for place in range(4, 60, 7):
                if line[place : place + 3].strip():
                    self.channels[line[place : place + 3].replace(" ", "0")] = integer(
                        self.path, index, line[place + 3 : place + 6], "the frequency channel"
                    )

    def _three(self, index: int, line: str, label: str) -> np.ndarray:
        return np.array([number(self.path, index, line[14 * i : 14 * i + 14], label) for i in range(3)])

    def _system(self, index: int, letter: str) -> str:
        if letter not in LETTERS:
            raise FileError(index, f"unknown satellite system {letter!r}; RINEX has {', '.join(LETTERS)}", self.path)
        return letter

    def _announce(self, index: int, letter: str, text: str) -> None:
        name = "the number of types"
        due = int(within(self.path, index, integer(self.path, index, text, name), 1, 200, name))
        self._types_of, self._codes[letter], self._due[letter] = letter, [], (index, due)

    def _types(self, index: int, line: str) -> None:
        if self._types_of is None or self._types_of not in self._due:
            what = "a satellite system" if self.version >= 3.0 else "their number"
            raise FileError(index, f"the line names observation types, but not {what}", self.path)
        codes, due = self._codes[self._types_of], self._due[self._types_of][1]
        codes += line[6:60].split()
        if len(codes) > due:
            raise FileError(index, f"the header names more than the announced {due} observation types", self.path)

    def _scaled(self, index: int, letter: str, factor: str, count: str, codes: list[str]) -> None:
        """A scale factor, or more of the types it is for."""
        if not letter and not factor.strip() and not count.strip():
            if self._scaling is None:
                raise FileError(index, "the line names observation types to scale, but no factor", self.path)
            of, value, due, where = self._scaling
        else:
            self._check_scaled()
            if self.version >= 3.0 and not letter:
                raise FileError(index, "the line has a scale factor, but no satellite system", self.path)
            of = self._system(index, letter) if letter else ""
            value, where = integer(self.path, index, factor, "the scale factor"), index
            if value not in _FACTORS:
                allowed = ", ".join(str(known) for known in _FACTORS)
                raise FileError(index, f"the scale factor is {value}; RINEX allows {allowed}", self.path)
            name = "the number of scaled types"
            due = int(within(self.path, index, integer(self.path, index, count.strip() or "0", name), 0, 200, name))
            if not due and not codes:
                self._of_system[of] = value
                return
        if len(codes) > due:
            raise FileError(index, f"the header names more scaled types than line {where} announces", self.path)
        self._of_code |= {(of, code): value for code in codes}
        self._scaling = of, value, due - len(codes), where

    def _check_scaled(self) -> None:
        """Check that no types of the last scale factor are missing."""
        if self._scaling is not None and self._scaling[2]:
            raise FileError(self._scaling[3], f"the header lacks {self._scaling[2]} of these scaled types", self.path)
        self._scaling = None


@dataclass(frozen=True)
class _Epoch:
    """The line that begins an epoch: its place, flag, how many satellites or lines it announces, its time's texts."""

    at: int
    flag: int
    count: int
    parts: list[str]


@dataclass(frozen=True)
class _Row:
    """Values of a satellite's record without scale factors, nan for none, and the marks of lost lock."""

    epoch: int
    name: str
    codes: tuple[str, ...]
    values: list[float]
    flags: list[str]


class _Reader:
    """Gathers (epoch, satellite, code) values while it walks the lines."""

    def __init__(self, path: Path, lines: list[str], header: _Header, dropped: Dropped) -> None:
        self.path, self.lines, self.header, self.dropped = path, list(lines), header, dropped
        self.ends_whole = self.lines[-1] == ""  # text after the last line end is not a line
        if self.ends_whole:
            self.lines.pop()
        self.blank_from = len(self.lines)
        while self.blank_from and not self.lines[self.blank_from - 1].strip():
            self.blank_from -= 1
        self.time: list[float] = []
        self.rows: list[_Row] = []
        self.events = 0

    def read_3(self, at: int) -> None:
        """Epochs of versions 3 and 4 from line index `at` on: `>` lines, then a line a satellite [2, 3]."""
        del self.lines[self.blank_from :]
        while at < len(self.lines):
            try:
                at = self._epoch_3(at)
            except FileError as error:
                self.dropped.damaged("epochs left out", error)
                at = self._next_3(at + 1)

    def _epoch_3(self, at: int) -> int:
        """Take the epoch at line index `at`; returns that of the next one."""
        line = self.lines[at]
        if not line.startswith(">"):
            raise FileError(at + 1, "expected an epoch: a line that begins with >", self.path)
        parts = [line[2:6], line[7:9], line[10:12], line[13:15], line[16:18], line[18:29]]
        # some programs write the flag a column too early; blank is 0
        epoch = self._head(at, line[29:32].strip() or "0", line[32:35], parts)
        if 1 < epoch.flag < _CYCLE_SLIPS:
            return self._event(epoch)
        end = self._next_3(at + 1)
        if end - at - 1 != epoch.count:
            ends = end == len(self.lines) and end - at - 1 < epoch.count
            error = self._miscounted(epoch, f"lines of {end - at - 1} follow", ends)
            self.dropped.damaged("wrong numbers of satellites", error)
        if epoch.flag == _CYCLE_SLIPS:
            self.events += 1
            return end
        self._begin(epoch)
        seen: set[str] = set()
        for row in range(at + 1, end):
            try:
                text = self.lines[row]
                name = text[:3].replace(" ", "0")
                layout = self.header.layout(name[:1])
                if layout is None or not name[1:].isdecimal():
                    raise FileError(row + 1, f"expected one of the header's satellites, found '{text[:3]}'", self.path)
                self._row(row, name, seen, layout, [text[3:]])
            except FileError as error:
                self.dropped.damaged("satellites left out", error)
        self._finish(epoch)
        return end

    def _next_3(self, at: int) -> int:
        """Line index of the next epoch, from `at` on."""
        while at < len(self.lines) and not self.lines[at].startswith(">"):
            at += 1
        return at

    def read_2(self, at: int) -> None:
        """Epochs of version 2 from line index `at` on: satellites listed twelve a line, values five a line [1]."""
        while at < self.blank_from:  # after the last epoch blank lines may follow
            try:
                at = self._epoch_2(at)
            except FileError as error:
                self.dropped.damaged("epochs left out", error)
                at = self._next_2(at + 1)

    def _epoch_2(self, at: int) -> int:
        """Take the epoch at line index `at`; returns that of the next one."""
        line = self.lines[at].ljust(80)
        parts = [line[1:3], line[4:6], line[7:9], line[10:12], line[13:15], line[15:26]]
        epoch = self._head(at, line[28:29].strip() or "0", line[29:32], parts)
        if 1 < epoch.flag < _CYCLE_SLIPS:
            return self._event(epoch)
        layout = self.header.layout("")
        assert layout is not None
        per_satellite = layout.per_satellite
        first, names = self._listed(epoch)
        due = first + len(names) * per_satellite
        end = self._next_2(first, due)
        if due > end == len(self.lines) and self.ends_whole and due - end < per_satellite:
            # blank lines at the very end are often trimmed: those of the last satellite's missing values
            self.dropped.add(f"missing lines at the end of {self.path.name}; navsim takes them as blank", due - end)
            self.lines += [""] * (due - end)
            end = due
        if due + 1 == end == len(self.lines) and _begins_epoch_2(self.lines[due]):
            end = due  # a last line cut off before it can be recognised as an epoch's
        if len(names) != epoch.count or due != end:
            found = f"{len(names)} are listed" if due == end else f"{end - first} lines, {per_satellite} each, follow"
            ends = due > end == len(self.lines)
            error = self._miscounted(epoch, found, ends)
            if due != end and not ends:
                raise error  # which lines are whose is not known
            self.dropped.damaged("wrong numbers of satellites", error)
            names = names[: (end - first) // per_satellite]
        if epoch.flag == _CYCLE_SLIPS:
            self.events += 1
            return end
        self._begin(epoch)
        seen: set[str] = set()
        for index, name in enumerate(names):
            row = first + index * per_satellite
            try:
                if name[0] not in LETTERS or not name[1:].isdecimal():
                    raise FileError(at + 1, f"expected a satellite such as G01, found '{name}'", self.path)
                self._row(row, name, seen, layout, self.lines[row : row + per_satellite])
            except FileError as error:
                self.dropped.damaged("satellites left out", error)
        self._finish(epoch)
        return end

    def _listed(self, epoch: _Epoch) -> tuple[int, list[str]]:
        """Index of the line after the list of satellites, and their names."""
        at = epoch.at + 1
        listing = self.lines[epoch.at].ljust(68)[32:68]
        while at < len(self.lines) and _MORE_SATELLITES_2.match(self.lines[at]) and len(listing) < 3 * epoch.count:
            listing += self.lines[at].ljust(68)[32:68]
            at += 1
        triples = [listing[3 * i : 3 * i + 3] for i in range(len(listing) // 3)]
        triples = [triple for triple in triples if triple.strip()]
        system = self.header.system if self.header.system in LETTERS else GPS.letter  # of mixed files [1]
        return at, [(t[0] if t[0] != " " else system) + t[1:].replace(" ", "0") for t in triples]

    def _next_2(self, at: int, due: int = 0) -> int:
        """Line index of the next epoch, from `at` on; the expected index `due` ends the search."""
        while at < len(self.lines):
            line = self.lines[at]
            if _EPOCH_2.match(line) or _EVENT_2.match(line):
                break
            if at == due and at >= self.blank_from:
                break
            at += 1
        return at

    def observations(self) -> Observations:
        """All that was read, by epoch and satellite. Raises FileError where that is nothing."""
        h, path = self.header, self.path
        if not self.time:
            raise FileError(len(self.lines), "the file has a header, but no epoch", path)
        satellites = tuple(sorted({row.name for row in self.rows}))
        place = {name: i for i, name in enumerate(satellites)}
        shape = len(self.time), len(satellites)
        codes = sorted({code for row in self.rows for code in row.codes})
        check_table(path, *shape, len(codes))
        values = {c: np.full(shape, np.nan) for c in codes}
        lost = {c: np.zeros(shape, dtype=bool) for c in codes if c.startswith("L")}
        for row in self.rows:
            i = place[row.name]
            for code, value, flag in zip(row.codes, row.values, row.flags, strict=False):
                values[code][row.epoch, i] = value
                if code in lost and flag.isdecimal():
                    lost[code][row.epoch, i] = int(flag) & 1
        return Observations(
            np.array(self.time),
            satellites,
            values,
            lost,
            h.position,
            h.antenna,
            h.channels,
            self.events,
            self.dropped.reasons(),
        )

    def _head(self, at: int, flag: str, count: str, parts: list[str]) -> _Epoch:
        name = "the number of satellites"
        number_of = int(within(self.path, at + 1, integer(self.path, at + 1, count, name), 0, _MOST_SATELLITES, name))
        kind = integer(self.path, at + 1, flag, "the epoch flag")
        within(self.path, at + 1, kind, 0, _CYCLE_SLIPS, "the epoch flag")
        return _Epoch(at, kind, number_of, parts)

    def _event(self, epoch: _Epoch) -> int:
        """Header lines between the epochs; returns the line index of the next epoch."""
        first, end = epoch.at + 1, epoch.at + 1 + epoch.count
        if end > len(self.lines):
            raise FileError(len(self.lines), f"the file ends within an event of {epoch.count} lines", self.path)
        self.events += 1
        self.header.change(first + 1, self.lines[first:end])
        return end

    def _miscounted(self, epoch: _Epoch, found: str, ends: bool) -> FileError:
        """Error for an epoch with a wrong number of lines; ends: the file ends early."""
        announced = f"the epoch announces {epoch.count} satellites"
        if not ends:
            return FileError(epoch.at + 1, f"{announced}, {found}", self.path)
        message = f"the file ends within an epoch: line {epoch.at + 1} announces {epoch.count} satellites, {found}"
        return FileError(len(self.lines), message, self.path)

    def _begin(self, epoch: _Epoch) -> None:
        time = date_and_time(self.path, epoch.at + 1, epoch.parts)
        if self.header.scale in timescales.LEAPING:
            # seconds from 60 on may be those of a leap second
            over = float(number(self.path, epoch.at + 1, epoch.parts[5], "the epoch") >= 60.0)
            time = float(timescales.gps_from_utc(time - over)) + over
        else:
            time += timescales.BEHIND_GPS[self.header.scale] - timescales.GPS_EPOCH
        if self.time and time <= self.time[-1]:
            raise FileError(epoch.at + 1, "the epoch is not later than the one before", self.path)
        self.time.append(time)

    def _finish(self, epoch: _Epoch) -> None:
        """Remove an epoch without any intact record."""
        if epoch.count and (not self.rows or self.rows[-1].epoch != len(self.time) - 1):
            self.time.pop()

    def _row(self, at: int, name: str, seen: set[str], layout: _Layout, texts: list[str]) -> None:
        """The values of a satellite, whose texts begin on line index `at`."""
        if name in seen:
            raise FileError(at + 1, f"{name} occurs twice in this epoch", self.path)
        numbers, flags = [], []
        for code, (line, start, factor) in zip(layout.codes, layout.fields, strict=True):
            text = texts[line]
            piece = text[start : start + 14]
            if not piece or piece.isspace():
                numbers.append(np.nan)
            else:
                if len(piece) < 14:
                    raise ends_within(self.path, at + line + 1, piece, code)
                value = number(self.path, at + line + 1, piece, code)
                # RINEX writes a missing value as blank or as 0
                numbers.append(value / factor if value != 0.0 else np.nan)
            flags.append(text[start + 14 : start + 15])
        seen.add(name)
        self.rows.append(_Row(len(self.time) - 1, name, layout.codes, numbers, flags))


def _begins_epoch_2(line: str) -> bool:
    """Whether a line may be the beginning of one that begins an epoch of version 2."""
    return all(c in (" .0123456789" if due == "d" else due) for c, due in zip(line, _CUT_EPOCH_2, strict=False))
