"""Filter model: sensors, measurements, gate. One place for simulated, recorded and live flights.

The truth is elsewhere (`sensors.imu`, `simulation`). The scenario decides whether the filter model equals the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.defect import Defect
from navsim.filter import states
from navsim.filter.measurement_kinds import RANGE, SOURCE
from navsim.filter.receiver_clock import UNKNOWN_BIAS, UNKNOWN_DRIFT, ReceiverClock
from navsim.filter.records import CONSTRAINED, GAUSSIAN_SUM, FilterModel
from navsim.filter.states import Block, ReferenceClock, TransmitterClockModel
from navsim.statistics import chi_square

_FLOORS = {"m": 1e-4, "m/s": 1e-6, "rad": 1e-8, "rad/s": 1e-12, "m/s2": 1e-9, "1": 1e-9}
"""Smallest initial sigma of a filter, by the unit of the state. Zeros, from a perfect sensor or start, would make P
singular. A state in another unit must start above 0."""


def gate_limits(probability: float) -> np.ndarray:
    """The largest normalised innovation squared that a gate lets pass, by degrees of freedom (MOST + 1,)."""
    return np.array([np.inf, *(chi_square.exceeded(probability, m) for m in range(1, states.MAX_MEASUREMENT_SIZE + 1))])


@dataclass(frozen=True)
class SensorDesign:
    """Filter model of the inertial sensors."""

    blocks: tuple[Block, ...]
    """States that the filter estimates, biases first."""
    sigma: tuple[float, ...]
    """Initial 1 sigma of each block."""
    noise: np.ndarray
    """(2,) white noise densities of gyros and accelerometers, see `filter.covariance`."""

    def covariance(self, navigation: np.ndarray) -> np.ndarray:
        """Initial P (n, n) from 1 sigma of position, velocity and attitude along each axis (9,), m, m/s, rad. Floors
        keep it regular. Raises Defect for a state with sigma 0 whose unit has no floor."""
        each = np.concatenate([navigation, np.repeat(self.sigma, [block.size for block in self.blocks])])
        floors = np.array([_FLOORS.get(unit, 0.0) for unit in states.units(self.blocks)])
        sigma = np.maximum(each, floors)
        if not np.all(sigma > 0.0):
            name = states.names(self.blocks)[int(np.argmin(sigma))]
            raise Defect(f"the filter starts with sigma 0 of {name}; give it a state only if its sigma is above 0")
        out = np.diag(sigma**2)
        self.correlate_clocks(out)
        return out

    @property
    def clocks(self) -> list[tuple[int, TransmitterClockModel]]:
        """Index of the offset of each transmitter's clock among the error states, and its model."""
        firsts = states.SENSORS + np.cumsum([0, *(block.size for block in self.blocks)])
        return [(int(first), b.clock) for first, b in zip(firsts, self.blocks, strict=False) if b.clock is not None]

    @property
    def reference_clock(self) -> ReferenceClock:
        """The clock against which those of transmitters are counted."""
        return self.clocks[0][1].reference if self.clocks else ReferenceClock()

    def correlate_clocks(self, p: np.ndarray) -> None:
        """Add to a diagonal initial P (n, n) the covariances of clocks, and the variance of their reference clock."""
        offsets = np.array([first for first, _ in self.clocks], np.int64)
        for first, clock in self.clocks:
            p[first, first + 1] = p[first + 1, first] = clock.covariance
        p[np.ix_(offsets, offsets)] += self.reference_clock.offset
        p[np.ix_(offsets + 1, offsets + 1)] += self.reference_clock.rate


@dataclass(frozen=True)
class CorrelatedErrorDesign:
    """Filter model of time-correlated ranging errors."""

    followed: bool
    """The filter estimates them as states, of fixes or of ranges."""
    groups: tuple[tuple[int, ...], ...]
    """Kinds of errors that each group of states describes, as numbers in order."""
    names: tuple[str, ...]
    """Name of each group."""
    factor: np.ndarray
    """(k,) factor on the variance of each kind if the filter treats it as white noise."""


