"""Figures of a landing result, fit for a paper: labels, units, no letter under 7 points at the width they are drawn.

Every figure function takes a result and returns a matplotlib Figure; `save` writes them all as PNG.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from navsim.report.budget_rows import source_title
from navsim.report.figure_data import (
    ellipse,
    first_runs,
    followed_by,
    in_runway_axes,
    rms_over_runs,
    settled,
    shares,
    some_fix_errors,
    state_ratios,
    touchdown,
    true_for,
)
from navsim.report.figure_files import remove_former
from navsim.report.label_placement import LabelPosition, Letters, Rectangle
from navsim.report.limits import gates, rms_lines, within_sight, word
from navsim.report.printing import (
    COLOURS,
    COLUMN,
    SMALL,
    Print,
    content,
    fit,
    legend,
    named_handles,
    new_figure,
    printed,
)
from navsim.report.result_cells import runs_of, setting, single
from navsim.report.ridges import BROWN, ShownRidge, clipped, flown_over, on_plan, shown_ridges, terrain_skyline
from navsim.report.sky import REACH, RINGS, SHADE, WRITTEN, bearings, masked, shaded, sides, source_tracks
from navsim.results.result import Result, ResultError, write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BLUE, _ORANGE, _GREEN = COLOURS[:3]
_GREY = "#777777"
_MOST_POINTS = 5000
_LETTERS = Letters(5.0, 8.0, 4.2)
"""Points of a mark, a line of small letters, and one of them."""


def legend_above(figure: Figure, axes: Axes, columns: int, title: str | None = None, *more: Axes) -> None:
    """Legend of `axes`, and of additional items, above the whole figure."""
    named = named_handles((axes, *more))
    legend(figure, list(named.values()), list(named), columns, "outside upper center", title)


def legend_below(figure: Figure, axes: Axes, columns: int) -> None:
    """Legend of `axes` below the whole figure."""
    named = named_handles((axes,))
    legend(figure, list(named.values()), list(named), columns, "outside lower center")


def legend_over(ax: Axes, columns: int) -> None:
    """A legend on top of one of several panels."""
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, borderaxespad=0.2)


def label_points(ax: Axes, names: Iterable[object], x: np.ndarray, y: np.ndarray) -> None:
    """Labels of points, each on the side where it overlaps least with other points and labels."""
    text = [str(name) for name in names]
    places = [(right, -up) for right, up in on_page(ax, x, y).tolist()]
    corners = ax.get_window_extent().get_points() * 72.0 / ax.figure.dpi
    paper = Rectangle(corners[0, 0], corners[1, 0], -corners[1, 1], -corners[0, 1])
    write_names(ax, text, x, y, _LETTERS.sides(places, text, (), paper))


def write_names(
    ax: Axes, names: Iterable[str], x: Iterable[float], y: Iterable[float], sides: Iterable[LabelPosition]
) -> None:
    """Labels of points at given positions, points of the page."""
    from matplotlib.patheffects import withStroke

    for name, right, up, side in zip(names, x, y, sides, strict=True):
        ax.annotate(
            name, (right, up), xytext=(side.right, -side.down), textcoords="offset points", ha=side.align,
            va="center_baseline", fontsize=SMALL, path_effects=[withStroke(linewidth=1.5, foreground="white")],
            annotation_clip=False,
        )  # fmt: skip


def on_page(ax: Axes, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Positions of data (n,) on the page, points (n, 2)."""
    return ax.transData.transform(np.column_stack([x, y])) * 72.0 / ax.figure.dpi


def view_from_above(plan: Axes) -> None:
    """Turn the axis of distances right of the runway downwards. The landing direction points to the right of the page,
    so the plan is a view from above and not its mirror image."""
    plan.yaxis.set_inverted(True)


