"""`navsim run`: one scenario of any kind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from navsim.cli.common import AT_TERMINAL, leaving
from navsim.cli.completion import UNTIL
from navsim.cli.options import (
    FreshOption,
    JsonOption,
    OutputOptions,
    Required,
    ScenarioArgument,
    SchedulerOption,
    SeedOption,
    WorkersOption,
    choice_option,
    dry_run_option,
    figures_option,
    number_option,
    output_option,
    set_option,
    value_option,
)
from navsim.cli.terminal import TerminalRequest, run_job
from navsim.runner.opening import Keep, Method, open_job, target_of


@dataclass(frozen=True)
class RunOptions:
    """Options of `navsim run`."""

    output: Annotated[
        Path | None,
        output_option(
            "results/<scenario stem>.h5; for several runs <stem>_runs<N>.h5 or <stem>_until.h5; for another method "
            "than the scenario's <stem>_<method>.h5"
        ),
    ] = None
    seed: SeedOption = 1
    runs: Annotated[
        int | None,
        number_option(
            int,
            1,
            "Number of runs. Default: 1; with --method rare until the 95 % interval is within 20 % of the "
            "probability on both sides, 20 000 at most; for a companion paper's system the scenario's number.",
        ),
    ] = None
    until: Annotated[
        str | None,
        value_option(
            "EXPR",
            "Run until an interval is narrow: 'rms_horizontal within 2%' or, with --method rare, 'probability "
            "within 10%'. --runs is then the maximum.",
            autocompletion=lambda: UNTIL,
        ),
    ] = None
    first_run: Annotated[
        int | None,
        number_option(int, 0, "Number of the first run. To repeat run 7: --runs 1 --first-run 7. Default: 0."),
    ] = None
    workers: WorkersOption = None
    scheduler: SchedulerOption = None
    keep: Annotated[
        Keep | None,
        choice_option(
            Keep,
            "Data stored of each run: the filter's errors; everything, with measurements and fixes; or statistics "
            "only. Default: all for one run, errors for several.",
        ),
    ] = None
    method: Annotated[
        Method | None,
        choice_option(
            Method,
            "Monte Carlo; linear covariance analysis; or importance sampling for the probability that a landing "
            "leaves the scenario's box. Default: the scenario's.",
        ),
    ] = None
    set_: Annotated[list[str] | None, set_option("scenario")] = None
    figures: Annotated[str | None, figures_option("that of the result; none for several runs or with --quiet")] = None
    dry_run: Annotated[bool, dry_run_option("Check the input, estimate time, memory and disk, and stop.")] = False
    fresh: FreshOption = False
    json_: JsonOption = False


def run(scenario: ScenarioArgument, given: RunOptions, required: Required, care: OutputOptions) -> None:
    """Simulate a scenario: write a result file and figures, print a summary."""
    from navsim.runner.job import Options

    options = Options(
        given.seed, given.runs, given.first_run, given.until, given.keep, given.method, given.workers,
        given.scheduler, fresh=given.fresh,
        require_fix=required.require_fix, require_consistent=required.require_consistent, require=required.require,
    )  # fmt: skip
    with leaving():
        job, suffix = open_job("run", scenario, given.set_ or [], options, AT_TERMINAL.warn)
        target = target_of(given.output, scenario.stem + suffix)
    run_job(scenario, job, target, TerminalRequest(care, required, options, given.figures, given.dry_run, given.json_))
