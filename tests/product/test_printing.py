"""Colours of figures as the colour-blind see them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from navsim.report import printing

_TO_LMS = np.array([[0.31399022, 0.63951294, 0.04649755], [0.15537241, 0.75789446, 0.08670142],
                    [0.01775239, 0.10944209, 0.87256922]])  # fmt: skip
_SEEN = {
    "protanopia": [[0.0, 1.05118294, -0.05116099], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "deuteranopia": [[1.0, 0.0, 0.0], [0.9513092, 0.0, 0.04866992], [0.0, 0.0, 1.0]],
    "tritanopia": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.86744736, 1.86727089, 0.0]],
}
"""Of cones long, middle, short: what who lacks one sees (Vienot, Brettel and Mollon 1999, with sRGB by Hunt's
matrix)."""


def lab(colour: str, seen: str | None) -> np.ndarray:
    """CIE L*a*b* of a colour as it is seen."""
    coded = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    if seen is not None:
        linear = np.clip(np.linalg.solve(_TO_LMS, np.array(_SEEN[seen]) @ _TO_LMS @ linear), 0.0, 1.0)
    xyz = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
                    [0.0193339, 0.1191920, 0.9503041]]) @ linear / np.array([0.95047, 1.0, 1.08883])  # fmt: skip
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def nearest(colours: tuple[str, ...], seen: str | None) -> float:
    pairs = itertools.combinations([lab(colour, seen) for colour in colours], 2)
    return min(float(np.linalg.norm(a - b)) for a, b in pairs)


@pytest.mark.parametrize("seen", [None, *_SEEN])
def test_colours_are_told_apart(seen: str | None) -> None:
    """Ten units of L*a*b* are told apart at a glance; two are just seen."""
    assert nearest(printing.COLOURS, seen) > 10.0
    if seen == "deuteranopia":
        own = ("#d62728", "#2ca02c", "#8c564b")  # red, green, brown of matplotlib
        assert nearest(own, seen) < 0.5 * nearest(own, None)


def test_more_lines_than_colours_differ_by_dashes() -> None:
    many = [tuple(sorted(printing.style(i).items())) for i in range(4 * len(printing.COLOURS))]
    assert len(set(many)) == len(many)
