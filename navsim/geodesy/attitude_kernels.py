"""Rotations: quaternions (scalar first, b -> n), direction cosine matrices, rotation vectors.

Quaternion algebra is Hamilton's: q(b -> n) rotates body components into NED, C_nb = C(q), and products
compose as C(p q) = C(p) C(q).
Sources: [1] Titterton & Weston, Strapdown Inertial Navigation Technology, 2nd ed. (2004), sections 3.6, 11.2.
[2] Barfoot, State Estimation for Robotics (2017), section 7.1 (left Jacobian of SO(3)).
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import atan2, sincos
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import any_lane, no, where

_SMALL = 1e-2
"""Below this square of an angle (rad2) series replace the closed forms; their error is below 1e-17."""


@kernel
def half_sinc(t2):
    """sin(t/2)/t and cos(t/2) of an angle t given by its square: the parts of a rotation quaternion."""
    small = t2 < _SMALL
    s = 0.5 + t2 * (-1.0 / 48.0 + t2 * (1.0 / 3840.0 + t2 * (-1.0 / 645120.0 + t2 * (1.0 / 185794560.0))))
    c = 1.0 + t2 * (-1.0 / 8.0 + t2 * (1.0 / 384.0 + t2 * (-1.0 / 46080.0 + t2 * (1.0 / 10321920.0))))
    if any_lane(no(small)):
        t = math.sqrt(t2)
        sine, cosine = sincos(0.5 * t)
        s = where(small, s, sine / t)
        c = where(small, c, cosine)
    return s, c


@kernel
def rotate_in_nav_axes(q, x, y, z):
    """q <- exp((x, y, z)) q: turn the attitude by a rotation vector given in the outer (n) axes [1]."""
    s, a = half_sinc(x * x + y * y + z * z)
    b = s * x
    c = s * y
    d = s * z
    q0, q1, q2, q3 = q[0], q[1], q[2], q[3]
    q[0] = a * q0 - b * q1 - c * q2 - d * q3
    q[1] = a * q1 + b * q0 + c * q3 - d * q2
    q[2] = a * q2 - b * q3 + c * q0 + d * q1
    q[3] = a * q3 + b * q2 - c * q1 + d * q0


@kernel
def rotate_in_body_axes(q, x, y, z):
    """q <- q exp((x, y, z)): turn the attitude by a rotation vector given in body axes [1]."""
    s, a = half_sinc(x * x + y * y + z * z)
    b = s * x
    c = s * y
    d = s * z
    q0, q1, q2, q3 = q[0], q[1], q[2], q[3]
    q[0] = q0 * a - q1 * b - q2 * c - q3 * d
    q[1] = q0 * b + q1 * a + q2 * d - q3 * c
    q[2] = q0 * c - q1 * d + q2 * a + q3 * b
    q[3] = q0 * d + q1 * c - q2 * b + q3 * a


@kernel
def normalise(q):
    """Scale a nearly unit quaternion back to unit length (one Newton step, exact to rounding)."""
    n = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    q[0] *= n
    q[1] *= n
    q[2] *= n
    q[3] *= n


@kernel
def dcm(q, out):
    """C_nb (3, 3) of the quaternion q, into `out` [1]."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    out[0, 0] = a * a + b * b - c * c - d * d
    out[0, 1] = 2.0 * (b * c - a * d)
    out[0, 2] = 2.0 * (b * d + a * c)
    out[1, 0] = 2.0 * (b * c + a * d)
    out[1, 1] = a * a - b * b + c * c - d * d
    out[1, 2] = 2.0 * (c * d - a * b)
    out[2, 0] = 2.0 * (b * d - a * c)
    out[2, 1] = 2.0 * (c * d + a * b)
    out[2, 2] = a * a - b * b - c * c + d * d


@kernel
def difference(p, q, out):
    """Rotation vector theta (rad, |theta| <= pi) with C(p) = exp(theta x) C(q), into out[0:3]."""
    # p times the conjugate of q
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    x = -p[0] * q[1] + p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    y = -p[0] * q[2] + p[1] * q[3] + p[2] * q[0] - p[3] * q[1]
    z = -p[0] * q[3] - p[1] * q[2] + p[2] * q[1] + p[3] * q[0]
    sign = where(w < 0.0, -1.0, 1.0)
    s = math.sqrt(x * x + y * y + z * z)
    k = sign * where(s > 1e-12, 2.0 * atan2(s, sign * w) / s, 2.0)
    out[0] = k * x
    out[1] = k * y
    out[2] = k * z


