"""Drawings of the companion papers' systems for the page of `navsim report`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import FactorRange
from bokeh.plotting import figure

from navsim.companions.atc import report as atc
from navsim.companions.azimuth import report as azimuth
from navsim.companions.elevation import report as elevation
from navsim.page import plots
from navsim.page.plots import Drawing, Key, Named
from navsim.report.figure_data import settled
from navsim.report.result_cells import setting
from navsim.results.result import Result
from navsim.statistics.rounding import digits

_OF_RUNS = "σ of the filter"


def _several(results: Sequence[Named], k: int) -> tuple[str, str]:
    """Suffix of an anchor and of a title for the k-th result."""
    return f"-{k}", f" ({results[k][0]})" if len(results) > 1 else ""


def _rmse(errors: np.ndarray) -> np.ndarray:
    """Root mean square over runs (t,)."""
    return np.sqrt(np.mean(errors**2, axis=0))


def atcs(results: Sequence[Named]) -> list[Drawing]:
    """Figures of air traffic control: RMSE over time of every filter; decoupled over full, state by state."""
    out = []
    for k, (_, result) in enumerate(results):
        anchor, called = _several(results, k)
        panels = [plots.plot("Range", "time, s", "RMSE, m", 280), plots.plot("Range rate", "time, s", "RMSE, m/s", 280)]
        panels[1].x_range = panels[0].x_range
        time = result["/time"]
        late, which = settled(time), plots.thin(time.size, 800)
        marks: list[list[Any]] = [[], []]
        seen: list[list[np.ndarray]] = [[], []]
        filters = [str(name) for name in result["/filter"]]
        for f, name in enumerate(filters):
            error, sigma = result[f"/filters/{name}/error"], result[f"/filters/{name}/sigma"]
            for i, on in enumerate(panels):
                rmse = _rmse(error[:, :, i])
                of = plots.source(x=which(time), y=which(rmse), sigma=which(sigma[:, i]))
                plots.line(on, of, "sigma", plots.colour(f), line_dash="dotted", line_width=1)
                marks[i].append(plots.line(on, of, "y", plots.colour(f), name=name))
                seen[i] += [rmse[late], sigma[late, i]]
        for i, on in enumerate(panels):
            for begin, end in setting(result, "circuit", "manoeuvre_s"):
                plots.shaded_interval(on, begin, end, upright=True)
            plots.extend_y_axis(on, seen[i])
            plots.hover_text(
                on, marks[i], ("", "$name"), ("time", "@x{0.0} s"), ("RMSE", "@y{0.000}"), (_OF_RUNS, "@sigma{0.000}")
            )
        keys = [Key(f"{name}: {atc.WORDS[name]}", plots.colour(f)) for f, name in enumerate(filters)]
        caption = (
            f"{atc.case_label(result['/case'][0])}, {_runs(result)}; dotted: {_OF_RUNS}; shaded: manoeuvres."
            + which.caption("scan")
        )
        out += [Drawing(f"errors{anchor}", f"Errors over time{called}", panels, caption, keys, 1),
                _ratios(result, anchor, called)]  # fmt: skip
    return out


def _runs(result: Result) -> str:
    runs = result["/run"].size
    return f"{runs} runs" if runs > 1 else "one run"


def _ratios(result: Result, anchor: str, called: str) -> Drawing:
    states = [str(name).replace("_", " ") for name in result["/state"]]
    cases, ratios = result["/case"], result["/summary/decoupled_to_full"][:, 0, 0]
    on = plots.plot("", "", "RMSE, adapt / full, manoeuvre", 320)
    marks, keys = [], []
    for c, case in enumerate(cases):
        at = np.arange(len(states)) + 0.6 / cases.size * (c - 0.5 * (cases.size - 1))
        value, low, high = ratios[c].T
        of = plots.source(x=at, y=value, low=low, high=high, state=states)
        on.segment("x", "low", "x", "high", source=of, line_color=plots.colour(c), line_width=2)
        text = atc.case_label(case)
        marks.append(on.scatter("x", "y", source=of, size=7, color=plots.colour(c), name=text))
        keys.append(Key(text, plots.colour(c), "dot"))
    plots.ticks(on, on.xaxis[0], range(len(states)), states)
    on.xaxis[0].major_label_orientation = 0.7
    plots.horizontal_line(on, 1.0)
    plots.hover_text(
        on, marks, ("", "$name"), ("", "@state"), ("ratio", "@y{0.000}"), ("95 %", "@low{0.000} to @high{0.000}")
    )
    caption = "Cost of decoupling for each state, with 95 % intervals; 1: no cost."
    return Drawing(f"ratios{anchor}", f"Decoupled over full{called}", [on], caption, keys, 1)


def azimuths(results: Sequence[Named]) -> list[Drawing]:
    """Figures of azimuth tracking: RMSE over time, the accelerations, the map."""
    out = []
    for k, (_, result) in enumerate(results):
        anchor, called = _several(results, k)
        words = azimuth.filter_labels(result)
        on = plots.plot("", "time, s", "azimuth RMSE, deg", 340, y_axis_type="log")
        time = result["/time"]
        which = plots.thin(time.size, 800)
        marks, keys = [], []
        for f, name in enumerate(("S1", "S2", "L1", "L2", "L3", "L4")):
            of = plots.source(x=which(time), y=which(_rmse(result[f"/filters/{name}/error_deg"])),
                              sigma=which(result[f"/filters/{name}/sigma_deg"]))  # fmt: skip
            plots.line(on, of, "sigma", plots.colour(f), line_dash="dotted", line_width=1)
            marks.append(plots.line(on, of, "y", plots.colour(f), name=name))
            keys.append(Key(f"{name}: {words[name]}", plots.colour(f)))
        turns = np.flatnonzero(result["/truth/roll"] != 0.0)
        for run in np.split(turns, np.flatnonzero(np.diff(turns) > 1) + 1) if turns.size else []:
            begin, end = (float(result["/truth/time"][at]) for at in run[[0, -1]])
            plots.shaded_interval(on, begin, end, upright=True)
        plots.hover_text(
            on,
            marks,
            ("", "$name"),
            ("time", "@x{0.0} s"),
            ("RMSE", "@y{0.0000} deg"),
            (_OF_RUNS, "@sigma{0.0000} deg"),
        )
        caption = (
            f"T = {result['/period'][0]:g} s, {_runs(result)}; dotted: {_OF_RUNS}; shaded: turns."
            + which.caption("scan")
        )
        out += [Drawing(f"errors{anchor}", f"Errors over time{called}", [on], caption, keys, 1),
                _accelerations(result, anchor, called)]  # fmt: skip
        if "/map/ratio" in result:
            out.append(_where(result, anchor, called))
    return out


def _accelerations(result: Result, anchor: str, called: str) -> Drawing:
    plan = plots.plot("Circuit", "east, km", "north, km", 320, match_aspect=True)
    below = plots.plot("Acceleration of the azimuth", "time, s", "10⁻³ deg/s²", 320)
    time = result["/truth/time"]
    which = plots.thin(time.size, 800)
    position = which(result["/truth/position"]) / 1e3
    of = plots.source(x=position[:, 2], y=position[:, 0], time=which(time))
    drawn = plots.line(plan, of, "y", plots.colour(0))
    plan.scatter([0.0], [0.0], marker="triangle", size=11, color=plots.ORANGE)
    plots.names(plan, 0.0, 0.0, ["radar"])
    plots.hover_text(plan, [drawn], ("time", "@time{0.0} s"), ("east", "@x{0.00} km"), ("north", "@y{0.00} km"))
    marks = []
    for i, (path, text) in enumerate((("", "exact"), ("_literal", "the paper's (14)"))):
        values = 1e3 * which(result[f"/truth/azimuth_acceleration{path}"])
        marks.append(plots.line(below, plots.source(x=which(time), y=values), "y", plots.colour(i), name=text))
    plots.extend_y_axis(below, [np.array([azimuth.shown_acceleration(result)]) / 1.08], symmetric=True)
    plots.hover_text(below, marks, ("", "$name"), ("time", "@x{0.0} s"), ("", "@y{0.000}"))
    caption = "The circuit seen from above, and what drives the azimuth." + which.caption()
    keys = [Key("exact", plots.colour(0)), Key("the paper's (14)", plots.colour(1))]
    return Drawing(f"accelerations{anchor}", f"Accelerations{called}", [plan, below], caption, keys)


def _where(result: Result, anchor: str, called: str) -> Drawing:
    both = [result[name] for name in ("/map/ratio", "/map/ratio_by_latency")]
    mapper = plots.colour_map(min(float(each.min()) for each in both), max(float(each.max()) for each in both))
    rows = [f"{x:g}" for x in result["/map/scan_period"]]
    panels = []
    for values, across, label in zip(both, (result["/map/azimuth_sigma"], result["/map/report_age"]),
                                     ("σ of azimuth, deg", "age of reports, s"), strict=True):  # fmt: skip
        columns = [f"{x:g}" for x in across]
        on = plots.plot("", label, "scan period, s", 370, x_range=FactorRange(*columns), y_range=FactorRange(*rows))
        drawn = plots.cells(on, rows, columns, values, "{:.2f}", mapper)
        plots.hover_text(on, [drawn], (label, "@x"), ("scan period", "@y s"), ("Singer / L4", "@value{0.000}"))
        plots.bar(on, mapper, "RMSE of Singer over that of L4")
        panels.append(on)
    low, high = azimuth.CLAIM
    caption = (
        f"RMSE of Singer over that of L4, each with its best tuning, in the manoeuvre; above 1 load factors (L4) help. "
        f"The paper claims {low:g} to {high:g}."
    )
    return Drawing(f"map{anchor}", f"Where it pays{called}", panels, caption)


def elevations(results: Sequence[Named]) -> list[Drawing]:
    """Figures of the MLS elevation: the angle over the approach, the proof with its band, the nominal run."""
    out = []
    for k, (_, result) in enumerate(results):
        anchor, called = _several(results, k)
        out += [_approach(result, anchor, called), _proof(result, anchor, called), _nominal(result, anchor, called)]
        if "/order/filter" in result:
            out += [
                _curves(elevation.order_curves(result), elevation.ORDER_TITLES, f"orders{anchor}",
                        f"First-order filters{called}"),
                _curves(elevation.channel_curves(result), elevation.CHANNEL_TITLES, f"channels{anchor}",
                        f"Azimuth and flare{called}"),
            ]  # fmt: skip
    return out


def _approach(result: Result, anchor: str, called: str) -> Drawing:
    time = result["/approach/time"]
    which = plots.thin(time.size, 1000)
    panels: list[figure] = []
    for name, label in (("beta", "β, deg"), ("beta_rate", "β', deg/s"), ("beta_acceleration", "β'', deg/s²")):
        on = plots.plot("", "time, s", label, 230)
        on.x_range = panels[0].x_range if panels else on.x_range
        drawn = plots.line(on, plots.source(x=which(time), y=which(result[f"/approach/{name}"])), "y", plots.colour(0))
        for edge in result["/approach/segment_start"][1:]:
            plots.vertical_line(on, float(edge))
        plots.hover_text(on, [drawn], ("time", "@x{0.0} s"), (label, "@y{0.00000}"))
        panels.append(on)
    segments = ", ".join(map(str, result["/approach/segment"]))
    caption = f"The angle over the approach and its derivatives; segments: {segments}."
    return Drawing(f"approach{anchor}", f"The approach{called}", panels, caption + which.caption(), columns=3)


def _proof(result: Result, anchor: str, called: str) -> Drawing:
    share = elevation.half_width(result)
    time = result["/step"] * float(result.variables["/step"].attributes["period_s"])
    panels: list[figure] = []
    for i, label in enumerate(("σ of β, deg", "σ of β', deg/s")):
        theory = np.sqrt(result["/filter/covariance"][:, i, i])
        sample = np.sqrt(result["/montecarlo/covariance"][:, i, i])
        of = plots.source(x=time, theory=theory, sample=sample, low=(1.0 - share) * theory, high=(1.0 + share) * theory)
        on = plots.plot("", "time, s", label, 260)
        on.x_range = panels[0].x_range if panels else on.x_range
        plots.band(on, of, "low", "high", plots.colour(1))
        marks = [plots.line(on, of, "theory", plots.colour(1)), plots.line(on, of, "sample", plots.colour(0))]
        plots.extend_y_axis(on, [np.array([2.0 * theory[-1]])])
        plots.hover_text(
            on, marks[1:], ("time", "@x{0.00} s"), ("runs", "@sample{0.00000}"), ("filter", "@theory{0.00000}")
        )
        panels.append(on)
    runs = int(result["/montecarlo/runs"])
    keys = [
        Key("filter", plots.colour(1)),
        Key(f"{runs} runs", plots.colour(0)),
        Key(f"±{100 * share:g} %", plots.colour(1), "band"),
    ]
    return Drawing(
        f"proof{anchor}", f"Proof by runs{called}", panels, "The first experiment and the filter's covariance.", keys
    )


def _nominal(result: Result, anchor: str, called: str) -> Drawing:
    time = result["/nominal/time"]
    late = elevation.judged(result)
    which = plots.thin(int(late.sum()), 800)
    panels = [
        plots.plot("Bias", "time of the approach, s", "10⁻³ deg", 260),
        plots.plot("RMSE", "time of the approach, s", "10⁻³ deg", 260),
    ]
    panels[1].x_range = panels[0].x_range
    marks: list[list[Any]] = [[], []]
    keys = []
    for i, q in enumerate(result["/nominal/rate_variance"]):
        bias = result["/nominal/bias"][i]
        for k, values in enumerate((bias, np.hypot(bias, result["/nominal/noise"][i]))):
            of = plots.source(x=which(time[late]), y=which(1e3 * values[late]))
            marks[k].append(plots.line(panels[k], of, "y", plots.colour(i), name=f"Q = {digits(q)}"))
        keys.append(Key(f"Q = {digits(q)} (deg/s)²", plots.colour(i)))
    for k, on in enumerate(panels):
        plots.hover_text(on, marks[k], ("", "$name"), ("time", "@x{0.0} s"), ("", "@y{0.000}"))
    panels[1].y_range.start = 0.0
    caption = (
        "The nominal approach after settling: what the model leaves, and that with the noise of the angles."
        + which.caption()
    )
    return Drawing(f"nominal{anchor}", f"Nominal approach{called}", panels, caption, keys)


def _curves(curves: Sequence[elevation.Curve], titles: tuple[str, str], anchor: str, title: str) -> Drawing:
    """Curves in two panels side by side."""
    panels, keys, thinned = [], [], []
    for panel, head in enumerate(titles):
        on = plots.plot(head, "time of the approach, s", "10⁻³ deg", 260)
        marks = []
        for i, curve in enumerate(c for c in curves if c.panel == panel):
            which = plots.thin(curve.time.size, 800)
            thinned.append(which)
            of = plots.source(x=which(curve.time), y=which(curve.values))
            marks.append(plots.line(on, of, "y", plots.colour(i), name=curve.name))
            key = Key(curve.name, plots.colour(i))
            keys += [key] if key not in keys else []
        plots.hover_text(on, marks, ("", "$name"), ("time", "@x{0.0} s"), ("", "@y{0.000}"))
        panels.append(on)
    caption = "On the nominal approach, after settling." + plots.most_thinned(thinned).caption()
    return Drawing(anchor, title, panels, caption, keys)
