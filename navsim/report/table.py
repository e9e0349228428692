"""Tables as plain data: a title, heads with units, rows of numbers and their format.

Each is drawn in one way in a terminal, as Markdown, for LaTeX, and as CSV.
"""

from __future__ import annotations

import csv
import fnmatch
import io
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from string import Formatter
from typing import TYPE_CHECKING

from navsim.statistics.rounding import share_text, write_out

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType, RenderResult

ABSENT = "-"
"""Text for an unknown number."""


class _NumberOrAbsent(float):
    """A number formatted as `ABSENT` if it is not finite; "share 95": a share, %, where 95 % are required."""

    def __format__(self, how: str) -> str:
        if not math.isfinite(self):
            return ABSENT
        if how.startswith("share "):
            return share_text(self, float(how.removeprefix("share ")))
        text = write_out(float.__format__(self, how))
        return text if text.strip("+-.0") else float.__format__(0.0, how)  # no negative zero


@dataclass(frozen=True)
class Cell:
    """Values and their `str.format` pattern."""

    pattern: str
    values: tuple[float | int | str, ...]
    whole: bool = False
    """Empty if the first value is unknown."""
    ends: bool = False
    """The second and third values are the ends of the first's 95 % interval."""
    several: bool = False
    """Values are independent, such as percentiles."""
    names: tuple[str, ...] = ()
    """Names of the values for programs; numbers from 1 if empty."""
    unit: str = ""
    """If it differs from the row's."""
    units: tuple[str, ...] = ()
    """Unit of each value, "" for `unit`."""
    trials: int = 0
    """The first value is a count out of so many trials; 0 if it is not a count."""
    trial: str = "run"
    """Name of a trial."""

    def __str__(self) -> str:
        first = self.values[0] if self.values else 0.0
        if self.whole and isinstance(first, float) and not math.isfinite(first):
            return ABSENT
        return self.pattern.format(*(_NumberOrAbsent(v) if isinstance(v, float) else v for v in self.values))


def cell(pattern: str, *values: float | int | str, names: tuple[str, ...] = ()) -> Cell:
    """A cell of these values, with their names."""
    return Cell(pattern, values, names=names)


def number(value: float, digits: int = 3) -> Cell:
    """A number with so many digits after the point."""
    return Cell(f"{{:.{digits}f}}", (float(value),))


def numbers(values: Iterable[float], digits: int, names: Iterable[str] = ()) -> Cell:
    """Numbers in a row, each with so many digits after the point, with their names."""
    known = tuple(map(float, values))
    return Cell("  ".join([f"{{:.{digits}f}}"] * len(known)), known, several=True, names=tuple(names))


def interval(values: Iterable[float], digits: int, scale: float = 1.0) -> Cell:
    """A value with its interval (3,): value, low, high, times a scale; nothing where the value is not known."""
    value, low, high = (float(x) * scale for x in values)
    return Cell(f"{{:.{digits}f}}  [{{:.{digits}f}}, {{:.{digits}f}}]", (value, low, high), whole=True, ends=True)


@dataclass(frozen=True)
class Row:
    """The cells of a row, one a column; heading: it names the rows that follow."""

    cells: tuple[Cell | str, ...]
    heading: bool = False

    def texts(self) -> list[str]:
        """The formatted cells."""
        return [str(each) for each in self.cells]


@dataclass
class Table:
    """A table."""

    title: str
    heads: tuple[str, ...]
    """Headings of the columns, with units."""
    rows: list[Row] = field(default_factory=list)
    notes: str = ""
    """Text below."""
    lines: bool = False
    """Lines between rows."""
    caption: str = ""
    """Caption on paper."""

    def add(self, *cells: Cell | str) -> None:
        """Add a row; missing cells are empty."""
        self.rows.append(Row(cells + ("",) * (len(self.heads) - len(cells))))

    def head(self, *cells: Cell | str) -> None:
        """A row that names those that follow."""
        self.rows.append(Row(cells, heading=True))


def console(parts: Sequence[Table | str]) -> RenderableType:
    """Tables, and words between them, for the terminal."""
    from rich.console import Group
    from rich.text import Text

    drawn: list[RenderableType] = []
    for before, part in zip([None, *parts], parts, strict=False):
        if drawn and (isinstance(part, Table) or isinstance(before, Table)):
            drawn.append(Text())
        drawn.append(_Fitted(brief(part)) if isinstance(part, Table) else Text(part))
    return Group(*drawn)


