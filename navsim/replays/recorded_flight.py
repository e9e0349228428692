"""A recording made ready for the filter: increments of the samples, fixes as they arrived, and starts of its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from navsim.filter import states
from navsim.filter.records import TIME_TOLERANCE
from navsim.formats.recorded_data import Fixes, Ranges, Samples
from navsim.geodesy import earth
from navsim.replays.aids import RecordedAid
from navsim.replays.alignment import Alignment

_STALE = 3.0
"""A start is taken from the fix after the alignment where the one before it is older by this, s."""
SURVIVED = np.radians(15.0)
"""Largest 1 sigma of attitude after missing samples with which a filter continues, rad."""


@dataclass(frozen=True)
class InertialLog:
    """Inertial measurements."""

    imu_time: np.ndarray
    """(n + 1,) s."""
    dtheta: np.ndarray
    """(n, 3) increments."""
    dv: np.ndarray
    """(n, 3) increments."""
    gaps: tuple[tuple[int, float], ...]
    """First sample and length, s, of missing samples."""
    rate_scatter: np.ndarray
    """(3,) 1 sigma of the samples, as `force_scatter`."""
    force_scatter: np.ndarray


@dataclass(frozen=True)
class KnownStart:
    """A state of the navigation that is known instead of aligned: time s; navigation (NAV_N,) of the IMU; sigma (9,) 1
    sigma of position, velocity and attitude along north, east, down, m, m/s, rad."""

    time: float
    navigation: np.ndarray
    sigma: np.ndarray

    @property
    def alignment(self) -> Alignment:
        """Attitude and gyro biases as an instantaneous alignment. It has no bias sigma, which a filter knows."""
        attitude = self.navigation[states.NAV_QUAT : states.NAV_BIAS_FRAME]
        covariance = np.diag(self.sigma[states.ATT : states.SENSORS] ** 2)
        gyro_bias = self.navigation[states.NAV_GYRO : states.NAV_ACCEL]
        return Alignment(self.time, attitude, covariance, gyro_bias, np.full(3, np.nan), self.time, self.time)


@dataclass(frozen=True)
class PartStart:
    """Start of a part of a flight."""

    alignment: Alignment
    llh: np.ndarray
    """(3,) of the nearest fix, extrapolated to the alignment."""
    velocity: np.ndarray
    """(3,) of that fix."""
    age: float
    """Time of extrapolation, s."""
    derived: np.ndarray
    """(3,) interval of the positions from which components of that velocity were computed, s, 0 for measured ones."""
    own: np.ndarray
    """(6,) 1 sigma of the fix from the receiver, nan if missing."""
    weight: np.ndarray
    """(6,) 1 sigma of the fix over that of a usual one, see `Fixes`."""
    effect: np.ndarray
    """(6, k) see `Fixes`."""
    kept: tuple[np.ndarray, np.ndarray] | None = None
    """Navigation (NAV,) and covariance (n, n) of the filter before; the part keeps their attitude and biases."""
    known: KnownStart | None = None
    """A known state, which replaces all of it."""

    @classmethod
    def at(cls, known: KnownStart) -> PartStart:
        """At a state that is known."""
        llh, velocity = known.navigation[states.NAV_LLH : states.NAV_VEL], known.navigation[states.NAV_VEL :][:3]
        none, one = np.full(6, np.nan), np.ones(6)
        return cls(known.alignment, llh, velocity, 0.0, np.zeros(3), none, one, np.empty((6, 0)), known=known)


@dataclass(frozen=True)
class RecordedFlight(InertialLog):
    """A recording ready for the filter, from the alignment on."""

    arrival: np.ndarray
    """(m,) times of arrival of the fixes, s."""
    llh: np.ndarray
    """(m, 3)."""
    velocity: np.ndarray
    """(m, 3) nan where unknown."""
    speed: np.ndarray
    """(m,) over ground, m/s, from positions where no velocity is known."""
    course: np.ndarray
    """(m,) rad, likewise."""
    start: PartStart
    """Start of the first part."""
    restart: Callable[[float], PartStart | None]
    """Start of the next part at or after a time; None without one."""
    patience: float
    """Duration of contradiction after which a filter counts as lost, s."""
    covariance: np.ndarray
    """(m, 6, 6) nan where unknown."""
    effect: np.ndarray
    """(m, 6, k) see `Fixes`."""
    weight: np.ndarray
    """(m, 6) see `Fixes`."""
    row: np.ndarray
    """(m,) numbers of the fixes, or epochs of ranges, in the recording."""
    velocity_lag: float = 0.0
    """How much older the velocity of a fix is than its position, s."""
    ranges: Ranges | None = None
    """Ranges of each epoch (m,) from which the fixes are solved, if known. An epoch without a fix has a row of nan."""
    aids: tuple[RecordedAid, ...] = ()
    """Measurements beside the fixes."""

    @property
    def breaks(self) -> tuple[tuple[float, float], ...]:
        """Begin and end, s, of the missing samples that the attitude does not survive: within them the rate was
        anywhere within its scatter over the flight."""
        scatter = np.sqrt(np.mean(self.rate_scatter**2))
        return tuple(
            (float(self.imu_time[k]), float(self.imu_time[k + 1]))
            for k, length in self.gaps
            if scatter * length > SURVIVED
        )


def increments(samples: Samples, begin: float, longest_gap: float, averaged: bool) -> InertialLog:
    """Inertial measurements from `begin` (s) on.

    longest_gap: interval from which samples count as missing, s. averaged: a sample is the mean since the one before;
    otherwise increments are the trapezoid of the samples at both ends.
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
    return InertialLog(
        imu_time=imu_time,
        dtheta=rate * step,
        dv=force * step,
        gaps=tuple((int(k), float(step[k, 0])) for k in lost),
        rate_scatter=samples.rate[keep].std(axis=0),
        force_scatter=samples.force[keep].std(axis=0),
    )


