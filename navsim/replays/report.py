"""A replayed flight: its tables and figures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.geodesy import earth
from navsim.report.table import Cell, Table, cell, interval, number, numbers
from navsim.report.view import View, one_by_one
from navsim.results.findings import several
from navsim.results.result import Result, scenario_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN_UNITS = {"rad/sqrt(s)": ("°/√h", math.radians(1.0 / 60.0)), "m/s/sqrt(s)": ("m/s/√h", 1.0 / 60.0),
               "rad": ("°", math.radians(1.0))}  # fmt: skip
"""Units of tuned values on screen, those of data sheets and of the log's keys, and their size in SI."""
REJECTED = 2
"""Status of a fix or range that the gate rejected, in `/innovations`."""


def tables(result: Result) -> list[Table | str]:
    """Innovations, what was tuned, drift without fixes."""
    seen = Table("Innovations, rms", ("fixes", "position N E D, m", "velocity N E D, m/s", "NIS per degree"))
    away = rejected(result)
    for i, name in enumerate(result["/summary/motion"][:2]):
        position, velocity = (result[f"/summary/innovation_{part}"][i] for part in ("position", "velocity"))
        without = str(name) if not away.any() else f"accepted{'' if name == 'all' else f', {name}'}"
        seen.add(without, *_innovation_cells(position, velocity, float(result["/summary/nis"][i])))
    if away.any() and "/innovations/range_status" not in result:  # NIS of ranges is without rejected ones
        seen.add("all, with rejected", *_innovation_cells(*_of_all_fixes(result)))
    evidence = _evidence(result)
    tuned = Table("Noise and latency", ("what", "value", "unit", "from"))
    for path, variable in sorted(result.variables.items()):
        if path.startswith("/tuning/"):
            unit, size = SHOWN_UNITS.get(variable.units, (variable.units, 1.0))
            origin = str(variable.attributes["origin"])
            shown = "{:.2g}" if "determined" in origin else "{:.3g}"
            tuned.add(variable.long_name, cell(shown, float(np.asarray(variable.data)) / size), unit, origin)
    alignment = result.attributes
    sigma = np.asarray(alignment["alignment_sigma_deg"])
    begin, until = float(alignment["alignment_time"]), float(alignment["alignment_until"])
    counts = {n: int(result[f"/summary/count/{n}"]) for n in ("samples", "fixes", "rejected", "gaps")}
    known = (scenario_of(result).get("alignment") or {}).get("known")
    start = "aligned at {:.2f} s with data up to {:.2f} s" if known is None else "known at {:.2f} s"
    text = (
        f"{start.format(begin, until)}: 1 sigma of tilt {max(sigma[:2]):.1f}, of heading "
        f"{sigma[2]:.1f} degrees; {several(counts['samples'], 'sample')}, {several(counts['fixes'], 'fix')}, "
        f"{counts['rejected']} rejected, {several(counts['gaps'], 'gap')}"
    )
    if "flown_s" in alignment:  # results of earlier versions lack it
        spans = ("{:.1f} to {:.1f} s".format(*np.asarray(alignment[name])) for name in ("flown_s", "recorded_s"))
        text += "; used " + " of the recording's ".join(spans)
    rest = [*_compared(result), *_unusable(result), *_unchecked(result)]
    every: list[Table | str] = [_accuracy(result), seen, *evidence, *_aids(result), tuned, *rest]
    every += _predicted(result)
    if not result["/outages/start"].size:
        return [*every, text]
    lost = Table("Horizontal drift without fixes, m", ("length, s", "outages", "median", "largest", "NEES"))
    length = result["/outages/end"] - result["/outages/start"]
    for i, duration in enumerate(result["/summary/duration"]):
        known = np.isfinite(result["/outages/horizontal_error"][np.abs(length - duration) < 1e-6])
        drift = [number(result[f"/summary/drift_{name}"][i], 1) for name in ("median", "max")]
        nees = result["/summary/drift_nees"][i] if "/summary/drift_nees" in result else math.nan
        lost.add(cell("{:g}", float(duration)), cell("{}", int(known.sum())), *drift, number(nees, 2))
    return [*every, lost, text]


