"""Innovation monitor: sum of normalised innovations squared over a window of time.

The filter follows a slowly growing fault: each innovation alone is small, but their sum is improbable.

Source: `docs/theory/integrity.md`, section 9; Tanil, Khanafseh, Joerger & Pervan, An INS monitor to detect GNSS
spoofers capable of tracking vehicle position, IEEE TAES 54(1) (2018).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.statistics import chi_square


@dataclass(frozen=True)
class InnovationTest:
    """The chi-square test of sums of normalised innovations squared. window: s. p_fa: probability of an alarm at an
    epoch without a fault."""

    window: float
    p_fa: float

    def ratio(self, time: np.ndarray, squared: np.ndarray, degrees: np.ndarray) -> np.ndarray:
        """Sums over the window that ends with each epoch, of at least one epoch, relative to their threshold (r, e).

        Above 1 they are an alarm; nan without a measurement in the window.

        time: (e,) s, increasing. squared: (r, e) normalised innovations squared, nan without a measurement. degrees:
        (r, e) int, their degrees of freedom.
        """
        first = np.minimum(np.searchsorted(time, time - self.window + 1e-9), np.arange(time.size))
        sums, counts = (
            np.concatenate([np.zeros((squared.shape[0], 1)), np.cumsum(each, axis=1)], axis=1)
            for each in (np.where(degrees > 0, squared, 0.0), degrees)
        )
        last = np.arange(1, time.size + 1)
        total, count = sums[:, last] - sums[:, first], counts[:, last] - counts[:, first]
        each, index = np.unique(count, return_inverse=True)
        limits = np.array([chi_square.exceeded(self.p_fa, n) if n > 0 else math.nan for n in each])
        return np.asarray(total / limits[index].reshape(count.shape))


def detection(degrees: int, noncentrality: float, p_fa: float) -> float:
    """Probability of an alarm for a sum with so many degrees of freedom and this noncentrality."""
    return 1.0 - chi_square.probability_below(chi_square.exceeded(p_fa, degrees), degrees, noncentrality)
