"""Delays of the ionosphere and the troposphere on L1.

Sources:

- [1] IS-GPS-200, section 20.3.3.5.2.5 (Klobuchar's ionosphere).
- [2] Saastamoinen, Contributions to the theory of atmospheric refraction, Bull. Geod. 105-107 (1972-73).
- [3] US Standard Atmosphere (1976), lowest layer.
- [4] RTCA DO-229D, appendix A.4.2.4 (seasonal troposphere of the MOPS, after Collins & Langley's UNB3).
- [5] Niell, Global mapping functions for the atmosphere delay at radio wavelengths, JGR 101 (1996), tables 3, 4.
- [6] Davis et al., Geodesy by radio interferometry, Radio Science 20 (1985), appendix A.
- [7] ITU-R P.453-14 (2019): refractivity, and its decrease with height in the reference atmosphere.
"""

from __future__ import annotations

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT
from navsim.gnss import timescales
from navsim.gnss.constellations.systems import GPS

L1 = GPS.carrier
"""Carrier frequency of GPS L1, Hz."""
_DEG = np.pi / 180.0
SCALE_HEIGHT = 7350.0
"""Scale height of refractivity in the reference atmosphere [7], m."""


def klobuchar(
    alpha: np.ndarray,
    beta: np.ndarray,
    gpst: np.ndarray,
    llh: np.ndarray,
    azimuth: np.ndarray,
    elevation: np.ndarray,
) -> np.ndarray:
    """Ionospheric delay of code on GPS L1, m, positive [1]; on another frequency f it is (L1 / f)^2 times that.

    alpha, beta: (4,) of the message, s and s per semicircle powers. gpst: GPS s. llh: (..., 3) rad, rad, m. azimuth,
    elevation: rad. All but alpha and beta broadcast against each other.
    """
    el = np.maximum(elevation, 0.0) / np.pi
    psi = 0.0137 / (el + 0.11) - 0.022
    phi = np.clip(llh[..., 0] / np.pi + psi * np.cos(azimuth), -0.416, 0.416)
    lam = llh[..., 1] / np.pi + psi * np.sin(azimuth) / np.cos(phi * np.pi)
    magnetic = phi + 0.064 * np.cos((lam - 1.617) * np.pi)
    local = (43200.0 * lam + gpst) % timescales.DAY
    slant = 1.0 + 16.0 * (0.53 - el) ** 3
    power = magnetic[..., None] ** np.arange(4)
    amplitude = np.maximum(power @ alpha, 0.0)
    period = np.maximum(power @ beta, 72000.0)
    x = 2.0 * np.pi * (local - 50400.0) / period
    day = np.where(np.abs(x) < 1.57, amplitude * (1.0 - x**2 / 2.0 + x**4 / 24.0), 0.0)
    return SPEED_OF_LIGHT * slant * (5e-9 + day)


_HIGHEST = 30e3
"""Height, m, from which on the standard atmosphere is constant: its temperature would fall below zero, and the delay is
6 mm."""


