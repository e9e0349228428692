"""Measurement model of a magnetometer.

Source: [1] `docs/theory/magnetometer.md`.
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import exp_of_negative
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import as_simd, no, small_matrix, small_vector, where
from navsim.filter.measurement_kinds import MAGNETIC
from navsim.filter.states import ATT, CONSTANT, NAV_BIAS_FRAME, NAV_LLH, NAV_QUAT, NAV_SENSORS, R_D, SENSORS
from navsim.geodesy.attitude_kernels import dcm


@kernel
def hard_iron(declared):
    """First error state of a magnetometer's hard iron, a vector in body axes; 0 if no state is."""
    first = 0
    for c in range(declared.shape[0] - 1, -1, -1):
        if declared[c].sensor == MAGNETIC and declared[c].signal == CONSTANT and declared[c].axis == 0:
            first = SENSORS + c
    return first


@kernel
def _magnetic(nav, declared, c_nb, table, z, h):
    """Magnetic field along the body axes [1]. z (3,): of a zero measurement; h (3, n): zero at first.

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
def observe_field(table, row, nav, declared, c_nb, have, z, h, r):
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
