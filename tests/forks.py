"""Forks of navsim as processes with a time limit, quickly: one process loads everything, the others are its forks.

A fork takes milliseconds where a start takes more than a second, and is a process like any other: it has its own
signals, exit code and memory. On its way it may be killed, or find the disk full, at a chosen step (`steps`).
"""

from __future__ import annotations

import atexit
import functools
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tests import steps

ROOT = Path(__file__).resolve().parent.parent
HANG_S = 10.0
"""A command that has to refuse its input and takes longer hangs."""
MOST_MB = 1000.0
"""A command that takes more memory was bombed."""


@dataclass(frozen=True)
class Ended:
    """How a command ended. code: negative for a signal; None where it ran out of time. peak_mb: resident memory.
    steps: on the file system under its folder, where they were counted."""

    code: int | None
    out: str
    err: str
    seconds: float
    peak_mb: float
    steps: int

    def failure(self, allowed: Sequence[int] = (0, 2, 3)) -> str | None:
        """What no command should ever do, in words that are the same for the same cause; None for all in order."""
        if self.code is None:
            return "hang"
        if "Traceback" in self.err or "Exception ignored" in self.err:
            place = [line.strip() for line in self.err.splitlines() if "/navsim/" in line][-1:]
            return f"traceback: {self.err.strip().splitlines()[-1][:120]} {' '.join(place)[-120:]}"
        if self.code not in allowed:
            return f"ended by {self.code}"
        if self.code != 0 and "error: " not in self.err:
            return "refused without a word"
        return "memory" if self.peak_mb > MOST_MB else None


class Forks:
    """Runs commands of navsim as forks of one process, one at a time."""

    def __init__(self, folder: Path, warm: Sequence[Sequence[object]] = ()) -> None:
        """folder: for what the commands say. warm: commands run once before, so that their forks find all loaded."""
        self._folder = folder
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        self._server = subprocess.Popen(
            [sys.executable, "-m", "tests.forks", str(folder), json.dumps(_texts(warm))],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert self._answer() == "ready"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self._server.communicate()

    def run(self, *arguments: object, cwd: Path, what: str = steps.COUNT, at: int = 0, limit_s: float = 60.0) -> Ended:
        """Run one command. what: happens at step number `at`, see `steps`."""
        assert self._server.stdin is not None
        order = {"arguments": list(map(str, arguments)), "cwd": str(cwd), "what": what, "at": at, "limit_s": limit_s}
        self._server.stdin.write(json.dumps(order) + "\n")
        self._server.stdin.flush()
        told = self._answer()
        out, err = (
            (self._folder / name).read_text(encoding="utf-8", errors="replace") for name in ("out.txt", "err.txt")
        )
        return Ended(out=out, err=err, **told)

    def _answer(self) -> Any:
        assert self._server.stdout is not None
        return json.loads(self._server.stdout.readline())


@functools.cache
def _shared() -> Forks:
    """The one of this test process; it ends with it, for its input is closed then."""
    landing = ROOT / "scenarios" / "landing.yaml"
    short = ("run", landing, "--set", "duration_s=65", "-q", "--force")
    warm = (
        short,
        (*short, "--figures", "."),
        (*short, "--method", "covariance"),
        (*short, "--runs", 26, "--keep", "all"),
    )
    folder = tempfile.TemporaryDirectory(prefix="navsim-forks-")
    atexit.register(folder.cleanup)
    return Forks(Path(folder.name), warm)


def navsim(*arguments: object, cwd: Path, code: int | None = 0) -> subprocess.CompletedProcess[str]:
    """A command that must end with this code (None: any), without a traceback."""
    done = _shared().run(*arguments, cwd=cwd, limit_s=600.0)
    assert "Traceback" not in done.err
    assert code is None or done.code == code, done.err + done.out
    assert done.code is not None, "it hangs"
    return subprocess.CompletedProcess(list(arguments), done.code, done.out, done.err)


def _texts(commands: Sequence[Sequence[object]]) -> list[list[str]]:
    return [[str(word) for word in command] for command in commands]


def _serve(folder: Path, warm: list[list[str]]) -> None:
    from typer.testing import CliRunner

    from navsim.cli.main import app

    os.chdir(folder)
    for command in warm:
        done = CliRunner().invoke(app, command)
        if done.exit_code:
            raise RuntimeError(f"{command}: {done.output}")
    importlib.import_module("navsim.report.page.document")  # Bokeh, a second for each report
    gc.freeze()  # what is collected in a fork is what it made itself
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        print(json.dumps(_forked(folder, **json.loads(line))), flush=True)


def _forked(folder: Path, arguments: list[str], cwd: str, what: str, at: int, limit_s: float) -> dict[str, Any]:
    counted = folder / "steps.txt"
    counted.unlink(missing_ok=True)
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        _become(folder, arguments, cwd, what, at)
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() - began > limit_s:
            os.kill(child, signal.SIGKILL)
            _, _, usage = os.wait4(child, 0)
            status = None
            break
        time.sleep(0.001)
    return {
        "code": None if status is None else os.waitstatus_to_exitcode(status),
        "seconds": time.monotonic() - began,
        "peak_mb": usage.ru_maxrss / 1024.0,
        "steps": int(counted.read_text()) if counted.exists() else 0,
    }


def _become(folder: Path, arguments: list[str], cwd: str, what: str, at: int) -> None:
    """The forked process: it runs the command and does not return."""
    code = 1
    try:
        os.chdir(cwd)
        for number, name in ((0, os.devnull), (1, str(folder / "out.txt")), (2, str(folder / "err.txt"))):
            descriptor = os.open(name, os.O_RDWR | (os.O_CREAT | os.O_TRUNC if number else 0))
            os.dup2(descriptor, number)
            os.close(descriptor)
        # new streams, open to the end: what a buffer of the parent holds is not said a second time
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
        sys.stdout, sys.stderr = (open(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))  # noqa: SIM115
        sys.argv = ["navsim", *arguments]
        from navsim.__main__ import main

        with steps.watched(Path(cwd), what, at) as count:
            try:
                main()
                code = 0
            except SystemExit as left:
                code = left.code if isinstance(left.code, int) else int(left.code is not None)
        (folder / "steps.txt").write_text(str(count()))
    except BaseException:  # told as an interpreter would at its end, for `Ended.failure` to find
        traceback.print_exc()
    finally:
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), json.loads(sys.argv[2]))
