"""Which sources to do without after an alarm.

Source: `docs/theory/integrity.md`, section 2; the rule of residuals' RMS is that of RTKLIB (`raim_fde` of `pntpos.c`).
"""

from __future__ import annotations

import numpy as np

NOTHING = -1
"""In place of the number of a candidate: none is excluded."""
LEAST_LEFT = 5
"""Ranges that must remain for a choice by RMS, as in RTKLIB."""


def contained(candidates: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Whether the sources of a candidate are a subset of another one's (c, c, e). candidates: (c, s) bool, used: (e, s)
    bool."""
    taken = candidates[:, None] & used
    return ~(taken[:, None] & ~taken[None]).any(axis=3)


def alone(passes: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The only candidate (e, W) without which the rest passes its own test; `NOTHING` if there is none or more than
    one.

    Candidates that contain it do not count. passes: (c, e, W) bool. inside: (c, c, e), see `contained`.
    """
    if not len(passes):
        return np.full(passes.shape[1:], NOTHING)
    least = np.stack([mine & (~passes | inside[k][..., None]).all(axis=0) for k, mine in enumerate(passes)])
    return np.where(least.any(axis=0), np.argmax(least, axis=0), NOTHING)


def least_rms(passes: np.ndarray, rms: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Candidate (e, W) with the smallest RMS of residuals of those without which the rest passes its own test.

    `NOTHING` if there is none. passes: (c, e, W) bool. rms: (c, e, W) m. left: (c, e) number of remaining ranges.
    """
    able = passes & (left >= LEAST_LEFT)[..., None]
    if not len(passes):
        return np.full(passes.shape[1:], NOTHING)
    return np.where(able.any(axis=0), np.argmin(np.where(able, rms, np.inf), axis=0), NOTHING)
