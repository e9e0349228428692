"""What the commands share: options, files found and written, progress."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any, NoReturn, cast

import typer

from navsim.cli import ending
from navsim.cli.ending import BAD_INPUT, say

if TYPE_CHECKING:
    from navsim.io.results import Result, Sort
    from navsim.study.partial import Store

MOST_RUNS = 1_000_000
"""Where `--until` gives up, unless --runs says otherwise."""


ScenarioArgument = Annotated[
    Path, typer.Argument(metavar="SCENARIO.yaml", help="The scenario to read.", show_default=False)
]
MOST = 2**63 - 1
"""Largest seed and number of a run: what a result file holds as an integer."""
_PLAIN = {int: re.compile("[0-9]{1,40}"), float: re.compile(r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")}
"""A number as people write one; Python's own reading takes `1_000`, `nan` and the digits of other scripts too."""


def number_option(
    kind: type[int] | type[float], least: float, meaning: str, *, most: int = MOST, show_default: bool = False
) -> Any:
    """An option with a whole number, or with seconds, from `least` to `most`."""
    what, metavar = ("a whole number", "N") if kind is int else ("a number", "SECONDS")

    def parse(given: object) -> float:
        text = str(given)  # a default comes as a number
        if not _PLAIN[kind].fullmatch(text) or not least <= kind(text) <= most:
            raise typer.BadParameter(f"expected {what} from {least:g} to {most}, not {text[:40]!r}")
        return kind(text)

    return typer.Option(parser=parse, metavar=metavar, help=f"{meaning} [{least:g} or more]", show_default=show_default)


WorkersOption = Annotated[int | None, number_option(int, 1, "Threads. Default: all cores.")]
SeedOption = Annotated[int, number_option(int, 0, "Root of all random numbers.", show_default=True)]
FreshOption = Annotated[bool, typer.Option("--fresh", help="Discard partial work of an earlier attempt.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite a result of another kind.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but warnings and errors.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the summary as JSON, and nothing else, on standard output.")
]
FiguresOption = Annotated[
    str | None,
    typer.Option(
        metavar="FOLDER|none",
        help="Where figures go, made where it is not there. Default: beside the result; none with --quiet.",
        show_default=False,
    ),
]


def output_option(default: str) -> Any:
    """-o of a command whose result has this name unless given."""
    return typer.Option(
        "--output", "-o", metavar="FILE.h5", help=f"The result file. Default: {default}.", show_default=False
    )


def set_option(what: str) -> Any:
    """--set of a command that reads a scenario, a study or a log."""
    return typer.Option(
        "--set", metavar="KEY=VALUE", help=f"Set a key of the {what}, dotted; may be given many times.",
        show_default=False,
    )  # fmt: skip


SetOption = Annotated[list[str] | None, set_option("scenario")]
StudySetOption = Annotated[list[str] | None, set_option("study")]


def leave(code: int, *messages: object) -> NoReturn:
    """End with an exit code and messages on standard error."""
    for message in messages:
        say(f"error: {message}")
    raise typer.Exit(code)


@contextmanager
def progress(total: int, shown: bool, what: str = "runs") -> Iterator[Callable[[int], None]]:
    """A progress bar over `total` of something on standard error, or nothing."""
    if not shown or total < 2 or not sys.stderr.isatty():
        yield lambda _: ending.check()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=cast("IO[str]", ending.Words())), transient=True) as bar:
        task = bar.add_task(what, total=total)

        def tell(done: int) -> None:
            ending.check()
            bar.update(task, completed=done)

        yield tell


SAY_EVERY_S = 10.0
"""How often a search says where it stands when nobody looks at a terminal."""


@contextmanager
def search_progress(shown: bool, unit: str) -> Iterator[Callable[[Any], None]]:
    """Where a search stands (`study.watch.Progress`) on standard error: a live line, or a line now and then where it
    is no terminal; nothing where it is not to be shown. unit: of the objective."""
    if not shown:
        yield lambda _: ending.check()
        return
    if sys.stderr.isatty():
        from rich.console import Console

        with Console(file=cast("IO[str]", ending.Words())).status("") as line:

            def show(progress: Any) -> None:
                ending.check()
                line.update(search_line(progress, unit))

            yield show
        return
    said = 0.0

    def tell(progress: Any) -> None:
        nonlocal said
        ending.check()
        if progress.used - said >= SAY_EVERY_S:
            said = progress.used
            say(search_line(progress, unit))

    yield tell


