"""Ridges on the plans of the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.plotting import figure

from navsim.page import plots
from navsim.report.ridges import ShownRidge, clipped

Ends = tuple[float, float]
"""From and to, m."""
_BORDER = 0.12
"""Share of a plan at its border in which a height is written towards the middle, so that it is not cut."""


def ridge_lines(on: figure, ridges: Sequence[ShownRidge], along: Ends, right: Ends, over_map: bool = False) -> bool:
    """Draw ridges with their heights within a part of a plan, from and to, m; whether there are any. over_map: there
    are colours below them."""
    there = False
    for ridge in ridges:
        parts = clipped(ridge, along, right)
        if len(parts):
            there = True
            lines = [*parts[..., 0]], [*parts[..., 1]]
            if over_map:
                on.multi_line(*lines, line_color="white", line_alpha=0.75, line_width=6)
            on.multi_line(*lines, line_color=plots.BROWN, line_width=3)
            ends = parts.reshape(-1, 2)
            x, y = ends[ends[:, 1].argmin()]
            style = _inwards(x, y, along, right)
            if over_map:
                style |= {"background_fill_color": "white", "background_fill_alpha": 0.75}
            plots.names(on, x, y, [ridge.label], plots.BROWN, **style)
    return there


def _inwards(x: float, y: float, along: Ends, right: Ends) -> dict[str, Any]:
    """Position of a label at the upper end of a line within the plan: above the end, else beside it.

    Right of the runway is down the page.
    """
    across, down_the_page = ((at - low) / (high - low) for at, (low, high) in ((x, along), (y, right)))
    down = down_the_page < _BORDER
    align = "right" if across > 1.0 - _BORDER else "left" if across < _BORDER or down else "center"
    aside = {"left": 8, "right": -8, "center": 0}[align]
    return {"text_align": align, "x_offset": aside, "y_offset": 6 if down else -4,
            "text_baseline": "top" if down else "bottom"}  # fmt: skip


def plan_of(seen: np.ndarray) -> tuple[Ends, Ends]:
    """The part of a plan, along and right, that has all places that are seen (n, 2), m."""
    (low, left), (high, right) = np.nanmin(seen, axis=0).tolist(), np.nanmax(seen, axis=0).tolist()
    return (low, high), (left, right)
