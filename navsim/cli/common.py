"""Common parts of the commands: files, progress, printing."""

from __future__ import annotations

import difflib
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn, cast

import typer

from navsim.cli import exit_status, log
from navsim.cli.exit_status import BAD_INPUT, RUN_FAILED, print_message
from navsim.runner.reporter import Reporter

if TYPE_CHECKING:
    from navsim.report.table import Table
    from navsim.results.result import Result
    from navsim.runner.job import Progress
    from navsim.runner.target import Written


def _warn(warning: str) -> None:
    from navsim.results.notes import labelled

    print_message(f"warning: {labelled(warning)}")


AT_TERMINAL = Reporter(print_message, _warn)
"""Messages of the work go to standard error."""


@contextmanager
def leaving() -> Iterator[None]:
    """Context in which an error for users (`navsim.runner.errors`) ends the command."""
    from navsim.runner.errors import BadInput, NavsimError

    try:
        yield
    except NavsimError as error:
        leave(BAD_INPUT if isinstance(error, BadInput) else RUN_FAILED, *error.problems)


def leave(code: int, *messages: object) -> NoReturn:
    """End with an exit code and messages on standard error."""
    for message in messages:
        print_message(f"error: {message}")
    raise typer.Exit(code)


def make_folder(output: Path) -> None:
    """Make the folder of an output file or folder where it is missing; leave where it is refused."""
    from navsim.runner import target

    with leaving():
        target.make_folder(output)


SAY_EVERY_S = 10.0
"""Interval of progress messages without a terminal, and in a log, s."""


@contextmanager
def progress(extent: int, unit: str, shown: bool, clock: Callable[[], float] = time.monotonic) -> Iterator[Progress]:
    """Progress on standard error: a bar over an extent, counted in `unit`, with a message behind it.

    With extent 0, only the message. Without a terminal, a line now and then, as in a log. `shown` False: nothing.
    """
    live = shown and extent != 1 and sys.stderr.isatty()
    here = _Standing(extent, unit, shown and not live, clock)
    with (_bar(extent, unit) if extent else _status()) if live else nullcontext() as show:

        def tell(finished: int, words: str = "") -> None:
            exit_status.check()
            here(finished, words)
            if show is not None:
                show(finished, words)

        yield tell


class _Standing:
    """Progress at intervals: printed, if requested, and logged."""

    def __init__(self, extent: int, unit: str, spoken: bool, clock: Callable[[], float]) -> None:
        self._extent, self._unit, self._spoken, self._clock = extent, unit, spoken, clock
        self._begun = self._said = clock()
        self._first: tuple[int, float] | None = None

    def __call__(self, finished: int, words: str) -> None:
        now = self._clock()
        if self._first is None:  # the estimate uses later progress: this may be an earlier attempt's
            self._first = finished, now
        if now - self._said < SAY_EVERY_S:
            return
        self._said = now
        used, done = now - self._begun, finished - self._first[0]
        going_on = done > 0 and finished < self._extent  # work after all pieces has no estimate
        left = (now - self._first[1]) * (self._extent - finished) / done if going_on else None
        if self._spoken:
            print_message(self._line(finished, words, used, left) if self._extent else words, logged=False)
        if log.is_open():
            log.note("progress", text=words, finished=finished, extent=self._extent, unit=self._unit,
                     used_s=round(used, 1), left_s=None if left is None else round(left, 1))  # fmt: skip

    def _line(self, finished: int, words: str, used: float, left: float | None) -> str:
        from navsim.runner.estimate import duration

        remaining = "" if left is None else f", {duration(left)} left"
        return f"{finished} of {self._extent} {self._unit}, {used:.0f} s used{remaining}{words and f'; {words}'}"


@contextmanager
def _bar(extent: int, unit: str) -> Iterator[Callable[[int, str], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.fields[words]}"),
    )  # fmt: skip
    with Progress(*columns, console=Console(file=cast("IO[str]", exit_status.LossyStderr())), transient=True) as bar:
        task = bar.add_task(unit, total=extent, words="")
        yield lambda finished, words: bar.update(task, completed=finished, words=words)


@contextmanager
def _status() -> Iterator[Callable[[int, str], None]]:
    from rich.console import Console

    with Console(file=cast("IO[str]", exit_status.LossyStderr())).status("") as line:
        yield lambda finished, words: line.update(words)


