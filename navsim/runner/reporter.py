"""How the work speaks to who asked for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navsim.runner.job import Progress


@dataclass(frozen=True)
class Reporter:
    """say: takes what is to be known. warn: takes warnings."""

    say: Callable[[str], None]
    warn: Callable[[str], None]


@dataclass(frozen=True)
class Listener:
    """Receiver of a job's messages."""

    speech: Reporter
    progress: Callable[[int, str], AbstractContextManager[Progress]]
    """Context for an extent and its unit, in which the job runs; it returns the progress callback."""
    ahead: Sequence[str] = ()
    """Modules to load during the first steps."""
