"""Dilution of precision and weighted fix covariance from unit vectors to the sources.

Row of H for one source: (-u, 1 in the column of its clock). The clocks of one epoch are those its used
sources belong to. A two-way range has no clock, and its row no such column. Sources: [1] Kaplan & Hegarty,
Understanding GPS/GNSS, 3rd ed. (2017), section 11.2.1. [2] `docs/theory/landing.md`, section 5.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import any_lane, where
from navsim.compiler.linear import cholesky, invert_factored

MAX_CLOCKS = 6
MAX_UNKNOWNS = 3 + MAX_CLOCKS
SINGULAR = 1e9
"""Limit beyond which a geometry counts as singular (`well_posed`): PDOP of 16 000 with four sources. A filter cannot
use such a fix in double precision. Its variance of 1e10 m2 in one direction hides its accuracy of metres in the
others."""


@kernel
def clock_columns(used, clock, column, present):
    """Give each clock that a source used in any lane belongs to a column; returns the number of unknowns.

    used: (s,) 1 where a source is used, else 0. clock: (s,) clock of each source, 0 .. MAX_CLOCKS - 1. Out: column
    (MAX_CLOCKS,) of H, -1 for a clock without source; columns go by clock number. present: (MAX_CLOCKS,) 1 where the
    clock has a source, else 0. A source with clock -1 has none.
    """
    for c in range(MAX_CLOCKS):
        column[c] = -1
        present[c] = 0.0
    for s in range(used.shape[0]):
        c = clock[s]
        if c < 0:
            continue
        present[c] = where(used[s] > 0.0, 1.0, present[c])
    n = 3
    for c in range(MAX_CLOCKS):
        if any_lane(present[c] > 0.0):
            column[c] = n
            n += 1
    return n


@kernel_inline
def add_source(x, y, z, weight, c, normal):
    """Add a source, unit vector x, y, z, the clock in column c, to the lower triangle of H' W H; c < 0: no clock."""
    normal[0, 0] += weight * x * x
    normal[1, 0] += weight * y * x
    normal[1, 1] += weight * y * y
    normal[2, 0] += weight * z * x
    normal[2, 1] += weight * z * y
    normal[2, 2] += weight * z * z
    if c < 0:
        return
    normal[c, 0] -= weight * x
    normal[c, 1] -= weight * y
    normal[c, 2] -= weight * z
    normal[c, c] += weight


@kernel
def strength(normal):
    """Sum of the weights of all sources, from their normal matrix: directions are unit vectors."""
    return normal[0, 0] + normal[1, 1] + normal[2, 2]


@kernel
def well_posed(weights, inverse):
    """Whether a geometry is not singular: the sum of the sources' weights times the position variance is below
    `SINGULAR`.

    With equal weights it is PDOP squared times the number of sources.
    """
    return weights * (inverse[0, 0] + inverse[1, 1] + inverse[2, 2]) < SINGULAR


@kernel
def invert_normal(normal, n, out):
    """out = normal^-1 (n, n), the place first, and whether there is one. normal is spoiled."""
    weights = strength(normal)
    good = cholesky(normal, n)
    invert_factored(normal, n, out)
    return good & well_posed(weights, out)


@kernel
def covariance_of_geometry(los, clock, weight, out, unknowns):
    """Inverse of H' W H at every epoch.

    - `los` (e, s, 3): unit vectors receiver -> source, any axes; nan marks an unused source.
    - `clock` (s,) int, -1: a two-way range; `weight` (e, s): 1/variance, or ones.
    - `out` (e, 6, 6): rows x, y, z, then the clocks; nan without a solution.
    - `unknowns` (e,) int, out: 0 if there are fewer sources than unknowns or the geometry is singular.
    """
    epochs, sources = los.shape[0], los.shape[1]
    used, present = np.empty(sources), np.empty(MAX_CLOCKS)
    column = np.empty(MAX_CLOCKS, np.int64)
    normal = np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS))
    for e in range(epochs):
        out[e] = np.nan
        count = 0
        for s in range(sources):
            used[s] = 0.0 if math.isnan(los[e, s, 0]) else 1.0
            count += int(used[s])
        n = clock_columns(used, clock, column, present)
        unknowns[e] = 0
        if count < n or count == 0:
            continue
        normal[:] = 0.0
        for s in range(sources):
            if used[s] > 0.0:
                c = column[clock[s]] if clock[s] >= 0 else -1
                add_source(los[e, s, 0], los[e, s, 1], los[e, s, 2], weight[e, s], c, normal)
        if invert_normal(normal, n, out[e]):
            unknowns[e] = n
        else:
            out[e] = np.nan


@kernel
def _normals(los, clock, weight, out):
    for e in range(los.shape[0]):
        for s in range(los.shape[1]):
            if not math.isnan(los[e, s, 0]):
                add_source(los[e, s, 0], los[e, s, 1], los[e, s, 2], weight[e, s], 3 + clock[s], out[e])


def normals(los: np.ndarray, clock: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """H' W H of every epoch (e, 6, 6), its lower triangle; a row for every clock, by number, zero without sources. See
    `dops`; los in any axes."""
    out = np.zeros((los.shape[0], MAX_UNKNOWNS, MAX_UNKNOWNS))
    _normals(*_as_kernels_take(los, clock, weight), out)
    return out


def dops(los: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """GDOP, PDOP, HDOP, VDOP, TDOP of each epoch, unit weights.

    los: (e, s, 3) unit vectors receiver -> source in ENU (or NED), nan for an unused source. clock: (s,) clock unknown
    of each source, -1 for two-way ranges. Returns (e, 5), nan without a solution. GDOP is the root of the whole trace,
    TDOP belongs to the first clock [2], nan without a clock.
    """
    cofactor, unknowns = geometry_covariance(los, clock, np.ones(los.shape[:2]))
    variance = np.diagonal(cofactor, axis1=1, axis2=2)
    present = np.arange(MAX_UNKNOWNS) < unknowns[:, None]
    # one after the other: a sum of eight and more numbers has another order
    g = np.where(unknowns > 0, np.add.accumulate(np.where(present, variance, 0.0), axis=1)[:, -1], np.nan)
    h, t = variance[:, 0] + variance[:, 1], np.where(unknowns > 3, variance[:, 3], np.nan)
    return np.sqrt(np.stack([g, h + variance[:, 2], h, variance[:, 2], t], axis=1))


def geometry_covariance(los: np.ndarray, clock: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H' W H)^-1 (e, 6, 6) and the number of unknowns (e,), 0 without a solution; see `dops`."""
    out = np.empty((los.shape[0], MAX_UNKNOWNS, MAX_UNKNOWNS))
    unknowns = np.zeros(los.shape[0], np.int64)
    covariance_of_geometry(*_as_kernels_take(los, clock, weight), out, unknowns)
    return out, unknowns


def _as_kernels_take(
    los: np.ndarray, clock: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        np.ascontiguousarray(los, dtype=float),
        np.ascontiguousarray(clock, dtype=np.int64),
        np.ascontiguousarray(weight, dtype=float),
    )
