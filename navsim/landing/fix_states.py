"""States of the fixes of runs, as `/summary/fix_states`."""

from __future__ import annotations

import numpy as np

from navsim.gnss.fix_states import FIXED, STATES, WRONG
from navsim.landing.case import Case
from navsim.results.builder import ResultBuilder
from navsim.runner.batches import Ensemble
from navsim.runner.checkpoint import Arrays
from navsim.runner.statistics import mean_interval
from navsim.simulation.run import Run


def of_runs(runs: Run) -> Arrays:
    """Shares of the states of each of several runs, and of wrong ones among those flagged as fixed; empty without."""
    if not runs.fix_state.shape[1]:
        return {}
    shares = [(runs.fix_state == number).mean(axis=1) for number in range(len(STATES))]
    flagged = runs.fix_flag == FIXED
    wrong = (flagged & (runs.fix_state == WRONG)).sum(axis=1)
    return {"fix_shares": np.stack(shares, axis=1), "fix_wrong": np.stack([wrong, flagged.sum(axis=1)], axis=1)}


def put_fix_states(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write the shares of the states, and the stationary ones; nothing without states."""
    model, branch = case.shared.fix_states, "/summary/fix_states"
    if model is None:
        return
    shares, (wrong, flagged) = ensemble.per_run("fix_shares"), ensemble.per_run("fix_wrong").sum(axis=0)
    draft[f"{branch}/state"] = np.array(STATES, dtype=object)
    draft[f"{branch}/share"] = np.stack([mean_interval(column) for column in shares.T])
    draft[f"{branch}/stationary"] = model.shares
    draft[f"{branch}/rms_horizontal"], draft[f"{branch}/rms_vertical"] = model.sigma.T[:2]
    draft[f"{branch}/wrong_share"] = float(wrong / flagged) if flagged else np.nan
