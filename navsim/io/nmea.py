"""NMEA 0183 sentences: fixes from GGA, RMC and VTG, dates from RMC and ZDA.

Loggers put comments between sentences, and times or other text around them: a sentence is what stands from a `$` to its
checksum, wherever in the line. Parsing and checksums are those of the `pynmeagps` package; what belongs to one epoch,
and what it means, is ours.

Source: [1] NMEA 0183 version 4.11: GGA (fix, height over the geoid, geoid separation), RMC (date, speed and course over
ground), VTG (speed and course), ZDA (date).
"""

from __future__ import annotations

import datetime
import re
from pathlib import Path
from typing import Any

import numpy as np

from navsim.io.text import Dropped, FileError
from navsim.models import timescales
from navsim.models.conventions import KNOT

_USED = ("GGA", "RMC", "VTG")
_SAME_PLACE = 1e-3
"""Fixes of one epoch that differ by more, degrees, are not those of one receiver (whose GPS and GLONASS fixes may both
be sent)."""
BACKWARDS = 60.0
"""Sentences of one receiver are not delayed by more than this, s: a file whose time goes back further is two."""
LONGEST_PAUSE = timescales.DAY
"""A file whose fixes pause for longer than this, s, is two."""
_BEGIN = re.compile(r"[$!][A-Z][A-Z0-9]{2,},")
_WHOLE = re.compile(r"\$[A-Z][^$*]*\*[0-9A-Fa-f]{2}(?![0-9A-Za-z])")


