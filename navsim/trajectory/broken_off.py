"""Landings of runs: where each touches down, and how it goes around after its own alarm.

Equations: `docs/theory/air.md`, section 7.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from navsim.trajectory.air import Air
from navsim.trajectory.approach import GLIDE_START, TOUCHDOWN
from navsim.trajectory.dispersion import PathDeviation
from navsim.trajectory.go_around import with_go_around
from navsim.trajectory.kinematics import Trajectory
from navsim.trajectory.path import Path

_MOST_CLIMBS = 16
"""Most go-arounds that are kept: some megabytes."""


class Endings(NamedTuple):
    """Ends of the landings of W runs; nan where there is none."""

    touchdown: np.ndarray
    """(4, W) time, s; position along the runway beyond the route's touchdown point, to the right of it, m; sink rate,
    m/s."""
    go_around: np.ndarray
    """(3, W) begin of the pull-up, s; height above the runway then, and the lowest one after it, m."""


@dataclass(frozen=True)
class LandingEnd:
    """The last part of a landing, along a route at equally spaced times (k,), s."""

    trajectory: Trajectory
    air: Air
    time: np.ndarray
    climbs: dict[float, np.ndarray] = field(default_factory=dict)
    """Jets of go-arounds by their begin, s: runs with an alarm at the same fix share one."""

    @cached_property
    def _jet(self) -> np.ndarray:
        """(k, 3, 3) position, velocity, acceleration of the route along path axes."""
        return np.ascontiguousarray(self.trajectory.path.jet(self.time)[:, :3])

    @property
    def _touchdown(self) -> float:
        """Time when the route touches down, s; inf if it does not."""
        return self.trajectory.path.events.get(TOUCHDOWN, np.inf)

    def begins(self, epochs: np.ndarray, known: np.ndarray, alerts: np.ndarray) -> np.ndarray:
        """Times (W,) when runs begin a go-around, s; inf for none.

        epochs: (e,) times of the fixes; known: (e,) when their alerts (e, W) are known.
        """
        go_around, end = self.air.go_around, self._touchdown
        assert go_around is not None
        height = -self.trajectory.path.jet(epochs)[:, 0, 2]
        first = self.trajectory.path.events.get(GLIDE_START, 0.0)
        begin = known + go_around.delay
        due = (epochs >= first) & (height >= go_around.decision_height) & (begin < min(end, self.time[-1]))
        due = alerts & due[:, None]
        return np.where(due.any(axis=0), begin[np.argmax(due, axis=0)], np.inf)

    def broken_off(self, departure: PathDeviation, begin: np.ndarray) -> PathDeviation:
        """Deviations from the route with go-arounds that begin at times (W,), s, inf for none; changes `departure`."""
        assert self.air.go_around is not None
        path = self.trajectory.path
        assert isinstance(path, Path)
        for lane in np.flatnonzero(np.isfinite(begin)):
            first = int(np.searchsorted(self.time, begin[lane]))
            jet, route = self._climb(path, float(begin[lane]), first), self._jet[first:]
            departure.way[first:, :, lane] += (jet - route).reshape(-1, 9)
            if self.trajectory.pitch_follows_path:
                wind = self.trajectory.wind.mean(self.time[first:])
                (now, rate), (before, slower) = (_climb_angle(each, wind) for each in (jet, route))
                half = np.tan(0.5 * (now - before))
                departure.turn[first:, 1, lane] += half
                departure.turn[first:, 4, lane] += 0.5 * (1.0 + half**2) * (rate - slower)
        return replace(departure, begin=begin)

    def _climb(self, path: Path, begin: float, first: int) -> np.ndarray:
        """Position, velocity, acceleration (k, 3, 3) of a go-around that begins at a time, from a sample on."""
        assert self.air.go_around is not None
        if begin not in self.climbs:
            if len(self.climbs) >= _MOST_CLIMBS:
                self.climbs.clear()
            climbing = with_go_around(path, begin, self.air.go_around.how, through_ground=True)
            self.climbs[begin] = climbing.jet(self.time[first:])[:, :3]
        return self.climbs[begin]

    def endings(self, departure: PathDeviation) -> Endings:
        """Ends of runs with these deviations."""
        jet, way = self._jet, departure.way
        begin = np.broadcast_to(departure.begin, way.shape[2])
        height = -(jet[:, 0, 2, None] + way[:, 2]) - self.air.rise * (jet[:, 0, 0, None] + way[:, 0])
        lanes = way.shape[2]
        out = Endings(np.full((4, lanes), np.nan), np.full((3, lanes), np.nan))
        last = min(int(np.searchsorted(self.time, self._touchdown, side="right")), self.time.size) - 1
        for lane in range(lanes):
            up = height[:, lane]
            off = int(np.searchsorted(self.time, begin[lane]))
            goes = off < self.time.size
            end = self.time.size if goes else last + 1
            below = np.flatnonzero((up[1:end] <= 0.0) & (up[: end - 1] > 0.0))
            if goes and not (below.size and below[0] < off):
                out.go_around[:, lane] = self.time[off], up[off], up[off:].min()
            if below.size:
                self._touch(out, lane, int(below[0]), departure, up)
            elif not goes and np.isfinite(self._touchdown) and self._touchdown <= self.time[-1]:
                self._touch(out, lane, last, departure, up)
        return out

    def _touch(self, out: Endings, lane: int, at: int, departure: PathDeviation, up: np.ndarray) -> None:
        """Write the touchdown of a run that goes on from a sample in a straight line to the ground."""
        place, speed = (self._jet[at, order] + departure.way[at, 3 * order : 3 * order + 3, lane] for order in (0, 1))
        sink = speed[2] + self.air.rise * speed[0]
        if up[at] > 0.0 and sink <= 0.0:
            return
        wait = up[at] / sink if up[at] > 0.0 else 0.0
        out.touchdown[:, lane] = self.time[at] + wait, *(place + wait * speed)[:2], sink


def _climb_angle(jet: np.ndarray, wind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle of the path through the air above the horizontal (k,), rad, and its rate, rad/s."""
    velocity, acceleration = jet[:, 1] - wind, jet[:, 2]
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    faster = np.sum(velocity[:, :2] * acceleration[:, :2], axis=1) / level
    angle = np.arctan2(-velocity[:, 2], level)
    return angle, (velocity[:, 2] * faster - level * acceleration[:, 2]) / (level**2 + velocity[:, 2] ** 2)
