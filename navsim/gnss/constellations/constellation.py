"""Interface of all constellations, independent of the data of their orbits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, Self

import numpy as np

from navsim.gnss.constellations.messages import Messages, for_each
from navsim.gnss.constellations.systems import System


class Constellation(Protocol):
    """n satellites of one system. `state` and `clock` take GPS times (m,), or (m, n) for each satellite its own."""

    @property
    def system(self) -> System:
        """Whose satellites they are."""

    @property
    def names(self) -> tuple[str, ...]:
        """The satellites (n,), such as R01."""

    @property
    def channels(self) -> Mapping[str, int]:
        """Frequency channels by name, of satellites whose data contain them."""

    @property
    def usable(self) -> np.ndarray:
        """(n,) bool, False for satellites that are marked as unhealthy as a whole.

        If each message has a health flag, satellites without a healthy message have no state.
        """

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last GPS time of the data, s; None for a design, which does not age."""

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m, m/s; nan without data."""

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Satellite clocks minus system time for an L1 user, s, and their rates (m, n); nan without data."""

    def accuracy(self, gpst: np.ndarray) -> np.ndarray:
        """Broadcast accuracy of orbits and clocks, 1 sigma, m (m, n); nan without."""

    def using_unhealthy(self) -> Constellation:
        """Copy that also uses unhealthy satellites and messages."""

    def broadcast(self, first: float, last: float) -> Constellation:
        """Constellation of the messages that it would send from `first` to `last` (UTC, POSIX s).

        Itself if it already consists of messages, or has none.
        """

    def messages(self, gpst: np.ndarray) -> Messages | None:
        """Messages of its satellites at GPS times (m,), real or simulated; None without messages."""


class WithoutMessages:
    """Part of constellations that are of no messages: two-line elements, and tables of positions and clocks."""

    names: tuple[str, ...]

    def accuracy(self, gpst: np.ndarray) -> np.ndarray:
        """Unknown (m, n): none that is read."""
        return np.full(for_each(gpst, len(self.names)).shape, np.nan)

    def using_unhealthy(self) -> Self:
        """Itself: no satellite is marked as unhealthy."""
        return self

    def broadcast(self, first: float, last: float) -> Self:
        """Itself: it makes no messages."""
        return self

    def messages(self, gpst: np.ndarray) -> Messages | None:
        """None: it makes no messages."""
        return None


def carriers(constellation: Constellation) -> np.ndarray:
    """Carrier frequencies in L1, Hz (n,); that of channel 0 where the channel is not known."""
    system, channels = constellation.system, constellation.channels
    return np.array([system.frequency(channels.get(name, 0)) for name in constellation.names])


class CachedConstellation:
    """A constellation that works out the same times but once."""

    def __init__(self, constellation: Constellation) -> None:
        self._constellation = constellation
        self._known: dict[tuple[tuple[int, ...], bytes], tuple[np.ndarray, np.ndarray]] = {}
        self.system, self.names = constellation.system, constellation.names
        self.channels, self.usable = constellation.channels, constellation.usable
        self.span, self.clock, self.messages = constellation.span, constellation.clock, constellation.messages
        self.accuracy = constellation.accuracy
        self.using_unhealthy, self.broadcast = constellation.using_unhealthy, constellation.broadcast

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See the constellation's own method."""
        key = gpst.shape, gpst.tobytes()
        if key not in self._known:
            self._known[key] = self._constellation.state(gpst)
        return self._known[key]
