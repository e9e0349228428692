"""The loop that all filter kinds share: mechanise, predict, weigh a measurement, correct, answer, event by event.

The filter lives at the time of its newest measurement. One that arrives late is applied to the state of its own time,
interpolated inside the IMU interval, and the answer for the present is that state mechanised forward, with what has
arrived in the meantime: the optimal use of late measurements, with nothing approximated (`records.schedule`).

All kinds predict and weigh with the same plain errors d = (dr, dv, theta, sensor states) and their covariance; they
differ in how the estimate is fed back and the covariance carried to the new estimate, `correct`, and in the coordinates
in which the error is judged, `own_error`: see `error_state`, `invariant`, `tfg`.

Source: `docs/theory/filter.md`, sections 3 to 7.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core.covariance import SIZE, gain, is_varying, joseph, kept, predict, square, vary
from navsim.core.jit import kernel
from navsim.core.states import NAV_GYRO, NAV_HELD, NAV_SENSORS
from navsim.core.strapdown import MID_N, compensated, first_increments, is_mixed, step, unmixing
from navsim.estimation import error_state, invariant, tfg
from navsim.estimation.observations import MOST, observe
from navsim.estimation.records import (
    ESKF,
    LEFT_INVARIANT,
    OUTPUT,
    PASS,
    REJECTED,
    TFG,
    TIME_TOLERANCE,
    USED,
)


@kernel
def set_off(imu, nav, declared, cursor, increments):
    """The start of a flight: cursor (3,) as of `advance`, increments (6,) for the interval before the first."""
    cursor[0] = 0.0
    cursor[1] = imu.time[0]
    cursor[2] = imu.time[1] - imu.time[0]
    first_increments(nav, declared, imu.dtheta[0], imu.dv[0], cursor[2], increments)


@kernel
def advance(kind, until, imu, model, nav, p, cursor, increments, scratch, c_nb, inverse):
    """Mechanise and predict from the present time to `until` (s), cutting an IMU interval where it must.

    imu, model: `records`. nav (NAV,), p (SIZE,): overwritten. cursor: (3,) index of the current IMU interval, present
    time s, length of the interval last used s. increments: (6,) its compensated increments.
    scratch: work space (MID_N + 3 * SIZE,), zero at first; c_nb: (3, 3), inverse: (2, 3, 3).
    """
    mid = scratch[:MID_N]
    phi = scratch[MID_N : MID_N + SIZE]
    a = scratch[MID_N + SIZE : MID_N + 2 * SIZE]
    b = scratch[MID_N + 2 * SIZE : MID_N + 3 * SIZE]
    time, dtheta, dv = imu.time, imu.dtheta, imu.dv
    declared, noise = model.declared, model.noise
    varying, mixed = is_varying(declared), is_mixed(declared)
    if mixed:
        unmixing(nav, declared, inverse)
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
            nav, mixed, inverse, share * dtheta[k, 0], share * dtheta[k, 1], share * dtheta[k, 2],
            share * dv[k, 0], share * dv[k, 1], share * dv[k, 2], dt,
        )  # fmt: skip
        step(nav, tx, ty, tz, ux, uy, uz, increments, dt, c_nb, mid)
        predict(p, mid, increments, noise[min(k, noise.shape[0] - 1)], declared, phi, a, b)
        if varying:
            vary(declared, dt, p)
            for c in range(declared.shape[0]):
                nav[NAV_SENSORS + c] *= kept(declared[c].decay, dt)
        if kind == TFG:
            tfg.hold_axes(nav, p, increments, dt)
        cursor[2] = dt
        if to_end:
            k += 1
            now = end
        else:
            now = until
    cursor[0] = k
    cursor[1] = now


@kernel
def keep_innovation(place, m, z, s, innovation, innovation_sigma):
    """Innovations z (m,) and 1 sigma, from the factor s of their covariance, into the places (MOST,) they are of."""
    for a in range(m):
        innovation[place[a]] = z[a]
        t = 0.0
        for b in range(a + 1):
            t += s[a, b] * s[a, b]
        innovation_sigma[place[a]] = math.sqrt(t)


@kernel
def whitened_square(s, z, m):
    """z' S^-1 z through the Cholesky factor s of S that `gain` left; z (m,) is spoiled."""
    q = 0.0
    for a in range(m):
        t = z[a]
        for b in range(a):
            t -= s[a, b] * z[b]
        z[a] = t / s[a, a]
        q += z[a] * z[a]
    return q


