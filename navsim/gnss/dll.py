"""Code loop of a receiver: errors due to signal strength and to a reflection.

Sources:

- [1] Kaplan & Hegarty, Understanding GPS/GNSS, 3rd ed. (2017), section 8.9.2 (thermal noise of a non-coherent
  early-late loop).
- [2] Misra & Enge, Global Positioning System (2006), section 10.5 (code error of a reflection, from the early-late
  discriminator).
- [3] ITU-R P.527 (permittivity and conductivity of ground); Balanis, Advanced Engineering Electromagnetics (2012),
  section 5.3 (Fresnel's coefficients).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT
from navsim.gnss.constellations.systems import System

_ROUNDING = 1e-6
"""Tolerance of a number of epochs, so that the times of further epochs do not change the rounding of half an epoch."""


def chip_length(system: System) -> float:
    """Length of a chip of a system's ranging code, m."""
    return SPEED_OF_LIGHT / system.chip_rate


@dataclass(frozen=True)
class CodeLoop:
    """spacing: early to late, chips (0 to 1); bandwidth: one-sided, Hz; integration: s."""

    spacing: float
    bandwidth: float
    integration: float

    def sigma(self, cn0: np.ndarray, chip: np.ndarray | float) -> np.ndarray:
        """1 sigma of the thermal noise of a pseudorange, m, at a carrier to noise density ratio (dB-Hz) [1]."""
        ratio = 10.0 ** (np.asarray(cn0) / 10.0)
        squaring = 1.0 + 2.0 / (self.integration * (2.0 - self.spacing) * ratio)
        return chip * np.sqrt(self.bandwidth * self.spacing / (2.0 * ratio) * squaring)


def antenna_gain(elevation: np.ndarray, horizon_db: float) -> np.ndarray:
    """Gain relative to the zenith, dB: falls with the sine of the elevation to `horizon_db` at the horizon, and on to
    twice that at the nadir."""
    return horizon_db * (1.0 - np.sin(elevation))


Polarisation = Literal["circular", "vertical", "horizontal"]
"""Polarisation of a wave that the ground reflects."""
DEEPEST = -40.0
"""Largest depth of a fade, dB. If reflection cancels the direct wave, a ground wave remains, which the model omits."""


_PHASES = 16
"""Phases that the mean and the spread of a reflection's error are taken over."""


@dataclass(frozen=True)
class GroundReflection:
    """Ground that reflects the signal of a nearby transmitter."""

    height: float
    """Above the ellipsoid, m."""
    permittivity: float
    """Relative."""
    conductivity: float
    """S/m."""
    horizon_db: float
    """Gain of the receiving antenna at its horizon, see `antenna_gain`."""
    polarisation: Polarisation = "circular"
    """Polarisation of transmitter and receiver."""


