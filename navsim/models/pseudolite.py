"""Where pseudolites stand: the paper's Table 1 frame, the runway frame, geodetic coordinates.

Source: `landing.md` section 2.
"""

from __future__ import annotations

import numpy as np

from navsim.core import wgs84
from navsim.models.kinematics import tangent_frame

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
    frame = tangent_frame(threshold, heading)
    llh = wgs84.llh_from_ecef(frame.origin + frame.axes @ np.array([-l1, s, 0.0]))
    return np.array([llh[0], llh[1], threshold[2] + height])
