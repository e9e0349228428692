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

from navsim.compiler.jit import kernel, kernel_inline, kernel_internal
from navsim.compiler.lanes import alloc, any_lane, no, where
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import gain, joseph
from navsim.filter.error_parametrisation import correct, error_in_filter_coordinates, feed_back
from navsim.filter.error_products import move_products, start_products
from navsim.filter.eskf import between
from navsim.filter.gnss_measurements import needs_relinearisation, observe_range
from navsim.filter.measurement_kinds import RANGE
from navsim.filter.measurement_models import clear
from navsim.filter.update import copy_where_not, estimate_errors

_MORE = 2
"""Further iterations for an epoch with curved ranges."""
RANGE_SIZE = 2
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
    available: np.ndarray
    """(c,) ranges of each time scale."""
    accepted: np.ndarray
    """(c,) ranges used of each time scale."""
    jumped: np.ndarray
    """(c + 1,) see `receiver_clock.detect_clock_jumps`."""
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
    """(n, n), also `work`."""
    work: np.ndarray


@kernel
def is_epoch_boundary(events, i, before):
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
            length = 1 if is_epoch_boundary(events, i, 1) else length + 1
            most = max(most, length)
    return most


@kernel_internal
def range_epoch(nav, n, estimates, events, scales):
    """Allocate the update of so many estimates of n states with the ranges of an epoch, for so many time scales."""
    most = _longest(events)
    m, states, size = (estimates, n, nav.shape[0]) if most else (0, 0, 0)
    return RangeEpoch(
        alloc(nav, (m, states)), alloc(nav, (m, states, states)), alloc(nav, (m,)), alloc(nav, (most,)),
        alloc(nav, (scales,)), alloc(nav, (scales,)), alloc(nav, (scales + 1,)), alloc(nav, (m,)),
        alloc(nav, (RANGE_SIZE,)),
        alloc(nav, (RANGE_SIZE, states)), alloc(nav, (states,)), alloc(nav, (size,)), alloc(nav, (states, states)),
        alloc(nav, (states, states)),
    )  # fmt: skip


@kernel
def begin_epoch(epoch):
    """The first range of an epoch is at hand."""
    for b in range(epoch.available.shape[0]):
        epoch.available[b], epoch.accepted[b] = 0.0, 0.0


@kernel
def begin_estimate(epoch, j, p):
    """Estimate j, of the covariance p (n, n), before the first range."""
    copy_matrix(p, epoch.prior[j])
    for i in range(p.shape[0]):
        epoch.x[j, i] = 0.0
    epoch.bent[j] = 0.0


@kernel_inline
def _observe(ranges, row, nav, increments, dt, declared, c_nb, have, z, h, r):
    """`measurement_models.observe` of a range, without the code of other kinds."""
    clear(have, h)
    # not the literal 2, for which numba would compile all that takes the size once more
    return np.int64(observe_range(ranges, row, nav, increments, dt, declared, c_nb, have, z, h, r))


@kernel
def predict_range(chart, row, measurements, declared, nav, increments, interval, epoch, j, space, buffers):
    """`observe` a range for estimate j, given the ranges before it; nav (NAV,) is the state before the epoch.

    Returns the number of components.
    """
    ranges, z, h, x = measurements.ranges, buffers.z, buffers.h, epoch.x[j]
    m = _observe(ranges, row, nav, increments, interval, declared, space.c_nb, buffers.have, z, h, buffers.r)
    bent = needs_relinearisation(ranges, row, h, epoch.prior[j])
    epoch.now[j] = where(bent, 1.0, 0.0)
    for a in range(m):
        for c in range(x.shape[0]):
            z[a] -= h[a, c] * x[c]
    if any_lane(bent):
        for a in range(m):
            epoch.z[a] = z[a]
            copy(h[a], epoch.h[a])
        copy(nav, epoch.nav)
        feed_back(chart, epoch.nav, x, space)
        _observe(ranges, row, epoch.nav, increments, interval, declared, space.c_nb, buffers.have, z, h, buffers.r)
        for a in range(m):
            z[a] = where(bent, z[a], epoch.z[a])
            copy_where_not(epoch.h[a], bent, h[a])
    return m


