"""Response of an aircraft to gusts and turbulence about its route, along one axis of its course at a time.

The air accelerates the aircraft with the lag of its force, and guidance corrects the deviation (`air.carried`). Scales
and lags follow the height and airspeed of the route. On the ground they keep their values of touchdown, while the
ground removes the effect of the air. Equations: `docs/theory/air.md`, section 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.geodesy import earth
from navsim.statistics.linear_processes import exponential
from navsim.trajectory.air import TURBULENCE_LOWEST, Air, Gust, Process, carried, dryden, level_axes, through
from navsim.trajectory.kinematics import Trajectory
from navsim.trajectory.track_frame import LATERAL, VERTICAL, Course, Walk

STRETCHES = 64
"""At most, of time, within which scales and lags count for the same."""
_ALONG_FLIGHT = (1, 0, 2)
"""Which of u, v, w is across the course, along it, up."""
_NODES = 3
"""Nodes of the Gauss-Legendre rule for a gust in a step."""


@dataclass(frozen=True)
class Buffeting:
    """Effect of gusts along one axis of the course on an aircraft, at times (k,), s."""

    which: np.ndarray
    """(k,) stretch of time to which each belongs."""
    lag: np.ndarray
    """(m,) lag in each stretch, s."""
    loop: float
    """s, see `Response`; inf if an autopilot corrects what it knows of the deviation."""
    rows: np.ndarray
    """(m, n) output rows of the turbulence, m/s, from the first n states of its `walk`; n is 0 without turbulence."""
    walk: Walk | None
    """Random walk of the turbulence; None without."""
    gust: np.ndarray
    """(k,) discrete gusts, m/s."""
    met: np.ndarray
    """(k, 3) or (k, 5) states of `carried` in discrete gusts."""

    def moved(self, states: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Deviation from the route with two derivatives (3, k, W), m, and the speed through the air that the nose
        follows.

        The latter, with its rate, is (2, k, W), m/s, or empty if the nose does not follow. states: (k, n, W) of the
        walk.
        """
        gust, met = self.blowing(states), self.met[..., None]
        if states is not None:
            met = met + states[:, self.rows.shape[1] :]
        place, speed, nose = met[:, 1], met[:, 2], met[:, 3:]
        acceleration = (gust - met[:, 0]) / self.lag[self.which, None] + self.guided(np.stack([place, speed]))
        return np.stack([place, speed, acceleration]), nose.transpose(1, 0, 2)

    def blowing(self, states: np.ndarray | None) -> np.ndarray:
        """Gusts and turbulence (k, W), m/s, without the mean wind; states (k, n, W) of the walk."""
        gust = self.gust[:, None]
        if states is None:
            return gust
        return np.asarray(gust + np.einsum("kn,knw->kw", self.rows[self.which], states[:, : self.rows.shape[1]]))

    def guided(self, moved: np.ndarray) -> np.ndarray:
        """The acceleration (k, W), m/s2, with which guidance answers a way and its derivative (2 or more, k, W); of the
        derivatives of both it is its rate."""
        return np.asarray(-(2.0 * moved[1] + moved[0] / self.loop) / self.loop)


def buffeting(air: Air, trajectory: Trajectory, time: np.ndarray, course: Course) -> dict[int, Buffeting]:
    """Effect of gusts along each axis of the course that has any, at equally spaced times (k,), s; with an autopilot
    without its answer, which `guidance.steered` adds."""
    if air.turbulence is None and not air.gusts:
        return {}
    which, middle = _stretches(course)
    height, airspeed = course.of_air(middle)
    lags = air.response.lags(airspeed)
    step = float(time[1] - time[0])
    points, shares = np.polynomial.legendre.leggauss(_NODES)
    within = time[:-1, None] + 0.5 * step * (1.0 + points)
    sampled = gust_components(air.gusts, trajectory, time, course, time)
    between = gust_components(air.gusts, trajectory, within.ravel(), course, time).reshape(*within.shape, 3)
    out, loop = {}, air.response.loop if air.autopilot is None else np.inf
    for axis, lag in enumerate(lags):
        nose = air.response.nose_lag if axis in (LATERAL, VERTICAL) else None
        systems = [carried(float(one), loop, nose) for one in lag]
        rows, walk = np.empty((lag.size, 0)), None
        if air.turbulence is not None:
            k = _ALONG_FLIGHT[axis]
            sigma = air.turbulence.sigmas(height)[:, k] * course.airborne[0, middle]
            gusts = [dryden(float(t), k > 0) for t in air.turbulence.time_scales(height, airspeed)[:, k]]
            rows = np.stack([s * row for s, (_, row) in zip(sigma, gusts, strict=True)])
            met_with = zip(gusts, rows, systems, strict=True)
            # at the beginning guidance has held the route for a long time
            start = through(gusts[0][0], rows[0], carried(float(lag[0]), air.response.loop, nose))
            walk = Walk.of([through(gust, row, system) for (gust, _), row, system in met_with], which[:-1], step, start)
        elif not between[..., axis].any():
            continue
        met = _met(systems, which[:-1], step, points, shares, between[..., axis])
        out[axis] = Buffeting(which, lag, loop, rows, walk, sampled[:, axis], met)
    return out


