"""The same path flown at given airspeeds instead of ground speeds: same geometry, other times.

Time on the original path, s(t), is a piecewise quintic fitted to the airspeed. The path stays as smooth as before, and
its derivatives follow by the chain rule. Source: `docs/theory/air.md`, section 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.trajectory.air import AirError, MeanWind, crossings, ground_speed, over_runway
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.path import AnyPath, hermite

_STEP = 0.1
"""Interval of the path's own time between the knots of s(t), s; airspeed errors between them are below 1e-4 m/s."""
_SMALL = 1e-4
"""Step of the difference quotients for slopes, s."""
SLOWEST = 2.0
"""Speed over ground that is needed, m/s: an attitude follows from it."""


def held_airspeed(path: AnyPath, wind: MeanWind, duration: float, rise: float = 0.0) -> Retimed:
    """The path with its speeds as airspeeds, for so many seconds, over a runway with this rise, m a m.

    Raises AirError if the wind makes it impossible.
    """
    points, shares = np.polynomial.legendre.leggauss(4)
    end = 1.2 * duration + 2.0
    while True:
        corners = np.concatenate([path.knots, crossings(path, wind.profile.corners, end)])
        s = np.union1d(_STEP * np.arange(math.ceil(end / _STEP) + 1), corners[(corners > 0.0) & (corners < end)])
        # knots within rounding of one another would make an empty piece
        s = s[np.concatenate([[True], np.diff(s) > 1e-6])]
        half = 0.5 * np.diff(s)
        nodes = (0.5 * (s[:-1] + s[1:]))[:, None] + half[:, None] * points
        ratio, speed = _rates(path, wind, rise, nodes.ravel())
        t = np.concatenate([[0.0], np.cumsum(((half[:, None] * shares) / ratio.reshape(nodes.shape)).sum(axis=1))])
        over_ground = (ratio * speed).reshape(nodes.shape)
        # the part after the end is not flown
        flown = t[:-1] < duration
        if not np.isfinite(over_ground[flown]).all() or np.isnan(t[1:][flown[: t.size - 1]]).any():
            text = "the wind, against the path or across it, is no less than the airspeed: it cannot be flown"
            raise AirError("speed_m_s", text + _after_landing(path, s, t, ~np.isfinite(over_ground).all(axis=1)))
        if (slow := (over_ground < SLOWEST).any(axis=1) & flown).any():
            text = f"against the wind the aircraft falls below {SLOWEST:g} m/s over ground"
            raise AirError("speed_m_s", text + _after_landing(path, s, t, slow))
        last = int(np.flatnonzero(flown)[-1]) + 2
        if last < t.size:
            break
        end *= 2.0
    s, t = s[:last], t[:last]
    first = _rates(path, wind, rise, s)[0]
    slope = (_rates(path, wind, rise, s + _SMALL)[0] - _rates(path, wind, rise, s - _SMALL)[0]) / (2.0 * _SMALL)
    return Retimed(path, t, np.stack([s, first, slope * first], axis=1))


def _after_landing(path: AnyPath, s: np.ndarray, t: np.ndarray, failing: np.ndarray) -> str:
    """What flies a landing that fails on the roll-out alone; s: of the path (n + 1,), t: of the flight (n + 1,), s, up
    to the first failing piece (n,)."""
    touchdown, first = path.events.get(TOUCHDOWN, math.inf), int(np.argmax(failing))
    if s[first] < touchdown:
        return ""
    landed, until = np.interp(touchdown, s[: first + 1], t[: first + 1]), math.floor(t[first])
    ground = "`approach.speed_is: ground`"
    return f", {t[first] - landed:.0f} s after touchdown, on the roll-out: give duration_s {until} or less, or {ground}"


def _rates(path: AnyPath, wind: MeanWind, rise: float, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed over ground by airspeed where the path is at its own times s (n,), nan where it cannot be flown; and the
    airspeed, m/s."""
    jet = path.jet(s)
    airspeed = np.linalg.norm(jet[:, 1], axis=1)
    over_ground = ground_speed(airspeed, jet[:, 1] / airspeed[:, None], wind.at(over_runway(path, s, jet, rise)[0])[0])
    return np.where(over_ground > 0.0, over_ground, np.nan) / airspeed, airspeed


@dataclass(frozen=True)
class Retimed:
    """A path at other times. time: (k,) s of the knots; way: (k, 3) the path's own time there, and its first two
    derivatives."""

    path: AnyPath
    time: np.ndarray
    way: np.ndarray

    def _own(self, t: np.ndarray) -> np.ndarray:
        """The path's time and its first three derivatives (n, 4)."""
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, self.time.size - 2)
        return hermite(self.way[k], self.way[k + 1], t - self.time[k], np.diff(self.time)[k])

    def when(self, s: float) -> float:
        """The time at which the path is at its own time s; beyond the knots as fast as at their end."""
        if s >= self.way[-1, 0]:
            return float(self.time[-1] + (s - self.way[-1, 0]) / self.way[-1, 1])
        k = max(0, int(np.searchsorted(self.way[:, 0], s, side="right")) - 1)
        t = float(self.time[k])
        for _ in range(8):
            own = self._own(np.array([t]))[0]
            t -= float((own[0] - s) / own[1])
        return t

    @cached_property
    def events(self) -> dict[str, float]:
        """Named times, s."""
        return {name: self.when(s) for name, s in self.path.events.items()}

    @property
    def knots(self) -> np.ndarray:
        """Times (s) at which polynomials join."""
        return self.time[1:-1]

    def jet(self, t: np.ndarray) -> np.ndarray:
        """Position, velocity, acceleration and jerk at the times t (n,): (n, 4, 3), m, m/s, m/s2, m/s3."""
        s, s1, s2, s3 = self._own(np.asarray(t, dtype=float)).T[:, :, None]
        p, p1, p2, p3 = np.moveaxis(self.path.jet(s[:, 0]), 1, 0)
        return np.stack([p, p1 * s1, p2 * s1**2 + p1 * s2, p3 * s1**3 + 3.0 * p2 * s1 * s2 + p1 * s3], axis=1)
