"""All filter kinds side by side: NEES and the verdict on every state, case by case; writes docs/filter-consistency.md.

Run by `make validate`, some minutes on two cores.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import measured
import numpy as np
from scipy.stats import chi2

from navsim.core.states import A_D, display_name
from navsim.estimation.estimate import FILTER_KINDS
from navsim.scenario.filter import FilterSection
from navsim.scenario.load import read
from navsim.study.consistency import Ratios
from navsim.study.executor import threads
from navsim.study.landing import fly_all, prepare
from navsim.study.landing.consistency import evaluate_states, ratios_of_runs, shares_beyond
from navsim.study.statistics import consistency_band

ROOT = Path(__file__).resolve().parent.parent
RUNS = 500
SEED = 31
SEEDS = (SEED, 32, 33)
"""Of no runs that anything was chosen by; the tails are judged by all of them."""
UNTIL = ("A, nose follows the path", "C, nose follows the path")
"""Cases in which the smoother is also given no more than a filter has."""
DEFAULT = FilterSection().kind
JUDGED = 1000
"""Runs of the default by which its tails are judged, of each seed."""
TIMES = tuple(float(t) for t in range(10, 121, 10))
A = ("receiver.rate_hz=1", "filter.velocity=false")
B = ("receiver.rate_hz=1", "filter.velocity=true")
C = ("receiver.rate_hz=10", "filter.velocity=false")
LEVEL = "approach.pitch=level"
GENTLE = ("initial_errors.attitude_deg=1", "imu.gyro.drift_deg_h=70")
CASES: list[tuple[str, str, tuple[str, ...]]] = [
    ("A, pitch held", "landing_gnss_only", (*A, LEVEL)),
    ("B, pitch held", "landing_gnss_only", (*B, LEVEL)),
    ("C, pitch held", "landing_gnss_only", (*C, LEVEL)),
    ("A, nose follows the path", "landing_gnss_only", A),
    ("B, nose follows the path", "landing_gnss_only", B),
    ("C, nose follows the path", "landing_gnss_only", C),
    ("landing.yaml", "landing", ()),
    ("landing_smooth.yaml", "landing_smooth", ()),
    ("landing_gnss_only.yaml", "landing_gnss_only", ()),
    ("S-turn at 6 °/s, A", "s_turn", A),
    ("A, pitch held, 1400 °/h", "landing_gnss_only", (*A, LEVEL, "imu.gyro.drift_deg_h=1400")),
    ("A, pitch held, 10°", "landing_gnss_only", (*A, LEVEL, "initial_errors.attitude_deg=10")),
    ("A, pitch held, 1° and 70 °/h", "landing_gnss_only", (*A, LEVEL, *GENTLE)),
]  # fmt: skip
FEWER = ("landing.yaml, 11 components", "landing", ("filter.gaussian_sum.components=11",))
"""What fewer components cost, for the tails alone."""


def nees(name: str, settings: Sequence[str], times: Sequence[float] = TIMES) -> tuple[np.ndarray, np.ndarray, str]:
    """Mean NEES/15 and NEES/6 of a scenario at some times, and its largest z at any output."""
    case = prepare(*read(ROOT / "scenarios" / f"{name}.yaml", settings))
    ensemble = fly_all(case, SEED, 0, RUNS, threads(), keep="errors")
    at = [int(np.argmin(np.abs(case.world.filter_time - t))) for t in times]
    full, part = ensemble["nees"].mean(axis=0)[at] / 15, ensemble["nees_position_velocity"].mean(axis=0)[at] / 6
    return full, part, largest_z(ratios_of_runs(case, ensemble))


def largest_z(ratios: Ratios) -> str:
    """The largest z with its state and time."""
    output, state = np.unravel_index(np.nanargmax(ratios.z), ratios.z.shape)
    return f"{ratios.z[output, state]:.2f}, {display_name(ratios.names[state])}, {ratios.time[output]:g} s"


def pooled(parts: Sequence[Ratios]) -> Ratios:
    """The ratios of parts of one ensemble with as many runs each."""
    z = np.sqrt(np.mean([part.z**2 for part in parts], axis=0))
    correlation = np.mean([part.correlation for part in parts], axis=0)
    return replace(parts[0], z=z, runs=sum(part.runs for part in parts), correlation=correlation)


def tails(label: str, name: str, settings: Sequence[str]) -> tuple[str, list[str]]:
    """One line of the table of the default, and of each seed one of the table of its states."""
    case = prepare(*read(ROOT / "scenarios" / f"{name}.yaml", (*settings, f"filter.kind={DEFAULT}")))
    at = [int(np.argmin(np.abs(case.world.filter_time - t))) for t in TIMES]
    limits = [chi2.isf(p, 15) for p in (0.05, 0.001)]
    full, part, beyond, heading = [], [], [], []
    ratios: dict[int, list[Ratios]] = {seed: [] for seed in SEEDS}
    shares: dict[int, list[np.ndarray]] = {seed: [] for seed in SEEDS}
    for seed, first in itertools.product(SEEDS, range(0, JUDGED, RUNS)):
        ensemble = fly_all(case, seed, first, RUNS, threads(), keep="errors")
        full.append(ensemble["nees"][:, at] / 15)
        part.append(ensemble["nees_position_velocity"][:, at] / 6)
        beyond.append([(ensemble["nees"][:, at] > limit).mean() for limit in limits])
        ratios[seed].append(ratios_of_runs(case, ensemble))
        shares[seed].append(shares_beyond(ensemble))
        heading.append(np.abs(ensemble["error"][..., A_D] / ensemble["sigma"][..., A_D]).max(axis=1))
    every, motion, largest = np.concatenate(full), np.concatenate(part).mean(axis=0), np.concatenate(heading)
    of_seeds = (np.split(every.max(axis=1), len(SEEDS)), np.split(largest, len(SEEDS)))
    worst, furthest = ([one.max() for one in each] for each in of_seeds)
    mean, share = every.mean(axis=0), np.mean(beyond, axis=0)
    states = []
    for seed in SEEDS:
        whole = pooled(ratios[seed])
        verdict = evaluate_states(case, whole)[1]
        assert verdict.at is not None
        of_worst = np.mean(shares[seed], axis=0)[:, verdict.at[0], verdict.at[1]]
        cells = (largest_z(whole), f"{100 * of_worst[0]:.1f} %", f"{100 * of_worst[1]:.2f} %", verdict.words)
        states.append(measured.row(label, seed, *cells))
    line = measured.row(
        label, f"{mean.min():.2f} - {mean.max():.2f}", f"{motion.min():.2f} - {motion.max():.2f}",
        f"{100 * share[0]:.1f} %", f"{100 * share[1]:.2f} %", f"{np.median(every.max(axis=1)):.1f}",
        ", ".join(f"{x:.0f}" for x in worst), ", ".join(f"{x:.1f}" for x in furthest), int((largest > 6.0).sum()),
    )  # fmt: skip
    return line, states


def row(label: str, kind: str, full: np.ndarray, part: np.ndarray, worst: str) -> str:
    """One line of the table."""
    cells = [f"{full[i]:.2f} ({part[i]:.2f})" for i in (1, 3, 7, 11)]
    return measured.row(label, kind, *cells, f"{full.max():.2f} ({part.max():.2f})", worst)


PROBED = ("A, nose follows the path", "B, pitch held", "landing_smooth.yaml", "S-turn at 6 °/s, A")


def probe() -> measured.Probe:
    """Every kind in the first of some cases, the default in all of them."""
    cases = {label: (name, settings) for label, name, settings in CASES}
    pairs = [(PROBED[0], kind) for kind in FILTER_KINDS] + [(label, DEFAULT) for label in PROBED[1:]]
    out = {}
    for label, kind in pairs:
        name, settings = cases[label]
        case = prepare(*read(ROOT / "scenarios" / f"{name}.yaml", (*settings, f"filter.kind={kind}")))
        out[f"{label}, {kind}"] = measured.flown(case, SEED)
    return out


PAGE = measured.Page("filter-consistency.md", "filter_consistency", SEEDS, probe)


def main() -> None:
    """Fly every case with every kind and write the table."""
    begun = measured.commit()
    low, high = consistency_band(15, RUNS)
    lines = [
        "# Consistency of the filter kinds, measured",
        "",
        f"Made by `make validate`: {RUNS} runs of seed {SEED} a cell, every kind with the exact reset. NEES/15 in the",
        "filter's own coordinates and, in brackets, NEES/6 of position and velocity in plain ones: the mean over the",
        "ensemble at 20, 40, 80 and 120 s, and the largest of 10, 20, ... 120 s. One is right; the 95 % band of a",
        f"single NEES/15 is {low:.3f} to {high:.3f}. Last column: the largest z (RMS of error / sigma) of any state at",
        "any output, with its state and time.",
        "",
        "A: position fixes at 1 Hz. B: position and velocity at 1 Hz. C: position at 10 Hz. Errors are the paper's",
        "(5°, 10 m, 1 m/s; 700 °/h, 1e-3 g) unless the case names others. [The filter](filter.md) discusses the table.",
        "The kind `map` is the batch smoother, every output from all fixes of the flight. The kind `map at T` has the",
        "fixes up to that time alone, the most a filter could know then.",
        "",
        "| case | kind | 20 s | 40 s | 80 s | 120 s | largest | worst state |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for label, name, settings in CASES:
        for kind in FILTER_KINDS:
            lines.append(row(label, kind, *nees(name, (*settings, f"filter.kind={kind}"))))
        if label in UNTIL:
            ends = [nees(name, (*settings, "filter.kind=map", f"duration_s={t:g}"), [t]) for t in TIMES]
            full, part = (np.concatenate([e[k] for e in ends]) for k in range(2))
            lines.append(row(label, "map at T", full, part, "-"))
    lines += [
        "",
        f"## `{DEFAULT}`: the tails",
        "",
        f"{JUDGED} runs of each of the seeds {', '.join(map(str, SEEDS))} a case, at 10, 20, ... 120 s.",
        "",
        "| column | what |",
        "|---|---|",
        "| NEES/15, NEES/6 | least and largest mean |",
        "| 5 %, 0.1 % | share of NEES beyond the limit that a true filter exceeds so often |",
        "| median, worst | largest NEES/15 of a run: its median, and the worst of each seed |",
        "| heading | largest heading error of any run at any time, in its sigma, of each seed |",
        "| beyond 6 | number of runs of all seeds with one beyond 6 |",
        "",
        "| case | NEES/15 | NEES/6 | 5 % | 0.1 % | median | worst | heading | beyond 6 |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    of_states: list[str] = []
    for label, name, settings in (*CASES, FEWER):
        line, states = tails(label, name, settings)
        lines.append(line)
        of_states += states
    lines += [
        "",
        f"## `{DEFAULT}`: every state",
        "",
        f"The same {JUDGED} runs of each seed: the largest z of any state at any output; the share of runs beyond 1.96",
        "and 3.29 sigma there (5 % and 0.1 % are right); the verdict, whose band is for all states and outputs",
        "together ([how to read it](filter.md#how-to-read-the-verdict)).",
        "",
        "| case | seed | largest z | 5 % | 0.1 % | verdict |",
        "|---|---|---|---|---|---|",
        *of_states,
    ]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
