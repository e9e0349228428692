"""Interface for messages of a job to its user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navsim.runner.job import Progress


@dataclass(frozen=True)
class Reporter:
    """say: receives messages. warn: receives warnings."""

    say: Callable[[str], None]
    warn: Callable[[str], None]


@dataclass(frozen=True)
class JobReporter:
    """Receiver of a job's messages."""

    speech: Reporter
    progress: Callable[[int, str], AbstractContextManager[Progress]]
    """Context for an extent and its unit, in which the job runs; it returns the progress callback."""
    ahead: Sequence[str] = ()
    """Modules to load during the first steps."""
