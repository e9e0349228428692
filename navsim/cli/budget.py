"""What a command will take, told and held against the machine before anything is made."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from navsim.cli.common import leave
from navsim.cli.ending import BAD_INPUT, say

if TYPE_CHECKING:
    from navsim.study.budget.estimate import Budget


def afford(
    name: object, estimate: Budget, kernels: str, target: Path, *, over_budget: bool, shown: bool, at_most: bool = False
) -> None:
    """Tell the estimate where it is to be shown; leave where the machine lacks memory or disk, unless `over_budget`.

    name: of the scenario or study. kernels: see `study.job.Job`. target: the result's path. at_most: the work may end
    earlier by itself, so the estimate alone refuses nothing.
    """
    from navsim.core import jit
    from navsim.study.budget.estimate import lacking, said
    from navsim.study.budget.machine import machine

    here = machine(target.parent)
    if shown:
        say(f"{name}: {'at most ' if at_most else ''}{said(estimate, here)}")
        if not jit.is_warm(kernels):
            say("compiling the kernels, once, takes up to a minute more")
    lack = lacking(estimate, here, _kept(target) if estimate.partial_bytes else 0.0)
    wanting = f"{name}: needs {', and '.join(lack)}"
    if not lack or (at_most and not shown):
        return
    if at_most:
        say(f"warning: {wanting}, where it does not end early")
    elif over_budget:
        say(f"warning: {wanting}")
    else:
        leave(BAD_INPUT, f"{wanting}; --over-budget computes it nevertheless")


def _kept(target: Path) -> float:
    """Size of the partial work that lies beside the target already, bytes."""
    from navsim.io.whole import partial_folder

    try:
        return float(sum(file.stat().st_size for file in partial_folder(target).iterdir()))
    except OSError:  # none there, or another process is at work in it: then all of it is still to come
        return 0.0
