"""Drawings of errors at touchdown and at the heights of the table: scatter, histograms, percentiles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from bokeh.plotting import figure

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.report.box_rows import box_limits, of_total, outside_box
from navsim.report.figure_data import (
    ellipse,
    indicated_deviations,
)
from navsim.report.limits import required_limits
from navsim.report.result_cells import known_percentiles, runs_of, single
from navsim.results.heights import spoken_height
from navsim.results.result import Result
from navsim.results.schema import HEIGHTS, INDICATED

_FEW = 3
"""Fewer runs than this have no distribution."""
_BINS = (8, 40)
"""Fewest and most columns of a histogram."""


def scatter(results: Sequence[Named]) -> Drawing | None:
    """Errors of runs at touchdown, or at the height of the box, with the box and an ellipse."""
    kept = [(i, name, r) for i, name, r in plots.results_with(results, "/summary/at/lateral_run")
            if r["/run"].size >= _FEW or "/summary/box/error_run" in r]  # fmt: skip
    if not kept:
        return None
    column, where, height = 0, "touchdown", "touchdown"
    boxed = [float(r["/summary/box/height"]) for _, _, r in kept if "/summary/box/height" in r]
    near = [
        k
        for k, at in enumerate(kept[0][2]["/summary/at/height"][: len(HEIGHTS)])
        if boxed and abs(at - boxed[0]) < 0.01
    ]
    if near:
        column, height = near[0], list(HEIGHTS)[near[0]]
        where = spoken_height(height)
    judged = len(set(boxed)) == 1 and all("/summary/box/error_run" in r for _, _, r in kept)
    if judged and not near:
        where = height = f"{boxed[0]:g} m above the runway"
    panels, drawn, required = [], False, False
    # limits along the runway that are given from its threshold are drawn from there, and are far longer than wide
    placed = judged and all("/summary/box/place" in r for _, _, r in kept)
    for across, up in (("lateral", "vertical"), ("lateral", "along")):
        zoned = placed and up == "along"
        text = "along the runway from the threshold, m" if zoned else f"{up} error, m"
        on = plots.plot(f"{up.capitalize()} against {across}", f"{across} error, m", text, 340, match_aspect=not zoned)
        marks = []
        for i, name, result in kept:
            which_error = "tse_run" if of_total(result) else "run"
            points = np.stack([
                result["/summary/box/error_run"][:, plots.AXES.index(axis)] if judged
                else result[f"/summary/at/{axis}_{which_error}"][:, column]
                for axis in (across, up)
            ])  # fmt: skip
            start = float(result["/summary/box/place"]) if zoned else 0.0
            points[1] += start
            known = np.isfinite(points).all(axis=0)
            outside = outside_box(result) if judged else np.zeros(known.size, bool)
            which = plots.thin(int(known.sum()))
            x, y, run, out = (which(each[known]) for each in (*points, result["/run"], outside))
            for those, mark in ((~out, "circle"), (out, "x")):
                of = plots.source(x=x[those], y=y[those], run=run[those])
                marks.append(
                    on.scatter("x", "y", source=of, size=5 if mark == "circle" else 8, marker=mark, name=name,
                               color=plots.colour(i), alpha=0.6 if len(kept) == 1 else 1.0,
                               line_color=None if mark == "circle" else plots.colour(i))
                )  # fmt: skip
            if known.sum() >= _FEW and np.linalg.matrix_rank(spread := np.cov(points[:, known])) == 2:
                rim = points[:, known].mean(axis=1)[:, None] + ellipse(spread)
                plots.line(on, plots.source(x=rim[0], y=rim[1]), "y", plots.colour(i))
            if judged or ("/summary/box/upper" in result and abs(float(result["/summary/box/height"]) - float(
                    result["/summary/at/height"][column])) < 0.01):  # fmt: skip
                _box(on, result, (across, up), start, plots.colour(i) if len(kept) > 1 else plots.GREY)
                drawn = True
            if not zoned and not of_total(result):
                required |= _required(
                    on, result, height, (across, up), plots.colour(i) if len(kept) > 1 else plots.GREY
                )
        plots.hover_text(on, marks, ("", "$name, run @run{0}"), (across, "@x{0.000} m"), (up, "@y{0.000} m"))
        panels.append(on)
    counted = ", ".join(
        f"{name}: {runs_of(result)}{', total system errors' if of_total(result) else ''}" for _, name, result in kept
    )
    total = [of_total(result) for _, _, result in kept]
    what = "" if all(total) else ", truth minus estimate" + (" where not total" if any(total) else "")
    caption = (
        f"Errors at {where}{what}, a point a run ({counted})" + (
            ", with the ellipse that holds 95 % of a Gaussian of their mean and covariance"
            if any(r["/run"].size >= _FEW for _, _, r in kept) else ""
        ) + ("; dashed: the box" + (", crosses: runs that end outside" if judged else "") if drawn else "")
        + ("; dotted: required sizes." if required else ".")
    )  # fmt: skip
    keys = [Key("box", plots.GREY, "dash")] if drawn else []
    keys += [Key("required", plots.GREY, "dots")] if required else []
    return Drawing("scatter", f"Scatter at {where}", panels, caption, plots.keys_of(results, *keys, of=kept))


def _box(on: figure, result: Result, axes: tuple[str, str], start: float, own: str) -> None:
    """Limits of the box, across and up the page, dashed; start: lower end of vertical ones, m."""
    x, y = (box_limits(result, plots.AXES.index(axis)) for axis in axes)
    y = None if y is None else (y[0] + start, y[1] + start)
    if x is not None and y is not None:
        corners = plots.source(x=np.array([x[0], x[1], x[1], x[0], x[0]]), y=np.array([y[0], y[0], y[1], y[1], y[0]]))
        plots.line(on, corners, "y", own, line_dash="dashed", line_width=1)
        return
    for ends, side in ((x, plots.vertical_line), (y, plots.horizontal_line)):
        for end in ends or ():
            side(on, end, own)


def _required(on: figure, result: Result, height: str, axes: tuple[str, str], own: str) -> bool:
    """Draw the required sizes of the errors across and up the page at a height; whether there are any."""
    found = [one for one in required_limits(result, "error") if one.at == height and one.of in axes]
    for one in found:
        for side in (-one.size, one.size):
            (plots.vertical_line if one.of == axes[0] else plots.horizontal_line)(on, side, own, "dotted")
    return bool(found)


def distribution(results: Sequence[Named]) -> Drawing | None:
    """Histograms of the errors at touchdown, with the filter's Gaussians."""
    kept = [
        (i, name, r) for i, name, r in plots.results_with(results, "/summary/at/lateral_run") if r["/run"].size >= 10
    ]
    if not kept:
        return None
    panels = []
    for axis in plots.AXES:
        on = plots.plot(axis.capitalize(), f"{axis} error at touchdown, m", "share of runs per m", 260)
        errors = {}
        for i, _, result in kept:
            of_runs = result[f"/summary/at/{axis}_run"][:, 0]
            errors[i] = of_runs[np.isfinite(of_runs)]
        every = np.concatenate(list(errors.values()))
        if not every.size or every.min() == every.max():
            continue
        runs = max(each.size for each in errors.values())
        bins = int(np.clip(2.0 * runs ** (1.0 / 3.0), *_BINS))  # Rice's rule
        edges = np.linspace(every.min(), every.max(), bins + 1)
        marks = []
        for i, name, result in kept:
            if not errors[i].size:
                continue
            count, _ = np.histogram(errors[i], edges)
            of = plots.source(
                left=edges[:-1], right=edges[1:], top=count / (errors[i].size * np.diff(edges)), count=count
            )
            marks.append(
                on.quad(left="left", right="right", bottom=0.0, top="top", source=of, fill_color=plots.colour(i),
                        fill_alpha=0.3 if len(kept) == 1 else 0.0, line_color=plots.colour(i),
                        line_width=plots.width(i, len(kept)), name=name)
            )  # fmt: skip
            sigma = float(result[f"/summary/at/{axis}_sigma"][0])
            x = np.linspace(edges[0], edges[-1], 121)
            density = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
            plots.line(on, plots.source(x=x, y=density), "y", plots.colour(i), line_dash="dashed")
        on.y_range.start = 0.0
        plots.hover_text(on, marks, ("", "$name"), ("error", "@left{0.000} to @right{0.000} m"), ("runs", "@count{0}"))
        panels.append(on)
    if not panels:
        return None
    caption = (
        "How errors of navigation at touchdown are distributed over runs; dashed: the Gaussian of the filter's σ "
        "there. "
        + ", ".join(f"{name}: {runs_of(result)}" for _, name, result in kept) + "."
    )  # fmt: skip
    return Drawing("histograms", "Histograms at touchdown", panels, caption, plots.keys_of(results, of=kept), 3)


