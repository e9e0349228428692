"""What a filter makes of errors of the inertial sensors that it knows nothing of, one by one, and which kinds of filter
are true beside misalignments that they follow; writes docs/sensor-errors-measured.md.

Run by `make validate`, some five minutes on two cores.
"""

from __future__ import annotations

from pathlib import Path

import measured
import numpy as np

from navsim.landing.study import Case, fly_all, prepare
from navsim.runner.executor import threads
from navsim.runner.statistics import consistency_band
from navsim.scenario.load import read
from navsim.statistics.rounding import digits

ROOT = Path(__file__).resolve().parent.parent
SEED = 417
"""Of no run that anything was chosen by."""
RUNS = 400
TIMES = range(10, 61, 10)
ALWAYS = ("receiver.rate_hz=1", "duration_s=61")
SENSOR = (
    "imu={preset: none, rate_hz: 100, gyro: {drift_deg_h: 70, arw_deg_sqrt_h: 0.05}, "
    "accelerometer: {bias_mg: 1, vrw_m_s_sqrt_h: 0.1}}"
)
UNKNOWN: list[tuple[str, tuple[str, ...]]] = [
    ("none", ()),
    ("scale factors, 1000 ppm", (
        "imu.gyro.scale_ppm=1000", "imu.accelerometer.scale_ppm=1000", "filter.scale_factors=false")),
    ("the same, estimated (default)", ("imu.gyro.scale_ppm=1000", "imu.accelerometer.scale_ppm=1000")),
    ("misalignments, 1 mrad", (
        "imu.gyro.misalignment_mrad=1", "imu.accelerometer.misalignment_mrad=1", "filter.misalignments=false")),
    ("the same, estimated (default)", ("imu.gyro.misalignment_mrad=1", "imu.accelerometer.misalignment_mrad=1")),
    ("asymmetry, 500 ppm", ("imu.gyro.asymmetry_ppm=500", "imu.accelerometer.asymmetry_ppm=500")),
    ("nonlinearity, 20 ppm/(°/s), 100 µg/g²", (
        "imu.gyro.nonlinearity_ppm_deg_s=20", "imu.accelerometer.nonlinearity_ug_g2=100")),
    ("g-sensitivity, 10 °/h/g", ("imu.gyro.g_sensitivity_deg_h_g=10",)),
    ("ramps, 600 °/h/h, 10 mg/h", ("imu.gyro.ramp_deg_h_h=600", "imu.accelerometer.ramp_mg_h=10")),
    ("temperature, 10 °/h/K, 0.1 mg/K, 5 K/min", (
        "imu.gyro.temperature_deg_h_k=10", "imu.accelerometer.temperature_mg_k=0.1",
        "imu.temperature={ramp_k_min: 5}")),
    ("vibration, 1 g at 33 Hz, rectified, 100 µg/g²", (
        "imu.vibration={lines: [{amplitude_g: 1, frequency_hz: 33}]}", "imu.accelerometer.rectification_ug_g2=100")),
    ("sines, 50 °/h, 0.5 mg, 0.1 Hz", (
        "imu.gyro.sine_deg_h=50", "imu.gyro.sine_hz=0.1", "imu.accelerometer.sine_mg=0.5",
        "imu.accelerometer.sine_hz=0.1")),
    ("quanta, 50 µrad, 5 mm/s", ("imu.gyro.quantum_urad=50", "imu.accelerometer.quantum_mm_s=5")),
    ("bandwidth, 10 Hz", ("imu.gyro.bandwidth_hz=10", "imu.accelerometer.bandwidth_hz=10")),
    ("range, 3 °/s", ("imu.gyro.range_deg_s=3",)),
]  # fmt: skip
"""Errors, and what is set for them."""
KINDS = ("gaussian-sum", "tfg", "left-invariant", "eskf")
KNOWN = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1")
STARTS: list[tuple[str, tuple[str, ...], float]] = [
    ("1°, 70 °/h", KNOWN, 10.0),
    ("5°, 700 °/h", (), 0.0),
    ("5°, 700 °/h", (), 1.0),
    ("5°, 700 °/h", (), 3.0),
    ("5°, 700 °/h", (), 10.0),
]
"""What the flights begin with, and the misalignments, mrad."""


