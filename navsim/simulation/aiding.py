"""Sensors beside the receiver on a flight: when they measure, and what they measure in each run.

A sensor declares itself in its module of `sensors` (`sensors.aiding`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.filter.states import Block
from navsim.sensors.aiding import AidingSensor
from navsim.statistics.random_streams import branch, generator
from navsim.trajectory.kinematics import Frame, Moving


@dataclass(frozen=True)
class Aid:
    """A sensor on a flight."""

    sensor: AidingSensor
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
    effects: tuple[np.ndarray, ...]
    """(m, k, c) derivatives of the numbers by each of its time-correlated errors."""

    @property
    def missing(self) -> int:
        """Number of times without a measurement."""
        return int(np.isnan(self.exact).all(axis=1).sum())

    def exact_on(self, flight: Any) -> np.ndarray:
        """Measurements without errors (m, k) on the trajectory of a run, None for the route."""
        return self.exact if flight is None else self.sensor.noise_free(flight, self.time)

    def drawn(self, seed: int, run: int) -> list[np.ndarray]:
        """Each time-correlated error (c, m) in a run."""
        draw = generator(seed, run, "aids", self.sensor.kind)
        draw.standard_normal(self.exact.shape)  # that of its noise, which comes first
        return self.sensor.drawn_errors(self.time, draw)

    def measured(
        self, seed: int, run: int, flight: Any = None, exact: np.ndarray | None = None,
        drawn: Sequence[np.ndarray] | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Measurements in a run (m, k).

        flight: its trajectory, None for the route. exact: from `exact_on`. drawn: from `drawn`.
        """
        exact = self.exact_on(flight) if exact is None else exact
        drawn = self.drawn(seed, run) if drawn is None else drawn
        sigma = self.sensor.noise_sigma(exact)
        effects = self.effects if flight is None else self.sensor.effects(flight, self.time)
        draw = generator(seed, run, "aids", self.sensor.kind)
        measured: np.ndarray = exact + sigma * draw.standard_normal(exact.shape)
        if not effects:
            return self.sensor.spoiled(measured, draw)
        added = [np.einsum("mkc,cm->mk", effect, error) for effect, error in zip(effects, drawn, strict=True)]
        if self.sensor.clock is not None:
            added.append(self.sensor.drawn_clock(self.time, draw)[0, :, None])
        return self.sensor.spoiled(measured + np.sum(added, axis=0), draw)

    def true_states(self, seed: int, run: int, at: np.ndarray, drawn: Sequence[np.ndarray]) -> np.ndarray:
        """True values (o, j) of the filter's states of its errors in a run, at times (o,), s; drawn: from `drawn`."""
        sensor = self.sensor
        if not sensor.followed:
            return np.empty((at.size, 0))
        draw = generator(seed, run, "aids", sensor.kind)
        there = sensor.errors_between(at, self.time, drawn, branch(draw, 0))
        mean = sensor.mean_errors
        out = sensor.state_scale * np.concatenate([mean[i] + there[i] for i in sensor.followed]).T
        if sensor.clock is not None:
            offset, rate = sensor.clock_between(at, self.time, draw)
            out[:, -1] += offset
            out = np.column_stack([out, rate])
        return np.asarray(out)

    def table(self, measured: np.ndarray) -> Any:
        """Measurements (m, k), or of lanes, as the filter takes them."""
        return self.sensor.table(self.frame, measured)


def columns_on_ground(aids: Sequence[Aid], sources: int) -> list[np.ndarray]:
    """Column (m,) of each measurement's transmitter, which follow those of so many sources; -1 for other sensors."""
    out, first = [], sources
    for aid in aids:
        some = aid.sensor.transmitters
        out.append(first + aid.sensor.transmitter_at(aid.time) if some else np.full(aid.time.size, -1))
        first += some
    return out


def followed_errors(sensors: Sequence[AidingSensor], step: float) -> tuple[tuple[Block, float], ...]:
    """States that a filter has for errors of these sensors and their 1 sigma, blocks of three first.

    step: of the filter, s.
    """
    each = [state for sensor in sensors for state in sensor.states(step)]
    return tuple(sorted(each, key=lambda state: state[0].size < 3))


def measurement_times(sensor: AidingSensor, duration: float, imu_rate: float) -> np.ndarray:
    """Times (m,) at which a sensor measures on a flight of `duration` s: 1 / rate, 2 / rate, ... s, as long as
    measurements arrive up to the last sample of the IMU, whose rate is in Hz."""
    last = np.floor(duration * imu_rate + 1e-9) / imu_rate - sensor.latency
    return np.arange(1, int(np.floor(last * sensor.rate + 1e-9)) + 1) / sensor.rate


def aids_of(sensors: Sequence[AidingSensor], trajectory: Moving, duration: float, imu_rate: float) -> tuple[Aid, ...]:
    """These sensors on a flight, measuring at their `measurement_times`. Raises ValueError for two of a kind."""
    kinds = [sensor.kind for sensor in sensors]
    if len(set(kinds)) < len(kinds):
        raise ValueError("a table of measurements belongs to one sensor: two of a kind cannot fly together")
    out = []
    for each in sensors:
        time = measurement_times(each, duration, imu_rate)
        sensor = each.on_route(trajectory, time)
        exact = sensor.noise_free(trajectory, time)
        arrival = time + sensor.latency
        valid = np.maximum(arrival - sensor.design_latency, 0.0)
        effects = sensor.effects(trajectory, time)
        sigma = sensor.noise_sigma(exact)
        out.append(Aid(sensor, trajectory.frame, time, arrival, valid, exact, sigma, effects))
    return tuple(out)
