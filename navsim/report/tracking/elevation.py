"""The MLS elevation study: the audit, the proof and the nominal run as tables, and their figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.io.results import Result
from navsim.report.table import Table, cell, number
from navsim.report.tables import setting
from navsim.report.view import View, one_by_one

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BAND_WORDS = {
    "std_theory": "standard deviation within {} of the filter's",
    "std_sample": "the filter's within {} of the sample's",
    "variance": "variance within {} of the filter's",
}


def half_width(result: Result) -> float:
    """Half width of the band, as a share of the standard deviation."""
    return float(setting(result, "montecarlo", "band"))


def tables(result: Result) -> list[Table | str]:
    """Steady state, the bands with their exact chances, the nominal run, the audit of the paper."""
    p, k = result["/filter/steady_covariance"], result["/filter/steady_gain"]
    steady = Table("Filter in the limit", ("sd of beta, deg", "P11, deg2", "P12", "P22", "K1", "K2, 1/s"))
    values = (np.sqrt(p[0, 0]), p[0, 0], p[0, 1], p[1, 1], k[0], k[1])
    steady.add(*(cell("{:.6g}", float(value)) for value in values))

    runs, inside = int(result["/montecarlo/runs"]), result["/montecarlo/fraction_in_band"]
    proof = Table(
        f"Monte Carlo: {len(inside)} experiments of {runs} runs; share of steps with beta inside the band",
        ("band", "exact chance", "mean of experiments", "first experiment", "spread", "runs needed"),
    )
    for b, band in enumerate(result["/band"]):
        proof.add(
            _BAND_WORDS[str(band)].format(f"±{100 * half_width(result):g} %"),
            number(result["/band_theory/coverage"][b], 4),
            number(inside[:, b].mean(), 4),
            number(inside[0, b]),
            number(inside[:, b].std()),
            cell("{}", int(result["/band_theory/runs_needed"][b])),
        )
    nees, nis = float(result["/montecarlo/nees"]) / p.shape[0], float(result["/montecarlo/nis"])
    proof.add("NEES / states, NIS", "1", cell("{:.4f}, {:.4f}", nees, nis, names=("NEES", "NIS")))

    flown = Table(
        "Nominal approach, truth by closed forms (adequacy)",
        ("Q, (deg/s)²", "peak of the bias, deg", "at, s", "worst RMSE, deg"),
    )
    for i, q in enumerate(result["/nominal/rate_variance"]):
        flown.add(
            cell("{:.6g}", float(q)),
            number(result["/nominal/peak_bias"][i], 6),
            number(result["/nominal/peak_time"][i], 4),
            number(result["/nominal/worst_rmse"][i], 5),
        )

    checked = Table("The paper's numbers", ("statement", "published", "computed", "unit", "verdict"))
    for i, statement in enumerate(result["/audit/statement"]):
        both = [cell("{:.6g}", float(result[f"/audit/{which}"][i])) for which in ("published", "computed")]
        checked.add(str(statement), *both, str(result["/audit/unit"][i]), str(result["/audit/verdict"][i]))
    sure = float(setting(result, "montecarlo", "confidence"))
    note = (
        "Truth and filter share a model in the Monte Carlo: it proves the code, not that the model is adequate; the "
        f"nominal run does. Errors are correlated over steps, so a single experiment cannot confirm "
        f"a confidence of {sure:g}."
    )
    return [steady, proof, flown, checked, note]


def _approach(result: Result) -> Figure:
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(COLUMN, 4.0)
    axes = fig.subplots(3, 1, sharex=True)
    time = result["/approach/time"]
    starts = result["/approach/segment_start"]
    for ax, name, label in zip(
        axes, ("beta", "beta_rate", "beta_acceleration"), ("β, deg", "β', deg/s", "β'', deg/s²"), strict=True
    ):
        ax.plot(time, result[f"/approach/{name}"], color=COLOURS[0])
        ax.set_ylabel(label)
        for edge in starts[1:]:
            ax.axvline(edge, color="#777777", lw=0.6, ls="--")
    axes[0].set_title(", ".join(str(name) for name in result["/approach/segment"]))
    axes[-1].set_xlabel("time, s")
    fig.align_ylabels(axes)
    return fig


def _proof(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(COLUMN, 3.6)
    axes = fig.subplots(2, 1, sharex=True)
    share = half_width(result)
    period = float(result.variables["/step"].attributes["period_s"])
    time = result["/step"] * period
    for i, (ax, label) in enumerate(zip(axes, ("sd of β, deg", "sd of β', deg/s"), strict=True)):
        theory = np.sqrt(result["/filter/covariance"][:, i, i])
        sample = np.sqrt(result["/montecarlo/covariance"][:, i, i])
        ax.fill_between(
            time, (1.0 - share) * theory, (1.0 + share) * theory, color=COLOURS[1], alpha=0.2, lw=0,
            label=f"±{100 * share:g} %",
        )  # fmt: skip
        ax.plot(time, theory, color=COLOURS[1], label="filter")
        ax.plot(time, sample, color=COLOURS[0], lw=0.7, label=f"{int(result['/montecarlo/runs'])} runs")
        ax.set_ylim(0.0, 2.2 * theory[-1])
        ax.set_ylabel(label)
    legend_above(fig, axes[0], 3, "first experiment")
    axes[-1].set_xlabel("time, s")
    fig.align_ylabels(axes)
    return fig


def judged(result: Result) -> np.ndarray:
    """Which times of the nominal approach are judged: those after settling."""
    settling = float(result.variables["/nominal/time"].attributes["settling_s"])
    return result["/nominal/time"] >= float(setting(result, "nominal", "from_s")) + settling


def _nominal(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(COLUMN, 4.0)
    upper, lower = fig.subplots(2, 1, sharex=True)
    time = result["/nominal/time"]
    late = judged(result)
    for i, q in enumerate(result["/nominal/rate_variance"]):
        colour = COLOURS[i % len(COLOURS)]
        bias = result["/nominal/bias"][i]
        upper.plot(time[late], 1e3 * bias[late], color=colour, label=f"Q = {q:.3g} (deg/s)²")
        lower.plot(time[late], 1e3 * np.hypot(bias, result["/nominal/noise"][i])[late], color=colour)
    upper.set_ylabel("bias, 10⁻³ deg")
    lower.set_ylabel("RMSE, 10⁻³ deg")
    lower.set_ylim(bottom=0.0)
    lower.set_xlabel("time of the approach, s")
    legend_above(fig, upper, 2)
    fig.align_ylabels([upper, lower])
    return fig


def figures(result: Result) -> dict[str, Figure]:
    """The angle over the approach, the proof with its band, the nominal run."""
    return {"approach": _approach(result), "proof": _proof(result), "nominal": _nominal(result)}


_SUMMARY = ("/filter/steady", "/band_theory", "/montecarlo/fraction", "/nominal/worst", "/nominal/peak", "/audit")
VIEW = View(
    one_by_one(tables),
    140,
    figures,
    _SUMMARY,
    drawings="navsim.report.page.systems:elevations",
)
