"""The paper of sky plots: north up, the zenith in the middle, 90 degrees less the elevation outwards."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bokeh.models import Range1d
from bokeh.plotting import figure

from navsim.report.page.marks import GREY, names, plot

Sector = tuple[float, float, float, float]
"""A part of the sky that is taken out: azimuths from, to, and elevations from, to, deg."""


def sky_paper(title: str, edge: float, masked: Sequence[Sector]) -> figure:
    """An empty sky down to 90 - edge, deg, with what is taken out of it shaded."""
    on = plot(title, "", "", 380)
    on.update(sizing_mode="scale_width", aspect_ratio=1.0, max_width=460, height=None)
    on.x_range = on.y_range = Range1d(-1.14 * edge, 1.14 * edge)
    for axis in (*on.axis, *on.grid):
        axis.visible = False
    for west, east, low, high in masked:
        if high > low:
            on.annular_wedge(
                0.0, 0.0, inner_radius=90.0 - high, outer_radius=90.0 - low, start_angle=90.0 - west,
                end_angle=90.0 - (east if east > west else east + 360.0), start_angle_units="deg",
                end_angle_units="deg", direction="clock", fill_color=GREY, fill_alpha=0.25, line_color=None,
            )  # fmt: skip
    for ring in (30.0, 60.0, 90.0):
        on.circle(0.0, 0.0, radius=ring, fill_color=None, line_color=GREY, line_alpha=0.5)
        names(on, 0.0, ring, [f"{90.0 - ring:g}°"], x_offset=2, y_offset=2, text_font_size="10px")
    for bearing, said in zip(range(0, 360, 45), ("N", "45°", "E", "135°", "S", "225°", "W", "315°"), strict=True):
        s, c = math.sin(math.radians(bearing)), math.cos(math.radians(bearing))
        on.segment(0.0, 0.0, edge * s, edge * c, line_color=GREY, line_alpha=0.3)
        names(on, 1.07 * edge * s, 1.07 * edge * c, [said], text_align="center", text_baseline="middle", x_offset=0,
              y_offset=0)  # fmt: skip
    return on
