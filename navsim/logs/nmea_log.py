"""NMEA sentences of a receiver, with the accuracies of GST and the quality of GGA. Source: `formats.nmea`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from navsim.formats.nmea import has_sentences, is_intact, read_nmea
from navsim.formats.text import Dropped, FileError, read_lines
from navsim.gnss.timescales import DAY, WEEK, gps_from_utc
from navsim.logs.contents import QUALITY, FixRecord, LogContents

TITLE = "NMEA sentences"
GIVES = "fixes with satellites, quality (GGA) and accuracies (GST)"
_QUALITIES = {"1": QUALITY["3D"], "2": QUALITY["differential"], "4": QUALITY["fixed"], "5": QUALITY["float"]}
_SENTENCE = re.compile(r"\$(..(GGA|GST),(\d{6}(?:\.\d+)?),([^*$]*))\*([0-9A-Fa-f]{2})")
_UNDATED = 10.0 * DAY
"""Times before this, POSIX s, are of sentences without a date."""


def matches(head: bytes, path: Path) -> bool:
    """Whether a file has sentences."""
    return has_sentences(head.decode("latin-1").splitlines())


def read(path: Path) -> LogContents:
    """Read sentences. Raises FileError, OSError."""
    out, dropped = LogContents(TITLE, clock="week"), Dropped()
    lines = read_lines(path, dropped)
    table = read_nmea(path, lines, dropped)
    if table.shape[0] < 2:
        raise FileError(0, "; ".join([f"{table.shape[0]} fixes", *dropped.reasons()]), path)
    further = {"nsat": table[:, 7], **_further(lines, table[:, 0])}
    if table[0, 0] > _UNDATED:
        gps = gps_from_utc(table[:, 0])
        out.start = float(np.floor(gps[0] / WEEK) * WEEK)
        time = np.round(gps - out.start, 4)
        out.decided.append("times are GPS seconds of the week that begins the sentences, which have UTC")
    else:
        out.clock, time = "own", table[:, 0]
        out.decided.append("times are seconds since midnight UTC: no sentence has a date")
    out.left_out += dropped.reasons()
    out.add_receiver(FixRecord("receiver", time, table[:, 1:4], table[:, 4:7], further))
    return out


def _further(lines: list[str], time: np.ndarray) -> dict[str, np.ndarray]:
    """Quality and 1 sigmas of the fixes at these times (m,), s, by the intact sentences of their epochs."""
    quality: dict[float, float] = {}
    sigma: dict[float, tuple[float, float]] = {}
    last = float(time[0])
    for line in lines:
        for body, kind, of_day, rest, digits in _SENTENCE.findall(line):
            if not is_intact(body, digits):
                continue
            at = 3600.0 * int(of_day[:2]) + 60.0 * int(of_day[2:4]) + float(of_day[4:])
            last = at + DAY * round((last - at) / DAY)
            at = round(last, 3)
            cells = rest.split(",")
            if kind == "GGA" and len(cells) > 4 and cells[4] in _QUALITIES:
                quality[at] = float(_QUALITIES[cells[4]])
            elif kind == "GST" and len(cells) > 6 and all(re.fullmatch(r"\d+\.?\d*", cell) for cell in cells[4:7]):
                north, east, up = map(float, cells[4:7])
                if min(north, east, up) > 0.0:
                    sigma[at] = float(np.hypot(north, east) / np.sqrt(2.0)), up
    out = {}
    at_fixes = np.round(time, 3).tolist()
    if quality:
        out["quality"] = np.array([quality.get(at, np.nan) for at in at_fixes])
    if sigma:
        pairs = np.array([sigma.get(at, (np.nan, np.nan)) for at in at_fixes])
        out |= {"sigma_horizontal_m": pairs[:, 0], "sigma_vertical_m": pairs[:, 1]}
    return out
