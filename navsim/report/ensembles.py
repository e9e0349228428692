"""Figures of ensembles: how the position errors of all runs spread over time and over height, and at touchdown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from navsim.report.box_rows import box_limits, of_total
from navsim.report.figure_data import (
    PERCENTS,
    IndicatedDeviations,
    affordable_instants,
    blocks,
    come_down,
    ellipse,
    heights,
    indicated_deviations,
    settled,
)
from navsim.report.figures import legend_above
from navsim.report.limits import DOTTED, REQUIRED, Limit, rectangle, required_limits
from navsim.report.printing import COLOURS, COLUMN, abreast, new_figure
from navsim.report.result_cells import runs_of, setting
from navsim.results.result import Result
from navsim.results.schema import INDICATED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXES = ("lateral", "along", "vertical")
_MOST_POINTS = 2000
_LEAST_RUNS = 10
"""Least number of runs for percentiles."""


@dataclass(frozen=True)
class RunSpread:
    """Spread of the runs over time."""

    time: np.ndarray
    """(w,) s."""
    height: np.ndarray
    """(w,) of the aircraft above the runway, m."""
    rms: np.ndarray
    """(w, 3) over runs, lateral, along, vertical, m."""
    sigma: np.ndarray | None
    """(w, 3) filter sigma, root mean square over runs. None if the runway is oblique to the map's axes, along which the
    file has the sigmas."""
    percentiles: np.ndarray
    """(5, w, 3) `PERCENTS` of the errors, m."""


def spread(result: Result) -> RunSpread:
    """Spread of a landing's ensemble with history, truth minus estimate in runway axes (right, forward, up)."""
    time = result["/filter/time"]
    count = min(time.size, affordable_instants(result))
    at = np.unique(np.linspace(0, time.size - 1, count).astype(int))
    turn = turned(result)
    errors = np.concatenate([block[:, at, :3] @ turn.T for block in blocks(result, "/filter/error")])
    axes = np.abs(np.round(turn))
    sigma = None
    if np.allclose(np.abs(turn), axes, atol=1e-9):
        total = sum(np.sum(block[:, at, :3] ** 2, axis=0) for block in blocks(result, "/filter/sigma"))
        sigma = np.sqrt(total / result["/filter/sigma"].shape[0]) @ axes.T
    rms = np.sqrt(np.mean(errors**2, axis=0))
    return RunSpread(time[at], heights(result)[at], rms, sigma, np.percentile(errors, PERCENTS, axis=0))


def turned(result: Result) -> np.ndarray:
    """The matrix (3, 3) from north, east, down to right of, along and above the axis of the runway."""
    heading = np.radians(setting(result, "runway", "heading_deg"))
    s, c = np.sin(heading), np.cos(heading)
    return np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])


def figures(result: Result) -> dict[str, Figure]:
    """By name, those that an ensemble has data for."""
    if result["/run"].size < _LEAST_RUNS or result.attributes["method"] != "monte-carlo":
        return {}
    out = {}
    if "/filter/error" in result:
        of = spread(result)
        out["spread_time"] = _bands(result, of, of.time, "time, s")
        down = _descent(result, of)
        if down.size > 2:
            out["spread_height"] = _bands(result, _at(of, down), of.height[down], "height above the runway, m")
    if (seen := indicated_deviations(result)) is not None and seen.height.size > 2:
        out["deviations"] = _deviations(result, seen)
    if all(np.isfinite(at_touchdown(result, axis)).any() for axis in AXES):
        out["touchdown"] = _scatter(result)
        out["histogram"] = _histogram(result)
    return out


def _deviations(result: Result, seen: IndicatedDeviations) -> Figure:
    """Deviations from localizer and glide path against height, with half and full scale and required sizes."""
    fig = new_figure(COLUMN, 3.6)
    axes = fig.subplots(2, 1, sharex=True)
    for i, (ax, name) in enumerate(zip(axes, INDICATED, strict=True)):
        low, lower, median, upper, high = seen.aircraft[:, :, i]
        ax.fill_between(seen.height, low, high, color=COLOURS[5], alpha=0.3, lw=0, label="95 % of runs")
        ax.fill_between(seen.height, lower, upper, color=COLOURS[0], alpha=0.4, lw=0, label="50 % of runs")
        ax.plot(seen.height, median, color=COLOURS[0], label="median")
        for k, side in ((0, -1.0), (4, 1.0)):
            label = "95 % as pilots see it" if k else None
            ax.plot(seen.height, seen.estimate[k, :, i], color=COLOURS[1], ls="--", lw=0.9, label=label)
            if seen.reach(i) > 1.0:
                ax.axhline(side, color="black", lw=0.9, label="full scale" if k else None)
            if 0.5 not in seen.required[name]:
                ax.axhline(0.5 * side, color="black", lw=0.6, ls="-.", label="half scale" if k else None)
        for size in seen.required[name]:
            for side in (-size, size):
                ax.axhline(side, color=REQUIRED, ls=DOTTED, lw=1.4, label="required" if side > 0.0 else None)
        ax.set_ylim(-seen.reach(i), seen.reach(i))
        ax.set_ylabel(f"{name.replace('_', ' ')}, parts\nof full scale")
    axes[-1].set_xlabel("height above the runway, m")
    axes[-1].set_xlim(seen.height.max(), seen.height.min())
    fig.align_ylabels(axes)
    legend_above(fig, axes[0], 2, f"deviations, {runs_of(result)}", axes[1])
    return fig


