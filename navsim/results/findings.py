"""What of a study its user must hear about, as it is kept in `/findings` of the result.

A finding is a warning with counts. It goes to standard error when the study is done, and into the result, so that
whoever opens the file later hears the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.results.draft import ResultBuilder
from navsim.results.result import Result, ResultError, Variable
from navsim.results.schema import FINDINGS, LANDING

FIX, CONSISTENT = "fix", "consistent"
"""What a finding speaks against: that there are fixes (`--require-fix`), that the filter is consistent
(`--require-consistent`)."""


@dataclass(frozen=True)
class Finding:
    """A warning. count: how many of `of` (fixes, outputs, runs, combinations) it is about, in how many runs; first:
    time of the first of them, s, nan where it has none. All 0 and nan for one without counts."""

    name: str
    text: str
    against: tuple[str, ...] = ()
    count: int = 0
    of: int = 0
    runs: int = 0
    first: float = math.nan


def several(count: int, noun: str) -> str:
    """`1 run`, `2 runs`, `2 fixes`."""
    return f"{count} {noun}" + ("" if count == 1 else "es" if noun.endswith("x") else "s")


def kept(found: list[Finding]) -> dict[str, Variable]:
    """The group `/findings` of a result of any sort."""
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
    """The findings kept in a result; none in one of an earlier version. Raises ResultError for a damaged group."""
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