def ridge_lines(ax: Axes, ridges: Iterable[ShownRidge], along: tuple[float, float], right: tuple[float, float]) -> None:
    """Draw ridges within a part of a plan seen from above (from and to, m) with their heights."""
    label: str | None = "terrain, height of its top"
    for ridge in ridges:
        parts = clipped(ridge, along, right)
        for part in parts:
            ax.plot(*part.T, color=BROWN, lw=1.6, solid_capstyle="butt", label=label)
            label = None
        if len(parts):
            ends = parts.reshape(-1, 2)
            x, y = ends[np.argmin(ends[:, 1])]
            down = y < right[0] + 0.1 * (right[1] - right[0])  # a title is above the border
            word(ax, ridge.label, (float(x), float(y)), (4.0, -3.0) if down else (0.0, 2.0),
                 ha="left" if down else "center", va="top" if down else "bottom", color=BROWN)  # fmt: skip


def _in_brackets(result: Result) -> str:
    text = true_for(result)
    return f" ({text})" if text else ""


def track(result: Result) -> Figure:
    """Plan view with pseudolites, beacons and ground stations, and the height profile over the same distances."""
    fig = new_figure(2 * COLUMN, 3.8)
    plan, profile = fig.subplots(2, 1, height_ratios=[3, 2], sharex=True)
    path = in_runway_axes(result, result["/truth/position_llh"])
    length = setting(result, "runway", "length_m")
    width = setting(result, "runway", "width_m")
    plan.fill([0, length, length, 0], [-width / 2, -width / 2, width / 2, width / 2], color=_GREY, lw=0)
    plan.plot([0, length], [0, 0], color=_GREY, lw=2.5, solid_capstyle="butt", alpha=0.6, label="runway")
    plan.plot(path[:, 0], path[:, 1], color=_BLUE, label="aircraft" + _in_brackets(result))
    plan.plot(path[0, 0], path[0, 1], "o", color=_BLUE, ms=3)
    ground = {}
    marks = {"pseudolites": ("^", _ORANGE), "beacons": ("s", _GREEN), "stations": ("D", "#882255")}
    for kind in marks:
        if f"/{kind}/name" in result and result[f"/{kind}/name"].size:
            ground[kind] = result[f"/{kind}/name"], in_runway_axes(result, result[f"/{kind}/position_llh"])
    for kind, (_, places) in ground.items():
        mark, own = marks[kind]
        plan.plot(places[:, 0], places[:, 1], mark, color=own, ms=5, label=kind)
    seen = np.concatenate([path[:, :2], *(places[:, :2] for _, places in ground.values())])
    ridge_lines(plan, shown_ridges(result), *on_plan(seen))
    for over in flown_over(result):
        profile.plot([over.along, over.along], [0.0, over.top], color=BROWN, lw=1.6)
        word(profile, over.label, (over.along, over.top), (0.0, 2.0), ha="center", va="bottom", color=BROWN)
    plan.margins(0.06, 0.15)
    view_from_above(plan)
    if ground:
        names, places = (np.concatenate(parts) for parts in zip(*ground.values(), strict=True))
        label_points(plan, names, places[:, 0], places[:, 1])
    plan.set_ylabel("right of the axis, m")
    legend_above(fig, plan, 3)

    profile.plot(path[:, 0], path[:, 2], color=_BLUE)
    landed = touchdown(result)
    if np.isfinite(landed):
        at = np.interp(landed, result["/truth/time"], path[:, 0])
        profile.axvline(at, color=_ORANGE, lw=0.8, ls="--")
        profile.annotate("touchdown", (at, 0.85), xycoords=("data", "axes fraction"), xytext=(4, 0),
                         textcoords="offset points", color=_ORANGE, fontsize=SMALL)  # fmt: skip
    profile.set_xlabel("beyond the threshold (= -l1), m")
    profile.set_ylabel("height above the threshold, m")
    fig.align_ylabels([plan, profile])
    return fig


