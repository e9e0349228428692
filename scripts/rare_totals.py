"""Rare total system errors and touchdowns of runs that leave the route, against counting; writes
docs/rare-totals-measured.md.

Run by `make validate`, some four minutes of processor time.
"""

from __future__ import annotations

import math
from pathlib import Path

import measured
import numpy as np
from scipy.special import ndtri

from navsim.landing import rare_events
from navsim.landing.study import Case, fly_all, prepare
from navsim.runner.executor import threads
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


def boxed(settings: tuple[str, ...], box: str, axes: tuple[int, ...], chance: float) -> tuple[Case, Case]:
    """A case with a box that Gaussian errors leave with this chance, as often along each axis: pushed, counted."""
    file = ROOT / "scenarios" / "landing.yaml"

    def of(limits: list[float], method: str) -> Case:
        sides = ", ".join(f"{KEYS[axis]}: {limit!r}" for axis, limit in zip(axes, limits, strict=True))
        return prepare(*read(file, (*settings, f"box={{{box}, {sides}}}", f"method={method}")))

    sigma = np.sqrt(np.diagonal(rare_events.prepare(of([1e3] * len(axes), "rare")).tilt.proposal.covariance))
    limits = [float(-ndtri(0.5 * chance / len(axes)) * sigma[axis]) for axis in axes]
    return of(limits, "rare"), of(limits, "monte-carlo")


def probe() -> measured.Probe:
    """Probability, relative error and effective samples of a few pushed runs."""
    out = {}
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
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
