"""Magnetic field of the Earth, if the extra `magnetic` is installed.

Source: `docs/theory/trajectory.md`, section 4.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np


class NoMagneticModel(Exception):
    """There is no model of the magnetic field, or none of the time."""


def field_ned(lat: float, lon: float, height: float, year: float) -> np.ndarray:
    """Field of the World Magnetic Model along north, east and down (3,), uT, at a position, deg and m above the
    ellipsoid.

    Raises NoMagneticModel without the package `pygeomag`, or if it has no model of that decimal year.
    """
    found = _calculated(lat, lon, height, year)
    return 1e-3 * np.array([found.x, found.y, found.z], dtype=float)


def declination(lat: float, lon: float, height: float, year: float) -> float:
    """Magnetic declination of the World Magnetic Model, deg, east positive. Position, year, Raises: as of
    `field_ned`."""
    return float(_calculated(lat, lon, height, year).d)


def _calculated(lat: float, lon: float, height: float, year: float) -> Any:
    """Elements of the field, nT and deg. Raises NoMagneticModel."""
    try:
        model = importlib.import_module("pygeomag")
    except ImportError:
        text = "needs the extra `magnetic` (pip install '.[magnetic]' in the folder of navsim); or give the number"
        raise NoMagneticModel(text) from None
    try:
        return model.GeoMag(base_year=year).calculate(glat=lat, glon=lon, alt=0.001 * height, time=year)
    except ValueError as error:
        raise NoMagneticModel(f"no magnetic model of {year:.1f}: {error}") from None
