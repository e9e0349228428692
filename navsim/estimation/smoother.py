"""`kind: map`: the batch maximum-a-posteriori smoother, the reference of what is attainable.

The whole flight is one least-squares problem: the initial estimate, the sensor noise of every interval and every
fix, each weighed by what the filter believes of it. It is solved by Gauss-Newton, whose normal equations are those
of a Kalman filter and a backward pass linearised along the latest trajectory [1]; the first trajectory is that of an
error-state filter, smoothed. At the solution nothing is linearised at a wrong place any more, so what is left of
inconsistency is the curvature of the posterior itself. Every output uses all fixes, also the later ones; the
last output of a flight is what a filter could at best know at that time.

Sources: [1] Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optim. 4 (1994). [2] Rauch, Tung &
Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA J. 3 (1965).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core import states
from navsim.core.covariance import SIZE, STRIDE, carry_errors, gain, joseph, reset
from navsim.core.jit import kernel
from navsim.core.linear import cholesky, solve_cholesky, solve_lower
from navsim.core.strapdown import MID_N
from navsim.estimation import error_state
from navsim.estimation.loosely_coupled import (
    ESKF,
    MAP,
    NO_FIX,
    REJECTED,
    RTS,
    TFG,
    TIME_TOLERANCE,
    USED,
    advance,
    keep_misfit,
    observe,
    plain_error,
    record,
)

PASSES = {MAP: 30, RTS: 1}
"""Passes over the flight that each kind makes at most."""
_CONVERGED = 1e-3
"""Stop once no state of any node moves by more than this many sigmas."""


@kernel
def _difference(a, b, out):
    """The plain error (15,) that carries navigation state b to a."""
    plain_error(
        a[states.NAV_LLH : states.NAV_LLH + 3],
        a[states.NAV_VEL : states.NAV_VEL + 3],
        a[states.NAV_QUAT : states.NAV_QUAT + 4],
        a[states.NAV_GYRO : states.NAV_GYRO + 6],
        b,
        out,
    )


@kernel
def _fly(until, imu_time, dtheta, dv, nav, cursor, previous, noise, scratch, c_nb, way, added, width):
    """Mechanise to `until`; way (240,): transition of the plain errors, added (240,): covariance gathered."""
    way[:] = 0.0
    added[:] = 0.0
    for i in range(states.N):
        way[(STRIDE + 1) * i] = 1.0
    phi = scratch[MID_N : MID_N + SIZE]
    work = scratch[MID_N + SIZE : MID_N + 2 * SIZE]
    last = imu_time.shape[0] - 1
    while int(cursor[0]) < last and cursor[1] < until - TIME_TOLERANCE:
        k = int(cursor[0])
        end = min(imu_time[k + 1], until)
        advance(ESKF, end, imu_time, dtheta, dv, nav, added, cursor, previous, noise, scratch, c_nb, width)
        carry_errors(phi, noise[min(k, noise.shape[0] - 1)], cursor[2], way, work, width)


@kernel
def _times(way, p, out):
    """out = way p, all (240,)."""
    for i in range(states.N):
        o = STRIDE * i
        for j in range(STRIDE):
            out[o + j] = 0.0
        for c in range(states.N):
            f = way[o + c]
            if f != 0.0:
                for j in range(STRIDE):
                    out[o + j] += f * p[STRIDE * c + j]


@kernel
def _predict(way, added, p, carried, out):
    """out = way p way' + added; carried = way p. All (240,)."""
    _times(way, p, carried)
    for i in range(states.N):
        for j in range(i + 1):
            t = added[STRIDE * i + j]
            for c in range(states.N):
                t += carried[STRIDE * i + c] * way[STRIDE * j + c]
            out[STRIDE * i + j] = t
            out[STRIDE * j + i] = t


@kernel
def _smoothing_gain(carried, predicted, factor, out):
    """out = P way' predicted^-1 (15, 15) from carried = way P; False where `predicted` is not positive definite."""
    for i in range(states.N):
        for j in range(i + 1):
            factor[i, j] = predicted[STRIDE * i + j]
    if not cholesky(factor, states.N):
        return False
    for i in range(states.N):
        for j in range(states.N):
            out[i, j] = carried[STRIDE * j + i]
        solve_cholesky(factor, states.N, out[i])
    return True


