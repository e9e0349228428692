"""The covariance of the errors: prediction over an interval, Joseph update, reset, for any declared sensor states.

The error model, the transition and the noise of an interval are those of `interval`.

Sources: [1] Bucy & Joseph (1968), the update that keeps P symmetric and positive; `docs/theory/filter.md`, eq. (23).
[2] Mueller, Hehn & D'Andrea, Covariance correction step for Kalman filtering with an attitude, JGCD 40 (2017).
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import any_lane, fma, small_vector, where
from navsim.compiler.linear import cholesky, solve_lower
from navsim.filter.interval import add_driven, add_white
from navsim.filter.states import (
    ACCEL,
    ACCELEROMETERS,
    ATT,
    GYRO,
    MAX_MEASUREMENT_SIZE,
    N_BASE,
    PHI_D,
    PHI_E,
    PHI_N,
    R_D,
    R_E,
    R_N,
    SENSORS,
    V_D,
    V_E,
    V_N,
)
from navsim.geodesy.attitude_kernels import left_jacobian

# densities of the sensors' white noise, one flat array: the squares of ARW and VRW
NOISE_GYRO, NOISE_ACCEL = 0, 1
"""Angular rate (rad2/s) and specific force (m2/s3)."""
NOISE_N = 2


@kernel_inline
def _couplings(phi, i):
    """Row i of Phi: couplings to position, velocity, attitude, gyro and accelerometer biases, each of three."""
    return (
        (phi[i, R_N], phi[i, R_E], phi[i, R_D]),
        (phi[i, V_N], phi[i, V_E], phi[i, V_D]),
        (phi[i, PHI_N], phi[i, PHI_E], phi[i, PHI_D]),
        (phi[i, GYRO], phi[i, GYRO + 1], phi[i, GYRO + 2]),
        (phi[i, ACCEL], phi[i, ACCEL + 1], phi[i, ACCEL + 2]),
    )


@kernel_inline
def _column(p, j):
    """Column j of p in the same order."""
    return (
        (p[R_N, j], p[R_E, j], p[R_D, j]),
        (p[V_N, j], p[V_E, j], p[V_D, j]),
        (p[PHI_N, j], p[PHI_E, j], p[PHI_D, j]),
        (p[GYRO, j], p[GYRO + 1, j], p[GYRO + 2, j]),
        (p[ACCEL, j], p[ACCEL + 1, j], p[ACCEL + 2, j]),
    )


@kernel_inline
def _block_row(phi, i, c):
    """Effect of a block of states from c on on row i."""
    return phi[i, c], phi[i, c + 1], phi[i, c + 2]


@kernel_inline
def _is_any(c):
    """Whether any of three is not zero, in any lane."""
    return any_lane((c[0] != 0.0) | (c[1] != 0.0) | (c[2] != 0.0))


@kernel_inline
def _add(c, x, s):
    """s + c' x of three."""
    return fma(c[2], x[2], fma(c[1], x[1], fma(c[0], x[0], s)))


@kernel_inline
def _add_outer(c, x, s):
    """`_add` for a zero middle coupling."""
    return fma(c[2], x[2], fma(c[0], x[0], s))


@kernel
def count_imu_states(declared):
    """Number of declared states that are errors of inertial sensors; they come first (`states.declared`)."""
    count = 0
    for c in range(declared.shape[0]):
        count += 1 if declared[c].sensor <= ACCELEROMETERS else 0
    return count


