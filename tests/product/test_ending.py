"""How commands end: signals at any moment, streams that are closed, full or of another encoding, two on one output."""

from __future__ import annotations

import errno
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from navsim.cli import ending
from navsim.cli.common import progress
from tests.conftest import ROOT, SCENARIOS

NAVSIM = [sys.executable, "-m", "navsim"]
LONG = ["run", str(SCENARIOS / "landing.yaml"), "--runs", "100000", "--keep", "none", "-q", "--workers", "1",
        "-o", "long.h5"]  # fmt: skip


def _listening() -> None:
    """The tests may themselves run where signals are ignored, as in the background of a script."""
    for number in ending.WORDS:
        signal.signal(number, signal.SIG_DFL)


def start(cwd: Path, *arguments: str) -> subprocess.Popen[str]:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*NAVSIM, *arguments], cwd=cwd, text=True, preexec_fn=_listening, **pipes)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("number", list(ending.WORDS))
def test_signals_keep_finished_work(number: signal.Signals, tmp_path: Path) -> None:
    process = start(tmp_path, *LONG)
    until(lambda: any(tmp_path.glob("long.h5.partial/*.npz")))
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert "finished runs are kept in long.h5.partial; the same command goes on from there" in err
    assert err.endswith(f"{ending.WORDS[number]}\n")
    assert "Traceback" not in err
    assert out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["long.h5.partial"]


def test_a_signal_does_not_wait_for_the_compiler(tmp_path: Path) -> None:
    """Which takes most of a minute at the first start, and would have it to the end."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cold")}
    command = [*NAVSIM, "run", str(SCENARIOS / "landing.yaml"), "--figures", "none", "-o", "a.h5"]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, preexec_fn=_listening
    )
    assert process.stderr is not None
    assert "compiling the kernels, once" in process.stderr.readline()
    time.sleep(6.0)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM
    assert err == "terminated while kernels were compiled\n"


def test_signals_in_a_row_show_no_traceback(tmp_path: Path) -> None:
    process = start(tmp_path, *LONG)
    until(lambda: any(tmp_path.glob("long.h5.partial/*.npz")))
    sent = 0
    while process.poll() is None:  # until it has ended, whatever it is at
        process.send_signal(signal.SIGINT)
        sent += 1
        time.sleep(0.005)
    assert sent > 1
    _, err = process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGINT)  # the latter after the last word, as the interpreter ends
    assert "Traceback" not in err
    assert "Exception ignored" not in err


@pytest.mark.parametrize(
    "module",
    ["typer", "navsim.cli.run", "pydantic", "navsim.scenario.landing", "navsim.study.landing", "numba"],
)
def test_signals_during_the_start_show_no_traceback(module: str, tmp_path: Path) -> None:
    """As a module begins to be imported. Python itself listens before navsim can; so does it here until the first line
    of navsim."""
    code = f"""
import os, signal, sys
from navsim.__main__ import main
class Interrupts:
    def find_spec(self, name, *rest):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
sys.argv = ['navsim', *{LONG!r}]
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120, preexec_fn=_listening
    )
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.endswith("interrupted\n")


