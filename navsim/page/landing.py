"""Drawings of landings: of one, or of several over each other, in the colour of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import Range1d
from bokeh.plotting import figure

from navsim.page import integrity, plots, rare
from navsim.page.plots import Drawing, Key, Named
from navsim.page.sky import beside, name_marks, sky_paper, skyline
from navsim.page.terrain import plan_of, ridge_lines
from navsim.page.touchdown import deviations, distribution, percentiles, scatter
from navsim.report.budget_rows import source_title
from navsim.report.consistency_rows import state_verdict
from navsim.report.figure_data import (
    RunwayErrors,
    descent,
    ellipse,
    first_runs,
    followed_by,
    in_runway_axes,
    rms_over_runs,
    runway_errors,
    settled,
    some_fix_errors,
    state_ratios,
    touchdown,
    true_for,
)
from navsim.report.figure_data import heights as height_of
from navsim.report.result_cells import setting, single
from navsim.report.ridges import clipped, flown_over, on_plan, shown_ridges, terrain_skyline
from navsim.report.sky import SourceTrack, masked, source_tracks
from navsim.results.result import Result
from navsim.results.schema import RMS_WINDOW

_ON_GROUND = ("pseudolites", "triangle", plots.ORANGE), ("beacons", "square", plots.GREEN)
"""Transmitters on the ground: group of the result, marker, colour."""
_MOST_FIXES = 1500
_RATIO_COLUMNS = 400
"""Most columns of the map of ratios."""


def drawings(results: Sequence[Named]) -> list[Drawing]:
    """Every drawing that these landings have data for, flights before the probabilities of leaving a box."""
    flights = [(name, result) for name, result in results if result.attributes["method"] != "rare"]
    out: list[Drawing] = []
    if flights:
        made = (
            track, sky, dops, heights, deviations, scatter, distribution, percentiles, states, fixes, consistency,
            ratios, budget, integrity.levels, integrity.stanford, integrity.interference,
        )  # fmt: skip
        out = [drawing for make in made if (drawing := make(flights)) is not None]
    boxes = [(name, result) for name, result in results if result.attributes["method"] == "rare"]
    return out + rare.drawings(boxes, len(flights)) if boxes else out


def track(results: Sequence[Named]) -> Drawing:
    """Plan view with pseudolites and beacons, and the height over the same distances."""
    plan = plots.plot("Plan", "", "right of the axis, m", 300)
    profile = plots.plot("Height", "beyond the threshold (= -l1), m", "height above the threshold, m", 220)
    lines: list[Any] = []
    places: list[Any] = []
    thinned = []
    runways = {(setting(r, "runway", "length_m"), setting(r, "runway", "width_m")) for _, r in results}
    for length, breadth in sorted(runways):
        plan.quad(
            left=0.0,
            right=length,
            bottom=-breadth / 2,
            top=breadth / 2,
            fill_color=plots.GREY,
            line_color=plots.GREY,
            line_width=3,
        )
    plots.shaded_interval(profile, 0.0, max(length for length, _ in runways), upright=True)
    for i, (name, result) in enumerate(results):
        path, time = in_runway_axes(result, result["/truth/position_llh"]), result["/truth/time"]
        which = plots.thin(time.size, 600)
        thinned.append(which)
        of = plots.source(x=which(path[:, 0]), right=which(path[:, 1]), up=which(path[:, 2]), time=which(time))
        own = plots.width(i, len(results))
        lines += [
            plots.line(on, of, y, plots.colour(i), name=name, line_width=own)
            for on, y in ((plan, "right"), (profile, "up"))
        ]
        for kind, mark, tint in _ON_GROUND:
            sites = result[f"/{kind}/name"] if f"/{kind}/name" in result else np.empty(0)
            if not sites.size:
                continue
            at = in_runway_axes(result, result[f"/{kind}/position_llh"])
            of = plots.source(x=at[:, 0], y=at[:, 1], said=[str(site) for site in sites])
            places.append(
                plan.scatter("x", "y", source=of, marker=mark, size=11, name=name,
                             color=tint if len(results) == 1 else plots.colour(i))
            )  # fmt: skip
            plots.names(plan, at[:, 0], at[:, 1], sites)
        if np.isfinite(landed := touchdown(result)):
            plots.vertical_line(
                profile, float(np.interp(landed, time, path[:, 0])), plots.colour(i) if len(results) > 1 else plots.GREY
            )
    view = _plan_view(results)
    hilly = False
    for _, result in results:
        hilly |= ridge_lines(plan, shown_ridges(result), *view)
        for over in flown_over(result):
            profile.segment(over.along, 0.0, over.along, over.top, line_color=plots.BROWN, line_width=3)
            plots.names(
                profile, over.along, over.top, [over.label], plots.BROWN, x_offset=0, y_offset=-4, text_align="center"
            )
    plots.view_from_above(plan, *((low - 0.07 * (high - low), high + 0.07 * (high - low)) for low, high in view))
    profile.x_range = plan.x_range
    for on in (plan, profile):
        plots.metres_on_axes(on)
        shown = [("", "$name"), ("time", "@time{0.0} s"), ("along", "@x{0} m"), ("right", "@right{0.0} m"),
                 ("up", "@up{0.0} m")]  # fmt: skip
        plots.hover_text(on, [each for each in lines if each in on.renderers], *shown)
    beacons = any("/beacons/name" in r for _, r in results)
    what = "transmitter" if beacons else "pseudolite"
    plots.hover_text(plan, places, (what, "@said"), ("along", "@x{0.0} m"), ("right", "@y{0.0} m"))
    truth = next((text for _, r in results if (text := true_for(r))), "")
    caption = (
        "The true flight over the runway (grey), seen from above and from the side, both over the distance from the "
        f"threshold. Triangles: pseudolites;{' squares: ranging beacons;' if beacons else ''} dashed: touchdown."
        + (" Brown: terrain, with the height of its top above the threshold; from the side where the way goes over it."
           if hilly else "") + (f" {truth.capitalize()}." if truth else "")
        + plots.most_thinned(thinned).caption()
    )  # fmt: skip
    keys = [Key("runway", plots.GREY, "band"),
            Key("pseudolite", plots.ORANGE if len(results) == 1 else plots.GREY, "triangle"),
            *([Key("beacon", plots.GREEN if len(results) == 1 else plots.GREY, "band")] if beacons else []),
            *([Key("terrain", plots.BROWN)] if hilly else [])]  # fmt: skip
    return Drawing("track", "Track over the runway", [plan, profile], caption, plots.keys_of(results, *keys), 1)


def _plan_view(results: Sequence[Named]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Range of a plan of these landings, along and right, m: runways, trajectories, pseudolites, and ridges near
    them."""
    there = []
    for _, result in results:
        paths = ("/truth/position_llh", *(f"/{kind}/position_llh" for kind, *_ in _ON_GROUND))
        seen = np.concatenate([in_runway_axes(result, result[path])[:, :2] for path in paths if path in result])
        half = 0.5 * setting(result, "runway", "width_m")
        there += [seen, np.array([[0.0, -half], [setting(result, "runway", "length_m"), half]])]
        there += [clipped(ridge, *on_plan(seen)).reshape(-1, 2) for ridge in shown_ridges(result)]
    return plan_of(np.concatenate(there))


