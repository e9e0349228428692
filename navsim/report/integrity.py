"""Integrity figures: levels, limits and errors over time, and Stanford diagrams."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from navsim.report.figure_data import (
    ALARM,
    LEVELS,
    NO_FIX,
    Stanford,
    alarms,
    largest_errors,
    limit,
    limits_over_time,
    stanford_text,
    touchdown,
    whose,
)
from navsim.report.figure_data import stanford as counted
from navsim.report.figures import legend_above
from navsim.report.limits import level_lines, required_limits
from navsim.report.printing import COLOURS, COLUMN, SMALL, abreast, new_figure
from navsim.report.result_cells import runs_of
from navsim.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEVEL, _ERROR, _LIMIT = COLOURS[0], COLOURS[2], COLOURS[1]
_SKY = (COLOURS[0], COLOURS[2], COLOURS[4], COLOURS[5])
"""Colours of satellites by their clocks."""
_GIVEN = {"fix": "fix", "filter": "fix or source"}
"""Quantity that is missing if a run has an alert without an alarm."""


def levels(result: Result) -> Figure:
    """Protection levels over time, with their limits and the errors of the fixes, or of the filter."""
    fig = new_figure(2 * COLUMN, 4.4)
    axes = fig.subplots(2, 1, sharex=True)
    time = result["/integrity/time"]
    landed = touchdown(result)
    for ax, (axis, level, name) in zip(axes, LEVELS, strict=True):
        values = result[f"/integrity/{level}"]
        shown = [values]
        ax.plot(time, np.where(np.isfinite(values), values, np.nan), color=_LEVEL, label="protection level")
        if not np.isfinite(values).any():
            ax.text(0.5, 0.5, "no protection level", transform=ax.transAxes, ha="center", fontsize=SMALL)
        if np.isfinite(most := limit(result, name)):
            # broad, so that a required level of this size, drawn over it, does not hide it
            ends = limits_over_time(result, name)
            drawn = ax.axhline(most) if (ends == most).all() else ax.plot(time, ends)[0]
            drawn.set(color=_LIMIT, lw=2.6, alpha=0.5, label="alert limit", zorder=1.5)
            shown.append(ends)
        if axis == "horizontal":
            for name_of, ls in (("lateral", "--"), ("along", "-.")):
                if f"/integrity/level_{name_of}" in result:
                    of_axis = result[f"/integrity/level_{name_of}"]
                    known = np.where(np.isfinite(of_axis), of_axis, np.nan)
                    ax.plot(time, known, color=COLOURS[5], ls=ls, lw=0.8, label=f"level {name_of}")
        level_lines(ax, result, level)
        shown += [np.full(time.size, one.size) for one in required_limits(result, "level") if one.of == level]
        if f"/integrity/error_{axis}" in result:
            several = "largest error of all runs" if result["/run"].size > 1 else f"error of the {whose(result)}"
            largest = largest_errors(result, axis)
            ax.plot(time, largest, color=_ERROR, lw=0.6, label=several)
            shown.append(largest)
            for text, mark, code in (("alarm", "|", ALARM), (f"alert: no {_GIVEN[whose(result)]}", "x", NO_FIX)):
                there = alarms(result, code)
                if there.size:
                    ax.plot(time[there], np.zeros(there.size), mark, color=COLOURS[3], ms=5, label=text, clip_on=False)
        if np.isfinite(landed):
            ax.axvline(landed, color="#777777", lw=0.8, ls="--", label="touchdown")
        ax.set_ylim(bottom=0.0)
        # epochs after touchdown do not count
        judged = np.array(shown)[:, ~(time > landed)]
        if np.isfinite(judged).any():
            ax.set_ylim(top=1.1 * float(np.max(judged, where=np.isfinite(judged), initial=0.1)))
        ax.set_ylabel(f"{axis}, {whose(result)}, m")
    axes[-1].set_xlabel("time, s")
    fig.align_ylabels(axes)
    legend_above(fig, axes[0], 4, runs_of(result), axes[1])
    return fig


def stanford(result: Result) -> Figure:
    """Stanford diagram of the fixes, or of the filter, on the glide, without epochs with an alarm."""
    fig = new_figure(2 * COLUMN, 3.2)
    fig.set_layout_engine("compressed")  # square panels leave room otherwise
    axes = abreast(fig, 2)
    for ax, (axis, level, name) in zip(axes, LEVELS, strict=True):
        _diagram(ax, counted(result, axis, level, name))
        ax.set_xlabel(f"{axis} error of the {whose(result)}, m")
        ax.set_ylabel(f"{axis} protection level, m")
    fig.suptitle(stanford_text(result).replace("; ", "\n"))
    return fig


def _diagram(ax: Axes, of: Stanford) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.patheffects import withStroke

    edges, counts, most, top = of.edges, of.counts, of.limit, of.top
    if counts.any():
        picture = ax.pcolormesh(
            edges, edges, np.where(counts > 0.0, counts, np.nan).T, norm=LogNorm(1.0, max(2.0, counts.max())),
            cmap="viridis", rasterized=True,
        )  # fmt: skip
        ax.figure.colorbar(picture, ax=ax, label="epochs", fraction=0.05)
    else:
        ax.text(0.5, 0.5, "no levels", transform=ax.transAxes, ha="center", fontsize=SMALL)
    ax.plot([0.0, top], [0.0, top], color="#777777", lw=0.8)
    if np.isfinite(most):
        ax.axhline(most, color=_LIMIT, lw=0.8, ls="--")
        ax.axvline(most, color=_LIMIT, lw=0.8, ls="--")
        for x, y, name in _free(of):
            ax.text(
                x, y, name, fontsize=SMALL, ha="center", va="center", color="#555555",
                path_effects=[withStroke(linewidth=1.5, foreground="white")],
            )  # fmt: skip
    ax.set_xlim(0.0, top)
    ax.set_ylim(0.0, top)
    ax.set_box_aspect(1.0)


def _free(of: Stanford) -> list[tuple[float, float, str]]:
    """Positions for the names of the regions: inside them, where they cover the fewest epochs."""
    step = of.edges[1] - of.edges[0]
    places = np.arange(of.edges.size - 1)
    x, y = np.meshgrid((places + 0.5) * step, (places + 0.5) * step, indexing="ij")
    out = []
    for home_x, home_y, name in of.regions():
        best, least = (home_x, home_y), np.inf
        for dx, dy in itertools.product(np.linspace(-0.3, 0.3, 7) * of.limit, repeat=2):
            here = home_x + dx, home_y + dy
            if not of.within(name, *here) or not 0.2 * of.top < here[0] < 0.85 * of.top:
                continue
            covered = (np.abs(x - here[0]) < 0.22 * of.top) & (np.abs(y - here[1]) < 0.06 * of.top)
            count = float(of.counts[covered].sum()) + 1e-3 * float(np.hypot(dx, dy)) / of.top
            if count < least:
                best, least = here, count
        out.append((*best, name))
    return out


def interference(result: Result) -> Figure:
    """Effective carrier to noise density ratios over time, and when jammers send."""
    fig = new_figure(2 * COLUMN, 3.0)
    ax = fig.subplots()
    time, cn0 = result["/interference/time"], result["/interference/cn0"]
    pseudolites = set(map(str, result["/pseudolites/name"]))
    text: set[str] = set()
    clocks = str(result.variables["/geometry/clock"].attributes["clocks"]).split(", ")
    system = dict(zip(map(str, result["/geometry/source"]), result["/geometry/clock"].tolist(), strict=True))
    for i, name in enumerate(map(str, result["/interference/source"])):
        if np.isnan(cn0[:, i]).all():
            continue
        ground = name in pseudolites
        of_clock = system[name]
        label = "pseudolites" if ground else f"{clocks[of_clock]} satellites"
        colour = COLOURS[1] if ground else _SKY[of_clock % len(_SKY)]
        ax.plot(time, cn0[:, i], color=colour, ls="--" if ground else "-", label=None if label in text else label)
        text.add(label)
    for j, name in enumerate(map(str, result["/interference/jammer"])):
        heard = np.isfinite(result["/interference/js"][j]).any(axis=1)
        if name in pseudolites or not heard.any():
            continue
        ax.fill_between(
            time, 0.0, 1.0, where=heard.tolist(), transform=ax.get_xaxis_transform(), color=COLOURS[3 + j % 3],
            alpha=0.15, lw=0, label=f"{name} is received",
        )  # fmt: skip
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("time, s")
    ax.set_ylabel("effective C/N0, dB-Hz")
    legend_above(fig, ax, 4)
    return fig
