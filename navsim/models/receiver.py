"""The satellite receiver as a clock and a source of fixes; how it positions is `estimation.receiver`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.core.arrays.earth import SPEED_OF_LIGHT


def epochs(duration: float, rate: float) -> np.ndarray:
    """Times k / rate, k = 1, 2, ... up to the duration, s."""
    return np.arange(1, int(np.floor(duration * rate + 1e-9)) + 1) / rate


@dataclass(frozen=True)
class Receiver:
    """rate: of fixes, Hz. latency: from the time a fix is valid to the time it is given out, s. clock_offset: s,
    clock_drift: s/s."""

    rate: float
    latency: float
    clock_offset: float
    clock_drift: float

    def epochs(self, duration: float, imu_rate: float) -> np.ndarray:
        """Times of the fixes that come before the last sample of an IMU of this rate (Hz), s (e,)."""
        last = np.floor(duration * imu_rate + 1e-9) / imu_rate
        time = epochs(duration, self.rate)
        return time[time + self.latency <= last + 1e-9]

    def clock(self, time: np.ndarray) -> np.ndarray:
        """Offset, m, and drift, m/s, of its clock at times (e,): (e, 2)."""
        drift = np.full_like(time, self.clock_drift)
        return SPEED_OF_LIGHT * np.stack([self.clock_offset + self.clock_drift * time, drift], axis=1)
