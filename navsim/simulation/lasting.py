"""What errors that last do to a receiver's fixes and ranges, and what a filter is told of it.

Errors of ranges become errors of a fix by its geometry. A loosely coupled filter can follow those: three states for the
kinds of errors that hardly change over the flight, three for the others, of 1 sigma one, whose effect on a fix is the
square root of the covariance that these kinds give it. Or it takes fixes, or ranges, for noisier than they are.

Source: `docs/theory/lasting-errors.md`, sections 3 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.core import states
from navsim.core.lanes import WIDTH
from navsim.core.states import MOST, Block
from navsim.estimation.beliefs import LastingBelief
from navsim.estimation.observations import FIX
from navsim.models.lasting import LastingError
from navsim.models.pseudorange import Signals
from navsim.simulation.fix_slopes import slopes
from navsim.simulation.fixes import solved

STATES, INFLATED, IGNORED = "states", "inflate", "none"
"""What a filter does about errors that last: follows them, takes what is measured for noisier, nothing."""
_SLOW, _FAST = "fix_error_slow", "fix_error_fast"


def followed_errors(
    how: str, kinds: Sequence[LastingError], duration: float, interval: float, step: float
) -> tuple[LastingBelief, tuple[Block, ...]]:
    """What a filter believes of these kinds of errors, and the blocks of states that it follows them by.

    how: `STATES`, `INFLATED` or `IGNORED`. duration: of the flight, interval: between fixes, step: of the filter, s.
    """
    groups: list[tuple[int, ...]] = []
    blocks: list[Block] = []
    if how == STATES:
        slow = [kind.time >= duration for kind in kinds]
        for name, wanted in ((_SLOW, True), (_FAST, False)):
            members = tuple(k for k, is_slow in enumerate(slow) if is_slow == wanted and kinds[k].sigma > 0.0)
            if members:
                variances = np.array([kinds[k].sigma ** 2 for k in members])
                rate = float(np.average([1.0 / kinds[k].time for k in members], weights=variances))
                time = 1.0 / rate if rate > 0.0 else np.inf
                blocks.append(states.lasting(name, FIX, time, step, 3 * len(groups)))
                groups.append(members)
    factor = np.ones(len(kinds))
    if how == INFLATED:
        factor = np.array([_as_noise(kind.time, duration, interval) for kind in kinds])
    return LastingBelief(how == STATES, tuple(groups), factor), tuple(blocks)


def _as_noise(time: float, duration: float, interval: float) -> float:
    """How many times its variance an error of this correlation time has as white noise that does to a mean over many
    intervals what the error does; of one that outlasts the flight, to the mean over the flight."""
    kept = np.exp(-interval / min(time, 0.5 * duration))
    return float((1.0 + kept) / (1.0 - kept))


@dataclass(frozen=True)
class FixErrors:
    """Errors of the fixes of a flight, to first order along the truth: fixed (e,) bool, where there is a fix; by_range,
    by_rate (e, MOST, s) as of `fix_slopes.slopes`."""

    signals: Signals
    fixed: np.ndarray
    by_range: np.ndarray
    by_rate: np.ndarray

    @classmethod
    def of(cls, start: np.ndarray, signals: Signals, ranges: np.ndarray, rates: np.ndarray) -> FixErrors:
        """Those of fixes from ranges and rates (e, s) without errors; start: (3,) ECEF, where the iteration begins."""
        fixes = solved(start, signals, *(np.repeat(m[..., None], WIDTH, axis=-1) for m in (ranges, rates)))
        llh, velocity, clocks = (m[..., 0] for m in fixes[:3])
        by_range, by_rate = slopes(signals, ranges, rates, (llh, velocity, clocks))
        return cls(signals, np.isfinite(llh[:, 0]), by_range, by_rate)

    @cached_property
    def noise(self) -> np.ndarray:
        """Covariance of what is new in each fix (e, MOST, MOST)."""
        s = self.signals
        return _spread(self.by_range, s.noise_sigma, s.used) + _spread(self.by_rate, s.rate_sigma, s.used)

    def of_kinds(self, factor: np.ndarray) -> np.ndarray:
        """Covariance of fixes by all kinds of lasting errors (e, MOST, MOST), the variance of each times a factor
        (k,)."""
        assert self.signals.lasting is not None
        sigma = np.sqrt(np.einsum("k,kes->es", factor, self.signals.lasting.sigma**2))
        return _spread(self.by_range, sigma, self.signals.used)

    def roots(self, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """What errors of 1 sigma one, three for each group of kinds, do to fixes (e, MOST, 3 g): a square root of the
        covariance of position by these kinds, and what goes with it in velocity; 0 where there is no fix.

        Any root would do for one fix. From fix to fix it is turned as the errors are, so that what the three are
        changes as little as can be while the satellites move; the first is symmetric.
        """
        lasting = self.signals.lasting
        assert lasting is not None
        out = np.zeros((self.fixed.size, MOST, 3 * len(groups)))
        at = np.flatnonzero(self.fixed)
        for g, members in enumerate(groups):
            size = np.where(self.signals.used, lasting.sigma[list(members)], 0.0)
            # (e, MOST, k s): by an error of each source and kind of variance one
            effect = (self.by_range[:, :, None] * np.moveaxis(size, 0, 1)[:, None]).reshape(self.fixed.size, MOST, -1)
            whole = effect @ np.swapaxes(effect, 1, 2)
            variance, axes = np.linalg.eigh(whole[:, :3, :3])
            root = np.sqrt(np.maximum(variance, 0.0))
            inverse = np.divide(1.0, root, out=np.zeros_like(root), where=root > 1e-9 * root[:, -1:])
            whitened = (axes * inverse[:, None]) @ np.swapaxes(axes, 1, 2) @ effect[:, :3]
            turn, before = np.eye(3), None
            for i in at:
                if before is not None:
                    left, _, right = np.linalg.svd(whitened[i] @ before.T)
                    turn = left @ right
                before = turn.T @ whitened[i]
                out[i, :, 3 * g : 3 * g + 3] = effect[i] @ before.T
        return out

    def projections(self, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """What the errors of `roots` owe to the errors of each kind and source of variance one (e, 3 g, k, s); where
        there is no fix they are as at the last one, or the first."""
        lasting = self.signals.lasting
        assert lasting is not None
        k, e, s = lasting.sigma.shape
        out = np.zeros((e, 3 * len(groups), k, s))
        roots = self.roots(groups)
        for g, members in enumerate(groups):
            here = slice(3 * g, 3 * g + 3)
            inverse = np.linalg.pinv(roots[:, :3, here])
            for member in members:
                size = np.where(self.signals.used, lasting.sigma[member], 0.0)
                out[:, here, member] = inverse @ (self.by_range[:, :3] * size[:, None])
        return out[self.last_fix]

    @property
    def last_fix(self) -> np.ndarray:
        """The epoch of the last fix at each, or of the first before it (e,) int."""
        at = np.flatnonzero(self.fixed)
        every = np.arange(self.fixed.size)
        if not at.size:
            return every
        return np.asarray(at[np.maximum(np.searchsorted(at, every, side="right") - 1, 0)])


def _spread(slope: np.ndarray, sigma: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Covariance (e, MOST, MOST) by independent errors of sources (e, s)."""
    spread = slope * np.where(used, sigma, 0.0)[:, None]
    return np.asarray(spread @ np.swapaxes(spread, 1, 2))
