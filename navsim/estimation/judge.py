"""A history against a truth: the errors, and whether they are of the size that the filter believes.

NEES is judged in the coordinates in which the filter is Gaussian (`filter_loop.own_error`); smoothers in those of
`tfg`.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
"""

from __future__ import annotations

import numpy as np

from navsim.core.covariance import normalised_square
from navsim.core.jit import kernel
from navsim.core.lanes import in_lanes, registers, room
from navsim.core.states import ATT, POS
from navsim.estimation.error_state import plain_error
from navsim.estimation.filter_loop import CHARTS, own_error
from navsim.estimation.records import FILTERS, SMOOTHERS, TFG, History, Judgement, Truth, lanes_of


@kernel
def _judge(chart, navigation, covariance, truth, out):
    navigation, covariance, sensors = registers(navigation), registers(covariance), registers(truth.sensors)
    errors, nees, nees_group = registers(out.error), registers(out.nees), registers(out.nees_group)
    nees_position_velocity = registers(out.nees_position_velocity)
    n = covariance.shape[1]
    factor, own, x = room(navigation, (n, n)), room(navigation, (n,)), room(navigation, (n,))
    for o in range(navigation.shape[0]):
        nav, p, error = navigation[o], covariance[o], errors[o]
        plain_error(truth.llh[o], truth.velocity[o], truth.quaternion[o], sensors[o], nav, error)
        own_error(chart, nav, error, own)
        nees[o] = normalised_square(p, own, 0, n, factor, x)
        for group in range(n // 3):
            # position and velocity in plain coordinates, the rest in the filter's own
            if 3 * group < ATT:
                nees_group[o, group] = normalised_square(p, error, 3 * group, 3, factor, x)
            else:
                nees_group[o, group] = normalised_square(p, own, 3 * group, 3, factor, x)
        nees_position_velocity[o] = normalised_square(p, error, POS, ATT, factor, x)


def empty_judgement(outputs: int, states: int, *lanes: int) -> Judgement:
    """Room for a judgement, of one run or of so many lanes."""
    o, n = outputs, states
    return Judgement(
        np.empty((o, n, *lanes)), np.empty((o, *lanes)), np.empty((o, *lanes)), np.empty((o, n // 3, *lanes))
    )


def judge(kind: int, history: History, truth: Truth, out: Judgement | None = None) -> Judgement:
    """What a history of an estimator of `kind` is worth, at all its outputs; a smoother's errors are those of `tfg`.

    history: of one run, or of lanes; truth: of them all, but for its sensors (o, k, W). out: where it goes, if it has a
    place already. Raises ValueError for a kind that is none of `records.FILTERS` or `records.SMOOTHERS`.
    """
    if kind not in (*FILTERS, *SMOOTHERS):
        raise ValueError(f"no kind of estimator: {kind}")
    o, n, _, *lanes = history.covariance.shape
    out = out or empty_judgement(o, n, *lanes)
    own = CHARTS[TFG if kind in SMOOTHERS else kind]
    if lanes:
        sensors = truth._replace(sensors=in_lanes(truth.sensors))
        _judge(own, in_lanes(history.navigation), in_lanes(history.covariance), sensors, lanes_of(out))
    else:
        _judge(own, history.navigation, history.covariance, truth, out)
    return out
