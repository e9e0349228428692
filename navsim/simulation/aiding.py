"""Sensors beside the receiver that aid the filter: their measurements along a flight and their filter models.

A new sensor has a model in `sensors`, a measurement model in `filter.measurement_models`, a section in `scenario` with
a line in `Landing.aiding`, and a line in `_SENSORS` here. Events, smoother, covariance analysis, error budget and
result file take it from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.filter import states
from navsim.filter.measurement_models import (
    ABOVE_GROUND,
    ALTITUDE,
    PRESSURE,
    AltitudeTable,
    GroundTable,
    PressureTable,
)
from navsim.filter.states import Block
from navsim.gnss.correlated_errors import LastingErrors
from navsim.sensors.altimeter import Altimeter, Centreline, RadioAltimeter
from navsim.sensors.barometer import DRIFT, SETTING, BarometricAltimeter
from navsim.statistics.random_streams import branch, generator
from navsim.trajectory.kinematics import Frame, Moving


@dataclass(frozen=True)
class Sensor:
    """Definition of a type of sensor: how a model of it measures on a flight, and how a filter uses it."""

    name: str
    """Name."""
    kind: int
    """Kind of its measurements (`filter.measurement_models`)."""
    numbers: tuple[str, ...]
    """Name of each number that it measures."""
    unit: str
    """Unit of the numbers."""
    exact: Callable[[Any, Moving, np.ndarray], np.ndarray]
    """Noise-free measurements (m, k) on a flight at times (m,), s; nan where it measures nothing."""
    sigma: Callable[[Any, np.ndarray], np.ndarray]
    """1 sigma (m, k) of the white noise there."""
    table: Callable[[Any, Frame, np.ndarray], Any]
    """Table of that kind from measurements (m, k)."""
    slope: Callable[[Any], float]
    """Derivative of the innovation by a number."""
    as_believed: Callable[[Any], bool]
    """Whether the filter model equals the model."""
    believed_latency: Callable[[Any], float] = lambda model: 0.0
    """Age of a measurement on arrival in the filter model, s."""
    lasting: Lasting | None = None
    """Time-correlated errors; None without."""


@dataclass(frozen=True)
class Lasting:
    """Time-correlated errors of a sensor's numbers; each field is a function of the model."""

    errors: Callable[[Any], LastingErrors]
    """The errors, of one source at one time."""
    mean: Callable[[Any], np.ndarray]
    """(j,) mean of each."""
    drawn: Callable[[Any, np.ndarray, np.random.Generator], np.ndarray]
    """(j, m) errors of a run at times (m,), s."""
    between: Callable[[Any, np.ndarray, np.ndarray, np.ndarray, np.random.Generator], np.ndarray]
    """(j, o) errors of a run at other times (o,), given those at its measurements."""
    followed: Callable[[Any], tuple[int, ...]]
    """Errors that the filter estimates, in order."""
    states: Callable[[Any, float], tuple[tuple[Block, float], ...]]
    """States for these errors and their 1 sigma, for a filter step of so many seconds."""


