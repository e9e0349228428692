"""Consistency of the default filter and of published filters, state by state; writes docs/filter-consistency.md.

    python scripts/filter_consistency.py                                                    the page, hours
    python scripts/filter_consistency.py --runs 20 --cases landing --kinds eskf tfg         two rows, a minute

The page is written when all cases and kinds are asked for, or with --page from what is finished; its other rows are
those of docs/filter-consistency.csv, if the page's probe still holds. Finished pieces stay in
results/filter-consistency/, by the content of the code: a second start computes only what is missing.
"""

from __future__ import annotations

import argparse
import ast
import csv
import hashlib
import os
import re
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import matplotlib as mpl
import measured
import numpy as np
from scipy.stats import chi2

from navsim.filter.states import GYRO, N_BASE, NAMES, PHI_D, SLICES, display_name
from navsim.landing.study import Case, fly_all, prepare
from navsim.runner.executor import threads
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
SCENARIOS = ROOT / "scenarios"
STORE = ROOT / "results" / "filter-consistency"
IMAGE = "images/filter_consistency.png"
TABLE = ROOT / "docs" / "filter-consistency.csv"
RUNS = 2000
"""Runs of each seed for the full page."""
SEEDS = (4931, 4932, 4933)
"""Of no run that anything was chosen by."""
PIECE = 100
"""Runs that are stored together."""
CORNER = 59.0
"""Just before the paper's corner, s."""
TENTH = 10.0
LOW, HIGH = 0.93, 1.07
"""What z of a consistent filter is asked to be within."""
SHARE = 0.2
"""Largest share, %, beyond the 99.9 % limit of NEES that is asked for."""
NOMINAL = 0.1
"""That share, %, of a consistent filter."""
FAR = 6.0
"""Heading error, in its sigma, that a run should never have."""
LARGEST_Z, LARGEST_NEES, LARGEST_SHARE = 1.2, 1.15, 0.5
"""Largest z of any state, NEES/n, and share beyond its 99.9 % limit, %, with which sigma counts as acceptable.
Of 300 runs of a consistent filter the largest of all z is about 1.12."""

OFF = "filter.steady_force=false"
DEFAULT = "gaussian-sum"
KINDS: dict[str, tuple[str, tuple[str, ...]]] = {
    DEFAULT: ("navsim's default", ()),
    "eskf": ("error-state, exact reset", ("filter.kind=eskf", OFF)),
    "left-invariant": ("invariant filter on SE₂(3)", ("filter.kind=left-invariant", OFF)),
    "tfg": ("equivariant filter on the two-frames group", ("filter.kind=tfg", OFF)),
    "first-estimates": ("first-estimates Jacobians (FEJ)", ("filter.kind=first-estimates",)),
    "observability-constrained": ("OC-EKF", ("filter.kind=observability-constrained",)),
    "eskf, steady force": ("`eskf` with navsim's rule for steady flight", ("filter.kind=eskf",)),
    "tfg, steady force": ("`tfg` with this rule: the default of `replay`", ("filter.kind=tfg",)),
}
SMOOTHERS: dict[str, tuple[str, tuple[str, ...]]] = {
    kind: ("smoother: each output from all fixes of the flight", (f"filter.kind={kind}",)) for kind in ("rts", "map")
}
PUBLISHED = ("eskf", "left-invariant", "tfg", "first-estimates", "observability-constrained")
MAIN = ("landing", "landing_smooth", "landing_gnss_only", "landing_open_sky", "s_turn", "circuit", "track")
OTHERS = (
    "odense", "beacons_uav", "beacons_pad", "landing_ils", "table2", "table2_almanac", "table2_row1", "table2_weighted",
)  # fmt: skip
STRAIGHT = ("landing", "landing_gnss_only", "landing_open_sky", *OTHERS[4:])
"""Scenarios that fly straight until `CORNER`."""
NOISES = (0.1, 3.0)
TOO_NOISY = ("odense, noise × 3",)
"""Noise that would hide the bias instability of its sensor: such a sheet is refused."""
NOISY_LANDINGS = ("landing, noise × 0.1", "landing", "landing, noise × 3")
SMALL = "1°, 70 °/h"
VARIANTS: dict[str, tuple[str, ...]] = {
    "fixes at 1 Hz": ("receiver.rate_hz=1",),
    "lever arm": ("receiver.lever_arm_m=[2,0.5,-1]",),
    "latency 0.3 s": ("receiver.latency_s=0.3",),
    "tight": ("filter.coupling=tight",),
    "1400 °/h": ("imu.gyro.drift_deg_h=1400",),
    "10°": ("initial_errors.attitude_deg=10",),
    SMALL: ("initial_errors.attitude_deg=1", "imu.gyro.drift_deg_h=70"),
    "known start": ("initial_errors.position_m=0.01", "initial_errors.velocity_m_s=0.01"),
    **{f"gusts of {a:g} m/s²": (f"wind.turbulence.w20_m_s={20.0 * a:g}",) for a in (0.01, 0.02, 0.03)},
}
"""Gusts: RMS of the lateral acceleration over 1 s."""
A = ("receiver.rate_hz=1", "filter.velocity=false")
B = ("receiver.rate_hz=1",)
C = ("filter.velocity=false",)
LEVEL = "approach.pitch=level"
FIXES: dict[str, tuple[str, tuple[str, ...]]] = {
    "A, nose follows the path": ("landing_gnss_only", A),
    "A, pitch held": ("landing_gnss_only", (*A, LEVEL)),
    "B, nose follows the path": ("landing_gnss_only", B),
    "C, nose follows the path": ("landing_gnss_only", C),
}


