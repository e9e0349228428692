"""Rotations on whole numpy arrays; `geodesy.attitude_kernels` has the kernels and the conventions.

Sources: [1] Titterton & Weston, Strapdown Inertial Navigation Technology, 2nd ed. (2004), section 3.6. [2]
Markley, Attitude determination using vector observations and the singular value decomposition, J. Astronautical
Sciences 36 (1988).
"""

from __future__ import annotations

import numpy as np


def quaternion_from_dcm(c: np.ndarray) -> np.ndarray:
    """C_nb (..., 3, 3) -> quaternion (..., 4), scalar first and not negative."""
    # all four candidate rows of Shepperd's method; the one with the largest pivot is well conditioned
    t = np.trace(c, axis1=-2, axis2=-1)
    c00, c11, c22 = c[..., 0, 0], c[..., 1, 1], c[..., 2, 2]
    pivots = np.stack([t, c00, c11, c22], axis=-1)
    wx, wy, wz = c[..., 2, 1] - c[..., 1, 2], c[..., 0, 2] - c[..., 2, 0], c[..., 1, 0] - c[..., 0, 1]
    xy, xz, yz = c[..., 0, 1] + c[..., 1, 0], c[..., 0, 2] + c[..., 2, 0], c[..., 1, 2] + c[..., 2, 1]
    candidates = np.stack(
        [
            np.stack([1 + t, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + 2 * c00 - t, xy, xz], axis=-1),
            np.stack([wy, xy, 1 + 2 * c11 - t, yz], axis=-1),
            np.stack([wz, xz, yz, 1 + 2 * c22 - t], axis=-1),
        ],
        axis=-2,
    )
    q = np.take_along_axis(candidates, np.argmax(pivots, axis=-1)[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def dcm_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Quaternion (..., 4), scalar first, of unit length -> C_nb (..., 3, 3) [1]."""
    a, b, c, d = np.moveaxis(q, -1, 0)
    rows = [
        [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
        [2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b)],
        [2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


@np.errstate(over="ignore", invalid="ignore")
def dcm_from_rotation_vector(theta: np.ndarray) -> np.ndarray:
    """exp(theta x) of rotation vectors (..., 3), rad -> (..., 3, 3) [1], nan if not finite; bits as of scipy's
    `Rotation`."""
    size = np.sqrt(theta[..., 0] ** 2 + theta[..., 1] ** 2 + theta[..., 2] ** 2)
    square = size**2
    small = size <= 1e-3
    half = np.where(small, 0.5 - square / 48 + square**2 / 3840, np.sin(size / 2) / np.where(small, 1.0, size))
    x, y, z = np.moveaxis(half[..., None] * theta, -1, 0)
    w = np.cos(size / 2)
    rows = [
        [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def dcm_from_rpy(rpy: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (..., 3), rad, of the yaw-pitch-roll sequence -> C_nb (..., 3, 3) [1]."""
    cr, cp, cy = np.moveaxis(np.cos(rpy), -1, 0)
    sr, sp, sy = np.moveaxis(np.sin(rpy), -1, 0)
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def roll_pitch_yaw(c: np.ndarray) -> np.ndarray:
    """C_nb (..., 3, 3) -> roll, pitch, yaw (..., 3), rad; the yaw-pitch-roll (z, y, x) sequence [1]."""
    return np.stack(
        [
            np.arctan2(c[..., 2, 1], c[..., 2, 2]),
            -np.arcsin(np.clip(c[..., 2, 0], -1.0, 1.0)),
            np.arctan2(c[..., 1, 0], c[..., 0, 0]),
        ],
        axis=-1,
    )


def rpy_jacobian(rpy: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) that turn a small rotation vector given in NED into increments of roll, pitch, yaw.

    rpy: (..., 3) rad. The inverse of the axes of the three rotations in NED [1]; undefined where the nose points
    straight up or down.
    """
    pitch, yaw = rpy[..., 1], rpy[..., 2]
    c, s, nothing = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)
    secant, tangent = 1.0 / np.cos(pitch), np.tan(pitch)
    rows = [[c * secant, s * secant, nothing], [-s, c, nothing], [c * tangent, s * tangent, nothing + 1.0]]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def rpy_error(rpy: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Errors of roll, pitch, yaw (..., 3), true minus estimated, in (-pi, pi].

    rpy: (..., 3) true angles. theta: (..., 3) attitude error, the rotation vector in NED with
    C_nb(true) = exp(theta x) C_nb(estimate). All rad; exact for errors of any size.
    """
    estimate = roll_pitch_yaw(dcm_from_rotation_vector(-theta) @ dcm_from_rpy(rpy))
    return np.pi - (np.pi - (rpy - estimate)) % (2.0 * np.pi)


def wahba(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotations (..., 3, 3) that best turn vectors a (..., n, 3) into b (..., n, 3), least squares [2]."""
    u, _, vt = np.linalg.svd(np.swapaxes(b, -1, -2) @ a)
    u[..., :, 2] *= (np.linalg.det(u) * np.linalg.det(vt))[..., None]
    return u @ vt
