"""Solutions of RTKLIB (`.pos`): positions, velocities and their covariances.

Source: [1] RTKLIB manual 2.4.2, appendix B.1 (positioning solution file).
"""

from __future__ import annotations

import datetime
import re
from pathlib import Path

import numpy as np

from navsim.formats.text import Dropped, FileError, number, read_lines
from navsim.gnss.timescales import WEEK, gps_from_utc
from navsim.logs.contents import QUALITY, FixRecord, LogContents

TITLE = "a solution of RTKLIB"
GIVES = "fixes with accuracies, quality"
_QUALITIES = {1: QUALITY["fixed"], 2: QUALITY["float"], 3: QUALITY["differential"], 4: QUALITY["differential"],
              5: QUALITY["3D"], 6: QUALITY["fixed"]}  # fmt: skip
"""The column Q: fix, float, SBAS, DGPS, single, PPP [1]."""
_COLUMNS = {
    "latitude": "lat_deg", "longitude": "lon_deg", "height": "h_m", "Q": "Q", "ns": "nsat", "sdn": "sigma_n_m",
    "sde": "sigma_e_m", "sdu": "sigma_d_m", "sdne": "ne", "sdeu": "eu", "sdun": "un", "vn": "vn", "ve": "ve",
    "vu": "vu", "sdvn": "sigma_vn_m_s", "sdve": "sigma_ve_m_s", "sdvu": "sigma_vd_m_s",
}  # fmt: skip
_LEAST = ("lat_deg", "lon_deg", "h_m", "Q")


def matches(head: bytes, path: Path) -> bool:
    """Whether a file has the header of a solution."""
    return re.search(rb"^% +(GPST|UTC|JST)\b", head, re.MULTILINE) is not None


def read(path: Path) -> LogContents:
    """Read a solution. Raises FileError, OSError."""
    out, dropped = LogContents(TITLE, clock="week"), Dropped(lenient=True)
    names: list[str] = []
    scale, rows = "", list[list[float]]()
    for count, line in enumerate(read_lines(path, dropped), 1):
        if header := re.match(r"% +(GPST|UTC|JST)\b(.*)", line):
            scale = header[1]
            before = names
            names = [_COLUMNS.get(name.split("(")[0], "") for name in header[2].replace(",", " ").split()]
            if rows and names != before:
                message = "the columns differ from those of the header before; split the file here, import each part"
                raise FileError(count, message, path)
            if missing := [name for name in _LEAST if name not in names]:
                message = f"the header lacks {', '.join(missing)}; write solutions as latitude, longitude, height"
                raise FileError(count, f"{message} in decimal degrees (out-solformat llh, out-degform deg)", path)
        elif line.strip() and not line.startswith("%"):
            try:
                rows.append(_row(path, count, line.replace(",", " ").split(), scale, len(names)))
            except FileError as error:
                dropped.damaged("lines left out", error)
    if not rows:
        raise FileError(0, "; ".join(["the solution has no fixes", *dropped.reasons()]), path)
    table = np.array(rows)
    column = {name: table[:, place] for place, name in enumerate(names, 1) if name}
    gps = table[:, 0]
    middle = np.sort(gps)[gps.size // 2]
    start = float(np.floor(gps[np.abs(gps - middle) < WEEK].min() / WEEK) * WEEK)  # without damaged dates
    out.start = start
    out.left_out += dropped.reasons()
    time = np.round(gps - start, 4)
    velocity = np.full((time.size, 3), np.nan)
    if {"vn", "ve", "vu"} <= column.keys():
        velocity = np.column_stack([column["vn"], column["ve"], -column["vu"]])
    quality = np.array([_QUALITIES.get(int(q), QUALITY["no fix"]) for q in column["Q"]], dtype=float)
    out.decided.append(f"times are GPS seconds of the week that begins the solution; the solution has {scale}")
    llh = np.column_stack([column[name] for name in _LEAST[:3]])
    further = {"quality": quality, **_sigmas(column)}
    out.add_receiver(FixRecord("solution", time, llh, velocity, further), quality > QUALITY["no fix"])
    return out


def _sigmas(column: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Satellites, 1 sigmas, and correlations, of covariances whose root has their sign."""
    out = {name: column[name] for name in ("nsat",) if name in column}
    for group in (("sigma_n_m", "sigma_e_m", "sigma_d_m"), ("sigma_vn_m_s", "sigma_ve_m_s", "sigma_vd_m_s")):
        if all(name in column for name in group):
            values = np.column_stack([column[name] for name in group])
            known = (values > 0.0).all(axis=1)
            out |= {name: np.where(known, column[name], np.nan) for name in group}
    if "sigma_n_m" in out:
        for key, root, a, b, sign in (("corr_n_e", "ne", "n", "e", 1.0), ("corr_e_d", "eu", "e", "d", -1.0),
                                      ("corr_n_d", "un", "n", "d", -1.0)):  # fmt: skip
            if root in column:
                product = out[f"sigma_{a}_m"] * out[f"sigma_{b}_m"]
                out[key] = np.clip(sign * column[root] * np.abs(column[root]) / product, -1.0, 1.0)
    return out


def _row(path: Path, line: int, cells: list[str], scale: str, columns: int) -> list[float]:
    """GPS s and the numbers of a line. Raises FileError."""
    if len(cells) != columns + 2 or not columns:
        raise FileError(line, f"{columns + 2} values are due by the header, here are {len(cells)}", path)
    if "/" in cells[0]:
        try:
            date = datetime.datetime.strptime(f"{cells[0]} {cells[1].partition('.')[0]}", "%Y/%m/%d %H:%M:%S")
        except ValueError:
            raise FileError(line, f"{cells[0]} {cells[1]} is not a time", path) from None
        fraction = number(path, line, f"0.{cells[1].partition('.')[2] or 0}", "time")
        utc = date.replace(tzinfo=datetime.UTC).timestamp()
        # GPS time is written as a calendar date too
        shift = {"UTC": float(gps_from_utc(utc)), "JST": float(gps_from_utc(utc - 32400.0))}
        gps = shift.get(scale, utc - _GPS_EPOCH) + fraction
    else:
        gps = WEEK * number(path, line, cells[0], "week") + number(path, line, cells[1], "seconds")
    return [gps, *(number(path, line, cell, "value") for cell in cells[2:])]


_GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC).timestamp()
