"""What every command that computes does with its job (`navsim.study.job`)."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from navsim.cli.budget import afford
from navsim.cli.common import begin, check_target, figure_folder, leave, print_shown, progress, save, target_of
from navsim.cli.ending import BAD_INPUT, RUN_FAILED, say
from navsim.cli.findings import require, warn
from navsim.cli.options import Care, Required

if TYPE_CHECKING:
    from navsim.io.results import Result
    from navsim.study.job import Job, Options
    from navsim.study.partial import Store


_OBJECTS = 20_000
"""New objects between two looks for cycles among them while work is done: every random stream that a kernel has drawn
from leaves one, a few kilobytes a run."""


@dataclass(frozen=True)
class Wanted:
    """What is to be done with a job. options: as the job has them. figures: see `common.figure_folder`."""

    care: Care
    required: Required
    options: Options
    figures: str | Path | None = None
    dry_run: bool = False
    json: bool = False


@contextmanager
def failures(name: object) -> Iterator[None]:
    """Leave with the words and the exit code of what stopped the work on a file of this name."""
    from navsim.io.results import ResultError
    from navsim.scenario.source import InputError
    from navsim.study.job import JobError, OptionError
    from navsim.study.partial import PartialError

    try:
        yield
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except OptionError as error:
        leave(BAD_INPUT, error)
    except JobError as error:
        leave(RUN_FAILED, f"{name}: {error}")
    except (ResultError, PartialError) as error:
        leave(RUN_FAILED, error)


def opened(command: str, file: Path, assignments: Sequence[str], options: Options) -> Job:
    """The job of a file that `command` computes."""
    from navsim.kinds import KINDS, named
    from navsim.scenario.load import read_for

    with failures(file):
        section, document = read_for(command, file, assignments)
        job: Job = named(KINDS[document.data["kind"]].job)(section, document, options)
    return job


def method_given(path: Path, assignments: list[str] | None, method: str | None) -> tuple[list[str], str]:
    """The assignment for --method, and the suffix of the result's name where it is not the file's own method."""
    from navsim.scenario.load import own_method
    from navsim.scenario.source import InputError

    if method is None:
        return [], ""
    try:
        own = own_method(path, assignments or [])
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    return ([], "") if own is None else ([f"method={method}"], "" if own == method else f"_{method}")


def target_for(output: Path | None, file: Path, job: Job, suffix: str = "") -> Path:
    """The result's path: as given by -o, else by the file's name and what is unusual about the work."""
    return target_of(output, f"{file.stem}{job.suffix or suffix}")


def carry_out(name: object, job: Job, target: Path, wanted: Wanted) -> Result | None:
    """Do a job and show its result, or only what it would take; returns the result where there is one.

    name: of the file, for messages. target: the result's path.
    """
    from navsim.core import jit
    from navsim.io.results import SEVERAL_RUNS
    from navsim.study.executor import threads

    check_target(target, job.sort, wanted.care.force)
    skipped = wanted.care.quiet or job.sort.runs == SEVERAL_RUNS
    drawing = figure_folder(wanted.figures, target, skipped)
    executor = threads(wanted.options.workers)

    def allow(budget: Any, final: bool = True, at_most: bool = False) -> None:
        shown = wanted.dry_run and final
        afford(name, budget, job.kernels, target, over_budget=wanted.care.over_budget, shown=shown, at_most=at_most)

    if not wanted.dry_run:
        begin(target, job.kernels)
        _load_ahead(job.kernels, printed=not (wanted.care.quiet or wanted.json))
    with failures(name):
        job.prepare(executor, allow)
    for warning in job.warnings:
        say(f"warning: {warning}")
    if wanted.dry_run:
        say(f"{name}: {job.described()}; would write {target}")
        return None
    store = _store(job, target, wanted.options.fresh)
    gc.freeze()  # what is loaded stays
    gc.set_threshold(_OBJECTS)
    try:
        with failures(name):
            with progress(job.extent, job.unit, not wanted.care.quiet) as tell:
                outcome = job.run(executor, store, tell)
            written = save(outcome.result, target, None if outcome.interrupted else drawing)
    except KeyboardInterrupt:
        if store is not None:
            say(f"finished {job.work} are kept in {store.folder}; the same command goes on from there")
        raise
    if store is not None:
        if store.redone:
            say(f"{store.redone} damaged piece(s) of an earlier attempt were computed again")
        if not outcome.stopped:
            store.remove()
    jit.mark_warm(job.kernels)
    print_shown(outcome.result, target, written, wanted.care.quiet, wanted.json)
    for warning in outcome.warnings:
        say(f"warning: {warning}")
    warn(outcome.result, known=job.warnings)
    if outcome.stopped:
        say(f"warning: stopped early: {outcome.stopped}; {target} holds what was found")
        if store is not None:
            say(f"finished {job.work} are kept in {store.folder}; the same command goes on from there")
    if outcome.interrupted:
        raise KeyboardInterrupt
    if outcome.failed:
        leave(RUN_FAILED, f"{name}: {outcome.failed} ({target} is complete)")
    require(outcome.result, target, wanted.required)
    return outcome.result


def _load_ahead(kernels: str, printed: bool) -> None:
    """Load what comes later beside what comes first: these kernels (`study.job.Job`), and what writes files and tables.
    Making machine code ready, and numpy's work, leave the interpreter to others."""
    from navsim.core import jit

    def load() -> None:
        jit.load_ahead(kernels)
        for module in ("navsim.io.netcdf", *["rich.console"] * printed):
            import_module(module)

    Thread(target=load).start()


def _store(job: Job, target: Path, fresh: bool) -> Store | None:
    """The place for partial work beside the result; None where the work is in one piece, and none lies there."""
    from navsim.io.whole import partial_folder
    from navsim.study.partial import PartialError, Store

    folder = partial_folder(target)
    if not job.pieces or (job.pieces == 1 and not folder.exists()):
        return None
    try:
        return Store(folder, job.key(), fresh)
    except PartialError as error:
        leave(BAD_INPUT, error)
