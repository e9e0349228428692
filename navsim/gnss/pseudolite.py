"""Positions of pseudolites: the paper's Table 1 frame, the runway frame, geodetic coordinates.

Source: `docs/theory/landing.md`, section 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from navsim.geodesy import earth
from navsim.trajectory.kinematics import tangent_frame

NEAREST = 10.0
"""Distance a pseudolite keeps from the aircraft at all times, m."""
TRACK_STEP = 2.0
"""Largest distance between points of a `Track`, m, which makes its distances accurate to 5 cm."""

TABLE1_SPHERE = 6371.0e3
"""Radius of the sphere behind the coordinates of Table 1, m."""


def table1_position(start: np.ndarray, slant: float, s: float, l1: float) -> np.ndarray:
    """Latitude and longitude (rad) of a pseudolite as defined in the paper's Table 1.

    start: (2,) latitude and longitude of the start of the approach, rad. slant: length of the glide path, m. s, l1: m.
    The paper puts the touchdown point the slant length due north of the start, S along the meridian and L1 eastwards,
    on a sphere, whatever the heading. The longitude is within -pi ... pi.
    """
    latitude = start[0] + (slant + s) / TABLE1_SPHERE
    longitude = start[1] + l1 / (TABLE1_SPHERE * np.cos(start[0]))
    return np.array([latitude, earth.wrap_angle(longitude)])


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
    llh = earth.llh_from_ecef(frame.origin + plane @ frame.axes.T)
    llh[..., 2] = threshold[2] + height
    return llh


@dataclass(frozen=True)
class Track:
    """Trajectory of the aircraft: points (n, 3), ECEF m, at most `TRACK_STEP` apart."""

    points: np.ndarray

    def too_near(self, sites: np.ndarray) -> np.ndarray:
        """Violation of the least distance `NEAREST` by sites (..., 3), ECEF m; zero or negative without one, m
        (...)."""
        return NEAREST - self.clearance(sites)

    def clearance(self, sites: np.ndarray) -> np.ndarray:
        """Least distance (...) of sites (..., 3) from the points, m."""
        few = 16
        if sites[..., 0].size <= few:  # spares a check of one scenario the import
            least = [np.linalg.norm(self.points - site, axis=1).min() for site in sites.reshape(-1, 3)]
            return np.array(least).reshape(sites.shape[:-1])
        return np.asarray(self._tree.query(sites)[0])

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.points)
