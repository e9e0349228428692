"""The landing circuit of the tracking systems: an aircraft about a radar, flown by roll, speed and path angle.

Axes: N north, h up, E east from the radar; azimuth clockwise from north, elevation up. Roll, speed and path angle
follow raised-cosine ramps; load factors, track and position follow from them.
Source: `docs/theory/circuit.md`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

G = 9.80665


@dataclass(frozen=True)
class Circuit:
    """Start of the circuit and its commands: rows (start s, duration s, increment) in rad, m/s."""

    north: float
    east: float
    height: float
    track: float
    speed: float
    roll: np.ndarray
    acceleration: np.ndarray
    path_angle: np.ndarray
    duration: float


@dataclass(frozen=True)
class CircuitFlight:
    """Motion of the aircraft at n times; SI, rad. A trailing 1 marks a derivative.

    Range, ground range, azimuth, elevation and their derivatives are relative to the radar.
    """

    time: np.ndarray
    """(n,)."""
    position: np.ndarray
    """(n, 3) N, h, E."""
    speed: np.ndarray
    path_angle: np.ndarray
    track: np.ndarray
    roll: np.ndarray
    speed1: np.ndarray
    path_angle1: np.ndarray
    track1: np.ndarray
    load: np.ndarray
    """(n, 3) load factors along the velocity, up and right in velocity axes (nx, ny, nz)."""

    @property
    def range(self) -> np.ndarray:
        """Slant range, m."""
        return np.linalg.norm(self.position, axis=1)

    @property
    def ground_range(self) -> np.ndarray:
        """Horizontal range, m."""
        return np.hypot(self.position[:, 0], self.position[:, 2])

    @property
    def azimuth(self) -> np.ndarray:
        """Clockwise from north, -pi ... pi."""
        return np.arctan2(self.position[:, 2], self.position[:, 0])

    @property
    def elevation(self) -> np.ndarray:
        """Elevation of the line of sight."""
        return np.arctan2(self.position[:, 1], self.ground_range)

    @property
    def azimuth1(self) -> np.ndarray:
        """Rate of the azimuth: V cos(theta) sin(phi - azimuth) / Dh."""
        return self.speed * np.cos(self.path_angle) * np.sin(self.track - self.azimuth) / self.ground_range

    @property
    def ground_range1(self) -> np.ndarray:
        """Rate of the horizontal range."""
        return self.speed * np.cos(self.path_angle) * np.cos(self.track - self.azimuth)

    @property
    def elevation1(self) -> np.ndarray:
        """Rate of the elevation."""
        up = self.speed * np.sin(self.path_angle)
        return (up * np.cos(self.elevation) - self.ground_range1 * np.sin(self.elevation)) / self.range

    @property
    def range1(self) -> np.ndarray:
        """Rate of the slant range."""
        up = self.speed * np.sin(self.path_angle)
        return self.ground_range1 * np.cos(self.elevation) + up * np.sin(self.elevation)

    def level_acceleration(self) -> tuple[np.ndarray, np.ndarray]:
        """Horizontal acceleration along the track and to the right of it, m/s2, from the load factors."""
        return level_acceleration(self.load, self.roll, self.path_angle)

    @property
    def azimuth2(self) -> np.ndarray:
        """Acceleration of the azimuth, rigorous: (a_t - 2 Dh' az') / Dh."""
        ahead, right = self.level_acceleration()
        d = self.track - self.azimuth
        tangential = ahead * np.sin(d) + right * np.cos(d)
        return (tangential - 2.0 * self.ground_range1 * self.azimuth1) / self.ground_range

    @property
    def azimuth2_literal(self) -> np.ndarray:
        """The paper's value of it (`docs/theory/azimuth.md`, eq. (1)): the north component of the acceleration over
        Dh."""
        ahead, right = self.level_acceleration()
        return (ahead * np.cos(self.track) - right * np.sin(self.track)) / self.ground_range

    @property
    def range2(self) -> np.ndarray:
        """Acceleration of the slant range: a.u + D (ev'^2 + az'^2 cos^2 ev)."""
        ahead, right = self.level_acceleration()
        d = self.track - self.azimuth
        up = self.speed1 * np.sin(self.path_angle) + self.speed * np.cos(self.path_angle) * self.path_angle1
        radial = ahead * np.cos(d) - right * np.sin(d)
        along = radial * np.cos(self.elevation) + up * np.sin(self.elevation)
        return along + self.range * (self.elevation1**2 + (self.azimuth1 * np.cos(self.elevation)) ** 2)


def level_acceleration(load: np.ndarray, roll: np.ndarray, path_angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal acceleration (n,) along the track and right of it, m/s2, from load factors (n, 3) in velocity axes."""
    ny = load[..., 1] * np.cos(roll) - load[..., 2] * np.sin(roll)
    nz = load[..., 1] * np.sin(roll) + load[..., 2] * np.cos(roll)
    return G * (load[..., 0] * np.cos(path_angle) - ny * np.sin(path_angle)), G * nz