def search_line(progress: Any, unit: str) -> str:
    """A `study.watch.Progress` in words."""
    from navsim.study.search import COARSE, FULL

    analysed = sum(progress.tried.get(way, 0) for way in (COARSE, FULL))
    tried = f"{sum(progress.tried.values())} placements tried"
    if analysed:
        tried += f", {analysed} by covariance analysis"
    best = "none found yet"
    if progress.best is not None:
        at = ", ".join(f"({s:.0f}, {l1:.0f})" for s, l1 in progress.places)
        best = f"best {progress.best:.4g}{'' if unit == '1' else f' {unit}'} at s, l1 {at} m"
    left = "time left not known yet" if progress.left is None else f"at most {progress.left:.0f} s left"
    return f"{progress.step or 'preparing'}: {tried}; {best}; {progress.used:.0f} s used, {left}"


def read(scenario: Path, assignments: list[str] | None) -> Any:
    from navsim.scenario.load import read_runnable
    from navsim.scenario.source import InputError

    try:
        return read_runnable(scenario, assignments or [])
    except InputError as error:
        leave(BAD_INPUT, *error.problems)


def method_given(path: Path, assignments: list[str] | None, method: str | None) -> tuple[list[str], str]:
    """The assignment for --method, and the suffix of the result's name where it is not the file's own method."""
    from navsim.scenario.load import own_method
    from navsim.scenario.source import InputError

    if method is None:
        return [], ""
    try:
        own = own_method(path, assignments or [])
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    return ([], "") if own is None else ([f"method={method}"], "" if own == method else f"_{method}")


def target_of(scenario: Path, output: Path | None, sort: Sort, force: bool, suffix: str = "") -> Path:
    """The result's path, found writable and free of other data before anything is computed.

    Without `output` it is results/<stem of the scenario><suffix>.h5; the suffix tells results of one scenario apart
    that are of different sorts. A result of another sort is not overwritten unless `force` says so, anything that is
    no result never.
    """
    from navsim.io.results import ResultError, check_writable

    target = output or Path("results") / f"{scenario.stem}{suffix}.h5"
    try:
        if output is not None and not target.parent.is_dir():
            raise ResultError(f"{target.parent}: no such folder; create it first or choose another -o/--output")
        check_writable(target)
        refuse_other(target, sort, force)
    except ResultError as error:
        leave(BAD_INPUT, error)
    return target


def refuse_other(target: Path, sort: Sort, force: bool) -> None:
    """Raise ResultError where a file stands that a result of this sort may not overwrite."""
    from navsim.io.results import ResultError, read_sort

    if not target.exists():
        return
    try:
        there = read_sort(target)
    except ResultError as error:
        raise ResultError(f"{error}; it is not overwritten, choose another -o/--output") from None
    if there != sort and not force:
        raise ResultError(
            f"{target}: holds a result of another sort ({there}) than the new one ({sort}); "
            "choose another -o/--output, or overwrite it with --force"
        )


def begin(target: Path) -> None:
    """The computing of a result begins: no other process works on it until the command ends, leftovers of killed ones
    are cleaned, and why the first run ever takes longer is said."""
    from navsim.core import jit
    from navsim.io.whole import Occupied, clean, locked

    try:
        ending.keep(locked(target))
    except Occupied as error:
        leave(BAD_INPUT, f"{error}; wait for it, or choose another -o/--output")
    except OSError as error:
        say(f"warning: {target} cannot be locked ({error.strerror or error}): let no other process write it")
    else:
        clean(target, owned=True)
    if not jit.is_warm():
        say(f"compiling the kernels, once, up to a minute; kept in {jit.cache_place()}")


def save(result: Result, target: Path, figures: Path | None) -> list[Path]:
    """Write a result and, where they are wanted, its figures; returns the figures. Raises ResultError.

    Figures of the result that stood there before are removed: they are not of this one.
    """
    from navsim.io.results import write
    from navsim.report.figure_files import remove_former

    write(target, result)
    remove_former(target.parent, target.stem)
    if figures is None:
        return []
    from navsim.report.views import save as draw

    return draw(result, figures, target.stem)


