"""What a number of sources makes possible at all, whatever their geometry: the paper's claim, by ranks.

Source: `docs/theory/integrity.md`, section 6.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

_SEED = 1
"""Directions of no symmetry; any have the same ranks."""


@dataclass(frozen=True)
class Observability:
    """What sources make possible: a fix; that any single fault is detected, and excluded; that single faults are
    detected and the loss of all pseudolites at once leaves a fix."""

    fix: bool
    detection: bool
    exclusion: bool
    ground_loss: bool

    def __str__(self) -> str:
        flags = (self.fix, self.detection, self.exclusion, self.ground_loss)
        return "".join(letter if there else "-" for letter, there in zip("FDXG", flags, strict=True))


def possible(satellite_clocks: tuple[int, ...], pseudolite_clocks: tuple[int, ...]) -> Observability:
    """What satellites and pseudolites, by the clocks that their ranges have, make possible."""
    clock = np.array([*satellite_clocks, *pseudolite_clocks], int)
    direction = np.random.default_rng(_SEED).standard_normal((clock.size, 3))
    rows = np.concatenate(
        [direction / np.linalg.norm(direction, axis=1)[:, None], clock[:, None] == np.unique(clock)], axis=1
    )
    everything = frozenset(range(clock.size))

    def survives(lost: int) -> bool:
        """Whether there is a fix however so many ranges are left out."""
        return clock.size > lost and all(
            _fix(rows, everything - set(out)) for out in itertools.combinations(everything, lost)
        )

    detection = survives(1)
    ground_loss = detection and _fix(rows, frozenset(range(len(satellite_clocks))))
    return Observability(survives(0), detection, survives(2), ground_loss)


def _fix(rows: np.ndarray, used: frozenset[int]) -> bool:
    """Whether the position can be told from these ranges: no change of clocks looks like one of it."""
    own = rows[sorted(used)]
    return bool(own.size and np.linalg.matrix_rank(own) - np.linalg.matrix_rank(own[:, 3:]) == 3)
