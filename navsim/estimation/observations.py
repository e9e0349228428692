"""What measurements say about the state: of each kind its innovation, its matrix and its noise.

    z = measured - predicted = H d + noise,  d the plain errors (dr, dv, theta, sensor states)

A new kind is a number (counted in `KIND_COUNT`), a table and a function here, with a line in `Measurements` and one in
`observe`.
Source: [1] Groves (2013), section 14.3 (loosely coupled update with lever arm, eqs. 14.102-14.108).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from navsim.core.attitude import dcm
from navsim.core.earth import RATE, radii, short_way
from navsim.core.elementary import sincos_of_latitude
from navsim.core.jit import kernel
from navsim.core.lanes import no, registers, select, small_vector
from navsim.core.states import (
    A_D,
    A_E,
    A_N,
    CONSTANT,
    GYROS,
    MOST,
    NAV_HELD,
    NAV_LLH,
    NAV_QUAT,
    NAV_VEL,
    POS,
    R_D,
    SENSORS,
    VEL,
)

FIX, ALTITUDE = 2, 3
"""Kinds of measurements, as kinds of events (`records.PASS` and `OUTPUT` come before them)."""
KIND_COUNT = 1 + max(FIX, ALTITUDE)
"""Room for them and those before."""


class FixTable(NamedTuple):
    """Fixes of a receiver's antenna, m of them: llh (m, 3) rad, rad, m, nan without a fix; velocity (m, 3) NED m/s, its
    components that are nan are not used; covariance (m, 6, 6) of both, NED; lever_arm (3,) IMU -> antenna, body, m,
    in all lanes."""

    llh: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray
    lever_arm: np.ndarray

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> FixTable:
        """The table with every array changed that differs between runs."""
        return FixTable(change(self.llh), change(self.velocity), change(self.covariance), self.lever_arm)


class AltitudeTable(NamedTuple):
    """Heights of the IMU above the ellipsoid, m of them: height (m,) m, nan where there is none; variance (m,) m2."""

    height: np.ndarray
    variance: np.ndarray

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> AltitudeTable:
        """The table with every array changed that differs between runs."""
        return AltitudeTable(change(self.height), change(self.variance))


class Measurements(NamedTuple):
    """The tables of all kinds of measurements, without rows where there are none."""

    fixes: FixTable
    altitudes: AltitudeTable

    @classmethod
    def of(cls, tables: Mapping[int, Any], *lanes: int) -> Measurements:
        """These tables, of one run or of so many lanes, by their kinds; of others there are no measurements. Raises
        KeyError for a kind that is none."""
        unknown = tables.keys() - {FIX, ALTITUDE}
        if unknown:
            raise KeyError(f"no measurements are of the kind {unknown.pop()}")

        def none(*shape: int) -> np.ndarray:
            return np.empty((0, *shape, *lanes))

        return cls(
            tables.get(FIX, FixTable(none(3), none(3), none(6, 6), np.zeros(3))),
            tables.get(ALTITUDE, AltitudeTable(none(), none())),
        )

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Measurements:
        """The tables with every array changed that differs between runs."""
        return Measurements(self.fixes.each(change), self.altitudes.each(change))


@kernel
def _across(arm, h, first):
    """-[arm x] into the attitude columns of the rows first .. first + 2: what turning does to an arm in NED."""
    h[first, A_E], h[first, A_D] = arm[2], -arm[1]
    h[first + 1, A_N], h[first + 1, A_D] = -arm[2], arm[0]
    h[first + 2, A_N], h[first + 2, A_E] = arm[1], -arm[0]


@kernel
def _fix(nav, increments, dt, declared, c_nb, lever, llh, vel, z, h):
    """Position and velocity of the antenna [1]; z (6,) nan where vel is, h (6, n) zero at first."""
    dcm(nav[NAV_QUAT:NAV_HELD], c_nb)
    lat, height = nav[NAV_LLH], nav[NAV_LLH + 2]
    sin_lat, cos_lat = sincos_of_latitude(lat)
    meridian, transverse = radii(sin_lat)
    arm, rate = small_vector(nav, 3), small_vector(nav, 3)
    for i in range(3):
        arm[i] = c_nb[i, 0] * lever[0] + c_nb[i, 1] * lever[1] + c_nb[i, 2] * lever[2]
        h[i, POS + i] = 1.0
    z[0] = (llh[0] - lat) * (meridian + height) - arm[0]
    z[1] = short_way(llh[1] - nav[NAV_LLH + 1]) * (transverse + height) * cos_lat - arm[1]
    z[2] = height - llh[2] - arm[2]
    # r_antenna = r + C l: d = -[C l x] theta
    _across(arm, h, 0)
    # v_antenna = v + C (omega_eb x l), omega_eb = omega_ib - C' omega_ie
    for i in range(3):
        rate[i] = increments[i] / dt - (c_nb[0, i] * RATE * cos_lat - c_nb[2, i] * RATE * sin_lat)
    bx = rate[1] * lever[2] - rate[2] * lever[1]
    by = rate[2] * lever[0] - rate[0] * lever[2]
    bz = rate[0] * lever[1] - rate[1] * lever[0]
    for i in range(3):
        arm[i] = c_nb[i, 0] * bx + c_nb[i, 1] * by + c_nb[i, 2] * bz
        z[3 + i] = vel[i] - nav[NAV_VEL + i] - arm[i]
        h[3 + i, VEL + i] = 1.0
    _across(arm, h, 3)
    # omega_true = omega_measured - error: d = C [l x] error
    for c in range(declared.shape[0]):
        if declared[c].triad == GYROS:
            b, d = (declared[c].axis + 1) % 3, (declared[c].axis + 2) % 3
            for i in range(3):
                turning = c_nb[i, b] * lever[d] - c_nb[i, d] * lever[b]
                if declared[c].signal != CONSTANT:
                    turning *= increments[declared[c].signal] / dt
                h[3 + i, SENSORS + c] = turning


@kernel
def observe(kind, row, measurements, nav, increments, dt, declared, c_nb, have, z, h, r):
    """What a measurement says: returns how many numbers its kind has.

    kind, row: as of `records.Events`. nav: navigation state; increments (6,): the compensated ones of the last
    interval, of dt s. declared: the filter's sensor states. c_nb (3, 3): work space. Out: have (MOST,) 1 for the
    numbers that are there, else 0; z (MOST,) innovation, h (MOST, n), r (MOST, MOST) noise. One that is not there has
    the innovation 0 and the row 0, and nothing is weighed by it.
    """
    for a in range(MOST):
        have[a] = 0.0
        for c in range(h.shape[1]):
            h[a, c] = 0.0
    if kind == FIX:
        fixes = measurements.fixes
        llh, velocity, covariance = registers(fixes.llh), registers(fixes.velocity), registers(fixes.covariance)
        _fix(nav, increments, dt, declared, c_nb, fixes.lever_arm, llh[row], velocity[row], z, h)
        fixed = no(math.isnan(llh[row, 0]))
        for a in range(MOST):
            there = fixed & no(math.isnan(z[a]))
            have[a] = select(there, 1.0, 0.0)
            z[a] = select(there, z[a], 0.0)
            for c in range(h.shape[1]):
                h[a, c] *= have[a]
            for b in range(a):
                both = have[a] * have[b] > 0.0
                r[a, b] = select(both, covariance[row, a, b], 0.0)
                r[b, a] = r[a, b]
            r[a, a] = select(there, covariance[row, a, a], 1.0)
        return MOST
    altitudes = measurements.altitudes
    measured, variance = registers(altitudes.height), registers(altitudes.variance)
    there = no(math.isnan(measured[row]))
    have[0] = select(there, 1.0, 0.0)
    z[0] = select(there, nav[NAV_LLH + 2] - measured[row], 0.0)  # down, as the error of position
    h[0, R_D] = have[0]
    r[0, 0] = select(there, variance[row], 1.0)
    return 1
