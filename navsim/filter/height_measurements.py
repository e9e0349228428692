"""Measurement models of heights: above the ground, by pressure, above the ellipsoid.

Source: [1] `docs/theory/altimeters.md`, sections 1, 2.
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import as_simd, no, small_vector, where
from navsim.filter.measurement_kinds import PRESSURE
from navsim.filter.states import (
    NAV_BIAS_FRAME,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_E,
    PHI_N,
    R_D,
    R_E,
    R_N,
    SENSORS,
    V_D,
)
from navsim.geodesy.attitude_kernels import dcm
from navsim.geodesy.earth_kernels import wrap_angle


@kernel
def _above_ground(nav, c_nb, grounds, z, h):
    """Height of an antenna above the filter's ground model [1]; returns the distance of the antenna beyond the
    threshold, m.

    z (1,): of a zero measurement. h (1, n): zero at first.
    """
    arm = small_vector(nav, 3)
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
    lever, along, height = grounds.lever_arm, grounds.along, grounds.ground
    for i in range(3):
        arm[i] = c_nb[i, 0] * lever[0] + c_nb[i, 1] * lever[1] + c_nb[i, 2] * lever[2]
    north, east = grounds.direction[0], grounds.direction[1]
    beyond = north * ((nav[NAV_LLH] - grounds.threshold[0]) * grounds.scale[0] + arm[0])
    beyond += east * (wrap_angle(nav[NAV_LLH + 1] - grounds.threshold[1]) * grounds.scale[1] + arm[1])
    ground, slope = 0.0 * beyond + height[0], 0.0 * beyond
    for k in range(along.shape[0] - 1):
        rise = (height[k + 1] - height[k]) / (along[k + 1] - along[k])
        past = beyond - along[k]
        inside = (past > 0.0) & (beyond < along[k + 1])
        slope = where(inside, rise, slope)
        ground = where(past > 0.0, height[k] + rise * past, ground)
        ground = where(beyond < along[k + 1], ground, height[k + 1])
    z[0] = -(nav[NAV_LLH + 2] - arm[2] - grounds.threshold[2] - ground)
    # height = -r_D - slope (north r_N + east r_E), r_antenna = r + C l: the arm turns with theta
    by_north, by_east = -slope * north, -slope * east
    h[0, R_N], h[0, R_E], h[0, R_D] = by_north, by_east, -1.0
    h[0, PHI_N] = -arm[1] - by_east * arm[2]
    h[0, PHI_E] = arm[0] + by_north * arm[2]
    h[0, PHI_D] = by_east * arm[0] - by_north * arm[1]
    return beyond


@kernel
def observe_height_above_ground(grounds, row, nav, c_nb, have, z, h, r):
    height = as_simd(grounds.height)
    beyond = _above_ground(nav, c_nb, grounds, z, h)
    there = no(math.isnan(height[row])) & (beyond >= grounds.start)
    # by the height that the filter expects, which is not off by the noise
    sigma = grounds.share * -z[0]
    sigma = where(sigma > grounds.floor, sigma, grounds.floor)
    have[0] = where(there, 1.0, 0.0)
    z[0] = where(there, z[0] + height[row], 0.0)
    for c in range(h.shape[1]):
        h[0, c] *= have[0]
    r[0, 0] = where(there, sigma * sigma, 1.0)
    return 1


@kernel
def observe_pressure(pressures, row, nav, declared, have, z, h, r):
    measured, variance = as_simd(pressures.height), as_simd(pressures.variance)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    # late by the lag, it reads the earlier height: higher during the descent [1]
    z[0] = measured[row] - (nav[NAV_LLH + 2] + pressures.lag * nav[NAV_VEL + 2])
    h[0, R_D], h[0, V_D] = -1.0, pressures.lag
    for c in range(declared.shape[0]):
        if declared[c].sensor == PRESSURE:
            z[0] -= nav[NAV_SENSORS + c]
            h[0, SENSORS + c] = 1.0
    z[0] = where(there, z[0], 0.0)
    for c in range(h.shape[1]):
        h[0, c] *= have[0]
    r[0, 0] = where(there, variance[row], 1.0)
    return 1


@kernel
def observe_altitude(altitudes, row, nav, have, z, h, r):
    measured, variance = as_simd(altitudes.height), as_simd(altitudes.variance)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    z[0] = where(there, nav[NAV_LLH + 2] - measured[row], 0.0)  # down, as the error of position
    h[0, R_D] = have[0]
    r[0, 0] = where(there, variance[row], 1.0)
    return 1
