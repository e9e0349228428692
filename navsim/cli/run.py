"""`navsim run`: one scenario of any kind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.carry_out import Wanted, carry_out
from navsim.cli.common import leaving
from navsim.cli.options import (
    Care,
    FreshOption,
    JsonOption,
    Required,
    ScenarioArgument,
    SchedulerOption,
    SeedOption,
    WorkersOption,
    dry_run_option,
    figures_option,
    number_option,
    output_option,
    set_option,
)
from navsim.work.opening import Keep, Method, opened, target_of


@dataclass(frozen=True)
class RunOptions:
    """What is flown, and where it goes."""

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
            "Number of runs. Default: 1; with method rare enough for 20 %; of a companion paper's system: the "
            "scenario's.",
        ),
    ] = None
    until: Annotated[
        str | None,
        typer.Option(
            metavar="EXPR",
            help="Stop once an interval is narrow, as in 'rms_horizontal within 2%' or, with method rare, 'probability "
            "within 10%'; --runs is then the most.",
            show_default=False,
        ),
    ] = None
    first_run: Annotated[
        int | None,
        number_option(int, 0, "Number of the first run; run 7 alone: --runs 1 --first-run 7. Default: 0."),
    ] = None
    workers: WorkersOption = None
    scheduler: SchedulerOption = None
    keep: Annotated[
        Keep | None,
        typer.Option(
            help="What is stored per run: the filter's errors, also measurements and fixes, or the statistics alone. "
            "Default: all for one run, errors for several.",
            show_default=False,
        ),
    ] = None
    method: Annotated[
        Method | None,
        typer.Option(
            help="Fly runs; compute their accuracy to first order; or fly runs that are pushed towards the edge of the "
            "scenario's box, for the probability of leaving it. Default: the scenario's.",
            show_default=False,
        ),
    ] = None
    set_: Annotated[list[str] | None, set_option("scenario")] = None
    figures: Annotated[str | None, figures_option("for several runs or with --quiet")] = None
    dry_run: Annotated[bool, dry_run_option("Check everything, fly nothing.")] = False
    fresh: FreshOption = False
    json_: JsonOption = False


def run(scenario: ScenarioArgument, given: RunOptions, required: Required, care: Care) -> None:
    """Fly a scenario: result file, summary table, figures."""
    from navsim.study.job import Options

    options = Options(
        given.seed, given.runs, given.first_run, given.until, given.keep, given.method, given.workers,
        given.scheduler, fresh=given.fresh,
        require_fix=required.require_fix, require_consistent=required.require_consistent, require=required.require,
    )  # fmt: skip
    with leaving():
        job, suffix = opened("run", scenario, given.set_ or [], options)
        target = target_of(given.output, scenario.stem + suffix)
    carry_out(scenario, job, target, Wanted(care, required, options, given.figures, given.dry_run, given.json_))
