"""DOPs of many placements of pseudolites along one approach.

The satellites' part of the normal matrix (`gnss.dop.normals`) depends on the epoch only. The pseudolites' part depends
on the placement and the point of the approach only. Without the clocks a 3 x 3 matrix remains,

    C = sum over clocks of A_g - b_g b_g' / n_g,        A = sum w u u', b = sum w u, n = sum w,

and its inverse is closed form. Only VDOP depends on the axes, so the computation stays in ECEF: the trace of the
inverse gives PDOP, up' C^-1 up gives VDOP, the difference HDOP. Each SIMD lane holds a placement. Quantities of the
epoch are computed once. Square roots and divisions take most of the time; independent work hides their latency.

Source: `docs/theory/landing.md`, section 6.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import as_simd, fma, small_matrix, where
from navsim.gnss.dop import SINGULAR

PDOP, HDOP, VDOP = 0, 1, 2
MEAN, SMALLEST, LARGEST = 0, 1, 2

# contribution of the satellites at one epoch, a row of `satellites`
SAT_A = 0
"""C of the clocks the pseudolites do not keep plus A of the one they keep: xx, yx, yy, zx, zy, zz."""
SAT_B = 6
"""b of the satellites on the pseudolites' clock."""
SAT_WEIGHT = 9
"""Their n, 0 without satellites."""
SAT_N = 10

# a ridge that hides pseudolites, a row of `ridges`
EDGE_FIRST = 0
"""First end of its top, x, y, z."""
EDGE_ACROSS = 3
"""Unit vector normal to its vertical plane."""
EDGE_ALONG = 6
"""Level vector along the ridge: 1 per length from its first to its last end."""
EDGE_UP = 9
"""Unit vector up."""
EDGE_RISE = 12
"""Height of the last end above the first."""
EDGE_N = 13

# common data of the placements at one epoch, weights in units of a pseudolite's where one is received
_AT = 0
"""Receiver, x, y, z."""
_A = 3
"""See SAT_A."""
_B = 9
"""See SAT_B."""
_SHARED = 12
"""-1/n, with the pseudolites on it; 0 for a clock without sources."""
_UP = 13
"""Coefficients of xx, yx, yy, zx, zy, zz in up' M up."""
_VARIANCE = 19
"""Variance of a source of weight 1."""
_HEARD = 20
"""1 where the receiver tracks pseudolites, else 0."""
_SPARE = 21
"""Satellites minus the unknowns without pseudolites."""
_KEPT = 22
"""Weight n of the satellites on the pseudolites' clock."""
_REACH = 23
"""Distance to the horizon."""
_EPOCH = 24
"""Number of the epoch."""
_N = 25

_TILE = 32
"""Epochs of one pass: their C for a register of placements fits into the first-level cache. One loop computes C, the
next one the roots. In a single loop each step of an epoch would wait for the one before."""


@kernel
def _common(receiver, up, reach, spare, satellites, weight, count, out):
    """Rows (e, _N) of what all placements of `count` pseudolites share at an epoch; returns the number of rows.

    Epochs with too few sources get no row. Arguments as of `placement_dops`.
    """
    solvable = 0
    for e in range(receiver.shape[0]):
        heard = count if weight[e] > 0.0 else 0
        unknowns = 1 if heard > 0 and satellites[e, SAT_WEIGHT] == 0.0 else 0
        if spare[e] + heard < unknowns:
            # rounding would hide that the matrix is singular
            continue
        row = out[solvable]
        solvable += 1
        variance = 1.0 / weight[e] if heard > 0 else 1.0
        for i in range(3):
            row[_AT + i] = receiver[e, i]
            row[_B + i] = satellites[e, SAT_B + i] * variance
        for i in range(6):
            row[_A + i] = satellites[e, SAT_A + i] * variance
        total = satellites[e, SAT_WEIGHT] * variance + heard
        row[_SHARED] = -1.0 / total if total > 0.0 else 0.0
        x, y, z = up[e, 0], up[e, 1], up[e, 2]
        row[_UP], row[_UP + 1], row[_UP + 2] = x * x, 2.0 * y * x, y * y
        row[_UP + 3], row[_UP + 4], row[_UP + 5] = 2.0 * z * x, 2.0 * z * y, z * z
        row[_VARIANCE] = variance
        row[_HEARD] = 1.0 if heard > 0 else 0.0
        row[_SPARE] = spare[e]
        row[_KEPT] = satellites[e, SAT_WEIGHT] * variance
        row[_REACH] = reach[e]
        row[_EPOCH] = e
    return solvable