def deviations(results: Sequence[Named]) -> Drawing | None:
    """Deviations from localizer and glide path against height, with half and full scale and required sizes."""
    touched = plots.results_with(results, "/summary/indicator/touchdown_llh")
    shown = [(i, name, result, seen) for i, name, result in touched
             if result["/run"].size >= 10 and (seen := indicated_deviations(result)) is not None
             and seen.height.size > 2]  # fmt: skip
    if not shown:
        return None
    panels = []
    for k, what in enumerate(INDICATED):
        title = what.replace("_", " ").capitalize()
        on, marks = plots.plot(title, "height above the runway, m", "parts of full scale", 260), []
        for i, name, _, seen in shown:
            low, _, median, _, high = seen.aircraft[:, :, k]
            of = plots.source(x=seen.height, low=low, median=median, high=high, seen_low=seen.estimate[0, :, k],
                              seen_high=seen.estimate[4, :, k])  # fmt: skip
            plots.band(on, of, "low", "high", plots.colour(i), len(shown) > 1)
            plots.line(on, of, "seen_low", plots.colour(i), line_dash="dashed")
            plots.line(on, of, "seen_high", plots.colour(i), line_dash="dashed")
            marks.append(
                plots.line(on, of, "median", plots.colour(i), line_width=plots.width(i, len(shown)), name=name)
            )
            for size in seen.required[what]:
                for side in (-size, size):
                    plots.horizontal_line(on, side, plots.colour(i), "dotted")
        for size in (-1.0, -0.5, 0.5, 1.0):
            plots.horizontal_line(on, size, plots.GREY, "solid" if abs(size) == 1.0 else "dotdash")
        most = max(seen.reach(k) for *_, seen in shown)
        on.y_range.start, on.y_range.end = -most, most
        plots.hover_text(on, marks, ("", "$name"), ("height", "@x{0.0} m"),
                         ("95 % of runs", "@low{0.000} to @high{0.000}"),
                         ("95 % of what pilots see", "@seen_low{0.000} to @seen_high{0.000}"))  # fmt: skip
        plots.reversed_x_axis(on, *(float(edge) for edge in (min(s.height.min() for *_, s in shown),
                                                             max(s.height.max() for *_, s in shown))))  # fmt: skip
        panels.append(on)
    caption = (
        "Deviations of the aircraft from localizer and glide path on the descent: 95 % of runs and their median; "
        "dashed: 95 % of what pilots see, the deviations of the estimate. Grey: half and full scale; dotted: required."
    )
    kept = [each[:3] for each in shown]
    return Drawing("deviations", "Localizer and glide path", panels, caption, plots.keys_of(results, of=kept), 2)


