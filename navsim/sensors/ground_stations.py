"""Ground stations of a landing system: localizer and glide path (ILS), azimuth and elevation (MLS), and DME.

Angles are conical, as arrays radiate them:

    azimuth = asin(right . u),  elevation = asin(up . u),  u the unit vector from the station to the antenna

Each has white noise and two errors that last: a bias, constant in each run, and bends, a Gauss-Markov process.

Source: `docs/theory/ground-stations.md`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from navsim.filter.measurement_kinds import AZIMUTH, DISTANCE, ELEVATION, StationTable
from navsim.filter.states import Block, correlated_single
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss.interference.horizon import Terrain, behind
from navsim.gnss.signals import antenna_ecef
from navsim.sensors.aiding import AidingSensor, SensorError, estimated
from navsim.trajectory.kinematics import Frame, Moving


@dataclass(frozen=True)
class StationErrors:
    """1 sigma of the errors, rad or m."""

    bias: float
    """Constant in each run."""
    bends: float
    """Bends of the course or path, as the aircraft passes through them."""
    bends_time: float
    """Correlation time of the bends, s."""

    def listed(self) -> tuple[SensorError, SensorError]:
        """The errors in the order of the filter's states."""
        return SensorError("bias", self.bias, math.inf), SensorError("bends", self.bends, self.bends_time)


@dataclass(frozen=True)
class StationDesign:
    """Filter model of a station, whose fields it shares. It estimates the errors whose sigma is not 0."""

    noise: float
    latency: float
    lever_arm: np.ndarray
    errors: StationErrors


@lru_cache(maxsize=64)
def _llh(origin: bytes, axes: bytes, along: float, right: float, height: float) -> np.ndarray:
    """Position (3,), rad, rad, m, of a place in a frame, by the bytes of its origin and axes; each run asks for it."""
    turned = np.frombuffer(axes).reshape(3, 3) @ np.array([along, right, 0.0])
    out = llh_from_ecef(np.frombuffer(origin) + turned)
    out[2] = height
    return out


