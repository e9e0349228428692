"""Functions of `navsim`. Each runs the same job as the command of its name, in the same steps."""

from __future__ import annotations

import logging
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from navsim.api.arguments import (
    OptimizeArguments,
    PathLike,
    ResultConditions,
    RunArguments,
    SweepArguments,
    Told,
    checked,
    spelled,
)
from navsim.api.result import ResultFile
from navsim.runner import opening, steps
from navsim.runner.errors import BadInput, RunFailed, as_problems, translate_input_errors
from navsim.runner.reporter import JobReporter, Reporter
from navsim.runner.requirements import ExitRequirements

if TYPE_CHECKING:
    from navsim.runner.job import Progress
    from navsim.scenario.load import Assignment, Source

Scenario = PathLike | Mapping[str, Any]
"""A file, or its contents as a mapping."""

_log = logging.getLogger("navsim")
_computing = threading.Lock()
_by: list[int] = []
"""Thread that is computing."""
_NOUNS = {"run": "scenario", "sweep": "study", "optimize": "study", "replay": "log"}
_CALLER = 3
"""Frames from a warning to the user's line: ours, the function's, the user's."""


class NavsimWarning(UserWarning):
    """A finding of a study, or a reason for its early end."""


@spelled(RunArguments)
def run(scenario: Scenario, /, **given: Unpack[RunArguments]) -> ResultFile:
    """Simulate a scenario, as `navsim run` does.

    Parameters
    ----------
    scenario : path or mapping
        A scenario file, or its contents. File names in a mapping are relative to the working folder.
    set : mapping, optional
        Values for keys, dotted: `{"pseudolites.s_m": 1000}`.
    runs : int, optional
        Number of runs.
    seed : int
        Root of all random numbers.
    first_run : int, optional
        Number of the first run.
    until : str, optional
        Stop when an interval is narrow enough: `"rms_horizontal within 2%"`.
    method : str, optional
        Replaces the scenario's method.
    keep : str, optional
        Data stored of each run.

    Other Parameters
    ----------------
    output : path, optional
        Result file. Default: a temporary one, deleted with the returned object.
    figures : path, optional
        Folder for figures. Default: no figures.
    force : bool
        Overwrite a result of a different kind.
    fresh : bool
        Discard partial work of an earlier attempt.
    over_budget : bool
        Compute even if this machine seems too small.
    require_fix : bool
        Raise RunFailed unless every epoch has a fix.
    require_consistent : bool
        Raise RunFailed unless the filter is consistent.
    require : bool
        Raise RunFailed unless the result meets all requirements.
    workers : int, optional
        Threads, default all cores.
    scheduler : str or path, optional
        Address or file of the scheduler of a Dask cluster.
    progress : callable, optional
        Receives (finished, extent, message). An exception from it ends the work.

    Returns
    -------
    ResultFile

    Raises
    ------
    BadInput
        The scenario, an option or a path is wrong. Nothing was computed.
    RunFailed
        The work failed, or the result does not meet a `require...` condition.

    Warns
    -----
    NavsimWarning
        For each finding.
    """
    return _computed("run", scenario, checked("run", RunArguments, given))


@spelled(SweepArguments)
def sweep(study: Scenario, /, **given: Unpack[SweepArguments]) -> ResultFile:
    """Compute every combination of a study's settings, as `navsim sweep` does.

    Parameters
    ----------
    study : path or mapping
        A study file, or its contents.
    runs : int, optional
        Runs of each combination with method monte-carlo.
    method : str, optional
        Replaces the study's method.

    Other Parameters
    ----------------
    **given
        See `run`; `first_run`, `until` and `keep` are for `run` only.

    Returns
    -------
    ResultFile

    Raises
    ------
    BadInput, RunFailed
        See `run`.
    """
    return _computed("sweep", study, checked("sweep", SweepArguments, given))


@spelled(OptimizeArguments)
def optimize(study: Scenario, /, **given: Unpack[OptimizeArguments]) -> ResultFile:
    """Find the best placement of pseudolites, as `navsim optimize` does.

    Parameters
    ----------
    study : path or mapping
        A study file, or its contents.
    runs : int, optional
        Runs of the best placements, 0 for none.
    time_limit : float, optional
        Stop after this time with the best placement so far, s.

    Other Parameters
    ----------------
    **given
        `seed`, `scheduler` and those of all functions, see `run`.

    Returns
    -------
    ResultFile

    Raises
    ------
    BadInput, RunFailed
        See `run`.
    """
    return _computed("optimize", study, checked("optimize", OptimizeArguments, given))


@spelled(ResultConditions)
def replay(log: Scenario, /, **given: Unpack[ResultConditions]) -> ResultFile:
    """Run a recorded flight through the filter, as `navsim replay` does.

    Parameters
    ----------
    log : path or mapping
        A log file, or its contents.

    Other Parameters
    ----------------
    **given
        `require_fix`, `require_consistent`, `require` and those of all functions, see `run`.

    Returns
    -------
    ResultFile

    Raises
    ------
    BadInput, RunFailed
        See `run`.
    """
    return _computed("replay", log, checked("replay", ResultConditions, given))


