"""Extended Kalman filter and smoother of one range at a time.

The filter takes each range at its own time, so that no epoch with all sources is needed. Its states, in this order
(`ranging.model`):

- the position and its derivatives; an acceleration may fade [3],
- the clocks as pairs of offset and rate,
- constant biases, and Gauss-Markov errors,
- errors smoothed by the receiver: the first Gauss-Markov errors behind a low-pass filter of first order.

Outliers are part of the measurement model: the noise of a range is a mixture of Gaussians, and the update matches mean
and covariance of the posterior mixture [1]. The likelihood of the ranges follows from the same weights. The smoother is
that of Bryson and Frazier [2], which inverts no covariance.

Sources:

- [1] Sorenson & Alspach, Automatica 7 (1971); Bar-Shalom & Fortmann, Tracking and Data Association (1988), section 6.4.
- [2] Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973).
- [3] Singer, Estimating optimal tracking filter performance for manned maneuvering targets, IEEE TAES 6 (1970).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel


class Dynamics(NamedTuple):
    """Motion and errors between ranges."""

    order: int
    """Order of the motion: 2 for a velocity, 3 for an acceleration."""
    motion: np.ndarray
    """(3,) noise densities of the highest derivative."""
    motion_time: float
    """Correlation time of an acceleration, s; inf: it does not fade."""
    clocks: int
    """Number of clocks."""
    clock_noise: np.ndarray
    """(c, c, 2) noise densities of their offsets and rates."""
    first_markov: int
    """The first Gauss-Markov state."""
    markov_time: np.ndarray
    """(k,) correlation times of the Gauss-Markov errors, s."""
    markov_sigma: np.ndarray
    """(k,) their standard deviations, m."""
    smoothed: int
    """How many of them, from the first on, the receiver smooths."""
    smoothing_time: float
    """Time constant of its smoothing, s."""


class RangeNoise(NamedTuple):
    """Noise of a range: shares (k,), means (k,) and standard deviations by source (s, k) of its Gaussians, the usual
    one first."""

    share: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray


class RangeData(NamedTuple):
    """Ranges in order of time."""

    time: np.ndarray
    """(m,) s."""
    source: np.ndarray
    """(m,): its index."""
    range: np.ndarray
    """(m,) m."""
    scale: np.ndarray
    """(m,): factor of the range's sigma."""
    position: np.ndarray
    """(s, 3): of the sources, m."""
    row: np.ndarray
    """(m, n): derivative of each range by the states behind the motion."""


class DistanceLines(NamedTuple):
    """Distances as linear functions of the position: slope (m, 3), offset (m,) m, variance of the rest (m,) m2.

    Beyond the rows that there are, the filter linearises each distance about its own prediction."""

    slope: np.ndarray
    offset: np.ndarray
    variance: np.ndarray


class RangeHistory(NamedTuple):
    """Filter output after each range, with the row of its update for the smoother."""

    state: np.ndarray
    """(m, n)."""
    covariance: np.ndarray
    """(m, n, n)."""
    row: np.ndarray
    """(m, n)."""
    gain: np.ndarray
    """(m, n): P times the row."""
    pull: np.ndarray
    """(m,): gain of the state along it."""
    shrink: np.ndarray
    """(m,): gain of the covariance along it."""


LEGENDRE = np.array(np.polynomial.legendre.leggauss(5))
"""Nodes and weights (2, 5) of the rule of Gauss and Legendre."""


@kernel
def _fading(dt, tau, out):
    """Change (3,) of position, velocity and acceleration over dt, s, by an acceleration of 1 m/s2 that fades with the
    time constant tau, s."""
    out[2] = np.exp(-dt / tau)
    out[1] = -tau * np.expm1(-dt / tau)
    out[0] = tau * (dt - out[1])


@kernel
def _passed(dt, tau, smoothing):
    """What a smoothed error takes over dt from an error of 1 m that fades with tau; time constants and dt in s."""
    slow, fast = min(dt / smoothing, dt / tau), max(dt / smoothing, dt / tau)
    x = fast - slow
    return dt / smoothing * np.exp(-slow) * (-np.expm1(-x) / x if x > 0.0 else 1.0)


@kernel
def smoothed_variance(variance, tau, smoothing):
    """Variance of a smoothed error, and its covariance with the error of this variance; time constants in s."""
    return variance * tau / (tau + smoothing)


