"""Errors of transmitters on the ground that last over a run: survey of the position, clock, delay of the hardware; and
of the air on the paths of all.

Every pseudolite has its own. A clock has two states, offset and rate, driven by white noises of phase and frequency.
It was set some time before the flight, which leaves an error of its rate.

Source: `gnss.clock_noise`; `docs/theory/signals.md`, section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.gnss.clock_noise import step_covariance
from navsim.gnss.receiver import wander
from navsim.statistics.random_streams import branch


@dataclass(frozen=True)
class TransmitterErrors:
    """1 sigma of the errors of each transmitter."""

    survey: float = 0.0
    """Of its position along each axis, m."""
    offset: float = 0.0
    """Of its clock at time 0 beside the noise of the clock, constant over a run, m."""
    rate: float = 0.0
    """Of the rate of its clock when that was set, m/s."""
    density: tuple[float, float] = (0.0, 0.0)
    """Of the clock's white noises of phase, m2/s, and frequency, m2/s3."""
    age: float = 0.0
    """How long before time 0 the clock was set, s."""
    bias: float = 0.0
    """Of its ranges besides the clock, constant over a run, m."""
    refractivity: float = 0.0
    """Of the refractivity at the runway, one for all transmitters, constant over a run, N-units."""

    @property
    def wanders(self) -> bool:
        """Whether clocks change over a run."""
        return self.rate > 0.0 or self.is_noisy

    @property
    def is_noisy(self) -> bool:
        """Whether clocks have noise; without it offset and rate follow from constants."""
        return any(self.density)

    @property
    def clock_states(self) -> int:
        """Number of states that describe a clock."""
        return (self.offset > 0.0 or self.is_noisy) + self.wanders

    def clock_covariance(self, time: np.ndarray | float) -> np.ndarray:
        """Covariance of offset and rate (..., 2, 2) at times (...), s, without `offset`."""
        since = np.asarray(time) + self.age
        bias, both, drift = step_covariance(np.array(self.density), since)
        square = self.rate**2
        out = np.array([[bias + square * since**2, both + square * since], [both + square * since, drift + square]])
        return np.moveaxis(out, (0, 1), (-2, -1))

    def variances(self, time: np.ndarray) -> np.ndarray:
        """Variance of ranges, m2, and of range rates, m2/s2, at times (e,), s (2, e)."""
        out: np.ndarray = np.diagonal(self.clock_covariance(time), axis1=1, axis2=2).T.copy()
        out[0] += self.survey**2 + self.offset**2 + self.bias**2
        return out


@dataclass(frozen=True)
class Transmitters:
    """True errors of the transmitters among the sources of signals."""

    which: np.ndarray
    """(s,) bool, the sources that are transmitters on the ground."""
    errors: TransmitterErrors
    """Sizes of the errors that are drawn for each run."""
    survey_error: np.ndarray
    """(3,) NED, true minus surveyed position of all, m, in addition to the drawn one."""
    delay: float
    """Effect of the offset of all clocks on pseudoranges, m, in addition to the drawn one."""
    refractivity: float = 0.0
    """Refractivity that the receiver's correction leaves, N-units, in addition to the drawn one."""

    def select(self, kept: np.ndarray) -> Transmitters:
        """Those of the sources marked in `kept` (s,) bool."""
        return replace(self, which=self.which[kept])