@kernel_inline
def _eliminated(row, sites, places, c):
    """c (6,) <- C of placements at an epoch, xx, yx, yy, zx, zy, zz, with the first `sites` pseudolites."""
    x, y, z = row[_AT], row[_AT + 1], row[_AT + 2]
    xx, yx, yy, zx, zy, zz = row[_A], row[_A + 1], row[_A + 2], row[_A + 3], row[_A + 4], row[_A + 5]
    bx, by, bz = row[_B], row[_B + 1], row[_B + 2]
    for k in range(sites):
        ux = places[k, 0] - x
        uy = places[k, 1] - y
        uz = places[k, 2] - z
        nearness = math.sqrt(1.0 / fma(uz, uz, fma(uy, uy, ux * ux)))
        ux *= nearness
        uy *= nearness
        uz *= nearness
        xx = fma(ux, ux, xx)
        yx = fma(uy, ux, yx)
        yy = fma(uy, uy, yy)
        zx = fma(uz, ux, zx)
        zy = fma(uz, uy, zy)
        zz = fma(uz, uz, zz)
        bx += ux
        by += uy
        bz += uz
    px, py, pz = row[_SHARED] * bx, row[_SHARED] * by, row[_SHARED] * bz
    c[0] = fma(px, bx, xx)
    c[1] = fma(py, bx, yx)
    c[2] = fma(py, by, yy)
    c[3] = fma(pz, bx, zx)
    c[4] = fma(pz, by, zy)
    c[5] = fma(pz, bz, zz)


@kernel_inline
def _along(x, y, z, row, of):
    """The product of a vector and one of a row, from column `of` on."""
    return fma(x, row[of], fma(y, row[of + 1], z * row[of + 2]))


@kernel_inline
def _in_sight(row, ridges, x, y, z, reach):
    """1 where places (x, y, z), ECEF, m, whose own horizon is at a distance `reach`, are seen from a receiver, 0 where
    the Earth or a ridge is before them."""
    dx, dy, dz = x - row[_AT], y - row[_AT + 1], z - row[_AT + 2]
    farthest = row[_REACH] + reach
    seen = where(fma(dz, dz, fma(dy, dy, dx * dx)) > farthest * farthest, 0.0, 1.0)
    for w in range(ridges.shape[0]):
        edge = ridges[w]
        # from the beginning of its top
        px, py, pz = x - edge[EDGE_FIRST], y - edge[EDGE_FIRST + 1], z - edge[EDGE_FIRST + 2]
        rx = row[_AT] - edge[EDGE_FIRST]
        ry = row[_AT + 1] - edge[EDGE_FIRST + 1]
        rz = row[_AT + 2] - edge[EDGE_FIRST + 2]
        there, here = _along(px, py, pz, edge, EDGE_ACROSS), _along(rx, ry, rz, edge, EDGE_ACROSS)
        # where the line of sight goes through its plane, as a share of it, from the place on
        share = there / (there - here)
        begin, low = _along(px, py, pz, edge, EDGE_ALONG), _along(px, py, pz, edge, EDGE_UP)
        beside = fma(share, _along(rx, ry, rz, edge, EDGE_ALONG) - begin, begin)
        height = fma(share, _along(rx, ry, rz, edge, EDGE_UP) - low, low)
        hidden = (there * here < 0.0) & (beside >= 0.0) & (beside <= 1.0) & (beside * edge[EDGE_RISE] > height)
        seen = where(hidden, 0.0, seen)
    return seen


