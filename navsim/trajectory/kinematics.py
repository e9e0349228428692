"""Kinematics of a path over the Earth: inputs of the inertial sensors by analytic differentiation.

The path is given in the tangent plane of the touchdown point, so position, velocity, acceleration and jerk are exact in
ECEF. Flight is coordinated (no side force) with a constant angle of attack, and the longitudinal plane contains the
velocity relative to the air. This determines the attitude. An aircraft that hovers keeps its attitude instead.

Sources: [1] Groves (2013), eqs. 2.147-2.149 (specific force in rotating axes), 5.3 (ECEF). [2] Etkin, Dynamics of
Atmospheric Flight (1972), section 4.2 (wind axes).
"""

from __future__ import annotations

import functools
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from navsim.geodesy import earth
from navsim.geodesy.attitude import quaternion_from_dcm, roll_pitch_yaw
from navsim.trajectory.path import AnyPath

EARTH_RATE = np.array([0.0, 0.0, earth.RATE])
_GRADIENT_STEP = 100.0
"""Baseline of the central difference of gravity along the path, m: exact to 1e-15 m/s2 per metre."""


@dataclass(frozen=True)
class Frame:
    """The tangent plane of the touchdown point: origin ECEF (3,), axes (3, 3) with v_ecef = axes @ v_path."""

    origin: np.ndarray
    axes: np.ndarray


def tangent_frame(llh: np.ndarray, heading: float) -> Frame:
    """Frame at a geodetic point (rad, rad, m), x towards `heading` (rad, clockwise from north), z down."""
    return Frame(earth.ecef_from_llh(np.asarray(llh)), earth.heading_axes(np.asarray(llh), heading))


@dataclass(frozen=True)
class Motion:
    """Motion of the vehicle at given times; SI units, rad."""

    time: np.ndarray
    """(n,)."""
    position_ecef: np.ndarray
    """(n, 3)."""
    velocity_ecef: np.ndarray
    """(n, 3)."""
    llh: np.ndarray
    """(n, 3)."""
    c_eb: np.ndarray
    """(n, 3, 3) body axes in ECEF."""
    specific_force: np.ndarray
    """(n, 3) body axes."""
    angular_rate: np.ndarray
    """(n, 3) relative to inertial space, body axes."""

    @cached_property
    def c_ne(self) -> np.ndarray:
        """ECEF axes in NED (n, 3, 3)."""
        return earth.ned_matrix(self.llh)

    @cached_property
    def velocity_ned(self) -> np.ndarray:
        """Velocity (n, 3)."""
        return np.einsum("nij,nj->ni", self.c_ne, self.velocity_ecef)

    @cached_property
    def c_nb(self) -> np.ndarray:
        """Body axes in NED (n, 3, 3)."""
        return self.c_ne @ self.c_eb

    @cached_property
    def quaternion(self) -> np.ndarray:
        """Attitude b -> n, scalar first (n, 4)."""
        return quaternion_from_dcm(self.c_nb)

    @property
    def rpy(self) -> np.ndarray:
        """Roll, pitch, yaw (n, 3), rad."""
        return roll_pitch_yaw(self.c_nb)


