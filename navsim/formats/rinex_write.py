"""RINEX 3.04 files: observations and navigation messages.

Version 3.04, since most programs read its four-line GLONASS records. Source: [1] RINEX 3.04 (2018), section 5 and
tables A2, A3 (observations), A5, A6, A8, A10, A12, A14 (navigation).
"""

from __future__ import annotations

import datetime
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from navsim.gnss import timescales
from navsim.gnss.constellations import gps
from navsim.gnss.constellations.glonass_broadcast import StateVectors
from navsim.gnss.constellations.systems import BEIDOU, BY_LETTER, GALILEO, GLONASS, GPS, System

VERSION = 3.04
INAV_SOURCES = 0b10_0000_0101
"""Data sources of a record of I/NAV: E1-B, E5b-I, and their clock [1], table A8."""
KINDS = "CDS"
"""Values written for each satellite: pseudorange m, Doppler Hz, C/N0 dB-Hz, all of its system's first signal."""


@dataclass(frozen=True)
class Epochs:
    """Observations of a receiver."""

    start: float
    """Full GPS s from 1980-01-06."""
    tag: np.ndarray
    """(e,) by the receiver clock, s after `start` (a single number could not hold tenths of microseconds)."""
    satellites: tuple[str, ...]
    """(s,) names."""
    values: np.ndarray
    """(3, e, s) as `KINDS`, nan if missing."""
    position: np.ndarray
    """(3,) approximate, ECEF, m."""
    channels: dict[str, int]
    """By GLONASS satellite."""
    interval: float
    """s."""


def observation_lines(
    epochs: Epochs, marker: str, comments: Iterable[str], made: str, receiver: str = "simulated"
) -> list[str]:
    """Lines of an observation file [1]; marker: its name, comments: sentences, which are wrapped, made: program."""
    first = _calendar(epochs.start, epochs.tag[0], 7)
    last = _calendar(epochs.start, epochs.tag[-1], 7)
    systems = [of for letter, of in BY_LETTER.items() if any(name[0] == letter for name in epochs.satellites)]
    lines = [
        _label(f"{VERSION:9.2f}           OBSERVATION DATA    {_kind(systems)}", "RINEX VERSION / TYPE"),
        _label(made, "PGM / RUN BY / DATE"),
        *_comment_lines(comments),
        _label(marker[:60], "MARKER NAME"),
        _label("GEODETIC" if epochs.tag.size == 0 else "AIRBORNE", "MARKER TYPE"),
        _label("navsim", "OBSERVER / AGENCY"),
        _label(f"{'1':20s}{receiver:20s}{'1':20s}", "REC # / TYPE / VERS"),
        _label(f"{'1':20s}{receiver:20s}", "ANT # / TYPE"),
        _label("".join(f"{x:14.4f}" for x in epochs.position), "APPROX POSITION XYZ"),
        _label("".join(f"{0.0:14.4f}" for _ in range(3)), "ANTENNA: DELTA H/E/N"),
        *(
            _label(
                f"{of.letter}  {len(KINDS):3d}" + "".join(f" {kind}{of.signals[0]}" for kind in KINDS),
                "SYS / # / OBS TYPES",
            )
            for of in systems
        ),
        _label("DBHZ", "SIGNAL STRENGTH UNIT"),
        _label(f"{epochs.interval:10.3f}", "INTERVAL"),
        _label(_first_obs(first), "TIME OF FIRST OBS"),
        _label(_first_obs(last), "TIME OF LAST OBS"),
        *_channel_lines(epochs.channels),
    ]
    if GLONASS in systems:
        lines.append(_label("", "GLONASS COD/PHS/BIS"))
    lines += [_leap_seconds(epochs.start), _label("", "END OF HEADER")]
    for e, tag in enumerate(epochs.tag):
        seen = np.flatnonzero(np.isfinite(epochs.values[0, e]))
        year, month, day, hour, minute, second = _calendar(epochs.start, tag, 7)
        lines.append(f"> {year:4d} {month:02d} {day:02d} {hour:02d} {minute:02d}{second:11.7f}  0{seen.size:3d}")
        for s in seen:
            fields = (f"{x:14.3f}  " if np.isfinite(x) else 16 * " " for x in epochs.values[:, e, s])
            lines.append((epochs.satellites[s] + "".join(fields)).rstrip())
    return lines


def navigation_lines(
    elements: Mapping[System, gps.Elements],
    vectors: StateVectors | None,
    comments: Iterable[str],
    made: str,
    *,
    at: float,
    klobuchar: tuple[Sequence[float], Sequence[float]] | None = None,
    gps_offset: float = 0.0,
) -> list[str]:
    """Lines of a navigation file [1] with elements by system, GLONASS state vectors, or both.

    - `comments`, `made`: as of `observation_lines`; `at`: time of the leap second message, GPS s from 1980-01-06.
    - `klobuchar`: alpha and beta (4,) of the ionosphere, s and s per semicircle powers.
    - `gps_offset`: GPS time minus GLONASS time, s.
    """
    systems = [*elements, *([GLONASS] if vectors is not None else [])]
    lines = [
        _label(f"{VERSION:9.2f}           NAVIGATION DATA     {_kind(systems)}", "RINEX VERSION / TYPE"),
        _label(made, "PGM / RUN BY / DATE"),
        *_comment_lines(comments),
    ]
    if klobuchar is not None:
        for name, four in zip(("GPSA", "GPSB"), klobuchar, strict=True):
            lines.append(_label(f"{name} " + "".join(_exponent(x, 12, 4) for x in four), "IONOSPHERIC CORR"))
    if GPS in elements and vectors is not None:
        week, second = divmod(int(at), int(timescales.WEEK))
        offset = f"GLGP {_exponent(gps_offset, 17, 10)}{_exponent(0.0, 16, 9)}{second:7d}{week:5d}"
        lines.append(_label(offset, "TIME SYSTEM CORR"))
    lines += [_leap_seconds(at), _label("", "END OF HEADER")]
    for system, sent in elements.items():
        for i in np.lexsort((sent.toe, sent.prn)):
            lines += _keplerian_record(system, sent, int(i))
    if vectors is not None:
        for i in np.lexsort((vectors.time, vectors.slot)):
            lines += _glonass_record(vectors, int(i))
    return lines


