"""The one table of states: order, slices, names, units. Nothing else in navsim counts them.

Error state (filter, results): truth minus estimate. Nine errors of navigation in the order of the landing paper's
equation (1), then errors of the sensors, which are declared: a filter follows the blocks it is given, the biases of
both inertial triads first. A tightly coupled filter has the receiver's clock behind them, the bias of each time scale
that its sources keep and the one drift. Navigation state (strapdown): one flat array, the `NAV_*` offsets below.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navsim.defect import Defect

# --- error state: the navigation block
POS, VEL, ATT = 0, 3, 6
"""First index of the position, velocity and attitude errors."""
R_N, R_E, R_D, V_N, V_E, V_D, PHI_N, PHI_E, PHI_D = range(9)
"""Each of them: position, velocity, attitude; north, east, down."""
SENSORS = 9
"""Size of the navigation block: the first index of the declared sensor states."""
GYRO, ACCEL = 9, 12
"""First index of the gyro and accelerometer biases, which every filter follows."""
N_BASE = 15
"""States of a filter that follows nothing but the biases."""
MAX_MEASUREMENT_SIZE = 6
"""Most numbers that one measurement has."""

# --- navigation state: latitude, longitude [rad], height [m]; velocity NED [m/s]; quaternion b -> n (scalar first); the
# turn that the `tfg` filter's bias axes have been held back by (quaternion, see `filter.tfg`; zeros at the start of
# a flight); estimates of the sensor states, biases [rad/s, m/s2] first, and of the clock, in the order of the error
# state
NAV_LLH, NAV_VEL, NAV_QUAT, NAV_BIAS_FRAME, NAV_SENSORS = 0, 3, 6, 10, 14
NAV_GYRO, NAV_ACCEL = 14, 17
NAV_N = 20
"""Size of the navigation state of a filter of `N_BASE` states."""

# --- declared sensor states
GYROS, ACCELEROMETERS = 0, 1
"""The triad that a sensor state belongs to."""
CONSTANT = -1
"""Signal of a state whose effect does not depend on rates or forces."""


DECLARED = np.dtype([("sensor", "i8"), ("axis", "i8"), ("signal", "i8"), ("decay", "f8"), ("drive", "f8")], align=True)
"""A sensor state of a filter or of a truth. Kernels take an array of them (k,). A state x adds x to what its `sensor`
measures along `axis`. If `signal` is an axis, not `CONSTANT`, it adds x times the sensor's input along that axis. Axes
of gyros from 3 on are axes of specific force; only a truth has them. `sensor` may be a kind of measurements
(`filter.measurement_kinds`); `axis` then counts its time-correlated errors or, with a `signal`, its axes. `decay`
(1/s): rate of decay. `drive` (unit2/s): density of the driving noise."""


class ReferenceClock(NamedTuple):
    """Filter model of the clock against which others are counted: all of them share its errors."""

    phase: float = 0.0
    """Density of the white noise of its phase, m2/s."""
    frequency: float = 0.0
    """Density of the white noise of its frequency, m2/s3."""
    offset: float = 0.0
    """Variance of its offset at the start, m2."""
    rate: float = 0.0
    """Variance of its rate at the start, m2/s2."""


class TransmitterClockModel(NamedTuple):
    """Filter model of the clock of a transmitter, whose offset is a state and whose rate is the next one.

    Densities and 1 sigmas of the states are without those of the reference clock.
    """

    phase: float
    """Density of the white noise of its phase, m2/s."""
    frequency: float
    """Density of the white noise of its frequency, m2/s3."""
    covariance: float
    """Covariance of offset and rate at the start, m2/s."""
    reference: ReferenceClock = ReferenceClock()
    """The clock against which this one is counted, the same for all clocks of a filter."""


@dataclass(frozen=True)
class Block:
    """Three states of a triad that differ only in their axis."""

    name: str
    """Name, the first part of the states' names."""
    unit: str
    """Unit of each state."""
    sensor: int
    """Triad of inertial sensors, or kind of measurements, as of `DECLARED`."""
    input_axis: int | None = None
    """Input that each state multiplies, relative to its axis: 0 the same axis, 1 the next, 2 the one before; 3 more for
    specific force; None: a bias."""
    decay: float = 0.0
    """1/s."""
    drive: float = 0.0
    """Density of the driving noise, unit2/s."""
    first: int = 0
    """Number of the first state among the time-correlated errors of a kind of measurements."""
    numbered: bool = False
    """The three states have numbers instead of axes."""
    of_body: bool = False
    """The axes of states of a kind of measurements are those of the body instead of ground axes."""
    size: int = 3
    """3; fewer for single states of a kind of measurements, which come after all blocks of three."""
    clock: TransmitterClockModel | None = None
    """For the offset of a transmitter's clock; the next block is its rate."""

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its states."""
        return tuple(f"{self.name}_{axis}" for axis in self.axes) if self.size > 1 else (self.name,)

    @property
    def axes(self) -> tuple[str, str, str]:
        """Suffixes of the three names: body axes, with the input axis if it differs; ground axes; or numbers."""
        if self.numbered:
            return "1", "2", "3"
        if self.sensor > ACCELEROMETERS and not self.of_body:
            return "north", "east", "down"
        if self.input_axis in (None, 0):
            return "x", "y", "z"
        first, second, third = (f"{'xyz'[axis]}{'xyz'[(axis + self.input_axis) % 3]}" for axis in range(3))
        return first, second, third


def biases(gyro: tuple[float, float] = (0.0, 0.0), accel: tuple[float, float] = (0.0, 0.0)) -> tuple[Block, Block]:
    """The blocks that every filter has; gyro, accel: decay (1/s) and drive (unit2/s) of each."""
    return (
        Block("gyro_bias", "rad/s", GYROS, decay=gyro[0], drive=gyro[1]),
        Block("accelerometer_bias", "m/s2", ACCELEROMETERS, decay=accel[0], drive=accel[1]),
    )


SCALE_FACTORS = (
    Block("gyro_scale", "1", GYROS, input_axis=0),
    Block("accelerometer_scale", "1", ACCELEROMETERS, input_axis=0),
)
"""Blocks of constant scale factors."""
MISALIGNMENTS = (
    Block("gyro_misalignment_next", "1", GYROS, input_axis=1),
    Block("gyro_misalignment_previous", "1", GYROS, input_axis=2),
    Block("accelerometer_misalignment_next", "1", ACCELEROMETERS, input_axis=1),
    Block("accelerometer_misalignment_previous", "1", ACCELEROMETERS, input_axis=2),
)
"""Blocks of constant gains to an axis from the next one (x, y, z, x) and from the one before."""
G_SENSITIVITY = tuple(Block(f"gyro_g_sensitivity_{k}", "rad/s/(m/s2)", GYROS, input_axis=3 + k) for k in range(3))
"""Blocks of constant gains of gyros from specific force, of a truth alone."""


def correlated_single(name: str, unit: str, kind: int, first: int, sigma: float, time: float, step: float) -> Block:
    """A single time-correlated measurement error of a kind, with the number `first`.

    It is a Gauss-Markov process of this 1 sigma, in its unit. time, step: see `correlated_triple`.
    """
    drive = -math.expm1(-2.0 * step / time) / step
    return Block(name, unit, kind, decay=1.0 / time, drive=sigma**2 * drive, first=first, size=1)


def correlated_triple(name: str, kind: int, time: float, step: float, first: int = 0, numbered: bool = False) -> Block:
    """Three time-correlated measurement errors of a kind (`filter.measurement_kinds`), each a Gauss-Markov process of
    1 sigma one.

    The measurement's table defines their effect on a measurement.

    time: their correlation time, s, may be inf. step: filter step, s, over which the drive keeps the variance constant.
    first, numbered: see `Block`.
    """
    drive = -math.expm1(-2.0 * step / time) / step
    return Block(name, "1", kind, decay=1.0 / time, drive=drive, first=first, numbered=numbered)


def declared(blocks: Sequence[Block]) -> np.ndarray:
    """States of the blocks as kernels take them (k,), see `DECLARED`.

    Raises Defect unless those of inertial sensors come first.
    """
    others = [b.sensor > ACCELEROMETERS for b in blocks]
    if others != sorted(others):
        raise Defect(f"states of inertial sensors behind others: {', '.join(b.name for b in blocks)}")
    return np.array(
        [(b.sensor, b.first + axis, _signal(b, axis), b.decay, b.drive) for b in blocks for axis in range(b.size)],
        dtype=DECLARED,
    )


def _signal(block: Block, axis: int) -> int:
    """`signal` of `DECLARED` for an axis of a block."""
    if block.input_axis is None:
        return CONSTANT
    ahead, beyond = block.input_axis % 3, block.input_axis // 3
    return 3 * beyond + (axis + ahead) % 3


_NAVIGATION = (("position", "m"), ("velocity", "m/s"), ("attitude", "rad"))


def slices(blocks: Sequence[Block]) -> dict[str, slice]:
    """Groups of three error states by their names, in order."""
    names = [*(name for name, _ in _NAVIGATION), *(b.name for b in blocks if b.size == 3)]
    return {name: slice(3 * i, 3 * i + 3) for i, name in enumerate(names)}


def clock_states(scales: int) -> int:
    """Number of states of the receiver clock for sources of so many time scales."""
    return scales + 1 if scales else 0


def names(blocks: Sequence[Block], scales: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the error states: of navigation along north, east, down, of sensors (`Block.states`), of the receiver's
    clock against these time scales."""
    return (
        *(f"{name}_{axis}" for name, _ in _NAVIGATION for axis in ("north", "east", "down")),
        *(name for b in blocks for name in b.states),
        *(f"clock_bias_{scale}" for scale in scales),
        *(["clock_drift"] if scales else []),
    )