@kernel_inline
def _eliminated_in_sight(row, sites, places, ridges, clear, g, c):
    """`_eliminated` for pseudolites that neither the Earth nor terrain hides; returns whether there are enough
    sources."""
    xx, yx, yy, zx, zy, zz = row[_A], row[_A + 1], row[_A + 2], row[_A + 3], row[_A + 4], row[_A + 5]
    bx, by, bz = row[_B], row[_B + 1], row[_B + 2]
    heard = 0.0
    for k in range(sites):
        seen = _in_sight(row, ridges, places[k, 0], places[k, 1], places[k, 2], places[k, 3])
        if clear.shape[0] > 0:
            seen *= clear[g, int(row[_EPOCH]), k]
        ux = places[k, 0] - row[_AT]
        uy = places[k, 1] - row[_AT + 1]
        uz = places[k, 2] - row[_AT + 2]
        nearness = seen * math.sqrt(1.0 / fma(uz, uz, fma(uy, uy, ux * ux)))
        ux *= nearness
        uy *= nearness
        uz *= nearness
        xx = fma(ux, ux, xx)
        yx = fma(uy, ux, yx)
        yy = fma(uy, uy, yy)
        zx = fma(uz, ux, zx)
        zy = fma(uz, uy, zy)
        zz = fma(uz, uz, zz)
        bx += ux
        by += uy
        bz += uz
        heard += seen
    total = row[_KEPT] + heard
    shared = where(total > 0.0, -1.0 / total, 0.0)
    px, py, pz = shared * bx, shared * by, shared * bz
    c[0] = fma(px, bx, xx)
    c[1] = fma(py, bx, yx)
    c[2] = fma(py, by, yy)
    c[3] = fma(pz, bx, zx)
    c[4] = fma(pz, by, zy)
    c[5] = fma(pz, bz, zz)
    # a clock that pseudolites alone keep is one unknown more
    own = 1.0 if row[_KEPT] == 0.0 else 0.0
    return row[_SPARE] + heard >= where(heard > 0.0, own, 0.0)


@kernel_inline
def _squares(row, c):
    """Squares of PDOP and VDOP, and whether there is a solution; nan without one."""
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    k0 = fma(c2, c5, -c4 * c4)
    k1 = fma(c3, c4, -c1 * c5)
    k2 = fma(c0, c5, -c3 * c3)
    k3 = fma(c1, c4, -c2 * c3)
    k4 = fma(c1, c3, -c0 * c4)
    k5 = fma(c0, c2, -c1 * c1)
    determinant = fma(c0, k0, fma(c1, k1, c3 * k3))
    # as in `dop.well_posed`, from the sources minus their clock unknowns
    squares = k0 + k2 + k5
    solved = (SINGULAR * determinant > (c0 + c2 + c5) * squares) & (squares > 0.0)
    inverse = where(solved, row[_VARIANCE] / determinant, math.nan)
    vertical = fma(row[_UP + 1], k1, fma(row[_UP + 2], k2, row[_UP] * k0))
    vertical = fma(row[_UP + 3], k3, fma(row[_UP + 4], k4, fma(row[_UP + 5], k5, vertical)))
    return squares * inverse, vertical * inverse, solved


