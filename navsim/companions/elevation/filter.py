"""The MLS elevation filter: models of the angle's acceleration, and its errors over many runs.

The acceleration of the angle is exponentially correlated, 1 sigma s and time tau. Filter models:

    paper   [beta, beta'], the acceleration white, Q = diag(0, q T) with q = 2 s^2 tau: the first power of T alone
    full    the same with all powers, q [T^3/3 T^2/2; T^2/2 T]
    singer  [beta, beta', a], exact

Source: `docs/theory/elevation.md`, sections 2, 3. Degrees throughout.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.companions.kalman import singer
from navsim.compiler.jit import kernel


@dataclass(frozen=True)
class Model:
    """x(k+1) = phi x(k) + root w(k), y = h x + noise of variance r (deg2); root (n, m), q = root root'. r: (1, 1), or
    (k, 1, 1) where it changes from step to step."""

    phi: np.ndarray
    root: np.ndarray
    h: np.ndarray
    r: np.ndarray

    @property
    def q(self) -> np.ndarray:
        """Covariance of the process noise (n, n)."""
        return self.root @ self.root.T


def model(kind: str, period: float, rate_variance: float, correlation_time: float, r: float) -> Model:
    """One of the models; rate_variance: of the rate's increment over a period, (deg/s)^2, the paper's Q = q T."""
    h, noise = np.array([[1.0, 0.0]]), np.array([[r]])
    phi = np.array([[1.0, period], [0.0, 1.0]])
    if kind == "paper":
        return Model(phi, np.array([[0.0], [np.sqrt(rate_variance)]]), h, noise)
    q = rate_variance / period
    if kind == "full":
        third, half = period**3 / 3.0, period**2 / 2.0
        return Model(phi, np.linalg.cholesky(q * np.array([[third, half], [half, period]])), h, noise)
    alpha = 1.0 / correlation_time
    phi, covariance = singer(period, alpha, float(np.sqrt(0.5 * q / correlation_time)))
    # nearly singular for a short period: a root by eigenvalues, not by Cholesky
    values, vectors = np.linalg.eigh(covariance)
    return Model(phi, vectors * np.sqrt(np.maximum(values, 0.0)), np.array([[1.0, 0.0, 0.0]]), noise)


def first_order(angle_variance: float, r: float) -> Model:
    """The first-order model [beta]: the angle itself is a random walk, angle_variance deg2 a period."""
    return Model(np.eye(1), np.array([[np.sqrt(angle_variance)]]), np.eye(1), np.array([[r]]))


@kernel
def fly(rng, phi, root, sigma, gains, root_p0, error, innovation):
    """One run of truth and filter under the same model.

    phi (n, n), root (n, m), sigma deg, gains (k, n), root_p0 (n, n) root of P(0). Out: error (k, n) truth - estimate
    after each update, innovation (k,). Truth and estimate enter through their difference alone, which is exact
    for a linear filter.
    """
    n, m = root.shape
    steps = gains.shape[0]
    e, moved, w = np.zeros(n), np.empty(n), np.empty(m)
    for j in range(n):
        draw = rng.standard_normal()
        for i in range(n):
            e[i] += root_p0[i, j] * draw
    for k in range(steps):
        for j in range(m):
            w[j] = rng.standard_normal()
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += phi[i, j] * e[j]
            for j in range(m):
                t += root[i, j] * w[j]
            moved[i] = t
        nu = moved[0] + sigma * rng.standard_normal()
        innovation[k] = nu
        for i in range(n):
            e[i] = moved[i] - gains[k, i] * nu
            error[k, i] = e[i]


@kernel
def follow(phi, gains, x, angle, estimate):
    """The filter on a given noise-free angle (k,), from the estimate x (n,); estimate (k, n) out."""
    n = x.shape[0]
    moved = np.empty(n)
    for k in range(angle.shape[0]):
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += phi[i, j] * x[j]
            moved[i] = t
        nu = angle[k] - moved[0]
        for i in range(n):
            x[i] = moved[i] + gains[k, i] * nu
            estimate[k, i] = x[i]