class Moving(Protocol):
    """Any motion that can be flown: `Trajectory`, or a recorded one."""

    @property
    def frame(self) -> Frame:
        """Axes of the path."""

    @property
    def path(self) -> Any:
        """`events`: times by name; `jet(t)`: position and its derivatives in the frame; `knots`."""

    def motion(self, t: np.ndarray) -> Motion:
        """Everything at the times t (n,), s."""

    def llh(self, t: np.ndarray) -> np.ndarray:
        """Places at the times t (n,), s: (n, 3) rad, rad, m."""

    def increments(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `integrate`."""


def faded(t: np.ndarray, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Smooth transition from 1 at one time to 0 at another, s, at times t (n,), and its rate, 1/s."""
    length = end - begin
    u = np.clip((t - begin) / length, 0.0, 1.0)
    return 1.0 - u**3 * (10.0 + u * (6.0 * u - 15.0)), -30.0 * u**2 * (1.0 - u) ** 2 / length


class WindField(Protocol):
    """A wind along a path, as of `Wind`."""

    @property
    def knots(self) -> np.ndarray:
        """Times where a higher derivative jumps."""

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The wind the attitude answers to, and its rate of change: (n, 3) m/s, m/s2."""

    def mean(self, t: np.ndarray) -> np.ndarray:
        """Mean wind (n, 3), m/s, independent of the attitude."""


@dataclass(frozen=True)
class Wind:
    """Steady wind in path axes (3,), m/s, towards.

    The aircraft flies with a crab angle until `decrab_start`, and removes it smoothly until `decrab_end` (s); None
    keeps it.
    """

    velocity: np.ndarray
    decrab_start: float | None = None
    decrab_end: float | None = None

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The wind the attitude answers to, and its rate of change: (n, 3) m/s, m/s2."""
        if self.decrab_start is None or self.decrab_end is None:
            return np.tile(self.velocity, (t.size, 1)), np.zeros((t.size, 3))
        keep, rate = faded(t, self.decrab_start, self.decrab_end)
        return keep[:, None] * self.velocity, rate[:, None] * self.velocity

    def mean(self, t: np.ndarray) -> np.ndarray:
        """Wind (n, 3), m/s, independent of the attitude."""
        return np.tile(self.velocity, (t.size, 1))

    @property
    def knots(self) -> np.ndarray:
        """Times where a higher derivative jumps."""
        ends = (self.decrab_start, self.decrab_end)
        return np.array([t for t in ends if t is not None])


@dataclass(frozen=True)
class Trajectory:
    """A path placed on the Earth, with the attitude of an aircraft flying along it."""

    path: AnyPath
    frame: Frame
    wind: WindField
    angle_of_attack: float
    pitch_follows_path: bool = True
    """False: the nose is `angle_of_attack` above the horizon on any slope."""
    grounded: float = np.inf
    """Time, s, from which the path is up the runway, where the nose stays, however slow the aircraft."""
    runway_slope: float = 0.0
    """Rise of the runway along the frame's x axis, m a m."""
    body: np.ndarray | None = None
    """(3, 3) body axes in those of the frame, of an aircraft that keeps them on any path and at rest; None: flight is
    coordinated."""

    def motion(self, t: np.ndarray) -> Motion:
        """Everything at the times t (n,), s."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        to_ecef = self.frame.axes.T
        jet = self.path.jet(t) @ to_ecef
        position = self.frame.origin + jet[:, 0]
        velocity, acceleration, jerk = jet[:, 1], jet[:, 2], jet[:, 3]
        llh = earth.llh_from_ecef(position)
        force = acceleration + 2.0 * np.cross(EARTH_RATE, velocity) - earth.gravity_at(llh)
        if self.body is not None:
            c_eb = np.tile(self.frame.axes @ self.body, (t.size, 1, 1))
            return assembled(t, (position, llh), velocity, force, c_eb, np.zeros((t.size, 3)))

        rolls = (t >= self.grounded)[:, None]
        # at rest there is no direction of motion; from here on it is known
        course = np.where(rolls, self.frame.axes[:, 0] - self.runway_slope * self.frame.axes[:, 2], velocity)
        course_rate = np.where(rolls, 0.0, acceleration)
        direction = course / np.linalg.norm(course, axis=1, keepdims=True)
        step = 0.5 * _GRADIENT_STEP * direction
        slope = (earth.gravity_ecef(position + step) - earth.gravity_ecef(position - step)) / _GRADIENT_STEP
        gravity_rate = slope * np.linalg.norm(velocity, axis=1, keepdims=True)
        force_rate = jerk + 2.0 * np.cross(EARTH_RATE, acceleration) - gravity_rate

        wind, wind_rate = self.wind.at(t)
        air, air_rate = course - wind @ to_ecef, course_rate - wind_rate @ to_ecef
        if not self.pitch_follows_path:
            vertical = self.frame.axes[:, 2]
            air, air_rate = (
                air - (air @ vertical)[:, None] * vertical,
                air_rate - (air_rate @ vertical)[:, None] * vertical,
            )
        ahead, ahead_rate = _unit(air, air_rate)
        # lift: component of the specific force normal to the velocity through the air [2]
        share = _dot(force, ahead)
        share_rate = _dot(force_rate, ahead) + _dot(force, ahead_rate)
        down, down_rate = _unit(share * ahead - force, share_rate * ahead + share * ahead_rate - force_rate)
        right, right_rate = np.cross(down, ahead), np.cross(down_rate, ahead) + np.cross(down, ahead_rate)
        c, s = np.cos(self.angle_of_attack), np.sin(self.angle_of_attack)
        c_eb = np.stack([c * ahead - s * down, right, s * ahead + c * down], axis=-1)
        x_rate, z_rate = c * ahead_rate - s * down_rate, s * ahead_rate + c * down_rate
        rate = np.stack(
            [
                np.sum(right_rate * c_eb[:, :, 2], axis=1),
                np.sum(z_rate * c_eb[:, :, 0], axis=1),
                np.sum(x_rate * c_eb[:, :, 1], axis=1),
            ],
            axis=1,
        )
        return assembled(t, (position, llh), velocity, force, c_eb, rate)

    def llh(self, t: np.ndarray) -> np.ndarray:
        """Places at the times t (n,), s: (n, 3) rad, rad, m."""
        return self.motion(t).llh

    def increments(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `integrate`. Read-only: studies vary settings more often than the trajectory, so the last are kept."""
        return _increments(pickle.dumps((self, t)))


@functools.lru_cache(maxsize=2)
def _increments(pickled: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Increments of a trajectory and times, by their content."""
    trajectory, t = pickle.loads(pickled)
    sums = integrate(trajectory.motion, np.concatenate([trajectory.path.knots, trajectory.wind.knots]), t)
    for each in sums:
        each.flags.writeable = False
    return sums


def assembled(
    t: np.ndarray,
    position: tuple[np.ndarray, np.ndarray],
    velocity: np.ndarray,
    force: np.ndarray,
    c_eb: np.ndarray,
    rate: np.ndarray,
) -> Motion:
    """Motion from its quantities in ECEF and body axes.

    position (and the same as llh), velocity, specific force (n, 3), attitude C_eb (n, 3, 3), and the angular rate
    relative to the Earth in body axes (n, 3).
    """
    return Motion(
        time=t,
        position_ecef=position[0],
        velocity_ecef=velocity,
        llh=position[1],
        c_eb=c_eb,
        specific_force=np.einsum("nji,nj->ni", c_eb, force),
        angular_rate=rate + np.einsum("nji,j->ni", c_eb, EARTH_RATE),
    )


def integrate(
    motion: Callable[[np.ndarray], Motion], knots: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of angular rate and specific force (body axes) between the times t (n + 1,).

    Gauss-Legendre quadrature with four nodes on every interval, cut at the knots, where the motion changes segment:
    exact to rounding for paths of polynomials. Returns dtheta (n, 3) rad, dv (n, 3) m/s.
    """
    t = np.asarray(t, dtype=float)
    cuts = np.sort(np.concatenate([t, knots[(knots > t[0]) & (knots < t[-1])]]))
    # a cut at a sample time, or within rounding of one, would make an empty interval
    cuts = cuts[np.concatenate([[True], np.diff(cuts) > 1e-12])]
    half = 0.5 * np.diff(cuts)
    points, shares = np.polynomial.legendre.leggauss(4)
    nodes = (0.5 * (cuts[:-1] + cuts[1:]))[:, None] + half[:, None] * points
    moving = motion(nodes.ravel())
    weights = half[:, None] * shares
    owner = np.searchsorted(t, 0.5 * (cuts[:-1] + cuts[1:])) - 1
    sums = []
    for values in (moving.angular_rate, moving.specific_force):
        pieces = np.einsum("kg,kgi->ki", weights, values.reshape(half.size, -1, 3))
        total = np.zeros((t.size - 1, 3))
        np.add.at(total, owner, pieces)
        sums.append(total)
    return sums[0], sums[1]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=1, keepdims=True)


def _unit(v: np.ndarray, v_rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """v / |v| and its time derivative."""
    size = np.linalg.norm(v, axis=1, keepdims=True)
    u = v / size
    return u, (v_rate - _dot(u, v_rate) * u) / size


def touchdown_from_start(start: tuple[float, float], height: float, heading: float, begin: np.ndarray) -> Frame:
    """The touchdown frame from which a path that begins at `begin` starts over the given point.

    start: latitude, longitude, rad. height: of the touchdown point, m. heading: rad. begin: (3,) first point
    of the path in its own axes, m. Newton's iteration on a nearly linear map, exact to rounding.
    """
    touchdown = np.array([start[0], start[1], height])
    for _ in range(10):
        frame = tangent_frame(touchdown, heading)
        reached = earth.llh_from_ecef(frame.origin + frame.axes @ begin)
        miss = np.array(start) - reached[:2]
        touchdown[:2] += miss
        if np.max(np.abs(miss)) < 1e-15:
            break
    return tangent_frame(touchdown, heading)


def touchdown_from_threshold(
    threshold: tuple[float, float], height: float, heading: float, aim_point: float, rise: float = 0.0
) -> Frame:
    """The touchdown frame `aim_point` metres beyond a threshold (latitude, longitude, rad), `rise` metres above it."""
    runway = tangent_frame(np.array([threshold[0], threshold[1], height]), heading)
    llh = earth.llh_from_ecef(runway.origin + aim_point * runway.axes[:, 0])
    return tangent_frame(np.array([llh[0], llh[1], height + rise]), heading)