def sky(result: Result) -> Figure:
    """Sky plot of all sources over the approach, used and unused, with mask, horizon and terrain."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle, Patch, Wedge

    fig = new_figure(COLUMN, COLUMN)
    wide = min(fig.get_figwidth(), 1.25 * COLUMN)
    fig.set_figheight(wide + 0.3)
    ax = fig.subplots()
    ax.set_axis_off()
    ax.set_aspect("equal")
    sources, edge = source_tracks(result)
    ax.set_xlim(-REACH * edge, REACH * edge)
    ax.set_ylim(-REACH * edge, REACH * edge)
    shade: dict[str, Any] = {"color": _GREY, "alpha": SHADE, "lw": 0.0}
    for west, east, low, high in masked(result, edge):
        if high > low:
            last = east if east > west else east + 360.0
            ax.add_patch(Wedge((0.0, 0.0), 90.0 - low, 90.0 - last, 90.0 - west, width=high - low, **shade))
    mask = float(setting(result, "sky", "mask_deg"))
    ax.add_patch(Circle((0.0, 0.0), 90.0 - mask, fill=False, color="black", lw=0.7, ls="--"))
    if "/geometry/horizon" in result:
        ax.fill(*shaded(result["/geometry/bearing"], result["/geometry/horizon"], mask), **shade)
    terrain = terrain_skyline(result)
    if terrain is not None:
        ax.fill(*shaded(*terrain, mask), **shade | {"color": BROWN, "alpha": 0.45})
    for ring in RINGS:
        ax.add_patch(Circle((0.0, 0.0), ring, fill=False, color=_GREY, lw=0.4, alpha=0.6))
        up = 3.0 if ring < edge else -5.0  # bearings are outside
        ax.annotate(f"{90.0 - ring:g}°", (0.0, ring), xytext=(2.0, up), textcoords="offset points", fontsize=SMALL,
                    va="center_baseline")  # fmt: skip
    for text, s, c in bearings():
        ax.plot([0.0, edge * s], [0.0, edge * c], color=_GREY, lw=0.4, alpha=0.5)
        ax.text(WRITTEN * edge * s, WRITTEN * edge * c, text, ha="center", va="center_baseline", fontsize=SMALL)
    for each in sources:
        own, mark = (_ORANGE, "^") if each.ground else (_BLUE, "o")
        ax.plot(*each.part(False), color=_GREY, lw=1.0, ls=":")
        ax.plot(*each.part(True), color=own, lw=1.0)
        ax.plot(each.x[each.last], each.y[each.last], mark, **_sky_mark(each.share, own))
    if sources:
        x, y, names = zip(*((e.x[e.last], e.y[e.last], e.name) for e in sources), strict=True)
        write_names(ax, names, x, y, sides(x, y, names, edge, 72.0 * wide - 8.0, _LETTERS))
    keys = {"pseudolite" if each.ground else "satellite": each.ground for each in sources}
    handles: dict[str, Any] = {}
    for what, ground in keys.items():
        own, mark = (_ORANGE, "^") if ground else (_BLUE, "o")
        for words, share in (("used", 1.0), ("lost at times", 0.5), ("not used", 0.0)):
            if any(each.ground == ground and _use_class(each.share) == share for each in sources):
                handles[f"{what} {words}"] = Line2D([], [], marker=mark, ls="", **_sky_mark(share, own))
    handles[f"mask, {mask:g}°"] = Line2D([], [], color="black", lw=0.7, ls="--")
    if "/geometry/horizon" in result or any(part[1] - part[0] < 360.0 for part in masked(result, edge)):
        handles["masked"] = Patch(**shade)
    if terrain is not None:
        handles["behind terrain"] = Patch(color=BROWN, alpha=0.45, lw=0.0)
    text = true_for(result)
    when = "marks, terrain: as at the last fix" if terrain is not None else "marks: last fix"
    title = f"directions by azimuth and elevation; {when}" + (f"; {text}" if text else "")
    legend(fig, list(handles.values()), list(handles), 3, "outside upper center", title)
    return fig


def _use_class(share: float) -> float:
    """Whether a source is used at all fixes, 1, at none, 0, or at some, 1/2."""
    return share if share in (0.0, 1.0) else 0.5


def _sky_mark(share: float, own: str) -> dict[str, Any]:
    """A mark that is full, half, or hollow and grey, by the share of fixes a source is used at."""
    if not share:
        return {"ms": 4.0, "mfc": "white", "mec": _GREY, "mew": 0.9}
    half = {} if share == 1.0 else {"fillstyle": "bottom", "markerfacecoloralt": "white"}
    return {"ms": 4.5, "color": own, "mec": own, "mew": 0.7, **half}


def dop(result: Result) -> Figure:
    """DOPs over time."""
    fig = new_figure(COLUMN, 2.5)
    ax = fig.subplots()
    t = result["/geometry/time"]
    for name, colour in (("pdop", _BLUE), ("vdop", _ORANGE), ("hdop", _GREEN)):
        ax.plot(t, result[f"/geometry/{name}"], color=colour, label=name.upper())
    landed = touchdown(result)
    if np.isfinite(landed):
        ax.axvline(landed, color=_GREY, lw=0.8, ls="--", label="touchdown")
    ax.set_ylim(bottom=0)
    ax.set_xlabel("time, s")
    ax.set_ylabel("DOP")
    legend_above(fig, ax, 4, true_for(result) or None)
    return fig


def fixes(result: Result) -> Figure:
    """Scatter of the fixes about the antenna's true position, with the 95 % ellipse of their mean covariance."""
    fig = new_figure(COLUMN, 3.4)
    ax = fig.subplots()
    shown = some_fix_errors(result, _MOST_POINTS)
    if shown.size:
        ax.plot(shown[:, 1], shown[:, 0], ".", ms=2, color=_BLUE, alpha=0.5, label="fixes")
        mean = np.nanmean(result["/receiver/covariance_enu"][:, :2, :2], axis=0)
        ax.plot(*ellipse(mean), color=_ORANGE, label="95 % by the predicted covariance")
        legend_above(fig, ax, 2, runs_of(result))
    else:
        ax.text(0.5, 0.5, "no fixes", transform=ax.transAxes, ha="center")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("fix minus true antenna, east, m")
    ax.set_ylabel("north, m")
    return fig


