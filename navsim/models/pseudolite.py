"""Where pseudolites stand: the paper's Table 1 frame, the runway frame, geodetic coordinates.

Source: `docs/theory/landing.md`, section 2.
"""

from __future__ import annotations

import numpy as np

from navsim.core import wgs84
from navsim.models.kinematics import tangent_frame

NEAREST = 10.0
"""Distance a pseudolite keeps from the aircraft at all times, m."""

TABLE1_SPHERE = 6371.0e3
"""Radius of the sphere behind the coordinates of Table 1, m."""


def table1_position(start: np.ndarray, slant: float, s: float, l1: float) -> np.ndarray:
    """Latitude and longitude (rad) of a pseudolite as the paper's Table 1 has them.

    start: (2,) latitude and longitude of the start of the approach, rad. slant: length of the glide path, m.
    s, l1: m. The paper puts the touchdown point the slant length due north of the start, S along the
    meridian and L1 eastwards, on a sphere, whatever the heading.
    """
    latitude = start[0] + (slant + s) / TABLE1_SPHERE
    longitude = start[1] + l1 / (TABLE1_SPHERE * np.cos(start[0]))
    return np.array([latitude, longitude])


def runway_position(threshold: np.ndarray, heading: float, s: float, l1: float, height: float) -> np.ndarray:
    """Geodetic position (rad, rad, m) of a pseudolite given in runway axes.

    threshold: (3,) rad, rad, m. heading: of landing, rad. s: across, positive right; l1: along, positive
    before the threshold; both in the tangent plane of the threshold, m. height: above the runway's height, m.
    """
    return runway_positions(threshold, heading, np.array([s, l1]), height)


def runway_positions(threshold: np.ndarray, heading: float, places: np.ndarray, height: float) -> np.ndarray:
    """Geodetic positions (..., 3) of places (..., 2), s and l1, as `runway_position`."""
    frame = tangent_frame(threshold, heading)
    plane = np.stack([-places[..., 1], places[..., 0], np.zeros(places.shape[:-1])], axis=-1)
    llh = wgs84.llh_from_ecef(frame.origin + plane @ frame.axes.T)
    llh[..., 2] = threshold[2] + height
    return llh


def clearance(track: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """Least distance (...) of sites (..., 3) from the points of a track (n, 3), all ECEF, m."""
    few = 16
    if sites[..., 0].size <= few:  # spares a check of one scenario the import
        return np.linalg.norm(sites[..., None, :] - track, axis=-1).min(axis=-1)
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(track).query(sites)[0])
