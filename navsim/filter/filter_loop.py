"""Event loop of all filter kinds: mechanise, predict, update with a measurement, correct, output.

The filter is at the time of its newest measurement. A late measurement is applied to the state at its time of validity,
interpolated inside the IMU interval. The output for the present is that state mechanised forward, with the measurements
that arrived in the meantime. This is the optimal use of late measurements, without approximation (`records.schedule`).

A flight may be processed in pieces: `State` and `StreamCursor` hold the filter between two of them. Arrays may be SIMD
lanes; masks hold the differences between runs.

All kinds predict and update with the plain errors d = (dr, dv, theta, sensor states) and their covariance. They differ
in the chart (`error_parametrisation`) of the correction. `history` writes the output.

Source: `docs/theory/filter.md`, sections 3 to 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel, kernel_inline, kernel_internal
from navsim.compiler.lanes import alloc, any_lane, as_simd, small_matrix, small_vector, where
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import NOISE_ACCEL, NOISE_GYRO, gain_by_factor, innovation_factor, is_varying, predict
from navsim.filter.error_parametrisation import rotate_bias_frame
from navsim.filter.error_products import hold_position, predict_products, start_products
from navsim.filter.first_estimates import note_shift, start_transition
from navsim.filter.history import as_error_registers, as_registers, clear_event, write_output
from navsim.filter.interval import LONGEST, StepSums, accumulate_markov, add_step, allocate_sums, reset_sums, transition
from navsim.filter.magnetometer_measurements import hard_iron
from navsim.filter.measurement_kinds import BEACON, RANGE
from navsim.filter.measurement_models import observe, slot
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
from navsim.filter.receiver_clock import detect_clock_jumps, propagate_clock, reset_clock
from navsim.filter.records import CONSTRAINED, OUTPUT, PASS, SHIFT_N, TIME_TOLERANCE
from navsim.filter.states import (
    N_BASE,
    NAV_BIAS_FRAME,
    NAV_GYRO,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_E,
    PHI_N,
    R_D,
    SENSORS,
    V_D,
    VEL,
)
from navsim.filter.steady_force import (
    begin_interval,
    couple,
    end_interval,
    is_interval_started,
    start_line,
    velocity_of,
)
from navsim.filter.strapdown import MID_GRAVITY, MID_N, compensated, first_increments, is_mixed, step, unmixing
from navsim.filter.update import (
    apply_gate,
    count_rejection,
    count_valid,
    estimate_by_factor,
    update,
    update_buffers,
)

_NO_NOISE = 1e-30
"""Density of noise of accelerometers that have none, m2/s3: no flight is steady by it."""
_BEYOND_GAUSSIAN = 2.0
"""Factor on the mean square of the second order of tilt errors: the gate then rejects no fix up to 4 sigma of tilt."""


class PropagationBuffers(NamedTuple):
    """Work space of one filter.

    - The step `advance` uses sums, mid (MID_N,), phi (9, 9 + k), a (n, 9) and c_nb (3, 3), with k sensor states.
    - The step `correct` uses diagonal and column (b, 3, 3), turned (n, 3 b) and columns (n, 3). There are b blocks up
      to the last vector of the body.

    straight, body: as of `error_parametrisation`.
    """

    sums: StepSums
    mid: np.ndarray
    phi: np.ndarray
    a: np.ndarray
    c_nb: np.ndarray
    diagonal: np.ndarray
    column: np.ndarray
    turned: np.ndarray
    columns: np.ndarray
    straight: int
    body: int = 0


@kernel_internal
def propagation_buffers(nav, n, straight, declared):
    """Allocate work space for a filter of n states, with the lanes of `nav`.

    declared: sensor states that act on it; those that it estimates come first.
    """
    known = SENSORS + declared.shape[0]
    phi = alloc(nav, (SENSORS, known))
    for i in range(SENSORS):
        for j in range(known):
            phi[i, j] = 0.0
    body = hard_iron(declared)
    moved = max(N_BASE, body + 3) // 3
    return PropagationBuffers(
        allocate_sums(nav, declared), alloc(nav, (MID_N,)), phi, alloc(nav, (n, SENSORS)), alloc(nav, (3, 3)),
        alloc(nav, (moved, 3, 3)), alloc(nav, (moved, 3, 3)), alloc(nav, (n, 3 * moved)), alloc(nav, (n, 3)), straight,
        body,
    )  # fmt: skip


@kernel
def start_axes(nav):
    """Initialise the bias axes: nothing is held back, unless the flight continues one that did."""
    nothing = 0.0 * nav[NAV_BIAS_FRAME]
    for i in range(NAV_BIAS_FRAME, NAV_GYRO):
        nothing += abs(nav[i])
    nav[NAV_BIAS_FRAME] = where(nothing == 0.0, 1.0, nav[NAV_BIAS_FRAME])


@kernel
def start_mechanisation(imu, nav, declared, cursor, increments):
    """The start of a flight: cursor (3,) as of `StreamCursor`, increments (6,) for the interval before the first."""
    cursor[0] = 0.0
    cursor[1] = imu.time[0]
    cursor[2] = imu.time[1] - imu.time[0]
    dtheta, dv = as_simd(imu.dtheta), as_simd(imu.dv)
    first_increments(nav, declared, dtheta[0], dv[0], cursor[2], increments)


@kernel_inline
def is_later(time, cursor):
    """Whether a time is later than the present of a filter.

    If not, `advance` need not be called, which with so many arrays costs as much as an interval.
    """
    return cursor[1] < time - TIME_TOLERANCE


@kernel_inline
def can_advance(imu, until, cursor):
    """Whether a filter has not yet got to `until` (s), and its IMU goes further."""
    return int(cursor[0]) < imu.time.shape[0] - 1 and cursor[1] < until - TIME_TOLERANCE


@kernel_inline
def force_noise(model, cursor):
    """Density of the accelerometers' noise, m2/s3, at the present of a filter."""
    k = min(max(int(cursor[0]), 0), model.noise.shape[0] - 1)
    return max(model.noise[k, NOISE_ACCEL], _NO_NOISE)