@dataclass(frozen=True)
class Study:
    """A case: label, scenario, settings, and whether smoothers fly it too."""

    label: str
    name: str
    settings: tuple[str, ...]
    smoothed: bool = False

    @property
    def kinds(self) -> dict[str, tuple[str, tuple[str, ...]]]:
        """The kinds that fly it."""
        return {**KINDS, **SMOOTHERS} if self.smoothed else KINDS


def noisier(name: str, factor: float) -> tuple[str, ...]:
    """The settings that multiply the accelerometers' noise of a scenario; one without `imu` has the paper's."""
    scenario, document = read(SCENARIOS / f"{name}.yaml", ())
    accelerometer = scenario.imu.accelerometer
    key = "noise_mg" if accelerometer.noise_mg is not None else "vrw_m_s_sqrt_h"
    preset = () if "imu" in document.data else ("imu.preset=paper",)
    return (*preset, f"imu.accelerometer.{key}={factor * getattr(accelerometer, key):g}")


@cache
def studies() -> dict[str, Study]:
    """All cases by their labels, the most wanted first."""
    plain = {name: Study(name, name, (), smoothed=name in ("landing", "s_turn")) for name in (*MAIN, *OTHERS)}
    noisy = [
        Study(label, name, noisier(name, factor))
        for name in (*MAIN, *OTHERS)
        for factor in NOISES
        if (label := f"{name}, noise × {factor:g}") not in TOO_NOISY
    ]
    of_landing = [
        Study(f"landing, {label}", "landing", settings, smoothed=label == SMALL) for label, settings in VARIANTS.items()
    ]
    fixes = [Study(label, *case, smoothed=label.startswith("A")) for label, case in FIXES.items()]
    first = [plain[name] for name in MAIN]
    every = (*first, *noisy[:2], *of_landing, *noisy[2:], *(plain[name] for name in OTHERS), *fixes)
    return {study.label: study for study in every}


@dataclass(frozen=True)
class Found:
    """Sums over runs. At times (k,): squares and fourth powers (k, 15) of error/sigma; squares (rad2) of heading error,
    sigma, and of the error without any fix; z2 (t,) squares of heading error/sigma at all outputs `clock` (t,). Of each
    run: nees, mean over times by the number of states; beyond, share of times beyond 99.9 %; furthest heading error in
    its sigma."""

    time: np.ndarray
    square: np.ndarray
    fourth: np.ndarray
    heading: np.ndarray
    clock: np.ndarray
    z2: np.ndarray
    nees: np.ndarray
    beyond: np.ndarray
    furthest: np.ndarray

    @property
    def runs(self) -> int:
        return self.nees.size

    @property
    def z(self) -> np.ndarray:
        """RMS of error/sigma (k, 15)."""
        return np.sqrt(self.square / self.runs)

    @property
    def spread(self) -> np.ndarray:
        """1 sigma of the sampling of z (k, 15), from the fourth powers."""
        variance = self.fourth / self.runs - (self.square / self.runs) ** 2
        return np.sqrt(variance / self.runs) / (2.0 * self.z)

    def plus(self, other: Found) -> Found:
        """The sums of more runs."""
        summed = {name: getattr(self, name) + getattr(other, name) for name in ("square", "fourth", "heading", "z2")}
        joined = {
            name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in ("nees", "beyond", "furthest")
        }
        return replace(self, **summed, **joined)


