"""SP3 precise orbit files, versions a to d.

Source: [1] Hilla, The extended standard product 3 orbit format (SP3-d), NGS (2016).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navsim.formats.text import Dropped, FileError, check_table, column, date_and_time, integer, read_lines, within
from navsim.gnss import timescales
from navsim.gnss.constellations.precise import OrbitTable
from navsim.gnss.constellations.systems import GPS

_NO_SCALE = "ccc"
_NO_CLOCK = 999999.0
_MARKS = ((78, "M"), (74, "E"), (79, "P"))
"""Columns and letters that mark, from version c on, a manoeuvre or a jump of the clock since the epoch before, and a
position that was not measured but predicted [1]."""
_POOR = 13
"""Largest code of a known accuracy: 2^13 mm are 8 m [1]."""
_PAD = GPS.satellite(0)
"""Name that fills the list of satellites."""


def read_sp3(path: Path, lenient: bool = False) -> OrbitTable:
    """Read an SP3 file, compressed or not.

    lenient: read the intact part of a file with wrong counts, broken lines or no end, with messages in `left_out`.
    Raises FileError with the line for damaged records otherwise, and for a damaged header in any case; OSError if the
    file cannot be read.
    """
    dropped = Dropped(lenient)
    lines = read_lines(path, dropped)
    head = lines[0]
    if len(head) < 60 or head[0] != "#" or head[1] not in "abcd":
        raise FileError(1, "not an SP3 file: it begins with #a, #b, #c or #d", path)
    epochs = integer(path, 1, head[32:39], "the number of epochs")
    listed: list[str] = []
    satellites = 0
    scale = GPS.time_system
    time: list[float] = []
    records: list[dict[str, tuple[float, ...]]] = []
    codes: list[int] = []
    scales_seen = 0
    ended = False
    usable = False  # whether the epoch that positions belong to is known
    for index, line in enumerate(lines[1:], 2):
        if line.startswith("+ "):
            if not satellites:
                satellites = integer(path, index, line[3:6], "the number of satellites")
                within(path, index, satellites, 1, 999, "the number of satellites")
            listed += [_name(line[9 + 3 * i : 12 + 3 * i]) for i in range(17) if line[9 + 3 * i : 12 + 3 * i].strip()]
        elif line.startswith("++"):
            pieces = [line[9 + 3 * i : 12 + 3 * i] for i in range(17)]
            codes += [integer(path, index, piece, "the accuracy") for piece in pieces if piece.strip()]
        elif line.startswith("%c"):
            scales_seen += 1
            if scales_seen == 1:
                told = line[9:12].strip()
                scale = GPS.time_system if told == _NO_SCALE else told
                if scale not in timescales.NAMES:
                    known = ", ".join(timescales.NAMES)
                    raise FileError(index, f"unknown time system {scale}; navsim knows {known}", path)
        elif line.startswith("*"):
            usable = False
            try:
                parts = [line[3:7], line[8:10], line[11:13], line[14:16], line[17:19], line[20:31]]
                now = date_and_time(path, index, parts)
                if time and now <= time[-1]:
                    raise FileError(index, "the epoch is not later than the one before", path)
            except FileError as error:
                dropped.damaged("epochs left out", error)
                continue
            time.append(now)
            records.append({})
            usable = True
        elif line.startswith("P") and (usable or not records):
            try:
                name, values = _position(path, index, line)
                if not records:
                    raise FileError(index, "a position before the first epoch", path)
                if name in records[-1]:
                    raise FileError(index, f"{name} occurs twice in this epoch", path)
                if name not in listed[:satellites]:
                    raise FileError(index, f"the header does not list {name}", path)
            except FileError as error:
                dropped.damaged("positions left out", error)
                continue
            records[-1][name] = values
        elif line.startswith("EOF"):
            ended = True
            break
    names = [name for name in listed[:satellites] if name != _PAD]
    if len(names) != satellites:
        wrong = FileError(0, f"the header announces {satellites} satellites and lists {len(names)}", path)
        dropped.damaged("wrong numbers of satellites", wrong)
    if not ended:
        dropped.damaged("end of the file missing", FileError(len(lines), "the file ends early: no line EOF", path))
    if len(time) != epochs:
        wrong = FileError(len(lines), f"the header announces {epochs} epochs, the file has {len(time)}", path)
        dropped.damaged("wrong number of epochs", wrong)
    if not time:
        raise FileError(len(lines), "the file has a header, but no epoch", path)
    check_table(path, len(time), len(names), 7)
    table = np.full((len(time), len(names), 7), np.nan)
    for epoch, record in enumerate(records):
        for i, name in enumerate(names):
            if name in record:
                table[epoch, i] = record[name]
    position, clock_us = 1e3 * table[..., :3], table[..., 3]
    position[np.all(position == 0.0, axis=2)] = np.nan
    # a missing clock is all nines
    clocks = np.where(clock_us >= _NO_CLOCK, np.nan, 1e-6 * clock_us)
    poor = [f"{name} (2^{code} mm)" for name, code in zip(names, codes, strict=False) if code > _POOR]
    dropped.add(f"satellites with inaccurate orbits, as the header says: {', '.join(poor)}", len(poor))
    manoeuvres, clock_events, predicted = (table[..., i] == 1.0 for i in (4, 5, 6))
    dropped.add("predicted positions", predicted.sum())
    gpst = _gpst(np.array(time), scale)
    return OrbitTable(tuple(names), gpst, position, clocks, manoeuvres, clock_events, dropped.reasons())


def _position(path: Path, line: int, text: str) -> tuple[str, tuple[float, ...]]:
    """Name, position in km, clock in microseconds and `_MARKS` (0 or 1) of a P line. Raises FileError."""
    values = [column(path, line, text, 4 + 14 * i, 14, "position") for i in range(3)]
    clock = column(path, line, text, 46, 14, "clock") if text[46:60].strip() else _NO_CLOCK
    radius = float(np.sqrt(sum(v * v for v in values)))
    if radius > 0.0:
        within(path, line, radius, 6.4e3, 5e5, "distance from the centre of the Earth in km")
    return _name(text[1:4]), (*values, clock, *(float(text[at : at + 1] == letter) for at, letter in _MARKS))


def _name(text: str) -> str:
    """Version a has bare GPS numbers."""
    text = text.replace(" ", "0")
    return GPS.letter + text[1:] if text[0] == "0" else text


def _gpst(time: np.ndarray, scale: str) -> np.ndarray:
    if scale in timescales.LEAPING:
        return timescales.gps_from_utc(time)
    return time - timescales.GPS_EPOCH + timescales.BEHIND_GPS[scale]
