"""NMEA 0183 sentences: fixes from GGA, GNS, RMC, VTG and GLL, dates from RMC and ZDA.

Loggers put comments between sentences, and times or other text around them: a sentence extends from a `$` to its
checksum, anywhere in the line. The `pynmeagps` package parses it. Assignment to epochs and interpretation are done
here.

GGA has a quality of the position, other sentences have mode letters [1]. Qualities 1 to 5 and 9, modes A, D, F, P and R
are fixes. Quality 6, mode E is the receiver's own dead reckoning, 7, M a position typed in, 8, S a simulator: none of
them measures the position. Quality 0, mode N, status V are no fix. GNS has one letter for each system: one fix among
them is enough.

Source: [1] NMEA 0183 version 4.11: GGA and GNS (fix, height over the geoid, geoid separation), RMC (date, speed and
course over ground), VTG (speed and course), GLL (position), ZDA (date).
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Sequence
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

import numpy as np

from navsim.formats.conventions import KNOT
from navsim.formats.text import Dropped, FileError
from navsim.gnss import timescales

_FIELDS = {"GGA": 14, "GNS": 12, "RMC": 11, "VTG": 8, "GLL": 6, "ZDA": 6}
"""The kinds of sentences that are read, and how many fields each has at least: without a checksum, one that is cut off
shows by nothing else."""
_QUALITIES = {**dict.fromkeys((1, 2, 3, 4, 5, 9), "fix"), 6: "estimated", 7: "manual", 8: "simulated"}
_MODES = {**dict.fromkeys("ADFPR", "fix"), "E": "estimated", "M": "manual", "S": "simulated"}
"""Meaning of a GGA quality, and of a mode of other sentences; first those of fixes."""
INSTEAD_OF_FIXES = {
    "estimated": "NMEA epochs of the receiver's own dead reckoning (quality 6 or mode E), which are no fixes",
    "manual": "NMEA epochs of positions typed into the receiver (quality 7 or mode M), which are no fixes",
    "simulated": "NMEA epochs of a simulator (quality 8 or mode S), which are no fixes unless you ask for them",
}
"""Kinds of positions that are no fixes, with the words for a count of them."""
_WITHOUT_CHECKSUM = "NMEA sentences without a checksum (which NMEA 0183 leaves optional), or cut off before it"
STANDING = 0.1
"""Speed, m/s, up to which a velocity without a course is taken for zero: receivers at rest leave the course empty."""
_SAME_PLACE = 1e-3
"""Fixes of one epoch that differ by more, degrees, are not those of one receiver (whose GPS and GLONASS fixes may both
be sent)."""
BACKWARDS = 60.0
"""Sentences of one receiver are not delayed by more than this, s: a file whose time goes back further is two."""
LONGEST_PAUSE = timescales.DAY
"""A file whose fixes pause for longer than this, s, is two."""
_BEGIN = re.compile(r"[$!][A-Z][A-Z0-9]{2,},")
_WHOLE = re.compile(r"\$([A-Z][^$*]*)\*([0-9A-Fa-f]{2})(?![0-9A-Za-z])")
_LONGEST = 120
"""Characters of a sentence that is read; the standard has 82."""
_BARE = re.compile(r"\$([A-Z][A-Z0-9]{2,},[^$*]*)")
_KIND = re.compile(r"[A-OQ-Z][A-Z0-9]([A-Z]{3}),")
"""The kind of a sentence after its talker; one that begins with P is a maker's own."""


