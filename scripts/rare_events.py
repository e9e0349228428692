"""The probability of leaving a box by pushed runs: against counting, against a closed form, and what it costs; writes
docs/rare-events-measured.md.

Run by `make validate`, some ten minutes on two cores.
"""

from __future__ import annotations

import math
from pathlib import Path

import measured
import numpy as np
from scipy.special import ndtr, ndtri

from navsim.landing import rare_events
from navsim.landing.study import Case, covariance_analysis, covariance_result, fly_all, prepare
from navsim.runner.executor import threads
from navsim.runner.statistics import weighted_share
from navsim.scenario.load import read
from navsim.simulation.importance_sampling import proposal

ROOT = Path(__file__).resolve().parent.parent
SEED = 41
"""Of no run that anything was chosen by."""
POSITION = ("receiver.rate_hz=1", "filter.velocity=false")
LEVER = ("receiver.lever_arm_m=[1, 0.5, -0.7]",)
LINEAR = (
    "receiver.rate_hz=10", "filter.velocity=false", "duration_s=61", "filter.kind=eskf",
    "initial_errors.attitude_deg=0.01", "imu.gyro.drift_deg_h=1", "imu.accelerometer.bias_mg=0.01",
)  # fmt: skip
LATERAL, ALONG, VERTICAL = 0, 1, 2
COUNTED: list[tuple[str, str, tuple[str, ...], float, int]] = [
    ("landing.yaml", "landing", (), 1e-2, 4000),
    ("landing.yaml", "landing", (), 1e-3, 10_000),
    ("landing_gnss_only.yaml, A", "landing_gnss_only", POSITION, 1e-2, 4000),
    ("landing_gnss_only.yaml, A", "landing_gnss_only", POSITION, 1e-3, 10_000),
    ("landing.yaml, lever arm", "landing", LEVER, 1e-2, 4000),
]
"""Label, scenario, settings, chance of a Gaussian error, runs that are counted."""
CLOSED: list[tuple[float, int]] = [(1e-5, 20_000), (1e-7, 20_000)]
"""Chances of the closed form, and pushed runs."""
COSTS: list[tuple[str, str, tuple[str, ...]]] = [
    ("landing.yaml", "landing", ()),
    ("landing_smooth.yaml", "landing_smooth", ()),
    ("landing_gnss_only.yaml, A", "landing_gnss_only", POSITION),
]
COST_AT = 1e-6
PARTS = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 1.0)
"""Sigmas of errors that are not linear."""
TRIALS, MOST = 400, 20_000


def boxed(
    name: str, settings: tuple[str, ...], chance: float, axes: tuple[int, ...]
) -> tuple[Case, rare_events.LimitState]:
    """A scenario with a box that a Gaussian error leaves with this chance, the same through each of its pairs of
    faces."""
    file = ROOT / "scenarios" / f"{name}.yaml"
    case = prepare(*read(file, (*settings, "box={lateral_m: 100}")))
    sigma = np.sqrt(np.diagonal(rare_events.prepare(case).tilt.proposal.covariance))
    limits = -ndtri(0.5 * chance / len(axes)) * sigma
    keys = [f"{('lateral_m', 'along_m', 'vertical_m')[axis]}: {float(limits[axis])!r}" for axis in axes]
    case = prepare(*read(file, (*settings, f"box={{{', '.join(keys)}}}")))
    return case, rare_events.prepare(case)


def interval(values: np.ndarray) -> str:
    return "{:.3g} [{:.3g}, {:.3g}]".format(*map(float, values))


def counted() -> list[str]:
    lines = [
        "## Against counting",
        "",
        "The boxes limit all three errors. The difference is in standard errors of both.",
        "",
        "| case | Gaussian | counted, of runs | by pushed runs | pushed runs | difference |",
        "|---|---|---|---|---|---|",
    ]
    for label, name, settings, chance, runs in COUNTED:
        case, edge = boxed(name, settings, chance, (LATERAL, ALONG, VERTICAL))
        errors = fly_all(case, SEED, 0, runs, threads(), keep="none").per_run("at_box")[:, 0]
        share = float(edge.box.beyond(errors).any(axis=1).mean())
        enough = rare_events.stopping_rule(lambda edge=edge: edge, "probability within 10%")  # type: ignore[misc]
        flown = rare_events.fly_all(case, edge, SEED + 1, 0, 20_000, threads(), enough=enough)
        value, relative, _ = rare_events.probability(edge, flown)
        error = math.hypot(relative * value[0], math.sqrt(share * (1.0 - share) / runs))
        difference = f"{(value[0] - share) / error:+.1f}"
        cells = (f"{chance:g}", f"{share:.3g} of {runs}", interval(value), flown.runs, difference)
        lines.append(measured.row(label, *cells))
    return lines


