"""Course of a route as the frame for deviations, their reduction on the ground, and random walks along it.

Equations: `docs/theory/air.md`, sections 3 to 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.statistics.linear_processes import discretised
from navsim.trajectory.air import Process
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.kinematics import Trajectory

GROUNDED = 5.0
"""After touchdown the ground takes out deviations in height and in attitude within so long, s."""
FREE = 15.24
"""Height above the runway from which gusts move an aircraft up and down as they would far from it, m; 50 ft."""
LATERAL, ALONG, VERTICAL = range(3)
"""Parts of a deviation in axes of the course: to the right, ahead, up."""


@dataclass(frozen=True)
class Course:
    """Course of a moving reference at times (k,), with its level axes."""

    right: np.ndarray
    """(3, k, 3) level unit vector to the right of the course along path axes, with two derivatives."""
    ahead: np.ndarray
    """(3, k, 3) level unit vector ahead, likewise."""
    height: np.ndarray
    """(3, k) height above the runway with two derivatives, m."""
    slowness: np.ndarray
    """(2, k) inverse of the airspeed and its rate."""
    airborne: np.ndarray
    """(3, k) fraction of the air's effect that remains, with two derivatives: the ground removes it after touchdown."""

    @classmethod
    def of(cls, trajectory: Trajectory, time: np.ndarray) -> Course:
        """Course of a trajectory that moves over ground everywhere."""
        jet = trajectory.path.jet(time)
        (vx, vy), (ax, ay), (jx, jy) = (jet[:, order, :2].T for order in (1, 2, 3))
        square = vx**2 + vy**2
        speed, zero = np.sqrt(square), np.zeros(time.size)
        ahead = np.stack([vx / speed, vy / speed, zero], axis=1)
        right = np.stack([-ahead[:, 1], ahead[:, 0], zero], axis=1)
        turn = (vx * ay - vy * ax) / square
        faster = ((vx * jy - vy * jx) - 2.0 * turn * (vx * ax + vy * ay)) / square
        turn, faster = turn[:, None], faster[:, None]
        airspeed = np.linalg.norm(jet[:, 1] - trajectory.wind.mean(time), axis=1)
        slowness = 1.0 / airspeed
        return cls(
            np.stack([right, -turn * ahead, -faster * ahead - turn**2 * right]),
            np.stack([ahead, turn * right, faster * right - turn**2 * ahead]),
            -jet[:, :3, 2].T,
            np.stack([slowness, np.gradient(slowness, time)]),
            _airborne(time, trajectory.path.events.get(TOUCHDOWN)),
        )

    def free(self) -> np.ndarray:
        """Remaining fraction of vertical deviations by gusts, with two derivatives (3, k).

        It is one above `FREE`, zero at the runway's height, and twice differentiable.
        """
        height, rate, acceleration = self.height / FREE
        u = np.clip(height, -1.0, 1.0)
        below = 1.0 - u**2
        slope, bend = 6.0 * u * below**2, 6.0 * below * (below - 4.0 * u**2)
        return np.stack([1.0 - below**3, slope * rate, bend * rate**2 + slope * acceleration])

    def of_air(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heights, m, and airspeeds, m/s, at some of the times; after touchdown they keep their values of touchdown."""
        last = max(0, int(np.count_nonzero(self.airborne[0] == 1.0)) - 1)
        held = np.minimum(which, last)
        return self.height[0, held], 1.0 / self.slowness[0, held]


def _airborne(time: np.ndarray, touchdown: float | None) -> np.ndarray:
    """1 in the air, 0 on the ground, with derivatives (3, k); twice differentiable."""
    out = np.zeros((3, time.size))
    out[0] = 1.0
    if touchdown is not None:
        u = np.clip((time - touchdown) / GROUNDED, 0.0, 1.0)
        out[0] -= u**3 * (10.0 + u * (6.0 * u - 15.0))
        out[1] = -30.0 * u**2 * (1.0 - u) ** 2 / GROUNDED
        out[2] = -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / GROUNDED**2
    return out


@dataclass(frozen=True)
class Walk:
    """A process in exact steps between times (k,): transition, root (m, n, n), which (k - 1,) of them each step takes,
    start (n, n) root of its stationary covariance."""

    transition: np.ndarray
    root: np.ndarray
    which: np.ndarray
    start: np.ndarray

    @classmethod
    def of(cls, processes: list[Process], which: np.ndarray, step: float, start: Process | None = None) -> Walk:
        """Random walk from processes with the same states, one for each step of so many s; start: stationary process
        from which it begins, None for that of the first step."""
        parts = [discretised(p.a, p.b, step) for p in processes]
        transition, root = (np.ascontiguousarray(np.stack(m)) for m in zip(*parts, strict=True))
        return cls(transition, root, which, np.linalg.cholesky((start or processes[which[0]]).covariance))

    def drawn(self, rngs: tuple[np.random.Generator, ...], count: int) -> np.ndarray:
        """States (k, n, W) of the first `count` of W runs."""
        from navsim.statistics.noise import walk  # compiled code only when something is really simulated

        out = np.zeros((self.which.size + 1, self.start.shape[0], len(rngs)))
        walk(rngs, count, self.transition, self.root, self.which, self.start, out)
        return out

    def carried(self, weights: np.ndarray) -> np.ndarray:
        """Covariance of the states times weights (K, k, n): where the states most likely are when sums of them with
        these weights are off by their variances."""
        later = weights.copy()
        for t in range(self.which.size - 1, -1, -1):
            later[:, t] += later[:, t + 1] @ self.transition[self.which[t]]
        out = np.empty_like(weights)
        out[:, 0] = later[:, 0] @ self.start @ self.start.T
        for t, step in enumerate(self.which):
            new = later[:, t + 1] @ self.root[step] @ self.root[step].T
            out[:, t + 1] = out[:, t] @ self.transition[step].T + new
        return out
