"""Pages of measured results: the commit and the seeds that each was made with, and a probe that guards it.

A probe is a brief run of some cases of the page, stored in the page as an HTML comment. Code that computes other
numbers than the page's code changes the probe; tests/consistency/test_measured_pages.py computes every probe again.
"""

from __future__ import annotations

import functools
import hashlib
import json
import subprocess
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import navsim
from navsim.filter import states
from navsim.landing.study import Case, covariance_analysis, fly_all
from navsim.runner.executor import threads

ROOT = Path(__file__).resolve().parent.parent
STORE = ROOT / "results" / "measured"
SEED = 1
"""The seed of the documented commands: readers can repeat each row."""
CODE = ("navsim", "scenarios", "scripts")
"""Folders whose content decides a page's numbers."""
NOT_TO_QUOTE = """\
Don't quote these levels: noise is white, `p_constellation` is 1e-8 and, where not stated, `effective_samples` 1:
too low ([what to quote](how-to/accuracy.md#4-quote))."""
"""The second paragraph of pages with levels."""
OPEN, CLOSE = "<!-- probe: ", " -->"
PROBE_RUNS = 8
TOLERANCE = 1e-6
"""Largest relative difference of a probe that counts as rounding. Kernels compiled for a generic x86-64 processor, and
numpy without its vector code, change no probe by more than 4.4e-9."""

Probe = Mapping[str, Sequence[float]]


def commit() -> str:
    """Abbreviated hash and date of the last commit of the code; exit 1 without one, or where files differ from it."""
    try:
        changed = _git("status", "--porcelain", "--", *CODE)
        last = _git("log", "-1", "--abbrev=10", "--format=`%h` (%cs)", "--", *CODE)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"a measured page names the commit of its code, and git tells none ({error}): run in a git checkout")
    if changed or not last:
        sys.exit(f"a measured page names the commit of its code; commit first:\n{changed}")
    return last


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.rstrip()


@functools.cache
def _code() -> str:
    """Name of the code and scenarios that decide the numbers of a run."""
    digest = hashlib.sha256()
    for folder in ("navsim", "scenarios"):
        for path in sorted(p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts):
            digest.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def kept(key: object, compute: Callable[[], Any]) -> Any:
    """What `compute` returned for this key with this code, as JSON has it; computed and stored the first time."""
    path = STORE / _code() / f"{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.json"
    if not path.exists():
        text = json.dumps(compute())
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    return json.loads(path.read_text(encoding="utf-8"))


def set_keys(settings: Sequence[str]) -> dict[str, Any]:
    """Keys and values of `--set KEY=VALUE`."""
    return {key: yaml.safe_load(value) for key, _, value in (text.partition("=") for text in settings)}


def summary(*settings: str, scenario: str = "landing", runs: int | None = 100, seed: int = SEED) -> Any:
    """The summary of `navsim run scenarios/SCENARIO.yaml --runs RUNS --set ...`; without runs of the covariance
    analysis."""
    how = {"method": "covariance"} if runs is None else {"runs": runs, "keep": "none"}

    def compute() -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", navsim.NavsimWarning)  # of faults that the page is about
            made = navsim.run(ROOT / "scenarios" / f"{scenario}.yaml", set=set_keys(settings), seed=seed, **how)
        return made.summary["summary"]

    if runs is not None and runs <= PROBE_RUNS:
        return compute()  # also for probes, which must not read what is stored
    return kept(("summary", scenario, settings, runs, seed), compute)


def command(*settings: str, scenario: str = "landing", runs: int = 100) -> str:
    """The same as a line of a page."""
    return " ".join(
        [f"    navsim run scenarios/{scenario}.yaml --runs {runs}", *(f"--set '{text}'" for text in settings)]
    )


def count(value: int) -> str:
    """A whole number, its digits in groups of three."""
    return f"{value:,}".replace(",", " ") if value >= 10_000 else f"{value}"


def share(values: Sequence[float], digits: int = 3) -> str:
    """A share with its 95 % interval."""
    value, low, high = values
    return f"{value:.{digits}g} [{low:.3g}, {high:.3g}]"


def size(values: Sequence[float]) -> str:
    """An RMS with its 95 % interval, to three digits of the RMS."""
    value, low, high = values
    places = max(0, 2 - int(np.floor(np.log10(value))))
    return f"{value:.{places}f} [{low:.{places}f}, {high:.{places}f}]"


