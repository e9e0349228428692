"""Parts of the page's drawings: plots for light and dark paper, lines, bands, points, images, with hover text.

Axes are in the unit of their label.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from textwrap import fill
from typing import Any

import numpy as np
from bokeh.core.properties import value
from bokeh.models import (
    BasicTickFormatter,
    BoxAnnotation,
    ColorBar,
    ColumnDataSource,
    FixedTicker,
    HoverTool,
    LinearColorMapper,
    LogColorMapper,
    Range1d,
    Span,
)
from bokeh.palettes import RdBu11, Viridis256
from bokeh.plotting import figure

from navsim.results.result import Result

Named = tuple[str, Result]
"""A result with its name on the page."""
AXES = ("lateral", "along", "vertical")
"""Axes of errors in the frame of the runway."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#A67C00", "#7A6FF0")
"""Colours of results and lines, distinguishable for the colour-blind (Okabe and Ito). Their yellow and sky blue are too
light on white and are replaced. Each has a contrast of 3:1 on white and on the page's dark."""
BLUE, ORANGE, GREEN = COLOURS[:3]
BROWN = "#A5682A"
"""Colour of terrain: 4.5:1 against white, 4:1 against the page's dark."""
GREY = "#808080"
TEXT = "#767676"
"""4.5:1 against white, 4:1 against the page's dark."""
MOST_POINTS = 1500
"""Largest number of points of a line; longer lines are thinned, and the caption says so."""
MOST_LINES = 20
"""Most runs drawn one by one."""
FONT = "system-ui, sans-serif"


@dataclass(frozen=True)
class Key:
    """An entry of a legend. how: line, dash, dots, band, dot, ring, triangle or star."""

    text: str
    colour: str
    how: str = "line"


@dataclass(frozen=True)
class Drawing:
    """A figure of the page."""

    name: str
    """Anchor."""
    title: str
    panels: list[figure]
    """Plots in reading order."""
    caption: str
    """Subject and results."""
    keys: list[Key] = field(default_factory=list)
    columns: int = 2
    """Number of panels side by side if there is room."""


def colour(i: int) -> str:
    """The colour of the i-th result or line."""
    return COLOURS[i % len(COLOURS)]


def width(i: int, of: int) -> float:
    """Line width for the i-th of several results: later ones are thinner, so that earlier ones remain visible."""
    return 1.6 if of == 1 else max(1.2, 3.6 - 1.2 * i)


def keys_of(results: Sequence[Named], *more: Key, of: Sequence[tuple[Any, ...]] | None = None) -> list[Key]:
    """Legend with the results by their colours, if there are several, and more.

    of: results that are drawn, each with its number before it; None for all.
    """
    drawn = range(len(results)) if of is None else [each[0] for each in of]
    return [*(Key(results[i][0], colour(i)) for i in drawn if len(results) > 1), *more]


def results_with(results: Sequence[Named], path: str) -> list[tuple[int, str, Result]]:
    """The results that have a variable, each with its number, which gives its colour."""
    return [(i, name, result) for i, (name, result) in enumerate(results) if path in result]


def as_float32(values: Any) -> np.ndarray:
    """Numbers in the page's single precision; values that are not finite are gaps."""
    data = np.asarray(values, dtype=np.float32)
    return np.where(np.isfinite(data), data, np.float32(np.nan))


@dataclass(frozen=True)
class Thinned:
    """Instants that are drawn: every `step`-th of `of`."""

    step: int
    of: int

    def __call__(self, values: np.ndarray) -> np.ndarray:
        return values[:: self.step]

    def caption(self, what: str = "instant") -> str:
        """A sentence for the caption; nothing where all are drawn."""
        return f" The figure shows every {_ordinal(self.step)} of {self.of} {what}s." if self.step > 1 else ""


def _ordinal(n: int) -> str:
    ending = "th" if 10 <= n % 100 <= 20 else {1: "st", 2: "nd", 3: "rd"}.get(n % 10, "th")
    return f"{n}{ending}"


