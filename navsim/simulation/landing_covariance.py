"""Linear covariance analysis of a landing: what a thousand runs would show, from matrices alone.

Truth and filter are two models. The filter's own covariance gives the gains; every source of error (initial
errors, sensor biases and noises, orbits and clocks of satellites, ranging noise of satellites and of pseudolites,
systematic errors) is then carried through the linearised loop by itself, with what it really is. Their sum is the true
covariance, whatever the filter believes, and the terms are the error budget.

State carried, 27: (dr, dv, theta), -b_hat (6), constant bias (6), Markov bias (6); the filter's error of a bias is
the sum of the last three. Noise of carrier-smoothed ranges is correlated in time and is carried beside it, see
`_Smoothed`; errors of orbits and clocks are constant over a run, so what each does to the state is.

Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.core import covariance, states
from navsim.core.defect import Defect
from navsim.core.wgs84 import E2, A, short_way
from navsim.estimation.linearised import INPUTS, NOISES, linearise
from navsim.models import imu
from navsim.models.pseudorange import Signals
from navsim.simulation.landing import (
    CARRIER_SIGMA,
    FilterSettings,
    InitialErrors,
    World,
    fixed,
    initial_estimate,
    without_noise,
)

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
    "satellite_ephemeris",
    "satellite_range",
    "satellite_range_rate",
    "pseudolite_range",
    "pseudolite_range_rate",
)
"""Independent random sources of error, in the order of the budget; systematic errors come beside them as a mean."""
_EPHEMERIS = SOURCES.index("satellite_ephemeris")
_RANGES = (SOURCES.index("satellite_range"), SOURCES.index("pseudolite_range"))
_RATES = (SOURCES.index("satellite_range_rate"), SOURCES.index("pseudolite_range_rate"))

_SIZE = states.N + INPUTS
_CONSTANT, _MARKOV = states.N, states.N + 6
_BIASES = slice(states.GYRO, states.N)

_DIFFERENCE = 0.05
"""Step of pseudoranges (m) and range rates (m/s) for the receiver's derivatives: a fix is nearly linear in them, and
rounding of 1e-8 m stays 1e-7 of the step."""

_EXPECTED_NIS = 0.01
"""Largest deviation from 1 of the expected normalised innovation squared, per degree of freedom, of a filter that
believes what is true."""


class AnalysisError(Defect):
    """The analysis contradicts itself."""


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
    llh, velocity, _, cov = fixed(world, ranges, rates)
    return llh, velocity, cov


def _slopes(world: World, ranges: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of position and velocity fixes (e, 6) by each pseudorange and each range rate, (e, 6, s) each.

    The receiver itself is differentiated, measurement by measurement, so that its weights are in it. Zero for what is
    not used, and where there is no fix.
    """
    s = world.signals
    e, n = ranges.shape
    out = np.zeros((e, 6, n)), np.zeros((e, 6, n))
    fix = np.isfinite(_solve(world, ranges, rates)[0][:, 0])
    for i in range(n):
        here = s.used[:, i] & fix
        for part in (0, 1):
            sides = []
            for sign in (1.0, -1.0):
                measured = [ranges.copy(), rates.copy()]
                measured[part][:, i] += sign * _DIFFERENCE
                sides.append(_solve(world, *measured)[:2])
            (llh1, v1), (llh0, v0) = sides
            slope = np.concatenate([_metres(llh1 - llh0, llh0), v1 - v0], axis=1) / (2.0 * _DIFFERENCE)
            out[part][here, :, i] = slope[here]
    return out


