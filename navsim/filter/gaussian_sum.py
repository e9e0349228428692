"""Gaussian-sum filter over heading, `kind: gaussian-sum`.

A single Gaussian becomes inconsistent when the aircraft turns while its heading is uncertain. The biases B = C b are
known along level axes but not along the vertical, and they rotate with the body. The error is then a product of two
uncertain quantities. This filter holds several components, each with a small heading sigma. Each component is a `tfg`
filter with a rule of its own for the axes of the biases in turns (`_set_bias_axes`).

- Split: before a turn, a component that is too wide in heading is divided into three. The split follows the correlation
  of the other states with heading.
- Weight: each measurement multiplies a component's weight by its likelihood.
- Prune and merge: negligible components are dropped; neighbours that are jointly narrow are merged. When heading is
  known, one component remains.

The output is the mean and covariance of the mixture in the chart of `tfg`.

Components of W runs are processed together in SIMD lanes: the first components, then the second ones. A run with fewer
components than another has weight 0 in the rest.

Sources:

- [1] Alspach & Sorenson, Nonlinear Bayesian estimation using Gaussian sum approximations, IEEE TAC 17 (1972).
- [2] Runnalls, Kullback-Leibler approach to Gaussian mixture reduction, IEEE TAES 43 (2007).
- [3] `docs/theory/gaussian-sum.md`.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.elementary import exp_of_negative
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import alloc, any_lane, as_simd, no, small_matrix, small_vector, where
from navsim.compiler.linear import cholesky, copy
from navsim.filter import tfg
from navsim.filter.covariance import gain, innovation_factor
from navsim.filter.error_products import hold_position, predict_products, start_products
from navsim.filter.filter_loop import (
    advance,
    force_noise,
    is_later,
    propagation_buffers,
    start_axes,
    start_mechanisation,
)
from navsim.filter.history import as_error_registers, as_registers, clear_event, write_output
from navsim.filter.measurement_kinds import BEACON, RANGE
from navsim.filter.measurement_models import observe, slot
from navsim.filter.mixture import (
    MIN_TURN,
    MIN_WEIGHT,
    compact_components,
    copy_mixture,
    count_components,
    empty_components,
    mixture_buffers,
    moments,
    normalise_weights,
    split_and_merge,
)
from navsim.filter.outliers import expects_outliers, is_lost, outlier_moments, widen
from navsim.filter.range_update import (
    accumulate_range,
    apply_epoch,
    begin_epoch,
    begin_estimate,
    count_range,
    is_epoch_boundary,
    predict_range,
    range_epoch,
)
from navsim.filter.receiver_clock import detect_clock_jumps, reset_clock
from navsim.filter.records import OUTPUT, PASS, TIME_TOLERANCE, Mixture
from navsim.filter.states import (
    GYRO,
    MAX_MEASUREMENT_SIZE,
    NAV_BIAS_FRAME,
    NAV_GYRO,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_N,
)
from navsim.filter.steady_force import (
    begin_interval,
    couple_sum,
    end_interval,
    is_interval_started,
    mean_velocity,
    start_line,
    turns_from_mean,
)
from navsim.filter.update import (
    apply_gate,
    count_rejection,
    count_valid,
    estimate_by_factor,
    update,
    update_buffers,
    whitened_square,
)

_TURN_HORIZON = 2.0
"""Time for which a turn is expected to continue, s."""
_FREEZE_RATE = 0.002
"""Least rate about the level axes of the body that is a turn, rad/s."""
_FREEZE_HEADING = 0.003
"""1 sigma of heading below which bias axes are not held, rad."""
_PLAIN_HEADING = 0.02
"""1 sigma of heading below which bias errors may become plain instead of held, rad."""
_PLAIN_BANK = 0.15
"""Bank or pitch, from the held axes, beyond which they become plain, rad."""
_FREEZE_LEVEL_BIAS = 0.1
"""Largest sigma of level gyro biases for which axes are held, relative to the vertical one."""


@kernel
def expected_turn(imu, cursor, until, nav):
    """Angle (rad) by which the body is expected to turn, from its turn until `until`; 0 if that is now."""
    time, dtheta = imu.time, as_simd(imu.dtheta)
    first = int(cursor[0])
    last = first
    body = small_vector(nav, 3)
    for i in range(3):
        body[i] = 0.0
    while last < time.shape[0] - 1 and time[last] < until - TIME_TOLERANCE:
        for i in range(3):
            body[i] += dtheta[last, i]
        last += 1
    span = time[last] - time[first]
    for i in range(3):
        body[i] -= nav[NAV_GYRO + i] * span
    size = math.sqrt(body[0] * body[0] + body[1] * body[1] + body[2] * body[2])
    return MIN_TURN + size * max(1.0, _TURN_HORIZON / span) if span > 0.0 else 0.0 * size


@kernel
def _second_order_axes(nav, axes, out):
    """Factor of the second-order term in errors of gyro biases, and out (3, 3): the errors are db + (out theta) x db.

    axes (3, 3): work space."""
    share = where(tfg.is_plain(nav), 0.0, where(tfg.has_navigation_axes(nav), 1.0, 0.5))
    tfg.bias_axes(nav, axes)
    for i in range(3):
        for j in range(3):
            out[i, j] = share * axes[j, i]
    return share


@kernel
def _add_second_order(changes, more, nav, p):
    """Where `changes`, add the mean of (more theta) x db to nav (NAV,) and its covariance to P (n, n).

    By this term errors db of gyro biases differ in other axes. more (3, 3). Exact for Gaussian errors: the term then
    has no covariance with any state."""
    turn, cross = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    for i in range(3):
        for j in range(3):
            cross[i, j] = 0.0
            turn[i, j] = 0.0
            for k in range(3):
                cross[i, j] += more[i, k] * p[PHI_N + k, GYRO + j]
                for l in range(3):
                    turn[i, j] += more[i, k] * p[PHI_N + k, PHI_N + l] * more[j, l]
    own, grown = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    for i in range(3):
        for j in range(3):
            own[i, j] = p[GYRO + i, GYRO + j]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        nav[NAV_GYRO + i] += where(changes, cross[a, b] - cross[b, a], 0.0)
        for j in range(i + 1):
            c, d = (j + 1) % 3, (j + 2) % 3
            # fourth moments of a Gaussian: products of two covariances
            t = turn[a, c] * own[b, d] + cross[a, d] * cross[c, b]
            t -= turn[a, d] * own[b, c] + cross[a, c] * cross[d, b]
            t -= turn[b, c] * own[a, d] + cross[b, d] * cross[c, a]
            grown[i, j] = t + turn[b, d] * own[a, c] + cross[b, c] * cross[d, a]
    for i in range(3):
        for j in range(3):
            t = grown[i, j] if i >= j else grown[j, i]
            p[GYRO + i, GYRO + j] += where(changes, t, 0.0)


@kernel
def _set_bias_axes(nav, p, before, dt, axes):
    """Set the axes of the bias errors after the body's turn in dt (s) since the attitude `before` (4,).

    In straight flight, once the level gyro biases are known, errors of gyro biases have fixed navigation axes. Before a
    turn the filter knows the level biases well, the vertical one badly. Axes that turned with the body would add half
    of heading error x turn x vertical bias to the level ones. So the turn is held back until heading is known. If the
    aircraft is then banked, bias errors become plain, since the vertical bias also changes tilt in a bank. Moments of
    gyro biases are carried over to other axes to second order. axes (3, 3): work space.
    """
    held, q = nav[NAV_BIAS_FRAME:NAV_SENSORS], nav[NAV_QUAT:NAV_BIAS_FRAME]
    # the conjugate of the attitude before, times that of now
    w = before[0] * q[0] + before[1] * q[1] + before[2] * q[2] + before[3] * q[3]
    x = before[0] * q[1] - before[1] * q[0] - before[2] * q[3] + before[3] * q[2]
    y = before[0] * q[2] + before[1] * q[3] - before[2] * q[0] - before[3] * q[1]
    z = before[0] * q[3] - before[1] * q[2] + before[2] * q[1] - before[3] * q[0]
    turning = 4.0 * (x * x + y * y) > (_FREEZE_RATE * dt) * (_FREEZE_RATE * dt)
    was_turned = abs(held[1]) + abs(held[2]) + abs(held[3]) > 0.0
    turned = turning | was_turned
    plain = tfg.is_plain(nav)
    variance, now = small_vector(nav, 3), small_vector(nav, 4)
    old, new = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    copy(q, now)
    # what a turn would hold are the axes from before it
    copy(before, q)
    share = _second_order_axes(nav, axes, old)
    copy(now, q)
    for i in range(3):
        variance[i] = 0.0
        for j in range(3):
            for k in range(3):
                variance[i] += axes[i, j] * p[GYRO + j, GYRO + k] * axes[i, k]
    level = where(variance[0] > variance[1], variance[0], variance[1])
    heading = p[PHI_D, PHI_D]
    knows = no(plain) & (heading > _FREEZE_HEADING * _FREEZE_HEADING)
    knows = knows & (level < _FREEZE_LEVEL_BIAS * _FREEZE_LEVEL_BIAS * variance[2])
    holds = knows & turned
    # plain axes have no vertical one: of the eigenvalues of the covariance, their sum and that of products of two
    g = p[GYRO : GYRO + 3, GYRO : GYRO + 3]
    total = g[0, 0] + g[1, 1] + g[2, 2]
    products = g[0, 0] * g[1, 1] + g[0, 0] * g[2, 2] + g[1, 1] * g[2, 2]
    products -= g[0, 1] * g[0, 1] + g[0, 2] * g[0, 2] + g[1, 2] * g[1, 2]
    banked = 4.0 * (held[1] * held[1] + held[2] * held[2]) > _PLAIN_BANK * _PLAIN_BANK
    plain = plain | (holds & banked & (heading < _PLAIN_HEADING * _PLAIN_HEADING))
    plain = plain & (products < _FREEZE_LEVEL_BIAS * _FREEZE_LEVEL_BIAS * total * total)
    turns = holds & turning
    a, b, c, d = held[0], held[1], held[2], held[3]
    unturned = where(knows, -1.0, 1.0)
    held[0] = where(plain, 0.0, where(turns, a * w - b * x - c * y - d * z, where(holds, a, unturned)))
    held[1] = where(plain, 0.0, where(turns, a * x + b * w + c * z - d * y, where(holds, b, 0.0)))
    held[2] = where(plain, 0.0, where(turns, a * y - b * z + c * w + d * x, where(holds, c, 0.0)))
    held[3] = where(plain, 0.0, where(turns, a * z + b * y - c * x + d * w, where(holds, d, 0.0)))
    changes = (share != _second_order_axes(nav, axes, new)) | (was_turned & no(holds))
    if any_lane(changes):
        for i in range(3):
            for j in range(3):
                new[i, j] -= old[i, j]
        _add_second_order(changes, new, nav, p)


@kernel
def _mixture_innovation(weight, zs, ss, m, z, s):
    """Innovation z (m,) of a sum, and the factor s (m, m) of its covariance, from those of the components zs (M, MOST),
    ss (M, MOST, MOST). Returns whether it is one."""
    count = count_components(weight)
    for a in range(m):
        z[a] = 0.0
        for j in range(count):
            z[a] += where(weight[j] > 0.0, weight[j] * zs[j, a], 0.0)
    for a in range(m):
        for b in range(a + 1):
            s[a, b] = 0.0
            for j in range(count):
                t = (zs[j, a] - z[a]) * (zs[j, b] - z[b])
                for c in range(b + 1):
                    t += ss[j, a, c] * ss[j, b, c]
                s[a, b] += where(weight[j] > 0.0, weight[j] * t, 0.0)
    return cholesky(s, m)


@kernel
def update_weights(used, weight, squares, sizes):
    """Multiply the weights (M,) by the likelihoods of a measurement, if it is used; negligible weights become zero.

    squares (M,): normalised innovations squared, sizes (M,): roots of the determinants of their covariances.
    """
    count = count_components(weight)
    least, of_least = 0.0 * weight[0] + math.inf, 0.0 * weight[0] + 1.0
    for j in range(count):
        better = (weight[j] > 0.0) & (squares[j] < least)
        least, of_least = where(better, squares[j], least), where(better, sizes[j], of_least)
    for j in range(count):
        there = (weight[j] > 0.0) & (squares[j] < math.inf)
        less = where(there, -0.5 * (squares[j] - least), 0.0)
        likelihood = where(there, exp_of_negative(less) * of_least / sizes[j], 0.0)
        weight[j] = where(used & (weight[j] > 0.0), weight[j] * likelihood, weight[j])
    normalise_weights(used, weight)
    for j in range(count):
        weight[j] = where(used & (weight[j] < MIN_WEIGHT), 0.0, weight[j])
    normalise_weights(used, weight)


@kernel
def run(chart, imu, measurements, events, state, stream, model, history, errors):
    """Process the events with a Gaussian sum; arguments are those of `filter_loop.run`.

    The components of `state` continue. Its navigation and covariance become their moments after the last event that was
    not ahead. The increments of `stream` are unused: each component has its own.
    """
    declared = model.declared
    state_nav, state_p, state_rejected = (
        as_simd(state.navigation),
        as_simd(state.covariance),
        as_simd(state.rejected),
    )
    record, account = as_registers(history), as_error_registers(errors)
    own = Mixture(
        as_simd(state.components.navigation), as_simd(state.components.covariance),
        as_simd(state.components.increments), as_simd(state.components.weight),
    )  # fmt: skip
    n, most, nav_size = state_p.shape[0], own.weight.shape[0], state_nav.shape[0]
    buffers = update_buffers(state_nav, n)
    zs, ss, phts = (
        alloc(state_nav, (most, MAX_MEASUREMENT_SIZE)),
        alloc(state_nav, (most, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
        alloc(state_nav, (most, n, MAX_MEASUREMENT_SIZE)),
    )
    squares, sizes, numbers = alloc(state_nav, (most,)), alloc(state_nav, (most,)), alloc(state_nav, (most,))
    spreads, held = alloc(state_nav, (most,)), alloc(state_nav, (3, 3))
    there = alloc(state_nav, (MAX_MEASUREMENT_SIZE,))
    space, mixture_work = (
        propagation_buffers(state_nav, n, chart.straight, declared),
        mixture_buffers(state_nav, n, most),
    )
    epoch = range_epoch(state_nav, n, most, events, model.clock.scales.shape[0])
    # the copy that runs ahead
    runs_ahead = False
    for i in range(events.ahead.shape[0]):  # numba's own `any` loads its linear algebra at every start
        runs_ahead |= events.ahead[i]
    late = empty_components(state_nav, most if runs_ahead else 1, nav_size, n)
    line, v, variance = as_simd(state.steady), alloc(state_nav, (3,)), alloc(state_nav, (3,))
    m_force, turns, attitude = alloc(state_nav, (3,)), alloc(state_nav, (most, 3)), alloc(state_nav, (4,))
    rejections, cursors, cursor = alloc(state_nav, (2, state_rejected.shape[0])), np.empty((2, 3)), np.empty(3)
    copy(state_rejected, rejections[0])
    copy(stream.cursor, cursors[0])
    if stream.cursor[0] < 0.0:
        for j in range(count_components(own.weight)):
            start_axes(own.navigation[j])
            start_mechanisation(imu, own.navigation[j], declared, cursors[0], own.increments[j])
            if chart.products > 0:
                start_products(chart.products, own.navigation[j], own.covariance[j])
        start_line(line, own.navigation[0, NAV_VEL:NAV_QUAT], cursors[0, 1])
    work = (
        account, buffers, zs, ss, phts, squares, sizes, numbers, spreads, there, space, mixture_work, epoch, late, v,
        variance, m_force, turns, attitude, rejections, cursors, cursor, held,
    )  # fmt: skip
    _process(chart, imu, measurements, events, model, line, record, own, work)
    moments(own, state_nav, state_p, True, space, mixture_work)
    copy(rejections[0], state_rejected)
    copy(cursors[0], stream.cursor)


@kernel
def _process(chart, imu, measurements, events, model, line, record, own, work):
    """Process the events; `work` is what `run` allocates. Apart from it, since it owns no array."""
    (
        account, buffers, zs, ss, phts, squares, sizes, numbers, spreads, there, space, mixture_work, epoch, late, v,
        variance, m_force, turns, attitude, rejections, cursors, cursor, held,
    ) = work  # fmt: skip
    declared, first = model.declared, 0
    before = 0
    for i in range(events.time.shape[0]):
        ahead = 1 if events.ahead[i] else 0
        if ahead > before:
            copy_mixture(own, count_components(own.weight), late)
            copy(cursors[0], cursors[1])
            copy(rejections[0], rejections[1])
        before = ahead
        now = late if ahead else own
        weight, rejected = now.weight, rejections[ahead]
        kind, row = events.kind[i], events.row[i]
        clear_event(record, i)
        copy(cursors[ahead], cursor)
        count = count_components(weight)
        # nowhere to go: in the midst of an epoch, too, whose components keep their places until its end
        if is_later(events.time[i], cursor):
            # a turn finds the components as narrow as it needs them
            turn = expected_turn(imu, cursor, events.time[i], now.navigation[0])
            if any_lane(turn > 0.0):
                split_and_merge(now, turn, model.split_heading_sigma, space, mixture_work)
                count = count_components(weight)
            if model.steady_force and not ahead and not is_interval_started(line):
                mean_velocity(now, count, v, variance)
                begin_interval(line, v, variance, force_noise(model, cursor), cursor[1])
            for j in range(count):
                copy(cursors[ahead], cursor)
                copy(now.navigation[j, NAV_QUAT:NAV_BIAS_FRAME], attitude)
                if chart.products > 0:
                    hold_position(now.covariance[j], held)
                advance(
                    chart, events.time[i], imu, model, now.navigation[j], now.covariance[j], cursor, now.increments[j],
                    space,
                )  # fmt: skip
                if chart.products > 0:
                    predict_products(chart.products, held, now.navigation[j], now.covariance[j])
                _set_bias_axes(
                    now.navigation[j], now.covariance[j], attitude, cursor[1] - cursors[ahead, 1], space.c_nb
                )
            copy(cursor, cursors[ahead])
        if model.steady_force and not ahead and kind != OUTPUT and kind != PASS and is_interval_started(line):
            mean_velocity(now, count, v, variance)
            turns_from_mean(now, count, turns, attitude)
            end_interval(line, v, variance, attitude, force_noise(model, cursor), cursor[1], m_force)
            couple_sum(now, count, m_force, turns)
        if kind == OUTPUT:
            moments(now, buffers.nav, buffers.p, True, space, mixture_work)
            write_output(chart, buffers.nav, buffers.p, record, account, row)
        elif kind != PASS:
            # no literal, for which numba would compile all that takes the size once more
            m, counter, chance = there.shape[0], slot(kind, row, measurements), 0.0 * weight[0]
            for a in range(MAX_MEASUREMENT_SIZE):
                there[a] = 0.0
            if kind == RANGE and is_epoch_boundary(events, i, 1):
                first = i
                begin_epoch(epoch)
                for j in range(count):
                    begin_estimate(epoch, j, now.covariance[j])
            for j in range(count):
                nav, increments = now.navigation[j], now.increments[j]
                if kind == RANGE:
                    m = predict_range(
                        chart, row, measurements, declared, nav, increments, cursor[2], epoch, j, space, buffers
                    )
                else:
                    m = observe(
                        kind, row, measurements, nav, increments, cursor[2], declared, space.c_nb, buffers.have,
                        buffers.z,
                        buffers.h, buffers.r,
                    )  # fmt: skip
                numbers[j] = count_valid(buffers.have, m)
                for a in range(m):
                    more = (weight[j] > 0.0) & (buffers.have[a] > there[a])
                    there[a] = where(more, buffers.have[a], there[a])
                    zs[j, a] = buffers.z[a]
                good = innovation_factor(now.covariance[j], buffers.h, buffers.r, m, phts[j], ss[j])
                if expects_outliers(kind, measurements):
                    lost = is_lost(rejected[counter], measurements.beacons.outliers, model.max_rejected)
                    if any_lane(lost):
                        hold_position(now.covariance[j], held)
                        widen(now.covariance[j], lost, zs[j, 0], ss[j, 0, 0])
                        if chart.products > 0:
                            predict_products(chart.products, held, nav, now.covariance[j])
                        good = innovation_factor(now.covariance[j], buffers.h, buffers.r, m, phts[j], ss[j])
                copy(zs[j], buffers.z)
                square = whitened_square(ss[j], buffers.z, m)
                squares[j] = where(good & (square < math.inf), square, math.inf)
                sizes[j] = ss[j, 0, 0]
                for a in range(1, m):
                    sizes[j] *= ss[j, a, a]
                if expects_outliers(kind, measurements):
                    outliers = measurements.beacons.outliers
                    mean, spreads[j], square, sizes[j], clean = outlier_moments(zs[j, 0], ss[j, 0, 0], outliers)
                    chance += where(weight[j] > 0.0, weight[j] * clean, 0.0)
                    squares[j] = where(squares[j] < math.inf, square, squares[j])
                    zs[j, 0] -= mean
            copy(there, buffers.have)
            degrees = count_valid(there, m)
            # a component that is none any more goes, unless there is no other
            sound = weight[0] < 0.0
            for j in range(count):
                squares[j] = where(numbers[j] < degrees, math.inf, squares[j])
                sound = sound | ((weight[j] > 0.0) & (squares[j] < math.inf))
            fewer = weight[0] < 0.0
            for j in range(count):
                failed = sound & (weight[j] > 0.0) & no(squares[j] < math.inf)
                weight[j] = where(failed, 0.0, weight[j])
                fewer = fewer | failed
            if any_lane(fewer):
                normalise_weights(fewer, weight)
            weighed = _mixture_innovation(weight, zs, ss, m, buffers.z, buffers.s) & (degrees > 0.0) & sound
            tested = not expects_outliers(kind, measurements)
            if not tested:
                lost = is_lost(rejected[counter], measurements.beacons.outliers, model.max_rejected)
                rejected[counter] = where(lost & weighed, 0.0, rejected[counter])
                count_rejection(weighed, chance > 0.5, counter, rejected)
            used = apply_gate(ahead > 0, weighed, degrees, m, buffers, counter, tested, model, rejected, record, i)
            for j in range(count):
                own_use = used & (weight[j] > 0.0)
                if not any_lane(own_use):
                    continue
                nav, p, increments = now.navigation[j], now.covariance[j], now.increments[j]
                estimate_by_factor(phts[j], ss[j], zs[j], m, buffers.x)
                if kind == RANGE:
                    # correction from another component is in the buffers
                    predict_range(
                        chart, row, measurements, declared, nav, increments, cursor[2], epoch, j, space, buffers
                    )
                    gain(p, buffers.h, buffers.r, m, buffers.pht, buffers.s, buffers.k)
                    accumulate_range(own_use, m, p, epoch, j, buffers)
                else:
                    buffers.spread[0] = spreads[j]
                    update(
                        chart, used, kind, row, measurements, declared, nav, p, increments, cursor[2], space, buffers
                    )  # fmt: skip
                    if chart.products > 0 and kind != BEACON:
                        start_products(chart.products, nav, p)
            update_weights(used, weight, squares, sizes)
            if kind == RANGE:
                count_range(measurements.ranges, row, i - first, weighed, used, epoch)
            if kind == RANGE and is_epoch_boundary(events, i, 0):
                for j in range(count_components(weight)):
                    apply_epoch(
                        chart, weight[j] > 0.0, events.row[first : i + 1], measurements, declared, now.navigation[j],
                        now.covariance[j], now.increments[j], cursor[2], epoch, j, space, buffers,
                    )  # fmt: skip
                if detect_clock_jumps(epoch.available, epoch.accepted, epoch.jumped):
                    for j in range(count_components(weight)):
                        reset_clock(epoch.jumped, now.covariance[j])
            # places in the epoch are those of its beginning
            if kind != RANGE or is_epoch_boundary(events, i, 0):
                compact_components(now)
