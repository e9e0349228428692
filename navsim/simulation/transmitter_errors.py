"""Errors of transmitters on the ground as states of a filter: survey, clock, range bias; and the refractivity of the
air.

They last over a run. The state of an error acts on the ranges of its own transmitter, that of the refractivity on all.
A tightly coupled filter has these effects as they are, a loosely coupled one as the geometry maps them to the fix.

Source: `docs/theory/lasting-errors.md`, section 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.filter.measurement_kinds import SOURCE
from navsim.filter.states import Block, TransmitterClockModel
from navsim.geodesy.earth import llh_from_ecef, ned_matrix
from navsim.gnss.pseudolite_clock import TransmitterErrors
from navsim.gnss.pseudorange import Signals
from navsim.statistics.random_streams import generator

_POSITION, _OFFSET, _BIAS, _RATE, _REFRACTIVITY = (0, 1, 2), 3, 4, 5, 6
"""Errors of a transmitter, in order; those of its position are along north, east, down. The last is of all."""
_ALL = -1
"""Source of an error that all transmitters share."""


def drawn_refractivity(errors: TransmitterErrors, seed: int, run: int) -> float:
    """The drawn part of a run's refractivity, in its 1 sigma."""
    return float(generator(seed, run, "space", 2).standard_normal()) if errors.refractivity else 0.0


@dataclass(frozen=True)
class TransmitterBelief:
    """Filter model of the errors of transmitters."""

    followed: bool
    """The filter estimates them as states."""
    errors: TransmitterErrors
    """Their sizes in the filter model."""
    factor: float
    """Factor on their variance in a range if the filter treats them as white noise."""


