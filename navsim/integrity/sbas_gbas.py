"""Protection levels of other systems, for comparison: SBAS and GBAS, by their standards' forms.

Source: `docs/theory/integrity.md`, section 5; RTCA DO-229 appendix J (SBAS), ICAO Annex 10 volume I (GBAS).
"""

from __future__ import annotations

import math

import numpy as np

from navsim.geodesy.earth import FOOT
from navsim.integrity.solution import MonitoredFix
from navsim.statistics import normal

SBAS_HORIZONTAL, SBAS_VERTICAL = 6.0, 5.33
"""Factors of precision approaches [DO-229]; 5.33 is the rounded 5.327 that a chance of 5e-8 a side has."""
SBAS_HORIZONTAL_NPA = 6.18
"""Horizontal factor of non-precision approaches [DO-229]: a chance of 5e-9 of a Rayleigh distribution."""


def sbas(solution: MonitoredFix, operation: str | None = None) -> np.ndarray:
    """Horizontal and vertical levels (e, 2), m, of an operation; nan without a fix."""
    c = solution.covariance
    east, north, cross = c[:, 0, 0], c[:, 1, 1], c[:, 0, 1]
    longest = np.sqrt(0.5 * (east + north) + np.hypot(0.5 * (east - north), cross))
    factor = SBAS_HORIZONTAL_NPA if operation == "NPA" else SBAS_HORIZONTAL
    return np.stack([factor * longest, SBAS_VERTICAL * np.sqrt(c[:, 2, 2])], axis=1)


def growth_of_limits(distance: np.ndarray, height: np.ndarray) -> np.ndarray:
    """What the lateral and vertical alert limit of a GBAS approach exceed those of its last segment by (e, 2), m.

    distance, height: of the aircraft from the threshold along the approach, and above it (e,), m. Source: ICAO Annex
    10, volume I, appendix B, tables B-68 and B-69.
    """
    lateral = np.clip(0.0044 * distance - 3.85, 0.0, 29.15)
    vertical = np.clip(0.02925 * (height / FOOT) - 5.85, 0.0, 33.35)
    return np.stack([lateral, vertical], axis=1)


def gbas_factors(receivers: int) -> tuple[float, float]:
    """K_ffmd and K_md of a ground station with so many reference receivers; the standard has them to three decimals."""
    return -normal.quantile(2.5e-8 / (receivers + 1) / 2.0), -normal.quantile(2.5e-3 * receivers / (receivers + 1))


def gbas_projection(effect: np.ndarray, course: float, glide: float) -> np.ndarray:
    """Effect across the track (right) and on the height above the glide path (e, 2, ...), of one on positions.

    effect: (e, 3, ...) east, north, up, as the estimator of fixes; course: of the approach, rad from north; glide:
    glide path angle, rad.
    """
    east, north, up = (effect[:, i] for i in range(3))
    along, across = (
        east * math.sin(course) + north * math.cos(course),
        east * math.cos(course) - north * math.sin(course),
    )
    return np.stack([across, up + along * math.tan(glide)], axis=1)


def effect_of_b(projection: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Size of the effect (e, 2, ...), m, of B values b (e, s, ...), m; projection: (e, 2, s)."""
    return np.abs((projection.reshape(*projection.shape, *(1,) * (b.ndim - 2)) * b[:, None]).sum(axis=2))


def gbas(
    projection: np.ndarray, sigma: np.ndarray, ground: np.ndarray, off: np.ndarray, receivers: int,
    factors: tuple[float, float],
) -> np.ndarray:  # fmt: skip
    """Lateral and vertical levels (e, 2, 2, ...), m, for fault-free reference receivers, and for the faulty one.

    - `projection` (e, 2, s); `sigma`, `ground` (e, s): of ranges and of the ground's part, m.
    - `off` (e, 2, ...): from `effect_of_b`, of the faulty receiver, m; `factors`: K_ffmd and K_md.
    """
    free, missed = factors
    variance = sigma**2 + ground**2 / (receivers - 1)  # the ground's with a receiver less
    without = free * np.sqrt(((projection * sigma[:, None]) ** 2).sum(axis=2))
    noise = missed * np.sqrt((projection**2 * variance[:, None]).sum(axis=2))
    without, noise = (each.reshape(*each.shape, *(1,) * (off.ndim - 2)) for each in (without, noise))
    return np.stack([np.broadcast_to(without, off.shape), off + noise], axis=2)
