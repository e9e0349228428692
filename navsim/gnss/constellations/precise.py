"""Satellites from tables of precise positions (SP3).

Source: [1] Schenewerk, A brief review of basic GPS orbit interpolation strategies, GPS Solutions 6 (2003).
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.geodesy.earth import RATE, SPEED_OF_LIGHT
from navsim.gnss import timescales
from navsim.gnss.constellations.constellation import WithoutMessages
from navsim.gnss.constellations.messages import for_each
from navsim.gnss.constellations.systems import SYSTEMS, System

_POINTS = 10
"""Points of the interpolating polynomial: millimetres for a table each 15 minutes, inside of it [1]."""
_LARGEST_ERROR = 0.1
"""Largest error of interpolation of positions that are given, m."""
_RADIUS, _ANGULAR_RATE = 2.7e7, 1.56e-4
"""Radius, m, and rate, rad/s, of a circular orbit for the error estimate if further epochs are missing: about those of
the fastest satellites, GLONASS."""
_MOST_LINES, _MOST_NAMES, _MOST_SPANS = 8, 12, 3
"""Largest number of lines, of satellites and of intervals in each, in messages about gaps in a table."""
_NEAREST = 0.3
"""Steps from an epoch within which the error is that at this distance: also an epoch's own place may be a blunder."""
_UNEVEN = 1e-3
"""By how much steps from epoch to epoch may differ, relative."""


@dataclass(frozen=True)
class OrbitTable:
    """Positions of n satellites of any systems at t times."""

    names: tuple[str, ...]
    time: np.ndarray
    """(t,) GPS s."""
    position: np.ndarray
    """(t, n, 3) ECEF, m, nan where missing."""
    offset: np.ndarray
    """(t, n) satellite clocks without the relativistic effect of eccentricity, s, nan where missing."""
    manoeuvres: np.ndarray
    """(t, n) whether the orbit jumped since the epoch before."""
    clock_events: np.ndarray
    """(t, n) whether the clock jumped since the epoch before."""
    left_out: tuple[str, ...] = ()
    """Messages about omitted parts of a damaged file."""

    def missing(
        self, first: float = -np.inf, last: float = np.inf, systems: Sequence[System] = SYSTEMS
    ) -> tuple[str, ...]:
        """Messages about the times at which satellites of these systems have no position or no clock in the table.

        Covers gaps that overlap the time from `first` to `last`, GPS s.
        """
        if self.time.size < _POINTS:
            few = "1 epoch is" if self.time.size == 1 else f"{self.time.size} epochs are"
            return (f"no positions: {few} too few, they are interpolated from {_POINTS}",)
        between = 0.5 * (self.time[1:] + self.time[:-1])
        each = [orbits.has_position(for_each(between, len(orbits.names))) for orbits in map(self.of, systems)]
        if any(there.size for there in each) and not any(there.any() for there in each):
            step = float(np.median(np.diff(self.time)))
            return (f"no positions: epochs {step:g} s apart, or the rows between gaps, are too few to interpolate",)
        text = []
        if -np.inf < first < self.time[0]:
            text.append(f"no positions before {_moment(self.time[0])} (GPS time), where the table begins")
        if self.time[-1] < last < np.inf:
            text.append(f"no positions after {_moment(self.time[-1])} (GPS time), where the table ends")
        for what, has in (("position", PreciseOrbits.has_position), ("clock", PreciseOrbits.has_clock)):
            lost: dict[tuple[tuple[float, float], ...], list[str]] = {}
            for orbits in map(self.of, systems):
                there = has(orbits, for_each(between, len(orbits.names)))
                for name, column in zip(orbits.names, there.T, strict=True):
                    spans = ((float(self.time[a]), float(self.time[b])) for a, b in _runs(~column))
                    if reaching := tuple(span for span in spans if span[0] <= last and span[1] >= first):
                        lost.setdefault(reaching, []).append(name)
            lines = [f"no {what} of {_some(names)} {_times(spans)} (GPS time)" for spans, names in lost.items()]
            text += lines[:_MOST_LINES]
            if len(lines) > _MOST_LINES:
                others = sum(map(len, list(lost.values())[_MOST_LINES:]))
                text.append(f"no {what} at times of {others} satellites more")
        return tuple(text)

    def of(self, system: System) -> PreciseOrbits:
        """The satellites of a system."""
        keep = [i for i, name in enumerate(self.names) if name.startswith(system.letter)]
        names = tuple(self.names[i] for i in keep)
        tables = (self.position, self.offset, self.manoeuvres, self.clock_events)
        return PreciseOrbits(system, names, self.time, *(table[:, keep] for table in tables))


