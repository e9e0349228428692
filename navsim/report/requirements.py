"""Figures of required errors of a landing, with their limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from navsim.report.box_rows import box_limits, of_total, outside_box
from navsim.report.figure_data import MOST_RUNS, blocks, settled, touchdown
from navsim.report.figures import legend_below, view_from_above
from navsim.report.limits import REQUIRED, glide, rectangle, required_limits, rms_lines, word
from navsim.report.printing import COLOURS, COLUMN, abreast, narrow, new_figure
from navsim.report.result_cells import known_percentiles, runs_of, single
from navsim.results.heights import height_m, height_names, spoken_height
from navsim.results.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ERROR, _OUTSIDE, _BELIEVED = COLOURS[0], COLOURS[1], COLOURS[1]
_SPREAD = 0.28
"""Half the width over which runs at one height are spread."""
_MOST_POINTS = 2000
_WIDEST = 4.0
"""Limits larger than the values by this factor are written at the edge instead of drawn."""
_STATES = {"horizontal": [0, 1], "vertical": [2]}
_NAMES = {"lateral": "lateral (right)", "along": "along the track", "vertical": "vertical (up)"}


def figures(result: Result) -> dict[str, Figure]:
    """Figures of limited quantities of a landing, by name."""
    out = {}
    if required_limits(result, "error", "rms"):
        out["requirements"] = errors(result)
    if "/summary/box/upper" in result:
        out["box"] = box(result)
    return out


def errors(result: Result) -> Figure:
    """Root mean square errors over time, and errors at heights, with their required limits."""
    rms = [axis for axis in _STATES if any(one.of == axis for one in required_limits(result, "rms"))]
    at = [axis for axis in _NAMES if any(one.of == axis for one in required_limits(result, "error"))]
    rows = [row for row in (rms, at) if row]
    alone = max(map(len, rows)) == 1
    fig = new_figure(COLUMN if alone else 2 * COLUMN, 2.4 * len(rows) + 0.4)
    if not alone and narrow(fig):
        rows = [[axis] for row in rows for axis in row]
        fig.set_figheight(2.2 * len(rows) + 0.4)
    grid = fig.add_gridspec(len(rows), 6)
    of_time = len(rms) if rows and len(rows[0]) == 1 and len(rows) > 1 else int(bool(rms))
    for i, row in enumerate(rows):
        width = 6 // len(row)
        for j, axis in enumerate(row):
            ax = fig.add_subplot(grid[i, j * width : (j + 1) * width])
            (_over_time if i < of_time else _at_heights)(ax, result, axis)
    fig.suptitle(f"Truth minus estimate, {runs_of(result)};" + ("\n" if alone else " ") + "black: required limits")
    return fig


def _over_time(ax: Axes, result: Result, axis: str) -> None:
    """Root mean square error of all runs over time, the filter's sigma, and the value over the last seconds."""
    time, states = result["/truth/time"], _STATES[axis]
    value, low, high = map(float, result[f"/summary/rms/{axis}"])
    if single(result):  # which has no meaningful interval
        low = high = value
    top = 1.6 * rms_lines(ax, result, axis)
    if "/filter/time" in result:
        time = result["/filter/time"]
        true, assumed = _curves(result, states)
        ax.plot(time, true, color=_ERROR, label="error" if single(result) else "RMS error")
        ax.plot(time, assumed, color=_BELIEVED, ls="--", label="σ of the filter")
        late = settled(time) & ~(time > touchdown(result))
        top = max(top, 1.3 * float(np.max(true, where=late & np.isfinite(true), initial=0.0)))
    end, length = glide(result)[1], float(time[-1] - time[0])
    if math.isfinite(value):
        ax.errorbar(
            end + 0.02 * length, value, [[value - low], [high - value]], fmt="o", color=_ERROR, ms=3.0,
            capsize=2.0, label="over the last 20 s",
        )  # fmt: skip
    ax.set_xlim(time[0], end + 0.08 * length)
    ax.set_ylim(0.0, 1.1 * max(top, high if math.isfinite(high) else 0.0))
    ax.set_xlabel("time, s")
    ax.set_ylabel(f"{axis} error, m")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, borderaxespad=0.2)


