"""What a filter believes: of the sensors, of the measurements, and what it does with those that cannot be true.

The one home of it, for simulated, recorded and live flights. What the truth is stands elsewhere (`sensors.imu`,
`simulation`); that a filter believes what is true is a choice of the scenario.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.core import states
from navsim.core.states import Block
from navsim.estimation.clock import UNKNOWN_BIAS, UNKNOWN_DRIFT, ReceiverClock
from navsim.estimation.observations import RANGE
from navsim.estimation.records import CONSTRAINED, GAUSSIAN_SUM, FilterModel

_FLOORS = {"m": 1e-4, "m/s": 1e-6, "rad": 1e-8, "rad/s": 1e-12, "m/s2": 1e-9, "1": 1e-9}
"""Smallest initial sigma a filter is given, by the unit of the state: with zeros P would be singular, and a perfect
sensor or a perfect start is a common check."""


@dataclass(frozen=True)
class SensorBeliefs:
    """What a filter believes of its inertial sensors: the states it follows, biases first, their 1 sigma at the start
    (one a block), and the white densities of gyros and accelerometers (2,), see `core.covariance`."""

    blocks: tuple[Block, ...]
    sigma: tuple[float, ...]
    noise: np.ndarray

    def covariance(self, navigation: np.ndarray) -> np.ndarray:
        """P (n, n) of a start from 1 sigma of position, velocity and attitude along each axis (9,), m, m/s, rad; none
        is below what keeps it regular."""
        each = np.concatenate([navigation, np.repeat(self.sigma, [block.size for block in self.blocks])])
        floors = np.array([_FLOORS[unit] for unit in states.units(self.blocks)])
        return np.diag(np.maximum(each, floors) ** 2)


@dataclass(frozen=True)
class LastingBelief:
    """What a filter makes of time-correlated errors of ranges: followed: whether as states, of fixes or of ranges;
    groups: numbers of the kinds of errors that the states stand for, in order, names: of the groups; factor: (k,) by
    which the variance of each kind is larger as noise, where they are none."""

    followed: bool
    groups: tuple[tuple[int, ...], ...]
    names: tuple[str, ...]
    factor: np.ndarray


@dataclass(frozen=True)
class Beliefs:
    """What a filter is and believes.

    kind: `estimate.FILTER_KINDS`. velocity: whether it uses that of the fixes. latency: age of the fixes when they
    come, s. lever_arm: (3,) IMU -> antenna, body, m. sigma_scale: factor on the 1 sigma that the receiver gives its
    fixes. gate: limits by the number of measurements; components, widest: of a Gaussian sum; steady_force; of all see
    `FilterModel`. clock: densities of the noises of the receiver's clock, phase (m2/s) and frequency (m2/s3), where
    ranges are measurements instead of fixes; None where they are not. lasting: what it makes of errors that last, None
    without. reflections: whether it knows how large errors by reflections are.
    """

    kind: int
    sensors: SensorBeliefs
    velocity: bool
    latency: float
    lever_arm: np.ndarray
    sigma_scale: float
    gate: np.ndarray
    max_rejected: int
    components: int
    widest: float
    steady_force: bool
    clock: tuple[float, float] | None = None
    lasting: LastingBelief | None = None
    reflections: bool = False

    @property
    def tight(self) -> bool:
        """Whether ranges are measurements instead of fixes."""
        return self.clock is not None

    def followed(self, scales: Sequence[int]) -> tuple[int, ...]:
        """Of the time scales that sources keep, those that it has a bias of the clock for."""
        return tuple(scales) if self.tight else ()

    def with_range_errors(self, errors: Sequence[Block]) -> Beliefs:
        """The same of a filter that follows these errors of ranges, of 1 sigma one, and none that it followed before.
        They come behind states in groups of three, before others."""
        kept = [pair for pair in zip(self.sensors.blocks, self.sensors.sigma, strict=True) if pair[0].triad != RANGE]
        first = sum(block.size == 3 for block, _ in kept)
        blocks, sigma = zip(*kept[:first], *((block, 1.0) for block in errors), *kept[first:], strict=True)
        return replace(self, sensors=replace(self.sensors, blocks=blocks, sigma=sigma))

    def model(self, noise: np.ndarray | None = None, scales: Sequence[int] = ()) -> FilterModel:
        """What the kernels take; noise: densities of each interval of the IMU (n, 2) instead of the sensors' own;
        scales: numbers of the time scales that sources keep."""
        densities = self.sensors.noise[None] if noise is None else noise
        clock = ReceiverClock(np.array(self.followed(scales), np.int64), np.array(self.clock or (0.0, 0.0)))
        return FilterModel(
            self.kind, densities, states.declared(self.sensors.blocks), self.gate, self.max_rejected,
            self.components if self.kind == GAUSSIAN_SUM else 0, self.widest, clock,
            # without velocities of fixes nothing confirms a line through those of the filter; filters that keep their
            # linearisation already take the corrections of velocity for part of the force
            self.steady_force and self.velocity and self.kind not in CONSTRAINED,
        )  # fmt: skip

    def covariance(self, position: float, velocity: float, attitude: float, scales: Sequence[int] = ()) -> np.ndarray:
        """P (n, n) of a start with these 1 sigmas per axis, m, m/s, rad; scales: as of `model`."""
        known = self.sensors.covariance(np.repeat([position, velocity, attitude], 3))
        return with_unknown_clock(known, len(self.followed(scales)))


def with_unknown_clock(known: np.ndarray, scales: int) -> np.ndarray:
    """P (n + c, n + c) of a start with P (n, n) of all but a clock against so many time scales."""
    sigma = clock_sigma(scales)
    out = np.zeros((known.shape[0] + sigma.size,) * 2)
    out[: known.shape[0], : known.shape[0]] = known
    out[known.shape[0] :, known.shape[0] :] = np.diag(sigma**2)
    return out


def clock_sigma(scales: int) -> np.ndarray:
    """1 sigma that the clock's states are known with at the start: its biases, m, and its drift, m/s."""
    return np.array([*[UNKNOWN_BIAS] * scales, UNKNOWN_DRIFT] if scales else [])

