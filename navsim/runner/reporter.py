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
    """Whom a job's steps speak to. progress: a context, for an extent and its unit, in which the job runs; gives what
    is told of its progress. ahead: modules that are loaded beside the first steps."""

    speech: Reporter
    progress: Callable[[int, str], AbstractContextManager[Progress]]
    ahead: Sequence[str] = ()