def fresnel(
    permittivity: float, conductivity: float, wavelength: float, grazing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of reflection by ground, vertical and horizontal, complex [3].

    permittivity: relative. conductivity: S/m. wavelength: m. grazing: angle over the ground, rad.
    """
    epsilon = permittivity - 60j * wavelength * conductivity
    sin, root = np.sin(grazing), np.sqrt(epsilon - np.cos(grazing) ** 2)
    return (epsilon * sin - root) / (epsilon * sin + root), (sin - root) / (sin + root)


def reflection(
    ground: GroundReflection, frequency: float, above: np.ndarray, transmitter_above: float, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ground-reflected ray relative to the direct one: amplitude ratio, excess length m, phase rad.

    frequency: Hz. above: heights of the receiver over the ground, transmitter_above: of the transmitter, across: their
    horizontal distance, m. Flat ground. With circular polarisation the part of the reflected wave of the same sense is
    received, half the sum of both Fresnel coefficients [3].
    """
    low, high = np.maximum(transmitter_above, 0.0), np.maximum(above, 0.0)
    direct, bounced = np.hypot(across, high - low), np.hypot(across, high + low)
    grazing = np.arctan2(high + low, across)
    wavelength = SPEED_OF_LIGHT / frequency
    vertical, horizontal = fresnel(ground.permittivity, ground.conductivity, wavelength, grazing)
    if ground.polarisation == "circular":
        coefficient = 0.5 * (vertical + horizontal)
    else:
        coefficient = vertical if ground.polarisation == "vertical" else horizontal
    below = np.arctan2(high - low, across)
    gain = antenna_gain(-grazing, ground.horizon_db) - antenna_gain(-below, ground.horizon_db)
    amplitude = np.abs(coefficient) * 10.0 ** (gain / 20.0) * direct / bounced
    excess = bounced - direct
    return amplitude, excess, (np.angle(coefficient) - 2.0 * np.pi * excess / wavelength) % (2.0 * np.pi)


def fade(amplitude: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """By how much a reflection makes a signal stronger, dB, no less than `DEEPEST`; amplitude, phase (rad): as of
    `reflection`."""
    field = np.abs(1.0 + amplitude * np.exp(1j * phase))
    return np.asarray(20.0 * np.log10(np.maximum(field, 10.0 ** (DEEPEST / 20.0))))


def multipath_error(
    spacing: float, chip: float, amplitude: np.ndarray, excess: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """Error of a pseudorange by one reflection, m: where the early-late discriminator of both rays is zero [2].

    spacing: chips. amplitude: relative, below 1. excess: m. phase: rad. Infinite bandwidth; by bisection, to 1e-6 m.
    """
    half, delay = 0.5 * spacing, np.asarray(excess) / chip
    mixed = np.asarray(amplitude) * np.cos(phase)

    def discriminator(error: np.ndarray) -> np.ndarray:
        direct = _triangle(error - half) - _triangle(error + half)
        reflected = _triangle(error - half - delay) - _triangle(error + half - delay)
        return direct + mixed * reflected

    # with amplitude below 1 the zero lies within half a spacing of the direct ray's
    low, high = np.full_like(delay, -half), np.full_like(delay, half)
    for _ in range(40):
        middle = 0.5 * (low + high)
        rising = discriminator(middle) < 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    return 0.5 * chip * (low + high)


@dataclass(frozen=True)
class ReflectionErrors:
    """Statistics of reflection errors if the geometry is known to metres, not to a wavelength; 0 for sources
    without."""

    mean: np.ndarray
    """(e, s) over all phases, m."""
    sigma: np.ndarray
    """(e, s) over all phases, m."""
    time: np.ndarray
    """(e, s) correlation time of the deviation from the mean, s: the inverse of the phase rate."""

    def at(self, epochs: np.ndarray) -> ReflectionErrors:
        """At the epochs with these numbers (m,) int."""
        return ReflectionErrors(self.mean[epochs], self.sigma[epochs], self.time[epochs])

    def select(self, kept: np.ndarray) -> ReflectionErrors:
        """Errors of the sources marked in `kept` (s,) bool."""
        return ReflectionErrors(self.mean[:, kept], self.sigma[:, kept], self.time[:, kept])


def over_phases(
    spacing: float, chip: float, amplitude: np.ndarray, excess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of `multipath_error` over all phases (e,), m."""
    phases = np.linspace(0.0, 2.0 * np.pi, _PHASES, endpoint=False)
    errors = multipath_error(spacing, chip, amplitude[:, None], excess[:, None], phases)
    return errors.mean(axis=1), errors.std(axis=1)


def _triangle(x: np.ndarray) -> np.ndarray:
    """Correlation of the code with itself, x in chips."""
    return np.maximum(1.0 - np.abs(x), 0.0)


def smoothing_memory(constant: float, time: np.ndarray) -> int:
    """Longest memory, epochs, of a carrier smoothing with a time constant, s, of epochs at times (e,), s."""
    return max(1, math.floor(constant / float(np.median(np.diff(time))) + 0.5 + _ROUNDING))


def smoothed_variance(variance: np.ndarray, used: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Variance (e, s) of carrier-smoothed pseudoranges, m2, and the weight count (e, s) of each epoch's own code.

    Hatch's filter is y = P / n + (1 - 1 / n) (y before + change of the carrier).

    variance: (e, s) of a single pseudorange. used: (e, s) bool; smoothing restarts after a gap, in which the variance
    is nan and the count 0. most: longest memory, epochs.
    """
    count = np.zeros(used.shape, dtype=int)
    out = np.zeros(used.shape)
    running = np.zeros(used.shape[1], dtype=int)
    previous = np.zeros(used.shape[1])
    for e in range(used.shape[0]):
        running = np.where(used[e], np.minimum(running + 1, most), 0)
        n = np.maximum(running, 1)
        before = np.where(running > 1, previous, 0.0)
        previous = np.where(used[e], variance[e] / n**2 + (1.0 - 1.0 / n) ** 2 * before, np.nan)
        count[e], out[e] = running, previous
    return out, count


def smooth(code: np.ndarray, carrier: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Carrier-smoothed pseudoranges (e, s), m, with the counts of `smoothed_variance`; nan without code."""
    out = np.empty_like(code)
    previous = np.zeros(code.shape[1])
    for e in range(code.shape[0]):
        n = np.maximum(count[e], 1)
        ahead = previous + (carrier[e] - carrier[e - 1] if e else 0.0)
        previous = np.where(count[e] > 1, code[e] / n + (1.0 - 1.0 / n) * ahead, code[e])
        out[e] = previous
    return out


def smoothing_slopes(slopes: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes (..., e, s) by codes and by carriers, from slopes by the output of `smooth`: its transpose, 0 without
    code."""
    by_code, by_carrier = np.zeros_like(slopes), np.zeros_like(slopes)
    later = np.zeros_like(slopes[..., 0, :])
    for e in range(count.shape[0] - 1, -1, -1):
        n = np.maximum(count[e], 1)
        here = slopes[..., e, :] + later
        by_code[..., e, :] = here / n
        later = (1.0 - 1.0 / n) * here
        by_carrier[..., e, :] += later
        if e:
            by_carrier[..., e - 1, :] -= later
    return by_code, by_carrier
