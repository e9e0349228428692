"""One function that estimates, whatever the kind: filters go forward, smoothers know what comes later."""

from __future__ import annotations

import numpy as np

from navsim.core import states
from navsim.core.covariance import STRIDE
from navsim.estimation import filter_loop, records, smoother
from navsim.estimation.observations import Measurements
from navsim.estimation.records import OUTPUT, Events, FilterModel, History, ImuData, State, empty_history

FILTER_KINDS = {
    "eskf": records.ESKF,
    "left-invariant": records.LEFT_INVARIANT,
    "tfg": records.TFG,
    "rts": records.RTS,
    "map": records.MAP,
}
"""Kinds of estimator, by their names."""


def is_smoother(kind: int) -> bool:
    """Whether a kind answers with measurements that come after the answer."""
    return kind in records.SMOOTHERS


def estimate(imu: ImuData, measurements: Measurements, events: Events, state: State, model: FilterModel) -> History:
    """The history of a flight; arguments are those of `estimation.records`.

    state: where to start, overwritten by the final one. Outputs are those that the events name. Where a
    smoother loses the positive covariance of its flight they are nan, see `lost`. Raises ValueError for a kind that is
    none, for more states than there is room for, and for a smoother that is given events ahead.
    """
    outputs = int(events.row[events.kind == OUTPUT].max(initial=-1)) + 1
    history = empty_history(outputs, events.time.size, model.declared)
    if model.kind not in (*records.FILTERS, *records.SMOOTHERS):
        raise ValueError(f"no kind of estimator: {model.kind}")
    if states.SENSORS + model.declared.size > STRIDE:
        raise ValueError(f"a filter has at most {STRIDE} states")
    if not is_smoother(model.kind):
        filter_loop.run(imu, measurements, events, state, model, history)
        return history
    if events.ahead.any():
        raise ValueError("a smoother has nothing to run ahead of")
    smoother.run(imu, measurements, events, state, model, smoother.PASSES[model.kind], history)
    return history


def lost(history: History) -> bool:
    """Whether a smoother lost the positive covariance of its flight."""
    return bool(np.isnan(history.covariance).all())
