"""Figures of a landing result, fit for a paper: labels, units, legible at column width.

Every figure function takes a result and returns a matplotlib Figure; `save` writes them all as PNG.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("MPLBACKEND", "Agg")

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from navsim.core.wgs84 import ecef_from_llh, heading_axes
from navsim.io.results import Result, ResultError, write_text
from navsim.report.figure_files import MARK, remove_former

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMN = 3.5
"""Width of a journal column, inches; two-column figures are twice that."""
_STYLE: Any = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.4,
    "lines.linewidth": 0.9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "savefig.dpi": 200,
}
_BLUE, _ORANGE, _GREEN, _GREY = "#0072B2", "#D55E00", "#009E73", "#777777"
COLOURS = (_BLUE, _ORANGE, _GREEN)
"""Told apart by the colour-blind."""


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    return Figure(figsize=(width, height), layout="constrained")


def _in_runway_axes(result: Result, llh: np.ndarray) -> np.ndarray:
    """Positions in the tangent plane of the threshold: along (positive beyond it), right, up, m."""
    threshold = result["/truth/threshold_llh"]
    heading = np.radians(_setting(result, "runway", "heading_deg"))
    offset = (ecef_from_llh(llh) - ecef_from_llh(threshold)) @ heading_axes(threshold, heading)
    return offset * np.array([1.0, 1.0, -1.0])


def _setting(result: Result, *keys: str) -> float:
    import yaml

    node = yaml.safe_load(str(result.attributes["scenario"]))
    for key in keys:
        node = node[key]
    return float(node)


def _touchdown(result: Result) -> float:
    names = list(result["/truth/event"])
    return float(result["/truth/event_time"][names.index("touchdown")]) if "touchdown" in names else np.nan


def track(result: Result) -> Figure:
    """Plan view with the pseudolites, and the height profile."""
    fig = new_figure(2 * COLUMN, 3.6)
    plan, profile = fig.subplots(2, 1, height_ratios=[3, 2])
    path = _in_runway_axes(result, result["/truth/position_llh"])
    length = _setting(result, "runway", "length_m")
    width = _setting(result, "runway", "width_m")
    plan.fill(
        [0, length, length, 0],
        [-width / 2, -width / 2, width / 2, width / 2],
        color=_GREY,
        lw=0,
        label="runway",
    )
    plan.plot([0, length], [0, 0], color=_GREY, lw=2.5, solid_capstyle="butt", alpha=0.6)
    plan.plot(path[:, 0], path[:, 1], color=_BLUE, label="aircraft")
    plan.plot(path[0, 0], path[0, 1], "o", color=_BLUE, ms=3)
    names = result["/pseudolites/name"]
    if names.size:
        ground = _in_runway_axes(result, result["/pseudolites/position_llh"])
        plan.plot(ground[:, 0], ground[:, 1], "^", color=_ORANGE, ms=5, label="pseudolites")
        for name, (x, y, _) in zip(names, ground, strict=True):
            plan.annotate(str(name), (x, y), xytext=(5, 3), textcoords="offset points", fontsize=7)
    plan.margins(0.06, 0.15)
    plan.set_xlabel("along the runway from the threshold, m")
    plan.set_ylabel("right of the axis, m")
    plan.legend(loc="best", ncols=3)

    profile.plot(path[:, 0], result["/truth/position_llh"][:, 2], color=_BLUE)
    for name, when in zip(result["/truth/event"], result["/truth/event_time"], strict=True):
        if name != "touchdown":
            continue
        at = np.interp(when, result["/truth/time"], path[:, 0])
        profile.axvline(at, color=_ORANGE, lw=0.8, ls="--")
        profile.annotate("touchdown", (at, 0.85), xycoords=("data", "axes fraction"), xytext=(4, 0),
                         textcoords="offset points", color=_ORANGE, fontsize=7)  # fmt: skip
    profile.set_xlabel("along the runway from the threshold, m")
    profile.set_ylabel("height, m")
    return fig


def sky(result: Result) -> Figure:
    """Directions to the used sources over the approach, pseudolites included."""
    fig = new_figure(COLUMN, 3.4)
    ax = fig.add_subplot(projection="polar")
    ax.set_theta_zero_location("N")  # type: ignore[attr-defined]
    ax.set_theta_direction(-1)  # type: ignore[attr-defined]
    los = result["/geometry/line_of_sight"]
    ground = set(result["/pseudolites/name"])
    lowest = 0.0
    for i, name in enumerate(result["/geometry/source"]):
        seen = los[np.isfinite(los[:, i, 0]), i]
        if not seen.size:
            continue
        azimuth = np.arctan2(seen[:, 0], seen[:, 1])
        zenith = 90.0 - np.degrees(np.arcsin(seen[:, 2]))
        lowest = max(lowest, zenith.max())
        mark = {"color": _ORANGE, "marker": "^"} if name in ground else {"color": _BLUE, "marker": "o"}
        ax.plot(azimuth, zenith, color=mark["color"], lw=1.0)
        ax.plot(azimuth[-1:], zenith[-1:], ms=4, ls="", **mark)  # type: ignore[arg-type]
        ax.annotate(str(name), (azimuth[-1], zenith[-1]), xytext=(4, 3), textcoords="offset points", fontsize=7)
    edge = 90.0 if lowest <= 90.0 else 10.0 * np.ceil(lowest / 10.0)
    ax.set_ylim(0, edge)
    ax.set_yticks([30, 60, 90], ["60°", "30°", "0°"])
    ax.set_xticks(np.radians(np.arange(0, 360, 45)), ["N", "45°", "E", "135°", "S", "225°", "W", "315°"])
    ax.set_title("elevation; ends mark the last epoch; triangles: pseudolites")
    return fig


def dop(result: Result) -> Figure:
    """DOPs over time."""
    fig = new_figure(COLUMN, 2.4)
    ax = fig.subplots()
    t = result["/geometry/time"]
    for name, colour in (("pdop", _BLUE), ("vdop", _ORANGE), ("hdop", _GREEN)):
        ax.plot(t, result[f"/geometry/{name}"], color=colour, label=name.upper())
    ax.axvline(_touchdown(result), color=_GREY, lw=0.8, ls="--", label="touchdown")
    ax.set_ylim(bottom=0)
    ax.set_xlabel("time, s")
    ax.set_ylabel("DOP")
    ax.legend(ncols=2)
    return fig


def _fix_errors(result: Result) -> np.ndarray:
    """Fix minus true antenna position, NED, m: (run * e, 3). The truth is interpolated to the epochs."""
    t = result["/truth/time"]
    llh = result["/truth/position_llh"]
    when = result["/receiver/time"]
    truth = np.stack([np.interp(when, t, llh[:, i]) for i in range(3)], axis=1)
    scale = np.array([6.378e6, 6.378e6 * np.cos(llh[0, 0]), -1.0])
    fixes = result["/receiver/position_llh"]
    difference = (fixes - truth) * scale
    return difference.reshape(-1, 3)


def fixes(result: Result) -> Figure:
    """Scatter of the fixes about the truth, with the 95 % ellipse of the mean predicted covariance."""
    fig = new_figure(COLUMN, 3.0)
    ax = fig.subplots()
    error = _fix_errors(result)
    error = error[np.isfinite(error[:, 0])]
    covariance = result["/receiver/covariance_enu"][:, :2, :2]
    if error.size:
        shown = error[:: max(1, len(error) // 5000)]
        ax.plot(shown[:, 1], shown[:, 0], ".", ms=2, color=_BLUE, alpha=0.5, label="fixes")
        mean = np.nanmean(covariance, axis=0)
        angle = np.linspace(0, 2 * np.pi, 181)
        circle = np.sqrt(5.991) * np.stack([np.cos(angle), np.sin(angle)])
        ellipse = np.linalg.cholesky(mean) @ circle
        ax.plot(*ellipse, color=_ORANGE, label="95 % of predicted covariance")
        ax.legend(loc="upper right")
    else:
        ax.text(0.5, 0.5, "no fixes", transform=ax.transAxes, ha="center")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east error of fixes, m")
    ax.set_ylabel("north error of fixes, m")
    return fig


_ROWS: tuple[tuple[str, float], ...] = (
    ("position, m", 1.0),
    ("velocity, m/s", 1.0),
    ("attitude, deg", 180.0 / np.pi),
    ("gyro bias, deg/h", 180.0 / np.pi * 3600.0),
    ("accel. bias, mg", 1e3 / 9.80665),
)


def errors(result: Result) -> Figure:
    """The fifteen errors of the first run with their 3 sigma bounds."""
    fig = new_figure(2 * COLUMN, 6.2)
    axes = fig.subplots(5, 3, sharex=True)
    t = result["/filter/time"]
    error, sigma = result["/filter/error"][0], result["/filter/sigma"][0]
    columns = ("north", "east", "down")
    for row, (label, scale) in enumerate(_ROWS):
        for column in range(3):
            ax: Axes = axes[row, column]
            i = 3 * row + column
            bound = 3 * sigma[:, i] * scale
            ax.fill_between(t, -bound, bound, color=_ORANGE, alpha=0.2, lw=0)
            ax.plot(t, error[:, i] * scale, color=_BLUE, lw=0.7)
            # the first seconds would dwarf the rest
            settled = bound[t >= t[0] + 0.1 * (t[-1] - t[0])]
            reach = 1.6 * max(settled.max(), np.abs(error[t >= 0.1 * t[-1], i] * scale).max())
            if reach > 0:
                ax.set_ylim(-reach, reach)
            if column == 0:
                ax.set_ylabel(label)
            if row == 0:
                ax.set_title(columns[column])
            if row == 3:
                ax.set_title("xyz"[column])
            if row == 4:
                ax.set_xlabel("time, s")
    fig.align_ylabels(axes[:, 0])
    fig.suptitle("error (truth - estimate) and ±3σ of the filter", fontsize=8)
    return fig


def budget(result: Result) -> Figure:
    """True root mean square error against the filter's belief, and what each source contributes."""
    fig = new_figure(2 * COLUMN, 4.4)
    axes = fig.subplots(2, 2, sharex=True)
    t = result["/covariance/time"]
    after = t >= t[0] + 0.05 * (t[-1] - t[0])
    names = [str(n).replace("_", " ") for n in result["/budget/source"]]
    square = result["/budget/rms"] ** 2
    for column, (title, states) in enumerate((("horizontal position", [0, 1]), ("vertical position", [2]))):
        upper, lower = axes[0, column], axes[1, column]
        true = np.sqrt((result["/covariance/rms"][:, states] ** 2).sum(axis=1))
        believed = np.sqrt((result["/filter/sigma"][0][:, states] ** 2).sum(axis=1))
        upper.plot(t, true, color=_BLUE, label="true RMS")
        upper.plot(t, believed, color=_ORANGE, ls="--", label="the filter's σ")
        upper.set_ylim(0, 1.15 * max(true[after].max(), believed[after].max()))
        upper.set_title(title)
        share = square[:, :, states].sum(axis=2)
        share = 100.0 * share / np.maximum(share.sum(axis=0), np.finfo(float).tiny)
        shown = np.flatnonzero(share[:, after].max(axis=1) > 1.0)
        colours = mpl.colormaps["tab20"](shown)
        lower.stackplot(t, share[shown], labels=[names[i] for i in shown], colors=colours, lw=0)
        lower.set_ylim(0, 100)
        lower.set_xlim(t[0], t[-1])
        lower.set_xlabel("time, s")
        lower.legend(fontsize=5.5, loc="lower left", frameon=True, framealpha=0.85)
    axes[0, 0].set_ylabel("error, m")
    axes[0, 0].legend()
    axes[1, 0].set_ylabel("share of mean square, %")
    return fig


