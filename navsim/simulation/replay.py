"""A recorded flight through the filter: increments from samples, fixes as they came, nothing simulated.

A fix that arrived late is used for the time it was valid, and the answer at each output time is what could be known
then: see `estimation.loosely_coupled`. Where samples are missing for long, the flight goes on with interpolated motion
and a process noise that knows it; smoothing carries across.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.core import covariance, states, wgs84
from navsim.core.rotation import dcm_from_quaternion, roll_pitch_yaw
from navsim.estimation import error_state, loosely_coupled, smoother
from navsim.models.imu import Triad, process_noise
from navsim.models.recording import Fixes, Samples
from navsim.simulation.alignment import Alignment

_ACCELERATION = 5.0
"""1 sigma of what an aircraft may accelerate between a fix and the alignment, m/s2."""


@dataclass(frozen=True)
class Beliefs:
    """What the filter believes of a recording: sensors; 1 sigma of the fixes' position and velocity (north, east,
    down), m, m/s; latency s; lever arm (3,) m; gate (7,); rejections in a row after which a fix is taken nevertheless.
    """

    gyro: Triad
    accel: Triad
    position_sigma: np.ndarray
    velocity_sigma: np.ndarray
    latency: float
    lever_arm: np.ndarray
    gate: np.ndarray
    max_rejected: int


@dataclass(frozen=True)
class Felt:
    """What sensors felt: imu_time (n + 1,) s; dtheta, dv (n, 3) increments; gaps: (first sample, length s) of missing
    samples; rate_scatter, force_scatter: (3,) 1 sigma of the samples."""

    imu_time: np.ndarray
    dtheta: np.ndarray
    dv: np.ndarray
    gaps: tuple[tuple[int, float], ...]
    rate_scatter: np.ndarray
    force_scatter: np.ndarray


@dataclass(frozen=True)
class Flight(Felt):
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
class Replay:
    """What the filter made of a flight, at the times it was asked for: time (t,), llh, velocity (t, 3), quaternion
    (t, 4), bias (t, 6), sigma (t, 15); and of each fix (m,): misfit and its 1 sigma (m, 6), squared, degrees, status.
    """

    time: np.ndarray
    llh: np.ndarray
    velocity: np.ndarray
    quaternion: np.ndarray
    bias: np.ndarray
    sigma: np.ndarray
    misfit: np.ndarray
    misfit_sigma: np.ndarray
    squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray

    @property
    def rpy(self) -> np.ndarray:
        """Roll, pitch, yaw (t, 3), rad."""
        return roll_pitch_yaw(dcm_from_quaternion(self.quaternion))

    def surprise(self, counted: np.ndarray) -> float:
        """Minus the logarithm of the likelihood of the counted fixes' innovations, up to a constant.

        The determinant of an innovation covariance is taken as the product of its diagonal: the noise of the fixes is
        uncorrelated, and what the filter's own uncertainty adds is small beside it.
        """
        seen = counted & (self.degrees > 0)
        sigma = self.misfit_sigma[seen]  # nan for components that a fix does not have
        return float(0.5 * np.sum(self.squared[seen]) + np.sum(np.log(sigma[np.isfinite(sigma)])))


def increments(samples: Samples, begin: float, longest_gap: float, averaged: bool) -> Felt:
    """What the sensors felt from `begin` (s) on.

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
    return Felt(
        imu_time=imu_time,
        dtheta=rate * step,
        dv=force * step,
        gaps=tuple((int(k), float(step[k, 0])) for k in lost),
        rate_scatter=samples.rate[keep].std(axis=0),
        force_scatter=samples.force[keep].std(axis=0),
    )


