"""Ranging noise with heavier tails than the receiver's Gaussian model.

Each range is drawn independently at each epoch from one of two Gaussians, a core and a tail. This is the contaminated
normal distribution [1]. Two components are also fitted to errors of differentially corrected ranges [2].

Sources:

- [1] Tukey (1960), *A survey of sampling from contaminated distributions*, in Contributions to Probability and
  Statistics.
- [2] *Bounding the Heavy-tailed DGNSS Error by Leveraging Membership Weights Analysis of Gaussian Mixture Model*,
  Pacific PNT 2024.
- [3] `docs/theory/integrity.md`, section 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HeavyTailedNoise:
    """Noise from two Gaussians; equation (13a) of [3] gives the probability of a size."""

    core: float
    """1 sigma of the core relative to the assumed sigma."""
    tail: float
    """1 sigma of the tail, likewise."""
    share: float
    """Fraction of the ranges in the tail."""

    def scales(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Random 1 sigma of each range, relative to the assumed one."""
        return np.where(rng.random(shape) < self.share, self.tail, self.core)
