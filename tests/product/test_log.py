"""`--log`: what a command does and says, an object of JSON a line; and progress where nobody looks at a terminal."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from navsim import __version__
from navsim.cli import common, log
from navsim.cli.exit_status import ends, keep, print_message
from tests import forks
from tests.conftest import SCENARIOS

NAVSIM = [sys.executable, "-m", "navsim"]
SHORT = ["run", str(SCENARIOS / "landing.yaml"), "--set", "duration_s=2", "--figures", "none"]


def navsim(cwd: Path, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    return forks.navsim(*words, cwd=cwd, code=code)


def events(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def test_a_run_from_start_to_end(tmp_path: Path) -> None:
    """Two commands, one log; nothing else is printed because of it."""
    plain = navsim(tmp_path, *SHORT, "-o", "a.h5", "-q")
    for _ in range(2):
        done = navsim(tmp_path, *SHORT, "-o", "a.h5", "-q", "--log", "a.log")
        assert (done.stdout, done.stderr) == (plain.stdout, plain.stderr)
    found = events(tmp_path / "a.log")
    assert all(set(each) >= {"time", "event"} for each in found)
    starts = [each for each in found if each["event"] == "start"]
    assert len(starts) == 2
    assert starts[0]["command"] == [*SHORT, "-o", "a.h5", "-q", "--log", "a.log"]
    assert starts[0]["version"] == __version__
    assert starts[0]["folder"] == str(tmp_path)
    ends_ = [each for each in found if each["event"] == "end"]
    assert [each["code"] for each in ends_] == [0, 0]
    assert found[-1] is ends_[-1]
    assert 0.0 < ends_[0]["seconds"] < 600.0
    said = [f"warning: {each['text']}" for each in found if each["event"] == "warning"]
    assert 2 * [line for line in plain.stderr.splitlines() if line.startswith("warning: ")] == said


def test_an_error_is_logged_with_its_code(tmp_path: Path) -> None:
    done = navsim(tmp_path, "run", str(SCENARIOS / "landing.yaml"), "--set", "imu.rate=1", "--log", "a.log", code=2)
    *_, error, end = events(tmp_path / "a.log")
    assert f"error: {error['text']}" == done.stderr.strip()
    assert error["event"] == "error"
    assert end["code"] == 2


def test_an_interrupt_is_logged(tmp_path: Path) -> None:
    more = ("--runs", "100000", "--keep", "none", "--set", "filter.kind=eskf", "-o", "b.h5", "--log", "b.log")
    process = forks.shared().start("run", SCENARIOS / "landing.yaml", *more, cwd=tmp_path)
    deadline = time.monotonic() + 120.0
    while not any(tmp_path.glob("b.h5.partial/*.npz")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    process.ended()
    *_, kept, end = events(tmp_path / "b.log")
    assert kept["text"] == (
        "finished runs are kept in b.h5.partial; the same command continues from there, or navsim resume b.h5.partial"
    )
    assert (end["code"], end["text"]) == (128 + signal.SIGTERM, "terminated")


@pytest.mark.parametrize(
    "content",
    [b"kind: landing\n", b"\x89HDF\r\n\x1a\n", b"\xff\xfe", b'{"kind": "landing"}\n', b"[1]\n"],
)  # fmt: skip
def test_what_is_no_log_is_left_alone(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "other"
    file.write_bytes(content)
    done = navsim(tmp_path, *SHORT, "--log", "other", code=2)
    assert "--log other: is there already and no log; choose another file" in done.stderr
    assert file.read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    done = navsim(tmp_path, *SHORT, "--log", "nowhere/a.log", code=2)
    assert "--log nowhere/a.log: No such file or directory" in done.stderr


def test_a_full_disk_ends_the_log_and_not_the_work(capsys: pytest.CaptureFixture[str]) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    with ends():
        log._files.append(open("/dev/full", "w", buffering=1))  # noqa: SIM115
        print_message("one")
        print_message("two")
    assert capsys.readouterr().err == "one\nwarning: /dev/full: No space left on device; the log ends here\ntwo\n"
    assert not log.is_open()


def test_a_log_that_cannot_grow_ends_without_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where it is closed, which tries to write once more."""
    least, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (400, most))
    try:
        with log.logged(tmp_path / "a.log", ["run"]):
            for _ in range(5):
                log.note("said", text=80 * "a")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (least, most))
    assert capsys.readouterr().err == f"warning: {tmp_path}/a.log: File too large; the log ends here\n"


