"""Ridges on the plans of the page."""

from __future__ import annotations

from collections.abc import Sequence

from bokeh.plotting import figure

from navsim.report.page.marks import names
from navsim.report.ridges import BROWN, ShownRidge, clipped


def ridge_lines(
    on: figure, ridges: Sequence[ShownRidge], along: tuple[float, float], right: tuple[float, float]
) -> bool:
    """Draw ridges with their heights within a part of a plan, from and to, m; whether there are any."""
    there = False
    for ridge in ridges:
        parts = clipped(ridge, along, right)
        if len(parts):
            there = True
            on.multi_line([*parts[..., 0]], [*parts[..., 1]], line_color=BROWN, line_width=3)
            ends = parts.reshape(-1, 2)
            x, y = ends[ends[:, 1].argmax()]
            names(on, x, y, [ridge.label], BROWN, x_offset=0, y_offset=-4, text_align="center")
    return there
