"""Measurements of a recorded flight beside its fixes: headings, rest, wheels that do not slip sideways, and ranges of
beacons.

Sources: `docs/theory/ground.md`, `docs/theory/beacons.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.filter.measurement_kinds import BEACON, HEADING, REST_RATE, VEHICLE_VELOCITY, BeaconTable, VehicleTable
from navsim.filter.states import Block, correlated_single
from navsim.formats.recorded_data import Fixes, Headings, Samples
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.ranging.recording import RangeLog
from navsim.scenario_files.base import DEG
from navsim.sensors.beacons import BeaconErrors

if TYPE_CHECKING:
    from navsim.replays.alignment import Search, Standstill
    from navsim.replays.scenario import BeaconRanges, HeadingSection, SideSlip, Standstills

WINDOW = 1.0
"""Length of the pieces that are tested for rest, s."""
SCATTER = 2.0
"""A piece at rest scatters less than this many times the sensor's own noise,"""
DRIFTED = 4.0
"""and its mean rate is that of the Earth and the bias within this many of their sigmas."""
FEWEST = 10
"""Pairs of pieces side by side from which on their mean rates show the noise of these."""
MOVES = 0.5
"""A piece is no rest if a fix in it is faster, m/s, or faster than `DRIFTED` sigmas."""


@dataclass(frozen=True)
class RecordedAid:
    """Measurements of a kind; those of the same kind have the same axes and lever arm."""

    name: str
    kind: int
    """Of `filter.measurement_kinds`."""
    time: np.ndarray
    """(k,) s, increasing."""
    table: VehicleTable | BeaconTable
    of_receiver: bool = False
    """Missing where fixes are withheld."""


def merge_aids(aids: list[tuple[RecordedAid, np.ndarray]], missing: list[np.ndarray]) -> VehicleTable | BeaconTable:
    """Some measurements (k,) int of each of these aids of one kind, one aid after the other, without the values that
    are missing (k,) bool."""
    table = aids[0][0].table
    names = ("range", "beacon") if isinstance(table, BeaconTable) else ("value", "variance")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(aid.table, name)[keep] for aid, keep in aids]) for name in names
    }
    columns[names[0]][np.concatenate(missing)] = np.nan
    return table._replace(**columns)


def antenna_axis(section: HeadingSection) -> np.ndarray:
    """Body axis (3,) whose heading is measured."""
    angle = section.mounting_deg * DEG
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def heading_aid(headings: Headings, section: HeadingSection, factor: float) -> RecordedAid:
    """Headings with their sigma times a factor."""
    value = np.full((headings.time.size, 3), np.nan)
    value[:, 0] = headings.value
    axes = np.eye(3)
    axes[0] = headings.axis
    variance = np.repeat((factor * headings.sigma[:, None]) ** 2, 3, axis=1)
    table = VehicleTable(value, variance, axes, np.zeros(3))
    return RecordedAid("heading", HEADING, headings.time, table, section.source == "antennas")


def heading_blocks(headings: Headings, section: HeadingSection, step: float) -> list[tuple[Block, float]]:
    """State of the lasting error of headings with its 1 sigma, rad, if there is one; step: of the filter, s."""
    sigma, time = headings.lasting, section.correlation_time_s
    return [(correlated_single("heading_error", "rad", HEADING, 0, sigma, time, step), sigma)] if sigma > 0.0 else []


@dataclass(frozen=True)
class OwnNoise:
    """Samples of sensors at rest: 1 sigma of a sample (3,), rad/s, m/s2; mean rates (r, 3) at times (r,), s, and their
    1 sigma later, rad/s."""

    rate: np.ndarray
    force: np.ndarray
    time: np.ndarray
    mean: np.ndarray
    strays: float


def own_noise(rests: list[Standstill], density: tuple[float, float], interval: float, wanted: Search) -> OwnNoise:
    """Noise of the sensors in the quietest standstill that fixes confirm, and mean rates of all; of the sensors' class
    where there is none."""
    if not rests:
        gyro, accel = (np.full(3, each / np.sqrt(interval)) for each in density)
        return OwnNoise(gyro, accel, np.zeros(1), np.zeros((1, 3)), wanted.gyro_sigma)
    quiet = min(rests, key=lambda rest: float(np.linalg.norm(rest.force_sigma)))
    time, mean = np.array([rest.end for rest in rests]), np.array([rest.rate for rest in rests])
    return OwnNoise(quiet.rate_sigma, quiet.force_sigma, time, mean, wanted.gyro_strays)