_DOWN = 2
"""Number of the state whose limits are those of the vertical error; the others are not along the runway's axes."""


_MOST_ROWS, _HIGHEST = 8, 8.4
"""Largest number of rows of panels of a figure, and their height, inches, for one page."""


def errors(result: Result) -> dict[str, Figure]:
    """All errors with 3 sigma bounds: of one run, or of an ensemble with its RMS. States that do not fit continue in
    another figure."""
    rows = math.ceil(len(result["/filter/state"]) / 3)
    pages = math.ceil(rows / _MOST_ROWS)
    ends = np.linspace(0, rows, pages + 1).round().astype(int)
    return {
        f"errors_{i + 1}" if i else "errors": _errors(result, range(int(first), int(last)))
        for i, (first, last) in enumerate(itertools.pairwise(ends))
    }


def _errors(result: Result, shown: range) -> Figure:
    """Some rows of three states."""
    states = followed_by(result)
    triads = sum(bool(state.axis) for state in states) // 3
    fig = new_figure(2 * COLUMN, min(1.32 * len(shown), _HIGHEST) + 0.2)
    axes = fig.subplots(len(shown), 3, sharex=True, squeeze=False)
    for unused in axes.flat[len(states) - 3 * shown.start :]:
        unused.set_axis_off()
    t = result["/filter/time"]
    error = first_runs(result, "/filter/error")
    alone = single(result)
    sigma, rms = rms_over_runs(result, "/filter/sigma"), rms_over_runs(result, "/filter/error")
    late = settled(t)
    for i in range(3 * shown.start, min(3 * shown.stop, len(states))):
        row, column = i // 3, i % 3
        ax: Axes = axes[row - shown.start, column]
        state = states[i]
        bound, spread = 3.0 * sigma[:, i] * state.scale, 3.0 * rms[:, i] * state.scale
        runs = error[:, :, i].T * state.scale
        ax.fill_between(t, -bound, bound, color=_ORANGE, alpha=0.25, lw=0, label="±3σ of the filter")
        if alone:
            ax.plot(t, runs, color=_BLUE, lw=0.7, label="error, truth minus estimate")
        else:
            lines = ax.plot(t, runs, color="#999999", lw=0.25, alpha=0.5)
            lines[0].set_label(f"errors of {runs.shape[1]} runs")
            ax.plot(t, spread, color=_BLUE, lw=0.9, label="±3 RMS over all runs")
            ax.plot(t, -spread, color=_BLUE, lw=0.9)
        seen = 1.6 * np.abs(runs[late]) if alone else 1.2 * spread[late]
        reach = max(1.6 * bound[late].max(initial=0.0), seen.max(initial=0.0))
        if i == _DOWN and reach > 0:
            reach = within_sight(result, "vertical", reach)
            gates(ax, result, "vertical", reach)
        if reach > 0:
            ax.set_ylim(-reach, reach)
        ax.locator_params(axis="y", nbins=5)
        if column == 0 or row >= triads:
            ax.set_ylabel(state.label)
        if row == shown.start or state.axis != states[i - 3].axis:
            ax.set_title(state.axis)
        if i + 3 >= min(3 * shown.stop, len(states)):
            ax.set_xlabel("time, s")
            ax.tick_params(labelbottom=True)
    fig.align_ylabels(axes[:, 0])
    legend_above(fig, axes[0, 0], 4, runs_of(result), axes[0, _DOWN])
    return fig


