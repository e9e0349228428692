"""Wild fixes of a recording: short runs of fixes that jump away from all others, and come back.

The test compares each step with the steps around it, so it needs no correct unit or axis. The checks of a recording
remove wild fixes before they compare units and axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.formats.recorded_data import Fixes
from navsim.geodesy import earth

BEYOND_NEIGHBOURS, BEYOND_USUAL = 10.0, 5.0
"""A step is a jump if it exceeds the median of the steps around it, and the upper quartile of all steps, by these
factors."""
NEIGHBOURS = 5
"""Steps to either side that a step is compared with."""
MOST_SKIPPED = 20
"""Runs, one after the other, that a series leaves out at most."""


def plausible(fixes: Fixes) -> np.ndarray:
    """Which fixes (m,) belong to the longest series without a jump of position or velocity.

    Jumps cut the fixes into runs. The series is the chain of runs with the most fixes in which no run jumps to the
    next.
    """
    if fixes.time.size < 2 * NEIGHBOURS:
        return np.full(fixes.time.size, True)
    values = [earth.ecef_from_llh(fixes.llh)]
    values += [fixes.velocity[:, i : i + 1] for i in range(3) if np.isfinite(fixes.velocity[:, i]).all()]
    series = [_Series(fixes.time, each) for each in values]
    jump = np.any([each.rates > each.limits for each in series], axis=0)
    runs = np.split(np.arange(fixes.time.size), np.flatnonzero(jump) + 1)
    length, before = [run.size for run in runs], [-1] * len(runs)
    for k, run in enumerate(runs):
        for i in range(max(0, k - MOST_SKIPPED), k):
            joined = all(each.is_smooth(int(runs[i][-1]), int(run[0])) for each in series)
            if joined and length[i] + run.size > length[k]:
                length[k], before[k] = length[i] + run.size, i
    out = np.full(fixes.time.size, False)
    last = int(np.argmax(length))
    while last >= 0:
        out[runs[last]] = True
        last = before[last]
    return out


@dataclass(frozen=True)
class _Series:
    """Values (m, d) at times (m,), s."""

    time: np.ndarray
    values: np.ndarray

    @cached_property
    def rates(self) -> np.ndarray:
        """Size of each change in a second: (m - 1,)."""
        return np.linalg.norm(np.diff(self.values, axis=0), axis=1) / np.diff(self.time)

    @cached_property
    def limits(self) -> np.ndarray:
        """Rate of change (m - 1,) beyond which each step is a jump."""
        padded = np.pad(self.rates, NEIGHBOURS, mode="reflect")
        around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1), axis=1)
        return np.maximum(BEYOND_NEIGHBOURS * around, BEYOND_USUAL * np.percentile(self.rates, 75.0))

    def is_smooth(self, first: int, last: int) -> bool:
        """Whether no jump leads from one value to a later one, by the limits around both."""
        change = np.linalg.norm(self.values[last] - self.values[first]) / (self.time[last] - self.time[first])
        return bool(change <= max(self.limits[max(first - 1, 0)], self.limits[min(last, self.limits.size - 1)]))
