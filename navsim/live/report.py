"""Report of a live run: messages received, and the filter's use of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from navsim.report.table import Table, cell
from navsim.report.view import View, one_by_one
from navsim.results.result import Result
from navsim.results.schema import COUNTS, RMS_WINDOW
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def tables(result: Result) -> list[Table | str]:
    """Counts of the stream above 0, accuracy against the scenario's truth."""
    stream = Table(f"Stream in place of the {result.attributes['replaced_block']}", ("messages", "count"))
    for name in COUNTS:
        variable = result.variables.get(f"/stream/{name}")
        count = 0 if variable is None else int(np.asarray(variable.data))
        if variable is not None and (count or name in ("received", "used")):
            stream.add(variable.long_name, cell("{}", count))
    out: list[Table | str] = [stream]
    if (time := result["/filter/time"]).size:
        rms = "  ".join(f"{x:.2f}" for x in result["/summary/rms_position_ned"])
        span = min(RMS_WINDOW, float(time[-1] - time[0]))
        out.append(f"rms position error N E D over the last {digits(span)} s: {rms} m; NIS per degree of freedom "
                   f"{result['/summary/nis'][0]:.2f}")  # fmt: skip
    offset = float(result["/clock/offset"])
    if math.isfinite(offset):
        out.append(f"time 0 of the flight by the source's clock: {offset:.3f} s ({result.attributes['clock']})")
    return [*out, f"verdict: {result.attributes['verdict']}"]


def figures(result: Result) -> dict[str, Figure]:
    """Position errors with their 3 sigma."""
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(COLUMN, 3.6)
    axes = fig.subplots(3, 1, sharex=True)
    time = result["/filter/time"]
    for i, (ax, name) in enumerate(zip(axes, ("north", "east", "down"), strict=True)):
        sigma = 3.0 * result["/filter/sigma"][:, i]
        ax.fill_between(time, -sigma, sigma, color=COLOURS[1], alpha=0.2, lw=0, label="±3σ")
        ax.plot(time, result["/filter/error"][:, i], color=COLOURS[0], label="truth minus estimate")
        ax.set_ylabel(f"{name}, m")
    axes[-1].set_xlabel("time, s")
    legend_above(fig, axes[0], 2)
    fig.align_ylabels(axes)
    return {"errors": fig}


VIEW = View(one_by_one(tables), figures, ("/summary", "/stream", "/clock"), drawings="navsim.replays.page:lives")
