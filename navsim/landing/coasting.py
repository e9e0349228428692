"""Covariance of the position while there are no fixes, before anything is flown.

A linear error model in coarse steps. Its states are position, velocity and tilt (NED), biases of the inertial sensors
(body axes), lasting errors of fixes, one lasting error of each beacon, and the clock of one-way ranges. Other sensors
are left out, so with them the covariance is too large. Source: Groves (2013), section 14.2.4, without Earth rate and
Schuler terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.filter.design import FilterDesign
from navsim.filter.states import ACCELEROMETERS, GYROS
from navsim.landing.beacons import BeaconGeometry
from navsim.simulation.flight import InitialErrors
from navsim.simulation.shared_truth import SharedTruth

STEP = 0.2
"""Length of the steps, s."""
_MOST = 3000
"""Largest number of steps: those of a longer flight are longer."""
_POSITION, _VELOCITY, _TILT, _GYRO, _ACCEL, _FIX = _OWN_STATES = [slice(3 * k, 3 * k + 3) for k in range(6)]
_OWN = 3 * len(_OWN_STATES)


def grid(shared: SharedTruth) -> np.ndarray:
    """Ends of the steps (g,), s."""
    begin, end = shared.imu_time[[0, -1]]
    count = int(np.clip(round((end - begin) / STEP), 1, _MOST))
    return np.asarray(np.linspace(begin, end, count + 1)[1:])


@dataclass(frozen=True)
class Coasting:
    """The error model of a flight with beacons."""

    shared: SharedTruth
    design: FilterDesign
    initial: InitialErrors
    geometry: BeaconGeometry
    """At the times of `grid`."""

    def covariance(self) -> np.ndarray:
        """Covariance of the position (g, 3, 3), NED m2, behind the measurements of each step."""
        time, p = grid(self.shared), self._start()
        moves, added = self._steps(time)
        epochs = np.searchsorted(self.shared.signals.time, np.append(self.shared.imu_time[0], time), side="right")
        rows, noise = self._ranges(float(time[0] - self.shared.imu_time[0]))
        there, out = self.geometry.received, np.empty((time.size, 3, 3))
        fixed = self.shared.fix_errors.fixed
        for g in range(time.size):
            p = moves[g] @ p @ moves[g].T
            p.flat[:: p.shape[0] + 1] += added
            for e in range(epochs[g], epochs[g + 1]):
                if fixed[e]:
                    p = self._after_fix(p, e)
            if there[g].any():
                p = _updated(p, rows[g, there[g]], np.diag(noise[g, there[g]]))
            out[g] = p[_POSITION, _POSITION]
        return out

    def _start(self) -> np.ndarray:
        """Covariance at time 0."""
        sensor, blocks = self.geometry.sensor.design, self.design.sensors.blocks[:2]
        n, clock = len(self.geometry.llh), sensor.clock
        assert [block.sensor for block in blocks] == [GYROS, ACCELEROMETERS]
        own = (self.initial.position, self.initial.velocity, self.initial.attitude, *self.design.sensors.sigma[:2])
        of_clock = [] if clock is None else [clock.offset, clock.rate]
        far = np.nanmax(np.where(self.geometry.received, self._distance, 0.0), axis=0, initial=0.0)
        lasting = np.sqrt(sensor.errors.variance(far) + (1e-6 * sensor.air_sigma * far) ** 2)
        out = np.diag(np.concatenate([np.repeat(own, 3), np.zeros(3), lasting[:n], of_clock]) ** 2)
        out[_FIX, _FIX] = self._lasting_of_fixes()
        return out

    @property
    def _distance(self) -> np.ndarray:
        """Distances (g, n), m."""
        return np.asarray(np.linalg.norm(self.geometry.away, axis=2))

    def _lasting_of_fixes(self) -> np.ndarray:
        """Covariance (3, 3) of the errors of fixes that last, NED m2: those of the first fix."""
        signals, errors = self.shared.signals, self.shared.fix_errors
        if signals.correlated is None or not errors.fixed.any():
            return np.zeros((3, 3))
        return np.asarray(errors.of_ranges(signals.correlated.total)[np.argmax(errors.fixed), :3, :3])

    def _steps(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition (g, N, N) of each step, and the diagonal (N,) of the noise that each adds."""
        truth, begin = self.shared.truth, float(self.shared.imu_time[0])
        h = float(time[0] - begin)
        middle = np.searchsorted(self.shared.imu_time, time - 0.5 * h)
        c = truth.c_ne[middle] @ truth.c_eb[middle]
        force = np.einsum("gij,gj->gi", c, truth.specific_force[middle])
        size = _OWN + len(self.geometry.llh) + 2 * (self.geometry.sensor.design.clock is not None)
        f = np.zeros((time.size, size, size))
        f[:, _POSITION, _VELOCITY] = np.eye(3)
        f[:, _VELOCITY, _TILT] = np.cross(force[:, None], np.eye(3)).swapaxes(1, 2)
        f[:, _TILT, _GYRO], f[:, _VELOCITY, _ACCEL] = c, c
        if self.geometry.sensor.design.clock is not None:
            f[:, -2, -1] = 1.0
        f *= h
        added = np.zeros(size)
        for place, block in zip((_GYRO, _ACCEL), self.design.sensors.blocks[:2], strict=True):
            decay, slower = block.decay * h, min(1.0, 1.0 / (block.decay * h)) if block.decay else 1.0
            # one that is faster than the steps becomes one of a step, with the same density at frequency 0
            decay, drive = decay * slower, block.drive * slower**2
            f[:, place, place] = -decay * np.eye(3)
            added[place] = drive * h * (-np.expm1(-2.0 * decay) / (2.0 * decay) if decay else 1.0)
        square = f @ f
        for place, density in zip((_TILT, _VELOCITY), self.design.sensors.noise, strict=True):
            added[place] = density * h
        if (clock := self.geometry.sensor.design.clock) is not None:
            added[-2:] = np.array(clock.density) * h
        return np.eye(size) + f + 0.5 * square + square @ f / 6.0, added

    def _ranges(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows (g, n, N) of the mean range of each beacon in a step of h, s, and its variance (g, n), m2."""
        sensor, away = self.geometry.sensor, self.geometry.away
        g, n = away.shape[:2]
        size = _OWN + n + 2 * (sensor.design.clock is not None)
        out = np.zeros((g, n, size))
        out[:, :, _POSITION] = -away[..., [1, 0, 2]] * [1.0, 1.0, -1.0] / self._distance[..., None]
        out[:, np.arange(n), _OWN + np.arange(n)] = 1.0
        out[:, :, _OWN + n : _OWN + n + 1] = 1.0
        return out, sensor.noise_variance(self._distance) * (n / (sensor.rate * h))

    def _after_fix(self, p: np.ndarray, e: int) -> np.ndarray:
        """P (N, N) after the fix of epoch e, with velocity if the filter uses it."""
        m = 6 if self.design.velocity else 3
        h, r = np.eye(m, p.shape[0]), self.shared.fix_errors.noise[e, :m, :m]
        h[:3, _FIX] = np.eye(3)
        return _updated(p, h, r * self.design.sigma_scale**2)


def _updated(p: np.ndarray, h: np.ndarray, r: np.ndarray) -> np.ndarray:
    """P (N, N) after measurements with rows h (m, N) and covariance r (m, m)."""
    seen = h @ p
    out = p - seen.T @ np.linalg.solve(seen @ h.T + r, seen)
    return 0.5 * (out + out.T)
