"""`navsim merge`: results of parts of one ensemble put together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import leave, leaving, read_result
from navsim.cli.exit_status import BAD_INPUT
from navsim.cli.options import (
    JsonOption,
    OutputOptions,
    Required,
    argument,
    dry_run_option,
    figures_option,
    value_option,
)
from navsim.cli.terminal import TerminalRequest, run_job
from navsim.runner.errors import translate_errors
from navsim.runner.opening import target_of


@dataclass(frozen=True)
class MergeOptions:
    """Output of the merge."""

    output: Annotated[Path, value_option("FILE.h5", "The result file.", "--output", "-o")]
    folder: Annotated[
        Path,
        typer.Option(metavar="FOLDER", help="Folder of the files that the scenario names, such as orbits."),
    ] = Path()
    figures: Annotated[str | None, figures_option("that of the result; none unless this option is given")] = None
    dry_run: Annotated[bool, dry_run_option("Check that the parts fit, then stop.")] = False
    json_: JsonOption = False


def merge(
    parts: Annotated[
        list[Path],
        argument("PART.h5", "Results of `navsim run --first-run K --runs N`."),
    ],
    given: MergeOptions,
    required: Required,
    care: OutputOptions,
) -> None:
    """Merge partial ensembles into one result, identical to a single run of all.

    The parts must have the same scenario, seed and --keep, and contain each run once, in any order.
    """
    from navsim.landing.merge_job import MergeJob
    from navsim.runner.job import Options

    results = [(file, read_result(file)) for file in parts]
    with leaving():
        target = target_of(given.output, given.output.stem)
    for file in parts:
        if target.exists() and target.samefile(file):
            leave(BAD_INPUT, f"{file}: is one of the parts; choose another -o/--output")
    with leaving(), translate_errors(target):
        job = MergeJob(results, given.folder.absolute())
    wanted = TerminalRequest(care, required, Options(), given.figures, given.dry_run, given.json_)
    run_job(target, job, target, wanted)
