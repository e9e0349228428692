"""Autopilot of an aircraft: the law of its guidance, and the aircraft's response to commands.

Equations: `docs/theory/air.md`, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_DAMPING = 0.4
"""Least damping ratio of a steered aircraft; less is refused."""


@dataclass(frozen=True)
class Channel:
    """Guidance along one axis of the course and the aircraft's response to it."""

    time: float
    """Time constant of the loop, s."""
    damping: float | None
    """Damping ratio; None: guidance holds the speed alone."""
    lag: float
    """Each of two lags of the acceleration behind the command, s."""
    limit: float
    """Largest command, m/s2."""
    rate: float = np.inf
    """Largest rate of the command, m/s3."""

    @property
    def gain(self) -> np.ndarray:
        """Acceleration per metre and per m/s of deviation (2,)."""
        if self.damping is None:
            return np.array([0.0, 1.0 / self.time])
        return np.array([1.0 / self.time**2, 2.0 * self.damping / self.time])

    @property
    def aircraft(self) -> tuple[np.ndarray, np.ndarray]:
        """Deviation with two derivatives and the rate of the acceleration, driven by the command: (4, 4), (4,)."""
        a, b = np.zeros((4, 4)), np.zeros(4)
        a[0, 1] = a[1, 2] = a[2, 3] = 1.0
        a[3, 2:], b[3] = [-1.0 / self.lag**2, -2.0 / self.lag], 1.0 / self.lag**2
        return a, b

    @property
    def closed(self) -> tuple[np.ndarray, np.ndarray]:
        """The same under guidance without limits, (4, 4), driven by errors of position and velocity, truth minus
        estimate, (4, 2)."""
        a, b = self.aircraft
        effect = np.outer(b, self.gain)
        a[:, :2] -= effect
        return a, effect

    @property
    def least_damping(self) -> float:
        """Damping ratio of the least damped motion; below 0 the loop is unstable."""
        modes = np.linalg.eigvals(self.closed[0][1:, 1:] if self.damping is None else self.closed[0])
        return float(np.min(-modes.real / np.abs(modes)))


@dataclass(frozen=True)
class Autopilot:
    """Guidance and response along the axes of the course: lateral, along, vertical."""

    channels: tuple[Channel, Channel, Channel]
