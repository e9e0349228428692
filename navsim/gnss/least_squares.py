"""Iterated weighted least squares for position, clocks and velocity from pseudoranges and range rates.

Source: [1] Groves (2013), section 9.4.1 (single-epoch least-squares navigation solution), with weights.
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import any_lane, no, where
from navsim.compiler.linear import cholesky, invert_factored, solve_cholesky
from navsim.gnss.dop import MAX_CLOCKS, add_source, clock_columns, strength, well_posed

_MAX_ITERATIONS = 20
_CONVERGED = 1e-2
"""Stop after a step below this, m: convergence is quadratic, the next step would be some step^2 / (2 range),
under 1e-6 m for sources beyond 100 m."""


@kernel
def _direction(source, s, x, los):
    """Unit vector los[s] from x to a source, and its distance."""
    dx = source[s, 0] - x[0]
    dy = source[s, 1] - x[1]
    dz = source[s, 2] - x[2]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    los[s, 0] = dx / distance
    los[s, 1] = dy / distance
    los[s, 2] = dz / distance
    return distance


@kernel
def solve_position(source, pseudorange, sigma, used, clock, x, column, present, normal, inverse, cofactor, rhs, los):
    """Position and clocks of one epoch; returns whether there is a fix.

    - `source` (s, 3): ECEF, m; `pseudorange`, `sigma` (s,): m; `used` (s,): 1 or 0; `clock` (s,): int.
    - `x` (6,), in: initial ECEF position; out: position, then the clocks, m, by `column` (MAX_CLOCKS,).
    - `cofactor` (6, 6), out: covariance (H' W H)^-1, ECEF axes; `los` (s, 3), out: unit vectors.
    - `present`, `normal`, `inverse`, `rhs`: work space.
    """
    sources = source.shape[0]
    n = clock_columns(used, clock, column, present)
    count = 0.0 * x[0]
    for s in range(sources):
        count += used[s]
    unknowns = present[0] + 3.0
    for c in range(1, MAX_CLOCKS):
        unknowns += present[c]
    running = (count >= unknowns) & (count > 0.0)
    fixed = running & no(running)
    for _ in range(_MAX_ITERATIONS):
        if not any_lane(running):
            break
        for i in range(n):
            rhs[i] = 0.0
            for j in range(n):
                normal[i, j] = 0.0
        for s in range(sources):
            there = used[s] > 0.0
            if not any_lane(there):
                continue
            distance = _direction(source, s, x, los)
            ux, uy, uz = los[s, 0], los[s, 1], los[s, 2]
            c = column[clock[s]]
            w = where(there, 1.0 / (sigma[s] * sigma[s]), 0.0)
            # the clocks enter linearly: solve for their total value each time
            z = where(there, w * (pseudorange[s] - distance), 0.0)
            add_source(ux, uy, uz, w, c, normal)
            rhs[0] -= z * ux
            rhs[1] -= z * uy
            rhs[2] -= z * uz
            rhs[c] += z
        for c in range(MAX_CLOCKS):
            if column[c] >= 0:
                i = column[c]
                normal[i, i] = where(present[c] > 0.0, normal[i, i], 1.0)
        weights = strength(normal)
        good = cholesky(normal, n)
        solve_cholesky(normal, n, rhs)
        move = rhs[0] * rhs[0] + rhs[1] * rhs[1] + rhs[2] * rhs[2]
        running = running & good & (move < 1e18)  # also nan
        for i in range(3):
            x[i] = where(running, x[i] + rhs[i], x[i])
        for i in range(3, n):
            x[i] = where(running, rhs[i], x[i])
        done = running & (move < _CONVERGED * _CONVERGED)
        if any_lane(done):
            invert_factored(normal, n, inverse)
            for i in range(n):
                for j in range(n):
                    cofactor[i, j] = where(done, inverse[i, j], cofactor[i, j])
            fixed = fixed | (done & well_posed(weights, inverse))
            running = running & no(done)
    # the velocity uses the unit vectors of this position: a last step of 1 cm turns those of a source 100 m away
    # by 1e-4, some millimetres per second
    for s in range(sources):
        if any_lane(used[s] > 0.0):
            _direction(source, s, x, los)
    return fixed


@kernel
def solve_velocity(source, los, source_velocity, range_rate, sigma, used, x, v, normal, cofactor, slope):
    """Velocity and receiver clock drift, from the unit vectors of the position fix; returns whether there is a
    solution.

    - `source`, `los`, `source_velocity` (s, 3): ECEF, m, m/s; `range_rate`, `sigma` (s,): m/s; `used` (s,): 1 or 0.
    - `x`: position fix, ECEF; `normal`: work space.
    - `v` (4,), out: ECEF m/s; `cofactor` (6, 6), out: covariance due to noise of the range rates alone.
    - `slope` (3, 4), out: the transpose of its first three columns is d(velocity error)/d(position error).

    A position error dr rotates the unit vectors. Near a source this matters: 5 m at 200 m and 30 m/s give 0.7 m/s.
    """
    for i in range(4):
        v[i] = 0.0
        for j in range(4):
            normal[i, j] = 0.0
    for s in range(los.shape[0]):
        there = used[s] > 0.0
        if not any_lane(there):
            continue
        ux, uy, uz = los[s, 0], los[s, 1], los[s, 2]
        w = where(there, 1.0 / (sigma[s] * sigma[s]), 0.0)
        z = ux * source_velocity[s, 0] + uy * source_velocity[s, 1] + uz * source_velocity[s, 2]
        z = where(there, w * (range_rate[s] - z), 0.0)
        add_source(ux, uy, uz, w, 3, normal)
        v[0] -= z * ux
        v[1] -= z * uy
        v[2] -= z * uz
        v[3] += z
    weights = strength(normal)
    good = cholesky(normal, 4)
    invert_factored(normal, 4, cofactor)
    good = good & well_posed(weights, cofactor)
    solve_cholesky(normal, 4, v)
    for a in range(3):
        for i in range(4):
            slope[a, i] = 0.0
    for s in range(los.shape[0]):
        there = used[s] > 0.0
        if not any_lane(there):
            continue
        ux, uy, uz = los[s, 0], los[s, 1], los[s, 2]
        distance = (source[s, 0] - x[0]) * ux + (source[s, 1] - x[1]) * uy + (source[s, 2] - x[2]) * uz
        wx, wy, wz = source_velocity[s, 0] - v[0], source_velocity[s, 1] - v[1], source_velocity[s, 2] - v[2]
        along = ux * wx + uy * wy + uz * wz
        weight = where(there, 1.0 / (sigma[s] * sigma[s] * distance), 0.0)
        # (I - u u') (v_source - v) / distance, the change of the range rate with the position
        _add_slope(slope[0], weight * (wx - along * ux), ux, uy, uz)
        _add_slope(slope[1], weight * (wy - along * uy), ux, uy, uz)
        _add_slope(slope[2], weight * (wz - along * uz), ux, uy, uz)
    for a in range(3):
        solve_cholesky(normal, 4, slope[a])
    return good


@kernel
def _add_slope(row, d, ux, uy, uz):
    row[0] -= d * ux
    row[1] -= d * uy
    row[2] -= d * uz
    row[3] += d
