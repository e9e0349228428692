"""Fixes of the receiver in lanes, and their residuals.

The solution itself is `navsim.gnss.position_fix`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.gnss.dop import MAX_CLOCKS
from navsim.gnss.position_fix import fixes, residuals
from navsim.gnss.pseudorange import Signals


class ReceiverFixes(NamedTuple):
    """Fixes; nan without a fix. Those of one run have no last axis."""

    llh: np.ndarray
    """(e, 3, W)."""
    velocity: np.ndarray
    """(e, 3, W) NED."""
    clocks: np.ndarray
    """(e, MAX_CLOCKS, W)."""
    covariance: np.ndarray
    """(e, 6, 6, W) of position and velocity."""


def solve_fixes(start: np.ndarray, signals: Signals, ranges: np.ndarray, rates: np.ndarray) -> ReceiverFixes:
    """Fixes from measurements (e, s, W); start: (3,) ECEF, where the iteration begins."""
    shapes: tuple[tuple[int, ...], ...] = ((3,), (3,), (MAX_CLOCKS,), (6, 6))
    out = ReceiverFixes(*(np.empty((ranges.shape[0], *shape, WIDTH)) for shape in shapes))
    # those of some sources have steps, and numba would compile the kernel once more for them
    of_sources = (signals.position, signals.velocity, signals.fix_sigma, signals.fix_rate_sigma)
    fixes(
        start, *map(np.ascontiguousarray, of_sources), signals.time_scale,
        *(in_lanes(m) for m in (ranges, rates, *out)),
    )  # fmt: skip
    return out


def range_residuals(
    signals: Signals, antenna: np.ndarray, axes: np.ndarray, ranges: np.ndarray, llh: np.ndarray, clocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of the ranges (e, s, W) of fixes, m, and sizes of the fix errors, horizontal and vertical (e, 2, W), m.

    - `antenna` (e, 3, W): true position, ECEF, m; `axes` (e, 3, 3): rows east, north, up at the antenna.
    - `llh` (e, 3, W), `clocks` (e, MAX_CLOCKS, W): the fixes.
    """
    left, off = np.empty_like(ranges), np.empty_like(llh)
    residuals(
        np.ascontiguousarray(signals.position), signals.time_scale, in_lanes(antenna), axes,
        *(in_lanes(m) for m in (ranges, llh, clocks, left, off)),
    )  # fmt: skip
    return left, np.stack([np.sqrt(off[:, 0] ** 2 + off[:, 1] ** 2), np.abs(off[:, 2])], axis=1)
