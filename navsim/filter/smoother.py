"""`kind: map`: batch maximum-a-posteriori smoother, the reference for the attainable accuracy.

The whole flight is one least-squares problem. It contains the initial estimate, the sensor noise of every interval and
every fix, each weighted by the filter model. Gauss-Newton solves it; its normal equations are those of a Kalman filter
and a backward pass, linearised along the latest trajectory [1]. The first trajectory is that of an error-state filter,
smoothed.

At the solution every linearisation is at the estimate, so the remaining inconsistency is the curvature of the
posterior. Every output uses all fixes, also later ones. The last output of a flight is the best that a filter could
know at that time.

Sources: [1] Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optim. 4 (1994). [2] Rauch, Tung &
Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA J. 3 (1965).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import alloc, any_lane, as_simd, no, small_matrix, small_vector, where
from navsim.compiler.linear import cholesky, copy, copy_matrix, identity, solve_cholesky
from navsim.filter import eskf
from navsim.filter.covariance import count_imu_states, gain, joseph, propagate_error_columns, reset
from navsim.filter.error_parametrisation import PLAIN
from navsim.filter.filter_loop import advance_once, can_advance, propagation_buffers, start_mechanisation
from navsim.filter.history import as_registers, record_decision, record_innovation
from navsim.filter.measurement_kinds import MONITOR_ONLY_FIX
from navsim.filter.measurement_models import observe, slot
from navsim.filter.outliers import add_spread, expects_outliers, is_lost, outlier_moments, widen
from navsim.filter.receiver_clock import propagate_clock_rows
from navsim.filter.records import MAP, NOT_USED, OUTPUT, RTS, TIME_TOLERANCE, USED
from navsim.filter.states import (
    MAX_MEASUREMENT_SIZE,
    NAV_BIAS_FRAME,
    NAV_SENSORS,
    PHI_D,
    PHI_E,
    PHI_N,
    SENSORS,
)
from navsim.filter.update import count_rejection, count_valid, estimate_errors, passes_gate, whitened_square

PASSES = {RTS: 1, MAP: 30}
"""Passes over the flight that each kind of smoother makes at most."""
_CONVERGED = 1e-3
"""Stop once no state of any node moves by more than this many sigmas."""


@kernel
def _fly(until, imu, model, nav, cursor, increments, space, added, transition):
    """Mechanise to `until`; transition (n, n) of the plain errors, added (n, n): covariance gathered.

    space: from `filter_loop.propagation_buffers`.
    """
    n, declared = transition.shape[0], model.declared
    identity(transition)
    for i in range(n):
        for j in range(n):
            added[i, j] = 0.0
    scales = model.clock.scales.shape[0]
    while can_advance(imu, until, cursor):
        begin = cursor[1]
        advance_once(PLAIN, until, imu, model, nav, added, cursor, increments, space)
        propagate_error_columns(space.phi, SENSORS + count_imu_states(declared), space.sums.decay, transition, space.a)
        if scales > 0:
            propagate_clock_rows(n - scales - 1, scales, cursor[1] - begin, transition)
        for c in range(model.clock.offsets.shape[0]):
            propagate_clock_rows(model.clock.offsets[c], 1, cursor[1] - begin, transition)


@kernel
def _predict(transition, added, p, carried, out):
    """out = transition p transition' + added; carried = transition p. All (n, n)."""
    n = p.shape[0]
    for i in range(n):
        for j in range(n):
            carried[i, j] = 0.0
        for c in range(n):
            f = transition[i, c]
            if any_lane(f != 0.0):
                for j in range(n):
                    carried[i, j] += f * p[c, j]
    for i in range(n):
        for j in range(i + 1):
            t = added[i, j]
            for c in range(n):
                t += carried[i, c] * transition[j, c]
            out[i, j] = t
            out[j, i] = t


@kernel
def _smoothing_gain(carried, predicted, factor, out):
    """out = P transition' predicted^-1 (n, n) from carried = transition P; returns whether `predicted` is positive
    definite."""
    n = out.shape[0]
    for i in range(n):
        for j in range(i + 1):
            factor[i, j] = predicted[i, j]
    good = cholesky(factor, n)
    for i in range(n):
        for j in range(n):
            out[i, j] = carried[j, i]
        solve_cholesky(factor, n, out[i])
    return good


