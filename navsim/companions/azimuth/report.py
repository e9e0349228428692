"""The azimuth study: errors by phase of flight, ratios, ages of reports, the map of where it pays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.report.table import Table, cell, interval, number
from navsim.report.view import View, one_by_one
from navsim.results.result import Result
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WORDS = {
    "L1": "the paper's (14) as printed",
    "L2": "tangential component", "L3": "rigorous, held", "L4": "rigorous, first-order hold",
    "L4 stamped": "L4, age of reports known", "L4 roll": "L4 from BDS 5,0 roll",
    "L4 track rate": "L4 from BDS 5,0 track rate", "L4 roll stamped": "L4 from roll, age known",
}  # fmt: skip
CLAIM = (1.5, 1.8)
"""The paper's claim: 1.5 to 1.8 times smaller errors."""
GROWTH = (1.5, 2.0)
"""The paper's claim about Singer's filter: errors 1.5 to 2 times larger in a manoeuvre."""


def tables(result: Result) -> list[Table | str]:
    """RMSE by phase, the claim, the sweep of ages, why the literal formula fails."""
    text = filter_labels(result)
    periods = result["/period"]
    parts: list[Table | str] = []
    for i, period in enumerate(periods):
        errors = Table(
            f"T = {period:g} s: azimuth RMSE, deg [95 %]",
            ("filter", "", "manoeuvre", "straight", "NIS, man. / straight"),
        )
        for f, name in enumerate(result["/filter"]):
            cells = [interval(values, 4) for values in result["/summary/rmse"][i, f]]
            nis = cell("{:.2f} / {:.2f}", *map(float, result["/summary/nis"][i, f]), names=("manoeuvre", "straight"))
            errors.add(str(name), text[str(name)], *cells, nis)
        parts.append(errors)
    claim = Table(
        f"The paper: {CLAIM[0]:g} to {CLAIM[1]:g} times smaller in the manoeuvre",
        ("T, s", "S1 / L4", "S2 / L4", "verdict"),
    )
    for i, period in enumerate(periods):
        values = result["/summary/ratio_to_l4"][i, :, 0]
        met = all(CLAIM[0] <= value <= CLAIM[1] for value in values[:, 0])
        verdict = "met by the rigorous acceleration" if met else "not met"
        claim.add(cell("{:g}", float(period)), *(interval(each, 3) for each in values), verdict)
    parts.append(claim)
    if "/summary/growth" in result:
        parts += _growth(result)
    ages = Table("L4 in the manoeuvre by age of reports, deg", ("T, s", "age, s", "unknown to the filter", "stamped"))
    for i, period in enumerate(periods):
        for j, late in enumerate(result["/latency"]):
            both = (number(x, 4) for x in result["/summary/latency_rmse"][i, j])
            ages.add(cell("{:g}", float(period)), cell("{:g}", float(late)), *both)
    parts.append(ages)
    rms = result["/summary/acceleration_rms"]
    than_zero = "more" if rms[0, 1] > rms[0, 0] else "less"
    parts.append(
        f"Why (14) as printed fails: it takes the north component for the tangential one and drops 2 Dh' az'. In the "
        f"manoeuvre azimuth'' is {rms[0, 0]:.4f} deg/s² rms and the error of (14) {rms[0, 1]:.4f}, {than_zero} than "
        f"that of assuming zero; that of the tangential component without Coriolis is {rms[0, 2]:.4f}. Mode S does not "
        "carry load factors: roll and track rate of BDS 5,0 do as well."
    )
    return parts


def growth_verdict(mean: float, peak: float, runs: int) -> str:
    """Verdict on the claim that errors grow in a manoeuvre, from the growth of the RMSE and of its largest value."""
    low, high = GROWTH
    if runs == 1 or not np.isfinite(mean):
        return "none from a single run"
    if mean > high:
        return "larger than claimed"
    if mean >= low:
        return "met"
    if peak < low:
        return "not met"
    return f"not met on average, {'met' if peak <= high else 'exceeded'} at the largest error"


