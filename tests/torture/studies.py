"""Small studies of every sort, killed or out of disk at a step, resumed, and compared with an undisturbed one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from navsim.results.schema import CONTENTS, NOT_REPEATED
from tests.conftest import SCENARIOS
from tests.forks import Ended, Forks
from tests.steps import FULL, KILL

QUIET = ("-q", "--figures", "none")
_SHORT = ("--set", "duration_s=6", "--set", "imu.rate_hz=20", "--set", "receiver.rate_hz=1", *QUIET)
_GRID = ("--set", "vary.1.grid.count=6", "--set", "vary.2.grid.count=6", *QUIET)
STUDIES: dict[str, tuple[object, ...]] = {
    "ensemble": ("run", SCENARIOS / "landing.yaml", *_SHORT, "--runs", 100, "--workers", 1),
    "ensemble, all kept": ("run", SCENARIOS / "landing.yaml", *_SHORT, "--runs", 60, "--keep", "all", "--workers", 2),
    "landing": ("run", SCENARIOS / "landing.yaml", *_SHORT),
    "landing with figures": ("run", SCENARIOS / "landing.yaml", "--set", "duration_s=6", "-q", "--figures", "."),
    "covariance": ("run", SCENARIOS / "landing.yaml", *_SHORT, "--method", "covariance"),
    "sweep": ("sweep", SCENARIOS / "placement_sweep.yaml", *_GRID),
    "sweep by covariance": (
        *("sweep", SCENARIOS / "placement_sweep.yaml", "--method", "covariance", *QUIET),
        *("--set", "vary.1.grid.count=2", "--set", "vary.2.grid.count=2", "--set", "outputs=[pdop, horizontal]"),
        *("--set", "set={pseudolites.frame: runway, imu.rate_hz: 10, duration_s: 61}"),
    ),
    "optimum of PDOP": (
        *("optimize", SCENARIOS / "placement_optimum.yaml", *QUIET, "--set", "pseudolites=[1, 2]", "--set", "effort=1"),
        *("--runs", 8),
    ),
    "optimum of the filter": (
        *("optimize", SCENARIOS / "placement_optimum.yaml", *QUIET, "--set", "pseudolites=[1]", "--set", "effort=1"),
        *("--set", "objective=vertical"),
        *("--set", "set={imu.rate_hz: 10, duration_s: 61, receiver.rate_hz: 1}", "--runs", 8),
    ),
    "replay": ("replay", SCENARIOS / "recorded_flight.yaml", "--set", "tuning=none", "--set", "outages=[]", *QUIET),
    "elevation": ("run", SCENARIOS / "mls_elevation.yaml", "--set", "montecarlo.experiments=5", *QUIET),
    "atc": ("run", SCENARIOS / "atc_tracking.yaml", "--runs", 5, "--set", "link.study_runs=5", *QUIET),
    "azimuth": ("run", SCENARIOS / "azimuth_tracking.yaml", "--runs", 5, "--set", "map.runs=0", *QUIET),
}
RESUMED = [name for name, words in STUDIES.items() if name.startswith(("ensemble", "sweep", "optimum"))]
"""Those that keep partial work, and know `--fresh`."""


_OF_THE_FORMAT = ("REFERENCE_LIST", "DIMENSION_LIST")
"""Attributes with addresses in the file."""


def contents(file: Path) -> dict[str, Any]:
    """All that is in a result, to the bit, but for the time when it was made and its digest; options and code too."""
    found: dict[str, Any] = {}

    def see(name: str, node: Any) -> None:
        found[f"attributes of {name}"] = {
            key: repr(value) for key, value in node.attrs.items() if key not in (*_OF_THE_FORMAT, *NOT_REPEATED)
        }
        if isinstance(node, h5py.Dataset):
            data = node[()]
            exact = data.tobytes() if isinstance(data, np.ndarray) and data.dtype != object else repr(data)
            found[name] = (str(node.dtype), node.shape, exact)

    with h5py.File(file) as tree:
        see("/", tree)
        tree.visititems(see)
        found["digests"] = json.loads(tree.attrs[CONTENTS])
    del found["digests"]["@created"]
    return found


@dataclass(frozen=True)
class Trial:
    """A study disturbed and resumed. what: was done to it. wrong: what must not be, None for all in order."""

    study: str
    what: str
    wrong: str | None


class Undisturbed:
    """What a study gives when it is left alone. steps: on the file system."""

    def __init__(self, commands: Forks, name: str, folder: Path, *more: object) -> None:
        self.command = (*STUDIES[name], *more, "-o", "r.h5")
        self._folder = folder
        folder.mkdir(parents=True)
        done = commands.run(*self.command, cwd=folder)
        if done.code != 0:
            raise RuntimeError(f"{name}: {done.err}")
        self.steps = done.steps
        self.contents = contents(folder / "r.h5")
        self.names = names(folder)

    def place(self, folder: Path, other: Path | None = None) -> Path:
        """A new folder; other: a result that stands there from before, under the same name."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        if other is not None:
            shutil.copy(other / "r.h5", folder / "r.h5")
        return folder


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def disturbed(
    commands: Forks, study: Undisturbed, before: Path, place: Path, what: str, at: int, *more: object
) -> str | None:
    """Disturb a study at a step, where an earlier result stands, resume it; what was wrong.

    before: a folder with the earlier result, of the same sort. more: words for the disturbed command alone.
    """
    study.place(place, before)
    old = contents(before / "r.h5")
    done = commands.run(*study.command, *more, cwd=place, what=what, at=at)
    expected = (-9, 0) if what == KILL else (0, 2, 3)
    wrong = done.failure(expected) if what == FULL else _killed(done)
    if wrong:
        return wrong
    try:
        left = contents(place / "r.h5")
    except OSError as error:
        return f"after it the result cannot be read: {error}"
    if left not in (old, study.contents):
        return "after it the result is neither the old one nor the new one"
    if done.code == 0 and left != study.contents:
        return "success without the result"
    return resumed(commands, study, place)


