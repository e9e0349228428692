"""Sums over runs that are the same to the bit for any distribution of the runs over workers and parts.

Sums of floating point numbers depend on their order. The order here is that of a binary tree over the numbers of runs:
runs 2k and 2k + 1 are added, then pairs, then fours [1]. An interval of runs is stored as a few blocks of that tree,
each of a power of two of runs, which begins at a multiple of its length. Adjacent intervals merge into the blocks of
their union, so sums do not depend on batches, workers and parts of an ensemble.

Source: [1] pairwise summation; Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed. (2002), section 4.1.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def blocks(first: int, count: int) -> list[tuple[int, int]]:
    """The blocks of runs first ... first + count - 1: their first runs and lengths."""
    out = []
    end = first + count
    while first < end:
        length = 1 << ((end - first).bit_length() - 1)
        if first:
            length = min(length, first & -first)
        out.append((first, length))
        first += length
    return out


class Sums:
    """Sums of several quantities over the runs so far."""

    def __init__(self) -> None:
        self._blocks: list[tuple[int, int, dict[str, np.ndarray]]] = []

    def add(self, first: int, length: int, values: Mapping[str, np.ndarray]) -> None:
        """Add the next block of runs, or a single run; values must not change afterwards."""
        self._blocks.append((first, length, dict(values)))
        while len(self._blocks) > 1:
            (start, size, left), (_, other, right) = self._blocks[-2:]
            if size != other or start % (2 * size):
                return
            self._blocks[-2:] = [(start, 2 * size, {name: left[name] + right[name] for name in left})]

    def extend(self, first: int, count: int, arrays: Mapping[str, np.ndarray]) -> None:
        """The runs first ... first + count - 1 as `arrays` has them."""
        for i, (start, length) in enumerate(blocks(first, count)):
            self.add(start, length, {name: values[i] for name, values in arrays.items()})

    def arrays(self) -> dict[str, np.ndarray]:
        """Each quantity by the blocks (b, ...), see `blocks`."""
        names = self._blocks[0][2] if self._blocks else ()
        return {name: np.stack([values[name] for _, _, values in self._blocks]) for name in names}

    def total(self, name: str) -> np.ndarray:
        """The sum over all runs, block after block."""
        (_, _, first), *others = self._blocks
        out = first[name]
        for _, _, values in others:
            out = out + values[name]
        return out