def _stretches(course: Course) -> tuple[np.ndarray, np.ndarray]:
    """Which stretch each time is in (k,), and the time in the middle of each (m,): of height, of airspeed and of the
    ground's hold as much changes in one as in another."""
    height, airspeed = course.of_air(np.arange(course.height.shape[1]))
    logs = np.log(np.maximum(height, TURBULENCE_LOWEST)), np.log(airspeed), course.airborne[0]
    change = np.concatenate([[0.0], np.cumsum(sum(np.abs(np.diff(one)) for one in logs))])
    share = change / change[-1] if change[-1] > 0.0 else change
    which = np.unique(np.minimum((STRETCHES * share).astype(np.int64), STRETCHES - 1), return_inverse=True)[1]
    first = np.searchsorted(which, np.arange(which[-1] + 1))
    last = np.append(first[1:], which.size) - 1
    return which, (first + last) // 2


def gust_components(
    gusts: tuple[Gust, ...], trajectory: Trajectory, t: np.ndarray, course: Course, time: np.ndarray
) -> np.ndarray:
    """Discrete gusts across the course, along it and up (n, 3), m/s, at times (n,), reduced on the ground.

    course: at other times (k,).
    """
    out = np.zeros((t.size, 3))
    if not gusts:
        return out
    ahead, right = level_axes(trajectory.path.jet(t)[:, 1])
    up = np.array([0.0, 0.0, -1.0])
    frame = trajectory.frame
    north, east, _ = earth.ned_matrix(earth.llh_from_ecef(frame.origin)) @ frame.axes
    mean = trajectory.wind.mean(t)
    speed = np.linalg.norm(mean, axis=1, keepdims=True)
    directions = {"north": north, "east": east, "along": ahead, "right": right, "up": up}
    directions["wind"] = np.divide(mean, speed, out=np.zeros_like(mean), where=speed > 0.0)
    airborne = np.interp(t, time, course.airborne[0])
    for gust in gusts:
        airspeed = 1.0 / float(np.interp(gust.start, time, course.slowness[0]))
        blows = (airborne * gust.at(t, airspeed))[:, None] * directions[gust.towards]
        for axis, unit in enumerate((right, ahead, up)):
            out[:, axis] += np.sum(blows * unit, axis=1)
    return out


def _met(
    systems: list[Process], which: np.ndarray, step: float, points: np.ndarray, shares: np.ndarray, gust: np.ndarray
) -> np.ndarray:
    """States (k, n) of linear systems from rest, driven by a gust.

    - `which` (k - 1,): system of each step.
    - `gust` (k - 1, q): at the points of a quadrature rule for the interval -1 ... 1 in each step.
    """
    a, b = np.stack([s.a for s in systems]), np.stack([s.b for s in systems])
    transition = exponential(a * step)
    left = 0.5 * step * (1.0 - points)
    kick = 0.5 * step * shares[:, None] * np.stack([(exponential(a * t) @ b[..., None])[..., 0] for t in left], axis=1)
    added = np.einsum("kq,kqn->kn", gust, kick[which])
    out = np.zeros((which.size + 1, a.shape[1]))
    begin = int(np.argmax(gust.any(axis=1))) if gust.any() else which.size
    for k, piece in enumerate(which[begin:], begin):
        out[k + 1] = transition[piece] @ out[k] + added[k]
    return out