def read_result(path: Path) -> Result:
    """Read a result file; for a scenario, a study or a log it exits with the command that takes it."""
    from navsim.results.result import ResultError, read

    try:
        return read(path)
    except ResultError as error:
        from navsim.runner.opening import scenario_instead

        leave(BAD_INPUT, scenario_instead(path) or error)


def called(files: list[Path]) -> list[str]:
    """Names of results: stems, paths for equal stems, with numbers for equal paths."""
    stems = [path.stem for path in files]
    names = stems if len(set(stems)) == len(stems) else [str(path) for path in files]
    return names if len(set(names)) == len(names) else [f"{name} ({i})" for i, name in enumerate(names, 1)]


@dataclass(frozen=True)
class Shown:
    """Format of printed tables.

    format: terminal, markdown, csv or tex. compare: with differences from the first result. rows: pattern of the rows,
    None for all.
    """

    format: str = "terminal"
    compare: bool = False
    rows: str | None = None


def print_tables(results: list[tuple[str, Result]], how: Shown | None = None) -> None:
    """Print the tables of results of one kind, each with its name."""
    from navsim.report.view import view

    how = how or Shown()
    kinds = {str(result.attributes["kind"]) for _, result in results}
    if len(kinds) > 1:
        leave(BAD_INPUT, f"results of different kinds cannot be compared: {', '.join(sorted(kinds))}")
    here = view(kinds.pop())
    tables = here.tables if how.rows is None or here.with_small_rows is None else here.with_small_rows
    parts: Sequence[Table | str] = tables(results)
    if how.compare:
        from navsim.report.compare import compared, differences, settings_of

        parts = compared(results, parts, [tables([each]) for each in results])
        settings = differences([name for name, _ in results], [settings_of(result) for _, result in results])
        if settings is not None:
            settings.title = "Settings that differ"
            parts = [settings, *parts] if settings.rows else ["the settings are the same", *parts]
    print_parts(parts, how)


def print_parts(parts: Sequence[Table | str], how: Shown) -> None:
    """Print tables, and words between them."""
    from navsim.report.table import Table, chosen

    if how.rows is not None:
        tables = [part for part in parts if isinstance(part, Table)]
        parts = chosen(tables, how.rows)
        if not parts:
            near = nearest_rows(how.rows, {str(row.cells[0]).strip() for table in tables for row in table.rows})
            ask = f"nearest: {'; '.join(near)}" if near else "without --rows all are printed"
            leave(BAD_INPUT, f"--rows {how.rows}: no row or heading matches; {ask}")
    if how.format == "terminal":
        _print_fitted(parts, how.compare)
    else:
        print(_written(parts, how.format), end="")


def nearest_rows(pattern: str, named: set[str]) -> list[str]:
    """Up to three names of rows that resemble a pattern, as a whole or by one of their words."""
    by_word: dict[str, list[str]] = {}
    for name in sorted(named):
        for part in (name, *re.findall(r"\w+", name)):
            by_word.setdefault(part.lower(), []).append(name)
    near = difflib.get_close_matches(pattern.lower(), list(by_word), n=3)
    return list(dict.fromkeys(name for word in near for name in by_word[word]))[:3]


def _written(parts: Sequence[Table | str], form: str) -> str:
    """Tables, and words between them, as text of a format; as CSV tables alone."""
    from navsim.report.table import TIDY, Table, csv_text, markdown, markdown_text, tex, tex_text, tidy

    if form == "csv":
        return csv_text(TIDY, (row for part in parts if isinstance(part, Table) for row in tidy(part)))
    lines: list[str] = []
    for part in parts:
        if not isinstance(part, Table):
            lines += [markdown_text(part) if form == "markdown" else tex_text(part), ""]
        elif form == "markdown":
            lines += [*([f"**{markdown_text(part.title)}**", ""] if part.title else []), *markdown(part)]
            lines += [markdown_text(part.notes), ""] if part.notes else []
        else:
            lines += tex(part)
    return "\n".join(lines) + "\n"


def _print_fitted(parts: Sequence[Table | str], compare: bool) -> None:
    """Print tables in the width of the terminal; comparisons, and other output, at most `WIDEST`."""
    from rich.console import Console

    from navsim.report.table import WIDEST, console, text

    class Piped(Console):
        """rich would leave with exit code 1 where the reader of a pipe goes away."""

        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    if not sys.stdout.isatty():
        print(text(parts), end="")
        return
    terminal = Piped(highlight=False)
    terminal.print(console(parts), width=min(terminal.width, WIDEST) if compare else None)


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
