"""Run the job of a command: `navsim.runner` with a terminal."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.cli.common import AT_TERMINAL, leaving, print_shown, progress
from navsim.cli.exit_status import print_message
from navsim.cli.findings import warn
from navsim.cli.options import OutputOptions, Required
from navsim.runner import steps
from navsim.runner.reporter import JobReporter
from navsim.runner.requirements import ExitRequirements

if TYPE_CHECKING:
    from navsim.results.result import Result
    from navsim.runner.job import Job, Options, Progress

_OBJECTS = 20_000
"""New objects between two looks for cycles among them while work is done: every random stream that a kernel has drawn
from leaves one, a few kilobytes a run."""


_resumed: ContextVar[Path | None] = ContextVar("resumed", default=None)


@contextmanager
def resuming(folder: Path) -> Iterator[None]:
    """Context in which a command may only continue the partial work in this folder."""
    token = _resumed.set(folder)
    try:
        yield
    finally:
        _resumed.reset(token)


@dataclass(frozen=True)
class TerminalRequest:
    """Options of a job. options: of the job itself. figures: see `runner.target.figure_folder`."""

    care: OutputOptions
    required: Required
    options: Options
    figures: str | Path | None = None
    dry_run: bool = False
    json: bool = False


def run_job(name: object, job: Job, target: Path, wanted: TerminalRequest) -> Result | None:
    """Do a job and print its result, or only its resources; returns the result, if any.

    name: of the file, for messages. target: the result's path.
    """
    care = wanted.care

    @contextmanager
    def shown(extent: int, unit: str) -> Iterator[Progress]:
        gc.freeze()  # loaded modules stay loaded
        gc.set_threshold(_OBJECTS)
        with progress(extent, unit, not care.quiet) as tell:
            yield tell

    listener = JobReporter(AT_TERMINAL, shown, () if care.quiet or wanted.json else ("rich.console",))
    asked = steps.JobRequest(
        wanted.options, wanted.figures, care.quiet, care.force, care.over_budget, wanted.dry_run, sys.argv[1:],
        _resumed.get(),
    )  # fmt: skip
    with leaving():
        done = steps.run_job(name, job, target, asked, listener)
    if done is None:
        return None
    print_shown(done.result, target, done.written, care.quiet, wanted.json)
    for warning in done.warnings:
        AT_TERMINAL.warn(warning)
    warn(done.result, known=done.known)
    if done.stopped:
        AT_TERMINAL.warn(done.stopped)
    if done.kept:
        print_message(done.kept)
    required = wanted.required
    with leaving():
        steps.raise_on_failure(
            done, ExitRequirements(required.require_fix, required.require_consistent, required.require)
        )
    return done.result
