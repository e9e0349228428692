"""Sums over the IMU steps of an interval between two covariance predictions; its transition and its process noise.

Error model, truth minus estimate, in the local-level frame (r in metres NED, C_true = exp(theta x) C).

    r' = F_rr r + v
    v' = F_vr r + F_vv v - [f x] theta - C b_a
    theta' = F_tr r + F_tv v - [omega_in x] theta - C b_g
    x' = -x / tau for each sensor state x

A bias enters as b above. A scale factor enters as s times the rate or force along its axis. A time-correlated
measurement error does not enter.

Force and attitude change from step to step, so the mechanisation sums them (`add_step`). Everything else changes by
1e-6 of itself in an interval and is computed once. The transition is exact to second order in the interval. It contains
the third-order chains f x (C b) that a product of the transitions of all steps has. The noise is that of this product
for a constant mean force. An interval of one step gives the usual discretisation.

Sources:

- [1] Groves (2013), section 14.2.4 (local-navigation-frame error states, position in metres, truth minus estimate).
- [2] Savage, Strapdown inertial navigation integration algorithm design, part 2, JGCD 21 (1998) (sums at the fast rate,
  updates at the slow one).
- [3] `docs/theory/filter.md`, section 3.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel, kernel_inline, kernel_internal
from navsim.compiler.lanes import alloc, fma, small_vector
from navsim.filter.states import (
    ACCELEROMETERS,
    ATT,
    CONSTANT,
    GYROS,
    PHI_D,
    PHI_E,
    PHI_N,
    POS,
    R_D,
    R_E,
    R_N,
    SENSORS,
    V_D,
    V_E,
    V_N,
    VEL,
)
from navsim.filter.strapdown import (
    MID_COS,
    MID_FELT,
    MID_GRAVITY,
    MID_HEIGHT,
    MID_MERIDIAN,
    MID_SIN,
    MID_TRANSVERSE,
    MID_VEL,
)
from navsim.geodesy.earth import E2, RATE, SOMIGLIANA, A

LONGEST = 0.2
"""Longest interval of more than one step, s."""
_STEEPENING = 2.0 * SOMIGLIANA + E2
"""d(ln gravity)/d(latitude) = this times sin(lat) cos(lat), to 1 %: the effect itself is 1e-8 of a step."""

# sums of a mechanisation over the steps of an interval, one flat array (`total`)
_VELOCITY, _FORCE, _FORCE_TWICE, _COLUMNS = 0, 3, 6, 9
"""Offsets: the integral of velocity NED, m (3); of specific force NED, m/s (3); the integral of the latter, m (3); then
a row for each sensor state. Its integrand is the column of C through which the state acts, times the signal that it
multiplies."""
_ONCE, _TWICE, _CROSSED, _CROSSED_TWICE, _COLUMN_N = 0, 3, 6, 9, 12
"""Offsets in that row: its integral (3), the integral of this (3); for gyros also the integral of f x (integral) (3)
and the integral of that (3)."""


class StepSums(NamedTuple):
    """Sums over the steps of an interval for k sensor states."""

    declared: np.ndarray
    """(k,) the sensor states, see `states.DECLARED`."""
    total: np.ndarray
    """(9 + 12 k,) sums, by the offsets above."""
    length: np.ndarray
    """(2,) length of the interval, s, and its number of steps; not in lanes."""
    decay: np.ndarray
    """(k,) decay of each state over the interval."""
    noise: np.ndarray
    """(k,) process noise that each state has collected, added to its variance."""
    step_decay: np.ndarray
    """(k,) decay over the last step."""
    row: np.ndarray
    """(k,) int, whose row of `total` holds the sums of each state: an accelerometer's are also those of its gyro."""


@kernel_internal
def allocate_sums(like, declared):
    """Allocate the sums for these sensor states, with the lanes of `like`."""
    k = declared.shape[0]
    total = alloc(like, (_COLUMNS + _COLUMN_N * k,))
    return StepSums(declared, total, np.empty(2), np.empty(k), np.empty(k), np.empty(k), rows_of_sums(declared))


