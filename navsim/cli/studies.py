"""`navsim sweep`, `navsim optimize`, `navsim table2`, `navsim integrity-table`: studies over many scenarios."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import AT_TERMINAL, leave, leaving
from navsim.cli.exit_status import CHECK_FAILED
from navsim.cli.options import (
    FreshOption,
    JsonOption,
    OutputOptions,
    Required,
    SchedulerOption,
    SeedOption,
    WorkersOption,
    argument,
    choice_option,
    dry_run_option,
    figures_option,
    number_option,
    output_option,
    set_option,
)
from navsim.cli.terminal import TerminalRequest, run_job
from navsim.runner.errors import translate_errors
from navsim.runner.opening import SweepMethod, open_job, target_of
from navsim.runner.target import require_folder

StudyArgument = Annotated[Path, argument("STUDY.yaml", "The study to compute.")]


@dataclass(frozen=True)
class SweepOptions:
    """Input and output of a sweep."""

    output: Annotated[
        Path | None,
        output_option("results/<study stem>.h5, for another method than the study's <stem>_<method>.h5"),
    ] = None
    seed: SeedOption = 1
    runs: Annotated[
        int | None,
        number_option(
            int,
            0,
            "Runs of each combination with method monte-carlo; default: the study's. With method covariance, "
            "runs that verify the best combinations, 0 for none; default: 200.",
        ),
    ] = None
    workers: WorkersOption = None
    scheduler: SchedulerOption = None
    method: Annotated[
        SweepMethod | None,
        choice_option(SweepMethod, "Method for each combination. Default: the study's."),
    ] = None
    set_: Annotated[list[str] | None, set_option("study")] = None
    figures: Annotated[str | None, figures_option()] = None
    dry_run: Annotated[bool, dry_run_option("Check the input, estimate time, memory and disk, and stop.")] = False
    fresh: FreshOption = False
    json_: JsonOption = False


def sweep(study: StudyArgument, given: SweepOptions, required: Required, care: OutputOptions) -> None:
    """Compute every combination of listed settings: table, CSV, maps.

    After an interruption the same command continues from the finished combinations.
    """
    from navsim.runner.job import Options

    options = Options(
        given.seed, given.runs, method=given.method, workers=given.workers, scheduler=given.scheduler,
        fresh=given.fresh, require=required.require,
    )  # fmt: skip
    with leaving():
        job, suffix = open_job("sweep", study, given.set_ or [], options, AT_TERMINAL.warn)
        target = target_of(given.output, study.stem + suffix)
    run_job(study, job, target, TerminalRequest(care, required, options, given.figures, given.dry_run, given.json_))


@dataclass(frozen=True)
class OptimizeOptions:
    """Input and output of an optimisation."""

    output: Annotated[Path | None, output_option("results/<study stem>.h5")] = None
    seed: SeedOption = 1
    workers: Annotated[
        int | None, number_option(int, 1, "Threads of the runs that verify placements. Default: all cores.")
    ] = None
    scheduler: SchedulerOption = None
    set_: Annotated[list[str] | None, set_option("study")] = None
    figures: Annotated[str | None, figures_option()] = None
    time_limit: Annotated[
        float | None,
        number_option(
            float,
            0.0,
            "Stop the search after this time, preparing included, with the best found so far. Default: no limit.",
            most=10**9,
        ),
    ] = None
    runs: Annotated[
        int | None,
        number_option(
            int,
            0,
            "Runs that verify the best placement of each number, 0 for none; default: 200. They come "
            "after --time-limit, too.",
        ),
    ] = None
    dry_run: Annotated[bool, dry_run_option("Check the input, estimate memory and disk, and stop.")] = False
    fresh: FreshOption = False
    json_: JsonOption = False


def optimize(study: StudyArgument, given: OptimizeOptions, care: OutputOptions) -> None:
    """Find the best positions of pseudolites or beacons under constraints.

    The study may ask for several numbers of them. After an interruption the same command continues.
    """
    from navsim.runner.job import Options

    options = Options(
        given.seed, given.runs, workers=given.workers, scheduler=given.scheduler, time_limit=given.time_limit,
        fresh=given.fresh,
    )  # fmt: skip
    with leaving():
        job, suffix = open_job("optimize", study, given.set_ or [], options, AT_TERMINAL.warn)
        target = target_of(given.output, study.stem + suffix)
    run_job(study, job, target, TerminalRequest(care, Required(), options, given.figures, given.dry_run, given.json_))


@dataclass(frozen=True)
class Table2Options:
    """Runs and output of Table 2."""

    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="Folder for the files; created if missing.")
    ] = Path("results")
    seed: SeedOption = 1
    runs: Annotated[int, number_option(int, 1, "Monte Carlo runs of each row.", show_default=True)] = 400
    workers: WorkersOption = None
    dry_run: Annotated[bool, dry_run_option("Check the input, estimate time, memory and disk, and stop.")] = False


def table2(given: Table2Options, care: OutputOptions) -> None:
    """Compute the paper's Table 2 and compare it with the published one.

    navsim exits with code 1 unless the paper's best positions have the lowest PDOP (claim C3), and pseudolites reduce
    the estimation error (C4).
    """
    from navsim.published_tables.table2_job import Table2Job
    from navsim.runner.job import Options

    options = Options(given.seed, given.runs, workers=given.workers)
    with leaving():
        require_folder(given.output)
    wanted = TerminalRequest(care, Required(), options, given.output, given.dry_run)
    result = run_job("table2", Table2Job(given.seed, given.runs), given.output / "table2.h5", wanted)
    if result is None:
        return
    held = dict(zip(result["/claims/claim"], result["/claims/holds"][0], strict=True))
    broken = [name for name in ("C3", "C4") if not held[name]]
    if broken:
        leave(CHECK_FAILED, f"claims that must hold fail: {', '.join(broken)}")


@dataclass(frozen=True)
class IntegrityTableOptions:
    """Input and output of the tables."""

    output: Annotated[Path | None, output_option("results/integrity_table.h5")] = None
    seed: SeedOption = 1
    set_: Annotated[list[str] | None, set_option("scenario")] = None
    dry_run: Annotated[bool, dry_run_option("Check the input, estimate time, memory and disk, and stop.")] = False
    json_: JsonOption = False


def integrity_table(
    given: IntegrityTableOptions,
    care: OutputOptions,
    scenario: Annotated[
        Path | None,
        argument("SCENARIO.yaml", "The landing. Default: the shipped landing.yaml."),
    ] = None,
) -> None:
    """Tabulate what a few satellites and pseudolites allow.

    For each number of sources navsim prints whether the geometry allows a fix, fault detection and fault exclusion,
    and at which share of epochs both protection levels are within the alert limits.
    """
    from navsim.published_tables.integrity_table_job import IntegrityTableJob
    from navsim.runner.job import Options
    from navsim.scenario.load import read
    from navsim.scenario_files import shipped

    file = shipped.path("landing") if scenario is None else scenario
    with leaving(), translate_errors(file):
        job = IntegrityTableJob(*read(file, given.set_ or []), given.seed)
        target = target_of(given.output, "integrity_table")
    run_job(
        file, job, target, TerminalRequest(care, Required(), Options(given.seed), "none", given.dry_run, given.json_)
    )
