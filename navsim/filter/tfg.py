"""`kind: tfg`: two-frames group filter, with biases in the navigation frame and the exact reset.

The group contains attitude, position, velocity and B = C b of both biases; the estimate moves by u+ = u + J_l(theta)
y_u for u in {r, v, B_g, B_a}. In these coordinates the posterior of a landing is nearly Gaussian where it is curved in
plain ones, so the covariance stays consistent at large heading errors. Hard iron of a magnetometer is a third such
vector, always of the present attitude. A heading and the hard iron that looks like it then lie on a straight line, and
the filter learns nothing along it.

    T: (dr, dv, theta, db_g, db_a) -> (dr, dv, theta, dB_g, dB_a),  dB = C db - [B x] theta
    P+ = T(x+)^-1 M T(x) P T(x)' M' T(x+)^-T
    M: J_l(theta) on the diagonal, d(J_l(theta) y_u)/d(theta) in the theta column

In straight flight `gaussian_sum` has errors of gyro biases in fixed navigation axes, B_g+ = exp(theta) B_g + C db.

C is the present attitude, except after a quick turn with an uncertain heading (`freeze_bias_frame`): then it is the
attitude before the turn. Any C is valid to first order; this one keeps the posterior straight.

Sources: [1] Barrau & Bonnabel, The geometry of navigation problems, IEEE TAC 68 (2023) (two-frames group). [2]
Fornasier et al., Equivariant symmetries for inertial navigation systems, arXiv 2309.03765. [3] `docs/theory/filter.md`,
section 5.
"""

from __future__ import annotations

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import any_lane, no, small_matrix, small_vector, where
from navsim.compiler.linear import copy, invert3
from navsim.filter.covariance import transport
from navsim.filter.left_invariant import blocks_of_motion, move_rigidly, turned
from navsim.filter.states import (
    ATT,
    GYRO,
    N_BASE,
    NAV_BIAS_FRAME,
    NAV_QUAT,
    NAV_SENSORS,
    PHI_D,
    PHI_E,
    PHI_N,
    POS,
    SENSORS,
    VEL,
)
from navsim.geodesy.attitude_kernels import dcm, left_jacobian, left_jacobian_derivative, rotate_in_body_axes

HELD_RATE = 0.035
"""Body rates above this (2 deg/s) turn the vehicle but not the bias axes, while heading is uncertain."""
HELD_SIGMA = 0.07
"""1 sigma of heading, rad (4 degrees), below which the bias axes follow the body at once."""


@kernel
def freeze_bias_frame(nav, p, increments, dt):
    """Accumulate the rotation that holds back the bias axes.

    increments: bias-free angle increments over dt, rad. While heading is uncertain, knowledge of a bias belongs to the
    axes along which it was observed. A quick turn of the body must not rotate it to axes of unknown direction.
    """
    held = nav[NAV_BIAS_FRAME:NAV_SENSORS]
    known = p[PHI_D, PHI_D] < HELD_SIGMA * HELD_SIGMA
    size = increments[0] * increments[0] + increments[1] * increments[1] + increments[2] * increments[2]
    turning = no(known) & (size > (HELD_RATE * dt) * (HELD_RATE * dt))
    if any_lane(turning):
        # a rotation by zero changes nothing
        share = where(turning, 1.0, 0.0)
        rotate_in_body_axes(held, share * increments[0], share * increments[1], share * increments[2])
    for i in range(4):
        held[i] = where(known, 1.0 if i == 0 else 0.0, held[i])


@kernel
def bias_axes(nav, out):
    """C (3, 3): the attitude minus the held-back turn; it rotates biases into their own frame."""
    q = nav[NAV_QUAT:NAV_BIAS_FRAME]
    m = nav[NAV_BIAS_FRAME:NAV_SENSORS]
    back = small_vector(nav, 4)
    back[0] = q[0] * m[0] + q[1] * m[1] + q[2] * m[2] + q[3] * m[3]
    back[1] = -q[0] * m[1] + q[1] * m[0] - q[2] * m[3] + q[3] * m[2]
    back[2] = -q[0] * m[2] + q[1] * m[3] + q[2] * m[0] - q[3] * m[1]
    back[3] = -q[0] * m[3] - q[1] * m[2] + q[2] * m[1] + q[3] * m[0]
    dcm(back, out)


@kernel
def is_plain(nav):
    """Whether bias errors have body axes and are added (`gaussian_sum`): no held turn is stored."""
    m = nav[NAV_BIAS_FRAME:NAV_SENSORS]
    return m[0] * m[0] + m[1] * m[1] + m[2] * m[2] + m[3] * m[3] == 0.0


@kernel
def has_navigation_axes(nav):
    """Whether errors of gyro biases have fixed navigation axes (`gaussian_sum`): the negative of no turn is stored."""
    return nav[NAV_BIAS_FRAME] == -1.0


@kernel
def apply_transposed(matrix, u0, u1, u2, out):
    """out = matrix' u for the 3-vector u."""
    for i in range(3):
        out[i] = matrix[0, i] * u0 + matrix[1, i] * u1 + matrix[2, i] * u2


