"""Printing of figures: width, format and resolution, distinguishable styles, fitting legends and labels, equal bytes.

Styles are distinguishable for the colour-blind. The bytes of a file are the same each time.
"""

from __future__ import annotations

import functools
import io
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from navsim.report.figure_files import MARK, mark_of_text

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

COLUMN = 3.5
"""Width of a journal column, inches; two-column figures are twice as wide, which is the default."""
SMALL = 7.0
"""The smallest letters, points."""
STYLE: Any = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "figure.titlesize": 8.0,
    "legend.fontsize": SMALL,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.4,
    "lines.linewidth": 0.9,
    # figures have the layout of `fit`, whatever the user's matplotlibrc contains
    "figure.autolayout": False,
    "figure.constrained_layout.use": False,
    "hatch.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 200,
    # text stays text, in files that are the same each time
    "svg.fonttype": "none",
    "svg.hashsalt": "navsim",
    "pdf.fonttype": 42,
}
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours distinguishable for the colour-blind (Okabe and Ito)."""
LINES = ("-", "--", "-.", ":")
MARKS = "osD^v<>Pp"


@dataclass(frozen=True)
class Print:
    """format: one of `FORMATS`. width: of every figure, inches, None for its own. dpi: of pictures, None for that of
    the style."""

    format: str = "png"
    width: float | None = None
    dpi: float | None = None


FORMATS = ("png", "svg", "pdf")
_WIDTH: ContextVar[float | None] = ContextVar("width", default=None)


@contextmanager
def printed(how: Print) -> Iterator[None]:
    """Figures made here are of this width, in the common style."""
    token = _WIDTH.set(how.width)
    try:
        with mpl.rc_context(STYLE):
            yield
    finally:
        _WIDTH.reset(token)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches; in the printed width if that is set."""
    return Figure(figsize=(_WIDTH.get() or width, height), layout="constrained")


def narrow(figure: Figure) -> bool:
    """Whether a figure has the width of a column, so that wide panels go below each other."""
    return figure.get_figwidth() < 1.4 * COLUMN


def abreast(figure: Figure, count: int, **how: Any) -> list[Axes]:
    """Panels side by side; in a narrow figure below each other, with correspondingly more height."""
    if not narrow(figure):
        return list(figure.subplots(1, count, squeeze=False, **how)[0])
    figure.set_figheight(figure.get_figheight() * (1.0 + 0.85 * (count - 1)))
    how = {name: value for name, value in how.items() if name not in ("width_ratios", "sharey")}
    return list(figure.subplots(count, 1, squeeze=False, **how)[:, 0])


