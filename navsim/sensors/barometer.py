"""The air's static pressure, and heights by it.

Sources: [1] ISO 2533 (1975), the standard atmosphere, its lowest layer, with heights for geopotential ones. [2]
`docs/theory/altimeters.md`, section 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.gnss.correlated_errors import LastingErrors

SEA_LEVEL, TEMPERATURE, LAPSE = 101_325.0, 288.15, 6.5e-3
"""Pressure, Pa, and temperature, K, of the standard atmosphere at sea level, and how it cools with height, K/m [1]."""
GAS, GRAVITY = 287.05287, 9.80665
"""The gas constant of air, J/(kg K), and gravity, m/s2 [1]."""
_POWER = GRAVITY / (GAS * LAPSE)
HECTOPASCAL = 100.0


def standard_temperature(height: np.ndarray | float) -> np.ndarray:
    """Temperature, K, of the standard atmosphere at heights above sea level, m, up to 11 km."""
    return TEMPERATURE - LAPSE * np.asarray(height)


def standard_pressure(height: np.ndarray | float) -> np.ndarray:
    """Pressure, Pa, of the standard atmosphere at heights above sea level, m, up to 11 km."""
    return SEA_LEVEL * (standard_temperature(height) / TEMPERATURE) ** _POWER


def pressure_altitude(pressure: np.ndarray | float) -> np.ndarray:
    """The height, m, at which the standard atmosphere has a pressure, Pa."""
    return TEMPERATURE / LAPSE * (1.0 - (np.asarray(pressure) / SEA_LEVEL) ** (1.0 / _POWER))


SLOPE = HECTOPASCAL * GAS * TEMPERATURE / (GRAVITY * SEA_LEVEL)
"""Metres of height a hectopascal at sea level."""
SETTING, DRIFT = 0, 1
"""Time-correlated errors of a barometric altimeter."""


@dataclass(frozen=True)
class AirColumn:
    """Air above an aerodrome as a deviation from the standard atmosphere.

    elevation: of the aerodrome above sea level, m. warmer: K, at all heights. The pressure at the aerodrome is the
    standard one; a correct QNH setting makes any other pressure equivalent.
    """

    elevation: float
    warmer: float

    @property
    def stretch(self) -> float:
        """Metres that an altimeter shows for each metre above the aerodrome: the standard temperature there over the
        true one [2]."""
        standard = float(standard_temperature(self.elevation))
        return standard / (standard + self.warmer)

    def pressure(self, height: np.ndarray) -> np.ndarray:
        """Static pressure, Pa, at heights above sea level (n,), m."""
        there = standard_temperature(self.elevation) + self.warmer
        ratio = (there - LAPSE * (height - self.elevation)) / there
        return standard_pressure(self.elevation) * ratio**_POWER

    def height(self, shown: np.ndarray) -> np.ndarray:
        """Height above sea level, m, from the reading of a correctly set altimeter."""
        return self.elevation + (shown - self.elevation) / self.stretch


@dataclass(frozen=True)
class PressureBeliefs:
    """Filter model of a `BarometricAltimeter`, whose fields it shares. The setting error and the drift have a state
    unless they are 0."""

    sigma: float
    lag: float
    air: AirColumn
    undulation: float
    setting: float = 0.0
    """1 sigma of the height error due to the setting, m."""
    drift: float = 0.0
    drift_time: float = 1.0

    def followed(self) -> tuple[int, ...]:
        """The errors that the filter has a state for."""
        return tuple(error for error, size in ((SETTING, self.setting), (DRIFT, self.drift)) if size > 0.0)


@dataclass(frozen=True)
class BarometricAltimeter:
    """Barometric altimeter: height above sea level from the static pressure at the IMU."""

    rate: float
    """Hz."""
    sigma: float
    """1 sigma of the white noise, m."""
    lag: float
    """Time constant of the first-order lag of the pressure in its tubes, s."""
    air: AirColumn
    """True air."""
    undulation: float
    """Geoid above the ellipsoid, m."""
    wrong_setting: float
    """Setting error, hPa, positive if set too high."""
    believed: PressureBeliefs
    """Filter model."""
    setting_sigma: float = 0.0
    """1 sigma of the setting error drawn in each run, hPa."""
    drift: float = 0.0
    """1 sigma of a Gauss-Markov error, m."""
    drift_time: float = 1.0
    """Its correlation time, s."""
    latency: float = 0.0
    """s."""

    def shown(self, time: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Noise-free reading (n,), m above sea level.

        height: (n,) m above the ellipsoid at times (n,), s, close enough for linear pressure in between.
        """
        outside = self.air.pressure(height - self.undulation)
        set_to = SEA_LEVEL + HECTOPASCAL * self.wrong_setting
        return pressure_altitude(late(time, outside, self.lag)) - pressure_altitude(set_to)

    @property
    def lasting(self) -> LastingErrors:
        """Time-correlated errors of the reading, m, at one time."""
        set_to = 1.0 + HECTOPASCAL * self.wrong_setting / SEA_LEVEL
        setting = self.setting_sigma * SLOPE * set_to ** (1.0 / _POWER - 1.0)
        sigma = np.array([setting, self.drift])
        return LastingErrors(("setting", "drift"), np.array([np.inf, self.drift_time]), sigma[:, None, None])

    @property
    def mean_lasting(self) -> np.ndarray:
        """Their means (2,), m."""
        return np.array([-float(pressure_altitude(SEA_LEVEL + HECTOPASCAL * self.wrong_setting)), 0.0])

    def drawn(self, time: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """Errors of the reading in a run (2, n), m, at ascending times (n,), s: its setting, and a stationary drift."""
        out = np.zeros((2, time.size))
        if self.setting_sigma > 0.0:
            set_to = SEA_LEVEL + HECTOPASCAL * self.wrong_setting
            off = HECTOPASCAL * self.setting_sigma * float(draw.standard_normal())
            out[SETTING] = float(pressure_altitude(np.array(set_to)) - pressure_altitude(np.array(set_to + off)))
        if self.drift > 0.0:
            kept = np.exp(-np.diff(time) / self.drift_time)
            new = self.drift * draw.standard_normal(time.size)
            value = np.empty(time.size)
            value[:1] = new[:1]
            for i, share in enumerate(kept):
                value[i + 1] = share * value[i] + np.sqrt(1.0 - share**2) * new[i + 1]
            out[DRIFT] = value
        return out

    def drift_at(self, at: np.ndarray, time: np.ndarray, drift: np.ndarray, draw: np.random.Generator) -> np.ndarray:
        """The drift (m,), m, at ascending times (m,), s, of a run whose drift at its measurements (n,), s, is known
        (n,): as the process is between them."""
        out, before = np.empty(at.size), -np.inf
        value = 0.0
        for i, (t, k) in enumerate(zip(at, np.searchsorted(time, at), strict=True)):
            if k and time[k - 1] >= before:
                before, value = time[k - 1], drift[k - 1]
            after, later = (time[k], drift[k]) if k < time.size else (np.inf, 0.0)
            kept, left = np.exp(-(t - before) / self.drift_time), np.exp(-(after - t) / self.drift_time)
            both = 1.0 - (kept * left) ** 2
            if both > 0.0:
                mean = (kept * (1.0 - left**2) * value + left * (1.0 - kept**2) * later) / both
                spread = self.drift * np.sqrt((1.0 - kept**2) * (1.0 - left**2) / both)
                value = mean + spread * float(draw.standard_normal())
            before, out[i] = t, value
        return out

    @property
    def as_believed(self) -> bool:
        """Whether the filter model equals the altimeter."""
        its = self.believed
        mine = self.sigma, self.lag, self.air, self.undulation, self.setting_sigma * SLOPE, self.drift
        right = self.wrong_setting == 0.0 and (self.drift == 0.0 or self.drift_time == its.drift_time)
        return right and mine == (its.sigma, its.lag, its.air, its.undulation, its.setting, its.drift)


def late(time: np.ndarray, value: np.ndarray, lag: float) -> np.ndarray:
    """First-order lag (s) of values (n,) at times (n,), linear between them, from the steady state of the initial
    slope."""
    if lag == 0.0:
        return value
    out = np.empty_like(value)
    slope = np.diff(value) / np.diff(time)
    behind = slope[0] * lag  # by how much the output is less than the input
    out[0] = value[0] - behind
    for i, (step, rise) in enumerate(zip(np.diff(time), slope, strict=True)):
        behind = rise * lag + (behind - rise * lag) * np.exp(-step / lag)
        out[i + 1] = value[i + 1] - behind
    return out
