"""True trajectories that deviate from the route, one for each run, and the true measurements along them.

The route still defines the choice of satellites, the weights and the axes of errors. Measurements and errors refer to
the run's own trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from navsim.compiler.lanes import in_lanes
from navsim.geodesy import earth
from navsim.gnss.pseudorange import Signals
from navsim.gnss.signals import antenna_motion
from navsim.simulation.dispersion_kernels import deviate, ranges_from
from navsim.statistics.random_streams import generator
from navsim.trajectory.air import Air
from navsim.trajectory.broken_off import Endings, LandingEnd
from navsim.trajectory.dispersion import Disturbance, PathDeviation, deviated
from navsim.trajectory.guidance import GuidanceErrors, slopes_by_errors
from navsim.trajectory.kinematics import EARTH_RATE, Frame, Motion, Trajectory


@dataclass(frozen=True)
class CachedRoute:
    """Route of all runs, with a cache, since every run needs the same times."""

    trajectory: Trajectory
    kept: dict[bytes, Motion] = field(default_factory=dict)

    def motion(self, t: np.ndarray) -> Motion:
        """Motion at the times t (n,), s."""
        key = t.tobytes()
        if key not in self.kept:
            self.kept[key] = self.trajectory.motion(t)
        return self.kept[key]


@dataclass(frozen=True)
class RunTrajectory:
    """Trajectory of one run for sensors beside the receiver (`aiding`)."""

    route: CachedRoute
    departure: PathDeviation
    """Of all lanes."""
    lane: int
    kept: dict[bytes, Motion] = field(default_factory=dict)
    """`motion` by its times, which sensors share."""

    @property
    def frame(self) -> Frame:
        """Axes of the path."""
        return self.route.trajectory.frame

    def motion(self, t: np.ndarray) -> Motion:
        """Motion at the times t (n,), s."""
        key = t.tobytes()
        if key not in self.kept:
            way, turn = (m[..., self.lane, None] for m in self.departure.at(t))
            self.kept[key] = deviated(self.route.motion(t), self.frame, way, turn)
        return self.kept[key]

    def llh(self, t: np.ndarray) -> np.ndarray:
        """Positions at the times t (n,), s: (n, 3) rad, rad, m."""
        off = self.departure.at(t)[0][:, :3, self.lane] @ self.frame.axes.T
        return earth.llh_from_ecef(self.route.motion(t).position_ecef + off)


class DispersedTrajectories(NamedTuple):
    """True motion of runs (lanes) that deviate from the route."""

    dtheta: np.ndarray
    """(n, 3, W) exact angle increments, rad."""
    dv: np.ndarray
    """(n, 3, W) exact velocity increments, m/s."""
    llh: np.ndarray
    """(o, 3, W) at the filter's outputs."""
    velocity: np.ndarray
    """(o, 3, W)."""
    quaternion: np.ndarray
    """(o, 4, W)."""
    deviation: np.ndarray
    """(o, 3, W) from the route along runway axes, m: lateral (right), along, vertical (up)."""
    antenna: np.ndarray
    """(e, 3, W) at fixes, ECEF."""
    antenna_velocity: np.ndarray
    """(e, 3, W) likewise."""
    ranges: np.ndarray
    """(e, s, W) at fixes."""
    rates: np.ndarray
    """(e, s, W) at fixes."""
    departure: PathDeviation
    motion: Motion
    """At the filter's outputs, of runs one after the other (W o)."""

    @property
    def rpy(self) -> np.ndarray:
        """(o, 3, W)."""
        return _lanes(self.motion.rpy, self.llh.shape[2])

    @property
    def gust(self) -> np.ndarray:
        """(o, 3, W) see `PathDeviation`."""
        return self.departure.gust_at(self.motion.time[: len(self.llh)])