def style(i: int) -> dict[str, Any]:
    """Colour and dashes of the i-th of many lines: dashes distinguish equal colours."""
    return {"color": COLOURS[i % len(COLOURS)], "ls": LINES[i // len(COLOURS) % len(LINES)]}


def marked(i: int) -> dict[str, Any]:
    """Colour and mark of the i-th of many rows of points."""
    return {"color": COLOURS[i % len(COLOURS)], "marker": MARKS[i % len(MARKS)]}


def legend(
    figure: Figure, handles: Sequence[Artist], labels: Sequence[str], columns: int, loc: Any, title: str | None = None
) -> None:
    """A legend of a figure, outside its panels, in as many columns as have room; the figure grows by the rows that are
    more than one."""
    room = 72.0 * figure.get_figwidth() - 8.0
    if not handles:
        return
    columns = max(1, min(columns, len(handles)))
    words = list(labels)
    broken = None if title is None else _broken(title, room - 12.0, 8.0)

    def draw_legend(columns: int) -> Any:
        return figure.legend(handles, words, loc=loc, ncols=columns, title=broken, title_fontsize=8.0)

    while (out := draw_legend(columns)) and columns > 1 and _width(figure, out) > room:
        out.remove()
        columns -= 1
    if _width(figure, out) > room:
        out.remove()
        words = [_broken(label, room - 30.0, SMALL) for label in labels]
        out = draw_legend(1)
    height = out.get_window_extent(_renderer(figure)).height * 72.0 / figure.dpi
    figure.set_figheight(figure.get_figheight() + max(0.0, height - 20.0) / 72.0)


_TO_SCALE: WeakKeyDictionary[Figure, list[Axes]] = WeakKeyDictionary()


def to_scale_below(figure: Figure, axes: Iterable[Axes]) -> None:
    """Have `fit` make a figure as high as panels need, each below the other, some of them to scale."""
    _TO_SCALE[figure] = list(axes)


def _close_up(figure: Figure) -> None:
    """Give panels to scale the height that their width asks for, so that no band stays empty."""
    axes, engine = _TO_SCALE.get(figure, []), figure.get_layout_engine()
    if not axes or engine is None:
        return
    grid = axes[0].get_gridspec()
    assert grid is not None
    for _ in range(8):  # another height leaves letters other room
        engine.execute(figure)
        whole, heights, more = figure.get_figheight(), [], 0.0
        for ax in axes:
            room = ax.get_position(original=True)
            heights.append(room.height * whole)
            if ax.get_aspect() != "auto":
                up, across = (abs(float(np.diff(ends)[0])) for ends in (ax.get_ylim(), ax.get_xlim()))
                heights[-1] = room.width * figure.get_figwidth() * up / across
            more += heights[-1] - room.height * whole
        figure.set_figheight(whole + more)
        grid.set_height_ratios(heights)
        if abs(more) < 0.01:
            break


_THIN = 0.5
"""Width of the columns of a panel in which a line shows no more than its least and its largest value, points."""
_APART = 4.0
"""Least room between numbers below an axis, points."""


def fit(figure: Figure) -> None:
    """Break titles and labels that are longer than the room they have, leave out numbers below axes that would run
    into each other, and points of lines that no print shows. The figure is arranged then, and stays so."""
    whole = 72.0 * figure.get_figwidth() - 8.0
    for text in figure.texts:
        _fit(text, whole)
    engine, renderer, broken = figure.get_layout_engine(), _renderer(figure), False
    if engine is not None:
        engine.execute(figure)
    scale = 72.0 / figure.dpi
    for ax in figure.axes:
        box = ax.get_window_extent(renderer)
        middle = 0.5 * (box.x0 + box.x1) * scale
        # text centred over a panel may extend to the nearer side of the page
        reach = 2.0 * min(middle, 72.0 * figure.get_figwidth() - middle) - 6.0
        alone = _alone_in_row(ax, figure)
        across = max(box.width * scale, reach if alone else box.width * scale)
        for text in (ax.title, ax.xaxis.label):
            broken |= _fit(text, across)
        # the stubs do not know it, and matplotlib gives out the title in the middle alone
        left = ax._left_title  # type: ignore[attr-defined]
        broken |= _fit(left, 72.0 * figure.get_figwidth() - box.x0 * scale - 4.0)
        broken |= _fit(ax.yaxis.label, box.height * scale)
        _spread_numbers(ax)
        for line in ax.lines:
            _thin(line, ax, box.width * scale)
    _close_up(figure)
    if engine is not None:
        if broken or figure in _TO_SCALE:
            engine.execute(figure)
        figure.set_layout_engine(None)  # with any engine, one that does nothing too, matplotlib draws each file twice


def _spread_numbers(ax: Axes) -> None:
    """Fewer numbers below an axis whose numbers run into each other."""
    from matplotlib.ticker import MaxNLocator

    axis, locator = ax.xaxis, ax.xaxis.get_major_locator()
    if not isinstance(locator, MaxNLocator) or not any(label.get_visible() for label in ax.get_xticklabels()):
        return
    scale = 72.0 / ax.figure.dpi

    def close() -> bool:
        at = np.asarray(axis.get_majorticklocs(), float)
        low, high = sorted(ax.get_xlim())
        numbers = axis.get_major_formatter().format_ticks(at.tolist())
        words = [text for x, text in zip(at, numbers, strict=True)
                 if low <= x <= high]  # fmt: skip
        seen = at[(at >= low) & (at <= high)]
        middle = ax.transData.transform(np.column_stack([seen, np.full(seen.size, ax.get_ylim()[0])]))[:, 0] * scale
        order = np.argsort(middle)
        long = np.array([_length(words[i], SMALL) for i in order])
        return bool(np.any(np.diff(middle[order]) < 0.5 * (long[1:] + long[:-1]) + _APART))

    count = len(axis.get_majorticklocs())
    while close() and count > 2:
        count -= 1
        locator.set_params(nbins=count)


def _thin(line: Line2D, ax: Axes, wide: float) -> None:
    """Reduce a line over a panel of this width, points, to the least and the largest value in every column of the
    print."""
    x, y = (np.asarray(values, float) for values in line.get_data())
    columns = int(wide / _THIN)
    if line.get_marker() not in ("None", None, "", " ") or line.get_drawstyle() != "default" or x.size <= 3 * columns:
        return
    if np.any(np.diff(x) < 0.0):
        return
    low, high = ax.get_xlim()
    group = np.floor((x - low) / (high - low) * columns)
    known = np.isfinite(y)
    first = np.flatnonzero(np.append(True, (np.diff(group) != 0.0) | (known[1:] != known[:-1])))
    number = np.cumsum(np.isin(np.arange(x.size), first)) - 1
    order = np.lexsort((y, number))  # by value in each part of one column
    last = np.append(first[1:], x.size) - 1
    kept = np.unique(np.concatenate([order[first], order[last], [0, x.size - 1]]))
    line.set_data(x[kept], y[kept])


def _alone_in_row(ax: Axes, figure: Figure) -> bool:
    here = ax.get_position()
    return not any(
        other is not ax and other.get_position().y0 < here.y1 and other.get_position().y1 > here.y0
        for other in figure.axes
    )


def _fit(text: Text, room: float) -> bool:
    """Break a text; returns whether it had to be."""
    said = text.get_text()
    if not said.strip():
        return False
    lines = _broken(said, room, float(text.get_fontsize()))
    text.set_text(lines)
    return lines != said


def _broken(text: str, room: float, size: float) -> str:
    """Words in lines that are no longer than the room, points; lines that are short enough stay."""
    return "\n".join(part for line in text.split("\n") for part in _lines(line, room, size))


def _lines(line: str, room: float, size: float) -> list[str]:
    lines = [line]
    most = len(line)
    while most > 8 and max(_length(each, size) for each in lines) > room:
        most -= 1
        lines = textwrap.wrap(line, most, break_long_words=False) or [line]
    return lines


def _length(line: str, size: float) -> float:
    """Width of a line of text, points."""
    return 0.01 * size * _hundredfold(line)


@functools.lru_cache(maxsize=4096)
def _hundredfold(line: str) -> float:
    """Width of a line of text in letters of a hundred points: all sizes have the same outlines."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    if not line.strip():
        return 0.0
    path = TextPath((0, 0), line, 100.0, prop=FontProperties())
    # outlines have a point at their extremes, curves stay within theirs; a closed outline has no end
    return float(np.ptp(path.vertices[path.codes != path.CLOSEPOLY, 0]))


def _renderer(figure: Figure) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return FigureCanvasAgg(figure).get_renderer()


def _width(figure: Figure, artist: Any) -> float:
    return float(artist.get_window_extent(_renderer(figure)).width) * 72.0 / figure.dpi


def content(figure: Figure, how: Print, stem: str) -> bytes:
    """The bytes of a figure's file, the same each time, with the mark of the result it is of."""
    out = io.BytesIO()
    metadata: dict[str, Any] = {MARK: stem}
    if how.format == "svg":
        metadata = {"Date": None, "Description": mark_of_text(stem)}
    elif how.format == "pdf":
        metadata = {"CreationDate": None, "Subject": mark_of_text(stem)}
    dpi: dict[str, Any] = {} if how.dpi is None else {"dpi": how.dpi}
    figure.savefig(out, format=how.format, metadata=metadata, **dpi)
    return out.getvalue()


def named_handles(axes: Iterable[Axes]) -> dict[str, Any]:
    """Items of the legends of these panels, each name once."""
    return {label: h for ax in axes for h, label in zip(*ax.get_legend_handles_labels(), strict=True)}
