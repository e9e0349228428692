"""A job: the work that a file of some kind asks for, done by every command in the same steps. (`navsim live` alone has
steps of its own: its work comes line by line and ends when the source does.)

opened      from the validated file and what the command line says beside it, cheap
prepared    files read, memory and disk estimated (`estimate`) and allowed, what all of the work shares made
run         pieces of it kept in a store, done by an executor, to a result
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

from navsim.results.result import Result, ResultKind
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import Budget
from navsim.runner.executor import Executor
from navsim.words import option


class JobError(Exception):
    """Work that cannot be done although its input is right."""


class OptionError(Exception):
    """An option that this work does not take, or whose value is wrong."""


@dataclass(frozen=True)
class Options:
    """What the command line says beside the file; None or False: nothing."""

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

    def foreign(self, *taken: str) -> list[str]:
        """Those given that are not among the ones taken, as messages spell them."""
        given = [field.name for field in fields(self)[1:] if getattr(self, field.name) not in (None, False)]
        return [option(name) for name in given if name not in taken]


class ResourceCheck(Protocol):
    """Told what the work will take before anything of its size is made; raises where it is not to be. at_most: the
    work may end earlier by itself."""

    def __call__(self, budget: Budget, at_most: bool = False) -> None: ...


class Progress(Protocol):
    """Told how much of a job's extent is finished, and where the work stands in words; raises where it is to stop."""

    def __call__(self, finished: int, words: str = "") -> None: ...


@dataclass(frozen=True)
class Outcome:
    """What a job came to. warnings: of how it ended, beside the findings in the result. stopped: why it ended before
    all was done, "" where it did not; what was finished is kept then. interrupted: by the user. failed: why the command
    fails although the result is complete, "" where it does not."""

    result: Result
    warnings: tuple[str, ...] = ()
    stopped: str = ""
    interrupted: bool = False
    failed: str = ""


class Job(Protocol):
    """The work of one file.

    sort: of its result. kernels: a name for those that the work takes, the same for work that takes the same, as far
    as is known before. suffix: of the result's name where it is not the usual work of the file. extent, unit: of
    progress, what it counts; an extent of 0 is told in words. even: whether all that it counts takes about the same
    time. pieces: of the work that a store keeps, named `work` in
    words; 0 where nothing is kept, more than one where their number is not known before. warnings: of the input. The
    last three count once the job is prepared.
    """

    sort: ResultKind
    kernels: str
    suffix: str
    unit: str
    even: bool
    work: str

    @property
    def extent(self) -> int: ...
    @property
    def pieces(self) -> int: ...
    @property
    def warnings(self) -> list[str]: ...

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        """Raises InputError, JobError, and what `allow` raises."""

    def described(self) -> str:
        """The work in a line, once it is prepared."""

    def key(self) -> dict[str, object]:
        """What partial work must agree in to be resumed."""

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        """Do the work, going on from what the store has. Raises JobError, ResultError, CheckpointError."""


class Check(Protocol):
    """Warns of what a validated file says: its section, its document. Raises InputError."""

    def __call__(self, section: Any, document: Any) -> list[str]: ...


class Opener(Protocol):
    """What makes the job of a kind from a validated file: its section, its document (`scenario.source`), the options.
    Raises InputError, OptionError."""

    def __call__(self, section: Any, document: Any, options: Options) -> Job: ...
