"""Satellites from two-line elements, by SGP4.

The propagation is the `sgp4` package's, Vallado's own code; from its true equator and mean equinox we turn by mean
sidereal time to rotating axes (UT1 taken as UTC: within 15 arc seconds, 2 km at GNSS heights at the very worst, usually
less than 0.5 km; polar motion left out, 40 m). Good for skies, not for ranges.

Source: [1] Vallado et al., Revisiting Spacetrack Report 3, AIAA 2006-6753.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.core.wgs84 import RATE
from navsim.models import timescales
from navsim.models.messages import for_each

_JULIAN_1970 = 2440587.5


def short_name(title: str, first: str) -> str:
    """G13 for `GPS BIIR-2  (PRN 13)`, R730 for `COSMOS 2456 (730)`, T28874 by catalogue number otherwise."""
    prn = re.search(r"\(PRN\s+0*(\d+)\)", title)
    if prn:
        return f"G{int(prn[1]):02d}"
    glonass = re.search(r"COSMOS\s+\d+\s+\((\d{3})K?\)", title)
    if glonass:
        return f"R{glonass[1]}"
    return f"T{first[2:7].strip()}"


@dataclass(frozen=True)
class Constellation:
    """Satellites of two-line elements: names (n,); healthy (n,), since elements do not say; epochs (n,) UTC POSIX s."""

    names: tuple[str, ...]
    healthy: np.ndarray
    epochs: np.ndarray
    satellites: Any

    system = "gps"

    @classmethod
    def of(cls, names: list[str], first: list[str], second: list[str]) -> Constellation:
        """From the lines of the elements. Raises ValueError for elements that SGP4 cannot use."""
        from sgp4.api import Satrec, SatrecArray

        satellites = [Satrec.twoline2rv(a, b) for a, b in zip(first, second, strict=True)]
        for name, satellite in zip(names, satellites, strict=True):
            if satellite.error:
                raise ValueError(f"{name}: SGP4 cannot use these elements (error {satellite.error})")
        epochs = np.array([(s.jdsatepoch - _JULIAN_1970 + s.jdsatepochF) * timescales.DAY for s in satellites])
        return cls(tuple(names), np.ones(len(names), dtype=bool), epochs, SatrecArray(satellites))

    def age(self, utc: float) -> float:
        """Largest distance, s, of the elements' epochs from a UTC time."""
        return float(np.max(np.abs(utc - self.epochs)))

    def state(self, utc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m, m/s, at UTC times (m,) or (m, n); nan where SGP4 fails."""
        utc = for_each(utc, len(self.names))
        # one time for all satellites, then along the velocity for the travel time's spread of some 10 ms
        common = np.mean(utc, axis=1)
        day = np.floor(common / timescales.DAY)
        error, p, v = self.satellites.sgp4(_JULIAN_1970 + day, common / timescales.DAY - day)
        p, v = 1e3 * np.moveaxis(p, 0, 1), 1e3 * np.moveaxis(v, 0, 1)
        failed = np.moveaxis(error, 0, 1) != 0
        p[failed], v[failed] = np.nan, np.nan
        p = p + v * (utc - common[:, None])[..., None]
        angle = timescales.sidereal_angle(utc)
        c, s = np.cos(angle), np.sin(angle)

        def turned(a: np.ndarray) -> np.ndarray:
            return np.stack([c * a[..., 0] + s * a[..., 1], c * a[..., 1] - s * a[..., 0], a[..., 2]], axis=-1)

        position, velocity = turned(p), turned(v)
        velocity[..., 0] += RATE * position[..., 1]
        velocity[..., 1] -= RATE * position[..., 0]
        return position, velocity