def nees(result: Result) -> Figure:
    """NEES per degree of freedom over time with its 95 % band; NIS below it."""
    fig = new_figure(COLUMN, 2.8)
    upper, lower = fig.subplots(2, 1, sharex=True)
    t = result["/summary/consistency/time"]
    for name, colour, label in (
        ("nees", _BLUE, "NEES/15"),
        ("nees_position_velocity", _GREEN, "NEES/6 (pos., vel.)"),
        ("nis", _ORANGE, "NIS/m"),
    ):
        ax = lower if name == "nis" else upper
        variable = result.variables[f"/summary/consistency/{name}"]
        values = np.asarray(variable.data)
        style = {"ls": "", "marker": ".", "ms": 1.5} if name == "nis" else {}
        ax.plot(t, values, color=colour, label=label, **style)
        if name != "nees_position_velocity" and "band_low" in variable.attributes:
            ax.axhspan(
                variable.attributes["band_low"],
                variable.attributes["band_high"],
                color=colour,
                alpha=0.12,
                lw=0,
            )
    for ax in (upper, lower):
        ax.axhline(1.0, color=_GREY, lw=0.6)
        ax.set_ylim(bottom=0)
        ax.legend(loc="upper right", ncols=2)
    lower.set_xlabel("time, s")
    runs = int(result["/summary/count/runs"])
    upper.set_title(f"mean of {runs} run(s); shaded: 95 % band of 15 states and of NIS" if runs else "expected, linear")
    return fig


