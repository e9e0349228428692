"""Inertial sensor errors on top of exact increments: scale factor, constant bias, white noise, Gauss-Markov bias.

Measured rate = (1 + scale) true rate + bias + Markov process + white noise, for each axis alike; the same for specific
force. Sources: [1] IEEE Std 952-1997, annex C (noise terms and their Allan variances).
[2] Titterton & Weston (2004), section 12.5 (datasheet units).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Triad:
    """Error model of three like sensors, SI: rad/s for gyros, m/s2 for accelerometers.

    bias: 1 sigma of the constant bias drawn per run and axis; fixed_bias: (3,) instead of it.
    noise_density: root of the white density, rad/sqrt(s) (ARW) or m/s/sqrt(s) (VRW).
    markov, markov_time: 1 sigma and correlation time (s) of the exponentially correlated bias.
    scale: 1 sigma of the error of the scale factor, drawn per run and axis.
    """

    bias: float
    noise_density: float
    markov: float = 0.0
    markov_time: float = math.inf
    fixed_bias: tuple[float, float, float] | None = None
    scale: float = 0.0

    def drive(self) -> float:
        """Density of the white noise that drives the Markov bias, unit2/s."""
        return 2.0 * self.markov**2 / self.markov_time

    def initial_sigma(self) -> float:
        """1 sigma of the whole bias at time 0; a fixed bias counts with its root mean square."""
        constant = self.bias
        if self.fixed_bias is not None:
            constant = math.sqrt(sum(b * b for b in self.fixed_bias) / 3.0)
        return math.hypot(constant, self.markov)


def density_from_sample_sigma(sigma: float, rate: float) -> float:
    """Noise density of a white sequence of `sigma` per sample at `rate` Hz: sigma / sqrt(rate) [2].

    The one converter between the two spellings of white noise; `sample_sigma_from_density` undoes it.
    """
    return sigma / math.sqrt(rate)


def sample_sigma_from_density(density: float, rate: float) -> float:
    """1 sigma per sample of white noise of a density at `rate` Hz."""
    return density * math.sqrt(rate)


@dataclass(frozen=True)
class SensorErrors:
    """The errors that measured increments have, but for white noise: bias (o, 6) of gyros and accelerometers, at the
    start of some intervals, rad/s, m/s2; scale (6,) of their scale factors. Of several runs along a last axis."""

    bias: np.ndarray
    scale: np.ndarray


def simulate(
    rng: np.random.Generator, dtheta: np.ndarray, dv: np.ndarray, dt: float, gyro: Triad, accel: Triad
) -> tuple[np.ndarray, np.ndarray, SensorErrors]:
    """Measured increments dtheta, dv (n, 3) of one run, and the errors behind them at the start of every interval and
    at the end (n + 1, 6)."""
    every = np.arange(dtheta.shape[0] + 1)
    out_dtheta, out_dv, errors = simulate_lanes((rng,), 1, dtheta, dv, dt, gyro, accel, every)
    return out_dtheta[..., 0], out_dv[..., 0], SensorErrors(errors.bias[..., 0], errors.scale[..., 0])


def simulate_lanes(
    rngs: tuple[np.random.Generator, ...],
    count: int,
    dtheta: np.ndarray,
    dv: np.ndarray,
    dt: float,
    gyro: Triad,
    accel: Triad,
    at: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, SensorErrors]:
    """Measured increments (n, 3, W) of the first `count` of W runs, from exact ones dtheta, dv (n, 3), or those of each
    run (n, 3, W), and the errors behind them at the start of the intervals `at` (o,): bias (o, 6, W), scale (6, W).
    Raises ValueError for intervals out of order, or that are none."""
    if at.size and (at[0] < 0 or at[-1] > dtheta.shape[0] or np.any(np.diff(at) < 0)):
        raise ValueError("biases are asked for at intervals in order, from the first to the end of the last")
    from navsim.core.noise import corrupt  # compiled code only when something is really simulated

    lanes = len(rngs)
    constant, scale = np.zeros((6, lanes)), np.zeros((6, lanes))
    for lane, rng in enumerate(rngs[:count]):
        for first, triad in ((0, gyro), (3, accel)):
            drawn = triad.bias * rng.standard_normal(3)
            constant[first : first + 3, lane] = drawn if triad.fixed_bias is None else triad.fixed_bias
        for first, triad in ((0, gyro), (3, accel)):
            if triad.scale > 0.0:
                scale[first : first + 3, lane] = triad.scale * rng.standard_normal(3)
    white = math.sqrt(dt) * np.array([gyro.noise_density, accel.noise_density])
    markov = np.array([gyro.markov, accel.markov])
    decay = np.exp(-dt / np.array([gyro.markov_time, accel.markov_time]))
    exact = [m.reshape(m.shape[0], 3, -1) for m in (dtheta, dv)]
    out_dtheta, out_dv = (np.empty((m.shape[0], 3, lanes)) for m in exact)
    bias = np.empty((at.size, 6, lanes))
    corrupt(
        rngs, count, *exact, dt, constant, 1.0 + scale, white, markov, decay, at, out_dtheta, out_dv, bias
    )  # fmt: skip
    return out_dtheta, out_dv, SensorErrors(bias, scale)


def allan_variance(triad: Triad, tau: np.ndarray) -> np.ndarray:
    """Closed form of the Allan variance of the modelled rate error at the cluster times tau, s [1].

    White noise N^2 / tau plus the exponentially correlated term; a constant bias does not show.
    """
    tau = np.asarray(tau, dtype=float)
    white = triad.noise_density**2 / tau
    if triad.markov == 0.0:
        return white
    x = tau / triad.markov_time
    return white + 2.0 * triad.markov**2 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))
