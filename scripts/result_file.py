"""Pages of the result file, one for each kind of result, from the schema of results. Written by `reference.py`."""

from __future__ import annotations

from collections.abc import Iterator

from navsim.results.schema import FAMILIES, LAYOUTS, ONE_FLIGHT, ROOT, SECTIONS, WORDS, Entry
from navsim.results.variables import row_of

HEAD = """# Variables of a result: {layout}

{what}. Made from `navsim/results/schema.py`, by which navsim writes results.
[The result file](../../result-file.md) explains the format.
{run}
## Root attributes

| attribute | what |
|---|---|
"""
TABLE = ["| path | dimensions | unit | holds | what | when | attributes |", "|---|---|---|---|---|---|---|"]


def row(entry: Entry, layout: str) -> str:
    """The row of an entry on the page of a layout."""
    found = row_of(entry, layout)
    paths, dims = ", ".join(f"`{path}`" for path in found.paths), ", ".join(found.dimensions)
    cells = (paths, f"`{dims}`" if dims else "", found.unit, found.holds, found.meaning, found.when,
             ", ".join(found.attributes))  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _explained(title: str, listed: Iterator[tuple[str, str]]) -> list[str]:
    rows = [f"| {name} | {what} |" for name, what in listed]
    return [f"## {title}", "", "| name | meaning |", "|---|---|", *rows, ""] if rows else []


def page(layout: str) -> str:
    """The page of a layout."""
    what = LAYOUTS[layout]
    run = "\nThe axis `run` is always there, also of length 1.\n" if layout == "landing" else ""
    run = "\nOne flight, without an axis `run`.\n" if layout in ONE_FLIGHT else run
    lines = [HEAD.format(layout=layout, what=f"{what[:1].upper()}{what[1:]}", run=run).rstrip("\n")]
    lines += [f"| `{name}` | {meaning} |" for name, (layouts, meaning) in ROOT.items() if layout in layouts]
    lines.append("")
    entries = []
    for section in SECTIONS:
        if here := [entry for entry in section.entries if layout in entry.layouts]:
            lines += [f"## {section.title}", "", section.text, "", *TABLE, *(row(e, layout) for e in here), ""]
            entries += here
    text = "\n".join(lines)
    families = ((f"`<{name}>`", what) for name, what in FAMILIES.items() if f"<{name}>" in text)
    words = ((f"*{name}*", what) for name, what in WORDS.items() if f"*{name}*" in text)
    lines += _explained("Names in <>", families) + _explained("Words in italics", words)
    return "\n".join(lines)


def pages() -> dict[str, str]:
    """All pages, by their names in docs/reference."""
    return {f"results/{layout}.md": page(layout) for layout in LAYOUTS}