@kernel
def _changes(dynamics, dt, out):
    """Coefficients (5, k) of the transition over dt, s.

    Rows: decay of each Gauss-Markov error; what its smoothed error takes of it; decay of the smoothed error; the
    effect of an acceleration on position, velocity and itself; of a velocity on the position."""
    for i in range(dynamics.markov_time.shape[0]):
        out[0, i] = np.exp(-dt / dynamics.markov_time[i])
    for i in range(dynamics.smoothed):
        out[1, i] = _passed(dt, dynamics.markov_time[i], dynamics.smoothing_time)
        out[2, i] = np.exp(-dt / dynamics.smoothing_time)
    out[3, 0], out[3, 1], out[3, 2] = 0.5 * dt * dt, dt, 1.0
    if dynamics.motion_time < np.inf:
        _fading(dt, dynamics.motion_time, out[3])
    out[4, 0] = dt


@kernel
def _propagate_rows(dynamics, change, m):
    """Rows of a matrix (n, k) by the transition of these changes, in place."""
    width, order, dt = m.shape[1], dynamics.order, change[4, 0]
    for i in range(3):
        for j in range(width):
            m[i, j] += dt * m[3 + i, j]
            if order > 2:
                m[i, j] += change[3, 0] * m[6 + i, j]
                m[3 + i, j] += change[3, 1] * m[6 + i, j]
                m[6 + i, j] *= change[3, 2]
    for c in range(dynamics.clocks):
        a = 3 * order + 2 * c
        for j in range(width):
            m[a, j] += dt * m[a + 1, j]
    first, count = dynamics.first_markov, dynamics.markov_time.shape[0]
    for i in range(dynamics.smoothed):
        for j in range(width):
            m[first + count + i, j] = change[2, i] * m[first + count + i, j] + change[1, i] * m[first + i, j]
    for i in range(count):
        for j in range(width):
            m[first + i, j] *= change[0, i]


@kernel
def _transpose_rows(dynamics, change, m):
    """Rows of a matrix (n, k) by the transposed transition of these changes, in place."""
    width, order, dt = m.shape[1], dynamics.order, change[4, 0]
    for i in range(3):
        for j in range(width):
            if order > 2:
                m[6 + i, j] = change[3, 2] * m[6 + i, j] + change[3, 1] * m[3 + i, j] + change[3, 0] * m[i, j]
            m[3 + i, j] += dt * m[i, j]
    for c in range(dynamics.clocks):
        a = 3 * order + 2 * c
        for j in range(width):
            m[a + 1, j] += dt * m[a, j]
    first, count = dynamics.first_markov, dynamics.markov_time.shape[0]
    for i in range(count):
        for j in range(width):
            m[first + i, j] *= change[0, i]
    for i in range(dynamics.smoothed):
        for j in range(width):
            m[first + i, j] += change[1, i] * m[first + count + i, j]
            m[first + count + i, j] *= change[2, i]


@kernel
def _add_fading(dynamics, dt, p):
    """Add the noise of an interval dt, s, behind accelerations that fade to P (n, n).

    It is the integral of the squared response to an impulse, by the Gauss-Legendre rule of five points. No step is
    longer than the correlation time. The closed form would lose its digits over short intervals."""
    steps = int(np.ceil(dt / dynamics.motion_time))
    reply, square = np.empty(3), np.zeros((3, 3))
    for step in range(steps):
        for k in range(5):
            _fading(dt / steps * (step + 0.5 + 0.5 * LEGENDRE[0, k]), dynamics.motion_time, reply)
            for a in range(3):
                for b in range(3):
                    square[a, b] += 0.5 * dt / steps * LEGENDRE[1, k] * reply[a] * reply[b]
    for i in range(3):
        for a in range(3):
            for b in range(3):
                p[3 * a + i, 3 * b + i] += dynamics.motion[i] * square[a, b]


@kernel
def _add_lasting(dynamics, dt, p):
    """Add the noise of an interval dt, s, behind velocities or accelerations that do not fade to P (n, n)."""
    order = dynamics.order
    for i in range(3):
        q = dynamics.motion[i]
        for a in range(order):
            for b in range(order):
                power, scale = 1, 1.0
                for o in range(a, order - 1):
                    power += 1
                    scale *= order - 1 - o
                for o in range(b, order - 1):
                    power += 1
                    scale *= order - 1 - o
                p[3 * a + i, 3 * b + i] += q * dt**power / (scale * power)