_FAMILIES = (("initial", "#CC79A7"), ("gyro", "#56B4E9"), ("accelerometer", _GREEN), ("satellite", _BLUE),
             ("pseudolite", "#E69F00"), ("systematic", _GREY), ("azimuth", "#882255"),
             ("elevation", "#44AA99"), ("dme", "#332288"), ("", "#F0E442"))  # fmt: skip
_HATCHES = ("", "//////", "......", "xxxxxx", "++++++", "oooo")
"""Sources of one group share a colour and differ by hatch; the last group has all others: sensors beside the
receiver, except ground stations."""


def source_style(names: list[str]) -> list[tuple[str, str]]:
    """Colour and hatch of each source, the same in every figure."""
    count = dict.fromkeys((family for family, _ in _FAMILIES), 0)
    out = []
    for name in names:
        family, colour = next(f for f in _FAMILIES if name.startswith(f[0]))
        out.append((colour, _HATCHES[count[family] % len(_HATCHES)]))
        count[family] += 1
    return out


def budget(result: Result) -> Figure:
    """True root mean square error, the filter's sigma, and the contribution of each source."""
    from matplotlib.patches import Patch

    fig = new_figure(2 * COLUMN, 4.8)
    axes = fig.subplots(2, 2, sharex=True)
    t = result["/covariance/time"]
    after = t >= t[0] + 0.05 * (t[-1] - t[0])
    names = [str(n) for n in result["/budget/source"]]
    styles = source_style(names)
    seen: set[int] = set()
    for column, (title, states) in enumerate((("horizontal position", [0, 1]), ("vertical position", [2]))):
        upper, lower = axes[0, column], axes[1, column]
        true = np.sqrt((result["/covariance/rms"][:, states] ** 2).sum(axis=1))
        assumed = np.sqrt((result["/filter/sigma"][0][:, states] ** 2).sum(axis=1))
        upper.plot(t, true, color=_BLUE, label="true RMS")
        upper.plot(t, assumed, color=_ORANGE, ls="--", label="the filter's σ")
        most = rms_lines(upper, result, title.split()[0])
        upper.set_ylim(0, 1.15 * max(true[after].max(), assumed[after].max(), most))
        upper.set_title(title)
        share = shares(result, states)
        shown = np.flatnonzero(share[:, after].max(axis=1) > 1.0)
        seen |= set(shown.tolist())
        stack = lower.stackplot(t, share[shown], colors=[styles[i][0] for i in shown], lw=0)
        for area, i in zip(stack, shown, strict=True):
            area.set(hatch=styles[i][1], edgecolor="white")
        lower.set_ylim(0, 100)
        lower.set_xlim(t[0], t[-1])
        lower.set_xlabel("time, s")
    axes[0, 0].set_ylabel("error, m")
    legend_above(fig, axes[0, 0], 2)
    axes[1, 0].set_ylabel("share of mean square, %")
    fig.align_ylabels(axes[:, 0])
    handles = [Patch(facecolor=styles[i][0], hatch=styles[i][1], edgecolor="white", lw=0) for i in sorted(seen)]
    labels = [source_title(names[i]) for i in sorted(seen)]
    legend(fig, handles, labels, 4, "outside lower center", "sources above 1 %, from below")
    return fig