def brief(table: Table) -> Table:
    """The table with one row for each group of rows without any value, such as heights that no flight passes."""
    rows: list[Row] = []
    for row in reversed(table.rows):  # a group, then its heading
        under = next((i for i, one in enumerate(rows) if one.heading), len(rows)) if row.heading else 0
        if under and {text for one in rows[:under] for text in one.texts()[1:]} == {"-"}:
            rows[:under] = []
            row = Row((row.cells[0], *["-"] * (len(table.heads) - 1)), heading=True)
        rows.insert(0, row)
    return replace(table, rows=rows)


@dataclass(frozen=True)
class _Fitted:
    """A table that fits the terminal: cells are broken where no number suffers, then columns go below each other."""

    table: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich.text import Text

        if self.table.title:
            yield Text(self.table.title, style="table.title")
        for i, (columns, widths) in enumerate(_blocks(_layout(self.table), options.max_width)):
            if i:
                yield Text()
            yield _drawn(self.table, columns, widths)
        if self.table.notes:
            yield Text(self.table.notes, style="table.caption")


_COLUMN_GAP = 2
"""Blanks between two columns in the terminal."""
_LABEL = 24
"""Width below which the first column is not broken to make room."""
_TOGETHER = re.compile(
    r"\[[^\[\]]*\]|\([^()]{,24}\)|\S+ [→/-] \S+(?: \*)?|\d+ of \d+|σ \S+|[<>] \S+|(?<=\d) (?:%|°|\*|(?:m|s|dB|deg)\b)"
)
"""Parts of a cell that stay on one line: intervals, numbers with their units and signs."""
_KEPT_BLANK = "\N{NO-BREAK SPACE}"


def _unbroken(text: str) -> str:
    """A text whose blanks are places where it may be broken."""
    return _TOGETHER.sub(lambda found: found[0].replace(" ", _KEPT_BLANK), text)


def _wrapped(text: str, width: int) -> str:
    """A cell in lines of some width."""
    lines = []
    for line in text.split("\n"):
        inset = " " * (len(line) - len(line.lstrip()))
        lines += textwrap.wrap(_unbroken(line), width, subsequent_indent=f"{inset}  " if inset else "",
                               replace_whitespace=False, break_on_hyphens=False) or [""]  # fmt: skip
    return "\n".join(lines).replace(_KEPT_BLANK, " ")


def _layout(table: Table) -> list[tuple[int, int]]:
    """The least and the natural width of each column."""
    columns = list(zip(table.heads, *(row.texts() for row in _filled(table)), strict=True))
    out = []
    for i, cells in enumerate(columns):
        natural = max(len(line) for cell in cells for line in cell.split("\n"))
        least = max(len(word) for cell in cells for word in re.split("[ \n]+", _unbroken(cell)))
        out.append((max(least, min(natural, _LABEL)) if i == 0 else least, natural))
    return out


def _blocks(layout: Sequence[tuple[int, int]], width: int) -> list[tuple[list[int], list[int]]]:
    """Columns side by side, and their widths.

    All of them if they fit, otherwise evenly in as few blocks as possible, each with the first column.
    """
    others = range(1, len(layout))
    for count in range(1, max(len(others), 1) + 1):
        size = -(-len(others) // count)
        blocks = [[0, *others[at : at + size]] for at in range(0, max(len(others), 1), max(size, 1))]
        fitted = [_fit([layout[i] for i in block], width) for block in blocks]
        if all(widths is not None for widths in fitted):
            return [(block, widths) for block, widths in zip(blocks, fitted, strict=True) if widths]
    # a word is longer than the terminal is wide
    room = width - _COLUMN_GAP
    return [(block, _shared([layout[i][1] for i in block], room)) for block in blocks]


def _fit(columns: Sequence[tuple[int, int]], width: int) -> list[int] | None:
    """Widths of columns, from their least and natural ones; None if they do not fit."""
    room = width - _COLUMN_GAP * (len(columns) - 1)
    widths = [least for least, _ in columns]
    if sum(widths) > room:
        return None
    free = list(range(len(columns)))
    while free:
        left = room - sum(widths[i] for i in range(len(columns)) if i not in free)
        share = dict(zip(free, _shared([columns[i][1] for i in free], left), strict=True))
        narrow = [i for i in free if share[i] < columns[i][0]]
        if not narrow:
            return [share.get(i, widths[i]) for i in range(len(columns))]
        free = [i for i in free if i not in narrow]
    return widths


def _drawn(table: Table, columns: Sequence[int], widths: Sequence[int]) -> RenderableType:
    """Some columns of a table."""
    from rich import box
    from rich import table as rich
    from rich.text import Text

    out = rich.Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, _COLUMN_GAP - 1, 0, 0), pad_edge=False,
                     show_lines=table.lines)  # fmt: skip
    for i, width in zip(columns, widths, strict=True):
        out.add_column(Text(_wrapped(table.heads[i], width)), no_wrap=True)
    for row in _filled(table):
        texts = row.texts()
        styles = ["bold", *["dim"] * len(widths)] if row.heading else [""] * len(columns)
        out.add_row(*(Text(_wrapped(texts[i], width), style=style)
                      for i, width, style in zip(columns, widths, styles, strict=False)))  # fmt: skip
    return out


