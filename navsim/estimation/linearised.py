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

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import fma, numbers, registers, room
from navsim.compiler.linear import copy, copy_matrix
from navsim.core.covariance import gain, joseph, kept, transition
from navsim.core.states import (
    A_D,
    A_E,
    A_N,
    ATT,
    GYRO,
    MOST,
    POS,
    R_D,
    R_E,
    R_N,
    SENSORS,
    V_D,
    V_E,
    V_N,
    VEL,
    N,
)
from navsim.core.strapdown import MID_N
from navsim.estimation.charts import PLAIN
from navsim.estimation.filter_loop import advance, set_off, workshop
from navsim.estimation.observations import observe
from navsim.estimation.records import OUTPUT, PASS, TIME_TOLERANCE, Events

NOISES = 4
"""Sensor noises: white gyro, white accelerometer, drive of the Markov gyro and accelerometer bias."""

ROWS = 4
"""Lanes that rows of matrices are taken in: nine rows fill most of three registers."""

_DT = MID_N + 6
_PAST_N = _DT + 1
"""What is kept of a step: mid (MID_N,) of `strapdown.step`, compensated increments (6,), its length, s."""


class Linearised(NamedTuple):
    """A filter along the truth. Of i intervals that events end: transition (i, n, n); inputs (i, 9, t) of the truth's
    sensor states; added (i, NOISES, 15, 15) covariance for a unit density of each noise that there is, of navigation
    and the Markov biases. Of w
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


def empty(steps: Steps, outputs: int, n: int, truth: np.ndarray) -> Linearised:
    """Empty arrays for the steps of a flight, of a filter of n states."""
    t = truth.size
    i, w = int(steps.interval.max(initial=-1)) + 1, int(steps.measurement.max(initial=-1)) + 1
    return Linearised(
        np.empty((i, n, n)), np.empty((i, SENSORS, t)), np.empty((i, NOISES, N, N)), np.zeros((w, MOST, n)),
        np.zeros((w, n, MOST)), np.zeros((w, MOST)), np.zeros((w, MOST, MOST)), np.zeros((w, MOST)),
        np.empty((outputs, n, n)),
    )  # fmt: skip


@kernel
def _add_square(columns, numbers_, scale, total):
    """total (9, 9) <- total + scale times the sum of c c' of three columns c (9,) of nine numbers.

    The nine are rows, side by side in registers: columns (3, g), total (9 or more, g), which has its columns first;
    numbers_: those of `columns`.
    """
    for g in range(total.shape[1]):
        x, y, z = scale * columns[0, g], scale * columns[1, g], scale * columns[2, g]
        for j in range(SENSORS):
            total[j, g] = fma(z, numbers_[2, j], fma(y, numbers_[1, j], fma(x, numbers_[0, j], total[j, g])))


@kernel
def _one_earlier(phi, keep, m):
    """What numbers at the end of an interval owe to the states at a moment, taken one step back: m <- m Phi.

    m (9 + k, g): the nine rows of each column side by side in registers. phi (9, 9 + k): as `transition` writes it.
    keep (k,): what is left of the sensor states after the step.
    """
    for g in range(m.shape[1]):
        r0, r1, r2, v0, v1, v2, a0, a1, a2 = (
            m[R_N, g], m[R_E, g], m[R_D, g], m[V_N, g], m[V_E, g], m[V_D, g], m[A_N, g], m[A_E, g], m[A_D, g],
        )  # fmt: skip
        for c in range(m.shape[0]):
            t = m[c, g]
            if c >= SENSORS:
                t *= keep[c - SENSORS]
            t = fma(r2, phi[R_D, c], fma(r1, phi[R_E, c], fma(r0, phi[R_N, c], t)))
            t = fma(v2, phi[V_D, c], fma(v1, phi[V_E, c], fma(v0, phi[V_N, c], t)))
            m[c, g] = fma(a2, phi[A_D, c], fma(a1, phi[A_E, c], fma(a0, phi[A_N, c], t)))


@kernel
def _describe(count, past, both, markov, noises, space, clock, phi_total, inputs, added):
    """What happened in an interval that was flown in `count` steps: phi_total (n, n), inputs (9, t), added (NOISES, 15,
    15); clock: `clock.ReceiverClock`.

    Backward in time, since what a step adds is then taken to the end by what all later steps do together. past: as
    `_interval` leaves it. both (k,), markov, noises: as of `linearise`. space: phi (9, 9 + k), keep, left (k,), own
    (6,) and, in lanes of rows, m (9 + k, g), push (3, g), total (NOISES, 15, g).
    """
    phi, keep, left, own, m, push, total = space
    m_numbers, push_numbers, total_numbers = numbers(m), numbers(push), numbers(total)
    size, k, groups, scales = phi_total.shape[0], both.shape[0], m.shape[1], clock.scales.shape[0]
    # the states of navigation and of its sensors, before those of the clock
    n = size - scales - 1 if scales > 0 else size
    length = 0.0
    for c in range(SENSORS + k):
        for g in range(groups):
            m[c, g] = 0.0
    for i in range(SENSORS):
        m_numbers[i, i] = 1.0
    for c in range(k):
        left[c] = 1.0
    for a in range(NOISES):
        for j in range(N):
            for g in range(groups):
                total[a, j, g] = 0.0
    for i in range(own.shape[0]):
        own[i] = 0.0
    for i in range(count - 1, -1, -1):
        dt = past[i, _DT]
        length += dt
        # noise comes in at the end of its step, that of velocity through the trapezoid rule into position (`add_white`)
        if noises[0]:
            _add_square(m[ATT : ATT + 3], m_numbers[ATT : ATT + 3], dt, total[0])
        if noises[1]:
            for c in range(3):
                for g in range(groups):
                    push[c, g] = fma(m[POS + c, g], 0.5 * dt, m[VEL + c, g])
            _add_square(push, push_numbers, dt, total[1])
        for a in range(2, NOISES):
            if noises[a]:
                triad = 3 * (a - 2)
                column = SENSORS + markov + triad
                _add_square(m[column : column + 3], m_numbers[column : column + 3], dt, total[a])
                for c in range(3):
                    rest = left[markov + triad + c]
                    own[triad + c] += rest * rest * dt
                    for g in range(groups):
                        total[a, GYRO + triad + c, g] = fma(m[column + c, g], rest * dt, total[a, GYRO + triad + c, g])
        transition(past[i, :MID_N], dt, past[i, MID_N:_DT], both, phi)
        for c in range(k):
            keep[c] = kept(both[c].decay, dt)
            left[c] *= keep[c]
        _one_earlier(phi, keep, m)
    for i in range(size):
        for j in range(size):
            phi_total[i, j] = m_numbers[j, i] if i < SENSORS and j < n else 0.0
    for c in range(SENSORS, n):
        phi_total[c, c] = left[c - SENSORS]
    for c in range(n, size):
        phi_total[c, c] = 1.0
        if c < size - 1:
            phi_total[c, size - 1] = length
    for i in range(SENSORS):
        for j in range(inputs.shape[1]):
            inputs[i, j] = m_numbers[n + j, i]
    for a in range(NOISES):
        for i in range(N):
            for j in range(i + 1):
                # exactly symmetric, as each product above is
                added[a, i, j] = total_numbers[a, i, j] if j < SENSORS else 0.0
                added[a, j, i] = added[a, i, j]
    for c in range(own.shape[0]):
        added[2 + c // 3, GYRO + c, GYRO + c] = own[c]


@kernel
def _interval(until, imu, model, nav, p, cursor, increments, space, past):
    """Fly to `until`, s; returns the number of steps. past (steps, _PAST_N): out, what `_describe` needs of each."""
    last = imu.time.shape[0] - 1
    count = 0
    while int(cursor[0]) < last and cursor[1] < until - TIME_TOLERANCE:
        step_end = min(imu.time[int(cursor[0]) + 1], until)
        advance(PLAIN, step_end, imu, model, nav, p, cursor, increments, space)
        for i in range(MID_N):
            past[count, i] = space.mid[i]
        for i in range(6):
            past[count, MID_N + i] = increments[i]
        past[count, _DT] = cursor[2]
        count += 1
    return count


@kernel
def linearise(imu, measurements, events, steps, state, model, both, markov, noises, like, out):
    """Fly the filter along exact increments from the exact initial state.

    imu, measurements, events, state, model: `estimation.records`, without noise, with one row of process noise. steps:
    `steps_of` the events. both: the declared sensor states of the filter, then those that there really are; markov:
    where among them the six Markov biases begin. noises (NOISES,) bool: those that there are; of others nothing is
    added. like: any array of `ROWS` lanes. out: filled in.
    """
    n = out.believed.shape[1]
    declared = model.declared
    h, z, r, s = np.empty((MOST, n)), np.empty(MOST), np.empty((MOST, MOST)), np.empty((MOST, MOST))
    pht, work = np.empty((n, MOST)), np.empty((n, MOST))
    space, k = workshop(state.navigation, n, PLAIN.straight), both.shape[0]
    past = np.empty((imu.time.shape[0] + 1, _PAST_N))
    lanes = registers(like)
    groups = (SENSORS + ROWS - 1) // ROWS
    to_describe = (
        np.zeros((SENSORS, SENSORS + k)), np.empty(k), np.empty(k), np.empty(N - SENSORS),
        room(lanes, (SENSORS + k, groups)), room(lanes, (3, groups)), room(lanes, (NOISES, N, groups)),
    )  # fmt: skip
    navs, ps, increments_pair, cursors = (
        np.empty((2, state.navigation.shape[0])), np.empty((2, n, n)), np.empty((2, 6)), np.zeros((2, 3)),
    )  # fmt: skip
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
            count = _interval(events.time[i], imu, model, nav, p, cursor, increments, space, past)
            _describe(
                count, past, both, markov, noises, to_describe, model.clock, out.transition[at], out.inputs[at],
                out.added[at],
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
