"""RMS of error over sigma of each state, every 10 s and just before the corner, by scenario, to standard output.

    python scripts/state_consistency.py --runs 2000 --seeds 3821 3822 3823 --kinds gaussian-sum eskf

One is right. Minutes of processor time for each scenario, seed and kind.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from navsim.core.states import A_D, N
from navsim.scenario.load import read
from navsim.study.executor import threads
from navsim.study.landing import fly_all, prepare

ROOT = Path(__file__).resolve().parent.parent
CORNER = 59.0
"""Just before the paper's corner, s."""
BATCH = 500
"""Runs at a time, for memory."""
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "landing": ("landing", ()),
    "landing, 1 mg": ("landing", ("imu.accelerometer.noise_mg=1",)),
    "landing, 30 mg": ("landing", ("imu.accelerometer.noise_mg=30",)),
    "landing, 1 Hz": ("landing", ("receiver.rate_hz=1",)),
    "landing, lever arm": ("landing", ("receiver.lever_arm_m=[2,0.5,-1]",)),
    "landing, latency 0.3 s": ("landing", ("receiver.latency_s=0.3",)),
    "landing, tight": ("landing", ("filter.coupling=tight",)),
    "landing, 1400 °/h": ("landing", ("imu.gyro.drift_deg_h=1400",)),
    "landing, 10°": ("landing", ("initial_errors.attitude_deg=10",)),
    **{
        name: (name, ())
        for name in ("landing_smooth", "landing_gnss_only", "landing_open_sky", "s_turn", "circuit", "track")
    },
}


def measure(name: str, settings: Sequence[str], seed: int, runs: int) -> str:
    """Fly a case and describe it in one line of a table."""
    case = prepare(*read(ROOT / "scenarios" / f"{name}.yaml", settings))
    time = case.world.filter_time
    wanted = sorted({CORNER, *np.arange(10.0, time[-1] + 1e-6, 10.0).tolist()})
    at = [int(np.argmin(np.abs(time - t))) for t in wanted]
    ratios, beyond, heading = [], [], []
    for first in range(0, runs, BATCH):
        flown = fly_all(case, seed, first, min(BATCH, runs - first), threads(), keep="errors")
        ratio = np.asarray(flown["error"])[..., :N] / np.asarray(flown["sigma"])[..., :N]
        ratios.append(ratio[:, at])
        states = np.asarray(flown["error"]).shape[-1]
        beyond.append(np.asarray(flown["nees"])[:, at] > chi2.isf(1e-3, states))
        heading.append(np.abs(ratio[..., A_D]).max(axis=1))
    z = np.sqrt((np.concatenate(ratios) ** 2).mean(axis=0))
    largest = np.concatenate(heading)
    corner = z[wanted.index(CORNER), A_D]
    return (
        f"z {z.min():.2f} - {z.max():.2f} | navigation {z[:, : A_D + 1].min():.2f} - {z[:, : A_D + 1].max():.2f} | "
        f"heading at {CORNER:g} s {corner:.3f} | beyond 99.9 % {100.0 * np.concatenate(beyond).mean():.2f} % | "
        f"largest heading {largest.max():.1f} sigma, {int((largest > 6.0).sum())} beyond 6"
    )


def main() -> None:
    """Fly what is asked for."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--runs", type=int, default=2000)
    ask.add_argument("--seeds", type=int, nargs="+", default=[3821, 3822, 3823])
    ask.add_argument("--kinds", nargs="+", default=["gaussian-sum"])
    ask.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    ask.add_argument("--set", action="append", default=[], dest="settings")
    options = ask.parse_args()
    for label in options.cases:
        name, settings = CASES[label]
        for kind in options.kinds:
            for seed in options.seeds:
                line = measure(name, (*settings, f"filter.kind={kind}", *options.settings), seed, options.runs)
                print(f"| {label} | {kind} | {seed} | {line} |", flush=True)


if __name__ == "__main__":
    main()
