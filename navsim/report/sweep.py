"""Sweeps: the tidy table, the best combinations, heat maps on the runway plan."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from navsim.io.results import Result
from navsim.report.tables import titled_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_MOST_PANELS = 4


def outputs(result: Result) -> list[str]:
    """The outputs of a sweep, in order."""
    return [path.split("/")[2] for path in result.variables if path.startswith("/sweep/") and path.count("/") == 2]


def dimensions(result: Result) -> tuple[str, ...]:
    """Names of the axes, slowest first."""
    return result.variables[f"/sweep/{outputs(result)[0]}"].dims


def keys(result: Result) -> dict[str, str]:
    """Names of the varied keys and the axis each belongs to, in order."""
    found = {p.split("/")[3]: v.dims[0] for p, v in result.variables.items() if p.startswith("/sweep/axes/")}
    order = dimensions(result)
    return dict(sorted(found.items(), key=lambda item: order.index(item[1])))


def setting(result: Result, key: str, index: tuple[int, ...]) -> object:
    """The value of a varied key at one combination."""
    dims = dimensions(result)
    return result[f"/sweep/axes/{key}"][index[dims.index(keys(result)[key])]]


def csv_text(result: Result) -> str:
    """One row a combination: the varied keys, then the outputs."""
    names, columns = list(keys(result)), outputs(result)
    cubes = [result[f"/sweep/{name}"] for name in columns]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*names, *columns])
    for index in np.ndindex(*cubes[0].shape):
        place = [_plain(setting(result, name, index)) for name in names]
        writer.writerow([*place, *(_plain(cube[index]) for cube in cubes)])
    return out.getvalue()


def _plain(value: object) -> str:
    if isinstance(value, (float, np.floating)):
        return "" if np.isnan(value) else f"{float(value):.10g}"
    return str(value)


def best(cube: np.ndarray) -> tuple[int, ...] | None:
    """The combination of the smallest value, None where there is none."""
    if not np.any(np.isfinite(cube)):
        return None
    return tuple(int(i) for i in np.unravel_index(int(np.nanargmin(cube)), cube.shape))


def console(result: Result) -> RenderableType:
    """The best combination for each output, with the range of values."""
    names = list(keys(result))
    combinations = int(result.attributes["combinations"])
    method = result.attributes["method"]
    title = f"{combinations} combinations, method {method}; the best for each output"
    table = titled_table(title, "output", "smallest", "median", "largest", *(f"best {name}" for name in names))
    for name in outputs(result):
        if name.endswith(("_low", "_high")):
            continue
        cube = result[f"/sweep/{name}"]
        index = best(cube)
        if index is None:
            table.add_row(name, "-", "-", "-")
            continue
        spread = [f"{value:.4g}" for value in (np.nanmin(cube), np.nanmedian(cube), np.nanmax(cube))]
        table.add_row(name, *spread, *(_plain(setting(result, key, index)) for key in names))
    return table


def best_json(result: Result) -> dict[str, object]:
    """The best combination for each output as plain data."""
    out: dict[str, object] = {k: result.attributes[k] for k in ("kind", "method", "combinations", "refused")}
    out = {k: v if isinstance(v, str) else int(v) for k, v in out.items()}  # type: ignore[call-overload]
    for name in outputs(result):
        cube = result[f"/sweep/{name}"]
        index = best(cube)
        if index is not None:
            place = {key: np.asarray(setting(result, key, index)).item() for key in keys(result)}
            out[name] = {"value": float(cube[index]), **place}
    return out


def figures(result: Result) -> dict[str, Figure]:
    """A map of each output where two axes move pseudolites, else curves along the longest numeric axis."""
    out = {}
    for name in outputs(result):
        if name.endswith(("_low", "_high")):
            continue
        cube = result[f"/sweep/{name}"]
        if best(cube) is None:
            continue
        plane = _plane(result)
        out[name] = _map(result, name, cube, plane) if plane else _curves(result, name, cube)
    return out


def _plane(result: Result) -> tuple[int, int] | None:
    """The two axes along which the first pseudolite moves in the plane."""
    moving = []
    along, right = result["/plan/site_along"][..., 0], result["/plan/site_right"][..., 0]
    for axis in range(along.ndim):
        if along.shape[axis] < 3:
            continue
        spread = np.abs(np.diff(along, axis=axis)) + np.abs(np.diff(right, axis=axis))
        if np.any(np.nan_to_num(spread) > 1e-3):
            moving.append(axis)
    return (moving[0], moving[1]) if len(moving) == 2 else None


def _label(result: Result, name: str) -> str:
    variable = result.variables[f"/sweep/{name}"]
    return variable.long_name + ("" if variable.units == "1" else f", {variable.units}")


def _map(result: Result, name: str, cube: np.ndarray, plane: tuple[int, int]) -> Figure:
    """Heat maps on the runway plan, a panel for each point of the other axes (or the best of them)."""
    from navsim.report.figures import COLUMN, new_figure

    dims = dimensions(result)
    others = [axis for axis in range(cube.ndim) if axis not in plane]
    found = best(cube)
    assert found is not None
    panels = list(np.ndindex(*(cube.shape[axis] for axis in others)))
    if len(panels) > _MOST_PANELS:
        panels = [tuple(found[axis] for axis in others)]
    finite = cube[np.isfinite(cube)]
    low, high = float(finite.min()), float(np.percentile(finite, 98))
    right_of = result["/plan/site_right"]
    heights = []
    for panel in panels:
        index = _slice(cube.ndim, others, panel)
        heights.append(float(np.nanmax(right_of[index]) - np.nanmin(right_of[index])))
    fig = new_figure(2 * COLUMN, 0.4 + sum(min(5.0, max(1.2, 4.5 * h / max(heights))) for h in heights))
    axes = fig.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
    image = None
    for ax, panel in zip(axes, panels, strict=True):
        place = _slice(cube.ndim, others, panel)
        values = cube[place]
        used = [s for s in range(result["/site"].size) if np.any(np.isfinite(result["/plan/site_along"][(*place, s)]))]
        for s in used:
            along, right = result["/plan/site_along"][(*place, s)], result["/plan/site_right"][(*place, s)]
            shown = np.ma.masked_invalid(np.where(np.isfinite(along), values, np.nan))
            image = ax.pcolormesh(
                np.nan_to_num(along), np.nan_to_num(right), shown, shading="nearest", cmap="viridis_r", vmin=low,
                vmax=max(high, low + 1e-12), rasterized=True,
            )  # fmt: skip
        here = best(values)
        if here is not None:
            along, right = result["/plan/site_along"][place][here], result["/plan/site_right"][place][here]
            ax.plot(along, right, "*", color="#D55E00", ms=9, mec="white", mew=0.6, ls="", label="best")
            text = ", ".join(f"{dims[axis]} = {_plain(_axis_value(result, axis, i))}"
                             for axis, i in zip(others, panel, strict=True))  # fmt: skip
            ax.set_title(f"{text + ': ' if text else ''}best {values[here]:.4g}")
        _runway(ax, result)
        ax.set_aspect("equal", adjustable="box")
        ax.set_ylabel("right of the axis, m")
    axes[-1].set_xlabel("along the runway from the threshold, m")
    axes[0].legend(loc="upper right", ncols=3, frameon=True, framealpha=0.8)
    if image is not None:
        fig.colorbar(image, ax=list(axes), label=_label(result, name), extend="max", shrink=0.8)
    return fig


def _slice(dimensions_: int, axes: list[int], points: tuple[int, ...]) -> tuple[int | slice, ...]:
    """The index that fixes some axes and leaves the others whole."""
    out: list[int | slice] = [slice(None)] * dimensions_
    for axis, i in zip(axes, points, strict=True):
        out[axis] = i
    return tuple(out)


def _axis_value(result: Result, axis: int, i: int) -> object:
    return result[f"/{dimensions(result)[axis]}"][i]


def _runway(ax: Axes, result: Result) -> None:
    scenario = yaml.safe_load(str(result.attributes["scenario"]))
    ax.plot(
        [0.0, scenario["runway"]["length_m"]], [0.0, 0.0], color="black", lw=3, solid_capstyle="butt", label="runway"
    )
    left, right = ax.get_xlim()
    track = result["/plan/track_along"], result["/plan/track_right"]
    ax.plot(*track, color="black", lw=0.8, ls="--", label="ground track")
    ax.set_xlim(left, right)


def _curves(result: Result, name: str, cube: np.ndarray) -> Figure:
    """The output along the longest axis, a curve for each point of the others (at most seven)."""
    from navsim.report.figures import COLUMN, new_figure

    dims = dimensions(result)
    axis = int(np.argmax(cube.shape))
    x = result[f"/{dims[axis]}"]
    members = [key for key, own in keys(result).items() if own == dims[axis]]
    fig = new_figure(COLUMN, 2.6)
    ax = fig.subplots()
    rows = np.moveaxis(cube, axis, -1).reshape(-1, cube.shape[axis])
    others = [d for i, d in enumerate(dims) if i != axis]
    shapes = [n for i, n in enumerate(cube.shape) if i != axis]
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(7, len(rows))).astype(int))
    numeric = x.dtype.kind in "fiu"
    at = x if numeric else np.arange(x.size)
    for row in chosen:
        index = np.unravel_index(int(row), shapes) if shapes else ()
        label = ", ".join(f"{d} = {_plain(result[f'/{d}'][int(i)])}" for d, i in zip(others, index, strict=True))
        scattered = members and len(members) > 1
        ax.plot(at, rows[row], "." if scattered else ".-", ms=3, lw=0.8, label=label or None)
    if not numeric:
        ax.set_xticks(at, [str(value) for value in x])
    ax.set_xlabel(dims[axis])
    ax.set_ylabel(_label(result, name))
    if others:
        ax.legend(fontsize=5.5)
    return fig


def save_csv(result: Result, path: Path) -> Path:
    """Write the tidy table. Raises ResultError."""
    from navsim.report.figures import save_text

    return save_text(path, csv_text(result))