_SUMMARY_FIGURES: dict[str, Callable[[Result], Figure]] = {
    "track": track,
    "sky": sky,
    "dop": dop,
    "nees": nees,
}
_FIGURES_OF: dict[str, tuple[str, Callable[[Result], Figure]]] = {
    "fixes": ("/receiver/position_llh", fixes),
    "errors": ("/filter/error", errors),
    "budget": ("/budget/rms", budget),
}
"""Figures that need a variable not every result has."""


def landing(result: Result) -> dict[str, Figure]:
    """Every figure a landing has data for, by name."""
    chosen = _SUMMARY_FIGURES | {name: draw for name, (needed, draw) in _FIGURES_OF.items() if needed in result}
    return {name: draw(result) for name, draw in chosen.items()}


def save_figures(draw: Callable[[], dict[str, Figure]], folder: Path, stem: str) -> list[Path]:
    """Draw figures in the common style and write them as `folder/stem_NAME.png`, in place of all that an earlier
    result of this stem left there. Raises ResultError."""
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context(_STYLE):
            for name, figure in draw().items():
                target = folder / f"{stem}_{name}.png"
                figure.savefig(target, metadata={MARK: stem})
                written.append(target)
    except OSError as error:
        raise ResultError(f"{folder}: figures cannot be written there: {error.strerror or error}") from None
    remove_former(folder, stem, written)
    return written


def save_text(path: Path, text: str) -> Path:
    """Write a text file whole or not at all, with its folder. Raises ResultError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(f"{path}: cannot be written: {error.strerror or error}") from None
    write_text(path, text)
    return path
