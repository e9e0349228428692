"""Measurement update with all ranges of one epoch together, like a fix.

The gate tests each range, given those before it. All ranges use one estimate, which is corrected once. A correction by
each range would also rotate unknown directions, since charts rotate positions with attitude. A correction in one
direction would then correlate the other directions with the heading error, and the next ranges would wrongly correct
attitude.

Near a source one linearisation is not enough. Ranges are then predicted from the estimate after the ranges before them,
and all are processed again from the corrected estimate.

Source: [1] `docs/theory/tight-coupling.md`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel, within
from navsim.compiler.lanes import any_lane, no, room, select
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import gain, joseph
from navsim.filter.error_parametrisation import correct, feed_back, own_error
from navsim.filter.eskf import between
from navsim.filter.measurement_models import RANGE, is_bent, observe
from navsim.filter.update import errors_from, held

_MORE = 2
"""Further iterations for an epoch with curved ranges."""
NUMBERS = 2
"""Components of a range: pseudorange and range rate."""


class RangeEpoch(NamedTuple):
    """Measurement update of M estimates (components of a sum) with the ranges of an epoch."""

    x: np.ndarray
    """(M, n) corrections of the prior estimates so far."""
    prior: np.ndarray
    """(M, n, n) covariances before the epoch."""
    bent: np.ndarray
    """(M,) 1 if one linearisation is not enough."""
    used: np.ndarray
    """(E,) 1 for ranges that are used."""
    heard: np.ndarray
    """(c,) ranges of each time scale."""
    kept: np.ndarray
    """(c,) ranges used of each time scale."""
    jumped: np.ndarray
    """(c + 1,) see `receiver_clock.has_jumped`."""
    now: np.ndarray
    """(M,) 1 if the present range is curved. Work space, as are all that follow."""
    z: np.ndarray
    """(2,)."""
    h: np.ndarray
    """(2, n)."""
    y: np.ndarray
    """(n,)."""
    nav: np.ndarray
    """(NAV,)."""
    p: np.ndarray
    """(n, n), also `again`."""
    again: np.ndarray


@kernel
def is_alone(events, i, before):
    """Whether the event before (1), or behind (0), event i is none of the ranges of the same epoch."""
    j = i - 1 if before else i + 1
    if j < 0 or j >= events.time.shape[0]:
        return True
    return events.kind[j] != RANGE or events.ahead[j] != events.ahead[i] or events.time[j] != events.time[i]


@kernel
def _longest(events):
    """Number of ranges of the longest epoch."""
    most, length = 0, 0
    for i in range(events.time.shape[0]):
        if events.kind[i] == RANGE:
            length = 1 if is_alone(events, i, 1) else length + 1
            most = max(most, length)
    return most


@within
def range_epoch(nav, n, estimates, events, scales):
    """Allocate the update of so many estimates of n states with the ranges of an epoch, for so many time scales."""
    most = _longest(events)
    m, states, size = (estimates, n, nav.shape[0]) if most else (0, 0, 0)
    return RangeEpoch(
        room(nav, (m, states)), room(nav, (m, states, states)), room(nav, (m,)), room(nav, (most,)),
        room(nav, (scales,)), room(nav, (scales,)), room(nav, (scales + 1,)), room(nav, (m,)), room(nav, (NUMBERS,)),
        room(nav, (NUMBERS, states)), room(nav, (states,)), room(nav, (size,)), room(nav, (states, states)),
        room(nav, (states, states)),
    )  # fmt: skip


@kernel
def begin_epoch(epoch):
    """The first range of an epoch is at hand."""
    for b in range(epoch.heard.shape[0]):
        epoch.heard[b], epoch.kept[b] = 0.0, 0.0


@kernel
def begin_estimate(epoch, j, p):
    """Estimate j, of the covariance p (n, n), before the first range."""
    copy_matrix(p, epoch.prior[j])
    for i in range(p.shape[0]):
        epoch.x[j, i] = 0.0
    epoch.bent[j] = 0.0


@kernel
def foresee(chart, row, measurements, declared, nav, increments, interval, epoch, j, space, gauge):
    """`observe` a range for estimate j, given the ranges before it; nav (NAV,) is the state before the epoch.

    Returns the number of components.
    """
    ranges, z, h, x = measurements.ranges, gauge.z, gauge.h, epoch.x[j]
    m = observe(RANGE, row, measurements, nav, increments, interval, declared, space.c_nb, gauge.have, z, h, gauge.r)
    bent = is_bent(ranges, row, h, epoch.prior[j])
    epoch.now[j] = select(bent, 1.0, 0.0)
    for a in range(m):
        for c in range(x.shape[0]):
            z[a] -= h[a, c] * x[c]
    if any_lane(bent):
        for a in range(m):
            epoch.z[a] = z[a]
            copy(h[a], epoch.h[a])
        copy(nav, epoch.nav)
        feed_back(chart, epoch.nav, x, space)
        observe(
            RANGE, row, measurements, epoch.nav, increments, interval, declared, space.c_nb, gauge.have, z, h, gauge.r
        )
        for a in range(m):
            z[a] = select(bent, z[a], epoch.z[a])
            held(epoch.h[a], bent, h[a])
    return m


@kernel
def _weigh(used, m, p, gauge):
    """Update P (n, n) with a range of m components after `gain`, where it is used."""
    for i in range(p.shape[0]):
        for a in range(m):
            gauge.k[i, a] = select(used, gauge.k[i, a], 0.0)
    joseph(p, gauge.h, gauge.r, m, gauge.pht, gauge.k, gauge.work)


@kernel
def take_range(used, m, p, epoch, j, gauge):
    """Update estimate j with a range, where it is used: covariance p (n, n), and the correction gauge.x."""
    for i in range(p.shape[0]):
        epoch.x[j, i] += select(used, gauge.x[i], 0.0)
    epoch.bent[j] = select(used & (epoch.now[j] > 0.0), 1.0, epoch.bent[j])
    _weigh(used, m, p, gauge)


@kernel
def count_range(ranges, row, place, weighed, used, epoch):
    """Count a range, the one of this place in its epoch."""
    b = ranges.bias[row]
    epoch.heard[b] += select(weighed, 1.0, 0.0)
    epoch.kept[b] += select(used, 1.0, 0.0)
    epoch.used[place] = select(used, 1.0, 0.0)


@kernel
def _weigh_all(rows, measurements, declared, nav, p, x, increments, interval, epoch, space, gauge, moves):
    """Update P (n, n) with all used ranges at nav (NAV,); where it `moves`, also the correction x (n,)."""
    for e in range(rows.shape[0]):
        m = observe(
            RANGE, rows[e], measurements, nav, increments, interval, declared, space.c_nb, gauge.have, gauge.z,
            gauge.h, gauge.r,
        )  # fmt: skip
        good = gain(p, gauge.h, gauge.r, m, gauge.pht, gauge.s, gauge.k) & (epoch.used[e] > 0.0)
        if moves:
            for a in range(m):
                for c in range(x.shape[0]):
                    gauge.z[a] -= gauge.h[a, c] * x[c]
            errors_from(gauge.k, gauge.z, m, gauge.x)
            for i in range(x.shape[0]):
                x[i] += select(good, gauge.x[i], 0.0)
        _weigh(good, m, p, gauge)


@kernel
def move_estimate(chart, there, rows, measurements, declared, nav, p, increments, interval, epoch, j, space, gauge):
    """Correct estimate j, nav (NAV,) and p (n, n), with the ranges of these rows, where it is `there`.

    The prior is transformed to the new estimate, and all ranges are processed there, as in `update.update`.
    """
    x = epoch.x[j]
    some = there & no(there)
    for e in range(rows.shape[0]):
        some = some | (there & (epoch.used[e] > 0.0))
    if not any_lane(some):
        return
    copy(nav, gauge.nav)
    copy_matrix(epoch.prior[j], p)
    correct(chart, nav, p, x, space)
    bent = some & (epoch.bent[j] > 0.0)
    if any_lane(bent):
        for _ in range(_MORE):
            copy(nav, epoch.nav)
            copy_matrix(p, epoch.again)
            copy_matrix(p, epoch.p)
            # innovation of the prior from here
            between(gauge.nav, nav, epoch.y)
            own_error(chart, nav, epoch.y, x)
            _weigh_all(
                rows, measurements, declared, nav, epoch.p, x, increments, interval, epoch, space, gauge, True
            )  # fmt: skip
            correct(chart, nav, p, x, space)
            held(epoch.nav, bent, nav)
            for i in range(p.shape[0]):
                held(epoch.again[i], bent, p[i])
    _weigh_all(rows, measurements, declared, nav, p, x, increments, interval, epoch, space, gauge, False)
    if any_lane(no(some)):
        held(gauge.nav, some, nav)
        for i in range(p.shape[0]):
            held(epoch.prior[j, i], some, p[i])
