"""Sweeps: the tidy table, the best combinations, heat maps on the runway plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.formats.ridges import WHOLE, varied
from navsim.formats.sweep_rows import VERDICT, dimensions, heads, key_path, keys, outputs, rows, setting
from navsim.formats.units import unit_of, without_unit
from navsim.report import table
from navsim.report.flown_requirements import flown_requirements, plain_requirements
from navsim.report.result_cells import setting as scenario_setting
from navsim.report.ridges import shown_ridges
from navsim.report.table import Cell, Table, as_text, cell
from navsim.report.view import View, one_by_one
from navsim.results.result import Result
from navsim.results.schema import LARGE, VERDICTS
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS = 4


def csv_text(result: Result) -> str:
    """One row a combination: the varied keys, then the outputs."""
    return table.csv_text(heads(result), (row for _, row in rows(result)))


def shown(result: Result) -> list[str]:
    """The outputs that are figures by themselves: neither ends of intervals nor verdicts."""
    return [name for name in outputs(result) if not name.endswith(("_low", "_high", VERDICT))]


def large(result: Result, name: str) -> bool:
    """Whether an output is the better the larger it is."""
    return name in LARGE or bool(result.variables[f"/sweep/{name}"].attributes.get("least", 0))


def best(cube: np.ndarray, large: bool) -> tuple[int, ...] | None:
    """Combination of the smallest value, or of the largest; None without any."""
    known = np.isfinite(cube)
    if not np.any(known):
        return None
    ranked = np.where(known, -cube if large else cube, np.inf)
    return tuple(int(i) for i in np.unravel_index(int(np.argmin(ranked)), cube.shape))


def choice(result: Result, name: str) -> np.ndarray:
    """The values of an output that the best is chosen among: where runs spoke against combinations, without those, and
    without all that are better than the one that was recommended."""
    cube, path = result[f"/sweep/{name}"], f"/flown/{name}_combination"
    if path not in result:
        return cube
    return np.where(cube < cube.flat[int(result[path])], np.nan, cube)


_ALIKE = 1e-9
"""Values that differ by no more, relative, are as good as each other: rounding leaves less."""


def alike(cube: np.ndarray, index: tuple[int, ...]) -> np.ndarray:
    """Which combinations are as good as one of them; a flag each."""
    return np.isclose(cube, cube[index], rtol=_ALIKE, atol=0.0)


def indifferent(tied: np.ndarray) -> tuple[bool, ...] | None:
    """Axes along which every point is as good as the best.

    None if the equally good combinations do not fill whole axes, so that naming one of them would be arbitrary.
    """
    members = [np.any(tied, axis=tuple(a for a in range(tied.ndim) if a != axis)) for axis in range(tied.ndim)]
    whole = tuple(bool(each.all() and each.size > 1) for each in members)
    alone = all(every or each.sum() == 1 for every, each in zip(whole, members, strict=True))
    # as many as their product are that product
    return whole if alone and tied.sum() == np.prod([each.sum() for each in members]) else None


def at_ends(result: Result, index: tuple[int, ...]) -> list[str]:
    """Varied keys for which a combination has the first or the last of three or more numbers.

    The optimum may be beyond them, where nothing was computed.
    """
    out = []
    for axis, name in enumerate(dimensions(result)):
        values = result[f"/{name}"]
        # an axis of several keys counts its points; its numbers have no order
        ordered = f"/sweep/axes/{name}" in result and values.dtype.kind in "fiu" and values.size > 2
        if ordered and index[axis] in (int(np.argmin(values)), int(np.argmax(values))):
            out.append(name)
    return out


def tables(result: Result) -> list[Table | str]:
    """The best combination for each output, with the range of values."""
    names = list(keys(result))
    combinations = int(result.attributes["combinations"])
    title = f"{combinations} combinations, method {result.attributes['method']}; the best for each output"
    dims, notes = dimensions(result), list[str]()
    columns = ("output", "smallest", "median", "largest", *(f"best {key_path(result, name)}" for name in names))
    out = Table(title, columns)
    for name in shown(result):
        cube, text = result[f"/sweep/{name}"], label(result, name)
        index = best(choice(result, name), large(result, name))
        if index is None:
            out.add(text, table.ABSENT, table.ABSENT, table.ABSENT)
            continue
        spread = [cell("{:.4g}", float(value)) for value in (np.nanmin(cube), np.nanmedian(cube), np.nanmax(cube))]
        tied = alike(cube, index)
        whole = indifferent(tied)
        ends = [] if whole is None else [key for key in at_ends(result, index) if not whole[dims.index(key)]]
        free = {key for key, axis in keys(result).items() if whole is not None and whole[dims.index(axis)]}
        if ends:
            notes.append("* the end of its range: the best may lie beyond")
        if whole is None:
            notes.append(f"{text}: {int(tied.sum())} combinations are equally good; this is the first one")
        places = (
            "any" if key in free else _place(setting(result, key, index), " *" if key in ends else "") for key in names
        )
        out.add(text, *spread, *places)
    out.notes = "\n".join(dict.fromkeys(notes))
    judged = requirements(result)
    return [out, *flown(result), *_flown_verdicts(result), *([] if judged is None else [judged])]


def flown(result: Result) -> list[Table | str]:
    """Results of runs of the best combinations, and of those that runs contradicted."""
    names = [name for name in shown(result) if f"/flown/{name}" in result]
    if not names:
        return []
    runs = int(result["/flown/runs"])
    out = Table(f"Runs of the best combinations ({runs} each)", ("output", "covariance analysis", "runs [95 %]"))
    for name in names:
        analysed = result[f"/sweep/{name}"].flat[int(result[f"/flown/{name}_combination"])]
        out.add(label(result, name), table.number(analysed, 4), table.interval(result[f"/flown/{name}"], 4))
    text = [(label(result, name), f"/flown/{name}_verdict") for name in names]
    out.notes = "\n".join(f"States, {whose}: {result[path]}" for whose, path in text if path in result)
    if "/rejected/rejected" not in result:
        return [out]
    keyed = list(keys(result))
    against = Table(
        "Rejected: runs contradict the covariance analysis",
        ("output", "covariance analysis", "runs [95 %]", *(key_path(result, key) for key in keyed)),
    )
    for i, name in enumerate(map(str, result["/rejected/output"])):
        index = np.unravel_index(int(result["/rejected/combination"][i]), result[f"/sweep/{name}"].shape)
        places = (_place(setting(result, key, tuple(map(int, index))), "") for key in keyed)
        both = table.number(result["/rejected/analysed"][i], 4), table.interval(result["/rejected/flown"][i], 4)
        against.add(label(result, name), *both, *places)
    return [out, against]


def _flown_verdicts(result: Result) -> list[Table | str]:
    if (path := "/flown/requirements/output") not in result:
        return []
    return flown_requirements(
        result, "Requirements of the best combinations", [label(result, str(name)) for name in result[path]]
    )


def requirements(result: Result) -> Table | None:
    """Number of combinations that meet each requirement; None if they are no output."""
    numbered = [name.removesuffix(VERDICT) for name in outputs(result) if name.endswith(VERDICT)]
    if not numbered:
        return None
    out = Table("Requirements, in how many combinations", ("output", "requirement", "limit", *VERDICTS[::-1]))
    every = np.full(result["/outcome/combination"].shape, True)
    for name in numbered:
        variable, verdict = result.variables[f"/sweep/{name}"], result[f"/sweep/{name}{VERDICT}"]
        every &= verdict == VERDICTS.index("met")
        statement = variable.long_name.removesuffix(": what was found")
        limit = cell("at least {:g}" if large(result, name) else "at most {:g}", float(variable.attributes["limit"]))
        found = [int(np.sum(verdict == code)) for code in reversed(range(len(VERDICTS)))]
        counts = [Cell("{}", (count,), trials=verdict.size, trial="combination") for count in found]
        out.add(name, statement, limit, *counts)
    out.notes = f"all of them together are met in {int(every.sum())} of {every.size}"
    return out


def _place(value: object, mark: str) -> Cell:
    """The value of a varied key, marked."""
    if isinstance(value, float | np.integer):
        return cell(f"{{:.10g}}{mark}", value.item() if isinstance(value, np.generic) else value)
    return cell(f"{{}}{mark}", as_text(value))


def best_plain(result: Result) -> dict[str, object]:
    """The best combination for each output as plain data."""
    out: dict[str, object] = {k: result.attributes[k] for k in ("method", "combinations", "refused")}
    out = {k: v if isinstance(v, str) else int(v) for k, v in out.items()}  # type: ignore[call-overload]
    for name in outputs(result):
        cube = result[f"/sweep/{name}"]
        if name.endswith(VERDICT):
            out[name] = {word: int(np.sum(cube == code)) for code, word in enumerate(VERDICTS)}
            continue
        index = best(choice(result, name), large(result, name))
        if index is not None:
            place = {key: np.asarray(setting(result, key, index)).item() for key in keys(result)}
            tied = alike(cube, index)
            ends = at_ends(result, index) if tied.sum() == 1 else []  # none of several is the best
            by_runs: dict[str, object] = {}
            if (path := f"/flown/{name}") in result:
                by_runs = {"flown": [float(x) for x in result[path]], "runs": int(result["/flown/runs"])}
                if (verdict := f"{path}_verdict") in result:
                    by_runs["verdict"] = str(result[verdict])
                if (judged := "/flown/requirements/output") in result:
                    by_runs |= plain_requirements(result, [str(each) for each in result[judged]].index(name))
            value = float(cube[index])
            out[name] = {"value": value, **by_runs, **place, "alike": int(tied.sum()), "at_end_of_range": ends}
    return out


def figures(result: Result) -> dict[str, Figure]:
    """A map of each output on the plan where two axes move pseudolites, a map over two axes of numbers, as latitude and
    longitude of a jammer, else curves along the longest numeric axis."""
    out = {}
    for name in shown(result):
        cube = result[f"/sweep/{name}"]
        if best(cube, large(result, name)) is None:
            continue
        moved = plane(result)
        if moved:
            out[name] = _map(result, name, cube, moved)
        else:
            both = grid(result)
            out[name] = _curves(result, name) if both is None else _over_two(result, name, both)
    return out


def plane(result: Result) -> tuple[int, int] | None:
    """The two axes along which the first pseudolite moves in the plane."""
    moving = []
    along, right = result["/plan/site_along"][..., 0], result["/plan/site_right"][..., 0]
    for axis in range(along.ndim):
        if along.shape[axis] < 3:
            continue
        spread = np.abs(np.diff(along, axis=axis)) + np.abs(np.diff(right, axis=axis))
        if np.any(spread > 1e-3):
            moving.append(axis)
    return (moving[0], moving[1]) if len(moving) == 2 else None


_LEAST_GRID = 5
"""Least number of points on two axes for a map; with fewer, curves are better."""


def grid(result: Result) -> tuple[int, int] | None:
    """The two longest axes of numbers, of one key each, where both are long enough for a map: down, across."""
    dims = dimensions(result)
    sizes = {i: result[f"/{name}"].size for i, name in enumerate(dims)
             if f"/sweep/axes/{name}" in result and result[f"/{name}"].dtype.kind in "fiu"}  # fmt: skip
    longest = sorted(sorted(sizes, key=lambda i: -sizes[i])[:2])
    if len(longest) < 2 or min(sizes[i] for i in longest) < _LEAST_GRID:
        return None
    return longest[0], longest[1]


def _over_two(result: Result, name: str, axes: tuple[int, int]) -> Figure:
    """A map of an output over two varied numbers; of the other axes the best combination."""
    from navsim.report.figures import legend_above
    from navsim.report.printing import COLOURS, COLUMN, new_figure

    cube, dims, better = result[f"/sweep/{name}"], dimensions(result), large(result, name)
    found = best(choice(result, name), better)
    assert found is not None
    others = [i for i in range(cube.ndim) if i not in axes]
    values = cube[_slice(cube.ndim, others, tuple(found[i] for i in others))]
    y, x = (result[f"/{dims[i]}"].astype(float) for i in axes)
    rows, columns = np.argsort(y), np.argsort(x)
    low, high = colours(values, better)
    fig = new_figure(COLUMN, 3.2)
    ax = fig.subplots()
    image = ax.pcolormesh(
        x[columns], y[rows], np.ma.masked_invalid(values[np.ix_(rows, columns)]), shading="nearest",
        cmap="viridis" if better else "viridis_r", vmin=low, vmax=high, rasterized=True,
    )  # fmt: skip
    ax.set_facecolor("#dddddd")
    ax.grid(visible=False)
    tied = alike(cube, found)[_slice(cube.ndim, others, tuple(found[i] for i in others))]
    everywhere = bool(tied[np.isfinite(values)].all())
    at = np.argwhere(tied & ~everywhere)  # no star where any place is as good as the others
    ax.plot(x[at[:, 1]], y[at[:, 0]], marker="*" if at.size else "", color=COLOURS[1], ms=9, mec="white", mew=0.6,
            ls="", clip_on=False, label=f"{'any' if everywhere else 'best'}: {digits(cube[found], 4)}")  # fmt: skip
    hollow = "; grey: no value" if not np.isfinite(values).all() else ""
    ax.locator_params(axis="x", nbins=5)
    ax.ticklabel_format(useOffset=False)
    ax.set_xlabel(f"{axis_label(result, dims[axes[1]])}{hollow}")
    ax.set_ylabel(axis_label(result, dims[axes[0]]))
    fig.colorbar(image, ax=ax, label=label(result, name), extend="min" if better else "max", location="bottom")
    text = ", ".join(point_of(result, dims[i], found[i]) for i in others)
    legend_above(fig, ax, 1, text or None)
    return fig


_CALLED = {
    "pseudolites count": "pseudolites", "pseudolites s": "distance from the axis",
    "pseudolites l1": "distance before the threshold",
}  # fmt: skip
"""Names of keys whose last part is not clear enough."""
_LETTERS = {"s": "distance right of the axis", "l1": "distance before the threshold", "lat": "latitude",
            "lon": "longitude"}  # fmt: skip


def key_label(key: str) -> str:
    """Name of a varied key, dotted, in words without its unit, such as jammers[0] latitude."""
    parts = list[str]()
    for part in key.split("."):
        if part.isdigit() and parts:
            parts[-1] += f"[{part}]"
        elif part != "place":
            parts.append(part)
    *whose, last = parts
    name = without_unit(last)
    text = " ".join([*whose[-1:], name]).replace("_", " ")
    return _CALLED.get(text) or " ".join([*whose[-1:], _LETTERS.get(name, name)]).replace("_", " ")


def axis_label(result: Result, axis: str) -> str:
    """Name of an axis in words with its unit: a varied key, or the number of the point of several."""
    paths = [key_path(result, key) for key, own in keys(result).items() if own == axis]
    if len(paths) > 1:
        return f"number of the point of {', '.join(map(key_label, paths))}"
    unit = unit_of(paths[0])
    return key_label(paths[0]) + (f", {unit}" if unit else "")


_DIGITS = 7
"""Of values that a legend names: a metre of latitude and longitude."""


def point_of(result: Result, axis: str, i: int) -> str:
    """Point of an axis: values of its keys, in words with their units."""
    text = []
    for key, own in keys(result).items():
        if own == axis:
            path = key_path(result, key)
            unit = unit_of(path)
            gap = "" if unit in ("", "°") else " "
            value = result[f"/sweep/axes/{key}"][i]
            said = digits(value, _DIGITS) if isinstance(value, float) else str(value)
            text.append(f"{key_label(path)} = {said}{gap}{unit}")
    return ", ".join(text)


def varied_terrain(result: Result) -> str:
    """Note about terrain that maps omit because it varies, in words; "" for nothing."""
    numbers = sorted(varied(result))
    if not numbers:
        return ""
    return f"{'terrain' if WHOLE in numbers else ', '.join(f'terrain[{number}]' for number in numbers)}, which varies"


def label(result: Result, name: str) -> str:
    """An output in words, with its unit."""
    variable = result.variables[f"/sweep/{name}"]
    return variable.long_name + ("" if variable.units == "1" else f", {variable.units}")


@dataclass(frozen=True)
class Panel:
    """Map of an output on the runway plan."""

    values: np.ndarray
    """(n, m)."""
    sites: list[tuple[np.ndarray, np.ndarray]]
    """(n, m) along and right of each pseudolite, m."""
    corners: list[tuple[np.ndarray, np.ndarray] | None]
    """(n + 1, m + 1) of the corners of the cells likewise, None if they are not on straight lines."""
    best: tuple[np.ndarray, np.ndarray] | None
    """(s,) along and right of the pseudolites of the best combination, or of all equally good ones, m, nan for none.
    None if nothing is known or all are equal."""
    title: str
    """Values of the other axes, and the best value."""


def panels(result: Result, name: str, plane: tuple[int, int]) -> list[Panel]:
    """Maps of an output, one for each point of the other axes, or of the best of them if there are many."""
    cube, dims = result[f"/sweep/{name}"], dimensions(result)
    others = [axis for axis in range(cube.ndim) if axis not in plane]
    better = large(result, name)
    chosen = choice(result, name)
    found = best(chosen, better)
    assert found is not None
    points = list(np.ndindex(*(cube.shape[axis] for axis in others)))
    if len(points) > _MOST_PANELS:
        points = [tuple(found[axis] for axis in others)]
    first_along = result["/plan/site_along"][..., 0]
    out = []
    for point in points:
        place = _slice(cube.ndim, others, point)
        if not np.any(np.isfinite(first_along[place])):
            continue
        values = cube[place]
        both = [(result["/plan/site_along"][(*place, s)], result["/plan/site_right"][(*place, s)])
                for s in range(result["/site"].size)]  # fmt: skip
        sites = [(along, right) for along, right in both if np.any(np.isfinite(along))]
        numbers = [result[f"/{dims[axis]}"] for axis in plane]
        corners = []
        for along, right in sites:
            x, y = _corners(numbers, along), _corners(numbers, right)
            corners.append(None if x is None or y is None else (x, y))
        here, title, star = best(chosen[place], better), "", None
        if here is not None:
            tied = alike(values, here)
            everywhere = bool(tied[np.isfinite(values)].all())
            if not everywhere:
                along, right = (result[f"/plan/site_{axis}"][place][tied].ravel() for axis in ("along", "right"))
                star = along, right
            text = ", ".join(point_of(result, dims[axis], i) for axis, i in zip(others, point, strict=True))
            index = [0] * cube.ndim
            for axis, i in (*zip(others, point, strict=True), *zip(plane, here, strict=True)):
                index[axis] = int(i)
            ends = [key for key in at_ends(result, tuple(index)) if dims.index(key) in plane and tied.sum() == 1]
            borders = ", ".join(point_of(result, key, index[dims.index(key)]) for key in ends)
            where = f"\non the border of the map ({borders}): try a wider range" if ends else ""
            found_there = "any place" if everywhere else "best"
            title = f"{text + ': ' if text else ''}{found_there} {digits(values[here], 4)}{where}"
        out.append(Panel(values, sites, corners, star, title))
    return out


def colours(cube: np.ndarray, better: bool) -> tuple[float, float]:
    """Ends of the colour scale of a map; the bad end is cut off. A constant output has the colour of the best."""
    known = cube[np.isfinite(cube)]
    if alike(known, (0,)).all():
        value = float(known[0])
        step = abs(value) or 1.0
        return (value - step, value) if better else (value, value + step)
    low, high = np.percentile(cube[np.isfinite(cube)], [2, 100] if better else [0, 98]).tolist()
    return low, max(high, low + 1e-12)


def _map(result: Result, name: str, cube: np.ndarray, plane: tuple[int, int]) -> Figure:
    """Heat maps on the runway plan, a panel for each point of the other axes (or the best of them)."""
    from navsim.report.figures import legend_above, view_from_above
    from navsim.report.printing import COLUMN, narrow, new_figure, to_scale_below

    better = large(result, name)
    shown = panels(result, name, plane)
    low, high = colours(cube, better)
    views = [_View(panel) for panel in shown]
    fig = new_figure(2 * COLUMN, 1.0)
    below = narrow(fig)
    # a colour bar next to the maps takes a quarter of the page
    across = fig.get_figwidth() - (0.8 if below else 1.7)
    heights = [across * view.ratio for view in views]
    fig.set_figheight(0.9 + sum(h + 0.35 for h in heights) + (0.7 if below else 0.0))
    axes = fig.subplots(len(shown), 1, squeeze=False, height_ratios=heights)[:, 0]
    image = None
    hollow = any(not np.all(np.isfinite(panel.values)) for panel in shown)
    style = {"cmap": "viridis" if better else "viridis_r", "vmin": low, "vmax": high, "rasterized": True}
    for ax, panel, view in zip(axes, shown, views, strict=True):
        for (along, right), corners in zip(panel.sites, panel.corners, strict=True):
            if corners is not None:
                image = ax.pcolormesh(*corners, np.ma.masked_invalid(panel.values), **style)
            else:
                image = ax.scatter(along, right, c=np.ma.masked_invalid(panel.values), marker="s", s=16.0, **style)
        ax.margins(0.0)
        lower, upper = ax.get_ylim()
        reach = 0.05 * (upper - lower)
        # the axis of the runway is shown where it runs close by
        ax.set_ylim(min(lower, -0.4 * reach) if lower < reach else lower,
                    max(upper, 0.4 * reach) if upper > -reach else upper)  # fmt: skip
        ax.set_facecolor("#dddddd")
        ax.grid(visible=False)
        ax.set_title(panel.title)
        if panel.best is not None:
            ax.plot(
                *panel.best, "*", color="#D55E00", ms=9, mec="white", mew=0.6, ls="", label="best",
                clip_on=False, zorder=5,
            )  # fmt: skip
        _runway(ax, result)
        view_from_above(ax)
        if view.to_scale:
            ax.set_aspect("equal", adjustable="box")
        ax.set_ylabel("right of the axis, m")
    axes[-1].set_xlabel("beyond the threshold (= -l1), m" + ("; grey: no solution" if hollow else ""))
    legend_above(fig, axes[0], 3, f"not drawn: {unlike}" if (unlike := varied_terrain(result)) else None)
    if image is not None:
        place: dict[str, Any] = {"location": "bottom", "aspect": 30} if below else {"shrink": 0.8}
        fig.colorbar(image, ax=list(axes), label=label(result, name), extend="min" if better else "max", **place)
        for ax in axes:
            ax.set_anchor("W")  # a colour bar moves them to the right, where the layout has no room for their labels
    to_scale_below(fig, axes)
    return fig


class _View:
    """Height of a panel on the page, and whether both axes have one scale."""

    def __init__(self, panel: Panel) -> None:
        along, right = (np.concatenate([site[i].ravel() for site in panel.sites]) for i in (0, 1))
        spans = [float(np.nanmax(x) - np.nanmin(x)) for x in (along, right)]
        ratio = spans[1] / max(spans[0], 1e-3)
        self.to_scale = 0.2 <= ratio <= 0.9
        """Whether both axes have one scale: a strip would leave the page white."""
        self.ratio = ratio if self.to_scale else 0.25 if ratio < 0.2 else 0.7
        """Height by width."""


def _corners(numbers: list[np.ndarray], coordinate: np.ndarray) -> np.ndarray | None:
    """A coordinate of the corners (n + 1, m + 1) of the cells of a panel; None if they are not on straight lines.

    Straight lines in the varied numbers (n,), (m,) let combinations without a solution leave no gap in the mesh.
    """
    if any(x.dtype.kind not in "fiu" for x in numbers):
        return None

    def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        first, second = np.meshgrid(x, y, indexing="ij")
        return np.stack([np.ones_like(first), first, second], axis=-1)

    def edges(x: np.ndarray) -> np.ndarray:
        middle = 0.5 * (x[1:] + x[:-1])
        return np.concatenate([[2.0 * x[0] - middle[0]], middle, [2.0 * x[-1] - middle[-1]]])

    x, y = (values.astype(float) for values in numbers)
    known = np.isfinite(coordinate)
    terms = plane(x, y)
    slope = np.linalg.lstsq(terms[known], coordinate[known], rcond=None)[0]
    off = np.abs(terms[known] @ slope - coordinate[known]).max()
    return plane(edges(x), edges(y)) @ slope if off <= 1e-3 * np.ptp(coordinate[known]) + 0.1 else None


def _slice(dimensions_: int, axes: list[int], points: tuple[int, ...]) -> tuple[int | slice, ...]:
    """Index that fixes some axes and leaves the others."""
    out: list[int | slice] = [slice(None)] * dimensions_
    for axis, i in zip(axes, points, strict=True):
        out[axis] = i
    return tuple(out)


def _runway(ax: Axes, result: Result) -> None:
    """Runway, ground track and terrain within the map."""
    from navsim.report.figures import ridge_lines

    box = ax.get_xlim(), ax.get_ylim()
    ends = [0.0, scenario_setting(result, "runway", "length_m")]
    ax.plot(ends, [0.0, 0.0], color="black", lw=3, solid_capstyle="butt", label="runway")
    track = result["/plan/track_along"], result["/plan/track_right"]
    ax.plot(*track, color="black", lw=0.8, ls="--", label="ground track")
    ridge_lines(ax, shown_ridges(result), *box)
    ax.set_xlim(box[0])
    ax.set_ylim(box[1])


@dataclass(frozen=True)
class Curves:
    """An output along an axis."""

    axis: str
    """Its name."""
    x: np.ndarray
    """(n,) numbers or names."""
    rows: np.ndarray
    """(k, n) values."""
    names: list[str]
    """Values of the other axes of each row, empty without other axes."""
    of: int
    """Number of combinations of the other axes; `rows` may have fewer."""
    scattered: bool
    """The points of the axis have no order: they are names, or of several keys."""

    @property
    def some(self) -> str:
        """Number of combinations shown, of how many; empty if all are."""
        return f"{len(self.rows)} of {self.of} combinations" if len(self.rows) < self.of else ""


def curves(result: Result, name: str, most: int) -> Curves:
    """The output along the longest axis, for as many points of the others as `most`, evenly chosen."""
    cube, dims = result[f"/sweep/{name}"], dimensions(result)
    axis = int(np.argmax(cube.shape))
    members = [key for key, own in keys(result).items() if own == dims[axis]]
    rows = np.moveaxis(cube, axis, -1).reshape(-1, cube.shape[axis])
    others = [d for i, d in enumerate(dims) if i != axis]
    shapes = [n for i, n in enumerate(cube.shape) if i != axis]
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int))
    names = []
    for row in chosen:
        index = np.unravel_index(int(row), shapes) if shapes else ()
        names.append(", ".join(point_of(result, d, int(i)) for d, i in zip(others, index, strict=True)))
    x = result[f"/{dims[axis]}"]
    scattered = len(members) > 1 or x.dtype.kind not in "fiu"
    return Curves(dims[axis], x, rows[chosen], names, len(rows), scattered)


def _curves(result: Result, name: str) -> Figure:
    """The output along the longest axis, a curve for each point of the others (as many as there are colours)."""
    from navsim.report.figures import legend_above
    from navsim.report.limits import DOTTED, REQUIRED
    from navsim.report.printing import COLOURS, COLUMN, MARKS, new_figure, style

    of = curves(result, name, len(COLOURS))
    several = bool(of.names[0])
    fig = new_figure(COLUMN, 2.5 + (0.16 * len(of.rows) if several else 0.0))
    ax = fig.subplots()
    numeric = of.x.dtype.kind in "fiu"
    at = of.x if numeric else np.arange(of.x.size)
    for i, (row, text) in enumerate(zip(of.rows, of.names, strict=True)):
        # marks without a line: equal values show as one mark in another
        how = style(i) | ({"ls": "", "mfc": "none"} if of.scattered else {})
        size = 2.5 + (1.5 * (len(of.rows) - 1 - i) if of.scattered else 0.0)
        ax.plot(at, row, marker=MARKS[i % len(MARKS)], ms=size, lw=0.8, label=text or None, **how)
    limit = result.variables[f"/sweep/{name}"].attributes.get("limit")
    if limit is not None:  # of a requirement
        ax.axhline(float(limit), color=REQUIRED, ls=DOTTED, lw=1.4)
    if numeric:
        ax.locator_params(axis="x", nbins=5)  # numbers of many digits, as latitudes, would run into each other
    else:
        ax.set_xticks(at, [str(value) for value in of.x])
    ax.set_xlabel(axis_label(result, of.axis))
    ax.set_ylabel(label(result, name))
    if several:
        legend_above(fig, ax, 1, of.some or None)
    return fig


def _texts(result: Result, target: Path) -> dict[Path, str]:
    return {target.with_suffix(".csv"): csv_text(result)}


def _verdicts(result: Result) -> list[Table | str]:
    judged = requirements(result)
    return [*_flown_verdicts(result), *([] if judged is None else [judged])]


VIEW = View(
    one_by_one(tables),
    figures,
    more=best_plain,
    texts=_texts,
    verdicts=one_by_one(_verdicts),
    drawings="navsim.sweeps.page:sweeps",
)
