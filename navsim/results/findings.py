"""Findings of a study: warnings with counts, kept in `/findings` of the result.

A finding is printed to standard error when the study is done, and again whenever the result is shown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.results.builder import ResultBuilder
from navsim.results.result import Result, ResultError, Variable
from navsim.results.schema import FINDINGS, LANDING


@dataclass(frozen=True)
class Finding:
    """A warning."""

    name: str
    """Short name."""
    text: str
    """Message."""
    against: tuple[str, ...] = ()
    """Conditions that it violates, `FIX` or `CONSISTENT`."""
    count: int = 0
    """Number of fixes, outputs, runs or combinations concerned; 0 without a count."""
    of: int = 0
    """Number of all of them."""
    runs: int = 0
    """Number of runs concerned."""
    first: float = math.nan
    """Time of the first, s, nan without a time."""


def several(count: int, noun: str) -> str:
    """`1 run`, `2 runs`, `2 fixes`."""
    return f"{count} {noun}" + ("" if count == 1 else "es" if noun.endswith("x") else "s")


def kept(found: list[Finding]) -> dict[str, Variable]:
    """Variables of the group `/findings` of a result."""
    out = ResultBuilder(LANDING)
    for name, kind, values in (
        ("finding", object, [f.name for f in found]),
        ("text", object, [f.text for f in found]),
        ("against", object, [", ".join(f.against) for f in found]),
        ("count", np.int64, [f.count for f in found]),
        ("of", np.int64, [f.of for f in found]),
        ("runs", np.int64, [f.runs for f in found]),
        ("first", np.float64, [f.first for f in found]),
    ):
        out[f"{FINDINGS}/{name}"] = np.array(values, dtype=kind)
    return {path: variable for path, variable in out.variables.items() if path.startswith(FINDINGS)}


def of(result: Result) -> list[Finding]:
    """Findings in a result; empty for an earlier version. Raises ResultError for a damaged group."""
    if "/findings/finding" not in result:
        return []
    names = ("finding", "text", "against", "count", "of", "runs", "first")
    try:
        columns = [np.atleast_1d(result[f"/findings/{name}"]) for name in names]
        return [
            Finding(str(name), str(text), tuple(str(against).split(", ")) if against else (), int(count), int(total),
                    int(runs), float(first))
            for name, text, against, count, total, runs, first in zip(*columns, strict=True)
        ]  # fmt: skip
    except (KeyError, ValueError, TypeError) as error:
        raise ResultError(f"/findings is damaged ({error})") from None
