"""Satellites from tables of precise positions (SP3).

Source: [1] Schenewerk, A brief review of basic GPS orbit interpolation strategies, GPS Solutions 6 (2003).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from navsim.core.arrays.earth import RATE, SPEED_OF_LIGHT
from navsim.models.messages import Messages, for_each
from navsim.models.systems import System

_POINTS = 10
"""Points of the interpolating polynomial: millimetres for a table each 15 minutes, inside of it [1]."""


@dataclass(frozen=True)
class OrbitTable:
    """Positions of n satellites of any systems at t times: names (n,), time (t,) GPS s, position (t, n, 3) ECEF m, nan
    where missing, offset (t, n) satellite clocks, s, nan where missing; relativity of the eccentric orbit is not in
    them. left_out: what of a damaged file was left out, in words."""

    names: tuple[str, ...]
    time: np.ndarray
    position: np.ndarray
    offset: np.ndarray
    left_out: tuple[str, ...] = ()

    def of(self, system: System) -> PreciseOrbits:
        """The satellites of a system."""
        keep = [i for i, name in enumerate(self.names) if name.startswith(system.letter)]
        names = tuple(self.names[i] for i in keep)
        return PreciseOrbits(system, names, self.time, self.position[:, keep], self.offset[:, keep])


@dataclass(frozen=True)
class PreciseOrbits:
    """Satellites of one system by a table of positions and clocks, see `OrbitTable`."""

    system: System
    names: tuple[str, ...]
    time: np.ndarray
    position: np.ndarray
    offset: np.ndarray

    @property
    def channels(self) -> Mapping[str, int]:
        """None: tables do not tell them."""
        return {}

    @property
    def usable(self) -> np.ndarray:
        """(n,): all, for tables have no marks of health."""
        return np.ones(len(self.names), dtype=bool)

    def age(self, gpst: float) -> float:
        """How far a GPS time lies outside the table, s."""
        return float(max(self.time[0] - gpst, gpst - self.time[-1], 0.0))

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m, m/s, at GPS times (m,) or (m, n); nan outside the table and
        beside missing positions."""
        n = len(self.names)
        gpst = for_each(gpst, n)
        first = np.clip(np.searchsorted(self.time, gpst) - _POINTS // 2, 0, max(self.time.size - _POINTS, 0))
        window = first[..., None] + np.arange(min(_POINTS, self.time.size))
        step = float(np.median(np.diff(self.time))) if self.time.size > 1 else 1.0
        x = (self.time[window] - gpst[..., None]) / step
        value, slope = _lagrange_at_zero(x)
        satellite = np.arange(n)[None, :, None]
        points = self.position[window, satellite]
        # in axes that stop turning at the wanted time the path is smoother
        angle = RATE * step * x
        c, s = np.cos(angle), np.sin(angle)
        still = np.stack(
            [c * points[..., 0] - s * points[..., 1], s * points[..., 0] + c * points[..., 1], points[..., 2]], axis=-1
        )
        position = np.einsum("mnk,mnkj->mnj", value, still)
        velocity = np.einsum("mnk,mnkj->mnj", slope / step, still)
        velocity[..., 0] += RATE * position[..., 1]
        velocity[..., 1] -= RATE * position[..., 0]
        outside = (gpst < self.time[0]) | (gpst > self.time[-1])
        position[outside], velocity[outside] = np.nan, np.nan
        return position, velocity

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Satellite clocks, s, and their rates (m, n), linear between the table's, with relativity -2 r.v / c2."""
        gpst = for_each(gpst, len(self.names))
        low = np.clip(np.searchsorted(self.time, gpst, side="right") - 1, 0, self.time.size - 2)
        column = np.arange(len(self.names))[None, :]
        width = self.time[low + 1] - self.time[low]
        rate = (self.offset[low + 1, column] - self.offset[low, column]) / width
        position, velocity = self.state(gpst)
        relativity = -2.0 * np.sum(position * velocity, axis=2) / SPEED_OF_LIGHT**2
        # the velocity in rotating axes will do: the Earth's rate is across the position
        return self.offset[low, column] + rate * (gpst - self.time[low]) + relativity, rate

    def accuracy(self, gpst: np.ndarray) -> np.ndarray:
        """Unknown (m, n): tables have none that is read."""
        return np.full(for_each(gpst, len(self.names)).shape, np.nan)

    def using_unhealthy(self) -> PreciseOrbits:
        """Itself."""
        return self

    def broadcast(self, first: float, last: float) -> PreciseOrbits:
        """Itself: messages are not made of tables."""
        return self

    def messages(self, gpst: np.ndarray) -> Messages | None:
        """None: messages are not made of tables."""
        return None


def _lagrange_at_zero(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (..., k) of k points at x (..., k) for the polynomial's value and slope at 0."""
    k = x.shape[-1]
    value, slope = np.ones_like(x), np.zeros_like(x)
    for i in range(k):
        for j in range(k):
            if j == i:
                continue
            factor = -x[..., j] / (x[..., i] - x[..., j])
            slope[..., i] = slope[..., i] * factor + value[..., i] / (x[..., i] - x[..., j])
            value[..., i] = value[..., i] * factor
    return value, slope