@dataclass(frozen=True)
class Dispersion:
    """Common data of the trajectories of all runs."""

    trajectory: Trajectory
    disturbance: Disturbance
    half: Motion
    """Route at IMU samples and halfway between them."""
    axes_half: np.ndarray
    """(2n + 1, 3, 3) its body axes in path axes."""
    increments: tuple[np.ndarray, np.ndarray]
    """(n, 3) its increments."""
    at_filter: Motion
    """Route at the filter's outputs."""
    at_fixes: Motion
    """Route at the fixes."""
    signals: Signals
    sources: np.ndarray
    """(e, s, 3) true positions of the sources, ECEF."""
    lever_arm: np.ndarray
    route: CachedRoute
    """Route at other times."""

    @classmethod
    def of(
        cls,
        air: Air,
        trajectory: Trajectory,
        imu_time: np.ndarray,
        at_filter: Motion,
        at_fixes: Motion,
        signals: Signals,
        sources: np.ndarray,
        lever_arm: np.ndarray,
    ) -> Dispersion:
        """Common data of trajectories in this air around a route."""
        half = trajectory.motion(np.linspace(imu_time[0], imu_time[-1], 2 * imu_time.size - 1))
        return cls(
            trajectory, Disturbance.of(air, trajectory, imu_time), half, np.ascontiguousarray(trajectory.frame.axes.T @
            half.c_eb), trajectory.increments(imu_time), at_filter, at_fixes, signals, sources, lever_arm,
            CachedRoute(trajectory),
        )  # fmt: skip

    @property
    def steered(self) -> bool:
        """Whether aircraft are steered by their estimates."""
        return self.disturbance.air.autopilot is not None

    @property
    def depends(self) -> bool:
        """Whether trajectories depend on what runs measure: on their estimates, or on their alarms."""
        return self.steered or self.breaks_off

    @property
    def breaks_off(self) -> bool:
        """Whether an alarm breaks a run's landing off."""
        return self.disturbance.air.go_around is not None

    @cached_property
    def end(self) -> LandingEnd:
        """The ends of the landings."""
        return LandingEnd(self.trajectory, self.disturbance.air, self.disturbance.time)

    def begins(self, alerts: np.ndarray) -> np.ndarray:
        """Times (W,), s, when runs with alerts (e, W) at their fixes begin a go-around; inf for none."""
        return self.end.begins(self.at_fixes.time, self.at_filter.time[1:], alerts)

    def endings(self, flown: DispersedTrajectories) -> Endings:
        """Where runs touch down or go around."""
        return self.end.endings(flown.departure)

    @cached_property
    def _to_path(self) -> np.ndarray:
        """NED at the filter's outputs in path axes (o, 3, 3)."""
        return np.asarray(self.trajectory.frame.axes.T @ self.at_filter.c_ne.swapaxes(1, 2))

    def known(self, error: np.ndarray) -> GuidanceErrors:
        """Errors of the estimates that guidance has, from errors of position and velocity (o, 6, W), truth minus
        estimate, NED, m and m/s, at the filter's outputs."""
        turn = self._to_path
        outputs, _, lanes = error.shape
        both = error.reshape(outputs, 2, 3, lanes)
        turned = [sum(turn[:, a, j, None, None] * both[:, :, j] for j in range(3)) for a in range(3)]
        return GuidanceErrors.of(self._since, np.stack(turned, axis=2).reshape(error.shape))

    @property
    def _since(self) -> np.ndarray:
        """(o,) samples from which guidance has the filter's outputs."""
        samples = self.disturbance.time
        return np.minimum(np.searchsorted(samples, self.at_filter.time - 1e-9), samples.size - 1)

    def slopes_by_errors(self, weights: np.ndarray) -> np.ndarray:
        """Slopes (K, o, 6) of K sums of the positions of steered runs, by errors of the filter's outputs, NED.

        weights: (K, k, 3) of the sums, of positions along path axes at the samples.
        """
        disturbance, out = self.disturbance, np.zeros((len(weights), self.at_filter.time.size, 6))
        autopilot, step = disturbance.air.autopilot, float(disturbance.time[1] - disturbance.time[0])
        assert autopilot is not None
        unit = self.known(np.broadcast_to(np.eye(6), (self.at_filter.time.size, 6, 6)))
        last = np.append(np.diff(self._since) > 0, True)  # of several outputs at a sample the last one counts
        course = disturbance.course
        by_error = slopes_by_errors(autopilot, unit.first, course, disturbance.slope, step, weights)
        out[:, last] = np.einsum("Kmai,maiw->Kmw", by_error, unit.along_course(course))
        return out

    def departure(
        self, seed: int, runs: Sequence[int], lanes: int, shift: dict[int, np.ndarray] | None = None
    ) -> PathDeviation:
        """Deviations of the runs from the route without guidance or go-around, in the first of so many lanes; further
        lanes repeat the last run. shift: see `Disturbance.drawn`."""
        others = lanes - len(runs)
        rngs = {}
        for number in self.disturbance.walks:
            own = [generator(seed, run, "air", number) for run in runs]
            rngs[number] = (*own, *(own[-1] for _ in range(others)))
        return _repeated(self.disturbance.drawn(rngs, len(runs), lanes, shift), len(runs))

    def commanded(
        self, departure: PathDeviation, count: int, known: GuidanceErrors | None = None, begin: np.ndarray | None = None
    ) -> PathDeviation:
        """Deviations of so many runs from the route, by those without guidance or go-around; further lanes repeat the
        last run.

        known: errors of the estimates that steer, None before they are known. begin: (W,) when they begin a go-around,
        s, inf for none; None before it is known.
        """
        departure = self.disturbance.guided(departure, known)
        if begin is not None:
            departure = self.end.broken_off(departure, begin)
        return _repeated(departure, count)

    def flown(self, departure: PathDeviation) -> DispersedTrajectories:
        """Trajectories of runs with these deviations."""
        frame, lanes = self.trajectory.frame, departure.way.shape[2]
        dtheta, dv = (np.empty((*m.shape, lanes)) for m in self.increments)
        along, step = self.disturbance, float(self.disturbance.time[1] - self.disturbance.time[0])
        deviate(
            step, self.half.specific_force, self.half.angular_rate, self.axes_half, along.gradient,
            frame.axes.T @ EARTH_RATE, in_lanes(departure.way), in_lanes(departure.turn), *self.increments,
            in_lanes(dtheta), in_lanes(dv),
        )  # fmt: skip
        way, turn = departure.at(self.at_filter.time)
        there = deviated(self.at_filter, frame, way, turn, force=False)
        if np.array_equal(self.at_fixes.time, self.at_filter.time[1:]):
            at_fixes = _without_first(there, lanes)
        else:
            at_fixes = deviated(self.at_fixes, frame, *departure.at(self.at_fixes.time), force=False)
        antenna, antenna_velocity = (_lanes(m, lanes) for m in antenna_motion(at_fixes, self.lever_arm))
        ranges, rates = self._ranges(antenna, antenna_velocity)
        return DispersedTrajectories(
            dtheta,
            dv,
            llh=_lanes(there.llh, lanes),
            velocity=_lanes(there.velocity_ned, lanes),
            quaternion=_lanes(there.quaternion, lanes),
            deviation=np.stack([way[:, 1], way[:, 0], -way[:, 2]], axis=1),
            antenna=antenna,
            antenna_velocity=antenna_velocity,
            ranges=ranges,
            rates=rates,
            departure=departure,
            motion=there,
        )

    def of_run(self, flown: DispersedTrajectories, lane: int) -> RunTrajectory:
        """Trajectory of one run."""
        return RunTrajectory(self.route, flown.departure, lane)

    def _ranges(self, antenna: np.ndarray, antenna_velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """True ranges and range rates (e, s, W): those of the route, and by how much the distances differ."""
        signals = self.signals
        e, s, lanes = *signals.range.shape, antenna.shape[2]
        ranges, rates = np.empty((e, s, lanes)), np.empty((e, s, lanes))
        ranges_from(self.sources, signals.velocity, *(in_lanes(m) for m in (antenna, antenna_velocity, ranges, rates)))
        old, faster = np.empty((e, s)), np.empty((e, s))
        ranges_from(self.sources, signals.velocity, signals.antenna, signals.antenna_velocity, old, faster)
        return ranges + (signals.range - old)[..., None], rates + (signals.range_rate - faster)[..., None]


def _repeated(departure: PathDeviation, count: int) -> PathDeviation:
    """Deviations of so many runs; further lanes repeat the last."""
    for each in (departure.way, departure.turn, departure.gust, departure.displaced):
        each[..., count:] = each[..., count - 1 : count]
    return departure


def _without_first(motion: Motion, lanes: int) -> Motion:
    """The motion of runs one after the other (W m) without the first time of each."""

    def rest(values: np.ndarray) -> np.ndarray:
        return values.reshape(lanes, -1, *values.shape[1:])[:, 1:].reshape(-1, *values.shape[1:])

    out = Motion(**{name: rest(getattr(motion, name)) for name in Motion.__dataclass_fields__})
    # what has been derived is not derived again
    vars(out).update(c_ne=rest(motion.c_ne), c_nb=rest(motion.c_nb))
    return out


def _lanes(values: np.ndarray, lanes: int) -> np.ndarray:
    """Numbers of runs one after the other (W m, k) as lanes (m, k, W)."""
    return np.ascontiguousarray(values.reshape(lanes, -1, *values.shape[1:]).transpose(1, 2, 0))
