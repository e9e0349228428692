"""The air's static pressure, and heights by it.

Sources: [1] ISO 2533 (1975), the standard atmosphere, its lowest layer, with heights for geopotential ones. [2]
`docs/theory/altimeters.md`, section 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.filter import states
from navsim.filter.measurement_kinds import PRESSURE, PressureTable
from navsim.filter.states import Block
from navsim.sensors.aiding import AidingSensor, SensorError, between, drawn_process
from navsim.trajectory.kinematics import Frame, Moving

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
_STEP = 0.01
"""Times between which a pressure is taken to change straight, s."""


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
class PressureDesign:
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
class BarometricAltimeter(AidingSensor):
    """Barometric altimeter: height above sea level from the static pressure at the IMU."""

    name, kind, numbers, unit = "barometric_altimeter", PRESSURE, ("height above sea level",), "m"

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
    design: PressureDesign
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

    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """What it shows (m, 1) without noise, m."""
        if self.lag == 0.0 or not time.size:
            return self.shown(time, flight.llh(time)[:, 2])[:, None]
        fine = np.linspace(0.0, time[-1], int(np.ceil(time[-1] / _STEP)) + 1)
        return np.interp(time, fine, self.shown(fine, flight.llh(fine)[:, 2]))[:, None]

    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, 1) of the white noise, m."""
        return np.full_like(exact, self.sigma)

    def table(self, frame: Frame, measured: np.ndarray) -> PressureTable:
        """Heights as the filter takes them: above the ellipsoid, by its own model of the air."""
        its = self.design
        height = its.air.height(measured[:, 0]) + its.undulation
        return PressureTable(height, np.full_like(height, (its.sigma / its.air.stretch) ** 2), its.lag)

    @property
    def slope(self) -> np.ndarray:
        """Derivative of the innovation by the height shown."""
        return np.eye(1) * self.state_scale

    @property
    def state_scale(self) -> float:
        """Metres of the filter's height for each metre shown."""
        return 1.0 / self.design.air.stretch

    @property
    def errors(self) -> tuple[SensorError, ...]:
        """Setting and drift, by what they add to what is shown, m."""
        set_to = 1.0 + HECTOPASCAL * self.wrong_setting / SEA_LEVEL
        setting = self.setting_sigma * SLOPE * set_to ** (1.0 / _POWER - 1.0)
        return SensorError("setting", setting, np.inf), SensorError("drift", self.drift, self.drift_time)

    def effects(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Both add to what is shown."""
        return (np.ones((time.size, 1, 1)),) * 2

    @property
    def mean_errors(self) -> np.ndarray:
        """Their means (2,), m."""
        return np.array([-float(pressure_altitude(SEA_LEVEL + HECTOPASCAL * self.wrong_setting)), 0.0])

    def drawn_errors(self, time: np.ndarray, draw: np.random.Generator) -> list[np.ndarray]:
        """Setting and stationary drift of a run (1, m), m, at ascending times (m,), s."""
        setting, drift = np.zeros((1, time.size)), np.zeros((1, time.size))
        if self.setting_sigma > 0.0:
            set_to = SEA_LEVEL + HECTOPASCAL * self.wrong_setting
            off = HECTOPASCAL * self.setting_sigma * float(draw.standard_normal())
            setting[:] = float(pressure_altitude(np.array(set_to)) - pressure_altitude(np.array(set_to + off)))
        if self.drift > 0.0:
            drift[0] = drawn_process(time, self.drift, self.drift_time, draw)
        return [setting, drift]

    def errors_between(
        self, at: np.ndarray, time: np.ndarray, drawn: Sequence[np.ndarray], draw: np.random.Generator
    ) -> list[np.ndarray]:
        """Both (1, o) at other times (o,), s, given those (1, m) at its measurements (m,), s."""
        setting = np.full((1, at.size), drawn[SETTING][0, 0] if time.size else 0.0)
        return [setting, between(at, time, drawn[DRIFT][0], self.drift, self.drift_time, draw)[None]]

    @property
    def followed(self) -> tuple[int, ...]:
        """The errors that the filter estimates."""
        return self.design.followed()

    def states(self, step: float) -> tuple[tuple[Block, float], ...]:
        """States for these errors, in metres of the filter's height."""
        its = self.design
        names, times, sigmas = ("setting", "drift"), (np.inf, its.drift_time), (its.setting, its.drift)
        out = []
        for error in its.followed():
            sigma = sigmas[error] / its.air.stretch
            block = states.correlated_single(
                f"barometric_{names[error]}", "m", PRESSURE, error, sigma, times[error], step
            )
            out.append((block, sigma))
        return tuple(out)

    @property
    def is_true_model(self) -> bool:
        """Whether the filter model equals the altimeter."""
        its = self.design
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