def _killed(done: Ended) -> str | None:
    return None if done.code in (-9, 0) else f"ended by {done.code}: {done.err[-200:]}"


def resumed(commands: Forks, study: Undisturbed, place: Path) -> str | None:
    """Run the command again, undisturbed; what was wrong."""
    done = commands.run(*study.command, cwd=place)
    if done.code != 0:
        return f"not resumed: {done.code}: {done.err[-300:]}"
    now = contents(place / "r.h5")
    if now != study.contents:
        differing = sorted(key for key in {*now, *study.contents} if now.get(key) != study.contents.get(key))
        return f"resumed with another result: {', '.join(differing[:5])}"
    if names(place) != study.names:
        return f"left behind: {sorted(set(names(place)) ^ set(study.names))}"
    return None


def adopted(commands: Forks, mine: Undisturbed, other: Undisturbed, place: Path, first: int, second: int) -> str | None:
    """Another study is killed at a step, begun anew with --fresh and killed again; then mine is run: what was wrong.

    It must be refused with the other's work left as it is, or give its own numbers.
    """
    mine.place(place)
    for at, more in ((first, ()), (second, ("--fresh",))):
        wrong = _killed(commands.run(*other.command, *more, cwd=place, what=KILL, at=at))
        if wrong:
            return wrong
    (place / "r.h5").unlink(missing_ok=True)
    done = commands.run(*mine.command, cwd=place)
    if done.code == 2 and "another study" in done.err:
        return resumed(commands, other, place)
    if done.code != 0:
        return f"ended by {done.code}: {done.err[-300:]}"
    return None if contents(place / "r.h5") == mine.contents else "another study's work was adopted"


def moments(steps: int, count: int, draw: Any) -> Iterator[int]:
    """Step numbers: all of them where count allows, else drawn."""
    yield from range(1, steps + 1) if steps <= count else sorted(draw.sample(range(1, steps + 1), count))
