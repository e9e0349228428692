"""Time scales of satellite navigation. Names contain the scale that they use.

- `gpst`: GPS time, seconds from 1980-01-06, which runs through leap seconds. Satellites, signals and recorded
  observations are computed at such instants, so that durations are exact.
- `utc`: seconds from 1970-01-01 without leap seconds, as POSIX counts, for dates: epochs of scenarios and times of
  GLONASS messages. GLONASS time is UTC, plus three hours for display. A leap second has the numbers of the second after
  it, so nothing is computed in it.

Sources:

- [1] IS-GPS-200, section 3.3.4 (GPS time and weeks).
- [2] IERS Bulletin C (leap seconds; none since 2017).
- [3] Aoki et al., The new definition of universal time, Astron. Astrophys. 105 (1982) (sidereal time).
"""

from __future__ import annotations

import datetime

import numpy as np

DAY = 86400.0
WEEK = 7.0 * DAY
GPS_EPOCH = 315964800.0
"""1980-01-06 00:00 UTC, s from 1970-01-01."""
BEHIND_GPS = {"GPS": 0.0, "GAL": 0.0, "QZS": 0.0, "IRN": 0.0, "BDT": 14.0, "TAI": -19.0}
"""Delay of the time systems of files behind GPS time, s, by their names in RINEX and SP3."""
LEAPING = ("UTC", "GLO")
"""Time systems of files that have UTC's leap seconds; GLONASS time in files is UTC."""
NAMES = (*BEHIND_GPS, *LEAPING)
"""All time systems that files may have."""
_LEAP_DATES = (
    "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01",
    "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01",
    "2015-07-01", "2017-01-01",
)  # fmt: skip
"""First UTC days after each leap second since 1980 [2]."""
_LEAPS = np.array([datetime.datetime.fromisoformat(d + "T00:00:00+00:00").timestamp() for d in _LEAP_DATES])
_LEAPS_GPS = _LEAPS - GPS_EPOCH + np.arange(1, _LEAPS.size + 1)


def posix(year: int, month: int, day: int, hour: int = 0, minute: int = 0, second: float = 0.0) -> float:
    """Seconds from 1970-01-01 of a calendar date and time. Raises ValueError for a date that does not exist.

    Seconds of 60 and more (a leap second, or a receiver's rounding) run into the next minute.
    """
    if not 0.0 <= second < 61.0:
        raise ValueError("second must be in 0..60")
    whole = datetime.datetime(year, month, day, hour, minute, tzinfo=datetime.UTC)
    return whole.timestamp() + second


def utc_text(utc: float) -> str:
    """A UTC time (POSIX s, years 1 to 9999) as `2018-09-13T12:00:00.100Z`. Raises ValueError, OverflowError."""
    when = datetime.datetime.fromtimestamp(round(utc, 3), datetime.UTC)
    return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def leap_seconds(utc: np.ndarray | float) -> np.ndarray:
    """GPS time minus UTC, s, at UTC times (POSIX s)."""
    return np.searchsorted(_LEAPS, utc, side="right").astype(float)


def gps_from_utc(utc: np.ndarray | float) -> np.ndarray:
    """GPS time, s from 1980-01-06, of UTC times (POSIX s)."""
    return utc - GPS_EPOCH + leap_seconds(utc)


def utc_from_gps(gps: np.ndarray | float) -> np.ndarray:
    """UTC (POSIX s) of GPS times, s from 1980-01-06; a leap second gets the numbers of the second after it."""
    return gps + GPS_EPOCH - np.searchsorted(_LEAPS_GPS, gps, side="right")


def utc_calendar(gpst: float) -> tuple[datetime.date, int, int, float]:
    """UTC date, hour, minute and second of a GPS time, to the microsecond; 60 and more within a leap second."""
    whole, part = divmod(round(float(gpst), 6), 1.0)
    leap = bool(np.any(whole == _LEAPS_GPS - 1.0))
    t = datetime.datetime.fromtimestamp(float(utc_from_gps(whole)) - leap, datetime.UTC)
    return t.date(), t.hour, t.minute, t.second + leap + round(part, 6)


_ANNOUNCED = 182.0 * DAY
"""Time from Bulletin C to the leap second that it announces, s [2]."""


def announced_leap_second(gpst: float) -> tuple[int, tuple[int, int, int]]:
    """GPS time minus UTC at a GPS time, s, and the leap second that GPS messages announce, or else the last one [1].

    The latter is the difference after it, and the GPS week and the day of the week (1 is Sunday) at whose end it comes.
    """
    now = int(np.searchsorted(_LEAPS_GPS, gpst, side="right"))
    ahead = now < _LEAPS.size and _LEAPS_GPS[now] - gpst <= _ANNOUNCED
    number = max(now + ahead, 1)
    week, seconds = divmod(_LEAPS[number - 1] - DAY - GPS_EPOCH, WEEK)
    return now, (number, int(week), int(seconds // DAY) + 1)


def full_week(week: int, near: float, modulus: int = 1024) -> int:
    """The GPS week that is `week` modulo 1024 and nearest to a UTC time (POSIX s) [1]."""
    now = float(gps_from_utc(near)) / WEEK
    return week + modulus * round((now - 0.5 - week) / modulus)


def sidereal_angle(ut1: np.ndarray | float) -> np.ndarray:
    """Greenwich mean sidereal time, rad, at UT1 (POSIX s; UTC is within a second, 15 arc seconds, of it) [3]."""
    days = (np.asarray(ut1) - 946728000.0) / DAY  # from 2000-01-01 12:00
    midnight = np.floor(days - 0.5) + 0.5
    t = midnight / 36525.0
    seconds = 24110.54841 + 8640184.812866 * t + 0.093104 * t**2 - 6.2e-6 * t**3
    seconds = seconds + 1.00273790934 * DAY * (days - midnight)
    return np.radians(seconds / 240.0) % (2.0 * np.pi)
