"""Small dense Kalman filters for the tracking systems, with sequential scalar measurements.

Predict and update are kernels on (n,) and (n, n) arrays; models in continuous time become discrete ones by van Loan's
method. The landing filter has the same steps for its fifteen states with their block structure (`filter.covariance`).

Sources:

- [1] Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.2, 5.4.2, 6.2.
- [2] van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978).
- [3] Singer, Estimating optimal tracking filter performance for manned maneuvering targets, IEEE TAES 6 (1970).
- [4] Anderson, Second-order convergent algorithms for the steady-state Riccati equation, Int. J. Control 28 (1978).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel
from navsim.defect import Defect

_MOST_DECAY = 8.0
"""Correlation times in a period up to which van Loan's method keeps its digits: its error grows by e with each."""
_DOUBLINGS = 200
"""More than enough: 64 for a decay of 1e-12 a step."""


@kernel
def predict(x, p, phi, q, work):
    """x <- Phi x, P <- Phi P Phi' + Q, in place. work: (n, n) space; the first row serves x."""
    n = x.shape[0]
    for i in range(n):
        t = 0.0
        for j in range(n):
            t += phi[i, j] * x[j]
        work[0, i] = t
    for i in range(n):
        x[i] = work[0, i]
    for i in range(n):
        for j in range(n):
            t = 0.0
            for k in range(n):
                t += phi[i, k] * p[k, j]
            work[i, j] = t
    for i in range(n):
        for j in range(i + 1):
            t = q[i, j]
            for k in range(n):
                t += work[i, k] * phi[j, k]
            p[i, j] = t
            p[j, i] = t


@kernel
def update(x, p, index, innovation, variance, gain):
    """Measurement update with state `index`, in place; returns the normalised innovation squared.

    innovation: measured minus predicted, wrapped by the caller if it is an angle. variance: of the measurement's noise.
    gain: (n,) out. Joseph form, exactly symmetric.
    """
    n = x.shape[0]
    s = p[index, index] + variance
    for i in range(n):
        gain[i] = p[i, index] / s
    for i in range(n):
        x[i] += gain[i] * innovation
    # (I - K h) P (I - K h)' + K r K' with h a unit row; row `index` is read until the others are done
    for i in range(n):
        if i == index:
            continue
        for j in range(i + 1):
            if j != index:
                t = p[i, j] - gain[i] * p[index, j] - gain[j] * p[index, i] + gain[i] * gain[j] * s
                p[i, j] = t
                p[j, i] = t
    for j in range(n):
        t = variance * gain[j]
        p[index, j] = t
        p[j, index] = t
    return innovation * innovation / s


def van_loan(f: np.ndarray, diffusion: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi and Q over `period` of x' = F x + w, E[w w'] = diffusion delta(t) [2]."""
    from scipy.linalg import expm

    n = f.shape[0]
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = -f
    block[:n, n:] = diffusion
    block[n:, n:] = f.T
    big = expm(block * period)
    phi = big[n:, n:].T
    q = phi @ big[:n, n:]
    return phi, 0.5 * (q + q.T)


def singer(period: float, alpha: float, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Phi, Q (3, 3) of position, rate and an acceleration of 1 sigma `sigma` and decay `alpha`, 1/s, exact [3].

    Singer's closed form cancels badly for a short period; van Loan's method does not. For a period of many correlation
    times van Loan's method overflows: a short period is doubled then.
    """
    f = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -alpha]])
    doublings = max(0, math.ceil(math.log2(alpha * period / _MOST_DECAY)))
    phi, q = van_loan(f, np.diag([0.0, 0.0, 2.0 * alpha * sigma**2]), period / 2**doublings)
    for _ in range(doublings):
        phi, q = phi @ phi, q + phi @ q @ phi.T
    return phi, q


def singer_sigma(largest: float, share_largest: float, share_none: float) -> float:
    """1 sigma of an acceleration that is +-`largest` with chance `share_largest` each, none with `share_none`, else
    anything between [3]: sqrt(a^2 / 3 (1 + 4 p_max - p_0))."""
    return float(largest * np.sqrt((1.0 + 4.0 * share_largest - share_none) / 3.0))


def covariance_sequence(
    phi: np.ndarray, q: np.ndarray, h: np.ndarray, r: np.ndarray, p0: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """P after the update (k, n, n) and gain (k, n, m) for k = 1 ... steps: predict, then update [1]. r: (m, m), or
    (k, m, m) where it changes from step to step."""
    p = p0
    variances = np.broadcast_to(r, (steps, *r.shape[-2:]))
    covariances, gains = np.empty((steps, *p0.shape)), np.empty((steps, p0.shape[0], h.shape[0]))
    for k in range(steps):
        p = phi @ p @ phi.T + q
        gain = np.linalg.solve(h @ p @ h.T + variances[k], h @ p).T
        keep = np.eye(p.shape[0]) - gain @ h
        p = keep @ p @ keep.T + gain @ variances[k] @ gain.T
        covariances[k], gains[k] = p, gain
    return covariances, gains


def steady_state(phi: np.ndarray, q: np.ndarray, h: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steady-state P after the update (n, n) and gain (n, m), by doubling [4].

    The k-th step is the covariance after 2^k measurements. Unlike solvers by eigenvalues it works if noises differ by
    many powers of ten. Raises Defect if there is no limit.
    """
    n = phi.shape[0]
    a, information, p = phi.T, h.T @ np.linalg.solve(r, h), q
    for _ in range(_DOUBLINGS):
        both = np.linalg.solve(np.eye(n) + information @ p, np.hstack([a, information]))
        grown = p + a.T @ p @ both[:, :n]
        information = information + a @ both[:, n:] @ a.T
        information = 0.5 * (information + information.T)
        a = a @ both[:, :n]
        grown = 0.5 * (grown + grown.T)
        sigma = np.sqrt(np.diag(grown))
        if np.all(np.abs(grown - p) <= 1e-15 * np.outer(sigma, sigma)):
            gain = np.linalg.solve(h @ grown @ h.T + r, h @ grown).T
            keep = np.eye(n) - gain @ h
            return keep @ grown @ keep.T + gain @ r @ gain.T, gain
        p = grown
    raise Defect("the covariance of a filter has no limit")


def driven_covariance(
    phi: np.ndarray, h: np.ndarray, r: np.ndarray, gains: np.ndarray, p0: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """True covariance (k, n, n) of the errors of a filter with these gains, its truth having p0, q and r, as
    `covariance_sequence`."""
    s = p0
    variances = np.broadcast_to(r, (gains.shape[0], *r.shape[-2:]))
    out = np.empty((gains.shape[0], *p0.shape))
    for k, gain in enumerate(gains):
        keep = np.eye(s.shape[0]) - gain @ h
        s = keep @ (phi @ s @ phi.T + q) @ keep.T + gain @ variances[k] @ gain.T
        out[k] = s
    return out


@kernel
def update_row(x, p, h, innovation, variance, gain, work):
    """Measurement update with h x, in place, Joseph form; as `update` for a full row h (n,). gain, work: (n,) space."""
    n = x.shape[0]
    s = variance
    for i in range(n):
        t = 0.0
        for j in range(n):
            t += p[i, j] * h[j]
        work[i] = t
    for i in range(n):
        s += h[i] * work[i]
    for i in range(n):
        gain[i] = work[i] / s
        x[i] += gain[i] * innovation
    for i in range(n):
        for j in range(i + 1):
            t = p[i, j] - gain[i] * work[j] - gain[j] * work[i] + gain[i] * gain[j] * s
            p[i, j] = t
            p[j, i] = t
    return innovation * innovation / s
