"""What stands between a transmitter on the ground and an aircraft: ridges, each a straight knife edge.

Page: `docs/theory/interference.md`, section 3.

Sources: [1] ITU-R P.526, section 4.1 (one knife edge; rays over an Earth of 4/3 of its radius).
"""

from __future__ import annotations

import numpy as np

from navsim.core.arrays.earth import ecef_from_llh, llh_from_ecef
from navsim.models.interference import EARTH_RADIUS, edge_loss, edge_parameter
from navsim.models.sky import enu_matrix, unit_vector

_BENT = 1.0 / 4.0
"""Curvature of rays by that of the Earth [1]."""
_CHORD = np.radians(1.0)
"""Azimuth that a straight part of a skyline spans at most."""


def ridge(ends: np.ndarray, height: float) -> np.ndarray:
    """The top (1, 2, 3), ECEF, m, of a ridge between two places (2, 2), latitude and longitude, rad; height: over the
    ellipsoid, m."""
    return ecef_from_llh(np.column_stack([ends, np.full(2, height)]))[None]


def skyline(eye: np.ndarray, azimuths: tuple[float, float], elevation: float, distance: float) -> np.ndarray:
    """Tops (w, 2, 3), ECEF, m, of ridges at a distance along the ground, m, from an eye, (3,) rad, rad, m, for which
    they reach up to an elevation, rad, between two azimuths, clockwise, rad: 0 to 2 pi is all around."""
    first, last = azimuths
    if last <= first:
        last += 2.0 * np.pi
    edges = np.linspace(first, last, int(np.ceil((last - first) / _CHORD)) + 1)
    towards = unit_vector(edges, np.full(edges.shape, elevation)) * distance / np.cos(elevation)
    points = ecef_from_llh(eye) + towards @ enu_matrix(eye)
    return np.stack([points[:-1], points[1:]], axis=1)


def ridge_loss(tops: np.ndarray, place: np.ndarray, antenna: np.ndarray, wavelength: float) -> np.ndarray:
    """Loss (e,), dB, that the worst of ridges makes of a transmitter at a place (3,) for antennas (e, 3), ECEF, m, by
    itself [1]; 0 where none lies between them.

    tops: (w, 2, 3) ends of the ridges' tops, ECEF, m; they reach down to the ground. wavelength: m.
    """
    first, along = tops[:, 0], tops[:, 1] - tops[:, 0]
    up = enu_matrix(llh_from_ecef(tops.mean(axis=1)))[:, 2]
    level = along - np.sum(along * up, axis=1, keepdims=True) * up
    way = antenna[:, None] - place
    # where the straight path goes through the upright plane of each ridge
    normal = np.cross(along, up)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.sum((first - place) * normal, axis=1) / np.einsum("eki,wi->ew", way, normal)
    between = (share > 0.0) & (share < 1.0)
    share = np.where(between, share, 0.5)
    crossing = place + share[..., None] * way
    beside = np.sum((crossing - first) * level, axis=2) / np.sum(level**2, axis=1)
    between &= (beside >= 0.0) & (beside <= 1.0)
    over = np.sum((first + beside[..., None] * along - crossing) * up, axis=2)
    distance = np.linalg.norm(way, axis=2)
    before, behind = share * distance, (1.0 - share) * distance
    over -= _BENT * before * behind / (2.0 * EARTH_RADIUS)
    # what counts is how far the ray misses the edge, across both
    across = np.cross(along, way)
    upright = np.abs(np.sum(across * up, axis=2)) / np.where(between, np.linalg.norm(across, axis=2), 1.0)
    loss = edge_loss(edge_parameter(over * upright, before, behind, wavelength))
    return np.where(between, loss, 0.0).max(axis=1, initial=0.0)
