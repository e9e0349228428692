"""Second-order errors near sources: effect of the curvature of ranges on fixes and on range measurements.

Let e be a position error, d the distance to a source, u the unit vector to it. The range is longer than its
linearisation by e' (I - u u') e / (2 d). The direction along which the range rate is measured turns. Fixes with errors
of 3 m, 28 m from a pseudolite, have a mean error of 0.16 m, always in the same direction. A filter that assumes
Gaussian errors of zero mean believes a hundredth of that after a hundred fixes.

The errors are quadratic forms e' F e of Gaussian errors e of covariance C = L L'. They are sums of products n_i n_j of
independent variables, with the mean tr(F C) and the six coefficients of L' F L.

Source: `docs/theory/landing.md`, section 4, eqs. (10) to (12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.geodesy.earth import llh_from_ecef, ned_matrix
from navsim.gnss.pseudorange import Signals
from navsim.statistics.rounding import digits

NEAR = 1e5
"""Distance of sources, m, whose ranges are curved: the error of 30 m of a fix makes that of a farther one longer by 5
mm at most."""
NEGLIGIBLE = 1.1**2 - 1.0
"""Largest sum of squared second-order errors, each in its measurement's sigma, that is neglected. No estimate is off by
more than the root of the sum, in its own sigma, so the RMS error grows by at most a tenth."""


@dataclass(frozen=True)
class Curvature:
    """Second-order errors of measurements (m, k)."""

    mean: np.ndarray
    """(m, k)."""
    white: np.ndarray
    """(m, k, k) covariance of the part that is independent at each time."""
    correlated: np.ndarray
    """(m, k, 6) effect of each of six uncorrelated variables of variance one that stay the same during a pass."""
    squares: float
    """Sum of the squared errors, each in its measurement's covariance."""
    bound: np.ndarray
    """(m, k, k) covariance of white noise that replaces `correlated` in the filter model; never too small."""

    @property
    def noise(self) -> np.ndarray:
        """Increase of the measurements' covariance (m, k, k)."""
        return self.white + self.bound

    @classmethod
    def of(cls, forms: np.ndarray, white: np.ndarray, correlated: np.ndarray, noise: np.ndarray) -> Curvature:
        """Second-order errors from their quadratic forms.

        - `forms` (m, k, 3, 3); `white`, `correlated` (m, 3, 3): covariances of the two parts of position errors.
        - `noise` (m, k, k): covariance of the measurements' first-order noise, zero if there is none.

        A lasting error g_t q, q of variance one, is bounded by white noise of covariance g_t g_t' (sum of all c) / c_t.
        Here c_t is the size of g_t relative to the noise. The difference of the two covariances is diagonally dominant,
        so no estimate is worse than the filter believes, for any use of the measurements.
        """
        mean, every = _products(forms, white + correlated)
        _, gamma = _products(forms, correlated)
        alone = every @ np.swapaxes(every, 1, 2) - gamma @ np.swapaxes(gamma, 1, 2)
        inverse = np.linalg.pinv(noise, hermitian=True)
        squares = np.einsum("mak,mab,mbk->mk", gamma, inverse, gamma)
        size = np.sqrt(np.maximum(squares, 0.0))
        longer = np.divide(size.sum(axis=0), size, out=np.zeros_like(size), where=size > 0.0)
        bound = (gamma * longer[:, None]) @ np.swapaxes(gamma, 1, 2)
        of_mean = np.einsum("ma,mab,mb->m", mean, inverse, mean)
        return cls(mean, alone, gamma, float(of_mean.sum() + squares.sum()), bound)


def diagonal_bound(covariance: np.ndarray) -> np.ndarray:
    """Variances (m, k) of uncorrelated errors that bound correlated ones of covariance (m, k, k).

    Each variance contains its share of every correlation. The difference is then diagonally dominant in units of the
    sigmas.
    """
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    size = sigma[:, :, None] * sigma[:, None, :]
    correlation = np.divide(np.abs(covariance), size, out=np.zeros_like(size), where=size > 0.0)
    return np.asarray(sigma**2 * correlation.sum(axis=2))


