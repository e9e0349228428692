"""Measurement models of a recording's aids: a heading, the velocity of a vehicle along its axes, gyros at rest.

Source: [1] `docs/theory/ground.md`.
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import atan2, sincos_of_latitude
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import as_simd, no, small_matrix, small_vector, where
from navsim.filter.gnss_measurements import gyro_column
from navsim.filter.measurement_kinds import HEADING, VEHICLE_VELOCITY
from navsim.filter.states import (
    ATT,
    CONSTANT,
    GYROS,
    NAV_BIAS_FRAME,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_E,
    PHI_N,
    SENSORS,
    VEL,
)
from navsim.geodesy.attitude_kernels import dcm
from navsim.geodesy.earth_kernels import RATE, wrap_angle

_LEVEL = 0.01
"""A body axis has a heading if the square of its level part is above this: within 84 degrees of level."""


@kernel
def _heading(nav, declared, c_nb, axis, z, h):
    """Heading of an axis (3,) of the body [1]. z (1,): of a zero measurement; h (1, n): zero at first. Returns the
    square of its level part."""
    u = small_vector(nav, 3)
    for i in range(3):
        u[i] = c_nb[i, 0] * axis[0] + c_nb[i, 1] * axis[1] + c_nb[i, 2] * axis[2]
    level = u[0] * u[0] + u[1] * u[1]
    some = where(level > _LEVEL, level, _LEVEL)
    z[0] = -atan2(u[1], u[0])
    h[0, PHI_N], h[0, PHI_E], h[0, PHI_D] = -u[0] * u[2] / some, -u[1] * u[2] / some, 1.0 + 0.0 * level
    for c in range(declared.shape[0]):
        if declared[c].sensor == HEADING:
            h[0, SENSORS + c] = 1.0
            z[0] -= nav[NAV_SENSORS + c]
    return level


@kernel
def _vehicle_velocity(nav, increments, dt, declared, c_nb, table, z, h):
    """Velocity of a point along the axes of a vehicle [1]. z (3,): of a zero measurement; h (3, n): zero at first."""
    lever, turn, rate, along, plain = (
        small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3),
    )  # fmt: skip
    axes, whole = small_matrix(nav, 3, 3), small_matrix(nav, 3, 3)
    sin_lat, cos_lat = sincos_of_latitude(nav[NAV_LLH])
    for i in range(3):
        lever[i], turn[i] = table.lever_arm[i] + 0.0 * sin_lat, 0.0 * sin_lat
        rate[i] = increments[i] / dt - (c_nb[0, i] * RATE * cos_lat - c_nb[2, i] * RATE * sin_lat)
    for c in range(declared.shape[0]):
        if declared[c].sensor == VEHICLE_VELOCITY:
            if declared[c].axis < 3:
                turn[declared[c].axis] = nav[NAV_SENSORS + c]
            else:
                lever[declared[c].axis - 3] += nav[NAV_SENSORS + c]
    for i in range(3):
        p, q = (i + 1) % 3, (i + 2) % 3
        along[i] = rate[p] * lever[q] - rate[q] * lever[p]
        for j in range(3):
            along[i] += c_nb[j, i] * nav[NAV_VEL + j]
            # axes turned by a small rotation: (1 - [turn x]) M
            axes[i, j] = table.axes[i, j] - (turn[p] * table.axes[q, j] - turn[q] * table.axes[p, j])
    for i in range(3):
        plain[i] = table.axes[i, 0] * along[0] + table.axes[i, 1] * along[1] + table.axes[i, 2] * along[2]
        z[i] = -(axes[i, 0] * along[0] + axes[i, 1] * along[1] + axes[i, 2] * along[2])
        for j in range(3):
            whole[i, j] = axes[i, 0] * c_nb[j, 0] + axes[i, 1] * c_nb[j, 1] + axes[i, 2] * c_nb[j, 2]
    for i in range(3):
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            h[i, VEL + k] = whole[i, k]
            # C_true' v = C' v + C' [v x] theta
            h[i, ATT + k] = whole[i, p] * nav[NAV_VEL + q] - whole[i, q] * nav[NAV_VEL + p]
    for c in range(declared.shape[0]):
        if declared[c].sensor == GYROS:
            for i in range(3):
                h[i, SENSORS + c] = gyro_column(declared[c], i, increments, dt, axes, lever)
        elif declared[c].sensor == VEHICLE_VELOCITY:
            p, q = (declared[c].axis + 1) % 3, (declared[c].axis + 2) % 3
            if declared[c].axis < 3:
                h[p, SENSORS + c], h[q, SENSORS + c] = plain[q], -plain[p]
            else:
                for i in range(3):
                    h[i, SENSORS + c] = axes[i, p] * rate[q] - axes[i, q] * rate[p]


@kernel
def _rest_rate(nav, declared, c_nb, z, h):
    """Reading of the gyros at rest: the Earth's rate and their biases [1]. z, h: as of `_vehicle_velocity`."""
    sin_lat, cos_lat = sincos_of_latitude(nav[NAV_LLH])
    for i in range(3):
        z[i] = -(c_nb[0, i] * RATE * cos_lat - c_nb[2, i] * RATE * sin_lat)
    for c in range(declared.shape[0]):
        if declared[c].sensor == GYROS and declared[c].signal == CONSTANT:
            z[declared[c].axis] -= nav[NAV_SENSORS + c]
            h[declared[c].axis, SENSORS + c] = 1.0


@kernel
def observe_vehicle(kind, table, row, nav, increments, dt, declared, c_nb, have, z, h, r):
    measured = as_simd(table.value)
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
    count, level = 3, 0.0 * nav[NAV_QUAT] + 1.0
    if kind == HEADING:
        level, count = _heading(nav, declared, c_nb, table.axes[0], z, h), 1
    elif kind == VEHICLE_VELOCITY:
        _vehicle_velocity(nav, increments, dt, declared, c_nb, table, z, h)
    else:
        _rest_rate(nav, declared, c_nb, z, h)
    for a in range(count):
        there = no(math.isnan(measured[row, a])) & (level > _LEVEL)
        have[a] = where(there, 1.0, 0.0)
        off = z[a] + measured[row, a]
        if kind == HEADING:
            off = wrap_angle(off)
        z[a] = where(there, off, 0.0)
        for c in range(h.shape[1]):
            h[a, c] *= have[a]
        for b in range(count):
            r[a, b] = 0.0 * level
        r[a, a] = where(there, table.variance[row, a], 1.0)
    return count
