"""Small dense linear algebra inside kernels: BLAS would cost more in calls than it saves at 3 to 15 rows.

Source: Golub & Van Loan, Matrix Computations, 4th ed. (2013), algorithm 4.2.1 (Cholesky), 3.1.1 (forward
substitution).
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import where


@kernel
def copy(source, target):
    """target <- source (n,)."""
    for i in range(source.shape[0]):
        target[i] = source[i]


@kernel
def copy_matrix(source, target):
    """target <- source (n, m)."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@kernel
def identity(matrix):
    """matrix (n, n) <- I."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 1.0 if i == j else 0.0


@kernel
def cholesky(a, n):
    """Lower Cholesky factor of the symmetric a (n, n), read and written in its lower triangle; returns whether it
    exists.

    A pivot below 1e-14 of its diagonal element means that `a` is not positive definite, or singular to working
    precision. It is replaced by 1, so that later results stay finite.
    """
    good = a[0, 0] > 0.0
    # by columns: elements below a pivot depend only on it
    for j in range(n):
        floor = 1e-14 * a[j, j]
        t = a[j, j]
        for k in range(j):
            t -= a[j, k] * a[j, k]
        positive = (t > floor) & (t > 0.0)
        pivot = math.sqrt(where(positive, t, 1.0))
        a[j, j], reciprocal = pivot, 1.0 / pivot
        good = good & positive
        # four rows at once: none waits for the sums of another
        last = j + 1 + (n - j - 1) // 4 * 4
        for i in range(j + 1, last, 4):
            t, u, v, w = a[i, j], a[i + 1, j], a[i + 2, j], a[i + 3, j]
            for k in range(j):
                b = a[j, k]
                t, u, v, w = t - a[i, k] * b, u - a[i + 1, k] * b, v - a[i + 2, k] * b, w - a[i + 3, k] * b
            a[i, j], a[i + 1, j] = t * reciprocal, u * reciprocal
            a[i + 2, j], a[i + 3, j] = v * reciprocal, w * reciprocal
        for i in range(last, n):
            t = a[i, j]
            for k in range(j):
                t -= a[i, k] * a[j, k]
            a[i, j] = t * reciprocal
    return good


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
