"""Almanac files: GLONASS `.agl` of the Russian IAC (three lines a satellite).

Line a: day month year, seconds of receipt. Line b: slot, frequency channel, health (1 = healthy), day month
year, t_lambda s (Moscow time), tau_UTC, tau_GPS, tau. Line c: lambda, delta i, omega (semicircles),
eccentricity, delta T (s), rate of delta T.
"""

from __future__ import annotations

import datetime
import math
from pathlib import Path

import numpy as np

from navsim.models import glonass

_EPOCH = datetime.date(1970, 1, 1)
_FIELDS = {"b": 10, "c": 6}


class AlmanacError(ValueError):
    """An almanac file that cannot be used; `line` counts from 1, 0 for the file as a whole."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


def read_agl(path: Path) -> glonass.Almanac:
    """Read a GLONASS `.agl` almanac.

    Raises AlmanacError, naming the line, for anything but whole and plausible records; OSError where the
    file cannot be read.
    """
    try:
        text = path.read_bytes().decode("ascii")
    except UnicodeDecodeError as error:
        raise AlmanacError(0, "not a text file") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines:
        raise AlmanacError(0, "the file is empty")
    records = []
    for first in range(0, len(lines), 3):
        block = lines[first : first + 3]
        if len(block) < 3:
            raise AlmanacError(block[-1][0], "the file ends within a record: three lines a satellite are due")
        records.append(_record(block))
    slots = [r[0] for r in records]
    for index, slot in enumerate(slots):
        if slot in slots[:index]:
            raise AlmanacError(lines[3 * index + 1][0], f"slot {slot:.0f} stands twice in the file")
    columns = np.array(records, dtype=float).T
    slot, health, day, time, lam, di, omega, ecc, dt, dt_rate = columns
    return glonass.Almanac(
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
    )


def _record(block: list[tuple[int, str]]) -> tuple[float, ...]:
    (line_a, a), (line_b, b), (line_c, c) = block
    if len(_numbers(line_a, a)) != 4:
        raise AlmanacError(line_a, "expected day month year and seconds of receipt")
    numbers = {}
    for line, text, name in ((line_b, b, "b"), (line_c, c, "c")):
        numbers[name] = _numbers(line, text)
        if len(numbers[name]) != _FIELDS[name]:
            raise AlmanacError(line, f"expected {_FIELDS[name]} numbers, found {len(numbers[name])}")
    slot, _, health, day, month, year, time = numbers["b"][:7]
    lam, di, omega, ecc, dt, dt_rate = numbers["c"]
    try:
        date = datetime.date(int(year), int(month), int(day))
    except ValueError as error:
        raise AlmanacError(line_b, f"no such date: {error}") from error
    _within(line_b, "slot", slot, 1, glonass.SLOTS)
    _within(line_b, "time of the ascending node in s", time, 0.0, glonass.DAY)
    _within(line_c, "longitude of the node in semicircles", lam, -1.0, 1.0)
    _within(line_c, "correction to inclination in semicircles", di, -0.1, 0.1)
    _within(line_c, "argument of perigee in semicircles", omega, -1.0, 1.0)
    _within(line_c, "eccentricity", ecc, 0.0, 0.05)
    _within(line_c, "correction to the period in s", dt, -3.6e3, 3.6e3)
    _within(line_c, "rate of the period in s per orbit", dt_rate, -0.01, 0.01)
    return slot, health, float((date - _EPOCH).days), time, lam, di, omega, ecc, dt, dt_rate


def _numbers(line: int, text: str) -> list[float]:
    values = []
    for word in text.split():
        try:
            values.append(float(word))
        except ValueError:
            raise AlmanacError(line, f"'{word[:30]}' is not a number") from None
        if not math.isfinite(values[-1]):
            raise AlmanacError(line, f"'{word[:30]}' is not a finite number")
    return values


def _within(line: int, name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise AlmanacError(line, f"{name} is {value:g}, allowed is {low:g} to {high:g}")