def sky(results: Sequence[Named]) -> Drawing:
    """Directions to all sources, used and not, with the mask, a panel a result."""
    found = [source_tracks(result) for _, result in results]
    edge = max(own for _, own in found)  # of one scale
    panels = [
        _sky(name if len(results) > 1 else "", result, sources, edge)
        for (name, result), (sources, _) in zip(results, found, strict=True)
    ]
    hilly = any(shown_ridges(result) for _, result in results)
    whole = all("/geometry/instant" in result for _, result in results)
    caption = (
        "Directions by azimuth (north up, east right) and elevation (zenith in the middle) over the approach; marks: "
        "where sources are at its end, pale where one is lost at some fixes. Shaded: below the mask or the horizon, or "
        "taken out of the sky."
        + (" Brown: what terrain hides beyond it, seen from the last fix; pseudolites may stand before it."
           if hilly else "")
        + ("" if whole else " A result of an earlier version keeps used sources alone.")
    )  # fmt: skip
    keys = [Key("used", plots.BLUE, "dot"), Key("not used", plots.GREY, "ring"),
            Key("pseudolite", plots.ORANGE, "triangle"), Key("masked", plots.GREY, "band"),
            *([Key("behind terrain", plots.BROWN, "band")] if hilly else [])]  # fmt: skip
    return Drawing("sky", "Sky: sources used and unused", panels, caption, keys, min(3, max(2, len(panels))))