def _descent(result: Result, of: RunSpread) -> np.ndarray:
    """Numbers of the instants at which the aircraft comes down, with every height once."""
    landed = come_down(result)
    until = of.time <= landed if np.isfinite(landed) else np.full(of.time.size, True)
    top = np.flatnonzero(until & (of.height >= of.height[until].max() - 0.5))[-1]
    return np.flatnonzero(until & (np.arange(of.time.size) >= top))


def _at(of: RunSpread, chosen: np.ndarray) -> RunSpread:
    sigma = None if of.sigma is None else of.sigma[chosen]
    return RunSpread(of.time[chosen], of.height[chosen], of.rms[chosen], sigma, of.percentiles[:, chosen])


def _bands(result: Result, of: RunSpread, across: np.ndarray, label: str) -> Figure:
    """Percentiles, root mean square and the filter's sigma against time or height, a panel an axis."""
    fig = new_figure(COLUMN, 4.8)
    axes = fig.subplots(3, 1, sharex=True)
    late, against_height = settled(of.time), label.startswith("height")
    for i, (ax, name) in enumerate(zip(axes, AXES, strict=True)):
        low, lower, median, upper, high = of.percentiles[:, :, i]
        ax.fill_between(across, low, high, color=COLOURS[5], alpha=0.3, lw=0, label="95 % of runs")
        ax.fill_between(across, lower, upper, color=COLOURS[0], alpha=0.4, lw=0, label="50 % of runs")
        ax.plot(across, median, color=COLOURS[0], label="median")
        for side in (-1.0, 1.0):
            ax.plot(across, side * of.rms[:, i], color="black", lw=0.9, label="±RMS" if side > 0 else None)
            if of.sigma is not None:
                ax.plot(across, side * of.sigma[:, i], color=COLOURS[1], ls="--", lw=0.9,
                        label="±σ of the filter" if side > 0 else None)  # fmt: skip
        if of.sigma is None and against_height:
            at, sigma = result["/summary/at/height"], result[f"/summary/at/{name}_sigma"]
            ax.errorbar(at, np.zeros(at.size), sigma, fmt="none", ecolor=COLOURS[1], elinewidth=0.9, capsize=2.5,
                        label=f"±σ of the filter at {at.size} heights")  # fmt: skip
        reach = 1.25 * float(max(np.abs(low[late]).max(), np.abs(high[late]).max()))
        if reach > 0.0:
            ax.set_ylim(-reach, reach)
        ax.set_ylabel(f"{name}, m")
    axes[-1].set_xlabel(label)
    if against_height:
        low, high = float(across.min()), float(across.max())
        # bars at touchdown are at the end of the axis
        axes[-1].set_xlim(high, low - 0.025 * (high - low) if of.sigma is None else low)
    fig.align_ylabels(axes)
    title = f"Truth minus estimate, {runs_of(result)}"
    if of.sigma is None and not against_height:
        title += "; the filter's σ is known along the axes of the map only"
    legend_above(fig, axes[0], 3, title)
    return fig


def at_touchdown(result: Result, axis: str) -> np.ndarray:
    """The error of each run at touchdown (run,), m."""
    return result[f"/summary/at/{axis}_run"][:, 0]


