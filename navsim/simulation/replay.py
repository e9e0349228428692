"""A recorded flight through the filter: increments from samples, fixes as they came, nothing simulated.

A fix that arrived late is used for the time it was valid, and the answer at each output time is what could be known
then: see `estimation.loosely_coupled`. Where samples are missing for long, the flight goes on with interpolated motion
and a covariance that knows it.
"""

from __future__ import annotations

import itertools
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

    arrival (m,) times of the fixes as they came, s; llh, velocity (m, 3); start_llh, start_velocity: of the fix nearest
    to the alignment, carried on to it over start_age seconds.
    """

    arrival: np.ndarray
    llh: np.ndarray
    velocity: np.ndarray
    alignment: Alignment
    start_llh: np.ndarray
    start_velocity: np.ndarray
    start_age: float


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
        sigma = self.misfit_sigma[counted]
        return float(0.5 * np.nansum(self.squared[counted]) + np.sum(np.log(sigma[np.isfinite(sigma)])))


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
    velocity = np.nan_to_num(fixes.velocity[at])
    ahead = begin - float(valid[at])
    start = wgs84.llh_from_ecef(
        wgs84.ecef_from_llh(fixes.llh[at]) + ahead * wgs84.ned_matrix(fixes.llh[at]).T @ velocity
    )
    return Flight(
        **vars(felt),
        arrival=late[inside],
        llh=fixes.llh[inside],
        velocity=fixes.velocity[inside],
        alignment=alignment,
        start_llh=start,
        start_velocity=velocity,
        start_age=abs(ahead),
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
    filter is not given (their misfit is nan).
    """
    nav, p = _start(flight, beliefs)
    noise = process_noise(beliefs.gyro, beliefs.accel)
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

    pieces = []
    done = 0
    lost = dict(flight.gaps)
    edges = sorted({0, *lost, *(k + 1 for k in lost), flight.imu_time.size - 1})
    for number, (first, last) in enumerate(itertools.pairwise(edges)):
        end = flight.imu_time[last]
        final = number == len(edges) - 2
        stop = arrival.size if final else int(np.searchsorted(arrival - beliefs.latency, end, side="right"))
        # an epoch without a fix at the end of a piece: the filter stops there, and the next piece goes on
        rows = [np.full(3, np.nan)] if not final else []
        when = np.concatenate([arrival[done:stop], [] if final else [end + beliefs.latency]])
        count = when.size
        out = loosely_coupled.Flown.of(count)
        job = (
            flight.imu_time[first : last + 1], flight.dtheta[first:last], flight.dv[first:last], nav, p,
            _unsampled(noise, flight, lost[first]) if first in lost else noise,
            np.maximum(when - beliefs.latency, flight.imu_time[first]),
            np.array([*llh[done:stop], *rows]).reshape(-1, 3),
            np.array([*velocity[done:stop], *rows]).reshape(-1, 3), np.tile(noise_of_fix, (count, 1, 1)), True,
            beliefs.latency, beliefs.lever_arm, beliefs.gate, beliefs.max_rejected, np.zeros((count + 1, 3)),
            np.zeros((count + 1, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count + 1, 1)), np.zeros((count + 1, 6)), out,
            covariance.STRIDE,
        )  # fmt: skip
        if kind in smoother.PASSES:
            smoother.run(*job, smoother.PASSES[kind])
        else:
            loosely_coupled.run(kind, *job)
        pieces.append(loosely_coupled.Flown(*(a[: a.shape[0] - len(rows)] for a in out)))
        done = stop
    estimate = np.concatenate([pieces[0].estimate[:1], *(o.estimate[1:] for o in pieces)])
    sigma = np.concatenate([pieces[0].sigma[:1], *(o.sigma[1:] for o in pieces)])

    def of_fixes(name: str) -> np.ndarray:
        return np.concatenate([getattr(o, name) for o in pieces])[is_fix]

    return Replay(
        time=np.concatenate([[flight.imu_time[0]], arrival]),
        llh=estimate[:, states.NAV_LLH : states.NAV_LLH + 3],
        velocity=estimate[:, states.NAV_VEL : states.NAV_VEL + 3],
        quaternion=estimate[:, states.NAV_QUAT : states.NAV_QUAT + 4],
        bias=estimate[:, states.NAV_GYRO : states.NAV_GYRO + 6],
        sigma=sigma,
        misfit=of_fixes("misfit"),
        misfit_sigma=of_fixes("misfit_sigma"),
        squared=of_fixes("innovation"),
        degrees=of_fixes("degrees"),
        status=of_fixes("status"),
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
    for first, variance in (
        (states.POS, (2.0 * beliefs.position_sigma) ** 2 + (0.5 * gained * flight.start_age) ** 2),
        (states.VEL, (2.0 * beliefs.velocity_sigma) ** 2 + gained**2),
        (states.GYRO, alignment.gyro_sigma**2),
        (states.ACCEL, np.full(3, beliefs.accel.initial_sigma() ** 2)),
    ):
        matrix[np.arange(first, first + 3), np.arange(first, first + 3)] = variance
    att = slice(states.ATT, states.ATT + 3)
    matrix[att, att] = alignment.covariance
    return nav, matrix.ravel()


def _unsampled(noise: np.ndarray, flight: Flight, length: float) -> np.ndarray:
    """Process noise (6,) for `length` seconds without samples: rate and specific force were then anywhere within their
    scatter over the flight. As white noise that leads to the same variances in the end."""
    out = noise.copy()
    out[covariance.NOISE_GYRO] += np.mean(flight.rate_scatter**2) * length
    out[covariance.NOISE_ACCEL] += np.mean(flight.force_scatter**2) * length
    return out
