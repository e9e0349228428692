"""What a filter makes of errors of altimeters that it knows nothing of, one by one, and of those that it follows;
writes docs/heights-measured.md.

Run by `make validate`, some three minutes on two cores.
"""

from __future__ import annotations

from pathlib import Path

import measured
import numpy as np

from navsim.filter import states
from navsim.landing.study import Case, fly_all, prepare
from navsim.runner.executor import threads
from navsim.runner.statistics import consistency_band
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
SEED = 512
"""Of no run that anything was chosen by."""
RUNS = 400
BELOW = 30.0
"""Heights above the runway that are looked at, m."""
ALWAYS = (
    "filter.kind=eskf", "receiver.rate_hz=1", "duration_s=61", "initial_errors.attitude_deg=1",
    "imu.gyro.drift_deg_h=70", "runway.geoid_undulation_m=15.5",
)  # fmt: skip
RADIO = "radio_altimeter={sigma_floor_m: 0.3, sigma_share: 0.02, lever_arm_m: [0, 0, 0.3], latency_s: 0.1%s}"
BARO = "barometric_altimeter={sigma_m: 0.5, lag_s: 0.4, isa_deviation_k: -15, rate_hz: 5%s}"
RISING = ", ground: [[-600, -6], [0, 0]]"
FOLLOWED = "filter.barometric_altimeter={errors: states}"
CASES: list[tuple[str, tuple[str, ...]]] = [
    ("no altimeter", ()),
    ("radio, all known", (RADIO % "",)),
    ("its ground rises by 1 % to the threshold", (RADIO % RISING, "filter.radio_altimeter.ground=[]")),
    ("the same, used over the runway alone", (RADIO % RISING, "filter.radio_altimeter={ground: [], from_m: 0}")),
    ("its latency, 0.1 s", (RADIO % "", "filter.radio_altimeter.latency_s=0")),
    ("its lever arm, 0.3 m", (RADIO % "", "filter.radio_altimeter.lever_arm_m=[0, 0, 0]")),
    ("its noise, twice as large as assumed", (
        RADIO % "", "filter.radio_altimeter={sigma_floor_m: 0.15, sigma_share: 0.01}")),
    ("barometric, all known", (BARO % "",)),
    ("its lag, 0.4 s", (BARO % "", "filter.barometric_altimeter.lag_s=0")),
    ("air 15 K colder", (BARO % "", "filter.barometric_altimeter.isa_deviation_k=0")),
    ("the geoid, 1 m", (BARO % "", "filter.barometric_altimeter.geoid_undulation_m=14.5")),
    ("its noise, twice as large as assumed", (BARO % "", "filter.barometric_altimeter.sigma_m=0.25")),
    ("its setting, 0.2 hPa too high", (BARO % ", qnh_error_hpa: 0.2",)),
    ("its setting, 1σ of 0.5 hPa", (BARO % ", qnh_sigma_hpa: 0.5",)),
    ("the same, estimated", (BARO % ", qnh_sigma_hpa: 0.5", FOLLOWED)),
    ("its drift, 3 m, 300 s", (BARO % ", drift_m: 3, drift_time_s: 300",)),
    ("the same, estimated", (BARO % ", drift_m: 3, drift_time_s: 300", FOLLOWED)),
    ("setting and drift", (BARO % ", qnh_sigma_hpa: 0.5, drift_m: 3, drift_time_s: 300",)),
    ("the same, estimated", (BARO % ", qnh_sigma_hpa: 0.5, drift_m: 3, drift_time_s: 300", FOLLOWED)),
    ("both altimeters, all known or estimated", (
        RADIO % "", BARO % ", qnh_sigma_hpa: 0.5, drift_m: 3, drift_time_s: 300", FOLLOWED)),
]  # fmt: skip
"""What the filter does not know, and what is set for it."""


def prepared(settings: tuple[str, ...]) -> Case:
    return prepare(*read(ROOT / "scenarios" / "landing.yaml", (*ALWAYS, *settings)))


def row(label: str, settings: tuple[str, ...]) -> str:
    """The table's line of a case: vertical error and NEES below `BELOW`."""
    case = prepared(settings)
    runs = fly_all(case, SEED, 0, RUNS, threads(), keep="errors")
    height = np.interp(case.shared.filter_time, case.shared.truth.time, case.shared.truth.llh[:, 2])
    height -= case.scenario.runway.ellipsoidal_m
    low = (height < BELOW) & (height > 0.1)
    error, sigma = (float(np.sqrt(np.mean(runs[name][:, low, states.R_D] ** 2))) for name in ("error", "sigma"))
    six, every = (
        float(runs[name][:, low].mean()) / size
        for name, size in (("nees_position_velocity", 6), ("nees", len(case.states)))
    )
    return measured.row(label, f"{error:.2f}, {sigma:.2f}", f"{six:.3g}", f"{every:.3g}")


def probe() -> measured.Probe:
    """Every row of the table; rows of the same name are numbered."""
    return {f"{i}, {label}": measured.flown(prepared(settings), SEED) for i, (label, settings) in enumerate(CASES, 1)}


PAGE = measured.Page("heights-measured.md", "heights", (SEED,), probe)


def main() -> None:
    """Fly every case and write the table."""
    begun = measured.commit()
    low, high = consistency_band(6, RUNS)
    lines = [
        "# Altimeters, measured",
        "",
        "In each row the filter ignores one error, or estimates it.",
        "",
        "| | |",
        "|---|---|",
        f"| flight | `landing.yaml` to 61 s with fixes at 1 Hz, {RUNS} runs |",
        "| filter | `eskf`; attitude 1°, gyros 70 °/h (1σ) |",
        "| radio altimeter | noise 0.3 m or 2 %, latency 0.1 s, lever arm 0.3 m |",
        "| barometric altimeter | noise 0.5 m, lag 0.4 s, air 15 K colder than standard |",
        f"| vertical, σ | RMS error and the filter's σ below {BELOW:g} m |",
        "| NEES/6, NEES | there, of position and velocity over 6, and of all states over their number. 95 % band of "
        f"NEES/6 at one time: {low:.2f} to {high:.2f} |",
        "",
        "| ignored | vertical, σ, m | NEES/6 | NEES |",
        "|---|---|---|---|",
        *(row(label, settings) for label, settings in CASES),
    ]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