def _sky(title: str, result: Result, sources: Sequence[SourceTrack], edge: float) -> figure:
    on = sky_paper(title, edge, masked(result, edge))
    mask = float(setting(result, "sky", "mask_deg"))
    if "/geometry/horizon" in result:
        skyline(on, result["/geometry/bearing"], result["/geometry/horizon"], mask)
    if (terrain := terrain_skyline(result)) is not None:
        skyline(on, *terrain, mask, plots.BROWN, 0.5)
    marks = []
    for each in sources:
        own, last = plots.ORANGE if each.ground else plots.BLUE, each.last
        for used, style in ((True, own), (False, plots.GREY)):
            x, y = each.part(used)
            if np.isfinite(x).any():
                plots.line(on, plots.source(x=x, y=y), "y", style, line_dash="solid" if used else "dotted")
        x, y = each.x[last : last + 1], each.y[last : last + 1]
        of = plots.source(said=[each.name], how=[each.how], x=x, y=y,
                          azimuth=np.degrees(np.arctan2(x, y)) % 360.0, elevation=90.0 - np.hypot(x, y))  # fmt: skip
        style = own if each.share else plots.GREY
        full = 1.0 if each.share == 1.0 else 0.35 if each.share else 0.0
        marks.append(
            on.scatter("x", "y", source=of, size=10, marker="triangle" if each.ground else "circle",
                       line_color=style, fill_color=style, fill_alpha=full)
        )  # fmt: skip
    if sources:
        across, up, text = zip(*((float(e.x[e.last]), float(e.y[e.last]), e.name) for e in sources), strict=True)
        name_marks(on, plots.source(**beside(across, up, text, edge)))
    plots.hover_text(on, marks, ("", "@said, @how"), ("azimuth", "@azimuth{0.0}°"), ("elevation", "@elevation{0.0}°"))
    return on


def dops(results: Sequence[Named]) -> Drawing:
    """Dilutions of precision, and how many sources are used, over time."""
    ground = any(result["/pseudolites/name"].size for _, result in results)
    wanted = ["pdop", "hdop", "vdop", "sources"]
    panels = [plots.plot(name.upper() if name != "sources" else "Sources used", "time, s", "", 210) for name in wanted]
    for other in panels[1:]:
        other.x_range = panels[0].x_range
    marks: list[list[Any]] = [[] for _ in wanted]
    largest: list[list[np.ndarray]] = [[] for _ in wanted]
    thinned = []
    for i, (name, result) in enumerate(results):
        time = result["/geometry/time"]
        which = plots.thin(time.size)
        thinned.append(which)
        seen = np.isfinite(result["/geometry/line_of_sight"][:, :, 0])
        mine = np.isin(result["/geometry/source"].astype(str), result["/pseudolites/name"].astype(str))
        columns = {dop: result[f"/geometry/{dop}"] for dop in wanted[:3]}
        columns |= {"sources": seen.sum(axis=1), "pseudolites": seen[:, mine].sum(axis=1)}
        of = plots.source(x=which(time), **{key: which(values) for key, values in columns.items()})
        for k, key in enumerate(wanted):
            marks[k].append(
                plots.line(panels[k], of, key, plots.colour(i), name=name, line_width=plots.width(i, len(results)))
            )
            largest[k].append(columns[key])
        if ground:
            marks[3].append(plots.line(panels[3], of, "pseudolites", plots.colour(i), name=name, line_dash="dashed"))
        if np.isfinite(landed := touchdown(result)):
            for on in panels:
                plots.vertical_line(on, landed)
    for k, key in enumerate(wanted):
        plots.extend_y_axis(panels[k], largest[k])
        text = ("used", "@sources{0}, of them @pseudolites{0} pseudolites") if key == "sources" else (
            key.upper(), f"@{key}{{0.000}}")  # fmt: skip
        plots.hover_text(panels[k], marks[k], ("", "$name"), ("time", "@x{0.0} s"), text, vertical=True)
    caption = (
        "Dilution of precision by unit weights, a gap where there is no fix; how many sources a fix is made of"
        + (", and of them pseudolites (dashed)" if ground else "") + "; the upright line is touchdown."
        + plots.most_thinned(thinned).caption()
    )  # fmt: skip
    return Drawing("dop", "Dilution of precision, number of sources", panels, caption, plots.keys_of(results))