@kernel_inline
def mechanise(chart, until, imu, model, nav, p, cursor, increments, space):
    """Mechanise from the present time to `until` (s), or over the longest interval, and sum the inputs of its
    transition.

    Splits an IMU step if necessary. Arguments are those of `advance`.
    """
    time, dtheta, dv, noise = imu.time, as_simd(imu.dtheta), as_simd(imu.dv), model.noise
    mixed, varying, known = is_mixed(model.declared), is_varying(space.sums.declared), model.declared.shape[0]
    inverse = small_matrix(nav, 6, 3)
    if mixed:
        unmixing(nav, model.declared, inverse)
    reset_sums(space.sums)
    declared, total, record, row_of = space.sums.declared, space.sums.total, space.sums.decay, space.sums.row
    # on the stack a step finds its numbers in registers
    motion, previous = small_vector(nav, NAV_SENSORS), small_vector(nav, 6)
    c_nb, mid = small_matrix(nav, 3, 3), small_vector(nav, MID_N)
    for i in range(NAV_SENSORS):
        motion[i] = nav[i]
    for i in range(6):
        previous[i] = increments[i]
    k, length, steps = int(cursor[0]), 0.0, 0
    now = cursor[1]
    begin, first, last = now, min(k, noise.shape[0] - 1), time.shape[0] - 1
    while k < last and now < until - TIME_TOLERANCE:
        end = time[k + 1]
        whole = end - time[k]
        is_whole = now - time[k] < TIME_TOLERANCE
        to_end = end <= until + TIME_TOLERANCE
        dt = (end if to_end else until) - now
        row = min(k, noise.shape[0] - 1)
        if now > begin and (now + dt - begin > LONGEST + TIME_TOLERANCE or is_other_noise(noise, row, first)):
            break
        scale = dt / cursor[2]
        if abs(scale - 1.0) > 1e-6:
            for i in range(6):
                previous[i] *= scale
        share = 1.0 if is_whole and to_end else dt / whole
        tx, ty, tz, ux, uy, uz = compensated(
            nav, mixed, inverse, share * dtheta[k, 0], share * dtheta[k, 1], share * dtheta[k, 2],
            share * dv[k, 0], share * dv[k, 1], share * dv[k, 2], dt,
        )  # fmt: skip
        step(motion, tx, ty, tz, ux, uy, uz, previous, dt, c_nb, mid)
        add_step(total, record, row_of, mid, dt, previous, declared)
        length, steps = length + dt, steps + 1
        if varying:
            accumulate_markov(space.sums, dt)
            for c in range(known):
                nav[NAV_SENSORS + c] *= space.sums.step_decay[c]
        rotate_bias_frame(chart, motion, p, previous, dt)
        cursor[2] = dt
        if to_end:
            k += 1
            now = end
        else:
            now = until
    for i in range(NAV_SENSORS):
        nav[i] = motion[i]
    for i in range(6):
        increments[i] = previous[i]
    copy(mid, space.mid)
    space.sums.length[0], space.sums.length[1] = length, steps
    cursor[0] = k
    cursor[1] = now


