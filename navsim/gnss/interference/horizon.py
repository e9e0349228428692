"""Obstacles between a transmitter and an aircraft: the Earth, ridges, each a straight knife edge, grids of heights.

Page: `docs/theory/interference.md`, section 3.

Sources: [1] ITU-R P.526, section 4.1 (one knife edge; rays over an Earth of 4/3 of its radius).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef
from navsim.geodesy.height_grid import HeightGrid
from navsim.geodesy.horizon import crossings
from navsim.gnss.interference.propagation import EARTH_RADIUS, LOWEST, edge_loss, edge_parameter, radio_horizon
from navsim.gnss.sky import enu_matrix, unit_vector

_BENT = 1.0 / 4.0
"""Curvature of rays by that of the Earth [1]."""
_CHORD = np.radians(1.0)
"""Azimuth that a straight part of a skyline spans at most."""
_AT_ONCE = 32
"""Ridges that sources are looked for behind at a time, so that a skyline takes no more memory than the signals."""


def horizon_dip(height: np.ndarray | float) -> np.ndarray:
    """Depression of the horizon, rad, of antennas at heights over smooth ground, m, without refraction; 0 below it."""
    return np.arccos(EARTH_RADIUS / (EARTH_RADIUS + np.maximum(height, 0.0)))


def horizon_distance(height: np.ndarray | float) -> np.ndarray:
    """Part of the `radio_horizon`, m, of an antenna at heights over the ground, m, on its side of the horizon. Two
    antennas see each other up to the sum of theirs."""
    return radio_horizon(np.maximum(height, LOWEST), 0.0)


def ridge(ends: np.ndarray, height: float) -> np.ndarray:
    """The top (1, 2, 3), ECEF, m, of a ridge between two places (2, 2), latitude and longitude, rad; height: over the
    ellipsoid, m."""
    return ecef_from_llh(np.column_stack([ends, np.full(2, height)]))[None]


def skyline(eye: np.ndarray, azimuths: tuple[float, float], elevation: float, distance: float) -> np.ndarray:
    """Tops (w, 2, 3), ECEF, m, of ridges around an eye (3,), rad, rad, m, that reach up to an elevation, rad.

    distance: of the ridges along the ground, m. azimuths: first and last, clockwise, rad; 0 to 2 pi is all around.
    """
    first, last = azimuths
    if last <= first:
        last += 2.0 * np.pi
    edges = np.linspace(first, last, int(np.ceil((last - first) / _CHORD)) + 1)
    towards = unit_vector(edges, np.full(edges.shape, elevation)) * distance / np.cos(elevation)
    points = ecef_from_llh(eye) + towards @ enu_matrix(eye)
    return np.stack([points[:-1], points[1:]], axis=1)


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground that hides sources."""

    tops: np.ndarray = field(default_factory=lambda: np.empty((0, 2, 3)))
    """(w, 2, 3) ends of the tops of ridges, ECEF, m; ridges reach down to the ground."""
    grids: tuple[HeightGrid, ...] = ()

    def __bool__(self) -> bool:
        return len(self.tops) > 0 or bool(self.grids)

    def ground(self, llh: np.ndarray) -> np.ndarray:
        """Height of the ground above the ellipsoid (...), m, by the grids, at places (..., 2 or 3), rad; nan where none
        has it."""
        out = np.full(llh.shape[:-1], np.nan)
        for grid in self.grids:
            out = np.fmax(out, grid.at(llh))
        return out


def loss_behind(terrain: Terrain, place: np.ndarray, antenna: np.ndarray, wavelength: float) -> np.ndarray:
    """Diffraction loss (e,), dB, of the worst edge alone between a transmitter (3,) and antennas (e, 3), ECEF, m [1].

    0 without ground between them. An edge is a ridge, or the ground at one place of the way. wavelength: m.
    """
    out = ridge_loss(terrain.tops, place, antenna, wavelength)
    for grid in terrain.grids:
        distance = np.linalg.norm(antenna - place, axis=1, keepdims=True)
        cell = EARTH_RADIUS * min(grid.down, grid.right * np.cos(grid.north))
        steps = max(2, int(np.ceil(distance.max(initial=0.0) / (0.25 * cell))))
        for e in range(len(antenna)):  # one at a time: a profile has thousands of points
            before = np.arange(1, steps) / steps * distance[e]
            over = grid.profile(place, antenna[e : e + 1], steps)[0]
            over = over - _BENT * before * (distance[e] - before) / (2.0 * EARTH_RADIUS)
            known = np.isfinite(over)
            nu = edge_parameter(over[known], before[known], (distance[e] - before)[known], wavelength)
            out[e] = max(out[e], edge_loss(nu).max(initial=0.0))
    return out


