"""Studies are checked with their base and their combinations; dry runs say what an earlier attempt has left."""

from __future__ import annotations

import shutil
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


def begun(file: Path, target: Path, pieces: int) -> None:
    """Leave pieces of a sweep as a killed attempt does."""
    job, _ = opening.opened("sweep", file, [], Options())
    job.prepare(threads(1), lambda *_, **__: None)
    store = Store(partial_folder(target), job.key(), fresh=False)
    for i in range(pieces):
        store.write(f"piece-{i}", {})


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
