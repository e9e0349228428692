"""Linear covariance analysis against Monte Carlo, component by component; writes docs/covariance-against-runs.md.

Run by `make validate`, some minutes on two cores.
"""

from __future__ import annotations

import sys
from pathlib import Path

import measured
import numpy as np

from navsim.filter.states import ACCEL, GYRO
from navsim.landing.study import Case, covariance_analysis, fly_all, prepare
from navsim.runner.executor import threads
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
RUNS = 2000
SEED = 1
TIMES = range(10, 121, 10)
GENTLE = ("receiver.rate_hz=1", "initial_errors.attitude_deg=1", "imu.gyro.drift_deg_h=70")
PAPER = ("receiver.rate_hz=1",)
POSITION_ONLY = ("filter.velocity=false",)
MISTUNED = ("filter.fix_sigma_scale=2", "filter.imu={gyro: {drift_deg_h: 20, noise_deg_h: 90}}")
CASES: list[tuple[str, tuple[str, ...]]] = [
    ("1°, 70 °/h, matched", GENTLE),
    ("1°, 70 °/h, mistuned", (*GENTLE, *POSITION_ONLY, *MISTUNED)),
    ("5°, 700 °/h, matched", PAPER),
    ("5°, 700 °/h, matched, fixes of position only", (*PAPER, *POSITION_ONLY)),
    ("5°, 700 °/h, matched, fixes of position only, one Gaussian", (*PAPER, *POSITION_ONLY, "filter.kind=tfg")),
    ("5°, 700 °/h, mistuned, fixes of position only", (*PAPER, *POSITION_ONLY, *MISTUNED)),
]


def case(settings: tuple[str, ...]) -> Case:
    return prepare(*read(ROOT / "scenarios" / "landing.yaml", settings))


def probe() -> measured.Probe:
    """Runs and analysis of a matched and of the mistuned case."""
    cases = {label: case(settings) for label, settings in (CASES[1], CASES[2])}
    return {label: [*measured.analysed(one), *measured.flown(one, SEED)] for label, one in cases.items()}


PAGE = measured.Page("covariance-against-runs.md", "covariance_against_runs", (SEED,), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# Covariance analysis against runs, measured",
        "",
        f"Each ratio is the RMS error of {RUNS} runs divided by that of `--method covariance`, for `landing.yaml` with",
        "fixes at 1 Hz ([summary](covariance.md#how-good)). Chance alone spreads a ratio by 1.6 % (1 sigma). The",
        "mistuned filter assumes twice the error of the fixes, a drift of 20 °/h and three times the gyro noise.",
    ]
    for label, settings in CASES:
        one = case(settings)
        analysis = covariance_analysis(one)
        predicted = np.sqrt(analysis.variance.sum(axis=0) + analysis.mean**2)
        error = fly_all(one, SEED, 0, RUNS, threads(), keep="errors")["error"]
        at = [int(np.argmin(np.abs(one.shared.filter_time - t))) for t in TIMES]
        found = np.sqrt(np.mean(error[:, at] ** 2, axis=0))
        ratio = found / predicted[at]
        yaw = np.degrees(found[:, 8])
        worst = np.abs(ratio[:, :6] - 1.0).max()
        gyros = np.abs(ratio[:, GYRO:ACCEL] - 1.0).max()
        lines += [
            "",
            f"## {label}: largest deviation of position and velocity {100 * worst:.1f} %, of gyro biases "
            f"{100 * gyros:.0f} %",
            "",
            "| t, s | r N | r E | r D | v N | v E | v D | heading | b_g x | b_g y | b_g z | heading RMS, ° |",
            "|---|---|---|---|---|---|---|---|---|---|---|---|",
        ]
        for t, values, heading in zip(TIMES, ratio, yaw, strict=True):
            cells = " | ".join(f"{x:.3f}" for x in (*values[:6], values[8], *values[GYRO:ACCEL]))
            lines.append(f"| {t} | {cells} | {heading:.2f} |")
        print("\n".join(lines[-15:]), file=sys.stderr)
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