@dataclass(frozen=True)
class TransmitterStates:
    """The states of a filter for the errors of the transmitters that it ever receives.

    The states of a clock with noise are its offset and rate. Without noise, both follow from two constants: the offset
    at which the clock was set, and the rate since then. As states of their own they would be fully correlated, which
    rounding makes a covariance that is not positive definite.
    """

    signals: Signals
    errors: TransmitterErrors
    """In the filter model."""

    @cached_property
    def each(self) -> tuple[tuple[int, int], ...]:
        """Source and error of each state."""
        truth, used, errors = self.signals.transmitters, self.signals.used, self.errors
        if truth is None:
            return ()
        own = [*(_POSITION if errors.survey > 0.0 else ())]
        own += [_BIAS] if errors.bias > 0.0 else []
        own += [_OFFSET] if errors.offset > 0.0 or errors.is_noisy else []
        own += [_RATE] if errors.wanders else []
        received = np.flatnonzero(truth.which & used.any(axis=0))
        of_all = [(_ALL, _REFRACTIVITY)] if self.follows_air and received.size else []
        return (*((int(i), k) for i in received for k in own), *of_all)

    @property
    def follows_air(self) -> bool:
        """Whether the refractivity is a state."""
        return self.signals.air is not None and self.errors.refractivity > 0.0

    def blocks(self) -> list[tuple[Block, float]]:
        """The states, each a separate block, and their initial 1 sigma."""
        errors, out = self.errors, []
        start = errors.clock_covariance(0.0)
        clock = TransmitterClockModel(*errors.density, float(start[0, 1])) if errors.is_noisy else None
        rate = float(np.sqrt(start[1, 1]))
        offset = float(np.hypot(errors.offset, np.sqrt(start[0, 0]))) if errors.is_noisy else errors.offset
        for number, (source, k) in enumerate(self.each):
            name = self.signals.names[source]
            if k == _REFRACTIVITY:
                one = Block("transmitter_refractivity", "1", SOURCE, first=number, size=1), errors.refractivity
            elif k in _POSITION:
                axis = ("north", "east", "down")[k]
                one = Block(f"transmitter_position_{name}_{axis}", "m", SOURCE, first=number, size=1), errors.survey
            elif k == _BIAS:
                one = Block(f"transmitter_range_bias_{name}", "m", SOURCE, first=number, size=1), errors.bias
            elif k == _OFFSET:
                one = Block(f"transmitter_clock_{name}", "m", SOURCE, first=number, size=1, clock=clock), offset
            else:
                one = Block(f"transmitter_clock_rate_{name}", "m/s", SOURCE, first=number, size=1), rate
            out.append(one)
        return out

    @cached_property
    def effects(self) -> np.ndarray:
        """Effect of each state on the pseudorange and range rate of its transmitter (e, 2, q), 0 where not received.

        That of a state of all is left 0 here."""
        s = self.signals
        out = np.zeros((s.time.size, 2, len(self.each)))
        for q, (i, k) in enumerate(self.each):
            if i == _ALL:
                continue
            used = s.used[:, i]
            if k in _POSITION:
                away = s.position[used, i] - s.antenna[used]
                axes = ned_matrix(llh_from_ecef(s.position[used, i]))
                out[used, 0, q] = np.einsum("ej,ej->e", away, axes[:, k]) / np.linalg.norm(away, axis=1)
            elif k == _RATE:
                out[used, 1, q] = 1.0
                if not self.errors.is_noisy:
                    out[used, 0, q] = s.time[used] + self.errors.age
            else:
                out[used, 0, q] = 1.0
        return out

    @property
    def sources(self) -> np.ndarray:
        """Source of each state (q,)."""
        return np.array([source for source, _ in self.each], np.int64)

    def on_ranges(self, epoch: np.ndarray, source: np.ndarray) -> np.ndarray:
        """Effects (m, 2, q) on the ranges of these epochs and sources (m,)."""
        own = self.sources[None, :] == source[:, None]
        out = np.where(own[:, None], self.effects[epoch], 0.0)
        if self.each and self.each[-1][0] == _ALL and self.signals.air is not None:
            out[:, 0, -1] = self.signals.air[epoch, source]
        return out

    def on_fixes(self, by_range: np.ndarray, by_rate: np.ndarray) -> np.ndarray:
        """Effects (e, MOST, q) on fixes, from their derivatives by ranges and range rates (e, MOST, s)."""
        ranges, rates = (by[:, :, self.sources] * self.effects[:, None, k] for k, by in enumerate((by_range, by_rate)))
        out = np.asarray(ranges + rates)
        if self.each and self.each[-1][0] == _ALL and self.signals.air is not None:
            air = np.where(self.signals.used, self.signals.air, 0.0)
            out[:, :, -1] = np.einsum("eas,es->ea", by_range, air)
        return out

    @property
    def of_positions(self) -> np.ndarray:
        """Which states (q,) are errors of positions."""
        return np.array([k in _POSITION for _, k in self.each], bool)

    def along_lines_of_sight(self) -> tuple[list[str], np.ndarray]:
        """Names of the transmitters with position states, and what the states (k, q) do to the length of the line of
        sight to each of them when it is received last."""
        used, places = self.signals.used, self.of_positions
        sources = np.unique(self.sources[places])
        last = [int(np.flatnonzero(used[:, i])[-1]) for i in sources]
        along = np.where(places & (self.sources == sources[:, None]), self.effects[last, 0], 0.0)
        return [self.signals.names[i] for i in sources], along

    @property
    def systematic(self) -> np.ndarray:
        """True values (q,) of the errors that are the same in all runs."""
        truth = self.signals.transmitters
        assert truth is not None or not self.each
        return np.array(
            [
                0.0 if truth is None else (*truth.survey_error, truth.delay, 0.0, 0.0, truth.refractivity)[k]
                for _, k in self.each
            ]
        )

    def of_refractivity(self) -> np.ndarray:
        """Effect on the states (q,) of one sigma of the drawn refractivity."""
        truth = self.signals.transmitters
        size = 0.0 if truth is None else truth.errors.refractivity
        return np.array([size if k == _REFRACTIVITY else 0.0 for _, k in self.each])

    def of_messages(self) -> np.ndarray:
        """Effect on the states (q, s, k) of one sigma of the errors in `Signals.source_errors`."""
        truth, space = self.signals.transmitters, self.signals.source_errors
        out = np.zeros((len(self.each), len(self.signals.names), 4 if space is None else space.shape[2]))
        for q, (i, k) in enumerate(self.each):
            if k < out.shape[2] and truth is not None:
                errors = truth.errors
                out[q, i, k] = {_OFFSET: errors.offset, _BIAS: errors.bias}.get(k, errors.survey)
        return out

    def of_clocks(self, which: np.ndarray, time: float) -> np.ndarray:
        """Effect on the states (q, 2 c) of offsets, then of rates, at a time, s, of the clocks of sources in `which`
        (s,) bool."""
        wandering = np.flatnonzero(which).tolist()
        out = np.zeros((len(self.each), 2 * len(wandering)))
        for q, (i, k) in enumerate(self.each):
            if k in (_OFFSET, _RATE) and i in wandering:
                clock = wandering.index(i)
                out[q, (k == _RATE) * len(wandering) + clock] = 1.0
                if k == _OFFSET and not self.errors.is_noisy:
                    out[q, len(wandering) + clock] = -(time + self.errors.age)
        return out

    def true_values(self, time: np.ndarray, seed: int, runs: Sequence[int], lanes: int) -> np.ndarray:
        """True values (o, q, lanes) of the states at times (o,), s, in runs."""
        s = self.signals
        out = np.empty((time.size, len(self.each), lanes))
        for lane, run in enumerate(runs):
            own = np.broadcast_to(self.systematic, out.shape[:2]).copy()
            if s.source_errors is not None:
                drawn = generator(seed, run, "space").standard_normal(s.source_errors.shape[1:])
                own += np.einsum("qsk,sk->q", self.of_messages(), drawn)
            if s.transmitters is not None and s.drawn_air is not None:
                own += self.of_refractivity() * drawn_refractivity(s.transmitters.errors, seed, run)
            if s.wandering is not None:
                known = s.wandering.drawn(s.time, [generator(seed, run, "clock", 2)])[..., 0]
                clocks = s.wandering.drawn_between(time, s.time, known, generator(seed, run, "clock", 2))
                of_which = clocks[:, :, s.wandering.which].transpose(1, 0, 2).reshape(time.size, -1)
                effects = np.stack([self.of_clocks(s.wandering.which, float(t)) for t in time])
                own += np.einsum("oqc,oc->oq", effects, of_which)
            out[..., lane] = own
        return out
