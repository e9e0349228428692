"""The functions: each opens the same job as the command of its name, and takes it through the same steps."""

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
    Requiring,
    RunArguments,
    SweepArguments,
    Told,
    checked,
    spelled,
)
from navsim.api.result import ResultFile
from navsim.runner import opening, steps
from navsim.runner.errors import BadInput, RunFailed, as_problems, translate_input_errors
from navsim.runner.reporter import Listener, Reporter
from navsim.runner.requirements import ExitRequirements
from navsim.words import of_python

if TYPE_CHECKING:
    from navsim.runner.job import Progress
    from navsim.scenario.load import Assignment, Source

Scenario = PathLike | Mapping[str, Any]
"""A file, or what would stand in one."""

_log = logging.getLogger("navsim")
_computing = threading.Lock()
_by: list[int] = []
"""The thread that computes."""
_NOUNS = {"run": "scenario", "sweep": "study", "optimize": "study", "replay": "log"}
_CALLER = 3
"""Frames from a warning to the user's line: ours, the function's, the user's."""


class NavsimWarning(UserWarning):
    """What a study found, or how it ended, that its user must hear about."""


@spelled(RunArguments)
def run(scenario: Scenario, /, **given: Unpack[RunArguments]) -> ResultFile:
    """Fly a scenario, as `navsim run` does.

    scenario: a file, or its contents as a mapping; files named in a mapping are relative to the working folder.
    Raises BadInput, RunFailed; warns with NavsimWarning.
    """
    return _computed("run", scenario, checked("run", RunArguments, given))


@spelled(SweepArguments)
def sweep(study: Scenario, /, **given: Unpack[SweepArguments]) -> ResultFile:
    """Compute every combination of a study's settings, as `navsim sweep` does. As `run`."""
    return _computed("sweep", study, checked("sweep", SweepArguments, given))


@spelled(OptimizeArguments)
def optimize(study: Scenario, /, **given: Unpack[OptimizeArguments]) -> ResultFile:
    """Find the best placement of pseudolites, as `navsim optimize` does. As `run`."""
    return _computed("optimize", study, checked("optimize", OptimizeArguments, given))


@spelled(Requiring)
def replay(log: Scenario, /, **given: Unpack[Requiring]) -> ResultFile:
    """Fly a recorded flight through the filter, as `navsim replay` does. As `run`."""
    return _computed("replay", log, checked("replay", Requiring, given))


def validate(scenario: Scenario, /, *, set: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Check a scenario, study or log, as `navsim validate` does; returns it with every default written out.

    set: values for keys, dotted. Reads the files that it names; warns as the command does.
    Raises BadInput, with all that is wrong.
    """
    with of_python():
        section, _, heard = opening.checked(_source(scenario, "scenario"), _assignments(set))
        for text in heard:
            warnings.warn(text, NavsimWarning, stacklevel=_CALLER - 1)
        return section.model_dump(mode="json", exclude_none=True)


def schema(kind: str = "landing") -> dict[str, Any]:
    """The JSON Schema of a kind of files. Raises BadInput for a kind there is not."""
    with of_python():
        return opening.schema_of(kind)


def _computed(command: str, scenario: Scenario, asked: dict[str, Any]) -> ResultFile:
    from navsim.core.defect import Defect

    heard: list[str] = []
    with _alone(), of_python():
        try:
            made = _compute_result(command, scenario, asked, heard)
        except Defect as error:
            raise RunFailed(as_problems(error)) from error
    for text in heard:
        warnings.warn(text, NavsimWarning, stacklevel=_CALLER)
    return made


def _compute_result(command: str, scenario: Scenario, asked: dict[str, Any], heard: list[str]) -> ResultFile:
    """The result of a job; heard: takes the warnings."""
    import shutil

    from navsim.results.findings import of
    from navsim.runner.job import Options

    taken = {name: value for name, value in asked.items() if name in Options.__dataclass_fields__}
    options = Options(**taken)
    source = _source(scenario, _NOUNS[command])
    job, suffix = opening.open_job(command, source, _assignments(asked["set"]), options)
    temporary = Path(tempfile.mkdtemp(prefix="navsim-")) if asked["output"] is None else None
    stem = source.stem if isinstance(source, Path) else "result"
    order = steps.JobRequest(options, asked["figures"], True, asked["force"], asked["over_budget"])
    listener = Listener(Reporter(_log.info, heard.append), lambda extent, _: _telling(asked["progress"], extent))
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
    """What the kernels' cache has to tell, where it was used at all."""
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
    """noun: what stands for a mapping in messages."""
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
    """One study at a time in a process: each takes all cores. Others wait; a call out of its own progress cannot."""
    here = threading.get_ident()
    if here in _by:
        raise BadInput(as_problems("a study is computed already; none can be begun from its progress"))
    with _computing:
        _by.append(here)
        try:
            yield
        finally:
            _by.clear()
