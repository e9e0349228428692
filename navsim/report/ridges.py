"""Terrain in figures and pages: ridges in the axes of the runway, where the way goes over them, what they hide of the
sky."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from navsim.core.arrays.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.io.export import true_antenna
from navsim.io.results import Result
from navsim.io.ridges import ridges
from navsim.report.quantities import about_threshold, in_runway_axes
from navsim.report.tables import setting

BROWN = "#8C4B00"
"""Colour of terrain in print."""
_AROUND = 1441
"""Azimuths at which a skyline is asked for, a quarter of a degree from each other."""
_WAY = 500
"""Most straight parts of a way that are held against ridges."""


@dataclass(frozen=True)
class ShownRidge:
    """A ridge or skyline as it is drawn. places: (n, 3) along its top, along and right of the runway's axis from the
    threshold, and its height above that, m. height: of the top above the threshold, m."""

    places: np.ndarray
    height: float

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
    """Where a way goes over a ridge: along the runway from the threshold, and the height of the top there, m."""

    along: float
    top: float
    label: str


def flown_over(result: Result) -> list[FlownOver]:
    """Where the true way of a landing goes over ridges, or through them."""
    path = in_runway_axes(result, result["/truth/position_llh"])
    step = max(1, -(-len(path) // _WAY))
    way = np.concatenate([path[::step], path[-1:]])[:, :2]
    out = []
    for ridge in shown_ridges(result):
        first, second = ridge.places[:-1], ridge.places[1:]
        for k in range(len(first)):
            share, of_top = _crossing(way[:-1], way[1:], first[k, :2], second[k, :2])
            for i in np.flatnonzero((share >= 0.0) & (share < 1.0) & (of_top >= 0.0) & (of_top < 1.0)):
                along = float(way[i, 0] + share[i] * (way[i + 1, 0] - way[i, 0]))
                top = float(first[k, 2] + of_top[i] * (second[k, 2] - first[k, 2]))
                out.append(FlownOver(along, top, ridge.label))
    return out


def _crossing(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where straight lines from p to q (n, 2) meet the one from a to b (2,), as shares of both; nan where they are
    parallel."""
    way, top = q - p, b - a
    turn = way[:, 0] * top[1] - way[:, 1] * top[0]
    gap = a - p
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (gap[:, 0] * top[1] - gap[:, 1] * top[0]) / turn
        of_top = (gap[:, 0] * way[:, 1] - gap[:, 1] * way[:, 0]) / turn
    parallel = turn == 0.0
    return np.where(parallel, np.nan, share), np.where(parallel, np.nan, of_top)


def seen_skyline(result: Result) -> tuple[np.ndarray, np.ndarray] | None:
    """Up to which elevations the terrain hides the sky from the antenna at the last fix epoch: azimuths (n,), growing,
    and elevations, -pi/2 where nothing stands, rad. None without terrain."""
    given = ridges(result)
    if not given:
        return None
    eye = true_antenna(result)[-1]
    to_enu = ned_matrix(llh_from_ecef(eye))[[1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, _AROUND)
    s, c = np.sin(azimuth), np.cos(azimuth)
    highest = np.full(azimuth.size, -0.5 * np.pi)
    for ridge in given:
        places = (ecef_from_llh(ridge.llh) - eye) @ to_enu.T
        for a, b in itertools.pairwise(places):
            # the share of the way from a to b at which it stands in the azimuth, and how far away
            left, right = a[0] * c - a[1] * s, b[0] * c - b[1] * s
            with np.errstate(divide="ignore", invalid="ignore"):
                share = left / (left - right)
            east, north, up = (a[i] + share * (b[i] - a[i]) for i in range(3))
            away = east * s + north * c
            there = (share >= 0.0) & (share <= 1.0) & (away > 0.0)
            elevation = np.arctan2(up, away, where=there, out=np.full(azimuth.size, -0.5 * np.pi))
            highest = np.maximum(highest, elevation)
    return azimuth, highest
