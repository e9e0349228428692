"""Further errors of inertial sensors, besides scale factor, constant bias, white noise and a Markov bias.

They act on a sample in this order: response (bandwidth); cross-axis gains, asymmetry, nonlinearity, g-sensitivity;
drifts; vibration, rectified or not; quantisation of the integral; range. Everything acts on increments, and a step is
one interval. Each kind of error has its own random numbers, so switching one on does not change the others.

Sources: [1] IEEE Std 952-1997, annexes B and C (terms, Allan variances). [2] `docs/theory/sensors.md`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.statistics.linear_processes import exponential
from navsim.statistics.random_streams import branch

(
    _MISALIGNMENT, _ASYMMETRY, _NONLINEARITY, _G_SENSITIVITY, _RAMP, _TEMPERATURE, _RECTIFICATION, _WALK, _LINES,
    _VIBRATION_LINES, _VIBRATION, _QUANTUM, _FLICKER,
) = range(1, 14)  # fmt: skip
"""Branches of a run's stream of inertial sensors; the stream itself has bias, white noise, Markov bias and scale."""

MEMORY = 10.0
"""Time over which the filter model treats the random part of a vibration as white noise, s: much longer than the
interval between fixes, in which the vibration averages out."""
_PARTS = 4
"""Subdivisions of a step of a vibration's spectrum; its density is evaluated at their middles."""


@dataclass(frozen=True)
class Vibration:
    """Vibration at the mounting point, the same along each axis."""

    lines: tuple[tuple[float, float], ...] = ()
    """Sines: amplitude, m/s2, and frequency, Hz."""
    density: tuple[tuple[float, float], ...] = ()
    """Points of frequency, Hz, and one-sided density, (m/s2)2/Hz; straight between them in log-log scale, zero
    outside."""

    def at(self, frequency: np.ndarray) -> np.ndarray:
        """One-sided density at frequencies, Hz, (m/s2)2/Hz."""
        if not self.density:
            return np.zeros_like(frequency)
        f, s = np.log(np.array(self.density)).T
        with np.errstate(divide="ignore"):
            x = np.log(frequency)
        return np.where((x >= f[0]) & (x <= f[-1]), np.exp(np.interp(x, f, s)), 0.0)

    def mean_square(self) -> float:
        """Mean square of the acceleration along an axis, (m/s2)2."""
        total = sum(0.5 * amplitude**2 for amplitude, _ in self.lines)
        for (f1, s1), (f2, s2) in zip(self.density[:-1], self.density[1:], strict=True):
            ratio, power = f2 / f1, 1.0 + math.log(s2 / s1) / math.log(f2 / f1)
            flat = abs(power) < 1e-9
            total += s1 * f1 * (math.log(ratio) if flat else (ratio**power - 1.0) / power)
        return total

    def white_density(self, interval: float = MEMORY) -> float:
        """Density, (m/s2)2 s, of the white noise whose integral over an interval, s, has the variance of that of the
        random part: D interval = interval^2 times the integral of S sinc^2."""
        if not self.density:
            return 0.0
        first, last = self.density[0][0], self.density[-1][0]
        # the sidelobes of a sinc are 1/interval wide; beyond a hundred of them less than 1 in 1e3 of each remains
        f = np.unique(np.concatenate([np.geomspace(first, last, 4000), self._within(first, last, interval)]))
        weighed = self.at(f) * np.sinc(f * interval) ** 2
        return float(interval * np.sum(0.5 * (weighed[1:] + weighed[:-1]) * np.diff(f)))

    @staticmethod
    def _within(first: float, last: float, interval: float) -> np.ndarray:
        return np.linspace(first, max(first, min(last, 100.0 / interval)), 4000)


@dataclass(frozen=True)
class Warming:
    """Rise of the sensors' temperature after the start."""

    ramp: float = 0.0
    """K/s."""
    warm_up: float = 0.0
    """Final rise of an exponential warm-up, K."""
    time: float = 1.0
    """Its time constant, s."""

    def at(self, time: np.ndarray) -> np.ndarray:
        """At times since the start, s, K."""
        return self.ramp * time - self.warm_up * np.expm1(-time / self.time)


