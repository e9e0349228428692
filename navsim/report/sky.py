"""The sky of a landing as numbers: for the printed figure and for the page. The zenith is in the middle, 90 degrees
less the elevation outwards, north up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.geodesy.horizon import between
from navsim.report.label_placement import ON, LabelPosition, Letters, Rectangle
from navsim.report.result_cells import setting
from navsim.results.result import Result

Sector = tuple[float, float, float, float]
"""A part of the sky that is taken out: azimuths from, to, and elevations from, to, deg."""
RINGS = (30.0, 60.0, 90.0)
WRITTEN, REACH = 1.07, 1.14
"""Radius of the bearings, and of the paper, relative to its edge."""
SHADE = 0.25
_BEARINGS = ("N", "45°", "E", "135°", "S", "225°", "W", "315°")
_OFF = 0.15
"""Largest deviation of a source from its line, deg: a third of a pixel of the page."""


def bearings() -> list[tuple[str, float, float]]:
    """Names of bearings, and their sines and cosines."""
    turns = [2.0 * math.pi * i / len(_BEARINGS) for i in range(len(_BEARINGS))]
    return [(text, math.sin(turn), math.cos(turn)) for text, turn in zip(_BEARINGS, turns, strict=True)]


def sides(
    x: Sequence[float], y: Sequence[float], text: Sequence[str], edge: float, wide: float, letters: Letters
) -> list[LabelPosition]:
    """Sides of the labels of marks on a paper down to 90 - edge, deg.

    wide: its width in the unit of the letters; x, y: of the marks, to the east and north, deg.
    """
    scale = 0.5 * wide / (REACH * edge)
    out = scale * WRITTEN * edge
    taken = [letters.written(out * s, -out * c, name, ON) for name, s, c in bearings()]
    ring_name = LabelPosition("left", 0.2 * letters.line, -0.4 * letters.line)
    taken += [letters.written(0.0, -scale * ring, f"{90.0 - ring:g}°", ring_name) for ring in RINGS]
    places = [(scale * right, -scale * up) for right, up in zip(x, y, strict=True)]
    return letters.sides(places, text, taken, Rectangle(-0.5 * wide, 0.5 * wide, -0.5 * wide, 0.5 * wide))


def shaded(azimuth: np.ndarray, elevation: np.ndarray, mask: float) -> tuple[np.ndarray, np.ndarray]:
    """Outline (n,), (n,) of the part of the sky that a horizon hides above a mask, deg, to the east and north, deg.

    azimuth, elevation: of its corners, rad, azimuths increasing; straight between them.
    """
    around = np.union1d(np.linspace(0.0, 2.0 * math.pi, 361), azimuth)
    over = np.degrees(between(azimuth, elevation, around))
    radius = np.concatenate((np.full(around.size, 90.0 - mask), (90.0 - np.maximum(over, mask))[::-1]))
    there = np.concatenate((around, around[::-1]))
    return radius * np.sin(there), radius * np.cos(there)


@dataclass(frozen=True)
class SourceTrack:
    """Track of a source over the approach, at as few fixes as its bends need."""

    name: str
    x: np.ndarray
    """(t,) to the east, deg; nan where its position is unknown, or it is below the horizon and unused."""
    y: np.ndarray
    """(t,) to the north, deg, likewise."""
    used: np.ndarray
    """(t,)."""
    share: float
    """Fraction of all fixes at which it is used."""
    ground: bool
    """A pseudolite."""

    @property
    def how(self) -> str:
        """Description of its use."""
        if 0.0 < self.share < 1.0:
            return f"used at {100.0 * self.share:.1f} % of fixes"
        return "used" if self.share else "not used"

    @property
    def last(self) -> int:
        """Index of its last known position."""
        return int(np.flatnonzero(np.isfinite(self.x))[-1])

    def part(self, used: bool) -> tuple[np.ndarray, np.ndarray]:
        """Its line where it is used, or unused, up to the first point of the other kind."""
        up = np.isfinite(self.x)
        shown = up & (self.used == used)
        joined = shown | (np.append(False, shown[:-1]) & up)
        return np.where(joined, self.x, np.nan), np.where(joined, self.y, np.nan)


def source_tracks(result: Result) -> tuple[list[SourceTrack], float]:
    """The sources that are over the horizon, and pseudolites wherever they are, and the edge of a paper that has them
    all, deg from the zenith."""
    los = result["/geometry/line_of_sight"]
    used = np.isfinite(los[:, :, 0])
    azimuth, away = np.arctan2(los[:, :, 0], los[:, :, 1]), 90.0 - np.degrees(np.arcsin(los[:, :, 2]))
    names, ground = [str(name) for name in result["/geometry/source"]], set(map(str, result["/pseudolites/name"]))
    sampled = np.zeros(len(los), bool)
    if "/geometry/instant" in result:  # else, in a result of an earlier version, none but those used are known
        at = np.searchsorted(result["/geometry/time"], result["/geometry/instant"])
        sampled[at] = True
        up = (result["/geometry/elevation"] > 0.0) | np.array([name in ground for name in names], bool)
        alone = np.where(up & ~used[at], 90.0 - np.degrees(result["/geometry/elevation"]), np.nan)
        away[at] = np.where(used[at], away[at], alone)
        azimuth[at] = np.where(used[at], azimuth[at], result["/geometry/azimuth"])
    edge = max(90.0, 10.0 * math.ceil(float(np.nanmax(away, initial=0.0)) / 10.0))
    out = []
    for i, name in enumerate(names):
        x, y = (away[:, i] * f(azimuth[:, i]) for f in (np.sin, np.cos))
        if np.isfinite(x).any():
            x, y, now = _path(x, y, used[:, i], sampled)
            out.append(SourceTrack(name, x, y, now, float(used[:, i].mean()), name in ground))
    return out, edge


def _path(
    x: np.ndarray, y: np.ndarray, used: np.ndarray, sampled: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Track of a source through the sky, and its use, at as few fixes as its bends need.

    x, y: at all fixes (t,), deg, nan if unknown. sampled: fixes with a known sky. Between two of them an unused source
    moves straight, unless it is below the horizon at one.
    """
    if sampled.any():
        told, every = np.flatnonzero(used | sampled), np.arange(used.size)
        x, y = (np.interp(every, told, each[told], left=np.nan, right=np.nan) for each in (x, y))
    there = np.isfinite(x)
    kind = np.where(there, 1 + used, 0)
    keep = []
    for run in np.split(np.arange(kind.size), np.flatnonzero(np.diff(kind)) + 1):
        keep.append(run[_bends(x[run], y[run])] if kind[run[0]] else run[:1])
    chosen = np.concatenate(keep)
    return x[chosen], y[chosen], used[chosen] & there[chosen]


