"""Which estimate of a quantity to take: plain, or controlled by first-order errors."""

from __future__ import annotations

import numpy as np

from navsim.results.builder import ResultBuilder
from navsim.results.result import Result

BRANCH = "/summary/controlled"
"""Group of the controlled estimates, under the names of the plain ones in /summary."""


def estimate(tree: Result | ResultBuilder, path: str, *at: int) -> np.ndarray:
    """An estimate of /summary with its interval (3,): the controlled one if its interval is narrower, else the plain
    one; at: its place among several."""
    controlled = path.replace("/summary", BRANCH, 1)
    if f"{controlled}_gain" in tree and float(tree[f"{controlled}_gain"][at]) > 1.0:
        return np.asarray(tree[controlled][at])
    return np.asarray(tree[path][at])
