"""Which sources to do without after an alarm.

Source: `docs/theory/integrity.md`, section 2; the rule of residuals' RMS is that of RTKLIB (`raim_fde` of `pntpos.c`).
"""

from __future__ import annotations

import numpy as np

NOTHING = -1
"""In place of the number of a candidate: none is excluded."""
LEAST_LEFT = 5
"""So many ranges have to be left for a choice by their RMS, as RTKLIB has it."""


def contained(candidates: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Whether what a candidate takes away another one takes away, too (c, c, e). candidates: (c, s) bool, used:
    (e, s) bool."""
    taken = candidates[:, None] & used
    return ~(taken[:, None] & ~taken[None]).any(axis=3)


def alone(passes: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The candidate (e, W) without which what is left passes its own test, where no other one does, but for those that
    take away still more; `NOTHING` where there is none.

    passes: (c, e, W) bool. inside: (c, c, e), see `contained`.
    """
    if not len(passes):
        return np.full(passes.shape[1:], NOTHING)
    least = np.stack([mine & (~passes | inside[k][..., None]).all(axis=0) for k, mine in enumerate(passes)])
    return np.where(least.any(axis=0), np.argmax(least, axis=0), NOTHING)


def least_rms(passes: np.ndarray, rms: np.ndarray, left: np.ndarray) -> np.ndarray:
    """The candidate (e, W) with the smallest RMS of residuals of those without which what is left passes its own test;
    `NOTHING` where there is none.

    passes: (c, e, W) bool. rms: (c, e, W) m. left: (c, e) how many ranges are left.
    """
    able = passes & (left >= LEAST_LEFT)[..., None]
    if not len(passes):
        return np.full(passes.shape[1:], NOTHING)
    return np.where(able.any(axis=0), np.argmin(np.where(able, rms, np.inf), axis=0), NOTHING)