@kernel
def rows_of_sums(declared):
    """See `StepSums.row`: declared biases of one axis and one decay act through the same column of C."""
    row = np.empty(declared.shape[0], np.int64)
    for c in range(declared.shape[0]):
        row[c] = c
        for b in range(c):
            alike = declared[b].axis == declared[c].axis and declared[b].decay == declared[c].decay
            both = declared[b].sensor == GYROS and declared[c].sensor == ACCELEROMETERS
            if alike and both and declared[b].signal == CONSTANT and declared[c].signal == CONSTANT:
                row[c] = b
    return row


@kernel_inline
def reset_sums(sums):
    """Reset the sums at the start of an interval."""
    sums.length[0], sums.length[1] = 0.0, 0.0
    for i in range(sums.total.shape[0]):
        sums.total[i] = 0.0
    for c in range(sums.decay.shape[0]):
        sums.decay[c], sums.noise[c] = 1.0, 0.0


@kernel_inline
def markov_decay(decay, dt):
    """Decay over dt (s) of a state with rate `decay` (1/s): exp(-decay dt)."""
    return math.exp(-decay * dt) if decay > 0.0 else 1.0


@kernel
def accumulate_markov(sums, dt):
    """Propagate decay and noise of the sensor states by dt (s)."""
    part, declared = 1.0, sums.declared
    for c in range(declared.shape[0]):
        if c == 0 or declared[c].decay != declared[c - 1].decay:
            part = markov_decay(declared[c].decay, dt)
        sums.step_decay[c] = part
        sums.decay[c] *= part
        sums.noise[c] = part * sums.noise[c] * part + declared[c].drive * dt


@kernel_inline
def add_step(total, decay, row, mid, dt, increments, declared):
    """Add a step of dt, s, that `strapdown.step` has made, to the sums `total`.

    decay, row (k,): as of `StepSums`, of the declared sensor states (k,), of which measurement errors are skipped. mid:
    (MID_N,). increments: (6,) compensated.
    """
    n, e, d = mid[MID_FELT], mid[MID_FELT + 1], mid[MID_FELT + 2]
    for i in range(3):
        felt = mid[MID_FELT + i]
        total[_VELOCITY + i] = fma(mid[MID_VEL + i], dt, total[_VELOCITY + i])
        total[_FORCE_TWICE + i] = fma(fma(felt, 0.5, total[_FORCE + i]), dt, total[_FORCE_TWICE + i])
        total[_FORCE + i] += felt
    for c in range(declared.shape[0]):
        triad, axis, signal = declared[c].sensor, declared[c].axis, declared[c].signal
        if triad > ACCELEROMETERS or row[c] != c:
            continue  # an error of measurements has no axis of the body
        # input of the state, over the step
        weight = decay[c] * (dt - 0.5 * dt * dt * declared[c].decay)
        x, y, z = weight * mid[axis], weight * mid[3 + axis], weight * mid[6 + axis]
        if signal != CONSTANT:
            signed = increments[3 * triad + signal] / dt
            x, y, z = signed * x, signed * y, signed * z
        k = _COLUMNS + _COLUMN_N * c
        # the integral at the middle of the step; mean values over it throughout
        ox, oy, oz = fma(x, 0.5, total[k]), fma(y, 0.5, total[k + 1]), fma(z, 0.5, total[k + 2])
        total[k], total[k + 1], total[k + 2] = fma(x, 0.5, ox), fma(y, 0.5, oy), fma(z, 0.5, oz)
        k += _TWICE
        total[k], total[k + 1], total[k + 2] = (
            fma(ox, dt, total[k]), fma(oy, dt, total[k + 1]), fma(oz, dt, total[k + 2]),
        )  # fmt: skip
        if triad == GYROS:
            x, y, z = fma(-d, oy, e * oz), fma(-n, oz, d * ox), fma(-e, ox, n * oy)
            k += _CROSSED - _TWICE
            ox, oy, oz = fma(x, 0.5, total[k]), fma(y, 0.5, total[k + 1]), fma(z, 0.5, total[k + 2])
            total[k], total[k + 1], total[k + 2] = fma(x, 0.5, ox), fma(y, 0.5, oy), fma(z, 0.5, oz)
            k += _CROSSED_TWICE - _CROSSED
            total[k], total[k + 1], total[k + 2] = (
                fma(ox, dt, total[k]), fma(oy, dt, total[k + 1]), fma(oz, dt, total[k + 2]),
            )  # fmt: skip


