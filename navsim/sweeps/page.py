"""Drawings of sweeps: a map, or curves, of each output; results one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.plotting import figure

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.page.terrain import ridge_lines
from navsim.report.result_cells import setting
from navsim.report.ridges import shown_ridges
from navsim.report.table import as_text
from navsim.results.result import Result
from navsim.sweeps import report

_MOST_MAPS = 12
"""Most outputs of a sweep that are drawn; the table has all."""
_MOST_CURVES = 6
RUNWAY = Key("runway", plots.GREY)


def sweeps(results: Sequence[Named]) -> list[Drawing]:
    """A map, or curves, of each output of each report."""
    out = []
    for k, (name, result) in enumerate(results):
        outputs = [
            each for each in report.shown(result) if report.best(result[f"/sweep/{each}"], report.large(result, each))
        ]
        moved = report.plane(result)
        for each in outputs[:_MOST_MAPS]:
            made = _map(result, each, moved) if moved else _curves(result, each)
            text = result.variables[f"/sweep/{each}"].long_name
            title = f"{text[:1].upper()}{text[1:]}{f' ({name})' if len(results) > 1 else ''}"
            panels, caption, keys = made
            left = len(outputs) - _MOST_MAPS
            caption += (
                f" {left} further outputs are in the table alone."
                if left > 0 and each == outputs[_MOST_MAPS - 1]
                else ""
            )
            out.append(Drawing(f"{each}-{k}", title, panels, caption, keys, min(2, len(panels))))
    return out


def _map(result: Result, name: str, moved: tuple[int, int]) -> tuple[list[figure], str, list[Key]]:
    better = report.large(result, name)
    low, high = report.colours(result[f"/sweep/{name}"], better)
    mapper = plots.colour_map(low, high, reverse=not better)
    panels, hollow = [], False
    for panel in report.panels(result, name, moved):
        on = plots.plot(panel.title, "beyond the threshold (= -l1), m", "right of the axis, m", 350)
        marks: list[Any] = []
        if not np.isfinite(panel.values).all():
            hollow = True
            for site in panel.sites:
                shade_ground(on, *site)
        for (along, right), corners in zip(panel.sites, panel.corners, strict=True):
            marks.append(_cells(on, panel.values, along, right, corners, mapper))
        plots.bar(on, mapper, report.label(result, name))
        if panel.best is not None:
            star = plots.source(x=panel.best[0], y=panel.best[1])
            on.scatter("x", "y", source=star, marker="star", size=15, fill_color=plots.ORANGE, line_color="white")
        draw_runway(on, result, panel.sites)
        unit = result.variables[f"/sweep/{name}"].units
        plots.hover_text(on, marks, ("along", "$x{0} m"), ("right", "$y{0} m"),
                         ("value", "@image{0.0000}" + ("" if unit == "1" else f" {unit}")))  # fmt: skip
        panels.append(on)
    text = f"Colours: {report.label(result, name)}, by the positions of the pseudolites; star: the best."
    text += f" Not drawn: {unlike}." if (unlike := report.varied_terrain(result)) else ""
    keys = [RUNWAY, Key("ground track", plots.GREY, "dash"), Key("best", plots.ORANGE, "star"), *terrain_key(result)]
    return panels, text, [*keys, Key("no solution", plots.GREY, "band")] if hollow else keys


def shade_ground(on: figure, along: np.ndarray, right: np.ndarray) -> None:
    """Shade the range of positions, as the background of a map with holes."""
    ends = [(float(np.nanmin(each)), float(np.nanmax(each))) for each in (along, right)]
    on.quad(left=ends[0][0], right=ends[0][1], bottom=ends[1][0], top=ends[1][1], fill_color=plots.GREY, fill_alpha=0.3,
            line_color=None, level="image")  # fmt: skip


def terrain_key(result: Result) -> list[Key]:
    return [Key("terrain, height of its top above the threshold", plots.BROWN)] if shown_ridges(result) else []


def _cells(
    on: figure, values: np.ndarray, along: np.ndarray, right: np.ndarray,
    corners: tuple[np.ndarray, np.ndarray] | None, mapper: Any,
) -> Any:  # fmt: skip
    """Values (n, m) at the pseudolites: an image if cells are along the axes, else squares."""
    if corners is not None:
        x, y = corners
        for first, second, data in ((x, y, values.T), (x.T, y.T, values)):
            # the first axis of the image goes along x, the second along y
            even = all(np.allclose(np.diff(each), np.diff(each)[0], rtol=1e-3) for each in (first[:, 0], second[0]))
            straight = np.ptp(first, axis=1).max() < 1e-3 * max(np.ptp(first), 1.0)
            straight &= bool(np.ptp(second, axis=0).max() < 1e-3 * max(np.ptp(second), 1.0))
            if even and straight:
                data = data if first[-1, 0] > first[0, 0] else data[:, ::-1]
                data = data if second[0, -1] > second[0, 0] else data[::-1]
                ends = [(float(min(e[0], e[-1])), float(max(e[0], e[-1]))) for e in (first[:, 0], second[0])]
                on.grid.visible = False
                return on.image(
                    image=[data.astype(np.float32)], x=ends[0][0], y=ends[1][0], dw=ends[0][1] - ends[0][0],
                    dh=ends[1][1] - ends[1][0], color_mapper=mapper, level="image",
                )  # fmt: skip
    known = np.isfinite(along) & np.isfinite(values)
    of = plots.source(x=along[known], y=right[known], image=values[known])
    fill = {"field": "image", "transform": mapper}
    return on.scatter("x", "y", source=of, marker="square", size=7, fill_color=fill, line_color=None)


def draw_runway(on: figure, result: Result, sites: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Runway and ground track in a map: the whole runway, if the map keeps half of the axes."""
    along, right = (np.concatenate([site[i].ravel() for site in sites]) for i in (0, 1))
    length = float(setting(result, "runway", "length_m"))
    on.line([0.0, length], [0.0, 0.0], line_color=plots.GREY, line_width=5)
    if "/plan/track_along" in result:
        of = plots.source(x=result["/plan/track_along"], y=result["/plan/track_right"])
        plots.line(on, of, "y", plots.GREY, line_dash="dashed")
    shown: list[tuple[float, float]] = []
    for each, more in ((along, (0.0, length)), (right, (0.0, 0.0))):
        low, high = float(np.nanmin(each)), float(np.nanmax(each))
        wide = min(low, *more), max(high, *more)
        low, high = wide if wide[1] - wide[0] <= 2.0 * (high - low) else (low, high)
        room = 0.06 * max(high - low, 1.0)
        shown.append((low - room, high + room))
    plots.view_from_above(on, shown[0], shown[1])
    ridge_lines(on, shown_ridges(result), shown[0], shown[1], over_map=True)
    plots.metres_on_axes(on)


