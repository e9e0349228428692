"""How the probability of leaving a box is shown: as a table, and as exceedance curves of the errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from navsim.core.arrays import normal
from navsim.core.arrays.sampling import FEW, TWO_SIDED, relative_error
from navsim.io.findings import several
from navsim.io.results import Result
from navsim.report.table import ABSENT, Cell, Table, cell
from navsim.report.tables import box_head, box_to_first_order, runs_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FAR = 1e-12
"""Probabilities below this are told to rest on the tails that inputs are drawn from."""
_LEAST = 1e-12
"""Probabilities below this are not drawn."""


def table(results: Sequence[tuple[str, Result]]) -> Table:
    """Probabilities of leaving a box, a column a result: names and results in order."""
    out = Table("", ("", *(name for name, _ in results)), labelled=True)

    def row(label: str, shown: Callable[[Result], Cell | str]) -> None:
        out.add(label, *(shown(result) for _, result in results))

    axes = list(enumerate(map(str, results[0][1]["/axis"])))
    row("pushed runs", runs_of)
    out.head("Outside the box", *(box_head(result, flown=True) for _, result in results))
    row("  any limit exceeded", lambda r: _probability(r["/summary/rare/probability"], _effective(r)))
    for i, axis in axes:
        row(f"  {axis}", lambda r, i=i: _of_axis(r, i))  # type: ignore[misc]
    out.head("The same to first order", *(box_head(result, flown=False) for _, result in results))
    row("  any limit exceeded", lambda r: box_to_first_order(r, None))
    for i, axis in axes:
        row(f"  {axis}", lambda r, i=i: box_to_first_order(r, i))  # type: ignore[misc]
    out.head("Errors there to first order, m", *("mean, 1 sigma" for _ in results))
    for i, axis in axes:
        row(f"  {axis}", lambda r, i=i: _first_order(r, i))  # type: ignore[misc]
    out.head("What it rests on")
    row("  relative error, 1 sigma", _relative_error)
    row("  effective samples", lambda r: cell("{:.0f}", _effective(r)))
    row("  runs outside the box", lambda r: cell("{}", int(r["/summary/rare/outside"])))
    row("  time of the box, s", lambda r: cell("{:.2f}", float(r["/summary/box/time"])))
    return out


def _probability(values: np.ndarray, effective: float, beyond: str = "") -> Cell:
    value, low, high = map(float, values)
    few = f"  ({several(round(effective), 'effective sample')})" if effective < FEW else ""
    tails = "  (if tails are Gaussian)" if not value >= _FAR else ""
    if effective == 0.0:
        return cell("none found; below {:.2g}" + beyond, high)
    if np.isnan(value):
        return cell("below {:.2g}" + beyond + tails + few, high)
    if value == 1.0:
        return cell("all found; above {:.3g}" + beyond + few, low)
    return cell("{:.3g}  [{:.3g}, {:.3g}]" + beyond + tails + few, value, low, high)


def _of_axis(result: Result, i: int) -> Cell | str:
    limit = float(result["/summary/box/limit"][i])
    if not np.isfinite(limit):
        return ABSENT
    effective = float(result["/summary/rare/axis_effective_samples"][i])
    return _probability(result["/summary/rare/axis_probability"][i], effective, f"  (beyond {limit:g} m)")


def _effective(result: Result) -> float:
    return float(result["/summary/rare/effective_samples"])


def _relative_error(result: Result) -> Cell:
    return Cell("{:.1f} %", (100.0 * float(result["/summary/rare/relative_error"]),), whole=True)


def _first_order(result: Result, i: int) -> Cell:
    mean, sigma = (float(result[f"/summary/box/axis_{name}"][i]) for name in ("mean", "sigma"))
    return cell("{:+.3f}, {:.3f}", round(mean, 3) + 0.0, sigma)  # no negative zero


def figures(result: Result) -> dict[str, Figure]:
    """The figures of a probability of leaving a box, by name."""
    return {"exceedance": exceedance(result)}


def exceedance(result: Result) -> Figure:
    """How often each limited error exceeds a size, by pushed runs and to first order."""
    from navsim.report.figures import COLUMN, legend_above, new_figure

    some = np.flatnonzero(np.isfinite(result["/summary/box/limit"]))
    fig = new_figure(COLUMN, 1.9 * some.size + 0.5)
    axes = fig.subplots(some.size, 1, squeeze=False)[:, 0]
    for ax, i in zip(axes, some, strict=True):
        _curve(ax, result, int(i))
    axes[-1].set_xlabel("size x of the error, m")
    legend_above(fig, axes[0], 3)
    return fig


def _curve(ax: Axes, result: Result, i: int) -> None:
    from navsim.report.figures import COLOURS, SMALL

    limit, mean, sigma = (float(result[f"/summary/box/{name}"][i]) for name in ("limit", "axis_mean", "axis_sigma"))
    error = result["/rare/error"][:, i]
    size = np.where(np.isfinite(error), np.abs(error), np.inf)  # what is no number exceeds everything
    order = np.argsort(-size)
    weight = np.exp(result["/rare/log_weight"][order])
    total = np.cumsum(weight)
    chance = total / size.size
    shown = np.isfinite(size[order]) & (chance < 0.5) & (np.cumsum(weight**2) > 0.0)
    x, chance = size[order][shown], chance[shown]
    reach = np.exp(TWO_SIDED * relative_error(total[shown], np.cumsum(weight**2)[shown], max(size.size, 2)))
    ax.fill_between(x, chance / reach, np.minimum(chance * reach, 1.0), color=COLOURS[0], alpha=0.25, lw=0)
    ax.plot(x, chance, color=COLOURS[0], label=f"{size.size} pushed runs, 95 %")
    grid = np.linspace(0.0, 1.1 * limit, 300)
    ax.plot(grid, normal.exceedance(grid, mean, sigma), color=COLOURS[1], ls="--", label="first order")
    ax.axvline(limit, color=COLOURS[-1], lw=0.6)
    ax.annotate("limit", (limit, 1.0), (-3, -9), textcoords="offset points", fontsize=SMALL, ha="right")
    at_limit = float(result["/summary/rare/axis_probability"][i, 0]), float(result["/summary/box/axis_first_order"][i])
    least = min((p for p in at_limit if p > 0.0), default=_LEAST)
    ax.set_yscale("log")
    ax.set_ylim(max(0.05 * least, _LEAST), 1.0)
    ax.set_xlim(0.0, 1.1 * limit)
    ax.set_ylabel(f"P(|{result['/axis'][i]} error| > x)")
