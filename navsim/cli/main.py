"""The `navsim` command. Heavy imports happen inside the commands, so that `--help` answers at once."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

MOST_RUNS = 1_000_000
"""Where `--until` gives up, unless --runs says otherwise."""

OK, CHECK_FAILED, BAD_INPUT, RUN_FAILED, INTERRUPTED = 0, 1, 2, 3, 130

app = typer.Typer(
    name="navsim",
    help="Plan and prove a landing navigation system: INS corrected by GNSS and ground pseudolites.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ScenarioArgument = Annotated[
    Path, typer.Argument(metavar="SCENARIO.yaml", help="The scenario to read.", show_default=False)
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set a scenario key, dotted; may be given many times.",
        show_default=False,
    ),
]
FiguresOption = Annotated[
    str | None,
    typer.Option(
        metavar="FOLDER|none",
        help="Where figures go. Default: beside the result for one run.",
        show_default=False,
    ),
]


WorkersOption = Annotated[int | None, typer.Option(min=1, help="Threads. Default: all cores.", show_default=False)]
SeedOption = Annotated[int, typer.Option(min=0, help="Root of all random numbers.")]
FreshOption = Annotated[bool, typer.Option("--fresh", help="Discard partial work of an earlier attempt.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")]


def say(message: str) -> None:
    """Tell the person at the terminal something; standard output is for results alone."""
    print(message, file=sys.stderr)


def leave(code: int, *messages: object) -> NoReturn:
    """End with an exit code and messages on standard error."""
    for message in messages:
        say(f"error: {message}")
    raise typer.Exit(code)


def _version(wanted: bool) -> None:
    if wanted:
        import navsim

        print(f"navsim {navsim.__version__}")
        raise typer.Exit(OK)


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    pass


@contextmanager
def _progress(total: int, shown: bool, what: str = "runs") -> Iterator[Callable[[int], None]]:
    """A progress bar over `total` of something on standard error, or nothing."""
    if not shown or total < 2 or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def _read(scenario: Path, assignments: list[str] | None) -> Any:
    from navsim.scenario.load import read_runnable
    from navsim.scenario.source import InputError

    try:
        return read_runnable(scenario, assignments or [])
    except InputError as error:
        leave(BAD_INPUT, *error.problems)


def _target(scenario: Path, output: Path | None, kind: str = "landing") -> Path:
    """The result's path, found writable and free of other people's data before anything is computed."""
    from navsim.io.results import ResultError, check_writable, read_kind

    target = output or Path("results") / f"{scenario.stem}.h5"
    try:
        if output is not None and not target.parent.is_dir():
            raise ResultError(f"{target.parent}: no such folder; create it first or choose another -o/--output")
        check_writable(target)
        if target.exists():
            there = read_kind(target)
            if there != kind:
                raise ResultError(f"{target}: holds a result of kind {there}, not {kind}; it will not be overwritten")
    except ResultError as error:
        leave(BAD_INPUT, error)
    return target


@app.command()
def run(
    scenario: ScenarioArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE.h5",
            help="Result file. Default: results/<scenario stem>.h5.",
            show_default=False,
        ),
    ] = None,
    seed: SeedOption = 1,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Number of Monte Carlo runs. Default: 1.", show_default=False)
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
        int, typer.Option(min=0, help="Number of the first run; run 7 alone: --runs 1 --first-run 7.")
    ] = 0,
    workers: WorkersOption = None,
    keep: Annotated[
        str | None,
        typer.Option(
            metavar="errors|all|none",
            help="What is stored per run. Default: all for one run, errors for several.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="monte-carlo|covariance",
            help="Fly runs, or compute their accuracy to first order. Default: the scenario's.",
            show_default=False,
        ),
    ] = None,
    set_: SetOption = None,
    figures: FiguresOption = None,
    require_fix: Annotated[bool, typer.Option("--require-fix", help="Exit 3 where any epoch has no fix.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, fly nothing.")] = False,
    fresh: FreshOption = False,
    quiet: QuietOption = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON, and nothing else, on stdout.")
    ] = False,
) -> None:
    """Fly a scenario and write its result file, the summary table and the figures."""
    checked, document = _read(scenario, [*(set_ or []), *([f"method={method}"] if method else [])])
    if checked.kind != "landing":  # one of the companion papers' systems
        given = {"--until": until, "--keep": keep, "--method": method, "--first-run": first_run, "--workers": workers}
        foreign = [name for name, value in given.items() if value]
        if foreign or require_fix:
            named = ", ".join(foreign or ["--require-fix"])
            leave(BAD_INPUT, f"{named}: only for `kind: landing`; {scenario} is of kind {checked.kind}")
        _run_companion(scenario, checked, _target(scenario, output, checked.kind), seed, runs, figures, dry_run, quiet,
                       json_)  # fmt: skip
        return
    analytic = checked.method == "covariance"
    if analytic and (runs or until or keep):
        leave(BAD_INPUT, "--runs, --until and --keep belong to method monte-carlo; a covariance analysis has no runs")
    runs = runs or (1 if until is None else MOST_RUNS)
    kept = keep or ("all" if runs == 1 else "errors")
    if kept not in ("errors", "all", "none"):
        leave(BAD_INPUT, f"--keep {keep}: allowed are errors, all, none")
    target = _target(scenario, output)
    drawing = _figure_folder(figures, target, runs, quiet)

    from navsim.core import jit
    from navsim.io.results import ResultError, write
    from navsim.scenario.source import InputError
    from navsim.study import landing
    from navsim.study.ensemble import PartialError

    try:
        enough = landing.stopping_rule(until) if until is not None else None
    except ValueError as error:
        leave(BAD_INPUT, f"--until {error}")
    if not dry_run:
        _announce_compiling()
    try:
        case = landing.prepare(checked, document)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    if dry_run:
        for warning in case.warnings:
            say(f"warning: {warning}")
        sources = len(case.world.signals.names)
        extent = "covariance analysis" if analytic else f"{runs} run(s)"
        say(
            f"{scenario}: {extent} of {case.scenario.duration_s:g} s, {case.world.dtheta.shape[0]} IMU samples, "
            f"{case.world.signals.time.size} fix epochs, {sources} sources; would write {target}"
        )
        return
    store = None if analytic else _store(target, landing.partial_key(case, seed, first_run, runs, kept), runs, fresh)
    try:
        if analytic:
            found = landing.fix_findings(case)
            result = landing.covariance_result(case, landing.covariance_analysis(case), seed)
        else:
            with _progress(runs, not quiet) as done:
                threads = workers or landing.default_workers()
                ensemble = landing.fly_all(
                    case, seed, first_run, runs, threads, keep=kept, store=store, done=done, enough=enough
                )
            if enough is not None and not enough(ensemble):
                say(f"warning: --until {until}: not reached within {runs} runs")
            found = landing.findings(case, ensemble)
            result = landing.result(case, ensemble, seed, keep=kept)
        write(target, result)
        written = _draw(result, drawing, target.stem)
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

    _print_summary(result, str(target.stem), quiet, json_)
    if not quiet and not json_:
        print(f"result   {target}")
        if written:
            names = ",".join(path.stem.removeprefix(f"{target.stem}_") for path in written)
            print(f"figures  {drawing}/{target.stem}_{{{names}}}.png")
    for warning in found:
        say(f"warning: {warning}")
    if found:
        say(f"{len(found)} warning(s)")
    lost = case.world.signals.time[case.world.dop[:, 1] != case.world.dop[:, 1]]
    if require_fix and lost.size:
        leave(
            RUN_FAILED,
            f"--require-fix: {lost.size} epochs without a fix, the first at {lost[0]:g} s ({target} is complete)",
        )


def _announce_compiling() -> None:
    """Say why the first run ever takes longer."""
    from navsim.core import jit

    if not jit.is_warm():
        say(f"compiling the kernels, once, about 15 s; kept in {jit.cache_place()}")


def _draw(result: Any, folder: Path | None, stem: str) -> list[Path]:
    """The figures of a result, where they are wanted. Raises ResultError."""
    if folder is None:
        return []
    from navsim.report.views import save

    return save(result, folder, stem)


def _run_companion(
    scenario: Path,
    checked: Any,
    target: Path,
    seed: int,
    runs: int | None,
    figures: str | None,
    dry_run: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """One of the companion papers' systems: computed, written, shown."""
    from navsim.core import jit
    from navsim.io.results import ResultError, write
    from navsim.report.views import VIEWS
    from navsim.study.companions import COMPANIONS

    drawing = _figure_folder(figures, target, 1, quiet)
    if dry_run:
        say(f"{scenario}: a study of kind {checked.kind}; would write {target}")
        return
    _announce_compiling()
    companion = COMPANIONS[checked.kind]
    try:
        with _progress(companion.extent(checked), not quiet, companion.unit) as done:
            result = companion.compute(checked, seed, runs, done)
        write(target, result)
        written = _draw(result, drawing, target.stem)
    except ResultError as error:
        leave(RUN_FAILED, error)
    jit.mark_warm()
    if as_json:
        import json

        from navsim.report.tables import plain_tree

        print(json.dumps(plain_tree(result, companion.summary), indent=1, allow_nan=False))
    elif not quiet:
        _print(VIEWS[checked.kind].console(result), VIEWS[checked.kind].width)
        print(f"result   {target}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")


