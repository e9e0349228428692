"""The air traffic control study: errors by phase, decoupled against full, Singer against onboard data, cost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.report.table import Table, cell, interval
from navsim.report.view import View, one_by_one
from navsim.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS = {
    "full": "13 states", "adapt": "six groups, variance of the input counted", "fix": "six groups, variance ignored",
    "singer": "range alone", "cartesian": "Cartesian, Singer acceleration",
}  # fmt: skip
_DEGREES = ("path_angle", "track", "elevation", "azimuth")
LITTLE = 0.05
"""Decoupling keeps the accuracy where its errors grow by no more than this."""


def tables(result: Result) -> list[Table | str]:
    """RMSE of range by case, filter and phase; ratios; verdicts; counts."""
    names = [str(n) for n in result["/state"]]
    rmse, ratios = result["/summary/rmse"], result["/summary/decoupled_to_full"]
    parts: list[Table | str] = []
    heads = ("filter", "", "D manoeuvre, m", "D' manoeuvre, m/s", "D straight, m", "azimuth man., deg")
    azimuth = names.index("azimuth")
    for c, case in enumerate(result["/case"]):
        errors = Table(f"{case_label(case)}: RMSE [95 %]", heads)
        for f, name in enumerate(result["/filter"]):
            errors.add(
                str(name), WORDS[str(name)], interval(rmse[c, f, 0, 0], 2), interval(rmse[c, f, 0, 1], 3),
                interval(rmse[c, f, 1, 0], 2), interval(rmse[c, f, 0, azimuth], 4, 180.0 / np.pi),
            )  # fmt: skip
        parts.append(errors)
    kept = Table(
        "Does decoupling keep the accuracy? RMSE of adapt over full in the manoeuvre [95 %]",
        ("case", "D", "D'", "pairs V, th, phi, ev, eg", "verdict"),
    )
    levels = [names.index(n) for n in ("speed", *_DEGREES)]
    for c, case in enumerate(result["/case"]):
        pairs = ratios[c, 0, 0, levels, 0]
        range_, rate = ratios[c, 0, 0, 0], ratios[c, 0, 0, 1]
        kept_pairs, kept_range = (bool(np.max(x) <= 1.0 + LITTLE) for x in (pairs, (range_[0], rate[0])))
        verdict = {
            (True, True): "yes", (True, False): "for the pairs, not for the range",
            (False, True): "for the range, not for the pairs", (False, False): "no",
        }[kept_pairs, kept_range]  # fmt: skip
        spread = cell("{:.3f} to {:.3f}", float(pairs.min()), float(pairs.max()), names=("smallest", "largest"))
        kept.add(case_label(case), interval(range_, 3), interval(rate, 3), spread, verdict)
    parts.append(kept)
    gain = Table("Singer over adapt in the manoeuvre [95 %]", ("case", "D", "D'"))
    for c, case in enumerate(result["/case"]):
        gain.add(case_label(case), *(interval(x, 3) for x in result["/summary/singer_to_adapt"][c, 0]))
    parts.append(gain)
    if "/link/cost" in result:
        parts += _link(result)
    full, groups = int(result["/summary/multiplications_full"]), int(result["/summary/multiplications_decoupled"])
    stored = int(result["/summary/stored_full"]), int(result["/summary/stored_decoupled"])
    parts.append(
        f"A covariance step takes {full} multiplications in the full filter, {groups} in the six groups: "
        f"{full / groups:.0f} times fewer; {stored[0]} and {stored[1]} numbers are stored. The full model is not full: "
        "it models rates of the line of sight as separate noises, though they follow from V, th, phi and D. The "
        "Cartesian filter uses that."
    )
    return parts


_RANGE = ("range", "range_rate")


def _link(result: Result) -> list[Table | str]:
    """Cost of data link reports: one table for each reported quantity."""
    filters = [str(name) for name in result["/link/link_filter"]]
    parts: list[Table | str] = []
    for r, reports in enumerate(map(str, result["/link/reports"])):
        table = Table(
            f"Reports by data link, {reports}: RMSE of D / D' in the manoeuvre, over that with exact reports",
            ("age, s", "age and steps, to the filter", *filters),
            notes="first row: exact reports, m / m/s; below: quantised as the registers are, ratios to the first row",
        )
        exact = result["/link/exact_rmse"][r, :, :, 0]
        table.add("0", "not quantised", *(cell("{:.2f} / {:.3f}", *map(float, x), names=_RANGE) for x in exact))
        for a, age in enumerate(result["/link/age"]):
            for k, known in enumerate(map(str, result["/link/knowledge"])):
                costs = result["/link/cost"][r, a, k, :, :, 0]
                cells = (cell("{:.2f} / {:.2f}", *map(float, x), names=_RANGE) for x in costs)
                table.add(cell("{:g}", float(age)), known, *cells)
        parts.append(table)
    return parts


_COLOURS = {"singer": "#999999", "fix": "#0072B2", "adapt": "#D55E00", "full": "#009E73", "cartesian": "#CC79A7"}


def case_label(case: object) -> str:
    """`T1_angles` as text."""
    period, measured = str(case).removeprefix("T").split("_")
    return f"T = {period} s, {'angles and rates' if measured == 'rates' else 'angles'}"


def _errors(result: Result) -> Figure:
    from navsim.report.figure_data import settled
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLUMN, new_figure
    from navsim.report.result_cells import setting

    fig = new_figure(2 * COLUMN, 4.8)
    axes = fig.subplots(2, 1, sharex=True)
    time = result["/time"]
    late = settled(time)
    top = np.zeros(2)
    for name in map(str, result["/filter"]):
        error, sigma = result[f"/filters/{name}/error"], result[f"/filters/{name}/sigma"]
        for i, ax in enumerate(axes):
            rmse = np.sqrt(np.mean(error[:, :, i] ** 2, axis=0))
            ax.plot(time, rmse, color=_COLOURS[name], label=f"{name}: {WORDS[name]}")
            ax.plot(time, sigma[:, i], color=_COLOURS[name], lw=0.6, ls=":")
            top[i] = max(top[i], rmse[late].max(initial=0.0), sigma[late, i].max(initial=0.0))
    runs = result["/run"].size
    for ax, label, highest in zip(axes, ("range", "range rate"), top, strict=True):
        for begin, end in setting(result, "circuit", "manoeuvre_s"):
            ax.axvspan(begin, end, color="#000000", alpha=0.06, lw=0)
        if highest > 0.0:
            ax.set_ylim(0.0, 1.08 * highest)
        ax.set_ylabel(f"{label} {'RMSE' if runs > 1 else 'error'}, {'m' if label == 'range' else 'm/s'}")
    title = f"{case_label(result['/case'][0])}, {f'{runs} runs' if runs > 1 else 'one run'}; dotted: σ of the filter"
    legend_above(fig, axes[0], 2, title)
    axes[1].set_xlim(time[0], time[-1])
    axes[1].set_xlabel("time, s; grey: manoeuvre")
    fig.align_ylabels(axes)
    return fig


def _ratios(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, narrow, new_figure

    fig = new_figure(2 * COLUMN, 3.1)
    ax = fig.subplots()
    names = [str(n).replace("_", " ") for n in result["/state"]]
    at = np.arange(len(names))
    ratios = result["/summary/decoupled_to_full"][:, 0, 0]
    cases = result["/case"]
    gap = 0.6 / cases.size
    for c, case in enumerate(cases):
        value, low, high = ratios[c].T
        ax.errorbar(
            at + gap * (c - 0.5 * (cases.size - 1)), value, yerr=[value - low, high - value],
            fmt="os^D"[c // len(COLOURS) % 4], ms=3, lw=0.8, color=COLOURS[c % len(COLOURS)],
            label=case_label(case),
        )  # fmt: skip
    ax.axhline(1.0, color="#777777", lw=0.6)
    ax.set_xticks(at, names, rotation=90 if narrow(fig) else 35, ha="center" if narrow(fig) else "right")
    ax.set_ylabel("RMSE, adapt / full, manoeuvre")
    legend_above(fig, ax, min(4, cases.size))
    return fig


def figures(result: Result) -> dict[str, Figure]:
    """RMSE over time of every filter; decoupled over full, state by state."""
    return {"errors": _errors(result), "ratios": _ratios(result)}


VIEW = View(one_by_one(tables), figures, ("/summary", "/limits", "/link"),
            drawings="navsim.companions.page:atcs", of_runs=("errors",))  # fmt: skip