def _of_runs(result: Result) -> tuple[np.ndarray, np.ndarray] | None:
    """Errors of single runs (r, t, n), and the root mean square over all runs (t, n).

    A covariance analysis has no single runs. None if the result has no history.
    """
    if "/filter/error" in result:
        return first_runs(result, "/filter/error", plots.MOST_LINES), rms_over_runs(result, "/filter/error")
    if "/covariance/rms" in result:
        rms = result["/covariance/rms"]
        return np.empty((0, *rms.shape)), rms
    return None


def heights(results: Sequence[Named]) -> Drawing | None:
    """Errors of position in axes of the runway against the height, with 3 sigma."""
    kept = [(i, name, result) for i, (name, result) in enumerate(results)
            if "/filter/error" in result or "/covariance/rms" in result]  # fmt: skip
    if not kept:
        return None
    panels = [plots.plot(axis.capitalize(), "height above the threshold, m", "error, m", 280) for axis in plots.AXES]
    seen: list[list[np.ndarray]] = [[] for _ in plots.AXES]
    marks: list[list[Any]] = [[] for _ in plots.AXES]
    thinned, turned, straight = [], False, False
    top = max(float(height_of(result)[descent(result)].max()) for _, _, result in kept)
    for i, name, result in kept:
        way = descent(result)
        which = plots.thin(way.size, 1300 if len(kept) == 1 else 650)
        thinned.append(which)
        found = runway_errors(result, which(way), plots.MOST_LINES)
        turned |= found.sigma is None
        straight |= found.sigma is not None
        flown = {"x": height_of(result)[which(way)], "time": result["/filter/time"][which(way)]}
        own = {"name": name, "line_width": plots.width(i, len(kept))}
        aside = 0.012 * top * (i - 0.5 * (len(results) - 1))  # bars of several results side by side
        for k, on in enumerate(panels):
            if len(kept) == 1 and not single(result):
                _single_runs(on, flown["x"], found.runs[:, :, k])
            lines, reached = _against_height(on, flown, found, k, single(result), plots.colour(i), own, len(kept) > 1)
            marks[k] += lines
            seen[k] += [*reached, _bars(on, result, plots.AXES[k], aside, plots.colour(i))]
    for k, on in enumerate(panels):
        plots.extend_y_axis(on, seen[k], symmetric=True)
        plots.horizontal_line(on, 0.0, dash="solid")
        one = [("error", "@error{0.000} m")] if any(single(r) for _, _, r in kept) else []
        more = [("RMS over runs", "@rms{0.000} m")] if not all(single(r) for _, _, r in kept) else []
        plots.hover_text(on, marks[k], ("", "$name"), ("height", "@x{0.0} m"), ("time", "@time{0.0} s"), *one, *more)
        plots.reversed_x_axis(on, -0.02 * top, 1.02 * top)
        on.x_range = panels[0].x_range
    lone = [single(result) for _, _, result in kept]
    what = "Error of position, truth minus estimate: right of, along and above the axes of the runway; the flight goes "
    what += "from left to right. "
    what += "Line: the error of the run. " if all(lone) else "Lines: ±3 RMS over runs. "
    what += "Thin lines: single runs. " if len(kept) == 1 and not lone[0] and "/filter/error" in kept[0][2] else ""
    what += "Bars: ±3σ of the filter at the heights of the table"
    what += f"; {plots.drawn_as(kept)}: the same all the way" if straight else ""
    what += ", where the runway runs along a parallel or meridian" if turned and straight else "."
    what += " Across other axes than those of the map σ is known at the bars alone" if turned else ""
    what += ", the RMS of a covariance analysis not." if turned else ""
    what += plots.most_thinned(thinned).caption("output")
    band = plots.band_key("±3σ of the filter", plots.BLUE, len(kept) > 1)
    bars = Key("±3σ of the filter: bars", plots.BLUE if len(kept) == 1 else plots.GREY)
    keys = plots.keys_of(results, band if straight else bars, of=kept)
    return Drawing("heights", "Errors in runway axes against height", panels, what, keys, 3)