@kernel_inline
def is_other_noise(noise, row, first):
    """Whether the noise of a step is another than that of the first."""
    return noise[row, NOISE_GYRO] != noise[first, NOISE_GYRO] or noise[row, NOISE_ACCEL] != noise[first, NOISE_ACCEL]


@kernel_inline
def advance_once(chart, until, imu, model, nav, p, cursor, increments, space):
    """`advance` over one interval."""
    begin, row = cursor[1], min(int(cursor[0]), model.noise.shape[0] - 1)
    mechanise(chart, until, imu, model, nav, p, cursor, increments, space)
    transition(space.sums, space.mid, space.phi)
    predict(p, space.sums, model.noise[row], model.declared, space.phi, space.a)
    propagate_clock(model.clock, cursor[1] - begin, nav, p)


@kernel
def advance(chart, until, imu, model, nav, p, cursor, increments, space):
    """Mechanise and predict from the present time to `until` (s), P once an interval, with the second order of tilt.

    imu, model: `records`. nav (NAV,), p (n, n), cursor (3,), increments (6,), as of `StreamCursor`: overwritten. space:
    from `propagation_buffers`.
    """
    tilt = small_vector(nav, 3)
    while can_advance(imu, until, cursor):
        begin = cursor[1]
        tilt[0], tilt[1], tilt[2] = p[PHI_N, PHI_N], p[PHI_E, PHI_E], p[PHI_N, PHI_E]
        advance_once(chart, until, imu, model, nav, p, cursor, increments, space)
        if model.tilt_time > 0.0:
            add_second_order_of_tilt(p, tilt, space.mid[MID_GRAVITY], cursor[1] - begin, model.tilt_time)


@kernel
def add_second_order_of_tilt(p, tilt, gravity, dt, time):
    """Add to P (n, n) the downward acceleration that F omits of a tilt error: gravity times half its square, over dt
    (s).

    tilt (3,): variances of the tilt errors about north and east and their covariance, rad2. The acceleration stays the
    same for `time` (s), until fixes show the tilt error; a white noise gives the velocity the same variance at that
    time. Its density has twice the mean square for equal variances, whose acceleration is exponential: a Gaussian
    of its own mean square would be too narrow far out. Source: `docs/theory/filter.md`, section 3.
    """
    n, e, both = tilt[0], tilt[1], tilt[2]
    # fourth moments of a Gaussian
    square = 0.25 * gravity * gravity * (3.0 * n * n + 3.0 * e * e + 2.0 * n * e + 4.0 * both * both)
    density = _BEYOND_GAUSSIAN * square * time
    p[V_D, V_D] += density * dt
    p[R_D, R_D] += density * dt * dt * dt / 3.0
    p[R_D, V_D] += 0.5 * density * dt * dt
    p[V_D, R_D] += 0.5 * density * dt * dt


