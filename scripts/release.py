"""Build the sdist and its wheel, and try the wheel under every Python that is to be had.

    python scripts/release.py [PYTHON ...]

Makes dist/ and docs/packaging-measured.md.

Interpreters that are not given are looked for on the PATH and below ~/.pyenv. Each gets an environment of its own and
the wheel with its dependencies from the package index, makes a first scenario fly in an empty folder, and its numbers
are laid beside those of this environment.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SERIES = ("3.11", "3.12", "3.13")
MOST_BYTES = 2_000_000
"""Size of the wheel."""
COMMANDS = (
    ("init", "-o", "my.yaml"),
    ("validate", "my.yaml"),
    ("run", "my.yaml", "--runs", "8", "--figures", "figures", "-o", "my.h5"),
    ("run", "my.yaml", "--method", "covariance", "-o", "analysed.h5"),
    ("show", "my.h5", "analysed.h5"),
    ("report", "my.h5", "-o", "my.html"),
    ("export", "my.h5", "--kml", "--csv"),
)


def done(*command: object, cwd: Path, env: dict[str, str] | None = None) -> str:
    """What a command prints; ends with its words where it fails."""
    ran = subprocess.run(list(map(str, command)), cwd=cwd, env=env, capture_output=True, text=True, check=False)
    if ran.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit {ran.returncode}\n{ran.stdout}{ran.stderr}")
    return ran.stdout


def build(folder: Path) -> Path:
    """The sdist of this tree, and the wheel of what the sdist holds; returns the wheel."""
    shutil.rmtree(folder, ignore_errors=True)
    done(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=ROOT)
    (archive,) = folder.glob("*.tar.gz")
    wheels = []
    with tempfile.TemporaryDirectory() as place:
        with tarfile.open(archive) as sdist:
            sdist.extractall(place, filter="data")
        (tree,) = Path(place).iterdir()
        for name in ("first", "again"):
            done(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", Path(place) / name, cwd=tree)
            (wheel,) = (Path(place) / name).glob("*.whl")
            wheels.append(wheel.read_bytes())
        target = folder / wheel.name
        target.write_bytes(wheels[0])
    if wheels[0] != wheels[1]:
        sys.exit("two wheels of one tree are not the same bytes")
    if len(wheels[0]) > MOST_BYTES:
        sys.exit(f"{target}: {len(wheels[0])} bytes, more than {MOST_BYTES}")
    return target


def interpreters(given: list[str]) -> dict[str, str]:
    """Pythons of the supported series, by series."""
    candidates = given or [
        *(path for path in (shutil.which(f"python{series}") for series in SERIES) if path),
        *map(str, sorted(Path.home().glob(".pyenv/versions/*/bin/python"))),
    ]
    found: dict[str, str] = {}
    for python in candidates:
        version = subprocess.run([python, "-V"], capture_output=True, text=True, check=False).stdout
        series = re.match(r"Python (3\.\d+)\.", version)
        if series and series.group(1) in SERIES:
            found.setdefault(series.group(1), python)
    return found


def summary(navsim: Path, place: Path, environment: dict[str, str]) -> dict[str, object]:
    """Every command of a new user in an empty folder; the numbers of the ensemble."""
    for command in COMMANDS:
        done(navsim, *command, cwd=place, env=environment)
    for name in ("my.h5", "my.html", "my.kml"):
        if not (place / name).stat().st_size:
            sys.exit(f"{place / name} is empty")
    return dict(json.loads(done(navsim, "show", "my.h5", "--json", cwd=place, env=environment)))


def numbers(tree: object, path: str = "") -> dict[str, float]:
    """The numbers of a summary by their places."""
    if isinstance(tree, dict):
        return {k: v for name, below in tree.items() for k, v in numbers(below, f"{path}/{name}").items()}
    if isinstance(tree, list):
        return {k: v for i, below in enumerate(tree) for k, v in numbers(below, f"{path}/{i}").items()}
    return {path: float(tree)} if isinstance(tree, (int, float)) else {}


def apart(mine: dict[str, float], theirs: dict[str, float]) -> float:
    """The largest relative difference of numbers; ends where they are not of the same places."""
    if mine.keys() != theirs.keys():
        sys.exit(f"summaries differ in {sorted(mine.keys() ^ theirs.keys())[:5]}")
    return max(abs(mine[k] - theirs[k]) / max(abs(mine[k]), 1e-12) for k in mine)


def main() -> None:
    wheel = build(ROOT / "dist")
    print(f"{wheel}: {wheel.stat().st_size} bytes, the same twice", file=sys.stderr)
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    commit = done("git", "rev-parse", "--short", "HEAD", cwd=ROOT).strip()
    lines = [
        "# The wheel, tried",
        "",
        f"Made by `make release` (`scripts/release.py`) on {date.today()}, after commit {commit}: version {version},",
        f"{wheel.stat().st_size / 1e3:.0f} kB. Two builds from the sdist have the same bytes. Each Python installs the",
        "wheel with the extra `report` into a fresh environment, and runs these commands in an empty folder:",
        f"{', '.join(f'`navsim {chr(32).join(command)}`' for command in COMMANDS)}.",
        "",
        "Difference: the largest relative one of any number of `navsim show my.h5 --json` from the environment of",
        "`requirements.lock`.",
        "",
        "| Python | numpy | numba | h5py | largest difference |",
        "|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder) / "here"
        here.mkdir()
        own = numbers(summary(Path(sys.executable).parent / "navsim", here, dict(os.environ)))
        for series, python in interpreters(sys.argv[1:]).items():
            place = Path(folder) / series
            place.mkdir()
            done(python, "-m", "venv", place / "venv", cwd=place)
            inside = place / "venv/bin"
            done(inside / "python", "-m", "pip", "install", "-q", f"{wheel}[report]", cwd=place)
            # neither this tree nor its machine code
            environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA", "VIRTUAL"))}
            environment["NUMBA_CACHE_DIR"] = str(place / "cache")
            work = place / "work"
            work.mkdir()
            gap = apart(own, numbers(summary(inside / "navsim", work, environment)))
            wanted = "import platform; from importlib.metadata import version as v; print(platform.python_version(), "
            wanted += "v('numpy'), v('numba'), v('h5py'))"
            versions = done(inside / "python", "-c", wanted, cwd=place).split()
            lines.append(f"| {' | '.join(versions)} | {gap:.1e} |")
            print(lines[-1], file=sys.stderr)
            shutil.rmtree(place)
    (ROOT / "docs/packaging-measured.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