def beacons(result: Result) -> Figure:
    """Sigma of height and lateral position against height, with beacons and without them."""
    fig = new_figure(COLUMN, 3.0)
    ax = fig.subplots()
    height = result["/truth/position_llh"][:, 2] - result["/truth/threshold_llh"][2]
    time, landed = result["/beacons/output"], touchdown(result)
    shown = time <= (landed if np.isfinite(landed) else time[-1])
    at = np.interp(time, result["/truth/time"], height)[shown]
    for name, colour in (("vertical", _ORANGE), ("lateral", _BLUE)):
        for end, dashes, words in (("", "-", "with beacons"), ("_without", "--", "without")):
            ax.plot(at, result[f"/beacons/{name}_sigma{end}"][shown], dashes, color=colour, label=f"{name}, {words}")
    ax.set_yscale("log")
    ax.invert_xaxis()
    ax.set_xlabel("height above the threshold, m")
    ax.set_ylabel("the filter's σ, m")
    legend_above(fig, ax, 2)
    return fig


def _degrees(result: Result) -> int:
    """States that a filter's NEES is of."""
    return int(result.variables["/summary/consistency/nees"].attributes["degrees_of_freedom"])


_SQUARES = (("nees", _BLUE, ""), ("nees_position_velocity", _GREEN, "position, velocity"),
            ("nis", _ORANGE, "innovations"))  # fmt: skip
"""Names, colours and titles of normalised squares; "": by the number of states."""


def nees(result: Result) -> Figure:
    """NEES and NIS per degree of freedom over time with their 95 % bands."""
    shown = [each for each in _SQUARES if f"/summary/consistency/{each[0]}" in result]
    fig = new_figure(COLUMN, 0.8 + 1.2 * len(shown))
    axes = fig.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    t = result["/summary/consistency/time"]
    several = result["/run"].size > 1
    for ax, (name, colour, label) in zip(axes, shown, strict=True):
        variable = result.variables[f"/summary/consistency/{name}"]
        values = np.asarray(variable.data)
        style = {"ls": "", "marker": ".", "ms": 1.5} if name == "nis" else {}
        ax.plot(t, values, color=colour, **style)
        if "band_low" in variable.attributes:
            band = (variable.attributes["band_low"], variable.attributes["band_high"])
            ax.axhspan(*band, color=colour, alpha=0.15, lw=0)
        ax.axhline(1.0, color=_GREY, lw=0.6)
        ax.set_ylim(0.0, max(1.5, ax.get_ylim()[1]))
        ax.set_title(label or f"{_degrees(result)} states", loc="left")
        ax.set_ylabel("NIS" if name == "nis" else "NEES")
    axes[-1].set_xlabel("time, s")
    fig.align_ylabels(axes)
    flown = result.attributes["method"] != "covariance"
    what = f"{'mean of ' if several else ''}{runs_of(result)}; shaded: 95 % band" if flown else "expected, linear"
    fig.suptitle(f"NEES and NIS per degree of freedom\n{what}")
    return fig


_RATIO_COLUMNS = 600
"""Most columns of the map of ratios."""


