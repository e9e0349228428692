"""Deviations from localizer and glide path as a pilot sees them.

Equations: `docs/theory/air.md`, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def foot_of(positions: np.ndarray, velocities: np.ndarray, angle: float) -> float:
    """Where the straight glide of a path meets the height of the touchdown point, m beyond that point.

    positions, velocities: (n, 3) in its axes, z down, m, m/s. angle: of the glide, rad.
    """
    slope = velocities[:, 2] / velocities[:, 0]
    on_glide = int(np.argmin(np.abs(slope - np.tan(angle))))
    ahead, _, down = positions[on_glide]
    return float(np.round(ahead - down / np.tan(angle), 6)) + 0.0


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
