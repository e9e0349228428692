"""The paper of sky plots: north up, the zenith in the middle, 90 degrees less the elevation outwards."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from bokeh.core.properties import value
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from navsim.report.page.marks import FONT, GREY, TEXT, names, plot, source

Sector = tuple[float, float, float, float]
"""A part of the sky that is taken out: azimuths from, to, and elevations from, to, deg."""


_SHADE = 0.25
_BEARINGS = ("N", "45°", "E", "135°", "S", "225°", "W", "315°")
_RINGS = (30.0, 60.0, 90.0)
_WRITTEN, _REACH = 1.07, 1.14
"""How far out bearings are written, and the paper goes, of its edge."""
_NARROW = 290.0
"""Pixels of the narrowest paper on which names are kept apart: of one of three beside each other."""
_MARK, _LINE, _LETTER = 10.0, 10.0, 6.5
"""Pixels of a mark, of a line of small letters, and of one of them."""


class _Side(NamedTuple):
    """Where a name stands beside its mark: its alignment, and pixels to the right and down from mark to name."""

    align: str
    right: float
    down: float


_SIDES = (
    _Side("left", 7.0, 0.0), _Side("right", -7.0, 0.0), _Side("center", 0.0, -12.0), _Side("center", 0.0, 12.0),
    _Side("left", 5.0, -8.0), _Side("right", -5.0, -8.0), _Side("left", 5.0, 8.0), _Side("right", -5.0, 8.0),
)  # fmt: skip
"""In the order of what is liked."""


class _Box(NamedTuple):
    """What something covers of a paper, pixels from its middle to the right and down."""

    left: float
    right: float
    upper: float
    lower: float

    def common(self, other: _Box) -> float:
        """How much of it another one covers."""
        across = min(self.right, other.right) - max(self.left, other.left)
        down = min(self.lower, other.lower) - max(self.upper, other.upper)
        return across * down if across > 0.0 and down > 0.0 else 0.0


def _written(x: float, y: float, said: str, side: _Side) -> _Box:
    """What a name covers beside a mark, or, in its middle, on it."""
    wide = _LETTER * len(said)
    left = x + side.right - {"left": 0.0, "center": 0.5 * wide, "right": wide}[side.align]
    return _Box(left, left + wide, y + side.down - 0.5 * _LINE, y + side.down + 0.5 * _LINE)


def skyline(on: figure, azimuth: np.ndarray, elevation: np.ndarray, mask: float) -> None:
    """Shade on a `sky_paper` what a horizon takes out of the sky above a mask, deg. azimuth, elevation: of its corners,
    rad, azimuths growing; straight between them."""
    around = np.union1d(np.linspace(0.0, 2.0 * math.pi, 361), azimuth)
    over = np.degrees(np.interp(around, azimuth, elevation, period=2.0 * math.pi))
    radius = np.concatenate((np.full(around.size, 90.0 - mask), (90.0 - np.maximum(over, mask))[::-1]))
    there = np.concatenate((around, around[::-1]))
    of = source(x=radius * np.sin(there), y=radius * np.cos(there))
    on.patch("x", "y", source=of, fill_color=GREY, fill_alpha=_SHADE, line_color=None)


def _bearings() -> list[tuple[str, float, float]]:
    """Names of bearings, and their sines and cosines."""
    turns = [2.0 * math.pi * i / len(_BEARINGS) for i in range(len(_BEARINGS))]
    return [(said, math.sin(turn), math.cos(turn)) for said, turn in zip(_BEARINGS, turns, strict=True)]


def beside(x: Sequence[float], y: Sequence[float], said: Sequence[str], edge: float) -> dict[str, list[Any]]:
    """Columns of names of marks on a `sky_paper`, for `name_marks`: each name stands where it covers least of marks, of
    names before it, and of what is written on the paper."""
    scale = 0.5 * _NARROW / (_REACH * edge)
    out = scale * _WRITTEN * edge
    taken = [_written(out * s, -out * c, name, _Side("center", 0.0, 0.0)) for name, s, c in _bearings()]
    taken += [_written(0.0, -scale * ring, f"{90.0 - ring:g}°", _Side("left", 2.0, -4.0)) for ring in _RINGS]
    places = [(scale * right, -scale * up) for right, up in zip(x, y, strict=True)]
    half = 0.5 * _MARK
    marks = [_Box(right - half, right + half, down - half, down + half) for right, down in places]
    paper = _Box(-0.5 * _NARROW, 0.5 * _NARROW, -0.5 * _NARROW, 0.5 * _NARROW)
    sides: list[_Side] = []
    for i, (place, name) in enumerate(zip(places, said, strict=True)):
        there = [*taken, *marks[:i], *marks[i + 1 :]]
        boxes = [_written(*place, name, side) for side in _SIDES]
        covered = [sum(map(box.common, there)) + box.common(box) - box.common(paper) for box in boxes]
        best = covered.index(min(covered))
        taken.append(boxes[best])
        sides.append(_SIDES[best])
    return {
        "x": list(x), "y": list(y), "said": list(said), "align": [side.align for side in sides],
        "right": [side.right for side in sides], "down": [side.down for side in sides],
    }  # fmt: skip


def name_marks(on: figure, of: ColumnDataSource) -> None:
    """Write the names that are in the columns of `beside`."""
    on.text("x", "y", "said", source=of, text_align="align", text_baseline="middle", x_offset="right", y_offset="down",
            text_color=TEXT, text_font=value(FONT), text_font_size="10px")  # fmt: skip


def sky_paper(title: str, edge: float, masked: Sequence[Sector]) -> figure:
    """An empty sky down to 90 - edge, deg, with what is taken out of it shaded."""
    on = plot(title, "", "", 380)
    # the frame is as wide as it is high: rings take their radius from the one, marks their places from both
    on.update(sizing_mode="scale_width", aspect_ratio=1.0, max_width=460, height=None, toolbar_inner=True,
              min_border=12, min_border_left=12, min_border_right=12)  # fmt: skip
    on.x_range = on.y_range = Range1d(-_REACH * edge, _REACH * edge)
    for axis in (*on.axis, *on.grid):
        axis.visible = False
    for west, east, low, high in masked:
        if high > low:
            on.annular_wedge(
                0.0, 0.0, inner_radius=90.0 - high, outer_radius=90.0 - low, start_angle=90.0 - west,
                end_angle=90.0 - (east if east > west else east + 360.0), start_angle_units="deg",
                end_angle_units="deg", direction="clock", fill_color=GREY, fill_alpha=_SHADE, line_color=None,
            )  # fmt: skip
    for ring in _RINGS:
        on.circle(0.0, 0.0, radius=ring, fill_color=None, line_color=GREY, line_alpha=0.5)
        names(on, 0.0, ring, [f"{90.0 - ring:g}°"], x_offset=2, y_offset=2, text_font_size="10px")
    for said, s, c in _bearings():
        on.segment(0.0, 0.0, edge * s, edge * c, line_color=GREY, line_alpha=0.3)
        names(on, _WRITTEN * edge * s, _WRITTEN * edge * c, [said], text_align="center", text_baseline="middle",
              x_offset=0, y_offset=0)  # fmt: skip
    return on
