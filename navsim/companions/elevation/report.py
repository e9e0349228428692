"""The MLS elevation study: the audit, the proof and the nominal run as tables, and their figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from navsim.report.result_cells import setting
from navsim.report.table import Table, cell, number
from navsim.report.view import View, one_by_one
from navsim.results.result import Result
from navsim.statistics.rounding import digits

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

    more: list[Table | str] = []
    if "/order/filter" in result:
        more = [*_orders(result), *_criterion(result), _limits(result), _channels(result), _flare(result)]

    checked = Table("The paper's numbers", ("statement", "published", "computed", "unit", "verdict"))
    for i, statement in enumerate(result["/published/statement"]):
        both = [cell("{:.6g}", float(result[f"/published/{which}"][i])) for which in ("published", "computed")]
        checked.add(str(statement), *both, str(result["/published/unit"][i]), str(result["/published/verdict"][i]))
    sure = float(setting(result, "montecarlo", "confidence"))
    note = (
        "Truth and filter share a model in the Monte Carlo: it proves the code, not that the model is adequate; the "
        f"nominal run does. Errors are correlated over steps, so a single experiment cannot confirm "
        f"a confidence of {sure:g}."
    )
    return [steady, proof, flown, *more, checked, note]


def order_verdict(peak: float, recovery: float) -> str:
    """Verdict on the paper's claim of a first-order filter.

    It uses the filter's largest bias and the settling time of its bias after glide-slope capture, each relative to the
    second-order filter.
    """
    errors = "larger dynamic error" if peak > 1.0 else "no larger dynamic error"
    if not np.isfinite(recovery):
        return errors
    slow = "slower" if recovery > 1.0 else "not slower"
    return f"{'as claimed' if peak > 1.0 and recovery > 1.0 else 'not as claimed'}: {errors}, {slow}"


def _orders(result: Result) -> list[Table | str]:
    table = Table(
        "First-order and second-order filter on the nominal approach",
        ("filter", "Q over a period", "sd in the limit, deg", "bias before the capture, deg",
         "largest bias, deg", "settled after, s", "worst RMSE, deg", "the paper's claim"),
        notes="settled: the bias stays below a tenth of its largest value after the capture of the glide; "
        "Q: (deg/s)² of the rate in a second-order filter, deg² of the angle in a first-order one",
    )  # fmt: skip
    peak, recovery = np.abs(result["/order/peak_bias"]), result["/order/recovery"]
    for i, name in enumerate(result["/order/filter"]):
        verdict = order_verdict(float(peak[i] / peak[0]), float(recovery[i] / recovery[0])) if i else ""
        table.add(
            str(name), cell("{:.4g}", float(result["/order/variance"][i])), number(result["/order/sigma"][i], 5),
            number(result["/order/before"][i], 5), number(result["/order/peak_bias"][i], 5),
            number(recovery[i], 2), number(result["/order/worst_rmse"][i], 5), verdict,
        )  # fmt: skip
    return [
        table,
        "The paper: a first-order filter has considerable dynamic errors and settles slowly. Rate white: Q is the "
        "table's variance of the rate times T². Same sigma: the gain of the second-order filter. Least error: the gain "
        "of the smallest RMSE at the largest rate of the approach.",
    ]


MUCH = 10.0
"""A criterion "much larger" holds from this ratio on."""


def criterion_verdict(period: float, memory: float) -> str:
    """Verdict on sigma >> 1/2 T^2 beta'', from the ratios for the period and for the filter's memory."""
    if memory >= MUCH:
        return "met, also over the filter's memory"
    return "met over a period, not over the filter's memory" if period >= MUCH else "not met"


