"""Deviations from localizer and glide path as a pilot sees them.

Equations: `docs/theory/air.md`, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ON_COURSE = 0.01
"""Largest deviation of a route that holds course and glide path, parts of full scale."""


def foot_of(positions: np.ndarray, velocities: np.ndarray, angle: float) -> float:
    """Where the straight glide of a path meets the height of the touchdown point, m beyond that point.

    positions, velocities: (n, 3) in its axes, z down, m, m/s. angle: of the glide, rad.
    """
    slope = velocities[:, 2] / velocities[:, 0]
    on_glide = int(np.argmin(np.abs(slope - np.tan(angle))))
    ahead, _, down = positions[on_glide]
    return float(np.round(ahead - down / np.tan(angle), 6)) + 0.0


def aircraft_and_estimate(off: np.ndarray, error: np.ndarray, steered: bool) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (..., 3) of aircraft and of their estimates from the route, m.

    off: stored deviations: of the aircraft where its estimate steers it, else of the estimate; error: truth minus
    estimate.
    """
    return (off, off - error) if steered else (off + error, off)


@dataclass(frozen=True)
class Indicator:
    """Scales of the deviations. m, rad."""

    origin: float
    """Distance of the vertex of the course beyond the threshold."""
    aim: float
    """Distance of the touchdown point beyond the threshold."""
    width: float
    """Full scale from the centre line at the threshold."""
    angle: float
    """Angle of the glide path."""
    share: float
    """Full scale of the glide path as a part of its angle."""
    foot: float
    """Distance of the foot of the glide path beyond the touchdown point: negative where a flare leads beyond it."""

    def deviations(self, along: np.ndarray, right: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Deviations (..., 2) from localizer and glide path in parts of full scale, to the right and up.

        along, right, up: positions in axes of the touchdown point, m. That of the glide path is nan beyond its foot.
        """
        course = np.arctan2(right, self.origin - self.aim - along) / np.arctan2(self.width, self.origin)
        before = np.where(along < self.foot, np.hypot(along - self.foot, right), np.nan)
        glide = (np.arctan2(up, before) - self.angle) / (self.share * self.angle)
        return np.stack([course, glide], axis=-1)

    def along_route(self, route: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Deviations (..., o, 2) from localizer and glide path, parts of full scale.

        route: positions (o, 3), z down, m. off: distances (..., o, 3) from it to the right, along, and up, m.
        """
        right, along, up = np.moveaxis(off, -1, 0)
        return self.deviations(route[:, 0] + along, route[:, 1] + right, up - route[:, 2])

    def established(self, route: np.ndarray) -> np.ndarray:
        """Outputs (o,) bool of a route (o, 3) from which it holds course and glide path longest: the capture of the
        glide path is no deviation of the aircraft. All where it holds them nowhere."""
        on = np.abs(self.along_route(route, np.zeros_like(route))).max(axis=1) <= ON_COURSE
        edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int))).reshape(-1, 2)
        first = int(edges[np.argmax(edges[:, 1] - edges[:, 0]), 0]) if edges.size else 0
        return np.arange(on.size) >= first
