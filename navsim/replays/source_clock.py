"""Convert the times of a source's messages to seconds of the flight.

A source's times are UTC with a date, UTC times of day (NMEA before its first date), or any count of seconds. The first
two messages that follow each other determine its clock at time 0 of the flight. The scenario's epoch decides if the
times fit it; otherwise the first message is the scenario's first. If messages contain a position, an interpretation
that contradicts it ranks behind one that does not.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from navsim.formats.text import plain_number
from navsim.gnss import timescales

Kind = Literal["dated", "undated", "count"]
"""Stamps: UTC (POSIX s), UTC seconds of an unknown day, or a number of a table (any of these or another count)."""
Base = Literal["utc", "time of day", "flight time", "first line", "given"]
MEANING = {
    "utc": "by UTC and the scenario's epoch",
    "time of day": "by the time of day of the scenario's epoch",
    "flight time": "the source counts from the scenario's epoch",
    "first line": "by the first line, taken for the scenario's first",
    "given": "as --start-time says",
}
LEAD = 600.0
"""A source may begin this long before the flight, s, and is waited for; further off, its clock is another one."""
LONGEST_STEP = 10.0
"""Two messages follow each other when they are not further apart than this, s, or than ten periods."""
LONGEST_SILENT_START = 1.0
"""Samples counted from later than this, s, do not count from the start of the flight: nothing could be integrated."""
FITS = 6.0
"""Largest distance of a position from the flight, in the receiver's sigmas, that fits."""
FIRST: Literal["first"] = "first"
_YEARS = (timescales.posix(1980, 1, 1), timescales.posix(2100, 1, 1))


class StartError(ValueError):
    """A start time that is none."""


@dataclass(frozen=True)
class Start:
    """Reading of the source's clock at time 0 of the flight according to the user: s, or POSIX s for an instant."""

    reading: float
    instant: bool


@dataclass(frozen=True)
class SourceClock:
    """Clock of a source: reading at time 0 of the flight, s; kind of stamps; how it was found; doubts, or empty."""

    offset: float
    kind: Kind
    base: Base
    doubt: str = ""

    def reading(self, stamp: float) -> str:
        """A reading of the source's clock, in the words of --start-time."""
        if self.kind == "dated" or _is_utc(stamp):
            return timescales.utc_text(stamp)
        return f"{stamp:.3f} s"

    def option(self, later: float) -> str:
        """Value of --start-time for a flight that begins so much later by the source's clock, s."""
        return self.reading(self.offset + later).removesuffix(" s")

    def dated(self, ahead: float, epoch: float) -> SourceClock:
        """The clock once the date is known: times of day were short by `ahead`. epoch as in `estimate_clock`."""
        offset = self.offset + ahead
        if self.base != "time of day":
            return replace(self, offset=offset, kind="dated")
        if abs(offset - epoch) < timescales.DAY / 2.0:
            return replace(self, offset=offset, kind="dated", base="utc")
        return replace(self, offset=offset, kind="dated", doubt=_other_day(offset, epoch))

    @property
    def text(self) -> str:
        """Message for the user."""
        of_day = " of the day" if self.kind == "undated" else ""
        reading = self.reading(self.offset)
        return f"time 0 of the flight is {reading}{of_day} by the source's clock, {MEANING[self.base]}"


def start_time(text: str) -> Start | Literal["first"]:
    """Value of --start-time: UTC (ISO 8601), seconds, or `first`. Raises StartError with the allowed values."""
    if text == FIRST:
        return FIRST
    try:
        seconds = plain_number(text)
        if np.isfinite(seconds):
            return Start(seconds, False)
    except ValueError:
        try:
            when = datetime.datetime.fromisoformat(text)
            when = when if when.tzinfo is not None else when.replace(tzinfo=datetime.UTC)
            return Start(when.timestamp(), True)
        except (ValueError, OverflowError):
            pass
    raise StartError(
        f"is {text!r}; allowed are an instant as 2018-09-13T12:00:00Z, the source's own count of seconds as 1234.5, "
        "and `first` (the first line is the scenario's first)"
    )


def estimate_clock(
    stamp: float,
    kind: Kind,
    epoch: float,
    duration: float,
    period: float,
    distance: Callable[[float], float] | None,
    start: Start | Literal["first"] | None = None,
) -> SourceClock:
    """Settle a source's clock by its first message.

    - `stamp`: of that message, s; `epoch`: UTC of time 0, POSIX s.
    - `duration`, `period`: of the flight and between messages, s.
    - `distance`: of the message's position from the flight at a time (s), in sigmas; None without a position.
    """
    if start == FIRST:
        return SourceClock(stamp - period, kind, "first line")
    if start is not None:
        offset = start.reading
        if kind == "undated" and start.instant:
            offset = stamp - _within_half_a_day(stamp - start.reading)
        return SourceClock(offset, kind, "given")
    candidates = [
        *_clock_readings(stamp, kind, epoch, duration, has_position=distance is not None),
        SourceClock(stamp - period, kind, "first line"),
    ]
    if distance is None:
        return candidates[0]
    for candidate in candidates:
        time = stamp - candidate.offset
        if time < 0.0 or distance(time) <= FITS:
            break
    else:  # its position is not near the flight: any clock reading is equally good
        return candidates[0]
    if candidate is not candidates[0]:
        passed = candidates[0]
        doubt = (
            f"{MEANING[passed.base]} its first message would be at {stamp - passed.offset:.3f} s of the flight, but "
            "its position is not from there"
        )
        return SourceClock(candidate.offset, kind, candidate.base, doubt)
    return candidate


def _clock_readings(stamp: float, kind: Kind, epoch: float, duration: float, has_position: bool) -> list[SourceClock]:
    """Possible meanings of the stamp, given the scenario's epoch, the likeliest first."""
    found = []
    instant = kind == "dated" or (kind == "count" and _is_utc(stamp))
    if instant and -LEAD <= stamp - epoch <= duration:
        return [SourceClock(epoch, kind, "utc")]
    if kind == "count" and 0.0 <= stamp <= (duration if has_position else LONGEST_SILENT_START):
        found.append(SourceClock(0.0, kind, "flight time"))
    if instant or kind == "undated" or 0.0 <= stamp < timescales.DAY:
        time = _within_half_a_day(stamp - epoch)
        if (0.0 if kind == "count" and not instant else -LEAD) <= time <= duration:
            found.append(SourceClock(stamp - time, kind, "time of day", _other_day(stamp, epoch) if instant else ""))
    return found


def _is_utc(stamp: float) -> bool:
    """Whether a count of seconds can be meant as UTC, POSIX s."""
    return _YEARS[0] <= stamp < _YEARS[1]


def _within_half_a_day(seconds: float) -> float:
    return float((seconds + timescales.DAY / 2.0) % timescales.DAY - timescales.DAY / 2.0)


def _other_day(stamp: float, epoch: float) -> str:
    days = round((stamp - epoch) / timescales.DAY)
    weeks = "; its receiver's count of GPS weeks has rolled over" if days % (7 * 1024) == 0 else ""
    return f"the source's date, {timescales.utc_text(stamp)[:10]}, is not the scenario's{weeks}"
