"""The notebooks of docs/notebooks, executed cell by cell: none fails, and what they print is so.

A notebook whose cells have run at length since they, the parameters of what they call or their scenarios changed runs
in brief (`BRIEF`), as a program; any other as it is written, by Jupyter; with `--as-written` all do: see
`tests/at_length.py`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests import at_length
from tests.conftest import ROOT
from tests.forks import PYTHON, XARRAY, shared

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.md"))
TABLE = ROOT / "tests" / "notebooks_at_length.txt"
BRIEF = (
    ("runs=100", "runs=30"),
    ('"count": 40', '"count": 8'),
    ('"count": 51', '"count": 11'),
    ('"pseudolites": [1, 2], "effort": 1}', '"pseudolites": [1], "effort": 1}, runs=8'),
)
"""What is written in notebooks, and what is run instead in brief."""


def cells(file: Path) -> str:
    """The cells of a notebook, one after the other."""
    return "\n".join(re.findall(r"^```\{code-cell\}.*\n([^`]*)^```$", file.read_text(encoding="utf-8"), re.MULTILINE))


def in_brief(text: str) -> str:
    for written, instead in BRIEF:
        text = text.replace(written, instead)
    return text


def executed(file: Path, form: Callable[[str], str] = str) -> tuple[str, int]:
    """All that a notebook prints whose cells, in some form, run in its folder, and the number of its figures."""
    before = {path.name for path in file.parent.iterdir()}
    if form is in_brief:
        shared().prepare(modules=[*XARRAY, "matplotlib.pyplot"])
        count = "\nprint('figures:', len(plt.get_fignums()))"
        done = shared().run("-c", form(cells(file)) + count, cwd=file.parent, limit_s=600.0, program=PYTHON)
        assert done.code == 0, done.err
        printed, _, figures = done.out.rpartition("figures:")
    else:
        printed, figures = by_jupyter(file)
    assert {path.name for path in file.parent.iterdir()} == before
    return printed, int(figures)


def by_jupyter(file: Path) -> tuple[str, int]:
    """The same of a notebook as it is written; the first output of one that has a result is its table."""
    client = pytest.importorskip("nbclient", reason="nbclient belongs to the group docs")
    read = pytest.importorskip("myst_nb.core.read", reason="myst-nb belongs to the group docs")
    from myst_parser.config.main import MdParserConfig

    notebook = read.read_myst_markdown_notebook(file.read_text(encoding="utf-8"), MdParserConfig())
    folder = {"metadata": {"path": str(file.parent)}}
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", ""))))
        patched.setenv("PYTHONSAFEPATH", "1")
        client.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=folder).execute()  # raises
    run = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(run) == file.read_text().count("```{code-cell}")
    outputs = [output for cell in run for output in cell.outputs]
    pages = [output["data"]["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert not pages or "<table>" in pages[0]
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    return printed, sum("image/png" in output.get("data", {}) for output in outputs)


def numbers(pattern: str, printed: str) -> list[float]:
    """The groups of the one place that a pattern fits."""
    found = re.search(pattern, printed)
    assert found is not None, printed
    return [float(group) for group in found.groups()]


def test_there_are_two() -> None:
    assert [file.stem for file in NOTEBOOKS] == ["first_landing", "placement_study"]
    every = "".join(map(cells, NOTEBOOKS))
    assert all(written in every for written, _ in BRIEF)


@contextmanager
def in_form(file: Path, config: pytest.Config) -> Iterator[Callable[[str], str]]:
    """The form in which a notebook runs; that it has run at length is kept where what is done within passes."""
    digest, known = at_length.digest(cells(file)), at_length.stored(TABLE)
    if not config.getoption("--as-written"):
        yield in_brief if digest in known else str
        return
    every = [*map(cells, NOTEBOOKS)]
    at_length.store(known - {digest}, every, TABLE)
    yield str
    at_length.store(known | {digest}, every, TABLE)


def test_a_first_landing(pytestconfig: pytest.Config) -> None:
    with in_form(NOTEBOOKS[0], pytestconfig) as form:
        printed, figures = executed(NOTEBOOKS[0], form)
        assert figures == 3
        (inside,) = numbers(r"within 3 sigma: ([\d.]+) %", printed)
        assert inside > 95.0
        runs = form("runs=100").partition("=")[2]
        assert f"{runs} of {runs} done" in printed
        rms, low, high = numbers(r"horizontal RMS ([\d.]+) m, 95 % interval ([\d.]+) to ([\d.]+) m", printed)
        assert 0.05 < low < rms < high < 1.0
        mean, share = numbers(r"mean ([\d.]+), within the 95 % band at (\d+) %", printed)
        assert 0.9 < mean < 1.1
        assert share > 60
        near, far = (numbers(rf"\b{name}: horizontal ([\d.]+) m", printed)[0] for name in ("200 m", "1000 m"))
        assert near != far
        assert "pseudolites.s_mm - unknown key; did you mean 's_m', in m?" in printed
        assert "imu.rate_hz - " in printed


def test_a_placement_study(pytestconfig: pytest.Config) -> None:
    with in_form(NOTEBOOKS[1], pytestconfig) as form:
        printed, figures = executed(NOTEBOOKS[1], form)
        assert figures == 1
        pdop, s, l1 = numbers(r"least PDOP ([\d.]+) at S (\d+) m, L1 (-?\d+) m", printed)
        assert 0.5 < pdop < 2.0
        assert 25 <= s <= 2000
        assert -1000 <= l1 <= 4000
        vertical = [
            numbers(rf"{name}: horizontal [\d.]+ m, vertical ([\d.]+) m", printed)[0] for name in ("none", "least PDOP")
        ]
        assert vertical[1] < 0.8 * vertical[0]


@pytest.mark.long
def test_a_cell_that_fails_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "broken.md"
    head = NOTEBOOKS[0].read_text().split("# A landing")[0]
    file.write_text(f"{head}# Broken\n\n```{{code-cell}} ipython3\nimport navsim\nnavsim.run('absent.yaml')\n```\n")
    with pytest.raises(Exception, match="BadInput"):
        executed(file)
