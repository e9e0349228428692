"""Clocks of pseudolites that wander: each two states, offset and rate, driven by white noises of phase and frequency.

Every pseudolite has its own. They begin without error some time before the flight, where calibration left them.

Source: `gnss.clock_noise`; `docs/theory/signals.md`, section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.gnss.clock_noise import step_covariance
from navsim.gnss.receiver import wander


@dataclass(frozen=True)
class WanderingClocks:
    """density: of the noises of phase, m2/s, and frequency, m2/s3. age: how long before time 0 they were set, s. which:
    (s,) bool, the sources that have such a clock."""

    density: tuple[float, float]
    age: float
    which: np.ndarray

    def select(self, kept: np.ndarray) -> WanderingClocks:
        """Clocks of the sources marked in `kept` (s,) bool."""
        return replace(self, which=self.which[kept])

    def sigmas(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma of ranges, m, and of range rates, m/s, at times (e,), s, of all sources (e, s)."""
        bias, _, drift = step_covariance(np.array(self.density), time + self.age)
        ranges, rates = (np.sqrt(variance)[:, None] * self.which for variance in (bias, drift))
        return ranges, rates

    def drawn(self, time: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """Additions to ranges, m, and range rates, m/s, at times (e,), s, of all sources (2, e, s, W); a run for each
        generator."""
        out = np.zeros((2, time.size, self.which.size, len(rngs)))
        for lane, rng in enumerate(rngs):
            for i in np.flatnonzero(self.which):
                out[:, :, i, lane] = wander(self.density, time + self.age, rng).T
        return out

    def steps(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition and noise covariance of offset and rate from epoch to epoch (e,), s, (e, 2, 2) each.

        The first step begins when the clocks were set.
        """
        dt = np.diff(time + self.age, prepend=0.0)
        bias, both, drift = step_covariance(np.array(self.density), dt)
        transition = np.broadcast_to(np.eye(2), (dt.size, 2, 2)).copy()
        transition[:, 0, 1] = dt
        return transition, np.moveaxis(np.array([[bias, both], [both, drift]]), 2, 0)
