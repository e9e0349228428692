"""`kind: left-invariant`: the left-invariant filter on SE2(3), biases beside it, with the exact reset.

Attitude, velocity and position form one group element; the estimate moves by its exponential,
u+ = u + J_l(theta) y_u for position and velocity (theta and y in the navigation frame), biases by addition.
Sources: [1] Barrau & Bonnabel, The invariant extended Kalman filter as a stable observer, IEEE TAC 62 (2017).
[2] `filter.md`.
"""

from __future__ import annotations

import numpy as np

from navsim.core import states
from navsim.core.attitude import left_jacobian, left_jacobian_derivative, rotate_left
from navsim.core.covariance import SIZE, STRIDE, transport
from navsim.core.jit import kernel
from navsim.core.linear import invert3
from navsim.estimation.error_state import move


@kernel
def turned(jac, u, out):
    """out = jac u for 3-vectors; out may not be u."""
    for i in range(3):
        out[i] = jac[i, 0] * u[0] + jac[i, 1] * u[1] + jac[i, 2] * u[2]


@kernel
def blocks_of_motion(x, diagonal, column):
    """The parts of the reset matrix that position, velocity and attitude have in both group filters.

    x: (15,) the estimate. diagonal, column: (5, 3, 3) out, bias blocks untouched but for zeroed columns.
    """
    a, b, c = x[states.ATT], x[states.ATT + 1], x[states.ATT + 2]
    column[:] = 0.0
    for block in range(3):
        left_jacobian(a, b, c, diagonal[block])
    left_jacobian_derivative(a, b, c, x[0:3], column[0])
    left_jacobian_derivative(a, b, c, x[3:6], column[1])


@kernel
def move_rigidly(nav, x, jac):
    """Move position and velocity by J_l(theta) y and turn the attitude by theta, in place."""
    u = np.empty(3)
    turned(jac, x[0:3], u)
    move(nav, u[0], u[1], u[2])
    turned(jac, x[3:6], u)
    for i in range(3):
        nav[states.NAV_VEL + i] += u[i]
    rotate_left(nav[states.NAV_QUAT : states.NAV_QUAT + 4], x[states.ATT], x[states.ATT + 1], x[states.ATT + 2])


@kernel
def correct(nav, p, x, work):
    """Feed the estimated errors x (15,) back and carry P (240,) to the new estimate. work: (720,) space."""
    diagonal = work[480:525].reshape(5, 3, 3)
    column = work[525:570].reshape(5, 3, 3)
    blocks_of_motion(x, diagonal, column)
    for block in range(3, 5):
        for i in range(3):
            for j in range(3):
                diagonal[block, i, j] = 1.0 if i == j else 0.0
    move_rigidly(nav, x, diagonal[0])
    for i in range(3):
        nav[states.NAV_GYRO + i] += x[states.GYRO + i]
        nav[states.NAV_ACCEL + i] += x[states.ACCEL + i]
    transport(p, diagonal, column, work[:SIZE], work[SIZE : 2 * SIZE], STRIDE)


@kernel
def own_error(error, out):
    """The error in the filter's own coordinates, expressed as the plain error of the same tangent: (15,)."""
    jac = np.empty((3, 3))
    inverse = np.empty((3, 3))
    left_jacobian(error[states.ATT], error[states.ATT + 1], error[states.ATT + 2], jac)
    invert3(jac, inverse)
    turned(inverse, error[0:3], out[0:3])
    turned(inverse, error[3:6], out[3:6])
    for i in range(states.ATT, states.N):
        out[i] = error[i]