@dataclass(frozen=True)
class PreciseOrbits(WithoutMessages):
    """Satellites of one system by a table of positions and clocks, see `OrbitTable`."""

    system: System
    names: tuple[str, ...]
    time: np.ndarray
    position: np.ndarray
    offset: np.ndarray
    manoeuvres: np.ndarray
    clock_events: np.ndarray

    @property
    def channels(self) -> Mapping[str, int]:
        """None: tables do not contain them."""
        return {}

    @property
    def usable(self) -> np.ndarray:
        """(n,): all, for tables have no marks of health."""
        return np.ones(len(self.names), dtype=bool)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last GPS time of the table, s."""
        return float(self.time[0]), float(self.time[-1])

    def _first(self, gpst: np.ndarray) -> np.ndarray:
        """Index of the first of the epochs around GPS times: as many before as after, but at the ends of the table."""
        return np.clip(np.searchsorted(self.time, gpst) - _POINTS // 2, 0, self.time.size - _POINTS)

    def has_position(self, gpst: np.ndarray) -> np.ndarray:
        """(m, n) whether the satellites have positions at GPS times (m, n): inside of the table, with all the epochs
        around at one step, without a manoeuvre between them, and near enough."""
        if self.time.size < _POINTS:
            return np.zeros(gpst.shape, dtype=bool)
        first = self._first(gpst)
        last = first + _POINTS - 1
        step, uneven, column = np.diff(self.time), self._uneven, np.arange(len(self.names))[None, :]
        missing = _counted(~np.isfinite(self.position).all(axis=2))
        jumps = _counted(self.manoeuvres)
        error = self._differences[first, column]
        for k in range(_POINTS):  # remainder of the polynomial; at the epochs themselves that of their neighbours
            error *= np.maximum(np.abs(self.time[first + k] - gpst) / step[first], _NEAREST) / (k + 1)
        return (
            (gpst >= self.time[0])
            & (gpst <= self.time[-1])
            & (uneven[last] == uneven[first + 1])
            & (missing[last + 1, column] == missing[first, column])
            & (jumps[last + 1, column] == jumps[first + 1, column])
            & (error < _LARGEST_ERROR)
        )

    @cached_property
    def _uneven(self) -> np.ndarray:
        """(t,) how many changes of the step from epoch to epoch there are before each epoch."""
        step = np.diff(self.time)
        return np.concatenate([[0, 0], np.cumsum(np.abs(np.diff(step)) > _UNEVEN * step[1:])])

    @cached_property
    def _differences(self) -> np.ndarray:
        """Sizes of the tenth differences of positions in inertial axes, m, about the epochs from each one on (k, n).

        Of ten epochs and the one before or after, the larger of the two. If neither exists, those of a circular orbit.
        """
        angle = RATE * (self.time - self.time[0])[:, None]
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = np.moveaxis(self.position, 2, 0)
        tenth = np.linalg.norm(np.diff([c * x - s * y, s * x + c * y, z], n=_POINTS, axis=1), axis=0)
        tenth[self._uneven[_POINTS:] != self._uneven[1 : 1 - _POINTS]] = np.nan
        unknown = np.full((1, tenth.shape[1]), np.nan)
        both = np.fmax(np.concatenate([tenth, unknown]), np.concatenate([unknown, tenth]))
        step = np.diff(self.time)[: both.shape[0], None]
        return np.where(np.isnan(both), _RADIUS * (_ANGULAR_RATE * step) ** _POINTS, both)

    def has_clock(self, gpst: np.ndarray) -> np.ndarray:
        """(m, n) whether the satellites have clocks at GPS times (m, n): at the epochs before and after, which are no
        further from each other than most, without a jump between them."""
        if self.time.size < 2:
            return np.zeros(gpst.shape, dtype=bool)
        low, column = self._low(gpst), np.arange(len(self.names))[None, :]
        step = np.diff(self.time)
        near = step < (1.0 + _UNEVEN) * np.median(step)
        known = np.isfinite(self.offset)
        return near[low] & known[low, column] & known[low + 1, column] & ~self.clock_events[low + 1, column]

    def _low(self, gpst: np.ndarray) -> np.ndarray:
        """Index of the epoch before GPS times."""
        return np.clip(np.searchsorted(self.time, gpst, side="right") - 1, 0, self.time.size - 2)

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m, m/s, at GPS times (m,) or (m, n); nan where `has_position` is
        not."""
        n = len(self.names)
        gpst = for_each(gpst, n)
        if self.time.size < _POINTS:
            return np.full((*gpst.shape, 3), np.nan), np.full((*gpst.shape, 3), np.nan)
        window = self._first(gpst)[..., None] + np.arange(_POINTS)
        step = float(np.median(np.diff(self.time)))
        x = (self.time[window] - gpst[..., None]) / step
        value, slope = _lagrange_at_zero(x)
        satellite = np.arange(n)[None, :, None]
        points = self.position[window, satellite]
        # in axes that stop rotating at the wanted time the trajectory is smoother
        angle = RATE * step * x
        c, s = np.cos(angle), np.sin(angle)
        still = np.stack(
            [c * points[..., 0] - s * points[..., 1], s * points[..., 0] + c * points[..., 1], points[..., 2]], axis=-1
        )
        position = np.einsum("mnk,mnkj->mnj", value, still)
        velocity = np.einsum("mnk,mnkj->mnj", slope / step, still)
        velocity[..., 0] += RATE * position[..., 1]
        velocity[..., 1] -= RATE * position[..., 0]
        unknown = ~self.has_position(gpst)
        position[unknown], velocity[unknown] = np.nan, np.nan
        return position, velocity

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Satellite clocks, s, and their rates (m, n), linear between the table's, with relativity -2 r.v / c2; nan
        where `has_clock` is not."""
        gpst = for_each(gpst, len(self.names))
        if self.time.size < 2:
            return np.full(gpst.shape, np.nan), np.full(gpst.shape, np.nan)
        low, column = self._low(gpst), np.arange(len(self.names))[None, :]
        width = self.time[low + 1] - self.time[low]
        rate = (self.offset[low + 1, column] - self.offset[low, column]) / width
        rate[~self.has_clock(gpst)] = np.nan
        position, velocity = self.state(gpst)
        relativity = -2.0 * np.sum(position * velocity, axis=2) / SPEED_OF_LIGHT**2
        # the velocity in rotating axes will do: the Earth's rate is across the position
        return self.offset[low, column] + rate * (gpst - self.time[low]) + relativity, rate


def _runs(marks: np.ndarray) -> list[tuple[int, int]]:
    """Runs of marks (k,): index of the first and of the one after the last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marks, [False]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _some(names: list[str]) -> str:
    """Names, or how many they are."""
    return ", ".join(names) if len(names) <= _MOST_NAMES else f"{len(names)} satellites, {names[0]} first"


def _times(spans: tuple[tuple[float, float], ...]) -> str:
    """The first spans of GPS time."""
    some = " and ".join(f"from {_moment(first)} to {_moment(last)}" for first, last in spans[:_MOST_SPANS])
    return f"{some} and {len(spans) - _MOST_SPANS} times more" if len(spans) > _MOST_SPANS else some


def _moment(gpst: float) -> str:
    """A GPS time as its date and time of day, without leap seconds."""
    return f"{datetime.datetime.fromtimestamp(gpst + timescales.GPS_EPOCH, datetime.UTC):%Y-%m-%d %H:%M:%S}"


def _counted(marks: np.ndarray) -> np.ndarray:
    """Number of marks (t, n) before each epoch, and in total (t + 1, n)."""
    return np.concatenate([np.zeros((1, marks.shape[1]), dtype=int), np.cumsum(marks, axis=0)])


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
