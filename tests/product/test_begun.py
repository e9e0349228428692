"""Studies are checked with their base and their combinations; dry runs say what an earlier attempt has left."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from navsim.io.whole import partial_folder
from navsim.study.executor import threads
from navsim.study.job import Options
from navsim.study.partial import Store
from navsim.work import opening
from tests.conftest import SCENARIOS
from tests.product.test_run import navsim
from tests.product.test_sweep import BASE, study

SWEEP = """
set: {pseudolites.frame: runway, receiver.rate_hz: 2}
vary:
  - {key: pseudolites.s_m, values: [50, 100, 150]}
  - {key: pseudolites.l1_m, grid: {first: 0, last: 4000, count: 1000}}
"""
"""Three pieces."""


def begun(file: Path, target: Path, pieces: int) -> Store:
    """Leave pieces of a sweep as a killed attempt does; returns where."""
    job, _ = opening.opened("sweep", file, [], Options())
    job.prepare(threads(1), lambda *_, **__: None)
    store = Store(partial_folder(target), job.key(), fresh=False)
    for i in range(pieces):
        store.write(f"piece-{i}", {})
    return store


def test_dry_run_says_what_is_kept(tmp_path: Path) -> None:
    file = study(tmp_path, "begun", SWEEP)
    arguments = ("sweep", file, "-o", "out.h5", "--dry-run")
    assert "begun before" not in navsim(*arguments, cwd=tmp_path).stderr
    begun(file, tmp_path / "out.h5", 2)
    before = sorted((path.name, path.read_bytes()) for path in (tmp_path / "out.h5.partial").iterdir())
    said = navsim(*arguments, cwd=tmp_path).stderr
    assert "2 of 3 pieces of the combinations are kept, what remains to be computed takes about" in said
    assert sorted((path.name, path.read_bytes()) for path in (tmp_path / "out.h5.partial").iterdir()) == before
    assert "would be discarded" in navsim(*arguments, "--fresh", cwd=tmp_path).stderr
    refused = navsim(*arguments, "--seed", 2, "--set", "vary.0.values=[1, 2, 3]", cwd=tmp_path, code=2).stderr
    assert "partial work of another study lies there" in refused


def test_resuming_is_giving_the_command_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In its folder, without what would discard the work; what has changed since is told."""
    (tmp_path / "a b").mkdir()
    file = study(tmp_path / "a b", "begun", SWEEP)
    store = begun(file, tmp_path / "a b" / "o p.h5", 2)
    monkeypatch.chdir(tmp_path / "a b")
    store.note(["sweep", file.name, "-o", "o p.h5", "--fresh", "--dry-run"])
    assert "its own is a b/o p.h5.partial: give that" in navsim("resume", "a b/o p.h5", cwd=tmp_path, code=2).stderr
    said = navsim("resume", "a b/o p.h5.partial", cwd=tmp_path).stderr
    assert said.startswith("navsim sweep begun.yaml -o 'o p.h5' --dry-run\n")
    assert "2 of 3 pieces of the combinations are kept" in said
    file.write_text(file.read_text().replace("150", "151"))
    said = navsim("resume", "a b/o p.h5.partial", cwd=tmp_path, code=2).stderr
    assert "partial work of another study lies there (other settings of the study)" in said
    file.unlink()
    assert "begun.yaml: cannot be read" in navsim("resume", "a b/o p.h5.partial", cwd=tmp_path, code=2).stderr


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (shutil.rmtree, "no folder of partial work"),
        (lambda folder: (folder / "command.json").unlink(), "it was begun from Python, or by an earlier version"),
        (lambda folder: [file.unlink() for file in folder.iterdir()], "no partial work of navsim lies there"),
        (lambda folder: (folder / "command.json").write_text("[]"), "command.json: cannot be read or is damaged"),
        (lambda folder: (folder / "command.json").write_text('{"command": [1], "folder": "/", "work": ""}'), "damaged"),
        (lambda folder: (folder / "command.json").write_bytes(b"\xff{"), "damaged"),
        (lambda folder: folder.rename(folder.with_name("moved")), "was moved there from"),
        (lambda folder: (folder.parent / "work").rmdir(), "the folder in which its command was given is gone"),
    ],
    ids=["folder", "command", "all", "other", "words", "bytes", "moved", "gone"],
)  # fmt: skip
def test_what_cannot_be_resumed_is_told(
    change: Callable[[Path], object], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    folder = tmp_path / "out.h5.partial"
    Store(folder, {"seed": 1}, fresh=False).note(["run", "landing.yaml", "--runs", "60", "-o", "../out.h5"])
    monkeypatch.chdir(tmp_path)
    now = change(folder)
    asked = now if isinstance(now, Path) else folder
    assert said in navsim("resume", asked, cwd=tmp_path, code=2).stderr


@pytest.mark.parametrize(
    ("text", "code", "expected"),
    [
        ("vary: [{key: pseudolites.s_m, values: [100, wide]}]", 0,
         "1 of all 2 combinations are no valid scenario and would be left out; the first, with pseudolites.s_m = wide"),
        ("vary: [{key: receiver.rate_hz, grid: {first: 1, last: 1000000, count: 2000}},\n"
         "       {key: pseudolites.count, values: [0, -1]}]", 0, "looked at, of 4000 combinations are no valid"),
        ("vary: [{key: pseudolites.s_m, values: [far, wide]}]", 2, "bad.yaml:4:8"),
        ("set: {runway.heading: 3}\nvary: [{key: pseudolites.s_m, values: [1, 2]}]", 2, "runway.heading"),
    ],
)  # fmt: skip
def test_sweeps_are_validated_with_their_combinations(tmp_path: Path, text: str, code: int, expected: str) -> None:
    done = navsim("validate", study(tmp_path, "bad", text), cwd=tmp_path, code=code)
    assert expected in done.stderr
    if code == 0:
        assert f"{tmp_path / 'bad.yaml'}:{text.count(chr(10)) + 4}:8: pseudolites." in done.stderr


def test_searches_are_validated_with_their_base(tmp_path: Path) -> None:
    """As `navsim optimize` would refuse them."""
    shutil.copy(SCENARIOS / "placement_optimum.yaml", tmp_path / "mine.yaml")
    text = (tmp_path / "mine.yaml").read_text()
    own = next(line for line in text.splitlines() if line.startswith("base:"))
    shutil.copy(BASE, tmp_path / "base.yaml")
    (tmp_path / "mine.yaml").write_text(text.replace(own, "base: base.yaml"))
    assert "a valid study" in navsim("validate", "mine.yaml", cwd=tmp_path).stdout
    wrong = (tmp_path / "base.yaml").read_text().replace("duration_s:", "duration_m:")
    (tmp_path / "base.yaml").write_text(wrong)
    for command in (("validate", "mine.yaml"), ("optimize", "mine.yaml", "-o", "out.h5", "--dry-run")):
        assert "duration_m" in navsim(*command, cwd=tmp_path, code=2).stderr