def _bends(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Numbers, in order, of the points of a line that others lie no farther from than `_OFF` when it goes through these
    alone (Douglas and Peucker)."""
    keep, open_ends = {0, x.size - 1}, [(0, x.size - 1)]
    while open_ends:
        first, last = open_ends.pop()
        if last - first < 2:
            continue
        ahead = np.array([x[last] - x[first], y[last] - y[first]])
        aside = np.stack([x[first + 1 : last] - x[first], y[first + 1 : last] - y[first]], axis=1)
        along = np.clip(aside @ ahead / max(float(ahead @ ahead), 1e-12), 0.0, 1.0)
        off = np.linalg.norm(aside - along[:, None] * ahead, axis=1)
        if off.max() > _OFF:
            middle = first + 1 + int(np.argmax(off))
            keep.add(middle)
            open_ends += [(first, middle), (middle, last)]
    return np.array(sorted(keep))


def masked(result: Result, edge: float) -> list[Sector]:
    """Part of the sky that the mask hides."""
    sectors = [(0.0, 360.0, low, high) for low, high in (
        (90.0 - edge, float(setting(result, "sky", "mask_deg"))),
        (float(setting(result, "sky", "mask_upper_deg")), 90.0),
    )]  # fmt: skip
    for part in setting(result, "sky", "interference"):
        (west, east), (low, high) = part["azimuth_deg"], part["elevation_deg"]
        sectors.append((float(west), float(east), float(low), float(high)))
    return sectors
