"""Display of the probability of leaving a box: a table, and exceedance curves of the errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from navsim.report.box_rows import box_head, box_limits, box_sides, box_to_first_order
from navsim.report.limits import DOTTED, REQUIRED, required_limits, word
from navsim.report.requirement_rows import requirements
from navsim.report.result_cells import runs_of
from navsim.report.table import ABSENT, Cell, Table, cell
from navsim.results.findings import several
from navsim.results.result import Result
from navsim.statistics import normal
from navsim.statistics.importance_sampling import FEW, TWO_SIDED, relative_error
from navsim.statistics.rounding import write_out

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FAR = 1e-12
"""Probability below which a note says that it depends on the assumed tails of the inputs."""
_LEAST = 1e-12
"""Probabilities below this are not drawn."""
_COMMON = 0.1
"""Probabilities above this need no logarithm."""
_POINTS = 300
_GO_AROUND = "/summary/rare/go_around"


def table(results: Sequence[tuple[str, Result]]) -> Table:
    """Probabilities of leaving a box, a column a result: names and results in order."""
    caption = "Probabilities of leaving the box, by runs that are pushed to its edge; in brackets 95 % intervals"
    out = Table("", ("", *(name for name, _ in results)), caption=caption)

    def row(label: str, shown: Callable[[Result], Cell | str]) -> None:
        out.add(label, *(shown(result) for _, result in results))

    axes = list(enumerate(map(str, results[0][1]["/axis"])))
    row("pushed runs", runs_of)
    out.head("Outside the box", *(box_head(result, flown=True) for _, result in results))
    row("  any limit exceeded", lambda r: _probability(r["/summary/rare/probability"], _effective(r)))
    for i, axis in axes:
        row(f"  {axis}", lambda r, i=i: _of_axis(r, i))  # type: ignore[misc]
    out.head("The same to first order", *(_without_alarms(result) for _, result in results))
    row("  any limit exceeded", lambda r: box_to_first_order(r, None))
    for i, axis in axes:
        row(f"  {axis}", lambda r, i=i: box_to_first_order(r, i))  # type: ignore[misc]
    out.head("Errors there to first order, m", *("mean, 1 sigma" for _ in results))
    for i, axis in axes:
        row(f"  {axis}", lambda r, i=i: _first_order(r, i))  # type: ignore[misc]
    if any(_GO_AROUND in result for _, result in results):
        out.head("Go-around after an alarm", *("probability [95 %]" for _ in results))
        row("  go-around", _of_go_arounds)
        row("  effective samples", lambda r: cell("{:.0f}", float(r[f"{_GO_AROUND}_effective_samples"]))
            if _GO_AROUND in r else ABSENT)  # fmt: skip
    out.head("Basis")
    row("  relative error, 1 sigma", _relative_error)
    row("  effective samples", lambda r: cell("{:.0f}", _effective(r)))
    row("  runs outside the box", lambda r: Cell("{}", (int(r["/summary/rare/outside"]),), trials=r["/run"].size))
    row("  time of the box, s", lambda r: cell("{:.2f}", float(r["/summary/box/time"])))
    requirements(out, results)
    return out


def _of_go_arounds(result: Result) -> Cell | str:
    if _GO_AROUND not in result:
        return ABSENT
    return _probability(result[_GO_AROUND], float(result[f"{_GO_AROUND}_effective_samples"]), event="going around")


def _without_alarms(result: Result) -> str:
    """Heading of probabilities to first order, which have no alarms."""
    return box_head(result, flown=False) + (", without alarms" if _GO_AROUND in result else "")


def _probability(values: np.ndarray, effective: float, beyond: str = "", event: str = "outside") -> Cell:
    value, low, high = map(float, values)
    few = f"  ({several(round(effective), 'effective sample')})" if effective < FEW else ""
    tails = "  (if tails are Gaussian)" if not value >= _FAR else ""
    if effective == 0.0:
        return cell(f"none {event}; below {{:.2g}}" + beyond, high, names=("below",))
    if np.isnan(value):
        return cell("below {:.2g}" + beyond + tails + few, high, names=("below",))
    if value == 1.0:
        return cell(f"all {event}; above {{:.3g}}" + beyond + few, low, names=("above",))
    pattern = "{:.3g}  [{:.3g}, {:.3g}]" + beyond + tails + few
    return Cell(pattern, (value, low, high), ends=True, names=("probability", "", ""))


def _of_axis(result: Result, i: int) -> Cell | str:
    if box_limits(result, i) is None:
        return ABSENT
    effective = float(result["/summary/rare/axis_effective_samples"][i])
    where, ends = box_sides(result, i)
    return _probability(result["/summary/rare/axis_probability"][i], effective, f"  ({where.format(*ends)})")


def _effective(result: Result) -> float:
    return float(result["/summary/rare/effective_samples"])


def _relative_error(result: Result) -> Cell:
    return Cell("{:.1f} %", (100.0 * float(result["/summary/rare/relative_error"]),), whole=True)


def _first_order(result: Result, i: int) -> Cell:
    mean, sigma = (float(result[f"/summary/box/axis_{name}"][i]) for name in ("mean", "sigma"))
    return cell("{:+.3f}, {:.3f}", mean, sigma, names=("mean", "σ"))


def figures(result: Result) -> dict[str, Figure]:
    """The figures of a probability of leaving a box, by name."""
    return {"exceedance": exceedance(result)}


def exceedance(result: Result) -> Figure:
    """Probability that each limited error exceeds a size, from shifted runs and to first order."""
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLUMN, new_figure

    some = np.flatnonzero(np.isfinite(result["/summary/box/upper"]))
    fig = new_figure(COLUMN, 1.9 * some.size + 0.5)
    axes = fig.subplots(some.size, 1, squeeze=False)[:, 0]
    for ax, i in zip(axes, some, strict=True):
        _curve(ax, result, int(i))
        ax.set_xlabel("x, m" if middle(result, int(i)) else "size x of the error, m")
    legend_above(fig, axes[0], 3)
    return fig


@dataclass(frozen=True)
class Exceedance:
    """Probability that an error differs from the middle of its limits by more than a size."""

    size: np.ndarray
    """(n,) m, from runs, see `exceeded`."""
    chance: np.ndarray
    """(n,) probability, with `low` and `high`."""
    low: np.ndarray
    high: np.ndarray
    grid: np.ndarray
    """Sizes of the first-order result, m."""
    first_order: np.ndarray
    """Probabilities to first order; nan where fixes have a state: errors are Gaussian then for a history of states
    alone."""
    limit: float
    """Limit of the box, half the distance of its limits, m."""
    bottom: float
    """Start of the probability axis, 0 for a linear one."""


def curve(result: Result, i: int) -> Exceedance:
    """Exceedance curve of the i-th axis, which has a limit."""
    limits = box_limits(result, i)
    assert limits is not None
    limit, centre = 0.5 * (limits[1] - limits[0]), middle(result, i)
    mean, sigma = (float(result[f"/summary/box/{name}"][i]) for name in ("axis_mean", "axis_sigma"))
    mean -= centre
    error = result["/rare/error"][:, i] - centre
    if _GO_AROUND in result:  # who goes around exceeds nothing
        error = np.where(result["/rare/go_around_time"] < float(result["/summary/box/time"]), 0.0, error)
    x, chance, low, high = exceeded(error, result["/rare/log_weight"])
    at_limit = float(result["/summary/rare/axis_probability"][i, 0]), float(result["/summary/box/axis_first_order"][i])
    least = min((p for p in at_limit if p > 0.0), default=_LEAST)
    required = min((one.limit for one in required_limits(result, "box")), default=math.inf)
    least = min(least, required)
    bottom = 0.0 if least > _COMMON else max(0.3 * least, _LEAST)
    grid = np.linspace(0.0, max(1.1 * limit, abs(mean) + 3.0 * sigma), _POINTS)
    if bottom:  # only as far as the curves
        grid = np.linspace(0.0, min(grid[-1], abs(mean) - sigma * normal.quantile(0.5 * bottom)), _POINTS)
    gaussian = normal.exceedance(grid, mean, sigma)
    if "/rare/history_log_weight" in result:
        gaussian = np.full_like(grid, np.nan)
    return Exceedance(x, chance, low, high, grid, gaussian, limit, bottom)


def middle(result: Result, i: int) -> float:
    """Between the limits of the i-th axis, m."""
    limits = box_limits(result, i)
    return 0.0 if limits is None else 0.5 * (limits[0] + limits[1])


def _curve(ax: Axes, result: Result, i: int) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

    from navsim.report.printing import COLOURS

    of = curve(result, i)
    bottom, grid = of.bottom, of.grid
    ax.fill_between(of.size, of.low, of.high, step="post", color=COLOURS[0], alpha=0.25, lw=0)
    runs = result["/run"].size
    ax.plot(of.size, of.chance, drawstyle="steps-post", color=COLOURS[0], label=f"{several(runs, 'pushed run')}, 95 %")
    if not np.isnan(of.first_order).all():
        ax.plot(grid, of.first_order, color=COLOURS[1], ls="--", label="first order")
    if bottom:
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(LogLocator(numticks=8))
        ax.yaxis.set_minor_formatter(NullFormatter())
        if bottom < 1e-4:
            ax.yaxis.set_minor_locator(NullLocator())
    ax.set_ylim(bottom, 1.0)
    ax.set_xlim(0.0, grid[-1])
    off = f" {write_out(f'{-centre:+.3g}')} m" if (centre := middle(result, i)) else ""
    ax.set_ylabel(f"P(|{result['/axis'][i]} error{off}| > x)")
    _mark(ax, of.limit, float(grid[-1]))
    required = min((one.limit for one in required_limits(result, "box")), default=math.inf)
    if math.isfinite(required):  # of the box, so of each of its sides at least
        ax.axhline(required, color=REQUIRED, ls=DOTTED, lw=1.2)
        word(ax, f"required of the box: {required:g}", (0.0, required), (3.0, 2.5))


def _mark(ax: Axes, limit: float, end: float) -> None:
    """Mark the limit, m, on an axis that ends at `end`, or write it at the end if it is beyond."""
    from matplotlib.patheffects import withStroke

    from navsim.report.printing import COLOURS, SMALL

    beyond, left = limit > end, limit < 0.5 * end
    if not beyond:
        ax.axvline(limit, color=COLOURS[-1], lw=0.6)
    text = f"limit {limit:g} m" + (" →" if beyond else "")
    place, side = ((3, -9), "left") if left else ((-3, -9), "right")
    ax.annotate(
        text, (min(limit, end), 1.0), place, xycoords=("data", "axes fraction"), textcoords="offset points",
        fontsize=SMALL, ha=side, path_effects=[withStroke(linewidth=1.5, foreground="white")],
    )  # fmt: skip


def exceeded(error: np.ndarray, log_weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Sizes of the errors of runs (n,), from the largest on, how often they are reached and the ends of 95 % intervals;
    above 1/2 by the runs that do not, as `/summary/rare/probability`."""
    size = np.where(np.isfinite(error), np.abs(error), np.inf)  # nan exceeds everything
    order = np.argsort(-size)
    weight, runs = np.exp(log_weight[order]), max(size.size, 2)

    def share(some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probability from the first 1, 2, ... of some weights, and factor to the end of its interval."""
        total, square = np.cumsum(some), np.cumsum(some**2)
        known = square > 0.0
        reach = np.exp(TWO_SIDED * relative_error(np.where(known, total, 1.0), np.where(known, square, 1.0), runs))
        return np.where(known, total / size.size, np.nan), reach

    beyond, reach = share(weight)
    rest, reach_of_rest = (np.append(each[::-1][1:], np.nan) for each in share(weight[::-1]))
    low, high = beyond / reach, beyond * reach
    common = beyond > 0.5
    beyond = np.where(common, 1.0 - rest, beyond)
    low = np.where(common, 1.0 - rest * reach_of_rest, low)
    high = np.where(common, 1.0 - rest / reach_of_rest, high)
    shown = np.isfinite(size[order]) & np.isfinite(beyond)
    return size[order][shown], beyond[shown], np.maximum(low[shown], 0.0), np.minimum(high[shown], 1.0)
