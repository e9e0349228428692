"""Straight lines of sight over a grid of heights.

Between its points the ground is bilinear. Along a straight line the ground's height over the line is then a parabola in
each cell, so that its top is exact and not sampled.

Source: `docs/theory/interference.md`, section 3.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel
from navsim.geodesy.earth_kernels import ecef_to_llh, wrap_angle

BLOCK = 16
"""Cells along the side of a block, whose highest point is known."""
_PIECE = 500.0
"""Length of the pieces of a line that are straight in latitude and longitude, m: its middle is then off by 3 cm at
most at a latitude of 80 degrees, beside less than 1 mm in height."""
_GRAZED = 0.05
"""Depth of a line in the ground up to which it passes, m: an antenna on the ground is not under it."""
_RADIUS = 6371e3
"""Of the Earth, m, for the sagitta of a piece."""


@kernel
def _place(at, corner, out):
    """A point, ECEF, m, as row and column of a grid, and height, m; corner: see `lines_below`."""
    ecef_to_llh(at[0], at[1], at[2], out)
    out[0] = (corner[0] - out[0]) / corner[2]
    out[1] = wrap_angle(out[1] - corner[1]) / corner[3]


@kernel
def _may_be_below(a, b, highest):
    """Whether the highest points of the blocks about a piece reach the height of its lower end."""
    rows, columns = highest.shape
    first = max(math.floor(min(a[0], b[0])) // BLOCK, 0)
    last = min(math.floor(max(a[0], b[0])) // BLOCK, rows - 1)
    left = max(math.floor(min(a[1], b[1])) // BLOCK, 0)
    right = min(math.floor(max(a[1], b[1])) // BLOCK, columns - 1)
    low = min(a[2], b[2]) - 0.1
    for i in range(first, last + 1):
        for j in range(left, right + 1):
            if highest[i, j] >= low:
                return True
    return False


@kernel
def _over(height, i, j, y, x):
    """Height of the ground, m, at a share y, x of cell i, j."""
    top = height[i, j] * (1.0 - x) + height[i, j + 1] * x
    return top * (1.0 - y) + (height[i + 1, j] * (1.0 - x) + height[i + 1, j + 1] * x) * y


@kernel
def _next_line(start, step, u):
    """The share of a piece, beyond u, at which a coordinate that is `start` + u `step` is next an integer."""
    if step == 0.0:
        return 1.0
    at = start + u * step
    line = math.floor(at + 1e-9) + 1.0 if step > 0.0 else math.ceil(at - 1e-9) - 1.0
    return min((line - start) / step, 1.0)


@kernel
def _piece_below(height, a, b, bow):
    """Whether the ground is above a piece from a to b, each row, column and height, m; bow: its sagitta, m."""
    rows, columns = height.shape
    dr, dc, dh = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    u = 0.0
    while u < 1.0:
        v = min(_next_line(a[0], dr, u), _next_line(a[1], dc, u))
        mid = 0.5 * (u + v)
        i, j = math.floor(a[0] + mid * dr), math.floor(a[1] + mid * dc)
        if 0 <= i < rows - 1 and 0 <= j < columns - 1:
            # the ground over the line at both ends and the middle: the parabola through them is exact
            f0, f1, f2 = 0.0, 0.0, 0.0
            for k in range(3):
                w = u if k == 0 else mid if k == 1 else v
                ground = _over(height, i, j, a[0] + w * dr - i, a[1] + w * dc - j)
                over = ground - (a[2] + w * dh - 4.0 * bow * w * (1.0 - w)) - _GRAZED
                if k == 0:
                    f0 = over
                elif k == 1:
                    f1 = over
                else:
                    f2 = over
            if f0 > 0.0 or f1 > 0.0 or f2 > 0.0:
                return True
            bend, slope = f0 - 2.0 * f1 + f2, f2 - f0
            if bend < 0.0 and abs(slope) < -2.0 * bend and f1 - slope * slope / (8.0 * bend) > 0.0:
                return True
        u = v
    return False


@kernel
def lines_below(height, highest, corner, antenna, places, out):
    """Which straight lines from antennas to places pass below the ground of a grid.

    - `height` (r, c) float32: m above the ellipsoid, rows from north to south; nan hides nothing.
    - `highest` (br, bc): the highest point of each block of `BLOCK` cells, with its edges, m.
    - `corner` (5,): latitude of the first row, longitude of the first column, steps between rows, to the south, and
      between columns, to the east, rad; the highest of all points, m.
    - `antenna` (e, 3) and `places` (e, s, 3), or (1, s, 3) for all antennas alike, ECEF, m; nan: no line.
    - `out` (e, s) bool, set to True where the ground is above the line, and else left.
    """
    a, b, at = np.empty(3), np.empty(3), np.empty(3)
    for e in range(antenna.shape[0]):
        row = min(e, places.shape[0] - 1)
        for s in range(places.shape[1]):
            way = 0.0
            for k in range(3):
                way += (places[row, s, k] - antenna[e, k]) ** 2
            if out[e, s] or not way > 0.0:
                continue
            way = math.sqrt(way)
            _place(antenna[e], corner, a)
            gone = 0.0
            while gone < way:
                to = min(gone + _PIECE, way)
                for k in range(3):
                    at[k] = antenna[e, k] + to / way * (places[row, s, k] - antenna[e, k])
                _place(at, corner, b)
                if _may_be_below(a, b, highest):
                    level = (to - gone) ** 2 - (b[2] - a[2]) ** 2
                    if _piece_below(height, a, b, max(level, 0.0) / (8.0 * _RADIUS)):
                        out[e, s] = True
                        break
                if b[2] > corner[4] and b[2] > a[2]:
                    break  # it rises above all ground
                a[0], a[1], a[2] = b[0], b[1], b[2]
                gone = to
