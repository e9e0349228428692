"""Jammers beside a flight: what the receiver has left of each signal, and which it holds.

Source: `docs/theory/interference.md`, section 7; the physics are those of `models.interference`, `spectra` and `lock`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.core.arrays.earth import SPEED_OF_LIGHT, llh_from_ecef
from navsim.models.code_loop import CodeLoop, antenna_gain
from navsim.models.interference import horizon_loss, jam_to_signal, jammed, noise_density, path_loss
from navsim.models.lock import FrequencyLoop, LockRule
from navsim.models.sky import enu_matrix
from navsim.models.spectra import Waveform, bpsk

LOWEST = 1.0
"""Height over the ground, m, that antennas have at least for the radio horizon: on the ground there would be none."""
TEMPERATURE = 290.0
"""Of a receiver, K: what its carrier to noise density ratios tell the power of signals by."""


@dataclass(frozen=True)
class Jammer:
    """place: (3,) ECEF, m. height: over the ground, m. eirp: dBW. frequency: that its way is told by, Hz. shadow: what
    hides it, dB. on: from, to, s; always where there are none."""

    name: str
    place: np.ndarray
    height: float
    eirp: float
    waveform: Waveform
    frequency: float
    shadow: float
    on: tuple[tuple[float, float], ...]

    def power(self, time: np.ndarray) -> np.ndarray:
        """What it sends at times (e,), dBW; -inf while it is off."""
        sending = np.zeros(time.shape, bool)
        for first, last in self.on or ((-np.inf, np.inf),):
            sending |= (time >= first) & (time < last)
        return np.where(sending, self.eirp, -np.inf)


@dataclass(frozen=True)
class Jamming:
    """All jammers, how the receiver holds signals against them, the height of the ground over the ellipsoid, m, and the
    gain of its antenna at the horizon, see `code_loop.antenna_gain`."""

    jammers: tuple[Jammer, ...]
    lock: LockRule
    code: CodeLoop
    rate: FrequencyLoop
    ground: float
    horizon_db: float

    def js(self, time: np.ndarray, antenna: np.ndarray, llh: np.ndarray, cn0: np.ndarray) -> np.ndarray:
        """Power of the jammers by that of signals (j, e, s), dB, at times (e,), s, at antennas (e, 3) ECEF and
        llh, of signals with cn0 (e, s) alone, dB-Hz."""
        away = np.stack([jammer.place - antenna for jammer in self.jammers])
        distance = np.linalg.norm(away, axis=2)
        up = np.einsum("ei,jei->je", enu_matrix(llh)[:, 2], away) / distance
        above = np.maximum(llh_from_ecef(antenna)[:, 2] - self.ground, LOWEST)
        frequency, height, shadow = (
            np.array([getattr(jammer, name) for jammer in self.jammers])[:, None]
            for name in ("frequency", "height", "shadow")
        )
        loss = path_loss(distance, frequency) + horizon_loss(distance, np.maximum(height, LOWEST), above) + shadow
        power = np.stack([jammer.power(time) for jammer in self.jammers])
        gain = antenna_gain(np.arcsin(up), self.horizon_db)
        # a signal's carrier to noise density ratio says how strong it is, the antenna's gain included
        return jam_to_signal(power, loss, gain, np.zeros(cn0.shape[1]), cn0 + noise_density(TEMPERATURE))

    def kappas(self, chip: np.ndarray, carrier: np.ndarray) -> np.ndarray:
        """Spectral separations (j, s), 1/Hz, of sources with chips (s,) m long on carriers (s,), Hz."""
        rate = SPEED_OF_LIGHT / chip
        out = np.empty((len(self.jammers), chip.size))
        for of_system in np.unique(rate):
            some = rate == of_system
            for j, jammer in enumerate(self.jammers):
                out[j, some] = jammer.waveform.kappa(bpsk(float(of_system)), carrier[some], None)
        return out

    def left(
        self, time: np.ndarray, js: np.ndarray, cn0: np.ndarray, chip: np.ndarray, carrier: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Effective carrier to noise density (e, s), dB-Hz, and which signals are held (e, s) bool."""
        effective = jammed(cn0, js, self.kappas(chip, carrier))
        return effective, self.lock.held(time, effective)

    def noise(
        self, cn0: np.ndarray, effective: np.ndarray, chip: np.ndarray, carrier: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the loops have more of noise, as variances (e, s) of ranges, m2, and range rates, (m/s)2."""
        wavelength = SPEED_OF_LIGHT / carrier
        return (
            self.code.sigma(effective, chip) ** 2 - self.code.sigma(cn0, chip) ** 2,
            self.rate.sigma(effective, wavelength) ** 2 - self.rate.sigma(cn0, wavelength) ** 2,
        )
