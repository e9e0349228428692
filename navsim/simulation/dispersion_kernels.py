"""Increments of inertial sensors on a trajectory that deviates from a reference, for runs in lanes.

The deviation is given at the samples of the sensors: its position with two derivatives, its rotation with one. Between
samples, the position is the quintic and the rotation the cubic with these values at both ends. The truth is thus
defined at all times, and twice or once differentiable. Rotations are Gibbs vectors, tan(angle / 2) along the axis, in
the reference's body axes. Source: `docs/theory/air.md`, section 5.
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import as_simd, small_vector


@kernel_inline
def _force_and_rate_change(force, rate, axes, gradient, earth, way, turn, out):
    """Difference of specific force and angular rate between the deviating trajectory and the reference.

    Writes out (6,): rad/s, m/s2, in the body axes of the deviating trajectory and of the reference.

    - `force`, `rate` (3,): of the reference, in its body axes.
    - `axes` (3, 3): body axes of the reference, by columns, in axes of the path.
    - `gradient` (3, 3): gravity gradient, 1/s2; `earth` (3,): rate of the Earth, rad/s; both in axes of the path.
    - `way` (9,): position, velocity and acceleration of the deviation; `turn` (6,): Gibbs vector and its rate.
    """
    hx, hy, hz = turn[0], turn[1], turn[2]
    k = 2.0 / (1.0 + (hx * hx + hy * hy + hz * hz))
    # contribution of the deviation to the specific force, along axes of the path
    ex = way[6] + 2.0 * (earth[1] * way[5] - earth[2] * way[4])
    ey = way[7] + 2.0 * (earth[2] * way[3] - earth[0] * way[5])
    ez = way[8] + 2.0 * (earth[0] * way[4] - earth[1] * way[3])
    ex -= gradient[0, 0] * way[0] + gradient[0, 1] * way[1] + gradient[0, 2] * way[2]
    ey -= gradient[1, 0] * way[0] + gradient[1, 1] * way[1] + gradient[1, 2] * way[2]
    ez -= gradient[2, 0] * way[0] + gradient[2, 1] * way[1] + gradient[2, 2] * way[2]
    ax = axes[0, 0] * ex + axes[1, 0] * ey + axes[2, 0] * ez
    ay = axes[0, 1] * ex + axes[1, 1] * ey + axes[2, 1] * ez
    az = axes[0, 2] * ex + axes[1, 2] * ey + axes[2, 2] * ez
    # into turned axes: v + k (-h x v + h x (h x v))
    fx, fy, fz = force[0] + ax, force[1] + ay, force[2] + az
    cx, cy, cz = hy * fz - hz * fy, hz * fx - hx * fz, hx * fy - hy * fx
    out[3] = ax + k * (hy * cz - hz * cy - cx)
    out[4] = ay + k * (hz * cx - hx * cz - cy)
    out[5] = az + k * (hx * cy - hy * cx - cz)
    fx, fy, fz = rate[0], rate[1], rate[2]
    cx, cy, cz = hy * fz - hz * fy, hz * fx - hx * fz, hx * fy - hy * fx
    gx, gy, gz = turn[3], turn[4], turn[5]
    out[0] = k * (hy * cz - hz * cy - cx + gx - (hy * gz - hz * gy))
    out[1] = k * (hz * cx - hx * cz - cy + gy - (hz * gx - hx * gz))
    out[2] = k * (hx * cy - hy * cx - cz + gz - (hx * gy - hy * gx))


@kernel
def deviate(dt, force, rate, axes, gradient, earth, way, turn, dtheta, dv, out_dtheta, out_dv):
    """Increments (n, 3) of runs, or of lanes, over intervals of dt s, from those of the reference dtheta, dv (n, 3).

    force, rate: (2n + 1, 3), axes: (2n + 1, 3, 3) of the reference at samples and between; gradient: (n + 1, 3, 3);
    earth: (3,), see `_force_and_rate_change`. way: (n + 1, 9), turn: (n + 1, 6) at samples. The contribution of the
    deviation is integrated by Simpson's rule, exact for its own acceleration. Out: out_dtheta, out_dv (n, 3).
    """
    way, turn, out_dtheta, out_dv = as_simd(way), as_simd(turn), as_simd(out_dtheta), as_simd(out_dv)
    before, between, after = small_vector(way, 6), small_vector(way, 6), small_vector(way, 6)
    place, turned = small_vector(way, 9), small_vector(way, 6)
    _force_and_rate_change(force[0], rate[0], axes[0], gradient[0], earth, way[0], turn[0], before)
    for k in range(dtheta.shape[0]):
        for i in range(3):
            p0, v0, a0 = way[k, i], way[k, 3 + i], way[k, 6 + i]
            p1, v1, a1 = way[k + 1, i], way[k + 1, 3 + i], way[k + 1, 6 + i]
            place[i] = 0.5 * (p0 + p1) + dt * (0.15625 * (v0 - v1) + dt * 0.015625 * (a0 + a1))
            place[3 + i] = 1.875 * (p1 - p0) / dt - 0.4375 * (v0 + v1) + dt * 0.03125 * (a1 - a0)
            place[6 + i] = 1.5 * (v1 - v0) / dt - 0.25 * (a0 + a1)
            h0, g0, h1, g1 = turn[k, i], turn[k, 3 + i], turn[k + 1, i], turn[k + 1, 3 + i]
            turned[i] = 0.5 * (h0 + h1) + 0.125 * dt * (g0 - g1)
            turned[3 + i] = 1.5 * (h1 - h0) / dt - 0.25 * (g0 + g1)
        middle, end = 2 * k + 1, 2 * k + 2
        _force_and_rate_change(force[middle], rate[middle], axes[middle], gradient[k], earth, place, turned, between)
        _force_and_rate_change(force[end], rate[end], axes[end], gradient[k + 1], earth, way[k + 1], turn[k + 1], after)
        for i in range(3):
            out_dtheta[k, i] = dtheta[k, i] + dt / 6.0 * (before[i] + 4.0 * between[i] + after[i])
            out_dv[k, i] = dv[k, i] + dt / 6.0 * (before[3 + i] + 4.0 * between[3 + i] + after[3 + i])
        for i in range(6):
            before[i] = after[i]


@kernel
def ranges_from(position, velocity, antenna, antenna_velocity, distance, rate):
    """Distances, m, and their rates, m/s, of sources at position, velocity (e, s, 3) from an antenna (e, 3), ECEF.

    Of one run or of lanes; nan if a position is. Out: distance, rate (e, s).
    """
    antenna, antenna_velocity = as_simd(antenna), as_simd(antenna_velocity)
    distance, rate = as_simd(distance), as_simd(rate)
    for e in range(position.shape[0]):
        for s in range(position.shape[1]):
            square, product = 0.0 * antenna[e, 0], 0.0 * antenna[e, 0]
            for i in range(3):
                away = position[e, s, i] - antenna[e, i]
                square += away * away
                product += away * (velocity[e, s, i] - antenna_velocity[e, i])
            distance[e, s] = math.sqrt(square)
            rate[e, s] = product / distance[e, s]