def prepare(felt: Felt, fixes: Fixes, alignment: Alignment, latency: float) -> Flight:
    """The flight after an alignment, its fixes `latency` seconds old when they came; felt: from the alignment on."""
    begin = alignment.time
    late = fixes.time
    valid = late - latency
    inside = (valid > begin) & (late <= felt.imu_time[-1])
    before = np.flatnonzero(valid <= begin + 1e-9)
    at = int(before[-1]) if before.size else int(np.flatnonzero(inside)[0])
    filled, over = fixes.with_velocity()
    velocity = filled.velocity[at]
    ahead = begin - float(valid[at])
    start = wgs84.llh_from_ecef(
        wgs84.ecef_from_llh(fixes.llh[at]) + ahead * wgs84.ned_matrix(fixes.llh[at]).T @ velocity
    )
    return Flight(
        **vars(felt),
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
    flight: Flight,
    kind: int,
    beliefs: Beliefs,
    times: np.ndarray,
    until: float = np.inf,
    withheld: np.ndarray | None = None,
) -> Replay:
    """The flight through a filter or smoother (`loosely_coupled.KINDS`).

    times: (t,) at which to answer, beside the fixes' own. until: end early, s. withheld: (m,) bool, fixes that the
    filter is not given (their misfit is nan). Raises ArithmeticError where a smoother's covariance fails.
    """
    nav, p = _start(flight, beliefs)
    until = min(until, float(flight.imu_time[-1]))
    given = flight.arrival <= until + 1e-9
    wanted = np.unique(times[(times > flight.imu_time[0] + beliefs.latency) & (times <= until + 1e-9)])
    arrival = np.concatenate([flight.arrival[given], wanted])
    order = np.argsort(arrival, kind="stable")
    arrival = arrival[order]
    nothing = np.full((wanted.size, 3), np.nan)
    llh = np.concatenate([flight.llh[given], nothing])[order]
    if withheld is not None:
        llh[np.argsort(order, kind="stable")[: given.sum()][withheld[given]]] = np.nan
    velocity = np.concatenate([flight.velocity[given], nothing])[order]
    is_fix = order < given.sum()
    noise_of_fix = np.diag(np.concatenate([beliefs.position_sigma, beliefs.velocity_sigma]) ** 2)
    count = arrival.size
    out = loosely_coupled.Flown.of(count)
    job = (
        flight.imu_time, flight.dtheta, flight.dv, nav, p, _noise(flight, beliefs),
        np.maximum(arrival - beliefs.latency, flight.imu_time[0]), llh, velocity,
        np.tile(noise_of_fix, (count, 1, 1)), True, beliefs.latency, beliefs.lever_arm, beliefs.gate,
        beliefs.max_rejected, np.zeros((count + 1, 3)), np.zeros((count + 1, 3)),
        np.tile([1.0, 0.0, 0.0, 0.0], (count + 1, 1)), np.zeros((count + 1, 6)), out, covariance.STRIDE,
    )  # fmt: skip
    if kind in smoother.PASSES:
        # over a gap one linearisation is not enough: the filter's attitude is off by tens of degrees there
        smoother.run(*job, smoother.PASSES[loosely_coupled.MAP if flight.gaps else kind])
        if np.isnan(out.nees[0]):
            raise ArithmeticError("the smoother lost the positive covariance of its flight")
    else:
        loosely_coupled.run(kind, *job)
    return Replay(
        time=np.concatenate([[flight.imu_time[0]], arrival]),
        llh=out.estimate[:, states.NAV_LLH : states.NAV_LLH + 3],
        velocity=out.estimate[:, states.NAV_VEL : states.NAV_VEL + 3],
        quaternion=out.estimate[:, states.NAV_QUAT : states.NAV_QUAT + 4],
        bias=out.estimate[:, states.NAV_GYRO : states.NAV_GYRO + 6],
        sigma=out.sigma,
        misfit=out.misfit[is_fix],
        misfit_sigma=out.misfit_sigma[is_fix],
        squared=out.innovation[is_fix],
        degrees=out.degrees[is_fix],
        status=out.status[is_fix],
    )


def _start(flight: Flight, beliefs: Beliefs) -> tuple[np.ndarray, np.ndarray]:
    """Navigation state (20,) and flat covariance (240,) at the alignment; the start position is the antenna's less the
    lever arm, its accelerometer biases are zero."""
    alignment = flight.alignment
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_LLH : states.NAV_LLH + 3] = flight.start_llh
    nav[states.NAV_VEL : states.NAV_VEL + 3] = flight.start_velocity
    nav[states.NAV_QUAT : states.NAV_QUAT + 4] = alignment.quaternion
    nav[states.NAV_GYRO : states.NAV_GYRO + 3] = alignment.gyro_bias
    error_state.move(nav, *(-dcm_from_quaternion(alignment.quaternion) @ beliefs.lever_arm))
    matrix = np.zeros((states.N, covariance.STRIDE))
    # since the fix the aircraft may have accelerated, and it turns about the antenna
    gained = _ACCELERATION * flight.start_age + np.linalg.norm(flight.rate_scatter) * np.linalg.norm(beliefs.lever_arm)
    derived = flight.start_derived
    velocity_sigma = 2.0 * beliefs.velocity_sigma
    unknown = derived > 0.0
    velocity_sigma[unknown] = (
        np.sqrt(2.0) * beliefs.position_sigma[unknown] / derived[unknown] + 0.5 * _ACCELERATION * derived[unknown]
    )
    for first, variance in (
        (states.POS, (2.0 * beliefs.position_sigma) ** 2 + (0.5 * gained * flight.start_age) ** 2),
        (states.VEL, velocity_sigma**2 + gained**2),
        (states.GYRO, alignment.gyro_sigma**2),
        (states.ACCEL, np.full(3, beliefs.accel.initial_sigma() ** 2)),
    ):
        matrix[np.arange(first, first + 3), np.arange(first, first + 3)] = variance
    att = slice(states.ATT, states.ATT + 3)
    matrix[att, att] = alignment.covariance
    return nav, matrix.ravel()


def _noise(flight: Flight, beliefs: Beliefs) -> np.ndarray:
    """Process noise of each IMU interval (n, 6), or one row where no samples are missing.

    In an interval without samples rate and specific force were anywhere within their scatter over the flight. As white
    noise that leads to the same variances of velocity and attitude in the end.
    """
    sensors = process_noise(beliefs.gyro, beliefs.accel)
    if not flight.gaps:
        return sensors
    out = np.repeat(sensors, flight.dtheta.shape[0], axis=0)
    for interval, length in flight.gaps:
        out[interval, covariance.NOISE_GYRO] += np.mean(flight.rate_scatter**2) * length
        out[interval, covariance.NOISE_ACCEL] += np.mean(flight.force_scatter**2) * length
    return out