def _store(target: Path, key: dict[str, Any], runs: int, fresh: bool, batch: int | None = None) -> Any:
    """The place for partial work beside the result; None for a study of a single batch."""
    from navsim.study.ensemble import BATCH, PartialError, Store

    folder = target.with_name(f"{target.name}.partial")
    if runs <= (batch or BATCH) and not folder.exists():
        return None
    try:
        return Store(folder, key, fresh)
    except PartialError as error:
        leave(BAD_INPUT, error)


def _figure_folder(figures: str | None, target: Path, runs: int, quiet: bool) -> Path | None:
    if figures == "none" or (figures is None and (runs > 1 or quiet)):
        return None
    folder = target.parent if figures is None else Path(figures)
    if folder.exists() and not folder.is_dir():
        leave(BAD_INPUT, f"--figures {folder}: is a file, not a folder")
    return folder


def _print_summary(result: Any, name: str, quiet: bool, as_json: bool) -> None:
    from navsim.report import tables

    if as_json:
        import json

        print(json.dumps(tables.summary_json(result), indent=1, allow_nan=False))
    elif not quiet:
        _print_table([(name, result)])


def _lacks(result: Any, name: object, error: KeyError) -> str:
    """What to say of a result file without a variable that its kind has today."""
    version = result.attributes["navsim_version"]
    return f"{name}: has no {error.args[0]}; it was written by navsim {version}, compute it again with this version"


