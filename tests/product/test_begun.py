"""Studies are checked with their base and their combinations; dry runs say what an earlier attempt has left."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from navsim.results.atomic_write import partial_folder
from navsim.runner import opening
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.executor import threads
from navsim.runner.job import Options
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


def begun(file: Path, target: Path, pieces: int) -> CheckpointStore:
    """Leave pieces of a sweep as a killed attempt does; returns where."""
    job, _ = opening.open_job("sweep", file, [], Options(), print)
    job.prepare(threads(1), lambda *_, **__: None)
    store = CheckpointStore(partial_folder(target), job.key(), fresh=False)
    for i in range(pieces):
        store.write(f"piece-{i}", {})
    return store


@pytest.mark.long
def test_dry_run_says_what_is_kept(tmp_path: Path) -> None:
    file = study(tmp_path, "begun", SWEEP)
    navsim("sweep", file, "-o", "compiled.h5", "--figures", "none", "-q", cwd=tmp_path)  # no block is timed before that
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
    assert said.startswith("navsim sweep begun.yaml --output 'o p.h5' --dry-run\n")
    assert "2 of 3 pieces of the combinations are kept" in said
    file.write_text(file.read_text().replace("150", "151"))
    said = navsim("resume", "a b/o p.h5.partial", cwd=tmp_path, code=2).stderr
    assert "partial work of another study lies there (other settings of the study)" in said
    file.unlink()
    assert "begun.yaml: there is no such file" in navsim("resume", "a b/o p.h5.partial", cwd=tmp_path, code=2).stderr


def piped(file: Path) -> None:
    """Put a named pipe in the place of a file: opening it would wait for a writer."""
    file.unlink()
    os.mkfifo(file)


def relative(folder: Path, member: str) -> None:
    """Make a path in the command a relative one, so that it is anywhere."""
    file = folder / "command.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {member: "."}))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (shutil.rmtree, "no folder of partial work"),
        (lambda folder: (folder / "command.json").unlink(), "it was begun from Python, or by an earlier version"),
        (lambda folder: [file.unlink() for file in folder.iterdir()], "no partial work of navsim lies there"),
        (lambda folder: (folder / "command.json").write_text("[]"), "command.json: cannot be read or is damaged"),
        (lambda folder: (folder / "command.json").write_text('{"command": [1], "folder": "/", "work": ""}'), "damaged"),
        (lambda folder: (folder / "command.json").write_bytes(b"\xff{"), "damaged"),
        (lambda folder: piped(folder / "command.json"), "damaged"),
        (lambda folder: relative(folder, "work"), "damaged"),
        (lambda folder: relative(folder, "folder"), "damaged"),
        (lambda folder: folder.rename(folder.with_name("moved")), "was moved there from"),
        (lambda folder: (folder.parent / "work").rmdir(), "the folder in which its command was given is gone"),
    ],
    ids=["folder", "command", "all", "other", "words", "bytes", "pipe", "work", "place", "moved", "gone"],
)  # fmt: skip
def test_what_cannot_be_resumed_is_told(
    change: Callable[[Path], object], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    folder = tmp_path / "out.h5.partial"
    CheckpointStore(folder, {"seed": 1}, fresh=False).note(["run", "landing.yaml", "--runs", "60", "-o", "../out.h5"])
    monkeypatch.chdir(tmp_path)
    now = change(folder)
    asked = now if isinstance(now, Path) else folder
    assert said in navsim("resume", asked, cwd=tmp_path, code=2).stderr


RUN = ("run", "landing.yaml", "--runs", "60", "--set", "duration_s=65")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("report", "out.h5", "-o", "../page.html"), "keeps no partial work; only navsim run, sweep, optimize can be"),
        (("resume", "out.h5.partial"), "keeps no partial work"),
        (("init", "landing.yaml"), "keeps no partial work"),
        ((*RUN, "-o", "../victim.h5"), "its command would write ../victim.h5, whose work lies in ../victim.h5.partial"),
        (RUN, "its command would write results/landing_runs60.h5"),
        ((*RUN[:2], "--method", "covariance", "-o", "out.h5"), "its command keeps no work; if you"),
        (("run", "--help"), "is none of this version (it only prints help)"),
        ((*RUN, "--no-such"), "is none of this version (No such option: --no-such"),
        ((*RUN, "-o", "out.h5"), "partial work of another study lies there"),
        ((*RUN, "-o", "out.h5", "--scheduler", "tcp://evil:8786"), "an address that navsim resume does not take"),
        ((*RUN, "-o", "out.h5\x1b[2J"), "cannot be read or is damaged"),
    ],
)  # fmt: skip
def test_only_the_work_of_the_folder_itself_is_resumed(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder of partial work may come from anybody: other commands, targets and studies are refused, and nothing is
    written, not even a log."""
    (tmp_path / "victim.h5").write_bytes(b"precious")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    shutil.copy(SCENARIOS / "landing.yaml", "landing.yaml")
    CheckpointStore(Path("out.h5.partial"), {"seed": 1}, fresh=False).note([*words, "--log", "../log", "--force"])
    before = sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*") if path.is_file())
    done = navsim("resume", "work/out.h5.partial", cwd=tmp_path, code=2)
    assert said in done.stderr
    assert sorted((path, path.stat().st_mtime_ns) for path in tmp_path.rglob("*") if path.is_file()) == before


def test_what_a_command_does_elsewhere_is_not_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs, figures, overwriting: by the options of `resume` alone, whose paths are of where it is given."""
    (tmp_path / "work").mkdir()
    file = study(tmp_path / "work", "begun", SWEEP)
    store = begun(file, tmp_path / "work" / "out.h5", 2)
    monkeypatch.chdir(tmp_path / "work")
    elsewhere = ("--log", str(tmp_path / "theirs"), "--figures", str(tmp_path / "drawn"), "--force")
    store.note(["sweep", file.name, "-o", "out.h5", "--workers", "1", *elsewhere])
    done = navsim("resume", "work/out.h5.partial", "--workers", 2, "-q", "--log", "mine", cwd=tmp_path)
    first, second, *_ = done.stderr.splitlines()
    assert first == "navsim sweep begun.yaml --output out.h5 --quiet --workers 2"
    assert second.startswith("options not repeated: --workers 1 --figures ")
    assert f"--force --log {tmp_path}/theirs. Add them to navsim resume if needed" in second
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "work"]
    assert (tmp_path / "work" / "out.h5").is_file()
    assert not store.folder.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
@pytest.mark.parametrize("name", ["", "command.json"])
@pytest.mark.parametrize(("owner", "mode", "said"), [(12345, 0o755, "belongs to user 12345"), (0, 0o777, "everybody")])
def test_work_of_others_is_not_resumed(
    name: str, owner: int, mode: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    CheckpointStore(Path("out.h5.partial"), {"seed": 1}, fresh=False).note([*RUN, "-o", "out.h5"])
    file = tmp_path / "out.h5.partial" / name
    os.chown(file, owner, 0)
    file.chmod(mode)
    assert said in navsim("resume", "out.h5.partial", cwd=tmp_path, code=2).stderr


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
