"""The filter linearised along the truth, with all matrices of a linear covariance analysis.

Along an error-free flight the filter's gains are those of every run to first order. This kernel stores, for each
interval between events, the propagation of errors and the added sensor noise, and for each measurement its innovation
and gain. The true error statistics then need only matrices (`navsim.simulation.landing_covariance`).

Errors are (dr, dv, theta, minus the estimates of the sensor states). True sensor states are not included, since they
need not follow the filter model; they act through `inputs`. Source: Maybeck, Stochastic Models, Estimation, and
Control, vol. 1 (1979), section 6.8 (covariance analysis with a truth model of its own).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import fma
from navsim.compiler.linear import copy, copy_matrix, identity
from navsim.filter.covariance import gain, joseph, propagate_covariance, propagate_markov_states
from navsim.filter.error_parametrisation import PLAIN
from navsim.filter.filter_loop import advance_once, can_advance, propagation_buffers, start_mechanisation
from navsim.filter.interval import add_driven, add_white
from navsim.filter.measurement_models import observe
from navsim.filter.records import OUTPUT, PASS, TIME_TOLERANCE, Events
from navsim.filter.states import MAX_MEASUREMENT_SIZE, N_BASE, SENSORS

NOISES = 4
"""Sensor noises: white gyro, white accelerometer, drive of the Markov gyro and accelerometer bias."""


class Linearised(NamedTuple):
    """A filter linearised along the truth: i intervals between events, w measurements, o outputs."""

    transition: np.ndarray
    """(i, n, n)."""
    inputs: np.ndarray
    """(i, 9, t) effect of the true sensor states."""
    added: np.ndarray
    """(i, NOISES, 15, 15) covariance for a unit density of each simulated noise, of navigation and the Markov
    biases."""
    h: np.ndarray
    """(w, MOST, n)."""
    gain: np.ndarray
    """(w, n, MOST)."""
    z: np.ndarray
    """(w, MOST) innovation at the truth."""
    expected: np.ndarray
    """(w, MOST, MOST) innovation covariance of the filter."""
    have: np.ndarray
    """(w, MOST) see `observe`."""
    assumed: np.ndarray
    """(o, n, n) filter covariance at the outputs."""


class Steps(NamedTuple):
    """Role of each event (k,) in a `Linearised`: the interval that it ends and its measurement, -1 for none; its
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
        np.empty((i, n, n)), np.empty((i, SENSORS, t)), np.empty((i, NOISES, N_BASE, N_BASE)),
        np.zeros((w, MAX_MEASUREMENT_SIZE, n)),
        np.zeros((w, n, MAX_MEASUREMENT_SIZE)), np.zeros((w, MAX_MEASUREMENT_SIZE)),
        np.zeros((w, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)), np.zeros((w, MAX_MEASUREMENT_SIZE)),
        np.empty((outputs, n, n)),
    )  # fmt: skip


@kernel
def _propagate_errors(phi, decay, errors, work):
    """Propagate errors (9 + k, 9 + k) over an interval; phi (9, 9 + k), decay (k,). work: the same size."""
    size = errors.shape[0]
    for i in range(SENSORS):
        for j in range(size):
            t = errors[i, j]
            for c in range(size):
                t = fma(phi[i, c], errors[c, j], t)
            work[i, j] = t
    for i in range(SENSORS):
        copy(work[i], errors[i])
    for c in range(decay.shape[0]):
        for j in range(size):
            errors[SENSORS + c, j] *= decay[c]


@kernel
def _propagate_noises(space, markov, noises, errors, work, added):
    """Propagate added (NOISES, 15, 15) over an interval, and add the noises of unit densities.

    space: after the interval. markov, noises: as of `linearise`. errors: (9, 15), work (15, 9): space.
    """
    sums = space.sums
    for i in range(SENSORS):
        for j in range(N_BASE):
            errors[i, j] = space.phi[i, j if j < SENSORS else j + markov]
    decay, nothing = sums.decay[markov : markov + N_BASE - SENSORS], np.zeros(N_BASE - SENSORS)
    for a in range(NOISES):
        if noises[a]:
            propagate_covariance(added[a], errors, N_BASE, work)
            propagate_markov_states(added[a], SENSORS, decay, nothing)
    if noises[0]:
        add_white(sums, 1.0, 0.0, added[0])
    if noises[1]:
        add_white(sums, 0.0, 1.0, added[1])
    for c in range(N_BASE - SENSORS):
        a = 2 + c // 3
        if noises[a]:
            add_driven(sums, markov + c, 1.0, SENSORS + c, added[a])
            added[a, SENSORS + c, SENSORS + c] += sums.noise[markov + c]