def test_progress_off_a_terminal_and_in_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every ten seconds; what an earlier attempt had finished says nothing of how fast this one is."""
    file, clock = tmp_path / "p.log", iter([0.0, *(float(t) for t in range(32))])
    with ends():
        keep(log.logged(file, ["run"]))
        with common.progress(1000, "runs", True, lambda: next(clock)) as tell:
            for second in range(32):
                tell(200 + 10 * second, f"rms_horizontal 0.2 m within {second}%")
    err = capsys.readouterr().err.splitlines()
    assert err == [
        "300 of 1000 runs, 10 s used, about 70 s left; rms_horizontal 0.2 m within 10%",
        "400 of 1000 runs, 20 s used, about 60 s left; rms_horizontal 0.2 m within 20%",
        "500 of 1000 runs, 30 s used, about 50 s left; rms_horizontal 0.2 m within 30%",
    ]
    told = [each for each in events(file) if each["event"] == "progress"]
    assert [(each["finished"], each["used_s"], each["left_s"]) for each in told] == [
        (300, 10.0, 70.0), (400, 20.0, 60.0), (500, 30.0, 50.0)
    ]  # fmt: skip
    assert not [each for each in events(file) if each["event"] == "said"]


def test_a_bar_has_the_interval_behind_it(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with common.progress(1000, "runs", True) as tell:
        tell(320, "rms_horizontal 0.213 m within 3.1%")
        time.sleep(0.3)
    err = capsys.readouterr().err
    assert "320/1000" in err
    assert "rms_horizontal 0.213 m within 3.1%" in err


def test_a_log_that_was_cut_off_goes_on_in_a_line_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "a.log"
    navsim(tmp_path, *SHORT, "-o", "a.h5", "-q", "--log", "a.log")
    whole = file.read_text()
    file.write_text(whole[:-20])
    navsim(tmp_path, *SHORT, "-o", "a.h5", "-q", "--log", "a.log")
    lines = file.read_text().splitlines()
    assert lines[len(whole.splitlines()) - 1] == whole.splitlines()[-1][:-19]
    assert json.loads(lines[len(whole.splitlines())])["event"] == "start"


def test_names_of_files_in_any_bytes(tmp_path: Path) -> None:
    name = b"\xff.yaml"
    done = subprocess.run([*NAVSIM, "run", name, "--log", "a.log"], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 2
    assert b"Traceback" not in done.stderr
    assert [each["event"] for each in events(tmp_path / "a.log")] == ["start", "error", "end"]


def test_a_reader_who_goes_away_is_no_failure(tmp_path: Path) -> None:
    command = f"{' '.join(NAVSIM)} {' '.join(SHORT)} -o a.h5 --log a.log | true"
    subprocess.run(["bash", "-c", command], cwd=tmp_path, check=True)
    assert events(tmp_path / "a.log")[-1]["code"] == 0


def test_a_result_that_is_written_is_not_said_to_be_lost(tmp_path: Path) -> None:
    """Figures that cannot be drawn: the result stands."""
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "r_track.png").mkdir()
    done = navsim(tmp_path, *SHORT[:-2], "-o", "r.h5", "--figures", "figures", code=3)
    assert done.stderr.rstrip().endswith("; r.h5 is complete")
    assert (tmp_path / "r.h5").exists()


def test_time_left_is_told_by_what_comes_after_the_first_piece(capsys: pytest.CaptureFixture[str]) -> None:
    """Which a row of a table is, told of when it is finished."""
    times = iter([0.0, 10.0, 20.0])
    with common.progress(20, "cells", True, lambda: next(times)) as tell:
        tell(1)
        tell(2)
    assert capsys.readouterr().err.splitlines() == [
        "1 of 20 cells, 10 s used", "2 of 20 cells, 20 s used, about 3 min left"
    ]  # fmt: skip


def test_no_time_is_left_for_what_comes_after_all_pieces(capsys: pytest.CaptureFixture[str]) -> None:
    """A sweep flies its best combinations then: all pieces stay finished, and nobody says that 0 s are left."""
    times = iter([0.0, 10.0, 20.0])
    with common.progress(12, "combinations", True, lambda: next(times)) as tell:
        tell(11)
        tell(12, "flying the best by pdop")
    assert capsys.readouterr().err.splitlines() == [
        "11 of 12 combinations, 10 s used", "12 of 12 combinations, 20 s used; flying the best by pdop"
    ]  # fmt: skip