def _curves(result: Result, name: str) -> tuple[list[figure], str, list[Key]]:
    of = report.curves(result, name, _MOST_CURVES)
    on = plots.plot("", report.axis_label(result, of.axis), report.label(result, name), 320)
    numeric = of.x.dtype.kind in "fiu"
    at = of.x if numeric else np.arange(of.x.size)
    text = [as_text(value) for value in of.x]
    marks = []
    for k, (row, which) in enumerate(zip(of.rows, of.names, strict=True)):
        columns = plots.source(x=at, y=row, said=text)
        if not of.scattered:
            plots.line(on, columns, "y", plots.colour(k))
        marks.append(on.scatter("x", "y", source=columns, size=6, color=plots.colour(k), name=which or name))
    if not numeric:
        plots.ticks(on, on.xaxis[0], [float(each) for each in at], text)
    unit = result.variables[f"/sweep/{name}"].units
    across, value = report.axis_label(result, of.axis), "@y{0.0000}" + ("" if unit == "1" else f" {unit}")
    plots.hover_text(on, marks, ("", "$name"), (across, "@said"), ("value", value))
    keys = [Key(which, plots.colour(k)) for k, which in enumerate(of.names) if which]
    return [on], f"{report.label(result, name)}.{f' Shown: {of.some}.' if of.some else ''}", keys
