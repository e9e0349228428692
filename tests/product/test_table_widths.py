"""Tables of every kind of result fit a terminal of 80 columns, comparisons 120, with every number whole."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from navsim.report.compare import compared
from navsim.report.provenance import Read, provenance
from navsim.report.table import Table, brief, text
from navsim.report.view import view
from navsim.results.result import Result, read
from tests.conftest import ROOT, SCENARIOS
from tests.forks import navsim
from tests.made import EVERY

_WHOLE = re.compile(r"\[[^\[\]]*\]|\S+")
"""What no line may end within: an interval, a number, a word."""
_LONGEST_WORD = 40
"""Letters from which on a word is no number, as a checksum."""


def numbers(parts: Sequence[Table | str]) -> Iterator[str]:
    """Intervals, numbers and words of all cells and heads."""
    for table in parts:
        if isinstance(table, Table):
            for cell in (*table.heads, *(text for row in brief(table).rows for text in row.texts())):
                yield from (found for found in _WHOLE.findall(cell) if len(found) < _LONGEST_WORD)


def check(parts: Sequence[Table | str], width: int) -> None:
    drawn = text(parts, width)
    assert max(map(len, drawn.splitlines())) <= width
    assert "…" not in drawn
    lost = [number for number in numbers(parts) if number not in drawn]
    assert not lost


def tables_of(result: Result, name: str) -> Sequence[Table | str]:
    return view(result.attributes["kind"]).tables([(name, result)])


@pytest.mark.parametrize("name", EVERY)
def test_tables_fit_80_columns(name: str, place: Path) -> None:
    result = read(place / f"{name}.h5")
    check(tables_of(result, name), 80)
    check([provenance([Read(name, place / f"{name}.h5", result)])], 80)


EVERYTHING = (
    "duration_s=65", "imu.rate_hz=20", "receiver.rate_hz=1", "receiver.single_clock=false", "title=everything",
    "wind={speed_m_s: 8, from_deg: 40}", "radio_altimeter={sigma_floor_m: 0.3}",
    "barometric_altimeter={sigma_m: 1, qnh_sigma_hpa: 1}", "runway.geoid_undulation_m=17",
    "box={lateral_m: 1.5, vertical_m: [-1, 2]}", "wind.response={}",
    "integrity={method: mhss, limits: {hal_m: 40, val_m: 60, tta_s: 2}}",
    "requirements=[{what: rms, of: horizontal, below_m: 0.2}]",
)  # fmt: skip
"""A landing whose summary has nearly every section."""


def test_a_summary_with_every_section(tmp_path: Path) -> None:
    settings = (part for setting in EVERYTHING for part in ("--set", setting))
    navsim("run", SCENARIOS / "landing.yaml", *settings, "--runs", 3, "-q", "--figures", "none", "-o", "all.h5",
           cwd=tmp_path)  # fmt: skip
    parts = tables_of(read(tmp_path / "all.h5"), "all")
    check(parts, 80)
    sections = [str(row.cells[0]) for table in parts if isinstance(table, Table) for row in table.rows if row.heading]
    assert len(sections) > 10


def test_results_side_by_side_and_compared(place: Path) -> None:
    """Of one run, several and a covariance analysis; as many as there are go below each other."""
    results = [(name, read(place / f"{name}.h5")) for name in ("one", "runs", "evil", "covariance")]
    tables = view("landing").tables
    check(tables(results), 80)
    parts = compared(results, tables(results), [tables([each]) for each in results])
    check(parts, 80)
    check(parts, 120)


def in_terminal(columns: int, *arguments: object) -> str:
    """What navsim prints on a terminal of so many columns."""
    main, other = pty.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    environment = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "navsim", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=other, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, cwd=ROOT,
                               env=environment | {"TERM": "xterm"})  # fmt: skip
    os.close(other)
    said = b""
    while True:
        try:
            more = os.read(main, 65536)
        except OSError:  # the other end is closed
            more = b""
        if not more:
            break
        said += more
    os.close(main)
    assert process.wait() == 0
    return re.sub(r"\x1b\[[0-9;]*m", "", said.decode()).replace("\r", "")


def test_a_comparison_in_a_wide_terminal(place: Path) -> None:
    """It is asked for its width; a comparison is not wider than people read, however wide it is."""
    files = [place / f"{name}.h5" for name in ("runs", "evil")]
    for columns, options, most in ((80, (), 80), (200, ("--compare",), 120)):
        drawn = in_terminal(columns, "show", *files, *options)
        assert 0.7 * most < max(map(len, drawn.splitlines())) <= most