@dataclass(frozen=True)
class Aid:
    """A sensor on a flight."""

    sensor: Sensor
    model: Any
    frame: Frame
    time: np.ndarray
    """(m,) times of its measurements, s."""
    arrival: np.ndarray
    """(m,) times of arrival, s."""
    valid: np.ndarray
    """(m,) times of validity in the filter model, s."""
    exact: np.ndarray
    """(m, k) noise-free, nan where it measures nothing."""
    sigma: np.ndarray
    """(m, k) 1 sigma of its white noise."""

    @property
    def missing(self) -> int:
        """Number of times without a measurement."""
        return int(np.isnan(self.exact).all(axis=1).sum())

    @property
    def slope(self) -> float:
        """Derivative of the filter's innovation by a measured number."""
        return self.sensor.slope(self.model)

    @property
    def as_believed(self) -> bool:
        """Whether the filter model equals the sensor."""
        return self.sensor.as_believed(self.model)

    def exact_on(self, flight: Any) -> np.ndarray:
        """Measurements without errors (m, k) on the trajectory of a run, None for the route."""
        return self.exact if flight is None else self.sensor.exact(self.model, flight, self.time)

    def measured(self, seed: int, run: int, exact: np.ndarray | None = None) -> np.ndarray:
        """Measurements in a run (m, k); exact: from `exact_on`, None for the route."""
        exact = self.exact if exact is None else exact
        sigma = self.sensor.sigma(self.model, exact)
        draw = generator(seed, run, "aids", self.sensor.kind)
        measured: np.ndarray = exact + sigma * draw.standard_normal(exact.shape)
        if self.sensor.lasting is None:
            return measured
        return measured + self.sensor.lasting.drawn(self.model, self.time, draw).sum(axis=0)[:, None]

    @property
    def followed(self) -> tuple[int, ...]:
        """Time-correlated errors that the filter estimates."""
        return () if self.sensor.lasting is None else self.sensor.lasting.followed(self.model)

    def errors(self, seed: int, run: int, at: np.ndarray) -> np.ndarray:
        """True values (o, j) of the filter's states for time-correlated errors in a run, at times (o,), s."""
        lasting, which = self.sensor.lasting, list(self.followed)
        if lasting is None or not which:
            return np.empty((at.size, 0))
        draw = generator(seed, run, "aids", self.sensor.kind)
        draw.standard_normal(self.exact.shape)  # that of its noise, which comes first
        drawn = lasting.drawn(self.model, self.time, draw)
        there = lasting.between(self.model, at, self.time, drawn, branch(draw, 0))
        return self.slope * (lasting.mean(self.model)[:, None] + there)[which].T

    def table(self, measured: np.ndarray) -> Any:
        """Measurements (m, k), or of lanes, as the filter takes them."""
        return self.sensor.table(self.model, self.frame, measured)


def _of_ground(model: RadioAltimeter, frame: Frame, measured: np.ndarray) -> GroundTable:
    """Heights (m, 1) above ground as the filter takes them."""
    strip, its = Centreline.of(frame, model.aim_point, model.height), model.believed
    return GroundTable(
        measured[:, 0].copy(), its.floor, its.share, its.start, strip.threshold, strip.scale, strip.direction,
        its.ground.along, its.ground.height, its.lever_arm,
    )  # fmt: skip


def _pressure_states(model: BarometricAltimeter, step: float) -> tuple[tuple[Block, float], ...]:
    """States for a barometric altimeter's errors, in m of the height that the filter computes from the reading."""
    its = model.believed
    names, times, sigmas = ("setting", "drift"), (np.inf, its.drift_time), (its.setting, its.drift)
    out = []
    for error in its.followed():
        sigma = sigmas[error] / its.air.stretch
        block = states.alone(f"barometric_{names[error]}", "m", PRESSURE, error, sigma, times[error], step)
        out.append((block, sigma))
    return tuple(out)


def _pressure_between(
    model: BarometricAltimeter, at: np.ndarray, time: np.ndarray, drawn: np.ndarray, draw: np.random.Generator
) -> np.ndarray:
    """The errors of a barometric altimeter at times (o,), s, by those (2, m) at its measurements (m,), s."""
    setting = np.full(at.size, drawn[SETTING, 0] if time.size else 0.0)
    return np.stack([setting, model.drift_at(at, time, drawn[DRIFT], draw)])


_STEP = 0.01
"""Times between which a pressure is taken to change straight, s."""


def _shown(model: BarometricAltimeter, flight: Moving, time: np.ndarray) -> np.ndarray:
    """Reading of a barometric altimeter on a flight at times (m,), s, without noise (m,), m."""
    if model.lag == 0.0 or not time.size:
        return model.shown(time, flight.llh(time)[:, 2])
    fine = np.linspace(0.0, time[-1], int(np.ceil(time[-1] / _STEP)) + 1)
    return np.interp(time, fine, model.shown(fine, flight.llh(fine)[:, 2]))