@kernel
def _interval(until, imu, model, markov, noises, nav, p, cursor, increments, space, tools, added):
    """Propagate to `until`, s.

    errors (9 + k, 9 + k) of `tools`: transition of errors and sensor states; added: (NOISES, 15, 15).
    """
    errors, work, of_markov, by = tools
    identity(errors)
    for a in range(NOISES):
        for i in range(N_BASE):
            for j in range(N_BASE):
                added[a, i, j] = 0.0
    while can_advance(imu, until, cursor):
        advance_once(PLAIN, until, imu, model, nav, p, cursor, increments, space)
        _propagate_errors(space.phi, space.sums.decay, errors, work)
        _propagate_noises(space, markov, noises, of_markov, by, added)


@kernel
def _describe(errors, clock, length, transition, inputs):
    """Write transition (n, n) and inputs (9, t) of an interval of this length, s, from the errors (9 + k, 9 + k) at its
    end.

    clock: `receiver_clock.ReceiverClock`.
    """
    size, scales = transition.shape[0], clock.scales.shape[0]
    # the states of navigation and of its sensors, before those of the clock
    n = size - scales - 1 if scales > 0 else size
    for i in range(size):
        for j in range(size):
            transition[i, j] = errors[i, j] if i < n and j < n else 0.0
    for c in range(n, size):
        transition[c, c] = 1.0
        if c < size - 1:
            transition[c, size - 1] = length
    for c in range(clock.offsets.shape[0]):
        transition[clock.offsets[c], clock.offsets[c] + 1] = length
    for i in range(SENSORS):
        for j in range(inputs.shape[1]):
            inputs[i, j] = errors[i, n + j]


@kernel
def linearise(imu, measurements, events, steps, state, model, both, markov, noises, out):
    """Run the filter along exact increments from the exact initial state.

    - `imu`, `measurements`, `events`, `state`, `model`: `filter.records`, without noise, with one row of process
      noise.
    - `steps`: `steps_of` the events.
    - `both`: declared sensor states of the filter, then the true ones, of unit drive.
    - `markov`: index of the first of the six Markov biases among them.
    - `noises` (NOISES,) bool: simulated noises; nothing is added for the others.
    - `out`: filled in.
    """
    n = out.assumed.shape[1]
    declared = model.declared
    h, z, r, s = (
        np.empty((MAX_MEASUREMENT_SIZE, n)),
        np.empty(MAX_MEASUREMENT_SIZE),
        np.empty((MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
        np.empty((MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
    )
    pht, work = np.empty((n, MAX_MEASUREMENT_SIZE)), np.empty((n, MAX_MEASUREMENT_SIZE))
    space, size = propagation_buffers(state.navigation, n, PLAIN.straight, both), SENSORS + both.shape[0]
    errors = np.empty((size, size))
    tools = errors, np.empty((SENSORS, size)), np.empty((SENSORS, N_BASE)), np.empty((N_BASE, SENSORS))
    navs, ps, increments_pair, cursors = (
        np.empty((2, state.navigation.shape[0])), np.empty((2, n, n)), np.empty((2, 6)), np.zeros((2, 3)),
    )  # fmt: skip
    copy(state.navigation, navs[0])
    copy_matrix(state.covariance, ps[0])
    start_mechanisation(imu, navs[0], declared, cursors[0], increments_pair[0])
    allocated = h, z, r, s, pht, work, space, errors, tools, navs, ps, increments_pair, cursors
    _process(imu, measurements, events, steps, model, (markov, noises), out, allocated)


@kernel
def _process(imu, measurements, events, steps, model, noise, out, allocated):
    """Process the events; `allocated` is what `linearise` allocates. Apart from it, since it owns no array."""
    h, z, r, s, pht, work, space, errors, tools, navs, ps, increments_pair, cursors = allocated
    (markov, noises), declared, n = noise, model.declared, out.assumed.shape[1]
    before = 0
    for i in range(events.time.shape[0]):
        # outputs ahead of late fixes are those of a copy, which starts from the present filter
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
                events.time[i], imu, model, markov, noises, nav, p, cursor, increments, space, tools,
                out.added[at],
            )  # fmt: skip
            _describe(errors, model.clock, steps.length[i], out.transition[at], out.inputs[at])
        kind, row = events.kind[i], events.row[i]
        if kind == OUTPUT:
            copy_matrix(p, out.assumed[row])
        elif kind != PASS:
            w = steps.measurement[i]
            m = observe(kind, row, measurements, nav, increments, cursor[2], declared, space.c_nb, out.have[w], z, h, r)
            if not gain(p, h, r, m, pht, s, out.gain[w]):
                for a in range(MAX_MEASUREMENT_SIZE):
                    out.have[w, a] = 0.0
                continue
            # innovation covariance of the filter: H P H' + R
            for a in range(m):
                out.z[w, a] = z[a]
                copy(h[a], out.h[w, a])
                for b in range(m):
                    u = r[a, b]
                    for c in range(n):
                        u += h[a, c] * pht[c, b]
                    out.expected[w, a, b] = u
            joseph(p, h, r, m, pht, out.gain[w], work)
