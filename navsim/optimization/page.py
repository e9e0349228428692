"""Drawings of placements found: the front, a map for each number of pseudolites, requirements; result by result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navsim.optimization import report
from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.results.result import Result
from navsim.results.schema import LARGE
from navsim.sweeps.page import RUNWAY, draw_runway, shade_ground, terrain_key


def optima(results: Sequence[Named]) -> list[Drawing]:
    """Plans of each search, and the front of all."""
    fronts = _front(results)
    return [fronts, *(_plan(k, name, result, len(results) > 1) for k, (name, result) in enumerate(results)),
            *(_requirements(k, name, result, len(results) > 1) for k, (name, result) in enumerate(results)
              if "/pareto/met" in result)]  # fmt: skip


def _front(results: Sequence[Named]) -> Drawing:
    panels = []
    alike = {(str(r.attributes["objective"]), report.front_of(r).label): None for _, r in results}
    placed = report.placed(results[0][1])
    for objective, axis in alike:
        mine = [
            (i, name, r) for i, (name, r) in enumerate(results)
            if r.attributes["objective"] == objective and report.front_of(r).label == axis
        ]  # fmt: skip
        points = [report.front_of(r) for _, _, r in mine]
        what = points[0].label
        on = plots.plot("", what, report.label(mine[0][2]), 300)
        marks, values = [], []
        for (i, name, _), front in zip(mine, points, strict=True):
            values += [front.value, front.runs]
            said = [f"{number} {placed}" for number in front.names] or [""] * front.x.size
            if front.met is not None:
                verdicts = ["requirements met" if each else "requirements not met" for each in front.met]
                said = [", ".join(filter(None, both)) for both in zip(said, verdicts, strict=True)]
            plots.line(on, plots.source(x=front.x[front.line], y=front.value[front.line]), "y", plots.colour(i))
            of = plots.source(x=front.x, y=front.value, said=said)
            marks.append(on.scatter("x", "y", source=of, size=9, color=plots.colour(i), name=name))
            runs = plots.source(x=front.flown, y=front.runs[:, 0], low=front.runs[:, 1], high=front.runs[:, 2])
            on.segment("x", "low", "x", "high", source=runs, line_color=plots.colour(i), line_width=1.5)
            on.scatter("x", "y", source=runs, marker="square", size=6, color=plots.colour(i), fill_color="white")
            if front.met is not None:
                unmet = plots.source(x=front.x[~front.met], y=front.value[~front.met])
                on.scatter("x", "y", source=unmet, marker="x", size=15, line_color=plots.ORANGE, line_width=2)
            if front.names:
                plots.labels(on, front.x, front.value, front.names)
        if not any(front.names for front in points):
            on.xaxis[0].ticker = sorted({int(x) for front in points for x in front.x})
        plots.extend_y_axis(on, values)
        text = (report.label(mine[0][2]), "@y{0.0000}")
        plots.hover_text(on, marks, ("", "$name"), (what, "@x{0}"), text, ("", "@said"))
        panels.append(on)
    judged = any("/pareto/met" in r for _, r in results)
    checked = any(report.front_of(r).flown.size for _, r in results)
    caption = "The best found for each number placed."
    if any(report.front_of(r).names for _, r in results):
        caption = "Accuracy against cost; the line joins the front, and each point has its number placed."
    caption += " Squares with 95 % intervals: found by runs." if checked else ""
    caption += " Crosses: requirements are not met." if judged else ""
    return Drawing(
        "front",
        f"What {report.placed(results[0][1])} buy",
        panels,
        caption,
        plots.keys_of(results),
        min(2, len(panels)),
    )


def _plan(k: int, name: str, result: Result, several: bool) -> Drawing:
    """For each number of pseudolites: the placement over the objective with the first one moved."""
    large = str(result.attributes["objective"]) in LARGE
    s, along = result["/map/s"], -result["/map/l1"]
    panels = []
    for i in report.plan_rows(result):
        count = int(result["/pseudolites"][i])
        on = plots.plot(report.plan_title(result, i), "beyond the threshold (= -l1), m", "right of the axis, m", 410)
        values = result["/map/objective"][i]
        known = values[np.isfinite(values)]
        sites = (-result["/optimum/l1"][i][:count], result["/optimum/s"][i][:count])
        if known.size:
            low, high = np.percentile(known, [5, 100] if large else [0, 95]).tolist()
            mapper = plots.colour_map(low, max(high, low + 1e-12), reverse=not large)
            flipped = values[:, ::-1] if along[-1] < along[0] else values
            half = [0.5 * abs(float(e[1] - e[0])) if e.size > 1 else 1.0 for e in (along, s)]
            ends = [(float(e.min()) - h, float(e.max()) + h) for e, h in zip((along, s), half, strict=True)]
            flipped = flipped if s[-1] > s[0] else flipped[::-1]
            shade_ground(on, *map(np.array, ends))
            drawn = plots.image(on, flipped, ends[0], ends[1], mapper, report.label(result))
            if "/map/seen" in result:
                on.contour(along, s, result["/map/seen"], levels=[0.5, 0.999], line_color="white")
            plots.hover_text(
                on,
                [drawn],
                ("along", "$x{0} m"),
                ("right", "$y{0} m"),
                (f"{report.site_name(result, 0)} there", "@image{0.0000}"),
            )
        of = plots.source(x=sites[0], y=sites[1], said=[report.site_name(result, n) for n in range(count)])
        stars = on.scatter("x", "y", source=of, marker="star", size=15, fill_color=plots.ORANGE, line_color="white")
        plots.labels(on, *sites, [report.site_name(result, n) for n in range(count)])
        plots.hover_text(on, [stars], ("", "@said"), ("along", "@x{0.00} m"), ("right", "@y{0.00} m"))
        draw_runway(on, result, [(np.append(along, sites[0]), np.append(s, sites[1][0]).repeat(1))])
        panels.append(on)
    unmet = ", or requirements are not met" if "/pareto/met" in result else ""
    caption = "Stars: the placement found."
    if np.isfinite(result["/map/objective"]).any():
        shown = f"{report.label(result)}, with {report.site_name(result, 0)} moved there and the others kept"
        caption = f"Colours: {shown}; grey where that is not allowed, or has no value{unmet}. {caption}"
        if "/map/seen" in result:
            caption += " White lines: half and all of the glide's fixes see an antenna there."
    else:
        caption += " The maps were not computed."
    title = f"Placement map{f' ({name})' if several else ''}"
    keys = [
        RUNWAY,
        Key(report.placed(result), plots.ORANGE, "star"),
        Key(f"not allowed, or no value{unmet}", plots.GREY, "band"),
        *terrain_key(result),
    ]
    return Drawing(f"plan-{k}", title, panels, caption, keys, min(2, len(panels)))


def _requirements(k: int, name: str, result: Result, several: bool) -> Drawing:
    """Utilisation of each requirement, by number of pseudolites."""
    what = report.placed(result)
    on = plots.plot("", what, "size kept as often as required, relative to the required size", 320)
    counts, statements, used = report.used(result)
    marks = []
    for i, statement in enumerate(statements):
        of = plots.source(x=counts, y=used[:, i])
        plots.line(on, of, "y", plots.colour(i))
        marks.append(on.scatter("x", "y", source=of, size=8, color=plots.colour(i), name=statement))
    plots.horizontal_line(on, 1.0)
    plots.extend_y_axis(on, [used], 1.1)
    on.xaxis[0].ticker = [int(count) for count in counts]
    plots.hover_text(on, marks, ("", "$name"), (what, "@x{0}"), ("used", "@y{0.000}"))
    keys = [Key(statement, plots.colour(i)) for i, statement in enumerate(statements)]
    caption = "Below the dashed line a requirement is met. The table has those that only runs decide."
    return Drawing(f"requirements-{k}", f"Requirements{f' ({name})' if several else ''}", [on], caption, keys, 1)