def _against_height(
    on: figure, flown: dict[str, np.ndarray], found: RunwayErrors, k: int, alone: bool, colour: str,
    own: dict[str, Any], several: bool,
) -> tuple[list[Any], list[np.ndarray]]:  # fmt: skip
    """Error of a run, or 3 RMS of several, and 3 sigma, along the k-th axis; returns marks and sizes that the plot must
    cover.

    flown: heights and times. own: name and width of the line. several: other results are in the same plot.
    """
    columns, late = dict(flown), settled(flown["time"])
    reached: list[np.ndarray] = []
    if found.sigma is not None:
        bound = 3.0 * found.sigma[:, k]
        columns |= {"low": -bound, "high": bound}
        reached.append(bound[late])
    if alone:
        columns["error"] = found.runs[0, :, k]
        reached.append(np.abs(columns["error"][late]))
    elif found.rms is not None:
        columns |= {"rms": found.rms[:, k], "up": 3.0 * found.rms[:, k], "down": -3.0 * found.rms[:, k]}
        reached.append(columns["up"][late])
    of = plots.source(**columns)
    if found.sigma is not None:
        plots.band(on, of, "low", "high", colour, several)
    drawn = ["error"] if alone else ["up", "down"] if found.rms is not None else []
    return [plots.line(on, of, each, colour, **own) for each in drawn][:1], reached


