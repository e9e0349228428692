"""An altimeter: heights of the IMU above the ellipsoid, each off by a constant and by white noise.

What a barometric and a radio altimeter have beyond that (datum, lag, temperature, terrain) is not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Altimeter:
    """rate: of the measurements, Hz. offset: m, how much too high it reads, of which the filter knows nothing. sigma: 1
    sigma of its noise, m; believed: what the filter takes for it, m."""

    rate: float
    offset: float
    sigma: tuple[float]
    believed: tuple[float]
