"""Pages of measured results are of this code. Each carries commit, command, seeds and a probe."""

from __future__ import annotations

import re
import subprocess
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.helpers import load_script

measured: Any = load_script("measured")
SCRIPTS = re.findall(r"scripts/(\w+)\.py", (ROOT / "Makefile").read_text().split("\nvalidate:")[1].split("\n\n")[0])
UNGUARDED: set[str] = set()
"""Scripts whose pages were made before pages had probes. Each takes minutes of processor time:
`make validate` makes the pages anew."""

EARLIER: set[str] = set()
"""Scripts whose pages say that they are of an earlier filter or response to gusts. Strike them out when they are made
anew."""
NOTE = "Computed with an earlier version"


def test_unguarded_pages_are_listed() -> None:
    assert len(SCRIPTS) >= 10
    without = {name for name in SCRIPTS if load_script(name).PAGE.stored() is None}
    assert without == UNGUARDED, "strike out of UNGUARDED what has a probe; make pages by their scripts alone"


DEAR = {"integrity", "lasting_errors", "sensor_errors", "heights", "faults", "filter_consistency", "interference",
        "mixture_tails", "near_passes", "outages", "rare_totals", "recorded_approach"}  # fmt: skip
"""Pages whose probes take seconds, of effects that other pages have too."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.long] if name in DEAR else []) for name in SCRIPTS if name not in UNGUARDED],
)
def test_a_page_is_of_this_code(name: str, request: pytest.FixtureRequest) -> None:
    page = load_script(name).PAGE
    text = page.path.read_text()
    commit = r"commit `[0-9a-f]{10,}` \([0-9-]{10}\)"
    assert (NOTE in text) == (name in EARLIER)
    (seeds,) = re.findall(rf"Made by `{page.command}`(?:, | with the code of ){commit}, seeds? ([0-9, ]+)\.", text)
    if name in EARLIER:
        return
    assert seeds == ", ".join(map(str, page.seeds))
    if name in ("recorded_approach", "replays"):
        request.getfixturevalue("shared")
    found = measured.differences(page.stored(), page.probe())
    assert not found, "\n".join([f"docs/{page.name} is of other code; make it anew: `{page.command}`", *found])


UNSTAMPED = {"validation", "table2", "covariance-measured", "companions-measured", "placement-measured",
             "real-signals-measured"}  # fmt: skip
"""Pages without a commit: tests repeat their numbers, or runs of shipped scenarios print them."""


def test_each_measured_page_names_its_commit_and_a_command_that_exists() -> None:
    docs, makefile = ROOT / "docs", (ROOT / "Makefile").read_text()
    listed = set(re.findall(r"\.\./([\w-]+)\.md", (docs / "contents" / "measured.md").read_text()))
    assert len(listed) > 20
    without = set()
    for name in listed:
        text = (docs / f"{name}.md").read_text()
        if not re.search(r"commit `?[0-9a-f]{7,}", text):
            without.add(name)
        for script in re.findall(r"scripts/(\w+)\.py", text):
            assert (ROOT / "scripts" / f"{script}.py").exists(), (name, script)
        for target in re.findall(r"`make (\w+)`", text):
            assert f"\n{target}: " in makefile, (name, target)
    of_other_code = {load_script(script).PAGE.path.stem for script in UNGUARDED}
    assert without == UNSTAMPED | of_other_code


def page(tmp_path: Any, monkeypatch: pytest.MonkeyPatch, value: float = 1.0) -> Any:
    """A page in a repository of its own."""
    monkeypatch.setattr(measured, "ROOT", tmp_path)
    for folder in ("docs", *measured.CODE):
        (tmp_path / folder).mkdir()
    (tmp_path / "navsim" / "code.py").write_text("")
    return measured.Page("page.md", "script", (3, 4), lambda: {"a -> b": [value, -2.5e-7]})


def git(folder: Any, *arguments: str) -> None:
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *who, *arguments], cwd=folder, check=True, capture_output=True)


def test_no_page_without_a_commit(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not outside of git, not with changed or new files, not where the code changed during the runs."""
    one = page(tmp_path, monkeypatch)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(SystemExit, match="run in a git checkout"):
        measured.commit()
    git(tmp_path, "init", "-q")
    with pytest.raises(SystemExit, match="names the commit"):
        measured.commit()
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "one")
    begun = measured.commit()
    one.write(["# Title"], begun)
    text = one.path.read_text()
    assert f"\nMade by `python scripts/script.py`, commit {begun}, seeds 3, 4.\n" in text
    assert one.stored() == {"a -> b": [1.0, -2.5e-7]}
    assert measured.commit() == begun, "pages are no code"
    (tmp_path / "navsim" / "code.py").write_text("1\n")
    with pytest.raises(SystemExit, match="commit first"):
        one.write(["# Title"], begun)
    git(tmp_path, "commit", "-qam", "two")
    with pytest.raises(SystemExit, match="changed from commit"):
        one.write(["# Title"], begun)


@pytest.mark.parametrize(
    ("stored", "computed", "expected"),
    [
        ({"a": [1.0, 2.0]}, {"a": [1.0 + 5e-7, 2.0]}, 0),
        ({"a": [1.0, 2.0]}, {"a": [1.0, 2.0 + 5e-6]}, 1),
        ({"a": [1.0]}, {"a": [float("nan")]}, 1),
        ({"a": [1.0]}, {"a": [1.0, 1.0]}, 1),
        ({"a": [1.0], "b": [1.0]}, {"b": [1.0], "c": [1.0]}, 2),
    ],
)
def test_other_numbers_are_found(stored: Any, computed: Any, expected: int) -> None:
    assert len(measured.differences(stored, computed)) == expected
