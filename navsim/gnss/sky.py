"""Visible part of the sky: elevation mask, horizon, jammed sectors, directions to and from ECEF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.geodesy import earth
from navsim.geodesy.horizon import between


@dataclass(frozen=True)
class Sector:
    """A part of the sky without usable signals, rad; an azimuth range through north has west > east end."""

    azimuth: tuple[float, float]
    elevation: tuple[float, float]

    def covers(self, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Whether directions (rad) lie inside, edges included."""
        low, high = self.azimuth
        width = (high - low) % (2 * np.pi)
        if width == 0.0 and high != low:
            width = 2 * np.pi
        across = (azimuth - low) % (2 * np.pi) <= width
        return across & (elevation >= self.elevation[0]) & (elevation <= self.elevation[1])


@dataclass(frozen=True)
class Horizon:
    """Elevations (n,) of the horizon at increasing azimuths (n,), rad; linear in azimuth between them, and around."""

    azimuth: np.ndarray
    elevation: np.ndarray

    def at(self, azimuth: np.ndarray) -> np.ndarray:
        """Its elevation at azimuths, rad."""
        return between(self.azimuth, self.elevation, azimuth)


@dataclass(frozen=True)
class Mask:
    """Usable elevations (rad, both ends included), the sectors taken out of them, and a horizon that is over them."""

    low: float
    high: float
    sectors: tuple[Sector, ...] = ()
    horizon: Horizon | None = None

    def passes(self, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Whether signals from these directions (rad) are used."""
        usable = (elevation >= self.low) & (elevation <= self.high)
        for sector in self.sectors:
            usable &= ~sector.covers(azimuth, elevation)
        if self.horizon is not None:
            usable &= elevation >= self.horizon.at(azimuth)
        return usable


def enu_matrix(llh: np.ndarray) -> np.ndarray:
    """C_ue of geodetic positions (..., 3): v_enu = C_ue @ v_ecef, (..., 3, 3)."""
    return earth.ned_matrix(llh)[..., [1, 0, 2], :] * np.array([1.0, 1.0, -1.0])[:, None]


def azimuth_elevation(los_enu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth (clockwise from north, 0 .. 2 pi) and elevation, rad, of unit vectors (..., 3) in ENU."""
    azimuth = np.arctan2(los_enu[..., 0], los_enu[..., 1]) % (2 * np.pi)
    return azimuth, np.arcsin(np.clip(los_enu[..., 2], -1.0, 1.0))


def unit_vector(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Unit vectors in ENU (..., 3) of azimuths and elevations in rad."""
    horizontal = np.cos(elevation)
    return np.stack([horizontal * np.sin(azimuth), horizontal * np.cos(azimuth), np.sin(elevation)], axis=-1)
