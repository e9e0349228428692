"""A history against a truth."""

from __future__ import annotations

from navsim.compiler.lanes import in_lanes
from navsim.filter.error_parametrisation import CHARTS, chart_of
from navsim.filter.history import judge_all
from navsim.filter.records import (
    FILTERS,
    SMOOTHERS,
    TFG,
    Account,
    FilterModel,
    History,
    Judgement,
    Truth,
    empty_account,
)


def judge(model: FilterModel, history: History, truth: Truth, single: int = 0) -> Judgement:
    """Errors and NEES of a history at all its outputs; a smoother's errors are those of `tfg`.

    history, truth: of one run, or of lanes; single: as of `empty_account`. Raises ValueError for a kind outside
    `records.FILTERS` and `records.SMOOTHERS`.
    """
    _, n, _, *lanes = history.covariance.shape
    account = empty_account(truth, n, 0, *lanes, single=single)
    judge_into(model, history, account)
    return account.judgement


def judge_into(model: FilterModel, history: History, account: Account) -> None:
    """`judge` into the outputs of an account. Raises ValueError also for a different number of outputs."""
    if account.sigma.shape[0] != history.navigation.shape[0]:
        raise ValueError("the truth has not the outputs of the history")
    if model.kind not in (*FILTERS, *SMOOTHERS):
        raise ValueError(f"no kind of estimator: {model.kind}")
    chart = CHARTS[TFG] if model.kind in SMOOTHERS else chart_of(model)
    navigation, covariance = history.navigation, history.covariance
    if covariance.ndim == 3:
        judge_all(chart, navigation, covariance, account)
    else:
        judge_all(chart, in_lanes(navigation), in_lanes(covariance), account.each(in_lanes))
