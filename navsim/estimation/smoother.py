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

from navsim.core.covariance import SIZE, STRIDE, carry_errors, gain, joseph, reset, square
from navsim.core.jit import kernel
from navsim.core.linear import cholesky, solve_cholesky
from navsim.core.states import (
    A_D,
    A_E,
    A_N,
    NAV_HELD,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
)
from navsim.core.strapdown import MID_N
from navsim.estimation import error_state
from navsim.estimation.filter_loop import advance, keep_innovation, set_off, whitened_square
from navsim.estimation.judge import plain_error
from navsim.estimation.observations import MOST, observe
from navsim.estimation.records import ESKF, MAP, NOT_USED, OUTPUT, REJECTED, RTS, TIME_TOLERANCE, USED

PASSES = {RTS: 1, MAP: 30}
"""Passes over the flight that each kind of smoother makes at most."""
_CONVERGED = 1e-3
"""Stop once no state of any node moves by more than this many sigmas."""


@kernel
def difference(a, b, out):
    """The plain error (n,) that carries navigation state b to a."""
    plain_error(a[NAV_LLH:NAV_VEL], a[NAV_VEL:NAV_QUAT], a[NAV_QUAT:NAV_HELD], a[NAV_SENSORS:], b, out)


@kernel
def _fly(until, imu, model, nav, cursor, increments, scratch, c_nb, inverse, phi_total, added, work, transition):
    """Mechanise to `until`; transition (n, n) of the plain errors, added (SIZE,): covariance gathered.

    phi_total, work: (SIZE,) space.
    """
    n = transition.shape[0]
    phi_total[:] = 0.0
    added[:] = 0.0
    for i in range(n):
        phi_total[(STRIDE + 1) * i] = 1.0
    phi = scratch[MID_N : MID_N + SIZE]
    last = imu.time.shape[0] - 1
    while int(cursor[0]) < last and cursor[1] < until - TIME_TOLERANCE:
        end = min(imu.time[int(cursor[0]) + 1], until)
        advance(ESKF, end, imu, model, nav, added, cursor, increments, scratch, c_nb, inverse)
        carry_errors(phi, model.declared, cursor[2], phi_total, n, work)
    square(phi_total, transition)


@kernel
def _predict(transition, added, p, carried, out):
    """out = transition p transition' + added; carried = transition p. All (n, n) but for added, (SIZE,)."""
    n = p.shape[0]
    for i in range(n):
        for j in range(n):
            carried[i, j] = 0.0
        for c in range(n):
            f = transition[i, c]
            if f != 0.0:
                for j in range(n):
                    carried[i, j] += f * p[c, j]
    for i in range(n):
        for j in range(i + 1):
            t = added[STRIDE * i + j]
            for c in range(n):
                t += carried[i, c] * transition[j, c]
            out[i, j] = t
            out[j, i] = t


@kernel
def _smoothing_gain(carried, predicted, factor, out):
    """out = P transition' predicted^-1 (n, n) from carried = transition P; False where `predicted` is not positive
    definite."""
    n = out.shape[0]
    for i in range(n):
        for j in range(i + 1):
            factor[i, j] = predicted[i, j]
    if not cholesky(factor, n):
        return False
    for i in range(n):
        for j in range(n):
            out[i, j] = carried[j, i]
        solve_cholesky(factor, n, out[i])
    return True


@kernel
def _smooth_covariance(gains, predicted, later, p):
    """P <- P + G (P later - predicted) G', in place; all (n, n)."""
    n = p.shape[0]
    d = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            t = 0.0
            for c in range(n):
                t += gains[i, c] * (later[c, j] - predicted[c, j])
            d[i, j] = t
    for i in range(n):
        for j in range(i + 1):
            t = 0.5 * (p[i, j] + p[j, i])
            for c in range(n):
                t += d[i, c] * gains[j, c]
            p[i, j] = t
            p[j, i] = t


