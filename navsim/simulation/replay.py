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
from navsim.core.dop import geometry_covariance
from navsim.estimation import error_state
from navsim.estimation.beliefs import Beliefs, with_unknown_clock
from navsim.estimation.estimate import FILTER_KINDS, estimate, is_smoother, lost
from navsim.estimation.observations import FIX, PROBE, RANGE, FixTable, Measurements, RangeTable
from navsim.estimation.records import ImuData, by_epoch, schedule, start
from navsim.models.recording import Fixes, Ranges, Samples
from navsim.simulation.alignment import Alignment

_ACCELERATION = 5.0
"""1 sigma of what an aircraft may accelerate between a fix and the alignment, m/s2."""
_STALE = 3.0
"""A start is taken from the fix after the alignment where the one before it is older by this, s."""


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

    arrival (m,) times of the fixes as they came, s; llh, velocity (m, 3), nan where unknown; speed, course (m,) over
    ground, m/s, rad, from the positions where no velocity is known; start_llh, start_velocity: of the fix nearest to
    the alignment, carried on to it over start_age seconds; start_derived: (3,) s over which positions gave the
    components of that velocity, 0 where they are known. ranges: of each epoch (m,) that the fixes are solved from,
    where they are known; an epoch without a fix has nan in its place.
    """

    arrival: np.ndarray
    llh: np.ndarray
    velocity: np.ndarray
    speed: np.ndarray
    course: np.ndarray
    alignment: Alignment
    start_llh: np.ndarray
    start_velocity: np.ndarray
    start_age: float
    start_derived: np.ndarray
    ranges: Ranges | None = None


@dataclass(frozen=True)
class Replayed:
    """What the filter made of a flight, at the times it was asked for: time (t,), navigation (t, NAV), sigma (t, n);
    and of each fix (m,): innovation and its 1 sigma (m, 6), innovation_squared, degrees, status, as of `History`. Of a
    tightly coupled filter these are of the ranges of an epoch, but for the innovations of its fix, which is not used;
    range_innovation, range_status: (m, s, 2) pseudorange and range rate, m, m/s, (m, s), else of no size; log_sigma
    (m,): sum of the logarithms of the 1 sigmas of the innovations that are counted."""

    time: np.ndarray
    navigation: np.ndarray
    sigma: np.ndarray
    innovation: np.ndarray
    innovation_sigma: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray
    log_sigma: np.ndarray
    range_innovation: np.ndarray
    range_status: np.ndarray

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
        return float(0.5 * np.sum(self.innovation_squared[seen]) + np.sum(self.log_sigma[seen]))


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


def prepare(
    sensed: Sensed, fixes: Fixes, alignment: Alignment, latency: float, ranges: Ranges | None = None
) -> RecordedFlight:
    """The flight after an alignment, its fixes `latency` seconds old when they came, or stamped too early by as much
    where it is negative, so that they come when they are valid; sensed: from the alignment on;
    ranges: that the fixes are from, of their epochs and of others, if they are known."""
    begin = alignment.time
    early = max(0.0, -latency)
    late = fixes.time + early
    valid = fixes.time - latency
    inside = (valid > begin) & (late <= sensed.imu_time[-1])
    filled, over = fixes.with_velocity()
    known = np.isfinite(filled.velocity).all(axis=1)
    before, after = np.flatnonzero(known & (valid <= begin + 1e-9)), np.flatnonzero(known & inside)
    at = int(before[-1] if before.size else after[0])
    if after.size and begin - valid[at] > valid[after[0]] - begin + _STALE:
        at = int(after[0])
    velocity = filled.velocity[at]
    ahead = begin - float(valid[at])
    start = earth.llh_from_ecef(
        earth.ecef_from_llh(fixes.llh[at]) + ahead * earth.ned_matrix(fixes.llh[at]).T @ velocity
    )
    arrival, llh, own = late[inside], fixes.llh[inside], fixes.velocity[inside]
    north, east = filled.velocity[inside, :2].T
    speed, course = np.linalg.norm(filled.velocity[inside, :2], axis=1), np.arctan2(east, north)
    if ranges is not None:
        due = ranges.time - latency
        ranges = ranges.take(np.flatnonzero((due > begin) & (ranges.time + early <= sensed.imu_time[-1])))
        solved = np.isin(ranges.time + early, arrival)
        arrival = ranges.time + early
        llh, own, speed, course = (_among(values, solved) for values in (llh, own, speed, course))
    return RecordedFlight(
        **vars(sensed),
        arrival=arrival,
        llh=llh,
        velocity=own,
        speed=speed,
        course=course,
        ranges=ranges,
        alignment=alignment,
        start_llh=start,
        start_velocity=velocity,
        start_age=abs(ahead),
        start_derived=np.where(np.isnan(fixes.velocity[at]), over[at], 0.0),
    )


def _among(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Values (k, ...) at the k places that are there (m,), nan at the others."""
    out = np.full((there.size, *values.shape[1:]), np.nan)
    out[there] = values
    return out


