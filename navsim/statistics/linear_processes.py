"""Linear processes driven by white noise, in exact steps: transition, noise and stationary covariance.

x' = A x + b n, n white of unit two-sided density (unit2/Hz). Sources: [1] Van Loan, Computing integrals involving the
matrix exponential, IEEE Trans. Automatic Control 23 (1978). [2] Golub & Van Loan, Matrix Computations, 4th ed. (2013),
section 9.3 (scaling and squaring).
"""

from __future__ import annotations

import math

import numpy as np

_TERMS = 14
"""Terms of the series of the exponential of a matrix of norm up to 1/2: the rest is below 1e-16."""
_NODES = 8
"""Nodes of a Gauss-Legendre rule over a piece on which the exponential rotates by at most one."""


def exponential(a: np.ndarray) -> np.ndarray:
    """The exponential of matrices (..., n, n), by scaling and squaring [2]."""
    norm = float(np.abs(a).sum(axis=-1).max(initial=0.0))
    halvings = max(0, math.ceil(math.log2(norm)) + 1) if norm > 0.0 else 0
    scaled = a / 2.0**halvings
    term = np.broadcast_to(np.eye(a.shape[-1]), a.shape)
    out = term.copy()
    for k in range(1, _TERMS + 1):
        term = term @ scaled / k
        out = out + term
    for _ in range(halvings):
        out = out @ out
    return np.asarray(out)


def discretised(a: np.ndarray, b: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition (n, n) over a step, s, and a root (n, n) of the covariance of the noise in it; a (n, n), b (n,).

    The covariance is the integral of [1], by quadrature of its factor. Quadrature of its square would lose the smallest
    directions in rounding.
    """
    n = a.shape[0]
    pieces = max(1, math.ceil(float(np.abs(a).sum(axis=1).max()) * step))
    points, shares = np.polynomial.legendre.leggauss(_NODES)
    width = step / pieces
    times = (width * (np.arange(pieces)[:, None] + 0.5 * (1.0 + points))).ravel()
    weights = np.tile(0.5 * width * shares, pieces)
    factor = np.sqrt(weights)[:, None] * (exponential(a * times[:, None, None]) @ b)
    root = np.asarray(np.linalg.qr(factor, mode="r")).T
    signs = np.where(np.diagonal(root) < 0.0, -1.0, 1.0)
    return exponential(a * step), root[:, :n] * signs


def stationary(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The covariance (n, n) that the process has had for ever: A P + P A' + b b' = 0; a must be stable."""
    n, one = a.shape[0], np.eye(a.shape[0])
    p = np.linalg.solve(np.kron(a, one) + np.kron(one, a), -np.outer(b, b).ravel()).reshape(n, n)
    return np.asarray(0.5 * (p + p.T))