@dataclass(frozen=True)
class FilterDesign:
    """Kind and model of a filter. `FilterModel` describes the fields that are not described here."""

    kind: int
    """`estimate.FILTER_KINDS`."""
    sensors: SensorDesign
    velocity: bool
    """Use the velocity of the fixes."""
    latency: float
    """Age of a fix on arrival, s."""
    lever_arm: np.ndarray
    """(3,) IMU to antenna, body axes, m."""
    sigma_scale: float
    """Factor on the receiver's 1 sigma of a fix."""
    gate: np.ndarray
    """Limits by number of measurements."""
    max_rejected: int
    components: int
    split_heading_sigma: float
    steady_force: bool
    clock: tuple[float, float] | None = None
    """Noise densities of the receiver clock, phase (m2/s) and frequency (m2/s3); None: the filter uses fixes, not
    ranges."""
    correlated: CorrelatedErrorDesign | None = None
    """Model of time-correlated ranging errors, None without."""
    reflections: bool = False
    """The filter knows the size of errors by reflections."""
    tilt_time: float = 0.0
    flag_sigma: np.ndarray | None = None
    """(5, 3) 1 sigma of fixes by their flag: horizontal axes, height, m, velocity, m/s; nan: not used. None: fixes have
    no state."""

    @property
    def tight(self) -> bool:
        """Whether the filter is tightly coupled: its measurements are ranges."""
        return self.clock is not None

    def followed(self, scales: Sequence[int]) -> tuple[int, ...]:
        """Time scales of the sources for which the filter estimates a clock bias."""
        return tuple(scales) if self.tight else ()

    def with_range_errors(self, errors: Sequence[Block]) -> FilterDesign:
        """Copy whose filter estimates these ranging errors of 1 sigma one, instead of earlier ones. They come after the
        states in groups of three."""
        kept = [pair for pair in zip(self.sensors.blocks, self.sensors.sigma, strict=True) if pair[0].sensor != RANGE]
        first = sum(block.size == 3 for block, _ in kept)
        blocks, sigma = zip(*kept[:first], *((block, 1.0) for block in errors), *kept[first:], strict=True)
        return replace(self, sensors=replace(self.sensors, blocks=blocks, sigma=sigma))

    def with_transmitter_errors(self, errors: Sequence[tuple[Block, float]]) -> FilterDesign:
        """Copy whose filter estimates these errors of transmitters, with their 1 sigma, instead of earlier ones. They
        are the last states."""
        each = zip(self.sensors.blocks, self.sensors.sigma, strict=True)
        kept = [pair for pair in each if pair[0].sensor != SOURCE]
        blocks, sigma = zip(*kept, *errors, strict=True)
        return replace(self, sensors=replace(self.sensors, blocks=blocks, sigma=sigma))

    def model(self, noise: np.ndarray | None = None, scales: Sequence[int] = ()) -> FilterModel:
        """Model for the kernels. noise: densities of each IMU interval (n, 2) instead of the sensors'; scales: numbers
        of the sources' time scales."""
        densities = self.sensors.noise[None] if noise is None else noise
        offsets = self.sensors.clocks
        clock = ReceiverClock(
            np.array(self.followed(scales), np.int64), np.array(self.clock or (0.0, 0.0)),
            np.array([first for first, _ in offsets], np.int64),
            np.array([[one.phase, one.frequency] for _, one in offsets]).reshape(-1, 2),
            np.array(self.sensors.reference_clock[:2]),
        )  # fmt: skip
        return FilterModel(
            self.kind, densities, states.declared(self.sensors.blocks), self.gate, self.max_rejected,
            self.components if self.kind == GAUSSIAN_SUM else 0, self.split_heading_sigma, clock,
            # without velocities of fixes nothing confirms a line through those of the filter; filters that keep their
            # linearisation already take the corrections of velocity for part of the force
            self.steady_force and self.velocity and self.kind not in CONSTRAINED, self.tilt_time,
        )  # fmt: skip

    def covariance(self, position: float, velocity: float, attitude: float, scales: Sequence[int] = ()) -> np.ndarray:
        """P (n, n) of a start with these 1 sigmas per axis, m, m/s, rad; scales: as of `model`."""
        known = self.sensors.covariance(np.repeat([position, velocity, attitude], 3))
        return with_unknown_clock(known, len(self.followed(scales)))


def with_unknown_clock(known: np.ndarray, scales: int) -> np.ndarray:
    """Initial P (n + c, n + c) with an unknown clock for so many time scales, from P (n, n) of all other states."""
    sigma = clock_sigma(scales)
    out = np.zeros((known.shape[0] + sigma.size,) * 2)
    out[: known.shape[0], : known.shape[0]] = known
    out[known.shape[0] :, known.shape[0] :] = np.diag(sigma**2)
    return out


def clock_sigma(scales: int) -> np.ndarray:
    """1 sigma that the clock's states are known with at the start: its biases, m, and its drift, m/s."""
    return np.array([*[UNKNOWN_BIAS] * scales, UNKNOWN_DRIFT] if scales else [])
