"""From models of inertial sensors to what a filter believes of them: the one converter between truth and belief."""

from __future__ import annotations

import numpy as np

from navsim.core import states
from navsim.core.states import Block
from navsim.estimation.beliefs import SensorBeliefs
from navsim.models.imu import Triad


def followed(gyro: Triad, accel: Triad) -> SensorBeliefs:
    """The beliefs of a filter that takes these sensors for true.

    A Markov bias alone is followed as such; on top of a constant bias it is followed as a random walk of the same
    short-term growth, since one state cannot be both. A fixed bias counts with its root mean square.
    """
    triads = (gyro, accel)
    return SensorBeliefs(
        blocks=states.biases(*(_decay_and_drive(t) for t in triads)),
        sigma=tuple(t.initial_sigma() for t in triads),
        noise=np.array([t.noise_density**2 for t in triads]),
    )


def _decay_and_drive(triad: Triad) -> tuple[float, float]:
    """1/tau (1/s) and driving density (unit2/s) with which a filter follows a bias."""
    if triad.markov == 0.0:
        return 0.0, 0.0
    alone = triad.bias == 0.0 and triad.fixed_bias is None
    return (1.0 / triad.markov_time if alone else 0.0), triad.drive()


def true_states(gyro: Triad, accel: Triad) -> tuple[Block, ...]:
    """The sensor states that there really are: constant biases, then Markov biases."""
    return (
        *states.biases(),
        *states.biases(*((1.0 / t.markov_time, t.drive()) for t in (gyro, accel))),
    )