class Assembler:
    """Combine the sentences of each epoch; for files and for live streams.

    `feed` takes one line. An epoch is complete when a sentence of another time comes, or at `flush`. Errors are
    counted, not raised:

    - corrupt sentences, and omitted ones without a checksum;
    - lines without a sentence (comments that begin with # do not count);
    - epochs without a fix, and those of each kind of `INSTEAD_OF_FIXES`;
    - fixes without a height (missing in GGA or GNS, or neither sentence), and fixes that contradict another of their
      epoch;
    - fixes used without a geoid separation, where none came before: their heights above the geoid count as heights
      above the ellipsoid. Later ones take the last separation.

    lenient: accept sentences without a checksum, which NMEA 0183 leaves optional. simulated: accept simulators' fixes.

    Times are UTC, POSIX s. Until a sentence contains the date (`dated`) they are seconds of the first day. `moved` is
    the correction of such times, s, once it is known. A date in an invalid RMC comes from a receiver reset and is
    ignored. After a date, days are counted by the time of day, which every fix contains.
    """

    def __init__(self, lenient: bool = False, simulated: bool = False) -> None:
        self.lenient = lenient
        self.takes_simulated = simulated
        self.corrupt = 0
        self.no_checksum = 0
        self.foreign = 0
        self.other = 0
        self.empty = 0
        self.estimated = 0
        self.manual = 0
        self.simulated = 0
        self.no_height = 0
        self.no_separation = 0
        self._separation: float | None = None
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
        parsed = self._parsed(sentence)
        if parsed is None:
            return None
        if parsed.msgID == "ZDA":
            self._zda(parsed)
            return None
        done = None
        if parsed.msgID != "VTG":
            time = _field(parsed, "time")
            if not isinstance(time, datetime.time):
                # of no epoch, least of all of the one before: a receiver that does not know the time yet, or a leap
                # second, 23:59:60, which UTC as a count of seconds cannot distinguish from the second after it
                self.untimed += 1
                return None
            date = _field(parsed, "date") if parsed.msgID == "RMC" and _field(parsed, "status") == "A" else None
            if isinstance(date, datetime.date) and not self.dated:  # also the epoch before is of this date then
                self._set_date(date, time)
            if self._time is not None and time != self._time:
                done = self.flush()
            if isinstance(date, datetime.date):
                self._set_date(date, time)
            self._time = time
        if self._time is not None:
            self._gather(parsed)
        return done

    def _parsed(self, sentence: str) -> Any:
        """Message by `pynmeagps` of a sentence from its `$`; None, counted, for an omitted one.

        Text after a checksum is ignored.
        """
        whole, bare = _WHOLE.match(sentence), _BARE.fullmatch(sentence.strip())
        found = whole or bare
        body = found[1] if found is not None and found[1].isascii() else ""
        kind = _KIND.match(body)
        fields = _FIELDS.get(kind[1], 0) if kind is not None else 0
        used = fields > 0
        if whole is not None:
            damaged = (used and len(body) > _LONGEST) or not is_intact(body, whole[2])
        else:
            damaged = body.count(",") < fields
        if damaged or not body:
            self.corrupt += 1
        elif whole is None and not self.lenient:
            self.no_checksum += 1
        elif not used:
            self.other += 1
        else:
            parsed = parse(body)
            self.corrupt += parsed is None
            return parsed
        return None

    def _gather(self, parsed: Any) -> None:
        """Keep the data of an epoch: its first fix, GGA before GNS, with a height before without. A fix elsewhere is
        counted."""
        fields, kind, fix = self._fields, parsed.msgID, _kind_of_fix(parsed)
        if fix == "simulated" and self.takes_simulated:
            fix = "fix"
        if fix in INSTEAD_OF_FIXES:
            fields.setdefault("instead", fix)
        elif kind in ("GGA", "GNS"):
            there = fields.get("fix")
            if fix == "none" or not _are_numbers(parsed, "lat", "lon"):
                fields["lost"] = True
            elif there is None:
                fields["fix"] = parsed
            elif not _one_place(there, parsed):
                self.contradicting += 1
            elif _worth(parsed) > _worth(there):
                fields["fix"] = parsed
        elif kind in ("RMC", "GLL"):
            if fix == "none":
                fields["invalid"] = True
            elif _are_numbers(parsed, "lat", "lon"):
                fields["without_height"] = True
        if fix == "fix" and kind in ("RMC", "VTG"):
            fields.setdefault(kind, parsed)

    def _zda(self, zda: Any) -> None:
        try:
            date = datetime.date(*(int(_field(zda, name)) for name in ("year", "month", "day")))
        except (TypeError, ValueError):  # empty before the first fix, or no such date
            return
        if isinstance(_field(zda, "time"), datetime.time):
            self._set_date(date, zda.time)

    def _set_date(self, date: datetime.date, time: datetime.time) -> None:
        of_day = _seconds(time)
        day = date.toordinal() - _FIRST_DAY
        if not self.dated:
            self.moved = timescales.DAY * (day - self._day(of_day))
            self.dated = True
        self._at = (day, of_day)

    def _day(self, of_day: float) -> int:
        """Day on which a time of day is nearest to the last one known."""
        if self._at is None:
            return 0
        day, before = self._at
        return day - round((of_day - before) / timescales.DAY)

    def flush(self) -> np.ndarray | None:
        """The row of the epoch gathered so far, if it has a fix."""
        fields, self._fields = self._fields, {}
        fix = fields.get("fix")
        if self._time is None or not fields:
            return None
        if "instead" in fields:
            setattr(self, fields["instead"], getattr(self, fields["instead"]) + 1)
            return None
        if "invalid" in fields or (fix is None and "lost" in fields):
            self.empty += 1
            return None
        if fix is None or not _are_numbers(fix, "alt"):
            self.no_height += fix is not None or "without_height" in fields
            return None
        lat, lon, alt = float(fix.lat), float(fix.lon), float(fix.alt)
        separation = float(fix.sep) if _are_numbers(fix, "sep") else self._separation
        sep = 0.0 if separation is None else separation
        sides = _field(fix, "NS") in ("N", "S") and _field(fix, "EW") in ("E", "W")
        if not (sides and abs(lat) <= 90.0 and abs(lon) <= 180.0 and -1e4 <= alt + sep <= 1e5):
            self.corrupt += 1
            return None
        of_day = _seconds(self._time)
        self._at = (self._day(of_day), of_day)
        seconds = timescales.DAY * self._at[0] + of_day
        self._separation = separation
        self.no_separation += separation is None
        count = float(fix.numSV) if _are_numbers(fix, "numSV") else np.nan
        return np.array([seconds, lat, lon, alt + sep, *_velocity(fields), np.nan, count])


