"""Report the resources of a job, and compare them with the machine before the job starts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.runner.errors import BadInput, as_problems
from navsim.runner.reporter import Reporter

if TYPE_CHECKING:
    from navsim.runner.estimate import Budget


@dataclass(frozen=True)
class Request:
    """Options of an estimate."""

    name: object
    """Name of the scenario or study."""
    target: Path
    """Path of the result."""
    over_budget: bool
    """Warn of missing resources instead of stopping."""
    at_most: bool = False
    """The work may end earlier, so the estimate alone stops nothing."""
    away: str = ""
    """Name of remote workers, "" for this machine's."""


def tell(asked: Request, estimate: Budget, speech: Reporter, seconds: float | None = None) -> None:
    """Report the estimate. seconds: total time, from a timed block."""
    from navsim.runner.estimate import estimate_text
    from navsim.runner.machine import machine

    words = estimate_text(estimate, machine(asked.target.parent), asked.away, seconds)
    speech.say(f"{asked.name}: {'at most ' if asked.at_most else ''}{words}")


def check_resources(asked: Request, estimate: Budget, speech: Reporter, shown: bool = False) -> None:
    """Raise BadInput if the machine lacks memory or disk, unless a warning is requested.

    shown: report the estimate, and also missing resources of work that may end earlier.
    """
    from navsim.runner.estimate import lacking
    from navsim.runner.machine import machine

    here = machine(asked.target.parent)
    lack = lacking(estimate, here, _kept(asked.target) if estimate.partial_bytes else 0.0)
    if not lack or (asked.at_most and not shown):
        return
    wanting = f"{asked.name}: needs {', and '.join(lack)}"
    if asked.at_most:
        speech.warn(f"{wanting}. It may need less if it ends early")
    elif asked.over_budget:
        speech.warn(wanting)
    else:
        if shown:
            tell(asked, estimate, speech)
        raise BadInput(as_problems(f"{wanting}; --over-budget computes it nevertheless"))


def _kept(target: Path) -> float:
    """Size of existing partial work beside the target, bytes."""
    from navsim.results.atomic_write import partial_folder

    try:
        return float(sum(file.stat().st_size for file in partial_folder(target).iterdir()))
    except OSError:  # none there, or another process is at work in it: then all of it is still to come
        return 0.0
