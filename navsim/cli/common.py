"""What the commands share: files found and written, progress, what is printed."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn, cast

import typer

from navsim.cli import ending
from navsim.cli.ending import BAD_INPUT, say

if TYPE_CHECKING:
    from navsim.io.results import Result, Sort
    from navsim.study.job import Tell


def leave(code: int, *messages: object) -> NoReturn:
    """End with an exit code and messages on standard error."""
    for message in messages:
        say(f"error: {message}")
    raise typer.Exit(code)


SAY_EVERY_S = 10.0
"""How often work whose extent is not known says where it stands when nobody looks at a terminal."""


@contextmanager
def progress(extent: int, unit: str, shown: bool, clock: Callable[[], float] = time.monotonic) -> Iterator[Tell]:
    """Progress on standard error: a bar over an extent, counted in `unit`; for an extent of 0 words, in a live line, or
    a line now and then where it is no terminal; nothing where it is not to be shown."""
    live = shown and sys.stderr.isatty()
    if extent == 0 and shown:
        with _status() if live else _lines(clock) as tell:
            yield tell
    elif extent > 1 and live:
        with _bar(extent, unit) as tell:
            yield tell
    else:
        yield lambda finished, words="": ending.check()


@contextmanager
def _bar(extent: int, unit: str) -> Iterator[Tell]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=cast("IO[str]", ending.Words())), transient=True) as bar:
        task = bar.add_task(unit, total=extent)

        def tell(finished: int, words: str = "") -> None:
            ending.check()
            bar.update(task, completed=finished)

        yield tell


@contextmanager
def _status() -> Iterator[Tell]:
    from rich.console import Console

    with Console(file=cast("IO[str]", ending.Words())).status("") as line:

        def tell(finished: int, words: str = "") -> None:
            ending.check()
            line.update(words)

        yield tell


@contextmanager
def _lines(clock: Callable[[], float]) -> Iterator[Tell]:
    said = clock()

    def tell(finished: int, words: str = "") -> None:
        nonlocal said
        ending.check()
        if clock() - said >= SAY_EVERY_S:
            said = clock()
            say(words)

    yield tell


def target_of(output: Path | None, default: str) -> Path:
    """The result's path: as given by -o, else results/<default>.h5."""
    if output is not None and not output.parent.is_dir():
        leave(BAD_INPUT, f"{output.parent}: no such folder; create it first or choose another -o/--output")
    return output or Path("results") / f"{default}.h5"


def check_target(target: Path, sort: Sort, force: bool) -> None:
    """Leave, before anything is computed, where the path cannot be written or holds what must stay: a result of another
    sort unless `force` says so, anything that is no result always."""
    from navsim.io.results import ResultError, check_writable

    try:
        check_writable(target)
        refuse_other(target, sort, force)
    except ResultError as error:
        leave(BAD_INPUT, error)


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


def begin(target: Path, kernels: str) -> None:
    """The computing of a result begins: no other process works on it until the command ends, leftovers of killed ones
    are cleaned, and why the first work with these kernels (`study.job.Job`) ever takes longer is said."""
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
    if not jit.is_warm(kernels):
        say(jit.compiling())


@dataclass(frozen=True)
class Written:
    """Files beside a result."""

    texts: list[Path]
    figures: list[Path]


def save(result: Result, target: Path, figures: Path | None) -> Written:
    """Write a result, the files of text beside it and, where they are wanted, its figures. Raises ResultError.

    Figures of the result that stood there before are removed: they are not of this one.
    """
    from navsim.io.results import write
    from navsim.report.figure_files import remove_former
    from navsim.report.view import draw, write_texts

    write(target, result)
    remove_former(target.parent, target.stem)
    texts = write_texts(result, target)
    return Written(texts, [] if figures is None else draw(result, figures, target.stem))


def figure_folder(figures: str | Path | None, target: Path, skipped: bool) -> Path | None:
    """Where figures go. figures: as given by the option, a folder or the word `none`; a Path is a folder whatever its
    name. skipped: there are none unless a folder is given."""
    if figures == "none" or (figures is None and skipped):
        return None
    folder = target.parent if figures is None else Path(figures)
    if folder.exists() and not folder.is_dir():
        leave(BAD_INPUT, f"--figures {folder}: is a file, not a folder")
    return folder


def read_result(path: Path) -> Result:
    """A result file; leaves with what takes the file instead where it is a scenario, a study or a log."""
    from navsim.io.results import ResultError, read

    try:
        return read(path)
    except ResultError as error:
        if path.suffix in (".yaml", ".yml"):
            from navsim.kinds import OF_FILES, advice
            from navsim.scenario.source import InputError, load

            with suppress(InputError):  # not even readable as YAML: what it is no result for is said below
                kind = str(load(path).data.get("kind"))
                if kind in OF_FILES:
                    leave(BAD_INPUT, f"{path}: is no result but {advice(kind, path)}")
        leave(BAD_INPUT, error)


def print_tables(results: list[tuple[str, Result]]) -> None:
    """Print the tables of results of one kind, each with its name."""
    from navsim.report.table import console
    from navsim.report.view import view

    kinds = {str(result.attributes["kind"]) for _, result in results}
    if len(kinds) > 1:
        leave(BAD_INPUT, f"results of different kinds do not stand side by side: {', '.join(sorted(kinds))}")
    here = view(kinds.pop())
    print_console(console(here.tables(results)), here.width + here.width_more * (len(results) - 1))


def print_console(table: Any, width: int) -> None:
    """Print a table, in this width where there is no terminal to ask for its own."""
    from rich.console import Console

    class Piped(Console):
        """rich would leave with exit code 1 where the reader of a pipe goes away."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    Piped(width=None if sys.stdout.isatty() else width, highlight=False).print(table)


def print_json(data: Any) -> None:
    import json

    print(json.dumps(data, indent=1, allow_nan=False))


def print_shown(result: Result, target: Path, written: Written, quiet: bool, as_json: bool) -> None:
    """The tables of a result and where its files are, or its summary as JSON."""
    from navsim.report.view import plain

    if as_json:
        print_json(plain(result))
    elif not quiet:
        print_tables([(target.stem, result)])
        print(f"result   {', '.join(map(str, (target, *written.texts)))}")
        if written.figures:
            names = ",".join(path.stem.removeprefix(f"{target.stem}_") for path in written.figures)
            names = f"{{{names}}}" if len(written.figures) > 1 else names
            print(f"figures  {written.figures[0].parent}/{target.stem}_{names}.png")
