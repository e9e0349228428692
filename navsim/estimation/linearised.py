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
    add_white,
    carry_covariance,
    carry_errors,
    gain,
    is_varying,
    joseph,
    transition,
    vary,
)
from navsim.core.jit import kernel
from navsim.core.linear import copy, copy_matrix, identity
from navsim.core.states import GYRO, MOST, SENSORS, N
from navsim.estimation.filter_loop import PLAIN, advance, set_off, workshop
from navsim.estimation.observations import observe
from navsim.estimation.records import OUTPUT, PASS, TIME_TOLERANCE, Events

NOISES = 4
"""Sensor noises: white gyro, white accelerometer, drive of the Markov gyro and accelerometer bias."""


class Linearised(NamedTuple):
    """A filter along the truth. Of i intervals that events end: transition (i, n, n); inputs (i, 9, t) of the truth's
    sensor states; added (i, NOISES, 15, 15) covariance for a unit density, of navigation and the Markov biases. Of w
    measurements: h (w, MOST, n), gain (w, n, MOST), z (w, MOST) innovation at the truth, expected (w, MOST, MOST) what
    the filter expects of it, have (w, MOST) as of `observe`. believed: (o, n, n) at the outputs.
    """

    transition: np.ndarray
    inputs: np.ndarray
    added: np.ndarray
    h: np.ndarray
    gain: np.ndarray
    z: np.ndarray
    expected: np.ndarray
    have: np.ndarray
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
        np.zeros((w, n, MOST)), np.zeros((w, MOST)), np.zeros((w, MOST, MOST)), np.zeros((w, MOST)),
        np.empty((outputs, n, n)),
    )  # fmt: skip


@kernel
def _interval(until, imu, model, truth, markov, unit_noise, nav, p, cursor, increments, space, work, phi_total, inputs,
              added):  # fmt: skip
    """Fly to `until` and describe what happens: phi_total (n, n), inputs (9, t), added (NOISES, 15, 15).

    work: driven (9 + t, t), phi of the truth (9, 9 + t) and of the Markov biases (9, 15), a (15 or t, 9).
    """
    driven, phi_truth, phi_markov, a = work
    t = inputs.shape[1]
    identity(phi_total)
    for i in range(SENSORS + t):
        for j in range(t):
            driven[i, j] = 1.0 if i == SENSORS + j else 0.0
    for i in range(NOISES):
        for j in range(N):
            for c in range(N):
                added[i, j, c] = 0.0
    varying = is_varying(markov)
    last = imu.time.shape[0] - 1
    while int(cursor[0]) < last and cursor[1] < until - TIME_TOLERANCE:
        step_end = min(imu.time[int(cursor[0]) + 1], until)
        advance(PLAIN, step_end, imu, model, nav, p, cursor, increments, space)
        dt = cursor[2]
        carry_errors(space.phi, model.declared, dt, phi_total, space.a)
        transition(space.mid, dt, increments, truth, phi_truth)
        carry_errors(phi_truth, truth, dt, driven, a[:t])
        transition(space.mid, dt, increments, markov, phi_markov)
        for i in range(NOISES):
            carry_covariance(added[i], phi_markov, a[:N])
            if varying:
                vary(markov, dt, added[i])
            add_white(added[i], unit_noise[i], dt)
            for c in range(3):
                # the drive of a Markov bias; the first two noises are white
                first = GYRO + 3 * (i - 2) + c
                if i >= 2:
                    added[i, first, first] += dt
    for i in range(SENSORS):
        for j in range(t):
            inputs[i, j] = driven[i, j]


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
    space, t = workshop(state.navigation, n), truth.shape[0]
    shared = (
        np.empty((SENSORS + t, t)), np.zeros((SENSORS, SENSORS + t)), np.zeros((SENSORS, N)),
        np.empty((max(N, t), SENSORS)),
    )  # fmt: skip
    navs, ps, increments_pair, cursors = (
        np.empty((2, state.navigation.shape[0])), np.empty((2, n, n)), np.empty((2, 6)), np.zeros((2, 3)),
    )  # fmt: skip
    unit_noise = np.zeros((NOISES, NOISE_N))
    unit_noise[0, NOISE_GYRO] = 1.0
    unit_noise[1, NOISE_ACCEL] = 1.0

    copy(state.navigation, navs[0])
    copy_matrix(state.covariance, ps[0])
    set_off(imu, navs[0], declared, cursors[0], increments_pair[0])
    before = 0
    for i in range(events.time.shape[0]):
        # what is answered ahead of late fixes is a copy's, which starts from the filter as it is now
        ahead = 1 if events.ahead[i] else 0
        if ahead > before:
            copy(navs[0], navs[1])
            copy_matrix(ps[0], ps[1])
            copy(increments_pair[0], increments_pair[1])
            copy(cursors[0], cursors[1])
        before = ahead
        nav, p, increments, cursor = navs[ahead], ps[ahead], increments_pair[ahead], cursors[ahead]
        at = steps.interval[i]
        if at >= 0:
            _interval(
                events.time[i], imu, model, truth, markov, unit_noise, nav, p, cursor, increments, space, shared,
                out.transition[at], out.inputs[at], out.added[at],
            )  # fmt: skip
        what, row = events.kind[i], events.row[i]
        if what == OUTPUT:
            copy_matrix(p, out.believed[row])
        elif what != PASS:
            w = steps.measurement[i]
            m = observe(what, row, measurements, nav, increments, cursor[2], declared, space.c_nb, out.have[w], z, h, r)
            if not gain(p, h, r, m, pht, s, out.gain[w]):
                for a in range(MOST):
                    out.have[w, a] = 0.0
                continue
            # what the filter expects of its innovation: H P H' + R
            for a in range(m):
                out.z[w, a] = z[a]
                copy(h[a], out.h[w, a])
                for b in range(m):
                    u = r[a, b]
                    for c in range(n):
                        u += h[a, c] * pht[c, b]
                    out.expected[w, a, b] = u
            joseph(p, h, r, m, pht, out.gain[w], work)
