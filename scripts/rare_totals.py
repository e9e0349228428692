"""Rare total system errors, touchdowns and go-arounds of runs that leave the route, against counting; writes
docs/rare-totals-measured.md.

Run by `make validate`, some five minutes of processor time.
"""

from __future__ import annotations

import math
from pathlib import Path

import measured
import numpy as np
from scipy.special import ndtri

from navsim.landing import rare_events
from navsim.landing.study import Case, fly_all, prepare
from navsim.landing.total_errors import went_around
from navsim.runner.executor import threads
from navsim.runner.statistics import share_interval
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
SEED = 51
"""Of no run that anything was chosen by."""
BRIEF = ("imu.rate_hz=50", "receiver.rate_hz=2", "duration_s=61")
STEERED = (*BRIEF, "approach.guidance=estimate")
AIR = (
    "wind.speed_m_s=5", "wind.from_deg=60", "wind.turbulence={severity: light}",
    "approach.flight_technical_error={lateral: {sigma_m: 0.5, correlation_time_s: 8}, "
    "vertical: {sigma_m: 0.5, correlation_time_s: 8}}",
)  # fmt: skip
CASES: list[tuple[str, tuple[str, ...], str, tuple[int, ...]]] = [
    ("steered, total error at touchdown", STEERED, "error: total", (0, 2)),
    ("steered in turbulence, 30 m high", (*STEERED, *AIR), "error: total, height_m: 30", (0, 2)),
    ("not steered, in turbulence, 30 m high", (*BRIEF, *AIR), "error: total, height_m: 30", (0, 2)),
    ("steered, touchdown across the runway", STEERED, "error: touchdown", (0,)),
]
"""Label, settings of landing.yaml, box without limits, limited axes."""
CHANCES, COUNTED = (1e-2, 1e-5), 2000
KEYS = ("lateral_m", "along_m", "vertical_m")
GO_AROUND = (*BRIEF, "approach.go_around={on_alarm: true}")
LASTING = ("signals.preset=open-sky", "receiver.smoothing_s=20")
MONITORS: list[tuple[str, tuple[str, ...], float]] = [
    *((f"{{method: chi2, p_fa: {p_fa:g}}}", (), p_fa) for p_fa in (1e-4, 1e-6, 1e-8)),
    ("{method: chi2, p_fa: 1e-06}", LASTING, math.nan),
    ("{}", LASTING, math.nan),
]
"""Section `integrity`, further settings, and the probability of an alarm of each fix if fixes are independent."""
PUSHED = 480
"""Runs with drawn alarms."""


def boxed(settings: tuple[str, ...], box: str, axes: tuple[int, ...], chance: float) -> tuple[Case, Case]:
    """A case with a box that Gaussian errors leave with this chance, as often along each axis: pushed, counted."""
    file = ROOT / "scenarios" / "landing.yaml"

    def of(limits: list[float], method: str) -> Case:
        sides = ", ".join(f"{KEYS[axis]}: {limit!r}" for axis, limit in zip(axes, limits, strict=True))
        return prepare(*read(file, (*settings, f"box={{{box}, {sides}}}", f"method={method}")))

    sigma = np.sqrt(np.diagonal(rare_events.prepare(of([1e3] * len(axes), "rare")).tilt.proposal.covariance))
    limits = [float(-ndtri(0.5 * chance / len(axes)) * sigma[axis]) for axis in axes]
    return of(limits, "rare"), of(limits, "monte-carlo")


def go_arounds(monitor: str, settings: tuple[str, ...], method: str) -> Case:
    """Landings that break off after an alarm."""
    section = (f"integrity={monitor}", f"method={method}", "box={height_m: 30, vertical_m: 10}")
    return prepare(*read(ROOT / "scenarios" / "landing.yaml", (*GO_AROUND, *settings, *section)))


def counted_go_arounds(settings: tuple[str, ...]) -> list[np.ndarray]:
    """Which runs go around by each of the monitors with these settings; a run that none of p_fa 1e-4 alarms in has no
    alarm of a smaller one."""
    first, *others = [monitor for monitor, mine, _ in MONITORS if mine == settings]
    out = [
        went_around(fly_all(go_arounds(first, settings, "monte-carlo"), SEED + 1, 0, COUNTED, threads(), keep="none"))
    ]
    for monitor in others:
        case, mine = go_arounds(monitor, settings, "monte-carlo"), np.zeros(COUNTED, bool)
        for run in np.flatnonzero(out[0]).tolist():
            mine[run] = bool(np.isfinite(case.fly(SEED + 1, run).go_around[0]))
        out.append(mine)
    return out


