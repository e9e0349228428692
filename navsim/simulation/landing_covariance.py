"""Linear covariance analysis of a landing: what a thousand runs would show, from matrices alone.

Truth and filter are two models. The filter's own covariance gives the gains; every source of error (initial
errors, sensor biases and noises, ranging noise of satellites and of pseudolites, systematic errors) is then carried
through the linearised loop by itself, with what it really is. Their sum is the true covariance, whatever the filter
believes, and the terms are the error budget.

State carried, 27: (dr, dv, theta), -b_hat (6), constant bias (6), Markov bias (6); the filter's error of a bias is
the sum of the last three. Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.core import covariance, states
from navsim.core.dop import MAX_CLOCKS
from navsim.core.wgs84 import E2, A
from navsim.estimation import receiver
from navsim.estimation.linearised import INPUTS, NOISES, linearise
from navsim.models import imu
from navsim.simulation.landing import FilterSettings, InitialErrors, World, initial_estimate

SOURCES = (
    "initial_position",
    "initial_velocity",
    "initial_attitude",
    "gyro_bias",
    "accelerometer_bias",
    "gyro_noise",
    "accelerometer_noise",
    "gyro_markov",
    "accelerometer_markov",
    "satellite_range",
    "satellite_range_rate",
    "pseudolite_range",
    "pseudolite_range_rate",
)
"""Independent random sources of error, in the order of the budget; systematic errors come beside them as a mean."""
_FIRST_OF_FIXES = SOURCES.index("satellite_range")

_SIZE = states.N + INPUTS
_CONSTANT, _MARKOV = states.N, states.N + 6
_BIASES = slice(states.GYRO, states.N)

_DIFFERENCE = 0.05
"""Step of pseudoranges (m) and range rates (m/s) for the receiver's derivatives: a fix is nearly linear in them, and
rounding of 1e-8 m stays 1e-7 of the step."""


@dataclass(frozen=True)
class Analysis:
    """True accuracy of the filter to first order.

    variance: (source, t, 15) of each of `SOURCES`. mean: (t, 15) from systematic errors and fixed values.
    covariance: (t, 15, 15) of all sources, without the mean. believed: (t, 15, 15) the filter's own.
    nis: (e,) expected normalised innovation squared, nan without a fix; degrees: (e,).
    """

    variance: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    believed: np.ndarray
    nis: np.ndarray
    degrees: np.ndarray

    def expected_square(self, states_: slice) -> np.ndarray:
        """Expected normalised squared error of some states, per degree of freedom (t,)."""
        second = self.covariance + self.mean[:, :, None] * self.mean[:, None, :]
        believed = self.believed[:, states_, states_]
        return np.trace(np.linalg.solve(believed, second[:, states_, states_]), axis1=1, axis2=2) / believed.shape[1]


def _solve(world: World, ranges: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fixes (e, 3) llh and (e, 3) velocity, and their covariance (e, 6, 6)."""
    s = world.signals
    e = s.time.size
    llh, velocity, clocks = np.empty((e, 3)), np.empty((e, 3)), np.empty((e, MAX_CLOCKS))
    cov = np.empty((e, 6, 6))
    receiver.fixes(
        world.start, s.position, s.velocity, s.sigma, s.rate_sigma, s.clock, ranges, rates, llh, velocity, clocks, cov
    )
    return llh, velocity, cov


