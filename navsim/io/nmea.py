"""NMEA 0183 sentences: fixes from GGA, RMC and VTG.

Parsing and checksums are those of the `pynmeagps` package; what belongs to one epoch, and what it means, is ours.

Source: [1] NMEA 0183 version 4.11: GGA (fix, height over the geoid, geoid separation), RMC (date, speed and course over
ground), VTG (speed and course).
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np

from navsim.io.text import FileError
from navsim.models import timescales

KNOT = 1852.0 / 3600.0
_USED = ("GGA", "RMC", "VTG")


class Assembler:
    """Puts the sentences of each epoch together; for files and for live streams.

    `feed` takes one line; an epoch is complete when a sentence of another time comes, or at `flush`. Corrupt lines are
    counted, not raised.
    """

    def __init__(self) -> None:
        self.corrupt = 0
        self.other = 0
        self.no_fix = 0
        self.untimed = 0
        self._time: datetime.time | None = None
        self._fields: dict[str, Any] = {}
        self._date: datetime.date | None = None
        self._day_offset = 0

    def feed(self, line: str) -> np.ndarray | None:
        """A row (8,) as of `recording.GNSS_COLUMNS` and the number of satellites, when the line completes an epoch.

        Times are UTC, POSIX s, or seconds of the first day where no sentence gives the date.
        """
        parsed = parse(line)
        if parsed is None:
            self.corrupt += bool(line.strip())
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
            self._fields["motion"] = (parsed.spd, parsed.cog, KNOT) if parsed.status == "A" else None
        elif self._fields.get("motion") is None:
            self._fields["motion"] = (parsed.sogk, parsed.cogt, 1.0 / 3.6)
        return done

    def flush(self) -> np.ndarray | None:
        """The row of the epoch gathered so far, if it has a fix."""
        fields, self._fields = self._fields, {}
        gga = fields.get("gga")
        if gga is None or self._time is None:
            return None
        numbers = [gga.lat, gga.lon, gga.alt, gga.sep]
        if not gga.quality or not all(isinstance(v, int | float) for v in numbers[:3]):
            self.no_fix += 1
            return None
        lat, lon, alt, sep = (float(v) if isinstance(v, int | float) else 0.0 for v in numbers)
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
        count = float(gga.numSV) if isinstance(gga.numSV, int) else np.nan
        return np.array([seconds, lat, lon, alt + sep, north, east, np.nan, count])


def parse(line: str) -> Any:
    """The message of a line by `pynmeagps`, None for anything that is not one whole sentence with its checksum."""
    from pynmeagps import NMEAReader
    from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

    text = line.strip()
    if not text.startswith("$") or "*" not in text or not text.isascii() or len(text) > 120:
        return None
    try:
        return NMEAReader.parse((text + "\r\n").encode(), validate=1)
    except (NMEAParseError, NMEAMessageError, NMEATypeError, ValueError, IndexError, KeyError, TypeError):
        return None


def read_nmea(path: Path, lines: list[str]) -> tuple[np.ndarray, Any]:
    """Rows of fixes (m, 8) of a file's lines, and what was left out. Raises FileError where there is no fix."""
    from navsim.io.recording import Dropped

    assembler = Assembler()
    rows = [row for row in (assembler.feed(line) for line in lines) if row is not None]
    last = assembler.flush()
    rows += [] if last is None else [last]
    if not rows:
        raise FileError(0, f"no NMEA fix among {len(lines)} lines ({assembler.corrupt} of them corrupt)", path)
    dropped = Dropped()
    dropped.add("corrupt NMEA lines", assembler.corrupt)
    dropped.add("NMEA epochs without a fix", assembler.no_fix)
    dropped.add("NMEA sentences without a time of day (a leap second has none)", assembler.untimed)
    return np.array(rows), dropped
