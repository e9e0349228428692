"""Heights of the ground at the points of a grid of latitudes and longitudes.

Source: `docs/theory/interference.md`, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.geodesy.earth import llh_from_ecef


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Ground between the points of a grid, bilinear in each cell."""

    north: float
    """Latitude of the first row, rad."""
    west: float
    """Longitude of the first column, rad."""
    down: float
    """From row to row, to the south, rad."""
    right: float
    """From column to column, to the east, rad."""
    height: np.ndarray
    """(r, c) float32, m above the ellipsoid; nan where it is unknown."""

    @cached_property
    def highest(self) -> np.ndarray:
        """The highest point of each block of cells, see `height_kernels.lines_below`; -inf without any."""
        from navsim.geodesy.height_kernels import BLOCK

        rows, columns = self.height.shape
        starts = [np.arange(0, n - 1, BLOCK) for n in (rows, columns)]
        known = np.where(np.isnan(self.height), -np.inf, self.height)
        # a block has the points on all of its edges
        tall = np.stack([known[i : i + BLOCK + 1].max(axis=0) for i in starts[0]])
        return np.stack([tall[:, j : j + BLOCK + 1].max(axis=1) for j in starts[1]], axis=1).astype(float)

    @cached_property
    def _corner(self) -> np.ndarray:
        return np.array([self.north, self.west, self.down, self.right, self.highest.max()])

    def at(self, llh: np.ndarray) -> np.ndarray:
        """Height of the ground (...), m, at places (..., 2 or 3), rad; nan outside of the grid, and beside unknown
        points."""
        rows, columns = self.height.shape
        east = np.remainder(llh[..., 1] - self.west + np.pi, 2.0 * np.pi) - np.pi
        y, x = (self.north - llh[..., 0]) / self.down, east / self.right
        inside = (y >= 0.0) & (y <= rows - 1) & (x >= 0.0) & (x <= columns - 1)
        i = np.clip(np.where(inside, y, 0.0).astype(np.int64), 0, rows - 2)
        j = np.clip(np.where(inside, x, 0.0).astype(np.int64), 0, columns - 2)
        y, x = y - i, x - j
        h = self.height
        top = h[i, j] * (1.0 - x) + h[i, j + 1] * x
        return np.where(inside, top * (1.0 - y) + (h[i + 1, j] * (1.0 - x) + h[i + 1, j + 1] * x) * y, np.nan)

    def mark_below(self, antenna: np.ndarray, places: np.ndarray, out: np.ndarray) -> None:
        """Set `out` (e, s) where the ground is above the straight line from an antenna (e, 3) to one of the places
        (e, s, 3), or (1, s, 3), ECEF, m."""
        from navsim.geodesy.height_kernels import lines_below

        lines_below(self.height, self.highest, self._corner, antenna, places, out)

    def profile(self, place: np.ndarray, antenna: np.ndarray, steps: int) -> np.ndarray:
        """Ground over the straight line (e, steps - 1), m, at equal shares of the way from a place (3,) to antennas
        (e, 3), ECEF, m; -inf where it is unknown."""
        share = np.arange(1, steps) / steps
        llh = llh_from_ecef(place + share[:, None] * (antenna - place)[:, None])
        over = self.at(llh) - llh[..., 2]
        return np.where(np.isnan(over), -np.inf, over)