@dataclass(frozen=True)
class ImuErrorModel:
    """Further errors of three equal sensors, SI: rad/s for gyros, m/s2 for accelerometers.

    Unless stated otherwise, sizes are 1 sigma of a constant that is drawn for each run and axis.
    """

    misalignment: float = 0.0
    """Each cross-axis gain."""
    asymmetry: float = 0.0
    """Error as a fraction of the input's magnitude."""
    nonlinearity: float = 0.0
    """Error per square of the input, 1/unit."""
    g_sensitivity: float = 0.0
    """Each of the nine gains from specific force, unit/(m/s2)."""
    ramp: float = 0.0
    """Drift of the bias, unit/s."""
    temperature: float = 0.0
    """Drift with temperature, unit/K."""
    rectification: float = 0.0
    """Vibration rectification, unit/(m/s2)2."""
    walk: float = 0.0
    """Root of the density of the bias random walk, unit/sqrt(s); not drawn."""
    lines: tuple[tuple[float, float], ...] = ()
    """Sines of random phase: amplitude, unit, and frequency, Hz."""
    quantum: float = 0.0
    """Quantisation step of the integral, rad or m/s."""
    largest: float = math.inf
    """Range of the sensor."""
    bandwidth: float = math.inf
    """-3 dB frequency, Hz, with `damping`."""
    damping: float = math.sqrt(0.5)
    vibration: Vibration = Vibration()
    """Vibration at the mounting point, where `warming` is, too."""
    warming: Warming = Warming()
    flicker: tuple[tuple[float, float], ...] = ()
    """1 sigma and correlation time, s, of the Gauss-Markov terms of flicker noise except the slowest, which is the
    Markov bias."""
    shaken: float = 0.0
    """White noise density, unit2 s, that describes the random part of the vibration in the filter model."""

    @property
    def there(self) -> bool:
        """Whether these errors, apart from the bandwidth, change measurements."""
        nothing = ImuErrorModel(bandwidth=self.bandwidth, damping=self.damping)
        return self != nothing

    @property
    def drifts(self) -> bool:
        """Whether these errors, apart from the random walk, change the bias."""
        return self.ramp > 0.0 or self.temperature > 0.0 or self.rectification > 0.0


NOTHING = ImuErrorModel()
"""Model without further errors."""


