"""The WGS-84 Earth on whole numpy arrays: constants, coordinates, gravity. `geodesy.earth_kernels` has the kernels.

Sources: [1] NIMA TR8350.2 (WGS-84), tables 3.1 and 3.4, eq. 4-1 (Somigliana).
[2] Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed. (2013),
eqs. 2.112 (geodetic to ECEF), 2.150 (ECEF to local axes).
[3] Bowring, The accuracy of geodetic latitude and height equations, Survey Review 28 (1985).
"""

from __future__ import annotations

from typing import Any

import numpy as np

A = 6378137.0
"""Semi-major axis, m [1]."""
F = 1.0 / 298.257223563
"""Flattening [1]."""
B = A * (1.0 - F)
E2 = F * (2.0 - F)
"""First eccentricity squared."""
EP2 = E2 / (1.0 - E2)
RATE = 7.292115e-5
"""Earth rotation rate, rad/s [1]."""
G_EQUATOR = 9.7803253359
"""Normal gravity at the equator, m/s2 [1]."""
FOOT = 0.3048
"""The international foot, m."""
STANDARD_GRAVITY = 9.80665
"""Standard gravity of the units g and mg, m/s2."""
SOMIGLIANA = 1.931852652458e-3
"""Somigliana's constant k: gamma = gamma_e (1 + k sin^2 lat) / sqrt(1 - e^2 sin^2 lat). The value that
gives 9.8321849378 m/s2 at the pole [1]."""
SPEED_OF_LIGHT = 299792458.0


def ned_matrix(llh: np.ndarray) -> np.ndarray:
    """C_ne of each geodetic position: llh (..., 3) [rad, rad, m] -> (..., 3, 3), v_ned = C_ne @ v_ecef."""
    sin_lat, cos_lat = np.sin(llh[..., 0]), np.cos(llh[..., 0])
    sin_lon, cos_lon = np.sin(llh[..., 1]), np.cos(llh[..., 1])
    rows = [
        [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
        [-sin_lon, cos_lon, np.zeros_like(sin_lat)],
        [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def heading_axes(llh: np.ndarray, heading: float) -> np.ndarray:
    """Columns (3, 3) are the unit vectors ahead, right and down at a point (3,), in ECEF; heading in rad."""
    c, s = np.cos(heading), np.sin(heading)
    return ned_matrix(llh).T @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def in_heading_axes(ecef: np.ndarray, llh: np.ndarray, heading: float) -> np.ndarray:
    """Positions (..., 3), ECEF, m, from a point (3,) in its `heading_axes`: ahead, right and down (..., 3), m."""
    return (ecef - ecef_from_llh(llh)) @ heading_axes(llh, heading)


def wrap_angle(angle: Any) -> Any:
    """A longitude, or the short way between two of them, rad: in -pi ... pi."""
    return angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5)


def unwrap_longitude(llh: np.ndarray) -> np.ndarray:
    """Positions (n, 3) [rad, rad, m], nan among them or not, with longitudes within half a turn of the first one's."""
    known = llh[np.isfinite(llh[:, 1]), 1]
    turns = np.round((llh[:, 1] - known[0]) / (2.0 * np.pi)) if known.size else 0.0
    return np.stack([llh[:, 0], llh[:, 1] - 2.0 * np.pi * turns, llh[:, 2]], axis=1)


def ecef_from_llh(llh: np.ndarray) -> np.ndarray:
    """llh (..., 3) [rad, rad, m] -> ECEF (..., 3) [m] [2]."""
    lat, lon, height = llh[..., 0], llh[..., 1], llh[..., 2]
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    across = (n + height) * np.cos(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), (n * (1.0 - E2) + height) * np.sin(lat)], axis=-1)


def llh_from_ecef(ecef: np.ndarray) -> np.ndarray:
    """ECEF (..., 3) [m] -> llh (..., 3) [rad, rad, m]; below 1e-9 m up to 1000 km (Bowring, iterated [3])."""
    x, y, z = ecef[..., 0], ecef[..., 1], ecef[..., 2]
    p = np.hypot(x, y)
    lat = np.arctan2(z, p * (1.0 - E2))
    for _ in range(3):
        beta = np.arctan2((1.0 - F) * np.sin(lat), np.cos(lat))
        lat = np.arctan2(z + EP2 * B * np.sin(beta) ** 3, p - E2 * A * np.cos(beta) ** 3)
    sin_lat = np.sin(lat)
    # the form without division by cos(lat) or sin(lat) is exact at the poles and on the equator
    height = p * np.cos(lat) + z * sin_lat - A * np.sqrt(1.0 - E2 * sin_lat**2)
    return np.stack([lat, np.arctan2(y, x), height], axis=-1)


def gravity_ecef(ecef: np.ndarray) -> np.ndarray:
    """Gravity (attraction and centrifugal) in ECEF axes: (..., 3) [m] -> (..., 3) [m/s2], along -up."""
    return gravity_at(llh_from_ecef(ecef))


def gravity_at(llh: np.ndarray) -> np.ndarray:
    """Gravity at geodetic positions (..., 3) [rad, rad, m]."""
    sin_lat, cos_lat = np.sin(llh[..., 0]), np.cos(llh[..., 0])
    g = G_EQUATOR * (1 + SOMIGLIANA * sin_lat**2) / np.sqrt(1 - E2 * sin_lat**2) * (1 - 2 * llh[..., 2] / A)
    down = np.stack([-cos_lat * np.cos(llh[..., 1]), -cos_lat * np.sin(llh[..., 1]), -sin_lat], axis=-1)
    return g[..., None] * down


def shifted(llh: np.ndarray, by: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Positions (e, 3, ...), rad, rad, m, moved by (e, 3) NED, m; along: (e, 3) rough positions, rad, rad, m."""
    w = 1.0 - E2 * np.sin(along[:, 0]) ** 2
    transverse = A / np.sqrt(w)
    meridian = transverse * (1.0 - E2) / w
    radius = np.stack([meridian + along[:, 2], (transverse + along[:, 2]) * np.cos(along[:, 0]), -np.ones(len(by))], 1)
    step = by / radius
    return np.asarray(llh + step.reshape(*step.shape, *(1,) * (llh.ndim - 2)))