@kernel_inline
def transition(sums, mid, phi):
    """Phi - I over an interval: its navigation rows, phi (9, n).

    - `sums`: over the steps of the interval; `mid` (MID_N,): mid-interval quantities of the last step.
    - `phi`: elements that this function does not write must be zero.

    At 60 m/s and an interval of 0.2 s it differs from exp(F T) by 2e-6 in velocity and position per attitude (m/s and m
    per rad). Elsewhere it differs by at most 6e-8: the vertical gravity gradient in velocity per velocity. Estimated
    scale factors do not change the effect of sensor states, which neglects 1e-3 of it for scale factors of 1e-3.
    """
    dt = sums.length[0]
    h = 0.5 * dt * dt
    total, declared = sums.total, sums.declared
    vn, ve, vd = total[_VELOCITY] / dt, total[_VELOCITY + 1] / dt, total[_VELOCITY + 2] / dt
    # the integral of f, the integral of this, and that of t f
    un, ue, ud = total[_FORCE], total[_FORCE + 1], total[_FORCE + 2]
    sn, se, sd = total[_FORCE_TWICE], total[_FORCE_TWICE + 1], total[_FORCE_TWICE + 2]
    ln, le, ld = dt * un - sn, dt * ue - se, dt * ud - sd
    irm = 1.0 / mid[MID_MERIDIAN]
    irt = 1.0 / mid[MID_TRANSVERSE]
    sin = mid[MID_SIN]
    cos = mid[MID_COS]
    tan = sin / cos
    ien, ied = RATE * cos, -RATE * sin
    wn, we, wd = ien + ve * irt, -vn * irm, ied - ve * tan * irt
    sec2 = 1.0 + tan * tan

    # omega_in as a function of north and down position and of velocity
    in_r0 = ied * irm  # d(omega_ie)_n / dr_n = -RATE sin / R
    id_r0 = -ien * irm
    en_v1 = irt
    en_r2 = ve * irt * irt
    ee_v0 = -irm
    ee_r2 = -vn * irm * irm
    ed_v1 = -tan * irt
    ed_r0 = -ve * sec2 * irt * irm
    ed_r2 = -ve * tan * irt * irt

    # position rows: F_rr r + v
    rr00 = -vd * irm
    rr02 = vn * irm
    rr10 = ve * tan * irm
    rr11 = -vd * irt - vn * tan * irt
    rr12 = ve * irt
    phi[R_N, R_N] = rr00 * dt
    phi[R_N, R_D] = rr02 * dt
    phi[R_E, R_N] = rr10 * dt
    phi[R_E, R_E] = rr11 * dt
    phi[R_E, R_D] = rr12 * dt

    # velocity rows: -(2 omega_ie + omega_en) x v, its change with position and velocity, gravity gradient
    on, oe, od = 2.0 * ien + ve * irt, -vn * irm, 2.0 * ied - ve * tan * irt
    # change of (2 omega_ie + omega_en) with r_n and r_d
    on_r0, od_r0 = 2.0 * in_r0, 2.0 * id_r0 + ed_r0
    on_r2, oe_r2, od_r2 = en_r2, ee_r2, ed_r2
    # -(d omega) x v
    vr00 = -(-od_r0 * ve)
    vr10 = -(od_r0 * vn - on_r0 * vd)
    vr20 = -(on_r0 * ve) + mid[MID_GRAVITY] * _STEEPENING * sin * cos * irm
    vr02 = -(oe_r2 * vd - od_r2 * ve)
    vr12 = -(od_r2 * vn - on_r2 * vd)
    vr22 = -(on_r2 * ve - oe_r2 * vn) + 2.0 / A * mid[MID_GRAVITY] * (1.0 + 2.0 / A * mid[MID_HEIGHT])
    vv00 = -(ee_v0 * vd)
    vv01 = od + ed_v1 * ve
    vv02 = -oe
    vv10 = -od
    vv11 = -(ed_v1 * vn - en_v1 * vd)
    vv12 = on
    vv20 = oe + ee_v0 * vn
    vv21 = -on - en_v1 * ve
    phi[V_N, R_N] = vr00 * dt
    phi[V_N, R_D] = vr02 * dt
    phi[V_E, R_N] = vr10 * dt
    phi[V_E, R_D] = vr12 * dt
    phi[V_D, R_N] = vr20 * dt
    phi[V_D, R_D] = vr22 * dt
    # with -[f x] theta of the tilt that a velocity error makes
    phi[V_N, V_N] = vv00 * dt - ld * ee_v0
    phi[V_N, V_E] = vv01 * dt + le * ed_v1
    phi[V_N, V_D] = vv02 * dt
    phi[V_E, V_N] = vv10 * dt
    phi[V_E, V_E] = vv11 * dt + (ld * en_v1 - ln * ed_v1)
    phi[V_E, V_D] = vv12 * dt
    phi[V_D, V_N] = vv20 * dt + ln * ee_v0
    phi[V_D, V_E] = vv21 * dt - le * en_v1
    phi[R_D, R_D] = h * vr22
    # r <- v: dt + (F_rr + F_vv) dt^2 / 2
    phi[R_N, V_N] = dt + h * (rr00 + vv00)
    phi[R_N, V_E] = h * vv01
    phi[R_N, V_D] = h * (rr02 + vv02)
    phi[R_E, V_N] = h * (rr10 + vv10)
    phi[R_E, V_E] = dt + h * (rr11 + vv11)
    phi[R_E, V_D] = h * (rr12 + vv12)
    phi[R_D, V_N] = h * vv20
    phi[R_D, V_E] = h * vv21
    phi[R_D, V_D] = dt

    # -[f x]: v <- theta to second order, r <- theta
    # (F_vv F_vt + F_vt F_tt) with F_vv = -[o x] and F_tt = -[w x], each product [a x][b x] = b a' - (a.b) I
    s = (on * sn + oe * se + od * sd) + (wn * ln + we * le + wd * ld)
    phi[V_N, PHI_N] = sn * on + wn * ln - s
    phi[V_N, PHI_E] = ud + (sn * oe + wn * le)
    phi[V_N, PHI_D] = -ue + (sn * od + wn * ld)
    phi[V_E, PHI_N] = -ud + (se * on + we * ln)
    phi[V_E, PHI_E] = se * oe + we * le - s
    phi[V_E, PHI_D] = un + (se * od + we * ld)
    phi[V_D, PHI_N] = ue + (sd * on + wd * ln)
    phi[V_D, PHI_E] = -un + (sd * oe + wd * le)
    phi[V_D, PHI_D] = sd * od + wd * ld - s
    phi[R_N, PHI_E] = sd
    phi[R_N, PHI_D] = -se
    phi[R_E, PHI_N] = -sd
    phi[R_E, PHI_D] = sn
    phi[R_D, PHI_N] = se
    phi[R_D, PHI_E] = -sn

    # attitude rows
    phi[PHI_N, R_N] = -in_r0 * dt
    phi[PHI_N, R_D] = -en_r2 * dt
    phi[PHI_E, R_D] = -ee_r2 * dt
    phi[PHI_D, R_N] = -(id_r0 + ed_r0) * dt
    phi[PHI_D, R_D] = -ed_r2 * dt
    phi[PHI_N, V_E] = -en_v1 * dt
    phi[PHI_E, V_N] = -ee_v0 * dt
    phi[PHI_D, V_E] = -ed_v1 * dt
    ww = wn * wn + we * we + wd * wd
    phi[PHI_N, PHI_N] = h * (wn * wn - ww)
    phi[PHI_N, PHI_E] = wd * dt + h * wn * we
    phi[PHI_N, PHI_D] = -we * dt + h * wn * wd
    phi[PHI_E, PHI_N] = -wd * dt + h * we * wn
    phi[PHI_E, PHI_E] = h * (we * we - ww)
    phi[PHI_E, PHI_D] = wn * dt + h * we * wd
    phi[PHI_D, PHI_N] = we * dt + h * wd * wn
    phi[PHI_D, PHI_E] = -wn * dt + h * wd * we
    phi[PHI_D, PHI_D] = h * (wd * wd - ww)

    # sensor states: -C on theta and v, with the turning of n
    for c in range(declared.shape[0]):
        k, j = _COLUMNS + _COLUMN_N * sums.row[c], SENSORS + c
        x, y, z = total[k + _ONCE], total[k + _ONCE + 1], total[k + _ONCE + 2]
        tx, ty, tz = total[k + _TWICE], total[k + _TWICE + 1], total[k + _TWICE + 2]
        if declared[c].sensor == ACCELEROMETERS:
            phi[R_N, j], phi[R_E, j], phi[R_D, j] = -tx, -ty, -tz
            phi[V_N, j] = (oe * tz - od * ty) - x
            phi[V_E, j] = (od * tx - on * tz) - y
            phi[V_D, j] = (on * ty - oe * tx) - z
        elif declared[c].sensor == GYROS:
            for i in range(3):
                phi[POS + i, j], phi[VEL + i, j] = total[k + _CROSSED_TWICE + i], total[k + _CROSSED + i]
            phi[PHI_N, j] = (we * tz - wd * ty) - x
            phi[PHI_E, j] = (wd * tx - wn * tz) - y
            phi[PHI_D, j] = (wn * ty - we * tx) - z


