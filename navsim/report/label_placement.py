"""Placement of labels beside marks, for figures and pages: with least overlap with marks, earlier labels and other
items."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class LabelPosition(NamedTuple):
    """Position of a label beside its mark: alignment, and offset to the right and down."""

    align: str
    right: float
    down: float


class Rectangle(NamedTuple):
    """Rectangle covered by an item, to the right and down."""

    left: float
    right: float
    upper: float
    lower: float

    def common(self, other: Rectangle) -> float:
        """Area of the overlap with another one."""
        across = min(self.right, other.right) - max(self.left, other.left)
        down = min(self.lower, other.lower) - max(self.upper, other.upper)
        return across * down if across > 0.0 and down > 0.0 else 0.0


ON = LabelPosition("center", 0.0, 0.0)
"""In the middle of its mark."""
_SIDES = (
    LabelPosition("left", 0.7, 0.0), LabelPosition("right", -0.7, 0.0), LabelPosition("center", 0.0, -1.2),
    LabelPosition("center", 0.0, 1.2),
    LabelPosition("left", 0.5, -0.8), LabelPosition("right", -0.5, -0.8), LabelPosition("left", 0.5, 0.8),
    LabelPosition("right", -0.5, 0.8),
)  # fmt: skip
"""Sides in the order of preference, in lines."""


class Letters(NamedTuple):
    """Sizes of a mark, a line of text, and a letter."""

    mark: float
    line: float
    letter: float

    def written(self, x: float, y: float, text: str, side: LabelPosition) -> Rectangle:
        """Rectangle of a label beside a mark."""
        wide = self.letter * len(text)
        left = x + side.right - {"left": 0.0, "center": 0.5 * wide, "right": wide}[side.align]
        return Rectangle(left, left + wide, y + side.down - 0.5 * self.line, y + side.down + 0.5 * self.line)

    def sides(
        self, places: Sequence[tuple[float, float]], text: Sequence[str], there: Sequence[Rectangle], paper: Rectangle
    ) -> list[LabelPosition]:
        """Sides of labels beside marks at positions, to the right and down.

        there: rectangles already covered. paper: labels must stay inside.
        """
        liked = [LabelPosition(side.align, self.line * side.right, self.line * side.down) for side in _SIDES]
        half = 0.5 * self.mark
        marks = [Rectangle(x - half, x + half, y - half, y + half) for x, y in places]
        taken, out = list(there), list[LabelPosition]()
        for i, (place, name) in enumerate(zip(places, text, strict=True)):
            others = [*taken, *marks[:i], *marks[i + 1 :]]
            boxes = [self.written(*place, name, side) for side in liked]
            covered = [sum(map(box.common, others)) + box.common(box) - box.common(paper) for box in boxes]
            best = covered.index(min(covered))
            taken.append(boxes[best])
            out.append(liked[best])
        return out