def _print_table(results: list[tuple[str, Any]]) -> None:
    from navsim.report.tables import summary_table
    from navsim.report.views import VIEWS

    kinds = {str(result.attributes["kind"]) for _, result in results}
    if len(kinds) > 1:
        leave(BAD_INPUT, f"results of different kinds do not stand side by side: {', '.join(sorted(kinds))}")
    view = VIEWS.get(kinds.pop())
    if view is None:
        _print(summary_table(results), 52 + 40 * len(results))
        return
    for name, result in results:
        print(name)
        _print(view.console(result), view.width)


def _print(table: Any, width: int) -> None:
    """Print a table, in this width where there is no terminal to ask for its own."""
    from rich.console import Console

    Console(width=None if sys.stdout.isatty() else width, highlight=False).print(table)


OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", metavar="FILE.h5", help="Result file. Default: results/<study stem>.h5.", show_default=False
    ),
]


@app.command()
def sweep(
    study: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study to compute.", show_default=False)],
    output: OutputOption = None,
    seed: SeedOption = 1,
    runs: Annotated[
        int | None,
        typer.Option(min=1, help="Monte Carlo runs a combination. Default: the study's.", show_default=False),
    ] = None,
    workers: WorkersOption = None,
    method: Annotated[
        str | None,
        typer.Option(metavar="dop|covariance|monte-carlo", help="Default: the study's.", show_default=False),
    ] = None,
    set_: SetOption = None,
    figures: FiguresOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, compute nothing.")] = False,
    fresh: FreshOption = False,
    quiet: QuietOption = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the best combinations as JSON, and nothing else, on stdout.")
    ] = False,
) -> None:
    """Compute every combination of the listed settings: a cube, a table, maps. Resumable after a kill."""
    from navsim.scenario.load import read_study
    from navsim.scenario.source import InputError
    from navsim.scenario.sweep import Sweep

    extra = [*(set_ or []), *([f"method={method}"] if method else []), *([f"runs={runs}"] if runs else [])]
    try:
        section, document, base = read_study(study, Sweep, extra)
        target = _target(study, output, "sweep")
        from navsim.core import jit
        from navsim.io.results import ResultError, write
        from navsim.report import sweep as report
        from navsim.study import sweep as computing
        from navsim.study.ensemble import PartialError
        from navsim.study.landing import default_workers

        planned = computing.plan(section, document, base, seed)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    extent = " x ".join(f"{len(axis.points)} {axis.name}" for axis in planned.axes)
    if dry_run:
        say(f"{study}: {planned.size} combinations ({extent}), method {section.method}; would write {target}")
        return
    _announce_compiling()
    drawing = _figure_folder(figures, target, 1, quiet)
    store = _store(target, computing.partial_key(planned), planned.size, fresh, planned.batch)
    try:
        with _progress(planned.size, not quiet, "combinations") as done:
            found = computing.compute(planned, workers or default_workers(), store, done)
        result = computing.sweep_result(planned, found)
        write(target, result)
        table = report.save_csv(result, target.with_suffix(".csv"))
        written = _draw(result, drawing, target.stem)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except (ResultError, PartialError) as error:
        leave(RUN_FAILED, error)
    except KeyboardInterrupt:
        say(f"finished combinations are kept in {target}.partial; the same command goes on from there")
        raise
    if store is not None:
        if store.redone:
            say(f"{store.redone} damaged batch(es) of an earlier attempt were computed again")
        store.remove()
    jit.mark_warm()
    if json_:
        import json

        print(json.dumps(report.best_json(result), indent=1, allow_nan=False))
    elif not quiet:
        _print(report.console(result), 150)
        print(f"result   {target}, {table}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")
    refused = int(result.attributes["refused"])
    if refused:
        say(f"warning: {refused} of {planned.size} combinations are no valid scenario or have no solution: nan")


