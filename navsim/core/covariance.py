"""The covariance of the fifteen errors: prediction over one IMU interval, Joseph update, reset.

P is one flat array, fifteen rows of stride sixteen (the last column is zero): LLVM turns row operations of a
literal stride into SIMD code only on such an array and with a trip count known at run time, which is why the
kernels take `width` (always `STRIDE`) as an argument.

Error model, truth minus estimate, in the local-level frame (r in metres NED, C_true = exp(theta x) C):
    r' = F_rr r + v
    v' = F_vr r + F_vv v - [f x] theta - C b_a
    theta' = F_tr r + F_tv v - [omega_in x] theta - C b_g
    b' = -b / tau
Sources: [1] Groves (2013), section 14.2.4 (local-navigation-frame error states, with position in metres and
signs of truth minus estimate). [2] Bucy & Joseph (1968), the update that keeps P symmetric and positive;
`landing.md` eq. (2). [3] Mueller, Hehn & D'Andrea, Covariance correction step for Kalman filtering with an
attitude, JGCD 40 (2017).
"""

from __future__ import annotations

import numpy as np

from navsim.core import states
from navsim.core.attitude import left_jacobian
from navsim.core.jit import inlined, kernel
from navsim.core.linear import cholesky, solve_lower
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
from navsim.core.wgs84 import E2, RATE, SOMIGLIANA, A

N = states.N
STRIDE = 16
SIZE = N * STRIDE

_STEEPENING = 2.0 * SOMIGLIANA + E2
"""d(ln gravity)/d(latitude) = this times sin(lat) cos(lat), to 1 %: the effect itself is 1e-8 of a step."""

# process noise, one flat array
NOISE_GYRO, NOISE_ACCEL = 0, 1
"""White angular rate (rad2/s) and specific force (m2/s3) densities: the squares of ARW and VRW."""
NOISE_GYRO_DECAY, NOISE_GYRO_DRIVE = 2, 3
"""1/tau of the gyro bias (1/s, 0 for a constant or a random walk) and its driving density (rad2/s3)."""
NOISE_ACCEL_DECAY, NOISE_ACCEL_DRIVE = 4, 5
"""The same for the accelerometer bias (1/s, m2/s5)."""
NOISE_N = 6


