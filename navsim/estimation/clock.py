"""The receiver's clock as states of a tightly coupled filter: a bias for each time scale, and the drift they share.

One oscillator drives all biases, so that they wander alike; what tells one from another is the constant offset of the
time scales. Between measurements the clock and the motion have nothing to do with each other, so that a step of any
length is exact.

    b' = d + w_f,  d' = w_g,  w_f and w_g white, of the densities S_f and S_g

Source: `core.arrays.clock`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.core.jit import kernel
from navsim.core.states import NAV_SENSORS, SENSORS


class ReceiverClock(NamedTuple):
    """What a filter believes of the clock: scales (c,) int, the time scales that it has a bias for, none where it is
    loosely coupled; density (2,) of the white noises of phase, m2/s, and frequency, m2/s3."""

    scales: np.ndarray
    density: np.ndarray


NO_CLOCK = ReceiverClock(np.empty(0, np.int64), np.zeros(2))
"""That of a loosely coupled filter."""


@kernel
def carry_clock_rows(first, count, dt, matrix):
    """The rows of the clock, biases first .. first + count - 1 and then the drift, of a matrix (n, m) over dt, s, in
    place."""
    drift = first + count
    for j in range(matrix.shape[1]):
        moved = dt * matrix[drift, j]
        for b in range(count):
            matrix[first + b, j] += moved


@kernel
def carry_clock_covariance(first, count, phase, frequency, dt, p):
    """P (n, n) of the same states over dt, s, with noises of the densities phase and frequency, in place and exactly
    symmetric."""
    drift = first + count
    carry_clock_rows(first, count, dt, p)
    for i in range(p.shape[0]):
        moved = dt * p[i, drift]
        for b in range(count):
            p[i, first + b] += moved
    bias = phase * dt + frequency * dt * dt * dt / 3.0
    both = 0.5 * frequency * dt * dt
    for a in range(count):
        for b in range(a + 1):
            p[first + a, first + b] += bias
            p[first + b, first + a] = p[first + a, first + b]
        p[first + a, drift] += both
        p[drift, first + a] = p[first + a, drift]
    p[drift, drift] += frequency * dt


@kernel
def run_clock_on(clock, dt, nav, p):
    """The clock of a filter over dt, s: nav (NAV,) and P (n, n), in place; its states are the last."""
    count = clock.scales.shape[0]
    if count > 0 and dt > 0.0:
        first = p.shape[0] - count - 1
        for b in range(count):
            nav[NAV_SENSORS - SENSORS + first + b] += dt * nav[NAV_SENSORS - SENSORS + first + count]
        carry_clock_covariance(first, count, clock.density[0], clock.density[1], dt, p)