def fly(
    flight: RecordedFlight,
    beliefs: Beliefs,
    fix_sigma: np.ndarray,
    times: np.ndarray,
    until: float = np.inf,
    withheld: np.ndarray | None = None,
    range_sigma: tuple[float, float] | None = None,
) -> Replayed:
    """The flight through a filter or smoother.

    fix_sigma: (6,) of position and velocity of the fixes, north, east, down, m, m/s. times: (t,) at which to answer,
    beside those when fixes came. until: end early, s. withheld: (m,) bool, fixes, or the ranges of their epochs, that
    the filter is not given (their innovation is nan). range_sigma: of pseudoranges (m) and range rates (m/s) overhead,
    for a tightly coupled filter. Raises ArithmeticError where a smoother's covariance fails, ValueError for a tightly
    coupled filter without ranges or their sigmas.
    """
    ranges = flight.ranges if beliefs.tight else None
    if beliefs.tight and (ranges is None or range_sigma is None):
        raise ValueError("a tightly coupled filter needs ranges and their sigmas")
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
    known = valid if is_smoother(kind) else arrival
    tables: dict[int, FixTable | RangeTable] = {}
    scales: tuple[int, ...] = ()
    heard = np.zeros((count, 0), bool)
    if ranges is not None and range_sigma is not None:
        scales, ranges = ranges.clocks, ranges.take(np.arange(count))
        heard = np.isfinite(ranges.pseudorange)
        if withheld is not None:
            heard &= ~withheld[:count, None]
        noise = _noise_of_fixes(ranges, llh, range_sigma, noise)
        tables[RANGE] = _table_of(ranges, heard, scales, range_sigma, beliefs.lever_arm)
    tables[PROBE if beliefs.tight else FIX] = FixTable(llh, velocity, noise, beliefs.lever_arm)
    epoch = np.nonzero(heard)[0]
    events = schedule(outputs, (PROBE if beliefs.tight else FIX, valid, known), (RANGE, valid[epoch], known[epoch]))
    model = replace(beliefs, kind=kind).model(_noise(flight, beliefs), scales)
    history = estimate(
        ImuData(flight.imu_time, flight.dtheta, flight.dv),
        Measurements.of(tables),
        events,
        start(*_start(flight, beliefs, fix_sigma, scales), model.components, heard.shape[1]),
        model,
    )
    if is_smoother(kind) and lost(history):
        raise ArithmeticError("the smoother lost the positive covariance of its flight")
    weighed = events.rows(PROBE if beliefs.tight else FIX)
    squared, degrees, status = (m[weighed] for m in (history.innovation_squared, history.degrees, history.status))
    each = np.where(np.isfinite(history.innovation_sigma), history.innovation_sigma, 1.0)  # 1 where there is none
    log_sigma = np.log(each).sum(axis=1)
    of_ranges = np.full((*heard.shape, 2), np.nan)
    range_status = np.zeros(heard.shape, np.int64)
    logs = log_sigma[weighed]
    if beliefs.tight:
        rows = np.full(heard.shape, -1)
        rows[heard] = events.rows(RANGE)
        squared, degrees, status, range_status = by_epoch(
            rows, history.innovation_squared, history.degrees, history.status
        )
        of_ranges[heard] = history.innovation[rows[heard], :2]
        logs = np.where(rows >= 0, log_sigma[rows], 0.0).sum(axis=1)
    return Replayed(
        outputs, history.navigation, history.sigma(), history.innovation[weighed], history.innovation_sigma[weighed],
        squared, degrees, status, logs, of_ranges, range_status,
    )  # fmt: skip


