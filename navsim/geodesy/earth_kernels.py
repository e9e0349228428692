"""The WGS-84 Earth inside kernels: radii of curvature, normal gravity, geodetic coordinates.

Sources: [1] NIMA TR8350.2, eq. 4-1 (Somigliana). [2] Groves (2013), eqs. 2.105, 2.106 (radii), 2.112
(geodetic to ECEF), 2.150 (ECEF to local axes). [3] Bowring (1985).
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import atan2, sincos
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import fma
from navsim.geodesy.earth import E2, EP2, G_EQUATOR, RATE, SOMIGLIANA, A, B, F

__all__ = ["RATE", "ecef_to_llh", "gravity", "llh_to_ecef", "ned_axes", "radii", "wrap_angle"]


@kernel
def wrap_angle(angle):
    """A longitude, or the short way between two of them, rad: in -pi ... pi."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def _flattened(sin_lat):
    """1 / sqrt(1 - e^2 sin^2 lat) by its series, to rounding: roots and divisions take ten times as long."""
    x = E2 * sin_lat * sin_lat
    t = fma(x, fma(x, fma(x, 429.0 / 2048.0, 231.0 / 1024.0), 63.0 / 256.0), 35.0 / 128.0)
    return fma(x, fma(x, fma(x, fma(x, t, 5.0 / 16.0), 3.0 / 8.0), 0.5), 1.0)


@kernel
def radii(sin_lat):
    """Meridian and transverse radii of curvature, m, from the sine of the geodetic latitude [2]."""
    t = _flattened(sin_lat)
    return A * (1.0 - E2) * t * t * t, A * t


@kernel
def gravity(sin_lat, height):
    """Normal gravity along the downward vertical, m/s2: Somigliana with the free-air term -2h/a [1]."""
    s2 = sin_lat * sin_lat
    return G_EQUATOR * (1.0 + SOMIGLIANA * s2) * _flattened(sin_lat) * (1.0 - 2.0 / A * height)


@kernel
def ecef_to_llh(x, y, z, out):
    """ECEF (m) to geodetic (rad, rad, m), into out[0:3]; below 1e-9 m up to 1000 km (Bowring [3], three times)."""
    p = math.sqrt(x * x + y * y)
    # sine and cosine of the latitude, and of the parametric latitude beta, from their tangents: no angle is needed
    s, c = z, p * (1.0 - E2)
    for _ in range(3):
        s, c = (1.0 - F) * s, c
        r = 1.0 / math.sqrt(s * s + c * c)
        sin_b = s * r
        cos_b = c * r
        s = z + EP2 * B * sin_b * sin_b * sin_b
        c = p - E2 * A * cos_b * cos_b * cos_b
    r = 1.0 / math.sqrt(s * s + c * c)
    sin_lat = s * r
    cos_lat = c * r
    out[0] = atan2(s, c)
    out[1] = atan2(y, x)
    # the form without division by cos(lat) or sin(lat) is exact at the poles and on the equator
    out[2] = p * cos_lat + z * sin_lat - A * math.sqrt(1.0 - E2 * sin_lat * sin_lat)


@kernel
def llh_to_ecef(llh, out):
    """Geodetic (rad, rad, m) to ECEF (m), into out[0:3] [2, eq. 2.112]."""
    sin_lat, cos_lat = sincos(llh[0])
    sin_lon, cos_lon = sincos(llh[1])
    transverse = A / math.sqrt(1.0 - E2 * sin_lat * sin_lat)
    across = (transverse + llh[2]) * cos_lat
    out[0] = across * cos_lon
    out[1] = across * sin_lon
    out[2] = ((1.0 - E2) * transverse + llh[2]) * sin_lat


@kernel
def ned_axes(lat, lon, out):
    """Rows of `out` (3, 3) are the north, east and down unit vectors in ECEF: v_ned = out @ v_ecef [2]."""
    sin_lat, cos_lat = sincos(lat)
    sin_lon, cos_lon = sincos(lon)
    out[0, 0] = -sin_lat * cos_lon
    out[0, 1] = -sin_lat * sin_lon
    out[0, 2] = cos_lat
    out[1, 0] = -sin_lon
    out[1, 1] = cos_lon
    out[1, 2] = 0.0
    out[2, 0] = -cos_lat * cos_lon
    out[2, 1] = -cos_lat * sin_lon
    out[2, 2] = -sin_lat
