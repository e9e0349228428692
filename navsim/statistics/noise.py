"""Kernels that add sensor errors and measurement noise to what runs in lanes measure.

The order of random numbers defines those of a seed: a change alters every result. Runs alternate every few intervals,
so that their output stays in the processor's cache: a run is a lane, every W-th number. Models: `navsim.sensors.imu`
and `navsim.gnss.pseudorange`.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel

_INTERVALS = 64
"""Intervals of the IMU, or epochs, after which it is the next run's turn: 12 kB of increments at W = 8."""


@kernel
def draw_normals(rng, out):
    """out (k,) <- standard normal numbers: those of `rng.standard_normal`, in a third of its time."""
    for i in range(out.shape[0]):
        out[i] = rng.standard_normal()


@kernel
def corrupt(
    normals, dtheta, dv, dt, constant, factor, white, markov_sigma, markov_decay, at, out_dtheta, out_dv, bias
):  # fmt: skip
    """Add sensor errors to exact increments, in as many lanes as there are runs.

    - `normals` (r, k): standard normal numbers of runs: of Markov processes at time 0, then of each interval white
      noise and Markov processes, gyros first; none for what has no noise.
    - `dtheta`, `dv` (n, 3, W), or (n, 3, 1) for all runs: rad, m/s over intervals of `dt` s.
    - `constant` (6, W): gyro, then accelerometer bias; `factor` (6, W): factor on the true rates.
    - `white` (2,): 1 sigma of the increments' noise, rad and m/s.
    - `markov_sigma` (2,); `markov_decay` (2,): exp(-dt / tau).
    - `at` (o,): increasing intervals.
    - `out_dtheta`, `out_dv` (n, 3, W), written.
    - `bias` (o, 6, W), written: bias at the start of the intervals `at`; interval n is the end of the last one.
    """
    n, own, count = dtheta.shape[0], dtheta.shape[2] - 1, normals.shape[0]
    drift, used = np.zeros((6, count)), np.zeros(count, np.int64)
    for lane in range(count):
        for sensor in range(2):
            if markov_sigma[sensor] > 0.0:
                for axis in range(3):
                    drift[3 * sensor + axis, lane] = markov_sigma[sensor] * normals[lane, used[lane] + axis]
                used[lane] += 3
    row = 0
    for first in range(0, n, _INTERVALS):
        kept = row
        for lane in range(count):
            row, way, i = kept, min(lane, own), used[lane]
            for k in range(first, min(first + _INTERVALS, n)):
                while row < at.shape[0] and at[row] == k:
                    for axis in range(6):
                        bias[row, axis, lane] = constant[axis, lane] + drift[axis, lane]
                    row += 1
                for axis in range(3):
                    gyro = constant[axis, lane] + drift[axis, lane]
                    accel = constant[3 + axis, lane] + drift[3 + axis, lane]
                    out_dtheta[k, axis, lane] = factor[axis, lane] * dtheta[k, axis, way] + gyro * dt
                    out_dv[k, axis, lane] = factor[3 + axis, lane] * dv[k, axis, way] + accel * dt
                if white[0] > 0.0:
                    for axis in range(3):
                        out_dtheta[k, axis, lane] += white[0] * normals[lane, i + axis]
                    i += 3
                if white[1] > 0.0:
                    for axis in range(3):
                        out_dv[k, axis, lane] += white[1] * normals[lane, i + axis]
                    i += 3
                for sensor in range(2):
                    if markov_sigma[sensor] > 0.0:
                        decay = markov_decay[sensor]
                        kick = markov_sigma[sensor] * math.sqrt(1.0 - decay * decay)
                        for axis in range(3):
                            before = decay * drift[3 * sensor + axis, lane]
                            drift[3 * sensor + axis, lane] = before + kick * normals[lane, i + axis]
                        i += 3
            used[lane] = i
    for end in range(row, at.shape[0]):
        for axis in range(6):
            for lane in range(count):
                bias[end, axis, lane] = constant[axis, lane] + drift[axis, lane]


@kernel
def measure(
    normals, range_, delay, sigma, range_rate, rate_sigma, used, clock, out_range, out_rate
):  # fmt: skip
    """Measurements in as many lanes as there are runs.

    - `normals` (r, e, s, 2): standard normal numbers of runs.
    - `range_`, `range_rate`, `delay`, `sigma` (e, s, W), or (e, s, 1) for all runs; `rate_sigma` (e, s).
    - `used` (e, s): bool; `clock` (e, 2): receiver clock offset (m) and drift (m/s) at each epoch.
    - `out_range`, `out_rate` (e, s, W), written: nan where not used.

    Every source has numbers at every epoch, so a mask does not shift those of the other sources.
    """
    epochs, own, spread, ways = range_.shape[0], delay.shape[2] - 1, sigma.shape[2] - 1, range_.shape[2] - 1
    for first in range(0, epochs, _INTERVALS):
        for lane in range(normals.shape[0]):
            late, wide, way = min(lane, own), min(lane, spread), min(lane, ways)
            for e in range(first, min(first + _INTERVALS, epochs)):
                for s in range(range_.shape[1]):
                    if used[e, s]:
                        exact = range_[e, s, way] + delay[e, s, late] + clock[e, 0]
                        out_range[e, s, lane] = exact + sigma[e, s, wide] * normals[lane, e, s, 0]
                        exact = range_rate[e, s, way] + clock[e, 1]
                        out_rate[e, s, lane] = exact + rate_sigma[e, s] * normals[lane, e, s, 1]
                    else:
                        out_range[e, s, lane] = np.nan
                        out_rate[e, s, lane] = np.nan


@kernel
def walk(rngs, count, transition, root, which, start, out):
    """Draw a linear process in exact steps (`statistics.linear_processes`), in the first `count` lanes.

    Inside a kernel a Generator produces numpy's own stream.

    rngs: numpy Generators, W of them. transition, root: (m, n, n) of steps; which: (k,) the step from each time to the
    next. start: (n, n) root of the covariance at the first. Out: (k + 1, n, W) states at all times.
    """
    steps, n = which.shape[0], transition.shape[1]
    drawn = np.empty(n)
    for lane in range(count):
        rng = rngs[lane]
        for j in range(n):
            drawn[j] = rng.standard_normal()
        for i in range(n):
            x = 0.0
            for j in range(i + 1):
                x += start[i, j] * drawn[j]
            out[0, i, lane] = x
    for first in range(0, steps, _INTERVALS):
        for lane in range(count):
            rng = rngs[lane]
            for k in range(first, min(first + _INTERVALS, steps)):
                step = which[k]
                for j in range(n):
                    drawn[j] = rng.standard_normal()
                for i in range(n):
                    x = 0.0
                    for j in range(i + 1):
                        x += root[step, i, j] * drawn[j]
                    for j in range(n):
                        x += transition[step, i, j] * out[k, j, lane]
                    out[k + 1, i, lane] = x
