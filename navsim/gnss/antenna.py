"""Antennas by tables of gain: the aircraft's, which turns with it, and those of pseudolites.

Page: `docs/theory/interference.md`, section 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class AircraftAntenna:
    """elevation: (k,) rad over the antenna's own horizon, increasing; gain: (k,) dBi at them; up: (3,) unit vector
    along its axis in body axes; mask: elevation, rad, below which the aircraft shadows it."""

    elevation: np.ndarray
    gain: np.ndarray
    up: np.ndarray
    mask: float

    def elevation_of(self, c_eb: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Elevations over its horizon (e, s), rad, of unit vectors (e, s, 3), ECEF; c_eb: (e, 3, 3) body axes in
        ECEF."""
        up = c_eb @ self.up
        return np.arcsin(np.clip(np.einsum("ei,esi->es", up, towards), -1.0, 1.0))

    def gain_at(self, elevation: np.ndarray) -> np.ndarray:
        """Gain, dBi, at elevations over its horizon, rad, of any shape: straight between those of the table, beyond its
        ends as at them."""
        return np.interp(elevation, self.elevation, self.gain)

    @property
    def zenith(self) -> float:
        """Gain along its axis, dBi."""
        return float(self.gain_at(np.array(0.5 * np.pi)))


@dataclass(frozen=True)
class GroundPattern:
    """azimuth: (a,) rad from north, increasing, within one turn; elevation: (k,) rad, increasing; gain: (a, k) dB
    relative to the radiated power that is stated."""

    azimuth: np.ndarray
    elevation: np.ndarray
    gain: np.ndarray

    def gain_at(self, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Gain, dB, towards azimuths and elevations, rad, of any shape: straight in both between those of the table,
        azimuths all around, elevations beyond its ends as at them."""
        columns = np.stack([np.interp(elevation, self.elevation, row) for row in self.gain])
        count = self.azimuth.size
        if count == 1:
            return columns[0]
        from_first = (azimuth - self.azimuth[0]) % (2.0 * np.pi)
        edges = np.append(self.azimuth - self.azimuth[0], 2.0 * np.pi)
        before = np.clip(np.searchsorted(edges, from_first, side="right") - 1, 0, count - 1)
        share = (from_first - edges[before]) / (edges[before + 1] - edges[before])
        low, high = (np.take_along_axis(columns, at[None], axis=0)[0] for at in (before, (before + 1) % count))
        return low + share * (high - low)