@dataclass(frozen=True)
class WanderingClocks:
    """Clocks of the sources marked in `which` (s,) bool."""

    errors: TransmitterErrors
    which: np.ndarray

    def select(self, kept: np.ndarray) -> WanderingClocks:
        """Clocks of the sources marked in `kept` (s,) bool."""
        return replace(self, which=self.which[kept])

    def sigmas(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma of ranges, m, and of range rates, m/s, at times (e,), s, of all sources (e, s)."""
        covariance = self.errors.clock_covariance(time)
        ranges, rates = (np.sqrt(covariance[:, i, i])[:, None] * self.which for i in range(2))
        return ranges, rates

    def drawn(self, time: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """Additions to ranges, m, and range rates, m/s, at times (e,), s, of all sources (2, e, s, W); a run for each
        generator."""
        out = np.zeros((2, time.size, self.which.size, len(rngs)))
        since = time + self.errors.age
        for lane, rng in enumerate(rngs):
            for i in np.flatnonzero(self.which):
                out[:, :, i, lane] = wander(self.errors.density, since, rng).T
            if self.errors.rate > 0.0:
                rate = self._first_rate(rng)
                out[0, :, :, lane] += since[:, None] * rate
                out[1, :, :, lane] += rate
        return out

    def _first_rate(self, rng: np.random.Generator) -> np.ndarray:
        """Error of the rate (s,) with which each clock of a run was set, m/s."""
        return self.errors.rate * branch(rng, 1).standard_normal(self.which.size) * self.which

    def drawn_between(
        self, at: np.ndarray, time: np.ndarray, drawn: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Offsets and rates (2, o, s) of a run at times (o,), s, given those `drawn` (2, e, s) at times (e,).

        Each is drawn given its two neighbours, so there is at most one between two of these times.
        """
        errors, first = self.errors, np.zeros((2, 1, self.which.size))
        if errors.rate > 0.0:
            first[1, 0] = self._first_rate(rng)
        known, values = np.concatenate([[-errors.age], time]), np.concatenate([first, drawn], axis=1)
        before = np.clip(np.searchsorted(known, at + _SAME_TIME, side="right") - 1, 0, None)
        after = np.minimum(before + 1, known.size - 1)
        gone, left = np.maximum(at - known[before], 0.0), known[after] - at
        own, later = (clock_noise(errors.density, np.maximum(dt, 0.0)) for dt in (gone, left))
        on = clock_transition(left)
        # the last ones have no neighbour behind them
        with_later = (on @ own @ on.swapaxes(1, 2) + later) * np.ones((at.size, 1, 1))
        gain = own @ on.swapaxes(1, 2) @ np.linalg.pinv(with_later)
        gain[after == before] = 0.0
        mean = np.einsum("oij,jos->ois", clock_transition(gone), values[:, before])
        expected = np.einsum("oij,ojs->ois", on, mean)
        mean += gain @ (np.moveaxis(values[:, after], 0, 1) - expected)
        variance, axes = np.linalg.eigh(own - gain @ on @ own)
        root = axes * np.sqrt(np.maximum(variance, 0.0))[:, None]
        white = branch(rng, 2).standard_normal((at.size, 2, self.which.size)) * self.which
        out = mean + root @ white
        same = gone < _SAME_TIME
        out[same] = np.moveaxis(values[:, before[same]], 0, 1)
        return np.moveaxis(out, 1, 0)

    def between(self, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition and noise covariance of offset and rate over dt (t,), s, (t, 2, 2) each."""
        return clock_transition(dt), clock_noise(self.errors.density, np.maximum(dt, 0.0))

    def steps(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition and noise covariance of offset and rate from epoch to epoch (e,), s, (e, 2, 2) each.

        The first step begins when the clocks were set, and its noise has the error of their rates.
        """
        dt = np.diff(time + self.errors.age, prepend=0.0)
        new = clock_noise(self.errors.density, dt)
        if self.errors.rate > 0.0:
            new[0] = self.errors.clock_covariance(time[0])
        return clock_transition(dt), new


_SAME_TIME = 1e-9
"""Times that differ by less, s, are the same."""


def clock_transition(dt: np.ndarray) -> np.ndarray:
    """Transition (t, 2, 2) of offset and rate over dt (t,), s."""
    out = np.broadcast_to(np.eye(2), (dt.size, 2, 2)).copy()
    out[:, 0, 1] = dt
    return out


def clock_noise(density: tuple[float, float], dt: np.ndarray) -> np.ndarray:
    """Covariance (t, 2, 2) that noises add to offset and rate over dt (t,), s."""
    bias, both, drift = step_covariance(np.array(density), dt)
    return np.moveaxis(np.array([[bias, both], [both, drift]]), 2, 0)
