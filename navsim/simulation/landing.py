"""The landing run, block by block as in figure 1 of the landing paper.

    route -> signal simulator with pseudolites -> receiver -> fix ┐
    route -> inertial sensors -> SINS ────────────────────────────┴-> Kalman filter -> accuracy

`World` is what all runs of a scenario share: the route and the geometry of the signals. `fly` is one run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.core import covariance, noise, states
from navsim.core.attitude import rotate_left
from navsim.core.dop import MAX_CLOCKS, dops, geometry_covariance
from navsim.core.wgs84 import RATE as EARTH_RATE
from navsim.core.wgs84 import SPEED_OF_LIGHT, ecef_from_llh, ned_matrix
from navsim.estimation import error_state, loosely_coupled, receiver, smoother
from navsim.models import atmosphere, imu, pseudorange, tracking
from navsim.models.glonass import FDMA_L1
from navsim.models.kinematics import Motion, Moving
from navsim.models.sky import Mask, azimuth_elevation, enu_matrix, unit_vector
from navsim.simulation.effects import NO_EFFECTS, Effects, propagation, seen_from, space_sensitivity
from navsim.simulation.streams import generator

_LISTED_RANGE = 20_000e3
"""Distance given to sources listed by direction, m."""
_CARRIER_SIGMA = 3e-3
"""1 sigma of a carrier phase measurement, m."""


@dataclass(frozen=True)
class Satellites:
    """A constellation of n satellites, their names, clock numbers (n,) int, and which of them to use (n,) bool."""

    constellation: Any
    names: tuple[str, ...]
    clock: np.ndarray
    chosen: np.ndarray


@dataclass(frozen=True)
class Listed:
    """Sources in fixed directions: azimuth, elevation (s,) rad, clock (s,) int, chosen (s,) bool."""

    names: tuple[str, ...]
    azimuth: np.ndarray
    elevation: np.ndarray
    clock: np.ndarray
    chosen: np.ndarray


@dataclass(frozen=True)
class Ground:
    """Pseudolites: surveyed llh (p, 3) rad, rad, m; survey_error (3,) NED true minus surveyed, m;
    delay: effect of their clock offset on the pseudorange, m; sigma, rate_sigma: m, m/s; cn0: dB-Hz."""

    names: tuple[str, ...]
    llh: np.ndarray
    survey_error: np.ndarray
    clock: int
    delay: float
    sigma: float
    rate_sigma: float
    cn0: float


@dataclass(frozen=True)
class ErrorLaw:
    """Ranging errors of satellites, see `pseudorange.sigma_of_elevation`; rate_sigma m/s, cn0 dB-Hz."""

    law: str
    zenith: float
    scale: float
    rate_sigma: float
    cn0: float


@dataclass(frozen=True)
class Environment:
    """All sources of signals, what becomes of them, and the antenna that hears them; lever_arm (3,) IMU to antenna,
    body, m."""

    satellites: tuple[Satellites, ...]
    listed: Listed | None
    mask: Mask
    ground: Ground
    law: ErrorLaw
    lever_arm: np.ndarray
    effects: Effects = NO_EFFECTS


@dataclass(frozen=True)
class InitialErrors:
    """1 sigma per axis of the initial errors, rad, m, m/s; `fixed` (9,) position, velocity, attitude errors
    (truth - estimate) instead of drawn ones."""

    attitude: float
    position: float
    velocity: float
    fixed: np.ndarray | None = None


@dataclass(frozen=True)
class FilterSettings:
    """What the filter is and believes: kind (`loosely_coupled.KINDS`), initial sigmas, sensors, fixes.

    gate: (7,) limits by the number of measurements.
    """

    kind: int
    initial: InitialErrors
    gyro: imu.Triad
    accel: imu.Triad
    with_velocity: bool
    latency: float
    lever_arm: np.ndarray
    sigma_scale: float
    gate: np.ndarray
    max_rejected: int

    def covariance(self) -> np.ndarray:
        """P at time 0, flat (240,)."""
        variances = np.empty(states.N)
        for first, sigma in (
            (states.POS, self.initial.position),
            (states.VEL, self.initial.velocity),
            (states.ATT, self.initial.attitude),
            (states.GYRO, self.gyro.initial_sigma()),
            (states.ACCEL, self.accel.initial_sigma()),
        ):
            variances[first : first + 3] = max(sigma, _SIGMA_FLOOR[first]) ** 2
        p = np.zeros(covariance.SIZE)
        p[np.arange(states.N) * (covariance.STRIDE + 1)] = variances
        return p

    def noise(self) -> np.ndarray:
        """Process noise (6,), see `core.covariance`."""
        return np.array(
            [
                self.gyro.noise_density**2,
                self.accel.noise_density**2,
                *self.gyro.decay_and_drive(),
                *self.accel.decay_and_drive(),
            ]
        )


_SIGMA_FLOOR = {states.POS: 1e-4, states.VEL: 1e-6, states.ATT: 1e-8, states.GYRO: 1e-12, states.ACCEL: 1e-9}
"""Smallest initial sigma the filter is given, SI: with zeros P would be singular, and a perfect sensor or a
perfect start is a common check."""


@dataclass(frozen=True)
class World:
    """Everything that is the same in all runs of a scenario.

    imu_time: (n + 1,) s. dtheta, dv: (n, 3) exact increments. truth: motion at imu_time. at_filter: motion
    at the filter's output times (e + 1): 0 and every fix epoch plus latency. filter_index: (e + 1,) index of
    the IMU sample at or just before them. dop: (e, 5). fix_covariance: (e, 3, 3) weighted, ENU.
    clock: (e, 2) receiver clock offset (m) and drift (m/s).
    """

    imu_time: np.ndarray
    dtheta: np.ndarray
    dv: np.ndarray
    truth: Motion
    signals: pseudorange.Signals
    dop: np.ndarray
    fix_covariance: np.ndarray
    clock: np.ndarray
    start: np.ndarray
    at_filter: Motion
    filter_index: np.ndarray

    @property
    def filter_time(self) -> np.ndarray:
        """Times of the filter's output, s (e + 1,)."""
        return self.at_filter.time