WIDEST = 120
"""Width of tables without a terminal, and largest width of comparisons."""


def text(parts: Sequence[Table | str], width: int = WIDEST) -> str:
    """Tables, and text between them, as plain text without trailing spaces."""
    from rich.console import Console

    out = io.StringIO()
    Console(file=out, width=width, highlight=False, force_jupyter=False).print(console(parts))
    return "".join(f"{line.rstrip(' ')}\n" for line in out.getvalue().splitlines())


def html(parts: Sequence[Table | str]) -> str:
    """Tables, and words between them, as HTML."""
    return "\n".join(_html_table(part) if isinstance(part, Table) else f"<p>{escape(part)}</p>" for part in parts)


def _html_table(table: Table) -> str:
    def lines(text: str) -> str:
        return escape(text).replace("\n", "<br>")

    def row(row: Row) -> str:
        first, *others = map(lines, row.texts())
        kind = "th" if row.heading else "td"
        return f'<tr><th scope="row">{first}</th>{"".join(f"<{kind}>{other}</{kind}>" for other in others)}</tr>'

    title = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    heads = "".join(f'<th scope="col">{lines(head)}</th>' for head in table.heads)
    notes = f"<p>{lines(table.notes)}</p>" if table.notes else ""
    rows = "".join(map(row, table.rows))
    return f"<table>{title}<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>{notes}"


_MARKS = str.maketrans({"\\": r"\\", "*": r"\*", "_": r"\_", "`": r"\`", "|": r"\|", "<": "&lt;"})
_LINK = re.compile(r"\](?=[(\[:])")
"""An end of brackets that a link may follow; others stay, as of intervals: some readers take `\\[` for a formula."""


def markdown_text(text: str) -> str:
    """Text escaped for Markdown, including line ends."""
    return _LINK.sub(r"\]", text.translate(_MARKS)).replace("\n", "<br>")


def markdown(table: Table) -> list[str]:
    """The lines of a table in Markdown, without its title and notes, an empty one behind them; headings of rows are
    bold."""

    def line(texts: Iterable[str]) -> str:
        return f"| {' | '.join(texts)} |"

    rows = []
    for row in table.rows:
        texts = [markdown_text(text.strip()) for text in row.texts()]
        texts += [""] * (len(table.heads) - len(texts))
        if row.heading:
            texts = [f"**{text}**" if text else "" for text in texts]
        rows.append(line(texts))
    return [line(map(markdown_text, table.heads)), "|" + "---|" * len(table.heads), *rows, ""]


_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "σ": r"$\sigma$",
    "β": r"$\beta$", "°": r"$^\circ$", "²": r"$^2$", "±": r"$\pm$", "×": r"$\times$", "→": r"$\rightarrow$",
    "≤": r"$\le$", "−": r"$-$", "…": r"\ldots{}", "⁻": r"$^-$", "³": r"$^3$", "√": r"$\surd$",
    '"': r"\textquotedbl{}",
}  # fmt: skip


_MINUS = re.compile(r"(?<![\w.)-])-(?=\.?\d)")
"""A hyphen that is the sign of a number."""


