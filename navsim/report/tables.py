"""The summary of results as rich tables and as plain data for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.io.results import Result

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

FINDINGS = "/findings/"
"""Where a result keeps what its user must hear about."""
_DEGREE = 180.0 / math.pi


def _number(value: float, digits: int = 3) -> str:
    return "-" if not np.isfinite(value) else f"{value:.{digits}f}"


def setting(result: Result, *keys: str) -> Any:
    """A value of the scenario stored in a result, defaults included. Raises KeyError where it has no such key."""
    import yaml

    node = yaml.safe_load(str(result.attributes["scenario"]))
    for key in keys:
        node = node[key]
    return node


def runs_of(result: Result) -> str:
    """Which runs a landing result holds, in words."""
    if result.attributes["method"] == "covariance":
        return "linear covariance analysis"
    numbers, seed = result["/run"], result.attributes["seed"]
    if numbers.size == 1:
        return f"run {numbers[0]}, seed {seed}"
    return f"{numbers.size} runs ({numbers[0]} to {numbers[-1]}), seed {seed}"


def single(result: Result) -> bool:
    """Whether a landing result is one run: a sample that has errors, but no statistics over runs."""
    return result["/run"].size == 1 and result.attributes["method"] != "covariance"


def _accuracy(values: np.ndarray, sigma: np.ndarray, scale: float = 1.0, sign: np.ndarray | None = None) -> str:
    """An error beside the filter's sigma: of one run without an interval, with its `sign` where it is given."""
    value, low, high = np.asarray(values) * scale
    if not np.isfinite(value):
        return "-"
    shown = _number(value)
    if sign is not None:
        shown = f"{float(sign) * scale:+.3f}"
    elif low != high:
        shown += f"  [{_number(low)}, {_number(high)}]"
    return f"{shown}  σ {_number(float(sigma) * scale)}"


def _late(result: Result, name: str, i: int | None = None, scale: float = 1.0) -> str:
    """RMS over the last seconds of an entry of /summary/rms, of its component `i` where it has several."""
    values, sigma = result[f"/summary/rms/{name}"], result[f"/summary/sigma/{name}"]
    if i is not None:
        values, sigma = values[i], sigma[i]
    if single(result):
        values = np.repeat(values[:1], 3)
    return _accuracy(values, sigma, scale)


def _at(result: Result, name: str, i: int) -> str:
    """The error at a height: of one run with its sign, of several the RMS with its interval."""
    sign = result[f"/summary/at/{name}_run"][0, i] if single(result) else None
    return _accuracy(result[f"/summary/at/{name}"][i], result[f"/summary/at/{name}_sigma"][i], sign=sign)


def _percentiles(result: Result, path: str, i: int | None = None) -> str:
    """Percentiles over runs; a result of one run has none, a covariance analysis only those at heights."""
    if single(result) or path not in result:
        return "-"
    values = result[path] if i is None else result[path][i]
    return "  ".join(_number(x) for x in values) if np.all(np.isfinite(values)) else "-"


def _unit_mean(result: Result, name: str) -> str:
    """Mean over time of a consistency series, with the band of one instant."""
    variable = result.variables[f"/summary/consistency/{name}"]
    data = np.asarray(variable.data)
    known = data[np.isfinite(data)]
    if known.size == 0:
        return "-"
    if "band_low" not in variable.attributes:
        return f"{known.mean():.3f}  (expected; {known.min():.3f} to {known.max():.3f})"
    if single(result):
        return f"{known.mean():.3f}  (one run, over time)"
    low, high = variable.attributes["band_low"], variable.attributes["band_high"]
    inside = np.mean((known >= low) & (known <= high))
    return f"{known.mean():.3f}  (95 % band {low:.3f} to {high:.3f}; {100 * inside:.0f} % of times inside)"


def _fixes(result: Result) -> str:
    runs, fixes = result["/run"].size, int(result["/summary/count/fixes"])
    return f"{fixes}" + (f"  ({fixes / runs:.6g} a run)" if runs > 1 else "")


def _group(result: Result, i: int) -> str:
    if "/summary/consistency/mean_group" not in result:
        return "-"
    mean = _number(result["/summary/consistency/mean_group"][i])
    return mean if single(result) else f"{mean}  {result['/summary/consistency/verdict'][i]}"