def units(blocks: Sequence[Block], scales: int = 0) -> tuple[str, ...]:
    """Units of the error states, including the clock's for so many time scales."""
    groups = (*((unit, 3) for _, unit in _NAVIGATION), *((b.unit, b.size) for b in blocks))
    return (*(unit for unit, size in groups for _ in range(size)), *(["m"] * scales), *(["m/s"] if scales else []))


_TRANSMITTER = re.compile(
    "(?:transmitter_(position|range_bias|clock_rate|clock)|beacons_(position|bias_growth|bias))_(.+?)(?:_(north|east|down))?"
)
"""States of errors of transmitters and beacons."""
_CORRELATED = re.compile("(?:fix_error_(slow|fast)|range_error_(slow|fast))(_more)?(?:_(.+))?")
"""States of time-correlated errors of fixes, and of ranges."""


def display_name(state: str) -> str:
    """Name of a state, or of a group of three, in reports."""
    if found := _CORRELATED.fullmatch(state):
        fix, range_, more, which = found.groups()
        name = f"{'further ' if more else ''}{fix} satellite errors" if fix else f"{range_} ranging error"
        return f"{name}, {which}" if which else name
    if found := _TRANSMITTER.fullmatch(state):
        of_transmitter, of_beacon, name, axis = found.groups()
        what = of_transmitter or of_beacon
        return f"{what.replace('_', ' ')} of {name}{f', {axis}' if axis else ''}"
    return "heading" if state == "attitude_down" else state.replace("_", " ")


def is_sigma_wrong(most: float, least: float, band: tuple[float, float], tolerance: float) -> tuple[bool, bool]:
    """Whether a sigma is too small, and whether it is too large, by more than chance and by more than the tolerance.

    most, least: largest and smallest RMS of error / sigma over all outputs. band: its limits where sigma is right.
    """
    return most > band[1] and most - 1.0 > tolerance, least < band[0] and 1.0 - least > tolerance


SLICES = slices(biases())
NAMES = names(biases())
UNITS = units(biases())
"""Units of a filter of `N_BASE` states."""