def tex_text(text: str) -> str:
    """Text escaped for TeX, with minus signs for numbers."""
    return "".join(_TEX.get(letter, letter) for letter in _MINUS.sub("−", text.replace("\n", " ")))


def _tex_row(texts: list[str]) -> str:
    r"""Cells of a row; the first one must not look like an argument of the row break before it."""
    first = f"{{}}{texts[0]}" if texts[0].lstrip().startswith(("[", "*")) else texts[0]
    return " & ".join([first, *texts[1:]]) + r" \\"


_LINE, _SMALL_LINE = 68, 84
"""Letters in a line of 345 pt, the text width of LaTeX's article on A4 and letter paper, set in 10 pt and in
\\footnotesize."""
_APART = 3
"""Letters that the room between two columns takes."""
_PAGE = 36
"""Lines of a table on a page, besides its caption."""


def tex(table: Table) -> list[str]:
    """Lines of a table for LaTeX with the packages booktabs, array and longtable.

    Its title and its caption become the caption. A table wider than the text is set smaller, then broken within its
    columns. A table longer than a page continues on the next.
    """
    columns = len(table.heads)
    widths = [
        max(map(len, column)) for column in zip(table.heads, *(row.texts() for row in _filled(table)), strict=True)
    ]
    room = _SMALL_LINE - _APART * (columns - 1)
    small = sum(widths) > _LINE - _APART * (columns - 1)
    kept = _shared(widths, room)
    rows = [_tex_texts(row, kept) for row in table.rows]
    form = "".join(
        ("l" if i == 0 else "r")
        if width <= share
        else rf">{{\raggedright\arraybackslash}}p{{{share / _SMALL_LINE:.3f}\linewidth}}"
        for i, (width, share) in enumerate(zip(widths, kept, strict=True))
    )
    height = sum(
        max(math.ceil(len(text) / max(share, 1)) for text, share in zip(row.texts(), kept, strict=False))
        for row in table.rows
    )
    head = [r"\toprule", _tex_row([tex_text(head) for head in table.heads]), r"\midrule"]
    body = []
    for i, (row, texts) in enumerate(zip(table.rows, rows, strict=True)):
        if row.heading and i:
            body.append(r"\addlinespace")
        body.append(_tex_row(texts))
    text = ". ".join(filter(None, (table.title, table.caption)))
    caption = [rf"\caption{{{tex_text(text)}}}"] if text else []
    notes = [rf"\par {tex_text(line)}" for line in table.notes.splitlines()]
    size = [r"\footnotesize"] if small else []
    if height <= _PAGE:
        inner = [rf"\begin{{tabular}}{{@{{}}{form}@{{}}}}", *head, *body, r"\bottomrule", r"\end{tabular}"]
        return [r"\begin{table}", *caption, *size, *inner, *notes, r"\end{table}", ""]
    caption = [line + r" \\" for line in caption]
    inner = [*caption, *head, r"\endfirsthead", *head, r"\endhead", *body, r"\bottomrule"]
    return [
        r"\begingroup",
        *size,
        rf"\begin{{longtable}}{{@{{}}{form}@{{}}}}",
        *inner,
        r"\end{longtable}",
        *notes,
        r"\endgroup",
        "",
    ]


def _filled(table: Table) -> list[Row]:
    """Rows with a cell for each head."""
    return [replace(row, cells=(*row.cells, *[""] * (len(table.heads) - len(row.cells)))) for row in table.rows]


def _tex_texts(row: Row, widths: Sequence[int]) -> list[str]:
    """Cells of a row for TeX.

    Headings are emphasised, and their rows indented as here. Words longer than their column, such as checksums, may
    break.
    """
    texts = [_breakable(text.strip(), width) for text, width in zip(row.texts(), widths, strict=False)]
    if row.heading:
        texts[0] = rf"\emph{{{texts[0]}}}"
    elif str(row.cells[0]).startswith("  "):
        texts[0] = rf"\quad {texts[0]}"
    return texts + [""] * (len(widths) - len(texts))


