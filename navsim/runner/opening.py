"""From a file, or its contents, to its job."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from navsim.runner.errors import BadInput, as_problems, translate_errors, translate_input_errors

if TYPE_CHECKING:
    from navsim.runner.job import Job, Options
    from navsim.scenario.load import Assignment, Source
    from navsim.scenario_files.base import Section
    from navsim.scenario_files.source import Document


Keep = Literal["errors", "all", "none"]
"""Data kept per run."""
Method = Literal["monte-carlo", "covariance", "rare"]
"""Method of a landing."""
SweepMethod = Literal["dop", "covariance", "monte-carlo"]
"""Method of a sweep for each combination."""


def scenario_instead(path: Path) -> str:
    """For a file that is not a result but a scenario or study: the command that takes it, and its results in
    `results/`; "" otherwise."""
    from navsim.kinds import OF_FILES, advice
    from navsim.scenario_files.source import InputError, load

    if path.suffix not in (".yaml", ".yml"):
        return ""
    try:
        kind = str(load(path).data.get("kind"))
    except InputError:  # not even YAML: another message explains why it is no result
        return ""
    if kind not in OF_FILES:
        return ""
    made = Path("results", f"{path.stem}.h5")
    return f"{path}: is not a result but {advice(kind, path)}" + (f"; its result is {made}" if made.is_file() else "")


def open_job(
    command: str, source: Source, assignments: Sequence[Assignment], options: Options, warn: Callable[[str], None]
) -> tuple[Job, str]:
    """Job of `command`, and the suffix of its result's name if it does not use the file's own method.

    warn: receives warnings about former names of keys. Raises BadInput.
    """
    from navsim.kinds import KINDS, named
    from navsim.scenario.load import own_method, read_for
    from navsim.scenario_files.source import Setting

    given, suffix = [*assignments], ""
    with translate_errors(source):
        if options.method is not None and (own := own_method(source, assignments)) is not None:
            given.append(Setting("method", options.method))
            suffix = "" if own == options.method else f"_{options.method}"
        if command == "sweep" and options.runs:  # 0 is of the runs that verify, which no study counts
            given.append(Setting("runs", options.runs))
        section, document = read_for(command, source, given)
        job: Job = named(KINDS[document.data["kind"]].job)(section, document, options)
        for text in document.renamed:
            warn(text)
    return job, job.suffix or suffix


def checked(source: Source, assignments: Sequence[Assignment]) -> tuple[Section, Document, list[str]]:
    """A scenario, study or log checked as far as possible without computing it, and warnings about unused or omitted
    input.

    It also reads the files that it names. Raises BadInput.
    """
    from navsim.kinds import KINDS, named
    from navsim.scenario.load import read_any

    with translate_input_errors():
        section, document = read_any(source, assignments)
        check = KINDS[document.data["kind"]].check
        warnings = named(check)(section, document) if check else []  # it reads a study's base, whose keys may be former
        return section, document, [*document.renamed, *warnings]


def target_of(output: Path | None, default: str) -> Path:
    """The result's path: as given, else results/<default>.h5. Raises BadInput as `require_folder`, and for a name that
    ends like another format."""
    from navsim.runner.errors import BadInput, as_problems
    from navsim.runner.target import require_folder

    if output is not None:
        require_folder(output)
        if output.suffix[1:].isalpha() and output.suffix != ".nc":
            name, made = output.with_suffix(".h5"), "a result is an HDF5 file (NetCDF-4)"
            raise BadInput(as_problems(f"-o/--output {output}: {made}; write {name}"))
    return output or Path("results") / f"{default}.h5"


def stem_of_log(log: Path) -> str:
    """Stem of a replay's result. Imports name every log log.yaml: those in folders X_log, as `navsim import` makes, do
    not replace each other's results."""
    folder = log.resolve().parent.name
    return f"{folder.removesuffix('_log')}_{log.stem}" if folder.endswith("_log") else log.stem


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON Schema of files of a kind, or of `any`. Raises BadInput."""
    from navsim.kinds import OF_FILES
    from navsim.scenario_files.base import hint
    from navsim.scenario_files.json_schema import ANY, published

    if kind not in (*OF_FILES, ANY):
        raise BadInput(as_problems(f"{kind!r} is not a kind of scenario; {hint(kind, [*OF_FILES, ANY])}"))
    return published(kind)
