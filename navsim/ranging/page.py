"""Drawings of recorded ranges for `navsim report`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.plotting import figure

from navsim.page.plots import (
    GREY,
    Drawing,
    Key,
    Named,
    colour,
    keys_of,
    line,
    most_thinned,
    plot,
    reach,
    some,
    source,
    tell,
)
from navsim.ranging.report import axis_names


def recorded_ranges(results: Sequence[Named]) -> list[Drawing]:
    """Track with the sources, and residuals by source."""
    return [_track(results), _residuals(results)]


def estimate_of(result: Any) -> str:
    """Name of the estimate that is drawn."""
    return "smoother" if "/smoother/position" in result else "filter"


def _track(results: Sequence[Named]) -> Drawing:
    x, y, z = axis_names(results[0][1])
    plan = plot("Plan", f"{x}, m", f"{y}, m", 380, match_aspect=True)
    profile = plot("Height", "time, s", f"{z}, m", 260)
    marks: list[list[Any]] = [[], []]
    thinned = []
    for i, (name, result) in enumerate(results):
        which = some(len(result["/time"]))
        thinned.append(which)
        if "/reference/position" in result:
            true = which(result["/reference/position"])
            of_truth = source(time=which(result["/time"]), x=true[:, 0], y=true[:, 1], z=true[:, 2])
            line(plan, of_truth, "y", GREY, line_width=3.0)
            line(profile, of_truth, "z", GREY, x="time", line_width=3.0)
        position = which(result[f"/{estimate_of(result)}/position"])
        of = source(time=which(result["/time"]), x=position[:, 0], y=position[:, 1], z=position[:, 2])
        marks[0].append(line(plan, of, "y", colour(i), name=name))
        marks[1].append(line(profile, of, "z", colour(i), x="time", name=name))
        at = result["/sources/position"]
        beacons = source(x=at[:, 0], y=at[:, 1], name=[str(each) for each in result["/source"]])
        plan.scatter("x", "y", source=beacons, size=9, marker="triangle", color=colour(3))
        plan.text("x", "y", text="name", source=beacons, x_offset=6, text_font_size="11px", text_color=colour(3))
    for on, which_marks in zip((plan, profile), marks, strict=True):
        values = [(axis, f"@{column}{{0.00}} m") for axis, column in zip((x, y, z), "xyz", strict=True)]
        tell(on, which_marks, ("", "$name"), ("time", "@time{0.0} s"), *values)
    caption = "Estimated positions and the sources (triangles)." + most_thinned(thinned).caption("output")
    truth = [Key("reference", GREY)] if any("/reference/position" in result for _, result in results) else []
    return Drawing("track", "Track", [plan, profile], caption, keys_of(results, *truth))


def _residuals(results: Sequence[Named]) -> Drawing:
    panels: list[figure] = []
    names = list(dict.fromkeys(str(name) for _, result in results for name in result["/source"]))
    thinned = []
    for name in names:
        on = plot(f"Residuals of {name}", "time, s", "m", 210)
        on.x_range = panels[0].x_range if panels else on.x_range
        seen = []
        for i, (_, result) in enumerate(results):
            here = np.isin(result["/ranges/source_index"], np.flatnonzero(result["/source"] == name))
            usual = result["/ranges/weight"][here] > 0.5
            time, residual = result["/ranges/time"][here], result["/ranges/residual"][here]
            which = some(int(usual.sum()))
            thinned.append(which)
            on.scatter("x", "y", source=source(x=which(time[usual]), y=which(residual[usual])), size=3, color=colour(i))
            away = source(x=time[~usual], y=residual[~usual])
            on.scatter("x", "y", source=away, size=8, marker="star", color=colour(3))
            if usual.any():
                seen.append(1.5 * np.percentile(np.abs(residual[usual]), [99.0]))
        reach(on, seen, symmetric=True)
        panels.append(on)
    caption = "Range less distance, clocks and biases. Stars: outliers, ranges with more than the usual noise."
    caption += most_thinned(thinned).caption("range")
    keys = keys_of(results, Key("outlier", colour(3), "star"))
    return Drawing("residuals", "Residuals by source", panels, caption, keys)