@kernel
def run(chart, imu, measurements, events, state, stream, model, history, errors):
    """Process the events; arguments are those of `filter.records`, or those of lanes.

    chart: of `error_parametrisation.CHARTS`. state, stream: overwritten by those after the last event that was not
    ahead. history, errors: filled in where they have rows.
    """
    declared = model.declared
    state_nav, state_p, state_rejected = (
        as_simd(state.navigation),
        as_simd(state.covariance),
        as_simd(state.rejected),
    )
    stream_increments = as_simd(stream.increments)
    record, account = as_registers(history), as_error_registers(errors)
    n = state_p.shape[0]
    buffers = update_buffers(state_nav, n)
    space = propagation_buffers(state_nav, n, chart.straight, declared)
    epoch = range_epoch(state_nav, n, 1, events, model.clock.scales.shape[0])
    # the filter itself, and its copy that runs ahead
    navs, ps = alloc(state_nav, (2, state_nav.shape[0])), alloc(state_nav, (2, n, n))
    increments_pair, cursors = alloc(state_nav, (2, 6)), np.empty((2, 3))
    line, v, variance, m_force = (
        as_simd(state.steady),
        alloc(state_nav, (3,)),
        alloc(state_nav, (3,)),
        alloc(state_nav, (3,)),
    )
    rejections = alloc(state_nav, (2, state_rejected.shape[0]))
    shift, shifts, predicted = as_simd(state.shift), alloc(state_nav, (2, SHIFT_N)), alloc(state_nav, state_nav.shape)
    held = alloc(state_nav, (3, 3))
    copy(state_nav, navs[0])
    copy_matrix(state_p, ps[0])
    copy(state_rejected, rejections[0])
    copy(shift, shifts[0])
    copy(stream_increments, increments_pair[0])
    copy(stream.cursor, cursors[0])
    if stream.cursor[0] < 0.0:
        start_axes(navs[0])
        start_mechanisation(imu, navs[0], declared, cursors[0], increments_pair[0])
        start_line(line, navs[0, NAV_VEL:NAV_QUAT], cursors[0, 1])
        if chart.products > 0:
            start_products(chart.products, navs[0], ps[0])
    work = (
        account, buffers, space, epoch, navs, ps, increments_pair, cursors, v, variance, m_force, rejections, shifts,
        predicted, held,
    )  # fmt: skip
    _process(chart, imu, measurements, events, model, line, record, work)
    copy(navs[0], state_nav)
    copy_matrix(ps[0], state_p)
    copy(rejections[0], state_rejected)
    copy(shifts[0], shift)
    copy(increments_pair[0], stream_increments)
    copy(cursors[0], stream.cursor)