def standard_atmosphere(height: np.ndarray, humidity: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressure (hPa), temperature (K), water vapour pressure (hPa) at a height (m) over the sea [3].

    humidity: relative, 0 to 1; 15 degrees Celsius and 1013.25 hPa at the sea.
    """
    h = np.clip(height, 0.0, _HIGHEST)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    temperature = 15.0 - 6.5e-3 * h + 273.16
    vapour = 6.108 * humidity * np.exp((17.15 * temperature - 4684.0) / (temperature - 38.45))
    return pressure, temperature, vapour


def saastamoinen(llh: np.ndarray, elevation: np.ndarray, humidity: float = 0.5) -> np.ndarray:
    """Tropospheric delay, m: Saastamoinen's zenith delays in the standard atmosphere over the sine of the elevation.

    llh: (..., 3) rad, rad, m, the height taken as over the sea. elevation: rad, above 0; nan below. The hydrostatic
    part with gravity's dependence on latitude and height of [6], the wet one of [2]. For elevations above some 10 deg.
    """
    hydrostatic, wet = saastamoinen_zenith(llh, humidity)
    return np.where(elevation > 0.0, (hydrostatic + wet) / np.sin(np.where(elevation > 0.0, elevation, 1.0)), np.nan)


def saastamoinen_zenith(llh: np.ndarray, humidity: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Hydrostatic and wet delay at the zenith, m; arguments as of `saastamoinen`."""
    height = np.maximum(llh[..., 2], 0.0)
    pressure, temperature, vapour = standard_atmosphere(height, humidity)
    gravity = 1.0 - 0.00266 * np.cos(2.0 * llh[..., 0]) - 0.00028 * height / 1e3
    return 0.0022768 * pressure / gravity, 0.002277 * (1255.0 / temperature + 0.05) * vapour


_LATITUDES = np.array([15.0, 30.0, 45.0, 60.0, 75.0]) * _DEG
# pressure hPa, temperature K, vapour pressure hPa, lapse rate K/m, its power of vapour: yearly mean, then amplitude [4]
_MOPS_MEAN = np.array(
    [
        [1013.25, 299.65, 26.31, 6.30e-3, 2.77],
        [1017.25, 294.15, 21.79, 6.05e-3, 3.15],
        [1015.75, 283.15, 11.66, 5.58e-3, 2.57],
        [1011.75, 272.15, 6.78, 5.39e-3, 1.81],
        [1013.00, 263.65, 4.11, 4.53e-3, 1.55],
    ]
)
_MOPS_SEASON = np.array(
    [
        [0.00, 0.00, 0.00, 0.00e-3, 0.00],
        [-3.75, 7.00, 8.85, 0.25e-3, 0.33],
        [-2.25, 11.00, 7.24, 0.32e-3, 0.46],
        [-1.75, 15.00, 5.36, 0.81e-3, 0.74],
        [-0.50, 14.50, 3.39, 0.62e-3, 0.30],
    ]
)
_K1, _K2, _GAS, _GM, _G = 77.604, 382000.0, 287.054, 9.784, 9.80665


def mops_zenith(llh: np.ndarray, day_of_year: float) -> tuple[np.ndarray, np.ndarray]:
    """Hydrostatic and wet delay at the zenith, m, from the climatology of DO-229 [4].

    llh: (..., 3) rad, rad, m over the sea. day_of_year: 1 to 366.
    """
    season = np.cos(2.0 * np.pi * (day_of_year - np.where(llh[..., 0] >= 0.0, 28.0, 211.0)) / 365.25)
    at = np.abs(llh[..., 0])
    pressure, temperature, vapour, lapse, power = (
        np.interp(at, _LATITUDES, _MOPS_MEAN[:, i]) - np.interp(at, _LATITUDES, _MOPS_SEASON[:, i]) * season
        for i in range(5)
    )
    hydrostatic = 1e-6 * _K1 * _GAS * pressure / _GM
    wet = 1e-6 * _K2 * _GAS / (_GM * (power + 1.0) - lapse * _GAS) * vapour / temperature
    shrink = 1.0 - lapse * llh[..., 2] / temperature
    exponent = _G / (_GAS * lapse)
    return shrink**exponent * hydrostatic, shrink ** ((power + 1.0) * exponent - 1.0) * wet


# a, b, c of the continued fraction [5]
_NIELL_MEAN = np.array(
    [
        [1.2769934e-3, 2.9153695e-3, 62.610505e-3],
        [1.2683230e-3, 2.9152299e-3, 62.837393e-3],
        [1.2465397e-3, 2.9288445e-3, 63.721774e-3],
        [1.2196049e-3, 2.9022565e-3, 63.824265e-3],
        [1.2045996e-3, 2.9024912e-3, 64.258455e-3],
    ]
)
_NIELL_SEASON = np.array(
    [
        [0.0, 0.0, 0.0],
        [1.2709626e-5, 2.1414979e-5, 9.0128400e-5],
        [2.6523662e-5, 3.0160779e-5, 4.3497037e-5],
        [3.4000452e-5, 7.2562722e-5, 84.795348e-5],
        [4.1202191e-5, 11.723375e-5, 170.37206e-5],
    ]
)
_NIELL_WET = np.array(
    [
        [5.8021897e-4, 1.4275268e-3, 4.3472961e-2],
        [5.6794847e-4, 1.5138625e-3, 4.6729510e-2],
        [5.8118019e-4, 1.4572752e-3, 4.3908931e-2],
        [5.9727542e-4, 1.5007428e-3, 4.4626982e-2],
        [6.1641693e-4, 1.7599082e-3, 5.4736038e-2],
    ]
)
_NIELL_HEIGHT = (2.53e-5, 5.49e-3, 1.14e-3)


def niell_mapping(llh: np.ndarray, elevation: np.ndarray, day_of_year: float) -> tuple[np.ndarray, np.ndarray]:
    """Niell's hydrostatic and wet mapping functions [5]: slant delay over zenith delay, down to 3 degrees.

    llh: (..., 3) rad, rad, m over the sea. elevation: rad, broadcast against llh's; nan below 0.
    """
    sin = np.sin(np.where(elevation > 0.0, elevation, np.nan))
    at = np.abs(llh[..., 0])
    season = np.cos(2.0 * np.pi * (day_of_year - np.where(llh[..., 0] >= 0.0, 28.0, 211.0)) / 365.25)
    dry = [
        np.interp(at, _LATITUDES, _NIELL_MEAN[:, i]) - np.interp(at, _LATITUDES, _NIELL_SEASON[:, i]) * season
        for i in range(3)
    ]
    wet = [np.interp(at, _LATITUDES, _NIELL_WET[:, i]) for i in range(3)]
    rise = 1e-3 * llh[..., 2] * (1.0 / sin - _fraction(sin, *_NIELL_HEIGHT))
    return _fraction(sin, *dry) + rise, _fraction(sin, *wet)


def _fraction(sin, a, b, c):  # type: ignore[no-untyped-def]
    top = 1.0 + a / (1.0 + b / (1.0 + c))
    return top / (sin + a / (sin + b / (sin + c)))


def mops_niell(gpst: float, llh: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Tropospheric delay, m: the climatology of DO-229 mapped with Niell's functions; arguments as there."""
    day = timescales.utc_calendar(gpst)[0].timetuple().tm_yday
    hydrostatic, wet = mops_zenith(llh, day)
    dry_map, wet_map = niell_mapping(llh, elevation, day)
    return hydrostatic * dry_map + wet * wet_map


def ground_delay(a: np.ndarray, b: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Delay, m, on a straight path between heights a and b above the runway, m, for one N-unit at the runway [7].

    distance: length of the path, m. It is 1e-6 times the integral of exp(-h / 7.35 km). All broadcast against each
    other.
    """
    rise = (b - a) / SCALE_HEIGHT
    level = np.abs(rise) < 1e-6
    mean = np.where(level, 1.0 - 0.5 * rise, -np.expm1(-rise) / np.where(level, 1.0, rise))
    return np.asarray(1e-6 * distance * np.exp(-a / SCALE_HEIGHT) * mean)
