"""Terrain in figures and pages: ridges in runway axes, their crossings by the trajectory, the skyline."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from navsim.formats.export_maps import true_antenna
from navsim.formats.ridges import RidgeLine, ridges
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef
from navsim.geodesy.horizon import crossings, skyline_elevation
from navsim.report.figure_data import about_threshold
from navsim.report.result_cells import setting
from navsim.results.result import Result

BROWN = "#8C4B00"
"""Colour of terrain in print."""
_AROUND = 1441
"""Azimuths at which a skyline is asked for, a quarter of a degree from each other."""
_WAY = 500
"""Largest number of straight pieces of a trajectory that are compared with ridges."""


@dataclass(frozen=True)
class ShownRidge:
    """A ridge or skyline in a drawing."""

    places: np.ndarray
    """(n, 3) points of its top: along and right of the runway axis from the threshold, height above the threshold,
    m."""
    height: float
    """Height of the top above the threshold, m."""

    @property
    def label(self) -> str:
        """Its height."""
        return f"{self.height:.0f} m"


def shown_ridges(result: Result) -> list[ShownRidge]:
    """The terrain in the axes of the runway."""
    place = "/truth/threshold_llh" if "/truth/threshold_llh" in result else "/plan/threshold_llh"
    heading = np.radians(setting(result, "runway", "heading_deg"))
    out = []
    for each in ridges(result):
        out.append(ShownRidge(about_threshold(each.llh, result[place], heading), each.height))
    return out


def clipped(ridge: ShownRidge, along: tuple[float, float], right: tuple[float, float]) -> np.ndarray:
    """The straight parts (k, 2, 2) of a ridge within a part of the plan, from and to, along and right, m."""
    out = []
    for a, b in itertools.pairwise(ridge.places[:, :2]):
        first, last = 0.0, 1.0
        for i, (low, high) in enumerate((along, right)):
            step = b[i] - a[i]
            if step == 0.0:
                first = first if low <= a[i] <= high else 2.0
            else:
                ends = sorted(((low - a[i]) / step, (high - a[i]) / step))
                first, last = max(first, ends[0]), min(last, ends[1])
        if first < last:
            out.append([a + first * (b - a), a + last * (b - a)])
    return np.array(out).reshape(-1, 2, 2)


def on_plan(seen: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """The part of a plan on which ridges are drawn, from and to, along and right, m: about all places that are seen
    (n, 2), and half as far to the sides as they reach along."""
    (low, left), (high, right) = np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)
    half = 0.5 * (high - low)
    return (low - 0.1 * half, high + 0.1 * half), (min(left, -half), max(right, half))


@dataclass(frozen=True)
class FlownOver:
    """Crossing of a ridge: along the runway from the threshold, and the height of the top there, m."""

    along: float
    top: float
    label: str


def flown_over(result: Result) -> list[FlownOver]:
    """Crossings of ridges, or collisions with them, on the true trajectory of a landing."""
    path = ecef_from_llh(result["/truth/position_llh"])
    step = max(1, -(-len(path) // _WAY))
    way = np.concatenate([path[::step], path[-1:]])
    heading = np.radians(setting(result, "runway", "heading_deg"))
    out = []
    for ridge in ridges(result):
        c = crossings(_tops(ridge), way[:-1, None], way[1:])
        leg, part = np.nonzero(c.between)
        over = way[leg] + c.share[leg, part, None] * c.way[leg, 0] + c.over[leg, part, None] * c.up[part]
        for along, _, top in about_threshold(llh_from_ecef(over), result["/truth/threshold_llh"], heading).tolist():
            out.append(FlownOver(along, top, f"{ridge.height:.0f} m"))
    return out


def _tops(ridge: RidgeLine) -> np.ndarray:
    """Ends (w, 2, 3) of the straight parts of its top, ECEF, m."""
    places = ecef_from_llh(ridge.llh)
    return np.stack([places[:-1], places[1:]], axis=1)


def terrain_skyline(result: Result) -> tuple[np.ndarray, np.ndarray] | None:
    """Terrain skyline at the last fix epoch: azimuths (n,), increasing, and elevations, rad, seen from the antenna.

    The elevation is -pi/2 without terrain in that direction. None without any terrain.
    """
    if "/geometry/skyline" in result:
        return result["/geometry/skyline_azimuth"], result["/geometry/skyline"]
    given = ridges(result)
    if not given:
        return None
    eye = true_antenna(result)[-1]
    azimuth = np.linspace(0.0, 2.0 * np.pi, _AROUND)
    return azimuth, skyline_elevation(np.concatenate([_tops(each) for each in given]), eye, azimuth)