@kernel
def _process(chart, imu, measurements, events, model, line, record, work):
    """Process the events; `work` is what `run` allocates. Apart from it, since it owns no array."""
    (
        account, buffers, space, epoch, navs, ps, increments_pair, cursors, v, variance, m_force, rejections, shifts,
        predicted, held,
    ) = work  # fmt: skip
    declared, constrained, first = model.declared, chart.kind in CONSTRAINED, 0
    before = 0
    for i in range(events.time.shape[0]):
        ahead = 1 if events.ahead[i] else 0
        if ahead > before:
            copy(navs[0], navs[1])
            copy_matrix(ps[0], ps[1])
            copy(increments_pair[0], increments_pair[1])
            copy(cursors[0], cursors[1])
            copy(rejections[0], rejections[1])
            copy(shifts[0], shifts[1])
        before = ahead
        nav, p, increments, cursor, rejected = (
            navs[ahead],
            ps[ahead],
            increments_pair[ahead],
            cursors[ahead],
            rejections[ahead],
        )
        kind, row = events.kind[i], events.row[i]
        clear_event(record, i)
        if is_later(events.time[i], cursor):
            if model.steady_force and not ahead and not is_interval_started(line):
                velocity_of(nav, p, v, variance)
                begin_interval(line, v, variance, force_noise(model, cursor), cursor[1])
            if constrained:
                start_transition(chart.kind, shifts[ahead], p)
            if chart.products > 0:
                hold_position(p, held)
            advance(chart, events.time[i], imu, model, nav, p, cursor, increments, space)
            if chart.products > 0:
                predict_products(chart.products, held, nav, p)
        if model.steady_force and not ahead and kind != OUTPUT and kind != PASS and is_interval_started(line):
            velocity_of(nav, p, v, variance)
            attitude = nav[NAV_QUAT:NAV_BIAS_FRAME]
            end_interval(line, v, variance, attitude, force_noise(model, cursor), cursor[1], m_force)
            couple(p, VEL, m_force, 1.0)
        if kind == OUTPUT:
            write_output(chart, nav, p, record, account, row)
        elif kind != PASS:
            if constrained:
                copy(nav, predicted)
            if kind == RANGE:
                if is_epoch_boundary(events, i, 1):
                    first = i
                    begin_epoch(epoch)
                    begin_estimate(epoch, 0, p)
                m = predict_range(
                    chart, row, measurements, declared, nav, increments, cursor[2], epoch, 0, space, buffers
                )
            else:
                m = observe(
                    kind, row, measurements, nav, increments, cursor[2], declared, space.c_nb, buffers.have, buffers.z,
                    buffers.h, buffers.r,
                )  # fmt: skip
            degrees = count_valid(buffers.have, m)
            weighed = innovation_factor(p, buffers.h, buffers.r, m, buffers.pht, buffers.s) & (degrees > 0.0)
            counter = slot(kind, row, measurements)
            if expects_outliers(kind, measurements):
                outliers = measurements.beacons.outliers
                lost = is_lost(rejected[counter], outliers, model.max_rejected) & (degrees > 0.0)
                if any_lane(lost):
                    hold_position(p, held)
                    widen(p, lost, buffers.z[0], buffers.s[0, 0])
                    if chart.products > 0:
                        predict_products(chart.products, held, nav, p)
                    weighed = innovation_factor(p, buffers.h, buffers.r, m, buffers.pht, buffers.s) & (degrees > 0.0)
                    rejected[counter] = where(lost, 0.0, rejected[counter])
                mean, buffers.spread[0], _, _, clean = outlier_moments(buffers.z[0], buffers.s[0, 0], outliers)
                buffers.z[0] -= mean
                count_rejection(weighed, clean > 0.5, counter, rejected)
            used = weighed
            if any_lane(weighed):
                estimate_by_factor(buffers.pht, buffers.s, buffers.z, m, buffers.x)
                tested = not expects_outliers(kind, measurements)
                used = apply_gate(ahead > 0, weighed, degrees, m, buffers, counter, tested, model, rejected, record, i)
                if any_lane(used):
                    if kind == RANGE:
                        gain_by_factor(buffers.s, m, buffers.pht, buffers.k)
                        accumulate_range(used, m, p, epoch, 0, buffers)
                    else:
                        update(
                            chart, used, kind, row, measurements, declared, nav, p, increments, cursor[2], space,
                            buffers
                        )  # fmt: skip
            if kind == RANGE:
                count_range(measurements.ranges, row, i - first, weighed, used, epoch)
                if is_epoch_boundary(events, i, 0):
                    # one estimate: it is there in every lane
                    apply_epoch(
                        chart, epoch.available[0] >= 0.0, events.row[first : i + 1], measurements, declared, nav, p,
                        increments, cursor[2], epoch, 0, space, buffers,
                    )  # fmt: skip
                    if detect_clock_jumps(epoch.available, epoch.accepted, epoch.jumped):
                        reset_clock(epoch.jumped, p)
            if chart.products > 0 and kind != RANGE and kind != BEACON:
                start_products(chart.products, nav, p)
            if constrained:
                note_shift(nav, predicted, buffers.x, shifts[ahead])
