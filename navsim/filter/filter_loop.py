"""Event loop of all filter kinds: mechanise, predict, update with a measurement, correct, output.

The filter is at the time of its newest measurement. A late measurement is applied to the state at its time of validity,
interpolated inside the IMU interval. The output for the present is that state mechanised forward, with the measurements
that arrived in the meantime. This is the optimal use of late measurements, without approximation (`records.schedule`).

A flight may be processed in pieces: `State` and `Way` hold the filter between two of them. Arrays may be SIMD lanes;
masks hold the differences between runs.

All kinds predict and update with the plain errors d = (dr, dv, theta, sensor states) and their covariance. They differ
in the chart (`error_parametrisation`) of the correction. `history` writes the output.

Source: `docs/theory/filter.md`, sections 3 to 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import inlined, kernel, within
from navsim.compiler.lanes import any_lane, registers, room, select, small_matrix, small_vector
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import NOISE_ACCEL, NOISE_GYRO, gain, is_varying, predict
from navsim.filter.error_parametrisation import turn_axes
from navsim.filter.first_estimates import note_shift, start_transition
from navsim.filter.history import answer, nothing_yet, opened
from navsim.filter.interval import LONGEST, StepSums, add_step, age_sums, begin_sums, sums_of, transition
from navsim.filter.measurement_models import RANGE, hard_iron, observe, slot
from navsim.filter.range_update import (
    begin_epoch,
    begin_estimate,
    count_range,
    foresee,
    is_alone,
    move_estimate,
    range_epoch,
    take_range,
)
from navsim.filter.receiver_clock import forget_clock, has_jumped, run_clock_on
from navsim.filter.records import CONSTRAINED, OUTPUT, PASS, SHIFT_N, TIME_TOLERANCE
from navsim.filter.states import NAV_GYRO, NAV_HELD, NAV_QUAT, NAV_SENSORS, NAV_VEL, SENSORS, VEL, N
from navsim.filter.steady_force import begin_interval, couple, end_interval, has_begun, start_line, velocity_of
from navsim.filter.strapdown import MID_N, compensated, first_increments, is_mixed, step, unmixing
from navsim.filter.update import decide, errors_from, numbers_in, update, weighing

_NO_NOISE = 1e-30
"""Density of noise of accelerometers that have none, m2/s3: no flight is steady by it."""


class Workshop(NamedTuple):
    """Work space: sums, mid (MID_N,), phi (9, 9 + k), a (n, 9), c_nb (3, 3) of `advance`, of k sensor states; diagonal,
    column (b, 3, 3), turned (n, 3 b), columns (n, 3) of `correct`, b blocks up to the last vector of the body;
    straight, body: as of `error_parametrisation`."""

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


@within
def workshop(nav, n, straight, declared):
    """Allocate work space for a filter of n states, with the lanes of `nav`.

    declared: sensor states that act on it; those that it estimates come first.
    """
    known = SENSORS + declared.shape[0]
    phi = room(nav, (SENSORS, known))
    for i in range(SENSORS):
        for j in range(known):
            phi[i, j] = 0.0
    body = hard_iron(declared)
    moved = max(N, body + 3) // 3
    return Workshop(
        sums_of(nav, declared), room(nav, (MID_N,)), phi, room(nav, (n, SENSORS)), room(nav, (3, 3)),
        room(nav, (moved, 3, 3)), room(nav, (moved, 3, 3)), room(nav, (n, 3 * moved)), room(nav, (n, 3)), straight,
        body,
    )  # fmt: skip


@kernel
def start_axes(nav):
    """Initialise the bias axes: nothing is held back, unless the flight continues one that did."""
    nothing = 0.0 * nav[NAV_HELD]
    for i in range(NAV_HELD, NAV_GYRO):
        nothing += abs(nav[i])
    nav[NAV_HELD] = select(nothing == 0.0, 1.0, nav[NAV_HELD])


@kernel
def set_off(imu, nav, declared, cursor, increments):
    """The start of a flight: cursor (3,) as of `Way`, increments (6,) for the interval before the first."""
    cursor[0] = 0.0
    cursor[1] = imu.time[0]
    cursor[2] = imu.time[1] - imu.time[0]
    dtheta, dv = registers(imu.dtheta), registers(imu.dv)
    first_increments(nav, declared, dtheta[0], dv[0], cursor[2], increments)


@inlined
def is_ahead(time, cursor):
    """Whether a time is later than the present of a filter.

    If not, `advance` need not be called, which with so many arrays costs as much as an interval.
    """
    return cursor[1] < time - TIME_TOLERANCE


@inlined
def goes_on(imu, until, cursor):
    """Whether a filter has not yet got to `until` (s), and its IMU goes further."""
    return int(cursor[0]) < imu.time.shape[0] - 1 and cursor[1] < until - TIME_TOLERANCE


@inlined
def force_noise(model, cursor):
    """Density of the accelerometers' noise, m2/s3, at the present of a filter."""
    k = min(max(int(cursor[0]), 0), model.noise.shape[0] - 1)
    return max(model.noise[k, NOISE_ACCEL], _NO_NOISE)


