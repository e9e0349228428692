"""Inertial sensor errors added to exact increments: scale factor, constant bias, white noise, Gauss-Markov bias.

Measured rate = (1 + scale) true rate + bias + Markov process + white noise, for each axis alike; the same for specific
force. Further errors are in `imu_errors`. Sources: [1] IEEE Std 952-1997, annex C (noise terms and their Allan
variances). [2] Titterton & Weston (2004), section 12.5 (datasheet units).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.sensors import imu_errors
from navsim.sensors.imu_errors import NOTHING, Gains, ImuErrorModel
from navsim.statistics.random_streams import normals

FAST = 3.0
"""Correlation time, s, below which a filter takes terms of flicker noise for white noise."""


@dataclass(frozen=True)
class Triad:
    """Error model of three equal sensors, SI: rad/s for gyros, m/s2 for accelerometers."""

    bias: float
    """1 sigma of the constant bias, drawn for each run and axis."""
    noise_density: float
    """Root of the white noise density, rad/sqrt(s) (ARW) or m/s/sqrt(s) (VRW)."""
    markov: float = 0.0
    """1 sigma of the exponentially correlated bias; the slowest term of flicker noise."""
    markov_time: float = math.inf
    """Its correlation time, s."""
    fixed_bias: tuple[float, float, float] | None = None
    """(3,) bias of all runs, instead of `bias`."""
    scale: float = 0.0
    """1 sigma of the scale factor error, drawn for each run and axis."""
    further: ImuErrorModel = NOTHING
    """All other errors."""

    @property
    def markovs(self) -> tuple[tuple[float, float], ...]:
        """1 sigma and correlation time, s, of all Gauss-Markov terms there are, the slowest first."""
        return (*([(self.markov, self.markov_time)] if self.markov > 0.0 else []), *self.further.flicker)

    def merged(self) -> Triad:
        """The model with one bias state and white noise, for filters.

        Flicker noise terms as slow as `FAST` or slower become one Markov bias of their variance and short-term growth.
        Faster terms become white noise of their long-term growth.
        """
        if not self.further.flicker:
            return self
        slow = [(sigma, time) for sigma, time in self.markovs if time >= FAST]
        fast = sum(2.0 * sigma**2 * time for sigma, time in self.markovs if time < FAST)
        variance = sum(sigma**2 for sigma, _ in slow)
        growth = sum(2.0 * sigma**2 / time for sigma, time in slow)
        return replace(
            self, noise_density=math.sqrt(self.noise_density**2 + fast), markov=math.sqrt(variance),
            markov_time=2.0 * variance / growth if slow else math.inf, further=replace(self.further, flicker=()),
        )  # fmt: skip

    def drive(self) -> float:
        """Density of the white noise that drives the Markov bias, unit2/s."""
        return 2.0 * self.markov**2 / self.markov_time

    def initial_sigma(self) -> float:
        """1 sigma of the total bias at time 0; a fixed bias counts with its root mean square."""
        constant = self.bias
        if self.fixed_bias is not None:
            constant = math.sqrt(sum(b * b for b in self.fixed_bias) / 3.0)
        shaken = self.further.rectification * self.further.vibration.mean_square()
        return math.hypot(constant, self.markov) if shaken == 0.0 else math.hypot(constant, self.markov, shaken)

    def white(self) -> float:
        """White noise density, unit2 s, including the white noise that represents vibration."""
        return self.noise_density**2 + self.further.shaken


def density_from_sample_sigma(sigma: float, rate: float) -> float:
    """Noise density of a white sequence of `sigma` per sample at `rate` Hz: sigma / sqrt(rate) [2]."""
    return sigma / math.sqrt(rate)


@dataclass(frozen=True)
class SensorErrors:
    """Errors of measured increments without the white noise. Several runs lie along a last axis."""

    bias: np.ndarray
    """(o, 6) of gyros and accelerometers at the start of some intervals, rad/s, m/s2."""
    scale: np.ndarray
    """(6,) scale factor errors."""
    cross: np.ndarray
    """(2, 3, 3) cross-axis gains of gyros and of accelerometers."""
    force: np.ndarray
    """(3, 3) gains of the gyros from specific force, rad/s/(m/s2)."""
    clipped: np.ndarray
    """(2,) samples beyond the range of gyros and of accelerometers."""


@dataclass(frozen=True)
class ImuDraws:
    """What is drawn for the sensors of W runs, the last of which may repeat one, whatever they measure."""

    rngs: tuple[np.random.Generator, ...]
    """Streams of the runs, whose branches further errors draw."""
    constant: np.ndarray
    """(6, W) constant biases, rad/s, m/s2."""
    scale: np.ndarray
    """(6, W) scale factor errors."""
    normals: np.ndarray
    """(r, k) see `noise.corrupt`."""

    @classmethod
    def of(
        cls, rngs: tuple[np.random.Generator, ...], count: int, intervals: int, gyro: Triad, accel: Triad
    ) -> ImuDraws:
        """Those of the first `count` of W runs over so many intervals."""
        constant, scale = np.zeros((6, len(rngs))), np.zeros((6, len(rngs)))
        for lane, rng in enumerate(rngs[:count]):
            for first, triad in ((0, gyro), (3, accel)):
                drawn = triad.bias * rng.standard_normal(3)
                constant[first : first + 3, lane] = drawn if triad.fixed_bias is None else triad.fixed_bias
            for first, triad in ((0, gyro), (3, accel)):
                if triad.scale > 0.0:
                    scale[first : first + 3, lane] = triad.scale * rng.standard_normal(3)
        begin = sum(3 * (triad.markov > 0.0) for triad in (gyro, accel))
        white = sum(3 * (triad.noise_density > 0.0) for triad in (gyro, accel))
        return cls(rngs[:count], constant, scale, normals(rngs[:count], begin + intervals * (white + begin)))

    def lane(self, i: int) -> ImuDraws:
        """Copy of one lane."""
        own = slice(i, i + 1)
        return ImuDraws(
            self.rngs[own], self.constant[:, own].copy(), self.scale[:, own].copy(), self.normals[own].copy()
        )

    @classmethod
    def of_lanes(cls, each: Sequence[ImuDraws], lanes: int) -> ImuDraws:
        """Draws of one lane in the first of so many; nothing is drawn for further lanes."""
        rest = np.zeros((6, lanes - len(each)))
        constant, scale = (
            np.concatenate([*(getattr(one, name) for one in each), rest], axis=1) for name in ("constant", "scale")
        )
        return cls(tuple(one.rngs[0] for one in each), constant, scale, np.concatenate([one.normals for one in each]))


def simulate(
    rng: np.random.Generator, dtheta: np.ndarray, dv: np.ndarray, dt: float, gyro: Triad, accel: Triad
) -> tuple[np.ndarray, np.ndarray, SensorErrors]:
    """Measured increments dtheta, dv (n, 3) of one run, and its errors at the start of every interval and at the end (n
    + 1, 6)."""
    every = np.arange(dtheta.shape[0] + 1)
    draws = ImuDraws.of((rng,), 1, dtheta.shape[0], gyro, accel)
    out_dtheta, out_dv, errors = simulate_lanes(draws, dtheta, dv, dt, gyro, accel, every)
    fields = {name: getattr(errors, name)[..., 0] for name in SensorErrors.__dataclass_fields__}
    return out_dtheta[..., 0], out_dv[..., 0], SensorErrors(**fields)


def simulate_lanes(
    draws: ImuDraws, dtheta: np.ndarray, dv: np.ndarray, dt: float, gyro: Triad, accel: Triad, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, SensorErrors]:
    """Measured increments (n, 3, W) of as many of W runs as are drawn, and their errors.

    - `dtheta`, `dv`: exact increments (n, 3), or those of each run (n, 3, W).
    - `at` (o,): intervals at whose start errors are returned: bias (o, 6, W), scale (6, W) and so on.

    Raises ValueError for intervals out of order or outside the data.
    """
    if at.size and (at[0] < 0 or at[-1] > dtheta.shape[0] or np.any(np.diff(at) < 0)):
        raise ValueError("biases are asked for at intervals in order, from the first to the end of the last")
    from navsim.statistics.noise import corrupt  # compiled code only when something is really simulated

    scale, lanes, count = draws.scale, draws.scale.shape[1], len(draws.rngs)
    acting = dv.reshape(dv.shape[0], 3, -1)[..., :count]
    dtheta, dv = (imu_errors.apply_bandwidth(m, dt, t.further) for m, t in ((dtheta, gyro), (dv, accel)))
    white = math.sqrt(dt) * np.array([gyro.noise_density, accel.noise_density])
    markov = np.array([gyro.markov, accel.markov])
    decay = np.exp(-dt / np.array([gyro.markov_time, accel.markov_time]))
    exact = [m.reshape(m.shape[0], 3, -1) for m in (dtheta, dv)]
    out_dtheta, out_dv = (np.empty((m.shape[0], 3, lanes)) for m in exact)
    bias = np.empty((at.size, 6, lanes))
    corrupt(
        draws.normals, *exact, dt, draws.constant, 1.0 + scale, white, markov, decay, at, out_dtheta, out_dv, bias
    )  # fmt: skip
    errors = SensorErrors(bias, scale, np.zeros((2, 3, 3, lanes)), np.zeros((3, 3, lanes)), np.zeros((2, lanes)))
    if gyro.further.there or accel.further.there:
        felt, forced = (m[..., :count] for m in exact)
        _go_on(draws.rngs, felt, forced, acting, dt, (gyro, accel), at, (out_dtheta, out_dv), errors)
    return out_dtheta, out_dv, errors


def _go_on(
    rngs: tuple[np.random.Generator, ...],
    dtheta: np.ndarray,
    dv: np.ndarray,
    acting: np.ndarray,
    dt: float,
    triads: tuple[Triad, Triad],
    at: np.ndarray,
    measured: tuple[np.ndarray, np.ndarray],
    errors: SensorErrors,
) -> None:
    """Add the `imperfections` of sensors to increments measured without them (n, 3, W), and to their errors, in place.

    - `dtheta`, `dv` (n, 3, W or 1): input of the sensors.
    - `acting`: dv before the response of the accelerometers, which does not affect the gyros.
    """
    count, lanes = dtheta.shape[0], len(rngs)
    middle = dt * (np.arange(count) + 0.5)
    shaken = imu_errors.shaking(triads[1].further.vibration, rngs, count, dt)
    force = acting if shaken is None else acting + shaken
    for number, (triad, felt, all_out) in enumerate(zip(triads, (dtheta, dv), measured, strict=True)):
        what, out, part = triad.further, all_out[..., :lanes], slice(3 * number, 3 * number + 3)
        gains = Gains.drawn(what, number, rngs)
        errors.cross[number, ..., :lanes] = gains.cross
        if number == 0:
            errors.force[..., :lanes] = gains.force
        out += gains.adds(felt, force, dt)
        if what.drifts:
            out += dt * gains.drift(what, middle)
            errors.bias[:, part, :lanes] += gains.drift(what, dt * at)
        if what.walk > 0.0:
            walk = imu_errors.walks(what, number, rngs, count, dt)
            out += dt * walk[:-1]
            errors.bias[:, part, :lanes] += walk[at]
        for term, (_, time) in enumerate(what.flicker):
            flicker = imu_errors.flickering(what, number, term, rngs, count, dt)
            out += dt * flicker[:-1]
            if time >= FAST:  # faster ones are noise to the state of a bias
                errors.bias[:, part, :lanes] += flicker[at]
        if number == 1 and shaken is not None:
            out += shaken
        if what.lines:
            out += imu_errors.periodic(what, number, rngs, count, dt)
        if what.quantum > 0.0:
            imu_errors.quantise(out, what, number, rngs)
        if math.isfinite(what.largest):
            errors.clipped[number, :lanes] = imu_errors.within_range(out, what, dt)


def _markov_variance(x: np.ndarray) -> np.ndarray:
    """Allan variance of a Gauss-Markov process of unit variance at x correlation times [1]."""
    return np.asarray(2.0 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x)))


MARKOV_PEAK = 1.892618, 0.617364
"""Peak of the Allan deviation of a Markov bias: its time in correlation times, and its height in 1 sigma [1]."""


def markov_of_lowest(lowest: float, density: float, time: float) -> float:
    """1 sigma of a Markov bias whose Allan deviation, together with white noise, peaks at `lowest`.

    Data sheets print this value as bias instability. time: correlation time, s; density: of the white noise. nan if the
    white noise alone exceeds it.
    """
    at, height = MARKOV_PEAK
    left = lowest**2 - density**2 / (at * time)
    return math.sqrt(left) / height if left > 0.0 else math.nan


_FLAT = 17.0
"""Largest ratio of neighbouring correlation times: Markov terms and white noise add up to a flat curve within 10 %."""
_SAMPLES = 4.0
"""Intervals between samples over which flicker noise begins to be flat."""


def flicker_of_lowest(lowest: float, density: float, time: float, interval: float) -> tuple[tuple[float, float], ...]:
    """Flicker noise as Gauss-Markov terms: 1 sigma and correlation time, s, the slowest first.

    Their sum with white noise has the Allan deviation `lowest` from the end of the white noise to the peak of the
    slowest term. It is exact at the peak of each term. nan if the white noise alone exceeds it.

    time: correlation time of the slowest term, s. interval: between samples, s; faster terms are omitted.
    """
    at, _ = MARKOV_PEAK
    # at 2.5 times where the white noise is as much its share of the variance is 40 %
    fastest = min(time, max(2.5 * (density / lowest) ** 2, _SAMPLES * interval) / at)
    count = 1 + math.ceil(math.log(time / fastest) / math.log(_FLAT))
    for terms in range(count, 1, -1):
        times = np.geomspace(time, fastest, terms)
        peaks = at * times
        variance = np.linalg.solve(_markov_variance(peaks[:, None] / times), lowest**2 - density**2 / peaks)
        if (variance > 0.0).all():
            return tuple((math.sqrt(v), float(t)) for v, t in zip(variance, times, strict=True))
    return ((markov_of_lowest(lowest, density, time), time),)
