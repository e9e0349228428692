"""The paper of sky plots: north up, the zenith in the middle, 90 degrees less the elevation outwards."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from navsim.page import plots
from navsim.report.label_placement import Letters
from navsim.report.sky import REACH, RINGS, SHADE, WRITTEN, Sector, bearings, shaded, sides

_NARROW = 290.0
"""Width of the narrowest paper on which labels do not overlap, pixels: one of three side by side."""
_LETTERS = Letters(10.0, 10.0, 6.5)
"""Pixels."""


def skyline(
    on: figure, azimuth: np.ndarray, elevation: np.ndarray, mask: float, colour: str = plots.GREY, alpha: float = SHADE
) -> None:
    """Shade on a `sky_paper` the part of the sky that a horizon hides above a mask, deg.

    azimuth, elevation: of its corners, rad, azimuths increasing; straight between them.
    """
    x, y = shaded(azimuth, elevation, mask)
    on.patch("x", "y", source=plots.source(x=x, y=y), fill_color=colour, fill_alpha=alpha, line_color=None)


def beside(x: Sequence[float], y: Sequence[float], text: Sequence[str], edge: float) -> dict[str, list[Any]]:
    """Columns with labels of marks on a `sky_paper`, for `name_marks`.

    Each label has the position with least overlap with marks, earlier labels and text on the paper.
    """
    put = sides(x, y, text, edge, _NARROW, _LETTERS)
    return {
        "x": list(x), "y": list(y), "said": list(text), "align": [side.align for side in put],
        "right": [side.right for side in put], "down": [side.down for side in put],
    }  # fmt: skip


def name_marks(on: figure, of: ColumnDataSource) -> None:
    """Write the labels in the columns of `beside`."""
    on.text("x", "y", "said", source=of, text_align="align", text_baseline="middle", x_offset="right", y_offset="down",
            text_color=plots.TEXT, text_font=value(plots.FONT), text_font_size="10px")  # fmt: skip


def sky_paper(title: str, edge: float, masked: Sequence[Sector]) -> figure:
    """Empty sky plot down to 90 - edge, deg, with the masked part shaded."""
    on = plots.plot(title, "", "", 380)
    # the frame is square: rings take their radius from one side, marks their positions from both
    on.update(sizing_mode="scale_width", aspect_ratio=1.0, max_width=460, height=None, toolbar_inner=True,
              min_border=12, min_border_left=12, min_border_right=12)  # fmt: skip
    on.x_range = on.y_range = Range1d(-REACH * edge, REACH * edge)
    for axis in (*on.axis, *on.grid):
        axis.visible = False
    for west, east, low, high in masked:
        if high > low:
            on.annular_wedge(
                0.0, 0.0, inner_radius=90.0 - high, outer_radius=90.0 - low, start_angle=90.0 - west,
                end_angle=90.0 - (east if east > west else east + 360.0), start_angle_units="deg",
                end_angle_units="deg", direction="clock", fill_color=plots.GREY, fill_alpha=SHADE, line_color=None,
            )  # fmt: skip
    for ring in RINGS:
        on.circle(0.0, 0.0, radius=ring, fill_color=None, line_color=plots.GREY, line_alpha=0.5)
        if ring < 90.0:  # the bearings are written at the horizon
            plots.names(on, 0.0, ring, [f"{90.0 - ring:g}°"], x_offset=2, y_offset=2, text_font_size="10px")
    for text, s, c in bearings():
        on.segment(0.0, 0.0, edge * s, edge * c, line_color=plots.GREY, line_alpha=0.3)
        plots.names(on, WRITTEN * edge * s, WRITTEN * edge * c, [text], text_align="center", text_baseline="middle",
                    x_offset=0, y_offset=0)  # fmt: skip
    return on