@inlined
def transition(mid, noise, phi):
    """Phi - I over one interval, rows 0-8 of the flat `phi` (stride 16), and the bias rows' diagonal.

    Second order in dt: I + F dt + F^2 dt^2 / 2 with F at mid-interval. Left out of F^2 are the products of
    two Earth-curvature terms (each below 1e-10 in Phi at 100 Hz and aircraft speeds).
    mid: (MID_N,) from `strapdown.step`. noise: (6,). phi: (240,) zero but for what this function writes.
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
    phi[0] = rr00 * dt
    phi[2] = rr02 * dt
    phi[16] = rr10 * dt
    phi[17] = rr11 * dt
    phi[18] = rr12 * dt

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
    phi[48] = vr00 * dt
    phi[50] = vr02 * dt
    phi[64] = vr10 * dt
    phi[66] = vr12 * dt
    phi[80] = vr20 * dt
    phi[82] = vr22 * dt
    phi[51] = vv00 * dt
    phi[52] = vv01 * dt
    phi[53] = vv02 * dt
    phi[67] = vv10 * dt
    phi[68] = vv11 * dt
    phi[69] = vv12 * dt
    phi[83] = vv20 * dt
    phi[84] = vv21 * dt
    # r <- v: dt + (F_rr + F_vv) dt^2 / 2
    phi[3] = dt + h * (rr00 + vv00)
    phi[4] = h * vv01
    phi[5] = h * (rr02 + vv02)
    phi[19] = h * (rr10 + vv10)
    phi[20] = dt + h * (rr11 + vv11)
    phi[21] = h * (rr12 + vv12)
    phi[35] = h * vv20
    phi[36] = h * vv21
    phi[37] = dt

    # -[f x]: v <- theta to second order, r <- theta
    # (F_vv F_vt + F_vt F_tt) with F_vv = -[o x] and F_tt = -[w x], each product [a x][b x] = b a' - (a.b) I
    of = on * fn + oe * fe + od * fd
    wf = wn * fn + we * fe + wd * fd
    s = of + wf
    phi[54] = h * (fn * on + wn * fn - s)
    phi[55] = fd * dt + h * (fn * oe + wn * fe)
    phi[56] = -fe * dt + h * (fn * od + wn * fd)
    phi[70] = -fd * dt + h * (fe * on + we * fn)
    phi[71] = h * (fe * oe + we * fe - s)
    phi[72] = fn * dt + h * (fe * od + we * fd)
    phi[86] = fe * dt + h * (fd * on + wd * fn)
    phi[87] = -fn * dt + h * (fd * oe + wd * fe)
    phi[88] = h * (fd * od + wd * fd - s)
    phi[7] = h * fd
    phi[8] = -h * fe
    phi[22] = -h * fd
    phi[24] = h * fn
    phi[38] = h * fe
    phi[39] = -h * fn

    # attitude rows
    phi[96] = -in_r0 * dt
    phi[98] = -en_r2 * dt
    phi[114] = -ee_r2 * dt
    phi[128] = -(id_r0 + ed_r0) * dt
    phi[130] = -ed_r2 * dt
    phi[100] = -en_v1 * dt
    phi[115] = -ee_v0 * dt
    phi[132] = -ed_v1 * dt
    ww = wn * wn + we * we + wd * wd
    phi[102] = h * (wn * wn - ww)
    phi[103] = wd * dt + h * wn * we
    phi[104] = -we * dt + h * wn * wd
    phi[118] = -wd * dt + h * we * wn
    phi[119] = h * (we * we - ww)
    phi[120] = wn * dt + h * we * wd
    phi[134] = we * dt + h * wd * wn
    phi[135] = -wn * dt + h * wd * we
    phi[136] = h * (wd * wd - ww)

    # biases: -C on theta and v, with the turning of n and the decay of b; second order on r and v
    gg = dt - h * noise[NOISE_GYRO_DECAY]
    ga = dt - h * noise[NOISE_ACCEL_DECAY]
    for j in range(3):
        c0 = mid[j]
        c1 = mid[3 + j]
        c2 = mid[6 + j]
        phi[9 * 0 + 12 + j] = -h * c0
        phi[16 + 12 + j] = -h * c1
        phi[32 + 12 + j] = -h * c2
        # v <- b_a: -C ga + [o x] C h;  v <- b_g: [f x] C h;  theta <- b_g: -C gg + [w x] C h
        phi[48 + 12 + j] = -ga * c0 + h * (oe * c2 - od * c1)
        phi[64 + 12 + j] = -ga * c1 + h * (od * c0 - on * c2)
        phi[80 + 12 + j] = -ga * c2 + h * (on * c1 - oe * c0)
        phi[48 + 9 + j] = h * (fe * c2 - fd * c1)
        phi[64 + 9 + j] = h * (fd * c0 - fn * c2)
        phi[80 + 9 + j] = h * (fn * c1 - fe * c0)
        phi[96 + 9 + j] = -gg * c0 + h * (we * c2 - wd * c1)
        phi[112 + 9 + j] = -gg * c1 + h * (wd * c0 - wn * c2)
        phi[128 + 9 + j] = -gg * c2 + h * (wn * c1 - we * c0)


@inlined
def _apply_transition(phi, p, out, width):
    """The first nine rows of out = Phi p, rows of stride 16, leaving out the blocks of Phi that are zero."""
    for i in range(3):
        o = 16 * i
        c0, c1, c2 = phi[o], phi[o + 1], phi[o + 2]
        c3, c4, c5 = phi[o + 3], phi[o + 4], phi[o + 5]
        c6, c7, c8 = phi[o + 6], phi[o + 7], phi[o + 8]
        d0, d1, d2 = phi[o + 12], phi[o + 13], phi[o + 14]
        for j in range(width):
            out[o + j] = (
                p[o + j]
                + (c0 * p[j] + c1 * p[16 + j] + c2 * p[32 + j])
                + (c3 * p[48 + j] + c4 * p[64 + j] + c5 * p[80 + j])
                + (c6 * p[96 + j] + c7 * p[112 + j] + c8 * p[128 + j])
                + (d0 * p[192 + j] + d1 * p[208 + j] + d2 * p[224 + j])
            )
    for i in range(3, 6):
        o = 16 * i
        c0, c2 = phi[o], phi[o + 2]
        c3, c4, c5 = phi[o + 3], phi[o + 4], phi[o + 5]
        c6, c7, c8 = phi[o + 6], phi[o + 7], phi[o + 8]
        b0, b1, b2 = phi[o + 9], phi[o + 10], phi[o + 11]
        d0, d1, d2 = phi[o + 12], phi[o + 13], phi[o + 14]
        for j in range(width):
            out[o + j] = (
                p[o + j]
                + (c0 * p[j] + c2 * p[32 + j])
                + (c3 * p[48 + j] + c4 * p[64 + j] + c5 * p[80 + j])
                + (c6 * p[96 + j] + c7 * p[112 + j] + c8 * p[128 + j])
                + (b0 * p[144 + j] + b1 * p[160 + j] + b2 * p[176 + j])
                + (d0 * p[192 + j] + d1 * p[208 + j] + d2 * p[224 + j])
            )
    for i in range(6, 9):
        o = 16 * i
        c0, c2 = phi[o], phi[o + 2]
        c3, c4 = phi[o + 3], phi[o + 4]
        c6, c7, c8 = phi[o + 6], phi[o + 7], phi[o + 8]
        b0, b1, b2 = phi[o + 9], phi[o + 10], phi[o + 11]
        for j in range(width):
            out[o + j] = (
                p[o + j]
                + (c0 * p[j] + c2 * p[32 + j])
                + (c3 * p[48 + j] + c4 * p[64 + j])
                + (c6 * p[96 + j] + c7 * p[112 + j] + c8 * p[128 + j])
                + (b0 * p[144 + j] + b1 * p[160 + j] + b2 * p[176 + j])
            )


@inlined
def _decay_biases(decay_gyro, decay_accel, p, out, width):
    """The bias rows of Phi p."""
    for j in range(3 * width):
        out[144 + j] = decay_gyro * p[144 + j]
    for j in range(3 * width):
        out[192 + j] = decay_accel * p[192 + j]


@inlined
def _transpose(a, out):
    """out = a', both 15 x 15 of stride 16."""
    for i in range(N):
        for j in range(N):
            out[STRIDE * j + i] = a[STRIDE * i + j]


