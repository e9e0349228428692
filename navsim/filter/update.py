"""Measurement update of a filter: gate, count of rejections, correction in the chart.

Source: `docs/theory/filter.md`, sections 4 to 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel, within
from navsim.compiler.lanes import any_lane, no, room, select
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import gain, joseph
from navsim.filter.error_parametrisation import correct
from navsim.filter.history import keep_decision, keep_innovation, keep_use
from navsim.filter.measurement_models import PROBE, observe
from navsim.filter.states import MOST


class Weighing(NamedTuple):
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


@within
def weighing(nav, n):
    """Allocate work space for a filter of n states, with the lanes of `nav`."""
    return Weighing(
        room(nav, (MOST,)), room(nav, (MOST,)), room(nav, (MOST, n)), room(nav, (MOST, MOST)), room(nav, (MOST, MOST)),
        room(nav, (n, MOST)), room(nav, (n, MOST)), room(nav, (n, MOST)), room(nav, (n,)), room(nav, (nav.shape[0],)),
        room(nav, (n, n)),
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
def numbers_in(have, m):
    """Number of valid measurements among the first m."""
    count = have[0]
    for a in range(1, m):
        count += have[a]
    return count


@kernel
def errors_from(k, z, m, x):
    """The estimated errors x (n,) = K z of m innovations."""
    for j in range(x.shape[0]):
        t = k[j, 0] * z[0]
        for a in range(1, m):
            t += k[j, a] * z[a]
        x[j] = t


@kernel
def limit_of(gate, degrees):
    """Gate limit (MOST + 1,) for so many components."""
    limit = degrees * 0.0 + gate[0]
    for m in range(1, gate.shape[0]):
        limit = select(degrees == m, gate[m], limit)
    return limit


@kernel
def count_rejection(weighed, used, where, rejected):
    """Rejections (slots,) in a row, after a measurement of the slot `where`."""
    rejected[where] = select(weighed, select(used, 0.0, rejected[where] + 1.0), rejected[where])


@kernel
def decide(ahead, weighed, degrees, m, gauge, where, model, rejected, left, i):
    """Whether a measurement is used: it passes the gate, or enough consecutive ones before it were rejected.

    - `gauge`: `weighing` with z (m,), which is overwritten, and the factor s of its covariance.
    - `where`: its slot in `rejected` (slots,), which is updated.
    - The decision is stored as that of event i, except for the copy that predicts ahead.
    """
    keep_innovation(ahead, gauge.have, weighed, m, gauge.z, gauge.s, left, i)
    q = whitened_square(gauge.s, gauge.z, m)
    used = weighed & ((q <= limit_of(model.gate, degrees)) | (rejected[where] >= model.max_rejected))
    if where == PROBE:
        used = used & no(used)
    keep_use(used, m, left, i)
    if not ahead:
        keep_decision(weighed, used, q, degrees, left, i)
    count_rejection(weighed, used, where, rejected)
    return used


@kernel
def held(source, there, target):
    """target (n,) <- source where `there` is not."""
    for i in range(source.shape[0]):
        target[i] = select(there, target[i], source[i])


@kernel
def update(chart, used, what, row, measurements, declared, nav, p, increments, interval, space, gauge):
    """Update nav (NAV,) and P (n, n) with a measurement and the errors gauge.x estimated from it, where it is used.

    what, row, measurements, increments, interval, declared: as of `observe`.
    """
    # a lane without the measurement does not change
    spared = any_lane(no(used))
    if spared:
        copy(nav, gauge.nav)
        copy_matrix(p, gauge.p)
    # Gauss-Newton: the prior is transformed to the new estimate and updated there. The reverse order would keep the
    # correlations that J_l(theta) y gives the fix at the old one
    correct(chart, nav, p, gauge.x, space)
    m = observe(
        what, row, measurements, nav, increments, interval, declared, space.c_nb, gauge.have, gauge.z, gauge.h, gauge.r
    )
    gain(p, gauge.h, gauge.r, m, gauge.pht, gauge.s, gauge.k)
    joseph(p, gauge.h, gauge.r, m, gauge.pht, gauge.k, gauge.work)
    if spared:
        held(gauge.nav, used, nav)
        for i in range(p.shape[0]):
            held(gauge.p[i], used, p[i])
