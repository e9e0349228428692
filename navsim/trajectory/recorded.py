"""A recorded trajectory to fly again: smooth curves through recorded positions and attitudes.

Positions from a table become a smoothing spline of degree five, weighted by their sigma [1, 4]. It is as close to the
positions as their sigma, with small jumps of the fifth derivative, and so has four continuous derivatives.

Positions from a filter are fitted by a quintic spline with a knot each half second. The least-squares fit smooths the
filter's steps at its fixes. Attitudes are fitted by a spline with continuous rates through samples a quarter of a
second apart. Rates and specific force follow from these curves exactly; `rms_residual` is their distance from the
recording.

Sources:

- [1] de Boor, A Practical Guide to Splines (2001), chapter XIV.
- [2] scipy's RotationSpline (rates in body axes).
- [3] Groves (2013), eqs. 2.147-2.149.
- [4] Dierckx, Curve and Surface Fitting with Splines (1993), chapter 5, implemented in scipy's splprep.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from navsim.geodesy import earth
from navsim.trajectory.kinematics import EARTH_RATE, Frame, Motion, Moving, assembled, integrate

_POSITION_KNOTS, _ATTITUDE_STEP = 0.5, 0.25
_DEGREE = 5
_FEWEST = 8
_LOOK = 0.01
"""Step in which the largest of a motion is sought, s."""
_AT_ONCE = 50_000
"""Moments of a motion that are looked at together: of a flight of hours, all would take gigabytes."""


@dataclass(frozen=True)
class RecordedPath:
    """Positions in the axes of a frame, as `trajectory.path.Path` gives them; events by name, s."""

    spline: Any
    frame: Frame
    knots: np.ndarray
    events: dict[str, float]
    rms_residual: float
    """rms distance of the curve from the recorded positions, m"""

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration, jerk at times t (n,): (n, 4, 3) m, m/s, ... in the frame's axes."""
        derivatives = np.stack([self.spline(t, order) for order in range(4)], axis=1)
        derivatives[:, 0] -= self.frame.origin
        return derivatives @ self.frame.axes


@dataclass(frozen=True)
class RecordedTrajectory:
    """A recorded flight, to be used like `kinematics.Trajectory`."""

    path: RecordedPath
    frame: Frame
    attitude: Any

    def motion(self, t: np.ndarray) -> Motion:
        """Everything at the times t (n,), s."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        position, velocity, acceleration = (self.path.spline(t, order) for order in range(3))
        c_eb = self.attitude(t).as_matrix()
        llh = earth.llh_from_ecef(position)
        force = acceleration + 2.0 * np.cross(EARTH_RATE, velocity) - earth.gravity_at(llh)
        return assembled(t, (position, llh), velocity, force, c_eb, self.attitude(t, 1))

    def llh(self, t: np.ndarray) -> np.ndarray:
        """Places at the times t (n,), s: (n, 3) rad, rad, m."""
        return self.motion(t).llh

    def increments(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrals of angular rate and specific force between the times t (n + 1,): (n, 3) rad, m/s."""
        return integrate(self.motion, self._knots, t)

    @cached_property
    def _knots(self) -> np.ndarray:
        return np.union1d(self.path.knots, self.attitude.times)


def recorded_trajectory(
    time: np.ndarray, llh: np.ndarray, c_nb: np.ndarray, frame: Frame, events: dict[str, float]
) -> RecordedTrajectory:
    """A trajectory through recorded positions (n, 3) rad, rad, m and attitudes (n, 3, 3) at times (n,), s, ascending.

    Raises ValueError for recordings too short or too sparse for the curves.
    """
    from scipy.interpolate import make_lsq_spline

    span = float(time[-1] - time[0])
    if span < 4.0 * _POSITION_KNOTS or np.max(np.diff(time)) > _ATTITUDE_STEP:
        raise ValueError(
            f"a recording of at least {4.0 * _POSITION_KNOTS:g} s with outputs each {_ATTITUDE_STEP:g} s or denser is "
            f"needed, this has {time.size} in {span:.1f} s; filter.output_rate_hz of the replay sets how many"
        )
    ecef = earth.ecef_from_llh(llh)
    inner = np.linspace(time[0], time[-1], max(2, round(span / _POSITION_KNOTS)) + 1)
    knots = np.concatenate([np.repeat(inner[:1], _DEGREE), inner, np.repeat(inner[-1:], _DEGREE)])
    spline = make_lsq_spline(time, ecef, knots, k=_DEGREE)
    path = RecordedPath(spline, frame, inner, events, _rms(spline(time) - ecef))
    return RecordedTrajectory(path, frame, _attitude(time, llh, c_nb))


