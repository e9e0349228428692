"""Capabilities of a number of sources in any geometry: the paper's claim, from ranks.

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
    """Capabilities of a set of sources."""

    fix: bool
    """There is a fix."""
    detection: bool
    """Any single fault can be detected."""
    exclusion: bool
    """Any single fault can be excluded."""
    ground_loss: bool
    """Single faults can be detected, and there is a fix without all pseudolites."""

    def __str__(self) -> str:
        flags = (self.fix, self.detection, self.exclusion, self.ground_loss)
        return "".join(letter if there else "-" for letter, there in zip("FDXG", flags, strict=True))


def possible(satellite_clocks: tuple[int, ...], pseudolite_clocks: tuple[int, ...]) -> Observability:
    """Capabilities of satellites and pseudolites with these clocks."""
    clock = np.array([*satellite_clocks, *pseudolite_clocks], int)
    direction = np.random.default_rng(_SEED).standard_normal((clock.size, 3))
    rows = np.concatenate(
        [direction / np.linalg.norm(direction, axis=1)[:, None], clock[:, None] == np.unique(clock)], axis=1
    )
    everything = frozenset(range(clock.size))

    def survives(lost: int) -> bool:
        """Whether there is a fix without any choice of so many ranges."""
        return clock.size > lost and all(
            _fix(rows, everything - set(out)) for out in itertools.combinations(everything, lost)
        )

    detection = survives(1)
    ground_loss = detection and _fix(rows, frozenset(range(len(satellite_clocks))))
    return Observability(survives(0), detection, survives(2), ground_loss)


def _fix(rows: np.ndarray, used: frozenset[int]) -> bool:
    """Whether these ranges determine the position: no change of clocks has the same effect as a change of position."""
    own = rows[sorted(used)]
    return bool(own.size and np.linalg.matrix_rank(own) - np.linalg.matrix_rank(own[:, 3:]) == 3)
