"""A history against a truth: the errors, and whether they are of the size that the filter believes.

NEES is judged in the coordinates in which the filter is Gaussian (`filter_loop.own_error`); smoothers in those of
`tfg`.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core.attitude import difference
from navsim.core.covariance import normalised_square
from navsim.core.earth import radii, short_way
from navsim.core.jit import kernel
from navsim.core.states import (
    A_N,
    ATT,
    NAV_HELD,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    POS,
    R_D,
    R_E,
    R_N,
    SENSORS,
    VEL,
)
from navsim.estimation.filter_loop import own_error
from navsim.estimation.records import FILTERS, SMOOTHERS, TFG, History, Judgement, Truth


@kernel
def plain_error(llh, vel, quat, sensors, nav, error):
    """The plain error (n,) of a navigation state: the given position, velocity, attitude, sensor states less its
    own."""
    height = nav[NAV_LLH + 2]
    meridian, transverse = radii(math.sin(nav[NAV_LLH]))
    error[R_N] = (llh[0] - nav[NAV_LLH]) * (meridian + height)
    error[R_E] = short_way(llh[1] - nav[NAV_LLH + 1]) * (transverse + height) * math.cos(nav[NAV_LLH])
    error[R_D] = height - llh[2]
    for i in range(3):
        error[VEL + i] = vel[i] - nav[NAV_VEL + i]
    for c in range(sensors.shape[0]):
        error[SENSORS + c] = sensors[c] - nav[NAV_SENSORS + c]
    difference(quat, nav[NAV_QUAT:NAV_HELD], error[A_N:SENSORS])


@kernel
def _judge(kind, navigation, covariance, truth, out):
    n = covariance.shape[1]
    factor, own, x = np.empty((n, n)), np.empty(n), np.empty(n)
    for o in range(navigation.shape[0]):
        nav, p, error = navigation[o], covariance[o], out.error[o]
        plain_error(truth.llh[o], truth.velocity[o], truth.quaternion[o], truth.sensors[o], nav, error)
        own_error(kind, nav, error, own)
        out.nees[o] = normalised_square(p, own, 0, n, factor, x)
        for group in range(n // 3):
            # position and velocity in plain coordinates, the rest in the filter's own
            judged = error if 3 * group < ATT else own
            out.nees_group[o, group] = normalised_square(p, judged, 3 * group, 3, factor, x)
        out.nees_position_velocity[o] = normalised_square(p, error, POS, ATT, factor, x)


def judge(kind: int, history: History, truth: Truth) -> Judgement:
    """What a history of an estimator of `kind` is worth, at all its outputs; a smoother's errors are those of `tfg`.

    Raises ValueError for a kind that is none of `records.FILTERS` or `records.SMOOTHERS`.
    """
    if kind not in (*FILTERS, *SMOOTHERS):
        raise ValueError(f"no kind of estimator: {kind}")
    o, n, _ = history.covariance.shape
    out = Judgement(np.empty((o, n)), np.empty(o), np.empty(o), np.empty((o, n // 3)))
    _judge(TFG if kind in SMOOTHERS else kind, history.navigation, history.covariance, truth, out)
    return out