@kernel
def _smooth_covariance(gains, predicted, later, p, d):
    """P <- P + G (P later - predicted) G', in place; all (n, n). d: (n, n) work space."""
    n = p.shape[0]
    for i in range(n):
        for j in range(n):
            t = gains[i, 0] * (later[0, j] - predicted[0, j])
            for c in range(1, n):
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
def _nodes(begin, events):
    """Times of a flight: time (n,), measurement (n,) and output (n,) of each; -1 for none.

    Node 0 is the start. A measurement has its own node; an output shares one of its time.
    """
    count = events.time.shape[0]
    time = np.empty(count + 1)
    measurement = np.full(count + 1, -1)
    output = np.full(count + 1, -1)
    time[0] = begin
    n = 1
    for i in range(count):
        if events.kind[i] == OUTPUT:
            # two outputs closer than the time tolerance are two nodes: each has its row
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
    """Smooth one flight; arguments are those of `filter.records`, or those of lanes, events without any ahead.

    passes: most passes over the flight; 1 is the fixed-interval smoother of [2] on the filter's own estimates,
    more iterate it towards the maximum a posteriori [1]. Measurements rejected by the gate of the first pass stay
    rejected. Innovations and their squares are those of the first pass. The answers are nan where a
    covariance is not positive definite.
    """
    declared = model.declared
    navigation, rejected, final = as_simd(state.navigation), as_simd(state.rejected), as_simd(state.covariance)
    n = final.shape[0]
    decay = as_registers(history)
    answers, covariance, status = decay.navigation, decay.covariance, decay.status
    size = navigation.shape[0]
    node_time, node_event, node_output = _nodes(imu.time[0], events)
    count = node_time.shape[0]
    nodes, filtered = alloc(navigation, (count, size)), alloc(navigation, (count, n, n))
    predicted, carried, gains = (
        alloc(navigation, (count, n, n)), alloc(navigation, (count, n, n)), alloc(navigation, (count, n, n)),
    )  # fmt: skip
    # means of the errors about each node, before and after its measurement
    mean, mean_predicted = alloc(navigation, (count, n)), alloc(navigation, (count, n))
    transition, factor, later = alloc(navigation, (n, n)), alloc(navigation, (n, n)), alloc(navigation, (n, n))
    added, p, prior = alloc(navigation, (n, n)), alloc(navigation, (n, n)), alloc(navigation, (n, n))
    h, z, r, s = (
        alloc(navigation, (MAX_MEASUREMENT_SIZE, n)), small_vector(navigation, MAX_MEASUREMENT_SIZE),
        small_matrix(navigation, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE),
        small_matrix(navigation, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE),
    )  # fmt: skip
    have, k, pht, work = (
        small_vector(navigation, MAX_MEASUREMENT_SIZE), alloc(navigation, (n, MAX_MEASUREMENT_SIZE)),
        alloc(navigation, (n, MAX_MEASUREMENT_SIZE)),
        alloc(navigation, (n, MAX_MEASUREMENT_SIZE)),
    )  # fmt: skip
    jac, columns = small_matrix(navigation, 3, 3), alloc(navigation, (n, 3))
    space = propagation_buffers(navigation, n, PLAIN.straight, declared)
    increments, cursor = small_vector(navigation, 6), np.zeros(3)
    here, x, start = alloc(navigation, (size,)), alloc(navigation, (n,)), alloc(navigation, (size,))

    copy(navigation, start)
    copy_matrix(final, prior)
    for i in range(NAV_BIAS_FRAME, NAV_SENSORS):
        start[i] = 1.0 if i == NAV_BIAS_FRAME else 0.0
    for e in range(status.shape[0]):
        status[e] = NOT_USED
    # runs that are still being smoothed; those that are done keep the answers of the pass in which they were
    running = start[NAV_BIAS_FRAME] == 1.0
    for iteration in range(passes):
        # the first pass has no trajectory yet: it follows its own estimate
        first = iteration == 0
        for i in range(rejected.shape[0]):
            rejected[i] = 0.0
        if first:
            copy(start, nodes[0])
        start_mechanisation(imu, nodes[0], declared, cursor, increments)
        # prior: exp(d) exp(moved) = exp(theta), theta ~ N(0, P)
        eskf.between(nodes[0], start, x)
        # forwards: a filter of the errors along this trajectory
        copy_matrix(prior, filtered[0])
        reset(filtered[0], x[PHI_N], x[PHI_E], x[PHI_D], jac, columns)
        for i in range(n):
            mean[0, i] = -x[i]
        for node in range(1, count):
            copy(nodes[node - 1], here)
            _fly(node_time[node], imu, model, here, cursor, increments, space, added, transition)
            _predict(transition, added, filtered[node - 1], carried[node], predicted[node])
            if first:
                copy(here, nodes[node])
            # the trajectory jumps where the pass before has moved its nodes: the jump moves the mean
            eskf.between(here, nodes[node], x)
            for i in range(n):
                t = x[i]
                for c in range(n):
                    t += transition[i, c] * mean[node - 1, c]
                mean_predicted[node, i] = t
                mean[node, i] = t
            copy_matrix(predicted[node], filtered[node])
            e = node_event[node]
            if e < 0:
                continue
            kind = events.kind[e]
            m = observe(
                kind, events.row[e], measurements, nodes[node], increments, cursor[2], declared, space.c_nb, have, z, h,
                r,
            )  # fmt: skip
            degrees = count_valid(have, m)
            for a in range(m):
                for c in range(n):
                    z[a] -= h[a, c] * mean[node, c]
            copy_matrix(filtered[node], p)
            used = gain(p, h, r, m, pht, s, k) & (degrees > 0.0)
            spread, counter = 0.0 * degrees, slot(kind, events.row[e], measurements)
            if expects_outliers(kind, measurements):
                outliers = measurements.beacons.outliers
                astray = is_lost(rejected[counter], outliers, model.max_rejected) & (degrees > 0.0)
                if any_lane(astray):
                    widen(predicted[node], astray, z[0], s[0, 0])
                    copy_matrix(predicted[node], filtered[node])
                    copy_matrix(predicted[node], p)
                    used = gain(p, h, r, m, pht, s, k) & (degrees > 0.0)
                    rejected[counter] = where(astray, 0.0, rejected[counter])
                shift, spread, _, _, clean = outlier_moments(z[0], s[0, 0], outliers)
                z[0] -= shift
                count_rejection(used, clean > 0.5, counter, rejected)
            estimate_errors(k, z, m, x)
            if first:
                weighed = used
                record_innovation(False, have, weighed, m, z, s, decay, e)
                q = whitened_square(s, z, m)
                used = weighed & passes_gate(q, degrees, rejected[counter], model)
                if expects_outliers(kind, measurements):
                    used = weighed
                if kind == MONITOR_ONLY_FIX:
                    used = used & no(used)
                record_decision(weighed, used, q, degrees, decay, e)
                if not expects_outliers(kind, measurements):
                    count_rejection(weighed, used, counter, rejected)
            used = used & (status[e] == USED)
            if not any_lane(used):
                continue
            joseph(p, h, r, m, pht, k, work)
            if expects_outliers(kind, measurements):
                add_spread(p, k, spread)
            if first:
                # the node moves onto its estimate, and its errors are counted from there
                copy(nodes[node], here)
                eskf.inject(here, x)
                reset(p, x[PHI_N], x[PHI_E], x[PHI_D], jac, columns)
                for i in range(size):
                    nodes[node, i] = where(used, here[i], nodes[node, i])
                for i in range(n):
                    mean_predicted[node, i] = where(used, -x[i], mean_predicted[node, i])
                    mean[node, i] = where(used, 0.0, mean[node, i])
            else:
                for i in range(n):
                    mean[node, i] = where(used, mean[node, i] + x[i], mean[node, i])
            for i in range(n):
                for j in range(n):
                    filtered[node, i, j] = where(used, p[i, j], filtered[node, i, j])
        # backwards [2]: information of later measurements about each node
        moved = 0.0 * start[0]
        for node in range(count - 1, -1, -1):
            if node < count - 1:
                good = _smoothing_gain(carried[node + 1], predicted[node + 1], factor, gains[node])
                # no covariance, no answer
                moved = where(good, moved, math.nan)
                for i in range(n):
                    t = mean[node, i]
                    for c in range(n):
                        t += gains[node, i, c] * (mean[node + 1, c] - mean_predicted[node + 1, c])
                    mean[node, i] = t
            for i in range(n):
                step = abs(mean[node, i]) / math.sqrt(filtered[node, i, i])
                moved = where(step > moved, step, moved)
        lost = running & math.isnan(moved)
        # the next trajectory
        for node in range(count):
            eskf.inject(nodes[node], mean[node])
        done = running & no(lost)
        if iteration < passes - 1:
            done = done & (moved < _CONVERGED)
            if first:
                done = done & no(done)
        if any_lane(lost):
            for o in range(answers.shape[0]):
                for i in range(size):
                    answers[o, i] = where(lost, math.nan, answers[o, i])
                for i in range(n):
                    for j in range(n):
                        covariance[o, i, j] = where(lost, math.nan, covariance[o, i, j])
        if any_lane(done):
            # covariances are smoothed once, along the last trajectory; they do not change it
            for i in range(size):
                navigation[i] = where(done, nodes[count - 1, i], navigation[i])
            copy_matrix(filtered[count - 1], later)
            for i in range(n):
                for j in range(n):
                    final[i, j] = where(done, later[i, j], final[i, j])
            for node in range(count - 1, -1, -1):
                if node < count - 1:
                    _smooth_covariance(gains[node], predicted[node + 1], later, filtered[node], factor)
                    copy_matrix(filtered[node], later)
                o = node_output[node]
                if o >= 0:
                    for i in range(size):
                        answers[o, i] = where(done, nodes[node, i], answers[o, i])
                    for i in range(n):
                        for j in range(n):
                            covariance[o, i, j] = where(done, later[i, j], covariance[o, i, j])
        running = running & no(done) & no(lost)
        if not any_lane(running):
            break
