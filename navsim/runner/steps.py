"""Steps of a job (`navsim.runner.job`): from a checked target to written files."""

from __future__ import annotations

import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from navsim.runner.errors import BadInput, RunFailed, as_problems, translate_errors
from navsim.runner.executors import open_executor
from navsim.runner.reporter import JobReporter
from navsim.runner.requirements import ExitRequirements, unmet_requirements
from navsim.runner.resources import Request, check_resources, tell
from navsim.runner.target import Written, check_target, figure_folder, locked_target, refuse_other, save

if TYPE_CHECKING:
    from navsim.results.result import Result
    from navsim.runner.checkpoint import CheckpointStore
    from navsim.runner.estimate import Budget
    from navsim.runner.executor import Executor
    from navsim.runner.job import Job, Options


_SHELL_TIME = 0.5
"""Seconds of a process outside the preparation and the work."""


@dataclass(frozen=True)
class JobRequest:
    """Options of a job."""

    options: Options
    """Options of the job itself."""
    figures: str | Path | None = None
    """See `target.figure_folder`."""
    plain: bool = False
    """No figures of single runs either, unless a folder is given."""
    force: bool = False
    """Overwrite a result of a different kind."""
    over_budget: bool = False
    """Compute even if this machine seems too small."""
    dry_run: bool = False
    """Only report the resources."""
    command: Sequence[str] = ()
    """Command line after the program, for messages about continuing; empty without one."""
    resumed: Path | None = None
    """Folder of partial work of this job to continue; None: start anew if there is none."""


@dataclass(frozen=True)
class Finished:
    """Outcome of a job after all steps."""

    result: Result
    target: Path
    written: Written
    known: Sequence[str]
    """Warnings already reported."""
    warnings: Sequence[str]
    """About its end."""
    stopped: str
    """Why it ended early, "" if complete."""
    kept: str
    """Where finished work is then, "" if complete."""
    interrupted: bool
    """By the user."""
    failed: str
    """Why it fails although the result is complete, "" if it does not."""


def run_job(name: object, job: Job, target: Path, order: JobRequest, listener: JobReporter) -> Finished | None:
    """Do a job and write its result, or only report its resources; returns None then.

    name: of the file, for messages. target: the result's path. Raises BadInput, RunFailed.
    """
    from navsim.results.result import SEVERAL_RUNS

    _check_resumed(target, order)
    check_target(target, job.sort, order.force)
    drawing = figure_folder(order.figures, target, order.plain or job.sort.runs == SEVERAL_RUNS)
    with open_executor(order.options, listener.speech) as executor:
        if order.dry_run:
            _report_estimate(name, job, target, order, listener, executor)
            return None
        with locked_target(target, job.kernels, listener.speech, 1 if executor.away else executor.workers):
            _load_ahead(job.kernels, listener.ahead)
            _prepare(name, job, target, order, listener, executor)
            return _computed(name, job, target, order, listener, executor, drawing)


def _check_resumed(target: Path, order: JobRequest) -> None:
    """Raise BadInput, before anything is touched, where a resumed command works elsewhere than in its folder."""
    from navsim.results.atomic_write import partial_folder

    if order.resumed is not None and (own := partial_folder(target)).resolve() != order.resumed.resolve():
        where = f"would write {target}, whose work lies in {own}"
        raise BadInput(as_problems(f"{order.resumed}: its command {where}; if you mean that, give the command itself"))


def _prepare(
    name: object, job: Job, target: Path, order: JobRequest, listener: JobReporter, executor: Executor
) -> tuple[Request, Budget]:
    """Prepare a job; returns its estimate."""
    from navsim.results.findings import several

    away = f"on {several(executor.workers, 'worker')} of {executor.name}" if executor.name else ""
    estimates: list[tuple[Request, Budget]] = []

    def allow(budget: Budget, at_most: bool = False) -> None:
        asked = Request(name, target, order.over_budget, at_most, away)
        check_resources(asked, budget, listener.speech, order.dry_run)
        estimates.append((asked, budget))

    with translate_errors(name):
        job.prepare(executor, allow)
    for warning in job.warnings:
        listener.speech.warn(warning)
    return estimates[-1]


def _report_estimate(
    name: object, job: Job, target: Path, order: JobRequest, listener: JobReporter, executor: Executor
) -> None:
    """Report the resources of a job, with the time from a timed block if that needs no compilation."""
    from navsim.compiler import jit
    from navsim.runner.timed import seconds_of

    started = time.monotonic()
    asked, budget = _prepare(name, job, target, order, listener, executor)
    seconds, why = None, "navsim can only estimate work in equal parts, such as runs"
    if not jit.is_warm(job.kernels):
        why = "its kernels are not compiled yet, which takes about a minute"
    else:
        prepared = time.monotonic() - started
        with translate_errors(name):
            seconds = seconds_of(job, executor)
        if seconds is not None:
            seconds += _SHELL_TIME + prepared
    tell(asked, budget, listener.speech, seconds)
    if seconds is None:
        listener.speech.say(f"{name}: its time is not estimated: {why}")
    listener.speech.say(f"{name}: {job.described()}; would write {target}")
    if kept := _earlier_work_text(job, target, seconds, order.options.fresh):
        listener.speech.say(kept)


