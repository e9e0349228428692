"""The trials by seed, each of which tells what it did and what was wrong; the tests take few, `make torture` many."""

from __future__ import annotations

import functools
import math
import random
import re
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import jsonschema

from navsim.kinds import KINDS, OF_FILES
from navsim.results.result import ResultError, read
from navsim.scenario.load import section
from tests.conftest import SCENARIOS
from tests.forks import HANG_S, MOST_MB, Forks
from tests.steps import FULL, KILL
from tests.torture import flips, mutants, studies

ALL = tuple(studies.STUDIES)


def warming(names: Sequence[str] = ALL) -> list[tuple[object, ...]]:
    """What the forks are to find loaded for trials of these studies."""
    of_kinds = {yaml_kind(text): name for name, text in sources().items()}
    checks = [("validate", SCENARIOS / name) for name in of_kinds.values()]
    return [*checks, *((*studies.STUDIES[name], "--force") for name in names)]


@dataclass
class Tally:
    """What trials of one sort have shown. ended: how many in which way. wrong: what must not be: (what, how)."""

    ended: Counter[str] = field(default_factory=Counter)
    wrong: list[tuple[str, str]] = field(default_factory=list)
    slowest_s: float = 0.0
    peak_mb: float = 0.0

    def add(self, what: str, ended: str, wrong: str | None) -> None:
        self.ended[ended] += 1
        if wrong is not None:
            self.wrong.append((what, wrong))

    @property
    def count(self) -> int:
        return sum(self.ended.values())

    def took(self, seconds: float, peak_mb: float) -> None:
        self.slowest_s, self.peak_mb = max(self.slowest_s, seconds), max(self.peak_mb, peak_mb)


def sources() -> dict[str, bytes]:
    """The shipped scenarios and studies."""
    return {path.name: path.read_bytes() for path in sorted(SCENARIOS.glob("*.yaml"))}


def scenario_folder(folder: Path) -> Path:
    """The shipped files, where mutants of them find what they name, and strange ones beside them."""
    shutil.copytree(SCENARIOS, folder)
    mutants.strange_files(folder)
    return folder


def mutated(commands: Forks, folder: Path, seed: int, count: int, each: int = 0) -> Tally:
    """`validate` of mutants: refused with a place, or in order by the published schema.

    each: how many are to be accepted, and how many refused; more than `count` are drawn for that, up to ten times it.
    """
    tally = Tally()
    for mutant in islice(mutants.mutants(sources(), seed), 10 * count):
        if tally.count >= count and min(tally.ended["accepted"], tally.ended["refused"]) >= each:
            break
        (folder / mutants.NAME).write_bytes(mutant.text)
        done = commands.run("validate", mutants.NAME, cwd=folder, limit_s=HANG_S)
        wrong = done.failure((0, 2))
        if wrong is None and done.code == 0:
            wrong = _breaks(mutant.data)
        tally.took(done.seconds, done.peak_mb)
        tally.add(f"{mutant.of}: {mutant.note}", {0: "accepted", 2: "refused"}.get(done.code, "else"), wrong)
    return tally


@functools.cache
def _schema(kind: str) -> Any:
    return jsonschema.Draft202012Validator(section(kind).model_json_schema())


def _breaks(data: Any) -> str | None:
    """What an accepted file breaks: a number that is none, or the published schema."""
    if data is None:
        return None
    if not _finite(data):
        return "accepted with a number that is not finite"
    kind = data.get("kind") if isinstance(data, dict) else None
    if kind not in OF_FILES:
        return "accepted without a kind that there is"
    errors = [
        f"{'.'.join(map(str, error.absolute_path))}: {error.message[:100]}" for error in _schema(kind).iter_errors(data)
    ]
    return f"accepted against its schema: {errors[0]}" if errors else None


def _finite(node: Any) -> bool:
    if isinstance(node, (dict, list)):
        return all(map(_finite, node.values() if isinstance(node, dict) else node))
    return not isinstance(node, float) or math.isfinite(node)


SHORTER = {
    "landing": ("--set", "duration_s=2"),
    "mls-elevation": ("--set", "montecarlo.experiments=3"),
    "atc-tracking": ("--runs", "5"),
    "azimuth-tracking": ("--runs", "5", "--set", "map.runs=0"),
    "optimize": ("--set", "effort=1", "--set", "pseudolites=[1]"),
    "sweep": ("--set", "vary.1.grid.count=4", "--set", "vary.2.grid.count=4"),
    "replay": ("--set", "tuning=none"),
    "ranges": ("--set", "tuning=none"),
}
"""Settings that make the shipped files quick."""
_SOON = re.compile(r": about [0-3](?:\.\d)? s on |its time is not estimated: navsim can only")
"""What `--dry-run` says of work that takes up to 3 s, by a block that was timed, or is one piece, such as one run."""
_MEMORY = re.compile(r": (?:.* )?about ([0-9.]+) MB of memory")