@kernel
def _smooth_covariance(gains, predicted, later, p):
    """p <- p + A (later - predicted) A', symmetric."""
    d = np.empty((states.N, states.N))
    for i in range(states.N):
        for j in range(states.N):
            t = 0.0
            for c in range(states.N):
                t += gains[i, c] * (later[STRIDE * c + j] - predicted[STRIDE * c + j])
            d[i, j] = t
    for i in range(states.N):
        for j in range(i + 1):
            t = 0.5 * (p[STRIDE * i + j] + p[STRIDE * j + i])
            for c in range(states.N):
                t += d[i, c] * gains[j, c]
            p[STRIDE * i + j] = t
            p[STRIDE * j + i] = t


@kernel
def _nodes(fix_time, out_time):
    """Times of fixes and outputs in one order: time (n,), fix (n,) and output (n,) index or -1; node 0 is time 0."""
    e = fix_time.shape[0]
    time = np.zeros(2 * e + 1)
    fix = np.full(2 * e + 1, -1)
    output = np.full(2 * e + 1, -1)
    output[0] = 0
    n = 1
    f, o = 0, 0
    while o < e:
        if f < e and fix_time[f] <= out_time[o] + TIME_TOLERANCE:
            time[n] = fix_time[f]
            fix[n] = f
            f += 1
            if out_time[o] - time[n] < TIME_TOLERANCE:
                o += 1
                output[n] = o
        else:
            time[n] = out_time[o]
            o += 1
            output[n] = o
        n += 1
    return time[:n], fix[:n], output[:n]


