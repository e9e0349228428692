"""Drawings of single flights: recorded ones, and those with a real block in the loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.plotting import figure

from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.replays import report
from navsim.report.figure_data import settled

_NED = ("north", "east", "down")


def _three_sigma(results: Sequence[Named]) -> Key:
    return plots.band_key("±3σ", plots.colour(0), len(results) > 1)


def replays(results: Sequence[Named]) -> list[Drawing]:
    """Figures of recorded flights: track, innovations, attitude with its sigma and the biases, drift in outages."""
    out = [_track(results), _innovations(results), _attitude(results)]
    if any(np.isfinite(r["/outages/horizontal_error"]).any() for _, r in results):
        out.append(_outages(results))
    return out


def _track(results: Sequence[Named]) -> Drawing:
    plan = plots.plot("Plan", "east, m", "north, m", 380, match_aspect=True)
    profile = plots.plot("Height", "time, s", "height above the ellipsoid, m", 380)
    lines: list[list[Any]] = [[], []]
    thinned = []
    for i, (name, result) in enumerate(results):
        llh, fixes = result["/filter/position_llh"], result["/receiver/position_llh"]
        which, few = plots.thin(len(llh)), plots.thin(len(fixes))
        thinned.append(which)
        time, path = which(result["/filter/time"]), np.column_stack([report.east_north(llh[0], llh), llh[:, 2]])
        path = np.where(report.after_hole(result, time)[:, None], np.nan, which(path))
        of = plots.source(time=time, height=path[:, 2], **_flat(path))
        dots = plots.source(
            time=few(result["/receiver/time"]), height=few(fixes[:, 2]), **_flat(few(report.east_north(llh[0], fixes)))
        )
        away = report.rejected(result)
        crosses = plots.source(
            time=result["/receiver/time"][away],
            height=fixes[away, 2],
            **_flat(report.east_north(llh[0], fixes[away])),
        )
        for k, (on, x, y) in enumerate(((plan, "east", "north"), (profile, "time", "height"))):
            on.scatter(x, y, source=crosses, size=8, marker="x", color=plots.colour(3), name="rejected fixes")
            on.scatter(x, y, source=dots, size=3, color=plots.GREY if len(results) == 1 else plots.colour(i), alpha=0.6)
            lines[k].append(plots.line(on, of, y, plots.colour(i), x=x, name=name))
    lost = _shade_lost([profile], results)
    for on in (plan, profile):
        plots.metres_on_axes(on)
    for k, on in enumerate((plan, profile)):
        text = [("", "$name"), ("time", "@time{0.0} s"), ("east", "@east{0.0} m"), ("north", "@north{0.0} m")]
        plots.hover_text(on, lines[k], *text, ("height", "@height{0.0} m"))
    caption = "Line: the estimate, of the IMU; points: fixes, of the antenna; crosses: fixes that the gate rejected."
    caption += plots.most_thinned(thinned).caption("output")
    return Drawing(
        "track", "Track", [plan, profile], caption, plots.keys_of(results, Key("fixes", plots.GREY, "dot"), *lost)
    )


def _shade_lost(panels: Sequence[figure], results: Sequence[Named]) -> list[Key]:
    """Shade the times at which the output is unusable; returns the text of the legend."""
    spans = [(i, span) for i, (_, result) in enumerate(results) for span in report.lost_spans(result)]
    for on in panels:
        for i, (begin, end) in spans:
            plots.shaded_interval(on, begin, end, plots.GREY if len(results) == 1 else plots.colour(i), upright=True)
    return [Key("output unusable", plots.GREY, "band")] if spans else []


def _flat(points: np.ndarray) -> dict[str, np.ndarray]:
    return {"east": points[:, 0], "north": points[:, 1]}


def _innovations(results: Sequence[Named]) -> Drawing:
    panels: list[figure] = []
    for name, unit, text in (("position_ned", "m", "Position"), ("velocity_ned", "m/s", "Velocity")):
        for row, axis in enumerate(_NED):
            on = plots.plot(f"{text} {axis}", "time, s", unit, 210)
            on.x_range = panels[0].x_range if panels else on.x_range
            marks, seen = [], []
            for i, (called, result) in enumerate(results):
                values, sigma = (result[f"/innovations/{name}{end}"][:, row] for end in ("", "_sigma"))
                which = plots.thin(len(values), 1000)
                of = plots.source(
                    x=which(result["/innovations/time"]),
                    y=which(values),
                    low=which(-3.0 * sigma),
                    high=which(3.0 * sigma),
                )
                plots.band(on, of, "low", "high", plots.colour(i), len(results) > 1)
                marks.append(plots.line(on, of, "y", plots.colour(i), name=called, line_width=1.0))
                if np.isfinite(values).any():
                    # a few wild fixes must not flatten the rest
                    seen.append(np.array([np.nanpercentile(np.abs(values), 98), np.nanmedian(3.0 * sigma)]) * 1.2)
            plots.extend_y_axis(on, seen, symmetric=True)
            plots.horizontal_line(on, 0.0, dash="solid")
            plots.hover_text(on, marks, ("", "$name"), ("time", "@x{0.0} s"), ("innovation", f"@y{{0.000}} {unit}"),
                             ("3σ", f"@high{{0.000}} {unit}"))  # fmt: skip
            panels.append(on)
    thinned = plots.most_thinned(plots.thin(r["/innovations/time"].size, 1000) for _, r in results)
    caption = f"Fix less prediction; {plots.drawn_as(results)}: 3σ of the filter. A few wild fixes lie beyond the axes."
    caption += thinned.caption("epoch")
    lost = _shade_lost(panels, results)
    return Drawing(
        "innovations", "Innovations", panels, caption, plots.keys_of(results, _three_sigma(results), *lost), 3
    )


def _attitude(results: Sequence[Named]) -> Drawing:
    titles = (
        "Roll",
        "Pitch",
        "Yaw",
        "Uncertainty of tilt",
        "Uncertainty of heading",
        "Gyro bias",
        "Accelerometer bias",
    )
    units = ("deg", "deg", "deg", "1σ, deg", "1σ, deg", "deg/s", "m/s²")
    panels = [plots.plot(title, "time, s", unit, 210) for title, unit in zip(titles, units, strict=True)]
    marks: list[list[Any]] = [[] for _ in panels]
    dashes, thinned = ("solid", "dashed", "dotted"), []
    for i, (name, result) in enumerate(results):
        time, rpy = result["/filter/time"], np.degrees(result["/filter/attitude_rpy"])
        which = plots.thin(time.size, 800)
        thinned.append(which)
        jump = np.abs(np.diff(rpy, axis=0, prepend=rpy[:1])) > 180.0
        rpy, sigma = np.where(jump, np.nan, rpy), np.degrees(result["/filter/sigma"][:, 6:9])
        shown = [rpy[:, 0], rpy[:, 1], rpy[:, 2], sigma[:, :2].max(axis=1), sigma[:, 2]]
        columns = {f"y{k}": which(values) for k, values in enumerate(shown)}
        gyro, accelerometer = np.degrees(result["/filter/gyro_bias"]), result["/filter/accelerometer_bias"]
        columns |= {
            f"{what}{a}": which(data[:, a]) for what, data in (("g", gyro), ("a", accelerometer)) for a in range(3)
        }
        hole = report.after_hole(result, which(time))
        of = plots.source(
            x=which(time), **{column: np.where(hole, np.nan, values) for column, values in columns.items()}
        )
        for k in range(len(shown)):
            marks[k].append(plots.line(panels[k], of, f"y{k}", plots.colour(i), name=name))
        for k, what in ((5, "g"), (6, "a")):
            for a, axis in enumerate("xyz"):
                marks[k].append(
                    plots.line(panels[k], of, f"{what}{a}", plots.colour(i if len(results) > 1 else a),
                               name=f"{axis}, {name}", line_dash=dashes[a] if len(results) > 1 else "solid")
                )  # fmt: skip
    for k, on in enumerate(panels):
        on.x_range = panels[0].x_range
        plots.hover_text(on, marks[k], ("", "$name"), ("time", "@x{0.0} s"), (units[k], "$y{0.0000}"))
    one = len(results) == 1
    keys = [Key(axis, plots.colour(a) if one else plots.GREY, "line" if a == 0 or one else "dash")
            for a, axis in enumerate(("bias x", "y", "z"))]  # fmt: skip
    caption = "Attitude, how well it is known, and the biases of the sensors by axis." + plots.most_thinned(
        thinned
    ).caption("output")
    keys += _shade_lost(panels, results)
    return Drawing("attitude", "Attitude and biases", panels, caption, plots.keys_of(results, *keys), 3)


def _outages(results: Sequence[Named]) -> Drawing:
    on = plots.plot("", "horizontal drift, m", "share of outages", 300, x_axis_type="log", y_range=(0.0, 1.0))
    marks, keys = [], []
    for i, (name, result) in enumerate(results):
        for k, (duration, drift, share) in enumerate(report.drifts(result)):
            own = plots.colour(k if len(results) == 1 else i)
            text = f"{duration:g} s without fixes"
            of = plots.source(x=drift, y=share)
            plots.line(on, of, "y", own, line_dash="solid" if len(results) == 1 or k == 0 else "dashed")
            marks.append(on.scatter("x", "y", source=of, size=7, color=own, name=f"{text}, {name}"))
            keys += [Key(text, own)] if len(results) == 1 else []
    plots.hover_text(on, marks, ("", "$name"), ("drift", "@x{0.0} m"), ("share", "@y{0.00}"))
    caption = "How far the estimate has drifted at the end of stretches whose fixes were withheld."
    return Drawing("outages", "Drift without fixes", [on], caption, keys or plots.keys_of(results), 1)


def lives(results: Sequence[Named]) -> list[Drawing]:
    """Figures of flights with a real block in the loop: position errors with their 3 sigma."""
    panels: list[figure] = []
    thinned = []
    for k, axis in enumerate(_NED):
        on = plots.plot(axis.capitalize(), "time, s", "error, m", 240)
        on.x_range = panels[0].x_range if panels else on.x_range
        marks, seen = [], []
        for i, (name, result) in enumerate(results):
            time, error, sigma = (
                result["/filter/time"],
                result["/filter/error"][:, k],
                3.0 * result["/filter/sigma"][:, k],
            )
            which = plots.thin(time.size)
            thinned.append(which)
            of = plots.source(x=which(time), y=which(error), low=which(-sigma), high=which(sigma))
            plots.band(on, of, "low", "high", plots.colour(i), len(results) > 1)
            marks.append(plots.line(on, of, "y", plots.colour(i), name=name))
            late = settled(time) if time.size else np.zeros(0, bool)
            seen += [np.abs(error[late]), sigma[late]]
        plots.extend_y_axis(on, seen, symmetric=True)
        plots.horizontal_line(on, 0.0, dash="solid")
        plots.hover_text(
            on, marks, ("", "$name"), ("time", "@x{0.0} s"), ("error", "@y{0.000} m"), ("3σ", "@high{0.000} m")
        )
        panels.append(on)
    caption = f"Errors of position, truth minus estimate; {plots.drawn_as(results)}: ±3σ of the filter."
    caption += plots.most_thinned(thinned).caption("output")
    return [Drawing("errors", "Errors", panels, caption, plots.keys_of(results, _three_sigma(results)), 3)]
