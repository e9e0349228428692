"""Spectra of signals and of jammers, and how much of a jammer's power the correlator of a signal takes in.

Spectra are of infinite bandwidth and unit area. Pages: `docs/theory/interference.md`, section 2.

Sources: [1] Betz, Effect of Partial-Band Interference on Receiver Estimation of C/N0, ION NTM (2001) (spectral
separation). [2] Betz, Binary Offset Carrier Modulations for Radionavigation, NAVIGATION 48(4) (2001) (spectra).
[3] Kaplan & Hegarty, Understanding GPS/GNSS, 3rd ed. (2017), chapter 9 (Q factors of interference).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

_NODES = 12
"""Gauss-Legendre nodes in a panel over which the phase of the fastest term changes by 2 pi: 1e-13 of the integral."""


@dataclass(frozen=True)
class Spectrum:
    """Power of a signal by the offset f from its carrier: the sum of weight / rate sinc^2(f / rate) over parts (weight,
    rate in 1/s), weights adding up to 1."""

    parts: tuple[tuple[float, float], ...]

    def density(self, offset: np.ndarray) -> np.ndarray:
        """Share of the power in a Hz, 1/Hz, at offsets from the carrier, Hz, of any shape."""
        return np.sum([weight * np.sinc(offset / rate) ** 2 / rate for weight, rate in self.parts], axis=0)

    def below(self, offset: np.ndarray) -> np.ndarray:
        """Share of the power below finite offsets from the carrier, Hz, of any shape."""
        from scipy.special import sici

        x = [np.pi * np.asarray(offset) / rate for _, rate in self.parts]
        shares = [sici(2.0 * u)[0] / np.pi - u / np.pi * np.sinc(u / np.pi) ** 2 for u in x]
        return 0.5 + np.sum([weight * share for (weight, _), share in zip(self.parts, shares, strict=True)], axis=0)

    @property
    def memory(self) -> float:
        """Length of its slowest chip, s: beyond it the code does not correlate with itself."""
        return max(1.0 / rate for _, rate in self.parts)


def bpsk(rate: float) -> Spectrum:
    """Binary phase shift keying by rectangular chips, rate in 1/s [2]."""
    return Spectrum(((1.0, rate),))


def separation(one: Spectrum, other: Spectrum, offset: np.ndarray) -> np.ndarray:
    """Integral of the product of two spectra with carriers `offset` apart, Hz, of any shape; 1/Hz [1].

    Exact: the transform of the product of two triangles, the codes' correlations with themselves.
    """
    total = np.zeros(np.shape(offset))
    for weight, rate in one.parts:
        for times, against in other.parts:
            fast, share = max(rate, against), min(rate, against) / max(rate, against)
            turned = 2.0 * np.pi * offset / fast
            total += weight * times / fast * ((1.0 - share) * np.sinc(offset / fast) ** 2 + 4.0 * share * _bow(turned))
    return total


def _bow(x: np.ndarray) -> np.ndarray:
    """(x - sin x) / x^3, by its series where x is small."""
    small = np.abs(x) < 1.0
    square, far = np.where(small, x, 0.0) ** 2, np.where(small, 1.0, x)
    series = np.zeros_like(square)
    for k in range(8, -1, -1):
        series = 1.0 / math.factorial(2 * k + 3) - square * series
    return np.where(small, series, (far - np.sin(far)) / far**3)


@dataclass(frozen=True)
class Band:
    """Pass band of a receiver's front end, low to high, Hz."""

    low: float
    high: float


class Waveform(Protocol):
    """Power spectrum of a jammer."""

    def kappa(self, signal: Spectrum, carrier: np.ndarray, band: Band | None) -> np.ndarray:
        """Spectral separation, 1/Hz (s,), from signals of one spectrum on carriers (s,), Hz, in the band of the front
        end, or in all there is: J/S times it is noise density by signal power. (e, s) where it changes with time."""


@dataclass(frozen=True)
class Tone:
    """All power at one frequency, Hz."""

    frequency: float

    def kappa(self, signal: Spectrum, carrier: np.ndarray, band: Band | None) -> np.ndarray:
        passed = band is None or band.low <= self.frequency <= band.high
        return float(passed) * signal.density(self.frequency - carrier)


@dataclass(frozen=True)
class Flat:
    """Power spread evenly over a width about a centre, Hz: white noise, or a fast sweep.

    A sweep counts as flat if it passes a signal's carrier more than once within a receiver's integration time.
    """

    centre: float
    width: float

    def kappa(self, signal: Spectrum, carrier: np.ndarray, band: Band | None) -> np.ndarray:
        low, high = self.centre - 0.5 * self.width, self.centre + 0.5 * self.width
        return _between(signal, carrier, band, np.array(low), np.array(high)) / self.width


def _between(signal: Spectrum, carrier: np.ndarray, band: Band | None, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Fraction of the power of signals on carriers (s,) from low to high, Hz, within the band; shapes are broadcast."""
    if band is not None:
        low, high = np.clip(low, band.low, band.high), np.clip(high, band.low, band.high)
    return signal.below(high - carrier) - signal.below(low - carrier)


@dataclass(frozen=True)
class SweptTone:
    """A tone that sweeps a width about a centre, Hz, upwards from time 0, and starts again after each period."""

    centre: float
    width: float
    period: float
    """s."""
    memory: float
    """Time over which a receiver averages the noise, s."""

    def at(self, time: np.ndarray) -> Waveform:
        """Spectrum over the memory before times (e,), s."""
        return _Passage(self, time)


@dataclass(frozen=True)
class _Passage:
    """A sweep by the memory before times (e,), s."""

    sweep: SweptTone
    time: np.ndarray

    def kappa(self, signal: Spectrum, carrier: np.ndarray, band: Band | None) -> np.ndarray:
        low, width = self.sweep.centre - 0.5 * self.sweep.width, self.sweep.width

        def passed(time: np.ndarray) -> np.ndarray:
            """Integral up to a time, in periods (e,): whole sweeps and part of the last one."""
            whole = np.floor(time)[:, None]
            upper = low + width * (time[:, None] - whole)
            bottom, top = np.array(low), np.array(low + width)
            return whole * _between(signal, carrier, band, bottom, top) + _between(signal, carrier, band, bottom, upper)

        first, last = (self.time - self.sweep.memory) / self.sweep.period, self.time / self.sweep.period
        return (passed(last) - passed(first)) / (last - first)[:, None] / width


@dataclass(frozen=True)
class Modulated:
    """A spectrum about a centre, Hz: a signal like those that it jams, or a pseudolite."""

    spectrum: Spectrum
    centre: float

    def kappa(self, signal: Spectrum, carrier: np.ndarray, band: Band | None) -> np.ndarray:
        if band is None:
            return separation(signal, self.spectrum, self.centre - carrier)
        # the product of the spectra has no terms faster than both memories together
        panels = math.ceil((band.high - band.low) * (signal.memory + self.spectrum.memory))
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        step = (band.high - band.low) / panels
        at = band.low + step * (np.arange(panels)[:, None] + 0.5 * (nodes + 1.0)).ravel()
        product = signal.density(at - np.asarray(carrier)[..., None]) * self.spectrum.density(at - self.centre)
        return product @ np.tile(0.5 * step * weights, panels)
