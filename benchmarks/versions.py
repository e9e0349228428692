"""This version of navsim and the one before, as commands and as processes that can be asked for times."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from dataclasses import dataclass
from importlib import metadata
from io import BytesIO
from pathlib import Path

from measure import ROOT, WORK, Job
from packaging.requirements import Requirement

LOCK = "requirements.lock"


NOT_A_USERS = ("OPENBLAS_NUM_THREADS", "PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED")
"""What the benchmarks set for themselves, and what has Python compile every module anew at every start."""


def environment(**more: str) -> dict[str, str]:
    """The environment of a user."""
    return {name: value for name, value in os.environ.items() if name not in NOT_A_USERS} | more


_BETWEEN = """
import os, sys
_, status, usage = os.wait4(os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ), 0)
print(usage.ru_maxrss)
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""What starts a command whose memory is asked for: the most that a process held counts from before it became the
command, when it was a copy of whoever started it."""


def spend(words: list[str], environ: dict[str, str]) -> float:
    """Carry out a command in an empty folder, its output thrown away; its time from start to end, s. Raises
    RuntimeError where it fails."""
    start = time.perf_counter()
    _carry_out(words, environ)
    return time.perf_counter() - start


def most_memory(words: list[str], environ: dict[str, str]) -> float:
    """The same; the most memory it held, bytes."""
    printed = _carry_out([sys.executable, "-I", "-S", "-c", _BETWEEN, *words], environ)
    return float(printed.split()[-1]) * (1.0 if sys.platform == "darwin" else 1024.0)


def _carry_out(words: list[str], environ: dict[str, str]) -> str:
    """What a command prints. Raises RuntimeError where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(words, cwd=folder, env=environ, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{words} ended with {done.returncode}: {done.stderr[-2000:]}")
    return done.stdout


@dataclass(frozen=True)
class Version:
    """A navsim: the folder of its source, the Python it runs in, and what its environment has beside the usual."""

    root: Path
    python: str
    own: dict[str, str]

    @property
    def environ(self) -> dict[str, str]:
        """The environment of its processes."""
        path = os.pathsep.join(filter(None, [str(self.root), os.environ.get("PYTHONPATH", "")]))
        return environment(PYTHONPATH=path, **self.own)

    @property
    def landing(self) -> str:
        """Its main scenario."""
        return str(self.root / "scenarios" / "landing.yaml")

    def spend(self, *arguments: str, **more: str) -> float:
        """The time of a command of it; more: variables of its environment."""
        return spend([self.python, "-m", "navsim", *arguments], self.environ | more)

    def most_memory(self, *arguments: str) -> float:
        """The most memory of a command of it."""
        return most_memory([self.python, "-m", "navsim", *arguments], self.environ)

    def command(self, *arguments: str) -> Job:
        """A command of it as a job."""
        return lambda: self.spend(*arguments)


class Clock:
    """A process of a version that keeps its work warm, and does it once whenever it is asked: a job."""

    def __init__(self, version: Version, script: str, *arguments: str):
        self._process = subprocess.Popen(
            [version.python, str(Path(__file__).resolve().parent / script), *arguments],
            env=version.environ,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        where = self._answer()
        if Path(where).resolve().parent.parent != version.root.resolve():
            raise RuntimeError(f"{script} was to run the navsim of {version.root}, not {where}")

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a process ended before it was asked to: {self._process.wait()}")
        return line.strip()

    def __call__(self) -> float:
        assert self._process.stdin is not None
        print("once", file=self._process.stdin, flush=True)
        return float(self._answer())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def now() -> Version:
    """This version."""
    return Version(ROOT, sys.executable, {})


def before(commit: str) -> Version | None:
    """The version of a commit, from git, its kernels in a cache of its own; None where git does not have it. It runs
    in this environment where it wants the same packages, else in one of its own."""
    folder = WORK / commit
    if not (folder / "navsim").is_dir():
        if shutil.which("git") is None:
            return None
        packed = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True)
        if packed.returncode:
            return None
        with tarfile.open(fileobj=BytesIO(packed.stdout)) as archive:
            archive.extractall(folder, filter="data")
    return Version(folder, _python(folder), {"NUMBA_CACHE_DIR": str(folder / "cache")})


def _wanted(folder: Path) -> list[Requirement]:
    """The packages that a version wants here, each with its one version."""
    lines = (folder / LOCK).read_text().replace("\\\n", " ").splitlines()
    listed = [line.split(" --hash")[0] for line in lines if line and line[0] not in " #"]
    wanted = [Requirement(line) for line in listed]
    return [w for w in wanted if w.marker is None or w.marker.evaluate()]


def _is_here(wanted: Requirement) -> bool:
    """Whether a package is installed as wanted."""
    try:
        return metadata.version(wanted.name) in wanted.specifier
    except metadata.PackageNotFoundError:
        return False


def _python(folder: Path) -> str:
    """A Python with the packages that a version wants."""
    if all(_is_here(wanted) for wanted in _wanted(folder)):
        return sys.executable
    place = folder / ".venv"
    python = str(place / "bin" / "python")
    if not (place / "complete").exists():
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(place)], check=True)
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--require-hashes"]
        subprocess.run([*install, "-r", str(folder / LOCK)], check=True)
        (place / "complete").touch()
    return python
