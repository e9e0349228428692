"""Formulas in closed form that tests hold simulations against."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.integrity.risk import _beyond
from navsim.integrity.solution import MonitoredFix
from navsim.sensors.imu import Triad, _markov_variance
from navsim.statistics import normal
from navsim.trajectory.air import MIL_F_8785C


def allan_variance(triad: Triad, tau: np.ndarray) -> np.ndarray:
    """Closed form of the Allan variance of the modelled rate error at the cluster times tau, s, on average over
    runs.

    White noise, the exponentially correlated term, quantum, random walk and ramp of the bias, lines. A constant bias
    does not show; the vibration of the place is left out.
    """
    tau, what = np.asarray(tau, dtype=float), triad.further
    out = triad.noise_density**2 / tau + what.quantum**2 / 4.0 / tau**2 + what.walk**2 * tau / 3.0
    out += 0.5 * (what.ramp * tau) ** 2
    for amplitude, frequency in what.lines:
        x = np.pi * frequency * tau
        out += amplitude**2 * (np.sin(x) ** 2 / x) ** 2
    for sigma, time in triad.markovs:
        out += sigma**2 * _markov_variance(tau / time)
    return np.asarray(out)


def dryden_spectrum(
    omega: np.ndarray, speed: float, length: float, sigma: float, transverse: bool, form: str = MIL_F_8785C
) -> np.ndarray:
    """One-sided density (m/s)2/(rad/s) at omega, rad/s, of a gust along or across the flight; its integral over all
    omega is sigma2; length: of the same form."""
    x2 = (length * omega / speed) ** 2
    if not transverse:
        return np.asarray(sigma**2 * 2.0 * length / (math.pi * speed) / (1.0 + x2))
    if form == MIL_F_8785C:
        return np.asarray(sigma**2 * length / (math.pi * speed) * (1.0 + 3.0 * x2) / (1.0 + x2) ** 2)
    return np.asarray(sigma**2 * 2.0 * length / (math.pi * speed) * (1.0 + 12.0 * x2) / (1.0 + 4.0 * x2) ** 2)


@dataclass(frozen=True)
class SteadyWalk:
    """The filter of a scalar random walk in its steady state: variance p of the prediction, gain, variance s of the
    innovation."""

    p: float
    gain: float
    s: float

    @classmethod
    def of(cls, q: float, r: float) -> SteadyWalk:
        """Steady state for a random walk with variance q a step, measured with variance r."""
        p = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
        return cls(p, p / (p + r), p + r)

    def noncentrality(self, slope: float) -> float:
        """Noncentrality of one normalised innovation squared, long after measurements began to drift by `slope` a step.

        The filter follows with the lag slope / gain.
        """
        return (slope / self.gain) ** 2 / self.s


def undetected_by_separation(
    main: MonitoredFix, separation: np.ndarray, epoch: int, source: int, bias: float, limits: tuple[float, float]
) -> float:
    """Integrity risk of one biased range under solution separation: the distance of the fix without the source is
    tested.

    limits: of the error, and of that distance, m. separation: (3, s) from range errors to that distance.
    """
    limit, threshold = limits
    moved = main.estimator[epoch, 2, source] * bias
    spread = float(np.sqrt(main.noise.variance(separation[None])[0, 2]))
    told = float(normal.exceedance(np.array(threshold), moved, spread))
    return _beyond(main, epoch, source, bias, limit) * (1.0 - told)
