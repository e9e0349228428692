"""What is done with a job (`navsim.study.job`), whoever asks for it: from a checked target to written files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from navsim.words import again
from navsim.work.afford import Request, afford
from navsim.work.errors import BadInput, RunFailed, failures, said
from navsim.work.required import Demands, wanting
from navsim.work.speech import Listener
from navsim.work.target import Written, begun, check_target, figure_folder, save
from navsim.work.workplace import workplace

if TYPE_CHECKING:
    from navsim.io.results import Result
    from navsim.study.executor import Executor
    from navsim.study.job import Job, Options
    from navsim.study.partial import Store


@dataclass(frozen=True)
class Order:
    """What is to be done with a job. options: as the job has them. figures: see `target.figure_folder`; plain: none of
    one run either, unless a folder is given. force: overwrite a result of another sort. over_budget: compute what the
    machine seems too small for. dry_run: only say what it would take."""

    options: Options
    figures: str | Path | None = None
    plain: bool = False
    force: bool = False
    over_budget: bool = False
    dry_run: bool = False


@dataclass(frozen=True)
class Finished:
    """What came of it. known: warnings that were said before. warnings: of how it ended. stopped: that it ended before
    all was done, and why; kept: where finished work is then; both "" where it did not. interrupted: by the user.
    failed: why it fails although the result is complete, "" where it does not."""

    result: Result
    target: Path
    written: Written
    known: Sequence[str]
    warnings: Sequence[str]
    stopped: str
    kept: str
    interrupted: bool
    failed: str


def carry_out(name: object, job: Job, target: Path, order: Order, listener: Listener) -> Finished | None:
    """Do a job and write its result, or only say what it would take; None then.

    name: of the file, for messages. target: the result's path. Raises BadInput, RunFailed.
    """
    from navsim.io.results import SEVERAL_RUNS
    check_target(target, job.sort, order.force)
    drawing = figure_folder(order.figures, target, order.plain or job.sort.runs == SEVERAL_RUNS)
    with workplace(order.options, listener.speech) as executor:
        if order.dry_run:
            _prepare(name, job, target, order, listener, executor)
            listener.speech.say(f"{name}: {job.described()}; would write {target}")
            return None
        with begun(target, job.kernels, listener.speech):
            _load_ahead(job.kernels, listener.ahead)
            _prepare(name, job, target, order, listener, executor)
            return _computed(name, job, target, order, listener, executor, drawing)


def _prepare(name: object, job: Job, target: Path, order: Order, listener: Listener, executor: Executor) -> None:
    from navsim.io.findings import several

    def allow(budget: Any, final: bool = True, at_most: bool = False) -> None:
        away = f"on {several(executor.workers, 'worker')} of {executor.name}" if executor.name else ""
        asked = Request(name, target, order.over_budget, order.dry_run and final, at_most, away)
        afford(asked, budget, job.kernels, listener.speech)

    with failures(name):
        job.prepare(executor, allow)
    for warning in job.warnings:
        listener.speech.warn(warning)


def _computed(
    name: object, job: Job, target: Path, order: Order, listener: Listener, executor: Executor, drawing: Path | None
) -> Finished:
    from navsim.core import jit
    from navsim.study.executor import Lost

    store = _store(job, target, order.options.fresh)
    kept = "" if store is None else f"finished {job.work} are kept in {store.folder}; {again()} goes on from there"
    try:
        with failures(name):
            with listener.progress(job.extent, job.unit) as tell:
                outcome = job.run(executor, store, tell)
            written = save(outcome.result, target, None if outcome.interrupted else drawing)
    except Lost as error:
        raise RunFailed(said(f"{name}: {error}; {kept or f'{again()} goes on from there'}")) from None
    except KeyboardInterrupt as interrupt:
        if kept:
            listener.speech.say(kept)
            interrupt.add_note(kept)
        raise
    if store is not None:
        if store.redone:
            listener.speech.say(f"{store.redone} damaged piece(s) of an earlier attempt were computed again")
        if not outcome.stopped:
            store.remove()
    jit.mark_warm(job.kernels)
    stopped = f"stopped early: {outcome.stopped}; {target} holds what was found" if outcome.stopped else ""
    return Finished(
        outcome.result, target, written, job.warnings, outcome.warnings, stopped, kept if stopped else "",
        outcome.interrupted, f"{name}: {outcome.failed} ({target} is complete)" if outcome.failed else "",
    )  # fmt: skip


def insist(finished: Finished, demands: Demands) -> None:
    """Raise KeyboardInterrupt where the work was interrupted, and RunFailed where it failed or its result is not what
    is demanded; all is written then."""
    if finished.interrupted:
        interrupt = KeyboardInterrupt()
        interrupt.add_note(finished.stopped)
        raise interrupt
    wrong = [finished.failed] if finished.failed else wanting(finished.result, demands)
    if not wrong:
        return
    if not finished.failed:
        wrong[-1] += f" ({finished.target} is complete)"
    error = RunFailed(said(*wrong))
    error.path = finished.target
    raise error


def _load_ahead(kernels: str, modules: Sequence[str]) -> None:
    """Load what comes later beside what comes first: these kernels (`study.job.Job`), and what writes files and tables.
    Making machine code ready, and numpy's work, leave the interpreter to others."""
    from navsim.core import jit

    def load() -> None:
        jit.load_ahead(kernels)
        for module in ("navsim.io.netcdf", *modules):
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
        raise BadInput(said(error)) from None