@kernel
def _transition_rows(phi, coupled, p, half, out):
    """out[j, i] <- the navigation rows i of Phi p, transposed, for the columns j of p (n, m).

    half: 0 computes all columns; 1 those up to i, and a few unneeded ones. coupled: number of states that act on the
    navigation states; they come first.

    Several rows are computed together with their couplings in registers, so each element of p is loaded once for all of
    them. Zero couplings (`transition`) are skipped.
    """
    whole = p.shape[1]
    # a letter for the row, one for its coupling
    nr, nv, na, ng, nf = _couplings(phi, R_N)
    er, ev, ea, eg, ef = _couplings(phi, R_E)
    for j in range(R_E + 1 if half else whole):
        r, v, a, g, f = _column(p, j)
        n, e = _add_outer(nr, r, r[0]), _add(er, r, r[1])
        n, e = _add(nv, v, n), _add(ev, v, e)
        n, e = fma(na[2], a[2], fma(na[1], a[1], n)), _add_outer(ea, a, e)
        n, e = _add(ng, g, n), _add(eg, g, e)
        out[j, R_N], out[j, R_E] = _add(nf, f, n), _add(ef, f, e)
    nr, nv, na, ng, nf = _couplings(phi, V_N)
    er, ev, ea, eg, ef = _couplings(phi, V_E)
    for j in range(V_E + 1 if half else whole):
        r, v, a, g, f = _column(p, j)
        n, e = _add_outer(nr, r, v[0]), _add_outer(er, r, v[1])
        n, e = _add(nv, v, n), _add(ev, v, e)
        n, e = _add(na, a, n), _add(ea, a, e)
        n, e = _add(ng, g, n), _add(eg, g, e)
        out[j, V_N], out[j, V_E] = _add(nf, f, n), _add(ef, f, e)
    rr, rv, ra, rg, rf = _couplings(phi, R_D)
    vr, vv, va, vg, vf = _couplings(phi, V_D)
    for j in range(V_D + 1 if half else whole):
        r, v, a, g, f = _column(p, j)
        s, t = _add(rv, v, fma(rr[2], r[2], r[2])), _add_outer(vr, r, v[2])
        s, t = fma(ra[1], a[1], fma(ra[0], a[0], s)), fma(vv[1], v[1], fma(vv[0], v[0], t))
        s, t = _add(rg, g, s), _add(vg, g, _add(va, a, t))
        out[j, R_D], out[j, V_D] = _add(rf, f, s), _add(vf, f, t)
    nr, nv, na, ng, _ = _couplings(phi, PHI_N)
    er, ev, ea, eg, _ = _couplings(phi, PHI_E)
    dr, dv, da, dg, _ = _couplings(phi, PHI_D)
    for j in range(PHI_D + 1 if half else whole):
        r, v, a, g, _ = _column(p, j)
        n, e, d = _add_outer(nr, r, a[0]), fma(er[2], r[2], a[1]), _add_outer(dr, r, a[2])
        n, e, d = fma(nv[1], v[1], n), fma(ev[0], v[0], e), fma(dv[1], v[1], d)
        n, e, d = _add(na, a, n), _add(ea, a, e), _add(da, a, d)
        out[j, PHI_N], out[j, PHI_E], out[j, PHI_D] = _add(ng, g, n), _add(eg, g, e), _add(dg, g, d)
    # blocks of sensor states after the biases may act on position, velocity and attitude
    for c in range(N_BASE, coupled, 3):
        for i in range(0, SENSORS, 3):
            n, e, d = _block_row(phi, i, c), _block_row(phi, i + 1, c), _block_row(phi, i + 2, c)
            if _is_any(n) or _is_any(e) or _is_any(d):
                for j in range(i + 3 if half else whole):
                    x = p[c, j], p[c + 1, j], p[c + 2, j]
                    out[j, i], out[j, i + 1], out[j, i + 2] = (
                        _add(n, x, out[j, i]), _add(e, x, out[j, i + 1]), _add(d, x, out[j, i + 2]),
                    )  # fmt: skip


@kernel
def propagate_markov_states(p, first, decay, noise_variance):
    """Propagate Gauss-Markov states of P (n, n) from `first` on, in place: multiply by `decay` (k,), add
    `noise_variance` (k,) to the variances."""
    last = first + decay.shape[0]
    for i in range(first, last):
        own = decay[i - first]
        for j in range(first):
            t = own * p[i, j]
            p[i, j], p[j, i] = t, t
        for j in range(first, i):
            t = own * p[i, j] * decay[j - first]
            p[i, j], p[j, i] = t, t
        p[i, i] = own * p[i, i] * own + noise_variance[i - first]
        for j in range(last, p.shape[0]):
            t = own * p[i, j]
            p[i, j], p[j, i] = t, t


@kernel
def is_varying(declared):
    """Whether any of these states decays or is driven, so that `propagate_markov_states` is needed."""
    varying = False
    for c in range(declared.shape[0]):
        varying |= declared[c].decay > 0.0 or declared[c].drive > 0.0
    return varying