def _curves(result: Result, states: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """RMS error and the filter's sigma (t,) of the position's states together, m."""

    def rms(path: str) -> np.ndarray:
        total = sum(np.sum(block[:, :, states] ** 2, axis=(0, 2)) for block in blocks(result, path))
        return np.sqrt(total / result["/run"].size)

    if "/filter/error" in result:
        return rms("/filter/error"), rms("/filter/sigma")
    return np.sqrt((result["/covariance/rms"][:, states] ** 2).sum(axis=1)), rms("/filter/sigma")


def _at_heights(ax: Axes, result: Result, axis: str) -> None:
    """Errors of runs at the evaluated heights, the size that 95 % of them keep, and the limits."""
    names = height_names(result["/summary/at/height"])
    passed = sorted(names, key=height_m, reverse=True)
    reach = max(_found_at(ax, result, axis, (i, passed.index(name))) for i, name in enumerate(names))
    beyond: list[tuple[int, str]] = []
    limits = [one for one in required_limits(result, "error") if one.of == axis]
    sizes = [one.size for one in limits]
    # a far wider range would compress the values
    sight = _WIDEST * (reach if reach > 0.0 else min(sizes, default=1.0))
    for one in limits:
        x = passed.index(one.at)
        if one.size > sight:
            beyond.append((x, f"↑ ±{one.size:g} m\n{100.0 * one.limit:g} %"))
            continue
        for side in (-one.size, one.size):
            ax.plot([x - 0.42, x + 0.42], [side, side], color=REQUIRED, lw=1.6, solid_capstyle="butt")
        word(ax, f"{100.0 * one.limit:g} %", (x, one.size), (0.0, 2.0), ha="center", va="bottom")
        reach = max(reach, one.size)
    ax.set_xticks(range(len(passed)), [spoken_height(h).replace("touchdown", "touch-\ndown") for h in passed])
    ax.set_xlim(-0.5, len(passed) - 0.5)
    ax.set_ylim(-1.3 * reach or -1.0, 1.3 * reach or 1.0)
    for x, text in beyond:
        word(ax, text, (x, 1.3 * reach or 1.0), (0.0, -1.0), ha="center", va="top")
    ax.grid(visible=False, axis="x")
    ax.set_ylabel(f"{_NAMES[axis]}, m")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, borderaxespad=0.2)


def _found_at(ax: Axes, result: Result, axis: str, at: tuple[int, int]) -> float:
    """Draw the value at a height; returns its size, m. at: number of the height, which is 0 for that of the legend,
    and its place across the page."""
    (i, x), reach = at, 0.0
    named = i == 0
    if f"/summary/at/{axis}_run" in result:
        found = result[f"/summary/at/{axis}_run"][:, i]
        found = found[:: math.ceil(found.size / _MOST_POINTS)]
        several = found.size > 1
        across = x + _SPREAD * np.linspace(-1.0, 1.0, found.size) if several else [x]
        label = ("runs" if several else "run") if named else None
        ax.plot(across, found, ".", color=_ERROR, ms=1.5 if found.size > MOST_RUNS else 3.0, alpha=0.5, label=label)
        reach = float(np.max(np.abs(found), where=np.isfinite(found), initial=0.0))
    known = not single(result) and bool(known_percentiles(result)[1])
    most = float(result[f"/summary/at/{axis}_percentile"][i, 1]) if known else math.nan
    if math.isfinite(most):
        for side in (-most, most):
            label = "95 % of runs" if named and side > 0.0 else None
            ax.plot([x - _SPREAD, x + _SPREAD], [side, side], color=_ERROR, lw=1.2, label=label)
        reach = max(reach, most)
    return reach


_ABOVE, _BEHIND = ("along", "lateral", "from above"), ("lateral", "vertical", "from behind")
"""Views of a box: across the page, up the page."""