def pieces_at_rest(samples: Samples, fixes: Fixes, own: OwnNoise, sigma: float) -> np.ndarray:
    """Begin and end (k, 2), s, of the pieces of `WINDOW` seconds at rest.

    The samples decide. Each axis scatters by no more than `SCATTER` times the sensors' own noise, and the mean rate is
    that of the standstill next to it. So are the pieces before and after, with the same mean specific force: a brake
    ends with a jerk. A fix that moves can only overrule them; sigma: of its velocity, m/s.
    """
    edges = np.arange(samples.time[0], samples.time[-1] - WINDOW, WINDOW)
    first, last = np.searchsorted(samples.time, edges), np.searchsorted(samples.time, edges + WINDOW)
    usual = WINDOW / float(np.median(np.diff(samples.time)))
    full = last - first > 0.8 * usual
    still, means = full.copy(), []
    for values, noise in ((samples.rate, own.rate), (samples.force, own.force)):
        count = np.maximum(last - first, 1)[:, None]
        sums, squares = (np.concatenate([np.zeros((1, 3)), np.cumsum(each, axis=0)])
                         for each in (values - values[0], (values - values[0]) ** 2))  # fmt: skip
        mean = (sums[last] - sums[first]) / count
        variance = np.maximum((squares[last] - squares[first]) / count - mean**2, 0.0)
        still &= (variance <= (SCATTER * noise) ** 2).all(axis=1)
        means.append(mean + values[0])
    limit = DRIFTED * np.hypot(own.strays, own.rate / np.sqrt(usual))
    nearest = np.argmin(np.abs(edges[:, None] - own.time), axis=1)
    still &= (np.abs(means[0] - own.mean[nearest]) <= limit).all(axis=1)
    speed = np.linalg.norm(fixes.velocity[:, :2], axis=1)
    fast = fixes.time[speed > min(MOVES, DRIFTED * sigma)]
    still &= np.searchsorted(fast, edges) == np.searchsorted(fast, edges + WINDOW, side="right")
    limit = DRIFTED * np.sqrt(2.0 / usual) * own.force
    alike = still[1:] & still[:-1] & (np.abs(np.diff(means[1], axis=0)) <= limit).all(axis=1)
    still = np.concatenate([[False], alike]) & np.concatenate([alike, [False]])
    return np.stack([edges, edges + WINDOW], axis=1)[still]


def rest_aids(
    samples: Samples, rests: np.ndarray, own: OwnNoise, section: Standstills, like: VehicleTable
) -> list[RecordedAid]:
    """Zero velocity and, if wanted, zero rotation at the end of each piece at rest (k, 2); like: a table with the axes
    and the lever arm of all velocities."""
    zero = np.zeros((rests.shape[0], 3))
    velocity = like._replace(value=zero, variance=zero + section.velocity_sigma_m_s**2)
    out = [RecordedAid("zero velocity", VEHICLE_VELOCITY, rests[:, 1], velocity)]
    if section.rotation:
        pieces = [samples.between(begin, end).rate for begin, end in rests]
        mean = np.array([piece.mean(axis=0) for piece in pieces]).reshape(-1, 3)
        count = np.array([piece.shape[0] for piece in pieces]).reshape(-1, 1)
        # flicker adds to white noise: the Allan variance of pieces side by side
        change = np.diff(mean, axis=0)[np.diff(rests[:, 0]) < 1.5 * WINDOW]
        allan = 0.5 * np.mean(change**2, axis=0) if change.shape[0] >= FEWEST else 0.0
        table = VehicleTable(mean, np.maximum(own.rate**2 / count, allan), np.eye(3), np.zeros(3))
        out.append(RecordedAid("zero rotation", REST_RATE, rests[:, 1], table))
    return out


def side_slip_aid(samples: Samples, rests: np.ndarray, section: SideSlip) -> RecordedAid:
    """No lateral and vertical velocity, at each `spacing_s`, but in the pieces at rest (k, 2)."""
    time = np.arange(samples.time[0] + section.spacing_s, samples.time[-1], section.spacing_s)
    time = time[np.searchsorted(rests[:, 0], time) == np.searchsorted(rests[:, 1], time)]
    value = np.zeros((time.size, 3))
    value[:, 0] = np.nan
    lateral, vertical = section.sigma_m_s
    variance = np.tile([1.0, lateral**2, vertical**2], (time.size, 1))
    axes = dcm_from_rpy(np.array(section.mounting_deg) * DEG)
    return RecordedAid(
        "side slip", VEHICLE_VELOCITY, time, VehicleTable(value, variance, axes, np.array(section.lever_arm_m))
    )


def side_slip_blocks(section: SideSlip) -> list[tuple[Block, float]]:
    """States of the vehicle's axes, rad, and of the lever arm, m, with their 1 sigma."""
    axes = Block("vehicle_axes", "rad", VEHICLE_VELOCITY, of_body=True)
    arm = Block("vehicle_lever_arm", "m", VEHICLE_VELOCITY, of_body=True, first=3)
    sized = ((axes, section.mounting_sigma_deg * DEG), (arm, section.lever_arm_sigma_m))
    return [(block, sigma) for block, sigma in sized if sigma > 0.0]


def beacon_errors(section: BeaconRanges) -> BeaconErrors:
    """Errors of each beacon that last."""
    grows, distance = (0.0, 1.0) if section.growth is None else (section.growth.sigma_m, section.growth.distance_m)
    return BeaconErrors(section.bias_sigma_m, 0.0, grows, distance, section.survey_sigma_m)


def range_aids(log: RangeLog, section: BeaconRanges) -> list[RecordedAid]:
    """Ranges, an aid for each beacon; positions of the beacons are geodetic."""
    origin, enu = log.sources.origin, log.sources.position
    assert origin is not None
    position = ecef_from_llh(origin) + (enu[:, [1, 0, 2]] * [1.0, 1.0, -1.0]) @ ned_matrix(origin)
    like = BeaconTable.none()._replace(
        position=position, axes=ned_matrix(llh_from_ecef(position)), sigma=section.sigma_m,
        growth_distance=beacon_errors(section).growth_distance, lever_arm=np.array(section.lever_arm_m),
    )  # fmt: skip
    out = []
    for number, name in enumerate(log.sources.names):
        its = np.flatnonzero(log.source == number)
        table = like._replace(range=log.range[its], beacon=np.full(its.size, number))
        out.append(
            RecordedAid(f"range of {name}", BEACON, log.time[its] + section.time_offset_s - section.latency_s, table)
        )
    return out
