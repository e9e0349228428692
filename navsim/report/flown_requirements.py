"""Verdicts of runs of the best placements or combinations on the base scenario's requirements, as table and as plain
data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from navsim.report.requirement_rows import verdict_cell
from navsim.report.table import ABSENT, Table
from navsim.results.result import Result

_BRANCH = "/flown/requirements"


def flown_requirements(result: Result, title: str, columns: Sequence[str]) -> list[Table | str]:
    """A row for each requirement, a column for each of the flown; none without requirements or runs."""
    if f"{_BRANCH}/verdict" not in result:
        return []
    found_by = "by runs (verdict: value [95 %], by control variates where narrower)"
    out = Table(f"{title}, {found_by}", ("requirement", *columns))
    limits = result[f"{_BRANCH}/limit"]
    for k, statement in enumerate(result[f"{_BRANCH}/statement"]):
        found = (result[f"{_BRANCH}/{name}"][:, k] for name in ("verdict", "value", "more_runs"))
        cells = (
            verdict_cell(str(statement), str(word), value, float(more), float(limits[k])) if word else ABSENT
            for word, value, more in zip(*found, strict=True)
        )
        out.add(str(statement), *cells)
    return [out]


def plain_requirements(result: Result, row: int) -> dict[str, Any]:
    """The verdicts of one of the flown, by the key `requirements`; empty without requirements or runs."""
    if f"{_BRANCH}/verdict" not in result:
        return {}
    each = [
        {
            "statement": str(statement),
            "verdict": str(result[f"{_BRANCH}/verdict"][row, k]),
            "limit": float(result[f"{_BRANCH}/limit"][k]),
            "value": [float(x) if np.isfinite(x) else None for x in result[f"{_BRANCH}/value"][row, k]],
        }
        for k, statement in enumerate(result[f"{_BRANCH}/statement"])
    ]
    return {"requirements": each}