def _single_runs(on: figure, height: np.ndarray, errors: np.ndarray) -> None:
    """Thin lines of runs (r, w)."""
    few = slice(None, None, max(1, height.size // 300))
    runs = [run[few].astype(np.float32) for run in errors]
    on.multi_line(
        [height[few].astype(np.float32)] * len(runs), runs, line_color=plots.GREY, line_alpha=0.45, line_width=0.7
    )


def _bars(on: figure, result: Result, axis: str, aside: float, colour: str) -> np.ndarray:
    """3 sigma of the filter at the evaluated heights, offset by `aside`; returns their sizes."""
    sizes = 3.0 * result[f"/summary/at/{axis}_sigma"]
    of = plots.source(x=result["/summary/at/height"] + aside, low=-sizes, high=sizes)
    on.segment("x", "low", "x", "high", source=of, line_color=colour, line_width=2)
    for end in ("low", "high"):
        on.scatter("x", end, source=of, marker="dash", size=9, line_color=colour, line_width=2)
    return sizes


def _sigma(result: Result) -> np.ndarray:
    """1 sigma of the filter over runs (t, n)."""
    return rms_over_runs(result, "/filter/sigma")


def states(results: Sequence[Named]) -> Drawing | None:
    """All errors of the filter over time."""
    kept = [(i, name, r, found) for i, (name, r) in enumerate(results) if (found := _of_runs(r)) is not None]
    if not kept:
        return None
    # those of all results, each by its name: filters follow different ones
    shown = {
        name: state
        for _, _, r, _ in kept
        for name, state in zip(map(str, r["/filter/state"]), followed_by(r), strict=True)
    }
    panels, thinned, place = [], [], {name: k for k, name in enumerate(shown)}
    for state in shown.values():
        panels.append(plots.plot(f"{state.row}{' ' + state.axis if state.axis else ''}", "time, s", state.unit, 190))
        panels[-1].x_range = panels[0].x_range
    marks: list[list[Any]] = [[] for _ in shown]
    seen: list[list[np.ndarray]] = [[] for _ in shown]
    for i, name, result, (errors, rms) in kept:
        time = result["/filter/time"]
        which = plots.thin(time.size, 1300 if len(kept) == 1 else 650)
        thinned.append(which)
        sigma, late, alone = _sigma(result), settled(time), single(result)
        columns: dict[str, np.ndarray] = {"x": which(time)}
        mine = [place[state] for state in map(str, result["/filter/state"])]
        for j, k in enumerate(mine):
            scale = list(shown.values())[k].scale
            drawn = (errors[0] if alone else 3.0 * rms)[:, j] * scale
            columns[f"e{k}"] = which(drawn)
            columns[f"s{k}"], columns[f"t{k}"] = (which(sign * 3.0 * sigma[:, j] * scale) for sign in (1.0, -1.0))
            seen[k] += [np.abs(drawn[late]), 3.0 * sigma[late, j] * scale]
        of = plots.source(**columns)
        for k in mine:
            plots.band(panels[k], of, f"t{k}", f"s{k}", plots.colour(i), len(kept) > 1)
            marks[k].append(
                plots.line(panels[k], of, f"e{k}", plots.colour(i), name=name, line_width=plots.width(i, len(kept)))
            )
    for k, on in enumerate(panels):
        plots.extend_y_axis(on, seen[k], symmetric=any(single(r) for _, _, r, _ in kept))
        unit = list(shown.values())[k].unit
        plots.hover_text(on, marks[k], ("", "$name"), ("time", "@x{0.0} s"), ("shown", f"@e{k}{{0.0000}} {unit}"),
                         ("3σ of the filter", f"@s{k}{{0.0000}} {unit}"))  # fmt: skip
    lone = [single(r) for _, _, r, _ in kept]
    what = "the error of the run, truth minus estimate" if all(lone) else "3 RMS over all runs"
    what = what if len(set(lone)) == 1 else "3 RMS over all runs; for a single run its error"
    caption = (
        f"Line: {what}; {plots.drawn_as(kept)}: 3σ of the filter. The axes fit the errors after the start has settled."
    )
    caption += plots.most_thinned(thinned).caption("output")
    keys = plots.keys_of(results, plots.band_key("3σ of the filter", plots.BLUE, len(kept) > 1), of=kept)
    return Drawing("states", "All states of the filter over time", panels, caption, keys, 3)


def fixes(results: Sequence[Named]) -> Drawing | None:
    """Scatter of fixes about the true antenna, a panel a result."""
    kept = plots.results_with(results, "/receiver/position_llh")
    if not kept:
        return None
    panels, predicted = [], plots.ORANGE if len(kept) == 1 else plots.GREY
    for i, name, result in kept:
        on = plots.plot(
            name if len(results) > 1 else "", "fix minus true antenna, east, m", "north, m", 340, match_aspect=True
        )
        shown = some_fix_errors(result, _MOST_FIXES)
        if not shown.size:
            plots.names(on, 0.0, 0.0, ["no fixes"])
        else:
            drawn = on.scatter(
                "x", "y", source=plots.source(x=shown[:, 1], y=shown[:, 0]), size=3, color=plots.colour(i), alpha=0.5
            )
            rim = ellipse(np.nanmean(result["/receiver/covariance_enu"][:, :2, :2], axis=0))
            plots.line(on, plots.source(x=rim[0], y=rim[1]), "y", predicted, line_width=2)
            plots.hover_text(on, [drawn], ("east", "@x{0.00} m"), ("north", "@y{0.00} m"))
        panels.append(on)
    caption = (
        "Fixes of the receiver about where its antenna is, some of all runs alike, with the ellipse that holds 95 % by "
        "the mean of their predicted covariance."
    )
    return Drawing("fixes", "Fixes", panels, caption, [Key("95 % as predicted", predicted)])


def consistency(results: Sequence[Named]) -> Drawing:
    """NEES and NIS per degree of freedom over time."""
    wanted = (("nees", "All states (NEES)"), ("nees_position_velocity", "Position and velocity (NEES)"),
              ("nis", "Innovations (NIS)"))  # fmt: skip
    panels: list[figure] = []
    thinned = []
    for name, title in wanted:
        on = plots.plot(title, "time, s", "per degree of freedom", 230)
        on.x_range = panels[0].x_range if panels else on.x_range
        marks, values = [], []
        for i, (called, result) in enumerate(results):
            variable = result.variables[f"/summary/consistency/{name}"]
            time, data = result["/summary/consistency/time"], np.asarray(variable.data)
            which = plots.thin(time.size, 1300 if len(results) == 1 else 650)
            thinned.append(which)
            of = plots.source(x=which(time), y=which(data))
            dots = name == "nis" and "band_low" in variable.attributes
            tint, wide = plots.colour(i), plots.width(i, len(results))
            marks.append(on.scatter("x", "y", source=of, size=3, color=tint, name=called) if dots
                         else plots.line(on, of, "y", tint, name=called, line_width=wide))  # fmt: skip
            values.append(data[settled(time)])
            if "band_low" in variable.attributes:
                low, high = (float(variable.attributes[f"band_{end}"]) for end in ("low", "high"))
                if len(results) == 1:
                    plots.shaded_interval(on, low, high, plots.colour(i))
                for end in (low, high) if len(results) > 1 else ():
                    plots.horizontal_line(on, end, plots.colour(i), "dotted")
        plots.horizontal_line(on, 1.0, dash="solid")
        plots.extend_y_axis(on, values, 1.5)
        plots.hover_text(on, marks, ("", "$name"), ("time", "@x{0.0} s"), ("per degree", "@y{0.000}"))
        panels.append(on)
    caption = (
        "Squared errors by the filter's own covariance, per degree of freedom: 1 is right, more is overconfident. "
        f"{plots.drawn_as(results).capitalize()}: the mean over these runs is inside at 95 % of instants if the filter "
        "is right. A covariance analysis shows expected values." + plots.most_thinned(thinned).caption("output")
    )
    return Drawing("consistency", "Consistency", panels, caption, plots.keys_of(results), 3)


def ratios(results: Sequence[Named]) -> Drawing | None:
    """Map of z of every state over time, a panel a result."""
    kept = plots.results_with(results, "/consistency/z")
    panels, text = [], []
    for _, name, result in kept:
        of = state_ratios(result, _RATIO_COLUMNS)
        count = len(of.names)
        on = plots.plot(name if len(results) > 1 else "", "time, s", "", 150 + 18 * count)
        on.y_range = Range1d(float(count), 0.0)
        plots.ticks(on, on.yaxis[0], [i + 0.5 for i in range(count)], of.names)
        mapper = plots.colour_map(0.0, of.limit) if of.alone else plots.ratio_colour_map(of.limit)
        span = (float(of.edges[0]), float(of.edges[-1]))
        drawn = plots.image(on, of.z, span, (0.0, float(count)), mapper, of.label)
        plots.hover_text(on, [drawn], ("time", "$x{0.0} s"), (of.label, "@image{0.000}"))
        panels.append(on)
        text.append(f"{f'{name}: ' if len(results) > 1 else ''}{state_verdict(result)}.")
    if not panels:
        return None
    caption = (
        "Root mean square over runs of each state's error in units of the filter's sigma, at every output. White, 1: "
        "sigma is right; red: too small; blue: too large. For a single run: its error in sigmas. States without "
        "uncertainty are left blank. " + " ".join(text)
    )
    return Drawing("ratios", "Consistency of every state", panels, caption, plots.keys_of(results, of=kept), 1)


def budget(results: Sequence[Named]) -> Drawing | None:
    """Contribution of each source of error, as a waterfall of mean squares."""
    kept = plots.results_with(results, "/summary/budget/source")
    panels = []
    for i, name, result in kept:
        sources = [source_title(str(each)) for each in result["/summary/budget/source"]]
        for axis in ("horizontal", "vertical"):
            share, alone = (result[f"/summary/budget/{axis}{part}"] for part in ("_share", ""))
            order = [k for k in np.argsort(-share, kind="stable") if share[k] >= 0.001]
            rest = 1.0 - float(share[order].sum())
            text = [sources[k] for k in order] + (
                [f"{len(sources) - len(order)} others"] if len(order) < len(sources) else []
            )
            shares = [float(share[k]) for k in order] + ([max(rest, 0.0)] if len(order) < len(sources) else [])
            metres = [float(alone[k]) for k in order]
            total = math.sqrt(float(np.sum(alone**2)))
            metres += [total * math.sqrt(s) for s in shares[len(metres) :]]
            end = 100.0 * np.cumsum(shares)
            text, start = [*text, "in all"], [*(end - 100.0 * np.array(shares)), 0.0]
            title = f"{axis.capitalize()}{f', {name}' if len(results) > 1 else ''}: {total:.3f} m"
            on = plots.plot(title, "share of the mean square, %", "", 90 + 22 * len(text), y_range=text[::-1])
            on.update(x_range=Range1d(0.0, 102.0))
            of = plots.source(said=text, left=start, right=[*end, 100.0], share=[*(100.0 * s for s in shares), 100.0],
                              metres=[*metres, total])  # fmt: skip
            drawn = on.hbar(
                "said", height=0.7, left="left", right="right", source=of, color=plots.colour(i), alpha=0.85
            )
            on.ygrid.visible = False
            plots.hover_text(on, [drawn], ("", "@said"), ("alone", "@metres{0.0000} m"), ("share", "@share{0.00} %"))
            panels.append(on)
    if not panels:
        return None
    caption = (
        f"How the mean square error over {RMS_WINDOW:g} s to touchdown is made up, the largest source first: mean "
        "squares of sources add up, sizes do not. Each bar begins where the one above it ends. Sources below 0.1 % "
        "are together."
    )
    return Drawing("budget", "Error budget", panels, caption, plots.keys_of(results, of=kept))
