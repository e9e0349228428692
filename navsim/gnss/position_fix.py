"""The satellite receiver: one least-squares fix an epoch from pseudoranges and range rates.

Source: `docs/theory/landing.md`, section 3; the solution itself is `navsim.gnss.least_squares`.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import alloc, any_lane, as_simd, no, small_matrix, small_vector, where
from navsim.geodesy.earth_kernels import ecef_to_llh, llh_to_ecef, ned_axes
from navsim.gnss.dop import MAX_CLOCKS, MAX_UNKNOWNS
from navsim.gnss.least_squares import solve_position, solve_velocity


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
    """Least-squares fixes of one run, or of lanes.

    - `start` (3,): ECEF, first point of the iteration.
    - `position`, `velocity` (e, s, 3): of the sources, ECEF; `sigma`, `rate_sigma` (e, s): of all runs.
    - `clock` (s,) int; `pseudorange`, `range_rate` (e, s): nan measurements are not used.
    - `llh` (e, 3), out: rad, rad, m; `v_ned` (e, 3), out: m/s; `clocks` (e, MAX_CLOCKS), out: m, by clock number.
    - `cov` (e, 6, 6), out: covariance of position and velocity, NED, including the effect of position errors on
      velocity.

    All are nan if there are too few sources or the geometry is singular; velocity alone if that is so for range rates.
    """
    pseudorange, range_rate, cov = as_simd(pseudorange), as_simd(range_rate), as_simd(cov)
    llh, v_ned, clocks = as_simd(llh), as_simd(v_ned), as_simd(clocks)
    epochs, sources = pseudorange.shape
    column = np.empty(MAX_CLOCKS, np.int64)
    used, present = alloc(llh, (sources,)), small_vector(llh, MAX_CLOCKS)
    normal, inverse = small_matrix(llh, MAX_UNKNOWNS, MAX_UNKNOWNS), small_matrix(llh, MAX_UNKNOWNS, MAX_UNKNOWNS)
    cofactor = small_matrix(llh, MAX_UNKNOWNS, MAX_UNKNOWNS)
    rhs, x, v, los = (
        small_vector(llh, MAX_UNKNOWNS),
        small_vector(llh, MAX_UNKNOWNS),
        small_vector(llh, 4),
        alloc(llh, (sources, 3)),
    )
    c_ne, p_r, p_v, turned = (
        small_matrix(llh, 3, 3),
        small_matrix(llh, 3, 3),
        small_matrix(llh, 3, 3),
        small_matrix(llh, 3, 3),
    )
    slope = small_matrix(llh, 3, 4)
    for i in range(MAX_UNKNOWNS):
        x[i] = start[i] if i < 3 else 0.0
        for j in range(MAX_UNKNOWNS):
            cofactor[i, j] = 0.0
    for e in range(epochs):
        for s in range(sources):
            used[s] = where(math.isnan(pseudorange[e, s]), 0.0, 1.0)
        fixed = solve_position(
            position[e], pseudorange[e], sigma[e], used, clock, x, column, present, normal, inverse, cofactor, rhs, los
        )
        ecef_to_llh(x[0], x[1], x[2], llh[e])
        ned_axes(llh[e, 0], llh[e, 1], c_ne)
        _to_ned(c_ne, cofactor, p_r)
        for i in range(3):
            llh[e, i] = where(fixed, llh[e, i], math.nan)
            for j in range(3):
                cov[e, i, j] = where(fixed, p_r[i, j], math.nan)
        for c in range(MAX_CLOCKS):
            clocks[e, c] = math.nan
            if column[c] >= 0:
                clocks[e, c] = where(fixed & (present[c] > 0.0), x[column[c]], math.nan)
        for s in range(sources):
            used[s] = where(math.isnan(range_rate[e, s]), 0.0, used[s])
        solved = fixed & solve_velocity(
            position[e], los, velocity[e], range_rate[e], rate_sigma[e], used, x, v, normal, inverse, slope
        )
        _to_ned(c_ne, inverse, p_v)
        _to_ned(c_ne, slope, turned)  # transposed: turned' = G, velocity error = G position error
        for i in range(3):
            t = c_ne[i, 0] * v[0] + c_ne[i, 1] * v[1] + c_ne[i, 2] * v[2]
            v_ned[e, i] = where(solved, t, math.nan)
            for j in range(3):
                t = turned[0, i] * p_r[0, j] + turned[1, i] * p_r[1, j] + turned[2, i] * p_r[2, j]
                cov[e, 3 + i, j] = where(solved, t, math.nan)
                cov[e, j, 3 + i] = cov[e, 3 + i, j]
        for i in range(3):
            for j in range(3):
                t = p_v[i, j]
                for a in range(3):
                    t += cov[e, 3 + i, a] * turned[a, j]
                cov[e, 3 + i, 3 + j] = where(solved, t, math.nan)
        if any_lane(no(fixed)):
            # the next epoch starts from the initial point
            for i in range(3):
                x[i] = where(fixed, x[i], start[i])


@kernel
def residuals(position, clock, antenna, axes, pseudorange, llh, clocks, residual, off):
    """Residuals of the pseudoranges of fixes, and errors of the fixes, of one run or of lanes.

    - `position` (e, s, 3), `clock` (s,), `pseudorange` (e, s), `llh` (e, 3), `clocks` (e, MAX_CLOCKS): as of `fixes`.
    - `antenna` (e, 3): true position, ECEF, m, in lanes with them; `axes` (e, 3, 3): rows, axes for the errors.
    - `residual` (e, s), out: m, nan for an unused range; `off` (e, 3), out: fix minus truth, m; both nan without a fix.
    """
    pseudorange, llh, clocks, antenna = as_simd(pseudorange), as_simd(llh), as_simd(clocks), as_simd(antenna)
    residual, off = as_simd(residual), as_simd(off)
    epochs, sources = pseudorange.shape
    here = small_vector(llh, 3)
    for e in range(epochs):
        llh_to_ecef(llh[e], here)
        for s in range(sources):
            dx, dy, dz = position[e, s, 0] - here[0], position[e, s, 1] - here[1], position[e, s, 2] - here[2]
            residual[e, s] = pseudorange[e, s] - math.sqrt(dx * dx + dy * dy + dz * dz) - clocks[e, clock[s]]
        dx, dy, dz = here[0] - antenna[e, 0], here[1] - antenna[e, 1], here[2] - antenna[e, 2]
        for i in range(3):
            off[e, i] = axes[e, i, 0] * dx + axes[e, i, 1] * dy + axes[e, i, 2] * dz