def computed(commands: Forks, folder: Path, seed: int, count: int) -> Tally:
    """Mutants computed until `count` were: those that say they take long are not, the others end in time with a result
    that can be read."""
    tally = Tally()
    draw = random.Random(seed)
    kinds = {name: yaml_kind(text) for name, text in sources().items()}
    for mutant in mutants.mutants(sources(), seed):
        if tally.count - tally.ended["refused"] >= count:
            break
        (folder / mutants.NAME).write_bytes(mutant.text)
        kind = kinds[mutant.of]
        short = SHORTER[kind] if draw.random() < 0.7 else ()
        words = (KINDS[kind].command if kind in KINDS else "run", mutants.NAME, "-o", "r.h5", "-q", *short)
        what = f"{mutant.of}: {mutant.note}"
        planned = commands.run(*words, "--dry-run", cwd=folder, limit_s=HANG_S)
        tally.took(planned.seconds, planned.peak_mb)
        wrong = planned.failure()
        memory = _MEMORY.search(planned.err)
        if wrong or planned.code != 0:
            tally.add(what, "refused", wrong and f"--dry-run: {wrong}")
            continue
        if memory is None or float(memory[1]) > MOST_MB / 2 or not _SOON.search(planned.err):
            tally.add(what, "too long", None)
            continue
        done = commands.run(*words, "--figures", "none", cwd=folder, limit_s=HANG_S)
        tally.took(done.seconds, done.peak_mb)
        wrong = done.failure()
        if wrong is None and done.code == 0:
            wrong = _unreadable(folder / "r.h5")
        tally.add(what, {0: "computed", 2: "refused", 3: "no result"}.get(done.code, "else"), wrong)
        (folder / "r.h5").unlink(missing_ok=True)
        (folder / "r.csv").unlink(missing_ok=True)
        shutil.rmtree(folder / "r.h5.partial", ignore_errors=True)
    return tally


def yaml_kind(text: bytes) -> str:
    """The kind of a shipped file."""
    found = re.search(rb"^kind: (\S+)", text, re.MULTILINE)
    return found[1].decode() if found else "landing"


def _unreadable(file: Path) -> str | None:
    try:
        read(file)
    except ResultError as error:
        return f"success, and its result cannot be read: {error}"
    return None


def killed(commands: Forks, folder: Path, seed: int, count: int, names: Sequence[str] = ALL) -> Tally:
    """Studies killed at drawn steps (within writing and --fresh too), resumed and compared."""
    tally = Tally()
    draw = random.Random(seed)
    known = Known(commands, folder / "undisturbed")
    for _ in range(count):
        name = draw.choice(names)
        mine, other = known.get(name), known.get(name, "--set", "title=another")
        place = folder / "place"
        if name in studies.RESUMED and draw.random() < 0.4:
            first, second = draw.randint(1, other.steps), draw.randint(1, min(other.steps, 12))
            wrong = studies.adopted(commands, mine, other, place, first, second)
            tally.add(f"{name}: killed at {first}, anew at {second}", "killed twice with a fresh start between", wrong)
        else:
            at = draw.randint(1, mine.steps)
            more = ("--fresh",) if name in studies.RESUMED and draw.random() < 0.3 else ()
            wrong = studies.disturbed(
                commands, mine, known.folder(name, "--set", "title=another"), place, KILL, at, *more
            )
            tally.add(f"{name}: killed at {at} {' '.join(more)}", "killed and resumed", wrong)
    return tally


def filled(commands: Forks, folder: Path, seed: int, count: int, names: Sequence[str] = ALL) -> Tally:
    """Studies under a disk that is full from a step on, each step in turn up to `count` of a study, then drawn."""
    tally = Tally()
    draw = random.Random(seed)
    known = Known(commands, folder / "undisturbed")
    for name in names:
        mine, before = known.get(name), known.folder(name, "--set", "title=another")
        for at in studies.moments(mine.steps, count, draw):
            wrong = studies.disturbed(commands, mine, before, folder / "place", FULL, at)
            tally.add(f"{name}: full from step {at} of {mine.steps}", name, wrong)
    return tally


class Known:
    """Undisturbed studies, each computed once."""

    def __init__(self, commands: Forks, folder: Path) -> None:
        self._commands, self._folder = commands, folder
        self._known: dict[tuple[object, ...], studies.Undisturbed] = {}

    def folder(self, name: str, *more: object) -> Path:
        """Where the result of one lies."""
        self.get(name, *more)
        return self._folder / str(list(self._known).index((name, *more)))

    def get(self, name: str, *more: object) -> studies.Undisturbed:
        key = (name, *more)
        if key not in self._known:
            place = self._folder / str(len(self._known))
            self._known[key] = studies.Undisturbed(self._commands, name, place, *more)
        return self._known[key]


def damaged(commands: Forks, folder: Path, seed: int, count: int) -> Tally:
    """A result with flipped bytes, looked at."""
    tally = Tally()
    (folder / "sound").mkdir(parents=True)
    (folder / "place").mkdir()
    made = commands.run(
        *studies.STUDIES["landing with figures"], "--figures", "none", "-o", "r.h5", cwd=folder / "sound"
    )
    if made.code != 0:
        raise RuntimeError(made.err)
    looked = flips.flipped(commands, folder / "sound" / "r.h5", folder / "place", seed)
    for what, wrong, refused in islice(looked, count):
        tally.add(what, "refused" if refused else "the same as of the sound file", wrong)
    return tally