@kernel
def _update_covariance(used, m, p, buffers):
    """Update P (n, n) with a range of m components after `gain`, where it is used."""
    for i in range(p.shape[0]):
        for a in range(m):
            buffers.k[i, a] = where(used, buffers.k[i, a], 0.0)
    joseph(p, buffers.h, buffers.r, m, buffers.pht, buffers.k, buffers.work)


@kernel
def accumulate_range(used, m, p, epoch, j, buffers):
    """Update estimate j with a range, where it is used: covariance p (n, n), and the correction buffers.x."""
    for i in range(p.shape[0]):
        epoch.x[j, i] += where(used, buffers.x[i], 0.0)
    epoch.bent[j] = where(used & (epoch.now[j] > 0.0), 1.0, epoch.bent[j])
    _update_covariance(used, m, p, buffers)


@kernel
def count_range(ranges, row, place, weighed, used, epoch):
    """Count a range, the one of this place in its epoch."""
    b = ranges.bias[row]
    epoch.available[b] += where(weighed, 1.0, 0.0)
    epoch.accepted[b] += where(used, 1.0, 0.0)
    epoch.used[place] = where(used, 1.0, 0.0)


@kernel
def _update_with_all(rows, measurements, declared, nav, p, x, increments, interval, epoch, space, buffers, moves):
    """Update P (n, n) with all used ranges at nav (NAV,); where it `moves`, also the correction x (n,)."""
    for e in range(rows.shape[0]):
        m = _observe(
            measurements.ranges, rows[e], nav, increments, interval, declared, space.c_nb, buffers.have, buffers.z,
            buffers.h, buffers.r,
        )  # fmt: skip
        good = gain(p, buffers.h, buffers.r, m, buffers.pht, buffers.s, buffers.k) & (epoch.used[e] > 0.0)
        if moves:
            for a in range(m):
                for c in range(x.shape[0]):
                    buffers.z[a] -= buffers.h[a, c] * x[c]
            estimate_errors(buffers.k, buffers.z, m, buffers.x)
            for i in range(x.shape[0]):
                x[i] += where(good, buffers.x[i], 0.0)
        _update_covariance(good, m, p, buffers)


@kernel
def apply_epoch(chart, mask, rows, measurements, declared, nav, p, increments, interval, epoch, j, space, buffers):
    """Correct estimate j, nav (NAV,) and p (n, n), with the ranges of these rows, where it is `mask`.

    The prior is transformed to the new estimate, and all ranges are processed there, as in `update.update`.
    """
    x = epoch.x[j]
    some = mask & no(mask)
    for e in range(rows.shape[0]):
        some = some | (mask & (epoch.used[e] > 0.0))
    if not any_lane(some):
        return
    copy(nav, buffers.nav)
    copy_matrix(epoch.prior[j], p)
    correct(chart, nav, p, x, space)
    if chart.products > 0:
        move_products(chart.products, x, False, nav, p)
    bent = some & (epoch.bent[j] > 0.0)
    if any_lane(bent):
        for _ in range(_MORE):
            copy(nav, epoch.nav)
            copy_matrix(p, epoch.work)
            copy_matrix(p, epoch.p)
            # innovation of the prior from here
            between(buffers.nav, nav, epoch.y)
            error_in_filter_coordinates(chart, nav, epoch.y, x)
            _update_with_all(
                rows, measurements, declared, nav, epoch.p, x, increments, interval, epoch, space, buffers, True
            )  # fmt: skip
            correct(chart, nav, p, x, space)
            if chart.products > 0:
                move_products(chart.products, x, False, nav, p)
            copy_where_not(epoch.nav, bent, nav)
            for i in range(p.shape[0]):
                copy_where_not(epoch.work[i], bent, p[i])
    _update_with_all(rows, measurements, declared, nav, p, x, increments, interval, epoch, space, buffers, False)
    if any_lane(no(some)):
        copy_where_not(buffers.nav, some, nav)
        for i in range(p.shape[0]):
            copy_where_not(epoch.prior[j, i], some, p[i])
    if chart.products > 0:
        start_products(chart.products, nav, p)