_FIRST_DAY = datetime.date(1970, 1, 1).toordinal()


def _seconds(time: datetime.time) -> float:
    return 3600 * time.hour + 60 * time.minute + time.second + 1e-6 * time.microsecond


def _kind_of_fix(parsed: Any) -> str:
    """Type of the position of a sentence: `fix`, `none`, or one of `INSTEAD_OF_FIXES`."""
    if parsed.msgID == "GGA":
        return _QUALITIES.get(_field(parsed, "quality"), "none")
    letters = str(_field(parsed, "posMode"))
    valid = parsed.msgID in ("GNS", "VTG") or _field(parsed, "status") == "A"
    if not letters and parsed.msgID != "GNS":  # before version 2.3
        return "fix" if valid else "none"
    text = next((kind for letter, kind in _MODES.items() if letter in letters), "none")
    return text if valid or text != "fix" else "none"


def _velocity(fields: dict[str, Any]) -> tuple[float, float]:
    """North and east velocity, m/s, of the first of RMC and VTG that has speed and course; nan without one.

    The magnetic course of a VTG is none: it is off by the declination.
    """
    for kind, course_name, units in (("RMC", "cog", {"spd": KNOT}), ("VTG", "cogt", {"sogk": 1.0 / 3.6, "sogn": KNOT})):
        sentence = fields.get(kind)
        if kind == "VTG" and _field(sentence, "cogtUnit") not in ("T", ""):
            continue  # of an old version, whose fields have no letters between them
        speeds = [unit * getattr(sentence, name) for name, unit in units.items() if _are_numbers(sentence, name)]
        if speeds and _are_numbers(sentence, course_name):
            course = np.radians(float(getattr(sentence, course_name)))
            return float(speeds[0] * np.cos(course)), float(speeds[0] * np.sin(course))
        if speeds and speeds[0] <= STANDING:
            return 0.0, 0.0
    return np.nan, np.nan


def _worth(fix: Any) -> tuple[bool, bool]:
    """Rank for the choice of an epoch's fix."""
    return _are_numbers(fix, "alt"), fix.msgID == "GGA"


def _one_place(a: Any, b: Any) -> bool:
    """Whether two sentences give the same place."""
    return bool(abs(a.lat - b.lat) <= _SAME_PLACE and abs(a.lon - b.lon) <= _SAME_PLACE)


def _are_numbers(parsed: Any, *names: str) -> bool:
    """Whether these fields hold numbers."""
    return all(isinstance(_field(parsed, name), int | float) for name in names)