@inlined
def mechanise(chart, until, imu, model, nav, p, cursor, increments, space):
    """Mechanise from the present time to `until` (s), or over the longest interval, and sum the inputs of its
    transition.

    Splits an IMU step if necessary. Arguments are those of `advance`.
    """
    time, dtheta, dv, noise = imu.time, registers(imu.dtheta), registers(imu.dv), model.noise
    mixed, varying, known = is_mixed(model.declared), is_varying(space.sums.declared), model.declared.shape[0]
    inverse = small_matrix(nav, 6, 3)
    if mixed:
        unmixing(nav, model.declared, inverse)
    begin_sums(space.sums)
    declared, total, left = space.sums.declared, space.sums.total, space.sums.left
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
        whole_left = now - time[k] < TIME_TOLERANCE
        to_end = end <= until + TIME_TOLERANCE
        dt = (end if to_end else until) - now
        row = min(k, noise.shape[0] - 1)
        if now > begin and (now + dt - begin > LONGEST + TIME_TOLERANCE or is_other(noise, row, first)):
            break
        scale = dt / cursor[2]
        if abs(scale - 1.0) > 1e-6:
            for i in range(6):
                previous[i] *= scale
        share = 1.0 if whole_left and to_end else dt / whole
        tx, ty, tz, ux, uy, uz = compensated(
            nav, mixed, inverse, share * dtheta[k, 0], share * dtheta[k, 1], share * dtheta[k, 2],
            share * dv[k, 0], share * dv[k, 1], share * dv[k, 2], dt,
        )  # fmt: skip
        step(motion, tx, ty, tz, ux, uy, uz, previous, dt, c_nb, mid)
        add_step(total, left, mid, dt, previous, declared)
        length, steps = length + dt, steps + 1
        if varying:
            age_sums(space.sums, dt)
            for c in range(known):
                nav[NAV_SENSORS + c] *= space.sums.step_left[c]
        turn_axes(chart, motion, p, previous, dt)
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


@inlined
def is_other(noise, row, first):
    """Whether the noise of a step is another than that of the first."""
    return noise[row, NOISE_GYRO] != noise[first, NOISE_GYRO] or noise[row, NOISE_ACCEL] != noise[first, NOISE_ACCEL]


@inlined
def advance_once(chart, until, imu, model, nav, p, cursor, increments, space):
    """`advance` over one interval."""
    begin, row = cursor[1], min(int(cursor[0]), model.noise.shape[0] - 1)
    mechanise(chart, until, imu, model, nav, p, cursor, increments, space)
    transition(space.sums, space.mid, space.phi)
    predict(p, space.sums, model.noise[row], model.declared, space.phi, space.a)
    run_clock_on(model.clock, cursor[1] - begin, nav, p)


@kernel
def advance(chart, until, imu, model, nav, p, cursor, increments, space):
    """Mechanise and predict from the present time to `until` (s), P once an interval.

    imu, model: `records`. nav (NAV,), p (n, n), cursor (3,), increments (6,), as of `Way`: overwritten. space: from
    `workshop`.
    """
    while goes_on(imu, until, cursor):
        advance_once(chart, until, imu, model, nav, p, cursor, increments, space)