def _criterion(result: Result) -> list[Table | str]:
    measured, memory = float(result["/criterion/sigma"]), float(result["/criterion/memory"])
    sigma, period = float(result["/order/sigma"][0]), float(result.variables["/step"].attributes["period_s"])
    table = Table(
        f"The criterion σ ≫ ½T²β''max for a second-order filter: σ = {measured:g} deg, T = {period:g} s",
        ("part", "β''max, deg/s²", "½T²β'', deg", "σ over it", f"½T²β'' with T = {memory:.3f} s, deg",
         f"σ of the filter, {sigma:.4f} deg, over it", "verdict"),
    )  # fmt: skip
    for i, name in enumerate(result["/criterion/stretch"]):
        acceleration = float(result["/criterion/acceleration"][i])
        errors = (float(result[f"/criterion/{which}_error"][i]) for which in ("period", "memory"))
        if acceleration < _NO_ACCELERATION:
            table.add(str(name), number(0.0, 6), "", "", "", "", "met: the angle has no acceleration")
            continue
        of_period, of_memory = errors
        ratios = measured / of_period, sigma / of_memory
        table.add(
            str(name), cell("{:.4g}", acceleration), cell("{:.4g}", of_period), cell("{:.3g}", ratios[0]),
            cell("{:.4g}", of_memory), cell("{:.3g}", ratios[1]), criterion_verdict(*ratios),
        )  # fmt: skip
    return [
        table,
        f"T is the paper's interval of extrapolation: one period. The filter remembers longer, {memory:.3f} s in the "
        f"limit; σ there is that of its angle. Neither sees the corner at the capture of the glide, where β' jumps: it "
        f"leaves the bias of {abs(float(result['/order/peak_bias'][0])):.4f} deg of the table above.",
    ]


_NO_ACCELERATION = 1e-12
"""Accelerations of the angle below this are rounding, deg/s2."""


def _limits(result: Result) -> Table:
    table = Table(
        "The exact model by T/τ: differences from its limits",
        ("τ, s", "T/τ", "A from constant velocity", "A from constant acceleration", "Q from a white acceleration",
         "noise, share of σ²", "P11 over the paper's model", "nearer limit of A"),
        notes="A: last column as shares of T²/2, T, 1; Q: of angle and rate, largest relative difference; "
        "T/τ → ∞: the first and third go to 0, T/τ → 0: the second and the noise",
    )  # fmt: skip
    for i, tau in enumerate(result["/limit/correlation_time"]):
        velocity, acceleration, white, drive, angle = (
            float(result[f"/limit/{name}"][i])
            for name in ("to_velocity", "to_acceleration", "to_white", "drive", "angle")
        )
        table.add(
            cell("{:g}", float(tau)), cell("{:.4g}", float(result["/limit/ratio"][i])), number(velocity, 4),
            number(acceleration, 4), number(white, 4), number(drive, 4), number(angle, 4),
            "constant velocity" if velocity < acceleration else "constant acceleration",
        )  # fmt: skip
    return table


def _channels(result: Result) -> Table:
    table = Table(
        "Azimuth and elevation on the nominal approach",
        ("channel", "rate, Hz", "Q, (deg/s)²", "sd in the limit, deg", "largest bias, deg", "at, s",
         "worst RMSE, deg"),
        notes="elevation: capture of the glide; azimuth: turn onto the centre line, seen from beyond the runway",
    )  # fmt: skip
    for place, name, section in (("/nominal", "elevation", "filter"), ("/azimuth", "azimuth", "azimuth")):
        for i, q in enumerate(result[f"{place}/rate_variance"]):
            table.add(
                name, number(1.0 / float(setting(result, section, "period_s")), 1), cell("{:.6g}", float(q)),
                number(result[f"{place}/steady_sigma"][i], 5), number(result[f"{place}/peak_bias"][i], 5),
                number(result[f"{place}/peak_time"][i], 2), number(result[f"{place}/worst_rmse"][i], 5),
            )  # fmt: skip
    return table


def _flare(result: Result) -> Table:
    allowed = float(setting(result, "flare", "allowed_deg"))
    table = Table(
        f"The flare guided from beyond the runway; the paper allows {allowed:g} deg at touchdown",
        ("guided by", "Q, (deg/s)²", "σ of one measurement, start and touchdown, deg", "largest bias, deg",
         "RMSE at touchdown, deg", "in height, m", "verdict"),
    )  # fmt: skip
    for i, name in enumerate(result["/flare/source"]):
        measured = result["/flare/measured_sigma"][i]
        ends = cell("{:.5f}, {:.5f}", float(measured[0]), float(measured[-1]), names=("start", "touchdown"))
        for j, q in enumerate(result["/flare/rate_variance"]):
            rmse = float(result["/flare/touchdown_rmse"][i, j])
            table.add(
                str(name), cell("{:.6g}", float(q)), ends, number(result["/flare/peak_bias"][i, j], 5),
                number(rmse, 5), number(result["/flare/touchdown_height_rmse"][i, j], 3),
                "within" if rmse <= allowed else "beyond",
            )  # fmt: skip
    return table


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
    """Times of the nominal approach after settling."""
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
        upper.plot(time[late], 1e3 * bias[late], color=colour, label=f"Q = {digits(q)} (deg/s)²")
        lower.plot(time[late], 1e3 * np.hypot(bias, result["/nominal/noise"][i])[late], color=colour)
    upper.set_ylabel("bias, 10⁻³ deg")
    lower.set_ylabel("RMSE, 10⁻³ deg")
    lower.set_ylim(bottom=0.0)
    lower.set_xlabel("time of the approach, s")
    legend_above(fig, upper, 2)
    fig.align_ylabels([upper, lower])
    return fig