def _accuracy(result: Result) -> Table:
    """RMS of the filter's 1 sigma over all outputs that are usable."""
    heads = "position N E D, m", "velocity N E D, m/s", "attitude about N E D, °"
    out = Table("1 sigma of the estimate, rms along the flight", heads)
    time = result["/filter/time"]
    is_usable = np.ones(time.size, bool)
    for begin, end in lost_spans(result):
        is_usable &= (time < begin) | (time > end)
    usable = result["/filter/sigma"][is_usable, :9]
    sigma = np.sqrt(np.mean(usable**2, axis=0)) if usable.size else np.full(9, np.nan)
    parts = (sigma[:3], 2), (sigma[3:6], 3), (np.degrees(sigma[6:]), 2)
    out.add(*(numbers(part, count, ("north", "east", "down")) for part, count in parts))
    return out


def _unchecked(result: Result) -> list[Table]:
    """Mistakes that the recording cannot reveal, and why."""
    out = Table("Not checked", ("mistake", "because"))
    for item in filter(None, str(result.attributes.get("not_judged", "")).split("; ")):
        mistake, _, reason = item.partition(": ")
        out.add(mistake, reason)
    return [out] if out.rows else []


def _evidence(result: Result) -> list[Table]:
    """Innovations over their sigmas by motion and by quantity, where 1 is due; their autocorrelation, where 0 is."""
    if "/summary/nis_position" not in result:  # results of earlier versions lack it
        return []
    out = Table("NIS by motion", ("motion", "fixes", "all", "position", "velocity"))
    for i, name in enumerate(result["/summary/motion"]):
        if np.isfinite(result["/summary/nis"][i]):
            counted = "/summary/motion_fixes" in result  # results of earlier versions lack it
            fixes = cell("{}", int(result["/summary/motion_fixes"][i])) if counted else ""
            nis = (number(result[f"/summary/nis{of}"][i], 2) for of in ("", "_position", "_velocity"))
            out.add(str(name), fixes, *nis)
    lags = (number(float(result[f"/summary/lag1_{of}"]), 2) for of in ("position", "velocity"))
    out.add("lag-1 autocorrelation, moving", "", "", *lags)
    return [out]


def _predicted(result: Result) -> list[Table | str]:
    """Predicted bands and the shares of later values within them, if there was a prediction."""
    if "/summary/quantity" not in result:
        return []
    until = result.variables["/summary/bet_until"]
    out = Table(
        f"Predicted from the part up to {float(np.asarray(until.data)):.12g} s, and what followed",
        ("in motion", "values", "independent", "50 % within", "were, %", "95 % within", "were, %", "verdict"),
    )
    for i, name in enumerate(result["/summary/quantity"]):
        shares: list[Cell] = []
        for percent in (50, 95):
            band, *share = (float(result[f"/summary/bet_{of}_{percent}"][i]) for of in ("band", "share", "low", "high"))
            shares += [cell("{:.3g}", band), interval(share, 0, 100.0)]
        counts = result["/summary/bet_values"][i], result["/summary/bet_independent"][i]
        verdict = str(result["/summary/bet_verdict"][i]) if "/summary/bet_verdict" in result else ""  # earlier results
        out.add(str(name), cell("{}", int(counts[0])), number(counts[1], 0), *shares, verdict)
    return [out, f"SHA-256 of the prediction: {until.attributes['sha256']}"]


def _aids(result: Result) -> list[Table]:
    """Further measurements, if there are any."""
    if "/summary/aid" not in result:
        return []
    motion = [str(name) for name in result["/summary/motion"]]
    out = Table("Further measurements", ("what", "used", "rejected", *(f"NIS, {name}" for name in motion)))
    for i, name in enumerate(result["/summary/aid"]):
        counts = (cell("{}", int(result[f"/summary/aid_{which}"][i])) for which in ("used", "rejected"))
        out.add(str(name), *counts, *(number(float(nis), 2) for nis in result["/summary/aid_nis"][i]))
    if "/clock" in result:
        return [out, _clocks(result)]
    if "/summary/beacon" not in result:
        return [out]
    biases = Table("Biases of the ranges at the end, m", ("beacon", "bias", "sigma"))
    for name, *value in zip(*(result[f"/summary/beacon{of}"] for of in ("", "_bias", "_bias_sigma")), strict=True):
        biases.add(str(name), *(number(float(x), 3) for x in value))
    return [out, biases]