def epochs(duration: float, rate: float) -> np.ndarray:
    """Times k / rate, k = 1, 2, ... up to the duration, s."""
    return np.arange(1, int(np.floor(duration * rate + 1e-9)) + 1) / rate


def build_world(
    trajectory: Moving,
    environment: Environment,
    *,
    utc: float,
    duration: float,
    imu_rate: float,
    fix_rate: float,
    latency: float,
    clock_offset: float,
    clock_drift: float,
) -> World:
    """Route and geometry of the signals.

    utc: of time 0, s from 1970-01-01. duration: s. imu_rate, fix_rate: Hz. latency: s; fixes that would come
    after the end are left out. clock_offset: s, clock_drift: s/s of the receiver.
    """
    imu_time = np.arange(int(np.floor(duration * imu_rate + 1e-9)) + 1) / imu_rate
    dtheta, dv = trajectory.increments(imu_time)
    fix_time = epochs(duration, fix_rate)
    fix_time = fix_time[fix_time + latency <= imu_time[-1] + 1e-9]
    at_fix = trajectory.motion(fix_time)
    signals = build_signals(at_fix, utc, environment)
    cofactor, _ = geometry_covariance(signals.los, signals.clock, 1.0 / signals.fix_sigma**2)
    at_filter = trajectory.motion(np.concatenate([[0.0], fix_time + latency]))
    return World(
        imu_time=imu_time,
        dtheta=dtheta,
        dv=dv,
        truth=trajectory.motion(imu_time),
        signals=signals,
        dop=dops(signals.los, signals.clock),
        fix_covariance=cofactor[:, :3, :3],
        clock=SPEED_OF_LIGHT
        * np.stack([clock_offset + clock_drift * fix_time, np.full_like(fix_time, clock_drift)], axis=1),
        start=trajectory.frame.origin,
        at_filter=at_filter,
        filter_index=np.searchsorted(imu_time, at_filter.time + 1e-9, side="right") - 1,
    )


