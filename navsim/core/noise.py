"""Kernels that draw: sensor errors and measurement noise of one run, from a numpy Generator.

Inside a kernel a Generator gives numpy's own stream, several times faster than from Python. The order of
draws is part of what a seed means: changing it changes every result.
Models: `navsim.models.imu` and `navsim.models.pseudorange`.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core.jit import kernel


@kernel
def _markov_step(bias, decay, kick, rng):
    for axis in range(3):
        bias[axis] = decay * bias[axis] + kick * rng.standard_normal()


@kernel
def corrupt(
    rng, dtheta, dv, dt, constant, factor, white, markov_sigma, markov_decay, out_dtheta, out_dv, lane, bias
):  # fmt: skip
    """Add sensor errors to exact increments.

    rng: numpy Generator. dtheta, dv: (n, 3) rad, m/s over intervals of dt s. constant: (6,) gyro, then
    accelerometer bias; factor: (6,) what true rates are multiplied by. white: (2,) 1 sigma of the increments' noise,
    rad and m/s. markov_sigma: (2,). markov_decay: (2,) exp(-dt / tau). Out: out_dtheta, out_dv (n, 3, W), of which
    `lane` is written; bias (n + 1, 6) the bias at the start of every interval and at the end.
    """
    n = dtheta.shape[0]
    drift = np.zeros(6)
    for sensor in range(2):
        if markov_sigma[sensor] > 0.0:
            for axis in range(3):
                drift[3 * sensor + axis] = markov_sigma[sensor] * rng.standard_normal()
    for k in range(n):
        for axis in range(3):
            gyro = constant[axis] + drift[axis]
            accel = constant[3 + axis] + drift[3 + axis]
            bias[k, axis] = gyro
            bias[k, 3 + axis] = accel
            out_dtheta[k, axis, lane] = factor[axis] * dtheta[k, axis] + gyro * dt
            out_dv[k, axis, lane] = factor[3 + axis] * dv[k, axis] + accel * dt
        if white[0] > 0.0:
            for axis in range(3):
                out_dtheta[k, axis, lane] += white[0] * rng.standard_normal()
        if white[1] > 0.0:
            for axis in range(3):
                out_dv[k, axis, lane] += white[1] * rng.standard_normal()
        for sensor in range(2):
            if markov_sigma[sensor] > 0.0:
                decay = markov_decay[sensor]
                kick = markov_sigma[sensor] * math.sqrt(1.0 - decay * decay)
                _markov_step(drift[3 * sensor : 3 * sensor + 3], decay, kick, rng)
    for axis in range(6):
        bias[n, axis] = constant[axis] + drift[axis]


@kernel
def measure(rng, range_, delay, sigma, range_rate, rate_sigma, used, clock, out_range, out_rate, lane):
    """Draw the measurements of one run.

    range_, delay, sigma, range_rate, rate_sigma: (e, s). used: (e, s) bool. clock: (e, 2) receiver clock
    offset (m) and drift (m/s) at each epoch. Out: out_range, out_rate (e, s, W), of which `lane` is written, nan where
    not used. Every source draws at every epoch, so a mask does not shift the numbers of the others.
    """
    for e in range(range_.shape[0]):
        for s in range(range_.shape[1]):
            a = rng.standard_normal()
            b = rng.standard_normal()
            if used[e, s]:
                out_range[e, s, lane] = range_[e, s] + delay[e, s] + clock[e, 0] + sigma[e, s] * a
                out_rate[e, s, lane] = range_rate[e, s] + clock[e, 1] + rate_sigma[e, s] * b
            else:
                out_range[e, s, lane] = np.nan
                out_rate[e, s, lane] = np.nan