@kernel
def propagate_covariance(p, phi, coupled, a):
    """P <- Phi P Phi' (n, n) without the decay of the sensor states, in place and exactly symmetric.

    phi: from `transition`. coupled: see `_transition_rows`. a: (n, 9) work space.
    """
    n = p.shape[0]
    _transition_rows(phi, coupled, p, 0, a)
    _transition_rows(phi, coupled, a, 1, p)
    for i in range(SENSORS):
        for j in range(i):
            p[i, j] = p[j, i]
    # covariances between sensor states do not change
    for j in range(SENSORS, n):
        for i in range(SENSORS):
            p[j, i] = a[j, i]
            p[i, j] = a[j, i]


@kernel_inline
def predict(p, sums, noise, declared, phi, a):
    """P <- Phi P Phi' + Q over an interval, in place.

    p: (n, n). sums: of its steps, for the declared sensor states (k,) first. noise: (2,) densities of the white noises.
    phi: as `interval.transition` writes it. a: (n, 9) work space.
    """
    propagate_covariance(p, phi, SENSORS + count_imu_states(declared), a)
    if is_varying(declared):
        known = declared.shape[0]
        propagate_markov_states(p, SENSORS, sums.decay[:known], sums.noise[:known])
        for c in range(count_imu_states(declared)):
            if declared[c].drive > 0.0:
                add_driven(sums, c, declared[c].drive, SENSORS + c, p)
    add_white(sums, noise[NOISE_GYRO], noise[NOISE_ACCEL], p)


@kernel
def propagate_error_columns(phi, coupled, decay, matrix, work):
    """Propagate errors and sensor states (n, m) over an interval, in place: matrix <- Phi matrix.

    phi, coupled: as of `propagate_covariance`. decay (k,): decay of the sensor states. work: (m, 9).
    """
    _transition_rows(phi, coupled, matrix, 0, work)
    for i in range(SENSORS):
        for j in range(matrix.shape[1]):
            matrix[i, j] = work[j, i]
    for c in range(decay.shape[0]):
        if decay[c] != 1.0:
            for j in range(matrix.shape[1]):
                matrix[SENSORS + c, j] *= decay[c]


@kernel
def gain(p, h, r, m, pht, s, k):
    """`innovation_factor` and `gain_by_factor`."""
    good = innovation_factor(p, h, r, m, pht, s)
    gain_by_factor(s, m, pht, k)
    return good


@kernel
def gain_by_factor(s, m, pht, k):
    """The gain K = P H' S^-1, k (n, m'), by what `innovation_factor` left."""
    # of the most measurements the compiler knows how many they are, and keeps the factor in registers
    if m == MAX_MEASUREMENT_SIZE:
        _solve_rows(s, MAX_MEASUREMENT_SIZE, pht, k)
    else:
        _solve_rows(s, m, pht, k)


@kernel
def innovation_factor(p, h, r, m, pht, s):
    """Cholesky factor of the innovation covariance S = H P H' + R; returns whether S is positive definite.

    p: (n, n). h: (m, n). r: (m, m). m: number of measurements. Out: pht (n, m') holds P H', s (m', m') the lower
    factor, with m' >= m.
    """
    n = h.shape[1]
    # H is mostly zero (a fix measures position and velocity, and the lever arm little else)
    for a in range(m):
        for i in range(n):
            pht[i, a] = 0.0
        for j in range(n):
            c = h[a, j]
            if any_lane(c != 0.0):
                for i in range(n):
                    pht[i, a] = fma(c, p[j, i], pht[i, a])
    for a in range(m):
        for b in range(a + 1):
            s[a, b] = r[a, b]
        for j in range(n):
            c = h[a, j]
            if any_lane(c != 0.0):
                for b in range(a + 1):
                    s[a, b] = fma(c, pht[j, b], s[a, b])
    return cholesky(s, m)


