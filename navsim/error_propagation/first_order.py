"""First-order errors of runs: the linearised filter, driven by all random inputs of each run.

To first order the filter's gains are those along the truth (`error_propagation.linearised`). The error of a run is then
a linear function of its random inputs, and one pass through the same matrices computes it at every output. The state
contains minus the estimates of the sensor states, so the increments contribute the sensor errors, whatever their model.

Within an interval the error of a step enters velocity and attitude at its end, and position by the trapezoid rule, as
in `filter.interval.add_white`. The covariance analysis of the same flight has the covariance of these errors.

Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8. Derivation:
`docs/theory/control-variates.md`, section 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import alloc, as_simd, fma, small_vector
from navsim.filter.states import ATT, GYRO, MAX_MEASUREMENT_SIZE, POS, SENSORS, VEL


class LinearisedRun(NamedTuple):
    """A linearised filter, event by event: k events, i intervals, w measurements, s IMU steps, m fixes or ranges."""

    ahead: np.ndarray
    """(k,) see `records.Events`."""
    output: np.ndarray
    """(k,) row of the output, -1 for none."""
    interval: np.ndarray
    """(k,) row of the interval that the event ends, -1 for none."""
    weighed: np.ndarray
    """(k,) row of the measurement, -1 for none."""
    row: np.ndarray
    """(k,) row in the table of the measurement."""
    sample: np.ndarray
    """(k,) first IMU step of the interval."""
    steps: np.ndarray
    """(k,) number of IMU steps."""
    shares: np.ndarray
    """(k, 2) fractions of the first and the last step in the interval."""
    latest: np.ndarray
    transition: np.ndarray
    """(i, n, n)."""
    h: np.ndarray
    """(w, MOST, n)."""
    gain: np.ndarray
    """(w, n, MOST)."""
    time: np.ndarray
    """(s + 1,) s."""
    attitude: np.ndarray
    """(s, 3, 3) C_nb."""
    force: np.ndarray
    """(s, 3) NED, m/s2."""
    epoch: np.ndarray
    """(m,)."""
    source: np.ndarray
    """(m,) -1 for all."""
    by_range: np.ndarray
    """(m, MOST, s) for all sources, (m, MOST, 1) for one; also `by_rate`."""
    by_rate: np.ndarray
    aided: np.ndarray
    """(w, MOST) index among the numbers of the sensors beside the receiver, -1 for none."""


class Readings(NamedTuple):
    """Measurements of inertial sensors and receiver, real or without random errors: dtheta, dv (s, 3) increments;
    ranges, rates (e, s)."""

    dtheta: np.ndarray
    dv: np.ndarray
    ranges: np.ndarray
    rates: np.ndarray


@kernel
def _add_steps(route, i, dtheta, dv, exact_dtheta, exact_dv, q):
    """q (9,) <- errors of the navigation states by those of the increments in the interval that event i ends."""
    w, more = small_vector(q, 3), small_vector(q, 3)
    for j in range(SENSORS):
        q[j] = 0.0
    first, last = route.sample[i], route.sample[i] + route.steps[i] - 1
    for t in range(first, last + 1):
        part = route.shares[i, 0] if t == first else route.shares[i, 1] if t == last else 1.0
        dt = part * (route.time[t + 1] - route.time[t])
        n, e, d = route.force[t, 0], route.force[t, 1], route.force[t, 2]
        # v' = -f x theta
        more[0] = fma(d, q[ATT + 1], -e * q[ATT + 2])
        more[1] = fma(n, q[ATT + 2], -d * q[ATT])
        more[2] = fma(e, q[ATT], -n * q[ATT + 1])
        for j in range(3):
            q[POS + j] = fma(fma(more[j], 0.5 * dt, q[VEL + j]), dt, q[POS + j])
            q[VEL + j] = fma(more[j], dt, q[VEL + j])
        c = route.attitude[t]
        for k in range(3):
            w[k] = part * (dv[t, k] - exact_dv[t, k])
        for j in range(3):
            more[j] = fma(-c[j, 0], w[0], fma(-c[j, 1], w[1], -c[j, 2] * w[2]))
            q[VEL + j] += more[j]
            q[POS + j] = fma(more[j], 0.5 * dt, q[POS + j])
        for k in range(3):
            w[k] = part * (dtheta[t, k] - exact_dtheta[t, k])
        for j in range(3):
            q[ATT + j] += fma(-c[j, 0], w[0], fma(-c[j, 1], w[1], -c[j, 2] * w[2]))


@kernel
def _propagate(phi, q, x, work):
    """x (n,) <- Phi x + q, q (9,) of the navigation states."""
    n = x.shape[0]
    for i in range(n):
        t = phi[i, 0] * x[0]
        for j in range(1, n):
            if phi[i, j] != 0.0:
                t = fma(phi[i, j], x[j], t)
        work[i] = t
    for i in range(n):
        x[i] = work[i] + q[i] if i < SENSORS else work[i]


@kernel
def _correct(h, gain, d, x):
    """x (n,) <- x - K (H x + d)."""
    for a in range(MAX_MEASUREMENT_SIZE):
        for j in range(x.shape[0]):
            if h[a, j] != 0.0:
                d[a] = fma(h[a, j], x[j], d[a])
    for a in range(MAX_MEASUREMENT_SIZE):
        for j in range(x.shape[0]):
            if gain[j, a] != 0.0:
                x[j] = fma(-gain[j, a], d[a], x[j])


@kernel
def propagate_errors(route, measured, exact, used, aided, x, errors):
    """First-order errors of position and velocity of runs in lanes.

    - `route`: the linearised filter.
    - `measured`, `exact`: `Readings` of the runs, and those without random errors, which may be numbers for all runs.
    - `used` (e, s): bool, ranges that are received.
    - `aided` (m,) of lanes: changes of innovations by sensors beside the receiver.
    - `x` (2, n) of lanes: initial errors, and room for the copy that predicts ahead; overwritten.
    - `errors` (o, 6) of lanes, out: NED, m, m/s, truth minus estimate, at the outputs, without their mean.
    """
    x, errors, aided = as_simd(x), as_simd(errors), as_simd(aided)
    dtheta, dv, ranges, rates = (
        as_simd(measured.dtheta), as_simd(measured.dv), as_simd(measured.ranges), as_simd(measured.rates),
    )  # fmt: skip
    exact_dtheta, exact_dv, exact_ranges, exact_rates = (
        as_simd(exact.dtheta), as_simd(exact.dv), as_simd(exact.ranges), as_simd(exact.rates),
    )  # fmt: skip
    q, d, work = small_vector(x, SENSORS), small_vector(x, MAX_MEASUREMENT_SIZE), alloc(x, (x.shape[1],))
    before = 0
    for i in range(route.ahead.shape[0]):
        ahead = 1 if route.ahead[i] else 0
        if ahead > before:
            for j in range(x.shape[1]):
                x[1, j] = x[0, j]
        before = ahead
        here, at, w, row = x[ahead], route.interval[i], route.weighed[i], route.row[i]
        if at >= 0:
            _add_steps(route, i, dtheta, dv, exact_dtheta, exact_dv, q)
            _propagate(route.transition[at], q, here, work)
        if route.output[i] >= 0:
            for j in range(errors.shape[1]):
                errors[route.output[i], j] = here[POS + j]
        if w < 0:
            continue
        for a in range(MAX_MEASUREMENT_SIZE):
            d[a] = 0.0
            if route.aided[w, a] >= 0:
                d[a] = aided[route.aided[w, a]]
        if route.aided[w, 0] < 0:
            e, first, last = route.epoch[row], 0, used.shape[1]
            if route.source[row] >= 0:
                first, last = route.source[row], route.source[row] + 1
            for s in range(first, last):
                if not used[e, s]:
                    continue
                late, faster = ranges[e, s] - exact_ranges[e, s], rates[e, s] - exact_rates[e, s]
                for a in range(MAX_MEASUREMENT_SIZE):
                    if route.by_range[row, a, s - first] != 0.0:
                        d[a] = fma(route.by_range[row, a, s - first], late, d[a])
                    if route.by_rate[row, a, s - first] != 0.0:
                        d[a] = fma(route.by_rate[row, a, s - first], faster, d[a])
        t = route.latest[i]
        for a in range(MAX_MEASUREMENT_SIZE):
            for k in range(3):
                if route.h[w, a, GYRO + k] != 0.0:
                    turned = (dtheta[t, k] - exact_dtheta[t, k]) / (route.time[t + 1] - route.time[t])
                    d[a] = fma(route.h[w, a, GYRO + k], turned, d[a])
        _correct(route.h[w], route.gain[w], d, here)
