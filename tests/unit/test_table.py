"""Tables as plain data, and how they are drawn."""

from __future__ import annotations

import io
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from navsim.cli.common import called, nearest_rows
from navsim.report import table
from navsim.report.compare import _widened
from navsim.report.requirement_rows import verdict_cell
from navsim.report.table import (
    TIDY,
    Cell,
    Row,
    Table,
    brief,
    cell,
    chosen,
    console,
    csv_text,
    interval,
    markdown,
    markdown_text,
    number,
    numbers,
    tex,
    tex_text,
    tidy,
)


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
        (number(-0.0004), "0.000"),
        (cell("{:+.1f} {:.2g}", -0.01, -1e-9), "+0.0 -1e-09"),
    ],
)
def test_numbers_are_kept_and_said(shown: Cell, text: str) -> None:
    assert str(shown) == text


@pytest.mark.parametrize(
    ("percent", "required", "text"),
    [(58.43, 95.0, "58.4"), (98.171, 95.0, "98.2"), (99.9877, 95.0, "99.988"), (99.999422, 95.0, "> 99.99"),
     (100.0, 95.0, "100"), (0.0, 95.0, "0"), (3e-7, 95.0, "< 0.01"), (0.0412, 95.0, "0.0412"),
     (95.006, 95.0, "95.01"), (94.998, 95.0, "94.998"), (95.0, 95.0, "95"),
     (99.99942, 99.999, "99.99942"), (99.999942, 99.999, "> 99.9999")],
)  # fmt: skip
def test_shares_are_shown_as_far_as_a_requirement_needs(percent: float, required: float, text: str) -> None:
    assert str(Cell(f"{{:share {required:g}}}", (percent,))) == text


@pytest.mark.parametrize(
    ("statement", "value", "limit", "then"),
    [("below 1 m in 95 % of runs", 0.986, 0.95, "met"), ("below 1 m in 95 % of runs", 0.93, 0.95, "not met"),
     ("RMS error below 0.2 m", 0.19, 0.2, "met"), ("RMS error below 0.2 m", 0.21, 0.2, "not met")],
)  # fmt: skip
def test_more_runs_are_shown_with_their_verdict(statement: str, value: float, limit: float, then: str) -> None:
    shown = verdict_cell(statement, "undecided", np.array([value, 0.5 * value, 1.0]), 70.0, limit)
    assert str(shown).endswith(f"; 70 more runs: {then}")


def made() -> Table:
    out = Table("Errors [m]", ("filter", "RMS [95 %], m"), notes="* of one run")
    out.head("[b]flown[/b]", "two\nlines")
    out.add("S1", interval([1.0, 0.5, 2.0], 1))
    out.add("short")
    return out


@pytest.mark.parametrize("width", [80, 100, 116])
def test_labels_give_way_to_values(width: int) -> None:
    """A statement as a label, and the values of two results, however narrow the terminal."""
    wide = Table("", ("", "one", "other"))
    statement = "LPV-200: P(fault-free vertical error > 10 m) at most 1e-07 at 99 % of epochs of the glide"
    wide.add(statement, "met", "1")
    wide.add("NEES", interval([1.0, 0.5, 2.0], 3), interval([3.0, 2.5, 4.0], 3))
    said = table.text([wide], width)
    assert "1.000  [0.500, 2.000]" in said
    assert "3.000  [2.500, 4.000]" in said
    assert "1e-07" in said
    assert "…" not in said


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
        "| **[b]flown[/b]** | **two<br>lines** |",
        "| S1 | 1.0  [0.5, 2.0] |",
        "| short |  |",
        "",
    ]


def test_markdown_keeps_columns_and_asterisks() -> None:
    wide = Table("", ("of", "a", "b - a"))
    wide.head("found | asked")
    wide.add("  x *", "1 *")
    assert markdown(wide)[2:4] == ["| **found \\| asked** |  |  |", "| x \\* | 1 \\* |  |"]
    assert markdown_text("* the end\n* < 3") == "\\* the end<br>\\* &lt; 3"
    assert markdown_text(r"_a_b `c` d\e") == r"\_a\_b \`c\` d\\e"
    assert markdown_text("[a](b) [a][b] [0.5, 2.0]") == r"[a\](b) [a\][b] [0.5, 2.0]"


def test_as_csv() -> None:
    rows = [[1, 0.1, math.nan], ["a,b", 1e-12, -2.0]]
    assert csv_text(("n", "x", "y"), rows) == 'n,x,y\n1,0.1,\n"a,b",1e-12,-2\n'


def test_as_tex() -> None:
    lines = tex(Table("50 % of a_b", ("x & y", "σ, °"), [Row((number(1.0), "{#}"))]))
    assert r"\caption{50 \% of a\_b}" in lines
    assert r"x \& y & $\sigma$, $^\circ$ \\" in lines
    assert r"1.000 & \{\#\} \\" in lines
    assert [line for line in lines if "rule" in line] == [r"\toprule", r"\midrule", r"\bottomrule"]