@kernel
def _add_noise(dynamics, change, dt, p):
    """Add the noise of an interval dt, s, with these changes to P (n, n)."""
    order = dynamics.order
    if dynamics.motion_time < np.inf:
        _add_fading(dynamics, dt, p)
    else:
        _add_lasting(dynamics, dt, p)
    for c in range(dynamics.clocks):
        for d in range(dynamics.clocks):
            phase, frequency = dynamics.clock_noise[c, d]
            a, b = 3 * order + 2 * c, 3 * order + 2 * d
            p[a, b] += phase * dt + frequency * dt * dt * dt / 3.0
            p[a, b + 1] += 0.5 * frequency * dt * dt
            p[a + 1, b] += 0.5 * frequency * dt * dt
            p[a + 1, b + 1] += frequency * dt
    for i in range(dynamics.markov_time.shape[0]):
        a = dynamics.first_markov + i
        p[a, a] += dynamics.markov_sigma[i] ** 2 * (1.0 - change[0, i] * change[0, i])
    for i in range(dynamics.smoothed):
        # what the transition leaves of the stationary covariance [[s, c], [c, c]], taken from it
        s, tau = dynamics.markov_sigma[i] ** 2, dynamics.markov_time[i]
        c = smoothed_variance(s, tau, dynamics.smoothing_time)
        left, passed, kept = change[0, i], change[1, i], change[2, i]
        a = dynamics.first_markov + i
        b = a + dynamics.markov_time.shape[0]
        cross = c - left * (passed * s + kept * c)
        p[a, b] += cross
        p[b, a] += cross
        p[b, b] += c - passed * passed * s - 2.0 * passed * kept * c - kept * kept * c


@kernel
def _transpose(p, q):
    """Copy the transpose of P (n, n) to Q (n, n)."""
    for i in range(p.shape[0]):
        for j in range(p.shape[0]):
            q[j, i] = p[i, j]


@kernel
def _symmetrise(p, q):
    """Copy the symmetric part of P (n, n) to Q (n, n): rounding would let the other part grow."""
    for i in range(p.shape[0]):
        for j in range(i + 1):
            q[i, j] = 0.5 * (p[i, j] + p[j, i])
            q[j, i] = q[i, j]


@kernel
def filter_ranges(data, dynamics, noise, lines, x, p, out, innovation, variance, weight, surprise):
    """Filter all ranges from the state x (n,) and covariance P (n, n) of the first one's time, both in place.

    - `data`, `dynamics`, `noise`, `lines`: `RangeData`, `Dynamics`, `RangeNoise`, `DistanceLines`
    - `out`: `RangeHistory`, without rows to keep none
    - `innovation` (m,): m; `variance` (m,): of the innovation with the usual noise, m2
    - `weight` (m,): probability that the range has the usual noise
    - `surprise` (m,): minus the logarithm of the range's likelihood
    """
    n = x.shape[0]
    keep, linear = out.pull.shape[0] > 0, lines.offset.shape[0]
    row, gain, column = np.empty(n), np.empty(n), np.empty((n, 1))
    change = np.empty((5, max(3, dynamics.markov_time.shape[0])))
    q = np.empty((n, n))
    kinds = noise.share.shape[0]
    likelihood, sigma = np.empty(kinds), np.empty(kinds)
    for k in range(data.time.shape[0]):
        dt = data.time[k] - data.time[k - 1] if k > 0 else 0.0
        if dt > 0.0:
            _changes(dynamics, dt, change)
            column[:, 0] = x
            _propagate_rows(dynamics, change, column)
            x[:] = column[:, 0]
            _propagate_rows(dynamics, change, p)
            _transpose(p, q)
            _propagate_rows(dynamics, change, q)
            _symmetrise(q, p)
            _add_noise(dynamics, change, dt, p)
        rest = 0.0
        row[:] = data.row[k]
        if k < linear:
            predicted, rest = lines.offset[k], lines.variance[k]
            for i in range(3):
                row[i] = lines.slope[k, i]
                predicted += row[i] * x[i]
        else:
            predicted = 0.0
            for i in range(3):
                row[i] = x[i] - data.position[data.source[k], i]
                predicted += row[i] * row[i]
            predicted = np.sqrt(max(predicted, 1e-12))
            for i in range(3):
                row[i] /= predicted
        for i in range(3, n):
            predicted += row[i] * x[i]
        residual = data.range[k] - predicted
        spread = rest
        for i in range(n):
            gain[i] = 0.0
            for j in range(n):
                gain[i] += p[i, j] * row[j]
            spread += row[i] * gain[i]
        largest = -np.inf
        for c in range(kinds):
            sigma[c] = noise.sigma[data.source[k], c]
            s = spread + (sigma[c] * data.scale[k]) ** 2
            e = residual - noise.mean[c]
            likelihood[c] = -np.inf
            if noise.share[c] > 0.0:
                likelihood[c] = np.log(noise.share[c]) - 0.5 * (e * e / s + np.log(2.0 * np.pi * s))
            largest = max(largest, likelihood[c])
        whole = 0.0
        for c in range(kinds):
            likelihood[c] = np.exp(likelihood[c] - largest)
            whole += likelihood[c]
        surprise[k] = -largest - np.log(whole)
        pull, shrink, square = 0.0, 0.0, 0.0
        for c in range(kinds):
            s = spread + (sigma[c] * data.scale[k]) ** 2
            e = (residual - noise.mean[c]) / s
            share = likelihood[c] / whole
            pull += share * e
            shrink += share / s
            square += share * e * e
        shrink -= square - pull * pull
        innovation[k], variance[k] = residual, spread + (sigma[0] * data.scale[k]) ** 2
        weight[k] = likelihood[0] / whole
        for i in range(n):
            x[i] += gain[i] * pull
            for j in range(n):
                p[i, j] -= shrink * gain[i] * gain[j]
        if keep:
            out.state[k], out.covariance[k], out.row[k], out.gain[k] = x, p, row, gain
            out.pull[k], out.shrink[k] = pull, shrink