@kernel
def _to_flat(matrix, out):
    """A matrix (n, n) as kernels keep a covariance, out (SIZE,)."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[0]):
            out[STRIDE * i + j] = matrix[i, j]


@kernel
def _nodes(begin, events):
    """The instants of a flight: time (n,), measurement (n,) and output (n,) of each; -1 where there is none. Node 0 is
    the beginning; a measurement is a node by itself, an output shares one of its time."""
    count = events.time.shape[0]
    time = np.empty(count + 1)
    measurement = np.full(count + 1, -1)
    output = np.full(count + 1, -1)
    time[0] = begin
    n = 1
    for i in range(count):
        if events.kind[i] == OUTPUT:
            # two outputs nearer than what is one time are two nodes: each has its row
            if output[n - 1] >= 0 or events.time[i] - time[n - 1] > TIME_TOLERANCE:
                time[n] = events.time[i]
                n += 1
            output[n - 1] = events.row[i]
        else:
            time[n] = events.time[i]
            measurement[n] = i
            n += 1
    return time[:n], measurement[:n], output[:n]


@kernel
def run(imu, measurements, events, state, model, passes, history):
    """Smooth one flight; arguments are those of `estimation.records`, events without any ahead.

    passes: most passes over the flight; 1 is the fixed-interval smoother of [2] on the filter's own estimates,
    more iterate it towards the maximum a posteriori [1]. Measurements rejected by the gate of the first pass stay
    rejected. Innovations and their squares are those of the first pass. The answers are nan where a
    covariance is not positive definite.
    """
    n = history.covariance.shape[1]
    declared = model.declared
    node_time, node_event, node_output = _nodes(imu.time[0], events)
    count = node_time.shape[0]
    nodes = np.empty((count, state.navigation.shape[0]))
    filtered, predicted, carried = np.empty((count, n, n)), np.empty((count, n, n)), np.empty((count, n, n))
    # means of the errors about each node, before and after its measurement
    mean, mean_predicted = np.zeros((count, n)), np.zeros((count, n))
    gains = np.empty((count, n, n))
    transition, factor, prior = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    phi_total, added, p = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE)
    flat_work = np.zeros(SIZE)
    h, z, r, s = np.empty((MOST, n)), np.empty(MOST), np.empty((MOST, MOST)), np.empty((MOST, MOST))
    place = np.empty(MOST, np.int64)
    k, pht, work = np.empty((n, MOST)), np.empty((n, MOST)), np.empty((n, MOST))
    c_nb, jac, columns, inverse = np.empty((3, 3)), np.empty((3, 3)), np.empty((n, 3)), np.empty((2, 3, 3))
    scratch = np.zeros(MID_N + 3 * SIZE)
    increments, cursor = np.empty(6), np.zeros(3)
    here, x = np.empty(state.navigation.shape[0]), np.empty(n)

    start = state.navigation.copy()
    start[NAV_HELD:NAV_SENSORS] = 0.0
    start[NAV_HELD] = 1.0
    status = history.status
    status[:] = NOT_USED
    rejected = state.rejected
    rejected[:] = 0
    for iteration in range(passes):
        # the first pass has no trajectory yet: it follows its own estimate
        first = iteration == 0
        if first:
            nodes[0] = start
        set_off(imu, nodes[0], declared, cursor, increments)
        # prior: exp(d) exp(moved) = exp(theta), theta ~ N(0, P)
        difference(nodes[0], start, x)
        # forwards: a filter of the errors along this trajectory
        p[:] = state.covariance
        reset(p, x[A_N], x[A_E], x[A_D], jac, columns)
        square(p, filtered[0])
        for i in range(n):
            mean[0, i] = -x[i]
        for node in range(1, count):
            here[:] = nodes[node - 1]
            _fly(
                node_time[node],
                imu,
                model,
                here,
                cursor,
                increments,
                scratch,
                c_nb,
                inverse,
                phi_total,
                added,
                flat_work,
                transition,
            )
            _predict(transition, added, filtered[node - 1], carried[node], predicted[node])
            if first:
                nodes[node] = here
            # the trajectory jumps where the pass before has moved its nodes: the jump carries the mean on
            difference(here, nodes[node], x)
            for i in range(n):
                t = x[i]
                for c in range(n):
                    t += transition[i, c] * mean[node - 1, c]
                mean_predicted[node, i] = t
                mean[node, i] = t
            filtered[node] = predicted[node]
            e = node_event[node]
            if e < 0 or (not first and status[e] != USED):
                continue
            what = events.kind[e]
            m = observe(
                what, events.row[e], measurements, nodes[node], increments, cursor[2], declared, c_nb, place, z, h, r
            )
            for a in range(m):
                for c in range(n):
                    z[a] -= h[a, c] * mean[node, c]
            _to_flat(filtered[node], p)
            if m == 0 or not gain(p, h, r, m, pht, s, k):
                continue
            if first:
                keep_innovation(place, m, z, s, history.innovation[e], history.innovation_sigma[e])
            for i in range(n):
                x[i] = 0.0
                for a in range(m):
                    x[i] += k[i, a] * z[a]
            q = whitened_square(s, z, m)
            if first:
                history.innovation_squared[e] = q
                history.degrees[e] = m
                if q > model.gate[m] and rejected[what] < model.max_rejected:
                    status[e] = REJECTED
                    rejected[what] += 1
                    continue
                status[e] = USED
                rejected[what] = 0
            joseph(p, h, r, m, pht, k, work)
            if first:
                # the node moves onto its estimate, and its errors are counted from there
                error_state.inject(nodes[node], x)
                reset(p, x[A_N], x[A_E], x[A_D], jac, columns)
                for i in range(n):
                    mean_predicted[node, i] = -x[i]
                    mean[node, i] = 0.0
            else:
                for i in range(n):
                    mean[node, i] += x[i]
            square(p, filtered[node])
        # backwards [2]: what later measurements say of each node
        moved = 0.0
        for node in range(count - 1, -1, -1):
            if node < count - 1:
                if not _smoothing_gain(carried[node + 1], predicted[node + 1], factor, gains[node]):
                    # no covariance, no answer: nothing of what the arrays held before is left in them
                    history.navigation[:] = np.nan
                    history.covariance[:] = np.nan
                    return
                for i in range(n):
                    t = 0.0
                    for c in range(n):
                        t += gains[node, i, c] * (mean[node + 1, c] - mean_predicted[node + 1, c])
                    mean[node, i] += t
            for i in range(n):
                moved = max(moved, abs(mean[node, i]) / math.sqrt(filtered[node, i, i]))
        # the next trajectory
        for node in range(count):
            error_state.inject(nodes[node], mean[node])
        if not first and moved < _CONVERGED:
            break
    # covariances are smoothed once, along the last trajectory; none of them moves it
    _to_flat(filtered[count - 1], state.covariance)
    prior[:] = filtered[count - 1]
    for node in range(count - 1, -1, -1):
        if node < count - 1:
            _smooth_covariance(gains[node], predicted[node + 1], prior, filtered[node])
            prior[:] = filtered[node]
        o = node_output[node]
        if o >= 0:
            history.navigation[o] = nodes[node]
            history.covariance[o] = filtered[node]
    state.navigation[:] = nodes[count - 1]
