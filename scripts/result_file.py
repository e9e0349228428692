"""Write docs/result-file.md, the page of the result file, from the schema of results. Run by `make docs`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from navsim.io.schema import FAMILIES, LAYOUTS, ONE_FLIGHT, ROOT, SECTIONS, WORDS, Entry, fields

PAGE = Path(__file__).resolve().parent.parent / "docs" / "result-file.md"
HEAD = """# The result file

Made by `make docs` from `navsim/io/schema.py`, by which results are written.

A result is an HDF5 file that is valid netCDF-4: groups, variables with named dimensions, coordinates named like their
dimension. Every variable has `units` and `long_name`; nan stands for what is not known. In results of flights (landing,
covariance, replay, live) the same path is the same quantity. [conventions.md](conventions.md) defines frames and signs,
[landing.md](landing.md) says how damage shows.

| layout | what it is |
|---|---|
"""
NOTES = """
The axis `run` is always there in runs of a landing, also of length 1; {one_flight} are one flight and have none.
`*axes` are all axes of a sweep. The last column has the attributes beside `units` and `long_name`.

A name in <> stands for each member of a family: {families}.

A word in italics stands for the member, or comes with the data: {words}.
"""
TABLE = ["| path | dimensions | unit | holds | what | in (when) | attributes |", "|---|---|---|---|---|---|---|"]


def path_of(entry: Entry) -> str:
    """The path of an entry, with the members of its families."""
    out = entry.path
    for name in fields(entry.path):
        members = entry.each.get(name, ())
        shown = f"<{name}>" if not members else members[0] if len(members) == 1 else "{" + ", ".join(members) + "}"
        out = out.replace(f"{{{name}}}", shown)
    return f"`{out}`"


def said(entry: Entry, text: str) -> str:
    """A unit or a meaning, with what stands for the member or comes with the data."""
    for name in fields(text):
        members = entry.each.get(name.lower(), ())
        only = (members[0].upper() if name.isupper() else members[0]) if len(members) == 1 else f"*{name}*"
        text = text.replace(f"{{{name}}}", only)
    return text


def _in(layouts: Mapping[str, str]) -> str:
    """Layouts of results, and on which condition each."""
    if len(layouts) == len(LAYOUTS) and not any(layouts.values()):
        return "all"
    return ", ".join(f"{name} ({when})" if when else name for name, when in layouts.items())


def row(entry: Entry) -> str:
    """The row of an entry."""
    dims = ", ".join(dim.replace("{", "<").replace("}", ">") for dim in entry.dims)
    meaning = said(entry, entry.meaning)
    if entry.labels:
        meaning += ": " + ", ".join(entry.labels)
    cells = (path_of(entry), f"`{dims}`" if dims else "", said(entry, entry.units), entry.of, meaning,
             _in(entry.layouts), ", ".join(entry.attributes))  # fmt: skip
    return f"| {' | '.join(cells)} |"


def page() -> str:
    """The whole page."""
    families = "; ".join(f"<{name}> {what}" for name, what in FAMILIES.items())
    words = "; ".join(f"*{name}* {what}" for name, what in WORDS.items())
    lines = [HEAD + "\n".join(f"| {name} | {what} |" for name, what in LAYOUTS.items())]
    lines.append(NOTES.format(one_flight=" and ".join(ONE_FLIGHT), families=families, words=words))
    lines += ["## Root attributes", "", "| attribute | what | in |", "|---|---|---|"]
    lines += [f"| `{name}` | {what} | {_in(dict.fromkeys(layouts, ''))} |" for name, (layouts, what) in ROOT.items()]
    lines.append("")
    for section in SECTIONS:
        rows = map(row, section.entries)
        lines += [f"## {section.title}", "", section.text, "", *TABLE, *rows, ""]
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page())
