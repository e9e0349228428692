"""Coarse alignment of recorded sensors: from standstill, and from the velocity of fixes while moving.

While an aircraft moves, the integral of what its accelerometers feel, carried to the axes of the start, must be the
change of its velocity less gravity: one rotation turns all pieces of the one into the other. It needs no
assumption on side slip, and finds the heading from any horizontal acceleration.

Sources: [1] Wu & Pan, Velocity/position integration formula part I: application to in-flight coarse alignment, IEEE
Trans. AES 49 (2013). [2] Davenport's solution of Wahba's problem: Shuster & Oh, Three-axis attitude determination from
vector observations, J. Guidance and Control 4 (1981). [3] Groves (2013), section 5.6.2 (levelling).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.core import wgs84
from navsim.core.rotation import quaternion_from_dcm


@dataclass(frozen=True)
class Samples:
    """Inertial samples: time (n,) s, rate (n, 3) rad/s, force (n, 3) m/s2, body axes forward-right-down."""

    time: np.ndarray
    rate: np.ndarray
    force: np.ndarray

    def between(self, first: float, last: float) -> Samples:
        """The samples at first <= time <= last."""
        keep = (self.time >= first) & (self.time <= last)
        return Samples(self.time[keep], self.rate[keep], self.force[keep])


@dataclass(frozen=True)
class Fixes:
    """Fixes: time of validity (m,) s, llh (m, 3) rad, rad, m, velocity (m, 3) NED m/s, nan where unknown."""

    time: np.ndarray
    llh: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True)
class Standstill:
    """A time without motion: begin, end s; mean rate and specific force (3,), and 1 sigma of a sample (3,)."""

    begin: float
    end: float
    rate: np.ndarray
    force: np.ndarray
    rate_sigma: np.ndarray
    force_sigma: np.ndarray


@dataclass(frozen=True)
class Alignment:
    """Where the navigation starts: time s, quaternion (4,) b -> n, covariance (3, 3) of the attitude error in NED,
    rad2, gyro bias (3,) rad/s and its 1 sigma (3,), until when (s) data were looked at."""

    time: float
    quaternion: np.ndarray
    covariance: np.ndarray
    gyro_bias: np.ndarray
    gyro_sigma: np.ndarray
    until: float


WINDOW = 1.0
"""Length of the pieces judged for standstill, s."""
STILL_RATE, STILL_FORCE, STILL_SPEED = 0.05, 0.5, 0.5
"""Largest scatter (1 sigma) of rate, rad/s, and specific force, m/s2, and largest speed, m/s, of a standstill."""
SHORTEST, LONGEST = 3.0, 30.0
"""A standstill is used from the one length on, and up to the other, s: gyros warm up."""


def standstill(samples: Samples, fixes: Fixes, begin: float, end: float) -> Standstill | None:
    """The last `LONGEST` seconds of the first standstill of some length within begin .. end; None without one.

    Pieces of `WINDOW` seconds are still when their scatter is small and no fix in them moves.
    """
    edges = np.arange(begin, end, WINDOW)
    speed = np.linalg.norm(fixes.velocity[:, :2], axis=1)
    still = []
    for first in edges:
        piece = samples.between(first, first + WINDOW)
        inside = (fixes.time >= first) & (fixes.time <= first + WINDOW)
        moving = bool(np.any(speed[inside] > STILL_SPEED))
        quiet = (
            piece.time.size > 4
            and piece.rate.std(axis=0).max() < STILL_RATE
            and piece.force.std(axis=0).max() < STILL_FORCE
        )
        still.append(bool(quiet) and not moving)
    start = None
    for index, at_rest in enumerate([*still, False]):
        if at_rest and start is None:
            start = index
        if not at_rest and start is not None:
            first, last = edges[start], edges[index - 1] + WINDOW
            if last - first >= SHORTEST:
                first = max(first, last - LONGEST)
                piece = samples.between(first, last)
                return Standstill(
                    float(first), float(last), piece.rate.mean(axis=0), piece.force.mean(axis=0),
                    piece.rate.std(axis=0), piece.force.std(axis=0),
                )  # fmt: skip
            start = None
    return None


def levelled(force: np.ndarray, heading: float) -> np.ndarray:
    """C_nb (3, 3) of a body at rest from its mean specific force (3,), and a heading in rad [3]."""
    roll = np.arctan2(-force[1], -force[2])
    pitch = np.arctan2(force[0], np.hypot(force[1], force[2]))
    cr, sr, cp, sp, ch, sh = (f(a) for a in (roll, pitch, heading) for f in (np.cos, np.sin))
    return np.array(
        [
            [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
            [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
            [-sp, sr * cp, cr * cp],
        ]
    )


def velocity_matching(
    samples: Samples, fixes: Fixes, begin: float, gyro_bias: np.ndarray, gyro_sigma: float, accel_sigma: float,
    heading_sigma: float, longest: float,
) -> Alignment | None:  # fmt: skip
    """Attitude at `begin` from the velocities of the fixes after it, as soon as the heading is good to `heading_sigma`.

    gyro_bias: (3,) rad/s to take off, and its 1 sigma; accel_sigma: of the accelerometers' biases, m/s2; both widen the
    covariance. longest: s after which to give up: None.
    """
    fixes = Fixes(*(a[(fixes.time >= begin) & (fixes.time <= begin + longest)] for a in _fields(fixes)))
    usable = np.isfinite(fixes.velocity).all(axis=1)
    time, velocity, llh = fixes.time[usable], fixes.velocity[usable], fixes.llh[usable]
    if time.size < 4:
        return None
    piece = samples.between(begin - 1.0, time[-1] + 1.0)
    felt = _felt(piece, begin, time, gyro_bias)
    gained = _gained(time - begin, velocity, llh)
    for last in range(3, time.size):
        a, b = np.diff(felt[: last + 1], axis=0), np.diff(gained[: last + 1], axis=0)
        c = _wahba(a, b)
        residual = b - a @ c.T
        scatter = np.sum(residual**2) / max(3 * last - 3, 1)
        # every piece weighs its own length across the axis that is turned about
        information = np.einsum("ni,ij->ij", b**2, np.eye(3)) * 0.0 + np.sum(b**2) * np.eye(3) - b.T @ b
        spread = float(time[last] - begin)
        systematic = (gyro_sigma * 0.5 * spread) ** 2 + (accel_sigma / 9.8) ** 2
        try:
            covariance = 4.0 * scatter * np.linalg.inv(information) + systematic * np.eye(3)
        except np.linalg.LinAlgError:
            continue
        # an accelerometer's bias looks like acceleration: against the real horizontal one it turns the heading
        real = np.sum(b[:, :2] ** 2)
        fooled = np.sum((accel_sigma * np.diff(time[: last + 1])) ** 2) / real if real > 0.0 else np.inf
        covariance[2, 2] += fooled
        if np.sqrt(covariance[2, 2]) < heading_sigma:
            return Alignment(
                begin, quaternion_from_dcm(c), covariance, gyro_bias, np.full(3, gyro_sigma), float(time[last])
            )
    return None


def _fields(fixes: Fixes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return fixes.time, fixes.llh, fixes.velocity


def _felt(samples: Samples, begin: float, time: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Integral of specific force from `begin` to the times (m,), in the body axes of `begin` as they stay inertially."""
    from scipy.spatial.transform import Rotation

    grid = np.unique(np.concatenate([samples.time[samples.time > begin], [begin], time]))
    rate = np.stack([np.interp(grid, samples.time, samples.rate[:, i]) for i in range(3)], axis=1) - bias
    force = np.stack([np.interp(grid, samples.time, samples.force[:, i]) for i in range(3)], axis=1)
    step = np.diff(grid)[:, None]
    turns = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * step)
    attitude = [Rotation.identity()]
    for turn in turns:
        attitude.append(attitude[-1] * turn)
    still = Rotation.concatenate(attitude).apply(force)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (still[1:] + still[:-1]) * step, axis=0)])
    return total[np.searchsorted(grid, time)]


