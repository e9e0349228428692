"""Rows of the probability of leaving the box."""

from __future__ import annotations

import math

import numpy as np

from navsim.report.result_cells import over_runs, setting
from navsim.report.table import ABSENT, Cell, cell
from navsim.results.result import Result
from navsim.results.schema import RUNWAY_AXES
from navsim.statistics.importance_sampling import LEAST


def outside_box(result: Result) -> np.ndarray:
    """Which runs (r,) of a result end outside its box: of one of an ensemble that one alone."""
    error = result["/summary/box/error_run"]
    within = (result["/summary/box/lower"] <= error) & (error <= result["/summary/box/upper"])
    outside = np.logical_not(within.all(axis=1))
    if "/summary/go_around/time_run" in result:
        outside &= ~(result["/summary/go_around/time_run"] < result["/summary/box/time"])
    return outside


def box_limits(result: Result, axis: int) -> tuple[float, float] | None:
    """The least and the largest error along an axis inside the box, m, if it limits that."""
    low, high = (float(result[f"/summary/box/{end}"][axis]) for end in ("lower", "upper"))
    return (low, high) if math.isfinite(high) else None


def of_total(result: Result) -> bool:
    """Whether a result has a box of total system errors, or of touchdowns."""
    return "/summary/box/upper" in result and setting(result, "box", "error") != "navigation"


def box_head(result: Result, flown: bool) -> str:
    """Heading of the probabilities of leaving a box, with an interval if they come from runs."""
    if "/summary/box/upper" not in result:
        return ""
    interval = " [95 %]" if flown and (result["/run"].size > 1 or "/summary/rare/probability" in result) else ""
    total = ", of total system errors" if of_total(result) else ""
    if setting(result, "box", "error") == "touchdown":
        return f"probability{interval}, where runs touch down"
    height = float(result["/summary/box/height"])
    where = f"{height:g} m above the runway" if height else "at touchdown"
    return f"probability{interval}, {where}{total}"


def box_to_first_order(result: Result, i: int | None) -> Cell | str:
    """The chance that a Gaussian error exceeds its limit; i None: any of them does, at most."""
    chances = result["/summary/box/axis_first_order"]
    value = min(1.0, float(np.nansum(chances))) if i is None else float(chances[i])
    if not np.isfinite(value):
        return ABSENT
    shown = "below {:g}" if value < LEAST else "{:.3g}"
    value = max(value, LEAST)
    if i is None:
        several = np.isfinite(chances).sum() > 1  # the sum is a bound
        text = f"{'at most ' if several else ''}{{:.3g}}  (if Gaussian)" if value > LEAST else shown
        return cell(text, value, names=("probability",))
    where, ends = box_sides(result, i)
    return Cell(f"{shown}  ({where}, if Gaussian)", (value, *ends), names=("probability", *_SIDES[len(ends)]),
                units=("1", *("m" for _ in ends)))  # fmt: skip


_SIDES = {1: ("beyond",), 2: ("from", "to")}
"""Names of the limits of a box, by their number."""


def box_sides(result: Result, i: int) -> tuple[str, tuple[float, ...]]:
    """Sides at which an axis of a box is left: a pattern, and its values."""
    limits = box_limits(result, i)
    assert limits is not None
    low, high = limits
    if i == RUNWAY_AXES.index("along") and "/summary/box/place" in result:
        place = float(result["/summary/box/place"])
        return "outside {:g} to {:g} m from the threshold", (round(low + place, 9), round(high + place, 9))
    return ("beyond {:g} m", (high,)) if low == -high else ("outside {:g} to {:g} m", limits)


def box_cell(result: Result, i: int | None) -> Cell | str:
    """Probability of leaving the box: from a count, or to first order."""
    if "/summary/box/upper" not in result:
        return ABSENT
    if i is None:
        if "/summary/box/probability" not in result:
            return box_to_first_order(result, None)
        return over_runs("{:.3g}", result, result["/summary/box/probability"], "probability")
    if box_limits(result, i) is None:
        return ABSENT
    if "/summary/box/axis_probability" in result:
        one = over_runs("{:.3g}", result, result["/summary/box/axis_probability"][i], "probability")
        where, ends = box_sides(result, i)
        found, pattern = one.values, one.pattern
        names, units = (*one.names, *_SIDES[len(ends)]), (*("1" for _ in found), *("m" for _ in ends))
        of_gaussian = "/summary/box/axis_gaussian"
        chance = float(result[of_gaussian][i]) if of_gaussian in result else math.nan
        if found[0] == 0.0 and math.isfinite(chance):
            shown = "below {:g}" if chance < LEAST else "{:.2g}"
            return Cell(f"{pattern}  ({where}; {shown} if Gaussian)", (*found, *ends, max(chance, LEAST)),
                        ends=one.ends, names=(*names, "Gaussian"), units=(*units, "1"))  # fmt: skip
        return Cell(f"{pattern}  ({where})", (*found, *ends), ends=one.ends, names=names, units=units)
    return box_to_first_order(result, i)
