"""Piecewise analytic paths in a tangent plane: position and its first three derivatives at any time.

A segment is one of three:

- a polynomial of degree five in time plus one decaying exponential per axis. It describes straight lines, uniform
  acceleration, C2 blends and the exponential flare.
- a circle.
- flight steered by speed, climb angle and track.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.polynomial import Chebyshev

DEGREE = 5
_NODES = 40
"""Degree of the series of steered flight: rolls to 60 degrees are exact to 1e-13."""
_FACTORS = np.array([[math.perm(p, k) if p >= k else 0 for p in range(DEGREE + 1)] for k in range(4)], dtype=float)


@dataclass(frozen=True)
class Segment:
    """One piece of a path, in time s since the piece's start.

    polynomial: (3, 6) coefficients of s^0 ... s^5 for each axis. amplitude: (3,) of exp(-s / time_constant).
    """

    start: float
    polynomial: np.ndarray
    amplitude: np.ndarray = field(default_factory=lambda: np.zeros(3))
    time_constant: float = math.inf

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration and jerk at the times t (n,): (n, 4, 3)."""
        s = np.asarray(t, dtype=float) - self.start
        powers = s[:, None] ** np.arange(DEGREE + 1)
        out = np.empty((s.size, 4, 3))
        rate = -1.0 / self.time_constant
        decay = np.exp(rate * s)
        for k in range(4):
            scaled = self.polynomial[:, k:] * _FACTORS[k, k:]
            out[:, k] = powers[:, : DEGREE + 1 - k] @ scaled.T + decay[:, None] * (rate**k * self.amplitude)
        return out


@dataclass(frozen=True)
class Arc:
    """Level flight along a circle at constant speed and turn rate (rad/s, positive to the right, not zero).

    position: (3,) at the start; track: direction of flight there, rad from the x axis towards y.
    """

    start: float
    position: np.ndarray
    track: float
    speed: float
    rate: float

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration and jerk at the times t (n,): (n, 4, 3)."""
        s = np.asarray(t, dtype=float) - self.start
        angle = self.track + self.rate * s
        out = np.zeros((s.size, 4, 3))
        radius = self.speed / self.rate
        out[:, 0, 0] = radius * (np.sin(angle) - np.sin(self.track))
        out[:, 0, 1] = radius * (np.cos(self.track) - np.cos(angle))
        out[:, 0] += self.position
        for k in range(1, 4):
            size = self.speed * self.rate ** (k - 1)
            turned = angle + (k - 1) * 0.5 * math.pi
            out[:, k, 0], out[:, k, 1] = size * np.cos(turned), size * np.sin(turned)
        return out


@dataclass(frozen=True)
class Steered:
    """Flight with given speed, climb angle and track; each is a series over the time since the start, [0, duration].

    The position is the integral of the velocity's own series, exact to rounding.
    """

    start: float
    """s."""
    position: np.ndarray
    """(3,) at the start, m."""
    speed: Chebyshev
    """m/s."""
    climb: Chebyshev
    """rad."""
    track: Chebyshev
    """rad, from the x axis towards y."""

    @cached_property
    def _displacement(self) -> tuple[Chebyshev, ...]:
        """Displacement since the start, an axis each."""
        domain = self.speed.domain.tolist()
        rates = (
            lambda s: self.speed(s) * np.cos(self.climb(s)) * np.cos(self.track(s)),
            lambda s: self.speed(s) * np.cos(self.climb(s)) * np.sin(self.track(s)),
            lambda s: -self.speed(s) * np.sin(self.climb(s)),
        )
        return tuple(Chebyshev.interpolate(rate, _NODES, domain).integ(lbnd=0.0) for rate in rates)

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration and jerk at the times t (n,): (n, 4, 3)."""
        s = np.asarray(t, dtype=float) - self.start
        v, c, k = (
            [(each.deriv(order) if order else each)(s)[:, None] for order in range(3)]
            for each in (self.speed, self.climb, self.track)
        )
        sin_c, cos_c, sin_k, cos_k = np.sin(c[0]), np.cos(c[0]), np.sin(k[0]), np.cos(k[0])
        none = np.zeros_like(sin_c)
        ahead = np.concatenate([cos_c * cos_k, cos_c * sin_k, -sin_c], axis=1)
        # derivatives of the direction by climb angle, by track, by both, and twice by track
        by_c = np.concatenate([-sin_c * cos_k, -sin_c * sin_k, -cos_c], axis=1)
        by_k = np.concatenate([-cos_c * sin_k, cos_c * cos_k, none], axis=1)
        by_ck = np.concatenate([sin_c * sin_k, -sin_c * cos_k, none], axis=1)
        by_kk = np.concatenate([-cos_c * cos_k, -cos_c * sin_k, none], axis=1)
        turn = c[1] * by_c + k[1] * by_k
        bend = c[2] * by_c + k[2] * by_k - c[1] ** 2 * ahead + 2.0 * c[1] * k[1] * by_ck + k[1] ** 2 * by_kk
        out = np.empty((s.size, 4, 3))
        out[:, 0] = self.position + np.stack([axis(s) for axis in self._displacement], axis=1)
        out[:, 1] = v[0] * ahead
        out[:, 2] = v[1] * ahead + v[0] * turn
        out[:, 3] = v[2] * ahead + 2.0 * v[1] * turn + v[0] * bend
        return out


AnySegment = Segment | Arc | Steered


class NoSuchPath(ValueError):
    """A path that cannot be flown; waypoint: number, from 0, of the waypoint at which it fails, if any."""

    def __init__(self, message: str, waypoint: int | None = None) -> None:
        super().__init__(message)
        self.waypoint = waypoint