def _fix_noise(world: World, ranges: np.ndarray, rates: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Covariance of position and velocity fixes (4, e, 6, 6) by the last four of `SOURCES`.

    The receiver itself is differentiated, measurement by measurement, so that its weights are in it.
    """
    s = world.signals
    e, n = ranges.shape
    out = np.zeros((4, e, 6, 6))
    for i in range(n):
        for part, sigma in ((0, s.sigma), (1, s.rate_sigma)):
            sides = []
            for sign in (1.0, -1.0):
                measured = [ranges.copy(), rates.copy()]
                measured[part][:, i] += sign * _DIFFERENCE
                sides.append(_solve(world, *measured)[:2])
            (llh1, v1), (llh0, v0) = sides
            slope = np.concatenate([_metres(llh1 - llh0, llh0), v1 - v0], axis=1) / (2.0 * _DIFFERENCE)
            slope[~s.used[:, i]] = 0.0
            out[2 * int(ground[i]) + part] += (sigma[:, i] ** 2)[:, None, None] * slope[:, :, None] * slope[:, None]
    return out


def _metres(difference: np.ndarray, llh: np.ndarray) -> np.ndarray:
    """Small differences of geodetic coordinates as NED metres (e, 3)."""
    w = 1.0 - E2 * np.sin(llh[:, 0]) ** 2
    meridian = A * (1.0 - E2) / (w * np.sqrt(w))
    transverse = A / np.sqrt(w)
    return np.stack(
        [
            difference[:, 0] * (meridian + llh[:, 2]),
            difference[:, 1] * (transverse + llh[:, 2]) * np.cos(llh[:, 0]),
            -difference[:, 2],
        ],
        axis=1,
    )


def analyse(
    world: World,
    initial: InitialErrors,
    gyro: imu.Triad,
    accel: imu.Triad,
    settings: FilterSettings,
    ground: np.ndarray,
) -> Analysis:
    """The accuracy of the filter of `settings` in the given world.

    initial, gyro, accel: the truth, as for `landing.fly`. ground: (s,) bool, which sources are pseudolites.
    """
    s = world.signals
    ranges = np.where(s.used, s.range + s.delay + world.clock[:, :1], np.nan)
    rates = np.where(s.used, s.range_rate + world.clock[:, 1:], np.nan)
    llh, velocity, cov = _solve(world, ranges, rates)
    markov_decay = np.array([1.0 / gyro.markov_time, 1.0 / accel.markov_time])
    e = s.time.size
    n = states.N
    phi, gamma, q = np.empty((e, n, n)), np.empty((e, n, INPUTS)), np.empty((e, NOISES, n, n))
    h, k, z = np.empty((e, 6, n)), np.empty((e, n, 6)), np.empty((e, 6))
    degrees = np.zeros(e, np.int64)
    late = e if settings.latency > 0.0 else 0
    ahead = np.empty((late, n, n)), np.empty((late, n, INPUTS)), np.empty((late, NOISES, n, n))
    believed, innovation = np.empty((e + 1, n, n)), np.zeros((e, 6, 6))
    valid = np.maximum(s.time + (world.filter_time[1:] - s.time) - settings.latency, 0.0)
    linearise(
        world.imu_time, world.dtheta, world.dv, _truth_at_start(world), settings.covariance(), settings.noise(),
        markov_decay, valid, llh, velocity, settings.sigma_scale**2 * cov, settings.with_velocity, settings.latency,
        settings.lever_arm, phi, gamma, q, h, k, z, degrees, *ahead, believed, innovation, covariance.STRIDE,
    )  # fmt: skip

    density = np.zeros((len(SOURCES), NOISES))
    for row, (name, value) in enumerate(
        (
            ("gyro_noise", gyro.noise_density**2),
            ("accelerometer_noise", accel.noise_density**2),
            ("gyro_markov", 2.0 * gyro.markov**2 / gyro.markov_time),
            ("accelerometer_markov", 2.0 * accel.markov**2 / accel.markov_time),
        )
    ):
        density[SOURCES.index(name), row] = value
    noise = np.nan_to_num(_fix_noise(world, ranges, rates, ground))

    total, mean = _at_start(initial, gyro, accel)
    to_error = np.zeros((n, _SIZE))
    to_error[:, :n] = np.eye(n)
    to_error[_BIASES, _CONSTANT:_MARKOV] = np.eye(6)
    to_error[_BIASES, _MARKOV:] = np.eye(6)

    variance = np.empty((len(SOURCES), e + 1, n))
    means, sums = np.empty((e + 1, n)), np.empty((e + 1, n, n))
    nis = np.full(e, np.nan)

    def record(at: int, covariances: np.ndarray, mu: np.ndarray) -> None:
        error = to_error @ covariances @ to_error.T
        variance[:, at] = np.diagonal(error, axis1=1, axis2=2)
        sums[at] = error.sum(axis=0)
        means[at] = to_error @ mu

    record(0, total, mean)
    for i in range(e):
        way, added = _augmented(phi[i], gamma[i], q[i], density)
        total = way @ total @ way.T + added
        mean = way @ mean
        m = degrees[i]
        if m:
            here = h[i, :m] @ to_error
            r = noise[:, i, :m, :m]
            second = here @ (total.sum(axis=0) + np.outer(mean, mean)) @ here.T + r.sum(axis=0)
            offset = here @ mean
            second += np.outer(z[i, :m], z[i, :m]) + np.outer(offset, z[i, :m]) + np.outer(z[i, :m], offset)
            nis[i] = np.trace(np.linalg.solve(innovation[i, :m, :m], second))
            feedback = np.zeros((_SIZE, m))
            feedback[:n] = k[i, :, :m]
            keep = np.eye(_SIZE) - feedback @ here
            total = keep @ total @ keep.T
            total[_FIRST_OF_FIXES:] += feedback @ r @ feedback.T
            mean = keep @ mean - feedback @ z[i, :m]
        if late:
            way, added = _augmented(ahead[0][i], ahead[1][i], ahead[2][i], density)
            record(i + 1, way @ total @ way.T + added, way @ mean)
        else:
            record(i + 1, total, mean)
    return Analysis(variance, means, sums, believed, nis, degrees)


def _truth_at_start(world: World) -> np.ndarray:
    """The navigation state at time 0 without error (20,)."""
    none = InitialErrors(0.0, 0.0, 0.0)
    return initial_estimate(np.random.default_rng(0), world.at_filter, none)


def _at_start(initial: InitialErrors, gyro: imu.Triad, accel: imu.Triad) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (source, 27, 27) and mean (27,) at time 0."""
    total = np.zeros((len(SOURCES), _SIZE, _SIZE))
    mean = np.zeros(_SIZE)

    def draw(source: str, first: int, sigma: float) -> None:
        at = range(first, first + 3)
        total[SOURCES.index(source), at, at] = sigma**2

    if initial.fixed is None:
        draw("initial_position", states.POS, initial.position)
        draw("initial_velocity", states.VEL, initial.velocity)
        draw("initial_attitude", states.ATT, initial.attitude)
    else:
        mean[:9] = initial.fixed
    for name, triad, place in (("gyro", gyro, 0), ("accelerometer", accel, 3)):
        if triad.fixed_bias is None:
            draw(f"{name}_bias", _CONSTANT + place, triad.bias)
        else:
            mean[_CONSTANT + place : _CONSTANT + place + 3] = triad.fixed_bias
        draw(f"{name}_markov", _MARKOV + place, triad.markov)
    return total, mean


def _augmented(phi: np.ndarray, gamma: np.ndarray, q: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transition (27, 27) and added covariance (source, 27, 27) of one interval."""
    n = states.N
    way = np.eye(_SIZE)
    way[:n, :n] = phi
    way[:9, n:] = gamma[:9]
    way[_MARKOV:, _MARKOV:] = gamma[_BIASES, 6:]
    # the bias rows of q are those of the Markov process itself
    place = np.concatenate([np.arange(9), np.arange(_MARKOV, _SIZE)])
    added = np.zeros((density.shape[0], _SIZE, _SIZE))
    for source, noise in zip(*np.nonzero(density), strict=True):
        added[source][np.ix_(place, place)] += density[source, noise] * q[noise]
    return way, added


def folded_quantile(probability: float, mean: float, sigma: float) -> float:
    """Quantile of the size of a Gaussian value; nan for undefined ones."""
    if not math.isfinite(mean) or not math.isfinite(sigma):
        return math.nan
    if sigma == 0.0:
        return abs(mean)
    from scipy.optimize import brentq
    from scipy.special import ndtr

    def excess(q: float) -> float:
        return float(ndtr((q - mean) / sigma) - ndtr((-q - mean) / sigma)) - probability

    return float(brentq(excess, 0.0, abs(mean) + 10.0 * sigma, xtol=1e-12))
