"""Products of the position error as states: the second order of ranges of beacons.

A range is d - u' dr + dr' B dr / 2, B its Hessian. The second-order term lasts as long as the position error: white
noise of its variance, as in the Gaussian second-order filter, would average out. So the six products of dr with itself
are states, and the range is linear in dr and them. Their estimates are means of the products. Errors of a Gaussian dr
with the covariance P have no covariance with dr, and among themselves

    cov(dr_i dr_j, dr_k dr_l) = P_ik P_jl + P_il P_jk                                               (1)

A correction x of the position changes the products to those of dr - x. What a prediction adds to P is independent of
dr before: (1) grows by that of the new P less that of the old one.

Source: `docs/theory/beacons.md`, section 3; Kowalski & Steeb, Nonlinear Dynamical Systems and Carleman Linearization
(1991).
"""

from __future__ import annotations

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import no, small_vector, where
from navsim.filter.states import NAV_SENSORS, POS, SENSORS

FIRST = (0, 1, 2, 0, 0, 1)
"""First axis of each product, north, east, down."""
SECOND = (0, 1, 2, 1, 2, 2)
"""Second axis."""
_COUNT = 6
_NAV = NAV_SENSORS - SENSORS


@kernel
def hold_position(p, held):
    """held (3, 3) <- covariance of position in P (n, n)."""
    for i in range(3):
        for j in range(3):
            held[i, j] = p[POS + i, POS + j]


@kernel
def _informed(first, p):
    """Whether a range has been used: products of a Gaussian error have no covariance with it."""
    return no(p[first, POS] == 0.0)


@kernel
def start_products(first, nav, p):
    """Products of a Gaussian position error as long as no range has been used: estimates in nav (NAV,), and P (n,
    n)."""
    informed = _informed(first, p)
    for a in range(_COUNT):
        i, j = FIRST[a], SECOND[a]
        nav[_NAV + first + a] = where(informed, nav[_NAV + first + a], p[POS + i, POS + j])
        for b in range(_COUNT):
            k, l = POS + FIRST[b], POS + SECOND[b]
            t = p[POS + i, k] * p[POS + j, l] + p[POS + i, l] * p[POS + j, k]
            p[first + a, first + b] = where(informed, p[first + a, first + b], t)
        for c in range(first):
            t = where(informed, p[first + a, c], 0.0)
            p[first + a, c], p[c, first + a] = t, t
        for c in range(first + _COUNT, p.shape[0]):
            t = where(informed, p[first + a, c], 0.0)
            p[first + a, c], p[c, first + a] = t, t


@kernel
def predict_products(first, held, nav, p):
    """After a prediction of P (n, n), whose covariance of position was `held` (3, 3): what it added is independent of
    the error before."""
    more, informed = small_vector(nav, 3), _informed(first, p)
    for i in range(3):
        t = p[POS + i, POS + i] - held[i, i]
        more[i] = where(informed & (t > 0.0), t, 0.0)
        nav[_NAV + first + i] += more[i]
    for a in range(_COUNT):
        i, j = FIRST[a], SECOND[a]
        for b in range(_COUNT):
            for turn in range(2):
                k, l = (SECOND[b], FIRST[b]) if turn else (FIRST[b], SECOND[b])
                # (P + D)_ik (P + D)_jl - P_ik P_jl
                if i == k:
                    p[first + a, first + b] += more[i] * held[j, l]
                    if j == l:
                        p[first + a, first + b] += more[i] * more[j]
                if j == l:
                    p[first + a, first + b] += more[j] * held[i, k]
    start_products(first, nav, p)


@kernel
def move_products(first, x, ranged, nav, p):
    """After a correction x (n,) of the estimate, by a range of a beacon (`ranged`) or another measurement: products of
    the remaining error in nav (NAV,) and P (n, n)."""
    n, d, moved = p.shape[0], small_vector(nav, 3), small_vector(nav, _COUNT)
    informed = _informed(first, p)
    for i in range(3):
        d[i] = x[POS + i] if ranged else where(informed, x[POS + i], 0.0)
    for a in range(_COUNT):
        nav[_NAV + first + a] -= d[FIRST[a]] * d[SECOND[a]]
        for c in range(n):
            p[first + a, c] -= d[FIRST[a]] * p[POS + SECOND[a], c] + d[SECOND[a]] * p[POS + FIRST[a], c]
    for a in range(_COUNT):
        row = p[first + a]
        for b in range(_COUNT):
            moved[b] = d[FIRST[b]] * row[POS + SECOND[b]] + d[SECOND[b]] * row[POS + FIRST[b]]
        for b in range(_COUNT):
            row[first + b] -= moved[b]
    for a in range(_COUNT):
        for c in range(n):
            if c < first + a or c >= first + _COUNT:
                p[c, first + a] = p[first + a, c]
