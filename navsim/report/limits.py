"""Required limits of a landing in figures: sizes of errors and levels, and their range of validity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.report.figure_data import come_down, event_time, touchdown
from navsim.results.heights import height_m
from navsim.results.result import Result
from navsim.results.schema import RMS_WINDOW

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation

REQUIRED = "#000000"
"""Colour of required limits; other limits have their own."""
DOTTED = (0, (1.0, 1.0))
"""Dash pattern of a required limit, distinguishable without colour."""


@dataclass(frozen=True)
class Limit:
    """A requirement that limits a size."""

    what: str
    """Value from the scenario, "" if missing; `of` and `at` likewise."""
    of: str
    at: str
    size: float
    """m, nan for none."""
    limit: float
    """Required fraction or probability."""
    verdict: str
    """In words."""


def required_limits(result: Result, *what: str) -> list[Limit]:
    """The requirements of these kinds, presets as their parts, of a landing's result."""
    branch = "/summary/requirements"
    if f"{branch}/size" not in result:
        return []
    names = ("what", "of", "at", "size", "limit", "verdict")
    rows = zip(*(result[f"{branch}/{name}"] for name in names), strict=True)
    found = [Limit(str(w), str(of), str(at), float(size), float(limit), str(v)) for w, of, at, size, limit, v in rows]
    return [one for one in found if one.what in what]


def glide(result: Result) -> tuple[float, float]:
    """When the glide begins and ends, s, for which levels are required."""
    begin, end, time = event_time(result, "glide_start"), come_down(result), result["/truth/time"]
    return (0.0 if math.isnan(begin) else begin), (float(time[-1]) if math.isnan(end) else end)


def passes(result: Result, height: str) -> float:
    """Last time at which the aircraft descends through a height, s; nan if it does not."""
    if not height_m(height):
        return touchdown(result)
    time = result["/truth/time"]
    above = result["/truth/position_llh"][:, 2] - result["/truth/threshold_llh"][2] - height_m(height)
    down = np.flatnonzero((above[:-1] >= 0.0) & (above[1:] < 0.0))
    if not down.size:
        return math.nan
    i = int(down[-1])
    return float(np.interp(0.0, -above[i : i + 2], time[i : i + 2]))


def level_lines(ax: Axes, result: Result, level: str) -> None:
    """The sizes that a level is required to be within, over the glide."""
    begin, end = glide(result)
    shares: dict[float, list[str]] = {}
    for one in required_limits(result, "level"):
        if one.of == level:
            shares.setdefault(one.size, []).append(f"{100.0 * one.limit:g} %")
    for size, each in shares.items():
        text = f"required at {', '.join(dict.fromkeys(each))}: {size:g} m"
        ax.plot([begin, end], [size, size], color=REQUIRED, ls=DOTTED, lw=1.0, label=text, zorder=3)


def rms_lines(ax: Axes, result: Result, axis: str) -> float:
    """Draw required limits of a root mean square error over their time range; returns the largest, m, 0 for none."""
    end = glide(result)[1]
    sizes = [one.size for one in required_limits(result, "rms") if one.of == axis]
    for size in sizes:
        _line(ax, end - RMS_WINDOW, end, size, f"required: {size:g} m")
    return max(sizes, default=0.0)


def _line(ax: Axes, begin: float, end: float, size: float, text: str) -> None:
    ax.plot([begin, end], [size, size], color=REQUIRED, ls=DOTTED, lw=1.4)
    behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.6}  # curves may pass under it
    word(ax, text, (end, size), (-4.0, 2.5), ha="right", va="bottom", bbox=behind)


def rectangle(ax: Axes, across: tuple[float, float] | None, up: tuple[float, float] | None, label: str) -> None:
    """From where to where two errors are to be, m, or one of them."""
    if across is not None and up is not None:
        (left, right), (low, high) = across, up
        ax.plot([left, right, right, left, left], [low, low, high, high, low], color=REQUIRED, lw=1.2, label=label)
        return
    for ends, draw in ((across, ax.axvline), (up, ax.axhline)):
        for i, end in enumerate(ends or ()):
            draw(end, color=REQUIRED, lw=1.2, label=label if i else None)


def word(ax: Axes, text: str, at: tuple[float, float], off: tuple[float, float], **how: Any) -> Annotation:
    """A word in a figure, legible over lines: at a point of the data, with an offset in points."""
    from matplotlib.patheffects import withStroke

    return ax.annotate(
        text, at, off, textcoords="offset points", fontsize=7.0,
        path_effects=[withStroke(linewidth=1.5, foreground="white")], **how,
    )  # fmt: skip


def within_sight(result: Result, axis: str, reach: float) -> float:
    """Half the height of a panel of errors, m, that shows limits, too, which are no more than three times as large."""
    sizes = [1.15 * one.size for one in required_limits(result, "error") if one.of == axis]
    return max([reach, *(size for size in sizes if size <= 3.0 * reach)])


def gates(ax: Axes, result: Result, axis: str, reach: float) -> None:
    """Draw required limits of an axis at the heights where they apply; reach: half the height of the panel, m.

    A limit beyond it is written at the edge.
    """
    label: str | None = f"required of the {axis} error"
    for one in required_limits(result, "error"):
        when = passes(result, one.at)
        if one.of != axis or math.isnan(when):
            continue
        if one.size <= reach:
            ax.errorbar(when, 0.0, one.size, fmt="none", ecolor=REQUIRED, elinewidth=0.7, capsize=3.0, capthick=1.2,
                        label=label)  # fmt: skip
            label = None
        else:
            ax.axvline(when, color=REQUIRED, lw=0.7)
            late = when > 0.7 * float(result["/truth/time"][-1])
            side, off = ("right", -3.0) if late else ("left", 3.0)
            word(ax, f"±{one.size:g} m ↕", (when, reach), (off, -1.0), ha=side, va="top")
