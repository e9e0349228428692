"""Forks of navsim as processes with a time limit, quickly: one process loads everything, the others are its forks.

A fork takes milliseconds where a start takes more than a second, and is a process like any other: it has its own
signals, exit code and memory, and the folder, environment and streams of who asks for it. On its way it may get a
signal, or find the disk full, at a chosen step (`steps`).
"""

from __future__ import annotations

import atexit
import functools
import gc
import importlib
import importlib.util
import json
import os
import pkgutil
import resource
import select
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from types import TracebackType
from typing import Any, Self, TextIO

import navsim as navsim_package
from tests import steps
from tests.fork_client import HEARD, ask, received
from tests.fork_client import __file__ as CLIENT

ROOT = Path(__file__).resolve().parent.parent
NAVSIM, PYTHON, DASK = "navsim", "python", "dask"
"""Programs whose commands can be forks; of Python those with `-c`."""
RARE = ("navsim.__main__", "navsim.runner.cluster")
"""Modules that forks load by themselves."""
LATE = ("scipy.stats", "shapely")
"""Modules that searches load when they begin."""
XARRAY = ("xarray", "h5netcdf.legacyapi", *(["dask.array"] if importlib.util.find_spec("dask") else []))
"""Modules that xarray loads to open a result."""
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


@dataclass(frozen=True)
class Running:
    """A command that was started."""

    pid: int
    _told: Future[dict[str, Any]]
    _out: TextIO
    _err: TextIO

    def has_ended(self) -> bool:
        return self._told.done()

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def ended(self, limit_s: float = 60.0) -> Ended:
        """How it ends. It is killed if that takes longer."""
        try:
            told = self._told.result(limit_s)
        finally:
            self.send_signal(signal.SIGKILL)
        with self._out, self._err:
            return Ended(out=_whole(self._out), err=_whole(self._err), **told)