@dataclass(frozen=True)
class GroundStation(AidingSensor):
    """A station of a landing system, received by an antenna of its own."""

    varies = True
    transmitters = 1
    place: tuple[float, float, float]
    """Along the runway beyond the threshold, right of the centre line, above the threshold, m."""
    aim_point: float
    """Touchdown point beyond the threshold, m."""
    height: float
    """Height of the threshold above the ellipsoid, m."""
    rate: float
    """Hz."""
    latency: float
    """s."""
    noise: float
    """1 sigma of the white noise, rad or m."""
    limits: tuple[float, float]
    """Smallest and largest number that it measures, rad or m."""
    lever_arm: np.ndarray
    """(3,) IMU to antenna, body axes, m."""
    off: np.ndarray
    """(j, 2) times from which and until which the station is off, s."""
    faults: np.ndarray
    """(j, 4) times from which and until which it radiates an error, s; the error then, rad or m; its rate."""
    true_errors: StationErrors
    terrain: Callable[[np.ndarray], Terrain]
    """What hides it, by the threshold of the runway (3,), rad, rad, m."""
    design: StationDesign
    """Filter model."""

    @abstractmethod
    def axis(self, frame: Frame, llh: np.ndarray) -> np.ndarray:
        """Unit vector (3,), ECEF, of a station at llh (3,), see `StationTable`."""

    def llh(self, frame: Frame) -> np.ndarray:
        """Position (3,), rad, rad, m."""
        along, right, above = self.place
        return _llh(
            frame.origin.tobytes(), frame.axes.tobytes(), along - self.aim_point, right, self.height + above
        ).copy()

    def geometry(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angles or ranges (m,), rad or m, also outside the limits; where (m,) the aircraft is on the radiated side."""
        frame, llh = flight.frame, self.llh(flight.frame)
        away = antenna_ecef(flight.motion(time), self.lever_arm) - ecef_from_llh(llh)
        distance = np.linalg.norm(away, axis=1)
        exact, there = distance, np.ones(time.size, bool)
        if self.kind != DISTANCE:
            exact = np.arcsin(away @ self.axis(frame, llh) / distance)
            there = away @ frame.axes[:, 0] < 0.0  # it radiates towards the approach
        return exact, there

    def hidden(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Where (m,) terrain is between the antennas."""
        frame = flight.frame
        threshold = _llh(frame.origin.tobytes(), frame.axes.tobytes(), -self.aim_point, 0.0, self.height)
        if not (terrain := self.terrain(threshold)):
            return np.zeros(time.size, bool)
        antenna = antenna_ecef(flight.motion(time), self.lever_arm)
        return behind(terrain, ecef_from_llh(self.llh(frame))[None, None], antenna)[:, 0]

    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Angles or ranges (m, 1) with faults, rad or m; nan outside the coverage, behind terrain and while the station
        is off."""
        exact, there = self.geometry(flight, time)
        there &= (exact >= self.limits[0]) & (exact <= self.limits[1]) & ~self.hidden(flight, time)
        for start, end in self.off:
            there &= (time < start) | (time >= end)
        for start, end, error, rate in self.faults:
            exact = exact + np.where((time >= start) & (time < end), error + rate * (time - start), 0.0)
        return np.where(there, exact, np.nan)[:, None]

    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, 1) of the white noise, rad or m."""
        return np.full_like(exact, self.noise)

    def table(self, frame: Frame, measured: np.ndarray) -> StationTable:
        """Angles or ranges as the filter takes them."""
        llh, its = self.llh(frame), self.design
        return StationTable(
            measured[:, 0].copy(), ecef_from_llh(llh), self.axis(frame, llh), its.noise**2, its.lever_arm
        )

    @property
    def design_latency(self) -> float:
        """Age of a measurement on arrival in the filter model, s."""
        return self.design.latency

    @property
    def is_true_model(self) -> bool:
        """Whether the filter model equals the station."""
        its = self.design
        same = (self.noise, self.latency, self.true_errors) == (its.noise, its.latency, its.errors)
        return same and not self.faults.size and np.array_equal(self.lever_arm, its.lever_arm)

    @property
    def errors(self) -> tuple[SensorError, ...]:
        """Time-correlated errors."""
        return self.true_errors.listed()

    def effects(self, flight: Moving, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Derivatives (m, 1, 1) of the numbers by each error."""
        return (np.ones((time.size, 1, 1)),) * len(self.errors)

    @property
    def followed(self) -> tuple[int, ...]:
        """The errors that the filter estimates."""
        return estimated(self.design.errors.listed())

    def states(self, step: float) -> tuple[tuple[Block, float], ...]:
        """States for these errors, rad or m."""
        out = []
        for k in self.followed:
            error = self.design.errors.listed()[k]
            name = f"{self.name.partition('_')[0]}_{error.name}"
            block = correlated_single(name, self.unit, self.kind, k, error.sigma, error.time, step)
            out.append((block, error.sigma))
        return tuple(out)


class AzimuthStation(GroundStation):
    """Localizer of an ILS, or approach azimuth of an MLS."""

    name, kind, numbers, unit = "azimuth_station", AZIMUTH, ("azimuth",), "rad"

    def axis(self, frame: Frame, llh: np.ndarray) -> np.ndarray:
        """To the right across the runway."""
        return frame.axes[:, 1].copy()


class ElevationStation(GroundStation):
    """Glide path of an ILS, or approach elevation of an MLS."""

    name, kind, numbers, unit = "elevation_station", ELEVATION, ("elevation",), "rad"

    def axis(self, frame: Frame, llh: np.ndarray) -> np.ndarray:
        """Up at the station."""
        return -ned_matrix(llh)[2]


class Dme(GroundStation):
    """Distance measuring equipment."""

    name, kind, numbers, unit = "dme", DISTANCE, ("range",), "m"

    def axis(self, frame: Frame, llh: np.ndarray) -> np.ndarray:
        """None: a range has no axis."""
        return np.zeros(3)
