"""NMEA 0183 sentences: fixes from GGA, RMC and VTG.

Loggers put comments between sentences, and times or other text around them: a sentence is what stands from a `$` to its
checksum, wherever in the line. Parsing and checksums are those of the `pynmeagps` package; what belongs to one epoch,
and what it means, is ours.

Source: [1] NMEA 0183 version 4.11: GGA (fix, height over the geoid, geoid separation), RMC (date, speed and course over
ground), VTG (speed and course).
"""

from __future__ import annotations

import datetime
import re
from pathlib import Path
from typing import Any

import numpy as np

from navsim.io.text import Dropped, FileError
from navsim.models import timescales

KNOT = 1852.0 / 3600.0
_USED = ("GGA", "RMC", "VTG")
_BEGIN = re.compile(r"[$!][A-Z][A-Z0-9]{2,},")
_WHOLE = re.compile(r"\$[A-Z][^$*]*\*[0-9A-Fa-f]{2}(?![0-9A-Za-z])")


class Assembler:
    """Puts the sentences of each epoch together; for files and for live streams.

    `feed` takes one line; an epoch is complete when a sentence of another time comes, or at `flush`. Nothing is raised;
    counted are corrupt sentences, lines without a sentence (comments that begin with # are none), epochs without a fix,
    fixes without a height (none in GGA, or no GGA with an RMC), and fixes used whose GGA has no geoid separation: their
    heights, which are over the geoid, pass for heights over the ellipsoid.
    """

    def __init__(self) -> None:
        self.corrupt = 0
        self.foreign = 0
        self.other = 0
        self.no_fix = 0
        self.no_height = 0
        self.no_separation = 0
        self.untimed = 0
        self._time: datetime.time | None = None
        self._fields: dict[str, Any] = {}
        self._date: datetime.date | None = None
        self._day_offset = 0

    def feed(self, line: str) -> list[np.ndarray]:
        """Rows (8,) as of `recording.GNSS_COLUMNS` and the number of satellites, of the epochs that the line completes.

        Times are UTC, POSIX s, or seconds of the first day where no sentence gives the date.
        """
        before, *pieces = line.split("$")
        if not pieces and _BEGIN.search(before):
            self.other += 1  # encapsulated messages, such as those of ships, begin with an exclamation mark
        elif not pieces:
            self.foreign += bool(before.strip()) and not before.lstrip().startswith("#")
        rows = (self._take("$" + piece) for piece in pieces)
        return [row for row in rows if row is not None]

    def _take(self, sentence: str) -> np.ndarray | None:
        parsed = parse(sentence)
        if parsed is None:
            self.corrupt += 1
            return None
        if parsed.msgID not in _USED:
            self.other += 1
            return None
        done = None
        time = getattr(parsed, "time", None)
        if parsed.msgID != "VTG" and not isinstance(time, datetime.time):
            # of no epoch, least of all of the one before: a receiver that does not know the time yet, or a leap second,
            # 23:59:60, which UTC as a count of seconds cannot tell from the second after it
            self.untimed += 1
            return None
        if isinstance(time, datetime.time):
            if self._time is not None and time != self._time:
                done = self.flush()
            if self._time is not None and time < self._time and self._date is None:
                self._day_offset += 1
            self._time = time
        if self._time is None:
            return done
        if parsed.msgID == "GGA":
            self._fields["gga"] = parsed
        elif parsed.msgID == "RMC":
            if isinstance(parsed.date, datetime.date):
                self._date = parsed.date
            valid = parsed.status == "A"
            self._fields["motion"] = (parsed.spd, parsed.cog, KNOT) if valid else None
            if valid and _are_numbers(parsed.lat, parsed.lon):
                self._fields["rmc"] = parsed
        elif self._fields.get("motion") is None:
            self._fields["motion"] = (parsed.sogk, parsed.cogt, 1.0 / 3.6)
        return done

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
        t = self._time
        seconds = 3600 * t.hour + 60 * t.minute + t.second + 1e-6 * t.microsecond
        if self._date is not None:
            seconds += timescales.posix(self._date.year, self._date.month, self._date.day)
        else:
            seconds += timescales.DAY * self._day_offset
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
        return NMEAReader.parse((whole.group() + "\r\n").encode(), validate=1)
    except (NMEAParseError, NMEAMessageError, NMEATypeError, ValueError, IndexError, KeyError, TypeError):
        return None


def read_nmea(path: Path, lines: list[str], dropped: Dropped) -> np.ndarray:
    """Rows of fixes (m, 8) of a file's lines; what was left out is counted. Raises FileError where there is no fix."""
    assembler = Assembler()
    rows = [row for line in lines for row in assembler.feed(line)]
    last = assembler.flush()
    rows += [] if last is None else [last]
    dropped.add("corrupt NMEA sentences", assembler.corrupt)
    dropped.add("lines without an NMEA sentence", assembler.foreign)
    dropped.add("NMEA epochs without a fix", assembler.no_fix)
    dropped.add("NMEA fixes without a height (no GGA, or none in it)", assembler.no_height)
    if not rows:
        said = "; ".join(dropped.said()) or "no GGA, RMC or VTG"
        raise FileError(0, f"no NMEA fix with a height among {len(lines)} lines: {said}", path)
    reason = "NMEA fixes without a geoid separation; their heights, over the geoid, pass for heights over the ellipsoid"
    dropped.add(reason, assembler.no_separation)
    dropped.add("NMEA sentences without a time of day (a leap second has none)", assembler.untimed)
    return np.array(rows)
