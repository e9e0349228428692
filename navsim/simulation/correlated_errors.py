"""Effect of time-correlated ranging errors on fixes and ranges, and their filter models.

The geometry maps range errors to errors of a fix. A loosely coupled filter can estimate these with a few states, some
for errors that hardly change over the flight, some for the others. Each state has 1 sigma one and is a sum of the
errors of all sources with fixed shares. The remainder is modelled as white. A tightly coupled filter estimates the
errors of each source. Or the filter inflates the noise of fixes or ranges.

Source: `docs/theory/lasting-errors.md`, sections 3 to 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.filter.design import CorrelatedErrorDesign
from navsim.filter.measurement_kinds import FIX, RANGE
from navsim.filter.states import MAX_MEASUREMENT_SIZE, Block
from navsim.gnss.correlated_errors import SUMS, CorrelatedError
from navsim.gnss.ground_accuracy import GroundStationError
from navsim.gnss.pseudolite_clock import TransmitterErrors
from navsim.gnss.pseudorange import Signals
from navsim.gnss.receiver_fixes import solve_fixes
from navsim.integrity.fix_slopes import slopes
from navsim.simulation.range_curvature import Curvature, fix_forms

STATES, INFLATED, IGNORED = "states", "inflate", "none"
"""Filter models of time-correlated errors: estimate them as states, inflate the measurement noise, ignore them."""
_AVERAGED = 60.0
"""Time over which fixes are averaged to weight pseudolites, s: as long as a filter of such sensors needs its fixes."""
_SPEEDS = "slow", "fast"
"""Names of the two groups of kinds: those that hardly change over the flight, and the others."""


def followed_errors(
    how: str, kinds: Sequence[CorrelatedError | GroundStationError], duration: float, interval: float
) -> CorrelatedErrorDesign:
    """Filter model of these kinds of errors.

    how: `STATES`, `INFLATED` or `IGNORED`. duration: of the flight, interval: between fixes, s.
    """
    groups = []
    if how == STATES:
        slow = [kind.time >= duration for kind in kinds]
        for name, wanted in zip(_SPEEDS, (True, False), strict=True):
            members = tuple(k for k, is_slow in enumerate(slow) if is_slow == wanted and kinds[k].sigma > 0.0)
            if members:
                groups.append((name, members))
    factor = np.ones(len(kinds))
    if how == INFLATED:
        factor = as_noise(np.array([kind.time for kind in kinds]), duration, interval)
    return CorrelatedErrorDesign(
        how == STATES, tuple(members for _, members in groups), tuple(n for n, _ in groups), factor
    )


def fix_blocks(
    belief: CorrelatedErrorDesign, kinds: Sequence[CorrelatedError | GroundStationError], step: float
) -> tuple[Block, ...]:
    """The states of a loosely coupled filter, `SUMS` for each group of kinds; step: of the filter, s."""
    blocks: list[Block] = []
    for name, members in zip(belief.names, belief.groups, strict=True):
        time = _common_time([kinds[k].time for k in members], [kinds[k].sigma ** 2 for k in members])
        for triad in range(SUMS // 3):
            own = f"fix_error_{name}_more" if triad else f"fix_error_{name}"
            blocks.append(states.correlated_triple(own, FIX, time, step, 3 * len(blocks), numbered=triad > 0))
    return tuple(blocks)


def _common_time(times: Sequence[float] | np.ndarray, variances: Sequence[float] | np.ndarray) -> float:
    """Correlation time, s, of a sum of processes of these times and variances, by its short-term growth."""
    rate = float(np.average(1.0 / np.asarray(times), weights=variances))
    return 1.0 / rate if rate > 0.0 else np.inf


def as_noise(time: np.ndarray, duration: float, interval: float) -> np.ndarray:
    """Factor on the variance of time-correlated errors so that white noise has the same effect on a mean over many
    intervals.

    time: correlation times, s. If an error outlasts the flight, the mean is over the flight.
    """
    kept = np.exp(-interval / np.minimum(time, 0.5 * duration))
    return np.asarray((1.0 + kept) / (1.0 - kept))


def fix_weights(signals: Signals, assumed: TransmitterErrors) -> Signals:
    """Signals with `filter_fix_sigma`, which are right for the mean of many fixes, not for each fix alone.

    assumed: errors of transmitters in the filter model.

    White noise averages out, errors that last do not: a pseudolite has to weigh as little as its lasting errors ask
    for. The mean is over `_AVERAGED`, wherever the flight ends, so that a search that cuts its flight has the same
    fixes. Satellites keep their weights. A pseudolite never weighs more than by the sigma of a single range.
    """
    if signals.transmitters is None or signals.time.size < 2:
        return signals
    duration, interval = _AVERAGED, float(np.median(np.diff(signals.time)))
    placed, lasting = signals.transmitters.which, signals.variances_of(assumed)
    factor = float(as_noise(np.array(np.inf), duration, interval))
    white = signals.noise_sigma**2 - signals.transmitter_variance[0]
    ranges = white + lasting[0] * placed
    noise = white
    if signals.smoothing is not None:  # over k epochs: a process that keeps 1 - 1 / k from one to the next
        noise = white * np.minimum(2.0 * np.maximum(signals.smoothing, 1) - 1.0, factor)
    mean = noise + factor * lasting[0] * placed
    if (correlated := signals.correlated) is not None:
        ranges = ranges + correlated.total**2
        mean = mean + np.einsum("k,kes->es", as_noise(correlated.time, duration, interval), correlated.sigma**2)
    sky = signals.used & ~placed
    # the scale by which satellites keep their weights
    shares = np.sum(np.divide(ranges, mean, out=np.zeros_like(mean), where=sky), axis=1)
    count = sky.sum(axis=1)
    scale = np.divide(shares, count, out=np.ones_like(shares), where=count > 0)[:, None]
    of_ranges = np.where(placed, np.maximum(ranges, scale * mean), signals.fix_sigma**2)
    of_rates = signals.fix_rate_sigma**2 + (factor * lasting[1] - signals.transmitter_variance[1]) * placed
    return replace(signals, filter_fix_sigma=np.sqrt([of_ranges, of_rates]))


@dataclass(frozen=True)
class FixErrors:
    """Errors of the filter's fixes of a flight, to first order along the truth."""

    signals: Signals
    fixed: np.ndarray
    """(e,) bool, whether there is a fix."""
    by_range: np.ndarray
    """(e, MOST, s) see `fix_slopes.slopes`, also for `by_rate`."""
    by_rate: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, signals: Signals, ranges: np.ndarray, rates: np.ndarray) -> FixErrors:
        """Errors of fixes from error-free ranges and rates (e, s); start: (3,) ECEF, first point of the iteration."""
        weighted = signals.of_filter
        fixes = solve_fixes(start, weighted, *(np.repeat(m[..., None], WIDTH, axis=-1) for m in (ranges, rates)))
        llh, velocity, clocks = (m[..., 0] for m in fixes[:3])
        by_range, by_rate = slopes(weighted, ranges, rates, (llh, velocity, clocks))
        return cls(signals, np.isfinite(llh[:, 0]), by_range, by_rate)

    @cached_property
    def noise(self) -> np.ndarray:
        """Covariance of the white part of each fix (e, MOST, MOST)."""
        s = self.signals
        return _spread(self.by_range, s.noise_sigma, s.used) + _spread(self.by_rate, s.fix_rate_sigma, s.used)

    def white(self, known: np.ndarray) -> np.ndarray:
        """`noise` without errors of these variances of ranges and range rates (2, e, s)."""
        s = self.signals
        ranges, rates = s.noise_sigma**2 - known[0], s.fix_rate_sigma**2 - known[1]
        out = _spread(self.by_range, np.sqrt(np.maximum(ranges, 0.0)), s.used)
        return out + _spread(self.by_rate, np.sqrt(np.maximum(rates, 0.0)), s.used)

    def of_ranges(self, sigma: np.ndarray) -> np.ndarray:
        """Covariance of fixes (e, MOST, MOST) by independent errors of ranges (e, s), m."""
        return _spread(self.by_range, sigma, self.signals.used)

    def curvature(self, noise_sigma: np.ndarray, correlated_sigma: np.ndarray, numbers: int) -> Curvature:
        """Second-order errors of fixes due to white and to time-correlated ranging errors (e, s), m.

        numbers: components of a fix that are used, 3 for position, 6 with velocity.
        """
        white, correlated = (self.of_ranges(sigma)[:, :3, :3] for sigma in (noise_sigma, correlated_sigma))
        noise = self.noise.copy()
        noise[:, numbers:] = noise[:, :, numbers:] = 0.0
        forms = fix_forms(self.signals, self.by_range, self.by_rate)
        forms[:, numbers:] = 0.0
        return Curvature.of(forms, white, correlated, noise)

    def of_kinds(self, factor: np.ndarray) -> np.ndarray:
        """Covariance of fixes due to all kinds of time-correlated errors (e, MOST, MOST), the variance of each times a
        factor (k,)."""
        assert self.signals.correlated is not None
        return self.of_ranges(np.sqrt(np.einsum("k,kes->es", factor, self.signals.correlated.sigma**2)))

    def roots(self, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """Effect of errors of 1 sigma one, `SUMS` of each of g groups of kinds, on fixes (e, MOST, g SUMS); 0 without a
        fix.

        They are sums of the sources' errors with constant shares (`_shares`), so they have the same correlation in
        time, whatever the geometry does.
        """
        out = [self._effect(members) @ self._shares(members) for members in groups]
        return np.concatenate([np.empty((self.fixed.size, MAX_MEASUREMENT_SIZE, 0)), *out], axis=2)

    def beside(self, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """Covariance of fixes (e, MOST, MOST) due to the part of the sources' errors that `roots` does not contain."""
        out = np.zeros((self.fixed.size, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE))
        for members in groups:
            effect, shares = self._effect(members), self._shares(members)
            rest = effect - (effect @ shares) @ shares.T
            out += rest @ np.swapaxes(rest, 1, 2)
        return out

    def projections(self, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """Effect of errors of each kind and source of variance one on the errors of `roots` (e, g SUMS, k, s)."""
        correlated = self.signals.correlated
        assert correlated is not None
        k, e, s = correlated.sigma.shape
        out = np.zeros((e, SUMS * len(groups), k, s))
        for g, members in enumerate(groups):
            shares = self._shares(members)
            for member, part in zip(members, _parts(self.signals, members), strict=True):
                out[:, SUMS * g : SUMS * (g + 1), member] = part[:, None] * shares.T
        return out

    def _effect(self, members: Sequence[int]) -> np.ndarray:
        """Effect of an error of a group of kinds, of 1 sigma one at each source, on fixes (e, MOST, s)."""
        return np.asarray(self.by_range * _size(self.signals, members)[:, None])

    def _shares(self, members: Sequence[int]) -> np.ndarray:
        """Share of each source's error, of 1 sigma one, in each of the orthogonal sums (s, SUMS).

        The sums explain most of the position error over the flight, with equal weight for each direction of a fix. The
        first three are the errors north, east, down at the first fix, as far as they are linearly independent.
        """
        effect = self._effect(members)[self.fixed, :3]
        variance, axes = np.linalg.eigh(effect @ np.swapaxes(effect, 1, 2))
        root = np.sqrt(np.maximum(variance, 0.0))
        inverse = np.divide(1.0, root, out=np.zeros_like(root), where=root > 1e-9 * root[:, -1:])
        # rows (e, 3, s) of unit length, where the variance has a root
        told = (axes * inverse[:, None]) @ np.swapaxes(axes, 1, 2) @ effect
        out = np.zeros((effect.shape[2], SUMS))
        if not told.size:
            return out
        heard = np.any(effect != 0.0, axis=(0, 1))
        told = told[:, :, heard]
        _, most = np.linalg.eigh(np.einsum("eas,eat->st", told, told))
        found = most[:, ::-1][:, :SUMS]
        left, _, right = np.linalg.svd(told[0] @ found)
        found = found @ right.T
        if found.shape[1] >= 3:  # fewer sources have fewer sums, in no such order
            found[:, :3] = found[:, :3] @ left.T
        out[heard, : found.shape[1]] = found
        return out


def _spread(slope: np.ndarray, sigma: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Covariance (e, MOST, MOST) by independent errors of sources (e, s)."""
    spread = slope * np.where(used, sigma, 0.0)[:, None]
    return np.asarray(spread @ np.swapaxes(spread, 1, 2))


def _size(signals: Signals, members: Sequence[int]) -> np.ndarray:
    """1 sigma of the errors of a group of kinds (e, s), m, 0 for unused sources."""
    assert signals.correlated is not None
    total = np.sqrt(np.sum(signals.correlated.sigma[list(members)] ** 2, axis=0))
    return np.where(signals.used, total, 0.0)


def _parts(signals: Signals, members: Sequence[int]) -> np.ndarray:
    """Share of each kind in an error of its group of 1 sigma one (k, e, s); unused sources keep the nearest value in
    time."""
    assert signals.correlated is not None
    size = _size(signals, members)
    there = size > 0.0
    at = np.where(there, np.arange(size.shape[0])[:, None], -1)
    last = np.maximum.accumulate(at, axis=0)
    last = np.where(last < 0, np.argmax(there, axis=0), last)
    source = np.arange(size.shape[1])
    total = size[last, source]
    sigma = signals.correlated.sigma[list(members)][:, last, source]
    return np.divide(sigma, total, out=np.zeros_like(sigma), where=total > 0.0)


@dataclass(frozen=True)
class RangeErrors:
    """Time-correlated errors of the ranges of a flight as states of a tightly coupled filter: of each source that is
    ever used one state for each group of kinds that it has, of 1 sigma one.

    A source that rises, or comes back, has a state that has not been measured, or not for long: its variance is one, or
    has returned towards one. Nothing has to be added or taken away.
    """

    signals: Signals
    belief: CorrelatedErrorDesign

    @cached_property
    def size(self) -> np.ndarray:
        """1 sigma of the errors of each group (e, s, g), m, 0 for unused sources."""
        sizes = [_size(self.signals, members) for members in self.belief.groups]
        return np.stack(sizes, axis=2) if sizes else np.empty((*self.signals.used.shape, 0))

    @cached_property
    def states(self) -> tuple[np.ndarray, np.ndarray]:
        """Group and source of each state (n,), group by group."""
        group, source = np.nonzero(self.size.any(axis=0).T)
        return group, source

    def blocks(self, step: float) -> tuple[Block, ...]:
        """The states, each a separate block; step: of the filter, s."""
        correlated, names, speeds = self.signals.correlated, self.signals.names, self.belief.names
        assert correlated is not None
        out = []
        for group, source in zip(*self.states, strict=True):
            members = list(self.belief.groups[group])
            time = _common_time(correlated.time[members], np.sum(correlated.sigma[members][:, :, source] ** 2, axis=1))
            name, number = f"range_error_{speeds[group]}_{names[source]}", len(self.belief.groups) * source + group
            out.append(states.correlated_single(name, "1", RANGE, int(number), 1.0, time, step))
        return tuple(out)

    @cached_property
    def _shares(self) -> np.ndarray:
        """By how much each kind is in the error of each state (k, e, n)."""
        assert self.signals.correlated is not None
        k, e, _ = self.signals.correlated.sigma.shape
        group, source = self.states
        out = np.zeros((k, e, group.size))
        for g, members in enumerate(self.belief.groups):
            own = np.flatnonzero(group == g)
            out[np.ix_(np.array(members), np.arange(e), own)] = _parts(self.signals, members)[:, :, source[own]]
        return out

    def projections(self, epoch: int) -> np.ndarray:
        """Effect of errors of each kind and source of variance one on the states (n, k, s), at an epoch."""
        _, source = self.states
        k, s = self._shares.shape[0], self.signals.used.shape[1]
        out = np.zeros((source.size, k, s))
        out[np.arange(source.size), :, source] = self._shares[:, epoch].T
        return out

    def true_values(self, errors: np.ndarray) -> np.ndarray:
        """The errors of the states (e, n), of errors of each kind and source of variance one (k, e, s)."""
        return np.asarray(np.sum(self._shares * errors[:, :, self.states[1]], axis=0))