def _gained(since: np.ndarray, velocity: np.ndarray, llh: np.ndarray) -> np.ndarray:
    """The same integral from the fixes: velocity less gravity and the turning of the axes, in NED of time 0 [1]."""
    from scipy.spatial.transform import Rotation

    ecef = wgs84.ecef_from_llh(llh)
    gravity = -np.linalg.norm(wgs84.gravity_ecef(ecef), axis=1)
    lat, height = llh[:, 0], llh[:, 2]
    w = np.sqrt(1.0 - wgs84.E2 * np.sin(lat) ** 2)
    transverse = wgs84.A / w
    meridian = transverse * (1.0 - wgs84.E2) / w**2
    earth = wgs84.RATE * np.stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)], axis=1)
    east = velocity[:, 1] / (transverse + height)
    transport = np.stack([east, -velocity[:, 0] / (meridian + height), -east * np.tan(lat)], axis=1)
    step = np.diff(since)[:, None]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(step * 0.5 * ((earth + transport)[1:] + (earth + transport)[:-1]), 0)])
    axes = Rotation.from_rotvec(angle + since[:1, None] * earth[:1])
    drive = np.cross(earth, velocity)
    drive[:, 2] += gravity
    drive = axes.apply(drive)
    return axes.apply(velocity) + np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (drive[1:] + drive[:-1]) * step, axis=0)])


def _wahba(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) that best turns the vectors a (n, 3) into b (n, 3), least squares [2]."""
    u, _, vt = np.linalg.svd(b.T @ a)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
