"""The covariance of the errors: prediction over one IMU interval, Joseph update, reset, for any declared sensor states.

P of n states is one flat array of n rows, `STRIDE` apart; what lies between the columns in use and the stride is zero.
LLVM turns row operations into SIMD code only on such an array, with a literal stride and a trip count known at run
time:
`width`, n rounded up to whole registers.

Error model, truth minus estimate, in the local-level frame (r in metres NED, C_true = exp(theta x) C):
    r' = F_rr r + v
    v' = F_vr r + F_vv v - [f x] theta - C b_a
    theta' = F_tr r + F_tv v - [omega_in x] theta - C b_g
    x' = -x / tau for each sensor state x; a bias enters as b above, a scale factor as s times what its axis feels
Sources: [1] Groves (2013), section 14.2.4 (local-navigation-frame error states, with position in metres and
signs of truth minus estimate). [2] Bucy & Joseph (1968), the update that keeps P symmetric and positive;
`docs/theory/filter.md`, eq. (23). [3] Mueller, Hehn & D'Andrea, Covariance correction step for Kalman filtering with an
attitude, JGCD 40 (2017).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core.arrays.earth import E2, RATE, SOMIGLIANA, A
from navsim.core.attitude import left_jacobian
from navsim.core.jit import inlined, kernel
from navsim.core.linear import cholesky, solve_lower
from navsim.core.states import (
    A_D,
    A_E,
    A_N,
    ACCEL,
    ACCELEROMETERS,
    ATT,
    CONSTANT,
    GYRO,
    POS,
    R_D,
    R_E,
    R_N,
    SENSORS,
    V_D,
    V_E,
    V_N,
    VEL,
    N,
)
from navsim.core.strapdown import (
    MID_COS,
    MID_DT,
    MID_FORCE,
    MID_GRAVITY,
    MID_HEIGHT,
    MID_MERIDIAN,
    MID_RATE_IN,
    MID_SIN,
    MID_TRANSVERSE,
    MID_VEL,
)

STRIDE = 40
"""Distance of rows, the most states a filter can have: no power of two, or rows would share their cache lines."""
SIZE = STRIDE * STRIDE

_STEEPENING = 2.0 * SOMIGLIANA + E2
"""d(ln gravity)/d(latitude) = this times sin(lat) cos(lat), to 1 %: the effect itself is 1e-8 of a step."""

# densities of the sensors' white noise, one flat array: the squares of ARW and VRW
NOISE_GYRO, NOISE_ACCEL = 0, 1
"""Angular rate (rad2/s) and specific force (m2/s3)."""
NOISE_N = 2


@inlined
def width_of(n):
    """Columns (int) that row operations on n states take: whole registers of eight."""
    return (n + 7) // 8 * 8


@inlined
def kept(decay, dt):
    """The part of a state that is left after dt (s) of a decay (1/s)."""
    return math.exp(-decay * dt) if decay > 0.0 else 1.0


@inlined
def transition(mid, increments, declared, phi):
    """Phi - I over one interval, the navigation rows of the flat `phi`.

    Second order in dt: I + F dt + F^2 dt^2 / 2 with F at mid-interval. Left out of F^2 are the products of
    two Earth-curvature terms (each below 1e-10 in Phi at 100 Hz and aircraft speeds), and of the effect of sensor
    states the estimated scale factors themselves (1e-3 of it where they are as large). mid: (MID_N,) from
    `strapdown.step`. increments: (6,) of angle and velocity over the interval, compensated by the estimate. declared:
    `states.DECLARED`. phi: (SIZE,) zero but for what this function writes.
    """
    dt = mid[MID_DT]
    h = 0.5 * dt * dt
    fn, fe, fd = mid[MID_FORCE], mid[MID_FORCE + 1], mid[MID_FORCE + 2]
    wn, we, wd = mid[MID_RATE_IN], mid[MID_RATE_IN + 1], mid[MID_RATE_IN + 2]
    vn, ve, vd = mid[MID_VEL], mid[MID_VEL + 1], mid[MID_VEL + 2]
    irm = 1.0 / mid[MID_MERIDIAN]
    irt = 1.0 / mid[MID_TRANSVERSE]
    sin = mid[MID_SIN]
    cos = mid[MID_COS]
    tan = sin / cos
    ien, ied = RATE * cos, -RATE * sin
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
    phi[R_N] = rr00 * dt
    phi[R_D] = rr02 * dt
    phi[STRIDE * R_E + R_N] = rr10 * dt
    phi[STRIDE * R_E + R_E] = rr11 * dt
    phi[STRIDE * R_E + R_D] = rr12 * dt

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
    phi[STRIDE * V_N + R_N] = vr00 * dt
    phi[STRIDE * V_N + R_D] = vr02 * dt
    phi[STRIDE * V_E + R_N] = vr10 * dt
    phi[STRIDE * V_E + R_D] = vr12 * dt
    phi[STRIDE * V_D + R_N] = vr20 * dt
    phi[STRIDE * V_D + R_D] = vr22 * dt
    phi[STRIDE * V_N + V_N] = vv00 * dt
    phi[STRIDE * V_N + V_E] = vv01 * dt
    phi[STRIDE * V_N + V_D] = vv02 * dt
    phi[STRIDE * V_E + V_N] = vv10 * dt
    phi[STRIDE * V_E + V_E] = vv11 * dt
    phi[STRIDE * V_E + V_D] = vv12 * dt
    phi[STRIDE * V_D + V_N] = vv20 * dt
    phi[STRIDE * V_D + V_E] = vv21 * dt
    # r <- v: dt + (F_rr + F_vv) dt^2 / 2
    phi[V_N] = dt + h * (rr00 + vv00)
    phi[V_E] = h * vv01
    phi[V_D] = h * (rr02 + vv02)
    phi[STRIDE * R_E + V_N] = h * (rr10 + vv10)
    phi[STRIDE * R_E + V_E] = dt + h * (rr11 + vv11)
    phi[STRIDE * R_E + V_D] = h * (rr12 + vv12)
    phi[STRIDE * R_D + V_N] = h * vv20
    phi[STRIDE * R_D + V_E] = h * vv21
    phi[STRIDE * R_D + V_D] = dt

    # -[f x]: v <- theta to second order, r <- theta
    # (F_vv F_vt + F_vt F_tt) with F_vv = -[o x] and F_tt = -[w x], each product [a x][b x] = b a' - (a.b) I
    of = on * fn + oe * fe + od * fd
    wf = wn * fn + we * fe + wd * fd
    s = of + wf
    phi[STRIDE * V_N + A_N] = h * (fn * on + wn * fn - s)
    phi[STRIDE * V_N + A_E] = fd * dt + h * (fn * oe + wn * fe)
    phi[STRIDE * V_N + A_D] = -fe * dt + h * (fn * od + wn * fd)
    phi[STRIDE * V_E + A_N] = -fd * dt + h * (fe * on + we * fn)
    phi[STRIDE * V_E + A_E] = h * (fe * oe + we * fe - s)
    phi[STRIDE * V_E + A_D] = fn * dt + h * (fe * od + we * fd)
    phi[STRIDE * V_D + A_N] = fe * dt + h * (fd * on + wd * fn)
    phi[STRIDE * V_D + A_E] = -fn * dt + h * (fd * oe + wd * fe)
    phi[STRIDE * V_D + A_D] = h * (fd * od + wd * fd - s)
    phi[A_E] = h * fd
    phi[A_D] = -h * fe
    phi[STRIDE * R_E + A_N] = -h * fd
    phi[STRIDE * R_E + A_D] = h * fn
    phi[STRIDE * R_D + A_N] = h * fe
    phi[STRIDE * R_D + A_E] = -h * fn

    # attitude rows
    phi[STRIDE * A_N + R_N] = -in_r0 * dt
    phi[STRIDE * A_N + R_D] = -en_r2 * dt
    phi[STRIDE * A_E + R_D] = -ee_r2 * dt
    phi[STRIDE * A_D + R_N] = -(id_r0 + ed_r0) * dt
    phi[STRIDE * A_D + R_D] = -ed_r2 * dt
    phi[STRIDE * A_N + V_E] = -en_v1 * dt
    phi[STRIDE * A_E + V_N] = -ee_v0 * dt
    phi[STRIDE * A_D + V_E] = -ed_v1 * dt
    ww = wn * wn + we * we + wd * wd
    phi[STRIDE * A_N + A_N] = h * (wn * wn - ww)
    phi[STRIDE * A_N + A_E] = wd * dt + h * wn * we
    phi[STRIDE * A_N + A_D] = -we * dt + h * wn * wd
    phi[STRIDE * A_E + A_N] = -wd * dt + h * we * wn
    phi[STRIDE * A_E + A_E] = h * (we * we - ww)
    phi[STRIDE * A_E + A_D] = wn * dt + h * we * wd
    phi[STRIDE * A_D + A_N] = we * dt + h * wd * wn
    phi[STRIDE * A_D + A_E] = -wn * dt + h * wd * we
    phi[STRIDE * A_D + A_D] = h * (wd * wd - ww)

    # sensor states: -C on theta and v, with the turning of n and their decay; second order on r and v
    for c in range(declared.shape[0]):
        axis = declared[c].axis
        x, y, z = mid[axis], mid[3 + axis], mid[6 + axis]
        size = dt - h * declared[c].decay
        second = h
        if declared[c].signal != CONSTANT:
            signal = increments[3 * declared[c].triad + declared[c].signal] / dt
            size *= signal
            second *= signal
        column = SENSORS + c
        if declared[c].triad == ACCELEROMETERS:
            phi[STRIDE * R_N + column] = -second * x
            phi[STRIDE * R_E + column] = -second * y
            phi[STRIDE * R_D + column] = -second * z
            # -C size + [o x] C h
            phi[STRIDE * V_N + column] = -size * x + second * (oe * z - od * y)
            phi[STRIDE * V_E + column] = -size * y + second * (od * x - on * z)
            phi[STRIDE * V_D + column] = -size * z + second * (on * y - oe * x)
        else:
            # [f x] C h on v;  -C size + [w x] C h on theta
            phi[STRIDE * V_N + column] = second * (fe * z - fd * y)
            phi[STRIDE * V_E + column] = second * (fd * x - fn * z)
            phi[STRIDE * V_D + column] = second * (fn * y - fe * x)
            phi[STRIDE * A_N + column] = -size * x + second * (we * z - wd * y)
            phi[STRIDE * A_E + column] = -size * y + second * (wd * x - wn * z)
            phi[STRIDE * A_D + column] = -size * z + second * (wn * y - we * x)


@inlined
def _apply_transition(phi, p, out, n, width):
    """The navigation rows of out = Phi p, leaving out the blocks of Phi that are zero."""
    for i in range(POS, VEL):
        o = STRIDE * i
        c0, c1, c2 = phi[o + R_N], phi[o + R_E], phi[o + R_D]
        c3, c4, c5 = phi[o + V_N], phi[o + V_E], phi[o + V_D]
        c6, c7, c8 = phi[o + A_N], phi[o + A_E], phi[o + A_D]
        d0, d1, d2 = phi[o + ACCEL], phi[o + ACCEL + 1], phi[o + ACCEL + 2]
        for j in range(width):
            out[o + j] = (
                p[o + j]
                + (c0 * p[STRIDE * R_N + j] + c1 * p[STRIDE * R_E + j] + c2 * p[STRIDE * R_D + j])
                + (c3 * p[STRIDE * V_N + j] + c4 * p[STRIDE * V_E + j] + c5 * p[STRIDE * V_D + j])
                + (c6 * p[STRIDE * A_N + j] + c7 * p[STRIDE * A_E + j] + c8 * p[STRIDE * A_D + j])
                + (d0 * p[STRIDE * ACCEL + j] + d1 * p[STRIDE * (ACCEL + 1) + j] + d2 * p[STRIDE * (ACCEL + 2) + j])
            )
    for i in range(VEL, ATT):
        o = STRIDE * i
        c0, c2 = phi[o + R_N], phi[o + R_D]
        c3, c4, c5 = phi[o + V_N], phi[o + V_E], phi[o + V_D]
        c6, c7, c8 = phi[o + A_N], phi[o + A_E], phi[o + A_D]
        b0, b1, b2 = phi[o + GYRO], phi[o + GYRO + 1], phi[o + GYRO + 2]
        d0, d1, d2 = phi[o + ACCEL], phi[o + ACCEL + 1], phi[o + ACCEL + 2]
        for j in range(width):
            out[o + j] = (
                p[o + j]
                + (c0 * p[STRIDE * R_N + j] + c2 * p[STRIDE * R_D + j])
                + (c3 * p[STRIDE * V_N + j] + c4 * p[STRIDE * V_E + j] + c5 * p[STRIDE * V_D + j])
                + (c6 * p[STRIDE * A_N + j] + c7 * p[STRIDE * A_E + j] + c8 * p[STRIDE * A_D + j])
                + (b0 * p[STRIDE * GYRO + j] + b1 * p[STRIDE * (GYRO + 1) + j] + b2 * p[STRIDE * (GYRO + 2) + j])
                + (d0 * p[STRIDE * ACCEL + j] + d1 * p[STRIDE * (ACCEL + 1) + j] + d2 * p[STRIDE * (ACCEL + 2) + j])
            )
    for i in range(ATT, SENSORS):
        o = STRIDE * i
        c0, c2 = phi[o + R_N], phi[o + R_D]
        c3, c4 = phi[o + V_N], phi[o + V_E]
        c6, c7, c8 = phi[o + A_N], phi[o + A_E], phi[o + A_D]
        b0, b1, b2 = phi[o + GYRO], phi[o + GYRO + 1], phi[o + GYRO + 2]
        for j in range(width):
            out[o + j] = (
                p[o + j]
                + (c0 * p[STRIDE * R_N + j] + c2 * p[STRIDE * R_D + j])
                + (c3 * p[STRIDE * V_N + j] + c4 * p[STRIDE * V_E + j])
                + (c6 * p[STRIDE * A_N + j] + c7 * p[STRIDE * A_E + j] + c8 * p[STRIDE * A_D + j])
                + (b0 * p[STRIDE * GYRO + j] + b1 * p[STRIDE * (GYRO + 1) + j] + b2 * p[STRIDE * (GYRO + 2) + j])
            )
    # what is declared beside the biases
    for i in range(SENSORS if n > N else 0):
        for column in range(N, n):
            c = phi[STRIDE * i + column]
            if c != 0.0:
                for j in range(width):
                    out[STRIDE * i + j] += c * p[STRIDE * column + j]


@kernel
def decay_rows(declared, dt, matrix, width):
    """The sensor rows of a matrix (SIZE,) over dt, s, in place."""
    for c in range(declared.shape[0]):
        if declared[c].decay > 0.0:
            part = kept(declared[c].decay, dt)
            for j in range(width):
                matrix[STRIDE * (SENSORS + c) + j] *= part


@kernel
def vary(declared, dt, p):
    """What decay and drive of the sensor states do to P over dt, s, in place, after `predict`."""
    decay_rows(declared, dt, p, SENSORS + declared.shape[0])
    for c in range(declared.shape[0]):
        part = kept(declared[c].decay, dt)
        for i in range(SENSORS + declared.shape[0]):
            p[STRIDE * i + SENSORS + c] *= part
        p[(STRIDE + 1) * (SENSORS + c)] += declared[c].drive * dt


@kernel
def is_varying(declared):
    """Whether any sensor state decays or is driven, so that `vary` is needed."""
    varying = False
    for c in range(declared.shape[0]):
        varying |= declared[c].decay > 0.0 or declared[c].drive > 0.0
    return varying


@inlined
def _transposed(above, below, out, n):
    for i in range(SENSORS):
        for j in range(n):
            out[STRIDE * j + i] = above[STRIDE * i + j]
    for i in range(SENSORS, n):
        for j in range(n):
            out[STRIDE * j + i] = below[STRIDE * i + j]


@inlined
def _transpose(above, below, out, n):
    """out (n x n) = the transpose of a matrix whose navigation rows stand in one place, the others in another."""
    if n == N:  # a trip count known to the compiler is three times as fast
        _transposed(above, below, out, N)
    else:
        _transposed(above, below, out, n)


@inlined
def carry_covariance(p, phi, n, a, b):
    """P <- Phi P Phi' of n states but for their decay, in place.

    phi: as `transition` writes it. a, b: (SIZE,) work space.
    """
    width = width_of(n)
    _apply_transition(phi, p, a, n, width)
    _transpose(a, p, b, n)
    _apply_transition(phi, b, p, n, width)
    # sensor states among each other stay as they are
    for i in range(SENSORS, n):
        for j in range(SENSORS):
            p[STRIDE * i + j] = b[STRIDE * i + j]


@inlined
def add_white(p, noise, dt):
    """P <- P + Q of white sensor noises of the densities noise (2,) over dt, s, in place."""
    # it enters velocity as it adds up over the interval, and position through the trapezoid rule
    qg = noise[NOISE_GYRO] * dt
    qa = noise[NOISE_ACCEL] * dt
    half = 0.5 * dt
    for i in range(3):
        p[(STRIDE + 1) * (POS + i)] += half * half * qa
        p[STRIDE * (POS + i) + VEL + i] += half * qa
        p[STRIDE * (VEL + i) + POS + i] += half * qa
        p[(STRIDE + 1) * (VEL + i)] += qa
        p[(STRIDE + 1) * (ATT + i)] += qg


@inlined
def predict(p, mid, increments, noise, declared, phi, a, b):
    """P <- Phi P Phi' + Q over one interval, in place, but for decay and drive of the sensor states (`vary`).

    p: (SIZE,). mid, increments, declared: as of `transition`. noise: (2,) densities of the white noises. phi, a, b:
    (SIZE,) work space, zero at first.
    """
    transition(mid, increments, declared, phi)
    carry_covariance(p, phi, SENSORS + declared.shape[0], a, b)
    add_white(p, noise, mid[MID_DT])


@kernel
def carry_errors(phi, declared, dt, matrix, columns, work):
    """matrix <- Phi matrix, in place: errors and sensor states over dt, s.

    phi: (SIZE,) as `transition` writes it for the declared states. matrix: (SIZE,) of so many columns. work: (SIZE,).
    """
    n = SENSORS + declared.shape[0]
    width = width_of(columns)
    _apply_transition(phi, matrix, work, n, width)
    # in one go, what lies between the rows too
    for i in range(STRIDE * SENSORS):
        matrix[i] = work[i]
    if is_varying(declared):
        decay_rows(declared, dt, matrix, width)


@kernel
def gain(p, h, r, m, pht, s, k):
    """Innovation covariance S = H P H' + R, its Cholesky factor and the gain K = P H' S^-1.

    p: (SIZE,). h: (m, n). r: (m, m). m: number of measurements. Out: pht (n, m'), s (m', m') holds the lower
    Cholesky factor of S, k (n, m'), with m' >= m. Returns False where S is not positive definite.
    """
    n = h.shape[1]
    # H is mostly zero (a fix measures position and velocity, and the lever arm little else)
    for a in range(m):
        for i in range(n):
            pht[i, a] = 0.0
        for j in range(n):
            c = h[a, j]
            if c != 0.0:
                for i in range(n):
                    pht[i, a] += c * p[STRIDE * j + i]
    for a in range(m):
        for b in range(a + 1):
            s[a, b] = r[a, b]
        for j in range(n):
            c = h[a, j]
            if c != 0.0:
                for b in range(a + 1):
                    s[a, b] += c * pht[j, b]
    if not cholesky(s, m):
        return False
    # K S = P H', all rows at once; six divisions instead of twelve a row
    reciprocal = np.empty(m)
    for a in range(m):
        reciprocal[a] = 1.0 / s[a, a]
    for i in range(n):
        for a in range(m):
            t = pht[i, a]
            for b in range(a):
                t -= s[a, b] * k[i, b]
            k[i, a] = t * reciprocal[a]
        for a in range(m - 1, -1, -1):
            t = k[i, a]
            for b in range(a + 1, m):
                t -= s[b, a] * k[i, b]
            k[i, a] = t * reciprocal[a]
    return True


@kernel
def joseph(p, h, r, m, pht, k, work):
    """P <- (I - K H) P (I - K H)' + K R K', in place and exactly symmetric [2].

    Arguments as left by `gain`; work: (n, m') space.
    """
    n = h.shape[1]
    # with A = P - K (P H')': the Joseph form is A + (K R - A H') K'
    for i in range(n):
        for j in range(n):
            t = 0.0
            for a in range(m):
                t += k[i, a] * pht[j, a]
            p[STRIDE * i + j] -= t
    for a in range(m):
        for i in range(n):
            t = 0.0
            for b in range(m):
                t += k[i, b] * r[b, a]
            work[i, a] = t
        for j in range(n):
            c = h[a, j]
            if c != 0.0:
                for i in range(n):
                    work[i, a] -= c * p[STRIDE * i + j]
    for i in range(n):
        for j in range(i + 1):
            t = p[STRIDE * i + j] + p[STRIDE * j + i]
            for a in range(m):
                t += work[i, a] * k[j, a] + work[j, a] * k[i, a]
            p[STRIDE * i + j] = 0.5 * t
            p[STRIDE * j + i] = 0.5 * t


@kernel
def reset(p, x, y, z, jac, work):
    """P <- G P G' after the attitude estimate was turned by theta = (x, y, z): G is I but for J_l(theta) [3].

    The error left, delta, is defined by exp(delta) exp(theta) = exp(theta + epsilon): delta = J_l epsilon.
    jac: (3, 3), work: (n, 3) space.
    """
    left_jacobian(x, y, z, jac)
    n = work.shape[0]
    for i in range(n):
        o = STRIDE * i + ATT
        for a in range(3):
            work[i, a] = jac[a, 0] * p[o] + jac[a, 1] * p[o + 1] + jac[a, 2] * p[o + 2]
    for i in range(n):
        for a in range(3):
            p[STRIDE * i + ATT + a] = work[i, a]
            p[STRIDE * (ATT + a) + i] = work[i, a]
    # the 3 x 3 block has so far one side only: J P_tt; the other, and exact symmetry
    for a in range(3):
        for b in range(a + 1):
            t = 0.0
            for j in range(3):
                t += jac[a, j] * work[ATT + j, b]
            p[STRIDE * (ATT + a) + ATT + b] = t
            p[STRIDE * (ATT + b) + ATT + a] = t


@kernel
def transport(p, diagonal, column, a, b):
    """P <- G P G' for a G of 3 x 3 blocks on the diagonal and in the attitude column, in place.

    diagonal: (n / 3, 3, 3). column: (n / 3, 3, 3), added to the attitude column; its attitude block must be zero.
    a, b: (SIZE,) work space. The result is exactly symmetric.
    """
    n = 3 * diagonal.shape[0]
    width = width_of(n)
    _apply_blocks(diagonal, column, p, a, width)
    _transpose(a, a, b, n)
    _apply_blocks(diagonal, column, b, p, width)
    for i in range(n):
        for j in range(i):
            t = 0.5 * (p[STRIDE * i + j] + p[STRIDE * j + i])
            p[STRIDE * i + j] = t
            p[STRIDE * j + i] = t


@kernel
def _apply_blocks(diagonal, column, p, out, width):
    """out = G p; see `transport`."""
    for block in range(diagonal.shape[0]):
        o = 3 * STRIDE * block
        for i in range(3):
            r = o + STRIDE * i
            a0, a1, a2 = diagonal[block, i, 0], diagonal[block, i, 1], diagonal[block, i, 2]
            c0, c1, c2 = column[block, i, 0], column[block, i, 1], column[block, i, 2]
            for j in range(width):
                out[r + j] = (a0 * p[o + j] + a1 * p[o + STRIDE + j] + a2 * p[o + 2 * STRIDE + j]) + (
                    c0 * p[STRIDE * A_N + j] + c1 * p[STRIDE * A_E + j] + c2 * p[STRIDE * A_D + j]
                )


@kernel
def normalised_square(p, e, first, count, factor, x):
    """e' P^-1 e over the states first .. first + count - 1; nan where that block of P is not positive.

    p: (n, n). e: (n,). factor (n, n) and x (n,) are work space.
    """
    for i in range(count):
        for j in range(i + 1):
            factor[i, j] = p[first + i, first + j]
        x[i] = e[first + i]
    if not cholesky(factor, count):
        return np.nan
    solve_lower(factor, count, x)
    t = 0.0
    for i in range(count):
        t += x[i] * x[i]
    return t


@kernel
def square(p, out):
    """The flat p as a matrix out (n, n)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[0]):
            out[i, j] = p[STRIDE * i + j]
