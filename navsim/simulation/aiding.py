"""Sensors that aid the filter beside the receiver: what they measure along a flight, and what the filter makes of it.

A new one is its model in `models`, its observation in `estimation.observations`, its section in `scenario` with a line
in `Landing.aiding`, and a line in `_SENSORS` here: events, smoother, covariance analysis, budget of errors and result
file take it from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.core.streams import generator
from navsim.estimation.observations import ALTITUDE, AltitudeTable
from navsim.models.altimeter import Altimeter
from navsim.models.kinematics import Motion, Moving


@dataclass(frozen=True)
class Sensor:
    """How a model becomes a sensor of a flight: name, kind of its measurements
    (`estimation.observations`), what their numbers are and their unit; exact: what
    it would measure along a motion without noise (m, k); table: what was measured (m, k), with the 1 sigma (k,) that
    the filter believes in, as that kind's table; sign: of the innovation's change with a number."""

    name: str
    kind: int
    numbers: tuple[str, ...]
    unit: str
    exact: Callable[[Any, Motion], np.ndarray]
    table: Callable[[np.ndarray, np.ndarray], Any]
    sign: float


@dataclass(frozen=True)
class Aid:
    """A sensor on a flight. time: (m,) s of its measurements; exact: (m, k) without noise; sigma, believed: (k,) 1
    sigma of its white noise, and what the filter believes of it."""

    sensor: Sensor
    time: np.ndarray
    exact: np.ndarray
    sigma: np.ndarray
    believed: np.ndarray

    def measured(self, seed: int, run: int) -> np.ndarray:
        """What it measures in a run (m, k)."""
        return self.exact + self.sigma * generator(seed, run, "aids", self.sensor.kind).standard_normal(
            self.exact.shape
        )

    def table(self, measured: np.ndarray) -> Any:
        """Measurements (m, k) as the filter takes them."""
        return self.sensor.table(measured, self.believed)


_SENSORS: Mapping[type, Sensor] = {
    Altimeter: Sensor(
        "altimeter",
        ALTITUDE,
        ("height",),
        "m",
        lambda model, motion: motion.llh[:, 2:] + model.offset,
        lambda measured, believed: AltitudeTable(measured[:, 0].copy(), np.full_like(measured[:, 0], believed[0] ** 2)),
        -1.0,
    ),
}
"""The sensor of each model."""


def times_of(model: Any, duration: float, imu_rate: float) -> np.ndarray:
    """When a model measures on a flight of `duration` s (m,): 1 / rate, 2 / rate, ... s up to the last sample of the
    IMU, whose rate is in Hz."""
    last = np.floor(duration * imu_rate + 1e-9) / imu_rate
    return np.arange(1, int(np.floor(last * model.rate + 1e-9)) + 1) / model.rate


def aids_of(models: Sequence[Any], trajectory: Moving, duration: float, imu_rate: float) -> tuple[Aid, ...]:
    """The sensors of these models on a flight, measuring at their `times_of`. A model has its `rate` (Hz), and `sigma`
    and `believed` as of `Aid`. Raises ValueError for two of a kind."""
    kinds = [_SENSORS[type(model)].kind for model in models]
    if len(set(kinds)) < len(kinds):
        raise ValueError("a table of measurements belongs to one sensor: two of a kind cannot fly together")
    out = []
    for model in models:
        sensor = _SENSORS[type(model)]
        time = times_of(model, duration, imu_rate)
        exact = sensor.exact(model, trajectory.motion(time))
        out.append(Aid(sensor, time, exact, np.asarray(model.sigma), np.asarray(model.believed)))
    return tuple(out)