def rows_of_go_arounds() -> list[str]:
    """Table of go-arounds: by plain runs, and by runs with drawn alarms."""
    lines = [
        "",
        "## Go-arounds",
        "",
        f"`{' '.join(GO_AROUND)}`, not steered; *lasting*: with `{' '.join(LASTING)}`.",
        "",
        "| `integrity` | closed form, independent fixes; none for lasting errors | counted | "
        "drawn alarms, from one seed: rows are off together | counted; effective samples |",
        "|---|---|---|---|---|",
    ]
    counted = counted_go_arounds(())
    for monitor, settings, p_fa in MONITORS:
        edge = rare_events.prepare(case := go_arounds(monitor, settings, "rare"))
        assert edge.alarms is not None
        value, _, effective = rare_events.go_around_probability(
            edge, rare_events.fly_all(case, edge, SEED, 0, PUSHED, threads())
        )
        shown, plain, times = "{:.3g} [{:.3g}, {:.3g}]".format(*map(float, value)), "-", "-"
        if not settings:
            turned = int(counted.pop(0).sum())
            plain, times = "{:.3g} [{:.3g}, {:.3g}]".format(*share_interval(turned, COUNTED)), str(turned)
        expected = "-" if math.isnan(p_fa) else f"{-math.expm1(edge.alarms.epoch.size * math.log1p(-p_fa)):.3g}"
        label = f"`{monitor}`" + (", lasting" if settings else "")
        lines.append(measured.row(label, expected, plain, shown, f"{times}; {effective:.0f}"))
    return lines


def probe() -> measured.Probe:
    """Probability, relative error and effective samples of a few pushed runs."""
    out = {}
    for monitor, settings, _ in MONITORS[1::3]:
        edge = rare_events.prepare(case := go_arounds(monitor, settings, "rare"))
        found = rare_events.go_around_probability(edge, rare_events.fly_all(case, edge, SEED, 0, 32, threads()))
        out[f"{monitor}, {len(settings)}"] = [float(found[0][0]), *found[1:]]
    for label, settings, box, axes in CASES[1::2]:
        case, _ = boxed(settings, box, axes, CHANCES[0])
        edge = rare_events.prepare(case)
        found = rare_events.probability(edge, rare_events.fly_all(case, edge, SEED, 0, 32, threads()))
        out[label] = [float(found[0][0]), *found[1:]]
    return out


PAGE = measured.Page("rare-totals-measured.md", "rare_totals", (SEED, SEED + 1), probe)


def main() -> None:
    """Fly every case and write the table."""
    begun = measured.commit()
    lines = [
        "# Rare total errors, measured",
        "",
        f"Boxes around runs that leave their route, by [importance sampling](rare-events.md); {COUNTED} other runs are",
        "counted. The difference is in standard errors of both, *nonlinear* as in",
        "[rare events, measured](rare-events-measured.md).",
        "",
        f"All cases are `landing.yaml` with `{' '.join(BRIEF)}`; steered: `approach.guidance=estimate`; in turbulence:",
        f"`{' '.join(AIR)}`.",
        "",
        "| case | Gaussian | counted | by pushed runs | pushed runs | difference | nonlinear |",
        "|---|---|---|---|---|---|---|",
    ]
    for label, settings, box, axes in CASES:
        for chance in CHANCES:
            case, plain = boxed(settings, box, axes, chance)
            edge = rare_events.prepare(case)
            enough = rare_events.stopping_rule(lambda edge=edge: edge, "probability within 20%")  # type: ignore[misc]
            flown = rare_events.fly_all(case, edge, SEED, 0, 4000, threads(), enough=enough)
            value, relative, _ = rare_events.probability(edge, flown)
            counted, difference = "-", "-"
            if chance == CHANCES[0]:
                errors = fly_all(plain, SEED + 1, 0, COUNTED, threads(), keep="none").per_run("at_box")[:, 0]
                share = float(edge.box.beyond(errors).any(axis=1).mean())
                error = math.hypot(relative * value[0], math.sqrt(share * (1.0 - share) / COUNTED))
                counted, difference = f"{share:.3g}", f"{(value[0] - share) / error:+.1f}"
            nonlinear = f"{float(rare_events.not_linear(edge, flown).max()):.2f} σ"
            shown = "{:.3g} [{:.3g}, {:.3g}]".format(*map(float, value))
            lines.append(measured.row(label, f"{chance:g}", counted, shown, flown.runs, difference, nonlinear))
    PAGE.write(lines + rows_of_go_arounds(), begun)


if __name__ == "__main__":
    main()