def _clocks(result: Result) -> Table:
    """Clocks of one-way ranges at the end."""
    datum = result.variables["/clock"].attributes["datum"]
    out = Table(f"Clocks of the ranges against {datum} at the end", ("clock", "offset, m", "±", "rate, m/s", "±"))
    columns = [result[f"/summary/clock_{name}"] for name in ("offset", "offset_sigma", "rate", "rate_sigma")]
    for name, *values in zip(result["/clock"], *columns, strict=True):
        out.add(str(name), *(number(float(x), digits) for x, digits in zip(values, (2, 2, 4, 4), strict=True)))
    return out


def _compared(result: Result) -> list[Table]:
    """The attitude minus that of another system, if there is one."""
    if "/filter/reference_attitude_rpy" not in result:
        return []
    out = Table("Attitude minus the reference's, degrees", ("", "roll", "pitch", "yaw"))
    for name, words in (("mean", "mean"), ("scatter", "rms about the mean")):
        out.add(words, *(number(float(x), 2) for x in np.degrees(result[f"/summary/attitude_difference_{name}"])))
    return [out]


def _innovation_cells(position: np.ndarray, velocity: np.ndarray, nis: float) -> tuple[Cell, Cell, Cell]:
    """Cells of RMS innovations, position (3,), m, and velocity (3,), m/s, and of their NIS per degree of freedom."""
    axes = ("north", "east", "down")
    return numbers(position, 2, axes), numbers(velocity, 3, axes), number(nis, 2)


def _of_all_fixes(result: Result) -> tuple[np.ndarray, np.ndarray, float]:
    """RMS innovations (3,), position and velocity, and NIS per degree of freedom, of fixes whether rejected or not."""
    degrees, squared = result["/innovations/degrees"], result["/innovations/normalized_squared"]
    known = (degrees > 0) & np.isfinite(squared)
    nis = float(squared[known].sum() / degrees[known].sum()) if known.any() else math.nan
    rms = []
    for part in ("position", "velocity"):
        seen = np.ma.masked_invalid(result[f"/innovations/{part}_ned"])
        rms.append(np.sqrt(np.ma.mean(seen**2, axis=0)).filled(np.nan))
    return rms[0], rms[1], nis


def _unusable(result: Result) -> list[Table]:
    """The times at which the output is unusable, if there are any."""
    if not lost_spans(result).size:
        return []
    out = Table("Unusable output", ("from, s", "to, s", "why"))
    for begin, end, why in zip(*(result[f"/lost/{name}"] for name in ("start", "end", "cause")), strict=True):
        out.add(number(begin, 1), number(end, 1), str(why))
    return [out]


def rejected(result: Result) -> np.ndarray:
    """Which fixes (m,) the gate rejected, or ranges of their epochs."""
    if "/innovations/range_status" in result:
        return (result["/innovations/range_status"] == REJECTED).any(axis=1)
    return result["/innovations/status"] == REJECTED


def east_north(origin: np.ndarray, llh: np.ndarray) -> np.ndarray:
    """East and north of positions (n, 3) from an origin, m."""
    ned = (earth.ecef_from_llh(llh) - earth.ecef_from_llh(origin)) @ earth.ned_matrix(origin).T
    return ned[:, [1, 0]]