def validate(scenario: Scenario, /, *, set: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Check a scenario, study or log, as `navsim validate` does.

    Parameters
    ----------
    scenario : path or mapping
        A file, or its contents. The files that it names are read, too.
    set : mapping, optional
        Values for keys, dotted.

    Returns
    -------
    dict
        The scenario with every default written out.

    Raises
    ------
    BadInput
        With all errors found.

    Warns
    -----
    NavsimWarning
        For keys without effect and the like, as the command does.
    """
    section, _, heard = opening.checked(_source(scenario, "scenario"), _assignments(set))
    for text in heard:
        warnings.warn(text, NavsimWarning, stacklevel=_CALLER - 1)
    return section.model_dump(mode="json", exclude_none=True)


def schema(kind: str = "landing") -> dict[str, Any]:
    """JSON Schema of a kind of files.

    Parameters
    ----------
    kind : str
        `landing`, `sweep`, `optimize`, `replay` ..., or `any`.

    Returns
    -------
    dict

    Raises
    ------
    BadInput
        The kind does not exist.
    """
    return opening.schema_of(kind)


def _computed(command: str, scenario: Scenario, asked: dict[str, Any]) -> ResultFile:
    from navsim.defect import Defect

    heard: list[str] = []
    with _alone():
        try:
            made = _compute_result(command, scenario, asked, heard)
        except Defect as error:
            raise RunFailed(as_problems(error)) from error
    for text in heard:
        warnings.warn(text, NavsimWarning, stacklevel=_CALLER)
    return made


def _compute_result(command: str, scenario: Scenario, asked: dict[str, Any], heard: list[str]) -> ResultFile:
    """Result of a job; `heard` receives the warnings."""
    import shutil

    from navsim.results.findings import of
    from navsim.runner.job import Options

    taken = {name: value for name, value in asked.items() if name in Options.__dataclass_fields__}
    options = Options(**taken)
    source = _source(scenario, _NOUNS[command])
    job, suffix = opening.open_job(command, source, _assignments(asked["set"]), options, heard.append)
    temporary = Path(tempfile.mkdtemp(prefix="navsim-")) if asked["output"] is None else None
    stem = source.stem if isinstance(source, Path) else "result"
    order = steps.JobRequest(options, asked["figures"], True, asked["force"], asked["over_budget"])
    listener = JobReporter(Reporter(_log.info, heard.append), lambda extent, _: _telling(asked["progress"], extent))
    try:
        output = asked["output"] if temporary is None else temporary / f"{stem}{suffix}.h5"
        target = opening.target_of(output, "")
        done = steps.run_job(source, job, target, order, listener)
        assert done is not None
        required = [asked.get(name, False) for name in ("require_fix", "require_consistent", "require")]
        steps.raise_on_failure(done, ExitRequirements(*required))
        made = ResultFile._of(target, [*done.written.texts, *done.written.figures], done.stopped, temporary)
    except BaseException:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        raise
    heard += [*done.warnings, *(f.text for f in of(done.result) if f.text not in done.known)]
    heard += [text for text in (done.stopped, done.kept) if text] + _notes()
    return made


def _notes() -> list[str]:
    """Messages of the kernel cache, if it was used."""
    cache = sys.modules.get("navsim.compiler.kernel_cache")
    if cache is None:
        return []
    notes, cache.notes[:] = [*cache.notes], []
    return notes


@contextmanager
def _telling(progress: Told | None, extent: int) -> Iterator[Progress]:
    def tell(finished: int, words: str = "") -> None:
        if progress is not None:
            progress(finished, extent, words)

    yield tell


def _source(scenario: Scenario, noun: str) -> Source:
    """Path of a file, or a mapping as a source. noun: name of a mapping in messages."""
    if isinstance(scenario, Mapping):
        from navsim.scenario.source import of_data

        with translate_input_errors():
            return of_data(scenario, noun)
    try:
        return Path(scenario).expanduser()
    except TypeError:
        text = f"expected the path of a file, or a mapping with its contents, not {type(scenario).__name__}"
        raise BadInput(as_problems(text)) from None


def _assignments(given: Mapping[str, Any] | None) -> list[Assignment]:
    from navsim.scenario.source import Setting

    return [Setting(key, value) for key, value in (given or {}).items()]


@contextmanager
def _alone() -> Iterator[None]:
    """Lock: one study at a time in a process, since each uses all cores.

    Other threads wait. A call from the study's own progress callback raises BadInput.
    """
    here = threading.get_ident()
    if here in _by:
        raise BadInput(as_problems("a study is computed already; none can be begun from its progress"))
    with _computing:
        _by.append(here)
        try:
            yield
        finally:
            _by.clear()
