"""The summary of results as rich tables and as plain data for JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.io.results import Result

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

_DEGREE = 180.0 / math.pi


def _number(value: float, digits: int = 3) -> str:
    return "-" if not np.isfinite(value) else f"{value:.{digits}f}"


def _with_interval(values: np.ndarray, scale: float = 1.0, digits: int = 3) -> str:
    value, low, high = np.asarray(values) * scale
    if not np.isfinite(value):
        return "-"
    shown = _number(value, digits)
    return shown if low == high else f"{shown}  [{_number(low, digits)}, {_number(high, digits)}]"


def _unit_mean(result: Result, name: str) -> str:
    """Mean over time of a consistency series, with the band of one instant."""
    variable = result.variables[f"/summary/consistency/{name}"]
    data = np.asarray(variable.data)
    known = data[np.isfinite(data)]
    if known.size == 0:
        return "-"
    if "band_low" not in variable.attributes:
        return f"{known.mean():.3f}  (expected; {known.min():.3f} to {known.max():.3f})"
    low, high = variable.attributes["band_low"], variable.attributes["band_high"]
    inside = np.mean((known >= low) & (known <= high))
    return f"{known.mean():.3f}  (95 % band {low:.3f} to {high:.3f}; {100 * inside:.0f} % of times inside)"


def _runs(result: Result) -> str:
    if result.attributes.get("method") == "covariance":
        return "none: linear covariance analysis"
    return f"{int(result['/summary/count/runs'])}, seed {result.attributes['seed']}"


def _budget(result: Result, i: int) -> str:
    if "/summary/budget/source" not in result:
        return "-"
    cells = []
    for axis in ("horizontal", "vertical"):
        share = 100.0 * result[f"/summary/budget/{axis}_share"][i]
        cells.append(f"{_number(result[f'/summary/budget/{axis}'][i])} ({_number(share, 1)} %)")
    return ", ".join(cells)


def _group(result: Result, i: int) -> str:
    if "/summary/consistency/mean_group" not in result:
        return "-"
    mean = result["/summary/consistency/mean_group"][i]
    return f"{_number(mean)}  ({result['/summary/consistency/verdict'][i]})"


def _coverage(result: Result, i: int) -> str:
    if "/summary/coverage/position" not in result:
        return "-"
    value, low, high = 100 * result["/summary/coverage/position"][i]
    reach = f"  [{_number(low, 1)}, {_number(high, 1)}]" if np.isfinite(low) else ""
    return f"{_number(value, 1)} %{reach}  (Gaussian {100 * result['/summary/coverage/expected'][i]:.1f} %)"


def titled_table(title: str, *heads: str, lines: bool = False) -> Table:
    """An empty table in the style of all reports."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, show_lines=lines)
    for head in heads:
        table.add_column(head)
    return table


def summary_table(results: list[tuple[str, Result]]) -> RenderableType:
    """One table of the summaries, a column a result: names and results in order."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for name, _ in results:
        table.add_column(name)

    def row(label: str, cell: Any) -> None:
        table.add_row(label, *(cell(r) for _, r in results))

    def section(title: str) -> None:
        table.add_row(f"[bold]{title}[/bold]", *("" for _ in results))

    row("runs", _runs)
    row(
        "fixes, epochs without",
        lambda r: f"{int(r['/summary/count/fixes'])}, {int(r['/summary/count/epochs_without_fix'])}",
    )
    section("Geometry on the glide (mean, min - max)")
    for name in ("pdop", "hdop", "vdop", "gdop", "tdop"):

        def dop(r: Result, name: str = name) -> str:
            mean, low, high = r[f"/summary/dop/{name}"][:3]
            return f"{_number(mean, 2)}  ({_number(low, 2)} - {_number(high, 2)})" if np.isfinite(mean) else "-"

        row("  " + name.upper(), dop)
    section("Fix from its covariance (SKO), m")
    for name in ("horizontal", "vertical", "3d"):
        row(f"  {name}", lambda r, n=name: _with_interval(r[f"/summary/fix/rms_{n}"], digits=2))
    section("Filter, RMS over 20 s to touchdown [95 %]")
    for name in ("horizontal", "vertical"):
        row(f"  {name} position, m", lambda r, n=name: _with_interval(r[f"/summary/rms/{n}"]))
    for path, axes, unit, scale in (
        ("velocity_ned", ("north", "east", "down"), "m/s", 1.0),
        ("attitude", ("north", "east", "down"), "deg", _DEGREE),
    ):
        for i, axis in enumerate(axes):
            label = f"  {path.removesuffix('_ned')} {axis}, {unit}"
            row(label, lambda r, p=path, i=i, s=scale: _with_interval(r[f"/summary/rms/{p}"][i], s))
    section("Filter, position at height [95 %], m")
    labels = ("touchdown", "50 ft", "100 ft", "200 ft")
    for i, label in enumerate(labels):
        for name in ("lateral", "along", "vertical"):
            row(f"  {label}, {name}", lambda r, n=name, i=i: _with_interval(r[f"/summary/at/{n}"][i]))
    section("Consistency (mean per degree of freedom, 1 is right)")
    row("  NEES, 15 states", lambda r: _unit_mean(r, "nees"))
    row("  NEES, position and velocity", lambda r: _unit_mean(r, "nees_position_velocity"))
    row("  NIS", lambda r: _unit_mean(r, "nis"))
    flown = next((r for _, r in results if "/summary/coverage/level" in r), None)
    if flown is not None:
        for i, name in enumerate(flown["/summary/consistency/group"]):
            row(f"  {str(name).replace('_', ' ')}, last 20 s", lambda r, i=i: _group(r, i))
        for i, level in enumerate(flown["/summary/coverage/level"]):
            row(f"  position within {level:g}σ", lambda r, i=i: _coverage(r, i))
    analysed = next((r for _, r in results if "/summary/budget/source" in r), None)
    if analysed is not None:
        section("Error budget, same 20 s (share of mean square), m")
        for i, name in enumerate(analysed["/summary/budget/source"]):
            row(f"  {str(name).replace('_', ' ')}", lambda r, i=i: _budget(r, i))
    return table


def summary_json(result: Result) -> dict[str, Any]:
    """The summary as nested plain data, with the names of the result file; nan becomes null."""
    out: dict[str, Any] = {
        k: result.attributes[k] for k in ("kind", "navsim_version", "seed", "epoch", "scenario_sha256")
    }
    out["seed"] = int(out["seed"])
    return out | plain_tree(result, ("/summary/",), ("/summary/consistency/time",))


def plain_tree(result: Result, prefixes: tuple[str, ...], left_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """The variables whose paths start with one of the prefixes as nested plain data; nan becomes null."""
    out: dict[str, Any] = {}
    for path, variable in result.variables.items():
        if path.startswith(prefixes) and path not in left_out:
            node = out
            *groups, name = path.strip("/").split("/")
            for group in groups:
                node = node.setdefault(group, {})
            node[name] = _plain(np.asarray(variable.data))
    return out


def _plain(data: np.ndarray) -> Any:
    """Arrays as nested lists of plain numbers and text; what is not finite becomes None."""
    if data.ndim:
        return [_plain(np.asarray(d)) for d in data]
    value = data.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
