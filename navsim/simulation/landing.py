"""Simulation of a landing, block by block as in figure 1 of the landing paper.

    route -> signal simulator with pseudolites -> receiver -> fix ┐
    route -> inertial sensors -> SINS ────────────────────────────┴-> Kalman filter -> accuracy

`World` contains what all runs of a scenario share: the route, and the signals (`gnss.signals`). `fly` simulates one
run. If the air moves each run off the route, `simulation.dispersed_trajectory` has its own trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.filter import eskf, states
from navsim.filter.design import Beliefs, clock_sigma
from navsim.filter.estimate import fly as fly_filter
from navsim.filter.estimate import in_all_lanes, is_smoother
from navsim.filter.measurement_models import FIX, RANGE, FixTable, Measurements, RangeTable
from navsim.filter.records import (
    Account,
    Events,
    FilterModel,
    ImuData,
    State,
    Truth,
    by_epoch,
    empty_account,
    schedule,
    start,
)
from navsim.filter.states import MOST
from navsim.geodesy.attitude import dcm_from_quaternion, roll_pitch_yaw
from navsim.geodesy.earth import llh_from_ecef
from navsim.gnss import dll, pseudorange
from navsim.gnss.dll import ReflectionErrors
from navsim.gnss.dop import MAX_CLOCKS, dops, geometry_covariance
from navsim.gnss.heavy_tailed import HeavyTailedNoise
from navsim.gnss.receiver import Receiver, wander
from navsim.gnss.signals import Environment, build_signals, true_positions
from navsim.gnss.sky import enu_matrix
from navsim.integrity import monitoring
from navsim.integrity.exclusion import NOTHING
from navsim.integrity.fix_exclusion import Excluder, SettledFixes
from navsim.integrity.fixes import ReceiverFixes, range_residuals, solved
from navsim.sensors import imu
from navsim.simulation.aiding import Aid, aids_of
from navsim.simulation.correlated_errors import FixErrors, RangeErrors, as_noise
from navsim.simulation.dispersed_trajectory import Flown, Ways
from navsim.simulation.inertial_states import true_values
from navsim.simulation.range_curvature import (
    NEGLIGIBLE,
    Curvature,
    NearPass,
    diagonal_bound,
    has_near_sources,
    near_passes,
    shifted,
)
from navsim.statistics import noise
from navsim.statistics.random_streams import generator
from navsim.trajectory.air import Air
from navsim.trajectory.guidance import Held
from navsim.trajectory.kinematics import Motion, Moving, Trajectory

CARRIER_SIGMA = 3e-3
"""1 sigma of a carrier phase measurement, m."""


@dataclass(frozen=True)
class InitialErrors:
    """1 sigma per axis of the initial errors, rad, m, m/s; `fixed` (9,) position, velocity, attitude errors
    (truth - estimate) instead of drawn ones."""

    attitude: float
    position: float
    velocity: float
    fixed: np.ndarray | None = None


@dataclass(frozen=True)
class World:
    """Simulation inputs that all runs of a scenario share."""

    imu_time: np.ndarray
    """(n + 1,) s."""
    dtheta: np.ndarray
    """(n, 3) exact angle increments, rad."""
    dv: np.ndarray
    """(n, 3) exact velocity increments, m/s."""
    truth: Motion
    """Motion at `imu_time`."""
    signals: pseudorange.Signals
    clock: np.ndarray
    """(e, 2) receiver clock offset (m) and drift (m/s) at the fixes, without noise."""
    clock_density: tuple[float, float]
    """Noise densities of the clock (`gnss.receiver.wander`)."""
    clock_at_filter: np.ndarray
    """(e + 1, 2) clock at the filter's outputs, without noise."""
    scale_offsets: np.ndarray
    """(MAX_CLOCKS,) offset of each time scale in the pseudoranges of its sources, m."""
    start: np.ndarray
    at_filter: Motion
    """Motion at the filter's e + 1 output times: 0, and every fix epoch plus latency."""
    filter_index: np.ndarray
    """(e + 1,) index of the IMU sample at or just before them."""
    aids: tuple[Aid, ...]
    """Sensors beside the receiver."""
    heavier: HeavyTailedNoise | None
    """Distribution of the ranging noise if it is not Gaussian."""
    ways: Ways | None = None
    """Common data of the trajectories of runs that deviate from the route; None if all runs fly the route."""

    @property
    def filter_time(self) -> np.ndarray:
        """Times of the filter's output, s (e + 1,)."""
        return self.at_filter.time

    @cached_property
    def scales(self) -> tuple[int, ...]:
        """Numbers of the time scales of the sources that are ever received."""
        return tuple(sorted(set(self.signals.clock[self.signals.used.any(axis=0)].tolist())))

    @cached_property
    def dop(self) -> np.ndarray:
        """`dops` of the signals (e, 5)."""
        return dops(self.signals.los, self.signals.clock)

    @cached_property
    def fix_errors(self) -> FixErrors:
        """Effect of ranging errors on fixes."""
        return FixErrors.of(self.start, self.signals, *believed_measurements(self))

    @cached_property
    def antenna_enu(self) -> np.ndarray:
        """Rows (e, 3, 3) that resolve ECEF along east, north and up at the antenna."""
        return enu_matrix(llh_from_ecef(self.signals.antenna))

    @cached_property
    def fix_covariance(self) -> np.ndarray:
        """Weighted covariance of the position fixes from the signals (e, 3, 3), ENU, m2."""
        weight = 1.0 / self.signals.fix_sigma**2
        return geometry_covariance(self.signals.los, self.signals.clock, weight)[0][:, :3, :3]


def build_world(
    trajectory: Moving,
    environment: Environment,
    receiver: Receiver,
    *,
    utc: float,
    duration: float,
    imu_rate: float,
    aiding: Sequence[Any] = (),
    air: Air | None = None,
) -> World:
    """Route and geometry of the signals.

    utc: of time 0, s from 1970-01-01. duration: s. imu_rate: Hz. Fixes after the end are omitted. aiding: models of
    sensors beside the receiver. air: disturbances that give each run its own trajectory around a `Trajectory`.
    """
    imu_time = np.arange(int(np.floor(duration * imu_rate + 1e-9)) + 1) / imu_rate
    dtheta, dv = trajectory.increments(imu_time)
    fix_time = receiver.epochs(duration, imu_rate)
    at_filter = trajectory.motion(np.concatenate([[0.0], fix_time + receiver.latency]))
    at_fixes = trajectory.motion(fix_time)
    signals, ways = build_signals(at_fixes, utc, environment), None
    if air is not None:
        assert isinstance(trajectory, Trajectory)
        sources = true_positions(environment, signals.position)
        ways = Ways.of(air, trajectory, imu_time, at_filter, at_fixes, signals, sources, environment.lever_arm)
    return World(
        imu_time=imu_time,
        dtheta=dtheta,
        dv=dv,
        truth=trajectory.motion(imu_time),
        signals=signals,
        clock=receiver.clock(fix_time),
        clock_density=receiver.clock_density,
        clock_at_filter=receiver.clock(at_filter.time),
        scale_offsets=environment.scale_offsets,
        start=trajectory.frame.origin,
        at_filter=at_filter,
        filter_index=np.searchsorted(imu_time, at_filter.time + 1e-9, side="right") - 1,
        aids=aids_of(aiding, trajectory, duration, imu_rate),
        heavier=environment.effects.heavier,
        ways=ways,
    )