def open_store(target: Path, key: dict[str, Any], fresh: bool) -> Store:
    """The place for partial work beside the result."""
    from navsim.io.whole import partial_folder
    from navsim.study.partial import PartialError, Store

    try:
        return Store(partial_folder(target), key, fresh)
    except PartialError as error:
        leave(BAD_INPUT, error)


def store_beside(target: Path, key: dict[str, Any], runs: int, fresh: bool, batch: int | None = None) -> Store | None:
    """The same for runs in batches; None for a study of a single batch."""
    from navsim.io.whole import partial_folder
    from navsim.study.ensemble import BATCH

    if runs <= (batch or BATCH) and not partial_folder(target).exists():
        return None
    return open_store(target, key, fresh)


def figure_folder(figures: str | None, target: Path, runs: int, quiet: bool) -> Path | None:
    if figures == "none" or (figures is None and (runs > 1 or quiet)):
        return None
    folder = target.parent if figures is None else Path(figures)
    if folder.exists() and not folder.is_dir():
        leave(BAD_INPUT, f"--figures {folder}: is a file, not a folder")
    return folder


def print_summary(result: Any, name: str, quiet: bool, as_json: bool) -> None:
    from navsim.report import tables

    if as_json:
        import json

        print(json.dumps(tables.summary_json(result), indent=1, allow_nan=False))
    elif not quiet:
        print_table([(name, result)])


def read_result(path: Path) -> Result:
    """A result file; leaves with what takes the file instead where it is a scenario, a study or a log."""
    from navsim.io.results import ResultError, read

    try:
        return read(path)
    except ResultError as error:
        if path.suffix in (".yaml", ".yml"):
            from navsim.scenario.kinds import COMMANDS, advice
            from navsim.scenario.source import InputError, load

            with suppress(InputError):  # not even readable as YAML: what it is no result for is said below
                kind = str(load(path).data.get("kind"))
                if kind in COMMANDS:
                    leave(BAD_INPUT, f"{path}: is no result but {advice(kind, path)}")
        leave(BAD_INPUT, error)


def lacks(result: Any, name: object, error: KeyError) -> str:
    """What to say of a result file without a variable that its kind has today."""
    version = result.attributes["navsim_version"]
    return f"{name}: has no {error.args[0]}; it was written by navsim {version}, compute it again with this version"


def print_table(results: list[tuple[str, Any]]) -> None:
    from navsim.report.table import console
    from navsim.report.tables import summary_table
    from navsim.report.views import VIEWS

    kinds = {str(result.attributes["kind"]) for _, result in results}
    if len(kinds) > 1:
        leave(BAD_INPUT, f"results of different kinds do not stand side by side: {', '.join(sorted(kinds))}")
    kind = kinds.pop()
    if kind == "landing":
        print_console(console([summary_table(results)]), 56 + 60 * len(results))
        return
    view = VIEWS[kind]
    for name, result in results:
        print(name)
        print_console(view.console(result), view.width)


def print_console(table: Any, width: int) -> None:
    """Print a table, in this width where there is no terminal to ask for its own."""
    from rich.console import Console

    class Piped(Console):
        """rich would leave with exit code 1 where the reader of a pipe goes away."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    Piped(width=None if sys.stdout.isatty() else width, highlight=False).print(table)


def print_result(
    result: Any, target: Path, written: list[Path], quiet: bool, as_json: bool, prefixes: tuple[str, ...]
) -> None:
    """The tables of a result's kind and where its files are, or as JSON what lies below the prefixes."""
    if as_json:
        import json

        from navsim.report.tables import FINDINGS, plain_tree

        print(json.dumps(plain_tree(result, (*prefixes, FINDINGS)), indent=1, allow_nan=False))
    elif not quiet:
        from navsim.report.views import VIEWS

        view = VIEWS[str(result.attributes["kind"])]
        print_console(view.console(result), view.width)
        print(f"result   {target}")
        if written:
            print(f"figures  {', '.join(map(str, written))}")