def _field(parsed: Any, name: str) -> Any:
    """A field by its name in `pynmeagps`; empty where the sentence has fewer fields."""
    return getattr(parsed, name, "")


def has_sentences(lines: list[str]) -> bool:
    """Whether any of the lines holds the beginning of a sentence."""
    return any(_BEGIN.search(line) for line in lines)


def is_intact(body: str, digits: str) -> bool:
    """Whether the text between `$` and `*` of a sentence has the checksum of these two digits."""
    return reduce(xor, body.encode(), 0) == int(digits, 16)


def parse(body: str) -> Any:
    """Message by `pynmeagps` of the text between `$` and `*` of a sentence; None for invalid values."""
    from pynmeagps import NMEAReader
    from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

    if "_" in body:  # the package reads numbers as Python does, with underscores between their digits
        return None
    try:
        return NMEAReader.parse(f"${body}*00\r\n".encode(), validate=0)
    except (NMEAParseError, NMEAMessageError, NMEATypeError, ValueError, IndexError, KeyError, TypeError):
        return None


def read_nmea(path: Path, lines: list[str], dropped: Dropped, simulated: bool = False) -> np.ndarray:
    """Rows of fixes (m, 8) of a file's lines; omissions are counted.

    Fixes before the first date get that date. simulated: accept those of simulators. Raises FileError without a fix,
    and at the line at which the times show the start of another recording.
    """
    assembler = Assembler(dropped.lenient, simulated)
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
    dropped.add(
        f"{_WITHOUT_CHECKSUM}; to read them, write `skip_bad_records: true` in the log.yaml that names the file",
        assembler.no_checksum,
    )
    dropped.add("lines without an NMEA sentence", assembler.foreign)
    dropped.add("NMEA epochs without a fix", assembler.empty)
    for kind, words in INSTEAD_OF_FIXES.items():
        key = "; write `gnss.simulator_fixes: true` to use them" if kind == "simulated" else ""
        dropped.add(words + key, getattr(assembler, kind))
    dropped.add("NMEA fixes without a height (no GGA or GNS, or none in it)", assembler.no_height)
    dropped.add("NMEA fixes that contradict another of their epoch", assembler.contradicting)
    if not rows:
        text = "; ".join(dropped.reasons()) or "the file has no GGA, GNS, RMC, VTG or GLL"
        raise FileError(0, f"no NMEA fix with a height in {len(lines)} lines: {text}", path)
    reason = "NMEA fixes without a geoid separation; navsim takes their heights as heights above the ellipsoid"
    dropped.add(reason, assembler.no_separation)
    dropped.add("NMEA sentences without a time of day (a leap second has none)", assembler.untimed)
    table = np.array(rows)
    table[:undated, 0] += assembler.moved
    one_recording(path, table[:, 0], [0, *after], timescales.utc_text if assembler.dated else _of_day)
    return table


def _of_day(time: float) -> str:
    return f"{time:.3f} s of the day"


def one_recording(
    path: Path, time: np.ndarray, lines: Sequence[int], told: Callable[[float], str] = "{:.3f} s".format
) -> None:
    """Raise FileError where times (m,), s, go back by more than a minute, or on by days.

    lines: number of the line of each; told: how the message writes one.
    """
    step = np.diff(time)
    wrong = np.flatnonzero((step < -BACKWARDS) | (step > LONGEST_PAUSE))
    if not wrong.size:
        return
    k = int(wrong[0])
    before, then = (told(float(t)) for t in time[k : k + 2])
    weeks = round(float(step[k]) / timescales.WEEK)
    rollovers = weeks // 1024 if weeks % 1024 == 0 else 0
    if rollovers and abs(step[k] - 1024 * timescales.WEEK * rollovers) < timescales.DAY:
        cause = "by 1024 weeks: the receiver's GPS week count rolled over; correct the dates before or after this line"
    elif weeks == -1 and abs(step[k] + timescales.WEEK) < BACKWARDS:
        cause = "by a week: seconds of the week began again; add 604800 s to the times from this line on"
    else:
        cause = "so the file seems to have two recordings; split it here"
    raise FileError(lines[k + 1], f"the time goes from {before} to {then}, {cause}", path)
