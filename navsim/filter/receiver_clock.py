"""Clocks as states: the receiver's, in a tightly coupled filter, and those of transmitters on the ground.

The receiver's clock has a bias for each time scale, and their common drift; a transmitter's has an offset and a rate.
One oscillator drives all biases of the receiver, so they wander alike and differ by the constant offsets of the time
scales. Between measurements a clock is independent of the motion, so a step of any length is exact.

    b' = d + w_f,  d' = w_g,  w_f and w_g white, of the densities S_f and S_g

Source: `gnss.clock_noise`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import any_lane, where
from navsim.filter.states import NAV_SENSORS, SENSORS


class ReceiverClock(NamedTuple):
    """Filter model of the receiver clock."""

    scales: np.ndarray
    """(c,) int, time scales with a bias state; none if the filter is loosely coupled."""
    density: np.ndarray
    """(2,) white noise densities of phase, m2/s, and frequency, m2/s3."""
    offsets: np.ndarray = np.empty(0, np.int64)
    """(q,) index, among the error states, of the offset of each transmitter's clock; the next state is its rate."""
    noises: np.ndarray = np.empty((0, 2))
    """(q, 2) `density` of each of these clocks."""
    shared: np.ndarray = np.zeros(2)
    """(2,) `density` of the noise that all of these clocks have in addition, that of the clock they are counted
    against."""


UNKNOWN_BIAS, UNKNOWN_DRIFT = 1e4, 1e2
"""1 sigma of an unknown clock bias, m, and drift, m/s. Large compared with ranges but no larger, since the loss to
rounding grows with its square (1e8 m2 x 2e-16 = 2e-8 m2)."""
NO_CLOCK = ReceiverClock(np.empty(0, np.int64), np.zeros(2))
"""Clock of a loosely coupled filter."""


@kernel
def propagate_clock_rows(first, count, dt, matrix):
    """Propagate the clock's rows of a matrix (n, m) over dt, s, in place: biases first .. first + count - 1, then the
    drift."""
    drift = first + count
    for j in range(matrix.shape[1]):
        moved = dt * matrix[drift, j]
        for b in range(count):
            matrix[first + b, j] += moved


@kernel
def propagate_clock_covariance(first, count, phase, frequency, dt, p):
    """Propagate P (n, n) of the same states over dt, s, with noise densities phase and frequency, in place and exactly
    symmetric."""
    drift = first + count
    propagate_clock_rows(first, count, dt, p)
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
def add_shared_noise(offsets, phase, frequency, dt, p):
    """Add to P (n, n) the noise over dt, s, of the clock against which clocks with these offsets (q,) are counted."""
    bias, both, drift = phase * dt + frequency * dt * dt * dt / 3.0, 0.5 * frequency * dt * dt, frequency * dt
    for a in range(offsets.shape[0]):
        for b in range(offsets.shape[0]):
            i, j = offsets[a], offsets[b]
            p[i, j] += bias
            p[i, j + 1] += both
            p[i + 1, j] += both
            p[i + 1, j + 1] += drift


@kernel
def propagate_clock(clock, dt, nav, p):
    """Propagate the clock states of nav (NAV,) and P (n, n) over dt, s, in place; the receiver's are the last ones."""
    if dt > 0.0:
        for c in range(clock.offsets.shape[0]):
            offset = clock.offsets[c]
            nav[NAV_SENSORS - SENSORS + offset] += dt * nav[NAV_SENSORS - SENSORS + offset + 1]
            propagate_clock_covariance(offset, 1, clock.noises[c, 0], clock.noises[c, 1], dt, p)
        if clock.shared[0] > 0.0 or clock.shared[1] > 0.0:
            add_shared_noise(clock.offsets, clock.shared[0], clock.shared[1], dt, p)
    count = clock.scales.shape[0]
    if count > 0 and dt > 0.0:
        first = p.shape[0] - count - 1
        for b in range(count):
            nav[NAV_SENSORS - SENSORS + first + b] += dt * nav[NAV_SENSORS - SENSORS + first + count]
        propagate_clock_covariance(first, count, clock.density[0], clock.density[1], dt, p)


@kernel
def detect_clock_jumps(available, accepted, jumped):
    """Detect jumps of clock biases and of the drift; returns whether any lane has one.

    A bias jumped if all the sources of an epoch, at least two, were rejected. The drift jumped if that is so for all
    biases with measurements.

    - `available`, `accepted` (c,): number of ranges of each bias, and number used.
    - `jumped` (c + 1,), out: 1 or 0, the drift last.
    """
    count = available.shape[0]
    every, some = available[0] >= 0.0, available[0] < 0.0
    for b in range(count):
        off = (available[b] > 1.5) & (accepted[b] == 0.0)
        jumped[b] = where(off, 1.0, 0.0)
        every = every & (off | (available[b] == 0.0))
        some = some | off
    jumped[count] = where(some & every, 1.0, 0.0)
    return any_lane(some)


@kernel
def reset_clock(jumped, p):
    """Remove all information about clocks that jumped (c + 1,) from P (n, n), in place; they are its last states."""
    first = p.shape[0] - jumped.shape[0]
    for b in range(jumped.shape[0]):
        gone = jumped[b] > 0.0
        for i in range(p.shape[0]):
            p[first + b, i] = where(gone, 0.0, p[first + b, i])
            p[i, first + b] = where(gone, 0.0, p[i, first + b])
        sigma = UNKNOWN_DRIFT if b == jumped.shape[0] - 1 else UNKNOWN_BIAS
        p[first + b, first + b] = where(gone, sigma * sigma, p[first + b, first + b])
