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


def test_a_thinned_line_reaches_as_far_everywhere() -> None:
    """Noise with a gap and a spike: in every half point of the print the least and the largest value are kept, and
    few points are."""
    rng = np.random.default_rng(2)
    x = np.linspace(0.0, 100.0, 200_000)
    y = rng.normal(size=x.size)
    y[60_000] = 9.0
    y[100_000:104_000] = np.nan
    with printing.printed(printing.Print(width=85.0 / 25.4)):
        figure = printing.new_figure(3.5, 2.0)
        ax = figure.subplots()
        (line,) = ax.plot(x, y, lw=0.7)
        ax.set_xlim(0.0, 100.0)
        printing.fit(figure)
        figure.draw_without_rendering()
    wide = ax.get_window_extent().width * 72.0 / figure.dpi
    assert len(line.get_xdata()) < 5.0 * wide
    edges = np.arange(0.0, 100.0, 100.0 / int(2.0 * wide))[1:]
    for of, values in ((x, y), (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))):
        columns = np.split(values, np.searchsorted(of, edges))
        ends = [(np.nanmin(each), np.nanmax(each), bool(np.isnan(each).any())) for each in columns
                if not np.isnan(each).all()]  # fmt: skip
        if of is x:
            wanted = ends
    off = [one != other for one, other in zip(wanted, ends, strict=True)]
    assert np.mean(off) < 0.02  # the panel is arranged once more after lines are thinned
    assert max(most for _, most, _ in ends) == 9.0


def test_numbers_below_an_axis_keep_apart() -> None:
    with printing.printed(printing.Print(width=85.0 / 25.4)):
        figure = printing.new_figure(3.5, 1.5)
        for ax in figure.subplots(1, 3):
            ax.plot([-12000.0, 3000.0], [0.0, 1.0])
        printing.fit(figure)
        figure.draw_without_rendering()
        for ax in figure.axes:
            low, high = ax.get_xlim()
            shown = [tick.label1 for tick in ax.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
            boxes = sorted((text.get_window_extent() for text in shown), key=lambda box: box.x0)
            assert len(boxes) >= 2
            assert all(b.x0 - a.x1 > 0.0 for a, b in itertools.pairwise(boxes))


def test_panels_to_scale_leave_no_band() -> None:
    """However high a figure is made, panels with one scale on both axes fill their room, and share their width."""
    for height in (2.0, 8.0):
        with printing.printed(printing.Print(width=85.0 / 25.4)):
            figure = printing.new_figure(3.5, height)
            panels = figure.subplots(2, 1)
            for ax, up in zip(panels, (30.0, 70.0), strict=True):
                ax.set(xlim=(0.0, 100.0), ylim=(0.0, up), aspect="equal", title="a title that is long enough to break "
                       "into two lines of a column")  # fmt: skip
            printing.to_scale_below(figure, panels)
            printing.fit(figure)
            figure.draw_without_rendering()
        for ax in panels:
            room, shown = ax.get_position(original=True), ax.get_position()
            assert (shown.width, shown.height) == pytest.approx((room.width, room.height), rel=0.02)
