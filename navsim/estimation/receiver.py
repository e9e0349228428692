"""The satellite receiver: one least-squares fix an epoch from pseudoranges and range rates.

Source: `docs/theory/landing.md`, section 5; the solution itself is `navsim.core.least_squares`.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core.dop import MAX_CLOCKS, MAX_UNKNOWNS
from navsim.core.earth import ecef_to_llh, ned_axes
from navsim.core.jit import kernel
from navsim.core.least_squares import solve_position, solve_velocity


@kernel
def _to_ned(c_ne, cofactor, out):
    """out = C_ne cofactor C_ne' for the position block."""
    for i in range(3):
        for j in range(3):
            t = 0.0
            for a in range(3):
                for b in range(3):
                    t += c_ne[i, a] * cofactor[a, b] * c_ne[j, b]
            out[i, j] = t


@kernel
def fixes(start, position, velocity, sigma, rate_sigma, clock, pseudorange, range_rate, llh, v_ned, clocks, cov):
    """Fixes of one run.

    start: (3,) ECEF point to begin the iteration at. position, velocity: (e, s, 3) of the sources, ECEF.
    sigma, rate_sigma, pseudorange, range_rate: (e, s); a nan measurement is not used. clock: (s,) int.
    Out: llh (e, 3) rad, rad, m; v_ned (e, 3) m/s; clocks (e, MAX_CLOCKS) m by clock number; cov (e, 6, 6)
    covariance of position and velocity, NED, with what errors of position do to velocity. All nan where there are too
    few sources or the geometry is singular; velocity alone where that is so of the range rates.
    """
    epochs, sources = pseudorange.shape
    used = np.empty(sources, np.bool_)
    column = np.empty(MAX_CLOCKS, np.int64)
    normal = np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS))
    cofactor = np.empty((MAX_UNKNOWNS, MAX_UNKNOWNS))
    rhs = np.empty(MAX_UNKNOWNS)
    x = np.zeros(MAX_UNKNOWNS)
    v = np.empty(4)
    los = np.empty((sources, 3))
    c_ne, p_r, p_v, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    slope = np.empty((3, 4))
    x[0:3] = start
    for e in range(epochs):
        llh[e] = np.nan
        v_ned[e] = np.nan
        clocks[e] = np.nan
        cov[e] = np.nan
        for s in range(sources):
            used[s] = not math.isnan(pseudorange[e, s])
        n = solve_position(position[e], pseudorange[e], sigma[e], used, clock, x, column, normal, cofactor, rhs, los)
        if n == 0:
            x[0:3] = start
            continue
        ecef_to_llh(x[0], x[1], x[2], llh[e])
        ned_axes(llh[e, 0], llh[e, 1], c_ne)
        _to_ned(c_ne, cofactor, p_r)
        for i in range(3):
            for j in range(3):
                cov[e, i, j] = p_r[i, j]
        for c in range(MAX_CLOCKS):
            if column[c] >= 0:
                clocks[e, c] = x[column[c]]
        for s in range(sources):
            used[s] = used[s] and not math.isnan(range_rate[e, s])
        if solve_velocity(
            position[e], los, velocity[e], range_rate[e], rate_sigma[e], used, x, v, normal, cofactor, slope
        ):
            _to_ned(c_ne, cofactor, p_v)
            _to_ned(c_ne, slope[:, :3], turned)  # transposed: turned' = G, velocity error = G position error
            for i in range(3):
                v_ned[e, i] = c_ne[i, 0] * v[0] + c_ne[i, 1] * v[1] + c_ne[i, 2] * v[2]
                for j in range(3):
                    t = 0.0
                    for a in range(3):
                        t += turned[a, i] * p_r[a, j]
                    cov[e, 3 + i, j] = t
                    cov[e, j, 3 + i] = t
            for i in range(3):
                for j in range(3):
                    t = p_v[i, j]
                    for a in range(3):
                        t += cov[e, 3 + i, a] * turned[a, j]
                    cov[e, 3 + i, 3 + j] = t
