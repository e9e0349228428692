"""Estimators of all kinds: filters run forward, smoothers also use later measurements.

W runs are processed at once, one in each SIMD lane (`compiler.lanes`). A single run through a filter is a batch of
equal runs. A smoother stores the whole flight and therefore uses plain numbers: the same kernels, the same bits. If the
truth is known, runs produce an error history (`run_filter`), otherwise a history. Histories of filters are produced in
pieces, since those of all lanes would need much memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.filter import filter_loop, gaussian_sum, records, smoother
from navsim.filter.error_parametrisation import chart_of
from navsim.filter.evaluation import evaluate_into
from navsim.filter.measurement_kinds import FIX, RANGE, SOURCE, Measurements
from navsim.filter.records import (
    OUTPUT,
    TIME_TOLERANCE,
    ErrorHistory,
    Events,
    FilterModel,
    History,
    ImuData,
    State,
    StreamCursor,
    Truth,
    empty_error_history,
    empty_history,
    lanes_of,
)

FILTER_KINDS = {
    "eskf": records.ESKF,
    "first-estimates": records.FIRST_ESTIMATES,
    "observability-constrained": records.OBSERVABILITY_CONSTRAINED,
    "left-invariant": records.LEFT_INVARIANT,
    "tfg": records.TFG,
    "gaussian-sum": records.GAUSSIAN_SUM,
    "rts": records.RTS,
    "map": records.MAP,
}
"""Kinds of estimator, by their names."""

_PIECE = 64
"""Outputs of a piece of a history: covariances of 15 states in 8 lanes are 0.9 MB of it."""


def is_smoother(kind: int) -> bool:
    """Whether a kind answers with measurements that come after the answer."""
    return kind in records.SMOOTHERS


def _pieces(events: Events, most: int | None) -> Iterator[slice]:
    """Slices of the events, each with some outputs or `most` events; a copy of the filter that runs ahead stays within
    one."""
    ends = np.flatnonzero(events.kind == OUTPUT)[_PIECE - 1 :: _PIECE] + 1
    if most is not None:
        ends = np.union1d(ends, np.arange(most, events.time.size, most))
    first = 0
    for last in [*ends.tolist(), events.time.size]:
        while last < events.time.size and events.ahead[last]:
            last += 1
        if last > first:
            yield slice(first, last)
            first = last


def run_filter(
    imu: ImuData, measurements: Measurements, events: Events, state: State, model: FilterModel, errors: ErrorHistory
) -> None:
    """Run an estimator through the events of a flight against the truth, W runs at once.

    - `imu`, `measurements`, `state`, `errors`: records in lanes (`filter.records`).
    - `events`, `model`: of all runs; outputs come in the order of their rows.
    - `state` is overwritten by the final one; `errors` is filled in.

    Raises ValueError for an unknown kind, for a smoother with events ahead, for a state without room for the components
    of a sum, and for an error history whose rows do not match the events.
    """
    if errors.sigma.shape[0] != _outputs(events) or errors.status.shape[0] != events.time.size:
        raise ValueError("the error history does not have the rows of the events")
    _check_correlated(measurements, events, model)
    if is_smoother(model.kind):
        for _, _, history in fly_in_pieces(imu, measurements, events, state, model):
            evaluate_into(model, history, errors)
            for name in ("innovation_squared", "degrees", "status"):
                getattr(errors, name)[...] = getattr(history, name)
        return
    _engine(model, state).run(
        chart_of(model), ImuData(imu.time, in_lanes(imu.dtheta), in_lanes(imu.dv)), measurements.each(in_lanes),
        events, lanes_of(state), _start_cursor(state.navigation.shape[-1]).each(in_lanes), model,
        lanes_of(errors.of_events()), errors.each(in_lanes),
    )  # fmt: skip


def _check_correlated(measurements: Measurements, events: Events, model: FilterModel) -> None:
    """Raise ValueError for a table of fixes or ranges without the effect of time-correlated errors that the filter
    estimates.

    Kernels would read beyond the table.
    """
    axes, rows = model.declared["axis"][model.declared["sensor"] == FIX], events.row[events.kind == FIX]
    table = measurements.fixes.correlated
    if axes.size and rows.size and (table.shape[2] <= axes.max() or table.shape[0] <= rows.max()):
        raise ValueError("the table of fixes does not say what the errors do to them that the filter follows")
    rows, effects = events.row[events.kind == RANGE], measurements.ranges.correlated
    axes = model.declared["axis"][model.declared["sensor"] == SOURCE]
    for kind, own in ((FIX, measurements.fixes.transmitters), (RANGE, measurements.ranges.transmitters)):
        used = events.row[events.kind == kind]
        if axes.size and used.size and (own.shape[2] <= axes.max() or own.shape[0] <= used.max()):
            raise ValueError("the table does not say what the errors of transmitters that the filter follows do")
    followed = bool((model.declared["sensor"] == RANGE).any())
    if followed and rows.size and (effects.shape[1] == 0 or effects.shape[0] <= rows.max()):
        raise ValueError("the table of ranges does not say what the errors do to them that the filter follows")


def _engine(model: FilterModel, state: State) -> Any:
    """The module whose kernel flies a filter. Raises ValueError as of `run_filter`."""
    if model.kind not in records.FILTERS:
        raise ValueError(f"no kind of estimator: {model.kind}")
    if model.kind != records.GAUSSIAN_SUM:
        return filter_loop
    if state.components.weight.shape[0] != max(1, model.components):
        raise ValueError(f"room for {state.components.weight.shape[0]} components, not for {model.components}")
    return gaussian_sum


def _start_cursor(lanes: int) -> StreamCursor:
    """`StreamCursor` of a filter that has not started."""
    return StreamCursor(np.array([-1.0, 0.0, 0.0]), np.zeros((6, lanes)))


def fly_in_pieces(
    imu: ImuData, measurements: Measurements, events: Events, state: State, model: FilterModel, most: int | None = None
) -> Iterator[tuple[slice, slice, History]]:
    """Run an estimator without a truth; yields pieces of the history, of `most` events if given.

    imu: of lanes, or of one run, the same for all; other arguments as of `run_filter`. Each piece has its events, its
    outputs, and their history, which the next piece overwrites. A smoother yields one piece.
    """
    lanes = state.navigation.shape[-1]
    _check_correlated(measurements, events, model)
    if is_smoother(model.kind):
        _check_smoother(events)
        outputs = _outputs(events)
        history = empty_history(outputs, events.time.size, model.states, lanes)
        whole = (m if m.ndim == 3 else in_all_lanes(m, lanes) for m in (imu.dtheta, imu.dv))
        smoother.run(
            ImuData(imu.time, *(in_lanes(m) for m in whole)), measurements.each(in_lanes), events, lanes_of(state),
            model, smoother.PASSES[model.kind], lanes_of(history),
        )  # fmt: skip
        yield slice(0, events.time.size), slice(0, outputs), history
        return
    engine, stream = _engine(model, state), _start_cursor(lanes)
    kernels_way = stream.each(in_lanes)
    tables, kernels_state = measurements.each(in_lanes), lanes_of(state)
    parts = list(_pieces(events, most))
    is_output = events.kind == OUTPUT
    answers = [int(is_output[part].sum()) for part in parts]
    longest = max((part.stop - part.start for part in parts), default=0)
    history = empty_history(max(answers, default=0), longest, model.states, lanes)
    kernels_history = lanes_of(history)
    no_errors = empty_error_history(Truth.none(lanes), model.states, 0, lanes).each(in_lanes)
    flown = [in_lanes(m) if m.ndim == 3 else None for m in (imu.dtheta, imu.dv)]
    output = 0
    for part, outputs in zip(parts, answers, strict=True):
        # the intervals of the IMU that the piece may touch
        first = max(0, int(stream.cursor[0]))
        last = int(np.searchsorted(imu.time, events.time[part].max() + TIME_TOLERANCE)) + 1
        sensed = (
            in_lanes(in_all_lanes(m[first:last], lanes)) if of_lanes is None else of_lanes[first:last]
            for m, of_lanes in zip((imu.dtheta, imu.dv), flown, strict=True)
        )
        noise = model.noise if model.noise.shape[0] == 1 else model.noise[first:last]
        row = events.row[part] - is_output[part] * output
        stream.cursor[0] -= first
        engine.run(
            chart_of(model),
            ImuData(imu.time[first : last + 1], *sensed),
            tables,
            Events(events.time[part], events.kind[part], row, events.ahead[part]),
            kernels_state,
            kernels_way,
            model._replace(noise=noise),
            kernels_history,
            no_errors,
        )
        stream.cursor[0] += first
        count = part.stop - part.start
        yield (
            part,
            slice(output, output + outputs),
            History(*(m[:outputs] for m in history[:2]), *(m[:count] for m in history[2:])),
        )
        output += outputs


def _each(record: Any, change: Callable[[np.ndarray], np.ndarray]) -> Any:
    """A record of arrays, and of such records, with every array changed."""
    return type(record)(*(_each(m, change) if isinstance(m, tuple) else change(m) for m in record))


def _arrays(record: Any) -> Iterator[np.ndarray]:
    """The arrays of a record, and of those in it."""
    for member in record:
        yield from _arrays(member) if isinstance(member, tuple) else (member,)


def in_all_lanes(array: np.ndarray, lanes: int = WIDTH) -> np.ndarray:
    """Copy the array of one run to every lane (..., W)."""
    return np.repeat(array[..., None], lanes, axis=-1)


def estimate(
    imu: ImuData,
    measurements: Measurements,
    events: Events,
    state: State,
    model: FilterModel,
    stop: Callable[[History], bool] | None = None,
) -> History:
    """History of one run; arguments are those of `filter.records`.

    - `state`: initial state, overwritten by the final one.
    - `stop`: whether a filter ends after a piece of its flight. It gets the history so far, in which later events are
      unused and later outputs are not set.

    Outputs are those of the events. If a smoother's covariance loses positive definiteness they are nan, see `lost`.
    Raises ValueError for an unknown kind, and for a smoother with events ahead.
    """
    history = empty_history(_outputs(events), events.time.size, model.states)
    if is_smoother(model.kind):
        # a smoother stores its whole flight: eight times the memory for one output would be too much
        _check_smoother(events)
        smoother.run(imu, measurements, events, state, model, smoother.PASSES[model.kind], history)
        return _counted(history)
    flown = _each(state, in_all_lanes)
    most = None if stop is None else _PIECE
    for which, rows, piece in fly_in_pieces(imu, measurements.each(in_all_lanes), events, flown, model, most):
        for name in ("navigation", "covariance"):
            getattr(history, name)[rows] = getattr(piece, name)[..., 0]
        for name in ("innovation", "innovation_sigma", "innovation_squared", "degrees", "status"):
            getattr(history, name)[which] = getattr(piece, name)[..., 0]
        if stop is not None and stop(history):
            break
    for mine, final in zip(_arrays(state), _arrays(flown), strict=True):
        mine[...] = final[..., 0]
    return _counted(history)


def _counted(history: History) -> History:
    """The history with integer arrays for its integers."""
    whole = {name: getattr(history, name).astype(np.int64) for name in ("degrees", "status")}
    return history._replace(**whole)


def _outputs(events: Events) -> int:
    """Number of outputs that events name."""
    return int(events.row[events.kind == OUTPUT].max(initial=-1)) + 1


def _check_smoother(events: Events) -> None:
    """Raises ValueError for events that a smoother cannot take."""
    if events.ahead.any():
        raise ValueError("a smoother has nothing to run ahead of")


def lost(history: History) -> bool:
    """Whether a smoother lost the positive covariance of its flight."""
    return bool(np.isnan(history.covariance).all())