@cache
def ready(label: str, kind: str) -> Case:
    """The case of a study with a kind of filter."""
    study = studies()[label]
    settings = (*study.settings, *study.kinds[kind][1])
    if kind == DEFAULT:
        settings = (*settings, f"filter.kind={DEFAULT}")
    return prepare(*read(SCENARIOS / f"{study.name}.yaml", settings))


def fly(case: Case, seed: int, first: int, runs: int) -> Found:
    """Fly runs and sum what the page needs."""
    clock = case.shared.filter_time
    wanted = sorted({CORNER, *np.arange(TENTH, clock[-1] + 1e-6, TENTH).tolist()})
    at = [int(np.argmin(np.abs(clock - t))) for t in wanted]
    flown = fly_all(case, seed, first, runs, threads(), keep="errors")
    error, sigma = np.asarray(flown["error"]), np.asarray(flown["sigma"])
    heading = error[..., PHI_D] / np.where(sigma[..., PHI_D] > 0.0, sigma[..., PHI_D], np.inf)
    ratio = error[:, at, :N_BASE] / sigma[:, at, :N_BASE]
    # a gyro that measures too much turns the estimate with it; level, its z axis points down
    drawn = error[:, :1, PHI_D] - (clock[at] - clock[0]) * error[:, :1, GYRO + 2]
    nees, count = np.asarray(flown["nees"])[:, at], error.shape[-1]
    return Found(
        clock[at], (ratio**2).sum(axis=0), (ratio**4).sum(axis=0),
        np.array([(x**2).sum(axis=0) for x in (error[:, at, PHI_D], sigma[:, at, PHI_D], drawn)]),
        clock, (heading**2).sum(axis=0), nees.mean(axis=1) / count,
        (nees > chi2.isf(1e-3, count)).mean(axis=1), np.abs(heading).max(axis=1),
    )  # fmt: skip


DECIDING = (
    "compiler",
    "geodesy",
    "statistics",
    "environment",
    "error_propagation",
    "trajectory",
    "gnss",
    "sensors",
    "filter",
    "integrity",
    "simulation",
    "landing",
)
"""Folders of the package that decide the numbers of a run."""