def _growth(result: Result) -> list[Table | str]:
    """Singer's error in the manoeuvre over that on the straight stretch; the tunings for which the claim holds."""
    table = Table(
        f"The paper: Singer's error {GROWTH[0]:g} to {GROWTH[1]:g} times larger in the manoeuvre than straight [95 %]",
        ("T, s", "filter", "", "RMSE", "largest RMSE of a scan", "verdict"),
    )
    text = filter_labels(result)
    for i, period in enumerate(result["/period"]):
        for j, name in enumerate(map(str, result["/baseline"])):
            mean, peak = result["/summary/growth"][i, j], float(result["/summary/peak_growth"][i, j])
            verdict = growth_verdict(float(mean[0]), peak, result["/run"].size)
            table.add(cell("{:g}", float(period)), name, text[name], interval(mean, 3), number(peak, 2), verdict)
    if "/map/growth" not in result:
        return [table]
    sigmas = result["/map/singer_sigma"]
    tuned = Table(
        f"Singer's error {GROWTH[0]:g} to {GROWTH[1]:g} times larger in the manoeuvre: σ of the acceleration, m/s²",
        ("T, s", "from", "to", "growth at the largest and smallest σ tried"),
        notes="- where no σ tried gives it; interpolated in the logarithm of σ",
    )
    order = np.argsort(sigmas)
    for period, growth in zip(result["/map/scan_period"], result["/map/growth"], strict=True):
        # growth falls with sigma
        falling = growth[order][::-1]
        from_, to = (
            float(np.exp(np.interp(limit, falling, np.log(sigmas[order][::-1]), left=np.nan, right=np.nan)))
            for limit in reversed(GROWTH)
        )
        ends = cell("{:.2f}, {:.2f}", float(falling[0]), float(falling[-1]), names=("largest", "smallest"))
        tuned.add(cell("{:g}", float(period)), number(from_, 2), number(to, 2), ends)
    return [table, tuned]


def filter_labels(result: Result) -> dict[str, str]:
    """Description of each filter."""
    from navsim.report.result_cells import setting

    sigmas = setting(result, "filters", "singer_sigma_m_s2")
    return {name: f"Singer, {digits(sigma)} m/s²" for name, sigma in zip(("S1", "S2"), sigmas, strict=True)} | _WORDS