def case(*settings: str) -> Case:
    return prepare(*read(ROOT / "scenarios" / "s_turn.yaml", (*ALWAYS, *settings)))


def unknown(settings: tuple[str, ...]) -> Case:
    """The flight of the first table."""
    return case(SENSOR, "initial_errors.attitude_deg=1", "filter.kind=tfg", *settings)


def followed(start: tuple[str, ...], size: float, kind: str) -> Case:
    """The flight of the second table, with misalignments of `size` mrad."""
    gains = (f"imu.gyro.misalignment_mrad={size}", f"imu.accelerometer.misalignment_mrad={size}",
             "filter.misalignments=true") if size else ()  # fmt: skip
    return case(*start, *gains, f"filter.kind={kind}")


def nees(ready: Case, name: str, size: int) -> tuple[np.ndarray, np.ndarray]:
    """NEES over size at the times, and the RMS of the horizontal error with the filter's sigma at the last, m."""
    runs = fly_all(ready, SEED, 0, RUNS, threads(), keep="errors")
    at = [int(np.argmin(np.abs(ready.shared.filter_time - t))) for t in TIMES]
    sizes = (np.sqrt(np.mean(np.sum(runs[key][:, at[-1], :2] ** 2, axis=1))) for key in ("error", "sigma"))
    return runs[name].mean(axis=0)[at] / size, np.array([*sizes])


def one_by_one() -> list[str]:
    columns = " | ".join(map(str, TIMES))
    low, high = consistency_band(6, RUNS)
    lines = [
        "## Errors that the filter ignores, one by one",
        "",
        f"NEES/6 of position and velocity of {RUNS} runs, times in s; 95 % band at one time {low:.2f} to {high:.2f}.",
        "Horizontal error and the filter's σ at the end, m. Kind `tfg`, attitude 1°, sensor 70 °/h, 0.05 °/√h, 1 mg,",
        "0.1 m/s/√h.",
        f"| error | {columns} | horizontal, σ |",
        f"|---|{'---|' * len(TIMES)}---|",
    ]
    for label, settings in UNKNOWN:
        ready = unknown(settings)
        values, sizes = nees(ready, "nees_position_velocity", 6)
        lines.append(measured.row(label, *map(digits, values), "{:.2f}, {:.2f}".format(*sizes)))
    return lines


def by_kind() -> list[str]:
    lines = [
        "## Estimated misalignments, by kind of filter",
        "",
        f"Largest NEES over the number of states (27; 15 without misalignments) at these times, {RUNS} runs.",
        "",
        f"| start | misalignments, mrad | {' | '.join(f'`{kind}`' for kind in KINDS)} |",
        f"|---|---|{'---|' * len(KINDS)}",
    ]
    for label, start, size in STARTS:
        found = []
        for kind in KINDS:
            ready = followed(start, size, kind)
            found.append(nees(ready, "nees", len(ready.states))[0].max())
        lines.append(measured.row(label, f"{size:g}", *(f"{x:.2f}" for x in found)))
    return lines


def probe() -> measured.Probe:
    """Every row of the first table, and the largest misalignments with each kind of filter."""
    out = {label: measured.flown(unknown(settings), SEED) for label, settings in UNKNOWN}
    return out | {kind: measured.flown(followed(*STARTS[-1][1:], kind), SEED) for kind in KINDS}


PAGE = measured.Page("sensor-errors-measured.md", "sensor_errors", (SEED,), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# Errors of inertial sensors, measured",
        "",
        "`s_turn.yaml` to 60 s with fixes at 1 Hz.",
        "",
        *one_by_one(),
        "",
        *by_kind(),
    ]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
