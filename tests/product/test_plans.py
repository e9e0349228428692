"""Every plan is a view from above: right of the landing direction is on the right-hand side of who looks along it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from navsim.kinds import named
from navsim.report import printing
from navsim.report.view import view
from navsim.results.result import read

PLAN = "right of the axis, m"
"""Label of the axis of distances from the runway's axis."""
WITH_PLAN = ("one", "runs", "evil", "covariance", "sweep", "optimize")
"""Results, of `tests.made`, whose figures have a plan."""


def figures(file: Path) -> dict[str, Figure]:
    result = read(file)
    with printing.printed(printing.Print("png", width=3.3, dpi=50.0)):
        return view(result.attributes["kind"]).figures(result)


@pytest.mark.parametrize("name", WITH_PLAN)
def test_figures_show_plans_from_above(name: str, place: Path) -> None:
    plans = [ax for figure in figures(place / f"{name}.h5").values() for ax in figure.axes if ax.get_ylabel() == PLAN]
    assert plans
    for ax in plans:
        assert ax.yaxis_inverted()
        assert not ax.xaxis_inverted()


@pytest.mark.parametrize("name", ["one", "sweep", "optimize"])
def test_pages_show_plans_from_above(name: str, place: Path) -> None:
    result = read(place / f"{name}.h5")
    drawings = named(view(result.attributes["kind"]).drawings)([(name, result)])
    plans = [on for drawing in drawings for on in drawing.panels if on.yaxis[0].axis_label == PLAN]
    assert plans
    for on in plans:
        assert on.y_range.start > on.y_range.end
        assert on.x_range.start < on.x_range.end


def test_a_requirement_and_the_box_are_two_limits(place: Path) -> None:
    """The box limits lateral and vertical errors, the requirement lateral ones alone: no rectangle is made of both."""
    across = figures(place / "runs.h5")["touchdown"].axes[1]
    lines = {line.get_label(): line for line in across.lines}
    assert np.ptp(lines["box"].get_xdata()) == np.ptp(lines["box"].get_ydata()) == 3.0
    assert list(lines["required: lateral ±1.2 m in 95 %"].get_xdata()) == [1.2, 1.2]
    page = view("landing").drawings
    shown = {each.name: each for each in named(page)([("runs", read(place / "runs.h5"))])}["scatter"]
    assert [key.text for key in shown.keys] == ["box", "required"]
