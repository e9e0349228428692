"""Events that affect signals during a landing: outages, faults, spoofing.

Source: `docs/theory/integrity.md`, section 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

PSEUDOLITES = "pseudolites"
"""Name of all pseudolites, like that of a satellite system."""
BEACONS = "beacons"
"""Name of all ranging beacons."""
EVERY = "all"
"""Name of all satellites and pseudolites."""


@dataclass(frozen=True)
class Scene:
    """Signals without events."""

    time: np.ndarray
    """(e,) s."""
    names: tuple[str, ...]
    """Names of the sources."""
    systems: tuple[str, ...]
    """Systems of the sources."""
    position: np.ndarray
    """(e, s, 3) of the sources, ECEF, m."""
    velocity: np.ndarray
    """(e, s, 3) of the sources, m/s."""
    antenna: np.ndarray
    """(e, 3) ECEF, m."""
    antenna_velocity: np.ndarray
    """(e, 3) m/s."""
    ned: np.ndarray
    """(e, 3, 3) rows north, east, down at the receiver."""

    def range(self, shift: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Changes of ranges and range rates (e, s) for sources shifted relative to the receiver by (e, 3) m, ECEF.

        moving: rate of the shift (e, 3), m/s.
        """
        away = self.position - self.antenna[:, None]
        closing = self.velocity - self.antenna_velocity[:, None]
        there = away + shift[:, None]
        distance, shifted = np.linalg.norm(away, axis=2), np.linalg.norm(there, axis=2)
        rate = np.sum(away * closing, axis=2) / distance
        return shifted - distance, np.sum(there * (closing + moving[:, None]), axis=2) / shifted - rate


class EventEffect(Protocol):
    """Effect of an event on the ranges of its sources."""

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Additions to ranges, m, and range rates, m/s (e, s), after the event has lasted (e,) s; None for an outage.

        ned: (3, 3) rows north, east, down at the receiver when it begins, ECEF.
        """


@dataclass(frozen=True)
class Event:
    """Something that happens to sources, by their names, their systems' or `EVERY`, from a time up to another, s;
    code_only: to their codes alone, neither to range rates nor to carriers."""

    what: EventEffect
    sources: tuple[str, ...]
    begin: float
    end: float
    code_only: bool = False
    receiver: int = 0
    """Number of the reference receiver from 1 whose part of the correction is wrong; 0: the ranges themselves are."""
    receivers: int = 1
    """Number of reference receivers that a correction is the mean of."""

    def concerns(self, names: Sequence[str], systems: Sequence[str]) -> np.ndarray:
        """Which of the sources of these names and systems (s,) bool."""
        pairs = zip(names, systems, strict=True)
        return np.array([bool({name, system, EVERY} & set(self.sources)) for name, system in pairs], bool)


@dataclass(frozen=True)
class Silence:
    """Nothing is received."""

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> None:
        return None


@dataclass(frozen=True)
class RangeFault:
    """Ranges too long by offset, m, and rate, m/s, from then on; range rates with them."""

    offset: float
    rate: float

    def at(self, since: np.ndarray) -> np.ndarray:
        """Addition (e,) to a range, m, after (e,) s."""
        return self.offset + self.rate * since

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        every = np.ones((1, len(scene.names)))
        return self.at(since)[:, None] * every, np.full((since.size, every.size), self.rate)


@dataclass(frozen=True)
class DisplacedSources:
    """Sources whose true position differs from the assumed one by (3,) m, in the receiver's NED."""

    by: np.ndarray

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        still = np.zeros((since.size, 3))
        return scene.range(still + self.by @ ned, still)


@dataclass(frozen=True)
class Spoofed:
    """Ranges as a receiver would measure that is off by offset (3,) m and rate (3,) m/s, NED, with its clock off by
    clock, m, and drift, m/s."""

    offset: np.ndarray
    rate: np.ndarray
    clock: float
    drift: float

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = self.offset + self.rate * since[:, None]
        ranges, rates = scene.range(-moved @ ned, np.broadcast_to(-self.rate @ ned, moved.shape))
        return ranges + self.clock + self.drift * since[:, None], rates + self.drift


@dataclass(frozen=True)
class Meaconed:
    """Signals received at a position (3,), ECEF, m, and retransmitted with a delay, m.

    The range of every source is that to there, plus the common distance to the receiver. Positions of the sources are
    those for the receiver, which is off by some centimetres.
    """

    place: np.ndarray
    delay: float

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shift = scene.antenna - self.place
        ranges, rates = scene.range(shift, scene.antenna_velocity)
        onward = np.linalg.norm(shift, axis=1, keepdims=True)
        return ranges + onward + self.delay, rates + np.sum(shift * scene.antenna_velocity, axis=1)[:, None] / onward


class EventEffects(NamedTuple):
    """Total effect of events on ranges (e, s)."""

    longer: np.ndarray
    """Addition to ranges, m."""
    faster: np.ndarray
    """Addition to range rates, m/s."""
    apart: np.ndarray
    """Part of `longer` that carriers do not have, m."""
    silent: np.ndarray
    """bool, no signal."""


def happened(events: tuple[Event, ...], scene: Scene) -> EventEffects:
    """Total effect of the events."""
    shape = scene.time.size, len(scene.names)
    longer, faster, apart, silent = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    for event in events:
        correlated = (scene.time >= event.begin) & (scene.time < event.end)
        if not correlated.any():
            continue
        on = correlated[:, None] & event.concerns(scene.names, scene.systems)
        begun = scene.ned[np.argmax(correlated)]
        added = event.what.on_ranges(scene, np.where(correlated, scene.time - event.begin, 0.0), begun)
        if added is None:
            silent |= on
        else:
            ranges, rates = (part / event.receivers for part in added)
            longer += np.where(on, ranges, 0.0)
            if event.code_only:
                apart += np.where(on, ranges, 0.0)
            else:
                faster += np.where(on, rates, 0.0)
    return EventEffects(longer, faster, apart, silent)