class Assembler:
    """Puts the sentences of each epoch together; for files and for live streams.

    `feed` takes one line; an epoch is complete when a sentence of another time comes, or at `flush`. Nothing is raised;
    counted are corrupt sentences, lines without a sentence (comments that begin with # are none), epochs without a fix,
    fixes without a height (none in GGA, or no GGA with an RMC), fixes that contradict another of their epoch, and fixes
    used whose GGA has no geoid separation: their heights, which are over the geoid, pass for heights over the
    ellipsoid.

    Times are UTC, POSIX s. Until a sentence has given the date (`dated`) they are seconds of the first day; `moved` is
    what such rows' times lack, s, once it is known. Dates of an RMC that is not valid are those of a receiver's reset.
    After a date, days are counted by the time of day: it is what every fix carries.
    """

    def __init__(self) -> None:
        self.corrupt = 0
        self.foreign = 0
        self.other = 0
        self.no_fix = 0
        self.no_height = 0
        self.no_separation = 0
        self.untimed = 0
        self.contradicting = 0
        self.dated = False
        self.moved = 0.0
        self._time: datetime.time | None = None
        self._fields: dict[str, Any] = {}
        self._at: tuple[int, float] | None = None

    def feed(self, line: str) -> list[np.ndarray]:
        """Rows (8,) as of `conventions.GNSS_COLUMNS` and the number of satellites, of the epochs a line completes."""
        before, *pieces = line.split("$")
        if not pieces and _BEGIN.search(before):
            self.other += 1  # encapsulated messages, such as those of ships, begin with an exclamation mark
        elif not pieces:
            self.foreign += bool(before.strip()) and not before.lstrip().startswith("#")
        rows: list[np.ndarray] = []
        for piece in pieces:
            moved = self.moved
            row = self._take("$" + piece)
            for earlier in rows:
                earlier[0] += self.moved - moved
            rows += [] if row is None else [row]
        return rows

    def _take(self, sentence: str) -> np.ndarray | None:
        parsed = parse(sentence)
        if parsed is None:
            self.corrupt += 1
            return None
        if parsed.msgID == "ZDA":
            self._zda(parsed)
            return None
        if parsed.msgID not in _USED:
            self.other += 1
            return None
        done = None
        if parsed.msgID != "VTG":
            time = parsed.time
            if not isinstance(time, datetime.time):
                # of no epoch, least of all of the one before: a receiver that does not know the time yet, or a leap
                # second, 23:59:60, which UTC as a count of seconds cannot tell from the second after it
                self.untimed += 1
                return None
            date = parsed.date if parsed.msgID == "RMC" and parsed.status == "A" else None
            if isinstance(date, datetime.date) and not self.dated:  # also the epoch before is of this date then
                self._set_date(date, time)
            if self._time is not None and time != self._time:
                done = self.flush()
            if isinstance(date, datetime.date):
                self._set_date(date, time)
            self._time = time
        if self._time is None:
            return done
        if parsed.msgID == "GGA":
            self._gga(parsed)
        elif parsed.msgID == "RMC":
            valid = parsed.status == "A"
            self._fields["motion"] = (parsed.spd, parsed.cog, KNOT) if valid else None
            if valid and _are_numbers(parsed.lat, parsed.lon):
                self._fields["rmc"] = parsed
        elif self._fields.get("motion") is None:
            self._fields["motion"] = (parsed.sogk, parsed.cogt, 1.0 / 3.6)
        return done

    def _gga(self, gga: Any) -> None:
        """The first fix of an epoch is its fix; another one of another place is counted."""
        there = self._fields.get("gga")
        if there is None or not there.quality:
            self._fields["gga"] = gga
        elif gga.quality and not _one_place(there, gga):
            self.contradicting += 1

    def _zda(self, zda: Any) -> None:
        try:
            date = datetime.date(int(zda.year), int(zda.month), int(zda.day))
        except (TypeError, ValueError):  # empty before the first fix, or no such date
            return
        if isinstance(zda.time, datetime.time):
            self._set_date(date, zda.time)

    def _set_date(self, date: datetime.date, time: datetime.time) -> None:
        of_day = _seconds(time)
        day = date.toordinal() - _FIRST_DAY
        if not self.dated:
            self.moved = timescales.DAY * (day - self._day(of_day))
            self.dated = True
        self._at = (day, of_day)

    def _day(self, of_day: float) -> int:
        """The day on which a time of day is nearest to the last one known."""
        if self._at is None:
            return 0
        day, before = self._at
        return day - round((of_day - before) / timescales.DAY)

    def flush(self) -> np.ndarray | None:
        """The row of the epoch gathered so far, if it has a fix."""
        fields, self._fields = self._fields, {}
        gga = fields.get("gga")
        if gga is None or self._time is None:
            self.no_height += "rmc" in fields
            return None
        if not gga.quality or not _are_numbers(gga.lat, gga.lon):
            self.no_fix += 1
            return None
        if not _are_numbers(gga.alt):
            self.no_height += 1
            return None
        lat, lon, alt = float(gga.lat), float(gga.lon), float(gga.alt)
        known = _are_numbers(gga.sep)
        sep = float(gga.sep) if known else 0.0
        if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0 and -1e4 <= alt + sep <= 1e5):
            self.corrupt += 1
            return None
        of_day = _seconds(self._time)
        self._at = (self._day(of_day), of_day)
        seconds = timescales.DAY * self._at[0] + of_day
        north = east = np.nan
        motion = fields.get("motion")
        if motion is not None and isinstance(motion[0], int | float):
            # a receiver at rest leaves the course empty
            course = np.radians(float(motion[1])) if isinstance(motion[1], int | float) else 0.0
            speed = float(motion[0]) * motion[2]
            north, east = speed * np.cos(course), speed * np.sin(course)
        self.no_separation += not known
        count = float(gga.numSV) if isinstance(gga.numSV, int) else np.nan
        return np.array([seconds, lat, lon, alt + sep, north, east, np.nan, count])


_FIRST_DAY = datetime.date(1970, 1, 1).toordinal()


def _seconds(time: datetime.time) -> float:
    return 3600 * time.hour + 60 * time.minute + time.second + 1e-6 * time.microsecond


