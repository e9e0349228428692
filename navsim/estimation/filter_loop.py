"""The loop that all filter kinds share: mechanise, predict, weigh a measurement, correct, answer, event by event.

The filter lives at the time of its newest measurement. One that arrives late is applied to the state of its own time,
interpolated inside the IMU interval, and the answer for the present is that state mechanised forward, with what has
arrived in the meantime: the optimal use of late measurements, with nothing approximated (`records.schedule`).

A flight may be flown in pieces: what a filter is between two of them is its `State` and its `Way`. All arrays may be
lanes: what differs between runs is a mask.

All kinds predict and weigh with the same plain errors d = (dr, dv, theta, sensor states) and their covariance; they
differ in their chart (`charts`), in which a filter is corrected. What it leaves is said in `answers`.

Source: `docs/theory/filter.md`, sections 3 to 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import inlined, kernel, within
from navsim.compiler.lanes import any_lane, registers, room, select
from navsim.compiler.linear import copy, copy_matrix
from navsim.core.covariance import NOISE_ACCEL, age, felt, gain, gather, is_varying, predict
from navsim.core.states import NAV_GYRO, NAV_HELD, NAV_QUAT, NAV_SENSORS, NAV_VEL, SENSORS, VEL, N
from navsim.core.strapdown import MID_N, compensated, first_increments, is_mixed, step, unmixing
from navsim.estimation.answers import answer, nothing_yet, opened
from navsim.estimation.charts import turn_axes
from navsim.estimation.clock import forget_clock, has_jumped, run_clock_on
from navsim.estimation.first_estimates import note_shift, start_transition
from navsim.estimation.observations import RANGE, observe, slot
from navsim.estimation.ranges import (
    begin_epoch,
    begin_estimate,
    count_range,
    foresee,
    is_alone,
    move_estimate,
    range_epoch,
    take_range,
)
from navsim.estimation.records import CONSTRAINED, OUTPUT, PASS, SHIFT_N, TIME_TOLERANCE
from navsim.estimation.steady_force import begin_interval, couple, end_interval, has_begun, start_line, velocity_of
from navsim.estimation.weighing import decide, errors_from, numbers_in, update, weighing

_NO_NOISE = 1e-30
"""Density of noise of accelerometers that have none, m2/s3: no flight is steady by it."""


class Workshop(NamedTuple):
    """Work space: mid (MID_N,), phi (9, n), a (n, 9), c_nb (3, 3), inverse (2, 3, 3) of `advance`; diagonal, column
    (5, 3, 3), turned (n, 15), columns (n, 3) of `correct`; left, gathered (n - 9,), no lanes, of what time does to
    sensor states; straight: as of `charts`."""

    mid: np.ndarray
    phi: np.ndarray
    a: np.ndarray
    c_nb: np.ndarray
    inverse: np.ndarray
    diagonal: np.ndarray
    column: np.ndarray
    turned: np.ndarray
    columns: np.ndarray
    left: np.ndarray
    gathered: np.ndarray
    straight: int


@within
def workshop(nav, n, straight):
    """Work space for a filter of n states, of what `nav` holds."""
    phi = room(nav, (SENSORS, n))
    for i in range(SENSORS):
        for j in range(n):
            phi[i, j] = 0.0
    return Workshop(
        room(nav, (MID_N,)), phi, room(nav, (n, SENSORS)), room(nav, (3, 3)), room(nav, (2, 3, 3)),
        room(nav, (N // 3, 3, 3)), room(nav, (N // 3, 3, 3)), room(nav, (n, N)), room(nav, (n, 3)),
        np.empty(n - SENSORS), np.empty(n - SENSORS), straight,
    )  # fmt: skip


@kernel
def start_axes(nav):
    """Bias axes at the start of a flight: nothing is held back, unless it goes on from an earlier one that did."""
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
def start_ageing(left, gathered):
    """No time has passed for declared states (k,) yet, see `core.covariance.gather`."""
    for c in range(left.shape[0]):
        left[c], gathered[c] = 1.0, 0.0


@inlined
def grow_old(nav, p, first, left, gathered):
    """Let the declared states from `first` on decay and be driven, in their estimates and in P."""
    for c in range(left.shape[0]):
        nav[NAV_SENSORS + first + c] *= left[c]
    age(p, SENSORS + first, left, gathered)


@inlined
def is_ahead(time, cursor):
    """Whether a time is later than the present of a filter: where not there is nowhere to `advance` to, and a call of
    so many arrays costs as much as an interval."""
    return cursor[1] < time - TIME_TOLERANCE


@inlined
def force_noise(model, cursor):
    """Density of the accelerometers' noise, m2/s3, at the present of a filter."""
    k = min(max(int(cursor[0]), 0), model.noise.shape[0] - 1)
    return max(model.noise[k, NOISE_ACCEL], _NO_NOISE)


