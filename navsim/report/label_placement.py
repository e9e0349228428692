"""Where names stand beside marks: each where it covers least of marks, of names before it, and of what else is there;
of figures and of pages alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Side(NamedTuple):
    """Where a name stands beside its mark: its alignment, and how far to the right and down from mark to name."""

    align: str
    right: float
    down: float


class Covered(NamedTuple):
    """What something covers, to the right and down."""

    left: float
    right: float
    upper: float
    lower: float

    def common(self, other: Covered) -> float:
        """How much of it another one covers."""
        across = min(self.right, other.right) - max(self.left, other.left)
        down = min(self.lower, other.lower) - max(self.upper, other.upper)
        return across * down if across > 0.0 and down > 0.0 else 0.0


ON = Side("center", 0.0, 0.0)
"""In the middle of its mark."""
_SIDES = (
    Side("left", 0.7, 0.0), Side("right", -0.7, 0.0), Side("center", 0.0, -1.2), Side("center", 0.0, 1.2),
    Side("left", 0.5, -0.8), Side("right", -0.5, -0.8), Side("left", 0.5, 0.8), Side("right", -0.5, 0.8),
)  # fmt: skip
"""In the order of what is liked, in lines."""


class Letters(NamedTuple):
    """How large a mark, a line of letters, and one of them are."""

    mark: float
    line: float
    letter: float

    def written(self, x: float, y: float, said: str, side: Side) -> Covered:
        """What a name covers beside a mark."""
        wide = self.letter * len(said)
        left = x + side.right - {"left": 0.0, "center": 0.5 * wide, "right": wide}[side.align]
        return Covered(left, left + wide, y + side.down - 0.5 * self.line, y + side.down + 0.5 * self.line)

    def sides(
        self, places: Sequence[tuple[float, float]], said: Sequence[str], there: Sequence[Covered], paper: Covered
    ) -> list[Side]:
        """Where names stand beside marks at places, to the right and down. there: what is covered already. paper: what
        no name is to leave."""
        liked = [Side(side.align, self.line * side.right, self.line * side.down) for side in _SIDES]
        half = 0.5 * self.mark
        marks = [Covered(x - half, x + half, y - half, y + half) for x, y in places]
        taken, out = list(there), list[Side]()
        for i, (place, name) in enumerate(zip(places, said, strict=True)):
            others = [*taken, *marks[:i], *marks[i + 1 :]]
            boxes = [self.written(*place, name, side) for side in liked]
            covered = [sum(map(box.common, others)) + box.common(box) - box.common(paper) for box in boxes]
            best = covered.index(min(covered))
            taken.append(boxes[best])
            out.append(liked[best])
        return out
