"""Data of a recorded flight: inertial samples, and fixes or the ranges from which they were solved."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from navsim.geodesy import earth

_NEIGHBOURS = 3.0
"""Fixes farther apart than this many usual intervals do not show the velocity of one another."""


def _intervals(time: np.ndarray, longest: float) -> np.ndarray:
    """Begin and end (k, 2) of the intervals between times that are longer than `longest` seconds."""
    first = np.flatnonzero(np.diff(time) > longest)
    return np.stack([time[first], time[first + 1]], axis=1)


@dataclass(frozen=True)
class Samples:
    """Inertial samples: time (n,) s, rate (n, 3) rad/s, force (n, 3) m/s2, body axes forward-right-down."""

    time: np.ndarray
    rate: np.ndarray
    force: np.ndarray

    def between(self, first: float, last: float) -> Samples:
        """Samples at first <= time <= last."""
        keep = slice(*np.searchsorted(self.time, [first, np.nextafter(last, np.inf)]))
        return Samples(self.time[keep], self.rate[keep], self.force[keep])

    def missing(self, longest: float) -> np.ndarray:
        """Begin and end, s, of the intervals without a sample (k, 2) that are longer than `longest` seconds."""
        return _intervals(self.time, longest)

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rate and specific force (m, 3) at times (m,), interpolated between samples."""
        rate, force = (
            np.stack([np.interp(time, self.time, values[:, i]) for i in range(3)], axis=1)
            for values in (self.rate, self.force)
        )
        return rate, force


@dataclass(frozen=True)
class Fixes:
    """Recorded fixes."""

    time: np.ndarray
    """(m,) s."""
    llh: np.ndarray
    """(m, 3) rad, rad, m."""
    velocity: np.ndarray
    """(m, 3) NED, m/s, nan where unknown."""
    covariance: np.ndarray | None = None
    """(m, 6, 6) of position and velocity, NED, from the receiver; nan where missing, None if always missing."""
    effect: np.ndarray | None = None
    """(m, 6, k) effect of each of k time-correlated errors of variance one, None without."""
    accuracy: np.ndarray | None = None
    """(m, 3) 1 sigma that the receiver claims, horizontal per axis, vertical, m, velocity per axis, m/s; nan where
    missing, None if always missing."""

    @property
    def has_own_noise(self) -> bool:
        """Whether the receiver gives the variance of every number of every fix."""
        if self.covariance is None:
            return False
        unknown = np.isnan(np.diagonal(self.covariance, axis1=1, axis2=2))
        return not np.any(unknown & np.isfinite(np.hstack([self.llh, self.velocity])))

    @property
    def usual_accuracy(self) -> np.ndarray:
        """Median (3,) of the accuracies that the receiver claims, nan where it claims none."""
        if self.accuracy is None:
            return np.full(3, np.nan)
        known = [column[np.isfinite(column)] for column in self.accuracy.T]
        return np.array([np.median(column) if column.size else np.nan for column in known])

    @property
    def weight(self) -> np.ndarray:
        """1 sigma (m, 6) of each fix by its claimed accuracy, over that of a usual fix; 1 without a claim."""
        if self.accuracy is None:
            return np.ones((self.time.size, 6))
        relative = self.accuracy / self.usual_accuracy
        return np.asarray(np.where(np.isfinite(relative), relative, 1.0)[:, [0, 0, 1, 2, 2, 2]])

    def take(self, index: np.ndarray | slice) -> Fixes:
        """Some of the fixes."""
        of_fixes = (self.covariance, self.effect, self.accuracy)
        more = (None if values is None else values[index] for values in of_fixes)
        return Fixes(self.time[index], self.llh[index], self.velocity[index], *more)

    def earlier(self, delay: float) -> Fixes:
        """The fixes with times earlier by `delay` seconds."""
        return replace(self, time=self.time - delay)

    def pauses(self, longest: float) -> np.ndarray:
        """Begin and end, s, of the intervals without a fix (k, 2) that are longer than `longest` seconds."""
        return _intervals(self.time, longest)

    def with_velocity(self) -> tuple[Fixes, np.ndarray]:
        """The fixes (at least two) with unknown velocities from the positions around them, and over how many seconds
        (m,).

        The interval is about one second. Positions on both sides of a gap are not used: an isolated fix keeps nan.
        """
        index = np.arange(self.time.size)
        interval = float(np.median(np.diff(self.time)))
        reach = max(1, round(0.5 / interval))
        before, after = np.maximum(index - reach, 0), np.minimum(index + reach, self.time.size - 1)
        far = _NEIGHBOURS * reach * interval
        before = np.where(self.time - self.time[before] > far, index, before)
        after = np.where(self.time[after] - self.time > far, index, after)
        ecef = earth.ecef_from_llh(self.llh)
        over = self.time[after] - self.time[before]
        mean = (ecef[after] - ecef[before]) / np.where(over > 0.0, over, np.nan)[:, None]
        derived = np.einsum("nij,nj->ni", earth.ned_matrix(self.llh), mean)
        return replace(self, velocity=np.where(np.isnan(self.velocity), derived, self.velocity)), over


@dataclass(frozen=True)
class Headings:
    """Recorded headings of an axis of the body from true north: time (k,) s, value and 1 sigma of its noise (k,) rad.

    lasting: 1 sigma of an error that lasts, rad.
    """

    time: np.ndarray
    value: np.ndarray
    sigma: np.ndarray
    axis: np.ndarray
    """(3,)."""
    lasting: float = 0.0

    def at(self, time: float, oldest: float = 1.0) -> tuple[float, float, float] | None:
        """Value and 1 sigma of the noise, rad, of the last heading up to a time, and its time, s; None if it is older
        than `oldest` s.

        Later ones are measurements of the filter that starts then, and must not count twice.
        """
        i = int(np.searchsorted(self.time, time, side="right")) - 1
        if i < 0 or time - self.time[i] > oldest:
            return None
        return float(self.value[i]), float(self.sigma[i]), float(self.time[i])


@dataclass(frozen=True)
class Ranges:
    """Measurements to s sources at e epochs, ready for the filter."""

    time: np.ndarray
    """(e,) s by the receiver clock."""
    names: tuple[str, ...]
    """(s,)."""
    clock: np.ndarray
    """(s,) number of the clock in `scales`."""
    scales: tuple[str, ...]
    """Names of the clocks."""
    position: np.ndarray
    """(e, s, 3) see `gnss.pseudorange.Signals`, also for `velocity`."""
    velocity: np.ndarray
    distance: np.ndarray
    """(e, s) m, approximate."""
    pseudorange: np.ndarray
    """(e, s) m, corrected for the source's clock and the atmosphere; nan if missing or below the mask."""
    range_rate: np.ndarray
    """(e, s) m/s, corrected likewise."""
    slant: np.ndarray
    """(e, s) 1 / sin(elevation), a factor on the noise."""

    @property
    def clocks(self) -> tuple[int, ...]:
        """Numbers of the clocks of the sources that are ever received."""
        return tuple(np.unique(self.clock[np.isfinite(self.pseudorange).any(axis=0)]).tolist())

    def take(self, index: np.ndarray) -> Ranges:
        """Some of the epochs."""
        per_epoch = ("time", "position", "velocity", "distance", "pseudorange", "range_rate", "slant")
        return replace(self, **{name: getattr(self, name)[index] for name in per_epoch})
