"""Measurement update of a filter: gate, count of rejections, correction in the chart.

Source: `docs/theory/filter.md`, sections 4 to 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel, kernel_inline, kernel_internal
from navsim.compiler.lanes import alloc, any_lane, no, small_vector, where
from navsim.compiler.linear import copy, copy_matrix, solve_cholesky
from navsim.filter.covariance import gain, joseph
from navsim.filter.error_parametrisation import correct
from navsim.filter.error_products import move_products
from navsim.filter.history import record_decision, record_innovation, record_use
from navsim.filter.measurement_kinds import BEACON, MONITOR_ONLY_FIX
from navsim.filter.measurement_models import observe
from navsim.filter.outliers import add_spread, expects_outliers
from navsim.filter.states import MAX_MEASUREMENT_SIZE


class UpdateBuffers(NamedTuple):
    """Work space of a measurement update; see `observe`, `gain` and `joseph`."""

    have: np.ndarray
    """(MOST,), also `z`."""
    z: np.ndarray
    h: np.ndarray
    """(MOST, n)."""
    r: np.ndarray
    """(MOST, MOST), also `s`."""
    s: np.ndarray
    k: np.ndarray
    """(n, MOST), also `pht` and `work`."""
    pht: np.ndarray
    work: np.ndarray
    x: np.ndarray
    """(n,) estimated errors."""
    nav: np.ndarray
    """(NAV,) state before the update or at the output."""
    p: np.ndarray
    """(n, n) covariance likewise."""
    spread: np.ndarray
    """(1,) variance of an outlier given its innovation (`outliers.outlier_moments`)."""


@kernel_internal
def update_buffers(nav, n):
    """Allocate work space for a filter of n states, with the lanes of `nav`."""
    return UpdateBuffers(
        alloc(nav, (MAX_MEASUREMENT_SIZE,)), alloc(nav, (MAX_MEASUREMENT_SIZE,)), alloc(nav, (MAX_MEASUREMENT_SIZE, n)),
        alloc(nav, (MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
        alloc(nav, (MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
        alloc(nav, (n, MAX_MEASUREMENT_SIZE)), alloc(nav, (n, MAX_MEASUREMENT_SIZE)),
        alloc(nav, (n, MAX_MEASUREMENT_SIZE)), alloc(nav, (n,)), alloc(nav, (nav.shape[0],)),
        alloc(nav, (n, n)), alloc(nav, (1,)),
    )  # fmt: skip


@kernel
def whitened_square(s, z, m):
    """z' S^-1 z through the Cholesky factor s of S that `gain` left; z (m,) is spoiled."""
    q = 0.0
    for a in range(m):
        t = z[a]
        for b in range(a):
            t -= s[a, b] * z[b]
        z[a] = t / s[a, a]
        q += z[a] * z[a]
    return q


@kernel
def count_valid(have, m):
    """Number of valid measurements among the first m."""
    count = have[0]
    for a in range(1, m):
        count += have[a]
    return count


@kernel
def estimate_errors(k, z, m, x):
    """The estimated errors x (n,) = K z of m innovations."""
    for j in range(x.shape[0]):
        t = k[j, 0] * z[0]
        for a in range(1, m):
            t += k[j, a] * z[a]
        x[j] = t


@kernel
def estimate_by_factor(pht, s, z, m, x):
    """The same x (n,) = P H' S^-1 z without a gain, by what `innovation_factor` left."""
    y = small_vector(x, MAX_MEASUREMENT_SIZE)
    for a in range(m):
        y[a] = z[a]
    solve_cholesky(s, m, y)
    estimate_errors(pht, y, m, x)


@kernel
def gate_limit(gate, degrees):
    """Largest normalised innovation squared that passes, from `gate` (MOST + 1,) by degrees of freedom."""
    limit = degrees * 0.0 + gate[0]
    for m in range(1, gate.shape[0]):
        limit = where(degrees == m, gate[m], limit)
    return limit


@kernel
def passes_gate(q, degrees, rejected, model):
    """Whether q = z' S^-1 z is within the limit for its degrees, or follows `max_rejected` rejections in a row."""
    return (q <= gate_limit(model.gate, degrees)) | (rejected >= model.max_rejected)


@kernel
def count_rejection(weighed, used, counter, rejected):
    """Rejections (slots,) in a row, after a measurement of the slot `counter`."""
    rejected[counter] = where(weighed, where(used, 0.0, rejected[counter] + 1.0), rejected[counter])


@kernel
def apply_gate(ahead, weighed, degrees, m, buffers, counter, tested, model, rejected, record, i):
    """Whether a measurement is used: its innovation passes the chi-square test of `passes_gate`.

    - `buffers`: `update_buffers` with z (m,), which is overwritten, and the factor s of its covariance.
    - `counter`: its slot in `rejected` (slots,). `tested`: whether the gate tests it, and updates the slot.
    - The decision is stored as that of event i, except for the copy that predicts ahead.
    """
    record_innovation(ahead, buffers.have, weighed, m, buffers.z, buffers.s, record, i)
    q = whitened_square(buffers.s, buffers.z, m)
    used = weighed & passes_gate(q, degrees, rejected[counter], model)
    if not tested:
        used = weighed
    if counter == MONITOR_ONLY_FIX:
        used = used & no(used)
    record_use(used, m, record, i)
    if not ahead:
        record_decision(weighed, used, q, degrees, record, i)
    if tested:
        count_rejection(weighed, used, counter, rejected)
    return used


@kernel
def copy_where_not(source, mask, target):
    """target (n,) <- source where `mask` is not."""
    for i in range(source.shape[0]):
        target[i] = where(mask, target[i], source[i])


@kernel_inline
def update(chart, used, kind, row, measurements, declared, nav, p, increments, interval, space, buffers):
    """Update nav (NAV,) and P (n, n) with a measurement and the errors buffers.x estimated from it, where it is used.

    The state is corrected first, then P at the corrected state.

    - `kind`, `row`, `measurements`, `declared`: as of `observe`; `increments`, `interval`: the last interval.
    - `chart`: the filter's error parametrisation; `used`: lanes whose measurement passed the gate.
    - `space`, `buffers`: work space; `buffers.x` (n,): estimated errors.
    """
    # a lane without the measurement does not change
    spared = any_lane(no(used))
    if spared:
        copy(nav, buffers.nav)
        copy_matrix(p, buffers.p)
    # Gauss-Newton: the prior is transformed to the new estimate and updated there. The reverse order would keep the
    # correlations that J_l(theta) y gives the fix at the old one
    correct(chart, nav, p, buffers.x, space)
    if chart.products > 0:
        move_products(chart.products, buffers.x, kind == BEACON, nav, p)
    m = observe(
        kind,
        row,
        measurements,
        nav,
        increments,
        interval,
        declared,
        space.c_nb,
        buffers.have,
        buffers.z,
        buffers.h,
        buffers.r,
    )
    gain(p, buffers.h, buffers.r, m, buffers.pht, buffers.s, buffers.k)
    joseph(p, buffers.h, buffers.r, m, buffers.pht, buffers.k, buffers.work)
    if expects_outliers(kind, measurements):
        add_spread(p, buffers.k, buffers.spread[0])
    if spared:
        copy_where_not(buffers.nav, used, nav)
        for i in range(p.shape[0]):
            copy_where_not(buffers.p[i], used, p[i])