def box(result: Result) -> Figure:
    """Errors at the height of the box, and the box; along the runway from the threshold, where its limits are."""
    limits = {name: box_limits(result, i) for i, name in enumerate(_NAMES)}
    names = _NAMES | ({"along": "along the runway from the threshold"} if "/summary/box/place" in result else {})
    views = [_ABOVE] if limits["along"] is not None else []
    if not views or limits["vertical"] is not None:
        views.append(_BEHIND)
    fig = new_figure(COLUMN * len(views), 3.8)
    panels = abreast(fig, len(views))
    for ax, (x, y, title) in zip(panels, views, strict=True):
        _view(ax, result, (x, y), limits)
        if (x, y, title) == _ABOVE:
            view_from_above(ax)
        ax.set_title(title)
        ax.set_xlabel(f"{names[x]}, m")
        ax.set_ylabel(f"{names[y]}, m")
    height = float(result["/summary/box/height"])
    what = "total system errors" if of_total(result) else "errors"
    where = f"{height:g} m above the runway" if height else "touchdown"
    count = f": {int(outside_box(result).sum())} outside" if "/summary/box/error_run" in result else ""
    required = [f"required: at most {one.limit:g} of landings outside" for one in required_limits(result, "box")]
    runs = f"{runs_of(result)}{count}"
    fig.suptitle("\n".join([f"{what} at {where}", runs, *required] if len(views) == 1 else
                           [f"{what} at {where}; {runs}", *required]))  # fmt: skip
    legend_below(fig, panels[0], 3)
    return fig


def _view(ax: Axes, result: Result, names: tuple[str, str], limits: dict[str, tuple[float, float] | None]) -> None:
    axes = [list(_NAMES).index(name) for name in names]
    # errors along the track count from the place of the route, limits given from the threshold from there
    start = [float(result["/summary/box/place"]) if name == "along" and "/summary/box/place" in result else 0.0
             for name in names]  # fmt: skip
    found: list[np.ndarray] = []
    if "/summary/box/error_run" in result:
        error, outside = result["/summary/box/error_run"], outside_box(result)
        for some, mark, colour, label in ((~outside, ".", _ERROR, "inside"), (outside, "x", _OUTSIDE, "outside")):
            if some.any():
                shown = error[some][:: math.ceil(some.sum() / _MOST_POINTS)]
                ax.plot(*(shown[:, axes] + start).T, mark, color=colour, ms=4.0, alpha=0.7, label=label)
        found = [one[np.isfinite(one)] for one in error[:, axes].T]
    elif "/summary/box/axis_sigma" in result:
        mean, sigma = (result[f"/summary/box/axis_{name}"][axes] for name in ("mean", "sigma"))
        if np.isfinite([*mean, *sigma]).all():
            x, y = mean + start
            ax.errorbar(x, y, 2.0 * sigma[1], 2.0 * sigma[0], fmt="o", color=_ERROR, ms=3.0, capsize=2.0,
                        label="mean ±2σ, to first order")  # fmt: skip
            found = [np.array([m - 2.0 * s, m + 2.0 * s]) for m, s in zip(mean, sigma, strict=True)]
    ends = []
    for name, at in zip(names, start, strict=True):
        own = limits[name]
        ends.append(None if own is None else (own[0] + at, own[1] + at))
    rectangle(ax, ends[0], ends[1], "box")
    across, up = (_stretch(found[i] if found else np.empty(0), start[i], limits[name]) for i, name in enumerate(names))
    ax.set_xlim(across)
    ax.set_ylim(up)


def _stretch(found: np.ndarray, start: float, limits: tuple[float, float] | None) -> tuple[float, float]:
    """Range of an axis for these errors and limits; symmetric about zero without limits."""
    reach = float(np.abs(found).max(initial=0.0))
    low, high = limits or (-reach, reach)
    low, high = start + min(low, found.min(initial=0.0)), start + max(high, found.max(initial=0.0))
    more = 0.075 * (high - low) or 1.15
    return low - more, high + more
