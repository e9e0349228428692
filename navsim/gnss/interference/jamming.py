"""Effect of jammers and pseudolites on a flight: remaining C/N0 of each signal, and tracked signals.

Source: `docs/theory/interference.md`, section 7; the physics are those of `gnss.interference.propagation`,
`spectral_separation`, `horizon` and `tracking_threshold`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT, llh_from_ecef
from navsim.gnss.antenna import AircraftAntenna
from navsim.gnss.dll import CodeLoop, antenna_gain
from navsim.gnss.interference.horizon import Terrain, loss_behind
from navsim.gnss.interference.propagation import (
    LOWEST,
    blanked_loss,
    cross_correlation,
    gated_loss,
    horizon_loss,
    jam_to_signal,
    jammed,
    noise_density,
    path_loss,
    ungated_loss,
)
from navsim.gnss.interference.spectral_separation import Band, Modulated, SweptTone, Waveform, bpsk
from navsim.gnss.interference.tracking_threshold import FrequencyLoop, LockRule
from navsim.gnss.sky import enu_matrix

TEMPERATURE = 290.0
"""Noise temperature of a receiver, K, which relates its carrier to noise density ratios to signal power."""
ISOLATION = -cross_correlation(10)
"""By how much a signal exceeds the highest line, dB, that codes of GPS, of ten stages, and pseudolites have of each
other."""
_APART = 1.0
"""Hz; carriers that differ by less are one."""


@dataclass(frozen=True)
class Received:
    """Received signals without jamming."""

    time: np.ndarray
    """(e,) s."""
    antenna: np.ndarray
    """(e, 3) ECEF, m."""
    llh: np.ndarray
    """(e, 3) of the receiver, rad, rad, m."""
    used: np.ndarray
    """(e, s) bool."""
    cn0: np.ndarray
    """(e, s) dB-Hz."""
    chip: np.ndarray
    """(s,) m."""
    carrier: np.ndarray
    """(s,) Hz."""
    ground: np.ndarray
    """(s,) bool, true for pseudolites."""
    c_eb: np.ndarray
    """(e, 3, 3) body axes in ECEF."""


@dataclass(frozen=True)
class Jammer:
    """A jammer."""

    name: str
    place: np.ndarray
    """(3,) ECEF, m."""
    height: float
    """Above the ground, m."""
    eirp: float
    """dBW."""
    waveform: Waveform | SweptTone
    frequency: float
    """Frequency for its propagation, Hz."""
    shadow: float
    """Additional shadowing, dB."""
    on: tuple[tuple[float, float], ...]
    """Times from, to, s; empty: always."""

    def power(self, time: np.ndarray) -> np.ndarray:
        """Transmitted power at times (e,), dBW; -inf while it is off."""
        sending = np.zeros(time.shape, bool)
        for first, last in self.on or ((-np.inf, np.inf),):
            sending |= (time >= first) & (time < last)
        return np.where(sending, self.eirp, -np.inf)

    def sent(self, time: np.ndarray) -> Waveform:
        """Waveform at times (e,), s, over the memory of a receiver."""
        return self.waveform.at(time) if isinstance(self.waveform, SweptTone) else self.waveform


def losses(
    jammers: Sequence[Jammer], antenna: np.ndarray, ground: float, terrain: Terrain
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vectors (j, e, 3) from antennas (e, 3) to jammers, ECEF, m, distances (j, e), m, and losses on the way, dB.

    ground: its height above the ellipsoid, m.
    """
    away = np.stack([jammer.place - antenna for jammer in jammers])
    distance = np.linalg.norm(away, axis=2)
    above = np.maximum(llh_from_ecef(antenna)[:, 2] - ground, LOWEST)
    frequency, height, shadow = (
        np.array([getattr(jammer, name) for jammer in jammers])[:, None] for name in ("frequency", "height", "shadow")
    )
    loss = path_loss(distance, frequency) + horizon_loss(distance, np.maximum(height, LOWEST), above) + shadow
    if terrain:
        hidden = (loss_behind(terrain, j.place, antenna, SPEED_OF_LIGHT / j.frequency) for j in jammers)
        loss = loss + np.stack([*hidden])
    return away, distance, loss