@dataclass(frozen=True)
class Path:
    """Segments in order of time; the first and the last extend to infinity.

    Axes: x along the landing direction, y to the right, z down; origin at the touchdown point, in its tangent plane.
    events: named times, s.
    """

    segments: tuple[AnySegment, ...]
    events: dict[str, float]

    @property
    def knots(self) -> np.ndarray:
        """Times (s) at which segments join."""
        return np.array([s.start for s in self.segments[1:]])

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration and jerk at the times t (n,): (n, 4, 3), m, m/s, m/s2, m/s3."""
        t = np.asarray(t, dtype=float)
        which = np.searchsorted(self.knots, t, side="right")
        out = np.empty((t.size, 4, 3))
        for i in np.flatnonzero(np.bincount(which)):
            mine = which == i
            out[mine] = self.segments[i].jet(t[mine])
        return out


def uniform(start: float, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> Segment:
    """A segment of constant acceleration from the given state."""
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[:, 0], polynomial[:, 1], polynomial[:, 2] = position, velocity, 0.5 * np.asarray(acceleration)
    return Segment(start, polynomial)


def blend(start: float, end: float, before: np.ndarray, after: np.ndarray) -> Segment:
    """The quintic that joins two states in position, velocity and acceleration (Hermite).

    before, after: (>= 3, 3) jets at the start and the end time.
    """
    h = end - start
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[:, :3] = (before[:3] / np.array([1.0, 1.0, 2.0])[:, None]).T
    matrix = np.array([[h**3, h**4, h**5], [3 * h**2, 4 * h**3, 5 * h**4], [6 * h, 12 * h**2, 20 * h**3]])
    carried = np.array([before[0] + h * before[1] + h**2 / 2 * before[2], before[1] + h * before[2], before[2]])
    polynomial[:, 3:] = np.linalg.solve(matrix, after[:3] - carried).T
    return Segment(start, polynomial)


class AnyPath(Protocol):
    """Interface of a path for trajectories; see `Path`."""

    @property
    def events(self) -> dict[str, float]:
        """Named times, s."""

    @property
    def knots(self) -> np.ndarray:
        """Times (s) where a higher derivative jumps."""

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration and jerk at the times t (n,): (n, 4, 3)."""


def hermite(before: np.ndarray, after: np.ndarray, s: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Values and three derivatives (n, 4, ...) of the quintics that join states at times s (n,) since the first.

    before, after: (n, 3, ...) value, first and second derivative, `step` (n,) apart. For a process driven by a white
    third derivative this is the conditional mean.
    """
    shape = (-1, *[1] * (before.ndim - 2))
    s, h = s.reshape(shape), step.reshape(shape)
    p0, v0, a0 = before[:, 0], before[:, 1], before[:, 2]
    # difference of the second state from the propagated first one, in units of the step
    r0 = after[:, 0] - (p0 + h * (v0 + 0.5 * h * a0))
    r1 = (after[:, 1] - (v0 + h * a0)) * h
    r2 = (after[:, 2] - a0) * h * h
    c3 = 10.0 * r0 - 4.0 * r1 + 0.5 * r2
    c4 = -15.0 * r0 + 7.0 * r1 - r2
    c5 = 6.0 * r0 - 3.0 * r1 + 0.5 * r2
    u = s / h
    return np.stack(
        [
            p0 + s * (v0 + 0.5 * s * a0) + u**3 * (c3 + u * (c4 + u * c5)),
            v0 + s * a0 + u**2 * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)) / h,
            a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)) / h**2,
            (6.0 * c3 + u * (24.0 * c4 + u * 60.0 * c5)) / h**3,
        ],
        axis=1,
    )


def series(value: Callable[[np.ndarray], np.ndarray], duration: float) -> Chebyshev:
    """A smooth function of the time s (n,) since a piece's start, as `Steered` takes it."""
    return Chebyshev.interpolate(value, _NODES, [0.0, duration])


def constant(value: float, duration: float) -> Chebyshev:
    """A number that does not change, as `Steered` takes it."""
    return Chebyshev([value], [0.0, duration])


def smooth_step(u: np.ndarray) -> np.ndarray:
    """0 to 1 over u = 0 ... 1, with two derivatives that vanish at both ends."""
    return u**3 * (10.0 + u * (6.0 * u - 15.0))


def ended(segment: AnySegment, t: float) -> np.ndarray:
    """The jet (4, 3) of a segment at a time."""
    return segment.jet(np.array([t]))[0]


def straight(
    start: float,
    position: np.ndarray,
    track: float,
    speeds: tuple[float, float],
    heights: tuple[float, float],
    length: float,
) -> tuple[Segment, float]:
    """A straight leg and the time it takes, s.

    Speed over ground goes from the first to the second by a cubic without acceleration at either end, height by a
    quintic. position: (3,) at the start; length: over ground, m.
    """
    first, second = speeds
    taken = 2.0 * length / (first + second)
    along = np.zeros(DEGREE + 1)
    along[1], along[3], along[4] = first, (second - first) / taken**2, -0.5 * (second - first) / taken**3
    polynomial = np.zeros((3, DEGREE + 1))
    polynomial[0], polynomial[1] = math.cos(track) * along, math.sin(track) * along
    polynomial[:2, 0] = position[:2]
    rise = heights[1] - heights[0]
    polynomial[2] = -heights[0], 0.0, 0.0, -10.0 * rise / taken**3, 15.0 * rise / taken**4, -6.0 * rise / taken**5
    return Segment(start, polynomial), taken


def shifted(path: Path, by: float) -> Path:
    """The same path, later by so many s."""
    segments = tuple(replace(each, start=each.start + by) for each in path.segments)
    return Path(segments, {name: t + by for name, t in path.events.items()})
