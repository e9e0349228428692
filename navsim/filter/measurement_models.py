"""Measurement models: innovation, matrix and noise of each kind of measurement.

    z = measured - predicted = H d + noise,  d the plain errors (dr, dv, theta, sensor states)

A new kind needs a number, a table, a line in `Measurements` and `_TABLES` (`measurement_kinds`), and a branch of
`observe`. The rest of a sensor is its declaration (`sensors.aiding`).

Sources:

- [1] Groves (2013), section 14.3 (loosely coupled update with lever arm, eqs. 14.102-14.108; tightly coupled update,
  section 14.3.2).
- [2] `docs/theory/tight-coupling.md`.
- [3] `docs/theory/altimeters.md`, sections 1, 2.
- [4] `docs/theory/lasting-errors.md`, sections 3 and 4.
- [5] `docs/theory/magnetometer.md`.
- [6] `docs/theory/beacons.md`.
- [7] `docs/theory/ground-stations.md`.
- [8] `docs/theory/ground.md`.
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import atan2, exp_of_negative, sincos_of_latitude
from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import any_lane, as_simd, no, small_matrix, small_vector, where
from navsim.filter.error_products import FIRST, SECOND
from navsim.filter.measurement_kinds import (
    ABOVE_GROUND,
    ALTITUDE,
    AZIMUTH,
    BEACON,
    BEACON_STATES,
    DISTANCE,
    ELEVATION,
    FIX,
    HEADING,
    KIND_COUNT,
    MAGNETIC,
    MONITOR_ONLY_FIX,
    PRESSURE,
    PRODUCT,
    RANGE,
    REST_RATE,
    SOURCE,
    VEHICLE_VELOCITY,
)
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
    R_D,
    R_E,
    R_N,
    SENSORS,
    V_D,
    VEL,
)
from navsim.geodesy.attitude_kernels import dcm
from navsim.geodesy.earth_kernels import RATE, llh_to_ecef, ned_axes, radii, wrap_angle

_LEVEL = 0.01
"""A body axis has a heading if the square of its level part is above this: within 84 degrees of level."""
_NEAR = 0.1
"""A range is treated as curved if the position uncertainty across it lengthens it by more than this fraction of its
sigma."""


@kernel
def slot(kind, row, measurements):
    """Counter for consecutive rejections of such a measurement; each source of ranges has its own."""
    beacons = measurements.beacons
    if kind == RANGE:
        return KIND_COUNT + beacons.position.shape[0] + measurements.ranges.source[row]
    return KIND_COUNT + beacons.beacon[row] if kind == BEACON else kind


@kernel
def hard_iron(declared):
    """First error state of a magnetometer's hard iron, a vector in body axes; 0 if no state is."""
    first = 0
    for c in range(declared.shape[0] - 1, -1, -1):
        if declared[c].sensor == MAGNETIC and declared[c].signal == CONSTANT and declared[c].axis == 0:
            first = SENSORS + c
    return first


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
def _turning(one, i, increments, dt, c_nb, lever):
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
                h[3 + i, SENSORS + c] = _turning(declared[c], i, increments, dt, c_nb, lever)


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
                h[1, SENSORS + c] -= u[i] * _turning(declared[c], i, increments, dt, c_nb, ranges.lever_arm)


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
def _above_ground(nav, c_nb, grounds, z, h):
    """Height of an antenna above the filter's ground model [3]; returns the distance of the antenna beyond the
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
def _magnetic(nav, declared, c_nb, table, z, h):
    """Magnetic field along the body axes [5]. z (3,): of a zero measurement; h (3, n): zero at first.

    States of the kind MAGNETIC: with a signal, soft iron; else the axes 0 to 2 are hard iron, 3 to 5 the error of the
    field model and 6 to 8 the disturbance at the ground, NED.
    """
    soft = small_matrix(nav, 3, 3)
    field, along = small_vector(nav, 3), small_vector(nav, 3)
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
    height = nav[NAV_LLH + 2] - table.ground
    above = height > 0.0
    fade = exp_of_negative(where(above, height, 0.0) * (-1.0 / table.fades))
    for i in range(3):
        field[i] = table.earth[i] + 0.0 * fade
        along[i] = c_nb[0, i] * table.earth[0] + c_nb[1, i] * table.earth[1] + c_nb[2, i] * table.earth[2]
        z[i] = -along[i]
        for j in range(3):
            soft[i, j] = 0.0 * fade
    for c in range(declared.shape[0]):
        if declared[c].sensor == MAGNETIC:
            axis, signal, x = declared[c].axis, declared[c].signal, nav[NAV_SENSORS + c]
            if signal != CONSTANT:
                h[axis, SENSORS + c] = along[signal]
                z[axis] -= along[signal] * x
                soft[axis, signal] = x
            elif axis < 3:
                h[axis, SENSORS + c] = 1.0
                z[axis] -= x
            else:
                k, share = axis % 3, 0.0 * fade + 1.0
                if axis >= 6:
                    share = fade
                field[k] += share * x
                for i in range(3):
                    effect = c_nb[k, i] * share
                    h[i, SENSORS + c] = effect
                    z[i] -= effect * x
                    if axis >= 6:  # higher up there is less of it
                        h[i, R_D] += where(above, effect * x * (1.0 / table.fades), 0.0)
    # C_true' v = C' v + C' [v x] theta
    for i in range(3):
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            h[i, ATT + k] = c_nb[p, i] * field[q] - c_nb[q, i] * field[p]
            for j in range(3):
                h[i, ATT + k] += soft[i, j] * (c_nb[p, j] * table.earth[q] - c_nb[q, j] * table.earth[p])


@kernel
def _beacon(nav, declared, c_nb, table, row, z, h):
    """Two-way range to a beacon [6]; returns the distance, m.

    z (1,): of a zero measurement. h (1, n): zero at first.
    """
    arm, x, u = small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3)
    c_ne = small_matrix(nav, 3, 3)
    beacon = table.beacon[row]
    lever, position, axes = table.lever_arm, table.position[beacon], table.axes[beacon]
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
    llh_to_ecef(nav[NAV_LLH:NAV_VEL], x)
    ned_axes(nav[NAV_LLH], nav[NAV_LLH + 1], c_ne)
    for i in range(3):
        x[i] = position[i] - x[i]
    for i in range(3):
        arm[i] = c_nb[i, 0] * lever[0] + c_nb[i, 1] * lever[1] + c_nb[i, 2] * lever[2]
        u[i] = c_ne[i, 0] * x[0] + c_ne[i, 1] * x[1] + c_ne[i, 2] * x[2] - arm[i]
    distance = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for i in range(3):
        u[i] /= distance
    for i in range(3):
        x[i] = c_ne[0, i] * u[0] + c_ne[1, i] * u[1] + c_ne[2, i] * u[2]
    left = exp_of_negative(distance * (-1.0 / table.growth_distance))
    growth, moved = table.growth + 0.0 * distance, 0.0 * distance
    z[0] = -distance
    for c in range(declared.shape[0]):
        if declared[c].sensor == BEACON and declared[c].axis // BEACON_STATES == beacon:
            k, value = declared[c].axis % BEACON_STATES, nav[NAV_SENSORS + c]
            if k == 0:
                h[0, SENSORS + c] = 1.0
                z[0] -= value
            elif k == 1:
                h[0, SENSORS + c] = 1.0 - left
                growth += value
            else:
                h[0, SENSORS + c] = axes[k - 2, 0] * x[0] + axes[k - 2, 1] * x[1] + axes[k - 2, 2] * x[2]
                moved += h[0, SENSORS + c] * value
        elif declared[c].sensor == BEACON and declared[c].axis == BEACON_STATES * table.position.shape[0]:
            h[0, SENSORS + c] = 1.0  # the receiver's clock
            z[0] -= nav[NAV_SENSORS + c]
    # a longer way also has a larger bias
    steeper = 1.0 + growth * left * (1.0 / table.growth_distance)
    z[0] -= growth * (1.0 - left) + steeper * moved
    for c in range(declared.shape[0]):
        if declared[c].sensor == BEACON and declared[c].axis % BEACON_STATES > 1:
            h[0, SENSORS + c] *= steeper
        elif declared[c].sensor == PRODUCT:
            i, j = FIRST[declared[c].axis], SECOND[declared[c].axis]
            bent = (steeper / distance + (steeper - 1.0) * (1.0 / table.growth_distance)) * u[i] * u[j]
            h[0, SENSORS + c] = 0.5 * (steeper / distance - bent) if i == j else -bent
            z[0] -= h[0, SENSORS + c] * nav[NAV_SENSORS + c]
    for i in range(3):
        h[0, POS + i] = -steeper * u[i]
        # r_antenna = r + C l: a' (theta x l) = (l x a)' theta
        j, k = (i + 1) % 3, (i + 2) % 3
        h[0, ATT + i] = steeper * (arm[k] * u[j] - arm[j] * u[k])
    return distance


@kernel
def _station(kind, nav, declared, c_nb, table, z, h):
    """Angle from a plane through a ground station, or distance from it [7].

    z (1,): of a zero measurement. h (1, n): zero at first.
    """
    arm, x, u, a = small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 3)
    c_ne = small_matrix(nav, 3, 3)
    lever, position, axis = table.lever_arm, table.position, table.axis
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
    llh_to_ecef(nav[NAV_LLH:NAV_VEL], x)
    ned_axes(nav[NAV_LLH], nav[NAV_LLH + 1], c_ne)
    for i in range(3):
        x[i] -= position[i]
    for i in range(3):
        arm[i] = c_nb[i, 0] * lever[0] + c_nb[i, 1] * lever[1] + c_nb[i, 2] * lever[2]
        u[i] = c_ne[i, 0] * x[0] + c_ne[i, 1] * x[1] + c_ne[i, 2] * x[2] + arm[i]
        a[i] = c_ne[i, 0] * axis[0] + c_ne[i, 1] * axis[1] + c_ne[i, 2] * axis[2]
    distance = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for i in range(3):
        u[i] /= distance
    z[0] = -distance
    if kind != DISTANCE:
        sine = a[0] * u[0] + a[1] * u[1] + a[2] * u[2]
        cosine = math.sqrt(1.0 - sine * sine)
        z[0] = -atan2(sine, cosine)
        for i in range(3):
            u[i] = (a[i] - sine * u[i]) / (cosine * distance)
    for c in range(declared.shape[0]):
        if declared[c].sensor == kind:
            h[0, SENSORS + c] = 1.0
            z[0] -= nav[NAV_SENSORS + c]
    for i in range(3):
        h[0, POS + i] = u[i]
        # r_antenna = r + C l, as of a beacon
        j, k = (i + 1) % 3, (i + 2) % 3
        h[0, ATT + i] = arm[j] * u[k] - arm[k] * u[j]


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
def _observe_fix(fixes, row, nav, increments, dt, declared, c_nb, have, z, h, r):
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
def _observe_range(ranges, row, nav, increments, dt, declared, c_nb, have, z, h, r):
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


@kernel
def _observe_height_above_ground(grounds, row, nav, c_nb, have, z, h, r):
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
def _observe_pressure(pressures, row, nav, declared, have, z, h, r):
    measured, variance = as_simd(pressures.height), as_simd(pressures.variance)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    # late by the lag, it reads the earlier height: higher during the descent [3]
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
def _observe_altitude(altitudes, row, nav, have, z, h, r):
    measured, variance = as_simd(altitudes.height), as_simd(altitudes.variance)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    z[0] = where(there, nav[NAV_LLH + 2] - measured[row], 0.0)  # down, as the error of position
    h[0, R_D] = have[0]
    r[0, 0] = where(there, variance[row], 1.0)
    return 1


@kernel
def _observe_field(table, row, nav, declared, c_nb, have, z, h, r):
    seen = as_simd(table.field)
    _magnetic(nav, declared, c_nb, table, z, h)
    for a in range(3):
        there = no(math.isnan(seen[row, a]))
        have[a] = where(there, 1.0, 0.0)
        z[a] = where(there, z[a] + seen[row, a], 0.0)
        for c in range(h.shape[1]):
            h[a, c] *= have[a]
        for b in range(3):
            r[a, b] = 0.0
        r[a, a] = where(there, table.variance, 1.0)
    return 3


@kernel
def _observe_beacon(beacons, row, nav, declared, c_nb, have, z, h, r):
    measured = as_simd(beacons.range)
    distance = _beacon(nav, declared, c_nb, beacons, row, z, h)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    z[0] = where(there, z[0] + measured[row], 0.0)
    for c in range(h.shape[1]):
        h[0, c] *= have[0]
    # by the distance that the filter expects, which is not off by the noise
    further = beacons.rise * distance
    if beacons.weakened.shape[0] > 0:
        further *= beacons.weakened[row]
    r[0, 0] = where(there, beacons.sigma * beacons.sigma + further * further, 1.0)
    return 1


@kernel
def _observe_station(kind, stations, row, nav, declared, c_nb, have, z, h, r):
    measured = as_simd(stations.value)
    _station(kind, nav, declared, c_nb, stations, z, h)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    z[0] = where(there, z[0] + measured[row], 0.0)
    for c in range(h.shape[1]):
        h[0, c] *= have[0]
    r[0, 0] = where(there, stations.variance, 1.0)
    return 1


@kernel
def _heading(nav, declared, c_nb, axis, z, h):
    """Heading of an axis (3,) of the body [8]. z (1,): of a zero measurement; h (1, n): zero at first. Returns the
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
    """Velocity of a point along the axes of a vehicle [8]. z (3,): of a zero measurement; h (3, n): zero at first."""
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
                h[i, SENSORS + c] = _turning(declared[c], i, increments, dt, axes, lever)
        elif declared[c].sensor == VEHICLE_VELOCITY:
            p, q = (declared[c].axis + 1) % 3, (declared[c].axis + 2) % 3
            if declared[c].axis < 3:
                h[p, SENSORS + c], h[q, SENSORS + c] = plain[q], -plain[p]
            else:
                for i in range(3):
                    h[i, SENSORS + c] = axes[i, p] * rate[q] - axes[i, q] * rate[p]


