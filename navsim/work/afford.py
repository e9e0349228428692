"""What work will take, told and held against the machine before anything is made."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.words import switch
from navsim.work.errors import BadInput, said
from navsim.work.speech import Speech

if TYPE_CHECKING:
    from navsim.study.budget.estimate import Budget


@dataclass(frozen=True)
class Request:
    """What is asked of an estimate. name: of the scenario or study. target: the result's path. over_budget: what is
    lacking is warned of. shown: the estimate is told. at_most: the work may end earlier by itself, so the estimate
    alone refuses nothing. away: workers of another place that do the work, in words, "" for this machine's."""

    name: object
    target: Path
    over_budget: bool
    shown: bool = False
    at_most: bool = False
    away: str = ""


def afford(asked: Request, estimate: Budget, kernels: str, speech: Speech) -> None:
    """Tell the estimate where it is to be shown; raise BadInput where the machine lacks memory or disk, unless they are
    to be warned of. kernels: see `study.job.Job`."""
    from navsim.core import jit
    from navsim.study.budget.estimate import lacking
    from navsim.study.budget.estimate import said as estimated
    from navsim.study.budget.machine import machine

    name, target, at_most = asked.name, asked.target, asked.at_most
    here = machine(target.parent)
    if asked.shown:
        speech.say(f"{name}: {'at most ' if at_most else ''}{estimated(estimate, here, asked.away)}")
        if not jit.is_warm(kernels):
            speech.say("compiling the kernels, once, takes up to a minute more")
    lack = lacking(estimate, here, _kept(target) if estimate.partial_bytes else 0.0)
    wanting = f"{name}: needs {', and '.join(lack)}"
    if not lack or (at_most and not asked.shown):
        return
    if at_most:
        speech.warn(f"{wanting}, where it does not end early")
    elif asked.over_budget:
        speech.warn(f"{wanting}")
    else:
        raise BadInput(said(f"{wanting}; {switch('over_budget')} computes it nevertheless"))


def _kept(target: Path) -> float:
    """Size of the partial work that lies beside the target already, bytes."""
    from navsim.io.whole import partial_folder

    try:
        return float(sum(file.stat().st_size for file in partial_folder(target).iterdir()))
    except OSError:  # none there, or another process is at work in it: then all of it is still to come
        return 0.0
