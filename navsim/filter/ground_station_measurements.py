"""Measurement models of ranging beacons, and of the stations of ILS, MLS and DME.

Sources: [1] `docs/theory/beacons.md`, [2] `docs/theory/ground-stations.md`.
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import atan2, exp_of_negative
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import as_simd, no, small_matrix, small_vector, where
from navsim.filter.error_products import FIRST, SECOND
from navsim.filter.measurement_kinds import BEACON, BEACON_STATES, DISTANCE, PRODUCT
from navsim.filter.states import ATT, NAV_BIAS_FRAME, NAV_LLH, NAV_QUAT, NAV_SENSORS, NAV_VEL, POS, SENSORS
from navsim.geodesy.attitude_kernels import dcm
from navsim.geodesy.earth_kernels import llh_to_ecef, ned_axes


@kernel
def _unit_delay(nav, table, beacon, distance):
    """Delay by the air of one N-unit at the runway on the way to a beacon, m: the path's mean by Simpson's rule [1]."""
    start, end = (nav[NAV_LLH + 2] - table.ground) * (1.0 / table.air_height), table.rise_to[beacon]
    ends = exp_of_negative(-start) + exp_of_negative(-end + 0.0 * start)
    return 1e-6 / 6.0 * distance * (ends + 4.0 * exp_of_negative(-0.5 * (start + end)))


@kernel
def _beacon(nav, declared, c_nb, table, row, z, h):
    """Two-way range to a beacon [1]; returns the distance, m.

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
    transmitter = BEACON_STATES * table.position.shape[0] + 3 + 2 * beacon
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
        elif declared[c].sensor == BEACON and declared[c].axis == BEACON_STATES * table.position.shape[0] + 2:
            h[0, SENSORS + c] = _unit_delay(nav, table, beacon, distance)
            z[0] -= h[0, SENSORS + c] * nav[NAV_SENSORS + c]
        elif declared[c].sensor == BEACON and declared[c].axis == transmitter:
            h[0, SENSORS + c] = -1.0  # the beacon's own clock: one that is ahead makes its range shorter
            z[0] += nav[NAV_SENSORS + c]
    # a longer way also has a larger bias
    steeper = 1.0 + growth * left * (1.0 / table.growth_distance)
    z[0] -= growth * (1.0 - left) + steeper * moved
    for c in range(declared.shape[0]):
        if declared[c].sensor == BEACON and declared[c].axis % BEACON_STATES > 1:
            if declared[c].axis < BEACON_STATES * table.position.shape[0]:
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
    """Angle from a plane through a ground station, or distance from it [2].

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
def observe_beacon(beacons, row, nav, declared, c_nb, have, z, h, r):
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
def observe_station(kind, stations, row, nav, declared, c_nb, have, z, h, r):
    measured = as_simd(stations.value)
    _station(kind, nav, declared, c_nb, stations, z, h)
    there = no(math.isnan(measured[row]))
    have[0] = where(there, 1.0, 0.0)
    z[0] = where(there, z[0] + measured[row], 0.0)
    for c in range(h.shape[1]):
        h[0, c] *= have[0]
    r[0, 0] = where(there, stations.variance, 1.0)
    return 1