def _track(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, abreast, new_figure

    fig = new_figure(2 * COLUMN, 3.6)
    plan, profile = abreast(fig, 2, width_ratios=[3, 2])
    llh, fixes = result["/filter/position_llh"], result["/receiver/position_llh"]
    dots: dict[str, Any] = {"ls": "", "marker": ".", "ms": 2, "color": COLOURS[1], "label": "fixes (antenna)"}
    plan.plot(*east_north(llh[0], fixes).T, **dots)
    hole = after_hole(result, result["/filter/time"])[:, None]
    plan.plot(*np.where(hole, np.nan, east_north(llh[0], llh)).T, color=COLOURS[0], label="estimate (IMU)")
    away = rejected(result)
    crosses: dict[str, Any] = {"ls": "", "marker": "x", "ms": 4, "color": COLOURS[3], "label": "rejected fixes"}
    if away.any():
        plan.plot(*east_north(llh[0], fixes[away]).T, **crosses)
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel("east, m")
    plan.set_ylabel("north, m")
    legend_above(fig, plan, 3 if away.any() else 2)
    if away.any():
        profile.plot(result["/receiver/time"][away], fixes[away, 2], **crosses)
    profile.plot(result["/receiver/time"], fixes[:, 2], ".", ms=2, color=COLOURS[1])
    profile.plot(result["/filter/time"], np.where(hole[:, 0], np.nan, llh[:, 2]), color=COLOURS[0])
    _shade_lost(profile, result)
    profile.set_xlabel("time, s")
    profile.set_ylabel("height above the ellipsoid, m")
    return fig


def _innovations(result: Result) -> Figure:
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(2 * COLUMN, 4.4)
    axes = fig.subplots(3, 2, sharex=True)
    time = result["/innovations/time"]
    for column, (name, unit) in enumerate((("position_ned", "m"), ("velocity_ned", "m/s"))):
        for row, axis in enumerate(("north", "east", "down")):
            ax = axes[row, column]
            sigma = 3.0 * result[f"/innovations/{name}_sigma"][:, row]
            ax.fill_between(time, -sigma, sigma, color=COLOURS[1], alpha=0.2, lw=0, label="±3σ")
            ax.plot(time, result[f"/innovations/{name}"][:, row], color=COLOURS[0], lw=0.6, label="innovation")
            ax.set_ylabel(f"{axis}, {unit}")
            # a few wild fixes must not flatten the rest
            seen = np.abs(result[f"/innovations/{name}"][:, row])
            if np.isfinite(seen).any():
                limit = max(float(np.nanpercentile(seen, 98)), float(np.nanmedian(sigma)))
                ax.set_ylim(-1.3 * limit, 1.3 * limit)
            # at the edge if they are beyond it
            away = rejected(result)
            low, high = ax.get_ylim()
            if away.any():
                shown = np.clip(result[f"/innovations/{name}"][away, row], 0.95 * low, 0.95 * high)
                ax.plot(time[away], shown, ls="", marker="x", ms=4, color=COLOURS[3], label="rejected")
            _shade_lost(ax, result)
    axes[0, 0].set_title("position")
    axes[0, 1].set_title("velocity")
    legend_above(fig, axes[2, 0], 2 + int(rejected(result).any()) + int(lost_spans(result).size > 0))
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    fig.align_ylabels(axes)
    return fig


def lost_spans(result: Result) -> np.ndarray:
    """Begin and end (k, 2), s, of the times at which the output is unusable."""
    if "/lost/start" not in result:  # results of earlier versions lack it
        return np.empty((0, 2))
    return np.stack([result["/lost/start"], result["/lost/end"]], axis=1)


def after_hole(result: Result, time: np.ndarray) -> np.ndarray:
    """Which outputs at times (t,), s, are the first after a time without output: no line leads to them."""
    out = np.full(time.size, False)
    for begin, end in lost_spans(result):
        k = int(np.searchsorted(time, end - 1e-6))
        if 0 < k < time.size:
            out[k] = time[k - 1] <= begin + 1e-6
    return out


def _shade_lost(ax: Axes, result: Result) -> None:
    """Shade the times at which the output is unusable."""
    for k, (begin, end) in enumerate(lost_spans(result)):
        ax.axvspan(begin, end, color="0.85", lw=0, zorder=0, label="" if k else "output unusable")


def _attitude(result: Result) -> Figure:
    from navsim.report.figures import legend_over
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    fig = new_figure(2 * COLUMN, 4.6)
    axes = fig.subplots(3, 2, sharex=True)
    time, rpy = result["/filter/time"], np.degrees(result["/filter/attitude_rpy"])
    jump = np.abs(np.diff(rpy, axis=0, prepend=rpy[:1])) > 180.0
    hole = after_hole(result, time)[:, None]
    rpy = np.where(jump | hole, np.nan, rpy)
    sigma = np.where(hole, np.nan, np.degrees(result["/filter/sigma"][:, 6:9]))
    for row, name in enumerate(("roll", "pitch", "yaw")):
        if "/filter/reference_attitude_rpy" in result:
            theirs = np.degrees(result["/filter/reference_attitude_rpy"][:, row])
            theirs[np.abs(np.diff(theirs, prepend=theirs[:1])) > 180.0] = np.nan
            axes[row, 0].plot(time, theirs, color=COLOURS[1], label="reference")
        axes[row, 0].plot(time, rpy[:, row], color=COLOURS[0], label="estimate")
        axes[row, 0].set_ylabel(f"{name}, deg")
    if "/filter/reference_attitude_rpy" in result:
        legend_over(axes[0, 0], 2)
    axes[0, 1].plot(time, sigma[:, :2].max(axis=1), color=COLOURS[0], label="tilt")
    axes[0, 1].plot(time, sigma[:, 2], color=COLOURS[1], label="heading")
    axes[0, 1].set_ylabel("1σ, deg")
    axes[0, 1].set_yscale("log")
    legend_over(axes[0, 1], 2)
    gyro, accelerometer = (np.where(hole, np.nan, result[f"/filter/{of}_bias"]) for of in ("gyro", "accelerometer"))
    for i, axis in enumerate("xyz"):
        axes[1, 1].plot(time, np.degrees(gyro[:, i]), color=COLOURS[i], label=axis)
        axes[2, 1].plot(time, accelerometer[:, i], color=COLOURS[i])
    axes[1, 1].set_ylabel("gyro bias, deg/s")
    legend_over(axes[1, 1], 3)
    axes[2, 1].set_ylabel("accel. bias, m/s²")
    for ax in axes.flat:
        _shade_lost(ax, result)
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    fig.align_ylabels(axes)
    return fig


def drifts(result: Result) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """For each length of outages, s: their horizontal drifts in order, m, and the cumulative fraction of outages."""
    length = np.round(result["/outages/end"] - result["/outages/start"], 6)
    out = []
    for duration in map(float, result["/summary/duration"]):
        drift = np.sort(result["/outages/horizontal_error"][length == np.round(duration, 6)])
        drift = drift[np.isfinite(drift)]
        out.append((duration, drift, (np.arange(drift.size) + 0.5) / max(drift.size, 1)))
    return out


def _outages(result: Result) -> Figure:
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    from navsim.report.figures import legend_above
    from navsim.report.printing import COLUMN, new_figure, style

    fig = new_figure(COLUMN, 2.8)
    ax = fig.subplots()
    for i, (duration, drift, share) in enumerate(drifts(result)):
        ax.plot(drift, share, marker="o", ms=3, **style(i), label=f"{duration:g} s without fixes")
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(ScalarFormatter())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("horizontal drift, m")
    ax.set_ylabel("cumulative share of outages")
    ax.set_ylim(0.0, 1.0)
    legend_above(fig, ax, 2)
    return fig


def figures(result: Result) -> dict[str, Figure]:
    """Track, innovations, attitude with its uncertainty and the biases, drift in outages."""
    drawn = {"track": _track(result), "innovations": _innovations(result), "attitude": _attitude(result)}
    if np.isfinite(result["/outages/horizontal_error"]).any():
        drawn["outages"] = _outages(result)
    return drawn


VIEW = View(one_by_one(tables), figures, ("/summary", "/tuning", "/outages"), drawings="navsim.replays.page:replays")
