"""A history against a truth."""

from __future__ import annotations

from navsim.compiler.lanes import in_lanes
from navsim.filter.error_parametrisation import CHARTS, chart_of
from navsim.filter.history import evaluate_outputs
from navsim.filter.records import (
    FILTERS,
    SMOOTHERS,
    TFG,
    ErrorHistory,
    FilterModel,
    History,
    OutputErrors,
    Truth,
    empty_error_history,
)


def evaluate(model: FilterModel, history: History, truth: Truth, single: int = 0) -> OutputErrors:
    """Errors and NEES of a history at all its outputs; a smoother's errors are those of `tfg`.

    history, truth: of one run, or of lanes; single: as of `empty_error_history`. Raises ValueError for a kind outside
    `records.FILTERS` and `records.SMOOTHERS`.
    """
    _, n, _, *lanes = history.covariance.shape
    errors = empty_error_history(truth, n, 0, *lanes, single=single)
    evaluate_into(model, history, errors)
    return errors.errors


def evaluate_into(model: FilterModel, history: History, errors: ErrorHistory) -> None:
    """`evaluate` into the outputs of an error history. Raises ValueError also for a different number of outputs."""
    if errors.sigma.shape[0] != history.navigation.shape[0]:
        raise ValueError("the truth has not the outputs of the history")
    if model.kind not in (*FILTERS, *SMOOTHERS):
        raise ValueError(f"no kind of estimator: {model.kind}")
    chart = CHARTS[TFG] if model.kind in SMOOTHERS else chart_of(model)
    navigation, covariance = history.navigation, history.covariance
    if covariance.ndim == 3:
        evaluate_outputs(chart, navigation, covariance, errors)
    else:
        evaluate_outputs(chart, in_lanes(navigation), in_lanes(covariance), errors.each(in_lanes))