def thin(count: int, most: int = MOST_POINTS) -> Thinned:
    """Thinning of `count` instants to at most `most`."""
    return Thinned(max(1, -(-count // most)), count)


def most_thinned(of: Iterable[Thinned]) -> Thinned:
    """The one with the largest step."""
    return max(of, key=lambda each: each.step, default=Thinned(1, 0))


def plot(title: str, x: str, y: str, height: int = 260, **more: Any) -> figure:
    """An empty plot as wide as its place. title: above it, as text of the page; x, y: labels with units."""
    out = figure(
        height=height, sizing_mode="stretch_width", tools="pan,box_zoom,wheel_zoom,reset,save", active_drag=None,
        active_scroll=None, toolbar_location="above", background_fill_alpha=0.0, border_fill_alpha=0.0,
        outline_line_color=None, name=title, min_border_left=64, min_border_right=12, **more,
    )  # fmt: skip
    out.toolbar.logo = None
    out.toolbar.autohide = True
    for axis, text in ((out.xaxis[0], x), (out.yaxis[0], fill(y, height // 7))):
        axis.update(
            axis_label=text, axis_label_text_color=TEXT, axis_label_text_font=FONT, axis_label_text_font_size="12px",
            axis_label_text_font_style="normal", major_label_text_color=TEXT, major_label_text_font=FONT,
            major_label_text_font_size="11px", axis_line_color=GREY, major_tick_line_color=GREY,
            minor_tick_line_color=None,
        )  # fmt: skip
    for grid in (out.xgrid[0], out.ygrid[0]):
        grid.update(grid_line_color=GREY, grid_line_alpha=0.25)
    return out


def source(**columns: Any) -> ColumnDataSource:
    """Columns that several marks share; numbers become `as_float32`."""
    return ColumnDataSource({
        name: values if isinstance(values, list) else as_float32(values) for name, values in columns.items()
    })  # fmt: skip


def line(on: figure, of: ColumnDataSource, y: str, colour: str, x: str = "x", **style: Any) -> Any:
    """A line through columns."""
    return on.line(x, y, source=of, line_color=colour, line_width=style.pop("line_width", 1.6), **style)


def band(on: figure, of: ColumnDataSource, low: str, high: str, colour: str, several: bool = False) -> None:
    """Area between two columns, with gaps where they are unknown.

    several: overlapping bands of several results. Only their ends are drawn, dotted, since translucent colours would
    mix.
    """
    if several:
        for end in (low, high):
            line(on, of, end, colour, line_dash="dotted", line_width=1)
        return
    known = np.isfinite(np.asarray(of.data[low])) & np.isfinite(np.asarray(of.data[high]))
    parts = [of]
    if not known.all():  # Bokeh draws an area across values that are not finite
        edges = np.flatnonzero(np.diff(known, prepend=False, append=False)).reshape(-1, 2)
        columns = ("x", low, high)
        parts = [ColumnDataSource({name: of.data[name][a:b] for name in columns}) for a, b in edges]
    for part in parts:
        on.varea("x", low, high, source=part, fill_color=colour, fill_alpha=0.18)


def drawn_as(results: Sequence[Any]) -> str:
    """Style of a `band` of these results, in a word."""
    return "dotted" if len(results) > 1 else "shaded"


def band_key(text: str, colour: str, several: bool = False) -> Key:
    """The entry of a legend for a `band`."""
    return Key(text, GREY, "dots") if several else Key(text, colour, "band")


def hover_text(on: figure, marks: Sequence[Any], *text: tuple[str, str], vertical: bool = False) -> None:
    """Hover text of these marks: pairs of a label and a Bokeh pattern.

    vertical: for all marks at the same x. The page shows the text of the nearest mark.
    """
    on.add_tools(
        HoverTool(renderers=list(marks), tooltips=list(text), mode="vline" if vertical else "mouse", limit=1,
                  point_policy="snap_to_data", line_policy="nearest", attachment="horizontal")
    )  # fmt: skip


def extend_y_axis(on: figure, values: Iterable[np.ndarray], least: float = 0.0, symmetric: bool = False) -> None:
    """Extend the y axis to 108 % of the largest of these values, from zero or from its negative."""
    known = [float(np.max(each[np.isfinite(each)])) for each in values if np.isfinite(each).any()]
    top = 1.08 * max([least, *known])
    if top > 0.0:
        on.y_range = Range1d(-top if symmetric else 0.0, top)


def vertical_line(on: figure, x: float, colour: str = GREY, dash: str = "dashed") -> None:
    """A line across the plot at x."""
    on.add_layout(Span(location=x, dimension="height", line_color=colour, line_dash=dash, line_width=1))


def horizontal_line(on: figure, y: float, colour: str = GREY, dash: str = "dashed") -> None:
    """A line across the plot at y."""
    on.add_layout(Span(location=y, dimension="width", line_color=colour, line_dash=dash, line_width=1))


def shaded_interval(on: figure, low: float, high: float, colour: str = GREY, upright: bool = False) -> None:
    """A shaded stretch of an axis."""
    ends = {"left": low, "right": high} if upright else {"bottom": low, "top": high}
    on.add_layout(BoxAnnotation(**ends, fill_color=colour, fill_alpha=0.15, line_color=None))


def names(on: figure, x: Any, y: Any, text: Iterable[object], colour: str = TEXT, **style: Any) -> None:
    """Text beside points."""
    style = {"x_offset": 6, "y_offset": 6, "text_font_size": "11px"} | style
    of = source(x=np.atleast_1d(x), y=np.atleast_1d(y), said=[str(text) for text in text])
    on.text("x", "y", "said", source=of, text_color=colour, text_font=value(FONT), **style)


def labels(on: figure, x: np.ndarray, y: np.ndarray, text: Iterable[object]) -> None:
    """Text beside points of a map, on any colour."""
    names(on, x, y, text, "black", background_fill_color="white", background_fill_alpha=0.75)


def image(
    on: figure, values: np.ndarray, x: tuple[float, float], y: tuple[float, float], mapper: Any, label: str
) -> Any:
    """An image (y, x) between ends of the axes, with its bar of colours."""
    drawn = on.image(
        image=[as_float32(values)], x=x[0], y=y[0], dw=x[1] - x[0], dh=y[1] - y[0], color_mapper=mapper, level="image"
    )
    on.grid.visible = False
    bar(on, mapper, label)
    return drawn


def bar(on: figure, mapper: Any, label: str) -> None:
    """Colour bar below a plot, with a label."""
    on.add_layout(
        ColorBar(
            color_mapper=mapper, title=label, title_text_color=TEXT, title_text_font=FONT, title_text_font_size="12px",
            title_text_font_style="normal", major_label_text_color=TEXT, major_label_text_font=FONT,
            background_fill_alpha=0.0, height=10, bar_line_color=None, padding=4, title_standoff=3,
        ),
        "below",
    )  # fmt: skip


def colour_map(low: float, high: float, *, reverse: bool = False, log: bool = False) -> Any:
    """Colours between two numbers; unknown values are transparent."""
    palette = list(Viridis256[::-1] if reverse else Viridis256)[::4]
    kind: Callable[..., Any] = LogColorMapper if log else LinearColorMapper
    return kind(palette=palette, low=low, high=high, nan_color="rgba(0,0,0,0)")


def ratio_colour_map(limit: float) -> Any:
    """Colours of ratios from 1 / limit, blue, through 1, white, to the limit, red; unknown values are transparent."""
    return LogColorMapper(palette=list(RdBu11), low=1.0 / limit, high=limit, nan_color="rgba(0,0,0,0)")


def ticks(on: figure, axis: Any, at: Sequence[float], text: Sequence[object]) -> None:
    """Words in place of numbers on an axis of a plot."""
    axis.ticker = FixedTicker(ticks=list(at))
    axis.major_label_overrides = {each: str(text) for each, text in zip(at, text, strict=True)}


def steps(on: figure, x: np.ndarray, y: np.ndarray, colour: str, **style: Any) -> Any:
    """A line that keeps each value until the next."""
    return on.step("x", "y", source=source(x=x, y=y), line_color=colour, line_width=1.6, mode="after", **style)


def view_from_above(on: figure, along: tuple[float, float], right: tuple[float, float]) -> None:
    """Set the axes of a plan, from and to, m. The landing direction points to the right of the page and the right side
    of the runway down, so the plan is a view from above and not its mirror image."""
    on.update(x_range=Range1d(*along), y_range=Range1d(right[1], right[0]))


def reversed_x_axis(on: figure, low: float, high: float) -> None:
    """An x axis that runs from its high end to its low one, as heights do in an approach."""
    on.x_range = Range1d(high, low)


def metres_on_axes(on: figure) -> None:
    """Axes in metres, whose thousands are not cut into powers of ten."""
    for axis in (on.xaxis[0], on.yaxis[0]):
        axis.formatter = BasicTickFormatter(use_scientific=False)


def cells(
    on: figure, rows: Sequence[str], columns: Sequence[str], values: np.ndarray, pattern: str, mapper: Any
) -> Any:
    """A table (rows, columns) as coloured cells with their numbers."""
    x, y = zip(*((c, r) for r in rows for c in columns), strict=True)
    flat = values.ravel()
    of = source(x=list(x), y=list(y), value=flat, said=[pattern.format(v) if np.isfinite(v) else "" for v in flat])
    drawn = on.rect("x", "y", width=1, height=1, source=of, line_color=None,
                    fill_color={"field": "value", "transform": mapper})  # fmt: skip
    middle = 0.5 * (mapper.low + mapper.high)
    for shown, ink in ((flat < middle, "white"), (flat >= middle, "black")):
        at = np.flatnonzero(shown)
        part = source(x=[x[i] for i in at], y=[y[i] for i in at], said=[of.data["said"][i] for i in at])
        on.text("x", "y", "said", source=part, text_align="center", text_baseline="middle", text_font_size="11px",
                text_color=ink)  # fmt: skip
    on.grid.visible = False
    return drawn