def closed() -> list[str]:
    lines = [
        "## Against the closed form of a linear case",
        "",
        f"The case is `landing_gnss_only.yaml` with `{' '.join(LINEAR)}`.",
        "Attitude and sensors are so good that it is linear, and the vertical error Gaussian, with the sigma of the",
        "covariance analysis.",
        "",
        "| Gaussian | by pushed runs | pushed runs | off by |",
        "|---|---|---|---|",
    ]
    file = ROOT / "scenarios" / "landing_gnss_only.yaml"
    case = prepare(*read(file, (*LINEAR, "box={lateral_m: 100}")))
    analysed = covariance_result(case, covariance_analysis(case), SEED)
    sigma = float(analysed["/summary/box/axis_sigma"][VERTICAL])
    for chance, runs in CLOSED:
        limit = float(-ndtri(0.5 * chance) * sigma)
        case = prepare(*read(file, (*LINEAR, f"box={{vertical_m: {limit!r}}}")))
        edge = rare_events.prepare(case)
        flown = rare_events.fly_all(case, edge, SEED, 0, runs, threads())
        value, _, _ = rare_events.probability(edge, flown)
        lines.append(measured.row(f"{chance:g}", interval(value), runs, f"{100 * (value[0] / chance - 1):+.1f} %"))
    return lines


def costs() -> list[str]:
    lines = [
        f"## Landings until the 95 % interval is ±20 %, at {COST_AT:g}",
        "",
        "The boxes limit the lateral and the vertical error; each case has three seeds.",
        "",
        "| case | landings | probabilities | largest standard deviation of a nonlinear part of an error |",
        "|---|---|---|---|",
    ]
    for label, name, settings in COSTS:
        case, edge = boxed(name, settings, COST_AT, (LATERAL, VERTICAL))
        enough = rare_events.stopping_rule(lambda edge=edge: edge, "probability within 20%")  # type: ignore[misc]
        flown = [rare_events.fly_all(case, edge, SEED + k, 0, 20_000, threads(), enough=enough) for k in range(3)]
        values = [f"{rare_events.probability(edge, each)[0][0]:.2g}" for each in flown]
        most = max(float(rare_events.not_linear(edge, each).max()) for each in flown)
        landings = sorted(each.runs for each in flown)
        lines.append(measured.row(label, f"{landings[0]} - {landings[-1]}", ", ".join(values), f"{most:.2f} σ"))
    return lines


def honesty() -> list[str]:
    lines = [
        "## The interval where errors are not linear",
        "",
        "Two errors have a Gaussian part ν σ that is not linear in the random inputs, so that importance sampling does",
        "not shift it.",
        "",
        "| | |",
        "|---|---|",
        f"| studies of each row | {TRIALS}; each ends when its interval is ±20 %, or after {MOST} runs |",
        f"| probability of the box to first order | {COST_AT:g} |",
        "| missed | the whole interval lies below the true probability; a 95 % interval should in 2.5 % of studies |",
        "",
        "| ν | runs | found over truth, median | missed | effective samples, median |",
        "|---|---|---|---|---|",
    ]
    rng = np.random.default_rng(SEED)
    limit = float(-ndtri(COST_AT / 4.0))
    mix = proposal(np.zeros(2), np.eye(2), np.full(2, -limit), np.full(2, limit))
    for part in PARTS:
        truth = 1.0 - (1.0 - 2.0 * float(ndtr(-limit / math.hypot(1.0, part)))) ** 2
        found = []
        for _ in range(TRIALS):
            first = rng.standard_normal((MOST, 2)) + mix.shifts[rng.choice(mix.shares.size, MOST, p=mix.shares)]
            log_weights = mix.log_weights(first.T)
            outside = (np.abs(first + part * rng.standard_normal((MOST, 2))) > limit).any(axis=1)
            for runs in (*range(512, MOST, 512), MOST):
                # of chances that are rare the rest is never looked at
                value, _, effective = weighted_share(
                    log_weights[:runs], outside[:runs], mix.most_weight, mix.most_weight
                )
                if rare_events.is_narrow(value, effective, rare_events.USUAL):
                    break
            found.append((runs, value[0] / truth, value[2] < truth, effective))
        runs, over, missed, effective = np.array(found, float).T
        cells = (f"{part:g}", f"{np.median(runs):.0f}", f"{np.median(over):.2f}", f"{100 * missed.mean():.1f} %")
        lines.append(measured.row(*cells, f"{np.median(effective):.0f}"))
    return lines


def probe() -> measured.Probe:
    """Probability, its relative error and its effective samples of a few pushed runs of one box."""
    label, name, settings, chance, _ = COUNTED[2]
    case, edge = boxed(name, settings, chance, (LATERAL, ALONG, VERTICAL))
    value, relative, effective = rare_events.probability(edge, rare_events.fly_all(case, edge, SEED, 0, 64, threads()))
    return {f"{label}, {chance:g}": [float(value[0]), float(relative), float(effective)]}


PAGE = measured.Page("rare-events-measured.md", "rare_events", (SEED, SEED + 1, SEED + 2), probe)


def main() -> None:
    """Fly every case and write the tables."""
    begun = measured.commit()
    lines = [
        "# Rare events, measured",
        "",
        "[Importance sampling](rare-events.md) of errors at touchdown. Case A has fixes of position alone at 1 Hz. The",
        'lever arm is 1, 0.5, -0.7 m, at 5° and 700 °/h. The column "Gaussian" has the probability by the covariance',
        "analysis, for several axes their sum.",
        "",
        *counted(),
        "",
        *closed(),
        "",
        *costs(),
        "",
        *honesty(),
    ]
    PAGE.write(lines, begun)


if __name__ == "__main__":
    main()
