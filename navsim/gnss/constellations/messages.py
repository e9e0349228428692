"""Messages of satellites: choice of the message for a time, and its copy in a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Messages:
    """Real or simulated messages of satellites."""

    fields: Mapping[str, np.ndarray]
    """By name (k,) or (k, 3) of k messages, including `healthy`."""
    exact: bool
    """Whether these very messages determine the simulated orbits."""


def nearest(
    owners: np.ndarray,
    usable: np.ndarray,
    reference: np.ndarray,
    members: np.ndarray,
    at: np.ndarray,
    reach: float,
    ahead: float,
) -> np.ndarray:
    """Index (m, n) of the message that each member (n,) uses at times `at` (m, n).

    It is the one with the nearest reference time; -1 without one up to `reach`, s, before the time or `ahead`, s, after
    it.

    owners, usable, reference (k,): satellite of each message, whether it may be used, its reference time.
    """
    out = np.full(at.shape, -1)
    for column, member in enumerate(members):
        mine = np.flatnonzero((owners == member) & usable)
        if mine.size:
            later = at[:, column, None] - reference[mine]
            distance = np.where((later <= reach) & (later >= -ahead), np.abs(later), np.inf)
            best = np.argmin(distance, axis=1)
            inside = np.isfinite(np.take_along_axis(distance, best[:, None], axis=1)[:, 0])
            out[:, column] = np.where(inside, mine[best], -1)
    return out


def for_each(time: np.ndarray, count: int) -> np.ndarray:
    """Times (m,) or (m, count) as (m, count)."""
    time = np.asarray(time, dtype=float)
    return np.repeat(time[:, None], count, axis=1) if time.ndim == 1 else time
