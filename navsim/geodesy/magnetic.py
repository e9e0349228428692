"""The magnetic declination, where the extra `magnetic` is installed.

Source: `docs/theory/trajectory.md`, section 4.
"""

from __future__ import annotations

import importlib


class NoDeclination(Exception):
    """There is no model of the magnetic field, or none of the time."""


def declination(lat: float, lon: float, height: float, year: float) -> float:
    """Magnetic declination of the World Magnetic Model, deg, east positive, at a position, deg and m above the
    ellipsoid.

    Raises NoDeclination without the package `pygeomag`, or if it has no model of that decimal year.
    """
    try:
        model = importlib.import_module("pygeomag")
    except ImportError:
        text = "needs the extra `magnetic` (pip install '.[magnetic]' in the folder of navsim); or give the number"
        raise NoDeclination(text) from None
    try:
        field = model.GeoMag(base_year=year)
        return float(field.calculate(glat=lat, glon=lon, alt=0.001 * height, time=year).d)
    except ValueError as error:
        raise NoDeclination(f"no declination in {year:.1f}: {error}") from None