def _budget(result: Result, i: int) -> str:
    if "/summary/budget/source" not in result:
        return "-"
    cells = []
    for axis in ("horizontal", "vertical"):
        share = 100.0 * result[f"/summary/budget/{axis}_share"][i]
        cells.append(f"{_number(result[f'/summary/budget/{axis}'][i])} ({_number(share, 1)} %)")
    return ", ".join(cells)


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
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    for name, _ in results:
        table.add_column(name)

    def row(label: str, cell: Any) -> None:
        table.add_row(label, *(cell(r) for _, r in results))

    def section(title: str, shown: Callable[[Result], str] = lambda _: "") -> None:
        table.add_row(f"[bold]{title}[/bold]", *(f"[dim]{escape(shown(r))}[/dim]" for _, r in results))

    row("runs", runs_of)
    row("fixes", _fixes)
    row("fix epochs without a fix", lambda r: str(int(r["/summary/count/epochs_without_fix"])))
    section("Geometry on the glide (mean, min - max)")
    for name in ("pdop", "hdop", "vdop", "gdop", "tdop"):

        def dop(r: Result, name: str = name) -> str:
            mean, low, high = r[f"/summary/dop/{name}"][:3]
            return f"{_number(mean, 2)}  ({_number(low, 2)} - {_number(high, 2)})" if np.isfinite(mean) else "-"

        row("  " + name.upper(), dop)
    section("Fix, RMS by its covariance, mean on the glide, m")
    for name in ("horizontal", "vertical", "3d"):
        row(f"  {name}", lambda r, n=name: _number(r[f"/summary/fix/rms_{n}"][0], 2))

    def columns(result: Result, value: str) -> str:
        return value + (" [95 %]" if result["/run"].size > 1 else "") + ", σ of the filter"

    section("Filter, errors over 20 s to touchdown", lambda r: columns(r, "RMS"))
    for name in ("horizontal", "vertical"):
        row(f"  {name} position, m", lambda r, n=name: _late(r, n))
    for path, axes, unit, scale in (
        ("velocity_ned", ("velocity north", "velocity east", "velocity down"), "m/s", 1.0),
        ("attitude_rpy", ("roll", "pitch", "heading"), "deg", _DEGREE),
    ):
        for i, axis in enumerate(axes):
            row(f"  {axis}, {unit}", lambda r, p=path, i=i, s=scale: _late(r, p, i, s))
    labels = ("touchdown", "50 ft", "100 ft", "200 ft")
    section("Filter, position error at height, m", lambda r: columns(r, "truth - estimate" if single(r) else "RMS"))
    for i, label in enumerate(labels):
        for name in ("lateral", "along", "vertical"):
            row(f"  {label}, {name}", lambda r, n=name, i=i: _at(r, n, i))

    def levels(result: Result) -> str:
        return "" if single(result) else "  ".join(f"{p} %" for p in result["/summary/percentile"]) + " of runs below"

    if not all(single(r) for _, r in results):
        section("Size of the position error, m", levels)
        for name in ("horizontal", "vertical"):
            row(f"  {name}, RMS over 20 s", lambda r, n=name: _percentiles(r, f"/summary/rms/{n}_percentile"))
        for i, label in enumerate(labels):
            for name in ("lateral", "along", "vertical"):
                path = f"/summary/at/{name}_percentile"
                row(f"  {label}, {name}", lambda r, p=path, i=i: _percentiles(r, p, i))
    section("Consistency (mean per degree of freedom, 1 is right)")
    counts = sorted(
        {int(r.variables["/summary/consistency/nees"].attributes["degrees_of_freedom"]) for _, r in results}
    )
    row(f"  NEES, {' or '.join(map(str, counts))} states", lambda r: _unit_mean(r, "nees"))
    row("  NEES, position and velocity", lambda r: _unit_mean(r, "nees_position_velocity"))
    row("  NIS", lambda r: _unit_mean(r, "nis"))
    flown = next((r for _, r in results if "/summary/coverage/level" in r), None)
    if flown is not None:
        for i, name in enumerate(flown["/summary/consistency/group"]):
            row(f"  NEES of {str(name).replace('_', ' ')}, last 20 s", lambda r, i=i: _group(r, i))
        for i, level in enumerate(flown["/summary/coverage/level"]):
            row(f"  share of position within {level:g}σ", lambda r, i=i: _coverage(r, i))
    analysed = next((r for _, r in results if "/summary/budget/source" in r), None)
    if analysed is not None:
        section("Error budget, same 20 s: horizontal, vertical, m (share of mean square)")
        for i, name in enumerate(analysed["/summary/budget/source"]):
            row(f"  {str(name).replace('_', ' ')}", lambda r, i=i: _budget(r, i))
    return table


LONG = ("/summary/consistency/time",)
"""In the summary of a file, but no summary."""


def plain_tree(result: Result, prefixes: tuple[str, ...]) -> dict[str, Any]:
    """The variables whose paths start with one of the prefixes as nested plain data; nan becomes null."""
    out: dict[str, Any] = {}
    for path, variable in result.variables.items():
        if path.startswith(prefixes) and path not in LONG:
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
