"""Drawings of studies of places: sweeps and the best placements, a map each; results one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.plotting import figure

from navsim.report import optimize, sweep
from navsim.report.page.marks import (
    BROWN,
    GREY,
    ORANGE,
    Drawing,
    Key,
    Named,
    bar,
    colour,
    from_runway,
    image,
    keys_of,
    labels,
    level,
    line,
    plot,
    reach,
    shades,
    source,
    tell,
    ticks,
    view_from_above,
)
from navsim.report.page.terrain import ridge_lines
from navsim.report.ridges import shown_ridges
from navsim.report.table import as_text
from navsim.report.tables import setting
from navsim.results.result import Result
from navsim.results.schema import LARGE

_MOST_MAPS = 12
"""Most outputs of a sweep that are drawn; the table has all."""
_MOST_CURVES = 6
_RUNWAY = Key("runway", GREY)


def sweeps(results: Sequence[Named]) -> list[Drawing]:
    """A map, or curves, of each output of each sweep."""
    out = []
    for k, (name, result) in enumerate(results):
        outputs = [
            each for each in sweep.shown(result) if sweep.best(result[f"/sweep/{each}"], sweep.large(result, each))
        ]
        moved = sweep.plane(result)
        for each in outputs[:_MOST_MAPS]:
            made = _map(result, each, moved) if moved else _curves(result, each)
            said = result.variables[f"/sweep/{each}"].long_name
            title = f"{said[:1].upper()}{said[1:]}{f' ({name})' if len(results) > 1 else ''}"
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
    better = sweep.large(result, name)
    low, high = sweep.colours(result[f"/sweep/{name}"], better)
    mapper = shades(low, high, reverse=not better)
    panels, hollow = [], False
    for panel in sweep.panels(result, name, moved):
        on = plot(panel.title, "along the runway from the threshold, m", "right of the axis, m", 350)
        marks: list[Any] = []
        if not np.isfinite(panel.values).all():
            hollow = True
            for site in panel.sites:
                _ground(on, *site)
        for (along, right), corners in zip(panel.sites, panel.corners, strict=True):
            marks.append(_cells(on, panel.values, along, right, corners, mapper))
        bar(on, mapper, sweep.label(result, name))
        if panel.best is not None:
            star = source(x=panel.best[0], y=panel.best[1])
            on.scatter("x", "y", source=star, marker="star", size=15, fill_color=ORANGE, line_color="white")
        _runway(on, result, panel.sites)
        unit = result.variables[f"/sweep/{name}"].units
        tell(on, marks, ("along", "$x{0} m"), ("right", "$y{0} m"),
             ("value", "@image{0.0000}" + ("" if unit == "1" else f" {unit}")))  # fmt: skip
        panels.append(on)
    text = f"Colours: {sweep.label(result, name)}, by where pseudolites stand; star: the best."
    text += f" Not drawn: {unlike}." if (unlike := sweep.varied_terrain(result)) else ""
    keys = [_RUNWAY, Key("ground track", GREY, "dash"), Key("best", ORANGE, "star"), *_terrain(result)]
    return panels, text, [*keys, Key("no solution", GREY, "band")] if hollow else keys


def _ground(on: figure, along: np.ndarray, right: np.ndarray) -> None:
    """Shade what places span, before a map with holes is drawn over it."""
    ends = [(float(np.nanmin(each)), float(np.nanmax(each))) for each in (along, right)]
    on.quad(left=ends[0][0], right=ends[0][1], bottom=ends[1][0], top=ends[1][1], fill_color=GREY, fill_alpha=0.3,
            line_color=None, level="image")  # fmt: skip


def _terrain(result: Result) -> list[Key]:
    return [Key("terrain, height of its top above the threshold", BROWN)] if shown_ridges(result) else []


def _cells(
    on: figure, values: np.ndarray, along: np.ndarray, right: np.ndarray,
    corners: tuple[np.ndarray, np.ndarray] | None, mapper: Any,
) -> Any:  # fmt: skip
    """The values (n, m) where pseudolites stand: as an image, where cells lie along the axes, else as squares."""
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
    of = source(x=along[known], y=right[known], image=values[known])
    fill = {"field": "image", "transform": mapper}
    return on.scatter("x", "y", source=of, marker="square", size=7, fill_color=fill, line_color=None)


def _runway(on: figure, result: Result, sites: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
    """Runway and ground track by a map: the whole runway, where the map keeps half of the axes."""
    along, right = (np.concatenate([site[i].ravel() for site in sites]) for i in (0, 1))
    length = float(setting(result, "runway", "length_m"))
    on.line([0.0, length], [0.0, 0.0], line_color=GREY, line_width=5)
    if "/plan/track_along" in result:
        of = source(x=result["/plan/track_along"], y=result["/plan/track_right"])
        line(on, of, "y", GREY, line_dash="dashed")
    shown: list[tuple[float, float]] = []
    for each, more in ((along, (0.0, length)), (right, (0.0, 0.0))):
        low, high = float(np.nanmin(each)), float(np.nanmax(each))
        wide = min(low, *more), max(high, *more)
        low, high = wide if wide[1] - wide[0] <= 2.0 * (high - low) else (low, high)
        room = 0.06 * max(high - low, 1.0)
        shown.append((low - room, high + room))
    view_from_above(on, shown[0], shown[1])
    ridge_lines(on, shown_ridges(result), shown[0], shown[1], over_map=True)
    from_runway(on)


def _curves(result: Result, name: str) -> tuple[list[figure], str, list[Key]]:
    of = sweep.curves(result, name, _MOST_CURVES)
    on = plot("", sweep.axis_label(result, of.axis), sweep.label(result, name), 320)
    numeric = of.x.dtype.kind in "fiu"
    at = of.x if numeric else np.arange(of.x.size)
    said = [as_text(value) for value in of.x]
    marks = []
    for k, (row, which) in enumerate(zip(of.rows, of.names, strict=True)):
        columns = source(x=at, y=row, said=said)
        if not of.scattered:
            line(on, columns, "y", colour(k))
        marks.append(on.scatter("x", "y", source=columns, size=6, color=colour(k), name=which or name))
    if not numeric:
        ticks(on, on.xaxis[0], [float(each) for each in at], said)
    unit = result.variables[f"/sweep/{name}"].units
    across, value = sweep.axis_label(result, of.axis), "@y{0.0000}" + ("" if unit == "1" else f" {unit}")
    tell(on, marks, ("", "$name"), (across, "@said"), ("value", value))
    keys = [Key(which, colour(k)) for k, which in enumerate(of.names) if which]
    return [on], f"{sweep.label(result, name)}.{f' Shown: {of.some}.' if of.some else ''}", keys


def optima(results: Sequence[Named]) -> list[Drawing]:
    """Plans of each search, and the front of all."""
    fronts = _front(results)
    return [fronts, *(_plan(k, name, result, len(results) > 1) for k, (name, result) in enumerate(results)),
            *(_requirements(k, name, result, len(results) > 1) for k, (name, result) in enumerate(results)
              if "/front/met" in result)]  # fmt: skip


def _front(results: Sequence[Named]) -> Drawing:
    panels = []
    objectives = list(dict.fromkeys(str(r.attributes["objective"]) for _, r in results))
    for objective in objectives:
        mine = [(i, name, r) for i, (name, r) in enumerate(results) if r.attributes["objective"] == objective]
        on = plot("", "pseudolites", optimize.label(mine[0][2]), 300)
        marks, values = [], []
        for i, name, result in mine:
            counts, found, met = optimize.front_points(result)
            values.append(found)
            verdicts = (
                ["requirements met" if each else "requirements not met" for each in met]
                if met is not None
                else [""] * len(counts)
            )
            of = source(x=counts, y=found, said=verdicts)
            line(on, of, "y", colour(i))
            marks.append(on.scatter("x", "y", source=of, size=9, color=colour(i), name=name))
            if met is not None:
                unmet = source(x=counts[~met], y=found[~met])
                on.scatter("x", "y", source=unmet, marker="x", size=15, line_color=ORANGE, line_width=2)
        on.xaxis[0].ticker = sorted({int(c) for _, _, r in mine for c in optimize.front_points(r)[0]})
        reach(on, values)
        said = (optimize.label(mine[0][2]), "@y{0.0000}")
        tell(on, marks, ("", "$name"), ("pseudolites", "@x{0}"), said, ("", "@said"))
        panels.append(on)
    judged = any("/front/met" in r for _, r in results)
    caption = "The best found for each number of pseudolites." + (
        " Crosses: requirements are not met." if judged else ""
    )
    return Drawing("front", "What pseudolites buy", panels, caption, keys_of(results), min(2, len(panels)))


def _plan(k: int, name: str, result: Result, several: bool) -> Drawing:
    """For each number of pseudolites: the placement over the objective with the first one moved."""
    large = str(result.attributes["objective"]) in LARGE
    s, along = result["/map/s"], -result["/map/l1"]
    panels = []
    for i, count in enumerate(map(int, result["/pseudolites"])):
        on = plot(optimize.plan_title(result, i), "along the runway from the threshold, m", "right of the axis, m", 410)
        values = result["/map/objective"][i]
        known = values[np.isfinite(values)]
        sites = (-result["/optimum/l1"][i][:count], result["/optimum/s"][i][:count])
        if known.size:
            low, high = np.percentile(known, [5, 100] if large else [0, 95]).tolist()
            mapper = shades(low, max(high, low + 1e-12), reverse=not large)
            flipped = values[:, ::-1] if along[-1] < along[0] else values
            half = [0.5 * abs(float(e[1] - e[0])) if e.size > 1 else 1.0 for e in (along, s)]
            ends = [(float(e.min()) - h, float(e.max()) + h) for e, h in zip((along, s), half, strict=True)]
            flipped = flipped if s[-1] > s[0] else flipped[::-1]
            _ground(on, *map(np.array, ends))
            drawn = image(on, flipped, ends[0], ends[1], mapper, optimize.label(result))
            tell(on, [drawn], ("along", "$x{0} m"), ("right", "$y{0} m"), ("PL1 there", "@image{0.0000}"))
        of = source(x=sites[0], y=sites[1], said=[f"PL{n + 1}" for n in range(count)])
        stars = on.scatter("x", "y", source=of, marker="star", size=15, fill_color=ORANGE, line_color="white")
        labels(on, *sites, [f"PL{n + 1}" for n in range(count)])
        tell(on, [stars], ("", "@said"), ("along", "@x{0.00} m"), ("right", "@y{0.00} m"))
        _runway(on, result, [(np.append(along, sites[0]), np.append(s, sites[1][0]).repeat(1))])
        panels.append(on)
    unmet = ", or requirements are not met" if "/front/met" in result else ""
    caption = "Stars: the placement found."
    if np.isfinite(result["/map/objective"]).any():
        shown = f"{optimize.label(result)}, with PL1 moved there and the others kept"
        caption = f"Colours: {shown}; grey where that is not allowed{unmet}. {caption}"
    else:
        caption += " The maps were not computed."
    title = f"Placement map{f' ({name})' if several else ''}"
    keys = [_RUNWAY, Key("pseudolites", ORANGE, "star"), Key(f"not allowed{unmet}", GREY, "band"), *_terrain(result)]
    return Drawing(f"plan-{k}", title, panels, caption, keys, min(2, len(panels)))


def _requirements(k: int, name: str, result: Result, several: bool) -> Drawing:
    """How much of what is allowed each requirement takes, by the number of pseudolites."""
    on = plot("", "pseudolites", "size kept as often as asked for, by the size asked for", 320)
    counts, statements, used = optimize.used(result)
    marks = []
    for i, statement in enumerate(statements):
        of = source(x=counts, y=used[:, i])
        line(on, of, "y", colour(i))
        marks.append(on.scatter("x", "y", source=of, size=8, color=colour(i), name=statement))
    level(on, 1.0)
    reach(on, [used], 1.1)
    on.xaxis[0].ticker = [int(count) for count in counts]
    tell(on, marks, ("", "$name"), ("pseudolites", "@x{0}"), ("used", "@y{0.000}"))
    keys = [Key(statement, colour(i)) for i, statement in enumerate(statements)]
    caption = "Below the dashed line a requirement is met. The table tells of those that are left to runs."
    return Drawing(f"requirements-{k}", f"Requirements{f' ({name})' if several else ''}", [on], caption, keys, 1)