def horizontal(made: Any) -> str:
    """Horizontal RMS of the filter, of a summary."""
    return size(made["rms"]["horizontal"])


def levels(made: Any, names: Sequence[str] = ("hpl", "vpl"), between: str = ", ") -> str:
    """Mean levels on the glide, m."""
    return between.join(f"{made['integrity'][name][0]:.1f}" for name in names)


def available(made: Any) -> str:
    """Share of epochs available."""
    return f"{made['integrity']['availability'][0]:.4g}"


@dataclass(frozen=True)
class Page:
    """A page of docs/, the script of scripts/ that writes it, its seeds, and its probe."""

    name: str
    script: str
    seeds: Sequence[int]
    probe: Callable[[], Probe]

    @property
    def path(self) -> Path:
        return ROOT / "docs" / self.name

    @property
    def command(self) -> str:
        return f"python scripts/{self.script}.py"

    def write(self, lines: Sequence[str], begun: str) -> None:
        """Write the page with its closing line and its probe; `begun` is `commit()` from before the first run."""
        if (ended := commit()) != begun:
            sys.exit(f"the code changed from commit {begun} to {ended} during the runs: start `{self.command}` again")
        seeds = f"seed {self.seeds[0]}" if len(self.seeds) == 1 else f"seeds {', '.join(map(str, self.seeds))}"
        values = [f"    {json.dumps(label, ensure_ascii=False)}: {_digits(row)}" for label, row in self.probe().items()]
        closing = f"Made by `{self.command}`, commit {begun}, {seeds}."
        comment = f"{OPEN}{{\n" + ",\n".join(values) + f"\n}}{CLOSE}"
        self.path.write_text("\n".join([*lines, "", closing, "", comment, ""]), encoding="utf-8")

    def stored(self) -> Probe | None:
        """The probe in the page; None where the page has none."""
        _, found, rest = self.path.read_text(encoding="utf-8").partition(OPEN)
        return json.loads(rest.partition(CLOSE)[0]) if found else None


def _digits(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.9g}' for value in values)}]"


def differences(stored: Probe, computed: Probe) -> list[str]:
    """What differs between two probes by more than `TOLERANCE`, one line each."""
    out = [f"{label}: only in one of the two" for label in sorted(stored.keys() ^ computed.keys())]
    for label in stored.keys() & computed.keys():
        pair = stored[label], computed[label]
        if len(pair[0]) != len(pair[1]) or not np.allclose(*pair, rtol=TOLERANCE, atol=0.0):
            out.append(f"{label}: {_digits(pair[0])} in the page, {_digits(pair[1])} now")
    return out


def flown(case: Case, seed: int, runs: int = PROBE_RUNS) -> list[float]:
    """Mean NEES, RMS position error (m) and RMS heading error (deg) of a few runs, half-way and at the end."""
    ensemble = fly_all(case, seed, 0, runs, threads(), keep="errors")
    out = []
    for at in _moments(case):
        error = ensemble["error"][:, at]
        position = np.sqrt(np.mean(np.sum(error[:, states.SLICES["position"]] ** 2, axis=1)))
        heading = np.degrees(np.sqrt(np.mean(error[:, states.PHI_D] ** 2)))
        out += [float(ensemble["nees"][:, at].mean()), float(position), float(heading)]
    return out


def analysed(case: Case) -> list[float]:
    """Position error (m) and heading error (deg), 1 sigma, of the covariance analysis, half-way and at the end."""
    analysis = covariance_analysis(case)
    square = np.diagonal(analysis.covariance, axis1=1, axis2=2) + analysis.mean**2
    out = []
    for at in _moments(case):
        position = np.sqrt(square[at, states.SLICES["position"]].sum())
        out += [float(position), float(np.degrees(np.sqrt(square[at, states.PHI_D])))]
    return out


def _moments(case: Case) -> tuple[int, int]:
    """Indices of the filter's output half-way and at the end."""
    last = case.shared.filter_time.size - 1
    return last // 2, last


def row(*cells: object) -> str:
    """One line of a table, also printed for progress."""
    line = f"| {' | '.join(map(str, cells))} |"
    print(line, file=sys.stderr, flush=True)
    return line
