"""DOPs of many placements of pseudolites along one approach.

The satellites' part of the normal matrix (`core.dop.normals`) depends on the epoch alone, the pseudolites' on placement
and point of the approach alone. With the clocks eliminated what is left is 3 x 3,

    C = sum over clocks of A_g - b_g b_g' / n_g,        A = sum w u u', b = sum w u, n = sum w,

and its inverse is closed form. The variances it gives do not depend on axes but for the vertical, so everything stays
in ECEF: trace of the inverse for PDOP, up' C^-1 up for VDOP, the difference for HDOP. One placement after the other
lies in memory, so that LLVM works on several at once.

Source: `docs/theory/landing.md`, section 6.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.core.jit import kernel

PDOP, HDOP, VDOP = 0, 1, 2
MEAN, SMALLEST, LARGEST = 0, 1, 2
BLOCK = 128
"""Placements worked on at once: their sums stay in the first cache."""

# what the satellites contribute at one epoch, a row of `satellites`
SAT_A = 0
"""C of the clocks the pseudolites do not keep plus A of the one they keep: xx, yx, yy, zx, zy, zz."""
SAT_B = 6
"""b of the satellites on the pseudolites' clock."""
SAT_WEIGHT = 9
"""n of them, 0 where there are none."""
SAT_N = 10

_SINGULAR = 1e-12
"""A determinant below this share of (trace / 3)^3 counts as no solution: DOPs above a hundred thousand."""


@kernel
def _add_site(x, y, z, site_x, site_y, site_z, weight, a, count):
    """Add one pseudolite of each placement of a block to the sums a (10, BLOCK); receiver at x, y, z."""
    xx, yx, yy, zx, zy, zz, bx, by, bz, total = a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9]
    for j in range(count):
        dx = site_x[j] - x
        dy = site_y[j] - y
        dz = site_z[j] - z
        inverse = 1.0 / (dx * dx + dy * dy + dz * dz)
        length = math.sqrt(inverse) * weight
        square = inverse * weight
        xx[j] += square * dx * dx
        yx[j] += square * dy * dx
        yy[j] += square * dy * dy
        zx[j] += square * dz * dx
        zy[j] += square * dz * dy
        zz[j] += square * dz * dz
        bx[j] += length * dx
        by[j] += length * dy
        bz[j] += length * dz
        total[j] += weight


@kernel
def _solve(up_x, up_y, up_z, a, squares, count):
    """Squares of PDOP, HDOP, VDOP (3, BLOCK) from the sums of a block; nan without a solution."""
    xx, yx, yy, zx, zy, zz, bx, by, bz, total = a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8], a[9]
    p, h, v = squares[0], squares[1], squares[2]
    for j in range(count):
        r = 1.0 / max(total[j], 1e-300)
        x, y, z = bx[j], by[j], bz[j]
        c0 = xx[j] - x * x * r
        c1 = yx[j] - y * x * r
        c2 = yy[j] - y * y * r
        c3 = zx[j] - z * x * r
        c4 = zy[j] - z * y * r
        c5 = zz[j] - z * z * r
        k0 = c2 * c5 - c4 * c4
        k1 = c3 * c4 - c1 * c5
        k2 = c0 * c5 - c3 * c3
        k3 = c1 * c4 - c2 * c3
        k4 = c1 * c3 - c0 * c4
        k5 = c0 * c2 - c1 * c1
        determinant = c0 * k0 + c1 * k1 + c3 * k3
        size = (c0 + c2 + c5) / 3.0
        inverse = 1.0 / determinant if determinant > _SINGULAR * size * size * size else math.nan
        position = (k0 + k2 + k5) * inverse
        vertical = (
            up_x * (k0 * up_x + 2.0 * (k1 * up_y + k3 * up_z)) + up_y * (k2 * up_y + 2.0 * k4 * up_z) + up_z * k5 * up_z
        ) * inverse
        p[j] = position
        v[j] = vertical
        h[j] = position - vertical


@kernel
def placement_dops(receiver, up, spare, satellites, sites, weight, first, last, out, lost):
    """Statistics over the epochs of PDOP, HDOP, VDOP for the placements first ... last - 1.

    receiver: (e, 3) ECEF, m. up: (e, 3) unit vectors in ECEF. spare: (e,) int, satellites less the unknowns there
    are without pseudolites. satellites: (e, SAT_N), see SAT_A, SAT_B, SAT_WEIGHT. sites: (k, 3, p) ECEF of the k
    pseudolites of each placement, m. weight: (e,) of their ranges, 1 or 1/variance, 0 where none is heard.
    out: (3, 3, p) written: PDOP, HDOP, VDOP by mean, smallest, largest over the epochs that have a solution, nan
    where none has. lost: (p,) int, written: epochs without a solution.
    """
    a = np.empty((SAT_N, BLOCK))
    squares = np.empty((3, BLOCK))
    for start in range(first, last, BLOCK):
        count = min(BLOCK, last - start)
        end = start + count
        for d in range(3):
            out[d, MEAN, start:end] = 0.0
            out[d, SMALLEST, start:end] = math.inf
            out[d, LARGEST, start:end] = 0.0
        lost[start:end] = 0
        for e in range(receiver.shape[0]):
            heard = sites.shape[0] if weight[e] > 0.0 else 0
            unknowns = 1 if heard > 0 and satellites[e, SAT_WEIGHT] == 0.0 else 0
            if spare[e] + heard < unknowns:
                # rounding would hide that there is nothing to invert
                lost[start:end] += 1
                continue
            for i in range(SAT_N):
                a[i, :count] = satellites[e, i]
            x, y, z = receiver[e, 0], receiver[e, 1], receiver[e, 2]
            for k in range(sites.shape[0]):
                _add_site(
                    x, y, z, sites[k, 0, start:end], sites[k, 1, start:end], sites[k, 2, start:end], weight[e], a, count
                )
            _solve(up[e, 0], up[e, 1], up[e, 2], a, squares, count)
            for d in range(3):
                mean, low, high = out[d, MEAN, start:end], out[d, SMALLEST, start:end], out[d, LARGEST, start:end]
                square = squares[d]
                for j in range(count):
                    root = math.sqrt(square[j])
                    # comparisons with nan are false: a lost epoch leaves the sums as they are
                    mean[j] += root if root == root else 0.0
                    low[j] = root if root < low[j] else low[j]
                    high[j] = root if root > high[j] else high[j]
            misses, square = lost[start:end], squares[0]
            for j in range(count):
                misses[j] += 1 if square[j] != square[j] else 0
        for j in range(start, end):
            solved = receiver.shape[0] - lost[j]
            for d in range(3):
                if solved == 0:
                    out[d, :, j] = math.nan
                else:
                    out[d, MEAN, j] /= solved
