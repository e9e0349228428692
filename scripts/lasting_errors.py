"""Errors that last: what filters make of them that follow them, take them for noise or know nothing of their memory;
writes docs/lasting-errors-measured.md.

Run by `make validate`, some twenty minutes on two cores.
"""

from __future__ import annotations

import sys
from pathlib import Path

import measured
import numpy as np

from navsim.landing.study import Case, covariance_analysis, fly_all, prepare
from navsim.runner.executor import threads
from navsim.runner.statistics import consistency_band
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
SEED = 83
"""Of no run that anything was chosen by."""
RUNS, AGAINST = 500, 2000
TIMES = range(10, 121, 10)
OPEN = "signals={preset: open-sky}"
TIGHT = ("filter.coupling=tight", "receiver.rate_hz=1")
FIRST = "landing_open_sky"
"""What `navsim init` writes."""
CASES: list[tuple[str, str, tuple[str, ...]]] = [
    ("landing", "open-sky, states", (OPEN,)),
    ("landing", "open-sky, inflate", (OPEN, "filter.fix_errors=inflate")),
    ("landing", "open-sky, none", (OPEN, "filter.fix_errors=none")),
    ("landing", "sbas, states", ("signals={preset: sbas}",)),
    ("landing", "differential, states", ("signals={preset: differential}",)),
    (FIRST, "open-sky, states", ()),
    (FIRST, "open-sky, inflate", ("filter.fix_errors=inflate",)),
    ("landing", "open-sky, tight, states", (OPEN, *TIGHT)),
    ("landing", "open-sky, tight, inflate", (OPEN, *TIGHT, "filter.fix_errors=inflate")),
    ("landing_gnss_only", "open-sky, tight, states", (OPEN, *TIGHT)),
]
COMPARED: list[tuple[str, tuple[str, ...]]] = [
    ("states", (OPEN, "receiver.rate_hz=1")),
    ("tight, states", (OPEN, *TIGHT)),
]

TRANSMITTERS = (
    "duration_s=20", "receiver.rate_hz=2", "imu.rate_hz=20", "sky.source=nominal-gps", "initial_errors.attitude_deg=1",
    "pseudolites.frame=runway", "pseudolites.clock=gps", "pseudolites.survey_sigma_m=0.5",
    "pseudolites.clock_sigma_ns=15", "pseudolites.clock_drift_sigma_ppb=5", "pseudolites.clock_age_s=3",
    "pseudolites.clock_noise={oscillator: tcxo}", "pseudolites.range_bias_sigma_m=0.5",
    "beacons={sites: [{s_m: 120, l1_m: 300, height_m: 10}, {s_m: -120, l1_m: 300}, {s_m: 150, l1_m: -400}, "
    "{s_m: -150, l1_m: -400, height_m: 15}], rate_hz: 10, range_limit_m: 3000, sigma_m: 0.1, weak_sigma_m: 0.2, "
    "bias_sigma_m: 0.3, growth_m: 0.4, growth_sigma_m: 0.2, growth_distance_m: 300, survey_sigma_m: 0.2}",
)  # fmt: skip
"""Two pseudolites with free clocks, four beacons; all errors are drawn."""


def case(*settings: str, name: str = "landing") -> Case:
    return prepare(*read(ROOT / "scenarios" / f"{name}.yaml", settings))


def times(ready: Case) -> list[int]:
    return [int(np.argmin(np.abs(ready.shared.filter_time - t))) for t in TIMES]


