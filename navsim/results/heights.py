"""Heights above the runway at which errors of landings are evaluated: `HEIGHTS`, then those that requirements add."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from navsim.geodesy.earth import FOOT
from navsim.results.schema import HEIGHTS


def height_m(name: str) -> float:
    """Height of one of `HEIGHTS`, or of a name such as 30m, m."""
    return FOOT * HEIGHTS[name] if name in HEIGHTS else float(name.removesuffix("m"))


def height_names(heights: Sequence[float] | np.ndarray) -> list[str]:
    """Names of the heights of a result (h,), m."""
    return [*HEIGHTS, *(f"{height:g}m" for height in heights[len(HEIGHTS) :])]


def spoken_height(name: str) -> str:
    """Name of a height with a space before its unit."""
    return re.sub(r"(?<=\d)(ft|m)$", r" \1", name)