def _products(forms: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (m, k) of e' F e, e of a covariance (m, 3, 3), and coefficients (m, k, 6) of its random part.

    The latter multiply the products n_i n_j, each divided by its standard deviation.
    """
    size, axes = np.linalg.eigh(covariance)
    root = (axes * np.sqrt(np.maximum(size, 0.0))[:, None]) @ np.swapaxes(axes, 1, 2)
    turned = np.swapaxes(root, 1, 2)[:, None] @ forms @ root[:, None]
    i, j = np.tril_indices(3)
    varied = turned[..., i, j] + turned[..., j, i]
    varied[..., i == j] /= np.sqrt(2.0)
    return np.trace(turned, axis1=2, axis2=3), varied


def has_near_sources(signals: Signals) -> bool:
    """Whether any range is received from so near that its curvature may count."""
    return bool((signals.range[signals.used] < NEAR).any())


_CURVED = 0.05
"""Second-order error of a range, in its sigma, up to which a first-order covariance is enough. If it lasts over the 40
fixes of a pass, it is 0.3 sigma of their mean and makes the RMS error 5 % larger."""
_CLOSE = 0.1
"""Position sigma across the line of sight, divided by the distance, up to which the second order will do: about the
size of the third order, divided by the second."""


@dataclass(frozen=True)
class NearPass:
    """A source at the epoch of its closest approach."""

    name: str
    """Name of the source."""
    distance: float
    """m."""
    sigma: float
    """1 sigma of position across the line of sight, m."""
    order: int
    """Order of its errors in the covariance, 1 or 2."""
    counts: bool
    """Whether the neglected errors matter."""

    def __str__(self) -> str:
        order = "first" if self.order == 1 else "second"
        return (
            f"{self.name} is passed at {self.distance:.0f} m with a position sigma of {digits(self.sigma, 2)} m "
            f"across the line of sight: covariances are right only to {order} order there; trust runs, or move it away"
        )


def near_passes(signals: Signals, covariance: np.ndarray, order: int) -> list[NearPass]:
    """Closest approaches to near sources; covariance: of position errors (e, 3, 3) or more, NED, m2."""
    distance = np.where(signals.used, signals.range, np.inf)
    *_, across = range_forms(signals)
    out = []
    for s in np.flatnonzero((distance < NEAR).any(axis=0)):
        e = int(np.argmin(distance[:, s]))
        longer = 0.5 * float(np.sum(across[e, s] * covariance[e, :3, :3]))
        away = float(distance[e, s])
        sigma = float(np.sqrt(2.0 * away * longer))
        counts = sigma > _CLOSE * away if order > 1 else longer > _CURVED * signals.fix_sigma[e, s]
        out.append(NearPass(signals.names[s], away, sigma, order, bool(counts)))
    return out


def range_forms(signals: Signals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Second-order parts of ranges and range rates, for a position error and for a velocity error; zero for distant
    sources.

    Returns the forms of the range and of the range rate (e, s, 3, 3) in NED, and (I - u u')/d (e, s, 3, 3), which
    multiplies position and velocity errors.
    """
    near = signals.used & (np.where(signals.used, signals.range, np.inf) < NEAR)
    axes = ned_matrix(llh_from_ecef(signals.antenna))
    ones = np.ones(3) / np.sqrt(3.0)
    away = np.where(near[..., None], signals.position - signals.antenna[:, None], ones) @ np.swapaxes(axes, 1, 2)
    moving = np.where(near[..., None], signals.velocity - signals.antenna_velocity[:, None], 0.0)
    moving = moving @ np.swapaxes(axes, 1, 2)
    distance = np.linalg.norm(away, axis=2)
    u = away / distance[..., None]
    across = (np.eye(3) - u[..., :, None] * u[..., None, :]) * near[..., None, None]
    along = np.sum(u * moving, axis=2)
    turning = (moving - along[..., None] * u)[..., :, None] * u[..., None, :]
    rate = -(turning + np.swapaxes(turning, 2, 3) + along[..., None, None] * across) / distance[..., None, None] ** 2
    across = across / distance[..., None, None]
    return 0.5 * across, 0.5 * rate, across


def fix_forms(signals: Signals, by_range: np.ndarray, by_rate: np.ndarray) -> np.ndarray:
    """Second-order errors of fixes, quadratic forms (e, 6, 3, 3) of their first-order position errors.

    by_range, by_rate: as of `fix_slopes.slopes`. The sign follows from the fix: a longer range makes the fix shorter.
    """
    of_range, of_rate, across = range_forms(signals)
    # effect of a position error on the velocity fix, and thus on the directions again
    to_velocity = by_range[:, 3:] @ np.linalg.pinv(by_range[:, :3])
    turned = across @ to_velocity[:, None]
    of_rate = of_rate + 0.5 * (turned + np.swapaxes(turned, 2, 3))
    return -np.asarray(np.einsum("eks,esij->ekij", by_range, of_range) + np.einsum("eks,esij->ekij", by_rate, of_rate))