@kernel
def smooth_ranges(data, dynamics, out, state, covariance):
    """Smoothed state (m, n) and covariance (m, s, s) of its first s at each range, from the filter's `RangeHistory`."""
    m, n = out.state.shape
    shown = covariance.shape[1]
    pull, shrink, q = np.zeros((n, 1)), np.zeros((n, n)), np.empty((n, n))
    along, change = np.empty(n), np.empty((5, max(3, dynamics.markov_time.shape[0])))
    half = np.empty((n, n))
    for k in range(m - 1, -1, -1):
        p, row, gain = out.covariance[k], out.row[k], out.gain[k]
        for i in range(n):
            state[k, i] = out.state[k, i]
            for j in range(n):
                state[k, i] -= p[i, j] * pull[j, 0]
        for i in range(shown):
            for j in range(n):
                half[i, j] = 0.0
                for a in range(n):
                    half[i, j] += p[i, a] * shrink[a, j]
        for i in range(shown):
            for j in range(shown):
                covariance[k, i, j] = p[i, j]
                for a in range(n):
                    covariance[k, i, j] -= half[i, a] * p[a, j]
        projected, double = 0.0, 0.0
        for i in range(n):
            projected += gain[i] * pull[i, 0]
            along[i] = 0.0
            for j in range(n):
                along[i] += shrink[i, j] * gain[j]
        for i in range(n):
            double += gain[i] * along[i]
        g = out.shrink[k]
        for i in range(n):
            pull[i, 0] -= row[i] * (g * projected + out.pull[k])
            for j in range(n):
                shrink[i, j] += row[i] * row[j] * (g + g * g * double) - g * (row[i] * along[j] + along[i] * row[j])
        dt = data.time[k] - data.time[k - 1] if k > 0 else 0.0
        if dt > 0.0:
            _changes(dynamics, dt, change)
            _transpose_rows(dynamics, change, pull)
            _transpose_rows(dynamics, change, shrink)
            _transpose(shrink, q)
            _transpose_rows(dynamics, change, q)
            _symmetrise(q, shrink)


@kernel
def smooth_mean(data, dynamics, out, until, state):
    """Smoothed states (until, n) by the ranges 0 .. until - 1, from a `RangeHistory`, without covariances."""
    n = out.state.shape[1]
    pull, change = np.zeros((n, 1)), np.empty((5, max(3, dynamics.markov_time.shape[0])))
    for k in range(until - 1, -1, -1):
        p, row, gain = out.covariance[k], out.row[k], out.gain[k]
        projected = 0.0
        for i in range(n):
            state[k, i] = out.state[k, i]
            projected += gain[i] * pull[i, 0]
            for j in range(n):
                state[k, i] -= p[i, j] * pull[j, 0]
        for i in range(n):
            pull[i, 0] -= row[i] * (out.shrink[k] * projected + out.pull[k])
        dt = data.time[k] - data.time[k - 1] if k > 0 else 0.0
        if dt > 0.0:
            _changes(dynamics, dt, change)
            _transpose_rows(dynamics, change, pull)