@dataclass(frozen=True)
class Gains:
    """Drawn errors of a triad, runs in lanes."""

    cross: np.ndarray
    """(3, 3, W) gains between its axes."""
    force: np.ndarray
    """(3, 3, W) gains from specific force."""
    uneven: np.ndarray
    """(3, W) gain from the input's magnitude."""
    square: np.ndarray
    """(3, W) gain from the input's square."""
    slope: np.ndarray
    """(3, W) unit/s."""
    per_kelvin: np.ndarray
    """(3, W) unit/K."""
    rectified: np.ndarray
    """(3, W) unit."""

    @classmethod
    def drawn(cls, what: ImuErrorModel, triad: int, rngs: Sequence[np.random.Generator]) -> Gains:
        """Draw the gains of runs, each from the branches of its stream; triad: 0 gyros, 1 accelerometers."""

        def each(size: float, kind: int, *shape: int) -> np.ndarray:
            if size == 0.0:
                return np.zeros((*shape, len(rngs)))
            return np.stack([size * branch(rng, kind, triad).standard_normal(shape) for rng in rngs], axis=-1)

        cross = each(what.misalignment, _MISALIGNMENT, 3, 3)
        cross[range(3), range(3)] = 0.0
        shaken = what.rectification * what.vibration.mean_square()
        return cls(
            cross, each(what.g_sensitivity, _G_SENSITIVITY, 3, 3), each(what.asymmetry, _ASYMMETRY, 3),
            each(what.nonlinearity, _NONLINEARITY, 3), each(what.ramp, _RAMP, 3),
            each(what.temperature, _TEMPERATURE, 3), each(shaken, _RECTIFICATION, 3),
        )  # fmt: skip

    def adds(self, felt: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
        """Addition to increments (n, 3, W), from the input `felt` (n, 3, W or 1) and the velocity increments
        `force`."""
        out = np.zeros((felt.shape[0], *self.uneven.shape))
        for axis in range(3):
            for other in range(3):
                for gain, signal in ((self.cross[axis, other], felt), (self.force[axis, other], force)):
                    if gain.any():
                        out[:, axis] += gain * signal[:, other]
        for gain, signal in ((self.uneven, np.abs(felt)), (self.square, felt * felt / dt)):
            if gain.any():
                out += gain * signal
        return out

    def drift(self, what: ImuErrorModel, time: np.ndarray) -> np.ndarray:
        """Addition to the bias at times (t,), s, since the start (t, 3, W)."""
        warmer = what.warming.at(time)
        return self.rectified + self.slope * time[:, None, None] + self.per_kelvin * warmer[:, None, None]


def apply_bandwidth(increments: np.ndarray, dt: float, what: ImuErrorModel) -> np.ndarray:
    """Increments (n, ...) as a sensor of its bandwidth takes them in, exactly where rates are constant over
    each interval [2]."""
    if not math.isfinite(what.bandwidth):
        return increments
    from navsim.sensors.second_order_response import respond  # compiled code only when something is really simulated

    z2 = what.damping**2
    omega = 2.0 * math.pi * what.bandwidth / math.sqrt(1.0 - 2.0 * z2 + math.sqrt((1.0 - 2.0 * z2) ** 2 + 1.0))
    # integral, value, slope, input
    a = np.zeros((4, 4))
    a[0, 1] = a[1, 2] = 1.0
    a[2, 1:] = -(omega**2), -2.0 * what.damping * omega, omega**2
    flat = np.ascontiguousarray(increments.reshape(increments.shape[0], -1))
    out = np.empty_like(flat)
    respond(flat, dt, np.ascontiguousarray(exponential(a * dt)[:3, 1:]), out)
    return out.reshape(increments.shape)


def walks(what: ImuErrorModel, triad: int, rngs: Sequence[np.random.Generator], count: int, dt: float) -> np.ndarray:
    """Random walks of the bias (count + 1, 3, W) at the ends of intervals of dt, s, from 0 on."""
    out = np.zeros((count + 1, 3, len(rngs)))
    for lane, rng in enumerate(rngs):
        out[1:, :, lane] = branch(rng, _WALK, triad).standard_normal((count, 3))
    return np.asarray(np.cumsum(what.walk * math.sqrt(dt) * out, axis=0))


def flickering(
    what: ImuErrorModel, triad: int, term: int, rngs: Sequence[np.random.Generator], count: int, dt: float
) -> np.ndarray:
    """A term of the flicker noise (count + 1, 3, W) at the ends of intervals of dt, s."""
    from navsim.statistics.noise import walk  # compiled code only when something is really simulated

    sigma, time = what.flicker[term]
    decay, own = math.exp(-dt / time), tuple(branch(rng, _FLICKER, triad, term) for rng in rngs)
    transition, root = (size * np.eye(3)[None] for size in (decay, sigma * math.sqrt(1.0 - decay**2)))
    out = np.empty((count + 1, 3, len(rngs)))
    walk(own, len(rngs), transition, root, np.zeros(count, np.int64), sigma * np.eye(3), out)
    return out


def sines(lines: Sequence[tuple[float, float]], phases: np.ndarray, count: int, dt: float) -> np.ndarray:
    """Increments (count, 3, W) of sines of an amplitude and a frequency, Hz, of phases (l, 3, W), rad: exact
    integrals, whether or not a frequency is above that of the samples."""
    out, time = np.zeros((count, *phases.shape[1:])), dt * np.arange(count + 1)
    for (amplitude, frequency), phase in zip(lines, phases, strict=True):
        omega = 2.0 * math.pi * frequency
        c, s = (amplitude / omega * np.diff(f(omega * time))[:, None, None] for f in (np.cos, np.sin))
        out += s * np.sin(phase) - c * np.cos(phase)
    return out


def _phases(lines: Sequence[object], rngs: Sequence[np.random.Generator], *kind: int) -> np.ndarray:
    drawn = [2.0 * math.pi * branch(rng, *kind).random((len(lines), 3)) for rng in rngs]
    return np.stack(drawn, axis=-1)


def shaking(vibration: Vibration, rngs: Sequence[np.random.Generator], count: int, dt: float) -> np.ndarray | None:
    """Increments of velocity (count, 3, W), m/s, of a vibration; None of none."""
    out = None
    if vibration.lines:
        out = sines(vibration.lines, _phases(vibration.lines, rngs, _VIBRATION_LINES), count, dt)
    if vibration.density:
        size = _spectrum(vibration, count, dt)
        random = np.empty((count, 3, len(rngs)))
        for lane, rng in enumerate(rngs):
            drawn = branch(rng, _VIBRATION).standard_normal((3, 2, size.size))
            random[..., lane] = np.fft.irfft(size * (drawn[:, 0] + 1j * drawn[:, 1]))[:, :count].T
        out = random if out is None else out + random
    return out


@functools.lru_cache(maxsize=4)
def _spectrum(vibration: Vibration, count: int, dt: float) -> np.ndarray:
    """Magnitudes (m,) of the Fourier transform of a series of at least `count` velocity increments due to vibration,
    m/s.

    The density is averaged over each interval of dt, s, with aliases from above half the sampling rate.
    """
    length = 1 << math.ceil(math.log2(1.1 * count + 1))
    rate, step = 1.0 / dt, 1.0 / (dt * length)
    lines = np.arange(length // 2 + 1)
    parts = step * (lines[:, None] + (np.arange(_PARTS) + 0.5) / _PARTS - 0.5)
    power = np.zeros(lines.shape)
    for fold in range(math.ceil(vibration.density[-1][0] / rate + 0.5) + 1):
        for f in (parts + fold * rate, fold * rate - parts) if fold else (parts,):
            power += (vibration.at(np.maximum(f, 0.0)) * np.sinc(f * dt) ** 2).mean(axis=1) * step
    size = 0.5 * length * dt * np.sqrt(power)
    # the ends have no partner: their real part alone counts, twice; the fold onto the last is its own half
    size[0] *= 2.0
    size[-1] *= math.sqrt(2.0)
    return size


def periodic(what: ImuErrorModel, triad: int, rngs: Sequence[np.random.Generator], count: int, dt: float) -> np.ndarray:
    """Increments (count, 3, W) of the sensors' own lines."""
    return sines(what.lines, _phases(what.lines, rngs, _LINES, triad), count, dt)


def quantise(increments: np.ndarray, what: ImuErrorModel, triad: int, rngs: Sequence[np.random.Generator]) -> None:
    """Round increments (n, 3, W) to multiples of the quantum, in place; the remainder is carried over."""
    begun = np.stack([branch(rng, _QUANTUM, triad).random(3) for rng in rngs], axis=-1)
    counts = np.floor(begun + np.cumsum(increments, axis=0) / what.quantum)
    increments[0] = what.quantum * counts[0]
    increments[1:] = what.quantum * np.diff(counts, axis=0)


def within_range(increments: np.ndarray, what: ImuErrorModel, dt: float) -> np.ndarray:
    """Cut increments (n, 3, W) off at the largest mean over an interval, in place; returns of how many samples (W,)
    any was."""
    limit = what.largest * dt
    over = (np.abs(increments) > limit).any(axis=1).sum(axis=0)
    np.clip(increments, -limit, limit, out=increments)
    return np.asarray(over)
