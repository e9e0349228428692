"""The summary of any result as plain data for JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from navsim.results.result import Result

FINDINGS = "/findings/"
"""Path of the findings in a result."""


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
    """Arrays as nested lists of plain numbers and text; values that are not finite become None."""
    if data.ndim:
        return [_plain(np.asarray(d)) for d in data]
    value = data.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
