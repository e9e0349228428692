"""Exclusion: solve fixes with an alarm again without the sources that are probably faulty.

Source: `docs/theory/integrity.md`, section 7. Fixes are solved in stretches of the flight that are the same for all
runs, each with a new start of the iteration. A run's fix thus does not depend on the alarms of other runs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from navsim.gnss.pseudorange import Signals
from navsim.gnss.receiver_fixes import ReceiverFixes, range_residuals, solve_fixes
from navsim.integrity import exclusion
from navsim.integrity.monitoring import RMS, Monitoring, Snapshot, tested_levels

STRETCH = 256
"""Epochs that are tried together."""
MOST_KEPT = 2**28
"""Memory limit for cached monitors, bytes; others are computed again for each use."""


@dataclass(frozen=True)
class FixesAfterExclusion:
    """Fixes after exclusion."""

    fixes: ReceiverFixes
    error: np.ndarray
    """(e, 2, W) sizes of their errors, m."""
    level: np.ndarray
    """(e, 2, W) protection levels, m, nan without a test."""
    excluded: np.ndarray
    """(e, W) number of the excluded candidate, `exclusion.NOTHING` for none."""


@dataclass(frozen=True)
class Excluder:
    """Exclusion for fixes with an alarm."""

    watching: Monitoring
    """Monitor with a rule of exclusion."""
    signals: Signals
    """Signals of the fixes."""
    start: np.ndarray
    """(3,) ECEF, first point of their iteration."""
    axes: np.ndarray
    """(e, 3, 3) rows east, north, up at the antenna."""
    _kept: dict[tuple[int, int], Snapshot] = field(default_factory=dict)

    @cached_property
    def _used_sources(self) -> np.ndarray:
        """Sources that are used at all (s,) bool; nothing is computed with others."""
        return np.asarray(self.signals.used.any(axis=0))

    @cached_property
    def _candidates(self) -> np.ndarray:
        """Sources that each candidate removes (c, s) bool."""
        names = np.array(self.signals.names)[self._used_sources]
        taken = [np.isin(names, one.sources) for one in self.watching.candidates(self.signals)]
        return np.array(taken, bool).reshape(-1, names.size)

    def exclude(
        self,
        alarm: np.ndarray,
        ranges: np.ndarray,
        rates: np.ndarray,
        antenna: np.ndarray,
        settled: FixesAfterExclusion,
    ) -> None:
        """Replace fixes with an alarm (e, W) by those without the excluded candidate; measurements (e, s, W), antenna
        (e, 3, W)."""
        for number, first in enumerate(range(0, alarm.shape[0], STRETCH)):
            part = slice(first, first + STRETCH)
            if alarm[part].any():
                heard = [np.ascontiguousarray(m[part, self._used_sources]) for m in (ranges, rates)]
                self._exclude_in_stretch(number, part, alarm[part], [*heard, antenna[part]], settled)

    def _exclude_in_stretch(
        self, number: int, part: slice, alarm: np.ndarray, measured: list[np.ndarray], settled: FixesAfterExclusion
    ) -> None:
        ranges, rates, antenna = measured
        signals = self.signals.at(np.arange(self.signals.time.size)[part]).select(self._used_sources)
        taken = (self._candidates[:, None] & signals.used).any(axis=2)
        tried = np.flatnonzero(taken.any(axis=1))
        passes, rms = np.zeros((tried.size, *alarm.shape), bool), np.zeros((tried.size, *alarm.shape))
        left = np.array([(signals.used & ~self._candidates[c]).sum(axis=1) for c in tried]).reshape(tried.size, -1)
        made: list[tuple[ReceiverFixes, np.ndarray, Snapshot]] = []
        for i, c in enumerate(tried):
            kept = np.where(self._candidates[c][:, None], np.nan, ranges)
            fixes = solve_fixes(self.start, signals, kept, rates)
            residual, error = range_residuals(signals, antenna, self.axes[part], kept, fixes.llh, fixes.clocks)
            monitor = self._monitor(number, int(c), signals)
            there = (taken[c] & monitor.tested)[:, None] & ~np.isnan(fixes.llh[:, 0])
            passes[i] = alarm & there & (monitor.statistic(residual) <= monitor.threshold[:, None])
            rms[i] = np.sqrt(np.nansum(residual**2, axis=1) / np.maximum(left[i], 1)[:, None])
            made.append((fixes, error, monitor))
        if self.watching.exclusion == RMS:
            chosen = exclusion.least_rms(passes, rms, left)
        else:
            chosen = exclusion.alone(passes, exclusion.contained(self._candidates[tried], signals.used))
        for i, (fixes, error, monitor) in enumerate(made):
            mine = chosen == i
            if not mine.any():
                continue
            for has, gets in zip((*settled.fixes, settled.error), (*fixes, error), strict=True):
                np.copyto(has[part], gets, where=mine.reshape(len(mine), *[1] * (has.ndim - 2), -1))
            np.copyto(settled.level[part], tested_levels(monitor)[..., None], where=mine[:, None])
            settled.excluded[part][mine] = tried[i]

    def _monitor(self, number: int, candidate: int, signals: Signals) -> Snapshot:
        """Monitor of a stretch of the flight without a candidate."""
        if (number, candidate) in self._kept:
            return self._kept[number, candidate]
        without = self.watching.without(self.signals, signals, candidate)
        if (len(self._kept) + 1) * without.size <= MOST_KEPT:
            self._kept[number, candidate] = without
        return without
