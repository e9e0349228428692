"""Tables as plain data, and how they are drawn."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console

from navsim.report.table import Cell, Table, cell, console, csv_text, interval, markdown, number, numbers


@pytest.mark.parametrize(
    ("shown", "text"),
    [
        (number(1.23456), "1.235"),
        (number(math.nan), "-"),
        (number(-math.inf, 1), "-"),
        (numbers([1.0, math.nan, -0.25], 2), "1.00  -  -0.25"),
        (interval([1.0, 0.5, 2.0], 1), "1.0  [0.5, 2.0]"),
        (interval([1.0, math.nan, math.nan], 1), "1.0  [-, -]"),
        (interval([math.nan, 0.5, 2.0], 1), "-"),
        (interval([1.0, 0.5, 2.0], 1, scale=10.0), "10.0  [5.0, 20.0]"),
        (cell("{} of {:.1f} %, {}", 3, 2.55, "all"), "3 of 2.5 %, all"),
        (cell("{:+.1f}", 1.0), "+1.0"),
    ],
)
def test_numbers_are_kept_and_said(shown: Cell, text: str) -> None:
    assert str(shown) == text


def made() -> Table:
    out = Table("Errors [m]", ("filter", "RMS [95 %], m"), notes="* of one run")
    out.head("[b]flown[/b]", "two\nlines")
    out.add("S1", interval([1.0, 0.5, 2.0], 1))
    out.add("short")
    return out


def test_in_the_terminal() -> None:
    """Words that look like rich's own marks stay words."""
    file = io.StringIO()
    Console(file=file, width=60).print(console([made(), "what [bold]was[/bold] meant"]))
    lines = [line.rstrip() for line in file.getvalue().splitlines()]
    for text in ("Errors [m]", "filter", "RMS [95 %], m", "[b]flown[/b]", "1.0  [0.5, 2.0]", "* of one run"):
        assert sum(text in line for line in lines) == 1, (text, lines)
    assert lines[-1] == "what [bold]was[/bold] meant"


def test_as_markdown() -> None:
    assert markdown(made()) == [
        "| filter | RMS [95 %], m |",
        "|---|---|",
        "| [b]flown[/b] | two<br>lines |",
        "| S1 | 1.0  [0.5, 2.0] |",
        "| short |  |",
        "",
    ]


def test_as_csv() -> None:
    rows = [[1, 0.1, math.nan], ["a,b", 1e-12, -2.0]]
    assert csv_text(("n", "x", "y"), rows) == 'n,x,y\n1,0.1,\n"a,b",1e-12,-2\n'
