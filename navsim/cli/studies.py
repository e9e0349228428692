"""`navsim sweep`, `navsim optimize`, `navsim table2`: studies over many scenarios."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from navsim.cli.budget import OverBudgetOption, afford
from navsim.cli.common import (
    FiguresOption,
    ForceOption,
    FreshOption,
    QuietOption,
    SeedOption,
    StudySetOption,
    WorkersOption,
    begin,
    figure_folder,
    leave,
    method_given,
    number_option,
    open_store,
    output_option,
    print_console,
    progress,
    refuse_other,
    save,
    search_progress,
    store_beside,
    target_of,
)
from navsim.cli.ending import BAD_INPUT, CHECK_FAILED, RUN_FAILED, say
from navsim.cli.findings import RequireConsistentOption, RequireFixOption, require, warn

SweepMethod = Literal["dop", "covariance", "monte-carlo"]


def sweep(
    study: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study to compute.", show_default=False)],
    output: Annotated[
        Path | None,
        output_option("results/<study stem>.h5, for another method than the study's <stem>_<method>.h5"),
    ] = None,
    seed: SeedOption = 1,
    runs: Annotated[
        int | None, number_option(int, 1, "Runs of each combination with method monte-carlo. Default: the study's.")
    ] = None,
    workers: WorkersOption = None,
    method: Annotated[
        SweepMethod | None,
        typer.Option(help="How each combination is judged. Default: the study's.", show_default=False),
    ] = None,
    set_: StudySetOption = None,
    figures: FiguresOption = None,
    require_fix: RequireFixOption = False,
    require_consistent: RequireConsistentOption = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, compute nothing.")] = False,
    fresh: FreshOption = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite a result of another kind or method.")] = False,
    over_budget: OverBudgetOption = False,
    quiet: QuietOption = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the best combinations as JSON, and nothing else, on standard output.")
    ] = False,
) -> None:
    """Compute every combination of the listed settings.

    A cube, a table, maps. After a kill the same command goes on from the finished combinations.
    """
    from navsim.io.results import ResultError, Sort
    from navsim.scenario.load import read_study
    from navsim.scenario.source import InputError
    from navsim.scenario.sweep import Sweep
    from navsim.study.partial import PartialError

    assigned, suffix = method_given(study, set_, method)
    extra = [*(set_ or []), *assigned, *([f"runs={runs}"] if runs else [])]
    try:
        section, document, base = read_study(study, Sweep, extra)
        target = target_of(study, output, Sort("sweep", section.method), force, suffix)
        from navsim.core import jit
        from navsim.report import sweep as report
        from navsim.report.views import VIEWS
        from navsim.study import sweep as computing
        from navsim.study.budget.studies import sweep as estimated
        from navsim.study.landing import default_workers

        planned = computing.plan(section, document, base, seed)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    for warning in planned.warnings:
        say(f"warning: {warning}")
    threads = workers or default_workers()
    afford(study, estimated(planned, threads), target, over_budget, shown=dry_run)
    extent = " x ".join(f"{len(axis.points)} {axis.name}" for axis in planned.axes)
    if dry_run:
        say(f"{study}: {planned.size} combinations ({extent}), method {section.method}; would write {target}")
        return
    begin(target)
    drawing = figure_folder(figures, target, 1, quiet)
    store = store_beside(target, computing.partial_key(planned), planned.size, fresh, planned.batch)
    try:
        with progress(planned.size, not quiet, "combinations") as done:
            found = computing.compute(planned, threads, store, done)
        result = computing.sweep_result(planned, found)
        written = save(result, target, drawing)
        table = report.save_csv(result, target.with_suffix(".csv"))
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except (ResultError, PartialError) as error:
        leave(RUN_FAILED, error)
    except KeyboardInterrupt:
        if store is not None:
            say(f"finished combinations are kept in {store.folder}; the same command goes on from there")
        raise
    if store is not None:
        if store.redone:
            say(f"{store.redone} damaged batch(es) of an earlier attempt were computed again")
        store.remove()
    jit.mark_warm()
    if json_:
        import json

        from navsim.report.tables import FINDINGS, plain_tree

        print(json.dumps(report.best_json(result) | plain_tree(result, (FINDINGS,)), indent=1, allow_nan=False))
    elif not quiet:
        print_console(VIEWS["sweep"].console(result), VIEWS["sweep"].width)
        print(f"result   {target}, {table}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")
    warn(result, known=planned.warnings)
    require(result, target, require_fix, require_consistent)


def optimize(
    study: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study to solve.", show_default=False)],
    output: Annotated[Path | None, output_option("results/<study stem>.h5")] = None,
    seed: SeedOption = 1,
    set_: StudySetOption = None,
    figures: FiguresOption = None,
    time_limit: Annotated[
        float | None,
        number_option(float, 0.0, "Stop then, with the best found so far. Default: none.", most=10**9),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, search nothing.")] = False,
    fresh: FreshOption = False,
    force: ForceOption = False,
    over_budget: OverBudgetOption = False,
    quiet: QuietOption = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the placements as JSON, and nothing else, on standard output.")
    ] = False,
) -> None:
    """Find the best placement of pseudolites under constraints.

    For one or several numbers of them. After a kill the same command goes on from what was analysed.
    """
    from navsim.io.results import ResultError, Sort
    from navsim.scenario.load import read_study
    from navsim.scenario.optimize import Optimize
    from navsim.scenario.source import InputError
    from navsim.study.partial import PartialError
    from navsim.study.search import NoPlacement

    try:
        section, document, base = read_study(study, Optimize, set_ or [])
        target = target_of(study, output, Sort("optimize"), force)
        from navsim.core import jit
        from navsim.io.schema import QUANTITIES
        from navsim.report import optimize as report
        from navsim.report.views import VIEWS
        from navsim.study import optimize as searching
        from navsim.study.budget import studies as estimates
        from navsim.study.journal import Journal
        from navsim.study.objective import problem as pose
        from navsim.study.watch import Watch

        if not dry_run:
            begin(target)
        with search_progress(not quiet and not dry_run, QUANTITIES[section.objective][0]) as tell:
            watch = Watch(tell, time_limit)
            needed: list[Any] = []

            def ask(scenario: Any, sources: Any) -> None:
                needed.append(estimates.posing(section, scenario, sources))
                afford(study, needed[0], target, over_budget, shown=False)

            problem = pose(section, document, base, ask)
            for warning in problem.warnings:
                say(f"warning: {warning}")
            if dry_run:
                whole = replace(needed[0], time_s=needed[0].time_s + estimates.search_time(problem))
                afford(study, whole, target, over_budget=True, shown=True, at_most=True)
                say(f"{study}: {section.objective} for {list(section.pseudolites)} pseudolites; would write {target}")
                return
            drawing = figure_folder(figures, target, 1, quiet)
            store = open_store(target, searching.partial_key(problem, seed), fresh)
            outcome = searching.solve(problem, seed, watch, Journal(store))
        result = searching.optimize_result(problem, outcome, seed)
        interrupted = outcome.stopped == searching.INTERRUPTED
        written = save(result, target, None if interrupted else drawing)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except (ResultError, NoPlacement, PartialError) as error:
        leave(RUN_FAILED, error)
    if store.redone:
        say(f"{store.redone} damaged piece(s) of an earlier attempt were computed again")
    if not outcome.stopped:
        store.remove()
    jit.mark_warm()
    if json_:
        import json

        from navsim.report.tables import FINDINGS, plain_tree

        print(json.dumps(report.plain(result) | plain_tree(result, (FINDINGS,)), indent=1, allow_nan=False))
    elif not quiet:
        print_console(VIEWS["optimize"].console(result), VIEWS["optimize"].width)
        print(f"result   {target}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")
    warn(result, known=problem.warnings)
    if outcome.stopped:
        why = "interrupted" if interrupted else f"time limit of {time_limit:g} s"
        say(f"warning: stopped early ({why}); {target} holds the best found; undone: {result.attributes['undone']}")
        say(f"what was analysed is kept in {store.folder}; the same command goes on from there")
    if interrupted:
        raise KeyboardInterrupt


def table2(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the files go, made where it is not there.")
    ] = Path("results"),
    seed: SeedOption = 1,
    runs: Annotated[int, number_option(int, 1, "Monte Carlo runs of each row.", show_default=True)] = 400,
    workers: WorkersOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, fly nothing.")] = False,
    force: ForceOption = False,
    over_budget: OverBudgetOption = False,
    quiet: QuietOption = False,
) -> None:
    """Set the paper's Table 2 beside the computed one.

    Exit code 1 when claim C3 or the direction of C4 fails.
    """
    from navsim.core import jit
    from navsim.io.results import ResultError, Sort, check_writable, write
    from navsim.report.table2 import save as save_tables
    from navsim.report.views import VIEWS
    from navsim.study import table2 as study
    from navsim.study.budget.studies import tables
    from navsim.study.landing import default_workers

    try:
        check_writable(output / "table2.h5")
        refuse_other(output / "table2.h5", Sort("table2"), force)
    except ResultError as error:
        leave(BAD_INPUT, error)
    threads = workers or default_workers()
    afford("table2", tables(runs, threads), output / "table2.h5", over_budget, shown=dry_run)
    if dry_run:
        rows = len(study.CALIBRATIONS) * len(study.ROWS)
        say(f"table2: {rows} rows of {runs} run(s); would write {output}/table2.h5")
        return
    begin(output / "table2.h5")
    with progress(len(study.CALIBRATIONS) * len(study.ROWS), not quiet, "rows") as done:
        found = study.compute_all(seed, runs, threads, done)
    result = study.result(found, seed, runs)
    try:
        write(output / "table2.h5", result)
        written = save_tables(result, output)
    except ResultError as error:
        leave(RUN_FAILED, error)
    if not quiet:
        print_console(VIEWS["table2"].console(result), VIEWS["table2"].width)
        print(f"files    {output}/table2.h5, {', '.join(path.name for path in written)}")
    warn(result)
    jit.mark_warm()
    held = dict(zip(result["/claims/claim"], result["/claims/holds"][0], strict=True))
    broken = [name for name in ("C3", "C4") if not held[name]]
    if broken:
        leave(CHECK_FAILED, f"claims that must hold fail: {', '.join(broken)}")