@kernel
def _rest_rate(nav, declared, c_nb, z, h):
    """Reading of the gyros at rest: the Earth's rate and their biases [8]. z, h: as of `_vehicle_velocity`."""
    sin_lat, cos_lat = sincos_of_latitude(nav[NAV_LLH])
    for i in range(3):
        z[i] = -(c_nb[0, i] * RATE * cos_lat - c_nb[2, i] * RATE * sin_lat)
    for c in range(declared.shape[0]):
        if declared[c].sensor == GYROS and declared[c].signal == CONSTANT:
            z[declared[c].axis] -= nav[NAV_SENSORS + c]
            h[declared[c].axis, SENSORS + c] = 1.0


@kernel
def _observe_vehicle(kind, table, row, nav, increments, dt, declared, c_nb, have, z, h, r):
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


@kernel_inline
def observe(kind, row, measurements, nav, increments, dt, declared, c_nb, have, z, h, r):
    """Innovation, matrix and noise of a measurement; returns the number of its components. Raises ValueError for an
    unknown kind.

    - `kind`, `row`: as of `records.Events`; `nav`: navigation state.
    - `increments` (6,): compensated increments of the last interval, of `dt` s.
    - `declared`: sensor states of the filter; `c_nb` (3, 3): work space.
    - `have` (MOST,), out: 1 for valid components, else 0.
    - `z` (MOST,), out: innovation; `h` (MOST, n), out; `r` (MOST, MOST), out: noise. An invalid component has
      innovation 0
      and row 0, so it has no effect.
    """
    for a in range(MAX_MEASUREMENT_SIZE):
        have[a] = 0.0
        for c in range(h.shape[1]):
            h[a, c] = 0.0
    if kind in (FIX, MONITOR_ONLY_FIX):
        return _observe_fix(measurements.fixes, row, nav, increments, dt, declared, c_nb, have, z, h, r)
    if kind == RANGE:
        return _observe_range(measurements.ranges, row, nav, increments, dt, declared, c_nb, have, z, h, r)
    if kind == ABOVE_GROUND:
        return _observe_height_above_ground(measurements.grounds, row, nav, c_nb, have, z, h, r)
    if kind == PRESSURE:
        return _observe_pressure(measurements.pressures, row, nav, declared, have, z, h, r)
    if kind == ALTITUDE:
        return _observe_altitude(measurements.altitudes, row, nav, have, z, h, r)
    if kind == MAGNETIC:
        return _observe_field(measurements.magnetic, row, nav, declared, c_nb, have, z, h, r)
    if kind == BEACON:
        return _observe_beacon(measurements.beacons, row, nav, declared, c_nb, have, z, h, r)
    if kind == AZIMUTH:
        return _observe_station(kind, measurements.azimuths, row, nav, declared, c_nb, have, z, h, r)
    if kind == ELEVATION:
        return _observe_station(kind, measurements.elevations, row, nav, declared, c_nb, have, z, h, r)
    if kind == DISTANCE:
        return _observe_station(kind, measurements.distances, row, nav, declared, c_nb, have, z, h, r)
    if kind == HEADING:
        return _observe_vehicle(
            kind, measurements.headings, row, nav, increments, dt, declared, c_nb, have, z, h, r
        )  # fmt: skip
    if kind == VEHICLE_VELOCITY:
        return _observe_vehicle(
            kind, measurements.vehicle_velocities, row, nav, increments, dt, declared, c_nb, have, z, h, r
        )  # fmt: skip
    if kind == REST_RATE:
        return _observe_vehicle(
            kind, measurements.rest_rates, row, nav, increments, dt, declared, c_nb, have, z, h, r
        )  # fmt: skip
    raise ValueError("no measurement model is of this kind")