class Forks:
    """Runs commands of navsim as forks of one process."""

    def __init__(self, folder: Path, warm: Sequence[Sequence[object]] = ()) -> None:
        """folder: for what the commands say. warm: commands run once before, so that their forks find all loaded."""
        self._folder = folder
        self._short = tempfile.TemporaryDirectory(prefix="navsim-")  # the name of a socket has a hundred characters
        self.door = str(Path(self._short.name) / "door")
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        self._server = subprocess.Popen(
            [sys.executable, "-m", "tests.forks", self.door, str(folder)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self.prepare(warm)

    def prepare(self, warm: Sequence[Sequence[object]] = (), modules: Sequence[str] = ()) -> None:
        """Load what commands need, and modules, for all forks that are yet to come."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(f"{json.dumps([_texts(warm), list(modules)])}\n")
        self._server.stdin.flush()
        assert self._server.stdout.readline() == "ready\n"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the process that the others are forks of."""
        self._server.communicate()
        self._short.cleanup()

    def run(self, *arguments: object, cwd: Path, limit_s: float = 60.0, **how: object) -> Ended:
        """Run one command. how: `what` happens `at` which step `of` a sort, see `steps.watched`; `file_bytes`, the
        largest file that it can write."""
        with (
            open(os.devnull) as nothing,
            open(self._folder / "out.txt", "w+", encoding="utf-8", errors="replace") as out,
            open(self._folder / "err.txt", "w+", encoding="utf-8", errors="replace") as err,
        ):
            streams = {number: stream.fileno() for number, stream in enumerate((nothing, out, err))}
            told = ask(self.door, list(map(str, arguments)), str(cwd), streams, os.environ, limit_s=limit_s, **how)
            return Ended(out=_whole(out), err=_whole(err), **told)

    def start(self, *arguments: object, cwd: Path, program: str = NAVSIM, **how: object) -> Running:
        """Start one command and leave it running. how: as of `run`."""
        # a command that is killed may stop within a letter: that must not hide the rest of its output
        out = [tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") for _ in range(2)]  # noqa: SIM115
        pid: Queue[int] = Queue()
        with open(os.devnull) as nothing:
            streams = {number: stream.fileno() for number, stream in enumerate((nothing, *out))}
            order = functools.partial(ask, self.door, list(map(str, arguments)), str(cwd), streams, dict(os.environ))
            told = ThreadPoolExecutor(1).submit(order, pid.put, program=program, **how)
            return Running(pid.get(), told, *out)

    def programs(self, folder: Path) -> Path:
        """Write programs `navsim` and `python` for shells, whose commands are forks; returns their folder."""
        folder.mkdir(exist_ok=True)
        for name in (NAVSIM, PYTHON):
            program(folder / name, "-IS", CLIENT, self.door, name)
        return folder


def _whole(stream: TextIO) -> str:
    stream.seek(0)
    return stream.read()


def program(file: Path, *words: object) -> None:
    """Write a program that is this Python with these words and those that the program is given."""
    said = " ".join(shlex.quote(str(word)) for word in (sys.executable, *words))
    file.write_text(f'#!/bin/sh\nexec {said} "$@"\n')
    file.chmod(0o755)


def found_first(programs: Path, tree: Path = ROOT) -> dict[str, str]:
    """The environment of a shell that finds the programs of a folder before others, and the package of a tree."""
    return {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(tree)}


@functools.cache
def shared() -> Forks:
    """The one of this test process; it ends with it."""
    landing, recorded = (ROOT / "scenarios" / f"{name}.yaml" for name in ("landing", "recorded_flight"))
    short = ("run", landing, "--set", "duration_s=65", "--set", "imu.rate_hz=20", "--set", "receiver.rate_hz=1",
             "--force", "--figures", "none", "-o", "warm.h5")  # fmt: skip
    warm = (
        short,
        ("plot", "warm.h5", "--only", "errors"),
        (*short, "--method", "covariance"),
        (*short, "--runs", 26, "--keep", "all"),
        (*short, "--set", "filter.kind=eskf"),
        ("replay", recorded, "--set", "tuning=none", "--set", "end_s=30", "--figures", "none", "-o", "warm_replay.h5"),
    )
    folder = tempfile.TemporaryDirectory(prefix="navsim-forks-")
    atexit.register(folder.cleanup)
    forks = Forks(Path(folder.name), warm)
    atexit.register(forks.close)
    return forks


@functools.cache
def installed() -> str:
    """The program `navsim`, whose commands are forks; it hears signals and has standard input as any other."""
    folder = tempfile.TemporaryDirectory(prefix="navsim-programs-")
    atexit.register(folder.cleanup)
    return str(shared().programs(Path(folder.name)) / NAVSIM)


def navsim(*arguments: object, cwd: Path, code: int | None = 0, **how: object) -> subprocess.CompletedProcess[str]:
    """A command that must end with this code (None: any), without a traceback. how: as of `Forks.run`."""
    done = shared().run(*arguments, cwd=cwd, limit_s=600.0, **how)
    assert "Traceback" not in done.err
    assert code is None or done.code == code, done.err + done.out
    assert done.code is not None, "it hangs"
    return subprocess.CompletedProcess(list(arguments), done.code, done.out, done.err)


def _texts(commands: Sequence[Sequence[object]]) -> list[list[str]]:
    return [[str(word) for word in command] for command in commands]


def _prepare(warm: list[list[str]], modules: list[str]) -> None:
    from typer.testing import CliRunner

    from navsim.cli.main import app

    for command in warm:
        done = CliRunner().invoke(app, command)
        if done.exit_code:
            raise RuntimeError(f"{command}: {done.output}")
    for module in modules:
        importlib.import_module(module)
    gc.freeze()  # what is collected in a fork is what it made itself
    print("ready", flush=True)


def _serve(door: str, folder: Path) -> None:
    os.chdir(folder)
    for module in pkgutil.walk_packages(navsim_package.__path__, "navsim."):
        if module.name not in RARE:
            importlib.import_module(module.name)
    for name in LATE:
        importlib.import_module(name)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(door)
        listening.listen()
        while True:
            if sys.stdin in select.select([listening, sys.stdin], [], [])[0]:
                asked = sys.stdin.readline()
                if not asked:  # its input is closed at the end
                    return
                _prepare(*json.loads(asked))
                continue
            line, _ = listening.accept()
            with line:
                if os.fork() == 0:
                    listening.close()
                    _keep(line)
            with suppress(ChildProcessError):  # those that have ended
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass


def _keep(line: socket.socket) -> None:
    """The process between the one that serves and a command: it tells how that ended, and does not return."""
    code = 1
    try:
        order = received(line)
        limit_s = order.pop("limit_s", 0.0)
        with tempfile.TemporaryFile("w+") as counted:
            began = time.monotonic()
            child = os.fork()
            if child == 0:
                line.close()
                _become(counted, **order)
            line.sendall(f"{child}\n".encode())
            late = False

            def kill(*_: object) -> None:
                nonlocal late
                late = True
                os.kill(child, signal.SIGKILL)

            signal.signal(signal.SIGALRM, kill)
            signal.setitimer(signal.ITIMER_REAL, limit_s)
            _, status, usage = os.wait4(child, 0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            told = {
                "code": None if late else os.waitstatus_to_exitcode(status),
                "seconds": time.monotonic() - began,
                "peak_mb": usage.ru_maxrss / 1024.0,
                "steps": int(_whole(counted) or 0),
            }
        line.sendall(f"{json.dumps(told)}\n".encode())
        code = 0
    finally:
        os._exit(code)


def _become(
    counted: TextIO,
    arguments: list[str],
    cwd: str,
    environment: dict[str, str],
    streams: dict[int, int],
    program: str = NAVSIM,
    file_bytes: int | None = None,
    **how: Any,
) -> None:
    """The forked process: it runs the command and does not return."""
    code = 1
    try:
        for number in HEARD:  # as a program has them that a terminal starts, whoever started the tests
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        os.chdir(cwd)
        os.environ.clear()
        os.environ.update(environment)
        for number in range(3):
            if number in streams:
                os.dup2(streams[number], number)
                os.close(streams[number])
            else:
                os.close(number)
        # new streams, open to the end: what a buffer of the parent holds is not said a second time
        sys.stdin = open(0, closefd=False) if 0 in streams else None  # noqa: SIM115
        sys.stdout, sys.stderr = (
            open(number, "w", buffering, encoding="utf-8", closefd=False) if number in streams else None  # noqa: SIM115
            for number, buffering in ((1, -1), (2, 1))  # errors a line at a time
        )
        sys.argv = [program, *arguments]
        sys.modules["__main__"].__package__ = None  # as of a program that is installed, whose name is said in its help
        from navsim.__main__ import main

        if file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
        with steps.watched(Path(cwd), **how) as count:
            try:
                {NAVSIM: main, PYTHON: _python, DASK: _dask}[program]()
                code = 0
            except SystemExit as left:
                code = left.code if isinstance(left.code, int) else int(left.code is not None)
        counted.write(str(count()))
        counted.flush()
    except BaseException:  # told as an interpreter would at its end, for `Ended.failure` to find
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, AttributeError):
                stream.flush()
        os._exit(code)


def _dask() -> None:
    from dask.cli import run_cli

    run_cli()


def _python() -> None:
    """What `python -c` does."""
    _, option, code, *arguments = sys.argv
    assert option == "-c", "only commands can be forks"
    sys.argv = [option, *arguments]
    sys.path[0] = ""
    exec(compile(code, "<string>", "exec"), {"__name__": "__main__"})


if __name__ == "__main__":
    _serve(sys.argv[1], Path(sys.argv[2]))
