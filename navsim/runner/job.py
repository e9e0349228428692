"""A job: the work of a file, in the same steps for every command.

- open: from the validated file and the command line, cheap.
- prepare: read files, estimate memory and disk (`estimate`) and check them, compute what all of the work shares.
- run: an executor computes pieces, a store keeps them, and the result follows.

Only `navsim live` has its own steps, since its work comes line by line and ends with the source.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

from navsim.results.result import Result, ResultKind
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import Budget
from navsim.runner.executor import Executor

BET_SUFFIX = "_bet"
"""End of the name of a result of `--bet`, which does not replace the plain one, and of its prediction."""


def prediction_of(target: Path) -> Path:
    """File of the prediction beside a result."""
    return target.with_name(f"{target.stem.removesuffix(BET_SUFFIX)}{BET_SUFFIX}.json")


class JobError(Exception):
    """Work that cannot be done although its input is right."""


class OptionError(Exception):
    """An option that this work does not take, or whose value is wrong."""


@dataclass(frozen=True)
class Options:
    """Options of the command line besides the file; None or False: not given."""

    seed: int = 1
    runs: int | None = None
    first_run: int | None = None
    until: str | None = None
    keep: str | None = None
    method: str | None = None
    workers: int | None = None
    scheduler: str | None = None
    time_limit: float | None = None
    fresh: bool = False
    require_fix: bool = False
    require_consistent: bool = False
    require: bool = False
    bet: str | None = None
    bet_file: Path | None = None

    def foreign(self, *taken: str) -> list[str]:
        """Given options outside the accepted ones, as spelled in messages."""
        given = [field.name for field in fields(self)[1:] if getattr(self, field.name) not in (None, False)]
        return [f"--{name.replace('_', '-')}" for name in given if name not in taken]


class ResourceCheck(Protocol):
    """Receives the estimate before any large allocation; raises to stop. at_most: the work may end earlier."""

    def __call__(self, budget: Budget, at_most: bool = False) -> None: ...


class Progress(Protocol):
    """Receives the finished part of a job's extent, and a message; raises to stop."""

    def __call__(self, finished: int, words: str = "") -> None: ...


@dataclass(frozen=True)
class Outcome:
    """Outcome of a job."""

    result: Result
    warnings: tuple[str, ...] = ()
    """About its end, in addition to the findings in the result."""
    stopped: str = ""
    """Why it ended early, "" if complete; finished work is kept."""
    interrupted: bool = False
    """By the user."""
    failed: str = ""
    """Why the command fails although the result is complete, "" if it does not."""


class Job(Protocol):
    """The work of one file. `extent`, `pieces` and `warnings` are valid once the job is prepared."""

    sort: ResultKind
    """Kind of its result."""
    kernels: str
    """Name of the kernels that the work uses, as far as known in advance; jobs with the same kernels have the same
    name."""
    suffix: str
    """Suffix of the result's name, if this is not the usual work of the file."""
    unit: str
    """Unit of progress; with an extent of 0, progress is text."""
    even: bool
    """Whether all units of progress take about the same time."""
    work: str
    """Name of the pieces that a store keeps. Their number `pieces` is 0 if none are kept, above 1 if unknown in
    advance."""

    @property
    def extent(self) -> int: ...
    @property
    def pieces(self) -> int: ...
    @property
    def warnings(self) -> list[str]: ...

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        """Prepare the job. Raises InputError, JobError, and errors of `allow`."""

    def described(self) -> str:
        """The work in a line, once it is prepared."""

    def key(self) -> dict[str, object]:
        """Data that partial work must match to be resumed."""

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        """Do the work, continuing from the store. Raises JobError, ResultError, CheckpointError."""


class Check(Protocol):
    """Returns warnings about a validated file, from its section and its document. Raises InputError."""

    def __call__(self, section: Any, document: Any) -> list[str]: ...


class Opener(Protocol):
    """Creates the job of a kind from a validated file: its section, its document (`scenario_files.source`), the
    options.

    Raises InputError, OptionError.
    """

    def __call__(self, section: Any, document: Any, options: Options) -> Job: ...