def build_signals(motion: Motion, utc: float, environment: Environment) -> pseudorange.Signals:
    """All sources at the times of `motion`, seen from the antenna; see `pseudorange.Signals`."""
    e = motion.time.size
    listed, ground, law = environment.listed, environment.ground, environment.law
    c_ne = ned_matrix(motion.llh)
    arm = np.einsum("nij,j->ni", motion.c_nb, environment.lever_arm)
    antenna = motion.position_ecef + np.einsum("nji,nj->ni", c_ne, arm)
    earth_rate_b = np.einsum("nji,njk,k->ni", motion.c_nb, c_ne, [0.0, 0.0, EARTH_RATE])
    swing = np.einsum("nij,nj->ni", motion.c_nb, np.cross(motion.angular_rate - earth_rate_b, environment.lever_arm))
    antenna_velocity = motion.velocity_ecef + np.einsum("nji,nj->ni", c_ne, swing)
    c_ue = enu_matrix(motion.llh)

    names: list[str] = []
    clocks: list[int] = []
    position, velocity, true_position, chosen, ground_based = [], [], [], [], []

    def add(name, clock, believed, speed, true, use, is_ground):  # type: ignore[no-untyped-def]
        names.append(name)
        clocks.append(clock)
        position.append(believed)
        velocity.append(speed)
        true_position.append(true)
        chosen.append(use)
        ground_based.append(is_ground)

    for group in environment.satellites:
        p, v = pseudorange.satellites_at_reception(group.constellation, utc + motion.time, antenna)
        for i, name in enumerate(group.names):
            add(name, int(group.clock[i]), p[:, i], v[:, i], p[:, i], group.chosen[i], False)
    if listed is not None:
        for i, name in enumerate(listed.names):
            direction = np.einsum("nji,j->ni", c_ue, unit_vector(listed.azimuth[i], listed.elevation[i]))
            p = antenna + _LISTED_RANGE * direction
            # the source keeps its direction: it moves along, without range rate
            add(name, int(listed.clock[i]), p, antenna_velocity, p, listed.chosen[i], False)
    for i, name in enumerate(ground.names):
        surveyed = ecef_from_llh(ground.llh[i])
        true = surveyed + ned_matrix(ground.llh[i]).T @ ground.survey_error
        still = np.zeros((e, 3))
        add(name, ground.clock, still + surveyed, still, still + true, True, True)

    s = len(names)
    believed = np.stack(position, axis=1) if s else np.empty((e, 0, 3))
    speed = np.stack(velocity, axis=1) if s else np.empty((e, 0, 3))
    true = np.stack(true_position, axis=1) if s else np.empty((e, 0, 3))
    on_ground = np.array(ground_based, dtype=bool)

    offset = true - antenna[:, None]
    distance = np.linalg.norm(offset, axis=2)
    rate = np.sum(offset * (speed - antenna_velocity[:, None]), axis=2) / distance
    offset = believed - antenna[:, None]
    los = np.einsum("nij,nsj->nsi", c_ue, offset / np.linalg.norm(offset, axis=2, keepdims=True))
    azimuth, elevation = azimuth_elevation(los)
    used = np.array(chosen, dtype=bool) & (on_ground | environment.mask.passes(azimuth, elevation))
    used &= np.isfinite(distance)  # a satellite without a message at the time
    los[~used] = np.nan
    sigma = pseudorange.sigma_of_elevation(law.law, law.zenith, elevation, law.scale)
    built = pseudorange.Signals(
        time=motion.time,
        antenna=antenna,
        names=tuple(names),
        clock=np.array(clocks, dtype=np.int64),
        used=used,
        position=believed,
        velocity=speed,
        range=distance,
        range_rate=rate,
        delay=np.broadcast_to(np.where(on_ground, ground.delay, 0.0), (e, s)).copy(),
        sigma=np.where(on_ground, ground.sigma, sigma),
        rate_sigma=np.broadcast_to(np.where(on_ground, ground.rate_sigma, law.rate_sigma), (e, s)).copy(),
        los=los,
        azimuth=azimuth,
        elevation=elevation,
        cn0=np.where(used, np.where(on_ground, ground.cn0, law.cn0), np.nan),
        ionosphere=np.zeros((e, s)),
        space=None,
        fix_sigma=np.empty((e, s)),
        smoothing=None,
    )
    return _affected(built, utc, motion.llh, environment, on_ground)


