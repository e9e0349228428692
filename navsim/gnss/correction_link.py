"""Data link that carries corrections for satellites to the aircraft, and the messages that a run loses.

Source: `docs/theory/signals.md`, section 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

_ROUNDING = 1e-9
"""Tolerance of times, s, and of numbers of messages."""
_OF_LINK, _BEFORE = 727, 1 << 30
"""First word of the seeds of the route's lost messages, and a number that makes those of messages before time 0
positive."""


@dataclass(frozen=True)
class CorrectionMessages:
    """Messages of a link along a route."""

    numbers: np.ndarray
    """(m,) int; a message has the corrections of this number times the interval."""
    interval: float
    """Time between two messages, s."""
    newest: np.ndarray
    """(e,) row of the newest message that can have arrived at each epoch."""
    heard: np.ndarray
    """(m,) bool, whether a sender is received when the message arrives."""
    oldest: np.ndarray
    """(e,) oldest row that is not too old at each epoch."""

    def in_use(self, lost: np.ndarray) -> np.ndarray:
        """Row (e,) of the message in use at each epoch, -1 for none; lost: (m,) bool."""
        rows = np.arange(self.numbers.size)
        last = np.maximum.accumulate(np.where(self.heard & ~lost, rows, -1))[self.newest]
        return np.where(last >= self.oldest, last, -1)

    def ages(self, time: np.ndarray, lost: np.ndarray) -> np.ndarray:
        """Age (e,), s, of the corrections in use at epochs (e,), s; inf without any."""
        row = self.in_use(lost)
        return np.where(row >= 0, time - self.numbers[row] * self.interval, np.inf)


@dataclass(frozen=True)
class CorrectionLink:
    """Data link that carries a station's corrections to the aircraft."""

    senders: tuple[str, ...]
    """Pseudolites that send them, each all of them."""
    interval: float
    """Time between two messages, s."""
    oldest: float
    """Age beyond which the receiver uses no corrections, s."""
    loss: float
    """Share of messages that are lost."""

    def messages(self, time: np.ndarray, received: np.ndarray, latency: float) -> CorrectionMessages:
        """Messages that may be in use at epochs (e,), s.

        A message that arrives between two epochs is received if a sender is received at the earlier one. A message from
        before the first epoch is received if a sender is at the first.

        received: (e,) bool, whether a sender is received. latency: of a message, s.
        """
        if time.size == 0:
            none = np.empty(0, np.int64)
            return CorrectionMessages(none, self.interval, none, none.astype(bool), none)
        newest = np.floor((time - latency) / self.interval + _ROUNDING).astype(np.int64)
        first = newest.min() - math.ceil(self.oldest / self.interval)
        numbers = np.arange(first, newest.max() + 1)
        arrival = numbers * self.interval + latency
        earlier = np.maximum(np.searchsorted(time, arrival + _ROUNDING * self.interval, side="right") - 1, 0)
        oldest = np.ceil((time - self.oldest - _ROUNDING) / self.interval).astype(np.int64)
        return CorrectionMessages(numbers, self.interval, newest - first, received[earlier], oldest - first)

    def lost_on_route(self, messages: CorrectionMessages) -> np.ndarray:
        """Which messages (m,) bool the nominal flight loses, by which the receiver weights its ranges."""
        of = (np.random.default_rng((_OF_LINK, _BEFORE + int(k))) for k in messages.numbers)
        return np.array([rng.random() < self.loss for rng in of], bool)


@dataclass(frozen=True)
class LossesByRun:
    """Corrections of each message, for runs that lose other messages than the nominal flight."""

    loss: float
    """Share of messages that are lost."""
    messages: CorrectionMessages
    nominal: np.ndarray
    """(e,) row of the message in use on the nominal flight, -1 for none."""
    delay: np.ndarray
    """(m, s) corrections of pseudoranges, m, nan for a satellite without one."""
    ionosphere: np.ndarray
    """(m, s) part of the ionosphere in them, m."""
    source_errors: np.ndarray | None
    """(m, s, k) part of the drawn errors, as of `Signals.source_errors`; None without."""
    noise: np.ndarray
    """(s,) 1 sigma of the station's noise in the corrections of each source, m."""

    def select(self, kept: np.ndarray) -> LossesByRun:
        """Those of the sources marked in `kept` (s,) bool."""
        source_errors = None if self.source_errors is None else self.source_errors[:, kept]
        delay, ionosphere = self.delay[:, kept], self.ionosphere[:, kept]
        return replace(self, source_errors=source_errors, noise=self.noise[kept], delay=delay, ionosphere=ionosphere)

    def at(self, epochs: np.ndarray) -> LossesByRun:
        """Those at the epochs with these numbers (m,) int."""
        its = self.messages
        its = replace(its, newest=its.newest[epochs], oldest=its.oldest[epochs])
        return replace(self, messages=its, nominal=self.nominal[epochs])

    def drawn(self, rng: np.random.Generator) -> np.ndarray:
        """Row (e,) of the message in use in a run, -1 for none."""
        return self.messages.in_use(rng.random(self.messages.numbers.size) < self.loss)

    def changes(self, rows: np.ndarray, space: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of pseudoranges, and of code minus carrier (e, s), m, and of the variance of noise (e, s), m2, where
        a run uses other messages than the nominal flight.

        rows: (e,) messages of the run, -1 for none. space: (s, k) its drawn errors, in sigmas; None without.
        """

        def of(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            there = (rows >= 0)[:, None]
            delay = self.delay[rows]
            if space is not None and self.source_errors is not None:
                delay = delay + np.einsum("esk,sk->es", self.source_errors[rows], space)
            return np.where(there, delay, 0.0), np.where(there, self.ionosphere[rows], 0.0)

        (mine, part), (theirs, other) = of(rows), of(self.nominal)
        # without a correction of the nominal flight the source is not used
        theirs, other = (np.where(np.isnan(m), 0.0, m) for m in (theirs, other))
        apart = (rows != self.nominal)[:, None]
        more = ((rows >= 0).astype(float) - (self.nominal >= 0))[:, None] * self.noise**2
        return np.where(apart, theirs - mine, 0.0), np.where(apart, 2.0 * (other - part), 0.0), more
