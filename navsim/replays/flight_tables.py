"""A recorded flight as a filter takes it: tables of fixes or ranges, initial state, process noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.filter import covariance, eskf, states
from navsim.filter.design import FilterDesign, with_unknown_clock
from navsim.filter.measurement_kinds import HEADING, RangeTable
from navsim.formats.recorded_data import Ranges
from navsim.geodesy import earth
from navsim.geodesy.attitude import dcm_from_quaternion
from navsim.gnss.dop import geometry_covariance
from navsim.replays.one_way import start_clocks

if TYPE_CHECKING:
    from navsim.replays.recorded_flight import PartStart, RecordedFlight

ACCELERATION = 5.0
"""1 sigma of an aircraft's acceleration between a fix and the alignment, m/s2."""


def fix_covariance(covariance: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Covariance of fixes (m, 6, 6): the receiver's own, nan where it gives none, else by 1 sigma (m, 6)."""
    unknown = np.isnan(covariance)
    usual = sigma[:, :, None] ** 2 * np.eye(sigma.shape[1])
    return np.where(unknown, np.where(unknown.all(axis=2)[..., None], usual, 0.0), covariance)


def noise_of_fixes(ranges: Ranges, llh: np.ndarray, sigma: tuple[float, float], otherwise: np.ndarray) -> np.ndarray:
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


def table_of(
    ranges: Ranges, heard: np.ndarray, scales: tuple[int, ...], sigma: tuple[float, float], lever_arm: np.ndarray
) -> RangeTable:
    """Table of the received ranges (m, s) for a filter with the clock of these time scales."""
    source = np.nonzero(heard)[1]
    slant = ranges.slant[heard]
    return RangeTable(
        ranges.position[heard], ranges.velocity[heard], ranges.distance[heard], sigma[0] * slant,
        np.full(slant.size, sigma[1]), source, np.searchsorted(scales, ranges.clock[source]),
        ranges.pseudorange[heard], ranges.range_rate[heard], lever_arm, np.empty((source.size, 0)),
    )  # fmt: skip


def start_of(
    flight: RecordedFlight,
    begin: PartStart,
    design: FilterDesign,
    fix_sigma: np.ndarray,
    scales: tuple[int, ...],
    ranges: Ranges | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Navigation state (NAV,) and covariance (n, n) at the alignment.

    The position is the antenna's minus the lever arm. Accelerometer biases are zero unless they are kept from before.
    scales: time scales whose clock the filter estimates. ranges: those of the part, in order.
    """
    if begin.known is not None:
        matrix = design.sensors.covariance(begin.known.sigma)
        nav = start_clocks(begin.known.navigation, matrix, flight, begin, design)
        return _with_clock(nav, matrix, begin, ranges, scales)
    alignment = begin.alignment
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_LLH : states.NAV_VEL] = begin.llh
    nav[states.NAV_VEL : states.NAV_QUAT] = begin.velocity
    nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = alignment.quaternion
    nav[states.NAV_GYRO : states.NAV_ACCEL] = alignment.gyro_bias
    if begin.kept is not None:
        nav[states.NAV_ACCEL : states.NAV_N] = begin.kept[0][states.NAV_ACCEL : states.NAV_N]
    eskf.move(nav, *(-dcm_from_quaternion(alignment.quaternion) @ design.lever_arm))
    position_sigma, fix_velocity_sigma = np.split(np.where(np.isnan(begin.own), fix_sigma * begin.weight, begin.own), 2)
    sizes = [3, 3, 3, *(block.size for block in design.sensors.blocks)]
    matrix = np.diag(np.repeat([0.0, 0.0, 0.0, *design.sensors.sigma], sizes) ** 2)
    design.sensors.correlate_clocks(matrix)
    # since the fix the aircraft may have accelerated, and it turns about the antenna
    gained = ACCELERATION * begin.age + np.linalg.norm(flight.rate_scatter) * np.linalg.norm(design.lever_arm)
    derived = begin.derived
    velocity_sigma = 2.0 * fix_velocity_sigma
    unknown = derived > 0.0
    velocity_sigma[unknown] = (
        np.sqrt(2.0) * position_sigma[unknown] / derived[unknown] + 0.5 * ACCELERATION * derived[unknown]
    )
    for first, variance in (
        (states.POS, (2.0 * position_sigma) ** 2 + (0.5 * gained * begin.age) ** 2),
        (states.VEL, velocity_sigma**2 + gained**2),
        (states.GYRO, alignment.gyro_sigma**2),
    ):
        matrix[np.arange(first, first + 3), np.arange(first, first + 3)] = variance
    att = slice(states.ATT, states.ATT + 3)
    matrix[att, att] = alignment.covariance
    if begin.kept is not None:
        inertial = slice(states.ATT, states.N_BASE)
        matrix[inertial, inertial] = begin.kept[1][inertial, inertial]
    # the start contains the time-correlated errors of its fix
    moving, correlated = slice(states.POS, states.ATT), slice(states.N_BASE, states.N_BASE + begin.effect.shape[1])
    matrix[moving, moving] += begin.effect @ begin.effect.T
    matrix[moving, correlated] = -begin.effect
    matrix[correlated, moving] = -begin.effect.T
    # the start contains the lasting error of its heading, whose state is the last one
    if design.sensors.blocks[-1].sensor == HEADING and begin.kept is None:
        matrix[att, -1] = matrix[-1, att] = -(design.sensors.sigma[-1] ** 2) * alignment.by_heading
    nav = start_clocks(nav, matrix, flight, begin, design)
    return _with_clock(nav, matrix, begin, ranges, scales)


def _with_clock(
    nav: np.ndarray, matrix: np.ndarray, begin: PartStart, ranges: Ranges | None, scales: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The start of a filter that follows the clock of these time scales, if there are any."""
    if not scales or ranges is None:
        return nav, matrix
    clock = _first_clock(begin, ranges, scales)
    whole = np.zeros(states.NAV_SENSORS + matrix.shape[0] - states.SENSORS)
    whole[: nav.size] = nav
    return np.concatenate([whole, clock]), with_unknown_clock(matrix, len(scales))


def _first_clock(begin: PartStart, ranges: Ranges, scales: tuple[int, ...]) -> np.ndarray:
    """Biases and drift of the clock (c,) from the first ranges of each time scale, and the initial position and
    velocity.

    Their error is the distance flown until then, small compared with the filter's initial 10 km.
    """
    here = earth.ecef_from_llh(begin.llh)
    moving = earth.ned_matrix(begin.llh).T @ begin.velocity
    away = ranges.position - here
    distance = np.linalg.norm(away, axis=2)
    bias = ranges.pseudorange - distance
    rate = ranges.range_rate - np.sum(away / distance[..., None] * (ranges.velocity - moving), axis=2)
    rate = np.where(np.isfinite(bias), rate, np.nan)
    out = []
    for scale in scales:
        own = bias[:, ranges.clock == scale]
        heard = own[np.isfinite(own).any(axis=1)]
        out.append(float(np.nanmedian(heard[0])) if heard.size else 0.0)  # otherwise it has no effect
    some = rate[np.isfinite(rate).any(axis=1)]
    # without a range rate the drift is unknown, which the filter's sigma reflects
    return np.array([*out, float(np.nanmedian(some[0])) if some.size else 0.0])


def noise_of(flight: RecordedFlight, design: FilterDesign) -> np.ndarray:
    """White densities of each IMU interval (n, 2), or one row where no samples are missing.

    In an interval without samples rate and specific force were anywhere within their scatter over the flight. As white
    noise that leads to the same variances of velocity and attitude in the end.
    """
    sensors = design.sensors.noise[None]
    if not flight.gaps:
        return sensors
    out = np.repeat(sensors, flight.dtheta.shape[0], axis=0)
    for interval, length in flight.gaps:
        out[interval, covariance.NOISE_GYRO] += np.mean(flight.rate_scatter**2) * length
        out[interval, covariance.NOISE_ACCEL] += np.mean(flight.force_scatter**2) * length
    return out