def _affected(
    signals: pseudorange.Signals, utc: float, llh: np.ndarray, environment: Environment, on_ground: np.ndarray
) -> pseudorange.Signals:
    """The signals with all effects of the environment; llh: (e, 3) of the receiver, on_ground: (s,) pseudolites."""
    effects, ground = environment.effects, environment.ground
    e, s = signals.range.shape
    sky = ~on_ground
    when = utc + signals.time
    delay, cn0, sigma = signals.delay.copy(), signals.cn0.copy(), signals.sigma.copy()
    chip, ratio2 = _carriers(environment, s)
    air, ionosphere = propagation(effects, when, llh, signals.azimuth, signals.elevation, ratio2)
    delay += np.where(sky, air, 0.0) + np.array(effects.offsets)[signals.clock]
    ionosphere = np.where(sky, ionosphere, 0.0)
    away = signals.position - signals.antenna[:, None]
    distance = np.linalg.norm(away, axis=2)
    space = None
    if effects.space is not None:
        space = np.zeros((e, s, 4))
        unit = away[:, sky] / distance[:, sky, None]
        space[:, sky] = space_sensitivity(effects.space, unit, signals.position[:, sky], signals.velocity[:, sky])
    if effects.reference is not None:
        first = 0
        earlier = when - effects.reference.latency
        place = np.broadcast_to(effects.reference.llh, (e, 3))
        for group in environment.satellites:
            here = slice(first, first + len(group.names))
            first = here.stop
            unit, azimuth, elevation = seen_from(group.constellation, earlier, effects.reference.llh)
            there, part = propagation(effects, earlier, place, azimuth, elevation, ratio2[here])
            delay[:, here] -= there
            ionosphere[:, here] -= part
            if space is not None and effects.space is not None:
                position, velocity = signals.position[:, here], signals.velocity[:, here]
                space[:, here] -= space_sensitivity(effects.space, unit, position, velocity)
        sigma = np.where(sky, np.hypot(sigma, effects.reference.noise), sigma)
    if effects.thermal:
        cn0 += np.where(sky, tracking.antenna_gain(signals.elevation, effects.horizon_db), 0.0)
    if effects.cn0_reference is not None:
        cn0 += np.where(on_ground, 20.0 * np.log10(effects.cn0_reference / distance), 0.0)
    if effects.thermal:
        thermal = effects.loop.sigma(np.nan_to_num(cn0, nan=environment.law.cn0), chip)
        sigma = np.where(sky, np.hypot(thermal, 0.0 if effects.reference is None else effects.reference.noise), sigma)
    if effects.ground is not None:
        for i in np.flatnonzero(on_ground):
            transmitter = ground.llh[i - (s - len(ground.names))]
            above, own = llh[:, 2] - effects.ground.height, transmitter[2] - effects.ground.height
            across = np.sqrt(np.maximum(distance[:, i] ** 2 - (above - own) ** 2, 1.0))
            ray = tracking.reflection(effects.ground, atmosphere.L1, above, float(own), across)
            delay[:, i] += tracking.multipath_error(effects.loop.spacing, float(chip[i]), *ray)
    fix_sigma, smoothing = sigma, None
    if effects.smoothing > 0.0 and e > 1:
        memory = max(1, round(effects.smoothing / float(np.median(np.diff(signals.time)))))
        variance, smoothing = tracking.smoothed_variance(sigma**2, signals.used, memory)
        fix_sigma = np.sqrt(np.where(signals.used, variance, 1.0))
    return replace(
        signals,
        clock=np.zeros_like(signals.clock) if effects.one_clock else signals.clock,
        delay=delay,
        cn0=cn0,
        sigma=sigma,
        ionosphere=ionosphere,
        space=space,
        fix_sigma=fix_sigma,
        smoothing=smoothing,
    )