def _ramps(t: np.ndarray, start: float, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A value and its derivative after raised-cosine ramps."""
    value, rate = np.full_like(t, start), np.zeros_like(t)
    for begin, length, increment in commands.reshape(-1, 3):
        u = np.clip((t - begin) / length, 0.0, 1.0)
        value += 0.5 * increment * (1.0 - np.cos(np.pi * u))
        inside = (t > begin) & (t < begin + length)
        rate += np.where(inside, 0.5 * increment * np.pi / length * np.sin(np.pi * u), 0.0)
    return value, rate


def _track_rate(circuit: Circuit, t: np.ndarray) -> np.ndarray:
    speed, _ = _ramps(t, circuit.speed, circuit.acceleration)
    angle, angle1 = _ramps(t, 0.0, circuit.path_angle)
    roll, _ = _ramps(t, 0.0, circuit.roll)
    # ny sin(roll) = (V theta' / g + cos theta) tan(roll)
    return G * (speed * angle1 / G + np.cos(angle)) * np.tan(roll) / (speed * np.cos(angle))


def _cumulative_simpson(rate: np.ndarray, step: float) -> np.ndarray:
    """Integral at every second node of a grid of half steps, from zero."""
    pieces = step / 6.0 * (rate[:-2:2] + 4.0 * rate[1::2] + rate[2::2])
    return np.concatenate([np.zeros((1, *rate.shape[1:])), np.cumsum(pieces, axis=0)])


def fly(circuit: Circuit, step: float = 0.01) -> CircuitFlight:
    """The circuit on a grid of `step` s, integrated by Simpson's rule; 1e-4 m against half the step."""
    nodes = round(circuit.duration / step)
    quarter = np.arange(4 * nodes + 1) * (step / 4.0)
    track = circuit.track + _cumulative_simpson(_track_rate(circuit, quarter), step / 2.0)
    half = quarter[::2]
    speed, _ = _ramps(half, circuit.speed, circuit.acceleration)
    angle, _ = _ramps(half, 0.0, circuit.path_angle)
    velocity = np.stack(
        [speed * np.cos(angle) * np.cos(track), speed * np.sin(angle), speed * np.cos(angle) * np.sin(track)], axis=1
    )
    position = np.array([circuit.north, circuit.height, circuit.east]) + _cumulative_simpson(velocity, step)
    t = half[::2]
    speed, speed1 = _ramps(t, circuit.speed, circuit.acceleration)
    angle, angle1 = _ramps(t, 0.0, circuit.path_angle)
    roll, _ = _ramps(t, 0.0, circuit.roll)
    ny = (speed * angle1 / G + np.cos(angle)) / np.cos(roll)
    load = np.stack([speed1 / G + np.sin(angle), ny, np.zeros_like(ny)], axis=1)
    return CircuitFlight(t, position, speed, angle, track[::2], roll, speed1, angle1, _track_rate(circuit, t), load)


def at(flight: CircuitFlight, time: np.ndarray) -> CircuitFlight:
    """The flight at other times, linear between its nodes (1e-4 m at 0.01 s)."""

    def picked(values: np.ndarray) -> np.ndarray:
        if values.ndim == 1:
            return np.interp(time, flight.time, values)
        return np.stack([np.interp(time, flight.time, column) for column in values.T], axis=1)

    return CircuitFlight(np.asarray(time, dtype=float), *(
        picked(getattr(flight, name)) for name in CircuitFlight.__dataclass_fields__ if name != "time"
    ))  # fmt: skip