@dataclass(frozen=True)
class Wander:
    """The noise of the receiver's clock in runs: offset, m, and drift, m/s, at the fixes (e, 2, W) and at the filter's
    outputs (e + 1, 2, W)."""

    at_fixes: np.ndarray
    at_filter: np.ndarray

    @classmethod
    def of(cls, world: World, seed: int, runs: Sequence[int], lanes: int) -> Wander | None:
        """Receiver clocks of runs, in the first of so many lanes; None without clock noise."""
        if not any(world.clock_density):
            return None
        fixed, answered = world.signals.time, world.filter_time
        time, where = np.unique(np.concatenate([fixed, answered]), return_inverse=True)
        wandered = np.empty((fixed.size + answered.size, 2, lanes))
        for lane, run in enumerate(runs):
            wandered[..., lane] = wander(world.clock_density, time, generator(seed, run, "clock"))[where]
        wandered[..., len(runs) :] = wandered[..., len(runs) - 1 : len(runs)]
        return cls(wandered[: fixed.size], wandered[fixed.size :])


@dataclass(frozen=True)
class Run:
    """Output of one run, or of several along a first axis. Shapes and units are those of the result file without the
    run axis.

    Arrays of n samples, e fixes, o outputs, s sources, a aiding measurements. Those that do not apply are empty.
    """

    pseudorange: np.ndarray
    """(e, s) m; empty if measurements are not kept."""
    range_rate: np.ndarray
    """(e, s) m/s, likewise."""
    fix_llh: np.ndarray
    """(e, 3) fixes of the receiver."""
    fix_velocity: np.ndarray
    """(e, 3) NED, m/s."""
    fix_clock: np.ndarray
    """Clock estimates of the fixes, m."""
    error: np.ndarray
    """(e + 1, n) truth minus estimate at the outputs."""
    sigma: np.ndarray
    """(e + 1, n) filter sigma."""
    cross: np.ndarray
    """(e + 1, 6) elements NE, ND, ED of the covariance of position, then of attitude: they allow a later rotation of
    axes."""
    nees: np.ndarray
    """(e + 1,) of all states."""
    nees_position_velocity: np.ndarray
    """(e + 1,) of position and velocity."""
    nees_group: np.ndarray
    """(e + 1, g) of each group of three states."""
    innovation_squared: np.ndarray
    """(e,) normalised innovation squared."""
    degrees: np.ndarray
    """(e,) its degrees of freedom."""
    status: np.ndarray
    """(e,) not used, used or rejected."""
    range_status: np.ndarray
    """(e, s) status of each range; empty unless the filter is tightly coupled."""
    aided: np.ndarray
    """(a, MOST) measurements of sensors beside the receiver, in the order of `World.aids`; nan after their numbers."""
    aided_squared: np.ndarray
    """(a,) as of the fixes."""
    aided_degrees: np.ndarray
    """(a,) as of the fixes."""
    aided_status: np.ndarray
    """(a,) as of the fixes."""
    monitor_statistic: np.ndarray
    """(e,) test statistic of the monitor, see `Watched`."""
    monitor_status: np.ndarray
    """(e,) result of the test."""
    watched_error: np.ndarray
    """(e, 2) sizes of the monitored horizontal and vertical errors, m."""
    monitor_excluded: np.ndarray
    """(e,) number of the exclusion candidate, -1 for none; empty without exclusion."""
    monitor_level: np.ndarray
    """(e, 2) protection levels of the fixes after exclusion, nan without a test; empty without exclusion."""
    innovation_ratio: np.ndarray
    """(e,) see `InnovationTest`; empty without the test."""
    deviation: np.ndarray
    """(o, 3) of the trajectory from the route, lateral, along, vertical, m. Empty if all runs fly the route."""
    attitude: np.ndarray
    """(o, 3) true roll, pitch, yaw, rad, likewise."""
    antenna: np.ndarray
    """(e, 3) true antenna position at fixes, ECEF, m, likewise."""
    gust: np.ndarray
    """Wind minus the mean wind (o, 3), m/s: right of the course, along it, up. Empty if all runs fly the route."""
    delta_angle: np.ndarray
    """Angle increments measured by the gyros (n, 3), rad. Empty if measurements are not kept."""
    delta_velocity: np.ndarray
    """Velocity increments measured by the accelerometers (n, 3), m/s. Empty if measurements are not kept."""
    start_llh: np.ndarray
    """Initial position of the filter (3,), rad, rad, m."""
    start_velocity: np.ndarray
    """Initial velocity of the filter (3,), NED, m/s."""
    start_rpy: np.ndarray
    """Initial roll, pitch, yaw of the filter (3,), rad."""
    filter_fix_llh: np.ndarray
    """Fixes (e, 3) used by a loosely coupled filter, nan where it uses none. Empty if measurements are not kept, or the
    filter is tightly coupled."""
    filter_fix_velocity: np.ndarray
    """Velocities (e, 3) of these fixes, NED, m/s, nan where the filter uses none."""
    filter_fix_covariance: np.ndarray
    """Their covariance (e, 6, 6) in the filter model, position and velocity, NED."""
    clipped: np.ndarray
    """(2,) samples of gyros and of accelerometers beyond their range; empty without a range."""

    def one(self, which: int) -> Run:
        """One of several runs."""
        return Run(**{name: getattr(self, name)[which] for name in self.__dataclass_fields__})


def initial_errors(flight: Flight, seed: int, run: int) -> np.ndarray:
    """Errors of the navigation states at time 0 (9,), truth - estimate: drawn or fixed."""
    errors = flight.initial
    sigma = np.repeat([errors.position, errors.velocity, errors.attitude], 3)
    drawn = generator(seed, run, "initial").standard_normal(states.SENSORS) * sigma
    return drawn if errors.fixed is None else errors.fixed


def initial_clock_errors(flight: Flight, seed: int, run: int) -> np.ndarray:
    """Errors of the clock's states at time 0 (c,), truth - estimate."""
    sigma = clock_sigma(len(flight.scales))
    return generator(seed, run, "clock", 1).standard_normal(sigma.size) * sigma


def initial_estimate(flight: Flight, errors: np.ndarray, flown: Flown | None = None) -> np.ndarray:
    """Navigation states at time 0 (NAV_N, W) of runs with these `initial_errors` (9, W), on their trajectories."""
    nav = in_all_lanes(exact_start(flight.world.at_filter))
    if flown is not None:
        nav[states.NAV_LLH : states.NAV_VEL] = flown.llh[0]
        nav[states.NAV_VEL : states.NAV_QUAT] = flown.velocity[0]
        nav[states.NAV_QUAT : states.NAV_HELD] = flown.quaternion[0]
    eskf.displace(in_lanes(nav), in_lanes(-errors))
    return nav