def ridge_loss(tops: np.ndarray, place: np.ndarray, antenna: np.ndarray, wavelength: float) -> np.ndarray:
    """Diffraction loss (e,), dB, of the worst ridge alone between a transmitter (3,) and antennas (e, 3), ECEF, m [1].

    0 without a ridge between them. tops: as of `Terrain`. wavelength: m.
    """
    c = crossings(tops, place, antenna)
    distance = np.linalg.norm(c.way, axis=2)
    before, behind = c.share * distance, (1.0 - c.share) * distance
    over = c.over - _BENT * before * behind / (2.0 * EARTH_RADIUS)
    # the distance of the ray from the edge counts, across both
    across = np.cross(c.along, c.way)
    upright = np.abs(np.sum(across * c.up, axis=2)) / np.where(c.between, np.linalg.norm(across, axis=2), 1.0)
    loss = edge_loss(edge_parameter(over * upright, before, behind, wavelength))
    return np.where(c.between, loss, 0.0).max(axis=1, initial=0.0)


def behind(terrain: Terrain, sources: np.ndarray, antenna: np.ndarray) -> np.ndarray:
    """Which of sources (e, s, 3) ground hides from an antenna (e, 3), ECEF, m, by straight lines of sight: (e, s)
    bool. Sources of (1, s, 3) are the same at all times. A source without a place (nan) is not hidden."""
    out = np.zeros((len(antenna), sources.shape[1]), bool)
    if len(terrain.tops):
        out |= _behind_ridges(terrain.tops, np.broadcast_to(sources, (*out.shape, 3)), antenna)
    for grid in terrain.grids:
        grid.mark_below(antenna, sources, out)
    return out


def _behind_ridges(tops: np.ndarray, sources: np.ndarray, antenna: np.ndarray) -> np.ndarray:
    """`behind` of ridges."""
    out = np.zeros(sources.shape[:2], bool)
    low = _below_tops(tops, sources, antenna)
    for i in np.flatnonzero(low.any(axis=0)):
        at = low[:, i]
        hidden = np.zeros(int(at.sum()), bool)
        for some in range(0, len(tops), _AT_ONCE):
            c = crossings(tops[some : some + _AT_ONCE], sources[at, i, None], antenna[at])
            hidden |= (c.between & (c.over > 0.0)).any(axis=1)
        out[at, i] = hidden
    return out


def flown_under(tops: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Depth of a path (n, 3), ECEF, m, below the top of a ridge, between each point and the next: (n - 1,) m.

    The largest of all ridges; -inf if the path crosses none or passes above it. tops: as of `Terrain`.
    """
    out = np.full(len(path) - 1, -np.inf)
    for some in range(0, len(tops), _AT_ONCE):
        c = crossings(tops[some : some + _AT_ONCE], path[:-1, None], path[1:])
        out = np.maximum(out, np.where(c.between & (c.over > 0.0), c.over, -np.inf).max(axis=1))
    return out


def _below_tops(tops: np.ndarray, sources: np.ndarray, antenna: np.ndarray) -> np.ndarray:
    """Which sources an antenna sees no higher than a bound of the highest of all tops (e, s) bool: only those can be
    behind one. Arguments as of `behind`."""
    up = enu_matrix(llh_from_ecef(antenna))[:, 2]
    highest = np.full(len(antenna), -1.0)
    for some in range(0, len(tops), _AT_ONCE):
        ends = tops[some : some + _AT_ONCE] - antenna[:, None, None]  # (e, w, 2, 3)
        height = np.einsum("ewpc,ec->ewp", ends, up).max(axis=2)
        along = ends[:, :, 1] - ends[:, :, 0]
        nearest = np.clip(-np.sum(ends[:, :, 0] * along, axis=2) / np.sum(along**2, axis=2), 0.0, 1.0)
        # a top above the antenna is seen highest from near, one below it from far
        near = np.linalg.norm(ends[:, :, 0] + nearest[..., None] * along, axis=2)
        far = np.linalg.norm(ends, axis=3).max(axis=2)
        highest = np.maximum(highest, (height / np.where(height > 0.0, near, far)).max(axis=1))
    towards = sources - antenna[:, None]
    sine = np.einsum("esc,ec->es", towards, up) / np.linalg.norm(towards, axis=2)
    return np.asarray(sine <= highest[:, None] + 1e-9)


LOWEST_SEEN, HIGHEST_SEEN = np.radians(-10.0), np.radians(80.0)
"""Elevations between which ground ends, rad."""
_HALVINGS = 17
"""Halvings of that range, which leave 0.001 degrees."""
_FAR = 1e6


def skyline_elevation(terrain: Terrain, eye: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Elevations (n,), rad, up to which ground hides the sky from an eye (3,), ECEF, m, at azimuths (n,); -pi/2 where
    there is none."""
    axes = enu_matrix(llh_from_ecef(eye))
    low, high = np.full(azimuth.size, LOWEST_SEEN), np.full(azimuth.size, HIGHEST_SEEN)

    def hidden(elevation: np.ndarray) -> np.ndarray:
        return behind(terrain, (eye + _FAR * unit_vector(azimuth, elevation) @ axes)[None], eye[None])[0]

    there = hidden(low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        under = hidden(middle)
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return np.where(there, low, -0.5 * np.pi)