@inlined
def predict(p, mid, noise, phi, a, b, width):
    """P <- Phi P Phi' + Q over one interval, in place.

    p: (240,). mid: (MID_N,) from `strapdown.step`. noise: (6,). phi, a, b: (240,) work space, zero at first.
    """
    transition(mid, noise, phi)
    dt = mid[MID_DT]
    x = dt * noise[NOISE_GYRO_DECAY]
    decay_gyro = 1.0 - x + 0.5 * x * x
    x = dt * noise[NOISE_ACCEL_DECAY]
    decay_accel = 1.0 - x + 0.5 * x * x
    _apply_transition(phi, p, a, width)
    _decay_biases(decay_gyro, decay_accel, p, a, width)
    _transpose(a, b)
    _apply_transition(phi, b, p, width)
    _decay_biases(decay_gyro, decay_accel, b, p, width)
    # white noise enters velocity as it adds up over the interval, and position through the trapezoid rule
    qg = noise[NOISE_GYRO] * dt
    qa = noise[NOISE_ACCEL] * dt
    bg = noise[NOISE_GYRO_DRIVE] * dt
    ba = noise[NOISE_ACCEL_DRIVE] * dt
    half = 0.5 * dt
    for i in range(3):
        p[17 * i] += half * half * qa
        p[17 * i + 3] += half * qa
        p[17 * i + 48] += half * qa
        p[51 + 17 * i] += qa
        p[102 + 17 * i] += qg
        p[153 + 17 * i] += bg
        p[204 + 17 * i] += ba


@kernel
def carry(phi, matrix, work, width):
    """The first nine rows of matrix <- Phi matrix, in place; the bias rows stay as they are.

    phi: (240,) as `transition` writes it. matrix: (240,) rows of stride 16. work: (240,) space.
    """
    _apply_transition(phi, matrix, work, width)
    for i in range(9 * STRIDE):
        matrix[i] = work[i]


@kernel
def carry_errors(phi, noise, dt, matrix, work, width):
    """As `carry` for errors of which the bias rows decay as the filter's estimates do; noise: (6,), dt: s."""
    carry(phi, matrix, work, width)
    for j in range(3):
        for i in range(N):
            matrix[STRIDE * (states.GYRO + j) + i] *= 1.0 - dt * noise[NOISE_GYRO_DECAY]
            matrix[STRIDE * (states.ACCEL + j) + i] *= 1.0 - dt * noise[NOISE_ACCEL_DECAY]