def _noise_of_fixes(ranges: Ranges, llh: np.ndarray, sigma: tuple[float, float], otherwise: np.ndarray) -> np.ndarray:
    """Covariance of position and velocity (m, 6, 6), NED, of fixes llh (m, 3) by the geometry of their ranges;
    otherwise: where that has no solution."""
    here = np.where(np.isfinite(llh), llh, 0.0)
    away = np.einsum("mij,msj->msi", earth.ned_matrix(here), ranges.position - earth.ecef_from_llh(here)[:, None])
    los = away[..., [1, 0, 2]] * [1.0, 1.0, -1.0] / np.linalg.norm(away, axis=2, keepdims=True)
    los = np.where(np.isfinite(ranges.pseudorange)[..., None], los, np.nan)
    out = otherwise.copy()
    one_clock, ned = np.zeros_like(ranges.clock), [1, 0, 2]
    sign = np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0])
    for first, clock, weight in (
        (0, ranges.clock, (sigma[0] * ranges.slant) ** -2.0),
        (3, one_clock, np.full(ranges.slant.shape, sigma[1] ** -2.0)),
    ):
        solution, unknowns = geometry_covariance(los, clock, weight)
        solved = (unknowns > 0) & np.isfinite(llh[:, 0])
        block = slice(first, first + 3)
        turned = solution[:, :3, :3][:, ned][:, :, ned] * sign
        out[solved, block, block] = turned[solved]
    return out


def _table_of(
    ranges: Ranges, heard: np.ndarray, scales: tuple[int, ...], sigma: tuple[float, float], lever_arm: np.ndarray
) -> RangeTable:
    """The ranges that are heard (m, s) as a filter with the clock of these time scales takes them."""
    source = np.nonzero(heard)[1]
    slant = ranges.slant[heard]
    return RangeTable(
        ranges.position[heard], ranges.velocity[heard], ranges.distance[heard], sigma[0] * slant,
        np.full(slant.size, sigma[1]), source, np.searchsorted(scales, ranges.clock[source]),
        ranges.pseudorange[heard], ranges.range_rate[heard], lever_arm,
    )  # fmt: skip


def _start(
    flight: RecordedFlight, beliefs: Beliefs, fix_sigma: np.ndarray, scales: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Navigation state (NAV,) and covariance (n, n) at the alignment; the start position is the antenna's less the
    lever arm, its accelerometer biases are zero; scales: whose clock the filter follows."""
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
    if not scales or flight.ranges is None:
        return nav, matrix
    clock = _first_clock(flight, flight.ranges, scales)
    return np.concatenate([nav, clock]), with_unknown_clock(matrix, len(scales))


def _first_clock(flight: RecordedFlight, ranges: Ranges, scales: tuple[int, ...]) -> np.ndarray:
    """Biases and drift of the clock (c,) as the first ranges of each time scale have them, by the start position and
    velocity: good to a flight's way until then, beside 10 km that the filter takes it for."""
    here = earth.ecef_from_llh(flight.start_llh)
    moving = earth.ned_matrix(flight.start_llh).T @ flight.start_velocity
    away = ranges.position - here
    distance = np.linalg.norm(away, axis=2)
    bias = ranges.pseudorange - distance
    rate = ranges.range_rate - np.sum(away / distance[..., None] * (ranges.velocity - moving), axis=2)
    rate = np.where(np.isfinite(bias), rate, np.nan)
    out = []
    for scale in scales:
        own = bias[:, ranges.clock == scale]
        out.append(float(np.nanmedian(own[np.isfinite(own).any(axis=1)][0])))
    some = rate[np.isfinite(rate).any(axis=1)]
    # without a range rate nothing is known of the drift, which the filter believes
    return np.array([*out, float(np.nanmedian(some[0])) if some.size else 0.0])


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
