"""Small dense linear algebra inside kernels: BLAS would cost more in calls than it saves at 3 to 15 rows.

Source: Golub & Van Loan, Matrix Computations, 4th ed. (2013), algorithm 4.2.1 (Cholesky), 3.1.1 (forward
substitution).
"""

from __future__ import annotations

import math

from navsim.core.jit import kernel


@kernel
def cholesky(a, n):
    """Lower Cholesky factor of the symmetric a (n, n), read and written in its lower triangle.

    Returns False, with `a` spoiled, where a pivot falls below 1e-14 of its diagonal element: not positive
    definite, or singular to working precision.
    """
    for i in range(n):
        floor = 1e-14 * a[i, i]
        for j in range(i + 1):
            t = a[i, j]
            for k in range(j):
                t -= a[i, k] * a[j, k]
            if i == j:
                if not t > floor or not t > 0.0:
                    return False
                a[i, i] = math.sqrt(t)
            else:
                a[i, j] = t / a[j, j]
    return True


@kernel
def solve_lower(l, n, x):
    """x <- L^-1 x, in place."""
    for i in range(n):
        t = x[i]
        for k in range(i):
            t -= l[i, k] * x[k]
        x[i] = t / l[i, i]


@kernel
def solve_cholesky(l, n, x):
    """x <- (L L')^-1 x, in place."""
    solve_lower(l, n, x)
    for i in range(n - 1, -1, -1):
        t = x[i]
        for k in range(i + 1, n):
            t -= l[k, i] * x[k]
        x[i] = t / l[i, i]


@kernel
def invert_spd(a, n, out):
    """out = a^-1 of the symmetric positive definite a (n, n), which is spoiled; False if it is not one."""
    if not cholesky(a, n):
        return False
    invert_factored(a, n, out)
    return True


@kernel
def invert_factored(l, n, out):
    """out = (L L')^-1."""
    for j in range(n):
        for i in range(n):
            out[j, i] = 0.0
        out[j, j] = 1.0
        solve_cholesky(l, n, out[j])


@kernel
def invert3(a, out):
    """out = a^-1 of a regular (3, 3) matrix, by cofactors."""
    c0 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c1 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c2 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    d = 1.0 / (a[0, 0] * c0 + a[0, 1] * c1 + a[0, 2] * c2)
    out[0, 0] = c0 * d
    out[1, 0] = c1 * d
    out[2, 0] = c2 * d
    out[0, 1] = (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) * d
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) * d
    out[2, 1] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) * d
    out[0, 2] = (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) * d
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) * d
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) * d