@kernel_inline
def _moments(length):
    """Sums of dt, dt r, dt r^2, dt r^3, dt r^4 over the equal steps of an interval, with r the time left after each,
    and a step; length: of `StepSums`."""
    whole, step = length[0], length[0] / length[1]
    first = 0.5 * whole * (whole - step)
    second = whole * (whole - step) * (2.0 * whole - step) / 6.0
    fourth = second * (3.0 * whole * (whole - step) - step * step) / 5.0
    return whole, first, second, first * first, fourth, step


@kernel_inline
def _add_both(p, i, j, more):
    """Add `more` to elements (i, j) and (j, i), so that P stays symmetric."""
    p[i, j] += more
    p[j, i] += more


@kernel
def add_white(sums, gyro, accel, p):
    """P <- P + Q of white noises of angular rate and specific force, densities rad2/s and m2/s3, over an interval.

    The noise of each step enters attitude and velocity at its end, position through the trapezoid rule. In the time r
    that is left a gyro's becomes -[f x] r of velocity and -[f x] r^2 / 2 of position, by the mean force f.
    """
    whole, first, second, third, fourth, step = _moments(sums.length)
    f = small_vector(p, 3)
    for i in range(3):
        f[i] = sums.total[_FORCE + i] / whole
    square = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    for i in range(3):
        half_step_later = second + step * first + 0.25 * step * step * whole
        p[POS + i, POS + i] += 0.25 * gyro * fourth * square + accel * half_step_later
        p[VEL + i, VEL + i] += gyro * second * square + accel * whole
        p[ATT + i, ATT + i] += gyro * whole
        _add_both(p, POS + i, VEL + i, 0.5 * gyro * third * square + 0.5 * accel * whole * whole)
        for j in range(3):
            # [f x] [f x]' = (f.f) I - f f'
            p[POS + i, POS + j] -= 0.25 * gyro * fourth * (f[i] * f[j])
            p[VEL + i, VEL + j] -= gyro * second * (f[i] * f[j])
            _add_both(p, POS + i, VEL + j, -0.5 * gyro * third * (f[i] * f[j]))
        j, k = (i + 1) % 3, (i + 2) % 3
        _add_both(p, VEL + i, ATT + j, gyro * first * f[k])
        _add_both(p, VEL + i, ATT + k, -gyro * first * f[j])
        _add_both(p, POS + i, ATT + j, 0.5 * gyro * second * f[k])
        _add_both(p, POS + i, ATT + k, -0.5 * gyro * second * f[j])


@kernel
def add_driven(sums, c, drive, place, p):
    """P <- P + Q due to the drive of a sensor state, of this density, through attitude or velocity over an interval.

    c: its number among those summed; place: its own in P. Its own variance is `noise`.
    """
    state = sums.declared[c]
    whole, first, second, third, _, _ = _moments(sums.length)
    block = ATT if state.sensor == GYROS else VEL
    mean, k = small_vector(p, 3), _COLUMNS + _COLUMN_N * sums.row[c] + _ONCE
    for i in range(3):
        mean[i] = sums.total[k + i] / (whole - 0.5 * whole * whole * state.decay)
    for i in range(3):
        _add_both(p, block + i, place, -drive * (first - 1.5 * state.decay * second) * mean[i])
        for j in range(3):
            p[block + i, block + j] += drive * (second - state.decay * third) * (mean[i] * mean[j])