def consistency() -> list[str]:
    low, high = consistency_band(6, RUNS)
    columns = " | ".join(map(str, TIMES))
    lines = [
        "## NEES/6 of position and velocity",
        "",
        "| column | |",
        "|---|---|",
        f"| times in s | {RUNS} runs; 95 % band at one time: {low:.2f} to {high:.2f} |",
        "| horizontal, σ; vertical, σ | RMS errors and the filter's σ of the last 10 s, m |",
        "| z | smallest and largest RMS of error/σ over all states and times; sampling error "
        f"{100 / np.sqrt(2 * RUNS):.1f} % (1 sigma) |",
        "| tight | with fixes at 1 Hz |",
        "",
        f"| scenario | signals, filter | {columns} | horizontal, σ | vertical, σ | states | z |",
        f"|---|---|{'---|' * len(TIMES)}---|---|---|---|",
    ]  # fmt: skip
    for name, label, settings in CASES:
        ready = case(*settings, name=name)
        ensemble = fly_all(ready, SEED, 0, RUNS, threads(), keep="errors")
        nees = ensemble["nees_position_velocity"].mean(axis=0)[times(ready)] / 6.0
        time = ready.shared.filter_time
        late = (time > TIMES[-1] - 10.0) & (time <= TIMES[-1])
        cells = []
        for which in ([0, 1], [2]):
            sizes = (
                np.sqrt(np.mean(np.sum(ensemble[name][:, late][..., which] ** 2, axis=2)))
                for name in ("error", "sigma")
            )
            cells.append("{:.2f}, {:.2f}".format(*sizes))
        at = times(ready)
        z = np.sqrt(np.mean((ensemble["error"][:, at] / ensemble["sigma"][:, at]) ** 2, axis=0))
        cells += [f"{z.shape[1]}", f"{z.min():.2f} - {z.max():.2f}"]
        lines.append(measured.row(f"{name}.yaml", label, *(f"{x:.3g}" for x in nees), *cells))
    return lines


def against_runs() -> list[str]:
    lines = [
        "## Covariance analysis",
        "",
        f"RMS error of {AGAINST} runs divided by that of `--method covariance`; `landing.yaml`, fixes at 1 Hz. The",
        "sampling error of a ratio is 1.6 % (1 sigma).",
    ]
    for label, settings in COMPARED:
        ready = case(*settings)
        analysis = covariance_analysis(ready)
        at = times(ready)
        predicted = np.sqrt(np.diagonal(analysis.covariance, axis1=1, axis2=2) + analysis.mean**2)[at, :6]
        error = fly_all(ready, SEED, 0, AGAINST, threads(), keep="errors")["error"][:, at, :6]
        ratio = np.sqrt(np.mean(error**2, axis=0)) / predicted
        worst = 100 * np.abs(ratio - 1.0).max()
        lines += ["", f"### open-sky, {label}: largest deviation {worst:.1f} %", ""]
        lines += ["| t, s | r N | r E | r D | v N | v E | v D |", "|---|---|---|---|---|---|---|"]
        print(lines[-4], file=sys.stderr)
        lines += [measured.row(t, *(f"{x:.3f}" for x in values)) for t, values in zip(TIMES, ratio, strict=True)]
    return lines


def of_transmitters() -> list[str]:
    lines = [
        "## Free clocks and biases of pseudolites and beacons",
        "",
        "| | smallest and largest value over all states and outputs; sampling error 1.6 % (1 sigma) |",
        "|---|---|",
        f"| flight | {AGAINST} runs of `landing.yaml`, 20 s, two pseudolites, four beacons |",
        "| errors | survey, clock (offset, rate, TCXO), bias |",
        "| z; ratio | RMS of error/σ; RMS error over that of `--method covariance` |",
        "",
        "| coupling | states | z | ratio |",
        "|---|---|---|---|",
    ]
    for coupling in ("loose", "tight"):
        ready = case(*TRANSMITTERS, f"filter.coupling={coupling}")
        true = np.sqrt(np.einsum("tii->ti", covariance_analysis(ready).covariance))
        square, normalised = np.zeros((2, *true.shape))
        for run in ready.fly_runs(SEED, 0, AGAINST, measured=False):
            square += np.sum(run.error**2, axis=0)
            normalised += np.sum((run.error / run.sigma) ** 2, axis=0)
        z, ratio = np.sqrt(normalised / AGAINST), np.sqrt(square / AGAINST) / true
        ends = (f"{x.min():.3f} - {x.max():.3f}" for x in (z, ratio))
        lines.append(measured.row(coupling, f"{z.shape[1]}", *ends))
    return lines


def probe() -> measured.Probe:
    """Every case of the first table; covariance analysis of the others."""
    out = {f"{name}.yaml, {label}": measured.flown(case(*each, name=name), SEED) for name, label, each in CASES}
    out |= {f"covariance, {label}": measured.analysed(case(*settings)) for label, settings in COMPARED}
    return out | {"covariance, transmitters": measured.analysed(case(*TRANSMITTERS))}


PAGE = measured.Page("lasting-errors-measured.md", "lasting_errors", (SEED,), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# Time-correlated ranging errors, measured",
        "",
        "Default filter (`gaussian-sum`).",
        "",
        *consistency(),
        "",
        *against_runs(),
        "",
        *of_transmitters(),
    ]  # fmt: skip
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
