"""Functions of `navsim`. Each runs the same job as the command of its name, in the same steps."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from navsim.api.arguments import (
    FileArguments,
    OptimizeArguments,
    PathLike,
    ReplayArguments,
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
    from navsim.runner.log_import import ImportedLog
    from navsim.runner.verification import Verification
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
        `seed`, `workers`, `scheduler` and those of all functions, see `run`.

    Returns
    -------
    ResultFile

    Raises
    ------
    BadInput, RunFailed
        See `run`.
    """
    return _computed("optimize", study, checked("optimize", OptimizeArguments, given))


@spelled(ReplayArguments)
def replay(log: Scenario, /, **given: Unpack[ReplayArguments]) -> ResultFile:
    """Run a recorded flight through the filter, as `navsim replay` does.

    Parameters
    ----------
    log : path or mapping
        A log file, or its contents.
    bet : float or path, optional
        Predict the rest of the recording from its part up to this time, s, and score the prediction. It is written
        beside the result. With an earlier prediction: test it on this recording.

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
    return _computed("replay", log, checked("replay", ReplayArguments, given))


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


def verify(
    file: PathLike,
    /,
    *,
    folder: PathLike | None = None,
    runs: int | None = 96,
    workers: int | None = None,
    progress: Told | None = None,
) -> Verification:
    """Verify a result, as `navsim verify` does: file, inputs, code, and numbers, which are computed again.

    Parameters
    ----------
    file : path
        The result file.
    folder : path, optional
        Folder of the files that the scenario names. Default: that of the scenario when it was computed, the working
        folder, or that of the result.
    runs : int, optional
        Number of randomly chosen runs of an ensemble to simulate again; None: all.
    workers : int, optional
        Threads, default all cores.
    progress : callable, optional
        Receives (finished, extent, message). An exception from it ends the work.

    Returns
    -------
    Verification
        Its `differs` is True if the result or an input was changed, `incomplete` if numbers could not be checked,
        `of_other_code` if numbers differ that other code than this one computed.
        `checks` lists each check with `subject`, `verdict` and `text`.

    Raises
    ------
    BadInput
        The file is not a result, or an option is wrong.
    """
    from navsim.results.result import ResultError
    from navsim.runner import verification
    from navsim.runner.executor import threads

    asked = checked("verify", FileArguments, {"folder": folder, "runs": runs, "workers": workers, "progress": progress})
    result = Path(file).expanduser()
    _check_folder(asked["folder"])
    count = verification.ALL if asked["runs"] is None else asked["runs"]
    with _alone(), _telling(progress, 0) as tell:
        try:
            return verification.verify(result, asked["folder"], count, threads(asked["workers"]), tell)
        except ResultError as error:
            raise BadInput(as_problems(opening.scenario_instead(result) or error)) from None


def evidence(
    file: PathLike, /, *, output: PathLike | None = None, folder: PathLike | None = None, license: str = ""
) -> list[Path]:
    """Write a result with its inputs as a folder for a reviewer, as `navsim evidence` does.

    Parameters
    ----------
    file : path
        The result file.
    output : path, optional
        New or empty folder. Default: <result stem>_evidence in the folder of the result.
    folder : path, optional
        Folder of the files that the scenario names, see `verify`.
    license : str
        Terms of use, such as a Creative Commons URL.

    Returns
    -------
    list of Path
        The written files.

    Raises
    ------
    BadInput
        The file is not a result or was changed, an input is lacking or was changed, or the folder is not empty.
    """
    from navsim.results.result import ResultError
    from navsim.runner.evidence import write_evidence
    from navsim.runner.target import make_folder

    asked = checked("evidence", FileArguments, {"output": output, "folder": folder})
    result = ResultFile(file).path
    _check_folder(asked["folder"])
    target = asked["output"] or result.with_name(f"{result.stem}_evidence")
    make_folder(target)
    try:
        return write_evidence(result, target, asked["folder"], license)
    except ResultError as error:
        raise BadInput(as_problems(error)) from None


def import_log(
    logs: PathLike | Sequence[PathLike],
    /,
    *,
    output: PathLike | None = None,
    format: str | None = None,
    imu: int = 0,
    receiver: int = 0,
    force: bool = False,
) -> ImportedLog:
    """Turn a log of an autopilot or a receiver into a recorded flight, as `navsim import` does.

    Parameters
    ----------
    logs : path or sequence of paths
        A log; several files of one recording if they have GPS time.
    output : path, optional
        Folder for the files. Default: <log stem>_log.
    format : str, optional
        Format of the log. Default: what the file shows.
    imu, receiver : int
        Numbers of the IMU and the receiver that log.yaml names.
    force : bool
        Overwrite files of an earlier import.

    Returns
    -------
    ImportedLog
        `files` that were written; `replayable`: those that `replay` takes; `account` of the data taken and left out.

    Raises
    ------
    BadInput
        A log or an option is wrong, or the folder has files of an earlier import.

    Warns
    -----
    NavsimWarning
        For data that a replay needs and the log lacks.
    """
    from navsim.runner.log_import import import_files

    asked = checked("import_log", FileArguments, {"output": output, "imu": imu, "receiver": receiver, "force": force})
    several = [logs] if isinstance(logs, str | os.PathLike) else logs
    paths = [Path(each).expanduser() for each in several]
    if not paths:
        raise BadInput(as_problems("no log is given"))
    made = import_files(paths, asked["output"], format, asked["imu"], asked["receiver"], asked["force"])
    for text in made.account.missing:
        warnings.warn(f"{paths[0]}: {text}", NavsimWarning, stacklevel=_CALLER - 1)
    return made


def _check_folder(folder: Path | None) -> None:
    if folder is not None and not folder.is_dir():
        raise BadInput(as_problems(f"folder {folder}: no such folder"))


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
    from navsim.runner.job import Options, prediction_of

    taken = {name: value for name, value in asked.items() if name in Options.__dataclass_fields__}
    source = _source(scenario, _NOUNS[command])
    stem = source.stem if isinstance(source, Path) else "result"
    temporary = Path(tempfile.mkdtemp(prefix="navsim-")) if asked["output"] is None else None
    if taken.get("bet") is not None:
        beside = asked["output"] if temporary is None else temporary / f"{stem}.h5"
        taken["bet_file"] = prediction_of(beside)
    options = Options(**taken)
    order = steps.JobRequest(options, asked["figures"], True, asked["force"], asked["over_budget"])
    listener = JobReporter(Reporter(_log.info, heard.append), lambda extent, _: _telling(asked["progress"], extent))
    try:
        job, suffix = opening.open_job(command, source, _assignments(asked["set"]), options, heard.append)
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
        from navsim.scenario_files.source import of_data

        with translate_input_errors():
            return of_data(scenario, noun)
    try:
        return Path(scenario).expanduser()
    except TypeError:
        text = f"expected the path of a file, or a mapping with its contents, not {type(scenario).__name__}"
        raise BadInput(as_problems(text)) from None


def _assignments(given: Mapping[str, Any] | None) -> list[Assignment]:
    from navsim.scenario_files.source import Setting

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
