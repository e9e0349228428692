"""Terrain horizon: ridges with straight tops that hide sources, and elevations by azimuth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.geodesy.earth import llh_from_ecef, ned_matrix


def upright_planes(tops: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertical planes of ridges (w, 2, 3), ECEF, m: first end, top, m, vertical at the middle, level part of the top,
    m.

    Each is (w, 3).
    """
    first, along = tops[:, 0], tops[:, 1] - tops[:, 0]
    up = -ned_matrix(llh_from_ecef(tops.mean(axis=1)))[:, 2]
    return first, along, up, along - np.sum(along * up, axis=1, keepdims=True) * up


@dataclass(frozen=True)
class Crossings:
    """Crossings of straight paths from a transmitter to antennas with the vertical planes of ridges, (e, w) each."""

    between: np.ndarray
    """Whether the path crosses the plane between transmitter and antenna, below or above the top."""
    share: np.ndarray
    """Position of the crossing as a fraction of the path from the transmitter."""
    over: np.ndarray
    """Height of the top above the path there, m."""
    way: np.ndarray
    """(e, 1, 3) paths, m."""
    along: np.ndarray
    """(w, 3) tops, m."""
    up: np.ndarray
    """(w, 3) vertical axes of the planes."""


def crossings(tops: np.ndarray, place: np.ndarray, antenna: np.ndarray) -> Crossings:
    """See `Crossings`; tops: (w, 2, 3) ends of the ridges' tops, place: (3,) or (e, 1, 3), antenna: (e, 3), ECEF, m."""
    first, along, up, level = upright_planes(tops)
    way = antenna[:, None] - place
    # where the straight path goes through the upright plane of each ridge
    normal = np.cross(along, up)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.sum((first - place) * normal, axis=-1) / np.einsum("eki,wi->ew", way, normal)
    between = (share > 0.0) & (share < 1.0)
    share = np.where(between, share, 0.5)
    crossing = place + share[..., None] * way
    beside = np.sum((crossing - first) * level, axis=2) / np.sum(level**2, axis=1)
    between &= (beside >= 0.0) & (beside <= 1.0)
    over = np.sum((first + beside[..., None] * along - crossing) * up, axis=2)
    return Crossings(between, share, over, way, along, up)


def skyline_elevation(tops: np.ndarray, eye: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Elevations (n,), rad, up to which ridges hide the sky from an eye (3,) at azimuths (n,); -pi/2 without a ridge.

    tops: (w, 2, 3) ends of their tops, ECEF, m.
    """
    to_enu = ned_matrix(llh_from_ecef(eye))[[1, 0, 2]] * np.array([1.0, 1.0, -1.0])[:, None]
    s, c = np.sin(azimuth), np.cos(azimuth)
    highest = np.full(azimuth.size, -0.5 * np.pi)
    for a, b in (tops - eye) @ to_enu.T:
        # fraction of the line from a to b at which it reaches the azimuth, and its distance there
        left, right = a[0] * c - a[1] * s, b[0] * c - b[1] * s
        with np.errstate(divide="ignore", invalid="ignore"):
            share = left / (left - right)
        east, north, up = (a[i] + share * (b[i] - a[i]) for i in range(3))
        away = east * s + north * c
        there = (share >= 0.0) & (share <= 1.0) & (away > 0.0)
        elevation = np.arctan2(up, away, where=there, out=np.full(azimuth.size, -0.5 * np.pi))
        highest = np.maximum(highest, elevation)
    return highest


def between(azimuth: np.ndarray, elevation: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Elevation of a horizon at azimuths, rad, by linear interpolation between given azimuths (n,), increasing, and
    around."""
    return np.interp(at, azimuth, elevation, period=2 * np.pi)