@kernel
def correct(nav, p, x, space):
    """Apply the estimated plain errors x (n,) and transform P (n, n) to the new estimate. space: as of
    `filter_loop`."""
    feed_back(nav, x, space)
    transport(p, space.diagonal, space.column, space.straight, space.turned)


@kernel
def feed_back(nav, x, space):
    """Apply the estimated plain errors x (n,), in place.

    diagonal, column (k, 3, 3) of `space`, out: reset matrix for `filter.covariance.transport`. Sensor states that are
    no vectors of the body do not change it.
    """
    n, body = x.shape[0], space.body
    diagonal, column = space.diagonal, space.column
    before, after = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    attitude, later = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    vector = small_vector(nav, 3)
    bias_axes(nav, before)
    if body > 0:
        dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], attitude)
    blocks_of_motion(x, diagonal, column, space.straight)
    jac = diagonal[2]
    move_rigidly(nav, x, jac, space.straight)
    bias_axes(nav, after)
    plain, fixed = is_plain(nav), has_navigation_axes(nav)
    for o in range(GYRO, N_BASE, 3):
        first = NAV_SENSORS - SENSORS + o
        copy(nav[first : first + 3], vector)
        _move_vector(nav, x, o, before, after, jac, diagonal[o // 3], column[o // 3])
        if any_lane(plain):
            _add_vector(plain, vector, x, o, nav, diagonal[o // 3], column[o // 3])
        if o == GYRO and any_lane(fixed):
            _turn_gyro_bias(fixed, vector, x, before, after, nav, diagonal, column)
    if body > 0:
        dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], later)
        _move_vector(nav, x, body, attitude, later, jac, diagonal[body // 3], column[body // 3])
    for c in range(N_BASE, n):
        if c < body or c >= body + 3:
            nav[NAV_SENSORS - SENSORS + c] += x[c]


@kernel
def _move_vector(nav, x, o, before, after, jac, diagonal, column):
    """Apply the errors of a vector of the body, states o .. o + 2, and of the attitude; axes before and after (3, 3).

    diagonal, column (3, 3), out: its blocks of the reset matrix.
    """
    slope = small_matrix(nav, 3, 3)
    y, big, moved = small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3)
    t0, t1, t2 = x[PHI_N], x[PHI_E], x[PHI_D]
    first = NAV_SENSORS - SENSORS + o
    b = nav[first : first + 3]
    turned(before, b, big)
    turned(before, x[o : o + 3], y)
    # y_B = C db - B x theta
    y[0] -= big[1] * t2 - big[2] * t1
    y[1] -= big[2] * t0 - big[0] * t2
    y[2] -= big[0] * t1 - big[1] * t0
    left_jacobian_derivative(t0, t1, t2, y, slope)
    turned(jac, y, moved)
    apply_transposed(after, moved[0] + big[0], moved[1] + big[1], moved[2] + big[2], b)
    # theta column: C+' (D - J [B x]) + [b+ x] C+' J;  own block: C+' J C
    for i in range(3):
        j0, j1, j2 = jac[i, 0], jac[i, 1], jac[i, 2]
        slope[i, 0] -= j1 * big[2] - j2 * big[1]
        slope[i, 1] -= j2 * big[0] - j0 * big[2]
        slope[i, 2] -= j0 * big[1] - j1 * big[0]
    for j in range(3):
        # column j of C+' J, then of C+' slope
        apply_transposed(after, jac[0, j], jac[1, j], jac[2, j], y)
        apply_transposed(after, slope[0, j], slope[1, j], slope[2, j], moved)
        column[0, j] = moved[0] + b[1] * y[2] - b[2] * y[1]
        column[1, j] = moved[1] + b[2] * y[0] - b[0] * y[2]
        column[2, j] = moved[2] + b[0] * y[1] - b[1] * y[0]
        # column j of C, then of J C, of C+' J C
        y[0], y[1], y[2] = before[0, j], before[1, j], before[2, j]
        turned(jac, y, moved)
        apply_transposed(after, moved[0], moved[1], moved[2], y)
        for i in range(3):
            diagonal[i, j] = y[i]


@kernel
def _add_vector(plain, vector, x, o, nav, diagonal, column):
    """Where `plain`, add the errors of a vector (3,) of the body, states o .. o + 2, as in plain coordinates."""
    first = NAV_SENSORS - SENSORS + o
    for i in range(3):
        nav[first + i] = where(plain, vector[i] + x[o + i], nav[first + i])
        for j in range(3):
            diagonal[i, j] = where(plain, 1.0 if i == j else 0.0, diagonal[i, j])
            column[i, j] = where(plain, 0.0, column[i, j])


@kernel
def _turn_gyro_bias(fixed, vector, x, before, after, nav, diagonal, column):
    """Where `fixed`, b+ = vector + C+' C x for the gyro biases, C `before`, C+ `after` (3, 3).

    diagonal, column: as of `feed_back`; their blocks of the gyro biases are C+' C and C+' [C x x] J.
    """
    y, row, first = small_vector(nav, 3), small_vector(nav, 3), NAV_SENSORS - SENSORS + GYRO
    own, across, jac = diagonal[GYRO // 3], column[GYRO // 3], diagonal[ATT // 3]
    turned(before, x[GYRO : GYRO + 3], y)
    for i in range(3):
        a, b, c = after[0, i], after[1, i], after[2, i]
        nav[first + i] = where(fixed, vector[i] + a * y[0] + b * y[1] + c * y[2], nav[first + i])
        row[0], row[1], row[2] = b * y[2] - c * y[1], c * y[0] - a * y[2], a * y[1] - b * y[0]
        for j in range(3):
            own[i, j] = where(fixed, a * before[0, j] + b * before[1, j] + c * before[2, j], own[i, j])
            by_attitude = row[0] * jac[0, j] + row[1] * jac[1, j] + row[2] * jac[2, j]
            across[i, j] = where(fixed, by_attitude, across[i, j])


@kernel
def error_in_filter_coordinates(nav, error, out, straight, body):
    """Error (n,) in the filter's own coordinates, expressed as the plain error of the same tangent.

    y_u = J_l(theta)^-1 (u_true - u), then db = C' y_B + [b x] C' theta, so that P of the plain errors applies to it.
    straight, body: of the chart.
    """
    c_nb, jac, inverse = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    left_jacobian(error[PHI_N], error[PHI_E], error[PHI_D], jac)
    invert3(jac, inverse)
    copy(error, out)
    if straight < 1:
        turned(inverse, error[POS:VEL], out[POS:VEL])
    if straight < 2:
        turned(inverse, error[VEL:ATT], out[VEL:ATT])
    bias_axes(nav, c_nb)
    for o in range(GYRO, N_BASE, 3):
        _vector_error_in_filter_coordinates(nav, error, o, c_nb, jac, inverse, out)
    plain, fixed = is_plain(nav), has_navigation_axes(nav)
    if any_lane(fixed):
        # C' exp(theta) C db, exp(theta) = I + [theta x] J
        y, moved = small_vector(nav, 3), small_vector(nav, 3)
        turned(c_nb, error[GYRO : GYRO + 3], y)
        turned(jac, y, moved)
        y[0] += error[PHI_E] * moved[2] - error[PHI_D] * moved[1]
        y[1] += error[PHI_D] * moved[0] - error[PHI_N] * moved[2]
        y[2] += error[PHI_N] * moved[1] - error[PHI_E] * moved[0]
        apply_transposed(c_nb, y[0], y[1], y[2], moved)
        for i in range(3):
            out[GYRO + i] = where(fixed, moved[i], out[GYRO + i])
    for i in range(GYRO, N_BASE):
        out[i] = where(plain, error[i], out[i])
    if body > 0:
        dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
        _vector_error_in_filter_coordinates(nav, error, body, c_nb, jac, inverse, out)


@kernel
def _vector_error_in_filter_coordinates(nav, error, o, c_nb, jac, inverse, out):
    """`error_in_filter_coordinates` of a vector of the body, states o .. o + 2, whose axes are c_nb (3, 3)."""
    truth, big, y = small_matrix(nav, 3, 3), small_vector(nav, 3), small_vector(nav, 3)
    t0, t1, t2 = error[PHI_N], error[PHI_E], error[PHI_D]
    # C_true = exp(theta x) C = (I + [theta x] J_l) C
    for j in range(3):
        y[0] = c_nb[0, j]
        y[1] = c_nb[1, j]
        y[2] = c_nb[2, j]
        turned(jac, y, big)
        truth[0, j] = y[0] + t1 * big[2] - t2 * big[1]
        truth[1, j] = y[1] + t2 * big[0] - t0 * big[2]
        truth[2, j] = y[2] + t0 * big[1] - t1 * big[0]
    # theta in body axes
    b0 = c_nb[0, 0] * t0 + c_nb[1, 0] * t1 + c_nb[2, 0] * t2
    b1 = c_nb[0, 1] * t0 + c_nb[1, 1] * t1 + c_nb[2, 1] * t2
    b2 = c_nb[0, 2] * t0 + c_nb[1, 2] * t1 + c_nb[2, 2] * t2
    n = NAV_SENSORS - SENSORS + o
    for i in range(3):
        big[i] = 0.0
        for j in range(3):
            big[i] += truth[i, j] * (nav[n + j] + error[o + j]) - c_nb[i, j] * nav[n + j]
    turned(inverse, big, y)
    k0, k1, k2 = nav[n], nav[n + 1], nav[n + 2]
    out[o] = c_nb[0, 0] * y[0] + c_nb[1, 0] * y[1] + c_nb[2, 0] * y[2] + k1 * b2 - k2 * b1
    out[o + 1] = c_nb[0, 1] * y[0] + c_nb[1, 1] * y[1] + c_nb[2, 1] * y[2] + k2 * b0 - k0 * b2
    out[o + 2] = c_nb[0, 2] * y[0] + c_nb[1, 2] * y[1] + c_nb[2, 2] * y[2] + k0 * b1 - k1 * b0