def test_tidy_and_chosen_rows() -> None:
    (only,) = chosen([made()], "s1")
    (row,) = tidy(only)
    assert dict(zip(TIDY, row, strict=True)) == {
        "table": "Errors [m]", "section": "[b]flown[/b]", "row": "S1", "column": "RMS [95 %], m", "part": "",
        "unit": "m", "value": 1.0, "low": 0.5, "high": 2.0, "text": "1.0  [0.5, 2.0]",
    }  # fmt: skip
    assert not chosen([made()], "nothing like it")
    (under,) = chosen([made()], "FLOWN")
    assert [str(r.cells[0]) for r in under.rows] == ["[b]flown[/b]", "S1", "short"]
    rest = Table("", ("",), [Row(("flown by S2",))])
    assert chosen([made(), rest], "FLOWN") == [rest]  # rows before headings, in all tables


def test_rows_like_a_pattern() -> None:
    assert nearest_rows("heigth", {"Filter, position error at height, m", "NIS", "PDOP"}) == [
        "Filter, position error at height, m"
    ]
    assert nearest_rows("nis", {"NIS", "PDOP"}) == ["NIS"]
    assert nearest_rows("qqqq", {"NIS", "PDOP"}) == []


def test_difference_and_ratio_with_intervals() -> None:
    """Of independent results, by Zou and Donner; without intervals where random numbers are shared."""
    both = Table("", ("", "a", "b"), [Row(("x, m", interval([1.0, 0.8, 1.4], 2), interval([2.0, 1.7, 2.5], 2)))])
    wide = _widened(both, ["a", "b"], [False, True]).rows[0].cells
    difference, ratio = wide[3], wide[4]
    assert isinstance(difference, Cell)
    assert isinstance(ratio, Cell)
    assert difference.values == pytest.approx((1.0, 1.0 - math.hypot(0.3, 0.4), 1.0 + math.hypot(0.5, 0.2)))
    down, up = math.hypot(math.log(2 / 1.7), math.log(1.4)), math.hypot(math.log(1.25), math.log(1 / 0.8))
    assert ratio.values == pytest.approx((2.0, 2.0 * math.exp(-down), 2.0 * math.exp(up)))
    alike = [str(cell) for cell in _widened(both, ["a", "b"], [False, False]).rows[0].cells[3:]]
    assert alike == ["+1.00", "2.000"]


@pytest.mark.parametrize(
    ("text", "set_so"),
    [
        ("-0.054  [-.1, 0.2]", "$-$0.054  [$-$.1, 0.2]"), ("2018-09-13", "2018-09-13"), ("1e-06", "1e-06"),
        ("R01 - PL1, 3-4", "R01 - PL1, 3-4"), ("(-3)", "($-$3)"), ("error-state", "error-state"),
    ],
)  # fmt: skip
def test_numbers_have_minus_signs_in_tex(text: str, set_so: str) -> None:
    assert tex_text(text) == set_so


def test_results_are_told_apart_by_their_names() -> None:
    assert called([Path("a/x.h5"), Path("b/y.h5")]) == ["x", "y"]
    assert called([Path("a/x.h5"), Path("b/x.h5")]) == ["a/x.h5", "b/x.h5"]
    assert called([Path("x.h5"), Path("x.h5")]) == ["x.h5 (1)", "x.h5 (2)"]


def test_no_number_of_a_cell_is_lost_in_csv() -> None:
    """Each with its name and its own unit, whatever stands beside it."""
    cells = {
        "budget, m": Cell("{:.3f} ({:.1f} %)", (0.2, 70.0), names=("alone", "share")),
        "share": Cell("{:.1f} %  [{:.1f}, {:.1f}]  (Gaussian {:.1f} %)", (90.0, 80.0, 95.0, 97.0), ends=True),
        "x, m": cell("{:.0f} - {:.0f}", 1.0, 3.0),
        "count": cell("{}", 4),
        "verdict": cell("{}: {:.2f}", "met", 0.5),
        "word": cell("{}", "none"),
    }
    table = Table("", ("", "a"), [Row((label, one)) for label, one in cells.items()])
    shown = [tuple(dict(zip(TIDY, row, strict=True)).values())[2:] for row in tidy(table)]
    assert [(row, part, unit, value) for row, _, part, unit, value, *_ in shown] == [
        ("budget, m", "alone", "m", 0.2), ("budget, m", "share", "%", 70.0), ("share", "1", "%", 90.0),
        ("share", "4", "%", 97.0), ("x, m", "1", "m", 1.0), ("x, m", "2", "m", 3.0), ("count", "", "1", 4),
        ("verdict", "", "1", 0.5), ("word", "", "1", ""),
    ]  # fmt: skip
    assert shown[2][5:7] == (80.0, 95.0)
    assert all(math.isnan(low) for _, _, _, _, _, low, *_ in shown[3:8])
    both = Table("", ("", "a", "b"), [Row(("x, m", cell("{:.2f}", 1.0), cell("{:.2f}", 2.0)))])
    compared = tidy(_widened(both, ["a", "b"], [False, False]))
    assert [(row[3], row[5], row[6]) for row in compared] == [
        ("a", "m", 1.0), ("b", "m", 2.0), ("b - a", "m", 1.0), ("b / a", "1", 2.0)
    ]  # fmt: skip
    fits = Table("", ("", "rms / max, %"), [Row(("A", cell("{:.1f} / {:.1f}", 1.0, 2.0)))])
    assert [row[5] for row in tidy(fits)] == ["%", "%"]