def sum_intervals(sensed: InertialLog, interval: float) -> InertialLog:
    """The same measurements, summed over so many intervals at a time that these last for `interval`, s, at most.

    Intervals of missing samples remain, and the first one.
    """
    begin = sensed.imu_time[:-1]
    alone = np.isin(np.arange(begin.size), [0, *(first for first, _ in sensed.gaps)])
    block = np.cumsum(alone | np.concatenate([[False], alone[:-1]]))
    first_of = begin[np.searchsorted(block, block)]
    number = np.floor((begin - first_of + TIME_TOLERANCE) / interval)
    starts = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(number, prepend=-1.0).astype(bool))
    rows = np.searchsorted(starts, [first for first, _ in sensed.gaps])
    return replace(
        sensed,
        imu_time=sensed.imu_time[np.append(starts, begin.size)],
        dtheta=np.add.reduceat(sensed.dtheta, starts),
        dv=np.add.reduceat(sensed.dv, starts),
        gaps=tuple((int(row), length) for row, (_, length) in zip(rows, sensed.gaps, strict=True)),
    )


def prepare(
    sensed: InertialLog,
    fixes: Fixes,
    alignment: Alignment,
    latency: float,
    ranges: Ranges | None = None,
    align: Callable[[float], Alignment | None] = lambda _: None,
    patience: float = np.inf,
    known: KnownStart | None = None,
    velocity_lag: float = 0.0,
) -> RecordedFlight:
    """Prepare the flight after an alignment, or from a known state on.

    - `sensed`: samples from the alignment on.
    - `latency`: age of the fixes on arrival, s. Negative: their time stamps are too early by that, and they arrive when
      they
      are valid.
    - `ranges`: those of the fixes' epochs and of others, if known.
    - `align`: next alignment at or after a time, s; `patience`: see `RecordedFlight`.
    - `known`: the state at the alignment, if known.
    - `velocity_lag`: how much older the velocity of a fix is than its position, s.
    """
    begin = alignment.time
    early = fix_delay(latency, velocity_lag)
    late = fixes.time + early
    valid = fixes.time - latency
    end = float(sensed.imu_time[-1]) + TIME_TOLERANCE
    inside = (valid > begin) & (late <= end)
    filled, over = fixes.with_velocity()

    def start_at(aligned: Alignment) -> PartStart:
        return _start_at(aligned, fixes, filled, over, latency, float(sensed.imu_time[-1]), abs(velocity_lag))

    def restart(time: float) -> PartStart | None:
        again = align(time)
        return None if again is None or again.time >= sensed.imu_time[-2] else start_at(again)

    row, arrival, llh, own = np.flatnonzero(inside), late[inside], fixes.llh[inside], fixes.velocity[inside]
    covariance = np.full((fixes.time.size, 6, 6), np.nan) if fixes.covariance is None else fixes.covariance
    covariance = covariance[inside]
    effect = np.empty((fixes.time.size, 6, 0)) if fixes.effect is None else fixes.effect
    effect, weight = effect[inside], fixes.weight[inside]
    north, east = filled.velocity[inside, :2].T
    speed, course = np.linalg.norm(filled.velocity[inside, :2], axis=1), np.arctan2(east, north)
    if ranges is not None:
        due = ranges.time - latency
        row = np.flatnonzero((due > begin) & (ranges.time + early <= end))
        ranges = ranges.take(row)
        solved = np.isin(ranges.time + early, arrival)
        arrival = ranges.time + early
        llh, own, speed, course, covariance, effect, weight = (
            _among(values, solved) for values in (llh, own, speed, course, covariance, effect, weight)
        )
    return RecordedFlight(
        **vars(sensed),
        arrival=arrival,
        llh=llh,
        velocity=own,
        speed=speed,
        course=course,
        start=start_at(alignment) if known is None else PartStart.at(known),
        restart=restart,
        patience=patience,
        covariance=covariance,
        effect=effect,
        weight=weight,
        row=row,
        velocity_lag=velocity_lag,
        ranges=ranges,
    )


