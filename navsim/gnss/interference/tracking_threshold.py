"""Tracking of weak signals: frequency loop noise, loop thresholds, loss and reacquisition of lock.

Pages: `docs/theory/interference.md`, sections 4, 5.

Sources: [1] Kaplan & Hegarty, Understanding GPS/GNSS, 3rd ed. (2017), section 8.9 (thermal noise and thresholds of
loops).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_ROUNDING = 1e-9
"""Tolerance of times, s, so that rounding does not decide which epoch ends a wait."""


@dataclass(frozen=True)
class FrequencyLoop:
    """bandwidth: one-sided, Hz; integration: s; factor: 1, near the threshold 2 [1]."""

    bandwidth: float
    integration: float
    factor: float

    def sigma(self, cn0: np.ndarray, wavelength: np.ndarray | float) -> np.ndarray:
        """1 sigma of the thermal noise of a range rate, m/s, at a carrier to noise density ratio (dB-Hz) [1].

        wavelength: of the carrier, m, of the shape of cn0, or to be broadcast to it.
        """
        ratio = 10.0 ** (np.asarray(cn0) / 10.0)
        squaring = 1.0 + 1.0 / (self.integration * ratio)
        turns = np.sqrt(4.0 * self.factor * self.bandwidth / ratio * squaring)
        return wavelength / (2.0 * np.pi * self.integration) * turns


@dataclass(frozen=True)
class LockRule:
    """lose: dB-Hz, below which a signal is lost after lose_s, s; regain: dB-Hz, above which it is back after
    regain_s."""

    lose: float = 28.0
    lose_s: float = 0.5
    regain: float = 31.0
    regain_s: float = 2.0

    def held(self, time: np.ndarray, cn0: np.ndarray) -> np.ndarray:
        """Tracked signals, bool (e, s), at increasing times (e,), s, from their carrier to noise density (e, s), dB-Hz.

        nan means no signal, which is below any threshold. A wait lasts from the first epoch below `lose`, or above
        `regain`. At the first epoch all signals not below `lose` are tracked.
        """
        weak, strong = ~(cn0 >= self.lose), cn0 > self.regain
        out = np.empty(cn0.shape, bool)
        held = ~weak[:1].all(axis=0)
        since = np.full(held.shape, np.inf)
        for e in range(time.size):
            turning = np.where(held, weak[e], strong[e])
            since = np.where(turning, np.minimum(since, time[e]), np.inf)
            turned = time[e] - since >= np.where(held, self.lose_s, self.regain_s) - _ROUNDING
            held, since = held ^ turned, np.where(turned, np.inf, since)
            out[e] = held
        return out
