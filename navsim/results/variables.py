"""Variables of a kind of result in words, from the schema, for `navsim variables` and the reference pages."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from navsim.results.schema import ONE_FLIGHT, SECTIONS, Entry, fields


@dataclass(frozen=True)
class VariableRow:
    """A variable of a result, or a family of similar ones."""

    paths: tuple[str, ...]
    """One for each member of the family; a name in <> is one that the study gives."""
    dimensions: tuple[str, ...]
    unit: str
    holds: str
    """Type of its content."""
    meaning: str
    when: str
    """Condition for it to be there, "" for always."""
    attributes: tuple[str, ...]
    """In addition to units and long_name."""

    def facts(self) -> str:
        """All but path and meaning, in a line."""
        parts = [self.holds, self.unit, f"({', '.join(self.dimensions)})" if self.dimensions else "scalar", self.when]
        return "; ".join(part for part in parts if part)


def rows_of(layout: str) -> Iterator[tuple[str, VariableRow]]:
    """Title of the chapter, and row, of every variable that a result of a layout may contain."""
    for section in SECTIONS:
        for entry in section.entries:
            if layout in entry.layouts:
                yield section.title, row_of(entry, layout)


def row_of(entry: Entry, layout: str) -> VariableRow:
    """The row of an entry of the schema in a layout."""
    meaning = with_members(entry, entry.meaning)
    if entry.labels:
        meaning += ": " + ", ".join(entry.labels)
    dimensions = tuple(_in_angle_brackets(d) for d in entry.dims if d != "run" or layout not in ONE_FLIGHT)
    return VariableRow(tuple(paths_of(entry)), dimensions, with_members(entry, entry.units), entry.of, meaning,
                       entry.layouts[layout], entry.attributes)  # fmt: skip


def paths_of(entry: Entry) -> list[str]:
    """The paths of an entry, one for each member of its families; a family that the study names is in <>."""
    named = [name for name in fields(entry.path) if name in entry.each]
    out = []
    for members in itertools.product(*(entry.each[name] for name in named)):
        path = entry.path
        for name, member in zip(named, members, strict=True):
            path = path.replace(f"{{{name}}}", member)
        out.append(_in_angle_brackets(path))
    return out


def _in_angle_brackets(text: str) -> str:
    """A path or dimension with the names that a study gives in <>."""
    return text.replace("{", "<").replace("}", ">")


def with_members(entry: Entry, text: str) -> str:
    """A unit or a meaning, with the word for its member or, in italics, for what comes with the data."""
    for name in fields(text):
        members = entry.each.get(name.lower(), ())
        only = (members[0].upper() if name.isupper() else members[0]) if len(members) == 1 else f"*{name}*"
        text = text.replace(f"{{{name}}}", only)
    return text
