"""Semi-physical modelling: one block of the chain is real and sends its data, the rest is simulated.

The filter goes forward piece by piece: it lives at the time of its newest fix, and increments wait until a fix for
their time has come. What comes too late, for a time already passed, is counted and left out.

Source: [1] `landing.md`, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from navsim.core import covariance, states
from navsim.estimation import loosely_coupled
from navsim.models.kinematics import Moving
from navsim.simulation.landing import FilterSettings


@dataclass
class Increments:
    """Increments by time, of which the oldest are used up: time (n + 1,) s, dtheta, dv (n, 3)."""

    time: list[float]
    dtheta: list[np.ndarray] = field(default_factory=list)
    dv: list[np.ndarray] = field(default_factory=list)

    def add(self, time: float, dtheta: np.ndarray, dv: np.ndarray) -> None:
        """What was felt from the last time to this one."""
        self.time.append(time)
        self.dtheta.append(dtheta)
        self.dv.append(dv)

    def until(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The whole intervals that reach up to `time`, at least one; all of them stay."""
        last = max(1, int(np.searchsorted(self.time, time - loosely_coupled.TIME_TOLERANCE)))
        return np.array(self.time[: last + 1]), np.array(self.dtheta[:last]), np.array(self.dv[:last])

    def drop(self, time: float) -> None:
        """Forget what was before `time`; an interval across it is cut in proportion."""
        first = int(np.searchsorted(self.time, time + loosely_coupled.TIME_TOLERANCE, side="right")) - 1
        self.time, self.dtheta, self.dv = self.time[first:], self.dtheta[first:], self.dv[first:]
        if time > self.time[0] + loosely_coupled.TIME_TOLERANCE:
            share = (self.time[1] - time) / (self.time[1] - self.time[0])
            self.time[0], self.dtheta[0], self.dv[0] = time, share * self.dtheta[0], share * self.dv[0]


@dataclass
class LiveFilter:
    """A filter that is fed as data come.

    settings, nav (20,), trajectory: as for a landing. What it leaves: a list of (time of its answer, s,
    `loosely_coupled.Flown` of one fix).
    """

    settings: FilterSettings
    trajectory: Moving
    nav: np.ndarray
    increments: Increments
    covariance: np.ndarray = field(init=False)
    rejected: int = 0
    """fixes in a row that the gate rejected"""
    left: list[tuple[float, loosely_coupled.Flown]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.covariance = self.settings.covariance()

    @property
    def time(self) -> float:
        """Where the filter is, s."""
        return self.increments.time[0]

    @property
    def known_until(self) -> float:
        """Up to when increments are there, s."""
        return self.increments.time[-1]

    def weigh(self, arrival: float, llh: np.ndarray, velocity: np.ndarray, noise: np.ndarray) -> bool:
        """Go on to a fix that came at `arrival`, use it, and answer for that time: llh (3,), velocity (3,) nan where
        unknown, noise (6, 6). The fix was valid the filter's latency earlier, as in a landing.

        False where that time is past, or increments up to the arrival are not there yet.
        """
        tolerance = loosely_coupled.TIME_TOLERANCE
        latency = self.settings.latency
        valid = max(arrival - latency, 0.0)
        if valid < self.time - tolerance or arrival > self.known_until + tolerance:
            return False
        if self.settings.kind > loosely_coupled.TFG:
            raise ValueError("a smoother cannot run live")
        arrival = min(arrival, self.known_until)
        valid = min(valid, arrival)
        imu_time, dtheta, dv = self.increments.until(arrival)
        truth = self.trajectory.motion(np.array([imu_time[0], arrival]))
        out = loosely_coupled.Flown.of(1)
        loosely_coupled.run(
            self.settings.kind, imu_time, dtheta, dv, self.nav, self.covariance, self.settings.noise(),
            np.array([valid]), llh[None].copy(), velocity[None].copy(), noise[None].copy(), self.settings.with_velocity,
            latency, self.settings.lever_arm, self.settings.gate, max(self.settings.max_rejected - self.rejected, 0),
            truth.llh, truth.velocity_ned, truth.quaternion, np.zeros((2, 6)), out, covariance.STRIDE,
        )  # fmt: skip
        # each call counts from none: what was rejected before it is taken off the limit
        if out.status[0] == loosely_coupled.REJECTED:
            self.rejected += 1
        elif out.status[0] == loosely_coupled.USED:
            self.rejected = 0
        self.increments.drop(valid)
        self.left.append((arrival, out))
        return True

    def estimates(self) -> dict[str, np.ndarray]:
        """What was left, stacked: time (t,) of the answers, error, sigma (t, 15), estimate (t, 20), misfit (t, 6),
        squared, degrees, status (t,). Errors of biases are nan: what they truly are is not known of real sensors."""
        n = len(self.left)
        error = np.array([f.error[1] for _, f in self.left]).reshape(n, states.N)
        error[:, states.GYRO :] = np.nan
        return {
            "time": np.array([t for t, _ in self.left]),
            "error": error,
            "sigma": np.array([f.sigma[1] for _, f in self.left]).reshape(n, states.N),
            "estimate": np.array([f.estimate[1] for _, f in self.left]).reshape(n, states.NAV_N),
            "misfit": np.array([f.misfit[0] for _, f in self.left]).reshape(n, 6),
            "squared": np.array([f.innovation[0] for _, f in self.left]),
            "degrees": np.array([f.degrees[0] for _, f in self.left], dtype=np.int64),
            "status": np.array([f.status[0] for _, f in self.left], dtype=np.int64),
        }
