"""Drawings of recorded ranges for `navsim report`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.plotting import figure

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.ranging.report import axis_names


def recorded_ranges(results: Sequence[Named]) -> list[Drawing]:
    """Track with the sources, and residuals by source."""
    return [_track(results), _residuals(results)]


def estimate_of(result: Any) -> str:
    """Name of the estimate that is drawn."""
    return "smoother" if "/smoother/position" in result else "filter"


def _track(results: Sequence[Named]) -> Drawing:
    x, y, z = axis_names(results[0][1])
    plan = plots.plot("Plan", f"{x}, m", f"{y}, m", 380, match_aspect=True)
    profile = plots.plot("Height", "time, s", f"{z}, m", 260)
    marks: list[list[Any]] = [[], []]
    thinned = []
    for i, (name, result) in enumerate(results):
        which = plots.thin(len(result["/time"]))
        thinned.append(which)
        if "/reference/position" in result:
            true = which(result["/reference/position"])
            of_truth = plots.source(time=which(result["/time"]), x=true[:, 0], y=true[:, 1], z=true[:, 2])
            plots.line(plan, of_truth, "y", plots.GREY, line_width=3.0)
            plots.line(profile, of_truth, "z", plots.GREY, x="time", line_width=3.0)
        position = which(result[f"/{estimate_of(result)}/position"])
        of = plots.source(time=which(result["/time"]), x=position[:, 0], y=position[:, 1], z=position[:, 2])
        marks[0].append(plots.line(plan, of, "y", plots.colour(i), name=name))
        marks[1].append(plots.line(profile, of, "z", plots.colour(i), x="time", name=name))
        at = result["/sources/position"]
        beacons = plots.source(x=at[:, 0], y=at[:, 1], name=[str(each) for each in result["/source"]])
        plan.scatter("x", "y", source=beacons, size=9, marker="triangle", color=plots.colour(3))
        plan.text("x", "y", text="name", source=beacons, x_offset=6, text_font_size="11px", text_color=plots.colour(3))
    for on, which_marks in zip((plan, profile), marks, strict=True):
        values = [(axis, f"@{column}{{0.00}} m") for axis, column in zip((x, y, z), "xyz", strict=True)]
        plots.hover_text(on, which_marks, ("", "$name"), ("time", "@time{0.0} s"), *values)
    caption = "Estimated positions and the sources (triangles)." + plots.most_thinned(thinned).caption("output")
    truth = [Key("reference", plots.GREY)] if any("/reference/position" in result for _, result in results) else []
    return Drawing("track", "Track", [plan, profile], caption, plots.keys_of(results, *truth))


def _residuals(results: Sequence[Named]) -> Drawing:
    panels: list[figure] = []
    names = list(dict.fromkeys(str(name) for _, result in results for name in result["/source"]))
    thinned = []
    for name in names:
        on = plots.plot(f"Residuals of {name}", "time, s", "m", 210)
        on.x_range = panels[0].x_range if panels else on.x_range
        seen = []
        for i, (_, result) in enumerate(results):
            here = np.isin(result["/ranges/source_index"], np.flatnonzero(result["/source"] == name))
            usual = result["/ranges/weight"][here] > 0.5
            time, residual = result["/ranges/time"][here], result["/ranges/residual"][here]
            which = plots.thin(int(usual.sum()))
            thinned.append(which)
            on.scatter(
                "x",
                "y",
                source=plots.source(x=which(time[usual]), y=which(residual[usual])),
                size=3,
                color=plots.colour(i),
            )
            away = plots.source(x=time[~usual], y=residual[~usual])
            on.scatter("x", "y", source=away, size=8, marker="star", color=plots.colour(3))
            if usual.any():
                seen.append(1.5 * np.percentile(np.abs(residual[usual]), [99.0]))
        plots.extend_y_axis(on, seen, symmetric=True)
        panels.append(on)
    caption = "Range less distance, clocks and biases. Stars: outliers, ranges with more than the usual noise."
    caption += plots.most_thinned(thinned).caption("range")
    keys = plots.keys_of(results, Key("outlier", plots.colour(3), "star"))
    return Drawing("residuals", "Residuals by source", panels, caption, keys)
