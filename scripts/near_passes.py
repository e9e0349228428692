"""Covariance analysis and filter sigma against runs beside pseudolites that are passed at 20 to 300 m.

Numbers of pseudolites x ranging errors x coupling x distance x sky. Writes docs/near-passes.md. Run by `make
validate`; some fifteen minutes of processor time.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import measured
import numpy as np

from navsim.filter import states
from navsim.landing.case import rms_window
from navsim.landing.study import Case, covariance_analysis, prepare
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
RUNS = 200
SEED = 11
WITHIN = 0.1
TWO_SIDED = 1.96
COUNTS, PRESETS, COUPLINGS, DISTANCES = (1, 2, 3), ("white", "open-sky"), ("loose", "tight"), (20.0, 50.0, 100.0, 300.0)
SKIES = ("nominal", "nominal-glonass")
QUICK = ("imu.rate_hz=50", "receiver.rate_hz=5", "duration_s=101")
SLOPE, AIM = math.tan(math.radians(5.0)), 100.0
"""Of the glide path, and where it meets the runway beyond the threshold, m."""


@dataclass(frozen=True)
class Cell:
    """A setting: number of pseudolites, ranging errors, coupling, distance passed, m, sky."""

    count: int
    preset: str
    coupling: str
    distance: float
    sky: str

    def case(self) -> Case:
        """The landing: the first pseudolite is passed at the distance, 16 to 25 m under the path; the second stands
        opposite, the third 1500 m before the threshold."""
        under = min(0.8 * self.distance, 25.0)
        before, side = under / SLOPE - AIM, math.sqrt(self.distance**2 - under**2)
        places = [(side, before), (-side, before), (500.0, 1500.0)][: self.count]
        sites = ", ".join(f"{{s_m: {s:.2f}, l1_m: {l1:.2f}}}" for s, l1 in places)
        settings = (
            f"pseudolites={{sites: [{sites}]}}", f"signals={{preset: {self.preset}}}", f"sky.source={self.sky}",
            f"filter.coupling={self.coupling}",
        )  # fmt: skip
        return prepare(*read(ROOT / "scenarios/landing_open_sky.yaml", [*QUICK, *settings]))


def cells() -> list[Cell]:
    """All settings."""
    return list(itertools.starmap(Cell, itertools.product(COUNTS, PRESETS, COUPLINGS, DISTANCES, SKIES)))


@dataclass(frozen=True)
class Found:
    """RMS errors of runs by those of the covariance analysis, and by the filter's sigma (3,), north, east, down over
    20 s to touchdown; warned: that the pseudolites are near."""

    by_analysis: np.ndarray
    by_filter: np.ndarray
    warned: bool

    def holds(self, runs: int) -> bool:
        """Whether all is within 1 +- `WITHIN` as far as so many runs tell, or there is a warning."""
        reach = TWO_SIDED / math.sqrt(2.0 * runs)
        every = np.concatenate([self.by_analysis, self.by_filter])
        return self.warned or bool(
            np.all((every < (1.0 + WITHIN) * (1.0 + reach)) & (every > (1.0 - WITHIN) * (1.0 - reach)))
        )


def flown(case: Case, runs: int) -> Found:
    """Fly a case, and analyse it."""
    analysis, window, position = covariance_analysis(case), rms_window(case), states.SLICES["position"]
    error, sigma = [], []
    for run in case.fly_runs(SEED, 0, runs, measured=False):
        error.append(np.mean(run.error[:, window, position] ** 2, axis=1))
        sigma.append(np.mean(run.sigma[:, window, position] ** 2, axis=1))
    square = np.concatenate(error).mean(axis=0)
    believed = np.concatenate(sigma).mean(axis=0)
    variance = np.diagonal(analysis.covariance, axis1=1, axis2=2)[window, position]
    expected = (variance + analysis.mean[window, position] ** 2).mean(axis=0)
    warned = bool(case.flight.near_passes)
    return Found(np.sqrt(square / expected), np.sqrt(square / believed), warned)


def _span(values: np.ndarray) -> str:
    return f"{values.min():.2f} - {values.max():.2f}"


PROBED = [
    Cell(1, "white", "loose", 20.0, "nominal"), Cell(2, "open-sky", "loose", 50.0, "nominal-glonass"),
    Cell(3, "open-sky", "tight", 20.0, "nominal-glonass"),
]  # fmt: skip


def probe() -> measured.Probe:
    """Runs and analysis of some settings."""
    cases = {f"{c.count}, {c.preset}, {c.coupling}, {c.distance:g} m, {c.sky}": c.case() for c in PROBED}
    return {label: [*measured.analysed(case), *measured.flown(case, SEED)] for label, case in cases.items()}


PAGE = measured.Page("near-passes.md", "near_passes", (SEED,), probe)


def main() -> None:
    """Fly all, write the page."""
    begun = measured.commit()
    found = {cell: flown(cell.case(), RUNS) for cell in cells()}
    rows, unwarned = [], sum(not it.holds(RUNS) for it in found.values())
    for preset, coupling, distance in itertools.product(PRESETS, COUPLINGS, DISTANCES):
        row = [it for c, it in found.items() if (c.preset, c.coupling, c.distance) == (preset, coupling, distance)]
        spans = [_span(np.stack([it.by_analysis for it in row])), _span(np.stack([it.by_filter for it in row]))]
        warned = f"{sum(it.warned for it in row)} of {len(row)}"
        rows.append(measured.row(preset, coupling, f"{distance:.0f}", *spans, warned))
    reach = 100.0 * TWO_SIDED / math.sqrt(2.0 * RUNS)
    least, most = (1.0 - WITHIN) * (1.0 - 0.01 * reach), (1.0 + WITHIN) * (1.0 + 0.01 * reach)
    text = f"""# Passing pseudolites at 20 to 300 m

Do covariance analysis and the filter's sigma hold where the aircraft passes near pseudolites? The table has RMS errors
of runs, divided by those of the analysis and by sigma.

| | |
|---|---|
| landing | `landing_open_sky.yaml` with 5 fixes and 50 inertial samples a second, {RUNS} runs of seed {SEED} |
| pseudolites | white noise only: no survey, clock or bias error |
| each row | one, two and three pseudolites under two skies (`nominal`, `nominal-glonass`) |
| cells | the smallest and largest ratio, north, east or down, over 20 s to touchdown |
| chance | moves a ratio of {RUNS} runs by up to {reach:.0f} % (95 %), similar settings alike: all have one seed |

A ratio fails if it is outside of 1 ± {WITHIN:g} by more than chance: below {least:.2f} or above {most:.2f}. \
{unwarned} of {len(found)} settings fail without
a warning.

| ranging errors | coupling | distance, m | runs / analysis | runs / sigma | warnings |
|---|---|---|---|---|---|
"""
    PAGE.write([*text.splitlines(), *rows], begun)


if __name__ == "__main__":
    main()