def test_a_signal_whose_exception_was_lost_still_ends(tmp_path: Path) -> None:
    """Python drops what is raised in a callback, such as a weak reference's."""
    code = f"""
import os, signal, sys, weakref
from navsim.__main__ import main
sys.argv = ['navsim', *{LONG!r}]
class Thing: pass
def interrupted(_): os.kill(os.getpid(), signal.SIGINT)
def key(*_):
    thing = Thing()
    kept.append(weakref.ref(thing, interrupted))
    return {{}}
kept = []
from navsim.study import landing
landing.partial_key = key
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120, preexec_fn=_listening
    )
    assert "Exception ignored" in done.stderr
    assert done.returncode == 130, done.stderr
    assert done.stderr.endswith("interrupted\n")


def test_ignored_signals_stay_ignored(tmp_path: Path) -> None:
    """As by nohup."""

    def ignoring() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    arguments = ["run", str(SCENARIOS / "landing.yaml"), "--set", "duration_s=2", "-q", "-o", "r.h5"]
    process = subprocess.Popen([*NAVSIM, *arguments], cwd=tmp_path, preexec_fn=ignoring, stderr=subprocess.PIPE)
    while process.poll() is None:
        process.send_signal(signal.SIGHUP)
        time.sleep(0.05)
    process.communicate()
    assert process.returncode == 0
    assert (tmp_path / "r.h5").exists()


def test_the_second_on_one_output_is_told_who_is_there(tmp_path: Path) -> None:
    first = start(tmp_path, *LONG)
    until(lambda: any(tmp_path.glob("long.h5.partial/*.npz")))
    first.send_signal(signal.SIGSTOP)  # it stays where it is, and leaves the processor to the others
    second = start(tmp_path, *LONG)
    _, err = second.communicate(timeout=60)
    assert second.returncode == 2
    assert f"long.h5: process {first.pid} on " in err
    assert "is at work on it; wait for it, or choose another -o/--output" in err
    assert first.poll() is None
    dry = start(tmp_path, *LONG, "--dry-run")
    dry.communicate(timeout=60)
    assert dry.returncode == 0
    first.kill()
    first.communicate()
    (tmp_path / ".long.h5.4711.tmp").touch()  # a result half written by a process that was killed
    third = start(tmp_path, *LONG)
    until(lambda: not (tmp_path / ".long.h5.4711.tmp").exists())
    third.terminate()
    third.communicate(timeout=60)
    assert [path.name for path in tmp_path.iterdir()] == ["long.h5.partial"]


def test_too_little_memory_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left, ending.ends():
        raise MemoryError
    assert left.value.code == ending.RUN_FAILED
    assert capsys.readouterr().err == "error: there is too little memory; --dry-run tells how much is needed\n"


# --- streams


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shown")
    arguments = ["run", str(SCENARIOS / "landing.yaml"), "--set", "duration_s=2", "-q", "-o", "r.h5"]
    assert subprocess.run([*NAVSIM, *arguments], cwd=folder, check=False).returncode == 0
    return folder


def shell(line: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    python = f"{sys.executable} -m navsim"
    return subprocess.run(
        ["bash", "-c", line.replace("navsim", python, 1)], cwd=cwd, capture_output=True, timeout=120, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip


@pytest.mark.parametrize(
    "environment",
    [{"PYTHONIOENCODING": "ascii"}, {"PYTHONIOENCODING": "cp1251"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}],
)
def test_any_encoding_will_do(environment: dict[str, str], shown: Path) -> None:
    done = shell("navsim show r.h5", shown, **environment)
    assert done.returncode == 0, done.stderr
    assert b"PDOP" in done.stdout


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        ("navsim show r.h5 > /dev/full", 3, b"error: standard output cannot be written: No space left on device\n"),
        ("navsim schema landing > /dev/full", 3, b"error: standard output cannot be written"),
        ("navsim --help > /dev/full", 3, b"error: standard output cannot be written"),
        ("navsim show r.h5 --json > /dev/full", 3, b"error: standard output cannot be written"),
        ("navsim show nothing.h5 2> /dev/full", 2, b""),
        ("navsim show r.h5 >&-", 0, b""),
        ("navsim show nothing.h5 2>&-", 2, b""),
        ("navsim show r.h5 <&- >&- 2>&-", 0, b""),
        ("navsim schema landing | head -1 > /dev/null; exit ${PIPESTATUS[0]}", 0, b""),
        ("navsim show r.h5 | true; exit ${PIPESTATUS[0]}", 0, b""),
    ],
)
def test_streams_that_are_full_or_closed(line: str, code: int, said: bytes, shown: Path) -> None:
    done = shell(line, shown)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert b"Traceback" not in done.stderr
    assert b"Exception ignored" not in done.stderr


def test_a_closed_stream_does_not_get_into_the_result(shown: Path, tmp_path: Path) -> None:
    """A file opened while standard output is closed would be number 1, and get what is printed."""
    line = f"navsim run {SCENARIOS / 'landing.yaml'} --set duration_s=2 --figures none -o r.h5 >&- 2>&-"
    assert shell(line, tmp_path).returncode == 0
    assert shell("navsim show r.h5 --json", tmp_path).stdout == shell("navsim show r.h5 --json", shown).stdout


def test_words_for_a_terminal_that_went_away_are_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the going of a terminal and its signal every write to it fails; the work goes on, and the signal
    comes."""

    class Gone(io.StringIO):
        def isatty(self) -> bool:
            return True

        def write(self, _: str) -> int:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(sys, "stderr", Gone())
    with progress(10, "runs", True) as done:
        done(3)
    with progress(0, "placements", True):
        pass
    ending.say("nobody hears")


@pytest.mark.parametrize("full", [True, False])
def test_only_what_standard_output_refuses_is_said_of_it(full: bool) -> None:
    """An error without a file's name may be of a socket, too."""
    code = (
        "import errno, os\nfrom navsim.cli.ending import ends\n"
        f"with ends():\n    print('words' * {full})\n    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))"
    )
    with open("/dev/full" if full else os.devnull, "w") as out:
        done = subprocess.run([sys.executable, "-c", code], stdout=out, stderr=subprocess.PIPE, cwd=ROOT)
    assert done.returncode == 3
    said = b"standard output cannot be written: " if full else b""
    assert done.stderr == b"error: " + said + b"No space left on device\n"
