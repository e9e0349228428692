"""What two pseudolites replace: one approach by ILS, by MLS, by satellites, and by satellites with pseudolites; writes
docs/landing-aids-measured.md.

Run by `make validate`, some three minutes on two cores.
"""

from __future__ import annotations

from pathlib import Path

import measured
import numpy as np

from navsim.landing.result import result
from navsim.landing.study import Case, covariance_analysis, covariance_result, fly_all, prepare
from navsim.results.schema import HEIGHTS
from navsim.runner.executor import threads
from navsim.scenario.load import read
from navsim.scenario.requirements import ACCURACY

ROOT = Path(__file__).resolve().parent.parent
SEED = 4406
"""Of no run that anything was chosen by."""
RUNS = 400
SHOWN = ("200ft", "50ft", "touchdown")
LATERAL, VERTICAL = 16.0, ACCURACY["CAT-I"][0.05]
"""Accuracy of category I, 95 %, m: ICAO Annex 10, volume I, table 3.7.2.4-1."""
WITHOUT = ("azimuth_station=~", "elevation_station=~", "dme=~", "events=[]", "filter.fix_errors=states")
"""Satellites in place of ground stations."""
TWO = "pseudolites={count: 2, frame: runway, clock: gps, s_m: 200, l1_m: 1000, survey_sigma_m: 0.05, clock_sigma_ns: 1}"
CASES: dict[str, tuple[str, ...]] = {
    "ILS category I, DME/N": (),
    "ILS category III, DME/N": ("azimuth_station.preset=ils-3",),
    "MLS, DME/P": (
        "azimuth_station={preset: mls}", "elevation_station={preset: mls, beyond_m: 200}", "dme={preset: dme-p}",
    ),
    "GPS": (*WITHOUT, "signals.preset=open-sky"),
    "GPS, two pseudolites": (*WITHOUT, "signals.preset=open-sky", TWO),
    "GPS with corrections, like GBAS": (*WITHOUT, "signals.preset=differential"),
    "GPS with corrections, two pseudolites": (*WITHOUT, "signals.preset=differential", TWO),
}  # fmt: skip
"""Systems, and what they set in landing_ils.yaml."""


def prepared(name: str) -> Case:
    """The approach by a system."""
    return prepare(*read(ROOT / "scenarios" / "landing_ils.yaml", CASES[name]))


def row(name: str) -> str:
    """The table's line of a system: percentiles of runs at the heights, RMS over that of the covariance analysis."""
    case = prepared(name)
    found = result(case, fly_all(case, SEED, 0, RUNS, threads(), keep="none"), SEED, keep="none")
    predicted = covariance_result(case, covariance_analysis(case), SEED)
    at = [list(HEIGHTS).index(height) for height in SHOWN]
    of_95 = list(found["/summary/percentile"]).index(95)
    axes = [f"/summary/at/{axis}" for axis in ("lateral", "vertical")]
    cells = [found[f"{axis}_percentile"][at, of_95] for axis in axes]
    ratios = np.array([found[axis][at, 0] / predicted[axis][at, 0] for axis in axes])
    good = cells[0][0] <= LATERAL and cells[1][0] <= VERTICAL
    sizes = [f"{size:.3g}" for axis in cells for size in axis]
    return measured.row(name, *sizes, "yes" if good else "no", f"{ratios.min():.2f} to {ratios.max():.2f}")


def probe() -> measured.Probe:
    """Some rows of the table."""
    return {name: measured.flown(prepared(name), SEED) for name in ("MLS, DME/P", "GPS, two pseudolites")}


PAGE = measured.Page("landing-aids-measured.md", "landing_aids", (SEED,), probe)


def main() -> None:
    """Fly every system and write the table."""
    begun = measured.commit()
    heads = [f"{axis} {height}" for axis in ("lateral", "vertical") for height in SHOWN]
    lines = [
        "# What do two pseudolites replace?",
        "",
        f"Errors of navigation, 95 %, m, in {RUNS} runs of `landing_ils.yaml` a row, with one runway, wind, turbulence",
        f"and IMU. Category I allows {LATERAL:g} m laterally, {VERTICAL:g} m vertically (200 ft).",
        "",
        f"| system | {' | '.join(heads)} | accuracy of category I | RMS of runs over analysis |",
        f"|---|{'---|' * (len(heads) + 2)}",
        *map(row, CASES),
        "",
        "Stations have the largest errors that the standards allow, pseudolites small assumed ones: the rows compare",
        "no typical systems ([models](theory/ground-stations.md)). Integrity and continuity are not compared.",
        "",
        "| pseudolites | |",
        "|---|---|",
        "| position | 1000 m before the threshold, 200 m to each side, surveyed to 0.05 m |",
        "| clocks | synchronised to 1 ns |",
    ]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
