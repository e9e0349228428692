"""Tables in text files: a header with names of columns, then rows of numbers, as programs and spreadsheets write them.

Cells are separated by commas, semicolons, tabs, bars or blanks, whichever the header has, and may be quoted. A first
line `sep=;` (Excel), lines that begin with #, and empty rows at the end are no part of a table. A header may itself be
such a comment (numpy), and may give units in brackets: `lat (deg)` is `lat_deg`. Where cells have a decimal comma, all
have it.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navsim.formats.text import Dropped, FileError, number

_SEPARATORS = (",", ";", "\t", "|")
_COMMENT = ("#", "%")
_EMPTY = ("", "nan", "na", "null")
"""Texts, in any case, for a missing number in cells that may be empty."""
_UNITS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "sec": "s", "second": "s",
    "seconds": "s", "µs": "us", "μs": "us", "hour": "h", "hr": "h", "meter": "m", "meters": "m", "metre": "m",
    "metres": "m", "foot": "ft", "feet": "ft", "knot": "kn", "knots": "kn", "kt": "kn", "kts": "kn", "dps": "deg/s",
    "kmh": "km/h", "kph": "km/h", "fps": "ft/s", "fpm": "ft/min", "dege7": "1e-7 deg",
}  # fmt: skip
"""Other spellings of units and their parts."""
_NO_UNITS = ("", "-", "1")


@dataclass(frozen=True)
class TextTable:
    """A table that is not read yet: names of its columns, their separator (None for blanks), number of the header's
    line, rows with the numbers of their lines."""

    path: Path
    names: tuple[str, ...]
    separator: str | None
    header: int
    lines: list[str]
    numbers: list[int]

    @classmethod
    def of(cls, path: Path, lines: list[str]) -> TextTable:
        """The table of a file's lines. Raises FileError where no line is a header."""
        separator: str | None = ""
        comment = 0
        for index, line in enumerate(lines, 1):
            text = line.strip()
            if separator_line := re.fullmatch(r'\s*"?sep=(.)"?[\s,;]*', line, re.IGNORECASE):
                separator = separator_line[1]
            elif text.startswith(_COMMENT):
                comment = index
            elif text:
                break
        else:
            raise FileError(0, "the file has no table", path)
        header = index
        if _is_of_numbers(text):
            if not comment:
                raise FileError(index, "the table has no header; begin it with a line that names the columns", path)
            header = comment  # the last comment before the first row
        head = lines[header - 1].strip().lstrip("".join(_COMMENT)).strip() if header == comment else lines[header - 1]
        separator = separator or _separator(head)
        names = tuple(cell.strip().strip("'") for cell in _cells(path, header, head, separator))
        junk = f' "{"".join(_SEPARATORS)}'
        first = header if header != comment else index - 1
        last = len(lines)
        while last > first and not lines[last - 1].strip(junk):
            last -= 1
        numbers = [
            n for n in range(first + 1, last + 1)
            if (row := lines[n - 1].lstrip()) and not row.startswith(_COMMENT)
        ]  # fmt: skip
        return cls(path, names, separator, header, lines, numbers)

    def find(self, name: str) -> int | None:
        """Place of a column: of this very name, or of this name with its unit in brackets, or in other letters. Raises
        FileError where several are."""
        for same in (lambda there: there == name, lambda there: _canonical(there) == _canonical(name)):
            places = [place for place, there in enumerate(self.names) if same(there)]
            if len(places) > 1:
                raise FileError(self.header, f"several columns are called {name}; rename all but one", self.path)
            if places:
                return places[0]
        return None

    def check_unit(self, name: str, due: str, known: Collection[str], key: str) -> None:
        """Raise FileError if the header gives a column in brackets a unit of `known` that is not the one due.

        key: of the file that declares the unit, "" if the unit cannot be chosen.
        """
        place = self.find(name)
        unit = None if place is None else bracketed_unit(self.names[place])
        if unit in known and unit != due:
            cure = f"{key} is {due}; write {key}: {unit}" if key else f"navsim takes it in {due}; convert it"
            assert place is not None
            raise FileError(self.header, f"the column {self.names[place]} is in {unit}, but {cure}", self.path)

    def read(
        self, wanted: Sequence[str], optional: Sequence[str], may_be_empty: Collection[str], dropped: Dropped
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns `wanted` and `optional` (nan if absent), and the line number of each row.

        may_be_empty: columns whose cells may be empty, which gives nan. dropped: a lenient one skips rows that cannot
        be read. Raises FileError.
        """
        found = {name: self.find(name) for name in (*wanted, *optional)}
        missing = [name for name in wanted if found[name] is None]
        if missing:
            there = ", ".join(self.names)
            optional = ", ".join(name for name in missing if name in may_be_empty)
            empty = f" (cells of {optional} may be empty)" if optional else ""
            message = f"the header lacks {', '.join(missing)}{empty}; the header has {there[:300]}"
            raise FileError(self.header, message, self.path)
        columns = {name: place for name, place in found.items() if place is not None}
        if not self.numbers:
            raise FileError(self.header, "the table has no rows", self.path)
        numbers = self.numbers
        table = self._fast(list(columns.values()))
        if table is None:
            table, numbers = self._by_cells(columns, may_be_empty, dropped)
        out = np.full((len(numbers), len(found)), np.nan)
        out[:, [place for place, name in enumerate(found) if name in columns]] = table
        return out, np.array(numbers)

    def texts(self, name: str) -> list[str]:
        """Cells of a column as text, one for each row. Raises FileError."""
        place = self.find(name)
        if place is None:
            there = ", ".join(self.names)
            raise FileError(self.header, f"the header lacks {name}; it has {there[:300]}", self.path)
        return [self._row(line)[place].strip() for line in self.numbers]

    def _fast(self, places: list[int]) -> np.ndarray | None:
        """The columns at these places; None for tables that have to be read cell by cell, or are wrong."""
        rows = [self.lines[n - 1] for n in self.numbers]
        due = len(self.names) - 1
        if self.separator is None:
            whole = all(len(row.split()) - 1 == due for row in rows)
        else:
            whole = all(row.count(self.separator) == due for row in rows)
        if self.separator != "," and any("," in row for row in rows):
            whole = whole and not any("." in row for row in rows)
            rows = [row.replace(",", ".") for row in rows]
        if not whole:
            return None
        try:
            table = np.loadtxt(
                rows, delimiter=self.separator, usecols=places, ndmin=2, comments=None, quotechar='"'
            )  # fmt: skip
        except ValueError:
            return None
        return table if np.all(np.isfinite(table)) else None

    def _by_cells(
        self, columns: dict[str, int], may_be_empty: Collection[str], dropped: Dropped
    ) -> tuple[np.ndarray, list[int]]:
        rows, numbers = [], []
        marks: dict[str, int] = {}
        for line in self.numbers:
            try:
                cells = self._row(line)
                self._check_decimals([cells[place] for place in columns.values()], line, marks)
                rows.append([self._value(line, cells[place], name, may_be_empty) for name, place in columns.items()])
                numbers.append(line)
            except FileError as error:
                dropped.damaged("rows left out", error)
        if not rows:
            raise FileError(0, "the table has no row that can be read", self.path)
        return np.array(rows), numbers

    def _row(self, line: int) -> list[str]:
        cells = _cells(self.path, line, self.lines[line - 1], self.separator)
        due = len(self.names)
        while len(cells) > due and not cells[-1].strip():
            cells.pop()
        if len(cells) != due:
            cure = ""
            if self.separator == "," and len(cells) > due:
                cure = "; if the decimals have commas, separate the cells by semicolons"
            raise FileError(line, f"the row has {len(cells)} cells, the header {due}{cure}", self.path)
        return cells

    def _check_decimals(self, cells: list[str], line: int, marks: dict[str, int]) -> None:
        """Note which decimal mark cells have. Raises FileError where both are in the table: 1,234 is then anything."""
        for mark in ",.":
            if any(mark in cell for cell in cells):
                marks.setdefault(mark, line)
        if len(marks) > 1:
            comma, point = marks[","], marks["."]
            message = f"decimal commas on line {comma}, points on line {point}; write one kind in all numbers"
            raise FileError(line, message, self.path)

    def _value(self, line: int, cell: str, name: str, may_be_empty: Collection[str]) -> float:
        if cell.strip().lower() in _EMPTY and name in may_be_empty:
            return np.nan
        return number(self.path, line, cell.replace(",", "."), name)


class StreamedTable:
    """A table whose lines come one by one: positions of its wanted columns, and separator.

    Without a header the columns are in the wanted order, and the first row shows the separator.
    """

    def __init__(self, wanted: Sequence[str]) -> None:
        self.wanted = tuple(wanted)
        self._places = list(range(len(self.wanted)))
        self._separator: str | None = ""

    def header(self, line: str) -> list[str] | None:
        """Use a line if it is a header, which contains the first wanted column.

        Returns the missing wanted columns, else None. A header with missing columns determines only the separator.
        """
        text = line.strip().lstrip("".join(_COMMENT)).strip()
        if not text or _is_of_numbers(text):
            return None
        try:
            table = TextTable.of(Path("stream"), [text])
            places = [table.find(name) for name in self.wanted]
        except FileError:
            return None
        if places[0] is None:
            return None
        self._separator = table.separator
        lacking = [name for name, place in zip(self.wanted, places, strict=True) if place is None]
        if not lacking:
            self._places = [place for place in places if place is not None]
        return lacking

    def row(self, line: str) -> list[str] | None:
        """Wanted cells of a line, with decimal points, None if it has fewer."""
        if self._separator == "":
            if not _is_of_numbers(line):
                return None
            # commas may be decimal ones with any other separator
            self._separator = next((one for one in (*_SEPARATORS[1:], _SEPARATORS[0]) if one in line), None)
        try:
            cells = _cells(Path("stream"), 0, line, self._separator)
        except FileError:
            return None
        if len(cells) <= max(self._places):
            return None
        return [cells[place].strip().replace(",", ".") for place in self._places]


def _separator(head: str) -> str | None:
    """Separator of the names of a header: the most frequent one; None for blanks."""
    bare = re.sub(r'"[^"]*"', "", head)
    most = max(_SEPARATORS, key=bare.count)
    return most if most in bare else None


def _cells(path: Path, line: int, text: str, separator: str | None) -> list[str]:
    """The cells of a line. Raises FileError."""
    try:
        if separator is None:
            return next(csv.reader([text.replace("\t", " ").strip()], delimiter=" ", skipinitialspace=True), [])
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error as error:
        raise FileError(line, f"this line is no row of a table: {error}", path) from None


def _is_of_numbers(text: str) -> bool:
    """Whether a line looks like a row, not like names."""
    return bool(text.strip()) and not re.sub(r"[-+.\d,;|\s\"]|[eE][-+]?\d|nan", "", text)


def _canonical(name: str) -> str:
    """A name in small letters, with a unit in brackets as its suffix."""
    base, unit = column_base(name), (bracketed_unit(name) or "").replace("/", "_")
    return base if unit in _NO_UNITS or base.endswith(f"_{unit}") else f"{base}_{unit}"


def column_base(name: str) -> str:
    """A column's name in small letters, without a unit in brackets."""
    return re.sub(r"\s+", "_", re.sub(r"(?<=.)\s*[\[(][^\[\]()]*[\])]$", "", name).strip().lower())


def bracketed_unit(name: str) -> str | None:
    """The unit in brackets at the end of a column's name, in the usual spelling, such as m/s2; None without."""
    bracketed = re.fullmatch(r".+?\s*[\[(]([^\[\]()]*)[\])]", name)
    if not bracketed:
        return None
    unit = re.sub(r"\^|\*\*", "", bracketed[1].strip().lower()).replace("²", "2")
    unit = _UNITS.get(unit, unit)
    return "/".join(_UNITS.get(part.strip(), part.strip()) for part in unit.split("/"))
