"""What happens to signals on the way of a landing: silence, faults, spoofers.

Source: `docs/theory/integrity.md`, section 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

PSEUDOLITES = "pseudolites"
"""What the pseudolites are called together, as a system of satellites is by its name."""
EVERY = "all"
"""What all sources are called."""


@dataclass(frozen=True)
class Scene:
    """Signals as they are without events.

    time: (e,) s. names, systems: of the sources. position, velocity: (e, s, 3) of the sources, antenna,
    antenna_velocity: (e, 3), ECEF, m, m/s. ned: (e, 3, 3) rows north, east, down at the receiver.
    """

    time: np.ndarray
    names: tuple[str, ...]
    systems: tuple[str, ...]
    position: np.ndarray
    velocity: np.ndarray
    antenna: np.ndarray
    antenna_velocity: np.ndarray
    ned: np.ndarray

    def range(self, shift: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How much longer ranges and range rates (e, s) are with sources shifted against the receiver by (e, 3) m, and
        moving with (e, 3) m/s, ECEF."""
        away = self.position - self.antenna[:, None]
        closing = self.velocity - self.antenna_velocity[:, None]
        there = away + shift[:, None]
        distance, shifted = np.linalg.norm(away, axis=2), np.linalg.norm(there, axis=2)
        rate = np.sum(away * closing, axis=2) / distance
        return shifted - distance, np.sum(there * (closing + moving[:, None]), axis=2) / shifted - rate


class Happening(Protocol):
    """What an event does to the ranges of its sources while it lasts."""

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """What it adds to ranges, m, and range rates, m/s (e, s), since (e,) s ago; None where it silences. ned: (3, 3)
        rows north, east, down at the receiver when it begins, ECEF."""


@dataclass(frozen=True)
class Event:
    """Something that happens to sources, by their names, their systems' or `EVERY`, from a time up to another, s;
    code_only: to their codes alone, neither to range rates nor to carriers."""

    what: Happening
    sources: tuple[str, ...]
    begin: float
    end: float
    code_only: bool = False

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

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        every = np.ones((1, len(scene.names)))
        return (self.offset + self.rate * since)[:, None] * every, np.full((since.size, every.size), self.rate)


@dataclass(frozen=True)
class Displaced:
    """Sources that are not where they are believed to be, but off by (3,) m, in the NED of the receiver."""

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
    """Signals received at a place (3,), ECEF, m, and sent again, with a delay, m: of every source the range to there,
    and all the same way on. Sources are taken where they are for the receiver: some centimetres off."""

    place: np.ndarray
    delay: float

    def on_ranges(self, scene: Scene, since: np.ndarray, ned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shift = scene.antenna - self.place
        ranges, rates = scene.range(shift, scene.antenna_velocity)
        onward = np.linalg.norm(shift, axis=1, keepdims=True)
        return ranges + onward + self.delay, rates + np.sum(shift * scene.antenna_velocity, axis=1)[:, None] / onward


class Happened(NamedTuple):
    """What events come to, (e, s): ranges longer by, m, range rates greater by, m/s, how much of `longer` carriers do
    not have, m, and which signals are silent, bool."""

    longer: np.ndarray
    faster: np.ndarray
    apart: np.ndarray
    silent: np.ndarray


def happened(events: tuple[Event, ...], scene: Scene) -> Happened:
    """What events come to, all together."""
    shape = scene.time.size, len(scene.names)
    longer, faster, apart, silent = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    for event in events:
        lasting = (scene.time >= event.begin) & (scene.time < event.end)
        if not lasting.any():
            continue
        on = lasting[:, None] & event.concerns(scene.names, scene.systems)
        begun = scene.ned[np.argmax(lasting)]
        added = event.what.on_ranges(scene, np.where(lasting, scene.time - event.begin, 0.0), begun)
        if added is None:
            silent |= on
        else:
            ranges, rates = added
            longer += np.where(on, ranges, 0.0)
            if event.code_only:
                apart += np.where(on, ranges, 0.0)
            else:
                faster += np.where(on, rates, 0.0)
    return Happened(longer, faster, apart, silent)
