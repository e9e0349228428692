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

    def take(self, until: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Everything up to `until`, an interval across it cut in proportion; the rest stays."""
        cut = int(np.searchsorted(self.time, until - loosely_coupled.TIME_TOLERANCE))
        time, dtheta, dv = self.time[: cut + 1], self.dtheta[:cut], self.dv[:cut]
        whole = time[-1] - time[-2]
        share = (until - time[-2]) / whole
        rest_theta, rest_dv = (1.0 - share) * dtheta[-1], (1.0 - share) * dv[-1]
        end = time[-1]
        out = (
            np.array([*time[:-1], until]),
            np.array([*dtheta[:-1], share * dtheta[-1]]),
            np.array([*dv[:-1], share * dv[-1]]),
        )
        if share < 1.0 - 1e-9:
            self.time = [until, end, *self.time[cut + 1 :]]
            self.dtheta = [rest_theta, *self.dtheta[cut:]]
            self.dv = [rest_dv, *self.dv[cut:]]
        else:
            self.time, self.dtheta, self.dv = self.time[cut:], self.dtheta[cut:], self.dv[cut:]
        return out


@dataclass
class LiveFilter:
    """A filter that is fed as data come.

    settings, nav (20,), trajectory: as for a landing; time: where the filter is, s. What it leaves: a list of (time,
    `loosely_coupled.Flown` of one fix).
    """

    settings: FilterSettings
    trajectory: Moving
    nav: np.ndarray
    increments: Increments
    covariance: np.ndarray = field(init=False)
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

    def weigh(self, time: float, llh: np.ndarray, velocity: np.ndarray, noise: np.ndarray) -> bool:
        """Go on to a fix of this time and use it: llh (3,), velocity (3,) nan where unknown, noise (6, 6).

        False where that time is past, or increments up to it are not there yet.
        """
        tolerance = loosely_coupled.TIME_TOLERANCE
        if time <= self.time + tolerance or time > self.known_until + tolerance:
            return False
        if self.settings.kind > loosely_coupled.TFG:
            raise ValueError("a smoother cannot run live")
        imu_time, dtheta, dv = self.increments.take(min(time, self.known_until))
        truth = self.trajectory.motion(np.array([imu_time[0], time]))
        out = loosely_coupled.Flown.of(1)
        loosely_coupled.run(
            self.settings.kind, imu_time, dtheta, dv, self.nav, self.covariance, self.settings.noise(),
            np.array([time]), llh[None].copy(), velocity[None].copy(), noise[None].copy(), self.settings.with_velocity,
            0.0, self.settings.lever_arm, self.settings.gate, self.settings.max_rejected, truth.llh,
            truth.velocity_ned, truth.quaternion, np.zeros((2, 6)), out, covariance.STRIDE,
        )  # fmt: skip
        self.left.append((time, out))
        return True

    def estimates(self) -> dict[str, np.ndarray]:
        """What was left, stacked: time (t,), error, sigma (t, 15), estimate (t, 20), misfit (t, 6), squared, degrees,
        status (t,). Errors of biases are nan: what they truly are is not known of real sensors."""
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