def consistency(result: Result) -> Figure:
    """Map of z of every state over time: white is right, red a sigma that is too small, blue one that is too large."""
    of = state_ratios(result, _RATIO_COLUMNS)
    fig = new_figure(COLUMN, 1.1 + 0.16 * len(of.names))
    ax = fig.subplots()
    norm = Normalize(0.0, of.limit) if of.alone else LogNorm(1.0 / of.limit, of.limit)
    picture = ax.pcolormesh(of.edges, np.arange(len(of.names) + 1), of.z, norm=norm,
                            cmap="Reds" if of.alone else "RdBu_r", rasterized=True)  # fmt: skip
    ax.set_facecolor("#dddddd")
    ax.grid(visible=False)
    ax.invert_yaxis()
    ax.set_yticks(np.arange(len(of.names)) + 0.5, of.names)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("time, s")
    shown = fig.colorbar(picture, ax=ax, label=of.label, extend="max" if of.alone else "both", fraction=0.06)
    if not of.alone:
        levels = [1.0 / of.limit, 1.0, of.limit]
        shown.set_ticks(levels, labels=[f"{each:.2f}" for each in levels])
        shown.minorticks_off()
    attributes = result.variables["/consistency/z"].attributes
    band = [float(attributes[f"band_{end}"]) for end in ("low", "high")]
    for end in band if band[0] < band[1] else ():
        shown.ax.axhline(end, color="black", lw=0.8)
    worst = result["/summary/consistency/worst_z"]
    if np.isfinite(worst).any():
        state = int(np.nanargmax(worst))
        ax.plot(float(result["/summary/consistency/worst_time"][state]), state + 0.5, "kx", ms=5.0, clip_on=False)
    landed = touchdown(result)
    dashed = ""
    if np.isfinite(landed):
        ax.axvline(landed, color="black", lw=0.8, ls="--")
        dashed = "; dashed: touchdown"
    flown = result.attributes["method"] != "covariance"
    colours = "dark red: large errors" if of.alone else "red: errors larger than σ, blue: smaller"
    marked = flown and not of.alone and (band[0] > 1.0 / of.limit or band[1] < of.limit)
    lines = "; lines on the scale: 99.9 % of chance" if marked else ""
    fig.suptitle(f"{runs_of(result)}\n{colours}\n×: largest{dashed}{lines}")
    return fig


_SUMMARY_FIGURES: dict[str, Callable[[Result], Figure]] = {
    "track": track,
    "sky": sky,
    "dop": dop,
    "nees": nees,
}
_FIGURES_OF: dict[str, tuple[str, Callable[[Result], Figure]]] = {
    "consistency": ("/consistency/z", consistency),
    "fixes": ("/receiver/position_llh", fixes),
    "budget": ("/budget/rms", budget),
    "beacons": ("/beacons/vertical_sigma", beacons),
}
"""Figures that need a variable not every result has."""


def _has_dop(result: Result) -> bool:
    return bool(np.isfinite(result["/geometry/pdop"]).any())


def landing(result: Result) -> dict[str, Figure]:
    """Every figure a landing has data for, by name."""
    chosen = {name: draw for name, draw in _SUMMARY_FIGURES.items() if name != "dop" or _has_dop(result)}
    chosen |= {name: draw for name, (needed, draw) in _FIGURES_OF.items() if needed in result}
    drawn = {name: draw(result) for name, draw in chosen.items()}
    return drawn | (errors(result) if "/filter/error" in result else {})


def save_figures(
    draw: Callable[[], dict[str, Figure]], folder: Path, stem: str, how: Print, only: Iterable[str] = (), part: str = ""
) -> list[Path]:
    """Draw figures in the common style and write them as `folder/stem_NAME.FORMAT`.

    By default all are written, in place of those of an earlier result of this stem; `only` selects names. part: prefix
    of the names, such as "run7_", for a part of the result. Raises ResultError.
    """
    written = []
    chosen = list(only)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with printed(how):
            drawn = draw()
            for name in chosen:
                if name not in drawn:
                    raise ResultError(f"--only {name}: {_no_figure(name, list(drawn))}")
            for name, figure in drawn.items():
                if chosen and name not in chosen:
                    continue
                fit(figure)
                target = folder / f"{stem}_{part}{name}.{how.format}"
                write_bytes(target, content(figure, how, stem))
                written.append(target)
    except OSError as error:
        raise ResultError(f"{folder}: figures cannot be written there: {error.strerror or error}") from None
    if not chosen and not part:
        remove_former(folder, stem, written, (how.format,))
    return written


def _no_figure(name: str, there: list[str]) -> str:
    from difflib import get_close_matches

    near = get_close_matches(name, there, 1)
    advice = f"did you mean {near[0]}? " if near else ""
    return f"the result has no such figure; {advice}it has {', '.join(there) or 'none'}"
