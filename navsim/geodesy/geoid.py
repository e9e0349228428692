"""The geoid above the ellipsoid, where the extra `geoid` is installed.

Source: `docs/theory/altimeters.md`, section 3.
"""

from __future__ import annotations

import importlib


class NoGeoid(Exception):
    """There is no model of the geoid."""


def undulation(lat: float, lon: float) -> float:
    """Height of the geoid of EGM96 above the WGS-84 ellipsoid, m, at a place, deg; good to 0.05 m of the model. Raises
    NoGeoid where the package `egm96` is not there, or of a version without its grid."""
    try:
        model = importlib.import_module("egm96")
    except ImportError:
        raise NoGeoid(
            "needs the extra `geoid` (pip install '.[geoid]' in the folder of navsim, Python 3.12 or later); or give "
            "the number"
        ) from None
    if not hasattr(model, "undulation"):
        # versions before 0.3, which pip takes on Python 3.11, have code and no grid
        raise NoGeoid("needs egm96 0.3 or later, which Python 3.12 is needed for; the one installed has no data")
    return float(model.undulation(lat, lon))
