"""The filter flown along the truth, with everything a linear covariance analysis needs.

Along an error-free flight the filter's gains are those of every run to first order. This kernel flies it there
and leaves behind, for each interval between events, how errors are carried on and what sensor noise adds, and for
each measurement its innovation and gain. What the errors really are is then a matter of matrices
(`navsim.simulation.landing_covariance`).

Errors are carried as (dr, dv, theta, minus the estimates of the sensor states): the true sensor states are not in it,
since they need not follow the filter's model; they act through `inputs`.
Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8 (covariance analysis with a
truth model of its own).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.core.covariance import (
    NOISE_ACCEL,
    NOISE_GYRO,
    NOISE_N,
    SIZE,
    STRIDE,
    add_white,
    carry_covariance,
    carry_errors,
    gain,
    is_varying,
    joseph,
    square,
    transition,
    vary,
)
from navsim.core.jit import kernel
from navsim.core.states import GYRO, SENSORS, N
from navsim.core.strapdown import MID_DT, MID_N
from navsim.estimation.filter_loop import advance, set_off
from navsim.estimation.observations import MOST, observe
from navsim.estimation.records import ESKF, OUTPUT, PASS, TIME_TOLERANCE, Events

NOISES = 4
"""Sensor noises: white gyro, white accelerometer, drive of the Markov gyro and accelerometer bias."""


class Linearised(NamedTuple):
    """A filter along the truth. Of i intervals that events end: transition (i, n, n); inputs (i, 9, t) of the truth's
    sensor states; added (i, NOISES, 15, 15) covariance for a unit density, of navigation and the Markov biases. Of w
    measurements: h (w, MOST, n), gain (w, n, MOST), z (w, MOST) innovation at the truth, expected (w, MOST, MOST) what
    the filter expects of it, degrees (w,), place (w, MOST) as of `observe`. believed: (o, n, n) at the outputs.
    """

    transition: np.ndarray
    inputs: np.ndarray
    added: np.ndarray
    h: np.ndarray
    gain: np.ndarray
    z: np.ndarray
    expected: np.ndarray
    degrees: np.ndarray
    place: np.ndarray
    believed: np.ndarray


class Steps(NamedTuple):
    """What each event (k,) is in a `Linearised`: the interval that it ends and its measurement, -1 for none; its
    length, s."""

    interval: np.ndarray
    measurement: np.ndarray
    length: np.ndarray


def steps_of(begin: float, events: Events) -> Steps:
    """The steps of a flight from `begin`, s, on."""
    count = events.time.size
    length = np.empty(count)
    own, copy = begin, begin  # times of the filter itself, and of its copy that runs ahead
    # nothing happens before the flight begins: a filter that waits for late fixes is at its start
    times = np.maximum(events.time, begin).tolist()
    for i, (time, ahead) in enumerate(zip(times, events.ahead.tolist(), strict=True)):
        if not ahead:
            length[i] = time - own
            own = copy = time
        else:
            length[i] = time - copy
            copy = time
    moved = length >= TIME_TOLERANCE
    weighed = (events.kind != OUTPUT) & (events.kind != PASS)
    return Steps(
        np.where(moved, np.cumsum(moved) - 1, -1),
        np.where(weighed, np.cumsum(weighed) - 1, -1),
        np.where(moved, length, 0.0),
    )


def room(steps: Steps, outputs: int, declared: np.ndarray, truth: np.ndarray) -> Linearised:
    """Empty arrays for the steps of a flight."""
    n, t = SENSORS + declared.size, truth.size
    i, w = int(steps.interval.max(initial=-1)) + 1, int(steps.measurement.max(initial=-1)) + 1
    return Linearised(
        np.empty((i, n, n)), np.empty((i, SENSORS, t)), np.empty((i, NOISES, N, N)), np.zeros((w, MOST, n)),
        np.zeros((w, n, MOST)), np.zeros((w, MOST)), np.zeros((w, MOST, MOST)), np.zeros(w, np.int64),
        np.zeros((w, MOST), np.int64), np.empty((outputs, n, n)),
    )  # fmt: skip


@kernel
def _interval(
    until, imu, model, truth, markov, unit_noise, nav, p, cursor, increments, scratch, c_nb, inverse, flat,
    phi_total, inputs, added,
):  # fmt: skip
    """Fly to `until` and describe what happens: phi_total (n, n), inputs (9, t), added (NOISES, 15, 15)."""
    errors, driven, phi_truth, phi_markov = flat[0], flat[1], flat[2], flat[3]
    a, b = flat[4], flat[5]
    gathered = flat[6 : 6 + NOISES]
    n, t = phi_total.shape[0], inputs.shape[1]
    errors[: STRIDE * n] = 0.0
    driven[: STRIDE * (SENSORS + t)] = 0.0
    gathered[:, : STRIDE * N] = 0.0
    for i in range(n):
        errors[(STRIDE + 1) * i] = 1.0
    for i in range(t):
        driven[STRIDE * (SENSORS + i) + i] = 1.0
    varying = is_varying(markov)
    mid = scratch[:MID_N]
    phi = scratch[MID_N : MID_N + SIZE]
    last = imu.time.shape[0] - 1
    while int(cursor[0]) < last and cursor[1] < until - TIME_TOLERANCE:
        step_end = min(imu.time[int(cursor[0]) + 1], until)
        advance(ESKF, step_end, imu, model, nav, p, cursor, increments, scratch, c_nb, inverse)
        dt = mid[MID_DT]
        carry_errors(phi, model.declared, dt, errors, n, a)
        transition(mid, increments, truth, phi_truth)
        carry_errors(phi_truth, truth, dt, driven, t, a)
        transition(mid, increments, markov, phi_markov)
        for i in range(NOISES):
            carry_covariance(gathered[i], phi_markov, N, a, b)
            if varying:
                vary(markov, dt, gathered[i])
            add_white(gathered[i], unit_noise[i], dt)
            for c in range(3):
                # the drive of a Markov bias; the first two noises are white
                first = GYRO + 3 * (i - 2) + c
                if i >= 2:
                    gathered[i, (STRIDE + 1) * first] += dt
    square(errors, phi_total)
    for i in range(SENSORS):
        for j in range(t):
            inputs[i, j] = driven[STRIDE * i + j]
    for i in range(NOISES):
        square(gathered[i], added[i])


@kernel
def linearise(imu, measurements, events, steps, state, model, truth, markov, out):
    """Fly the filter along exact increments from the exact initial state.

    imu, measurements, events, state, model: `estimation.records`, without noise, with one row of process noise. steps:
    `steps_of` the events. truth: the sensor states that there really are; markov: biases alone, with the decay of the
    true Markov biases. out: filled in.
    """
    n = out.believed.shape[1]
    declared = model.declared
    h, z, r, s = np.empty((MOST, n)), np.empty(MOST), np.empty((MOST, MOST)), np.empty((MOST, MOST))
    pht, work = np.empty((n, MOST)), np.empty((n, MOST))
    c_nb, inverse = np.empty((3, 3)), np.empty((2, 3, 3))
    scratch = np.zeros(MID_N + 3 * SIZE)
    flat = np.zeros((6 + NOISES, SIZE))
    navs, ps, increments_pair, cursors = (
        np.empty((2, state.navigation.shape[0])), np.zeros((2, SIZE)), np.empty((2, 6)), np.zeros((2, 3)),
    )  # fmt: skip
    unit_noise = np.zeros((NOISES, NOISE_N))
    unit_noise[0, NOISE_GYRO] = 1.0
    unit_noise[1, NOISE_ACCEL] = 1.0

    navs[0] = state.navigation
    ps[0] = state.covariance
    set_off(imu, navs[0], declared, cursors[0], increments_pair[0])
    before = 0
    for i in range(events.time.shape[0]):
        # what is answered ahead of late fixes is a copy's, which starts from the filter as it is now
        ahead = 1 if events.ahead[i] else 0
        if ahead > before:
            navs[1] = navs[0]
            ps[1] = ps[0]
            increments_pair[1] = increments_pair[0]
            cursors[1] = cursors[0]
        before = ahead
        nav, p, increments, cursor = navs[ahead], ps[ahead], increments_pair[ahead], cursors[ahead]
        at = steps.interval[i]
        if at >= 0:
            _interval(
                events.time[i], imu, model, truth, markov, unit_noise, nav, p, cursor, increments, scratch, c_nb,
                inverse, flat, out.transition[at], out.inputs[at], out.added[at],
            )  # fmt: skip
        what, row = events.kind[i], events.row[i]
        if what == OUTPUT:
            square(p, out.believed[row])
        elif what != PASS:
            w = steps.measurement[i]
            m = observe(what, row, measurements, nav, increments, cursor[2], declared, c_nb, out.place[w], z, h, r)
            if m == 0 or not gain(p, h, r, m, pht, s, out.gain[w]):
                continue
            out.degrees[w] = m
            # what the filter expects of its innovation: H P H' + R
            for a in range(m):
                out.z[w, a] = z[a]
                out.h[w, a] = h[a]
                for b in range(m):
                    u = r[a, b]
                    for c in range(n):
                        u += h[a, c] * pht[c, b]
                    out.expected[w, a, b] = u
            joseph(p, h, r, m, pht, out.gain[w], work)