def with_clock(flight: Flight, nav: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """Navigation states (NAV_N, ...), other sensor states that are zero, and those of the clock (c, ...)."""
    if not flight.scales:
        return nav
    out = np.zeros((states.NAV_SENSORS + flight.covariance.shape[0] - states.SENSORS, *nav.shape[1:]))
    out[: nav.shape[0]], out[-clock.shape[0] :] = nav, clock
    return out


def exact_clock(flight: Flight) -> np.ndarray:
    """True clock states of the filter at its outputs, without noise (o, c)."""
    now, scales = flight.world.clock_at_filter, list(flight.scales)
    if not scales:
        return np.empty((now.shape[0], 0))
    return np.concatenate([now[:, :1] + flight.world.scale_offsets[scales], now[:, 1:]], axis=1)


def exact_start(truth: Motion) -> np.ndarray:
    """The navigation state at time 0 without error (NAV_N,)."""
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_LLH : states.NAV_VEL] = truth.llh[0]
    nav[states.NAV_VEL : states.NAV_QUAT] = truth.velocity_ned[0]
    nav[states.NAV_QUAT : states.NAV_HELD] = truth.quaternion[0]
    return nav


def measured(world: World, seed: int, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Pseudoranges (m) and range rates (m/s) of a run on the route (e, s), nan if missing."""
    ranges, rates, phases = _measure(
        world, seed, (run,), 1, Wander.of(world, seed, (run,), 1), lasting_errors(world, seed, (run,)), None
    )
    return smoothed(world, ranges, phases)[..., 0], rates[..., 0]


def smoothed(world: World, ranges: np.ndarray, phases: np.ndarray | None) -> np.ndarray:
    """Pseudoranges (e, s, W) as the receiver uses them: smoothed by the carrier where it does that."""
    if phases is None or world.signals.smoothing is None:
        return ranges
    each = range(ranges.shape[-1])
    return np.stack([dll.smooth(ranges[..., k], phases[..., k], world.signals.smoothing) for k in each], axis=-1)


def lasting_errors(world: World, seed: int, runs: Sequence[int]) -> np.ndarray | None:
    """Time-correlated ranging errors of so many runs, in the sigma of their kinds (k, e, s, W); None without."""
    if world.signals.lasting is None:
        return None
    return world.signals.lasting.drawn(world.signals.time, [generator(seed, run, "lasting") for run in runs])


def _measure(
    world: World,
    seed: int,
    runs: Sequence[int],
    lanes: int,
    wandered: Wander | None,
    lasting: np.ndarray | None,
    flown: Flown | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Pseudoranges, range rates and carrier phases of runs in the first of so many lanes, see `Inputs`.

    lasting: from `lasting_errors`.
    """
    signals = world.signals
    e, s = signals.range.shape
    # what is added below goes to idle lanes, too, where no noise does
    ranges, rates = np.zeros((e, s, lanes)), np.zeros((e, s, lanes))
    delay = signals.delay[..., None]
    if signals.space is not None:
        of_space = (generator(seed, run, "space").standard_normal((s, 4)) for run in runs)
        late = [signals.delay + np.einsum("esk,sk->es", signals.space, drawn) for drawn in of_space]
        delay = np.stack(late, axis=-1)
    if signals.offset is not None:
        scales = signals.offset.shape[1]
        apart = [signals.offset @ generator(seed, run, "space", 1).standard_normal(scales) for run in runs]
        delay = delay + np.stack(apart, axis=-1)[None]
    if lasting is not None and signals.lasting is not None:
        # as they are after smoothing: in code and carrier alike
        late = [np.sum(signals.lasting.sigma * lasting[..., lane], axis=0) for lane in range(len(runs))]
        delay = delay + np.stack(late, axis=-1)
    faster = None
    if signals.wandering is not None:
        rngs = [generator(seed, run, "clock", 2) for run in runs]
        late, faster = signals.wandering.drawn(signals.time, rngs)
        delay = delay + late
    sigma = signals.sigma[..., None]
    if world.heavier is not None:
        # of a branch: the stream itself is that of Gaussian noise
        of_runs = (generator(seed, run, "measurements", 1) for run in runs)
        sigma = sigma * np.stack([world.heavier.scales(rng, (e, s)) for rng in of_runs], axis=-1)
    true = (signals.range[..., None], signals.range_rate[..., None]) if flown is None else (flown.ranges, flown.rates)
    noise.measure(
        _generators(seed, runs, "measurements", lanes), len(runs), true[0], delay, sigma, true[1], signals.rate_sigma,
        signals.used, world.clock, ranges, rates,
    )  # fmt: skip
    if faster is not None:
        rates[..., : len(runs)] += faster
    if wandered is not None:
        ranges += wandered.at_fixes[:, None, 0]
        rates += wandered.at_fixes[:, None, 1]
    if signals.smoothing is None:
        return ranges, rates, None
    phases = np.zeros((e, s, lanes))
    for lane, run in enumerate(runs):
        drawn = generator(seed, run, "carrier").standard_normal((e, s))
        longer = delay[..., min(lane, delay.shape[2] - 1)]
        if flown is not None:
            longer = longer + (flown.ranges[..., lane] - signals.range)
        phases[..., lane] = carrier(world, longer) + CARRIER_SIGMA * drawn
    if wandered is not None:
        phases += wandered.at_fixes[:, None, 0]
    return ranges, rates, phases


def _generators(seed: int, runs: Sequence[int], stream: str, lanes: int) -> tuple[np.random.Generator, ...]:
    """A random stream of each run; further lanes get that of the last run and draw nothing."""
    own = [generator(seed, run, stream) for run in runs]
    return (*own, *(own[-1] for _ in range(lanes - len(own))))


def carrier(world: World, delay: np.ndarray) -> np.ndarray:
    """Carrier phases without noise (e, s), m, where the code is late by delay (e, s), m; ambiguities are left out."""
    return world.signals.range + delay - world.signals.divergence + world.clock[:, :1]


def without_noise(world: World) -> tuple[np.ndarray, np.ndarray]:
    """`measured` without random errors: systematic errors only."""
    ranges, rates, phases = expected_measurements(world)
    return smoothed(world, ranges[..., None], None if phases is None else phases[..., None])[..., 0], rates


def believed_measurements(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Pseudoranges and range rates (e, s) without any error: they agree with the receiver's own positions of the
    sources."""
    signals = world.signals
    offset = signals.position - signals.antenna[:, None]
    distance = np.linalg.norm(offset, axis=2)
    rate = np.sum(offset * (signals.velocity - signals.antenna_velocity[:, None]), axis=2) / distance
    ranges = np.where(signals.used, distance + world.clock[:, :1], np.nan)
    return ranges, np.where(signals.used, rate + world.clock[:, 1:], np.nan)


def expected_measurements(world: World) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Pseudoranges, range rates and carrier phases (e, s) as of `Inputs` where nothing is drawn."""
    signals = world.signals
    ranges = np.where(signals.used, signals.range + signals.delay + world.clock[:, :1], np.nan)
    rates = np.where(signals.used, signals.range_rate + world.clock[:, 1:], np.nan)
    return ranges, rates, None if signals.smoothing is None else carrier(world, signals.delay)


def receiver_fixes(world: World, ranges: np.ndarray, rates: np.ndarray) -> ReceiverFixes:
    """The receiver's fixes from measurements (e, s), or of lanes (e, s, W)."""
    lanes = (m if m.ndim == 3 else in_all_lanes(m) for m in (ranges, rates))
    out = solved(world.start, world.signals, *lanes)
    return out if ranges.ndim == 3 else ReceiverFixes(*(m[..., 0].copy() for m in out))


@dataclass(frozen=True)
class Flight:
    """A landing that a filter can fly any number of times."""

    world: World
    initial: InitialErrors
    """True initial errors."""
    gyro: imu.Triad
    """True gyros."""
    accel: imu.Triad
    """True accelerometers."""
    beliefs: Beliefs
    """Filter model."""
    covariance: np.ndarray
    """(n, n) initial covariance of the filter."""
    events: Events
    """In the order of the filter."""
    weighed: np.ndarray
    """(e, 1) event of each fix, or (e, s) of each range; -1 for a range that is not received."""
    model: FilterModel
    """`beliefs` for the kernels."""
    start: InitialErrors
    """1 sigma of the initial errors in the filter model."""
    watching: monitoring.Monitoring | None = None
    """Monitor; None without."""
    second_order: bool = True
    """Whether the filter model includes second-order errors near sources."""

    @cached_property
    def bank(self) -> monitoring.Bank | None:
        """Filters that monitor the filter, None without."""
        return None if self.watching is None or self.watching.bank is None else self.watching.bank(self)

    @cached_property
    def snapshot(self) -> monitoring.Snapshot | None:
        """Monitor of the fixes, None without."""
        return None if self.watching is None or self.watching.bank else self.watching.over(self.world.signals)

    @property
    def monitor(self) -> monitoring.Watcher | None:
        """Monitor of the landing, None without."""
        return self.snapshot or self.bank

    @property
    def expected(self) -> tuple[monitoring.ExpectedFault, ...]:
        """The faults that it expects."""
        return () if self.watching is None else self.watching.expected(self.world.signals)

    @property
    def limited(self) -> bool:
        """Whether an inertial sensor has a range."""
        return any(math.isfinite(triad.further.largest) for triad in (self.gyro, self.accel))

    @property
    def scales(self) -> tuple[int, ...]:
        """Numbers of the time scales that the filter has a bias of the clock for."""
        return self.beliefs.followed(self.world.scales)

    @property
    def candidates(self) -> tuple[monitoring.ExpectedFault, ...]:
        """Candidates for exclusion after an alarm."""
        return () if self.watching is None else self.watching.candidates(self.world.signals)

    @property
    def drops(self) -> bool:
        """Whether its filter does without fixes with an alarm, or their ranges."""
        return self.watching is not None and self.watching.drops

    @cached_property
    def excluder(self) -> Excluder | None:
        """Excludes candidates, None without exclusion."""
        if self.watching is None or self.watching.exclusion == monitoring.NO_EXCLUSION:
            return None
        return Excluder(self.watching, self.world.signals, self.world.start, self.world.antenna_enu)

    @cached_property
    def range_errors(self) -> RangeErrors:
        """Time-correlated errors of ranges as states, where a tightly coupled filter follows them."""
        assert self.beliefs.lasting is not None
        return RangeErrors(self.world.signals, self.beliefs.lasting)

    @cached_property
    def reflection_sigma(self) -> np.ndarray | None:
        """1 sigma of reflection errors (e, s), m, about their mean, as noise in the filter model; their correlation
        enlarges it.

        None without reflections, or if the filter model neglects them.
        """
        reflections, time = self._reflections, self.world.signals.time
        if reflections is None or time.size < 2:
            return None
        duration, interval = float(time[-1] - time[0]), float(np.median(np.diff(time)))
        return np.asarray(reflections.sigma * np.sqrt(as_noise(reflections.time, duration, interval)))

    @property
    def _reflections(self) -> ReflectionErrors | None:
        """Reflection errors in the filter model."""
        return self.world.signals.reflections if self.beliefs.reflections else None

    @cached_property
    def fix_bias(self) -> np.ndarray | None:
        """The errors of fixes (e, MOST) that a loosely coupled filter takes off: the mean of second-order errors, and
        of errors by reflections over all phases; None of none."""
        out = None if self.curvature is None else self.curvature.mean
        if self._reflections is not None:
            mean = np.where(self.world.signals.used, self._reflections.mean, 0.0)
            by_reflections = np.einsum("ems,es->em", self.world.fix_errors.by_range, mean)
            out = by_reflections if out is None else out + by_reflections
        return out

    @property
    def range_bias(self) -> np.ndarray:
        """The errors of ranges (e, s), m, that a tightly coupled filter takes off: the mean of those by reflections."""
        reflections = self._reflections
        return np.zeros_like(self.world.signals.range) if reflections is None else reflections.mean

    @property
    def range_error_sigma(self) -> np.ndarray:
        """1 sigma of the errors of each group (e, s, g), m, that a tightly coupled filter follows; of no size where it
        follows none."""
        lasting = self.beliefs.lasting
        if lasting is None or not lasting.followed or self.world.signals.lasting is None:
            return np.empty((*self.world.signals.used.shape, 0))
        return self.range_errors.size

    @cached_property
    def lasting_roots(self) -> np.ndarray:
        """Effect of estimated time-correlated errors on fixes (e, MOST, k)."""
        lasting = self.beliefs.lasting
        if lasting is None or not lasting.followed:
            return np.empty((0, MOST, 0))
        return self.beliefs.sigma_scale * self.world.fix_errors.roots(lasting.groups)

    @cached_property
    def lasting_projections(self) -> np.ndarray:
        """Effect of errors of each kind and source on those (e, k, kinds, s), if the filter estimates them."""
        assert self.beliefs.lasting is not None
        return self.world.fix_errors.projections(self.beliefs.lasting.groups) / self.beliefs.sigma_scale

    def lasting_of_states(self, epoch: int) -> np.ndarray:
        """Effect (n, k, s) of time-correlated errors of variance one, of each kind and source, on the filter's states
        for them.

        Of an epoch; states in units of their sigma in the filter model. Empty if the filter estimates none.
        """
        lasting, signals = self.beliefs.lasting, self.world.signals
        assert signals.lasting is not None
        if lasting is None or not lasting.followed:
            return np.empty((0, *signals.lasting.sigma.shape[::2]))
        if not self.beliefs.tight:
            return np.asarray(self.lasting_projections[epoch])
        return self.range_errors.projections(epoch) / self.beliefs.sigma_scale

    @cached_property
    def lasting_noise(self) -> np.ndarray:
        """Covariance of the white part of each fix (e, MOST, MOST), m2, beside estimated time-correlated errors."""
        assert self.beliefs.lasting is not None
        errors = self.world.fix_errors
        return errors.noise + errors.beside(self.beliefs.lasting.groups)

    @cached_property
    def noise_along_route(self) -> np.ndarray | None:
        """Covariance of fixes (e, MOST, MOST) from the geometry of the route; None if the filter uses the receiver's
        own.

        The receiver computes its covariance at the fix, which near a source depends on the error of the fix.
        """
        lasting, curvature = self.beliefs.lasting, self.curvature
        if lasting is not None and lasting.followed:
            noise = self.lasting_noise
        elif curvature is None:
            return None
        else:
            errors = self.world.fix_errors
            noise = errors.noise + (0.0 if lasting is None else errors.of_kinds(lasting.factor))
        return noise if curvature is None else noise + curvature.noise

    @cached_property
    def _second_order(self) -> Curvature | None:
        """Second-order errors of fixes, None if negligible.

        If the filter uses ranges, only those due to time-correlated errors; the others average out.
        """
        signals = self.world.signals
        if not has_near_sources(signals):
            return None
        noise, lasting = signals.noise_sigma, np.zeros_like(signals.fix_sigma)
        if signals.smoothing is not None:
            noise, lasting = lasting, signals.fix_sigma
        elif signals.lasting is not None:
            lasting = signals.lasting.total
        noise = np.zeros_like(noise) if self.beliefs.tight else noise
        found = self.world.fix_errors.curvature(noise, lasting, MOST if self.beliefs.velocity else 3)
        return found if found.squares > NEGLIGIBLE else None

    @property
    def _has_second_order(self) -> bool:
        """Whether the filter model includes second-order errors.

        It does not if the sources of a fix may differ from those of the route: monitoring filters have fewer, and
        exclusion removes some.
        """
        watching = self.watching
        other = watching is not None and (watching.bank or (self.excluder and not self.beliefs.tight))
        return self.second_order and not other and self._second_order is not None

    @property
    def curvature(self) -> Curvature | None:
        """Second-order errors of fixes in a loosely coupled filter model; None if negligible."""
        return self._second_order if self._has_second_order and not self.beliefs.tight else None

    @cached_property
    def range_curvature(self) -> Curvature | None:
        """Second-order errors of the ranges (m, 2) of all epochs and sources in a tightly coupled filter model; None if
        negligible.

        They follow from the filter's own position errors, to first order.
        """
        if not self._has_second_order or not self.beliefs.tight:
            return None
        from navsim.simulation.landing_covariance import curvature_of_ranges

        return curvature_of_ranges(replace(self, second_order=False))

    @cached_property
    def near_passes(self) -> tuple[NearPass, ...]:
        """Sources that are passed so near that covariances are not right there: to second order, where the filter knows
        of that part, because the third counts; to first order, where it does not."""
        if self._second_order is None:
            return ()
        signals = self.world.signals
        sigma = signals.lasting.total if self.beliefs.tight and signals.lasting is not None else signals.fix_sigma
        order = 2 if self._has_second_order else 1
        every = near_passes(signals, self.world.fix_errors.of_ranges(sigma), order)
        return tuple(one for one in every if one.counts)

    @property
    def range_sigma(self) -> np.ndarray:
        """1 sigma of pseudoranges (e, s), m, as noise in a tightly coupled filter model."""
        signals, lasting = self.world.signals, self.beliefs.lasting
        sigma = signals.fix_sigma
        if lasting is not None and signals.lasting is not None:
            of_kinds = 0.0 if lasting.followed else np.einsum("k,kes->es", lasting.factor, signals.lasting.sigma**2)
            sigma = np.sqrt(signals.noise_sigma**2 + of_kinds)
        return sigma if self.reflection_sigma is None else np.hypot(sigma, self.reflection_sigma)

    @cached_property
    def _without(self) -> dict[int, Flight]:
        """Cache of `without`."""
        return {}

    def without(self, candidate: int) -> Flight:
        """The flight without the sources of one of `candidates`, for the filter model of fixes made without them."""
        if candidate not in self._without:
            signals = self.world.signals
            kept = ~np.isin(signals.names, self.candidates[candidate].sources)
            world = replace(self.world, signals=replace(signals, used=signals.used & kept))
            self._without[candidate] = replace(self, world=world)
        return self._without[candidate]

    def over(self, world: World) -> Flight:
        """Copy of this flight with another world."""
        return prepare(world, self.initial, self.gyro, self.accel, self.beliefs, self.start, self.watching)


def prepare(
    world: World,
    initial: InitialErrors,
    gyro: imu.Triad,
    accel: imu.Triad,
    beliefs: Beliefs,
    start: InitialErrors,
    watching: monitoring.Monitoring | None = None,
) -> Flight:
    """A flight; start: 1 sigma of the initial errors that the filter believes in."""
    if beliefs.tight and beliefs.lasting is not None and beliefs.lasting.followed:
        step = float(world.imu_time[1] - world.imu_time[0])
        errors = () if world.signals.lasting is None else RangeErrors(world.signals, beliefs.lasting).blocks(step)
        beliefs = beliefs.with_range_errors(errors)
    covariance = beliefs.covariance(start.position, start.velocity, start.attitude, world.scales)
    model = beliefs.model(scales=world.scales)
    return Flight(world, initial, gyro, accel, beliefs, covariance, *_order(world, beliefs), model, start, watching)


def _order(world: World, beliefs: Beliefs) -> tuple[Events, np.ndarray]:
    """The events of a flight, and those of its fixes or ranges, see `Flight`."""
    # the filter knows when a fix came and how old it believes it to be
    arrival = world.filter_time[1:]
    valid = np.maximum(arrival - beliefs.latency, 0.0)
    smooths = is_smoother(beliefs.kind)
    known = valid if smooths else arrival
    heard = world.signals.used if beliefs.tight else np.ones((arrival.size, 1), bool)
    epoch, kind = np.nonzero(heard)[0], RANGE if beliefs.tight else FIX
    events = schedule(
        world.filter_time, (kind, valid[epoch], known[epoch]),
        *((aid.sensor.kind, aid.valid, aid.valid if smooths else aid.arrival) for aid in world.aids),
    )  # fmt: skip
    weighed = np.full(heard.shape, -1)
    weighed[heard] = events.rows(kind)
    return events, weighed


def table_of_fixes(beliefs: Beliefs, llh: np.ndarray, velocity: np.ndarray, covariance: np.ndarray) -> FixTable:
    """Fixes (m, 3), (m, 3), (m, 6, 6) as the filter takes them."""
    used = velocity if beliefs.velocity else np.full_like(velocity, np.nan)
    believed = covariance if beliefs.sigma_scale == 1.0 else beliefs.sigma_scale**2 * covariance
    return FixTable(llh, used, believed, beliefs.lever_arm)


def table_of_all_fixes(
    flight: Flight, llh: np.ndarray, velocity: np.ndarray, covariance: np.ndarray, epochs: slice = slice(None)
) -> FixTable:
    """Table of the fixes (e, 3), (e, 3), (e, 6, 6) of one run, or of lanes, with time-correlated errors of the filter
    model.

    epochs: their epochs.
    """
    lasting, bias, lanes = flight.beliefs.lasting, flight.fix_bias, covariance.ndim == 4
    noise = flight.noise_along_route
    if noise is not None:
        # a fix of another receiver may come where the scenario's has none
        known = flight.world.fix_errors.fixed[epochs, None, None]
        covariance = in_all_lanes(noise[epochs]) if lanes else np.where(known, noise[epochs], covariance)
    elif lasting is not None:
        more = flight.world.fix_errors.of_kinds(lasting.factor - 1.0)[epochs]
        covariance = covariance + (more[..., None] if lanes else more)
    if flight.reflection_sigma is not None:
        more = flight.world.fix_errors.of_ranges(flight.reflection_sigma)[epochs]
        covariance = covariance + (more[..., None] if lanes else more)
    if bias is not None:
        mean, route = bias[epochs], llh_from_ecef(flight.world.signals.antenna[epochs])
        llh = shifted(llh, -mean[:, : states.VEL], route)
        velocity = velocity - mean[:, states.VEL :].reshape(-1, 3, *(1,) * (velocity.ndim - 2))
    table = table_of_fixes(flight.beliefs, llh, velocity, covariance)
    return table if lasting is None else table._replace(lasting=flight.lasting_roots[epochs])


def table_of_ranges(flight: Flight, ranges: np.ndarray, rates: np.ndarray) -> RangeTable:
    """Table of the pseudoranges and range rates (e, s) of one run, or of lanes, for a tightly coupled filter."""
    signals, beliefs, heard = flight.world.signals, flight.beliefs, flight.world.signals.used
    bias = np.full(MAX_CLOCKS, -1)
    bias[list(flight.scales)] = np.arange(len(flight.scales))
    source, curvature = np.nonzero(heard)[1], flight.range_curvature
    sigma = np.stack([flight.range_sigma[heard], signals.fix_rate_sigma[heard]], axis=1)
    off = flight.range_bias[heard].reshape(-1, *(1,) * (ranges.ndim - 2))
    given = np.stack([ranges[heard] - off, rates[heard]], axis=1)
    if curvature is not None:
        sigma = np.sqrt(sigma**2 + diagonal_bound(curvature.noise))
        given = given - curvature.mean.reshape(*curvature.mean.shape, *(1,) * (given.ndim - 2))
    sigma = beliefs.sigma_scale * sigma
    return RangeTable(
        signals.position[heard], signals.velocity[heard], signals.range[heard], sigma[:, 0].copy(), sigma[:, 1].copy(),
        source, bias[signals.clock[source]], given[:, 0].copy(),
        given[:, 1].copy() if beliefs.velocity else np.full_like(given[:, 1], np.nan), beliefs.lever_arm,
        beliefs.sigma_scale * flight.range_error_sigma[heard],
    )  # fmt: skip


def measurements(flight: Flight, own: FixTable | RangeTable, aided: Sequence[np.ndarray]) -> Measurements:
    """All that the filter is given: fixes or ranges, and what each sensor beside the receiver measured (m, k); of one
    run, or of lanes."""
    of_aids = zip(flight.world.aids, aided, strict=True)
    kind, shape = (FIX, own.llh.shape[2:]) if isinstance(own, FixTable) else (RANGE, own.pseudorange.shape[1:])
    tables = {kind: own, **{aid.sensor.kind: aid.table(measured) for aid, measured in of_aids}}
    return Measurements.of(tables, *shape)


@dataclass(frozen=True)
class Inputs:
    """Everything drawn for WIDTH landings, one in each SIMD lane."""

    initial: np.ndarray
    """(9, W) errors of the navigation states at time 0, truth minus estimate."""
    dtheta: np.ndarray
    """(n, 3, W) measured angle increments, rad."""
    dv: np.ndarray
    """(n, 3, W) measured velocity increments, m/s."""
    ranges: np.ndarray
    """(e, s, W) pseudoranges (m), nan if missing."""
    rates: np.ndarray
    """(e, s, W) range rates (m/s), nan if missing."""
    phases: np.ndarray | None
    """(e, s, W) carrier phases (m) if they smooth the code, else None."""
    aided: tuple[np.ndarray, ...]
    """(m, k, W) of each sensor beside the receiver."""
    clock: np.ndarray
    """(c, W) estimates of the clock states at time 0."""
    sensors: np.ndarray
    """(o, k, W) true values of the filter's sensor states and clock states, for its errors."""
    clipped: np.ndarray
    """(2, W) samples of gyros and of accelerometers beyond their range."""
    flown: Flown | None = None
    """Trajectories of the runs; None if all fly the route."""


def draw(flight: Flight, seed: int, runs: Sequence[int], known: Held | None = None) -> Inputs:
    """The inputs of at most WIDTH landings, numbered `runs`, of the ensemble of `seed`; lanes that are left over have
    those of the last one. known: see `Ways.flown`. Raises ValueError for more."""
    if not 0 < len(runs) <= WIDTH:
        raise ValueError(f"1 to {WIDTH} runs can fly at once, not {len(runs)}")
    world, beliefs = flight.world, flight.beliefs
    flown = None if world.ways is None else world.ways.flown(seed, runs, WIDTH, known)
    initial = np.empty((states.SENSORS, WIDTH))
    aided = tuple(np.empty((*aid.exact.shape, WIDTH)) for aid in world.aids)
    for lane, run in enumerate(runs):
        initial[:, lane] = initial_errors(flight, seed, run)
        way = None if world.ways is None or flown is None or not aided else world.ways.of_run(flown, lane)
        for aid, of_aid in zip(world.aids, aided, strict=True):
            of_aid[..., lane] = aid.measured(seed, run, way)
    dt = world.imu_time[1] - world.imu_time[0]
    exact = (world.dtheta, world.dv) if flown is None else (flown.dtheta, flown.dv)
    dtheta, dv, errors = imu.simulate_lanes(
        _generators(seed, runs, "imu", WIDTH), len(runs), *exact, dt, flight.gyro, flight.accel, world.filter_index
    )
    sensors = true_values(beliefs.sensors.blocks, errors)
    wandered = Wander.of(world, seed, runs, WIDTH)
    lasting = lasting_errors(world, seed, runs)
    ranges, rates, phases = _measure(world, seed, runs, WIDTH, wandered, lasting, flown)
    if lasting is not None:
        sensors = np.concatenate([sensors, _lasting_of(flight, lasting)], axis=1)
    sensors = np.concatenate([sensors, _aided_errors(world, seed, runs)], axis=1)
    clock, sensors = _clock_of(flight, seed, runs, wandered, sensors)
    for lanes in (initial, dtheta, dv, sensors, ranges, rates, *([] if phases is None else [phases]), *aided, clock):
        lanes[..., len(runs) :] = lanes[..., len(runs) - 1 : len(runs)]
    return Inputs(initial, dtheta, dv, ranges, rates, phases, aided, clock, sensors, errors.clipped, flown)


def _lasting_of(flight: Flight, errors: np.ndarray) -> np.ndarray:
    """True values (o, k, W) of the time-correlated errors that the filter estimates at its outputs, from
    `lasting_errors`.

    They are those of the last fix, and before it those of the first one.
    """
    believed = flight.beliefs.lasting
    outputs = flight.world.filter_time.size
    if believed is None or not believed.followed:
        return np.empty((outputs, 0, WIDTH))
    epoch = np.maximum(np.arange(outputs) - 1, 0)
    if flight.beliefs.tight:
        mine = flight.range_errors
        out = np.empty((outputs, mine.states[0].size, WIDTH))
        for lane in range(errors.shape[-1]):
            out[..., lane] = mine.true_values(errors[..., lane])[epoch] / flight.beliefs.sigma_scale
        return out
    effect = flight.lasting_projections
    out = np.empty((outputs, effect.shape[1], WIDTH))
    for lane in range(errors.shape[-1]):
        # one run at a time: sums over its numbers have one order
        own = np.ascontiguousarray(np.moveaxis(errors[..., lane], 0, 1))
        out[..., lane] = np.sum(effect * own[:, None], axis=(2, 3))[epoch]
    return out


def _aided_errors(world: World, seed: int, runs: Sequence[int]) -> np.ndarray:
    """True values (o, k, W) of the filter's states for errors of sensors beside the receiver, at its outputs."""
    out = np.empty((world.filter_time.size, sum(len(aid.followed) for aid in world.aids), WIDTH))
    for lane, run in enumerate(runs):
        own = [aid.errors(seed, run, world.filter_time) for aid in world.aids if aid.followed]
        out[..., lane] = np.concatenate(own, axis=1) if own else out[..., lane]
    return out


def _clock_of(
    flight: Flight, seed: int, runs: Sequence[int], wandered: Wander | None, sensors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Estimates of the clock's states at time 0 (c, W), and its true values behind those of the sensors (o, k + c,
    W)."""
    if not flight.scales:
        return np.empty((0, WIDTH)), sensors
    true = in_all_lanes(exact_clock(flight))
    if wandered is not None:
        true[:, :-1] += wandered.at_filter[:, :1]
        true[:, -1:] += wandered.at_filter[:, 1:]
    clock = true[0].copy()
    for lane, run in enumerate(runs):
        clock[:, lane] -= initial_clock_errors(flight, seed, run)
    return clock, np.concatenate([sensors, true], axis=1)


def fly(flight: Flight, seed: int, runs: Sequence[int], measured: bool = True) -> Run:
    """At most WIDTH landings at once, numbered `runs`, of the ensemble of `seed`; measured: with their measurements.
    Where aircraft are steered by their estimates they fly twice: first without that, to know their errors. Raises
    ValueError for more."""
    inputs, ways = draw(flight, seed, runs), flight.world.ways
    if ways is not None and ways.follows:
        before = fly_inputs(flight, inputs, len(runs)).error[..., states.SLICES["position"]]
        of_lanes = before[np.minimum(np.arange(WIDTH), len(runs) - 1)].transpose(1, 2, 0)
        inputs = draw(flight, seed, runs, ways.known(of_lanes))
    return fly_inputs(flight, inputs, len(runs), measured)


NO_FIXES = FixTable(np.empty((0, 3, WIDTH)), np.empty((0, 3, WIDTH)), np.empty((0, MOST, MOST, WIDTH)), np.zeros(3))
"""A table of fixes of lanes without any."""
_ROWS = 64
"""Numbers of a run that are taken out of its lane before those of the next: 4 kB of eight lanes."""


@kernel
def _take_apart(lanes: np.ndarray, runs: np.ndarray) -> None:
    """Runs (r, m) out of the first lanes of (m, W)."""
    count, numbers = runs.shape
    for first in range(0, numbers, _ROWS):
        for run in range(count):
            for row in range(first, min(first + _ROWS, numbers)):
                runs[run, row] = lanes[row, run]


def fly_inputs(flight: Flight, inputs: Inputs, count: int, measured: bool = False) -> Run:
    """Run the filter on these inputs; returns the first `count` landings, with their measurements if requested."""
    world, beliefs = flight.world, flight.beliefs
    n = flight.covariance.shape[0]
    nav = with_clock(flight, initial_estimate(flight, inputs.initial, inputs.flown), inputs.clock)
    ranges, rates = smoothed(world, inputs.ranges, inputs.phases), inputs.rates
    fixes = receiver_fixes(world, ranges, rates)
    antenna = in_all_lanes(world.signals.antenna) if inputs.flown is None else inputs.flown.antenna
    watched = Watched.of_fixes(flight, antenna, ranges, fixes).settled(flight, antenna, ranges, rates, fixes)
    llh, velocity, clocks, cov = fixes
    if beliefs.tight:
        tables = measurements(flight, table_of_ranges(flight, watched.trusted(flight, ranges), rates), inputs.aided)
    else:
        given = np.where((watched.status == monitoring.ALARM)[:, None], np.nan, llh) if flight.drops else llh
        table = table_of_all_fixes(flight, given, velocity, cov)
        for candidate in np.unique(watched.excluded[watched.excluded != NOTHING]).astype(int):
            mine = watched.excluded == candidate
            made = table_of_all_fixes(flight.without(candidate), given, velocity, cov)
            for all_fixes, without in zip(table[:3], made[:3], strict=True):
                np.copyto(all_fixes, without, where=mine.reshape(len(mine), *[1] * (all_fixes.ndim - 2), -1))
        tables = measurements(flight, table, inputs.aided)

    account = empty_account(
        _truth(world, inputs), n, flight.events.time.size, WIDTH,
        single=n - 3 * len(states.slices(beliefs.sensors.blocks)), innovations=flight.bank is not None,
    )  # fmt: skip
    start_ = begun(flight, nav, in_all_lanes(flight.covariance))
    fly_filter(ImuData(world.imu_time, inputs.dtheta, inputs.dv), tables, flight.events, start_, flight.model, account)
    if flight.bank is not None:
        watched = Watched.of_filter(flight, account, fixes, ranges, rates)

    def of_runs(lanes: np.ndarray) -> np.ndarray:
        runs = np.empty((count, *lanes.shape[:-1]))
        _take_apart(lanes.reshape(-1, WIDTH), runs.reshape(count, -1))
        return runs

    def of_signals(lanes: np.ndarray) -> np.ndarray:
        return of_runs(lanes) if measured else np.empty((count, 0, 0))

    of_filter = tables.fixes if measured and not beliefs.tight else NO_FIXES
    none = np.empty((0, 3, WIDTH))
    own = {"deviation": none, "attitude": none, "antenna": none, "gust": none}
    if inputs.flown is not None:
        flown = inputs.flown
        own = {"deviation": flown.deviation, "attitude": flown.rpy, "antenna": flown.antenna, "gust": flown.gust}
    of_events = _of_events(
        flight, [of_runs(m) for m in inputs.aided], of_runs(account.innovation_squared),
        of_runs(account.degrees).astype(np.int64), of_runs(account.status).astype(np.int64),
    )  # fmt: skip
    status, ratio = of_runs(watched.status).astype(np.int64), np.empty((count, 0))
    if flight.watching is not None and flight.watching.innovations is not None:
        squared, degrees = of_events["innovation_squared"], of_events["degrees"]
        ratio = flight.watching.innovations.ratio(world.signals.time, squared, degrees)
        status = np.where((ratio > 1.0) & (status != monitoring.NO_FIX), monitoring.ALARM, status)
    return Run(
        of_signals(ranges), of_signals(rates), of_runs(llh), of_runs(velocity), of_runs(clocks),
        of_runs(account.judgement.error), of_runs(account.sigma), of_runs(account.cross),
        of_runs(account.judgement.nees), of_runs(account.judgement.nees_position_velocity),
        of_runs(account.judgement.nees_group),
        **of_events,
        monitor_statistic=of_runs(watched.statistic), monitor_status=status, innovation_ratio=ratio,
        watched_error=of_runs(watched.error), monitor_excluded=of_runs(watched.excluded).astype(np.int64),
        monitor_level=of_runs(watched.level),
        **{name: of_runs(lanes) for name, lanes in own.items()},
        delta_angle=of_signals(inputs.dtheta), delta_velocity=of_signals(inputs.dv),
        start_llh=of_runs(nav[states.NAV_LLH : states.NAV_VEL]),
        start_velocity=of_runs(nav[states.NAV_VEL : states.NAV_QUAT]),
        start_rpy=roll_pitch_yaw(dcm_from_quaternion(of_runs(nav[states.NAV_QUAT : states.NAV_HELD]))),
        filter_fix_llh=of_runs(of_filter.llh), filter_fix_velocity=of_runs(of_filter.velocity),
        filter_fix_covariance=of_runs(of_filter.covariance),
        clipped=of_runs(inputs.clipped).astype(np.int64) if flight.limited else np.empty((count, 0), np.int64),
    )  # fmt: skip


def _truth(world: World, inputs: Inputs) -> Truth:
    """True values for the errors of runs."""
    route, flown = world.at_filter, inputs.flown
    if flown is not None:
        return Truth(flown.llh, flown.velocity, flown.quaternion, inputs.sensors)
    llh, velocity, quaternion = (in_all_lanes(m) for m in (route.llh, route.velocity_ned, route.quaternion))
    return Truth(llh, velocity, quaternion, inputs.sensors)


def begun(flight: Flight, nav: np.ndarray, covariance: np.ndarray) -> State:
    """Initial state of a flight's filter; nav (NAV,), covariance (n, n), of one run or of lanes."""
    sources = len(flight.world.signals.names) if flight.beliefs.tight else 0
    return start(nav, covariance, flight.model.components, sources)


@dataclass(frozen=True)
class Watched:
    """Output of a monitor of fixes, or of filters, in lanes; empty without a monitor."""

    statistic: np.ndarray
    """(e, W)."""
    status: np.ndarray
    """(e, W)."""
    error: np.ndarray
    """(e, 2, W) sizes of the horizontal and vertical errors, m."""
    excluded: np.ndarray
    """(e, W) see `Run`."""
    level: np.ndarray
    """(e, 2, W) see `Run`."""

    @classmethod
    def of_filter(
        cls, flight: Flight, account: Account, fixes: ReceiverFixes, ranges: np.ndarray, rates: np.ndarray
    ) -> Watched:
        """Monitor output for a filter, from its history and its fixes from ranges and rates (e, s, W)."""
        bank, none = flight.bank, (np.empty((0, WIDTH)), np.empty((0, 2, WIDTH)))
        assert bank is not None
        statistic = bank.statistic(account.innovation, fixes, ranges, rates)
        aided = np.repeat(bank.aided[:, None], WIDTH, axis=1)
        said = monitoring.status(bank.tested, bank.threshold, statistic, aided)
        # what is no number is no silence; nor do levels hold where the filter knows much less than they are of
        sigma = account.sigma[1:, states.POS : states.POS + 3]
        lost = np.isnan(statistic) | (sigma > monitoring.DOUBTED * bank.sigma[..., None]).any(axis=1)
        said = np.where(lost & aided, monitoring.ALARM, said)
        error = np.abs(account.judgement.error[1:, states.POS : states.POS + 3])
        off = np.stack([np.hypot(error[:, 0], error[:, 1]), error[:, 2]], axis=1)
        return cls(statistic, said.astype(float), off, *none)

    @classmethod
    def of_fixes(cls, flight: Flight, antenna: np.ndarray, ranges: np.ndarray, fixes: ReceiverFixes) -> Watched:
        """Monitor output for fixes from ranges (e, s, W); antenna: (e, 3, W) true position, ECEF, m."""
        monitor, none = flight.snapshot, (np.empty((0, WIDTH)), np.empty((0, 2, WIDTH)))
        if monitor is None:
            return cls(none[0], *none, *none)
        signals, axes = flight.world.signals, flight.world.antenna_enu
        left, error = range_residuals(signals, antenna, axes, ranges, fixes.llh, fixes.clocks)
        fixed = ~np.isnan(fixes.llh[:, 0])
        statistic = np.where(fixed, monitor.statistic(left), np.nan)
        said = monitoring.status(monitor.tested, monitor.threshold, statistic, fixed)
        return cls(statistic, said.astype(float), error, *none)

    def settled(
        self, flight: Flight, antenna: np.ndarray, ranges: np.ndarray, rates: np.ndarray, fixes: ReceiverFixes
    ) -> Watched:
        """After exclusions, which change the fixes."""
        excluder, monitor = flight.excluder, flight.snapshot
        if excluder is None or monitor is None:
            return self
        levels = np.repeat(monitoring.tested_levels(monitor)[..., None], WIDTH, axis=2)
        now = SettledFixes(fixes, self.error.copy(), levels, np.full(self.status.shape, float(NOTHING)))
        excluder.settle(self.status == monitoring.ALARM, ranges, rates, antenna, now)
        status = np.where(now.excluded == NOTHING, self.status, monitoring.EXCLUDED)
        return Watched(self.statistic, status, now.error, now.excluded, now.level)

    def trusted(self, flight: Flight, ranges: np.ndarray) -> np.ndarray:
        """Ranges (e, s, W) with nan for excluded ones, and for epochs with an alarm if the filter ignores them."""
        out = ranges
        if self.excluded.size:
            for number, candidate in enumerate(flight.candidates):
                taken = np.isin(flight.world.signals.names, candidate.sources)
                out = np.where((self.excluded == number)[:, None] & taken[:, None], np.nan, out)
        if flight.drops:
            out = np.where((self.status == monitoring.ALARM)[:, None], np.nan, out)
        return out


def _of_events(
    flight: Flight, aided: Sequence[np.ndarray], squared: np.ndarray, degrees: np.ndarray, status: np.ndarray
) -> dict[str, np.ndarray]:
    """History of the fixes and of the sensors beside the receiver.

    aided: (r, m, k) of each; squared, degrees, status (r, k): of all events.
    """
    aids = np.concatenate([np.empty(0, np.int64), *(flight.events.rows(a.sensor.kind) for a in flight.world.aids)])
    measured = np.full((squared.shape[0], aids.size, MOST), np.nan)
    first = 0
    for numbers in aided:
        measured[:, first : first + numbers.shape[1], : numbers.shape[2]] = numbers
        first += numbers.shape[1]
    of_events = {"squared": squared, "degrees": degrees, "status": status}
    # a run's numbers lie side by side, as they do when it flies alone: sums over them have one order
    of_fixes = {name: np.ascontiguousarray(values) for name, values in _of_epochs(flight, of_events).items()}
    of_aids = {f"aided_{name}": np.ascontiguousarray(values[:, aids]) for name, values in of_events.items()}
    return {
        "innovation_squared": of_fixes["squared"], "degrees": of_fixes["degrees"], "status": of_fixes["status"],
        "range_status": of_fixes["range_status"],
        "aided": measured, **of_aids,
    }  # fmt: skip


def _of_epochs(flight: Flight, of_events: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Innovations squared, degrees and status of each epoch (r, e), from those of all events (r, k), and range_status
    (r, e, s), see `records.by_epoch`."""
    weighed = flight.weighed
    if not flight.beliefs.tight:
        of_fixes = {name: values[:, weighed[:, 0]] for name, values in of_events.items()}
        return {**of_fixes, "range_status": np.empty((*of_fixes["status"].shape, 0), np.int64)}
    names = ("squared", "degrees", "status", "range_status")
    return dict(zip(names, by_epoch(weighed, *(of_events[name] for name in names[:3])), strict=True))
