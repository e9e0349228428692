"""Convert models of inertial sensors to states: the true ones, and those of the filter model.

This is the only converter between truth and filter model. A further error of a sensor needs a term in `sensors.imu`, a
line in `true_states`, and one in `followed` and `true_values` if a filter can estimate it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from navsim.filter import states
from navsim.filter.design import SensorDesign
from navsim.filter.states import Block
from navsim.sensors.imu import SensorErrors, Triad

GAINS = (*states.SCALE_FACTORS, *states.MISALIGNMENTS)
"""Errors of inertial sensors, besides biases, that a filter can estimate."""
_MATTERS = 0.3
"""Smallest ratio, of the effect of a gain to the uncertainty of the filter, at which the filter estimates it by
default. Without the state, sigma would be too small by sqrt(1 + 0.3^2) - 1, 4 %."""


def _sigma(block: Block, triads: Sequence[Triad]) -> float:
    """1 sigma of gains of a block."""
    triad = triads[block.sensor]
    return triad.scale if block.input_axis == 0 else triad.further.misalignment


def gains_that_matter(gyro: Triad, accel: Triad, dtheta: np.ndarray, dv: np.ndarray, dt: float) -> tuple[Block, ...]:
    """Blocks of sensor gains with a large effect on a flight.

    dtheta, dv: exact increments (n, 3) over intervals of dt, s.

    A gain s adds s u for the input u of its triad. Over windows of 1 s, 2 s, 4 s and so on, s times the integral of u
    is compared with the uncertainty that remains however well the filter knows the bias: white noise and bias
    instability.
    """
    triads, out = (gyro.merged(), accel.merged()), []
    for block in GAINS:
        sigma, triad = _sigma(block, triads), triads[block.sensor]
        felt = (dtheta, dv)[block.sensor]
        # the axis with the largest input counts, whichever axis the gain acts on
        adding = np.concatenate([np.zeros((1, 3)), np.cumsum(felt, axis=0)])
        length = max(1, round(1.0 / dt))
        while length <= felt.shape[0]:
            most, window = float(np.abs(adding[length:] - adding[:-length]).max()), length * dt
            if sigma * most > _MATTERS * np.hypot(np.sqrt(triad.white() * window), triad.markov * window):
                out.append(block)
                break
            length *= 2
    return tuple(out)


def followed(gyro: Triad, accel: Triad, gains: Collection[Block] = ()) -> SensorDesign:
    """Filter model that equals these sensors. gains: blocks of `GAINS` that it estimates, of those that the sensors
    have.

    - A Markov bias alone is a Markov state.
    - With a constant bias it is a random walk of the same short-term growth, since one state cannot be both.
    - Flicker noise is merged as in `Triad.merged`. A random walk of the bias is a random walk.
    - A fixed bias counts with its root mean square.
    """
    triads = (gyro.merged(), accel.merged())
    there = [(block, sigma) for block in GAINS if block in gains and (sigma := _sigma(block, triads)) > 0.0]
    return SensorDesign(
        blocks=(*states.biases(*(_decay_and_drive(t) for t in triads)), *(block for block, _ in there)),
        sigma=(*(t.initial_sigma() for t in triads), *(sigma for _, sigma in there)),
        noise=np.array([t.white() for t in triads]),
    )


def _decay_and_drive(triad: Triad) -> tuple[float, float]:
    """1/tau (1/s) and driving density (unit2/s) with which a filter follows a bias."""
    walk = triad.further.walk**2
    if triad.markov == 0.0:
        return 0.0, walk
    alone = triad.bias == 0.0 and triad.fixed_bias is None and walk == 0.0
    return (1.0 / triad.markov_time if alone else 0.0), triad.drive() + walk


@dataclass(frozen=True)
class TrueState:
    """Three equal true errors of a triad."""

    source: str
    """Source of error in the budget."""
    block: Block
    sigma: float
    """1 sigma at time 0."""
    fixed: tuple[float, float, float] | None = None
    """Values (3,) if they are not drawn."""


def true_states(gyro: Triad, accel: Triad) -> tuple[TrueState, ...]:
    """True errors of these sensors: constant biases, Markov biases with flicker noise as of `Triad.merged`, further
    errors."""
    triads = (("gyro", gyro.merged()), ("accelerometer", accel.merged()))
    gains = (
        *((block.name, block, t.scale) for block, (_, t) in zip(states.SCALE_FACTORS, triads, strict=True)),
        *(
            (f"{triads[block.sensor][0]}_misalignment", block, triads[block.sensor][1].further.misalignment)
            for block in states.MISALIGNMENTS
        ),
        *(("gyro_g_sensitivity", block, gyro.further.g_sensitivity) for block in states.G_SENSITIVITY),
    )
    markov = states.biases(*((1.0 / t.markov_time, t.drive()) for _, t in triads))
    constant = zip(triads, states.biases(), strict=True)
    varying = zip(triads, markov, strict=True)
    return (
        *(TrueState(f"{name}_bias", block, t.bias, t.fixed_bias) for (name, t), block in constant),
        *(TrueState(f"{name}_markov", block, t.markov) for (name, t), block in varying),
        *(TrueState(source, block, sigma) for source, block, sigma in gains if sigma > 0.0),
    )


def true_values(blocks: Sequence[Block], errors: SensorErrors) -> np.ndarray:
    """True values (o, k, W) of the filter's inertial sensor states, from errors with a bias (o, 6, W)."""
    columns = []
    for block in blocks:
        if block.sensor not in (states.GYROS, states.ACCELEROMETERS):
            continue  # an error of measurements
        part = slice(3 * block.sensor, 3 * block.sensor + 3)
        bias = errors.bias[:, part]
        if block.input_axis is None:
            columns.append(bias)
            continue
        own = np.arange(3)
        beside = (own + block.input_axis) % 3
        gains = errors.scale[part] if block.input_axis == 0 else errors.cross[block.sensor, own, beside]
        columns.append(np.broadcast_to(gains, bias.shape))
    return np.ascontiguousarray(np.concatenate(columns, axis=1))