def _earlier_work_text(job: Job, target: Path, seconds: float | None, fresh: bool) -> str:
    """Finished and remaining part of a job, in words; "" without earlier work. seconds: total time, if known."""
    from navsim.results.atomic_write import partial_folder
    from navsim.runner.checkpoint import CheckpointError, earlier_work
    from navsim.runner.estimate import duration

    folder = partial_folder(target)
    if not job.pieces or not folder.exists():
        return ""
    if fresh:
        return f"{folder}: work of an earlier attempt lies there and would be discarded"
    try:
        earlier = earlier_work(folder, job.key())
    except CheckpointError as error:
        raise BadInput(as_problems(error)) from None
    if earlier is None:
        return ""
    if not job.even:
        parts = f"{earlier.pieces} finished steps and {earlier.analyses} analyses"
        return f"{folder}: begun before; {parts} are kept and not computed again"
    left = max(job.pieces - earlier.pieces, 0)
    kept = f"{folder}: begun before; {earlier.pieces} of {job.pieces} pieces of the {job.work} are kept"
    if seconds is None:
        return kept
    return f"{kept}, what remains to be computed takes {duration(seconds * left / job.pieces)}"


def _computed(
    name: object,
    job: Job,
    target: Path,
    order: JobRequest,
    listener: JobReporter,
    executor: Executor,
    drawing: Path | None,
) -> Finished:
    from navsim.compiler import jit
    from navsim.runner.provenance import inputs_of, provenance

    store = _store(job, target, order)
    former = _which(target)
    read = inputs_of(job)
    refused = False

    def kept() -> str:
        if store is None or not store.holds_work():
            return "no work is kept; the same command starts from the beginning"
        if refused:
            way = f"move {target} away, or give --force: the same command then writes them without computing"
            return f"finished {job.work} are kept in {store.folder}; {way}"
        resume = f", or navsim resume {shlex.quote(str(store.folder))}" if order.command else ""
        return f"finished {job.work} are kept in {store.folder}; the same command continues from there{resume}"

    def state() -> str:
        return kept() if _which(target) == former else f"{target} is complete"

    try:
        with translate_errors(name):
            with listener.progress(job.extent, job.unit) as tell:
                outcome = job.run(executor, store, tell)
            if not job.sort.count and "/run" in outcome.result:  # how many runs there are is known only now
                count = int(outcome.result["/run"].size)
                refused = True
                refuse_other(target, replace(job.sort, count=count), order.force)
                refused = False
            outcome.result.variables.update(provenance(job, order.options, read))
            written = save(outcome.result, target, None if outcome.interrupted else drawing)
    except RunFailed as error:
        last = error.problems[-1]
        raise RunFailed([*error.problems[:-1], replace(last, message=f"{last.message}; {state()}")]) from None
    except BaseException as ended:  # in any case the next step is the same
        listener.speech.say(state())
        ended.add_note(state())
        raise
    finally:
        if store is not None:
            store.remove_if_empty()
    if store is not None:
        if store.redone:
            listener.speech.say(f"{store.redone} damaged piece(s) of an earlier attempt were computed again")
        if not outcome.stopped:
            store.remove()
    jit.mark_warm(job.kernels)
    stopped = f"stopped early: {outcome.stopped}; {target} holds what was found" if outcome.stopped else ""
    return Finished(
        outcome.result, target, written, job.warnings, outcome.warnings, stopped, kept() if stopped else "",
        outcome.interrupted, f"{name}: {outcome.failed} ({target} is complete)" if outcome.failed else "",
    )  # fmt: skip


def _which(target: Path) -> tuple[int, int] | None:
    """Identity of the file at a path: it is replaced atomically, never changed."""
    try:
        found = target.stat()
    except OSError:  # none, or none that this process may see
        return None
    return found.st_ino, found.st_mtime_ns


def raise_on_failure(finished: Finished, demands: ExitRequirements) -> None:
    """Raise KeyboardInterrupt after an interrupt, and RunFailed if the work failed or its result violates the demands.

    All files are written before.
    """
    if finished.interrupted:
        interrupt = KeyboardInterrupt()
        interrupt.add_note(finished.stopped)
        raise interrupt
    wrong = [finished.failed] if finished.failed else unmet_requirements(finished.result, demands)
    if not wrong:
        return
    if not finished.failed:
        whole, many = f"{finished.target} is complete", len(wrong)
        wrong = [f"{wrong[0]} ({whole})"] if many == 1 else [*wrong, f"{many} conditions are violated; {whole}"]
    error = RunFailed(as_problems(*wrong))
    error.path = finished.target
    raise error


def _load_ahead(kernels: str, modules: Sequence[str]) -> None:
    """Load later modules and these kernels (`runner.job.Job`) in parallel with the first steps.

    Loading machine code and numpy's work release the interpreter.
    """
    from navsim.compiler import jit

    jit.work_begins()

    def load() -> None:
        jit.load_ahead(kernels)
        for module in ("navsim.results.netcdf", *modules):
            import_module(module)

    Thread(target=load).start()


def _store(job: Job, target: Path, order: JobRequest) -> CheckpointStore | None:
    """Store for partial work beside the result; None for work in one piece without an earlier one."""
    from navsim.results.atomic_write import partial_folder
    from navsim.runner.checkpoint import CheckpointError, CheckpointStore, check_key

    folder = partial_folder(target)
    if order.resumed is not None and not job.pieces:
        raise BadInput(
            as_problems(f"{order.resumed}: its command keeps no work; if you mean it, give the command itself")
        )
    if not job.pieces or (job.pieces == 1 and not folder.exists()):
        return None
    try:
        if order.resumed is not None:
            check_key(folder, job.key())
        store = CheckpointStore(folder, job.key(), order.options.fresh)
        if order.command:
            store.note(order.command)
        return store
    except CheckpointError as error:
        raise BadInput(as_problems(error)) from None