@kernel_inline
def _solve_rows(s, m, pht, k):
    """K S = P H' for all rows of K (n, m'), S by its factor; with m divisions instead of 2 m a row."""
    reciprocal, row = small_vector(k, MAX_MEASUREMENT_SIZE), small_vector(k, MAX_MEASUREMENT_SIZE)
    for a in range(m):
        reciprocal[a] = 1.0 / s[a, a]
    for i in range(k.shape[0]):
        for a in range(m):
            t = pht[i, a]
            for b in range(a):
                t = fma(-s[a, b], row[b], t)
            row[a] = t * reciprocal[a]
        for a in range(m - 1, -1, -1):
            t = row[a]
            for b in range(a + 1, m):
                t = fma(-s[b, a], row[b], t)
            row[a] = t * reciprocal[a]
        for a in range(m):
            k[i, a] = row[a]


@kernel
def joseph(p, h, r, m, pht, k, work):
    """P <- (I - K H) P (I - K H)' + K R K', in place and exactly symmetric [1].

    Arguments as left by `gain`; work: (n, m') space.
    """
    # of the most measurements the compiler knows how many they are, and keeps their numbers in registers
    if m == MAX_MEASUREMENT_SIZE:
        _joseph(p, h, r, MAX_MEASUREMENT_SIZE, pht, k, work)
    else:
        _joseph(p, h, r, m, pht, k, work)


@kernel_inline
def _joseph(p, h, r, m, pht, k, work):
    n = h.shape[1]
    # with A = P - K (P H')': the Joseph form is A + (K R - A H') K'. A H' is that of the A computed, whose rounding it
    # takes away
    _add_products(p, -1.0, k, pht, m)
    row = small_vector(p, MAX_MEASUREMENT_SIZE)
    for i in range(n):
        for a in range(m):
            row[a] = k[i, a]
        for a in range(m):
            t = row[0] * r[0, a]
            for b in range(1, m):
                t = fma(row[b], r[b, a], t)
            work[i, a] = t
    for a in range(m):
        for j in range(n):
            c = h[a, j]
            if any_lane(c != 0.0):
                for i in range(j):
                    work[i, a] = fma(-c, p[j, i], work[i, a])
                for i in range(j, n):
                    work[i, a] = fma(-c, p[i, j], work[i, a])
    _add_products(p, 1.0, work, k, m)
    for i in range(n):
        for j in range(i):
            p[j, i] = p[i, j]


@kernel_inline
def _add_products(p, sign, a, b, m):
    """The lower half of p <- p + sign a b' (n, n) for a, b (n, m'), which is symmetric but for rounding."""
    n = p.shape[0]
    first, second = small_vector(p, MAX_MEASUREMENT_SIZE), small_vector(p, MAX_MEASUREMENT_SIZE)
    # two rows at once; of an odd number of rows the first is taken with itself
    for pair in range(-(n % 2), n, 2):
        one, two = max(pair, 0), pair + 1
        for c in range(m):
            first[c], second[c] = sign * a[one, c], sign * a[two, c]
        for j in range(two + 1):
            s, t = p[one, j], p[two, j]
            for c in range(m):
                s, t = fma(first[c], b[j, c], s), fma(second[c], b[j, c], t)
            p[one, j], p[two, j] = s, t


@kernel
def reset(p, x, y, z, jac, work):
    """P <- G P G' after a rotation of the attitude estimate by theta = (x, y, z): G is I except for J_l(theta) [2].

    The remaining error delta is defined by exp(delta) exp(theta) = exp(theta + epsilon): delta = J_l epsilon. p: (n,
    n). jac: (3, 3), work: (n, 3) space.
    """
    left_jacobian(x, y, z, jac)
    n = p.shape[0]
    for i in range(n):
        for a in range(3):
            work[i, a] = jac[a, 0] * p[i, ATT] + jac[a, 1] * p[i, ATT + 1] + jac[a, 2] * p[i, ATT + 2]
    for i in range(n):
        for a in range(3):
            p[i, ATT + a] = work[i, a]
            p[ATT + a, i] = work[i, a]
    # the 3 x 3 block has so far one side only: J P_tt; the other, and exact symmetry
    for a in range(3):
        for b in range(a + 1):
            t = jac[a, 0] * work[ATT, b] + jac[a, 1] * work[ATT + 1, b] + jac[a, 2] * work[ATT + 2, b]
            p[ATT + a, ATT + b] = t
            p[ATT + b, ATT + a] = t