def _errors(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(2 * COLUMN, 3.6)
    ax = fig.subplots()
    time = result["/time"]
    colours = ("#999999", COLOURS[0], "#CC79A7", "#E69F00", COLOURS[1], COLOURS[2])
    text = filter_labels(result)
    for name, colour in zip(("S1", "S2", "L1", "L2", "L3", "L4"), colours, strict=True):
        error = result[f"/filters/{name}/error_deg"]
        ax.semilogy(time, np.sqrt(np.mean(error**2, axis=0)), color=colour, label=f"{name}: {text[name]}")
        ax.semilogy(time, result[f"/filters/{name}/sigma_deg"], color=colour, lw=0.6, ls=":")
    roll = result["/truth/roll"] != 0.0
    ax.fill_between(result["/truth/time"], 0, 1, where=roll, color="#000000", alpha=0.06, lw=0,
                    transform=ax.get_xaxis_transform())  # fmt: skip
    ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time, s; grey: turns")
    runs = result["/run"].size
    ax.set_ylabel(f"azimuth {'RMSE' if runs > 1 else 'error'}, deg")
    title = f"T = {result['/period'][0]:g} s, {f'{runs} runs' if runs > 1 else 'one run'}; dotted: σ of the filter"
    legend_above(fig, ax, 3, title)
    return fig


def shown_acceleration(result: Result) -> float:
    """Range of the azimuth accelerations in figures, 1e-3 deg/s2: close to the radar they are much larger."""
    most = 1.3e3 * float(np.percentile(np.abs(result["/truth/azimuth_acceleration"]), 95))
    return max(most, 1.1e3 * float(np.abs(result["/truth/azimuth_acceleration_literal"]).max()))


def _accelerations(result: Result) -> Figure:
    from navsim.report.figures import legend_over
    from navsim.report.printing import COLOURS, COLUMN, SMALL, new_figure

    fig = new_figure(COLUMN, 4.6)
    upper, lower = fig.subplots(2, 1, height_ratios=[3, 2])
    position = result["/truth/position"] / 1e3
    upper.plot(position[:, 2], position[:, 0], color=COLOURS[0])
    upper.plot(0, 0, "^", color=COLOURS[1])
    upper.annotate("radar", (0, 0), xytext=(-6, 0), textcoords="offset points", ha="right", va="center", fontsize=SMALL)
    upper.plot(position[0, 2], position[0, 0], "o", color=COLOURS[0], ms=3)
    upper.set_aspect("equal", adjustable="datalim")
    upper.set_xlabel("east, km")
    upper.set_ylabel("north, km")
    time = result["/truth/time"]
    lower.plot(time, 1e3 * result["/truth/azimuth_acceleration"], color=COLOURS[0], label="exact")
    lower.plot(time, 1e3 * result["/truth/azimuth_acceleration_literal"], color=COLOURS[1], label="the paper's (14)")
    reach = shown_acceleration(result)
    lower.set_ylim(-reach, reach)
    lower.set_xlabel("time, s")
    lower.set_ylabel("azimuth'', 10⁻³ deg/s²")
    legend_over(lower, 2)
    return fig


def _map(result: Result) -> Figure:
    from navsim.report.printing import COLUMN, SMALL, abreast, new_figure

    fig = new_figure(2 * COLUMN, 3.0)
    axes = abreast(fig, 2, sharey=True)
    period = result["/map/scan_period"]
    low, high = (f([f(result[n]) for n in ("/map/ratio", "/map/ratio_by_latency")]) for f in (np.min, np.max))
    image = None
    for ax, name, across, label in (
        (axes[0], "/map/ratio", result["/map/azimuth_sigma"], "σ of azimuth, deg"),
        (axes[1], "/map/ratio_by_latency", result["/map/report_age"], "age of reports, s"),
    ):
        values = result[name]
        image = ax.imshow(values, origin="lower", aspect="auto", cmap="viridis", vmin=low, vmax=high)
        for i in range(values.shape[0]):
            for j in range(values.shape[1]):
                inside = CLAIM[0] <= values[i, j] <= CLAIM[1]
                colour, weight = (
                    ("white" if values[i, j] < 0.5 * (low + high) else "black"),
                    ("bold" if inside else "normal"),
                )
                ax.text(
                    j, i, f"{values[i, j]:.2f}", ha="center", va="center", fontsize=SMALL, color=colour, weight=weight
                )
                if inside:
                    ax.add_patch(_box(j, i))
        ax.set_xticks(range(across.size), [f"{x:g}" for x in across])
        ax.set_xlabel(label)
        ax.grid(visible=False)
    for ax in axes:
        ax.set_yticks(range(period.size), [f"{x:g}" for x in period])
    axes[0].set_ylabel("scan period, s")
    if image is not None:
        fig.colorbar(image, ax=axes, label="RMSE of Singer / RMSE of L4")
    fig.suptitle(f"Above 1 load factors (L4) help; framed: the paper's claim, {CLAIM[0]:g} to {CLAIM[1]:g}")
    return fig


def _box(column: int, row: int):  # type: ignore[no-untyped-def]
    from matplotlib.patches import Rectangle

    return Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, fill=False, edgecolor="#D55E00", lw=1.4)


def figures(result: Result) -> dict[str, Figure]:
    """RMSE over time, the accelerations, the map."""
    out = {"errors": _errors(result), "accelerations": _accelerations(result)}
    if "/map/ratio" in result:
        out["map"] = _map(result)
    return out


VIEW = View(one_by_one(tables), figures, ("/summary", "/map"), drawings="navsim.companions.page:azimuths",
            of_runs=("errors",))  # fmt: skip
