"""Recorded ranges: their tables and figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.report.table import Cell, Table, cell, number, numbers
from navsim.report.view import View, one_by_one
from navsim.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def tables(result: Result) -> list[Table | str]:
    """Sources, errors against the reference, states, noise, geometry."""
    out: list[Table | str] = [_sources(result)]
    if (errors := _errors(result)) is not None:
        out.append(errors)
    return [*out, *_correlated_table(result), _noise(result), _geometry(result)]


def _sources(result: Result) -> Table:
    smoothed = "/smoother/position" in result
    table = Table(
        f"Ranges by source (residuals of the {'smoother' if smoothed else 'filter'})",
        ("source", "ranges", "outliers", "range sigma, m", "wander, m", "residual RMS, m", "NIS", "lag-1"),
        notes="outliers: ranges with probably more than the usual noise; the other columns omit them",
    )
    for i, name in enumerate(result["/source"]):
        counts = [cell("{}", int(result[f"/summary/{what}"][i])) for what in ("ranges", "outliers")]
        sigmas = [number(result[f"/noise/source_{what}_sigma"][i], 3) for what in ("range", "wander")]
        statistics = [
            number(result[f"/summary/{what}"][i], digits)
            for what, digits in (("residual_rms", 3), ("nis", 2), ("lag1", 2))
        ]
        table.add(str(name), *counts, *sigmas, *statistics)
    table.add(
        "all", cell("{}", int(result["/summary/ranges"].sum())), cell("{}", int(result["/summary/outliers"].sum())),
        "", "", number(float(result["/summary/residual_rms_all"]), 3), number(float(result["/summary/nis_all"]), 2), "",
    )  # fmt: skip
    return table


def _errors(result: Result) -> Table | None:
    if "/summary/filter_error_rms" not in result:
        return None
    offset = float(result["/reference/time_offset"])
    table = Table(
        "Errors against the reference, m",
        ("", "horizontal RMS", "z", "vertical RMS", "z", "mean x y z"),
        notes=f"z: RMS of error over sigma, true between 0.8 and 1.25; reference times moved by {offset:+.3f} s",
    )
    for name in ("filter", "smoother"):
        if f"/summary/{name}_error_rms" not in result:
            continue
        rms, z, mean = (result[f"/summary/{name}_error_{what}"] for what in ("rms", "z", "mean"))
        table.add(
            name, number(float(np.hypot(rms[0], rms[1])), 2), number(float(np.sqrt(np.mean(z[:2] ** 2))), 2),
            number(rms[2], 2), number(z[2], 2), numbers(mean, 2, ("x", "y", "z")),
        )  # fmt: skip
    return table


def _correlated_table(result: Result) -> list[Table | str]:
    """Clocks or biases, at the end."""
    names = [str(name) for name in result["/states/state"]]
    values, sigma = result["/states/value"], result["/states/sigma"]

    def with_sigma(name: str, digits: int) -> Cell | str:
        if name not in names:
            return ""
        k = names.index(name)
        return Cell(
            f"{{:+.{digits}f}} ± {{:.{digits}f}}",
            (float(values[k]), float(sigma[k])),
            whole=True,
            names=("value", "sigma"),
        )

    not_seen = "-: the ranges do not show it"
    if "/clocks/clock" in result:
        datum = str(result.attributes["datum"])
        table = Table(
            f"Clocks against that of {datum}, at the end",
            ("clock", "offset, m", "rate, m/s", "mean rate, m/s"),
            notes=f"only differences of clocks can be observed; the datum is {datum}. {not_seen}",
        )
        for k, name in enumerate(map(str, result["/clocks/clock"])):
            table.add(
                name, with_sigma(f"clock offset {name}", 2), with_sigma(f"clock rate {name}", 4),
                number(result["/clocks/mean_rate"][k], 4),
            )  # fmt: skip
        return [table]
    growing = any(name.startswith("bias growth") for name in names)
    table = Table(
        "Biases of the ranges", ("source", "bias, m", *(("growing part, m",) if growing else ())), notes=not_seen
    )
    for name in map(str, result["/source"]):
        table.add(name, with_sigma(f"bias {name}", 3), *((with_sigma(f"bias growth {name}", 3),) if growing else ()))
    return [table]


def _noise(result: Result) -> Table:
    table = Table("Noise", ("setting", "value", "unit", "from"))
    for name, value, units, tuned in zip(
        *(result[f"/noise/{what}"] for what in ("setting", "value", "units", "tuned")), strict=True
    ):
        table.add(str(name).replace("_", " "), cell("{:.3g}", float(value)), str(units), "tuned" if tuned else "file")
    return table


def _geometry(result: Result) -> Table:
    two_way = str(result.attributes["measurement"]) == "two_way"
    table = Table(
        f"Dilution of precision ({'without' if two_way else 'with'} a clock)", ("", "median", "95 %"),
    )  # fmt: skip
    for name in ("position", "horizontal", "vertical"):
        values = result[f"/dop/{name}"]
        table.add(name, *(number(float(np.percentile(values, p)), 2) for p in (50.0, 95.0)))
    return table


def _figure(height: float, rows: int):  # type: ignore[no-untyped-def]
    from navsim.report.printing import COLUMN, new_figure

    fig = new_figure(2 * COLUMN, height)
    return fig, np.atleast_1d(fig.subplots(rows, 1, sharex=True))


def _track(result: Result) -> Figure:
    from navsim.report.figures import label_points, legend_above
    from navsim.report.printing import COLOURS, COLUMN, abreast, new_figure

    fig = new_figure(2 * COLUMN, 3.6)
    plan, profile = abreast(fig, 2, width_ratios=[3, 2])
    time, sources = result["/time"], result["/sources/position"]
    if "/reference/position" in result:
        true = result["/reference/position"]
        plan.plot(true[:, 0], true[:, 1], color="0.6", lw=2.0, label="reference")
        profile.plot(time, true[:, 2], color="0.6", lw=2.0)
    for name, colour in (("filter", COLOURS[1]), ("smoother", COLOURS[0])):
        if f"/{name}/position" in result:
            position = result[f"/{name}/position"]
            plan.plot(position[:, 0], position[:, 1], color=colour, lw=0.8, label=name)
            profile.plot(time, position[:, 2], color=colour, lw=0.8)
    plan.plot(sources[:, 0], sources[:, 1], "^", ls="", color=COLOURS[3], label="sources")
    label_points(plan, result["/source"], sources[:, 0], sources[:, 1])
    east, north, up = axis_names(result)
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel(f"{east}, m")
    plan.set_ylabel(f"{north}, m")
    profile.set_xlabel("time, s")
    profile.set_ylabel(f"{up}, m")
    legend_above(fig, plan, 4)
    return fig


def axis_names(result: Result) -> tuple[str, str, str]:
    """Names of the axes of positions."""
    return ("east", "north", "up") if "/sources/origin_llh" in result else ("x", "y", "z")


def _residuals(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS

    names = result["/source"]
    fig, axes = _figure(min(1.1 * len(names) + 0.6, 9.0), len(names))
    usual = result["/ranges/weight"] > 0.5
    within = np.abs(result["/ranges/residual"][usual])
    reach = 1.3 * float(np.percentile(within, 99)) if within.size else 1.0
    for i, (ax, name) in enumerate(zip(axes, names, strict=True)):
        here = result["/ranges/source_index"] == i
        time, residual = result["/ranges/time"][here], result["/ranges/residual"][here]
        good = usual[here]
        ax.plot(time[good], residual[good], ".", ms=2, color=COLOURS[0], label="usual noise")
        ax.plot(
            time[~good],
            np.clip(residual[~good], -reach, reach),
            "x",
            ms=4,
            color=COLOURS[3],
            label="outliers (at the edge: beyond)",
        )
        ax.set_ylim(-1.05 * reach, 1.05 * reach)
        ax.set_ylabel(f"{name}, m")
    axes[-1].set_xlabel("time, s")
    legend_above(fig, axes[0], 2, "residuals of the ranges")
    fig.align_ylabels(list(axes))
    return fig


def _error_figure(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS

    fig, axes = _figure(4.2, 3)
    time, true = result["/time"], result["/reference/position"]
    for name, colour in (("filter", COLOURS[1]), ("smoother", COLOURS[0])):
        if f"/{name}/position" not in result:
            continue
        error = result[f"/{name}/position"] - true
        sigma = result[f"/{name}/position_sigma"]
        for k, ax in enumerate(axes):
            ax.fill_between(time, -sigma[:, k], sigma[:, k], color=colour, alpha=0.15, lw=0, label=f"±1σ, {name}")
            ax.plot(time, error[:, k], color=colour, lw=0.8, label=name)
    for ax, axis in zip(axes, axis_names(result), strict=True):
        ax.set_ylabel(f"error {axis}, m")
    axes[-1].set_xlabel("time, s")
    legend_above(fig, axes[0], 4)
    fig.align_ylabels(list(axes))
    return fig


def _clock_figure(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import style

    fig, axes = _figure(3.2, 2)
    shown = [k for k, name in enumerate(map(str, result["/clocks/clock"])) if name != "receiver"]
    for i, k in enumerate(shown):
        label = str(result["/clocks/clock"][k])
        for ax, what in zip(axes, ("offset", "rate"), strict=True):
            ax.plot(result["/time"], result[f"/clocks/{what}"][:, k], **style(i), label=label)
    axes[0].set_ylabel("offset, m")
    axes[1].set_ylabel("rate, m/s")
    axes[1].set_xlabel(f"time, s; datum: {result.attributes['datum']}")
    legend_above(fig, axes[0], 4)
    return fig


def figures(result: Result) -> dict[str, Figure]:
    """Track with the sources, residuals by source, errors with sigma, clocks."""
    out = {"track": _track(result), "residuals": _residuals(result)}
    if "/summary/filter_error_rms" in result:
        out["errors"] = _error_figure(result)
    if "/clocks/clock" in result and len(result["/clocks/clock"]) > 1:
        out["clocks"] = _clock_figure(result)
    return out


VIEW = View(
    one_by_one(tables),
    figures,
    ("/summary", "/noise", "/states", "/mirror"),
    drawings="navsim.ranging.page:recorded_ranges",
)
