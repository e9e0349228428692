"""Measurement models of fixes, and of ranges and range rates of satellites and pseudolites.

Sources:

- [1] Groves (2013), section 14.3 (loosely coupled update with lever arm, eqs. 14.102-14.108; tightly coupled update,
  section 14.3.2).
- [2] `docs/theory/tight-coupling.md`.
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import sincos_of_latitude
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import any_lane, as_simd, no, small_matrix, small_vector, where
from navsim.filter.measurement_kinds import FIX, RANGE, SOURCE
from navsim.filter.states import (
    ATT,
    CONSTANT,
    GYROS,
    MAX_MEASUREMENT_SIZE,
    NAV_BIAS_FRAME,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_E,
    PHI_N,
    POS,
    SENSORS,
    VEL,
)
from navsim.geodesy.attitude_kernels import dcm
from navsim.geodesy.earth_kernels import RATE, llh_to_ecef, ned_axes, radii, wrap_angle

_NEAR = 0.1
"""A range is treated as curved if the position uncertainty across it lengthens it by more than this fraction of its
sigma."""


@kernel
def _across(arm, h, first):
    """-[arm x] into the attitude columns of the rows first .. first + 2: effect of a rotation on an arm in NED."""
    h[first, PHI_E], h[first, PHI_D] = arm[2], -arm[1]
    h[first + 1, PHI_N], h[first + 1, PHI_D] = -arm[2], arm[0]
    h[first + 2, PHI_N], h[first + 2, PHI_E] = arm[1], -arm[0]


@kernel
def _antenna(nav, increments, dt, c_nb, lever, arm, swing):
    """Position of the antenna relative to the IMU, arm (3,) NED m, and its velocity, swing (3,) NED m/s [1]; c_nb (3,
    3) out."""
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
    sin_lat, cos_lat = sincos_of_latitude(nav[NAV_LLH])
    rate = small_vector(nav, 3)
    # v_antenna = v + C (omega_eb x l), omega_eb = omega_ib - C' omega_ie
    for i in range(3):
        arm[i] = c_nb[i, 0] * lever[0] + c_nb[i, 1] * lever[1] + c_nb[i, 2] * lever[2]
        rate[i] = increments[i] / dt - (c_nb[0, i] * RATE * cos_lat - c_nb[2, i] * RATE * sin_lat)
    bx = rate[1] * lever[2] - rate[2] * lever[1]
    by = rate[2] * lever[0] - rate[0] * lever[2]
    bz = rate[0] * lever[1] - rate[1] * lever[0]
    for i in range(3):
        swing[i] = c_nb[i, 0] * bx + c_nb[i, 1] * by + c_nb[i, 2] * bz


@kernel
def gyro_column(one, i, increments, dt, c_nb, lever):
    """Effect of a gyro state on the swing along axis i of NED: omega_true = omega_measured - error, d = C [l x]
    error."""
    b, d = (one.axis + 1) % 3, (one.axis + 2) % 3
    turning = c_nb[i, b] * lever[d] - c_nb[i, d] * lever[b]
    if one.signal != CONSTANT:
        turning *= increments[one.signal] / dt
    return turning


@kernel
def _fix(nav, increments, dt, declared, c_nb, lever, llh, vel, z, h):
    """Position and velocity of the antenna [1]; z (6,) nan where vel is, h (6, n) zero at first."""
    arm, swing = small_vector(nav, 3), small_vector(nav, 3)
    _antenna(nav, increments, dt, c_nb, lever, arm, swing)
    lat, height = nav[NAV_LLH], nav[NAV_LLH + 2]
    sin_lat, cos_lat = sincos_of_latitude(lat)
    meridian, transverse = radii(sin_lat)
    z[0] = (llh[0] - lat) * (meridian + height) - arm[0]
    z[1] = wrap_angle(llh[1] - nav[NAV_LLH + 1]) * (transverse + height) * cos_lat - arm[1]
    z[2] = height - llh[2] - arm[2]
    # r_antenna = r + C l: d = -[C l x] theta
    _across(arm, h, 0)
    for i in range(3):
        z[3 + i] = vel[i] - nav[NAV_VEL + i] - swing[i]
        h[i, POS + i], h[3 + i, VEL + i] = 1.0, 1.0
    _across(swing, h, 3)
    for c in range(declared.shape[0]):
        if declared[c].sensor == GYROS:
            for i in range(3):
                h[3 + i, SENSORS + c] = gyro_column(declared[c], i, increments, dt, c_nb, lever)


@kernel
def _range(nav, increments, dt, declared, c_nb, ranges, row, z, h):
    """Pseudorange and range rate of a source [1], [2]; z (2,) of zero measurements, h (2, n) zero at first.

    range = |x - x_antenna| + bias, range rate = u (v - v_antenna) + drift, u the unit vector to the source.
    """
    arm, swing, x, u, w = (
        small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3),
    )  # fmt: skip
    c_ne = small_matrix(nav, 3, 3)
    _antenna(nav, increments, dt, c_nb, ranges.lever_arm, arm, swing)
    llh_to_ecef(nav[NAV_LLH:NAV_VEL], x)
    ned_axes(nav[NAV_LLH], nav[NAV_LLH + 1], c_ne)
    source, velocity = ranges.position[row], ranges.velocity[row]
    for i in range(3):
        x[i] = source[i] - x[i]
    for i in range(3):
        u[i] = c_ne[i, 0] * x[0] + c_ne[i, 1] * x[1] + c_ne[i, 2] * x[2] - arm[i]
        w[i] = c_ne[i, 0] * velocity[0] + c_ne[i, 1] * velocity[1] + c_ne[i, 2] * velocity[2]
        w[i] -= nav[NAV_VEL + i] + swing[i]
    distance = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for i in range(3):
        u[i] /= distance
    along = u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
    drift = h.shape[1] - 1
    bias = SENSORS + declared.shape[0] + ranges.bias[row]
    clock = NAV_SENSORS - SENSORS
    z[0], z[1] = -distance - nav[clock + bias], -along - nav[clock + drift]
    h[0, bias], h[1, drift] = 1.0, 1.0
    for i in range(3):
        # the place turns the unit vector
        turn = (along * u[i] - w[i]) / distance
        h[0, POS + i], h[1, POS + i], h[1, VEL + i] = -u[i], turn, -u[i]
        # r_antenna = r + C l: a' (theta x l) = (l x a)' theta
        j, k = (i + 1) % 3, (i + 2) % 3
        h[0, ATT + i] = arm[k] * u[j] - arm[j] * u[k]
        h[1, ATT + i] = arm[j] * ((along * u[k] - w[k]) / distance) - arm[k] * ((along * u[j] - w[j]) / distance)
        h[1, ATT + i] += swing[k] * u[j] - swing[j] * u[k]
    for c in range(declared.shape[0]):
        if declared[c].sensor == GYROS:
            for i in range(3):
                h[1, SENSORS + c] -= u[i] * gyro_column(declared[c], i, increments, dt, c_nb, ranges.lever_arm)


@kernel
def _transmitters(nav, declared, effects, row, m, z, h):
    """Effects (rows, m, q) of the estimated errors of transmitters on the m numbers of a measurement: from z, into
    h."""
    for c in range(declared.shape[0]):
        if declared[c].sensor == SOURCE and effects.shape[2] > 0:  # a probe's table has none
            for a in range(m):
                effect = effects[row, a, declared[c].axis]
                z[a] -= effect * nav[NAV_SENSORS + c]
                h[a, SENSORS + c] = effect


@kernel
def needs_relinearisation(ranges, row, h, p):
    """Whether one linearisation of a range is not enough: its source is near, and the position uncertain across it [2].

    h: from `observe`; p: (n, n).
    """
    across = 0.0
    for i in range(3):
        across += p[POS + i, POS + i]
        for j in range(3):
            across -= h[0, POS + i] * h[0, POS + j] * p[POS + i, POS + j]
    return across > 2.0 * ranges.distance[row] * _NEAR * ranges.sigma[row]


@kernel
def observe_fix(fixes, row, nav, increments, dt, declared, c_nb, have, z, h, r):
    llh, velocity, covariance = as_simd(fixes.llh), as_simd(fixes.velocity), as_simd(fixes.covariance)
    _fix(nav, increments, dt, declared, c_nb, fixes.lever_arm, llh[row], velocity[row], z, h)
    for c in range(declared.shape[0]):
        if declared[c].sensor == FIX:
            for a in range(MAX_MEASUREMENT_SIZE):
                effect = fixes.correlated[row, a, declared[c].axis]
                z[a] -= effect * nav[NAV_SENSORS + c]
                h[a, SENSORS + c] = effect
    _transmitters(nav, declared, fixes.transmitters, row, MAX_MEASUREMENT_SIZE, z, h)
    for a in range(MAX_MEASUREMENT_SIZE):
        there = no(math.isnan(z[a]))
        have[a] = where(there, 1.0, 0.0)
        z[a] = where(there, z[a], 0.0)
        if any_lane(no(there)):
            for c in range(h.shape[1]):
                h[a, c] *= have[a]
        for b in range(a):
            both = have[a] * have[b] > 0.0
            r[a, b] = where(both, covariance[row, a, b], 0.0)
            r[b, a] = r[a, b]
        r[a, a] = where(there, covariance[row, a, a], 1.0)
    return MAX_MEASUREMENT_SIZE


@kernel
def observe_range(ranges, row, nav, increments, dt, declared, c_nb, have, z, h, r):
    pseudorange, range_rate = as_simd(ranges.pseudorange), as_simd(ranges.range_rate)
    _range(nav, increments, dt, declared, c_nb, ranges, row, z, h)
    groups = ranges.correlated.shape[1]
    for c in range(declared.shape[0]):
        if declared[c].sensor == RANGE and declared[c].axis // groups == ranges.source[row]:
            effect = ranges.correlated[row, declared[c].axis % groups]
            z[0] -= effect * nav[NAV_SENSORS + c]
            h[0, SENSORS + c] = effect
    _transmitters(nav, declared, ranges.transmitters, row, 2, z, h)
    ranged = no(math.isnan(pseudorange[row]))
    for a in range(2):
        measured = pseudorange[row] if a == 0 else range_rate[row]
        sigma = ranges.sigma[row] if a == 0 else ranges.rate_sigma[row]
        there = ranged & no(math.isnan(measured))
        have[a] = where(there, 1.0, 0.0)
        z[a] = where(there, z[a] + measured, 0.0)
        for c in range(h.shape[1]):
            h[a, c] *= have[a]
        r[a, a] = where(there, sigma * sigma, 1.0)
    r[0, 1], r[1, 0] = 0.0, 0.0
    return 2