@kernel
def correct(kind, nav, p, x, work):
    """Feed the estimated errors x (n,) back and carry P to the new estimate, as the kind does it. work: (3 * SIZE,)."""
    if kind == ESKF:
        error_state.correct(nav, p, x, work)
    elif kind == LEFT_INVARIANT:
        invariant.correct(nav, p, x, work)
    else:
        tfg.correct(nav, p, x, work)


@kernel
def own_error(kind, nav, error, out):
    """The plain error (n,) in the coordinates in which the kind is Gaussian, out (n,)."""
    if kind == ESKF:
        out[:] = error
    elif kind == LEFT_INVARIANT:
        invariant.own_error(error, out)
    else:
        tfg.own_error(nav, error, out)


@kernel
def run(imu, measurements, events, state, model, history):
    """Fly through the events; arguments are those of `estimation.records`.

    state: overwritten by the final one, at the last event that was not ahead. history: filled in.
    """
    kind, declared = model.kind, model.declared
    n = history.covariance.shape[1]
    x = np.empty(n)
    h = np.empty((MOST, n))
    z = np.empty(MOST)
    r = np.empty((MOST, MOST))
    s = np.empty((MOST, MOST))
    place = np.empty(MOST, np.int64)
    k = np.empty((n, MOST))
    pht = np.empty((n, MOST))
    work = np.empty((n, MOST))
    c_nb, inverse = np.empty((3, 3)), np.empty((2, 3, 3))
    scratch = np.zeros(MID_N + 3 * SIZE)
    space = np.zeros(3 * SIZE)
    # the filter itself, and its copy that runs ahead
    navs = np.empty((2, state.navigation.shape[0]))
    ps = np.zeros((2, SIZE))
    increments_pair = np.empty((2, 6))
    cursors = np.zeros((2, 3))
    rejections = np.zeros((2, state.rejected.shape[0]), np.int64)

    navs[0] = state.navigation
    ps[0] = state.covariance
    rejections[0] = state.rejected
    # a flight that goes on from an earlier piece keeps the bias axes of its covariance
    if not navs[0, NAV_HELD:NAV_GYRO].any():
        navs[0, NAV_HELD] = 1.0
    set_off(imu, navs[0], declared, cursors[0], increments_pair[0])
    before = 0
    for i in range(events.time.shape[0]):
        ahead = 1 if events.ahead[i] else 0
        if ahead > before:
            navs[1] = navs[0]
            ps[1] = ps[0]
            increments_pair[1] = increments_pair[0]
            cursors[1] = cursors[0]
            rejections[1] = rejections[0]
        before = ahead
        nav, p, increments, cursor, rejected = (
            navs[ahead],
            ps[ahead],
            increments_pair[ahead],
            cursors[ahead],
            rejections[ahead],
        )
        what, row = events.kind[i], events.row[i]
        advance(kind, events.time[i], imu, model, nav, p, cursor, increments, scratch, c_nb, inverse)
        if what == OUTPUT:
            history.navigation[row] = nav
            square(p, history.covariance[row])
        elif what != PASS:
            m = observe(what, row, measurements, nav, increments, cursor[2], declared, c_nb, place, z, h, r)
            if m == 0 or not gain(p, h, r, m, pht, s, k):
                continue
            if ahead == 0:
                keep_innovation(place, m, z, s, history.innovation[i], history.innovation_sigma[i])
            for j in range(n):
                x[j] = 0.0
                for a in range(m):
                    x[j] += k[j, a] * z[a]
            q = whitened_square(s, z, m)
            used = q <= model.gate[m] or rejected[what] >= model.max_rejected
            if ahead == 0:
                history.innovation_squared[i] = q
                history.degrees[i] = m
                history.status[i] = USED if used else REJECTED
            if used:
                rejected[what] = 0
                # Gauss-Newton: the prior is carried to the new estimate and weighed there. Weighing before
                # carrying would keep the correlations that J_l(theta) y gives the fix at the old one
                correct(kind, nav, p, x, space)
                observe(what, row, measurements, nav, increments, cursor[2], declared, c_nb, place, z, h, r)
                gain(p, h, r, m, pht, s, k)
                joseph(p, h, r, m, pht, k, work)
            else:
                rejected[what] += 1
    state.navigation[:] = navs[0]
    state.covariance[:] = ps[0]
    state.rejected[:] = rejections[0]
