"""The loosely coupled loop all filter kinds share: mechanise, predict, weigh a fix, correct, record.

Measurements are receiver fixes, z = fix - strapdown at the antenna: position, and velocity where wanted.
The filter lives at the time its newest fix was valid. A fix that arrives `latency` late is applied to the
state of its own time, interpolated inside the IMU interval, and the answer for the present is that state
mechanised forward: the optimal use of late measurements, with nothing approximated.

All kinds predict and weigh with the same plain errors d = (dr, dv, theta, db_g, db_a) and their covariance;
they differ in how the estimate is fed back and the covariance carried to the new estimate, `correct`, and in
the coordinates in which the error is judged, `own_error`: see `error_state`, `invariant`, `tfg`.

Sources: [1] `landing.md` section 5; [2] `filter.md`; [3] Groves (2013), sections 14.2, 14.3 (loosely coupled
update with lever arm, eqs. 14.102-14.108).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navsim.core import states
from navsim.core.attitude import dcm, difference
from navsim.core.covariance import (
    NOISE_ACCEL_DECAY,
    NOISE_GYRO_DECAY,
    SIZE,
    STRIDE,
    gain,
    joseph,
    normalised_square,
    predict,
)
from navsim.core.earth import RATE, radii, short_way
from navsim.core.jit import kernel
from navsim.core.strapdown import MID_N, step
from navsim.estimation import error_state, invariant, tfg

ESKF, LEFT_INVARIANT, TFG, MAP, RTS = 0, 1, 2, 3, 4
"""Kinds of filter; MAP and RTS are no filters but `estimation.smoother`."""
KINDS = {"eskf": ESKF, "left-invariant": LEFT_INVARIANT, "tfg": TFG, "map": MAP, "rts": RTS}

NO_FIX, USED, REJECTED = 0, 1, 2
"""What became of an epoch: no fix to use, fix used, fix rejected by the innovation gate."""

TIME_TOLERANCE = 1e-9
"""Times closer than this are one, s: well under any sample interval, well over rounding."""


class Flown(NamedTuple):
    """What a filter leaves of one run of e fixes, filled in by the kernels.

    error, sigma (e + 1, 15) plain errors and 1 sigma at time 0 and after each fix; cross (e + 1, 6) what else a turn
    of axes needs of P: its elements NE, ND, ED of position, then of attitude; nees, nees_position_velocity
    (e + 1,); nees_group (e + 1, 5); innovation (e,) normalised and squared, degrees (e,) int, status (e,) int; estimate
    (e + 1, 20) navigation states; misfit, misfit_sigma (e, 6) innovations of position and velocity and their 1 sigma,
    nan where there are none.
    """

    error: np.ndarray
    sigma: np.ndarray
    cross: np.ndarray
    nees: np.ndarray
    nees_position_velocity: np.ndarray
    nees_group: np.ndarray
    innovation: np.ndarray
    degrees: np.ndarray
    status: np.ndarray
    estimate: np.ndarray
    misfit: np.ndarray
    misfit_sigma: np.ndarray

    @classmethod
    def of(cls, e: int) -> Flown:
        """Empty arrays for e fixes."""
        n = states.N
        return cls(
            np.empty((e + 1, n)), np.empty((e + 1, n)), np.empty((e + 1, 6)), np.empty(e + 1), np.empty(e + 1),
            np.empty((e + 1, 5)), np.empty(e), np.empty(e, np.int64), np.empty(e, np.int64),
            np.empty((e + 1, states.NAV_N)), np.empty((e, 6)), np.empty((e, 6)),
        )  # fmt: skip


@kernel
def advance(kind, until, imu_time, dtheta, dv, nav, p, cursor, previous, noise, scratch, c_nb, width):
    """Mechanise and predict from the present time to `until` (s), cutting an IMU interval where it must.

    noise: (n, 6) of each IMU interval, or (1, 6) of all. cursor: (3,) index of the current IMU interval, present time
    s, length of the interval last used s.
    scratch: work space (MID_N + 3 * SIZE,), zero at first.
    """
    mid = scratch[:MID_N]
    phi = scratch[MID_N : MID_N + SIZE]
    a = scratch[MID_N + SIZE : MID_N + 2 * SIZE]
    b = scratch[MID_N + 2 * SIZE : MID_N + 3 * SIZE]
    k = int(cursor[0])
    now = cursor[1]
    last = imu_time.shape[0] - 1
    while k < last and now < until - TIME_TOLERANCE:
        end = imu_time[k + 1]
        whole = end - imu_time[k]
        whole_left = now - imu_time[k] < TIME_TOLERANCE
        to_end = end <= until + TIME_TOLERANCE
        dt = (end if to_end else until) - now
        scale = dt / cursor[2]
        if abs(scale - 1.0) > 1e-6:
            for i in range(6):
                previous[i] *= scale
        share = 1.0 if whole_left and to_end else dt / whole
        step(
            nav, share * dtheta[k, 0], share * dtheta[k, 1], share * dtheta[k, 2],
            share * dv[k, 0], share * dv[k, 1], share * dv[k, 2], previous, dt, c_nb, mid,
        )  # fmt: skip
        here = noise[min(k, noise.shape[0] - 1)]
        predict(p, mid, here, phi, a, b, width)
        if here[NOISE_GYRO_DECAY] + here[NOISE_ACCEL_DECAY] > 0.0:
            for i in range(3):
                nav[states.NAV_GYRO + i] *= 1.0 - dt * here[NOISE_GYRO_DECAY]
                nav[states.NAV_ACCEL + i] *= 1.0 - dt * here[NOISE_ACCEL_DECAY]
        if kind == TFG:
            tfg.hold_axes(nav, p, previous, dt)
        cursor[2] = dt
        if to_end:
            k += 1
            now = end
        else:
            now = until
    cursor[0] = k
    cursor[1] = now


@kernel
def plain_error(llh, vel, quat, bias, nav, error):
    """The plain error (15,) of a navigation state: the given position, velocity, attitude, biases (6,) less its own."""
    meridian, transverse = radii(math.sin(nav[0]))
    error[0] = (llh[0] - nav[0]) * (meridian + nav[2])
    error[1] = short_way(llh[1] - nav[1]) * (transverse + nav[2]) * math.cos(nav[0])
    error[2] = nav[2] - llh[2]
    for i in range(3):
        error[states.VEL + i] = vel[i] - nav[states.NAV_VEL + i]
        error[states.GYRO + i] = bias[i] - nav[states.NAV_GYRO + i]
        error[states.ACCEL + i] = bias[3 + i] - nav[states.NAV_ACCEL + i]
    difference(quat, nav[states.NAV_QUAT : states.NAV_QUAT + 4], error[states.ATT : states.ATT + 3])


@kernel
def record(kind, p, nav, llh, vel, quat, bias, error, sigma, cross, groups, factor, own, x):
    """Errors (truth - estimate) and sigmas of one instant; returns NEES of 15 states in the filter's own
    coordinates and of 6 states in plain ones. cross: (6,) as of `Flown`. groups: (5,) normalised squares of each
    triple of states."""
    plain_error(llh, vel, quat, bias, nav, error)
    for i in range(states.N):
        sigma[i] = math.sqrt(p[(STRIDE + 1) * i])
    for i in range(2):
        first = states.POS if i == 0 else states.ATT
        cross[3 * i] = p[STRIDE * first + first + 1]
        cross[3 * i + 1] = p[STRIDE * first + first + 2]
        cross[3 * i + 2] = p[STRIDE * (first + 1) + first + 2]
    _own_error(kind, nav, error, own)
    full = normalised_square(p, own, 0, states.N, factor, x)
    for group in range(5):
        # position and velocity in plain coordinates, the rest in the filter's own
        groups[group] = normalised_square(p, error if group < 2 else own, 3 * group, 3, factor, x)
    return full, normalised_square(p, error, 0, 6, factor, x)


@kernel
def measurement(nav, previous, dt, c_nb, lever, llh, vel, with_velocity, z, h):
    """Innovation z and matrix h of a fix at the antenna [3]; returns the number of measurements."""
    dcm(nav[6:10], c_nb)
    sin_lat = math.sin(nav[0])
    cos_lat = math.cos(nav[0])
    meridian, transverse = radii(sin_lat)
    h[:] = 0.0
    arm = np.empty(3)
    for i in range(3):
        arm[i] = c_nb[i, 0] * lever[0] + c_nb[i, 1] * lever[1] + c_nb[i, 2] * lever[2]
        h[i, i] = 1.0
    z[0] = (llh[0] - nav[0]) * (meridian + nav[2]) - arm[0]
    z[1] = short_way(llh[1] - nav[1]) * (transverse + nav[2]) * cos_lat - arm[1]
    z[2] = nav[2] - llh[2] - arm[2]
    # r_antenna = r + C l: d = -[C l x] theta
    h[0, 7], h[0, 8] = arm[2], -arm[1]
    h[1, 6], h[1, 8] = -arm[2], arm[0]
    h[2, 6], h[2, 7] = arm[1], -arm[0]
    if not with_velocity:
        return 3
    # v_antenna = v + C (omega_eb x l), omega_eb = omega_ib - C' omega_ie
    rate = np.empty(3)
    for i in range(3):
        rate[i] = previous[i] / dt - (c_nb[0, i] * RATE * cos_lat - c_nb[2, i] * RATE * sin_lat)
    bx = rate[1] * lever[2] - rate[2] * lever[1]
    by = rate[2] * lever[0] - rate[0] * lever[2]
    bz = rate[0] * lever[1] - rate[1] * lever[0]
    for i in range(3):
        arm[i] = c_nb[i, 0] * bx + c_nb[i, 1] * by + c_nb[i, 2] * bz
        z[3 + i] = vel[i] - nav[3 + i] - arm[i]
        h[3 + i, 3 + i] = 1.0
        # omega_true = omega_measured - b: d = C [l x] b_g
        h[3 + i, 9] = c_nb[i, 1] * lever[2] - c_nb[i, 2] * lever[1]
        h[3 + i, 10] = c_nb[i, 2] * lever[0] - c_nb[i, 0] * lever[2]
        h[3 + i, 11] = c_nb[i, 0] * lever[1] - c_nb[i, 1] * lever[0]
    h[3, 7], h[3, 8] = arm[2], -arm[1]
    h[4, 6], h[4, 8] = -arm[2], arm[0]
    h[5, 6], h[5, 7] = arm[1], -arm[0]
    return 6


@kernel
def observe(nav, previous, dt, c_nb, lever, llh, vel, cov, with_velocity, z, h, r):
    """As `measurement`, with the noise r (6, 6) from the fix's covariance (6, 6), and without those components of the
    velocity that are nan: returns the number of measurements, the rows of z, h and r in use."""
    with_velocity = with_velocity and not (math.isnan(vel[0]) and math.isnan(vel[1]) and math.isnan(vel[2]))
    m = measurement(nav, previous, dt, c_nb, lever, llh, vel, with_velocity, z, h)
    row = np.empty(6, np.int64)
    kept = 0
    for a in range(m):
        if not math.isnan(z[a]):
            row[kept] = a
            kept += 1
    for a in range(kept):
        if row[a] != a:
            z[a] = z[row[a]]
            h[a] = h[row[a]]
        for b in range(kept):
            r[a, b] = cov[row[a], row[b]]
    return kept


@kernel
def keep_misfit(vel, m, z, s, misfit, misfit_sigma):
    """Innovations z (m,) and 1 sigma, from the factor s of their covariance, into the places (6,) they are of."""
    place = 0
    for a in range(m):
        while place >= 3 and place < 5 and math.isnan(vel[place - 3]):
            place += 1
        misfit[place] = z[a]
        t = 0.0
        for b in range(a + 1):
            t += s[a, b] * s[a, b]
        misfit_sigma[place] = math.sqrt(t)
        place += 1


@kernel
def _correct(kind, nav, p, x, work):
    if kind == ESKF:
        error_state.correct(nav, p, x, work)
    elif kind == LEFT_INVARIANT:
        invariant.correct(nav, p, x, work)
    else:
        tfg.correct(nav, p, x, work)


@kernel
def _own_error(kind, nav, error, out):
    if kind == ESKF:
        for i in range(states.N):
            out[i] = error[i]
    elif kind == LEFT_INVARIANT:
        invariant.own_error(error, out)
    else:
        tfg.own_error(nav, error, out)


@kernel
def run(
    kind, imu_time, dtheta, dv, nav, p, noise,
    fix_time, fix_llh, fix_velocity, fix_cov, with_velocity, latency, lever, gate, max_rejected,
    truth_llh, truth_velocity, truth_quaternion, truth_bias,
    out, width,
):  # fmt: skip
    """Fly one run through the filter.

    kind: ESKF, LEFT_INVARIANT or TFG.
    imu_time: (n + 1,) s. dtheta, dv: (n, 3) measured increments. nav: (20,) initial estimate and p: (240,)
    its covariance, both overwritten by the final ones at the last fix. noise: rows (6,) of `core.covariance`, one for
    each IMU interval (n, 6) or one for all (1, 6).
    fix_*: e epochs: time (s, of validity), llh, NED velocity, covariance of both (e, 6, 6); nan without a fix.
    with_velocity: bool; components of the velocity that are nan are left out. latency: s. lever: (3,) IMU ->
    antenna, body, m. gate: (7,) largest normalised innovation squared by the number of measurements.
    max_rejected: rejections in a row after which a fix is taken nevertheless.
    truth_*: (e + 1, ...) at time 0 and at fix_time + latency; truth_bias (e + 1, 6).
    out: a `Flown`. width: `covariance.STRIDE`.
    """
    error, sigma, cross, nees, nees_pv, nees_group, innovation, degrees, status, estimate, misfit, misfit_sigma = out
    factor = np.empty((states.N, states.N))
    x = np.empty(states.N)
    own = np.empty(states.N)
    h = np.empty((6, states.N))
    z = np.empty(6)
    r = np.empty((6, 6))
    s = np.empty((6, 6))
    k = np.empty((states.N, 6))
    pht = np.empty((states.N, 6))
    work = np.empty((states.N, 6))
    c_nb = np.empty((3, 3))
    scratch = np.zeros(MID_N + 3 * SIZE)
    space = np.zeros(3 * SIZE)
    previous = np.empty(6)
    cursor = np.zeros(3)
    ahead_nav = np.empty(states.NAV_N)
    ahead_p = np.empty(SIZE)
    ahead_previous = np.empty(6)
    ahead_cursor = np.empty(3)

    # a flight that goes on from an earlier piece keeps the bias axes of its covariance
    if not nav[states.NAV_HELD : states.NAV_HELD + 4].any():
        nav[states.NAV_HELD] = 1.0
    cursor[1] = imu_time[0]
    cursor[2] = imu_time[1] - imu_time[0]
    for i in range(3):
        previous[i] = dtheta[0, i] - nav[10 + i] * cursor[2]
        previous[3 + i] = dv[0, i] - nav[13 + i] * cursor[2]
    nees[0], nees_pv[0] = record(
        kind,
        p,
        nav,
        truth_llh[0],
        truth_velocity[0],
        truth_quaternion[0],
        truth_bias[0],
        error[0],
        sigma[0],
        cross[0],
        nees_group[0],
        factor,
        own,
        x,
    )
    estimate[0] = nav
    rejected = 0
    for e in range(fix_time.shape[0]):
        after = e + 1
        advance(kind, fix_time[e], imu_time, dtheta, dv, nav, p, cursor, previous, noise, scratch, c_nb, width)
        innovation[e] = np.nan
        degrees[e] = 0
        status[e] = NO_FIX
        misfit[e] = np.nan
        misfit_sigma[e] = np.nan
        if not math.isnan(fix_llh[e, 0]):
            fix = (nav, previous, cursor[2], c_nb, lever, fix_llh[e], fix_velocity[e], fix_cov[e], with_velocity)
            m = observe(*fix, z, h, r)
            if gain(p, h, r, m, pht, s, k):
                keep_misfit(fix_velocity[e], m, z, s, misfit[e], misfit_sigma[e])
                for i in range(states.N):
                    x[i] = 0.0
                    for a in range(m):
                        x[i] += k[i, a] * z[a]
                # z' S^-1 z through the Cholesky factor of S that `gain` left
                q = 0.0
                for a in range(m):
                    t = z[a]
                    for b in range(a):
                        t -= s[a, b] * z[b]
                    z[a] = t / s[a, a]
                    q += z[a] * z[a]
                innovation[e] = q
                degrees[e] = m
                if q <= gate[m] or rejected >= max_rejected:
                    status[e] = USED
                    rejected = 0
                    # Gauss-Newton: the prior is carried to the new estimate and weighed there. Weighing before
                    # carrying would keep the correlations that J_l(theta) y gives the fix at the old one
                    _correct(kind, nav, p, x, space)
                    observe(*fix, z, h, r)
                    gain(p, h, r, m, pht, s, k)
                    joseph(p, h, r, m, pht, k, work)
                else:
                    status[e] = REJECTED
                    rejected += 1
        if latency > 0.0:
            ahead_nav[:] = nav
            ahead_p[:] = p
            ahead_previous[:] = previous
            ahead_cursor[:] = cursor
            advance(
                kind, fix_time[e] + latency, imu_time, dtheta, dv, ahead_nav, ahead_p, ahead_cursor, ahead_previous,
                noise, scratch, c_nb, width,
            )  # fmt: skip
            nees[after], nees_pv[after] = record(
                kind, ahead_p, ahead_nav, truth_llh[after], truth_velocity[after], truth_quaternion[after],
                truth_bias[after], error[after], sigma[after], cross[after], nees_group[after], factor, own, x,
            )  # fmt: skip
            estimate[after] = ahead_nav
        else:
            estimate[after] = nav
            nees[after], nees_pv[after] = record(
                kind, p, nav, truth_llh[after], truth_velocity[after], truth_quaternion[after], truth_bias[after],
                error[after], sigma[after], cross[after], nees_group[after], factor, own, x,
            )  # fmt: skip