@app.command()
def optimize(
    study: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study to solve.", show_default=False)],
    output: OutputOption = None,
    seed: SeedOption = 1,
    set_: SetOption = None,
    figures: FiguresOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check everything, search nothing.")] = False,
    quiet: QuietOption = False,
    json_: Annotated[
        bool, typer.Option("--json", help="Print the placements as JSON, and nothing else, on stdout.")
    ] = False,
) -> None:
    """Find the best placement of pseudolites under constraints, for one or several numbers of them."""
    from navsim.scenario.load import read_study
    from navsim.scenario.optimize import Optimize
    from navsim.scenario.source import InputError

    try:
        section, document, base = read_study(study, Optimize, set_ or [])
        target = _target(study, output, "optimize")
        from navsim.core import jit
        from navsim.io.results import ResultError, write
        from navsim.report import optimize as report
        from navsim.study import optimize as searching

        if not dry_run:
            _announce_compiling()
        problem = searching.problem(section, document, base)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    if dry_run:
        say(f"{study}: {section.objective} for {list(section.pseudolites)} pseudolites; would write {target}")
        return
    drawing = _figure_folder(figures, target, 1, quiet)
    try:
        with _progress(len(section.pseudolites), not quiet, "numbers of pseudolites") as done:
            found = searching.search(problem, seed, done)
        result = searching.optimize_result(problem, found, seed)
        write(target, result)
        written = _draw(result, drawing, target.stem)
    except (ResultError, searching.NoPlacement) as error:
        leave(RUN_FAILED, error)
    jit.mark_warm()
    if json_:
        import json

        print(json.dumps(report.plain(result), indent=1, allow_nan=False))
    elif not quiet:
        _print(report.console(result), 140)
        print(f"result   {target}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")


@app.command()
def table2(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the files go.")] = Path(
        "results"
    ),
    seed: SeedOption = 1,
    runs: Annotated[int, typer.Option(min=1, help="Monte Carlo runs a row.")] = 400,
    workers: WorkersOption = None,
    quiet: QuietOption = False,
) -> None:
    """Set the paper's Table 2 beside the computed one; exit 1 when claim C3 or the direction of C4 fails."""
    from navsim.core import jit
    from navsim.io.results import ResultError, check_writable, write
    from navsim.report.table2 import console, save
    from navsim.study import table2 as study
    from navsim.study.landing import default_workers

    try:
        check_writable(output / "table2.h5")
    except ResultError as error:
        leave(BAD_INPUT, error)
    _announce_compiling()
    with _progress(len(study.CALIBRATIONS) * len(study.ROWS), not quiet, "rows") as done:
        found = study.compute_all(seed, runs, workers or default_workers(), done)
    result = study.result(found, seed, runs)
    try:
        write(output / "table2.h5", result)
        written = save(result, output)
    except ResultError as error:
        leave(RUN_FAILED, error)
    if not quiet:
        _print(console(result), 170)
        print(f"files    {output}/table2.h5, {', '.join(path.name for path in written)}")
    jit.mark_warm()
    held = dict(zip(result["/claims/claim"], result["/claims/holds"][0], strict=True))
    broken = [name for name in ("C3", "C4") if not held[name]]
    if broken:
        leave(CHECK_FAILED, f"claims that must hold fail: {', '.join(broken)}")