def _white(slope: np.ndarray, sigma: np.ndarray, used: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Covariance of fixes (e, 6, 6) by independent errors of chosen (s,) sources; slope: (e, 6, s), others: (e, s)."""
    spread = slope * np.where(used & chosen, sigma, 0.0)[:, None, :]
    return spread @ np.swapaxes(spread, 1, 2)


class _Smoothed:
    """Range noise after Hatch's filter with what it has done to the state, (27 + s)^2 for satellites and pseudolites.

    The smoothed noise is x + w, w the carrier's own, and x = (1 - 1/n) x before + (v - w) / n with the code's v: a
    process of first order driven by white noise, one state more a source.
    """

    def __init__(self, counts: np.ndarray, sigma: np.ndarray, used: np.ndarray, slope: np.ndarray, ground: np.ndarray):
        """counts, sigma, used: (e, s) of `Signals`; slope: (e, 6, s) of fixes; ground: (s,) bool."""
        self.n = np.maximum(counts, 1)
        self.decay = np.where(counts > 1, 1.0 - 1.0 / self.n, 0.0)
        self.sigma, self.slope, self.used = sigma, slope, used
        self.chosen = (~ground, ground)
        size = _SIZE + ground.size
        self.cov = np.zeros((2, size, size))

    def carry(self, i: int, way: np.ndarray) -> None:
        """To epoch i, the state by `way`; the smoothed noises become those of the epoch."""
        decay = self.decay[i]
        self.cov[:, :_SIZE] = way @ self.cov[:, :_SIZE]
        self.cov[:, :, :_SIZE] = self.cov[:, :, :_SIZE] @ way.T
        self.cov[:, _SIZE:] *= decay[:, None]
        self.cov[:, :, _SIZE:] *= decay
        at = _SIZE + np.arange(decay.size)
        for cov, chosen in zip(self.cov, self.chosen, strict=True):
            code = np.where(chosen & self.used[i], self.sigma[i], 0.0)
            phase = np.where(chosen & self.used[i], CARRIER_SIGMA, 0.0)
            cov[at, at] += (code**2 + phase**2) / self.n[i] ** 2

    def fixed(self, i: int, here: np.ndarray, gain: np.ndarray, m: int) -> np.ndarray:
        """Weigh the fix of epoch i by `gain` (27, m), `here` (m, 27); returns what it adds to E[z z'] (m, m)."""
        slope = self.slope[i, :m]
        turn = np.eye(self.cov.shape[1])
        turn[:_SIZE, :_SIZE] -= gain @ here
        turn[:_SIZE, _SIZE:] = -gain @ slope
        seen = np.hstack([here, slope])
        out = np.zeros((m, m))
        for k, chosen in enumerate(self.chosen):
            phase = np.where(chosen & self.used[i], CARRIER_SIGMA**2, 0.0)
            # the carrier's noise is in the fix and, with the other sign, in the smoothed state
            with_phase = np.zeros((self.cov.shape[1], phase.size))
            with_phase[_SIZE:] = np.diag(-phase / self.n[i])
            cross = seen @ with_phase @ slope.T
            out += seen @ self.cov[k] @ seen.T + cross + cross.T + (slope * phase) @ slope.T
            direct = np.zeros_like(with_phase)
            direct[:_SIZE] = -gain @ slope
            cross = turn @ with_phase @ direct.T
            self.cov[k] = turn @ self.cov[k] @ turn.T + cross + cross.T + (direct * phase) @ direct.T
        return out

    def state(self) -> np.ndarray:
        """Covariances of the state (2, 27, 27)."""
        return self.cov[:, :_SIZE, :_SIZE]


def _metres(difference: np.ndarray, llh: np.ndarray) -> np.ndarray:
    """Small differences of geodetic coordinates as NED metres (e, 3)."""
    w = 1.0 - E2 * np.sin(llh[:, 0]) ** 2
    meridian = A * (1.0 - E2) / (w * np.sqrt(w))
    transverse = A / np.sqrt(w)
    return np.stack(
        [
            difference[:, 0] * (meridian + llh[:, 2]),
            short_way(difference[:, 1]) * (transverse + llh[:, 2]) * np.cos(llh[:, 0]),
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

    initial, gyro, accel: the truth, as for `landing.fly`. ground: (s,) bool, which sources are pseudolites. Raises
    AnalysisError where the result contradicts itself.
    """
    s = world.signals
    ranges, rates = without_noise(world)
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
    by_range, by_rate = _slopes(world, ranges, rates)
    noise = np.zeros((len(SOURCES), e, 6, 6))
    smoothed = None if s.smoothing is None else _Smoothed(s.smoothing, s.sigma, s.used, by_range, ground)
    for which, chosen in enumerate((~ground, ground)):
        noise[_RATES[which]] = _white(by_rate, s.rate_sigma, s.used, chosen)
        if smoothed is None:
            noise[_RANGES[which]] = _white(by_range, s.sigma, s.used, chosen)
    ephemeris = _messages(s, by_range)

    total, mean = _at_start(initial, gyro, accel)
    response = np.zeros((_SIZE, ephemeris.shape[2]))
    to_error = np.zeros((n, _SIZE))
    to_error[:, :n] = np.eye(n)
    to_error[_BIASES, _CONSTANT:_MARKOV] = np.eye(6)
    to_error[_BIASES, _MARKOV:] = np.eye(6)

    variance = np.empty((len(SOURCES), e + 1, n))
    means, sums = np.empty((e + 1, n)), np.empty((e + 1, n, n))
    nis = np.full(e, np.nan)

    def record(at: int, covariances: np.ndarray, mu: np.ndarray, messages: np.ndarray) -> None:
        error = to_error @ covariances @ to_error.T
        one = to_error @ messages
        error[_EPHEMERIS] = one @ one.T
        variance[:, at] = np.diagonal(error, axis1=1, axis2=2)
        sums[at] = error.sum(axis=0)
        means[at] = to_error @ mu

    record(0, total, mean, response)
    systematic = np.zeros(e)
    for i in range(e):
        way, added = _augmented(phi[i], gamma[i], q[i], density)
        total = way @ total @ way.T + added
        mean, response = way @ mean, way @ response
        if smoothed is not None:
            smoothed.carry(i, way)
            total[list(_RANGES)] = smoothed.state()
        m = degrees[i]
        if m:
            here = h[i, :m] @ to_error
            feedback = np.zeros((_SIZE, m))
            feedback[:n] = k[i, :, :m]
            keep = np.eye(_SIZE) - feedback @ here
            r = noise[:, i, :m, :m]
            fixed_off, messages_off = z[i, :m] + here @ mean, here @ response + ephemeris[i, :m]
            others = total.sum(axis=0) if smoothed is None else np.delete(total, _RANGES, axis=0).sum(axis=0)
            second = here @ others @ here.T + r.sum(axis=0) + messages_off @ messages_off.T
            total = keep @ total @ keep.T + feedback @ r @ feedback.T
            if smoothed is not None:
                second += smoothed.fixed(i, here, feedback, m)
                total[list(_RANGES)] = smoothed.state()
            expected = innovation[i, :m, :m]
            systematic[i] = fixed_off @ np.linalg.solve(expected, fixed_off)
            nis[i] = np.trace(np.linalg.solve(expected, second)) + systematic[i]
            mean = keep @ mean - feedback @ z[i, :m]
            response = keep @ response - feedback @ ephemeris[i, :m]
        if late:
            way, added = _augmented(ahead[0][i], ahead[1][i], ahead[2][i], density)
            record(i + 1, way @ total @ way.T + added, way @ mean, way @ response)
        else:
            record(i + 1, total, mean, response)
    out = Analysis(variance, means, sums, believed, nis, degrees)
    white = smoothed is None and s.space is None and settings.sigma_scale == 1.0
    same = np.allclose(settings.noise(), imu.process_noise(gyro, accel), rtol=1e-12, atol=0.0)
    start = np.allclose(believed[0], sums[0], rtol=1e-9, atol=0.0)
    # a constant bias beside a Markov one is more than the filter's one state a bias can follow
    followed = all(not t.markov or (not t.bias and t.fixed_bias is None) for t in (gyro, accel))
    _check(out, matched=bool(white and same and start and followed and np.all(systematic < 1e-3)))
    return out


def _check(analysis: Analysis, matched: bool) -> None:
    """Raise AnalysisError for undefined accuracies, and where a filter that believes what is true is not expected to
    have innovations of the size it expects itself."""
    if not np.all(np.isfinite(analysis.variance)):
        raise AnalysisError("the accuracy is undefined (nan); please report this scenario")
    some = analysis.degrees > 0
    per_degree = analysis.nis[some] / analysis.degrees[some]
    if matched and per_degree.size and np.abs(per_degree - 1.0).max() > _EXPECTED_NIS:
        worst = per_degree[np.argmax(np.abs(per_degree - 1.0))]
        raise AnalysisError(
            f"the filter believes what is true, yet its expected NIS is {worst:.3f} instead of 1: "
            "the analysis is wrong; please report this scenario"
        )


def _messages(signals: Signals, by_range: np.ndarray) -> np.ndarray:
    """Change of fixes (e, 6, 4 s) by one sigma of each error of orbits and clocks; (e, 6, 0) without them."""
    e = by_range.shape[0]
    if signals.space is None:
        return np.zeros((e, 6, 0))
    size = np.where(signals.used[:, :, None], signals.space, 0.0)
    return np.einsum("ers,esk->ersk", by_range, size).reshape(e, 6, -1)


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
