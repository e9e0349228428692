"""Rows of the summary table with controlled estimates: those from first-order errors of the runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from navsim.report.result_cells import heights_of
from navsim.report.table import ABSENT, Cell, Table
from navsim.results.estimates import BRANCH
from navsim.results.result import Result
from navsim.results.schema import RMS_WINDOW, RUNWAY_AXES
from navsim.statistics.rounding import digits

_MILLION, _MOST = 1e6, 1e9
_NO_GAIN = "no better"
"""Cell of an estimate whose interval the first-order errors do not make narrower."""


def controlled_rows(table: Table, results: Sequence[tuple[str, Result]]) -> None:
    """Add the section of controlled estimates if a result has any, or the reason why there are none."""
    if not any(_has_branch(result) for _, result in results):
        return
    table.head("RMS by control variates (more precise), m", *("RMS [95 %], equivalent runs" for _ in results))
    names = {f"rms/{part}": f"{part}, {RMS_WINDOW:g} s" for part in ("horizontal", "vertical")}
    for path, label in names.items():
        table.add(f"  {label}", *(_estimate(result, path) for _, result in results))
    for h, height in heights_of([result for _, result in results]).items():
        for axis in RUNWAY_AXES:
            table.add(f"  {height}, {axis}", *(_estimate(result, f"at/{axis}", h) for _, result in results))
    if any(f"{BRANCH}/box/probability" in result for _, result in results):
        table.add("  outside the box", *(_estimate(result, "box/probability") for _, result in results))
    if any(why_none(result) for _, result in results):
        table.add("  none, because", *(why_none(result) or ABSENT for _, result in results))


def why_none(result: Result) -> str:
    """Why a result of many runs has no controlled estimates; "" if it has them, or has few runs."""
    path = f"{BRANCH}/why_none"
    return str(result[path]) if path in result else ""


def _has_branch(result: Result) -> bool:
    return f"{BRANCH}/rms/horizontal" in result or bool(why_none(result))


def _estimate(result: Result, name: str, *at: int) -> Cell | str:
    """An estimate with its interval, and the number of runs that would be as precise without control."""
    path = f"{BRANCH}/{name}"
    if path not in result:
        return ABSENT
    values, gain = result[path][at], float(result[f"{path}_gain"][at])
    if not np.isfinite(values).all():
        return ABSENT
    if not gain > 1.0:
        return _NO_GAIN
    names = ("probability" if name.startswith("box") else "rms", "", "", "as good as")
    value, low, high = map(float, values)
    shown = (value, low, high, as_good_as(result, gain))
    number = f"{{:.{_decimals(max(high - value, value - low), 5 if name.startswith('box') else 4)}f}}"
    return Cell(f"{number}  [{number}, {number}]  {{}}", shown, ends=True, names=names, units=("", "", "", "1"))


def _decimals(half: float, most: int) -> int:
    """Digits after the point, so many at most, that show half an interval with two significant digits."""
    return most if half <= 0.0 else min(most, max(2, 1 - math.floor(math.log10(half))))


def as_good_as(result: Result, gain: float) -> str:
    """Number of runs that would be as precise without control, to two digits, at most 1e9: see `Controlled`."""
    runs = gain * result["/run"].size
    if not math.isfinite(runs):
        return "any number"
    if runs > _MOST:
        return "over 1000 million"
    if runs >= _MILLION:
        return f"{float(f'{digits(runs / _MILLION, 2)}'):.15g} million"
    unit = 10 ** max(0, math.floor(math.log10(runs)) - 1)
    return f"{round(runs / unit) * unit:,}".replace(",", " ")