@app.command()
def show(
    files: Annotated[list[Path], typer.Argument(metavar="RESULT.h5 [MORE]", help="Result files.", show_default=False)],
    json_: Annotated[bool, typer.Option("--json", help="Print the summaries as JSON.")] = False,
) -> None:
    """Print the summary tables of results side by side."""
    from navsim.io.results import ResultError, read

    try:
        results = [(path.stem, read(path)) for path in files]
    except ResultError as error:
        leave(BAD_INPUT, error)
    if json_:
        import json

        from navsim.report.tables import summary_json

        summaries = [summary_json(result) for _, result in results]
        print(json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=1, allow_nan=False))
    else:
        try:
            _print_table(results)
        except KeyError as error:
            leave(BAD_INPUT, *(_lacks(result, name, error) for name, result in results))


@app.command()
def plot(
    file: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="A result file.", show_default=False)],
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Default: beside the result.", show_default=False)
    ] = None,
) -> None:
    """Draw the figures of a result."""
    from navsim.io.results import ResultError, read

    try:
        result = read(file)
        from navsim.report.views import save

        for path in save(result, figures or file.parent, file.stem):
            print(path)
    except ResultError as error:
        leave(BAD_INPUT, error)
    except KeyError as error:
        leave(BAD_INPUT, _lacks(result, file, error))


@app.command()
def validate(scenario: ScenarioArgument, set_: SetOption = None) -> None:
    """Check a scenario or study file and say what is wrong with it."""
    from navsim.scenario.load import read_any, read_study
    from navsim.scenario.source import InputError
    from navsim.scenario.sweep import Sweep

    try:
        checked, document = read_any(scenario, set_ or [])
        kind = document.data["kind"]
        if isinstance(checked, Sweep):
            from navsim.study.sweep import plan

            plan(*read_study(scenario, Sweep, set_ or []), seed=1)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    print(f"{scenario}: a valid {'study' if kind in ('sweep', 'optimize') else 'scenario'} of kind {kind}")


@app.command()
def schema(kind: Annotated[str, typer.Argument(help="Kind of scenario.")] = "landing") -> None:
    """Print the JSON Schema of a kind of scenario: every key, its unit, range, default."""
    import json

    from navsim.scenario.load import KINDS

    if kind not in KINDS:
        leave(BAD_INPUT, f"{kind!r} is no kind of scenario; allowed: {', '.join(KINDS)}")
    print(json.dumps(KINDS[kind].model_json_schema(), indent=1))


@app.command()
def init(
    template: Annotated[str, typer.Argument(help="Which one; a wrong name lists them.")] = "landing",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.yaml", help="Default: <template>.yaml.", show_default=False),
    ] = None,
) -> None:
    """Write a commented scenario to start from, which runs as it is."""
    from navsim.scenario.shipped import names, text

    if template not in names():
        leave(BAD_INPUT, f"there is no template {template!r}; allowed: {', '.join(names())}")
    target = output or Path(f"{template}.yaml")
    try:
        with open(target, "x", encoding="utf-8") as file:
            file.write(text(template))
    except FileExistsError:
        leave(BAD_INPUT, f"{target}: exists already and stays untouched; choose another name with -o")
    except OSError as error:
        leave(BAD_INPUT, f"{target}: cannot be written: {error.strerror or error}")
    print(f"{target} written; fly it with: navsim run {target}")


def main() -> None:
    """Entry point of the `navsim` command."""
    try:
        app()
    except KeyboardInterrupt:
        say("interrupted")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # the reader of a pipe went away, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(OK)


if __name__ == "__main__":
    main()