def test_counts_are_compared_by_what_they_are_counted_in() -> None:
    """Twice the runs have twice the fixes, and no more a run."""
    counts = [Cell("{}", (fixes,), trials=runs) for fixes, runs in ((600, 20), (1200, 40), (1240, 40))]
    alarms = [Cell("{} of {}", (n, of), trials=of, trial="tested epoch") for n, of in ((1, 100), (4, 200), (0, 0))]
    both = Table("", ("", "a", "b", "c"), [Row(("fixes", *counts)), Row(("alarms", *alarms))])
    wide = _widened(both, ["a", "b", "c"], [False, True, True])
    assert wide.rows[0].texts()[4:] == ["+0 a run", "1.000", "+1 a run", "1.033"]
    assert wide.rows[1].texts()[4:] == ["+0.01 a tested epoch", "2.000", "-", "-"]
    assert "counts are compared per run" in wide.notes
    units = [(row[3], row[5]) for row in tidy(wide) if row[2] == "fixes" and row[6] == pytest.approx(1.0)]
    assert units == [("b / a", "1"), ("c - a", "1/run")]


def test_captions_and_rows_that_tex_takes_as_they_are() -> None:
    r"""What begins with a bracket or an asterisk is no argument of the `\\` before it."""
    made_so = Table("Errors", ("[x]", "y, m"), [Row(("*", number(1.0)))], caption="Of 20 runs; 95 % in [low, high]")
    lines = tex(made_so)
    assert r"\caption{Errors. Of 20 runs; 95 \% in [low, high]}" in lines
    assert r"{}[x] & y, m \\" in lines
    assert r"{}* & 1.000 \\" in lines
    assert not any(r"\caption" in line for line in tex(Table("", ("x",))))


def wide_table(rows: int) -> Table:
    out = Table("Wide", ("", *"abcd"), notes="one\ntwo")
    out.head("A heading of rows that says much", *["what stands in the column, m"] * 4)
    for i in range(rows):
        out.add(f"  row {i}, of more than a few words", *(interval([i, i - 0.5, i + 0.5], 3) for _ in range(4)))
    out.add("checksum", "0123456789abcdef" * 4)
    return out


@pytest.mark.parametrize("paper", ["a4paper", "letterpaper"])
def test_tex_fits_the_page(paper: str, tmp_path: Path) -> None:
    if shutil.which("pdflatex") is None:
        pytest.skip("no pdflatex on this machine")
    small = Table("Small", ("x", "y"), [Row(("a", number(1.0)))])
    text = "\n".join(line for table in (small, wide_table(3), wide_table(60)) for line in tex(table))
    packages = r"\usepackage[utf8]{inputenc}\usepackage{booktabs,array,longtable}"
    document = rf"\documentclass[{paper}]{{article}}{packages}\begin{{document}}{text}\end{{document}}"
    (tmp_path / "t.tex").write_text(document)
    command = ["pdflatex", "-halt-on-error", "t"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "Overfull" not in done.stdout
    assert "too large" not in done.stdout


def test_tex_sets_in_and_breaks() -> None:
    lines = tex(wide_table(3))
    assert r"\footnotesize" in lines
    assert any(line.startswith(r"\quad row 0") for line in lines)
    assert any(r"\allowbreak{}" in line for line in lines)
    assert any("p{" in line for line in lines if r"\begin{tabular}" in line)
    assert any(r"\begin{longtable}" in line for line in tex(wide_table(60)))


def test_a_group_without_values_is_one_row() -> None:
    table = Table("", ("", "one"))
    table.add("runs", "1")
    for head, value in (("Position at height", "-"), ("NEES", "1.02")):
        table.head(head, "RMS")
        table.add("  touchdown", "-")
        table.add("  50 ft", value)
    assert [row.texts() for row in brief(table).rows] == [
        ["runs", "1"], ["Position at height", "-"], ["NEES", "RMS"], ["  touchdown", "-"], ["  50 ft", "1.02"],
    ]  # fmt: skip
