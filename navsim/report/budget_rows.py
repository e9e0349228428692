"""Rows of the error budget."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from navsim.report.result_cells import index_of, names_at
from navsim.report.table import ABSENT, Cell
from navsim.results.result import Result

SOURCES = "/summary/budget/source"


_SMALL_SHARE = 0.005
"""Share of the mean square error below which sources are summed."""


def _shares(result: Result, name: str) -> tuple[float, float]:
    """Shares of a source in the horizontal and vertical mean square error; 0 for one that a result lacks."""
    i = index_of(result, SOURCES, name)
    if i is None:
        return 0.0, 0.0
    horizontal, vertical = (float(result[f"/summary/budget/{axis}_share"][i]) for axis in ("horizontal", "vertical"))
    return horizontal, vertical


def source_title(name: str) -> str:
    """Name of a source of error in reports."""
    return (
        name.replace("satellite_lasting_", "time-correlated ")
        .replace("orbit_clock", "orbits, clocks")
        .replace("_markov", " in-run bias")
        .replace("_", " ")
    )


def budget_rows(results: Sequence[Result], every: bool = False) -> dict[str, list[str]]:
    """Sources of the error budget by the names of their rows: the largest of any result first, small ones last, summed
    unless `every` is asked for."""
    largest = {name: max(max(_shares(r, name)) for r in results) for name in names_at(results, SOURCES)}
    order = sorted(largest, key=lambda name: -largest[name])
    least = 0.0 if every else _SMALL_SHARE
    out = {source_title(name): [name] for name in order if largest[name] >= least}
    rest = [name for name in order if largest[name] < least]
    return out | ({f"{len(rest)} others, below {100 * _SMALL_SHARE:g} % each": rest} if rest else {})


def budget_cell(result: Result, names: Sequence[str]) -> Cell | str:
    """Sum of the sources, horizontal and vertical, m, and their share of the mean square, %."""
    found = [i for name in names if (i := index_of(result, SOURCES, name)) is not None]
    if not found:
        return ABSENT
    values = []
    for axis in ("horizontal", "vertical"):
        share = 100.0 * float(np.sum(result[f"/summary/budget/{axis}_share"][found]))
        values += [math.sqrt(float(np.sum(result[f"/summary/budget/{axis}"][found] ** 2))), share]
    names = tuple(f"{axis}{what}" for axis in ("horizontal", "vertical") for what in ("", ", share"))
    return Cell("{:.3f} ({:.1f} %), {:.3f} ({:.1f} %)", tuple(values), names=names)
