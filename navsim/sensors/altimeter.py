"""Altimeters: one that is off by a constant and white noise, and a radio altimeter over ground of a known profile.

Source: `docs/theory/altimeters.md`, section 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.filter.measurement_kinds import ABOVE_GROUND, ALTITUDE, AltitudeTable, GroundTable
from navsim.geodesy.earth import llh_from_ecef
from navsim.geodesy.earth_kernels import radii
from navsim.gnss.interference.horizon import Terrain
from navsim.sensors.aiding import AidingSensor
from navsim.trajectory.kinematics import Frame, Motion, Moving

_PROFILE = -15e3, 5e3, 5.0
"""Distances beyond the threshold between which the filter has the terrain as a profile, and their step, m."""


@dataclass(frozen=True)
class Altimeter(AidingSensor):
    """Altimeter that measures the height of the IMU above the ellipsoid."""

    name, kind, numbers, unit = "altimeter", ALTITUDE, ("height",), "m"

    rate: float
    """Hz."""
    offset: float
    """Constant error, m, positive if it reads too high; unknown to the filter."""
    sigma: float
    """1 sigma of its white noise, m."""
    design: float
    """1 sigma in the filter model, m."""
    latency: float = 0.0
    """s."""

    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Heights (m, 1) with their offset, m."""
        return flight.llh(time)[:, 2:] + self.offset

    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, 1) of the white noise, m."""
        return np.full_like(exact, self.sigma)

    def table(self, frame: Frame, measured: np.ndarray) -> AltitudeTable:
        """Heights as the filter takes them."""
        return AltitudeTable(measured[:, 0].copy(), np.full_like(measured[:, 0], self.design**2))

    @property
    def slope(self) -> np.ndarray:
        """Derivative of the innovation, which points down, by the height."""
        return -np.eye(1)

    @property
    def is_true_model(self) -> bool:
        """Whether the filter model equals the sensor."""
        return bool(self.sigma == self.design)


@dataclass(frozen=True)
class Ground:
    """Profile of the ground along the approach, constant across it.

    Straight between the points; the first and last height hold beyond the ends.
    """

    along: np.ndarray
    """(g,) distance beyond the threshold in the direction of landing, m, increasing."""
    height: np.ndarray
    """(g,) m above the runway height of the scenario."""

    def at(self, along: np.ndarray) -> np.ndarray:
        """Height (n,), m, at distances (n,), m."""
        return np.interp(along, self.along, self.height)


@dataclass(frozen=True)
class Centreline:
    """Origin and direction of distances along an approach."""

    threshold: np.ndarray
    """llh (3,) rad, rad, m."""
    scale: np.ndarray
    """(2,) metres in a radian of latitude and of longitude there."""
    direction: np.ndarray
    """(2,) cosine and sine of the direction of landing, clockwise from north."""

    @classmethod
    def of(cls, frame: Frame, aim_point: float, height: float) -> Centreline:
        """Centreline of a runway whose touchdown point, `aim_point` m beyond its threshold, is the origin of
        `frame`."""
        llh = llh_from_ecef(frame.origin - aim_point * frame.axes[:, 0])
        lat, lon = llh[:2]
        north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
        east = np.array([-math.sin(lon), math.cos(lon), 0.0])
        direction = np.array([north @ frame.axes[:, 0], east @ frame.axes[:, 0]])
        meridian, transverse = radii(math.sin(lat))
        scale = np.array([meridian + height, (transverse + height) * math.cos(lat)])
        return cls(np.array([lat, lon, height]), scale, direction / np.linalg.norm(direction))

    def along(self, llh: np.ndarray, arm: np.ndarray) -> np.ndarray:
        """Distance beyond the threshold (n,), m, of points at `arm` (n, 3), NED m, from positions llh (n, 3)."""
        turn = llh[:, 1] - self.threshold[1]
        turn -= 2.0 * math.pi * np.floor(turn / (2.0 * math.pi) + 0.5)
        north = (llh[:, 0] - self.threshold[0]) * self.scale[0] + arm[:, 0]
        return self.direction[0] * north + self.direction[1] * (turn * self.scale[1] + arm[:, 1])


@dataclass(frozen=True)
class RadioAltimeterDesign:
    """Filter model of a `RadioAltimeter`, whose fields it shares."""

    floor: float
    share: float
    ground: Ground | None
    """None: the terrain under the centre line."""
    lever_arm: np.ndarray
    latency: float
    start: float = -math.inf
    """Distance beyond the threshold from which the filter uses it, m."""


@dataclass(frozen=True)
class RadioAltimeter(AidingSensor):
    """Radio altimeter: height of its antenna above the ground."""

    name, kind, numbers, unit = "radio_altimeter", ABOVE_GROUND, ("height above ground",), "m"

    rate: float
    """Hz."""
    floor: float
    """Smallest 1 sigma of the white noise, m."""
    share: float
    """1 sigma as a fraction of the height, if that is larger than `floor`."""
    lowest: float
    """Smallest height that it measures, m."""
    highest: float
    """Largest height that it measures, m."""
    tilt: float
    """Largest angle between the aircraft's vertical axis and the vertical at which it measures, rad."""
    latency: float
    """s."""
    ground: Ground
    """True ground."""
    lever_arm: np.ndarray
    """(3,) IMU to antenna, body axes, m."""
    aim_point: float
    """Aim point of the runway, see `Centreline.of`, also for `height`."""
    height: float
    design: RadioAltimeterDesign
    """Filter model."""
    terrain: Callable[[np.ndarray], Terrain] | None = None
    """In place of `ground`: files of heights, by the threshold (3,), rad, rad, m."""

    def exact(self, frame: Frame, motion: Motion) -> np.ndarray:
        """Noise-free measurements along a motion (m,), m; nan where it does not measure."""
        arm = motion.c_nb @ self.lever_arm
        strip = Centreline.of(frame, self.aim_point, self.height)
        if self.terrain is None:
            ground = self.ground.at(strip.along(motion.llh, arm))
        else:
            below = motion.llh[:, :2] + arm[:, :2] / strip.scale
            ground = self.terrain(strip.threshold).ground(below) - self.height
        above = motion.llh[:, 2] - arm[:, 2] - self.height - ground
        near = 1e-6  # on the ground the height is 0 m, but for rounding
        there = (above >= self.lowest - near) & (above <= self.highest + near)
        return np.where(there & (motion.c_nb[:, 2, 2] >= math.cos(self.tilt)), above, np.nan)

    def noise_free(self, flight: Moving, time: np.ndarray) -> np.ndarray:
        """Heights (m, 1), m; nan where it does not measure."""
        return self.exact(flight.frame, flight.motion(time))[:, None]

    def noise_sigma(self, exact: np.ndarray) -> np.ndarray:
        """1 sigma (m, 1) of the white noise, m; the floor's where it does not measure."""
        return np.fmax(self.floor, self.share * exact)

    def table(self, frame: Frame, measured: np.ndarray) -> GroundTable:
        """Heights as the filter takes them, and its ground."""
        strip, its = Centreline.of(frame, self.aim_point, self.height), self.design
        ground = self._under_centreline(strip) if its.ground is None else its.ground
        return GroundTable(
            measured[:, 0].copy(), its.floor, its.share, its.start, strip.threshold, strip.scale, strip.direction,
            ground.along, ground.height, its.lever_arm,
        )  # fmt: skip

    def _under_centreline(self, strip: Centreline) -> Ground:
        """Profile of the terrain along the centre line; without the places that have no height."""
        assert self.terrain is not None
        along = np.arange(*_PROFILE)
        below = strip.threshold[:2] + along[:, None] * strip.direction / strip.scale
        height = self.terrain(strip.threshold).ground(below)
        known = np.isfinite(height)
        return Ground(along[known], height[known] - self.height)

    @property
    def design_latency(self) -> float:
        """Age of a measurement on arrival in the filter model, s."""
        return float(self.design.latency)

    @property
    def is_true_model(self) -> bool:
        """Whether the filter model equals the altimeter."""
        mine, its = self, self.design
        return (
            (mine.floor, mine.share, mine.latency) == (its.floor, its.share, its.latency)
            and np.array_equal(mine.lever_arm, its.lever_arm)
            and its.ground is not None
            and mine.terrain is None
            and np.array_equal(mine.ground.along, its.ground.along)
            and np.array_equal(mine.ground.height, its.ground.height)
        )
