"""What is raised for users: the input is wrong, or the work failed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navsim.scenario.source import Problem


class NavsimError(Exception):
    """What was asked for cannot be had.

    problems: all that was found wrong, each with its file, line, key (empty or 0 where it has none) and message.
    """

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = list(problems)


class BadInput(NavsimError):
    """The input is wrong: a scenario, an option, a path. Nothing was computed."""


class RunFailed(NavsimError):
    """The work itself failed, or its result is not what was required of it.

    path: of the result where it is complete nevertheless, else None.
    """

    path: Path | None = None


def as_problems(*messages: object) -> list[Problem]:
    """Problems that stand at no place of a file."""
    from navsim.scenario.source import NOWHERE, Problem

    return [Problem(NOWHERE, "", str(message)) for message in messages]


@contextmanager
def translate_input_errors() -> Iterator[None]:
    """What is wrong with a file that is only read, as users are told: raises BadInput."""
    from navsim.scenario.source import InputError

    try:
        yield
    except InputError as error:
        raise BadInput(error.problems) from None


@contextmanager
def translate_errors(name: object) -> Iterator[None]:
    """What stopped the work on a file of this name, as users are told: raises BadInput, RunFailed."""
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
