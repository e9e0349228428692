"""Overlapping Allan deviation of a static record, and the noise terms of its spectrum.

The deviation is a picture. The terms come from the record's spectrum, whose values at different frequencies are
independent; those of a deviation are not, so that a fit to it has no honest intervals. The two-sided spectrum is

    S(f) = N^2 + B^2 / (2 pi f) + K^2 / (2 pi f)^2

with white noise N, flicker noise (bias instability) B and random walk of the rate K [1]. Its Allan variance is
N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3.

Sources: [1] IEEE Std 952-1997, annex C. [2] Percival & Walden (1993), Spectral Analysis for Physical Applications,
sections 6.4 (tapers) and 8.2 (likelihood of a spectrum).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, nnls

FLAT = 2.0 * math.log(2.0) / math.pi
"""Allan variance of flicker noise, in B^2."""
TERMS = ("white", "flicker", "walk")
_LOWEST_BIN = 3
"""First bin of the tapered spectrum that the mean, which is subtracted, does not touch."""
_SLOWEST_SHARE = 20.0
"""The fit ends at the sample rate over this: above it filters and quanta of the sensor shape the spectrum."""
_TAPER_VARIANCE = 1.94
"""Variance of means over neighbouring bins with a Hann taper, in that of independent ones [2]."""
_BINS_A_DECADE = 60
_SIGNIFICANT = 6.635
"""Twice the logarithm of the likelihood that a term must gain to be there: chance 1 %."""
_INTERVAL = 3.841
"""The same at the ends of an interval of 95 %."""
LONGEST_SHARE = 10.0
"""The longest cluster time is the record's length over this."""


def overlapping_deviation(rate: np.ndarray, step: float, counts: np.ndarray) -> np.ndarray:
    """Overlapping Allan deviation (k, a) of rates (n, a) at a sample interval, over `counts` (k,) of samples [1]."""
    angle = step * np.concatenate([np.zeros((1, rate.shape[1])), np.cumsum(rate, axis=0)])
    out = np.empty((counts.size, rate.shape[1]))
    for row, m in enumerate(counts):
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        out[row] = np.sqrt(0.5 * np.mean(second**2, axis=0)) / (m * step)
    return out


def cluster_counts(samples: int) -> np.ndarray:
    """Numbers of samples of clusters, ten a decade, up to the record over `LONGEST_SHARE`."""
    decades = math.log10(samples / LONGEST_SHARE)
    return np.unique(np.round(np.logspace(0.0, decades, int(10 * decades) + 1)).astype(int))


@dataclass(frozen=True)
class RecordSpectrum:
    """Mean spectrum (k,) in bands of frequencies (k,) Hz, and the number of independent values in each (k,)."""

    frequency: np.ndarray
    power: np.ndarray
    weight: np.ndarray


def spectra(rate: np.ndarray, step: float) -> list[RecordSpectrum]:
    """Spectra of the columns of rates (n, a), with a Hann taper, and last of their mean square."""
    count = rate.shape[0]
    taper = np.hanning(count + 2)[1:-1]
    centred = rate - (taper @ rate) / taper.sum()
    power = step / np.sum(taper**2) * np.abs(np.fft.rfft(taper[:, None] * centred, axis=0)) ** 2
    last = max(int(count / _SLOWEST_SHARE), _LOWEST_BIN + 10)
    bins = np.arange(_LOWEST_BIN, min(last, power.shape[0] - 1))
    band = np.floor(_BINS_A_DECADE * np.log10(bins)).astype(int)
    _, place, size = np.unique(band, return_inverse=True, return_counts=True)
    frequency = np.bincount(place, bins) / size / (count * step)
    means = [np.bincount(place, power[bins, axis]) / size for axis in range(rate.shape[1])]
    weight = size / _TAPER_VARIANCE
    return [*(RecordSpectrum(frequency, each, weight) for each in means),
            RecordSpectrum(frequency, np.mean(means, axis=0), rate.shape[1] * weight)]  # fmt: skip


@dataclass(frozen=True)
class Term:
    """Size of a term and its interval of 95 %; held: the record shows that it is there."""

    value: float
    low: float
    high: float
    held: bool


@dataclass(frozen=True)
class NoiseFit:
    """Terms of a spectrum, each in SI units to the power of its own definition."""

    white: Term
    flicker: Term
    walk: Term
    ambiguous: bool
    """The record shows flicker noise or a random walk, and cannot tell which."""

    def variance(self, tau: np.ndarray) -> np.ndarray:
        """Allan variance of the terms that the record shows."""
        n, b, k = (term.value if term.held else 0.0 for term in (self.white, self.flicker, self.walk))
        return np.asarray(n**2 / tau + FLAT * b**2 + k**2 * tau / 3.0)

    @property
    def corner(self) -> float:
        """Cluster time, s, at which white noise falls to the flicker noise; infinite without any."""
        return (self.white.value / self.flicker.value) ** 2 / FLAT if self.flicker.value else math.inf


def fit(spectrum: RecordSpectrum) -> NoiseFit:
    """Terms of greatest likelihood [2], none negative, with intervals by the likelihood."""
    omega = 2.0 * np.pi * spectrum.frequency
    shapes = np.stack([np.ones_like(omega), 1.0 / omega, 1.0 / omega**2], axis=1)
    scale = shapes.max(axis=0) / spectrum.power.mean()
    shapes = shapes / scale
    power, weight = spectrum.power, spectrum.weight

    def best(fixed: int | None = None, value: float = 0.0) -> tuple[float, np.ndarray]:
        """Twice the log-likelihood at its maximum, where one term may be fixed, and the terms."""
        free = [i for i in range(3) if i != fixed]
        model = np.maximum(power, power.mean() * 1e-12)
        theta = np.zeros(3)
        base = value * shapes[:, fixed] if fixed is not None else np.zeros_like(power)
        for _ in range(60):
            root = np.sqrt(weight) / model
            found, _ = nnls(shapes[:, free] * root[:, None], (power - base) * root)
            before = theta.copy()
            theta[free] = found
            if fixed is not None:
                theta[fixed] = value
            model = np.maximum(shapes @ theta, power.mean() * 1e-9)
            if np.all(np.abs(theta - before) <= 1e-7 * np.abs(theta).max()):
                break
        return -2.0 * float(np.sum(weight * (np.log(model) + power / model))), theta

    top, theta = best()
    gain = [top - best(i)[0] for i in range(3)]
    terms = []
    for i in range(3):

        def short(value: float, i: int = i) -> float:
            return top - best(i, value)[0] - _INTERVAL

        low = brentq(short, 0.0, theta[i], rtol=1e-3) if gain[i] > _INTERVAL else 0.0
        high = max(2.0 * theta[i], 1e-6 * float(theta.max()))
        while short(high) < 0.0:
            high *= 2.0
        high = brentq(short, max(theta[i], 1e-12 * high), high, rtol=1e-3)
        value, low, high = (math.sqrt(x / scale[i]) for x in (theta[i], low, high))
        terms.append(Term(value, low, high, gain[i] > _SIGNIFICANT))
    white, flicker, walk = terms
    alone = _white_alone(spectrum)
    ambiguous = not flicker.held and not walk.held and top - alone > _SIGNIFICANT
    return NoiseFit(white, flicker, walk, ambiguous)


def _white_alone(spectrum: RecordSpectrum) -> float:
    """Twice the log-likelihood of white noise alone."""
    level = float(np.average(spectrum.power, weights=spectrum.weight))
    return -2.0 * float(np.sum(spectrum.weight * (math.log(level) + spectrum.power / level)))
