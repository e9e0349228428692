"""Drawings of the probability of leaving a box: exceedance curves, and where pushed runs end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import Range1d

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.report.box_rows import box_limits
from navsim.report.rare import curve, middle
from navsim.results.findings import several

_MOST = 400
"""Largest number of steps of a curve; longer curves are thinned."""


def drawings(results: Sequence[Named], first: int) -> list[Drawing]:
    """The drawings of these results. first: the number, which gives the colour, of the first of them on the page."""
    return [_exceedance(results, first), _runs(results, first)]


def _keys(results: Sequence[Named], first: int, *more: Key) -> list[Key]:
    """A legend with the results, where others are on the page, and more."""
    several_here = first + len(results) > 1
    return [*(Key(name, plots.colour(i)) for i, (name, _) in enumerate(results, first) if several_here), *more]


def _exceedance(results: Sequence[Named], first: int) -> Drawing:
    """Probability that each limited error exceeds a size, from shifted runs and to first order."""
    panels = []
    for k, axis in enumerate(map(str, results[0][1]["/axis"])):
        curves = [(i, name, curve(result, k)) for i, (name, result) in enumerate(results, first)
                  if box_limits(result, k) is not None]  # fmt: skip
        if not curves:
            continue
        bottom = min(each.bottom for _, _, each in curves)
        off = any(middle(result, k) for _, result in results)
        error = f"{axis} error, from the middle of its limits" if off else f"{axis} error"
        on = plots.plot(axis.capitalize(), "x, m" if off else "size x of the error, m", f"P(|{error}| > x)", 320,
                        y_axis_type="log" if bottom > 0.0 else "linear")  # fmt: skip
        on.x_range = Range1d(0.0, max(float(each.grid[-1]) for _, _, each in curves))
        on.y_range = Range1d(bottom, 1.0)
        marks: list[Any] = []
        for i, name, each in curves:
            which = plots.thin(each.size.size, _MOST)
            floor = bottom if bottom > 0.0 else 0.0
            of = plots.source(
                x=which(each.size), y=which(each.chance), low=np.maximum(which(each.low), floor), high=which(each.high)
            )
            if len(curves) == 1:
                on.varea_step(
                    "x", "low", "high", source=of, step_mode="after", fill_color=plots.colour(i), fill_alpha=0.2
                )
            for end in ("low", "high") if len(curves) > 1 else ():  # translucent colours would mix
                on.step("x", end, source=of, mode="after", line_color=plots.colour(i), line_dash="dotted")
            marks.append(
                on.step("x", "y", source=of, mode="after", line_color=plots.colour(i), line_width=1.6, name=name)
            )
            if not np.isnan(each.first_order).all():
                plots.line(on, plots.source(x=each.grid, y=each.first_order), "y", plots.colour(i), line_dash="dashed")
            plots.vertical_line(on, each.limit, plots.colour(i) if len(results) > 1 else plots.GREY)
        plots.hover_text(on, marks, ("", "$name"), ("size", "@x{0.000} m"), ("chance", "@y{0.0e+0}"),
                         ("95 %", "@low{0.0e+0} to @high{0.0e+0}"))  # fmt: skip
        panels.append(on)
    counted = ", ".join(f"{name}: {several(result['/run'].size, 'pushed run')}" for name, result in results)
    caption = (
        "How often an error at the height of the box exceeds a size, by weighed runs with their 95 % interval "
        f"({counted}); dashed curve: a Gaussian by first order; upright line: the limit."
    )
    return Drawing("exceedance", "How often errors exceed a size", panels, caption,
                   _keys(results, first, Key("first order", plots.GREY, "dash")))  # fmt: skip


def _runs(results: Sequence[Named], first: int) -> Drawing:
    """Final errors of shifted runs, lateral and vertical."""
    on = plots.plot("Vertical against lateral", "lateral error, m", "vertical error, m", 360, match_aspect=True)
    marks = []
    for i, (name, result) in enumerate(results, first):
        error = result["/rare/error"]
        which = plots.thin(len(error))
        weight = np.exp(result["/rare/log_weight"])
        of = plots.source(x=which(error[:, 0]), y=which(error[:, 2]), weight=which(weight))
        marks.append(on.scatter("x", "y", source=of, size=5, color=plots.colour(i), line_color=None, name=name,
                                alpha=0.6 if len(results) == 1 else 1.0))  # fmt: skip
        for k, side in ((0, plots.vertical_line), (2, plots.horizontal_line)):
            for end in box_limits(result, k) or ():
                side(on, end, plots.colour(i) if len(results) > 1 else plots.GREY)
    plots.hover_text(
        on, marks, ("", "$name"), ("lateral", "@x{0.000} m"), ("vertical", "@y{0.000} m"), ("weight", "@weight{0.0e+0}")
    )
    caption = (
        "Errors of the pushed runs at the height of the box (dashed). They are pushed towards its faces: how dense "
        "they lie is no probability, their weights make one of it."
    )
    return Drawing(
        "pushed", "Pushed runs and the box", [on], caption, _keys(results, first, Key("box", plots.GREY, "dash"))
    )
