"""Tables for people as plain data: a title, heads with their units, rows of numbers and how they are said; and the one
way each to draw them in a terminal, as Markdown, and to write rows as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import RenderableType

ABSENT = "-"
"""What stands for a number that is not known."""


class _Said(float):
    """A number that is said as `ABSENT` where it is not finite."""

    def __format__(self, how: str) -> str:
        return float.__format__(self, how) if math.isfinite(self) else ABSENT


@dataclass(frozen=True)
class Cell:
    """Values, and the pattern of `str.format` that says them. whole: nothing is said where the first is not known."""

    pattern: str
    values: tuple[float | int | str, ...]
    whole: bool = False

    def __str__(self) -> str:
        first = self.values[0] if self.values else 0.0
        if self.whole and isinstance(first, float) and not math.isfinite(first):
            return ABSENT
        return self.pattern.format(*(_Said(v) if isinstance(v, float) else v for v in self.values))


def cell(pattern: str, *values: float | int | str) -> Cell:
    """A cell of these values."""
    return Cell(pattern, values)


def number(value: float, digits: int = 3) -> Cell:
    """A number with so many digits behind the point."""
    return Cell(f"{{:.{digits}f}}", (float(value),))


def numbers(values: Iterable[float], digits: int) -> Cell:
    """Numbers in a row, each with so many digits behind the point."""
    known = tuple(map(float, values))
    return Cell("  ".join([f"{{:.{digits}f}}"] * len(known)), known)


def interval(values: Iterable[float], digits: int, scale: float = 1.0) -> Cell:
    """A value with its interval (3,): value, low, high, times a scale; nothing where the value is not known."""
    value, low, high = (float(x) * scale for x in values)
    return Cell(f"{{:.{digits}f}}  [{{:.{digits}f}}, {{:.{digits}f}}]", (value, low, high), whole=True)


@dataclass(frozen=True)
class Row:
    """The cells of a row, one a column; heading: it names the rows that follow."""

    cells: tuple[Cell | str, ...]
    heading: bool = False

    def texts(self) -> list[str]:
        """The cells as they are said."""
        return [str(each) for each in self.cells]


@dataclass
class Table:
    """heads: of the columns, with units. notes: what stands below. lines: between rows; labelled: the first column
    names the rows and is not broken."""

    title: str
    heads: tuple[str, ...]
    rows: list[Row] = field(default_factory=list)
    notes: str = ""
    lines: bool = False
    labelled: bool = False

    def add(self, *cells: Cell | str) -> None:
        """A row; what it is short of stays empty."""
        self.rows.append(Row(cells + ("",) * (len(self.heads) - len(cells))))

    def head(self, *cells: Cell | str) -> None:
        """A row that names those that follow."""
        self.rows.append(Row(cells, heading=True))


def console(parts: Sequence[Table | str]) -> RenderableType:
    """Tables, and words between them, for the terminal."""
    from rich.console import Group
    from rich.markup import escape

    return Group(*(_drawn(part) if isinstance(part, Table) else escape(part) for part in parts))


def _drawn(table: Table) -> RenderableType:
    from rich import box
    from rich import table as rich
    from rich.markup import escape

    out = rich.Table(
        title=escape(table.title) or None, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False,
        show_lines=table.lines, caption=escape(table.notes) or None,
    )  # fmt: skip
    for i, head in enumerate(table.heads):
        out.add_column(escape(head), no_wrap=table.labelled and i == 0)
    for row in table.rows:
        first, *others = map(escape, row.texts())
        if row.heading:
            out.add_row(f"[bold]{first}[/bold]", *(f"[dim]{text}[/dim]" for text in others))
        else:
            out.add_row(first, *others)
    return out


def markdown(table: Table) -> list[str]:
    """The lines of a table in Markdown, without its title, an empty one behind them."""
    heads = [f"| {' | '.join(table.heads)} |", "|" + "---|" * len(table.heads)]
    rows = [f"| {' | '.join(text.replace(chr(10), '<br>') for text in row.texts())} |" for row in table.rows]
    return [*heads, *rows, ""]


def csv_text(heads: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV; numbers in ten digits, empty where they are not known."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows([as_text(value) for value in row] for row in rows)
    return out.getvalue()


def as_text(value: object) -> str:
    """A value in a CSV file: ten digits of a number, nothing where it is not known."""
    if isinstance(value, float):  # numpy's are
        return "" if math.isnan(value) else f"{float(value):.10g}"
    return str(value)