@kernel
def transport(p, diagonal, column, first, work):
    """P <- G P G' for a G of 3 x 3 blocks on the diagonal and in the attitude column, in place; the result is
    symmetric.

    p: (n, n). diagonal, column: (k, 3, 3) of the first 3 k states, column added to the attitude column; its attitude
    block must be zero. Later states do not change, and neither do those of the blocks before `first`, which is at most
    that of attitude. work: (n, 3 k) space.
    """
    n, still, moved = p.shape[0], 3 * first, 3 * diagonal.shape[0]
    _apply_blocks(diagonal, column, p, first, n, 0, work)
    _apply_blocks(diagonal, column, work, first, moved, 1, p)
    for i in range(still, moved):
        for j in range(still, i):
            p[j, i] = p[i, j]
        for j in range(still):
            p[i, j], p[j, i] = work[j, i], work[j, i]
        for j in range(moved, n):
            p[i, j], p[j, i] = work[j, i], work[j, i]


@kernel
def transported(p, diagonal, column, first, work, out):
    """`transport` of a P that does not change: the lower half of out (n, n) <- that of G P G'."""
    n, still, moved = p.shape[0], 3 * first, 3 * diagonal.shape[0]
    _apply_blocks(diagonal, column, p, first, n, 0, work)
    _apply_blocks(diagonal, column, work, first, moved, 1, out)
    for i in range(n):
        for j in range(min(i + 1, still)):
            out[i, j] = work[j, i] if still <= i < moved else p[i, j]
        for j in range(still, moved if i >= moved else still):
            out[i, j] = work[i, j]
        for j in range(moved, i + 1):
            out[i, j] = p[i, j]


@kernel
def _apply_blocks(diagonal, column, p, first, last, half, out):
    """out[j, i] <- (G p)[i, j] of the states i that change, for the columns j below `last`; see `transport`.

    half: 0 computes all columns; 1 those with j >= i, and a few unneeded ones.
    """
    for block in range(first, diagonal.shape[0]):
        o = 3 * block
        own, across = diagonal[block], column[block]
        a0, a1, a2, a3, a4, a5 = own[0, 0], own[0, 1], own[0, 2], across[0, 0], across[0, 1], across[0, 2]
        b0, b1, b2, b3, b4, b5 = own[1, 0], own[1, 1], own[1, 2], across[1, 0], across[1, 1], across[1, 2]
        c0, c1, c2, c3, c4, c5 = own[2, 0], own[2, 1], own[2, 2], across[2, 0], across[2, 1], across[2, 2]
        if o == ATT:
            for j in range(half * o, last):
                x0, x1, x2 = p[o, j], p[o + 1, j], p[o + 2, j]
                out[j, o] = fma(a2, x2, fma(a1, x1, a0 * x0))
                out[j, o + 1] = fma(b2, x2, fma(b1, x1, b0 * x0))
                out[j, o + 2] = fma(c2, x2, fma(c1, x1, c0 * x0))
            continue
        for j in range(half * o, last):
            x0, x1, x2, x3, x4, x5 = p[o, j], p[o + 1, j], p[o + 2, j], p[PHI_N, j], p[PHI_E, j], p[PHI_D, j]
            out[j, o] = fma(a5, x5, fma(a4, x4, fma(a3, x3, fma(a2, x2, fma(a1, x1, a0 * x0)))))
            out[j, o + 1] = fma(b5, x5, fma(b4, x4, fma(b3, x3, fma(b2, x2, fma(b1, x1, b0 * x0)))))
            out[j, o + 2] = fma(c5, x5, fma(c4, x4, fma(c3, x3, fma(c2, x2, fma(c1, x1, c0 * x0)))))


@kernel
def normalised_square(p, e, first, count, factor, x):
    """e' P^-1 e over the states first .. first + count - 1; nan where that block of P is not positive.

    p: (n, n). e: (n,). factor (n, n) and x (n,) are work space.
    """
    for i in range(count):
        for j in range(i + 1):
            factor[i, j] = p[first + i, first + j]
        x[i] = e[first + i]
    good = cholesky(factor, count)
    solve_lower(factor, count, x)
    t = x[0] * x[0]
    for i in range(1, count):
        t += x[i] * x[i]
    return where(good, t, math.nan)
