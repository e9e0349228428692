"""Display of the results of a kind: tables for the terminal, figures, plain data, text files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from navsim.kinds import KINDS, named
from navsim.report.plain_data import FINDINGS, plain_tree
from navsim.report.table import Cell, Table
from navsim.results.result import Result, ResultError, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from navsim.report.printing import Print

_HEAD = ("kind", "navsim_version", "seed", "epoch", "scenario_sha256")
"""Attributes at the top of the plain data of every result."""


@dataclass(frozen=True)
class View:
    """How results of one kind are shown."""

    tables: Callable[[Sequence[tuple[str, Result]]], list[Table | str]]
    """Tables of several results, each with its name, and text between them."""
    figures: Callable[[Result], dict[str, Figure]]
    """By name."""
    summary: tuple[str, ...] = ()
    """Paths whose variables are the summary as plain data."""
    more: Callable[[Result], dict[str, Any]] = lambda _: {}
    """More of the summary."""
    texts: Callable[[Result, Path], dict[Path, str]] = lambda _, __: {}
    """Text files written beside the result, by path."""
    drawings: str = ""
    """Draws results for the page of `navsim report`, as "module:name". It takes results, each with its name, and
    returns `page.plots.Drawing`s."""
    verdicts: Callable[[Sequence[tuple[str, Result]]], list[Table | str]] = lambda _: []
    """Tables and text of verdicts."""
    glance: Callable[[Result], list[tuple[str, Cell | str]]] = lambda _: []
    """Key values of a result, by name."""
    of_runs: tuple[str, ...] = ()
    """Names of the figures of single runs."""
    with_small_rows: Callable[[Sequence[tuple[str, Result]]], list[Table | str]] | None = None
    """`tables` with every row that they sum; None: they sum none."""


def one_by_one(
    tables: Callable[[Result], list[Table | str]],
) -> Callable[[Sequence[tuple[str, Result]]], list[Table | str]]:
    """Tables of each result that has any, under its name if there are several."""

    def all_of_them(results: Sequence[tuple[str, Result]]) -> list[Table | str]:
        made = [(name, tables(result)) for name, result in results]
        return [part for name, parts in made if parts for part in [name][: len(results) - 1] + parts]

    return all_of_them


def view(kind: object) -> View:
    """The view of a kind. Raises ResultError for one that this version does not have."""
    if str(kind) not in KINDS:
        raise ResultError(f"not a result of this version: there is no kind {kind}")
    found: View = named(KINDS[str(kind)].view)
    return found


def plain(result: Result) -> dict[str, Any]:
    """Summary and findings of a result as nested plain data, with the names of the result file; nan becomes null."""
    here = view(result.attributes["kind"])
    head = {name: result.attributes[name] for name in _HEAD}
    head["seed"] = int(head["seed"])
    return head | here.more(result) | plain_tree(result, (*here.summary, FINDINGS))


def draw(
    result: Result, folder: Path, stem: str, how: Print | None = None, only: Sequence[str] = (), run: int | None = None
) -> list[Path]:
    """Draw every figure a result has data for, or those of the names in `only`, as `folder/stem_NAME.FORMAT`; of one of
    its runs alone those that show runs, as `folder/stem_runK_NAME.FORMAT`. Returns the files. Raises ResultError."""
    from navsim.report.figures import save_figures
    from navsim.report.printing import Print

    how = how or Print()
    here = view(result.attributes["kind"])
    if run is None:
        return save_figures(lambda: here.figures(result), folder, stem, how, only)
    from navsim.report.figure_data import one_run

    chosen = one_run(result, run)

    def of_run() -> dict[str, Figure]:
        drawn = {name: figure for name, figure in here.figures(chosen).items() if name.split("_")[0] in here.of_runs}
        if not drawn:
            raise ResultError(f"--run {run}: the result has no figure of single runs")
        return drawn

    return save_figures(of_run, folder, stem, how, only, f"run{run}_")


def write_texts(result: Result, target: Path) -> list[Path]:
    """Write the text files of a result beside `target`; returns them. Raises ResultError."""
    texts = view(result.attributes["kind"]).texts(result, target)
    for path, text in texts.items():
        write_text(path, text)
    return list(texts)