def _one_place(a: Any, b: Any) -> bool:
    """Whether two GGA sentences give the same place, as far as they give one."""
    pairs = [(a.lat, b.lat), (a.lon, b.lon)]
    return all(abs(x - y) <= _SAME_PLACE for x, y in pairs if _are_numbers(x, y))


def _are_numbers(*values: Any) -> bool:
    """Whether `pynmeagps` found numbers; empty fields are empty strings to it."""
    return all(isinstance(value, int | float) for value in values)


def has_sentences(lines: list[str]) -> bool:
    """Whether any of the lines holds the beginning of a sentence."""
    return any(_BEGIN.search(line) for line in lines)


def parse(text: str) -> Any:
    """The message by `pynmeagps` of what begins with a `$`, None for anything but a whole sentence with its checksum.

    What follows the checksum is not looked at.
    """
    from pynmeagps import NMEAReader
    from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

    whole = _WHOLE.match(text)
    if whole is None or not whole.group().isascii() or len(whole.group()) > 120:
        return None
    try:
        parsed = NMEAReader.parse((whole.group() + "\r\n").encode(), validate=1)
        # the package reads numbers as Python does, with underscores between their digits
        return None if "_" in whole.group() and parsed.msgID in (*_USED, "ZDA") else parsed
    except (NMEAParseError, NMEAMessageError, NMEATypeError, ValueError, IndexError, KeyError, TypeError):
        return None


def read_nmea(path: Path, lines: list[str], dropped: Dropped) -> np.ndarray:
    """Rows of fixes (m, 8) of a file's lines; what was left out is counted.

    Fixes before the first date are given it. Raises FileError where there is no fix, and at the line where the times
    show that another recording begins.
    """
    assembler = Assembler()
    rows: list[np.ndarray] = []
    after: list[int] = []
    undated = 0
    for number, line in enumerate(lines, 1):
        for row in assembler.feed(line):
            undated += not assembler.dated
            rows.append(row)
            after.append(number)
    last = assembler.flush()
    if last is not None:
        undated += not assembler.dated
        rows.append(last)
    dropped.add("corrupt NMEA sentences", assembler.corrupt)
    dropped.add("lines without an NMEA sentence", assembler.foreign)
    dropped.add("NMEA epochs without a fix", assembler.no_fix)
    dropped.add("NMEA fixes without a height (no GGA, or none in it)", assembler.no_height)
    dropped.add("NMEA fixes that contradict another of their epoch", assembler.contradicting)
    if not rows:
        said = "; ".join(dropped.said()) or "no GGA, RMC or VTG"
        raise FileError(0, f"no NMEA fix with a height among {len(lines)} lines: {said}", path)
    reason = "NMEA fixes without a geoid separation; their heights, over the geoid, pass for heights over the ellipsoid"
    dropped.add(reason, assembler.no_separation)
    dropped.add("NMEA sentences without a time of day (a leap second has none)", assembler.untimed)
    table = np.array(rows)
    table[:undated, 0] += assembler.moved
    _one_recording(path, table[:, 0], after, assembler.dated)
    return table


def _one_recording(path: Path, time: np.ndarray, after: list[int], dated: bool) -> None:
    """Refuse times (m,) that go back, or on by days: after[k] is the line where the epoch of time[k] was over."""
    step = np.diff(time)
    wrong = np.flatnonzero((step < -BACKWARDS) | (step > LONGEST_PAUSE))
    if not wrong.size:
        return
    k = int(wrong[0])
    before, then = (timescales.utc_text(t) if dated else f"{t:.3f} s of the day" for t in time[k : k + 2])
    rollovers = round(float(step[k]) / (1024 * timescales.WEEK))
    if rollovers and abs(step[k] - 1024 * timescales.WEEK * rollovers) < timescales.DAY:
        cause = "by 1024 weeks: the receiver's count of GPS weeks rolled over; correct the dates of one part"
    else:
        cause = "two recordings in one file? Split it here"
    raise FileError(after[k], f"the time goes from {before} to {then}, {cause}", path)
