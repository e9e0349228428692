"""Time-correlated ranging errors: one or several Gauss-Markov processes for each satellite, drawn for each run.

    e(t + d) = a e(t) + sigma sqrt(1 - a^2) n,  a = exp(-d / tau),  n white

Sources:

- [1] Brown & Hwang, Introduction to random signals and applied Kalman filtering, 4th ed. (2012), section 4.2 (the
  process, and its exact steps).
- [2] Groves (2013), section 9.3, eqs. 9.79 and 9.80 (increase of ionospheric and tropospheric errors towards the
  horizon).
- [3] `docs/theory/lasting-errors.md`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

SUMS = 6
"""Number of sums over the sources that model fix errors of similar correlation time. Three are enough while satellites
keep their shares in a fix. A lost satellite or a near pseudolite changes the shares."""
Mapping = Literal["none", "ionosphere", "troposphere", "multipath"]
"""Increase of an error towards the horizon, see `mapped`."""
LOWEST = np.radians(2.0)
"""Elevation below which errors grow no more, rad, as those of `pseudorange.sigma_of_elevation`."""


@dataclass(frozen=True)
class CorrelatedError:
    """A kind of error that all satellites have, each its own: name; sigma: 1 sigma at the zenith, m; time: correlation
    time, s, may be inf; mapping: how it grows towards the horizon."""

    name: str
    sigma: float
    time: float
    mapping: Mapping

    def at(self, elevation: np.ndarray, systems: Sequence[str]) -> np.ndarray:
        """1 sigma (e, s), m, of sources of these systems (s,), which are all alike, at elevations (e, s), rad."""
        return self.sigma * mapped(self.mapping, elevation)


@dataclass(frozen=True)
class CorrelatedErrors:
    """The kinds of errors of the sources of signals: names (k,); time (k,) correlation times, s; sigma (k, e, s) 1
    sigma at each epoch of each source, m, 0 of those without."""

    names: tuple[str, ...]
    time: np.ndarray
    sigma: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """1 sigma of all kinds together (e, s), m."""
        return np.asarray(np.sqrt(np.sum(self.sigma**2, axis=0)))

    def at(self, epochs: np.ndarray) -> CorrelatedErrors:
        """At the epochs with these numbers (m,) int."""
        return CorrelatedErrors(self.names, self.time, self.sigma[:, epochs])

    def select(self, kept: np.ndarray) -> CorrelatedErrors:
        """Errors of the sources marked in `kept` (s,) bool."""
        return CorrelatedErrors(self.names, self.time, self.sigma[:, :, kept])

    def steps(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Decay of each kind from epoch to epoch (e,), s, and 1 sigma of the noise for a variance of one (e, k).

        At the first epoch everything is noise.
        """
        ages = np.diff(time)[:, None] / self.time
        kept, new = np.zeros((time.size, self.time.size)), np.ones((time.size, self.time.size))
        kept[1:], new[1:] = np.exp(-ages), np.sqrt(-np.expm1(-2.0 * ages))
        return kept, new

    def drawn(self, time: np.ndarray, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """Errors of unit variance of as many runs as there are generators (k, e, s, W), at epochs (e,), s.

        Every source draws at every epoch, so a mask does not shift the numbers of the others.
        """
        k, e, s = self.sigma.shape
        out = np.stack([rng.standard_normal((e, k, s)) for rng in rngs], axis=-1)
        kept, new = (m[:, :, None, None] for m in self.steps(time))
        for i in range(1, e):
            out[i] = kept[i] * out[i - 1] + new[i] * out[i]
        return np.moveaxis(out, 1, 0)


def mapped(mapping: Mapping, elevation: np.ndarray) -> np.ndarray:
    """Factor on an error's size at the zenith at elevations, rad, of at least `LOWEST`.

    ionosphere, troposphere: [2]. multipath: 1 + 1.31 exp(-el / 13 deg), the law of aircraft at L1 [3].
    """
    el = np.maximum(elevation, LOWEST)
    if mapping == "none":
        return np.ones_like(el)
    if mapping == "multipath":
        return 1.0 + 1.31 * np.exp(-el / np.radians(13.0))
    share = {"ionosphere": 0.899, "troposphere": 0.998}[mapping]
    return 1.0 / np.sqrt(1.0 - share * np.cos(el) ** 2)
