"""The trials at length: ten seeds of each, some hours on two cores; writes docs/reliability.md.

What is finished is kept in results/torture/, so after a kill the same command goes on. Seeds are drawn anew unless
`--seed` gives the first of them.
"""

from __future__ import annotations

import argparse
import datetime
import json
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import navsim
from navsim.results.atomic_write import write_atomically
from tests.conftest import ROOT
from tests.forks import Forks
from tests.torture import trials
from tests.torture.trials import Tally

SEEDS = 10
KEPT = ROOT / "results" / "torture"
PAGE = ROOT / "docs" / "reliability.md"
Trial = Callable[[Forks, Path, int, int], Tally]


def _in_scenarios(trial: Trial) -> Trial:
    return lambda commands, folder, seed, count: trial(commands, trials.scenario_folder(folder / "at"), seed, count)


PARTS: dict[str, tuple[Trial, int, str]] = {
    "mutants": (_in_scenarios(trials.mutated), 2000, "mutated scenarios and studies, read and checked (`validate`)"),
    "computed": (
        _in_scenarios(trials.computed),
        60,
        "mutants computed if the dry run accepts them and predicts a short time",
    ),
    "killed": (trials.killed, 20, "studies killed at a file operation, resumed, compared bit by bit"),
    "full": (trials.filled, 1, "studies whose disk becomes full, resumed, compared bit by bit"),
    "damaged": (trials.damaged, 500, "results with damaged bytes, shown and exported"),
}
"""What is done: how, how often a seed, in words."""


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m tests.torture", description=__doc__)
    options.add_argument("--seed", type=int, help="the first of the seeds; default: drawn")
    options.add_argument("--seeds", type=int, default=SEEDS, help=f"how many; default {SEEDS}")
    options.add_argument("--part", choices=PARTS, help="one part only")
    chosen = options.parse_args()
    KEPT.mkdir(parents=True, exist_ok=True)
    plan = KEPT / "seeds.json"
    if chosen.seed is not None or not plan.exists():
        first = chosen.seed if chosen.seed is not None else random.SystemRandom().randrange(10**6, 10**9)
        write_atomically(plan, json.dumps(list(range(first, first + chosen.seeds))).encode())
    seeds = json.loads(plan.read_text())
    for part, (trial, count, _) in PARTS.items():
        if chosen.part in (None, part):
            for seed in seeds:
                _once(part, trial, seed, count)
    page(seeds)
    found = [wrong for part in PARTS for seed in seeds for wrong in _kept(part, seed).wrong]
    sys.exit(bool(found))


def _once(part: str, trial: Trial, seed: int, count: int) -> None:
    file = KEPT / f"{part}-{seed}.json"
    if file.exists():
        return
    began, commit = time.monotonic(), _commit()
    with tempfile.TemporaryDirectory() as place, Forks(Path(place), trials.warming()) as commands:
        tally = trial(commands, Path(place) / "work", seed, count)
    kept = {
        "commit": commit,
        "ended": tally.ended,
        "wrong": tally.wrong,
        "slowest_s": tally.slowest_s,
        "peak_mb": tally.peak_mb,
    }
    write_atomically(file, json.dumps(kept | {"took_s": time.monotonic() - began}, indent=1).encode())
    print(f"{part} {seed}: {dict(tally.ended)}, {time.monotonic() - began:.0f} s", flush=True)
    for what, wrong in tally.wrong:
        print(f"    {what}: {wrong}", flush=True)


def _commit() -> str:
    """What was tried: the commit, with a + where the package differs from it."""
    head, changed = (
        subprocess.run(("git", *words), cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
        for words in (("rev-parse", "--short=10", "HEAD"), ("status", "--porcelain", "--", "navsim"))
    )
    return head + "+" * bool(changed)


def _kept(part: str, seed: int) -> Tally:
    file = KEPT / f"{part}-{seed}.json"
    if not file.exists():
        return Tally()
    found = json.loads(file.read_text())
    return Tally(Counter(found["ended"]), list(map(tuple, found["wrong"])), found["slowest_s"], found["peak_mb"])


def page(seeds: list[int]) -> None:
    """Write the figures of what is kept."""
    files = [file for part in PARTS for seed in seeds if (file := KEPT / f"{part}-{seed}.json").exists()]
    commits = dict.fromkeys(json.loads(file.read_text())["commit"] for file in files)
    lines = [
        "# Robustness of the software",
        "",
        f"Made by `make torture` on {datetime.date.today()} with navsim {navsim.__version__} (commit "
        f"{', '.join(commits)}), seeds {seeds[0]} to {seeds[-1]}; the",
        "tests repeat a small part each time (`tests/torture/`).",
        "",
        "| wrong | |",
        "|---|---|",
        "| end | a traceback; a trial of more than 10 s or 1 GB; a file left behind |",
        "| numbers | they differ from those of the undisturbed study, or belong to another study |",
        "| success | with input that the published schema refuses, or with a result that cannot be read |",
        "",
        "| trial | number | how they ended | slowest | most memory | wrong |",
        "|---|---|---|---|---|---|",
    ]
    wrong: list[str] = []
    for part, (_, _, words) in PARTS.items():
        tallies = [_kept(part, seed) for seed in seeds]
        ended = sum((tally.ended for tally in tallies), Counter[str]())
        slowest, peak = max(t.slowest_s for t in tallies), max(t.peak_mb for t in tallies)
        found = [item for tally in tallies for item in tally.wrong]
        wrong += [f"- {words}: {what}: {how}" for what, how in found]
        how = ", ".join(f"{count} {name}" for name, count in ended.most_common())
        limits = f"{slowest:.1f} s | {peak:.0f} MB" if slowest else "|"
        lines.append(f"| {words} | {ended.total()} | {how} | {limits} | {len(found)} |")
    PAGE.write_text("\n".join([*lines, "", *(["What was wrong:", "", *wrong, ""] if wrong else [])]), encoding="utf-8")


if __name__ == "__main__":
    main()