@kernel
def advance(chart, until, imu, model, nav, p, cursor, increments, space):
    """Mechanise and predict from the present time to `until` (s), cutting an IMU interval where it must.

    imu, model: `records`. nav (NAV,), p (n, n), cursor (3,), increments (6,), as of `Way`: overwritten. space: from
    `workshop`; its mid and phi are those of the last interval.
    """
    time, dtheta, dv = imu.time, registers(imu.dtheta), registers(imu.dv)
    declared, noise = model.declared, model.noise
    inertial = felt(declared)
    own, lasting = declared[:inertial], declared[inertial:]
    varying, others_vary, mixed = is_varying(own), is_varying(lasting), is_mixed(declared)
    left, gathered = space.left[:inertial], space.gathered[:inertial]
    # errors that last act on nothing before they are measured: what time does to them is done once
    known = declared.shape[0]
    others_left, others_gathered = space.left[inertial:known], space.gathered[inertial:known]
    start_ageing(others_left, others_gathered)
    if mixed:
        unmixing(nav, declared, space.inverse)
    k = int(cursor[0])
    now = cursor[1]
    last = time.shape[0] - 1
    while k < last and now < until - TIME_TOLERANCE:
        end = time[k + 1]
        whole = end - time[k]
        whole_left = now - time[k] < TIME_TOLERANCE
        to_end = end <= until + TIME_TOLERANCE
        dt = (end if to_end else until) - now
        scale = dt / cursor[2]
        if abs(scale - 1.0) > 1e-6:
            for i in range(6):
                increments[i] *= scale
        share = 1.0 if whole_left and to_end else dt / whole
        tx, ty, tz, ux, uy, uz = compensated(
            nav, mixed, space.inverse, share * dtheta[k, 0], share * dtheta[k, 1], share * dtheta[k, 2],
            share * dv[k, 0], share * dv[k, 1], share * dv[k, 2], dt,
        )  # fmt: skip
        step(nav, tx, ty, tz, ux, uy, uz, increments, dt, space.c_nb, space.mid)
        predict(p, space.mid, dt, increments, noise[min(k, noise.shape[0] - 1)], declared, space.phi, space.a)
        if varying:
            start_ageing(left, gathered)
            gather(own, dt, left, gathered)
            grow_old(nav, p, 0, left, gathered)
        if others_vary:
            gather(lasting, dt, others_left, others_gathered)
        turn_axes(chart, nav, p, increments, dt)
        cursor[2] = dt
        if to_end:
            k += 1
            now = end
        else:
            now = until
    if others_vary:
        grow_old(nav, p, inertial, others_left, others_gathered)
    run_clock_on(model.clock, now - cursor[1], nav, p)
    cursor[0] = k
    cursor[1] = now


@kernel
def run(chart, imu, measurements, events, state, way, model, account):
    """Fly through the events; arguments are those of `estimation.records`, or those of lanes.

    chart: of `charts.CHARTS`. state, way: overwritten by those after the last event that was not ahead. account: it, or
    a history, is filled in.
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
    space = workshop(state_nav, n, chart.straight)
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