@dataclass(frozen=True)
class LinkJamming:
    """Jammers of links on one carrier between receivers that are not those of satellites."""

    jammers: tuple[Jammer, ...]
    ground: float
    """Height of the ground above the ellipsoid, m."""
    terrain: Callable[[np.ndarray], Terrain]
    """See `sensors.beacons.Beacons`."""
    carrier: float
    """Hz."""
    bandwidth: float
    """Noise bandwidth of the signals, Hz."""
    noise_figure: float
    """Of the receivers, dB."""
    gain: float
    """Of their antennas towards jammers, dBi."""

    def noise(self, time: np.ndarray, antenna: np.ndarray, threshold: np.ndarray) -> np.ndarray:
        """Noise density with jammers over that without (t, m), at times (t,), s, at each of some antennas.

        antenna: (m, 3) at rest, or (t, 1, 3) on the way, ECEF, m. threshold: of the runway (3,), rad, rad, m.
        """
        moving = antenna.ndim == 3
        _, _, loss = losses(self.jammers, antenna.reshape(-1, 3), self.ground, self.terrain(threshold))
        out = np.ones((time.size, 1 if moving else len(antenna)))
        floor = noise_density(TEMPERATURE) + self.noise_figure
        for jammer, lost in zip(self.jammers, loss, strict=True):
            kappa = jammer.sent(time).kappa(bpsk(self.bandwidth), np.array([self.carrier]), None)
            power = jammer.power(time)[:, None] + self.gain - (lost[:, None] if moving else lost)
            out += 10.0 ** ((power - floor) / 10.0) * kappa
        return out


@dataclass(frozen=True)
class Pulses:
    """Pulses of pseudolites that do not overlap."""

    duty: float
    """Fraction of the time in which each transmits."""
    blanking: bool
    """The receiver blanks satellite signals during pulses; otherwise pulses act as noise."""
    gated: bool
    """The receiver correlates with a pseudolite only during its pulses."""

    def loss(self, sending: np.ndarray, ground: np.ndarray) -> np.ndarray:
        """Loss of signals, (e, s) dB, in addition to noise; sending: (e, p) bool; ground: (s,) bool."""
        own = gated_loss(self.duty) if self.gated else ungated_loss(self.duty)
        deaf = blanked_loss(self.duty * sending) if self.blanking else np.zeros(len(sending))
        return np.where(ground, own, deaf[:, None])

    def open_share(self, ground: np.ndarray) -> np.ndarray:
        """Share of the power of another's pulses that the correlators of sources (s,) are open to."""
        return np.where(ground, 0.0 if self.gated else self.duty, 0.0 if self.blanking else self.duty)


@dataclass(frozen=True)
class NearFar:
    """Pseudolites as jammers of satellites, and of each other."""

    pulses: Pulses | None
    """None: continuous transmission."""
    isolation: float | None
    """Margin, dB, by which they may exceed signals of like codes and carrier before code cross-correlation captures
    those; None: unlimited."""

    def js(self, received: Received) -> np.ndarray:
        """Power ratio of pseudolites, or of their pulses, to signals (p, e, s), dB."""
        sent = np.where(received.used, received.cn0, -np.inf)[:, received.ground].T
        out = sent[..., None] - received.cn0
        p = np.arange(len(sent))
        own = out[p, :, np.flatnonzero(received.ground)]
        out[p, :, np.flatnonzero(received.ground)] = np.where(np.isnan(own), np.nan, -np.inf)
        return out

    def weight(self, received: Received) -> np.ndarray:
        """Share of that power that is noise to sources (s,)."""
        return np.ones(received.ground.shape) if self.pulses is None else self.pulses.open_share(received.ground)

    def loss(self, received: Received) -> np.ndarray:
        """Loss of signals in addition to noise (e, s), dB."""
        if self.pulses is None:
            return np.zeros(received.cn0.shape)
        return self.pulses.loss(received.used[:, received.ground], received.ground)

    def buried(self, received: Received, js: np.ndarray) -> np.ndarray:
        """Which signals (e, s) a line of a pseudolite's code exceeds at its worst; js: (p, e, s)."""
        if self.isolation is None or not received.ground.any():
            return np.zeros(received.cn0.shape, bool)
        first = np.argmax(received.ground)
        alike = np.abs(received.carrier - received.carrier[first]) < _APART
        alike &= received.chip == received.chip[first]
        return alike & (js > self.isolation).any(axis=0)


