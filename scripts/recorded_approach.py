"""A recorded airliner tracked by Singer's filters and by one driven by its Mode S reports; writes
docs/recorded-approach.md. Needs ../shared/data/modes_afr34zg; run by `make validate`, half a minute.
"""

from __future__ import annotations

import sys
from pathlib import Path

import measured
import numpy as np
from mode_s import (
    DEG,
    RESIDUAL,
    SIMULATED_RESIDUAL,
    Tracks,
    read,
    received_nodes,
    smoothed,
    track_plots,
)

from navsim.companions.azimuth.scenario import Azimuth
from navsim.companions.azimuth.study import onboard, ratio, rmse
from navsim.companions.reports import draw, nodes, reported

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data" / "modes_afr34zg"
RADAR = np.array([43.635 * DEG, 1.3678 * DEG, 150.0])
"""Beside the runways of Toulouse-Blagnac."""
TURN = (954.0, 1056.0)
TIME = np.arange(20.0, 1230.0)
NEAREST = 4000.0
"""Scans closer to the radar than this do not count, m."""
RUNS = 400
SEED = 1


def tracked(runs: int = RUNS) -> tuple[Tracks, np.ndarray, np.ndarray]:
    """The comparison, where each scan's report came from, and which scans count."""
    recording = read(DATA, "afr34zg_lfbo", RADAR)
    flight = smoothed(recording, TIME)
    received, source = received_nodes(recording, TIME)
    drawn = draw(SEED, runs, TIME.size).reports
    simulated = reported(flight, drawn, onboard(Azimuth(kind="azimuth-tracking", version=1)))
    driven = {
        "received": (received, RESIDUAL[source]),
        "simulated": (nodes(simulated, "roll", 1.0), np.full(TIME.size, SIMULATED_RESIDUAL)),
    }
    return track_plots(flight, driven, SEED, runs), source, flight.ground_range > NEAREST


def windows(found: Tracks, counted: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Stretches of 60 s with their scans."""
    out = []
    for begin in np.arange(60.0, TIME[-1] - 59.0, 60.0):
        inside = (found.time >= begin) & (found.time < begin + 60.0) & counted
        if inside.sum() >= 30:
            out.append((float(begin), inside))
    return out


def probe() -> measured.Probe:
    """RMSE of azimuth (deg) and range (m), and mean NIS, of every filter over the scans that count."""
    found, _, counted = tracked(4)
    return {
        name: [
            rmse(error[:, counted])[0], rmse(found.range[name][:, counted])[0],
            float(np.nanmean(found.nis[name][:, counted])),
        ]
        for name, error in found.azimuth.items()
    }  # fmt: skip


PAGE = measured.Page("recorded-approach.md", "recorded_approach", (SEED,), probe)


def main() -> int:
    """Fly the comparison and write the page."""
    if not DATA.is_dir():
        print(f"{DATA} is not there: docs/recorded-approach.md is left as it is", file=sys.stderr)
        return 0
    begun = measured.commit()
    found, source, counted = tracked()
    turn = (found.time >= TURN[0]) & (found.time < TURN[1])
    straight = ~turn & counted & (found.time >= 60.0)
    of = np.bincount(source[turn], minlength=4)
    lines = [
        "# A recorded approach",
        "",
        "The filters of [tracking from the ground](companions.md#azimuth-from-load-factors-kind-azimuth-tracking)",
        "along a recorded flight: an airliner to Toulouse (`shared/data/modes_afr34zg`), which turns right to final",
        "from 954 to 1056 s of the record. The table has RMS errors with 95 % intervals over simulated plots.",
        "",
        "| name | meaning |",
        "|---|---|",
        "| truth | the recorded positions and velocities, smoothed |",
        f"| plots | simulated each second by a radar at the airport, 1σ 0.08° and 30 m, in {RUNS} ensembles |",
        "| `received` | filter L4 with the reports as they came: BDS 5,0 up to 5 s old where roll and track rate "
        f"agree, else the slope of velocity squitters (in the turn {of[0]} scans by track rate, {of[1]} by roll, "
        f"{of[2]} by squitters). The residual acceleration is 0.8 m/s² with a report and 1.5 m/s² without |",
        "| `simulated` | filter L4 with reports each second from the smoothed track, with the scenario's noise and a "
        "residual acceleration of 0.2 m/s² |",
        "| S1, S2 | Singer's filter with 1.07 and 2.50 m/s² |",
        "",
        "| filter | azimuth, turn, deg | azimuth, else, deg | NIS, turn / else | range, turn, m | range, else, m |",
        "|---|---|---|---|---|---|",
    ]
    for name, error in found.azimuth.items():
        cells = []
        for errors, digits in ((error, 4), (found.range[name], 1)):
            for mask in (turn, straight):
                value, low, high = rmse(errors[:, mask])
                cells.append(f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]")
        nis = " / ".join(f"{np.nanmean(found.nis[name][:, mask]):.2f}" for mask in (turn, straight))
        lines.append(f"| {name} | {cells[0]} | {cells[1]} | {nis} | {cells[2]} | {cells[3]} |")
    lines += ["", "Azimuth error of Singer's filter in the turn, divided by that of L4, with 95 % intervals:", ""]
    for name in ("received", "simulated"):
        for baseline in ("S1", "S2"):
            value, low, high = ratio(found.azimuth[baseline][:, turn], found.azimuth[name][:, turn])
            lines.append(f"- {baseline} / {name}: {value:.3f} [{low:.3f}, {high:.3f}]")
    lines += ["", "Error of `received` divided by that of Singer's filter, in spans of 60 s (azimuth; range):", "",
              "| from, s | S1 | S2 | range S1 | range S2 |", "|---|---|---|---|---|"]  # fmt: skip
    for begin, inside in windows(found, counted):
        cells = [
            f"{ratio(errors['received'][:, inside], errors[s][:, inside])[0]:.3f}"
            for errors in (found.azimuth, found.range)
            for s in ("S1", "S2")
        ]
        lines.append(f"| {begin:g} | {' | '.join(cells)} |")
    PAGE.write(lines, begun)
    return 0


if __name__ == "__main__":
    sys.exit(main())