def _carriers(environment: Environment, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Length of a chip, m, and (L1 / f)^2 of every source (s,); what is no GLONASS satellite is as GPS."""
    chip, ratio2 = np.full(count, tracking.CHIP["gps"]), np.ones(count)
    first = 0
    for group in environment.satellites:
        here = slice(first, first + len(group.names))
        first = here.stop
        if group.constellation.system == "glonass":
            chip[here] = tracking.CHIP["glonass"]
            frequency = getattr(group.constellation, "frequency", np.full(len(group.names), FDMA_L1))
            ratio2[here] = (atmosphere.L1 / frequency) ** 2
    return chip, ratio2


@dataclass(frozen=True)
class Run:
    """What one run leaves behind; shapes and units as in the result file, without the run axis."""

    pseudorange: np.ndarray
    range_rate: np.ndarray
    fix_llh: np.ndarray
    fix_velocity: np.ndarray
    fix_clock: np.ndarray
    error: np.ndarray
    sigma: np.ndarray
    nees: np.ndarray
    nees_position_velocity: np.ndarray
    nees_group: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray


def initial_estimate(rng: np.random.Generator, truth: Motion, errors: InitialErrors) -> np.ndarray:
    """The navigation state at time 0 (20,): the truth minus drawn or fixed errors."""
    drawn = rng.standard_normal(9) * np.repeat([errors.position, errors.velocity, errors.attitude], 3)
    x = drawn if errors.fixed is None else errors.fixed
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_LLH : states.NAV_LLH + 3] = truth.llh[0]
    nav[states.NAV_VEL : states.NAV_VEL + 3] = truth.velocity_ned[0]
    nav[states.NAV_QUAT : states.NAV_QUAT + 4] = truth.quaternion[0]
    error_state.inject(nav, np.concatenate([-x[:6], np.zeros(9)]))
    rotate_left(nav[states.NAV_QUAT : states.NAV_QUAT + 4], -x[6], -x[7], -x[8])
    return nav


def fly(
    world: World,
    initial: InitialErrors,
    gyro: imu.Triad,
    accel: imu.Triad,
    settings: FilterSettings,
    seed: int,
    run: int,
) -> Run:
    """One landing, numbered `run`, of the ensemble of `seed`."""
    signals = world.signals
    e, s = signals.range.shape

    nav = initial_estimate(generator(seed, run, "initial"), world.at_filter, initial)

    dt = world.imu_time[1] - world.imu_time[0]
    dtheta, dv, bias = imu.simulate(generator(seed, run, "imu"), world.dtheta, world.dv, dt, gyro, accel)

    ranges, rates = np.empty((e, s)), np.empty((e, s))
    delay = signals.delay
    if signals.space is not None:
        delay = delay + np.einsum("esk,sk->es", signals.space, generator(seed, run, "space").standard_normal((s, 4)))
    noise.measure(
        generator(seed, run, "measurements"),
        signals.range, delay, signals.sigma, signals.range_rate, signals.rate_sigma, signals.used, world.clock,
        ranges, rates,
    )  # fmt: skip
    if signals.smoothing is not None:
        # the ionosphere delays the code as much as it advances the carrier
        phase = signals.range + delay - 2.0 * signals.ionosphere + world.clock[:, :1]
        phase = phase + _CARRIER_SIGMA * generator(seed, run, "carrier").standard_normal((e, s))
        ranges = tracking.smooth(ranges, phase, signals.smoothing)

    llh, velocity, clocks = np.empty((e, 3)), np.empty((e, 3)), np.empty((e, MAX_CLOCKS))
    cov = np.empty((e, 6, 6))
    receiver.fixes(
        world.start, signals.position, signals.velocity, signals.fix_sigma, signals.rate_sigma, signals.clock,
        ranges, rates, llh, velocity, clocks, cov,
    )  # fmt: skip

    out = loosely_coupled.Flown.of(e)
    truth = world.at_filter
    scale = settings.sigma_scale**2
    # the filter knows when a fix came and how old it believes it to be
    valid = signals.time + (truth.time[1:] - signals.time) - settings.latency if e else signals.time
    flight = (
        world.imu_time, dtheta, dv, nav, settings.covariance(), settings.noise(),
        np.maximum(valid, 0.0), llh, velocity, scale * cov,
        settings.with_velocity, settings.latency, settings.lever_arm, settings.gate, settings.max_rejected,
        truth.llh, truth.velocity_ned, truth.quaternion, bias[world.filter_index],
        out, covariance.STRIDE,
    )  # fmt: skip
    if settings.kind in smoother.PASSES:
        smoother.run(*flight, smoother.PASSES[settings.kind])
    else:
        loosely_coupled.run(settings.kind, *flight)
    return Run(
        ranges, rates, llh, velocity, clocks, out.error, out.sigma, out.nees, out.nees_position_velocity,
        out.nees_group, out.innovation, out.degrees, out.status,
    )  # fmt: skip
