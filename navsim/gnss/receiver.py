"""The satellite receiver as a clock and a source of fixes; how it positions is `gnss.position_fix`.

Source of the clock's noise: `gnss.clock_noise`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT
from navsim.gnss.clock_noise import step_covariance
from navsim.gnss.fix_states import FixStates


def epochs(duration: float, rate: float) -> np.ndarray:
    """Times k / rate, k = 1, 2, ... up to the duration, s."""
    return np.arange(1, int(np.floor(duration * rate + 1e-9)) + 1) / rate


@dataclass(frozen=True)
class Receiver:
    """Rate, latency and clock of a receiver."""

    rate: float
    """Rate of fixes, Hz."""
    latency: float
    """From the validity of a fix to its output, s."""
    clock_offset: float
    """s."""
    clock_drift: float
    """s/s."""
    clock_density: tuple[float, float] = (0.0, 0.0)
    """Noise densities of the clock's phase, m2/s, and frequency, m2/s3."""
    states: FixStates | None = None
    """States of its fixes; None: fixes follow from the ranges."""

    def epochs(self, duration: float, imu_rate: float) -> np.ndarray:
        """Times of the fixes before the last sample of an IMU of this rate (Hz), s (e,)."""
        last = np.floor(duration * imu_rate + 1e-9) / imu_rate
        time = epochs(duration, self.rate)
        return time[time + self.latency <= last + 1e-9]

    def clock(self, time: np.ndarray) -> np.ndarray:
        """Offset, m, and drift, m/s, of its clock at times (e,): (e, 2)."""
        drift = np.full_like(time, self.clock_drift)
        return SPEED_OF_LIGHT * np.stack([self.clock_offset + self.clock_drift * time, drift], axis=1)


def wander(density: tuple[float, float], time: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Offset, m, and drift, m/s, of a clock (t, 2) due to noises of these densities, from zero at time 0.

    time: (t,) increasing, s.
    """
    bias, both, drift = step_covariance(np.array(density), np.diff(time, prepend=0.0))
    white = random.standard_normal((2, time.size))
    root = np.sqrt(drift)
    share = np.divide(both, root, out=np.zeros_like(root), where=root > 0.0)
    faster = np.cumsum(root * white[0])
    longer = share * white[0] + np.sqrt(bias - share**2) * white[1]
    longer[1:] += faster[:-1] * np.diff(time)
    return np.stack([np.cumsum(longer), faster], axis=1)
