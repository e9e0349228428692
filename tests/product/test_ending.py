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
from contextlib import suppress
from pathlib import Path

import pytest

from navsim.cli import exit_status
from navsim.cli.common import progress
from tests.conftest import ROOT, SCENARIOS
from tests.forks import PYTHON, Running, found_first, navsim, shared
from tests.helpers import in_brief

NAVSIM = [sys.executable, "-m", "navsim"]
LONG = ["run", str(SCENARIOS / "landing.yaml"), "--runs", "100000", "--keep", "none", "-q", "--workers", "1",
        "--set", "filter.kind=eskf", "-o", "long.h5"]  # fmt: skip


def _listening() -> None:
    """The tests may themselves run where signals are ignored, as in the background of a script."""
    for number in exit_status.WORDS:
        signal.signal(number, signal.SIG_DFL)


def start(cwd: Path, *arguments: str) -> Running:
    return shared().start(*arguments, cwd=cwd, limit_s=300.0)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("number", in_brief(exit_status.WORDS, 0, 1))
def test_signals_keep_finished_work(number: signal.Signals, tmp_path: Path) -> None:
    process = start(tmp_path, *LONG)
    until(lambda: any(tmp_path.glob("long.h5.partial/*.npz")))
    process.send_signal(number)
    done = process.ended()
    assert done.code == 128 + number
    assert "finished runs are kept in long.h5.partial; the same command continues from there" in done.err
    assert done.err.endswith(f"{exit_status.WORDS[number]}\n")
    assert "Traceback" not in done.err
    assert done.out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["long.h5.partial"]


def seconds_of_other_threads(pid: int) -> float:
    """Processor time of the threads of a process without that of its main thread."""
    ticks = 0
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # it ended since the folder was listed
            if thread.name != str(pid):
                fields = (thread / "stat").read_text().rpartition(")")[2].split()
                ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs a system that tells of threads")
def test_a_signal_does_not_wait_for_the_compiler(tmp_path: Path) -> None:
    """Which takes most of a minute at the first start, and would have it to the end."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cold")}
    command = [*NAVSIM, "run", str(SCENARIOS / "landing.yaml"), "--figures", "none", "-o", "a.h5"]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True, preexec_fn=_listening
    )
    assert process.stderr is not None
    assert "compiling the kernels of this kind" in process.stderr.readline()
    until(lambda: seconds_of_other_threads(process.pid) > 0.5)  # where the main thread compiles it ends at once
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM
    assert err.splitlines()[-1] == "terminated while kernels were compiled"


def test_signals_in_a_row_show_no_traceback(tmp_path: Path) -> None:
    """Until the interpreter itself has ended: that of a program, not a fork."""
    command = [*NAVSIM, *LONG]
    process = subprocess.Popen(command, cwd=tmp_path, text=True, preexec_fn=_listening, stderr=subprocess.PIPE)
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
    in_brief(["typer", "navsim.cli.run", "pydantic", "navsim.scenario.landing", "navsim.landing.study", "numba"], 1, 4),
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
from navsim.landing import study as landing
landing.partial_key = key
main()
"""
    done = shared().start("-c", code, cwd=tmp_path, program=PYTHON).ended()
    assert "Exception ignored" in done.err
    assert done.code == 130, done.err
    assert done.err.endswith("interrupted\n")


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
    second = start(tmp_path, *LONG).ended()
    assert second.code == 2
    assert f"long.h5: process {first.pid} on " in second.err
    assert "is at work on it; wait for it, or choose another -o/--output" in second.err
    assert not first.has_ended()
    assert start(tmp_path, *LONG, "--dry-run").ended().code == 0
    first.send_signal(signal.SIGKILL)
    first.ended()
    (tmp_path / ".long.h5.4711.tmp").touch()  # a result half written by a process that was killed
    third = start(tmp_path, *LONG)
    until(lambda: not (tmp_path / ".long.h5.4711.tmp").exists())
    third.send_signal(signal.SIGTERM)
    third.ended()
    assert [path.name for path in tmp_path.iterdir()] == ["long.h5.partial"]


def test_too_little_memory_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left, exit_status.ends():
        raise MemoryError
    assert left.value.code == exit_status.RUN_FAILED
    assert capsys.readouterr().err == "error: not enough memory; --dry-run prints the need\n"


# --- streams


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shown")
    navsim("run", SCENARIOS / "landing.yaml", "--set", "duration_s=2", "-q", "-o", "r.h5", cwd=folder)
    return folder


def shell(line: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(["bash", "-c", line], cwd=cwd, capture_output=True, timeout=120, env=environment)


def started(line: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """By an interpreter that starts with these streams and settings."""
    line = line.replace("navsim", f"{sys.executable} -m navsim", 1)
    return shell(line, cwd, **{**os.environ, "PYTHONPATH": str(ROOT), **environment})


@pytest.fixture(scope="module")
def forked(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a shell whose navsim is quick to start."""
    return found_first(shared().programs(tmp_path_factory.mktemp("programs")))


@pytest.mark.parametrize(
    "environment",
    in_brief([{"PYTHONIOENCODING": "ascii"}, {"PYTHONIOENCODING": "cp1251"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}], 0),
)
def test_any_encoding_will_do(environment: dict[str, str], shown: Path) -> None:
    done = started("navsim show r.h5", shown, **environment)
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
def test_streams_that_are_full_or_closed(
    line: str, code: int, said: bytes, shown: Path, forked: dict[str, str]
) -> None:
    # what is closed is so from the interpreter's first moment
    done = started(line, shown) if "&-" in line else shell(line, shown, **forked)
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert b"Traceback" not in done.stderr
    assert b"Exception ignored" not in done.stderr


def test_a_closed_stream_does_not_get_into_the_result(shown: Path, tmp_path: Path) -> None:
    """A file opened while standard output is closed would be number 1, and get what is printed."""
    line = f"navsim run {SCENARIOS / 'landing.yaml'} --set duration_s=2 --figures none -o r.h5 >&- 2>&-"
    assert started(line, tmp_path).returncode == 0
    mine, right = (navsim("show", "r.h5", "--json", cwd=folder).stdout for folder in (tmp_path, shown))
    assert mine == right


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
    exit_status.print_message("nobody hears")


@pytest.mark.parametrize("full", [True, False])
def test_only_what_standard_output_refuses_is_said_of_it(full: bool) -> None:
    """An error without a file's name may be of a socket, too."""
    code = (
        "import errno, os\nfrom navsim.cli.exit_status import ends\n"
        f"with ends():\n    print('words' * {full})\n    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))"
    )
    with open("/dev/full" if full else os.devnull, "w") as out:
        done = subprocess.run([sys.executable, "-c", code], stdout=out, stderr=subprocess.PIPE, cwd=ROOT)
    assert done.returncode == 3
    said = b"standard output cannot be written: " if full else b""
    assert done.stderr == b"error: " + said + b"No space left on device\n"