def smoothed_path(
    time: np.ndarray, llh: np.ndarray, sigma: tuple[float, float], frame: Frame, events: dict[str, float]
) -> RecordedPath:
    """The curve by places (n, 3) rad, rad, m at times (n,), s, ascending, whose mean square distance from them in
    sigmas is 1 an axis. sigma: horizontal and vertical, m.

    Raises ValueError for too few places, and where no curve is as near.
    """
    from scipy.interpolate import BSpline, splprep

    if time.size < _FEWEST:
        raise ValueError(f"{time.size} places are too few for a curve, {_FEWEST} are needed")
    ecef = earth.ecef_from_llh(llh)
    weight = np.array([sigma[0], sigma[0], sigma[1]])
    scaled = ((ecef - frame.origin) @ frame.axes) / weight
    found: Any
    (found, _), _, flaw, message = splprep(scaled.T, u=time, k=_DEGREE, s=float(scaled.size), full_output=1, quiet=1)
    if flaw > 0:
        raise ValueError(f"no smooth curve is within the sigma of the positions: {message}")
    knots, coefficients = found[0], np.array(found[1]).T * weight
    spline = BSpline(knots, coefficients @ frame.axes.T + frame.origin, _DEGREE)
    return RecordedPath(spline, frame, np.unique(knots), events, _rms(spline(time) - ecef))


def track_trajectory(path: RecordedPath, time: np.ndarray, llh: np.ndarray, c_nb: np.ndarray) -> RecordedTrajectory:
    """A path with recorded attitudes (n, 3, 3) at places (n, 3) rad, rad, m and times (n,), s, ascending."""
    return RecordedTrajectory(path, path.frame, _attitude(time, llh, c_nb))


@dataclass(frozen=True)
class Largest:
    """Largest specific force, m/s2, and largest rate relative to inertial space, rad/s, of a motion, and their times,
    s."""

    force: float
    force_time: float
    rate: float
    rate_time: float


def largest(moving: Moving, duration: float) -> Largest:
    """Largest values of a motion from time 0 on, every hundredth of a second."""
    time = np.arange(0.0, duration + 0.5 * _LOOK, _LOOK)
    pieces = (moving.motion(piece) for piece in np.array_split(time, -(-time.size // _AT_ONCE)))
    force, rate = (
        np.concatenate(each)
        for each in zip(
            *((np.linalg.norm(m.specific_force, axis=1), np.linalg.norm(m.angular_rate, axis=1)) for m in pieces),
            strict=True,
        )
    )
    hard, fast = int(np.argmax(force)), int(np.argmax(rate))
    return Largest(float(force[hard]), float(time[hard]), float(rate[fast]), float(time[fast]))


def _rms(distance: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(distance**2, axis=1))))


def _attitude(time: np.ndarray, llh: np.ndarray, c_nb: np.ndarray) -> Any:
    """A curve with continuous rates through attitudes (n, 3, 3), of those a quarter of a second apart or more."""
    from scipy.spatial.transform import Rotation, RotationSpline

    kept = [0]
    for index in range(1, time.size):
        if time[index] - time[kept[-1]] >= _ATTITUDE_STEP - 1e-6:
            kept.append(index)
    if kept[-1] != time.size - 1:
        kept[-1] = time.size - 1
    c_eb = np.swapaxes(earth.ned_matrix(llh[kept]), 1, 2) @ c_nb[kept]
    return RotationSpline(time[kept], Rotation.from_matrix(c_eb))
