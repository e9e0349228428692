"""`kind: eskf`: feedback by addition, attitude by rotation, with the exact covariance reset.

Sources: [1] `filter.md`. [2] Mueller, Hehn & D'Andrea, Covariance correction step for Kalman filtering with
an attitude, JGCD 40 (2017).
"""

from __future__ import annotations

import math

from navsim.core import states
from navsim.core.attitude import rotate_left
from navsim.core.covariance import reset
from navsim.core.earth import radii, short_way
from navsim.core.jit import kernel


@kernel
def move(nav, north, east, down):
    """Move the position of a navigation state by metres, in place."""
    meridian, transverse = radii(math.sin(nav[0]))
    nav[1] = short_way(nav[1] + east / ((transverse + nav[2]) * math.cos(nav[0])))
    nav[0] += north / (meridian + nav[2])
    nav[2] -= down


@kernel
def inject(nav, x):
    """Feed the estimated errors x (15,) back into the navigation state, in place."""
    move(nav, x[0], x[1], x[2])
    for i in range(3):
        nav[states.NAV_VEL + i] += x[states.VEL + i]
        nav[states.NAV_GYRO + i] += x[states.GYRO + i]
        nav[states.NAV_ACCEL + i] += x[states.ACCEL + i]
    rotate_left(nav[states.NAV_QUAT : states.NAV_QUAT + 4], x[6], x[7], x[8])


@kernel
def correct(nav, p, x, work):
    """Feed the estimated errors x (15,) back and carry P (240,) to the new estimate. work: (720,) space."""
    inject(nav, x)
    reset(
        p, x[states.ATT], x[states.ATT + 1], x[states.ATT + 2], work[:9].reshape(3, 3), work[9:54].reshape(states.N, 3)
    )
