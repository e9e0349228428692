"""Geometry of two-way ranges: their DOPs, the plane of the sources, and the mirror image of a position.

Sources nearly in a plane fit a position and its image on the other side nearly alike.

Source: `docs/theory/beacons.md`, sections 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.gnss.dop import SINGULAR, dops

COPLANAR = 0.25
"""Thickness of the sources over their width below which they have a mirror image."""
_STEPS = 30
"""Most steps of least squares from a mirrored position."""
_CLOSE = 1e-6
"""Step, m, at which least squares has converged."""


@dataclass(frozen=True)
class Plane:
    """Plane of the sources: a point (3,) m, unit normal (3,) that points up, thickness and width of the sources, m."""

    point: np.ndarray
    normal: np.ndarray
    thickness: float
    width: float

    @property
    def is_flat(self) -> bool:
        """Whether the sources have a mirror image."""
        return self.thickness < COPLANAR * self.width

    def distance(self, position: np.ndarray) -> np.ndarray:
        """Signed distance of positions (..., 3)."""
        return np.asarray((position - self.point) @ self.normal)

    def mirrored(self, position: np.ndarray) -> np.ndarray:
        """Images of positions (..., 3)."""
        return np.asarray(position - 2.0 * self.distance(position)[..., None] * self.normal)


def plane_of(position: np.ndarray) -> Plane:
    """The plane nearest to sources (s, 3)."""
    point = position.mean(axis=0)
    _, size, axes = np.linalg.svd(position - point, full_matrices=True)
    normal = axes[2] if abs(axes[2, 2]) < 1e-9 else axes[2] * np.sign(axes[2, 2])
    size = np.concatenate([size, np.zeros(3 - size.size)]) / np.sqrt(position.shape[0])
    return Plane(point, normal, float(size[2]), float(size[1]))


def two_way_dops(away: np.ndarray) -> np.ndarray:
    """PDOP, HDOP, VDOP (e, 3) of two-way ranges, nan without a solution; compiles nothing.

    away: (e, n, 3) from the antenna to the beacons, the third axis vertical, nan where one is not received.
    """
    unit = away / np.linalg.norm(away, axis=2, keepdims=True)
    information = np.nansum(unit[..., :, None] * unit[..., None, :], axis=1)
    least, largest = np.linalg.eigvalsh(information)[:, [0, -1]].T
    solved = largest < SINGULAR * least
    variance = np.full((len(away), 3), np.nan)
    variance[solved] = np.diagonal(np.linalg.inv(information[solved]), axis1=1, axis2=2)
    level = variance[:, 0] + variance[:, 1]
    return np.sqrt(np.stack([level + variance[:, 2], level, variance[:, 2]], axis=1))


def mixed_dops(away: np.ndarray, los: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """PDOP, HDOP, VDOP (e, 3) of two-way ranges together with pseudoranges.

    away: see `two_way_dops`; los: (e, s, 3) unit vectors to sources of pseudoranges in the same axes, nan likewise, and
    clock (s,) of each, see `dop.dops`.
    """
    both = np.concatenate([away / np.linalg.norm(away, axis=2, keepdims=True), los], axis=1)
    return dops(both, np.concatenate([np.full(away.shape[1], -1), clock]))[:, 1:4]


def mirror_image(beacons: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, float]:
    """Second solution (3,) of the ranges from a position (3,) to beacons (n, 3), and how badly they fit there, RMS, m.

    nan without a second solution: fewer than three beacons, beacons that are not nearly in a plane, or a position in
    their plane.
    """
    none = np.full(3, np.nan), float("nan")
    if len(beacons) < 3:
        return none
    plane = plane_of(beacons)
    if not plane.is_flat:
        return none
    ranges, x = np.linalg.norm(beacons - position, axis=1), plane.mirrored(position)
    for _ in range(_STEPS):
        away = x - beacons
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        step = np.linalg.lstsq(away / distance[:, None], ranges - distance, rcond=None)[0]
        x = x + step
        if np.linalg.norm(step) < _CLOSE:
            break
    else:
        return none
    if plane.distance(x) * plane.distance(position) >= 0.0:
        return none
    return x, float(np.sqrt(np.mean((ranges - np.linalg.norm(beacons - x, axis=1)) ** 2)))
