"""Probabilities from weighted samples, for arrays."""

from __future__ import annotations

import numpy as np

TWO_SIDED = 1.959963984540054
"""Standard errors to either side of a two-sided 95 % interval."""
FEW = 30
"""Effective samples below which an interval is no more than a hint."""
LEAST = 1e-300
"""Smallest probability that is distinguished from zero; floating-point numbers end soon below it."""


def relative_error(total: np.ndarray, square: np.ndarray, runs: int) -> np.ndarray:
    """Standard error over the mean of `runs` numbers, not negative, by their sum and the sum of their squares."""
    spread = np.maximum(square / np.square(total) - 1.0 / runs, 0.0)
    return np.asarray(np.sqrt(spread * runs / (runs - 1.0)))
