"""`navsim run`: one scenario of any kind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from navsim.cli.budget import OverBudgetOption, afford
from navsim.cli.common import (
    MOST,
    MOST_RUNS,
    FreshOption,
    JsonOption,
    QuietOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    WorkersOption,
    begin,
    figure_folder,
    leave,
    method_given,
    number_option,
    output_option,
    print_result,
    print_summary,
    progress,
    read,
    save,
    store_beside,
    target_of,
)
from navsim.cli.ending import BAD_INPUT, RUN_FAILED, say
from navsim.cli.findings import RequireConsistentOption, RequireFixOption, require, warn

Keep = Literal["errors", "all", "none"]
Method = Literal["monte-carlo", "covariance"]


def run(
    scenario: ScenarioArgument,
    output: Annotated[
        Path | None,
        output_option(
            "results/<scenario stem>.h5; for several runs <stem>_runs<N>.h5 or <stem>_until.h5; for another method "
            "than the scenario's <stem>_<method>.h5"
        ),
    ] = None,
    seed: SeedOption = 1,
    runs: Annotated[
        int | None,
        number_option(int, 1, "Number of Monte Carlo runs. Default: 1; of a companion paper's system: the scenario's."),
    ] = None,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="EXPR",
            help="Stop once an interval is narrow, as in 'rms_horizontal within 2%'; --runs is then the most.",
            show_default=False,
        ),
    ] = None,
    first_run: Annotated[
        int,
        number_option(int, 0, "Number of the first run; run 7 alone: --runs 1 --first-run 7.", show_default=True),
    ] = 0,
    workers: WorkersOption = None,
    keep: Annotated[
        Keep | None,
        typer.Option(
            help="What is stored per run: the filter's errors, also measurements and fixes, or the statistics alone. "
            "Default: all for one run, errors for several.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        Method | None,
        typer.Option(
            help="Fly runs, or compute their accuracy to first order. Default: the scenario's.",
            show_default=False,
        ),
    ] = None,
    set_: SetOption = None,
    figures: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|none",
            help="Where figures go, made where it is not there. Default: beside the result; none for several runs or "
            "with --quiet.",
            show_default=False,
        ),
    ] = None,
    require_fix: RequireFixOption = False,
    require_consistent: RequireConsistentOption = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, fly nothing.")] = False,
    fresh: FreshOption = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Overwrite a result of another kind or method, one run by several or the reverse."
        ),
    ] = False,
    over_budget: OverBudgetOption = False,
    quiet: QuietOption = False,
    json_: JsonOption = False,
) -> None:
    """Fly a scenario: result file, summary table, figures."""
    from navsim.io.results import ONE_RUN, SEVERAL_RUNS, Sort

    assigned, suffix = method_given(scenario, set_, method)
    checked, document = read(scenario, [*(set_ or []), *assigned])
    if checked.kind != "landing":  # one of the companion papers' systems
        given = {"--until": until, "--keep": keep, "--method": method, "--first-run": first_run, "--workers": workers,
                 "--fresh": fresh}  # fmt: skip
        foreign = [name for name, value in given.items() if value]
        if foreign or require_fix:
            named = ", ".join(foreign or ["--require-fix"])
            leave(BAD_INPUT, f"{named}: only for `kind: landing`; {scenario} is of kind {checked.kind}")
        target = target_of(scenario, output, Sort(checked.kind), force)
        _run_companion(
            scenario, checked, target, seed, runs, figures, dry_run, require_consistent, over_budget, quiet, json_
        )
        return
    analytic = checked.method == "covariance"
    if analytic:
        given = {"--runs": runs, "--until": until, "--keep": keep, "--first-run": first_run, "--workers": workers,
                 "--fresh": fresh}  # fmt: skip
        foreign = [name for name, value in given.items() if value]
        if foreign:
            leave(BAD_INPUT, f"{', '.join(foreign)}: only for method monte-carlo; a covariance analysis has no runs")
    runs = runs or (1 if until is None else MOST_RUNS)
    if first_run > MOST - runs:
        leave(BAD_INPUT, f"--first-run {first_run}: the last of {runs} run(s) would have a number beyond {MOST}")
    kept = keep or ("all" if runs == 1 else "errors")
    if runs > 1:
        suffix = f"_runs{runs}" if until is None else "_until"
    extent = "" if analytic else SEVERAL_RUNS if runs > 1 else ONE_RUN
    target = target_of(scenario, output, Sort("landing", checked.method, extent), force, suffix)
    drawing = figure_folder(figures, target, runs, quiet)

    from navsim.core import jit
    from navsim.io.results import ResultError
    from navsim.scenario.source import InputError
    from navsim.study import landing
    from navsim.study.budget.landing import landing as estimated
    from navsim.study.partial import PartialError

    threads = workers or landing.default_workers()

    def ask(section: Any, sources: Any) -> None:
        budget = estimated(section, sources, runs, kept, threads)
        afford(scenario, budget, target, over_budget, shown=dry_run, at_most=until is not None)

    try:
        enough = landing.stopping_rule(until) if until is not None else None
    except ValueError as error:
        leave(BAD_INPUT, f"--until {error}")
    if not dry_run:
        begin(target)
    try:
        case = landing.prepare(checked, document, ask)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    if dry_run:
        for warning in case.warnings:
            say(f"warning: {warning}")
        sources = len(case.world.signals.names)
        what = "covariance analysis" if analytic else f"{runs} run(s)"
        say(
            f"{scenario}: {what} of {case.scenario.duration_s:g} s, {case.world.dtheta.shape[0]} IMU samples, "
            f"{case.world.signals.time.size} fix epochs, {sources} sources; would write {target}"
        )
        return
    store = (
        None if analytic else store_beside(target, landing.partial_key(case, seed, first_run, runs, kept), runs, fresh)
    )
    try:
        if analytic:
            result = landing.covariance_result(case, landing.covariance_analysis(case), seed)
        else:
            with progress(runs, not quiet) as done:
                ensemble = landing.fly_all(
                    case, seed, first_run, runs, threads, keep=kept, store=store, done=done, enough=enough
                )
            if enough is not None and not enough(ensemble):
                say(f"warning: --until {until}: not reached within {runs} runs")
            result = landing.result(case, ensemble, seed, keep=kept)
        written = save(result, target, drawing)
    except (ResultError, PartialError) as error:
        leave(RUN_FAILED, error)
    except KeyboardInterrupt:
        if store is not None:
            say(f"finished runs are kept in {store.folder}; the same command goes on from there")
        raise
    if store is not None:
        if store.redone:
            say(f"{store.redone} damaged batch(es) of an earlier attempt were flown again")
        store.remove()
    jit.mark_warm()

    print_summary(result, str(target.stem), quiet, json_)
    if not quiet and not json_:
        print(f"result   {target}")
        if written:
            names = ",".join(path.stem.removeprefix(f"{target.stem}_") for path in written)
            print(f"figures  {drawing}/{target.stem}_{{{names}}}.png")
    warn(result)
    require(result, target, require_fix, require_consistent)


def _run_companion(
    scenario: Path,
    checked: Any,
    target: Path,
    seed: int,
    runs: int | None,
    figures: str | None,
    dry_run: bool,
    require_consistent: bool,
    over_budget: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """One of the companion papers' systems: computed, written, shown."""
    from navsim.core import jit
    from navsim.io.results import ResultError
    from navsim.study.budget.companions import COMPANIONS as ESTIMATES
    from navsim.study.companions import COMPANIONS

    drawing = figure_folder(figures, target, 1, quiet)
    afford(scenario, ESTIMATES[checked.kind](checked, runs), target, over_budget, shown=dry_run)
    if dry_run:
        say(f"{scenario}: a study of kind {checked.kind}; would write {target}")
        return
    begin(target)
    companion = COMPANIONS[checked.kind]
    try:
        with progress(companion.extent(checked), not quiet, companion.unit) as done:
            result = companion.compute(checked, seed, runs, done)
        written = save(result, target, drawing)
    except ResultError as error:
        leave(RUN_FAILED, error)
    jit.mark_warm()
    print_result(result, target, written, quiet, as_json, companion.summary)
    warn(result)
    require(result, target, False, require_consistent)