def _scatter(result: Result) -> Figure:
    """Errors of all runs at touchdown, from above and from behind, with the ellipses of their covariance, the box and
    the required sizes."""
    fig = new_figure(2 * COLUMN, 3.4)
    names = {"lateral": "lateral (right)", "along": "along the track", "vertical": "vertical (up)"}
    panels, boxed, unseen = abreast(fig, 2), _box_at_touchdown(result), set[str]()
    for ax, (x, y) in zip(panels, (("lateral", "along"), ("lateral", "vertical")), strict=True):
        both = np.stack([at_touchdown(result, x), at_touchdown(result, y)], axis=1)
        both = both[np.isfinite(both).all(axis=1)]
        mean, covariance = both.mean(axis=0), np.cov(both.T)
        step = max(1, len(both) // _MOST_POINTS)
        ax.plot(*both[::step].T, ".", ms=2.5, color=COLOURS[0], alpha=0.6, label="runs")
        wide = float(np.abs(both).max(initial=0.0))
        if np.linalg.eigvalsh(covariance)[0] > 0.0:
            whole = ellipse(covariance)
            half = whole * np.sqrt(-2.0 * np.log(0.5) / 5.991)
            ax.plot(*(mean[:, None] + half), color=COLOURS[1], ls="--", label="50 % of a Gaussian")
            ax.plot(*(mean[:, None] + whole), color=COLOURS[1], label="95 % of a Gaussian")
            wide = max(wide, float(np.abs(mean[:, None] + whole).max()))
        in_sight = {name: size for name, size in boxed.items() if max(-size[0], size[1]) <= 4.0 * wide}
        rectangle(ax, in_sight.get(x), in_sight.get(y), "box")
        required = [one for one in required_limits(result, "error") if one.at == "touchdown" and one.of in (x, y)]
        shown = [one for one in required if one.size <= 4.0 * wide]
        for one in shown:
            _required_line(ax, one, upright=one.of == x)
        unseen |= {f"box {name} {boxed[name][0]:g} to {boxed[name][1]:g} m" for name in (x, y)
                   if name in boxed and name not in in_sight}  # fmt: skip
        unseen |= {_limit_text(one) for one in required if one not in shown}
        ends = [abs(end) for name, size in in_sight.items() if name in (x, y) for end in size]
        wide = 1.15 * max([wide, *ends, *(one.size for one in shown)])
        ax.set_xlim(-wide, wide)
        ax.set_ylim(-wide, wide)
        ax.set_box_aspect(1.0)
        ax.set_xlabel(f"{names[x]}, m")
        ax.set_ylabel(f"{names[y]}, m")
    far = f"; not in sight: {', '.join(sorted(unseen))}" if unseen else ""
    legend_above(fig, panels[0], 4, f"error at touchdown, {runs_of(result)}{far}", panels[1])
    return fig


def _box_at_touchdown(result: Result) -> dict[str, tuple[float, float]]:
    """The scenario's box by axis, from and to, m, if it limits navigation errors at touchdown."""
    if "/summary/box/upper" not in result or of_total(result) or float(result["/summary/box/height"]) != 0.0:
        return {}
    return {name: ends for i, name in enumerate(AXES) if (ends := box_limits(result, i)) is not None}


def _limit_text(one: Limit) -> str:
    return f"required: {one.of} ±{one.size:g} m in {100.0 * one.limit:g} %"


def _required_line(ax: Axes, one: Limit, upright: bool) -> None:
    """Draw the required size of one error to both sides of zero, upright or level."""
    for side in (-one.size, one.size):
        draw = ax.axvline if upright else ax.axhline
        draw(side, color=REQUIRED, ls=DOTTED, lw=1.4, label=_limit_text(one) if side > 0.0 else None)


def _histogram(result: Result) -> Figure:
    """Distribution of the errors at touchdown, with Gaussians of the filter's sigma."""
    fig = new_figure(2 * COLUMN, 2.6)
    panels = abreast(fig, 3)
    for ax, name in zip(panels, AXES, strict=True):
        _bars(ax, at_touchdown(result, name), float(result[f"/summary/at/{name}_sigma"][0]))
        ax.set_xlabel(f"{name} error at touchdown, m")
    panels[0].set_ylabel("density, 1/m")
    legend_above(fig, panels[0], 4, f"Truth minus estimate, {runs_of(result)}")
    return fig


def _bars(ax: Axes, errors: np.ndarray, sigma: float) -> None:
    known = errors[np.isfinite(errors)]
    bins = int(np.clip(2.0 * np.cbrt(known.size), 7, 60))  # Rice's rule
    ax.hist(known, bins=bins, density=True, color=COLOURS[5], alpha=0.7, label="runs")
    reach = max(float(np.abs(known).max(initial=0.0)), 3.0 * sigma)
    x = np.linspace(-reach, reach, 121)
    if sigma > 0.0:
        density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi))
        ax.plot(x, density, color=COLOURS[1], ls="--", label="Gaussian of the filter's σ")
    for percent in np.percentile(known, (2.5, 97.5)):
        ax.axvline(float(percent), color="black", lw=0.9, ls=":", label="2.5 % and 97.5 %" if percent > 0.0 else None)
