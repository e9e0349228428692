"""Drawings of the integrity of fixes: levels, limits and errors over time, Stanford diagrams, interference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import Range1d
from bokeh.plotting import figure

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.report.figure_data import (
    LEVELS,
    alarms,
    largest_errors,
    limits_over_time,
    settled,
    stanford_text,
    touchdown,
    whose,
)
from navsim.report.figure_data import stanford as counted

_ALARMED = "#CC79A7"
_STRIP = 2.0
"""Height of the strip of the axis, dB-Hz, that a jammer has at the foot."""


def levels(results: Sequence[Named]) -> Drawing | None:
    """Protection levels over time, with their limits and the errors of the fixes, or of the filter."""
    kept = [(i, name, r) for i, (name, r) in enumerate(results) if "/integrity/hpl" in r]
    if not kept:
        return None
    panels: list[figure] = []
    thinned = []
    for axis, path, most in LEVELS:
        on = plots.plot(axis.capitalize(), "time, s", "m", 280)
        on.x_range = panels[0].x_range if panels else on.x_range
        seen, marks, errors = [], [], []
        for i, name, result in kept:
            own, error = (plots.BLUE, plots.GREEN) if len(results) == 1 else (plots.colour(i), plots.colour(i))
            time, values = result["/integrity/time"], result[f"/integrity/{path}"]
            which = plots.thin(time.size, 800)
            thinned.append(which)
            columns = {"x": which(time), "level": which(values)}
            seen.append(values[settled(time)])
            flown = f"/integrity/error_{axis}" in result
            if flown:
                largest = largest_errors(result, axis)
                columns["error"] = which(largest)
                seen.append(largest)
            of = plots.source(**columns)
            marks.append(plots.line(on, of, "level", own, name=name))
            if flown:
                errors.append(plots.line(on, of, "error", error, name=name, line_width=0.8))
                there = alarms(result)
                of_alarms = plots.source(x=time[there], y=np.zeros(there.size))
                on.scatter("x", "y", source=of_alarms, marker="dash", angle=math.pi / 2, size=16, line_color=_ALARMED,
                           line_width=2)  # fmt: skip
            if np.isfinite(ends := limits_over_time(result, most)).all():
                of_limit = plots.source(x=which(time), limit=which(ends))
                plots.line(
                    on, of_limit, "limit", plots.ORANGE if len(results) == 1 else own, line_dash="dashed", line_width=1
                )
                seen.append(1.05 * ends)
            if np.isfinite(landed := touchdown(result)):
                plots.vertical_line(on, landed)
        plots.extend_y_axis(on, seen)
        plots.hover_text(on, marks, ("", "$name"), ("time", "@x{0.0} s"), ("protection level", "@level{0.00} m"))
        plots.hover_text(on, errors, ("", "$name"), ("time", "@x{0.0} s"), ("largest error", "@error{0.00} m"))
        panels.append(on)
    caption = (
        "Protection levels over time; dashed: the alert limit; thin: the largest error of all "
        "runs; marks at the foot: epochs at which a run has an alarm. A gap: no level."
        + plots.most_thinned(thinned).caption("epoch")
    )
    keys = [
        Key("protection level", plots.BLUE),
        Key("largest error", plots.GREEN),
        Key("alert limit", plots.ORANGE, "dash"),
    ]
    more = [Key("alarm", _ALARMED)]
    return Drawing("levels", "Protection levels", panels, caption, [*keys, *more] if len(results) == 1 else
                   plots.keys_of(results, *more, of=kept), 1)  # fmt: skip


def stanford(results: Sequence[Named]) -> Drawing | None:
    """Stanford diagrams of fixes, or of the filter, two panels a result."""
    kept = [(name, r) for name, r in results if "/integrity/status" in r]
    if not kept:
        return None
    panels, text = [], []
    for name, result in kept:
        text.append(f"{name + ': ' if len(results) > 1 else ''}{stanford_text(result)}")
        for axis, path, most in LEVELS:
            of = counted(result, axis, path, most)
            title = f"{axis.capitalize()}{f', {name}' if len(results) > 1 else ''}"
            on = plots.plot(title, f"{axis} error of the {whose(result)}, m", f"{axis} protection level, m", 380)
            on.x_range, on.y_range = Range1d(0.0, of.top), Range1d(0.0, of.top)
            if of.counts.any():
                mapper = plots.colour_map(1.0, max(2.0, float(of.counts.max())), log=True)
                counts = np.where(of.counts > 0.0, of.counts, np.nan).T
                drawn = plots.image(on, counts, (0.0, of.top), (0.0, of.top), mapper, "epochs")
                plots.hover_text(on, [drawn], ("error", "$x{0.0} m"), ("level", "$y{0.0} m"), ("epochs", "@image{0}"))
            else:
                plots.names(on, 0.5 * of.top, 0.5 * of.top, ["no levels"])
            plots.line(on, plots.source(x=np.array([0.0, of.top]), y=np.array([0.0, of.top])), "y", plots.GREY)
            if np.isfinite(of.limit):
                plots.horizontal_line(on, of.limit, plots.ORANGE)
                plots.vertical_line(on, of.limit, plots.ORANGE)
                regions = of.regions()
                plots.names(on, np.array([x for x, _, _ in regions]), np.array([y for _, y, _ in regions]),
                            [word for _, _, word in regions], text_align="center", x_offset=0, y_offset=0)  # fmt: skip
            panels.append(on)
    keys = [Key("alert limit", plots.ORANGE, "dash"), Key("error equals level", plots.GREY)]
    caption = f"Stanford diagram. {'; '.join(text)}. Below the line an error is larger than its level."
    return Drawing("stanford", "Stanford diagram", panels, caption, keys)


def interference(results: Sequence[Named]) -> Drawing | None:
    """Effective carrier to noise density ratios over time, and when jammers send."""
    kept = [(name, r) for name, r in results if "/interference/cn0" in r]
    jammers = list(dict.fromkeys(str(each) for _, r in kept for each in r["/interference/jammer"]))
    panels, thinned = [], []
    for name, result in kept:
        on = plots.plot(name if len(results) > 1 else "", "time, s", "effective C/N0, dB-Hz", 280)
        time, cn0 = result["/interference/time"], result["/interference/cn0"]
        ground = set(map(str, result["/pseudolites/name"]))
        which = plots.thin(time.size, 400)
        thinned.append(which)
        marks: list[Any] = []
        for i, each in enumerate(map(str, result["/interference/source"])):
            if np.isfinite(cn0[:, i]).any():
                of = plots.source(x=which(time), y=which(cn0[:, i]))
                marks.append(
                    plots.line(on, of, "y", plots.ORANGE if each in ground else plots.BLUE, name=each, line_width=1.1)
                )
        for jammer, js in zip(map(str, result["/interference/jammer"]), result["/interference/js"], strict=True):
            j, heard = jammers.index(jammer), np.flatnonzero(np.isfinite(js).any(axis=1))
            for run in np.split(heard, np.flatnonzero(np.diff(heard) > 1) + 1) if heard.size else []:
                # at the foot, one above the other: shades over each other mix into colours of no jammer
                on.quad(left=float(time[run[0]]), right=float(time[run[-1]]), bottom=_STRIP * j, top=_STRIP * (j + 0.8),
                        fill_color=plots.colour(3 + j), line_color=None)  # fmt: skip
        plots.extend_y_axis(on, [cn0])
        plots.hover_text(on, marks, ("", "$name"), ("time", "@x{0.0} s"), ("C/N0", "@y{0.0} dB-Hz"))
        panels.append(on)
    if not panels:
        return None
    keys = [Key("satellites", plots.BLUE), Key("pseudolites", plots.ORANGE),
            *(Key(f"{each} is received", plots.colour(3 + j)) for j, each in enumerate(jammers))]  # fmt: skip
    caption = "Effective carrier to noise density of every source; bars at the foot: a jammer is received."
    caption += plots.most_thinned(thinned).caption("epoch")
    return Drawing("interference", "Interference", panels, caption, keys, 1)