def _of_pressure(model: BarometricAltimeter, frame: Frame, measured: np.ndarray) -> PressureTable:
    """Heights (m, 1) above the ellipsoid from pressure, with the air of the filter model."""
    its = model.believed
    height = its.air.height(measured[:, 0]) + its.undulation
    return PressureTable(height, np.full_like(height, (its.sigma / its.air.stretch) ** 2), its.lag)


_SENSORS: Mapping[type, Sensor] = {
    Altimeter: Sensor(
        "altimeter",
        ALTITUDE,
        ("height",),
        "m",
        lambda model, flight, time: flight.llh(time)[:, 2:] + model.offset,
        lambda model, exact: np.full_like(exact, model.sigma),
        lambda model, frame, measured: AltitudeTable(
            measured[:, 0].copy(), np.full_like(measured[:, 0], model.believed**2)
        ),
        lambda model: -1.0,
        lambda model: bool(model.sigma == model.believed),
    ),
    RadioAltimeter: Sensor(
        "radio_altimeter",
        ABOVE_GROUND,
        ("height above ground",),
        "m",
        lambda model, flight, time: model.exact(flight.frame, flight.motion(time))[:, None],
        lambda model, exact: model.sigma(exact),
        _of_ground,
        lambda model: 1.0,
        lambda model: model.as_believed,
        lambda model: float(model.believed.latency),
    ),
    BarometricAltimeter: Sensor(
        "barometric_altimeter",
        PRESSURE,
        ("height above sea level",),
        "m",
        lambda model, flight, time: _shown(model, flight, time)[:, None],
        lambda model, exact: np.full_like(exact, model.sigma),
        _of_pressure,
        lambda model: 1.0 / model.believed.air.stretch,
        lambda model: model.as_believed,
        lasting=Lasting(
            lambda model: model.lasting,
            lambda model: model.mean_lasting,
            lambda model, time, draw: model.drawn(time, draw),
            _pressure_between,
            lambda model: model.believed.followed(),
            _pressure_states,
        ),
    ),
}
"""The sensor of each model."""


def followed_errors(models: Sequence[Any], step: float) -> tuple[tuple[Block, float], ...]:
    """States of a filter for time-correlated errors of these models, and their 1 sigma; step: of the filter, s."""
    lasting = ((model, _SENSORS[type(model)].lasting) for model in models)
    return tuple(state for model, one in lasting if one is not None for state in one.states(model, step))


def believed_latency(model: Any) -> float:
    """Age of a model's measurements on arrival in the filter model, s."""
    return _SENSORS[type(model)].believed_latency(model)


def times_of(model: Any, duration: float, imu_rate: float) -> np.ndarray:
    """Times (m,) of a model's measurements on a flight of `duration` s: 1 / rate, 2 / rate, ... s.

    Measurements end with the last sample of the IMU, whose rate is in Hz.
    """
    last = np.floor(duration * imu_rate + 1e-9) / imu_rate - model.latency
    return np.arange(1, int(np.floor(last * model.rate + 1e-9)) + 1) / model.rate


def aids_of(models: Sequence[Any], trajectory: Moving, duration: float, imu_rate: float) -> tuple[Aid, ...]:
    """The sensors of these models on a flight, measuring at their `times_of`. A model has its `rate` (Hz) and `latency`
    (s). Raises ValueError for two of a kind."""
    kinds = [_SENSORS[type(model)].kind for model in models]
    if len(set(kinds)) < len(kinds):
        raise ValueError("a table of measurements belongs to one sensor: two of a kind cannot fly together")
    out = []
    for model in models:
        sensor, frame = _SENSORS[type(model)], trajectory.frame
        time = times_of(model, duration, imu_rate)
        exact = sensor.exact(model, trajectory, time)
        arrival = time + model.latency
        valid = np.maximum(arrival - believed_latency(model), 0.0) if model.latency else time
        out.append(Aid(sensor, model, frame, time, arrival, valid, exact, sensor.sigma(model, exact)))
    return tuple(out)