@kernel
def run(
    imu_time, dtheta, dv, nav, p, noise,
    fix_time, fix_llh, fix_velocity, fix_cov, with_velocity, latency, lever, gate, max_rejected,
    truth_llh, truth_velocity, truth_quaternion, truth_bias,
    out, width, iterations,
):  # fmt: skip
    """Smooth one run; arguments and outputs as of `loosely_coupled.run`. NEES is judged in two-frames coordinates.

    iterations: most passes over the flight; 1 is the fixed-interval smoother of [2] on the filter's own estimates,
    more iterate it towards the maximum a posteriori [1]. Fixes rejected by the gate of the first pass stay rejected.
    Innovations, squared and as misfit, are those of the first pass.
    """
    error, sigma, cross, nees, nees_pv, nees_group, innovation, degrees, status, estimate, misfit, misfit_sigma = out
    node_time, node_fix, node_output = _nodes(fix_time, fix_time + latency)
    n = node_time.shape[0]
    nodes = np.empty((n, states.NAV_N))
    filtered, predicted, carried = np.zeros((n, SIZE)), np.zeros((n, SIZE)), np.zeros((n, SIZE))
    mean, mean_predicted = np.zeros((n, states.N)), np.zeros((n, states.N))
    gains = np.empty((n, states.N, states.N))
    way, added, prior = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE)
    factor = np.empty((states.N, states.N))
    h, z, r, s = np.empty((6, states.N)), np.empty(6), np.empty((6, 6)), np.empty((6, 6))
    k, pht, work = np.empty((states.N, 6)), np.empty((states.N, 6)), np.empty((states.N, 6))
    c_nb, jac, columns = np.empty((3, 3)), np.empty((3, 3)), np.empty((states.N, 3))
    scratch = np.zeros(MID_N + 3 * SIZE)
    previous, cursor = np.empty(6), np.zeros(3)
    here, x, own = np.empty(states.NAV_N), np.empty(states.N), np.empty(states.N)

    nav[states.NAV_HELD] = 1.0
    nav[states.NAV_HELD + 1 :] = 0.0
    start = nav.copy()
    innovation[:] = np.nan
    misfit[:] = np.nan
    misfit_sigma[:] = np.nan
    degrees[:] = 0
    status[:] = NO_FIX
    rejected = 0
    for iteration in range(iterations):
        # the first pass has no trajectory yet: it follows its own estimate
        first = iteration == 0
        cursor[0] = 0.0
        cursor[1] = imu_time[0]
        cursor[2] = imu_time[1] - imu_time[0]
        if first:
            nodes[0] = start
        for i in range(3):
            previous[i] = dtheta[0, i] - nodes[0, 10 + i] * cursor[2]
            previous[3 + i] = dv[0, i] - nodes[0, 13 + i] * cursor[2]
        # prior: exp(d) exp(moved) = exp(theta), theta ~ N(0, P)
        _difference(nodes[0], start, x)
        filtered[0] = p
        reset(filtered[0], x[states.ATT], x[states.ATT + 1], x[states.ATT + 2], jac, columns)
        for i in range(states.N):
            mean[0, i] = -x[i]
        for node in range(1, n):
            here[:] = nodes[node - 1]
            _fly(node_time[node], imu_time, dtheta, dv, here, cursor, previous, noise, scratch, c_nb, way, added, width)
            _predict(way, added, filtered[node - 1], carried[node], predicted[node])
            if first:
                nodes[node] = here
            _difference(here, nodes[node], x)
            for i in range(states.N):
                t = x[i]
                for c in range(states.N):
                    t += way[STRIDE * i + c] * mean[node - 1, c]
                mean_predicted[node, i] = t
                mean[node, i] = t
            filtered[node] = predicted[node]
            e = node_fix[node]
            if e < 0 or math.isnan(fix_llh[e, 0]) or (not first and status[e] != USED):
                continue
            m = observe(
                nodes[node], previous, cursor[2], c_nb, lever, fix_llh[e], fix_velocity[e], fix_cov[e], with_velocity,
                z, h, r,
            )  # fmt: skip
            for i in range(m):
                for c in range(states.N):
                    z[i] -= h[i, c] * mean[node, c]
            if not gain(filtered[node], h, r, m, pht, s, k):
                continue
            if first:
                keep_misfit(fix_velocity[e], m, z, s, misfit[e], misfit_sigma[e])
            for i in range(states.N):
                x[i] = 0.0
                for a in range(m):
                    x[i] += k[i, a] * z[a]
            solve_lower(s, m, z)
            q = 0.0
            for a in range(m):
                q += z[a] * z[a]
            innovation[e] = q
            degrees[e] = m
            if first:
                if q > gate[m] and rejected < max_rejected:
                    status[e] = REJECTED
                    rejected += 1
                    continue
                status[e] = USED
                rejected = 0
            joseph(filtered[node], h, r, m, pht, k, work)
            if first:
                error_state.inject(nodes[node], x)
                reset(filtered[node], x[states.ATT], x[states.ATT + 1], x[states.ATT + 2], jac, columns)
                for i in range(states.N):
                    mean_predicted[node, i] = -x[i]
                    mean[node, i] = 0.0
            else:
                for i in range(states.N):
                    mean[node, i] += x[i]
        moved = 0.0
        for node in range(n - 1, -1, -1):
            if node < n - 1:
                if not _smoothing_gain(carried[node + 1], predicted[node + 1], factor, gains[node]):
                    # no covariance, no answer: nothing of what the arrays held before is left in them
                    error[:], sigma[:], cross[:], estimate[:] = np.nan, np.nan, np.nan, np.nan
                    nees[:], nees_pv[:], nees_group[:] = np.nan, np.nan, np.nan
                    return
                for i in range(states.N):
                    t = 0.0
                    for c in range(states.N):
                        t += gains[node, i, c] * (mean[node + 1, c] - mean_predicted[node + 1, c])
                    mean[node, i] += t
            for i in range(states.N):
                moved = max(moved, abs(mean[node, i]) / math.sqrt(filtered[node, (STRIDE + 1) * i]))
        for node in range(n):
            error_state.inject(nodes[node], mean[node])
        if not first and moved < _CONVERGED:
            break
    p[:] = filtered[n - 1]
    prior[:] = p
    for node in range(n - 1, -1, -1):
        if node < n - 1:
            _smooth_covariance(gains[node], predicted[node + 1], prior, filtered[node])
            prior[:] = filtered[node]
        o = node_output[node]
        if o >= 0:
            estimate[o] = nodes[node]
            nees[o], nees_pv[o] = record(
                TFG, filtered[node], nodes[node], truth_llh[o], truth_velocity[o], truth_quaternion[o], truth_bias[o],
                error[o], sigma[o], cross[o], nees_group[o], factor, own, x,
            )  # fmt: skip
    nav[:] = nodes[n - 1]