@kernel
def _shares(t2):
    """(1 - cos t)/t^2 and (t - sin t)/t^3 of an angle t given by its square."""
    small = t2 < _SMALL
    p = 0.5 + t2 * (-1.0 / 24.0 + t2 * (1.0 / 720.0 + t2 * (-1.0 / 40320.0 + t2 * (1.0 / 3628800.0))))
    q = 1.0 / 6.0 + t2 * (-1.0 / 120.0 + t2 * (1.0 / 5040.0 + t2 * (-1.0 / 362880.0 + t2 * (1.0 / 39916800.0))))
    if any_lane(no(small)):
        t = math.sqrt(t2)
        s, c = sincos(t)
        p = where(small, p, (1.0 - c) / t2)
        q = where(small, q, (t - s) / (t2 * t))
    return p, q


@kernel
def left_jacobian_derivative(x, y, z, u, out):
    """out (3, 3) = d(J_l(theta) u) / d(theta) at theta = (x, y, z), for constant u.

    It is the derivative of J_l u = u + p theta x u + q theta x (theta x u), p and q functions of the angle.

        -p [u x] + (theta x u) theta' p'/t + q ((theta.u) I + theta u' - 2 u theta') + theta x (theta x u) theta' q'/t
    """
    t2 = x * x + y * y + z * z
    small = t2 < _SMALL
    p, q = _shares(t2)
    dp = -1.0 / 12.0 + t2 * (1.0 / 180.0 + t2 * (-1.0 / 6720.0 + t2 * (1.0 / 453600.0)))
    dq = -1.0 / 60.0 + t2 * (1.0 / 1260.0 + t2 * (-1.0 / 60480.0 + t2 * (1.0 / 4989600.0)))
    if any_lane(no(small)):
        t = math.sqrt(t2)
        s, c = sincos(t)
        v = 1.0 - c
        dp = where(small, dp, (t * s - 2.0 * v) / (t2 * t2))
        dq = where(small, dq, (t * v - 3.0 * (t - s)) / (t2 * t2 * t))
    u0, u1, u2 = u[0], u[1], u[2]
    c0, c1, c2 = y * u2 - z * u1, z * u0 - x * u2, x * u1 - y * u0
    dot = x * u0 + y * u1 + z * u2
    # coefficient vector of theta' (outer product from the right)
    a0 = dp * c0 + dq * (x * dot - t2 * u0) - 2.0 * q * u0
    a1 = dp * c1 + dq * (y * dot - t2 * u1) - 2.0 * q * u1
    a2 = dp * c2 + dq * (z * dot - t2 * u2) - 2.0 * q * u2
    out[0, 0] = a0 * x + q * (dot + x * u0)
    out[0, 1] = a0 * y + q * x * u1 + p * u2
    out[0, 2] = a0 * z + q * x * u2 - p * u1
    out[1, 0] = a1 * x + q * y * u0 - p * u2
    out[1, 1] = a1 * y + q * (dot + y * u1)
    out[1, 2] = a1 * z + q * y * u2 + p * u0
    out[2, 0] = a2 * x + q * z * u0 + p * u1
    out[2, 1] = a2 * y + q * z * u1 - p * u0
    out[2, 2] = a2 * z + q * (dot + z * u2)


@kernel
def left_jacobian(x, y, z, out):
    """Left Jacobian of SO(3) at the rotation vector (x, y, z), into `out` (3, 3) [2].

    J = I + (1 - cos t)/t^2 [theta x] + (t - sin t)/t^3 [theta x]^2
    """
    t2 = x * x + y * y + z * z
    p, r = _shares(t2)
    out[0, 0] = 1.0 - r * (y * y + z * z)
    out[0, 1] = r * x * y - p * z
    out[0, 2] = r * x * z + p * y
    out[1, 0] = r * x * y + p * z
    out[1, 1] = 1.0 - r * (x * x + z * z)
    out[1, 2] = r * y * z - p * x
    out[2, 0] = r * x * z - p * y
    out[2, 1] = r * y * z + p * x
    out[2, 2] = 1.0 - r * (x * x + y * y)