def _start_at(
    alignment: Alignment, fixes: Fixes, filled: Fixes, over: np.ndarray, latency: float, last: float, lag: float
) -> PartStart:
    """Start at an alignment from the nearest fix; filled, over: as of `Fixes.with_velocity`; last: the end of the
    flight, s; lag: time between its position and its velocity, s."""
    begin, valid = alignment.time, fixes.time - latency
    known = np.isfinite(filled.velocity).all(axis=1)
    before = np.flatnonzero(known & (valid <= begin + 1e-9))
    after = np.flatnonzero(known & (valid > begin) & (fixes.time <= last))
    at = int(before[-1] if before.size else after[0])
    if after.size and begin - valid[at] > valid[after[0]] - begin + _STALE:
        at = int(after[0])
    velocity = filled.velocity[at]
    ahead = begin - float(valid[at])
    here = earth.llh_from_ecef(
        earth.ecef_from_llh(fixes.llh[at]) + ahead * earth.ned_matrix(fixes.llh[at]).T @ velocity
    )
    derived = np.where(np.isnan(fixes.velocity[at]), over[at], 0.0)
    own = np.full(6, np.nan) if fixes.covariance is None else np.sqrt(np.diag(fixes.covariance[at]))
    effect = np.empty((6, 0)) if fixes.effect is None else fixes.effect[at]
    return PartStart(alignment, here, velocity, abs(ahead) + lag, derived, own, fixes.weight[at], effect)


def _among(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Values (k, ...) at the k places that are there (m,), nan at the others."""
    out = np.full((there.size, *values.shape[1:]), np.nan)
    out[there] = values
    return out


def fix_delay(latency: float, velocity_lag: float) -> float:
    """Time, s, after its stamp at which a fix is complete: one that is stamped too early waits until it is valid."""
    return max(0.0, -latency, -latency - velocity_lag)