@cache
def code(kind: str) -> str:
    """Name of the code that decides the numbers of a kind: modules without comments and docstrings, and scenarios. What
    only the default runs is left out for the others."""
    digest = hashlib.sha256()
    for folder in DECIDING:
        modules = sorted((ROOT / "navsim" / folder).rglob("*.py"))
        if not modules:
            raise FileNotFoundError(f"navsim/{folder} has no modules; mend DECIDING")
        for path in modules:
            if kind == DEFAULT or path.name not in ("gaussian_sum.py", "mixture.py"):
                digest.update(path.name.encode() + _statements(path).encode())
    for path in sorted(p for p in SCENARIOS.rglob("*") if p.suffix in (".yaml", ".csv")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


@cache
def _statements(path: Path) -> str:
    """What a module does: its syntax tree without strings that stand alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [  # type: ignore[attr-defined]
                part for part in body if not (isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant))
            ]
    return ast.dump(tree)


def stored_at(label: str, kind: str, seed: int, first: int, runs: int) -> Path:
    """The file of a piece."""
    study = studies()[label]
    told = hashlib.sha256(repr((study.name, study.settings, study.kinds[kind][1])).encode()).hexdigest()[:8]
    name = re.sub(r"[^\w.,-]+", "_", f"{label}-{kind}")
    return STORE / code(kind) / f"{name}-{told}-{seed}-{first}-{runs}.npz"


def stored(label: str, kind: str, seed: int, first: int, runs: int) -> Found | None:
    """A finished piece; None where it is not finished."""
    path = stored_at(label, kind, seed, first, runs)
    if not path.exists():
        return None
    with np.load(path) as arrays:
        return Found(**arrays)


def finish(label: str, kind: str, seed: int, first: int, runs: int) -> None:
    """Compute a piece and store it."""
    found = fly(ready(label, kind), seed, first, runs)
    path = stored_at(label, kind, seed, first, runs)
    path.parent.mkdir(parents=True, exist_ok=True)
    # whole or not at all, whenever the process ends
    part = path.with_name(f"{path.stem}.part{os.getpid()}.npz")
    np.savez(part, **vars(found))
    part.replace(path)


Piece = tuple[str, str, int, int, int]
"""Label, kind, seed, first run, number of runs."""


def pieces(labels: Sequence[str], kinds: Sequence[str], seeds: Sequence[int], runs: int) -> Iterator[Piece]:
    """All pieces, the first runs of every case before further ones."""
    for first in range(0, runs, PIECE):
        for label in labels:
            for kind in kinds:
                if kind in studies()[label].kinds:
                    for seed in seeds:
                        yield label, kind, seed, first, min(PIECE, runs - first)


def compute(wanted: Sequence[Piece]) -> None:
    """Compute the pieces that are missing, with a line of progress after each."""
    missing = [piece for piece in wanted if not stored_at(*piece).exists()]
    begun = time.monotonic()
    print(f"{len(wanted)} pieces, {len(wanted) - len(missing)} finished before", file=sys.stderr, flush=True)
    for count, piece in enumerate(missing, 1):
        finish(*piece)
        label, kind, seed, first, runs = piece
        left = (time.monotonic() - begun) / count * (len(missing) - count) / 60.0
        print(
            f"{count}/{len(missing)}: {label}, {kind}, seed {seed}, runs {first} to {first + runs - 1}; "
            f"about {left:.0f} min left",
            file=sys.stderr, flush=True,
        )  # fmt: skip


def together(found: Sequence[Piece]) -> Found | None:
    """The sums of several pieces; None of none."""
    out: Found | None = None
    for piece in found:
        if (one := stored(*piece)) is not None:
            out = one if out is None else out.plus(one)
    return out


def finished(label: str, kind: str, most: int = RUNS) -> Found | None:
    """All whole pieces of a row that are finished with every seed of the page, of the first runs of each seed."""
    rows: list[Piece] = []
    for first in range(0, most, PIECE):
        each = [(label, kind, seed, first, PIECE) for seed in SEEDS]
        if not all(stored_at(*piece).exists() for piece in each):
            break
        rows += each
    return together(rows)


@dataclass(frozen=True)
class Row:
    """What a case and a kind came to: a row of the CSV. `_sampling` is 1 sigma of the chance of finitely many runs.

    least_z, largest_z: of any state at any of the times. heading_*: at `CORNER`; no_fixes_deg: RMS error there without
    fixes. nees: by the number of states. beyond: share of NEES beyond its 99.9 % limit, %. far: runs with a heading
    error beyond `FAR` sigma; furthest: the largest, in its sigma. motion_*: the z of position or velocity that is
    furthest from 1.
    """

    case: str
    kind: str
    runs: int
    least_z: float
    least_z_sampling: float
    least_z_at: str
    largest_z: float
    largest_z_sampling: float
    largest_z_at: str
    heading_z: float
    heading_z_sampling: float
    heading_rms_deg: float
    heading_sigma_deg: float
    no_fixes_deg: float
    nees: float
    nees_sampling: float
    beyond: float
    beyond_sampling: float
    far: int
    furthest: float
    motion_z: float
    motion_z_sampling: float
    motion_z_at: str
    commit: str

    @classmethod
    def of(cls, case: str, kind: str, found: Found, commit: str = "") -> Row:
        """The row of these sums."""
        z, spread = found.z, found.spread

        motion = np.zeros(N_BASE, dtype=bool)
        motion[SLICES["position"]] = motion[SLICES["velocity"]] = True
        of_motion = np.where(motion, np.abs(z - 1.0), 0.0)
        extremes: list[list[float | str]] = []
        for k, state in (np.unravel_index(flat, z.shape) for flat in (z.argmin(), z.argmax(), of_motion.argmax())):
            extremes.append([z[k, state], spread[k, state], f"{display_name(NAMES[state])} {found.time[k]:.0f} s"])
        corner = int(np.argmin(np.abs(found.time - CORNER)))
        degrees = np.degrees(np.sqrt(found.heading[:, corner] / found.runs))
        if studies()[case].name not in STRAIGHT:
            degrees[2] = np.nan
        numbers = (
            *extremes[0], *extremes[1], z[corner, PHI_D], spread[corner, PHI_D], *degrees, *_mean(found.nees),
            *_mean(100.0 * found.beyond), int((found.furthest > FAR).sum()), found.furthest.max(),
            *extremes[2],
        )  # fmt: skip
        return cls.read([case, kind, str(found.runs), *map(_digits, numbers), commit])

    @classmethod
    def read(cls, cells: Sequence[str]) -> Row:
        """The row of these cells of the CSV."""
        kinds = [{"str": str, "int": int, "float": float}[str(field.type)] for field in fields(cls)]
        return cls(*(kind(cell) for kind, cell in zip(kinds, cells, strict=True)))

    def cells(self) -> list[str]:
        """Its cells in the CSV."""
        return [_digits(getattr(self, field.name)) for field in fields(self)]

    @property
    def study(self) -> Study:
        return studies()[self.case]

    @property
    def departure(self) -> float:
        """How far z of any state is from one."""
        return max(self.largest_z - 1.0, 1.0 - self.least_z)

    @property
    def departure_told(self) -> str:
        """`departure` with the sampling of its z."""
        is_least = 1.0 - self.least_z > self.largest_z - 1.0
        return f"{self.departure:.2f} ± {self.least_z_sampling if is_least else self.largest_z_sampling:.2f}"

    @property
    def is_large_enough(self) -> bool:
        """Whether sigma is acceptable: for each state, on average, and for large errors."""
        return self.largest_z <= LARGEST_Z and self.nees <= LARGEST_NEES and self.beyond <= LARGEST_SHARE

    def outside(self, errors: float = 3.0, motion: bool = False) -> list[str]:
        """Extreme z, of all states or of position and velocity, outside of what is asked for by more than so many
        sigma of the sampling."""
        return [f"{at} {z:.2f} ± {sampling:.2f}" for z, sampling, at in self.extremes_outside(errors, motion)]

    def extremes_outside(self, errors: float, motion: bool = False) -> list[tuple[float, float, str]]:
        """Those z, each with its sampling and its state and time."""
        each = [
            (self.largest_z, self.largest_z_sampling, self.largest_z_at),
            (self.least_z, self.least_z_sampling, self.least_z_at),
        ]
        return [
            (z, sampling, at)
            for z, sampling, at in ([(self.motion_z, self.motion_z_sampling, self.motion_z_at)] if motion else each)
            if not LOW - errors * sampling <= z <= HIGH + errors * sampling
        ]


def most_runs(rows: Sequence[Row], least: bool = False) -> list[Row]:
    """The row with the most runs of each case and kind, or with the least: all kinds of a case have these runs."""
    best: dict[tuple[str, str], Row] = {}
    for row in rows:
        other = best.setdefault((row.case, row.kind), row)
        if (row.runs < other.runs) if least else (row.runs > other.runs):
            best[row.case, row.kind] = row
    return list(best.values())


Value = TypeVar("Value", int, str)


def span(values: Sequence[Value]) -> str:
    """The smallest and the largest of values, or the only one."""
    return " to ".join(dict.fromkeys(map(str, (min(values), max(values)))))


def _mean(of_runs: np.ndarray) -> tuple[float, float]:
    """Mean over runs and its sampling."""
    return float(of_runs.mean()), float(of_runs.std() / np.sqrt(of_runs.size))


def _digits(value: float | str) -> str:
    """A cell of the CSV."""
    return value if isinstance(value, str) else f"{value:.4g}"


HEAD = ("| case | kind | runs | least z | largest z | NEES/n | > 99.9 %, % |", f"|{'---|' * 7}")


def table(rows: Sequence[Row]) -> list[str]:
    """The table of some rows."""
    return [
        *HEAD,
        *(
            measured.row(
                row.case, f"`{row.kind}`", row.runs, f"{row.least_z:.2f}, {row.least_z_at}",
                f"{row.largest_z:.2f}, {row.largest_z_at}", f"{row.nees:.2f}", f"{row.beyond:.2f}",
            )
            for row in rows
        ),
    ]  # fmt: skip


def kinds_table(rows: Sequence[Row]) -> list[str]:
    """All cases by kinds: largest z and NEES, bold where sigma is acceptable."""
    found = {(row.case, row.kind): row for row in rows}
    lines = [f"| case | {' | '.join(f'`{kind}`' for kind in KINDS)} |", f"|{'---|' * (1 + len(KINDS))}"]
    for case in dict.fromkeys(row.case for row in rows):
        cells = []
        for kind in KINDS:
            row = found.get((case, kind))
            text = f"{row.largest_z:.2f}; {row.nees:.2f}" if row else "-"
            cells.append(f"**{text}**" if row and row.is_large_enough else text)
        lines.append(measured.row(case, *cells))
    return lines


def figure(found: dict[str, Found], path: Path) -> None:
    """z of heading over time, of kinds in `landing`."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    fig, axis = plt.subplots(figsize=(7.2, 3.8), layout="constrained")
    runs = min(one.runs for one in found.values())
    by = 1.96 / np.sqrt(2.0 * runs)
    axis.axhspan(1.0 - by, 1.0 + by, color="0.88", label=f"95 % of one look, {runs} runs")
    for kind, one in found.items():
        axis.plot(one.clock, np.sqrt(one.z2 / one.runs), label=kind, lw=2.0 if kind == DEFAULT else 1.0)
    axis.axvline(CORNER + 1.0, color="0.5", lw=0.8, ls=":")
    axis.set(xlabel="time, s", ylabel="RMS of heading error / σ", xlim=(0.0, one.clock[-1]))
    axis.legend(fontsize=7, ncols=2)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def at_corner(rows: Sequence[Row], label: str, kind: str) -> str:
    """z of heading of one row at `CORNER`; a dash where it is not finished."""
    return next((f"{r.heading_z:.2f}" for r in rows if r.case == label and r.kind == kind), "-")


def listed(subject: str, found: Sequence[tuple[str, str]]) -> list[str]:
    """A table of cases, or one line that nothing was found."""
    if not found:
        return [f"{subject}: none."]
    return [f"{subject}:", "", "| case | |", "|---|---|", *(f"| {case} | {text} |" for case, text in found)]


def results(rows: Sequence[Row]) -> list[str]:
    """A paragraph for each result, computed from the rows."""
    own, alike = [row for row in most_runs(rows) if row.kind == DEFAULT], most_runs(rows, least=True)
    shipped = [row for row in alike if row.case == row.study.name]
    kinds = [
        "| kind | z of heading, shipped scenarios | z by noise of the accelerometers × 0.1, 1, 3 | RMS, ° | σ, ° "
        "| no fixes, ° |",
        "|---|---|---|---|---|---|",
    ]
    landings = {row.kind: row for row in alike if row.case == "landing"}
    for kind in KINDS:
        each = [f"{row.heading_z:.2f}" for row in shipped if row.kind == kind]
        noises = ", ".join(at_corner(alike, label, kind) for label in NOISY_LANDINGS)
        one = landings.get(kind)
        degrees = [f"{x:.1f}" for x in (one.heading_rms_deg, one.heading_sigma_deg, one.no_fixes_deg)] if one else []
        kinds.append(measured.row(f"`{kind}`", span(each), noises, *degrees))
    outside = [(row.case, ", ".join(row.outside())) for row in own if row.outside()]
    inside = [[row for row in own if not row.outside(0.0, motion)] for motion in (False, True)]
    motion = [(row.case, ", ".join(row.outside(motion=True))) for row in own if row.outside(motion=True)]
    near = [one for row in own if not row.outside() for one in row.extremes_outside(0.0)]
    margin = span([f"{3.0 * sampling:.2f}" for _, sampling, _ in near])
    above = [
        (row.case, f"{row.heading_rms_deg:.1f}° against {row.no_fixes_deg:.1f}°")
        for row in own
        if row.heading_rms_deg > row.no_fixes_deg * (1.0 + 2.0 * row.heading_z_sampling)
    ]
    beyond = [row for row in own if row.beyond - 2.0 * row.beyond_sampling > NOMINAL]
    above_share = [row for row in own if row.beyond > SHARE]
    over = [
        (row.case, f"{row.beyond:.2f} ± {row.beyond_sampling:.2f} %")
        for row in above_share
        if row.beyond - 2.0 * row.beyond_sampling > SHARE
    ]
    far = [(row.case, f"{row.far} of {row.runs}") for row in own if row.far]
    better, bold = [], []
    for row in (row for row in alike if row.kind == DEFAULT):
        beside = [rival for rival in alike if rival.case == row.case and rival.kind in PUBLISHED]
        bold += [
            (row.case, f"`{rival.kind}`: {rival.beyond:.2f} against {row.beyond:.2f} %")
            for rival in beside
            if rival.is_large_enough and not row.is_large_enough
        ]
        best = min(beside, key=lambda rival: rival.departure, default=row)
        if round(best.departure, 2) < round(row.departure, 2):
            better.append((row.case, f"`{best.kind}`: {best.departure_told} against {row.departure_told}"))
    many = next(row for row in own if row.case == "landing")
    return [
        f"**Heading** at {CORNER:g} s, before the turn, by {landings[DEFAULT].runs} runs (z of 1: ± "
        f"{landings[DEFAULT].heading_z_sampling:.2f}). The first column of figures is over the",
        f"shipped scenarios, all others of `landing`; {many.runs} runs of `{DEFAULT}` have z {many.heading_z:.3f} ±",
        f"{many.heading_z_sampling:.3f} there. Straight flight does not show heading, so errors should equal those "
        "without fixes.",
        "",
        *kinds,
        "",
        f"**Every state.** Each z of `{DEFAULT}` should be between {LOW} and {HIGH}. In {len(inside[0])} of {len(own)}",
        f"cases each is. In {len(own) - len(outside) - len(inside[0])} others z leaves this range by at most 3 "
        f"standard errors ({margin}, by the scatter of the runs).",
        *listed("Cases further outside", outside),
        "",
        f"**Position and velocity.** Each of their z is in this range in {len(inside[1])} cases, and leaves it by at",
        f"most 3 standard errors in {len(own) - len(motion) - len(inside[1])} others.",
        *listed("Cases further outside", motion),
        "",
        *listed(f"Cases in which fixes make heading errors of `{DEFAULT}` larger by more than 2 sigma", above),
        "",
        f"**Large errors.** NEES of a consistent filter exceeds its 99.9 % limit in {NOMINAL} %. For `{DEFAULT}` this",
        f"share is larger by more than chance (2 sigma) in {len(beyond)} of {len(own)} cases. It is above {SHARE} % in",
        f"{len(above_share)} cases, in {len(over)} of them by more than chance. The filter's own mixture",
        "[explains a part](mixture-tails-measured.md).",
        *listed(f"Cases above {SHARE} % beyond chance", over),
        "",
        *listed(f"Cases in which a run has a heading error beyond {FAR:g} σ", far),
        "",
        *listed(
            "Cases in which the worst z of a published filter is nearer to 1 than that of the default (|z - 1|; "
            "differences within ± are chance)",
            better,
        ),
        "",
        *listed("Cases in which a published filter is [bold](#every-kind), but not the default, by large errors", bold),
        "",
    ]


def whole_rows(commit: str) -> list[Row]:
    """The rows that are finished with this code, else those of the CSV; writes the CSV. A kind with more runs than
    others of its case has a second row, of as many runs as all have."""
    kept, rows, own = read_table(), [], commit.split("`")[1]
    for case, study in studies().items():
        found = {kind: sums for kind in study.kinds if (sums := finished(case, kind)) is not None}
        old = [row for row in kept if row.case == case and row.kind in study.kinds and row.kind not in found]
        alike = min([*(sums.runs for sums in found.values()), *(row.runs for row in old)], default=0) // len(SEEDS)
        for kind in study.kinds:
            rows += [row for row in old if row.kind == kind]
            if kind not in found:
                continue
            rows.append(Row.of(case, kind, found[kind], own))
            if (first := finished(case, kind, alike)) is not None and first.runs < rows[-1].runs:
                rows.append(Row.of(case, kind, first, own))
    before, now = PAGE.stored() or {}, probe()
    both = before.keys() & now.keys()
    changed = measured.differences({key: before[key] for key in both}, {key: now[key] for key in both})
    if changed and any(row.commit not in commit for row in rows):
        sys.exit("\n".join(["the CSV has rows of other code; make them anew:", *changed]))
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([[field.name for field in fields(Row)], *(row.cells() for row in rows)])
    return rows


def read_table() -> list[Row]:
    """The rows of the CSV; none without it, or where it has other columns."""
    if not TABLE.exists():
        return []
    with TABLE.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    return [Row.read(cells) for cells in rows] if head == [field.name for field in fields(Row)] else []


def page(rows: Sequence[Row]) -> list[str]:
    """The page of these rows."""
    full, alike = most_runs(rows), most_runs(rows, least=True)
    own, others = span([row.runs for row in full if row.kind == DEFAULT]), span([row.runs for row in alike])
    scenarios = len({row.study.name for row in rows})
    table_of = "[filter-consistency.csv](filter-consistency.csv)"
    return [
        "# Consistency of the filter kinds, measured",
        "",
        "This page compares the errors of navsim's default filter, and of published filters, with the filter's σ,",
        "state by state ([may I trust σ?](sigma.md)).",
        "",
        f"Kinds are compared by the same {others} runs of a case; other results of `{DEFAULT}` are of {own} runs.",
        f"The {len({row.case for row in rows})} cases are {scenarios} scenarios and variants of them, some much alike.",
        f"{table_of} has every row, with sampling errors and the commit.",
        "",
        "## Results",
        "",
        *results(rows),
        f"![RMS of heading error / sigma over time]({IMAGE})",
        "",
        "## Method",
        "",
        "No setting was chosen by these seeds.",
        "",
        "| word | meaning |",
        "|---|---|",
        "| z | RMS over runs of error divided by σ. 1 is right; below 1 σ is too large, above 1 too small |",
        f"| least, largest z | smallest and largest z of the first {N_BASE} states at 10, 20, ... s and at "
        f"{CORNER:g} s, with its state and time. The largest of many exceeds 1 also by chance |",
        f"| RMS, σ | RMS error of heading at {CORNER:g} s; RMS of its σ |",
        "| no fixes | RMS heading error of the same runs without any fix, in straight flight |",
        "| NEES/n | NEES in the filter's own coordinates, divided by the number of states; mean over runs and times. "
        "1 is right |",
        "| > 99.9 % | share of NEES beyond the limit that a consistent filter exceeds in 0.1 % |",
        "| ± | 1 sigma of the chance of a finite number of runs |",
        "| A, B, C | A: positions at 1 Hz. B: positions and velocities at 1 Hz. C: positions at 10 Hz |",
        "",
        "| kind | filter | settings |",
        "|---|---|---|",
        *(
            f"| `{kind}` | {title} | {' '.join(f'`{setting}`' for setting in settings) or 'default'} |"
            for kind, (title, settings) in {**KINDS, **SMOOTHERS}.items()
            if any(row.kind == kind for row in rows)
        ),
        "",
        "## Every kind",
        "",
        f"Largest z; NEES/n, of the same {others} runs. In **bold** cells σ is acceptable:",
        f"no z above {LARGEST_Z}, NEES/n at most {LARGEST_NEES}, at most {LARGEST_SHARE} % of NEES beyond its limit "
        "(in the CSV).",
        "",
        *kinds_table([row for row in alike if row.kind in KINDS]),
        "",
        f"## `{DEFAULT}`",
        "",
        *table([row for row in full if row.kind == DEFAULT]),
        "",
        "## Smoothers",
        "",
        *table([row for row in full if row.kind in SMOOTHERS]),
    ]


PROBED = ("landing", "landing_smooth")


def probe() -> measured.Probe:
    """Every kind in the first case, the default in the second."""
    pairs = [*((PROBED[0], kind) for kind in KINDS), (PROBED[1], DEFAULT)]
    return {f"{label}, {kind}": measured.flown(ready(label, kind), SEEDS[0]) for label, kind in pairs}


PAGE = measured.Page("filter-consistency.md", "filter_consistency", SEEDS, probe)


def main() -> None:
    """Compute what is asked for; print its rows, or write the page."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = [*KINDS, *SMOOTHERS]
    ask.add_argument("--runs", type=int, default=RUNS, help="runs of each seed")
    ask.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    ask.add_argument("--cases", nargs="+", choices=list(studies()), metavar="CASE", help=", ".join(studies()))
    ask.add_argument("--kinds", nargs="+", choices=every, metavar="KIND", help=", ".join(every))
    ask.add_argument("--page", action="store_true", help="write the page from the pieces that are finished")
    options = ask.parse_args()
    whole = options.cases is None and options.kinds is None and tuple(options.seeds) == SEEDS
    begun = measured.commit() if options.page or whole else ""
    labels, kinds = options.cases or list(studies()), options.kinds or every
    if not options.page:
        wanted = list(pieces(labels, kinds, options.seeds, options.runs))
        compute(wanted)
        if not whole:
            rows = []
            for label in labels:
                for kind in kinds:
                    found = together([piece for piece in wanted if piece[:2] == (label, kind)])
                    if found is not None:
                        rows.append(Row.of(label, kind, found))
            print("\n".join(table(rows)))
            return
    landings = {kind: found for kind in KINDS if (found := finished("landing", kind)) is not None}
    if len(landings) == len(KINDS):
        figure(landings, ROOT / "docs" / IMAGE)
    PAGE.write(page(whole_rows(begun)), begun)


if __name__ == "__main__":
    main()
