"""Iterated weighted least squares for position, clocks and velocity from pseudoranges and range rates.

Source: [1] Groves (2013), section 9.4.1 (single-epoch least-squares navigation solution), with weights.
"""

from __future__ import annotations

import math

from navsim.core.dop import add_source, clock_columns
from navsim.core.jit import kernel
from navsim.core.linear import cholesky, invert_factored, invert_spd, solve_cholesky

_MAX_ITERATIONS = 20
_CONVERGED = 1e-2
"""Stop after a step below this, m: convergence is quadratic, the next step would be some step^2 / (2 range),
under 1e-6 m for sources beyond 100 m."""


@kernel
def solve_position(source, pseudorange, sigma, used, clock, x, column, normal, cofactor, rhs, los):
    """Position and clocks of one epoch.

    source: (s, 3) ECEF, m. pseudorange, sigma: (s,) m. used: (s,) bool. clock: (s,) int.
    x: (6,) in: starting ECEF position; out: position, then the clocks, m.
    cofactor: (6, 6) out: the covariance (H' W H)^-1, ECEF axes. los: (s, 3) out: unit vectors.
    column, normal, rhs: work space. Returns the number of unknowns, 0 without a fix.
    """
    sources = source.shape[0]
    count = 0
    for s in range(sources):
        count += used[s]
    n = clock_columns(used, clock, column)
    if count < n or count == 0:
        return 0
    for _ in range(_MAX_ITERATIONS):
        for i in range(n):
            rhs[i] = 0.0
            for j in range(n):
                normal[i, j] = 0.0
        for s in range(sources):
            if not used[s]:
                continue
            dx = source[s, 0] - x[0]
            dy = source[s, 1] - x[1]
            dz = source[s, 2] - x[2]
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            ux, uy, uz = dx / distance, dy / distance, dz / distance
            los[s, 0] = ux
            los[s, 1] = uy
            los[s, 2] = uz
            c = column[clock[s]]
            w = 1.0 / (sigma[s] * sigma[s])
            # the clocks enter linearly: solve for their whole value each time
            z = w * (pseudorange[s] - distance)
            add_source(ux, uy, uz, w, c, normal)
            rhs[0] -= z * ux
            rhs[1] -= z * uy
            rhs[2] -= z * uz
            rhs[c] += z
        if not cholesky(normal, n):
            return 0
        solve_cholesky(normal, n, rhs)
        x[0] += rhs[0]
        x[1] += rhs[1]
        x[2] += rhs[2]
        for i in range(3, n):
            x[i] = rhs[i]
        move = rhs[0] * rhs[0] + rhs[1] * rhs[1] + rhs[2] * rhs[2]
        if not move < 1e18:  # also nan
            return 0
        if move < _CONVERGED * _CONVERGED:
            invert_factored(normal, n, cofactor)
            # the velocity takes the unit vectors of this place: a last step of 1 cm turns those of a source 100 m away
            # by 1e-4, some millimetres per second
            for s in range(sources):
                if used[s]:
                    dx = source[s, 0] - x[0]
                    dy = source[s, 1] - x[1]
                    dz = source[s, 2] - x[2]
                    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
                    los[s, 0] = dx / distance
                    los[s, 1] = dy / distance
                    los[s, 2] = dz / distance
            return n
    return 0


@kernel
def solve_velocity(source, los, source_velocity, range_rate, sigma, used, x, v, normal, cofactor, slope):
    """Velocity and the drift of the one receiver clock, from the unit vectors of the position fix.

    source, los, source_velocity: (s, 3) ECEF, m, m/s. range_rate, sigma: (s,) m/s. x: position fix, ECEF.
    v: (4,) out, ECEF m/s. cofactor: (6, 6) out, covariance from the range rates' noise alone.
    slope: (3, 4) out, its first three columns' transpose is d(velocity error)/d(position error): a position
    off by dr turns the unit vectors, which counts beside a near source (5 m at 200 m and 30 m/s: 0.7 m/s).
    normal: work space. Returns False where it cannot be solved.
    """
    for i in range(4):
        v[i] = 0.0
        for j in range(4):
            normal[i, j] = 0.0
    for s in range(los.shape[0]):
        if not used[s]:
            continue
        ux, uy, uz = los[s, 0], los[s, 1], los[s, 2]
        w = 1.0 / (sigma[s] * sigma[s])
        z = ux * source_velocity[s, 0] + uy * source_velocity[s, 1] + uz * source_velocity[s, 2]
        z = w * (range_rate[s] - z)
        add_source(ux, uy, uz, w, 3, normal)
        v[0] -= z * ux
        v[1] -= z * uy
        v[2] -= z * uz
        v[3] += z
    if not invert_spd(normal, 4, cofactor):
        return False
    solve_cholesky(normal, 4, v)
    for a in range(3):
        for i in range(4):
            slope[a, i] = 0.0
    for s in range(los.shape[0]):
        if not used[s]:
            continue
        ux, uy, uz = los[s, 0], los[s, 1], los[s, 2]
        distance = (source[s, 0] - x[0]) * ux + (source[s, 1] - x[1]) * uy + (source[s, 2] - x[2]) * uz
        wx, wy, wz = source_velocity[s, 0] - v[0], source_velocity[s, 1] - v[1], source_velocity[s, 2] - v[2]
        along = ux * wx + uy * wy + uz * wz
        weight = 1.0 / (sigma[s] * sigma[s] * distance)
        for a in range(3):
            # (I - u u') (v_source - v) / distance, the change of the range rate with the position
            d = weight * (wx - along * ux if a == 0 else wy - along * uy if a == 1 else wz - along * uz)
            slope[a, 0] -= d * ux
            slope[a, 1] -= d * uy
            slope[a, 2] -= d * uz
            slope[a, 3] += d
    for a in range(3):
        solve_cholesky(normal, 4, slope[a])
    return True
