"""Tight against loose coupling: under a clear sky, and with few sources for 30 s of the glide; writes
docs/outages-measured.md and docs/images/outages.png.

Run by `make validate`, some ten minutes on two cores.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import measured
import numpy as np

from navsim.landing.study import Case, fly_all, prepare
from navsim.runner.executor import threads
from navsim.runner.statistics import consistency_band, rms_interval
from navsim.scenario.load import read

mpl.use("agg")
ROOT = Path(__file__).resolve().parent.parent
SEED = 61
"""Of no run that anything was chosen by."""
RUNS = 400
CLEAR_RUNS = 1600
"""Ratios are near 1: they need more."""
BEGIN, END = 25.0, 55.0
LEFT: dict[str, tuple[str, ...]] = {
    "R01, R07, PL1": ("R01", "R07", "PL1"),
    "R01, R07, R16": ("R01", "R07", "R16"),
    "R01, PL1": ("R01", "PL1"),
    "PL1, PL2": ("PL1", "PL2"),
    "R01": ("R01",),
    "PL1": ("PL1",),
    "none": (),
}
CLEAR: dict[str, tuple[str, tuple[str, ...]]] = {
    "landing.yaml": ("landing", ()),
    "two systems": ("landing", ("sky.source=nominal",)),
    "pseudolites on a separate clock": ("landing", ("pseudolites.clock=own",)),
    "landing_gnss_only.yaml": ("landing_gnss_only", ()),
    "landing_smooth.yaml": ("landing_smooth", ()),
    "a fix a second, late by 0.25 s, lever arm": (
        "landing", ("receiver.rate_hz=1", "receiver.latency_s=0.25", "receiver.lever_arm_m=[1, 0.5, -0.7]"),
    ),
}  # fmt: skip
COUPLINGS = ("loose", "tight")


def case(name: str, coupling: str, *settings: str) -> Case:
    return prepare(*read(ROOT / "scenarios" / f"{name}.yaml", (f"filter.coupling={coupling}", *settings)))


def outage(left: tuple[str, ...], coupling: str) -> Case:
    """landing.yaml with all other sources silent from `BEGIN` to `END`."""
    silent = [name for name in case("landing", "loose").shared.signals.names if name not in left]
    events = json.dumps([{"what": "silence", "sources": silent, "at_s": BEGIN, "until_s": END}])
    return case("landing", coupling, f"events={events}")


@dataclass(frozen=True)
class Flown:
    """Histories of an ensemble: errors (run, t, 3) NED, m; sigmas; nees (run, t) of position and velocity."""

    time: np.ndarray
    error: np.ndarray
    sigma: np.ndarray
    nees: np.ndarray

    def at(self, when: float) -> int:
        return int(np.searchsorted(self.time, when - 1e-6))


def flown(ready: Case, runs: int = RUNS) -> Flown:
    ensemble = fly_all(ready, SEED, 0, runs, threads(), keep="errors")
    parts = (np.concatenate(list(ensemble.blocks(name))) for name in ("error", "sigma", "nees_position_velocity"))
    error, sigma, nees = parts
    return Flown(ready.shared.filter_time, error, sigma, nees / 6.0)


def clear() -> list[str]:
    groups = (("horizontal", [0, 1]), ("vertical", [2]), ("velocity", [3, 4, 5]), ("attitude", [6, 7, 8]))
    lines = [
        "## Under a clear sky",
        "",
        "RMS error of the tight filter divided by that of the loose one, second half of the flight; NEES/6 of position",
        f"and velocity. {CLEAR_RUNS} runs of each, with the same errors; 95 % intervals by 1000 resamples.",
        "",
        f"| case | {' | '.join(name for name, _ in groups)} | NEES/6 loose | tight |",
        "|---|---|---|---|---|---|---|",
    ]
    random = np.random.default_rng(SEED)
    for label, (name, settings) in CLEAR.items():
        both = [flown(case(name, coupling, *settings), CLEAR_RUNS) for coupling in COUPLINGS]
        late = slice(both[0].time.size // 2, None)
        cells = []
        for _, columns in groups:
            squares = [np.mean(np.sum(one.error[:, late, columns] ** 2, axis=2), axis=1) for one in both]
            some = random.integers(0, CLEAR_RUNS, (1000, CLEAR_RUNS))
            ratios = np.sqrt(squares[1][some].mean(axis=1) / squares[0][some].mean(axis=1))
            low, high = np.percentile(ratios, [2.5, 97.5])
            cells.append(f"{np.sqrt(squares[1].mean() / squares[0].mean()):.3f} [{low:.3f}, {high:.3f}]")
        lines.append(measured.row(label, *cells, *(f"{one.nees[:, late].mean():.3f}" for one in both)))
    return lines


def outages() -> tuple[list[str], dict[str, list[Flown]]]:
    low, high = consistency_band(6, RUNS)
    lines = [
        f"## Few sources from {BEGIN:g} to {END:g} s",
        "",
        "`landing.yaml`; all sources but these are silent:",
        f"`events: [{{what: silence, sources: [...], at_s: {BEGIN:g}, until_s: {END:g}}}]`. RMS errors of {RUNS} runs",
        f"with their 95 % interval, and the filter's σ, at the last epoch before {END:g} s. NEES/6 of position and",
        f"velocity: 95 % band at one time {low:.2f} to {high:.2f}.",
        "",
        "| sources | coupling | horizontal, m | σ | vertical, m | σ | NEES/6 at the end | in the outage |",
        "|---|---|---|---|---|---|---|---|",
    ]
    kept: dict[str, list[Flown]] = {}
    for label, left in LEFT.items():
        kept[label] = []
        for coupling in COUPLINGS:
            one = flown(outage(left, coupling))
            kept[label].append(one)
            last, first = one.at(END) - 1, one.at(BEGIN)
            cells: list[str] = []
            for columns in ([0, 1], [2]):
                value = rms_interval(one.error[:, last, columns] ** 2)
                cells.append("{:.2f} [{:.2f}, {:.2f}]".format(*value))
                cells.append(f"{np.sqrt(np.mean(np.sum(one.sigma[:, last, columns] ** 2, axis=1))):.2f}")
            nees = one.nees.mean(axis=0)
            inside = nees[first : last + 1]
            cells += [f"{nees[last]:.2f}", f"{inside.min():.2f} to {inside.max():.2f}"]
            lines.append(measured.row(label, coupling, *cells))
            if coupling == "loose" and label != "R01, R07, PL1":
                lines.pop()  # the same whatever is left, for there is no fix
    return lines, kept


def figure(kept: dict[str, list[Flown]], path: Path) -> None:
    import matplotlib.pyplot as plt

    shown = ("R01, R07, PL1", "R01, PL1", "PL1, PL2", "none")
    fig, axes = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained", sharex=True)
    colours = ("#0072B2", "#009E73", "#D55E00", "#555555")
    for label, colour in zip(shown, colours, strict=True):
        one = kept[label][1]
        for axis, columns in zip(axes, ([0, 1], [2]), strict=True):
            rms = np.sqrt(np.mean(np.sum(one.error[:, :, columns] ** 2, axis=2), axis=0))
            sigma = np.sqrt(np.mean(np.sum(one.sigma[:, :, columns] ** 2, axis=2), axis=0))
            axis.plot(one.time, rms, color=colour, lw=1.2, label=label)
            axis.plot(one.time, sigma, color=colour, lw=0.8, ls="--")
    loose = kept["none"][0]
    for axis, columns, name in zip(axes, ([0, 1], [2]), ("horizontal", "vertical"), strict=True):
        rms = np.sqrt(np.mean(np.sum(loose.error[:, :, columns] ** 2, axis=2), axis=0))
        axis.plot(loose.time, rms, color="black", lw=1.2, ls=":", label="loose, whatever is left")
        axis.axvspan(BEGIN, END, color="0.93", lw=0)
        axis.set(xlim=(15.0, 65.0), yscale="log", xlabel="time, s", ylabel=f"{name} position error, RMS, m")
        axis.grid(alpha=0.3, which="both", lw=0.4)
    axes[0].legend(fontsize=7, loc="upper left", frameon=False)
    fig.savefig(path, dpi=150)


def probe() -> measured.Probe:
    """Both couplings with few sources, and with a lever arm and late fixes."""
    label = "a fix a second, late by 0.25 s, lever arm"
    name, settings = CLEAR[label]
    out = {}
    for coupling in COUPLINGS:
        out[f"R01, PL1, {coupling}"] = measured.flown(outage(LEFT["R01, PL1"], coupling), SEED)
        out[f"{label}, {coupling}"] = measured.flown(case(name, coupling, *settings), SEED)
    return out


PAGE = measured.Page("outages-measured.md", "outages", (SEED,), probe)


def main() -> None:
    begun = measured.commit()
    head = [
        "# Tight and loose coupling, measured",
        "",
        "Default filter (`gaussian-sum`); [coupling](filter.md#tight-coupling).",
        "",
    ]
    lines, kept = outages()
    figure(kept, ROOT / "docs" / "images" / "outages.png")
    picture = [
        "",
        "![Errors of position through the outage](images/outages.png)",
        "",
        "Solid: RMS error; dashed: σ of the filter.",
        "",
    ]
    PAGE.write([*head, *lines, *picture, *clear()], begun)


if __name__ == "__main__":
    main()