def percentiles(results: Sequence[Named]) -> Drawing | None:
    """Percentiles of the size of errors against the height."""
    kept = [each for each in plots.results_with(results, "/summary/at/lateral_percentile")
            if not single(each[2]) and known_percentiles(each[2]).any()]  # fmt: skip
    if not kept:
        return None
    panels, dashes = [], ("solid", "dashed", "dotted", "dotdash")
    shown = np.any([known_percentiles(result) for _, _, result in kept], axis=0)
    text = [str(p) for p in kept[0][2]["/summary/percentile"][shown]]
    for axis in plots.AXES:
        on = plots.plot(axis.capitalize(), "height above the runway, m", "size of the error, m", 260)
        marks, values = [], []
        for i, name, result in kept:
            found = np.where(known_percentiles(result), result[f"/summary/at/{axis}_percentile"], np.nan)
            of = plots.source(x=result["/summary/at/height"], **{f"p{k}": row for k, row in enumerate(found.T[shown])})
            values.append(found)
            for k in range(len(text)):
                plots.line(on, of, f"p{k}", plots.colour(i), line_dash=dashes[k % len(dashes)])
                marks.append(on.scatter("x", f"p{k}", source=of, size=6, color=plots.colour(i), name=name))
        plots.extend_y_axis(on, values)
        plots.hover_text(on, marks, ("", "$name"), ("height", "@x{0.0} m"),
                         *((f"{p} % of runs below", f"@p{k}{{0.000}} m") for k, p in enumerate(text)))  # fmt: skip
        top = max(float(r["/summary/at/height"].max()) for _, _, r in kept)
        plots.reversed_x_axis(on, -0.03 * top, 1.05 * top)
        panels.append(on)
    caption = (
        f"Navigation errors that {' and '.join(text)} % of runs stay below (lowest first), at the "
        "heights of the table. A covariance analysis assumes Gaussian errors."
    )  # fmt: skip
    return Drawing("percentiles", "Percentiles of the error", panels, caption, plots.keys_of(results, of=kept), 3)