def _two_panels(curves: Sequence[Curve], titles: tuple[str, str]) -> Figure:
    """Curves in two panels above each other, each with its keys."""
    from navsim.report.figures import legend_over
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(2 * COLUMN, 5.0)
    axes = fig.subplots(2, 1)
    for panel, ax in enumerate(axes):
        inside = [curve for curve in curves if curve.panel == panel]
        for i, curve in enumerate(inside):
            ax.plot(curve.time, curve.values, color=COLOURS[i % len(COLOURS)], label=curve.name)
        ax.set_ylabel(f"{titles[panel]}, 10⁻³ deg")
        ax.set_xlabel("time of the approach, s")
        legend_over(ax, 2)
    fig.align_ylabels(axes)
    return fig


@dataclass(frozen=True)
class Curve:
    """A curve of a figure with two panels: values (t,) over time (t,), in 1e-3 deg."""

    panel: int
    time: np.ndarray
    values: np.ndarray
    name: str


ORDER_TITLES, CHANNEL_TITLES = ("bias", "RMSE"), ("RMSE of the azimuth", "RMSE in the flare")


def order_curves(result: Result) -> list[Curve]:
    """Bias and root mean square error of the second-order and the first-order filters, after settling."""
    late = judged(result)
    out = []
    for i, name in enumerate(map(str, result["/order/filter"])):
        bias, noise = result["/order/bias"][i, late], result["/order/noise"][i, late]
        time = result["/order/time"][late]
        out += [Curve(0, time, 1e3 * bias, name), Curve(1, time, 1e3 * np.hypot(bias, noise), name)]
    return out


def channel_curves(result: Result) -> list[Curve]:
    """Root mean square error of the azimuth, and of the angle in the flare by guidance source, after settling."""
    settling = float(result.variables["/nominal/time"].attributes["settling_s"])
    out = []
    time = result["/azimuth/time"]
    late = time >= float(setting(result, "azimuth", "from_s")) + settling
    for i, q in enumerate(result["/azimuth/rate_variance"]):
        rmse = np.hypot(result["/azimuth/bias"][i], result["/azimuth/noise"][i])
        out.append(Curve(0, time[late], 1e3 * rmse[late], f"Q = {digits(q)} (deg/s)²"))
    time = result["/flare/time"]
    late = time >= time[0] + settling
    for i, name in enumerate(map(str, result["/flare/source"])):
        rmse = np.hypot(result["/flare/bias"][i, 0], result["/flare/noise"][i, 0])
        out.append(Curve(1, time[late], 1e3 * rmse[late], name))
    return out


def figures(result: Result) -> dict[str, Figure]:
    """The angle over the approach, the proof with its band, the nominal run; first-order filters, azimuth and flare."""
    out = {"approach": _approach(result), "proof": _proof(result), "nominal": _nominal(result)}
    if "/order/filter" in result:
        out["orders"] = _two_panels(order_curves(result), ORDER_TITLES)
        out["channels"] = _two_panels(channel_curves(result), CHANNEL_TITLES)
    return out


_SUMMARY = ("/filter/steady", "/band_theory", "/montecarlo/fraction", "/nominal/worst", "/nominal/peak", "/order/worst",
            "/order/peak", "/criterion", "/limit", "/azimuth/worst", "/flare/touchdown", "/published")  # fmt: skip
VIEW = View(
    one_by_one(tables),
    figures,
    _SUMMARY,
    drawings="navsim.companions.page:elevations",
)
