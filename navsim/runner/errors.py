"""Exceptions for users: the input is wrong, or the work failed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navsim.scenario_files.source import Problem


class NavsimError(Exception):
    """Base class of navsim's exceptions.

    Attributes
    ----------
    problems : list of Problem
        All errors found, each with `file`, `line`, `key` (empty or 0 if it has none) and `message`.
    """

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = list(problems)


class BadInput(NavsimError):
    """The input is wrong: a scenario, an option, a path. Nothing was computed."""


class RunFailed(NavsimError):
    """The work failed, or its result does not meet a requirement.

    Attributes
    ----------
    path : Path or None
        The result, if it is complete nevertheless.
    """

    path: Path | None = None


def as_problems(*messages: object) -> list[Problem]:
    """Problems without a place in a file."""
    from navsim.scenario_files.source import NOWHERE, Problem

    return [Problem(NOWHERE, "", str(message)) for message in messages]


@contextmanager
def translate_input_errors() -> Iterator[None]:
    """Raise errors of a file as BadInput."""
    from navsim.scenario_files.source import InputError

    try:
        yield
    except InputError as error:
        raise BadInput(error.problems) from None


@contextmanager
def translate_errors(name: object) -> Iterator[None]:
    """Raise errors of the work on a file of this name as BadInput or RunFailed."""
    from navsim.results.result import ResultError
    from navsim.runner.checkpoint import CheckpointError
    from navsim.runner.executor import WorkerLost
    from navsim.runner.job import JobError, OptionError

    try:
        with translate_input_errors():
            yield
    except OptionError as error:
        raise BadInput(as_problems(error)) from None
    except (JobError, WorkerLost) as error:
        raise RunFailed(as_problems(f"{name}: {error}")) from None
    except (ResultError, CheckpointError) as error:
        raise RunFailed(as_problems(error)) from None
