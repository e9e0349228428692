"""Sums over runs that are the same to the bit wherever the runs were flown, and in whatever pieces.

Sums of floating point numbers depend on their order. The order here is that of a binary tree over the numbers of runs:
runs 2k and 2k + 1 are added, then pairs, then fours [1]. A stretch of runs is what is left of that tree: few blocks,
each of a power of two of runs, beginning at a multiple of its length. Stretches that follow each other make the blocks
that they have as one, so batches, workers and parts of an ensemble leave no trace in a sum.

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
        """The next block of runs, or a run by itself; values are not to be changed afterwards."""
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