def _breakable(text: str, width: int) -> str:
    most = max(width // 2, 1)
    pieces = ([word[i : i + most] for i in range(0, len(word), most)] if len(word) > width else [word]
              for word in text.split(" "))  # fmt: skip
    return " ".join(r"\allowbreak{}".join(map(tex_text, word)) for word in pieces)


def _shared(widths: Sequence[int], room: int) -> list[int]:
    """Share of the room for columns of some widths: all they need if that is at most what others get."""
    kept = [*widths]
    wide = sorted(range(len(widths)), key=lambda i: widths[i])
    for done, i in enumerate(wide):
        kept[i] = min(widths[i], max(room // (len(wide) - done), 1))
        room -= kept[i]
    return kept


TIDY = ("table", "section", "row", "column", "part", "unit", "value", "low", "high", "text")
"""Columns of tables as CSV."""
_UNIT = re.compile(r", (m/s|deg/s|deg/h|deg|m|s|mg|%|°|dB-Hz|\(deg/s\)²|deg2)(?=$|[ ,:(\[])")


def _unit(*texts: str) -> str:
    """Unit after a comma in the first of some texts that has one; 1 for none."""
    return next((found[1] for text in texts if (found := _UNIT.search(text))), "1")


def _own_units(pattern: str) -> list[str]:
    """Units after the values of a pattern, "" for none: only % is recognised."""
    behind = [literal for literal, *_ in Formatter().parse(pattern)][1:]
    places = sum(field is not None for _, field, *_ in Formatter().parse(pattern))
    return ["%" if text.lstrip().startswith("%") else "" for text in (*behind, "")][:places]


def tidy(table: Table) -> list[list[object]]:
    """Rows of a table for programs under `TIDY`.

    One for each number, with the ends of its interval if known; one for each cell without a number.
    """
    out: list[list[object]] = []
    section = ""
    for row in table.rows:
        label, *cells = row.cells
        if row.heading:
            section = str(label)
            continue
        for head, one in zip(table.heads[1:], cells, strict=False):
            where = [table.title, section, str(label).strip(), head]
            unit = _unit(str(label), head, section)
            numbers = _numbers(one) if isinstance(one, Cell) else []
            if not numbers:
                out.append([*where, "", unit, "", "", "", str(one)])
            for name, value, low, high, own in numbers:
                out.append([*where, name, own or unit, value, low, high, str(one)])
    return out


def _numbers(one: Cell) -> list[tuple[str, float | int, float, float, str]]:
    """The numbers of a cell: name, value, ends of its interval, and unit where it has its own."""
    units = _own_units(one.pattern)
    chosen_ones = [
        k for k, value in enumerate(one.values)
        if isinstance(value, float | int) and not (one.ends and k in (1, 2))
    ]  # fmt: skip
    out = []
    for k in chosen_ones:
        ends = (one.values[1], one.values[2]) if one.ends and k == 0 else (math.nan, math.nan)
        name = one.names[k] if one.names else "" if len(chosen_ones) == 1 else str(k + 1)
        unit = (one.units[k] if one.units else "") or one.unit or (units[k] if k < len(units) else "")
        out.append((name, one.values[k], float(ends[0]), float(ends[1]), unit))
    return out  # type: ignore[return-value] # numbers were chosen


def chosen(tables: Sequence[Table], pattern: str) -> list[Table]:
    """Rows whose first cell matches the pattern, with their headings.

    `*` and `?` work as in file names, anywhere and in any case. If no row matches, those under a matching heading.
    Tables without a match are omitted.
    """
    wanted = re.compile(fnmatch.translate(f"*{pattern}*"), re.IGNORECASE)
    for by_heading in (False, True):
        found = [replace(table, rows=rows) for table in tables if (rows := _chosen(table, wanted, by_heading))]
        if found:
            return found
    return []


def _chosen(table: Table, wanted: re.Pattern[str], by_heading: bool) -> list[Row]:
    rows: list[Row] = []
    heading: Row | None = None
    under = False
    for row in table.rows:
        first = str(row.cells[0])
        if row.heading:
            heading, under = row, bool(wanted.match(first))
        elif under if by_heading else wanted.match(first):
            rows += [row] if heading is None else [heading, row]
            heading = None
    return rows


def csv_text(heads: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV; numbers with ten digits, empty if unknown."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows([as_text(value) for value in row] for row in rows)
    return out.getvalue()


def as_text(value: object) -> str:
    """A value in a CSV file: ten digits of a number, empty if unknown."""
    if isinstance(value, float):  # numpy's are
        return "" if math.isnan(value) else f"{float(value):.10g}"
    return str(value)
