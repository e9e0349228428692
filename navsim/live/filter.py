"""Hardware in the loop: a real receiver or IMU sends its data, navsim simulates the rest.

The filter runs forward piece by piece. It is at the time of its newest fix, and increments wait until a fix for their
time has arrived. Data for a time already passed are counted and omitted.

Source: `docs/theory/landing.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from navsim.filter.estimate import estimate, is_smoother
from navsim.filter.evaluation import evaluate
from navsim.filter.measurement_kinds import FIX, Measurements
from navsim.filter.records import TIME_TOLERANCE, History, ImuData, OutputErrors, State, Truth, schedule, start
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.simulation.flight import Flight
from navsim.simulation.measurement_tables import table_of_all_fixes
from navsim.trajectory.kinematics import Moving


@dataclass
class Increments:
    """Queue of increments by time: time (n + 1,) s, dtheta, dv (n, 3)."""

    time: list[float]
    dtheta: list[np.ndarray] = field(default_factory=list)
    dv: list[np.ndarray] = field(default_factory=list)

    def add(self, time: float, dtheta: np.ndarray, dv: np.ndarray) -> None:
        """Add the increments from the last time to this one."""
        self.time.append(time)
        self.dtheta.append(dtheta)
        self.dv.append(dv)

    def until(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Complete intervals up to `time`, at least one; all of them stay in the queue."""
        last = max(1, int(np.searchsorted(self.time, time - TIME_TOLERANCE)))
        return np.array(self.time[: last + 1]), np.array(self.dtheta[:last]), np.array(self.dv[:last])

    def drop(self, time: float) -> None:
        """Remove everything before `time`; an interval across it is cut in proportion."""
        first = int(np.searchsorted(self.time, time + TIME_TOLERANCE, side="right")) - 1
        self.time, self.dtheta, self.dv = self.time[first:], self.dtheta[first:], self.dv[first:]
        if time > self.time[0] + TIME_TOLERANCE:
            share = (self.time[1] - time) / (self.time[1] - self.time[0])
            self.time[0], self.dtheta[0], self.dv[0] = time, share * self.dtheta[0], share * self.dv[0]


@dataclass
class LiveFilter:
    """A filter that receives data as they arrive.

    flight: filter model, as for a landing; covariance: initial one. trajectory: reference for the errors. navigation
    (NAV,): initial state. The output is a list of (time, s, history of one fix, errors).
    """

    flight: Flight
    trajectory: Moving
    navigation: np.ndarray
    increments: Increments
    state: State = field(init=False)
    outputs: list[tuple[float, History, OutputErrors]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if is_smoother(self.flight.design.kind):
            raise ValueError("a smoother cannot run live")
        if self.flight.design.tight:
            raise ValueError("live receivers give fixes, no ranges")
        if self.flight.shared.aids:
            raise ValueError("aiding sensors cannot run live")
        self.state = start(self.navigation, self.flight.covariance, self.flight.model.components)

    @property
    def time(self) -> float:
        """Present time of the filter, s."""
        return self.increments.time[0]

    @property
    def known_until(self) -> float:
        """Up to when increments are there, s."""
        return self.increments.time[-1]

    def process_fix(self, arrival: float, llh: np.ndarray, velocity: np.ndarray, noise: np.ndarray, epoch: int) -> bool:
        """Propagate to a fix that arrived at `arrival`, use it, and store the output for that time.

        llh (3,), velocity (3,) nan where unknown, noise (6, 6). The fix was valid the filter's latency earlier, as in a
        landing. epoch: of the flight, whose time-correlated errors are used for those of the fix.

        Returns False if that time is past, or increments up to the arrival are missing.
        """
        design = self.flight.design
        valid = max(arrival - design.latency, 0.0)
        if valid < self.time - TIME_TOLERANCE or arrival > self.known_until + TIME_TOLERANCE:
            return False
        arrival = min(arrival, self.known_until)
        valid = min(valid, arrival)
        own = table_of_all_fixes(
            self.flight, llh[None].copy(), velocity[None].copy(), noise[None], slice(epoch, epoch + 1)
        )
        history = estimate(
            ImuData(*self.increments.until(arrival)),
            Measurements.of({FIX: own}),
            schedule(np.array([arrival]), (FIX, np.array([valid]), np.array([arrival]))),
            self.state,
            self.flight.model,
        )
        truth = self.trajectory.motion(np.array([arrival]))
        # the true errors of real sensors are unknown
        unknown = np.full((1, self.flight.model.declared.size), np.nan)
        judged = evaluate(self.flight.model, history, Truth(truth.llh, truth.velocity_ned, truth.quaternion, unknown))
        self.increments.drop(valid)
        self.outputs.append((arrival, history, judged))
        return True

    def estimates(self) -> dict[str, np.ndarray]:
        """Stored outputs: time (t,), error, sigma (t, n), navigation (t, NAV), innovation (t, 6), innovation_squared,
        degrees, status (t,). Errors of sensor states are nan."""
        histories = [history for _, history, _ in self.outputs]
        count, n = len(self.outputs), self.flight.covariance.shape[0]
        # the fix is the first event of its history
        return {
            "time": np.array([time for time, _, _ in self.outputs]),
            "error": np.array([judged.error[0] for _, _, judged in self.outputs]).reshape(count, n),
            "sigma": np.array([h.sigma()[0] for h in histories]).reshape(count, n),
            "navigation": np.array([h.navigation[0] for h in histories]).reshape(count, self.state.navigation.size),
            "innovation": np.array([h.innovation[0] for h in histories]).reshape(count, MAX_MEASUREMENT_SIZE),
            "innovation_squared": np.array([h.innovation_squared[0] for h in histories]),
            "degrees": np.array([h.degrees[0] for h in histories], dtype=np.int64),
            "status": np.array([h.status[0] for h in histories], dtype=np.int64),
        }