@kernel
def placement_dops(
    receiver, up, reach, spare, satellites, weight, ridges, clear, sites, far, room, places, first, last, out, lost
):
    """Statistics of PDOP, HDOP and VDOP over the epochs, for placements in the SIMD registers first ... last - 1.

    - `receiver` (e, 3): ECEF, m; `up` (e, 3): unit vectors, ECEF; `reach` (e,): distance to the horizon, m.
    - `spare` (e,) int: satellites minus the unknowns that they alone determine.
    - `satellites` (e, SAT_N): rows as of SAT_A, SAT_B, SAT_WEIGHT.
    - `weight` (e,): weight of a pseudolite range, 1 or 1/variance; 0 where the receiver tracks no pseudolite.
    - `ridges` (w, EDGE_N): ridges that hide pseudolites, see EDGE_FIRST.
    - `clear` (last - first, e, k) of SIMD lanes: 1 where grids of heights let the antenna see a pseudolite, else 0;
      (0, 0, 0) without grids.
    - `sites` (p, k, 3): ECEF positions of the k pseudolites of each placement, m.
    - `far` (p, k): distance of each to its horizon, m; (0, k) if none can be beyond it.
    - `room` (k, 4, W) and `places` (k, 4) of SIMD lanes: the same work space.
    - `out` (3, 3, g) of SIMD lanes, written: PDOP, HDOP, VDOP by mean, smallest, largest over the epochs with a
      solution; nan if there is none.
    - `lost` (g,) of SIMD lanes, written: number of epochs without a solution.

    Lane l of register g is placement W g + l. Lanes after the last placement repeat it.
    """
    places, clear, out, lost = as_simd(places), as_simd(clear), as_simd(out), as_simd(lost)
    count, width = sites.shape[1], room.shape[2]
    epochs = receiver.shape[0]
    common = np.empty((epochs, _N))
    solvable = _common(receiver, up, reach, spare, satellites, weight, count, common)
    c = small_matrix(places, _TILE, 6)
    for g in range(first, last):
        for lane in range(width):
            p = min(g * width + lane, sites.shape[0] - 1)
            for k in range(count):
                for i in range(3):
                    room[k, i, lane] = sites[p, k, i]
                room[k, 3, lane] = far[p, k] if far.shape[0] > 0 else math.inf
        solutions = 0.0
        p_sum, h_sum, v_sum = 0.0, 0.0, 0.0
        p_low, h_low, v_low = math.inf, math.inf, math.inf
        p_high, h_high, v_high = 0.0, 0.0, 0.0
        for begin in range(0, solvable, _TILE):
            rows = common[begin : min(begin + _TILE, solvable)]
            for e in range(rows.shape[0]):
                heard = count if rows[e, _HEARD] > 0.0 else 0
                if ridges.shape[0] == 0 and far.shape[0] == 0 and clear.shape[0] == 0:
                    _eliminated(rows[e], heard, places, c[e])
                    continue
                enough = _eliminated_in_sight(rows[e], heard, places, ridges, clear, g - first, c[e])
                for i in range(6):
                    c[e, i] = where(enough, c[e, i], math.nan)
            for e in range(rows.shape[0]):
                p_square, v_square, solved = _squares(rows[e], c[e])
                p, h, v = math.sqrt(p_square), math.sqrt(p_square - v_square), math.sqrt(v_square)
                solutions = where(solved, solutions + 1.0, solutions)
                p_sum = where(solved, p_sum + p, p_sum)
                h_sum = where(solved, h_sum + h, h_sum)
                v_sum = where(solved, v_sum + v, v_sum)
                # comparisons with nan are false: a lost epoch does not change the bounds
                p_low = where(p < p_low, p, p_low)
                h_low = where(h < h_low, h, h_low)
                v_low = where(v < v_low, v, v_low)
                p_high = where(p > p_high, p, p_high)
                h_high = where(h > h_high, h, h_high)
                v_high = where(v > v_high, v, v_high)
        lost[g] = epochs - solutions
        some = solutions > 0.0
        for d, total, low, high in (
            (PDOP, p_sum, p_low, p_high), (HDOP, h_sum, h_low, h_high), (VDOP, v_sum, v_low, v_high)
        ):  # fmt: skip
            out[d, MEAN, g] = where(some, total / solutions, math.nan)
            out[d, SMALLEST, g] = where(some, low, math.nan)
            out[d, LARGEST, g] = where(some, high, math.nan)
