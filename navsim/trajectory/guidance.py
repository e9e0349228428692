"""Guidance by estimates: effect of navigation errors on the trajectory.

Guidance corrects the estimated deviation from the route, also that by gusts, not the true one. Navigation errors
therefore take the aircraft off the route. Equations: `docs/theory/air.md`, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.statistics.linear_processes import exponential
from navsim.trajectory.autopilot import Autopilot
from navsim.trajectory.track_frame import ALONG, LATERAL, VERTICAL, Course


@dataclass(frozen=True)
class GuidanceErrors:
    """Errors of estimates as guidance has them, truth - estimate."""

    first: np.ndarray
    """(m,) samples, increasing, from which each counts until the next."""
    values: np.ndarray
    """(m, 6, W) errors of position, m, and velocity, m/s, along path axes."""

    @classmethod
    def of(cls, first: np.ndarray, values: np.ndarray) -> GuidanceErrors:
        """Hold outputs at samples (m,), which may repeat: the last one counts.

        An estimate that is nan holds the last valid one. Before the first valid one the estimate has no error.
        """
        known = np.where(np.isfinite(values).all(axis=1), np.arange(first.size)[:, None], -1)
        last = np.maximum.accumulate(known, axis=0)
        kept = np.take_along_axis(values, np.maximum(last, 0)[:, None], axis=0)
        of_samples = np.append(first[1:] != first[:-1], True)
        return cls(first[of_samples], np.where(last[:, None] >= 0, kept, 0.0)[of_samples])

    def along_course(self, course: Course) -> np.ndarray:
        """Along axes of the course, which turn (m, 3, 2, W): errors of position, m, and their rates, m/s."""
        out = np.empty((self.first.size, 3, 2, self.values.shape[2]))
        position, velocity = np.split(self.values, 2, axis=1)
        for axis, unit in ((LATERAL, course.right), (ALONG, course.ahead)):
            direction, turning = unit[:2, self.first]
            out[:, axis, 0] = np.einsum("maw,ma->mw", position, direction)
            out[:, axis, 1] = np.einsum("maw,ma->mw", velocity, direction)
            out[:, axis, 1] += np.einsum("maw,ma->mw", position, turning)
        out[:, VERTICAL, 0], out[:, VERTICAL, 1] = -position[:, 2], -velocity[:, 2]
        return out


def steered(
    autopilot: Autopilot,
    known: GuidanceErrors,
    course: Course,
    slope: np.ndarray,
    step: float,
    pitches: bool,
    way: np.ndarray,
    turn: np.ndarray,
    displaced: np.ndarray | None = None,
) -> None:
    """Add the effect of an autopilot that has estimates to deviations `way`, `turn` at the samples of a course.

    - displaced: see `PathDeviation`; its estimate is corrected, too. None or (0, ...): nothing displaces.
    - slope: (2, k) climb of the route per metre ahead, and its rate, 1/s.
    - step: s between samples.
    - pitches: the nose follows the path.
    - way, turn: (k, 9, W), (k, 6, W), see `PathDeviation`. The nose follows the trajectory, the bank its acceleration.
    """
    from navsim.compiler.lanes import in_lanes
    from navsim.trajectory.autopilot_kernels import steer  # compiled code only when something is really simulated

    transition, drive, gain = _discrete(autopilot, step)
    limits, rates = (np.array([getattr(c, name) for c in autopilot.channels]) for name in ("limit", "rate"))
    first, error = known.first, known.along_course(course)
    if displaced is not None and len(displaced):
        # what the autopilot has flown and an error that is smaller by the displacement: the same estimate
        row = np.searchsorted(first, np.arange(len(way)), side="right") - 1
        error = error[row]
        error[row < 0] = 0.0
        error -= displaced
        first = np.arange(len(way))
    steer(
        step, first, in_lanes(error), slope, gain, limits, rates, transition, drive,
        course.right, course.ahead, course.airborne, course.slowness, pitches, in_lanes(way), in_lanes(turn),
    )  # fmt: skip


def _discrete(autopilot: Autopilot, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition (3, 4, 4) of the aircraft's motion over a sample, its drive (3, 4) by the command, gains (3, 2)."""
    both = np.zeros((3, 5, 5))
    for each, channel in zip(both, autopilot.channels, strict=True):
        each[:4, :4], each[:4, 4] = channel.aircraft
    both = exponential(both * step)
    gain = np.stack([channel.gain for channel in autopilot.channels])
    return np.ascontiguousarray(both[:, :4, :4]), np.ascontiguousarray(both[:, :4, 4]), gain


def slopes_by_errors(
    autopilot: Autopilot, first: np.ndarray, course: Course, slope: np.ndarray, step: float, weights: np.ndarray
) -> np.ndarray:
    """Slopes (K, m, 3, 2) of K sums of the positions of a steered aircraft, by the errors that its guidance has from
    samples `first` (m,) on, as of `GuidanceErrors.along_course`: the adjoint of `steered` within its limits.

    - slope, step: see `steered`.
    - weights: (K, k, 3) of the sums, of positions along path axes at the first k samples.
    """
    transition, drive, gain = _discrete(autopilot, step)
    by_error = np.zeros((len(weights), first.size, 3, 2))
    moved = np.zeros((len(weights), 3, 4))  # slopes by the motion
    rows = np.searchsorted(first, np.arange(weights.shape[1]), side="right") - 1
    for k in range(weights.shape[1] - 1, -1, -1):
        asked = np.einsum("Kai,ai->Ka", moved, drive)
        of_estimate = -asked[..., None] * gain
        up = of_estimate[:, VERTICAL]
        of_estimate[:, ALONG, 0] -= up[:, 0] * slope[0, k] + up[:, 1] * slope[1, k]
        of_estimate[:, ALONG, 1] -= up[:, 1] * slope[0, k]
        if rows[k] >= 0:
            by_error[:, rows[k]] -= of_estimate
        moved = np.einsum("aji,Kaj->Kai", transition, moved)
        moved[..., :2] += of_estimate
        moved[:, LATERAL, 0] += weights[:, k] @ course.right[0, k]
        moved[:, ALONG, 0] += weights[:, k] @ course.ahead[0, k]
        moved[:, VERTICAL, 0] -= weights[:, k, 2] * course.airborne[0, k]
    return by_error
