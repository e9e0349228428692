"""A recorded flight through the filter: increments from samples, fixes as they came, nothing simulated.

A fix that arrived late is used for the time it was valid, and the answer at each output time is what could be known
then: see `estimation.filter_loop`. Where samples are missing for long, the flight goes on with interpolated motion
and a process noise that knows it; smoothing carries across.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from navsim.core import covariance, states
from navsim.core.arrays import earth
from navsim.core.arrays.attitude import dcm_from_quaternion, roll_pitch_yaw
from navsim.estimation import error_state
from navsim.estimation.beliefs import Beliefs
from navsim.estimation.estimate import FILTER_KINDS, estimate, is_smoother, lost
from navsim.estimation.observations import FIX, FixTable, Measurements
from navsim.estimation.records import ImuData, schedule, start
from navsim.models.recording import Fixes, Samples
from navsim.simulation.alignment import Alignment

_ACCELERATION = 5.0
"""1 sigma of what an aircraft may accelerate between a fix and the alignment, m/s2."""


@dataclass(frozen=True)
class Sensed:
    """What the sensors measured: imu_time (n + 1,) s; dtheta, dv (n, 3) increments; gaps: (first sample, length s) of
    missing samples; rate_scatter, force_scatter: (3,) 1 sigma of the samples."""

    imu_time: np.ndarray
    dtheta: np.ndarray
    dv: np.ndarray
    gaps: tuple[tuple[int, float], ...]
    rate_scatter: np.ndarray
    force_scatter: np.ndarray


@dataclass(frozen=True)
class RecordedFlight(Sensed):
    """A recording ready for the filter, from the alignment on.

    arrival (m,) times of the fixes as they came, s; llh, velocity (m, 3), nan where unknown; speed (m,) over ground,
    from the positions where no velocity is known; start_llh, start_velocity: of the fix nearest to the alignment,
    carried on to it over start_age seconds; start_derived: (3,) s over which positions gave the components of that
    velocity, 0 where they are known.
    """

    arrival: np.ndarray
    llh: np.ndarray
    velocity: np.ndarray
    speed: np.ndarray
    alignment: Alignment
    start_llh: np.ndarray
    start_velocity: np.ndarray
    start_age: float
    start_derived: np.ndarray


@dataclass(frozen=True)
class Replayed:
    """What the filter made of a flight, at the times it was asked for: time (t,), navigation (t, NAV), sigma (t, n);
    and of each fix (m,): innovation and its 1 sigma (m, 6), innovation_squared, degrees, status, as of `History`."""

    time: np.ndarray
    navigation: np.ndarray
    sigma: np.ndarray
    innovation: np.ndarray
    innovation_sigma: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray

    @property
    def rpy(self) -> np.ndarray:
        """Roll, pitch, yaw (t, 3), rad."""
        return roll_pitch_yaw(dcm_from_quaternion(self.navigation[:, states.NAV_QUAT : states.NAV_HELD]))

    def surprise(self, counted: np.ndarray) -> float:
        """Minus the logarithm of the likelihood of the counted fixes' innovations, up to a constant.

        The determinant of an innovation covariance is taken as the product of its diagonal: the noise of the fixes is
        uncorrelated, and what the filter's own uncertainty adds is small beside it.
        """
        seen = counted & (self.degrees > 0)
        sigma = self.innovation_sigma[seen]  # nan for components that a fix does not have
        return float(0.5 * np.sum(self.innovation_squared[seen]) + np.sum(np.log(sigma[np.isfinite(sigma)])))


def increments(samples: Samples, begin: float, longest_gap: float, averaged: bool) -> Sensed:
    """What the sensors measured from `begin` (s) on.

    longest_gap: s between samples from which on they count as missing. averaged: a sample is the mean since the one
    before; otherwise increments are the trapezoid of the samples at both ends.
    """
    keep = samples.time >= begin
    imu_time = np.concatenate([[begin], samples.time[keep]])
    imu_time = imu_time[np.concatenate([[True], np.diff(imu_time) > 1e-6])]
    step = np.diff(imu_time)[:, None]
    if averaged:
        sample = np.searchsorted(samples.time, imu_time[1:])
        rate, force = samples.rate[sample], samples.force[sample]
    else:
        rate, force = (0.5 * (ends[1:] + ends[:-1]) for ends in samples.at(imu_time))
    lost = np.flatnonzero(step[:, 0] > longest_gap)
    return Sensed(
        imu_time=imu_time,
        dtheta=rate * step,
        dv=force * step,
        gaps=tuple((int(k), float(step[k, 0])) for k in lost),
        rate_scatter=samples.rate[keep].std(axis=0),
        force_scatter=samples.force[keep].std(axis=0),
    )


def prepare(sensed: Sensed, fixes: Fixes, alignment: Alignment, latency: float) -> RecordedFlight:
    """The flight after an alignment, its fixes `latency` seconds old when they came; sensed: from the alignment on."""
    begin = alignment.time
    late = fixes.time
    valid = late - latency
    inside = (valid > begin) & (late <= sensed.imu_time[-1])
    before = np.flatnonzero(valid <= begin + 1e-9)
    at = int(before[-1]) if before.size else int(np.flatnonzero(inside)[0])
    filled, over = fixes.with_velocity()
    velocity = filled.velocity[at]
    ahead = begin - float(valid[at])
    start = earth.llh_from_ecef(
        earth.ecef_from_llh(fixes.llh[at]) + ahead * earth.ned_matrix(fixes.llh[at]).T @ velocity
    )
    return RecordedFlight(
        **vars(sensed),
        arrival=late[inside],
        llh=fixes.llh[inside],
        velocity=fixes.velocity[inside],
        speed=np.linalg.norm(filled.velocity[inside, :2], axis=1),
        alignment=alignment,
        start_llh=start,
        start_velocity=velocity,
        start_age=abs(ahead),
        start_derived=np.where(np.isnan(fixes.velocity[at]), over[at], 0.0),
    )


def fly(
    flight: RecordedFlight,
    beliefs: Beliefs,
    fix_sigma: np.ndarray,
    times: np.ndarray,
    until: float = np.inf,
    withheld: np.ndarray | None = None,
) -> Replayed:
    """The flight through a filter or smoother.

    fix_sigma: (6,) of position and velocity of the fixes, north, east, down, m, m/s. times: (t,) at which to answer,
    beside those when fixes came. until: end early, s. withheld: (m,) bool, fixes that the filter is not given (their
    innovation is nan). Raises ArithmeticError where a smoother's covariance fails.
    """
    until = min(until, float(flight.imu_time[-1]))
    count = int(np.sum(flight.arrival <= until + 1e-9))
    arrival = flight.arrival[:count]
    wanted = np.unique(times[(times > flight.imu_time[0] + beliefs.latency) & (times <= until + 1e-9)])
    outputs = np.unique(np.concatenate([flight.imu_time[:1], arrival, wanted]))
    llh, velocity = flight.llh[:count].copy(), flight.velocity[:count].copy()
    if withheld is not None:
        llh[withheld[:count]] = np.nan
    valid = np.maximum(arrival - beliefs.latency, flight.imu_time[0])
    # over a gap one linearisation is not enough: the filter's attitude is off by tens of degrees there
    kind = FILTER_KINDS["map"] if is_smoother(beliefs.kind) and flight.gaps else beliefs.kind
    noise = np.tile(np.diag(beliefs.sigma_scale**2 * fix_sigma**2), (count, 1, 1))
    events = schedule(outputs, (FIX, valid, valid if is_smoother(kind) else arrival))
    model = replace(beliefs, kind=kind).model(_noise(flight, beliefs))
    history = estimate(
        ImuData(flight.imu_time, flight.dtheta, flight.dv),
        Measurements.of({FIX: FixTable(llh, velocity, noise, beliefs.lever_arm)}),
        events,
        start(*_start(flight, beliefs, fix_sigma), model.components),
        model,
    )
    if is_smoother(kind) and lost(history):
        raise ArithmeticError("the smoother lost the positive covariance of its flight")
    weighed = events.rows(FIX)
    return Replayed(
        outputs, history.navigation, history.sigma(), history.innovation[weighed], history.innovation_sigma[weighed],
        history.innovation_squared[weighed], history.degrees[weighed], history.status[weighed],
    )  # fmt: skip


def _start(flight: RecordedFlight, beliefs: Beliefs, fix_sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Navigation state (NAV_N,) and covariance (n, n) at the alignment; the start position is the antenna's less the
    lever arm, its accelerometer biases are zero."""
    alignment = flight.alignment
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_LLH : states.NAV_VEL] = flight.start_llh
    nav[states.NAV_VEL : states.NAV_QUAT] = flight.start_velocity
    nav[states.NAV_QUAT : states.NAV_HELD] = alignment.quaternion
    nav[states.NAV_GYRO : states.NAV_ACCEL] = alignment.gyro_bias
    error_state.move(nav, *(-dcm_from_quaternion(alignment.quaternion) @ beliefs.lever_arm))
    position_sigma, fix_velocity_sigma = fix_sigma[:3], fix_sigma[3:]
    matrix = np.diag(np.repeat([0.0, 0.0, 0.0, *beliefs.sensors.sigma], 3) ** 2)
    # since the fix the aircraft may have accelerated, and it turns about the antenna
    gained = _ACCELERATION * flight.start_age + np.linalg.norm(flight.rate_scatter) * np.linalg.norm(beliefs.lever_arm)
    derived = flight.start_derived
    velocity_sigma = 2.0 * fix_velocity_sigma
    unknown = derived > 0.0
    velocity_sigma[unknown] = (
        np.sqrt(2.0) * position_sigma[unknown] / derived[unknown] + 0.5 * _ACCELERATION * derived[unknown]
    )
    for first, variance in (
        (states.POS, (2.0 * position_sigma) ** 2 + (0.5 * gained * flight.start_age) ** 2),
        (states.VEL, velocity_sigma**2 + gained**2),
        (states.GYRO, alignment.gyro_sigma**2),
    ):
        matrix[np.arange(first, first + 3), np.arange(first, first + 3)] = variance
    att = slice(states.ATT, states.ATT + 3)
    matrix[att, att] = alignment.covariance
    return nav, matrix


def _noise(flight: RecordedFlight, beliefs: Beliefs) -> np.ndarray:
    """White densities of each IMU interval (n, 2), or one row where no samples are missing.

    In an interval without samples rate and specific force were anywhere within their scatter over the flight. As white
    noise that leads to the same variances of velocity and attitude in the end.
    """
    sensors = beliefs.sensors.noise[None]
    if not flight.gaps:
        return sensors
    out = np.repeat(sensors, flight.dtheta.shape[0], axis=0)
    for interval, length in flight.gaps:
        out[interval, covariance.NOISE_GYRO] += np.mean(flight.rate_scatter**2) * length
        out[interval, covariance.NOISE_ACCEL] += np.mean(flight.force_scatter**2) * length
    return out