def _kind(systems: Sequence[System]) -> str:
    """Whose satellites a file is of, for its first line."""
    return "M: MIXED" if len(systems) > 1 else f"{systems[0].letter}: {systems[0].title}"


_BDT_WEEK = 1356.0
"""The GPS week at whose start BeiDou time begins."""


def _keplerian_record(system: System, x: gps.Elements, i: int) -> list[str]:
    """A record of elements, in the system's own time. A Galileo one is of I/NAV, and has no group delay of E5a."""
    behind = timescales.BEHIND_GPS[system.time_system]
    week, second = divmod(float(x.toe[i]) - behind, timescales.WEEK)
    year, month, day, hour, minute, sec = _calendar(float(x.toc[i]) - behind, 0.0, 0)
    head = f"{system.satellite(x.prn[i])} {year:4d} {month:02d} {day:02d} {hour:02d} {minute:02d} {int(sec):02d}"
    orbit = [
        x.iode[i], x.crs[i], x.delta_n[i], x.m0[i], x.cuc[i], x.e[i], x.cus[i], x.sqrt_a[i],
        second, x.cic[i], x.omega0[i], x.cis[i], x.i0[i], x.crc[i], x.omega[i], x.omega_dot[i],
    ]  # fmt: skip
    sick = float(not x.healthy[i])
    if system is GALILEO:
        rest = [x.i_dot[i], float(INAV_SOURCES), week, 0.0, x.ura[i], sick, 0.0, x.tgd[i], second]
    elif system is BEIDOU:
        rest = [x.i_dot[i], 0.0, week - _BDT_WEEK, 0.0, x.ura[i], sick, x.tgd[i], 0.0, second, x.iodc[i]]
    else:
        # sent for the first time two hours before its reference time, and fit for four hours
        rest = [x.i_dot[i], 1.0, week, 0.0, x.ura[i], 63.0 * sick, x.tgd[i], x.iodc[i], second - 7200.0, 4.0]
    return _record(head, [x.af0[i], x.af1[i], x.af2[i]], orbit + rest)


def _glonass_record(x: StateVectors, i: int) -> list[str]:
    when = datetime.datetime.fromtimestamp(float(x.time[i]), datetime.UTC)
    head = f"{GLONASS.satellite(x.slot[i])} {when:%Y %m %d %H %M %S}"
    # the time of the message's frame is in the week of UTC, not of GPS [1], table A10
    week_second = (float(x.time[i]) - timescales.GPS_EPOCH) % timescales.WEEK
    p, v, a = 1e-3 * x.position[i], 1e-3 * x.velocity[i], 1e-3 * x.acceleration[i]
    numbers = [p[0], v[0], a[0], 0.0 if x.healthy[i] else 1.0, p[1], v[1], a[1], float(x.channel[i]),
               p[2], v[2], a[2], x.age[i]]  # fmt: skip
    return _record(head, [-x.tau[i], x.gamma[i], week_second], numbers)


def _record(head: str, first: list[float], rest: list[float]) -> list[str]:
    """A record: the first line has three numbers, all others four."""
    lines = [head + "".join(_exponent(x) for x in first)]
    return lines + ["    " + "".join(_exponent(x) for x in rest[k : k + 4]) for k in range(0, len(rest), 4)]


def _exponent(x: float, width: int = 19, digits: int = 12) -> str:
    """Number as D19.12 in the usual form; blank if unknown."""
    if np.isnan(x):
        return " " * width
    return f"{float(x):{width}.{digits}E}".replace("E", "D")


def _comment_lines(comments: Iterable[str]) -> list[str]:
    return [_label(line, "COMMENT") for text in comments for line in textwrap.wrap(text, 60)]


def _leap_seconds(gpst: float) -> str:
    """Line with GPS time minus UTC at a GPS time, and the leap second that GPS messages announce [1].

    The latter is the number after it, and the week and the day of the week (1 is Sunday) at whose end it comes.
    """
    now, (after, week, day) = timescales.announced_leap_second(gpst)
    return _label(f"{now:6d}{after:6d}{week:6d}{day:6d}", "LEAP SECONDS")


def _label(text: str, label: str) -> str:
    return f"{text:60s}{label}"


def _calendar(start: float, since: float, digits: int) -> tuple[int, int, int, int, int, float]:
    """Calendar date and time of `since` seconds after full GPS seconds, rounded to so many digits of a second."""
    whole, part = divmod(round(float(since), digits), 1.0)
    t = datetime.datetime.fromtimestamp(timescales.GPS_EPOCH + start + whole, datetime.UTC)
    return t.year, t.month, t.day, t.hour, t.minute, t.second + part


def _first_obs(calendar: tuple[int, int, int, int, int, float]) -> str:
    return "".join(f"{x:6d}" for x in calendar[:5]) + f"{calendar[5]:13.7f}     GPS"


def _channel_lines(channels: dict[str, int]) -> list[str]:
    names = sorted(channels)
    lines = []
    for first in range(0, len(names), 8):
        start = f"{len(names):3d} " if first == 0 else "    "
        text = "".join(f"{name} {channels[name]:2d} " for name in names[first : first + 8])
        lines.append(_label(start + text, "GLONASS SLOT / FRQ #"))
    return lines
