"""`kind: left-invariant`: left-invariant filter on SE2(3) with additive biases and the exact reset.

Attitude, velocity and position form one group element, which the exponential map moves: u+ = u + J_l(theta) y_u for
position and velocity, with theta and y in the navigation frame. Sensor states are added.

Sources: [1] Barrau & Bonnabel, The invariant extended Kalman filter as a stable observer, IEEE TAC 62 (2017). [2]
`docs/theory/filter.md`, section 5.
"""

from __future__ import annotations

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import small_matrix, small_vector
from navsim.compiler.linear import copy, copy_matrix, identity, invert3
from navsim.filter.covariance import transport
from navsim.filter.eskf import move
from navsim.filter.states import (
    ATT,
    NAV_BIAS_FRAME,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_E,
    PHI_N,
    POS,
    SENSORS,
    VEL,
)
from navsim.geodesy.attitude_kernels import left_jacobian, left_jacobian_derivative, rotate_in_nav_axes


@kernel
def turned(jac, u, out):
    """out = jac u for 3-vectors; out may not be u."""
    for i in range(3):
        out[i] = jac[i, 0] * u[0] + jac[i, 1] * u[1] + jac[i, 2] * u[2]


@kernel
def blocks_of_motion(x, diagonal, column, straight):
    """Blocks of the reset matrix for position, velocity and attitude, common to both group filters.

    x: (n,) the estimate. diagonal, column: (5, 3, 3) out. Blocks of sensor states are the identity; those of
    position and velocity are not written as far as the chart is `straight` (`error_parametrisation`).
    """
    a, b, c = x[PHI_N], x[PHI_E], x[PHI_D]
    for block in range(straight, diagonal.shape[0]):
        identity(diagonal[block])
        for i in range(3):
            for j in range(3):
                column[block, i, j] = 0.0
    left_jacobian(a, b, c, diagonal[2])
    if straight < 1:
        copy_matrix(diagonal[2], diagonal[0])
        left_jacobian_derivative(a, b, c, x[POS:VEL], column[0])
    if straight < 2:
        copy_matrix(diagonal[2], diagonal[1])
        left_jacobian_derivative(a, b, c, x[VEL:ATT], column[1])


@kernel
def move_rigidly(nav, x, jac, straight):
    """Move position and velocity by J_l(theta) y, `straight` ones by y, and turn the attitude by theta, in place."""
    u = small_vector(nav, 3)
    copy(x[POS:VEL], u)
    if straight < 1:
        turned(jac, x[POS:VEL], u)
    move(nav, u[0], u[1], u[2])
    copy(x[VEL:ATT], u)
    if straight < 2:
        turned(jac, x[VEL:ATT], u)
    for i in range(3):
        nav[NAV_VEL + i] += u[i]
    rotate_in_nav_axes(nav[NAV_QUAT:NAV_BIAS_FRAME], x[PHI_N], x[PHI_E], x[PHI_D])


@kernel
def correct(nav, p, x, space):
    """Apply the estimated errors x (n,) and transform P (n, n) to the new estimate. space:
    `filter_loop.PropagationBuffers`."""
    feed_back(nav, x, space)
    transport(p, space.diagonal, space.column, space.straight, space.turned)


@kernel
def feed_back(nav, x, space):
    """Feed the estimated errors x (n,) back, in place; diagonal, column (5, 3, 3) of `space`: the reset matrix, as
    `filter.covariance.transport` takes it."""
    n = x.shape[0]
    diagonal, column = space.diagonal, space.column
    blocks_of_motion(x, diagonal, column, space.straight)
    move_rigidly(nav, x, diagonal[2], space.straight)
    for c in range(n - SENSORS):
        nav[NAV_SENSORS + c] += x[SENSORS + c]


@kernel
def error_in_filter_coordinates(error, out, straight):
    """The error in the filter's own coordinates, expressed as the plain error of the same tangent: (n,)."""
    jac, inverse = small_matrix(error, 3, 3), small_matrix(error, 3, 3)
    left_jacobian(error[PHI_N], error[PHI_E], error[PHI_D], jac)
    invert3(jac, inverse)
    copy(error, out)
    if straight < 1:
        turned(inverse, error[POS:VEL], out[POS:VEL])
    if straight < 2:
        turned(inverse, error[VEL:ATT], out[VEL:ATT])
