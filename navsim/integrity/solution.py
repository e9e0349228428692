"""Least-squares fixes for monitors: effect of an error of each range on the position and on the residuals.

Source: `docs/theory/integrity.md`, section 1. `gnss.least_squares` computes the receiver's own fixes; their normal
matrix is that of `gnss.dop` for independent range errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.compiler.jit import kernel
from navsim.gnss.dop import invert_normal

POSITION = 3
"""Number of position unknowns, which come first."""


@kernel
def _cofactors(rows: np.ndarray, used: np.ndarray, out: np.ndarray, degrees: np.ndarray) -> None:
    """(A' A)^-1 of the rows (e, s, u) that are used (e, s), out (e, u, u), 0 at unknowns of no row; degrees (e,) of
    freedom, -1 without a solution."""
    epochs, sources, unknowns = rows.shape
    column = np.empty(unknowns, np.int64)
    normal, inverse = np.empty((unknowns, unknowns)), np.empty((unknowns, unknowns))
    for e in range(epochs):
        count, n = 0, 0
        for s in range(sources):
            count += int(used[e, s])
        for j in range(unknowns):
            met = j < POSITION
            for s in range(sources):
                met |= used[e, s] and rows[e, s, j] != 0.0
            if met:
                column[n] = j
                n += 1
        for i in range(n):
            for j in range(i + 1):
                normal[i, j] = 0.0
                for s in range(sources):
                    if used[e, s]:
                        normal[i, j] += rows[e, s, column[i]] * rows[e, s, column[j]]
        degrees[e] = count - n
        for i in range(unknowns):
            for j in range(unknowns):
                out[e, i, j] = 0.0
        if count < n or not invert_normal(normal, n, inverse):
            degrees[e] = -1
            continue
        for i in range(n):
            for j in range(n):
                out[e, column[i], column[j]] = inverse[i, j]


class Independent:
    """Independent ranging errors: sigma (e, s) m; for unused ranges any value except 0."""

    def __init__(self, sigma: np.ndarray) -> None:
        self.sigma = sigma

    def whiten(self, values: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Values of the ranges (e, s, m) in units in which their errors are independent and of 1 sigma 1."""
        return np.asarray(values / self.sigma[..., None])

    def unwhiten(self, estimator: np.ndarray, used: np.ndarray) -> np.ndarray:
        """Estimator (e, m, s) for whitened values, equivalent to `estimator` for values."""
        return np.asarray(estimator / self.sigma[:, None])

    def variance(self, estimator: np.ndarray) -> np.ndarray:
        """Variance (e, m) of estimates with (e, m, s)."""
        return np.asarray(((estimator * self.sigma[:, None]) ** 2).sum(axis=2))


class Correlated:
    """Errors of ranges with a covariance (e, s, s), m2, positive definite."""

    def __init__(self, covariance: np.ndarray) -> None:
        self.covariance = covariance

    def _root(self, used: np.ndarray) -> np.ndarray:
        """Lower factor of the covariance of used ranges, 1 for others."""
        both = used[:, :, None] & used[:, None, :]
        return np.linalg.cholesky(np.where(both, self.covariance, np.eye(used.shape[1])))

    def whiten(self, values: np.ndarray, used: np.ndarray) -> np.ndarray:
        """See `Independent`."""
        return np.linalg.solve(self._root(used), values)

    def unwhiten(self, estimator: np.ndarray, used: np.ndarray) -> np.ndarray:
        """See `Independent`."""
        return np.linalg.solve(self._root(used).swapaxes(1, 2), estimator.swapaxes(1, 2)).swapaxes(1, 2)

    def variance(self, estimator: np.ndarray) -> np.ndarray:
        """See `Independent`."""
        return np.einsum("emi,eij,emj->em", estimator, self.covariance, estimator)


Noise = Independent | Correlated


@dataclass(frozen=True)
class MonitoredFix:
    """Fixes of epochs, each from its own sources."""

    used: np.ndarray
    """(e, s)."""
    noise: Noise
    """Noise of the ranges."""
    rows: np.ndarray
    """(e, s, u) whitened, 0 where not used."""
    cofactor: np.ndarray
    """(e, u, u) covariance of the unknowns, 0 without a fix."""
    degrees: np.ndarray
    """(e,) degrees of freedom of the residuals, -1 without a fix."""

    @property
    def solved(self) -> np.ndarray:
        """(e,) whether there is a fix."""
        return self.degrees >= 0

    @cached_property
    def estimator(self) -> np.ndarray:
        """Effect of a range error of 1 m on the position (e, 3, s), m, ENU; 0 for unused ranges."""
        gain = self.cofactor[:, :POSITION] @ self.rows.swapaxes(1, 2)
        return np.where(self.used[:, None], self.noise.unwhiten(gain, self.used), 0.0)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the position (e, 3, 3), m2, ENU; nan without a fix."""
        return np.where(self.solved[:, None, None], self.cofactor[:, :POSITION, :POSITION], np.nan)

    @cached_property
    def shown(self) -> np.ndarray:
        """Whitened residuals (e, s, f) of a bias of 1 m on each range f, 1/m."""
        return self.residuals(self._biases)

    @cached_property
    def visibility(self) -> np.ndarray:
        """Noncentrality of the residuals' square for a bias of 1 m on each range (e, s), 1/m2."""
        return np.asarray((self.shown**2).sum(axis=1))

    @property
    def redundancy(self) -> np.ndarray:
        """Fraction of the squared whitened bias of each range that the residuals show (e, s).

        0 if the other ranges do not check it; nan for unused ranges.
        """
        alone = self.whitened(self._biases)
        with np.errstate(invalid="ignore"):
            part = self.visibility / (alone**2).sum(axis=1)
        return np.where(self.used & self.solved[:, None], part, np.nan)

    @property
    def _biases(self) -> np.ndarray:
        """1 m on each range (e, s, f)."""
        return np.broadcast_to(np.eye(self.used.shape[1]), (*self.used.shape, self.used.shape[1]))

    def whitened(self, errors: np.ndarray) -> np.ndarray:
        """Whitened errors, or residuals, of ranges (e, s, m), m; 0 for unused ranges."""
        there = self.used[..., None]
        return np.where(there, self.noise.whiten(np.where(there, errors, 0.0), self.used), 0.0)

    def residuals(self, errors: np.ndarray) -> np.ndarray:
        """Whitened residuals (e, s, m) of range errors (e, s, m), m; 0 for unused ranges."""
        whitened = self.whitened(errors)
        estimated = self.cofactor @ (self.rows.swapaxes(1, 2) @ whitened)
        return np.asarray(whitened - self.rows @ estimated)


def solve(rows: np.ndarray, used: np.ndarray, noise: Noise) -> MonitoredFix:
    """The fixes of epochs.

    rows: (e, s, u) minus the unit vector from receiver to source, ENU, and 1 at the clock it belongs to; unknowns that
    no used source has drop out. used: (e, s).
    """
    there = used[..., None]
    whitened = np.where(there, noise.whiten(np.where(there, rows, 0.0), used), 0.0)
    cofactor, degrees = np.empty((*used.shape[:1], *rows.shape[2:] * 2)), np.empty(used.shape[0], np.int64)
    _cofactors(np.ascontiguousarray(whitened), np.ascontiguousarray(used), cofactor, degrees)
    return MonitoredFix(used, noise, whitened, cofactor, degrees)


def rows_of(los: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """Rows (e, s, u) of unit vectors receiver -> source (e, s, 3), ENU, and the clock (s,) of each source."""
    clocks = np.broadcast_to(np.eye(int(clock.max()) + 1)[clock], (*los.shape[:2], int(clock.max()) + 1))
    return np.concatenate([-los, clocks], axis=2)


def turned(estimator: np.ndarray, bearing: float) -> np.ndarray:
    """Estimator of the position to the right of a horizontal direction, and along it (..., 2, s).

    estimator (..., m, s): east and north come first. bearing: of the direction, rad.
    """
    across = np.array([[np.cos(bearing), -np.sin(bearing)], [np.sin(bearing), np.cos(bearing)]])
    return np.asarray(across @ estimator[..., : len(across), :])
