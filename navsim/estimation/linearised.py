"""The loosely coupled filter flown along the truth, with everything a linear covariance analysis needs.

Along an error-free flight the filter's gains are those of every run to first order. This kernel flies it there
and leaves behind, for each interval between fixes, how errors are carried on and what sensor noise adds, and for
each fix its innovation and gain. What the errors really are is then a matter of matrices
(`navsim.simulation.landing_covariance`).

Errors are carried as (dr, dv, theta, -b_hat): the true biases are not in it, since they need not follow the
filter's model; they act through `gamma`.
Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8 (covariance analysis with a
truth model of its own).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core import states
from navsim.core.covariance import (
    NOISE_ACCEL,
    NOISE_ACCEL_DECAY,
    NOISE_ACCEL_DRIVE,
    NOISE_GYRO,
    NOISE_GYRO_DECAY,
    NOISE_GYRO_DRIVE,
    NOISE_N,
    SIZE,
    STRIDE,
    carry,
    carry_errors,
    gain,
    joseph,
    predict,
)
from navsim.core.jit import kernel
from navsim.core.strapdown import MID_N
from navsim.estimation.loosely_coupled import ESKF, TIME_TOLERANCE, advance, measurement

INPUTS = 12
"""Columns of gamma: constant gyro and accelerometer bias (6), Markov gyro and accelerometer bias (6)."""
NOISES = 4
"""Sensor noises: white gyro, white accelerometer, drive of the Markov gyro and accelerometer bias."""


@kernel
def _interval(
    until, imu_time, dtheta, dv, nav, p, cursor, previous, noise, markov_decay, unit_noise,
    scratch, c_nb, flat, phi, gamma, q, width,
):  # fmt: skip
    """Fly to `until` and describe the way there: phi (15, 15), gamma (15, 12), q (4, 15, 15)."""
    way, inputs = flat[0], flat[1]
    a, b, work = flat[2], flat[3], flat[4]
    gathered = flat[5:9]
    way[:] = 0.0
    inputs[:] = 0.0
    gathered[:] = 0.0
    for i in range(states.N):
        way[(STRIDE + 1) * i] = 1.0
    for i in range(6):
        inputs[STRIDE * (states.GYRO + i) + i] = 1.0
        inputs[STRIDE * (states.GYRO + i) + 6 + i] = 1.0
    last = imu_time.shape[0] - 1
    while int(cursor[0]) < last and cursor[1] < until - TIME_TOLERANCE:
        step_end = min(imu_time[int(cursor[0]) + 1], until)
        advance(ESKF, step_end, imu_time, dtheta, dv, nav, p, cursor, previous, noise, scratch, c_nb, width)
        dt = cursor[2]
        mid = scratch[:MID_N]
        step = scratch[MID_N : MID_N + SIZE]
        carry_errors(step, noise[0], dt, way, a, width)
        carry(step, inputs, a, width)
        for j in range(3):
            inputs[STRIDE * (states.GYRO + j) + 6 + j] *= math.exp(-dt * markov_decay[0])
            inputs[STRIDE * (states.ACCEL + j) + 9 + j] *= math.exp(-dt * markov_decay[1])
        for n in range(NOISES):
            predict(gathered[n], mid, unit_noise[n], work, a, b, width)
    for i in range(states.N):
        for j in range(states.N):
            phi[i, j] = way[STRIDE * i + j]
            for n in range(NOISES):
                q[n, i, j] = gathered[n, STRIDE * i + j]
        for j in range(INPUTS):
            gamma[i, j] = inputs[STRIDE * i + j]


@kernel
def linearise(
    imu_time, dtheta, dv, nav, p, noise, markov_decay,
    fix_time, fix_llh, fix_velocity, fix_cov, with_velocity, latency, lever,
    phi, gamma, q, h, k, z, degrees, ahead_phi, ahead_gamma, ahead_q, believed, innovation_cov, width,
):  # fmt: skip
    """Fly the filter along exact increments from the exact initial state.

    Arguments as of `loosely_coupled.run`, with e fixes free of noise and one row of process noise (1, 6);
    markov_decay: (2,) 1/tau of the true gyro and accelerometer Markov bias, 1/s. Out, for each epoch: phi (e, 15, 15),
    gamma (e, 15, 12), q (e, 4, 15, 15) for a unit density, from the fix before (or time 0); h (e, 6, 15), k (e, 15, 6),
    z (e, 6) innovation at the truth, degrees (e,) 3, 6 or 0 without a fix; ahead_* the same for the way from the fix to
    the output, where there is latency; believed (e + 1, 15, 15) the filter's covariance at the outputs; innovation_cov
    (e, 6, 6) what it expects of the innovation.
    """
    r, s = np.empty((6, 6)), np.empty((6, 6))
    pht, work = np.empty((states.N, 6)), np.empty((states.N, 6))
    c_nb = np.empty((3, 3))
    scratch = np.zeros(MID_N + 3 * SIZE)
    flat = np.zeros((9, SIZE))
    previous, ahead_previous = np.empty(6), np.empty(6)
    cursor, ahead_cursor = np.zeros(3), np.empty(3)
    ahead_nav, ahead_p = np.empty(states.NAV_N), np.empty(SIZE)
    unit_noise = np.zeros((NOISES, NOISE_N))
    unit_noise[0, NOISE_GYRO] = 1.0
    unit_noise[1, NOISE_ACCEL] = 1.0
    unit_noise[2, NOISE_GYRO_DRIVE] = 1.0
    unit_noise[3, NOISE_ACCEL_DRIVE] = 1.0
    for n in range(2, NOISES):
        unit_noise[n, NOISE_GYRO_DECAY] = markov_decay[0]
        unit_noise[n, NOISE_ACCEL_DECAY] = markov_decay[1]

    cursor[1] = imu_time[0]
    cursor[2] = imu_time[1] - imu_time[0]
    for i in range(3):
        previous[i] = dtheta[0, i]
        previous[3 + i] = dv[0, i]
    for i in range(states.N):
        for j in range(states.N):
            believed[0, i, j] = p[STRIDE * i + j]
    for e in range(fix_time.shape[0]):
        _interval(
            fix_time[e], imu_time, dtheta, dv, nav, p, cursor, previous, noise, markov_decay, unit_noise,
            scratch, c_nb, flat, phi[e], gamma[e], q[e], width,
        )  # fmt: skip
        degrees[e] = 0
        k[e] = 0.0
        h[e] = 0.0
        z[e] = 0.0
        if not math.isnan(fix_llh[e, 0]):
            velocity_here = with_velocity and not math.isnan(fix_velocity[e, 0])
            m = measurement(
                nav, previous, cursor[2], c_nb, lever, fix_llh[e], fix_velocity[e], velocity_here, z[e], h[e]
            )
            for i in range(m):
                for j in range(m):
                    r[i, j] = fix_cov[e, i, j]
            if gain(p, h[e], r, m, pht, s, k[e]):
                degrees[e] = m
                for i in range(m):
                    for j in range(m):
                        t = r[i, j]
                        for c in range(states.N):
                            t += h[e, i, c] * pht[c, j]
                        innovation_cov[e, i, j] = t
                joseph(p, h[e], r, m, pht, k[e], work)
        if latency > 0.0:
            ahead_nav[:] = nav
            ahead_p[:] = p
            ahead_previous[:] = previous
            ahead_cursor[:] = cursor
            _interval(
                fix_time[e] + latency, imu_time, dtheta, dv, ahead_nav, ahead_p, ahead_cursor, ahead_previous, noise,
                markov_decay, unit_noise, scratch, c_nb, flat, ahead_phi[e], ahead_gamma[e], ahead_q[e], width,
            )  # fmt: skip
        for i in range(states.N):
            for j in range(states.N):
                believed[e + 1, i, j] = ahead_p[STRIDE * i + j] if latency > 0.0 else p[STRIDE * i + j]
