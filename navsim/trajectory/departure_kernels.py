"""Deviations of runs in lanes between the samples where they are known."""

from __future__ import annotations

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import as_simd


@kernel
def interpolate(first, since, steps, way, turn, out_way, out_turn):
    """Deviations of lanes at times: the quintic, and the cubic of attitude, of the samples on both sides.

    - `first` (m,): the sample before each time; `since` (m,): time since then, s.
    - `steps` (4,): powers 1 to 4 of the time between samples, s.
    - `way` (k, 9), `turn` (k, 6): see `PathDeviation`. Written: `out_way` (m, 9), `out_turn` (m, 6).
    """
    way, turn, out_way, out_turn = as_simd(way), as_simd(turn), as_simd(out_way), as_simd(out_turn)
    h, h2, h3, h4 = steps[0], steps[1], steps[2], steps[3]
    for m in range(first.shape[0]):
        k, s = first[m], since[m]
        for i in range(3):
            p0, v0, a0 = way[k, i], way[k, 3 + i], way[k, 6 + i]
            v1 = way[k + 1, 3 + i]
            away, b0, b1 = way[k + 1, i] - p0, 0.5 * h * a0, 0.5 * h * way[k + 1, 6 + i]
            c3 = (10.0 * away / h - 6.0 * v0 - 4.0 * v1 - 3.0 * b0 + b1) / h2
            c4 = (-15.0 * away / h + 8.0 * v0 + 7.0 * v1 + 3.0 * b0 - 2.0 * b1) / h3
            c5 = (6.0 * away / h - 3.0 * (v0 + v1) - b0 + b1) / h4
            out_way[m, i] = p0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))
            out_way[m, 3 + i] = v0 + s * (a0 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))
            out_way[m, 6 + i] = a0 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))
            p0, v0, v1 = turn[k, i], turn[k, 3 + i], turn[k + 1, 3 + i]
            away = turn[k + 1, i] - p0
            c2, c3 = (3.0 * away / h - 2.0 * v0 - v1) / h, (-2.0 * away / h + v0 + v1) / h2
            out_turn[m, i] = p0 + s * (v0 + s * (c2 + s * c3))
            out_turn[m, 3 + i] = v0 + s * (2.0 * c2 + s * 3.0 * c3)
