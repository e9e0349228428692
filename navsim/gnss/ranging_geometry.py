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


def range_dops(away: np.ndarray, one_way: bool = False) -> np.ndarray:
    """PDOP, HDOP, VDOP (e, 3) of two-way ranges, or of one-way ranges with one clock; nan without a solution. Compiles
    nothing.

    away: (e, n, 3) from the antenna to the beacons, the third axis vertical, nan where one is not received.
    """
    axes = np.ascontiguousarray(np.moveaxis(away, (2, 1), (0, 1)))
    weight = np.ones(axes.shape[1:])
    east, north, up = inverse_diagonal(*(without_clock(axes, weight) if one_way else (axes, weight)))
    return np.sqrt(np.stack([east + north + up, east + north, up], axis=1))


def without_clock(away: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (3, n, ...) and weights (n, ...) with which `inverse_diagonal` is that of ranges with an unknown clock.

    Eliminating the clock takes the weighted mean of the lines of sight off. away, weight: of `inverse_diagonal`.
    """
    unit = away / np.sqrt((away * away).sum(axis=0))
    there = np.isfinite(unit[0])
    own = np.where(there, weight, 0.0)
    with np.errstate(invalid="ignore"):  # nothing received
        centred = unit - (own * np.where(there, unit, 0.0)).sum(axis=1, keepdims=True) / own.sum(axis=0)
    square = (centred * centred).sum(axis=0)
    return np.where(square > _CLOSE**2, centred, np.nan), weight * square


def inverse_diagonal(away: np.ndarray, weight: np.ndarray, prior: float = 0.0) -> np.ndarray:
    """Diagonal (3, ...), east, north, up, of the inverse of the information sum w u u' + prior I of ranges.

    nan where it is singular.

    away: (3, n, ...) to the beacons, nan where one is not received. weight: (n, ...) of each range.
    """
    square = (away * away).sum(axis=0)
    weight = np.where(np.isnan(square), 0.0, weight / square)
    x, y, z = np.where(weight > 0.0, away, 0.0)
    xx, yy, zz = ((weight * axis * axis).sum(axis=0) + prior for axis in (x, y, z))
    xy, xz, yz = ((weight * one * other).sum(axis=0) for one, other in ((x, y), (x, z), (y, z)))
    # L D L' of the matrix; a pivot that is not positive leaves nan
    first = np.where(xx > 0.0, xx, np.nan)
    low, last = xy / first, xz / first
    second = yy - low * xy
    second = np.where(second > 0.0, second, np.nan)
    across = (yz - last * xy) / second
    third = zz - last * xz - across * across * second
    third = np.where(third > 0.0, third, np.nan)
    up = 1.0 / third
    north = 1.0 / second + across**2 * up
    east = 1.0 / first + low**2 / second + (low * across - last) ** 2 * up
    # trace of the matrix times that of its inverse bounds its condition number
    out = np.stack([east, north, up])
    return np.where((xx + yy + zz) * out.sum(axis=0) < SINGULAR, out, np.nan)


def mixed_dops(away: np.ndarray, los: np.ndarray, clock: np.ndarray, own: int = -1) -> np.ndarray:
    """PDOP, HDOP, VDOP (e, 3) of two-way ranges, or of ranges with a clock of the number `own`, and of pseudoranges.

    away: see `range_dops`; los: (e, s, 3) unit vectors to sources of pseudoranges in the same axes, nan likewise, and
    clock (s,) of each, see `dop.dops`.
    """
    both = np.concatenate([away / np.linalg.norm(away, axis=2, keepdims=True), los], axis=1)
    return dops(both, np.concatenate([np.full(away.shape[1], own), clock]))[:, 1:4]


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