@kernel
def gain(p, h, r, m, pht, s, k):
    """Innovation covariance S = H P H' + R, its Cholesky factor and the gain K = P H' S^-1.

    p: (240,). h: (m, 15). r: (m, m). m: number of measurements. Out: pht (15, m'), s (m', m') holds the lower
    Cholesky factor of S, k (15, m'), with m' >= m. Returns False where S is not positive definite.
    """
    # H is mostly zero (a fix measures position and velocity, and the lever arm little else)
    for a in range(m):
        for i in range(N):
            pht[i, a] = 0.0
        for j in range(N):
            c = h[a, j]
            if c != 0.0:
                for i in range(N):
                    pht[i, a] += c * p[STRIDE * j + i]
    for a in range(m):
        for b in range(a + 1):
            s[a, b] = r[a, b]
        for j in range(N):
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
    for i in range(N):
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

    Arguments as left by `gain`; work: (15, m') space.
    """
    # with A = P - K (P H')': the Joseph form is A + (K R - A H') K'
    for i in range(N):
        for j in range(N):
            t = 0.0
            for a in range(m):
                t += k[i, a] * pht[j, a]
            p[STRIDE * i + j] -= t
    for a in range(m):
        for i in range(N):
            t = 0.0
            for b in range(m):
                t += k[i, b] * r[b, a]
            work[i, a] = t
        for j in range(N):
            c = h[a, j]
            if c != 0.0:
                for i in range(N):
                    work[i, a] -= c * p[STRIDE * i + j]
    for i in range(N):
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
    jac: (3, 3), work: (15, 3) space.
    """
    left_jacobian(x, y, z, jac)
    att = states.ATT
    for i in range(N):
        o = STRIDE * i + att
        for a in range(3):
            work[i, a] = jac[a, 0] * p[o] + jac[a, 1] * p[o + 1] + jac[a, 2] * p[o + 2]
    for i in range(N):
        for a in range(3):
            p[STRIDE * i + att + a] = work[i, a]
            p[STRIDE * (att + a) + i] = work[i, a]
    # the 3 x 3 block has so far one side only: J P_tt; the other, and exact symmetry
    for a in range(3):
        for b in range(a + 1):
            t = 0.0
            for j in range(3):
                t += jac[a, j] * work[att + j, b]
            p[STRIDE * (att + a) + att + b] = t
            p[STRIDE * (att + b) + att + a] = t


@kernel
def transport(p, diagonal, column, a, b, width):
    """P <- G P G' for a G of five 3 x 3 blocks on the diagonal and five in the attitude column, in place.

    diagonal: (5, 3, 3). column: (5, 3, 3), added to the attitude column; its attitude block must be zero.
    a, b: (240,) work space. The result is exactly symmetric.
    """
    _apply_blocks(diagonal, column, p, a, width)
    _transpose(a, b)
    _apply_blocks(diagonal, column, b, p, width)
    for i in range(N):
        for j in range(i):
            t = 0.5 * (p[STRIDE * i + j] + p[STRIDE * j + i])
            p[STRIDE * i + j] = t
            p[STRIDE * j + i] = t


@kernel
def _apply_blocks(diagonal, column, p, out, width):
    """out = G p, rows of stride 16; see `transport`."""
    for block in range(5):
        o = 48 * block
        for i in range(3):
            r = o + 16 * i
            a0, a1, a2 = diagonal[block, i, 0], diagonal[block, i, 1], diagonal[block, i, 2]
            c0, c1, c2 = column[block, i, 0], column[block, i, 1], column[block, i, 2]
            for j in range(width):
                out[r + j] = (a0 * p[o + j] + a1 * p[o + 16 + j] + a2 * p[o + 32 + j]) + (
                    c0 * p[96 + j] + c1 * p[112 + j] + c2 * p[128 + j]
                )


@kernel
def normalised_square(p, e, first, count, factor, x):
    """e' P^-1 e over the states first .. first + count - 1; nan where that block of P is not positive.

    p: (240,) flat. e: (15,). factor (15, 15) and x (15,) are work space.
    """
    for i in range(count):
        for j in range(i + 1):
            factor[i, j] = p[STRIDE * (first + i) + first + j]
        x[i] = e[first + i]
    if not cholesky(factor, count):
        return np.nan
    solve_lower(factor, count, x)
    t = 0.0
    for i in range(count):
        t += x[i] * x[i]
    return t