@dataclass(frozen=True)
class Jamming:
    """Jammers, and the receiver's tolerance."""

    jammers: tuple[Jammer, ...]
    lock: LockRule
    code: CodeLoop
    rate: FrequencyLoop
    ground: float
    """Height of the ground above the ellipsoid, m."""
    horizon_db: float
    """Gain of the receiving antenna at the horizon, see `code_loop.antenna_gain`."""
    antenna: AircraftAntenna | None
    """Antenna of the receiver, if a table gives one."""
    noise_figure: float
    """Noise figure of the receiver, dB."""
    pseudolites: NearFar | None
    """Interference by pseudolites; None without."""
    terrain: Terrain
    """What hides jammers."""
    bands: tuple[Band, ...]
    """Pass bands of the front end, one for each carrier; empty: everything passes."""

    def js(self, received: Received) -> np.ndarray:
        """Jammer to signal power ratio (j, e, s), dB, of jammers, then of pseudolites if they jam.

        -inf without power from the jammer, nan without signal.
        """
        parts = [self._of_jammers(received)]
        if self.pseudolites is not None:
            parts.append(self.pseudolites.js(received))
        return np.concatenate(parts)

    def _of_jammers(self, received: Received) -> np.ndarray:
        antenna, cn0 = received.antenna, received.cn0
        if not self.jammers:
            return np.empty((0, *cn0.shape))
        away, distance, loss = losses(self.jammers, antenna, self.ground, self.terrain)
        up = np.einsum("ei,jei->je", enu_matrix(received.llh)[:, 2], away) / distance
        power = np.stack([jammer.power(received.time) for jammer in self.jammers])
        if self.antenna is None:
            gain = antenna_gain(np.arcsin(up), self.horizon_db)
        else:
            towards = np.moveaxis(away / distance[..., None], 0, 1)
            gain = self.antenna.gain_at(self.antenna.elevation_of(received.c_eb, towards)).T
        # the carrier to noise density ratio gives the signal's strength, including the antenna's gain
        noise = noise_density(TEMPERATURE) + self.noise_figure
        return jam_to_signal(power, loss, gain, np.zeros(cn0.shape[1]), cn0 + noise)

    def passed(self, carrier: np.ndarray) -> np.ndarray:
        """Whether the front end passes carriers (s,), Hz."""
        inside = [(carrier >= band.low) & (carrier <= band.high) for band in self.bands]
        return np.any(inside, axis=0) if inside else np.ones(carrier.shape, bool)

    def kappas(self, received: Received) -> np.ndarray:
        """Spectral separation coefficients, 1/Hz, for the powers of `js`, (j, e, s), or (j, 1, s) if constant.

        0 for sources that the front end does not pass.
        """
        carrier, rate = received.carrier, SPEED_OF_LIGHT / received.chip
        sent = [jammer.sent(received.time) for jammer in self.jammers]
        own = None
        if self.pseudolites is not None and received.ground.any():
            first = np.argmax(received.ground)
            own = Modulated(bpsk(float(rate[first])), float(carrier[first]))
            sent.append(own)
        changing = any(isinstance(jammer.waveform, SweptTone) for jammer in self.jammers)
        out = np.zeros((len(sent), received.time.size if changing else 1, carrier.size))
        for band in self.bands or (None,):
            inside = np.ones(carrier.shape, bool) if band is None else (carrier >= band.low) & (carrier <= band.high)
            for of_system in np.unique(rate[inside]):
                some = inside & (rate == of_system)
                for j, waveform in enumerate(sent):
                    out[j][:, some] = waveform.kappa(bpsk(float(of_system)), carrier[some], band)
        if self.pseudolites is None or own is None:
            return out
        # pseudolites have one spectrum
        ours = np.broadcast_to(out[-1] * self.pseudolites.weight(received), (np.sum(received.ground), *out[-1].shape))
        return np.concatenate([out[:-1], ours])

    def effective_cn0(self, received: Received, js: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Effective carrier to noise density (e, s), dB-Hz, and which signals are passed and held (e, s) bool."""
        effective = jammed(received.cn0, js, self.kappas(received))
        tracked = effective
        if self.pseudolites is not None:
            effective = effective - self.pseudolites.loss(received)
            buried = self.pseudolites.buried(received, js[len(self.jammers) :])
            tracked = np.where(buried, -np.inf, effective)
        return effective, self.lock.held(received.time, tracked) & self.passed(received.carrier)

    def noise(self, received: Received, effective: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Additional loop noise as variances (e, s) of ranges, m2, and range rates, (m/s)2."""
        cn0, wavelength = received.cn0, SPEED_OF_LIGHT / received.carrier
        return (
            self.code.sigma(effective, received.chip) ** 2 - self.code.sigma(cn0, received.chip) ** 2,
            self.rate.sigma(effective, wavelength) ** 2 - self.rate.sigma(cn0, wavelength) ** 2,
        )