@kernel
def run(chart, imu, measurements, events, state, way, model, account):
    """Process the events; arguments are those of `filter.records`, or those of lanes.

    chart: of `error_parametrisation.CHARTS`. state, way: overwritten by those after the last event that was not ahead.
    account: it, or a history, is filled in.
    """
    declared = model.declared
    state_nav, state_p, state_rejected = (
        registers(state.navigation),
        registers(state.covariance),
        registers(state.rejected),
    )
    way_increments = registers(way.increments)
    left = opened(account)
    n = state_p.shape[0]
    gauge = weighing(state_nav, n)
    space = workshop(state_nav, n, chart.straight, declared)
    epoch, first = range_epoch(state_nav, n, 1, events, model.clock.scales.shape[0]), 0
    # the filter itself, and its copy that runs ahead
    navs, ps = room(state_nav, (2, state_nav.shape[0])), room(state_nav, (2, n, n))
    increments_pair, cursors = room(state_nav, (2, 6)), np.empty((2, 3))
    line, v, variance, m_force = (
        registers(state.steady),
        room(state_nav, (3,)),
        room(state_nav, (3,)),
        room(state_nav, (3,)),
    )
    rejections = room(state_nav, (2, state_rejected.shape[0]))
    constrained, shift = chart.kind in CONSTRAINED, registers(state.shift)
    shifts, predicted = room(state_nav, (2, SHIFT_N)), room(state_nav, (state_nav.shape[0],))

    copy(state_nav, navs[0])
    copy_matrix(state_p, ps[0])
    copy(state_rejected, rejections[0])
    copy(shift, shifts[0])
    copy(way_increments, increments_pair[0])
    copy(way.cursor, cursors[0])
    if way.cursor[0] < 0.0:
        start_axes(navs[0])
        set_off(imu, navs[0], declared, cursors[0], increments_pair[0])
        start_line(line, navs[0, NAV_VEL:NAV_QUAT], cursors[0, 1])
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
        what, row = events.kind[i], events.row[i]
        nothing_yet(left, i)
        if is_ahead(events.time[i], cursor):
            if model.steady_force and not ahead and not has_begun(line):
                velocity_of(nav, p, v, variance)
                begin_interval(line, v, variance, force_noise(model, cursor), cursor[1])
            if constrained:
                start_transition(chart.kind, shifts[ahead], p)
            advance(chart, events.time[i], imu, model, nav, p, cursor, increments, space)
        if model.steady_force and not ahead and what != OUTPUT and what != PASS and has_begun(line):
            velocity_of(nav, p, v, variance)
            attitude = nav[NAV_QUAT:NAV_HELD]
            end_interval(line, v, variance, attitude, force_noise(model, cursor), cursor[1], m_force)
            couple(p, VEL, m_force, 1.0)
        if what == OUTPUT:
            answer(chart, nav, p, left, row)
        elif what != PASS:
            if constrained:
                copy(nav, predicted)
            if what == RANGE:
                if is_alone(events, i, 1):
                    first = i
                    begin_epoch(epoch)
                    begin_estimate(epoch, 0, p)
                m = foresee(chart, row, measurements, declared, nav, increments, cursor[2], epoch, 0, space, gauge)
            else:
                m = observe(
                    what, row, measurements, nav, increments, cursor[2], declared, space.c_nb, gauge.have, gauge.z,
                    gauge.h, gauge.r,
                )  # fmt: skip
            degrees = numbers_in(gauge.have, m)
            weighed = gain(p, gauge.h, gauge.r, m, gauge.pht, gauge.s, gauge.k) & (degrees > 0.0)
            used = weighed
            if any_lane(weighed):
                errors_from(gauge.k, gauge.z, m, gauge.x)
                where = slot(what, row, measurements)
                used = decide(ahead > 0, weighed, degrees, m, gauge, where, model, rejected, left, i)
                if any_lane(used):
                    if what == RANGE:
                        take_range(used, m, p, epoch, 0, gauge)
                    else:
                        update(
                            chart, used, what, row, measurements, declared, nav, p, increments, cursor[2], space, gauge
                        )  # fmt: skip
            if what == RANGE:
                count_range(measurements.ranges, row, i - first, weighed, used, epoch)
                if is_alone(events, i, 0):
                    # one estimate: it is there in every lane
                    move_estimate(
                        chart, epoch.heard[0] >= 0.0, events.row[first : i + 1], measurements, declared, nav, p,
                        increments, cursor[2], epoch, 0, space, gauge,
                    )  # fmt: skip
                    if has_jumped(epoch.heard, epoch.kept, epoch.jumped):
                        forget_clock(epoch.jumped, p)
            if constrained:
                note_shift(nav, predicted, gauge.x, shifts[ahead])
    copy(navs[0], state_nav)
    copy_matrix(ps[0], state_p)
    copy(rejections[0], state_rejected)
    copy(shifts[0], shift)
    copy(increments_pair[0], way_increments)
    copy(cursors[0], way.cursor)
