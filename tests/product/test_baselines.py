"""Every figure, at the width of a column, against its picture of before: tests/baselines, which people have looked at.

After a change that was meant, `pytest tests/product/test_baselines.py --baselines` writes them anew, to be looked at
again. A picture is judged by the mean colour of small squares, so that the edge of a letter does not count and a line
does.
"""

from __future__ import annotations

import functools
import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from navsim.report import printing
from navsim.report.view import view
from navsim.results.result import read
from tests.conftest import ROOT
from tests.helpers import in_brief
from tests.made import EVERY

PLAN = "right of the axis, m"
"""Label of the axis of distances from the runway's axis."""
DRAWN = [name for name in EVERY if name not in ("cut", "none", "integrity-table")]
"""Results with figures of their own."""
WITH_PLAN = ("one", "runs", "evil", "covariance", "sweep", "optimize")
"""Those with a plan."""
FOLDER = ROOT / "tests" / "baselines"
HOW = printing.Print("png", width=85.0 / 25.4, dpi=56.0)
SQUARE = 5
"""Side of a square, pixels: two millimetres."""
FAR = 5.0
"""Of 255, the largest difference of the mean colours of squares that is none. The tests below show what is one."""


def drawn(figure: Figure, file: Path) -> Path:
    """A figure made within `printing.printed`, as a picture."""
    printing.fit(figure)
    file.write_bytes(printing.content(figure, HOW, file.stem))
    return file


@functools.cache
def figures(file: Path) -> dict[str, Figure]:
    """The figures of a result, by their names; once for all tests."""
    result = read(file)
    with printing.printed(HOW):
        return dict(view(result.attributes["kind"]).figures(result))


@pytest.fixture(scope="module")
def errors(place: Path) -> bytes:
    """A figure that is not drawn yet, to be changed."""
    return pickle.dumps(figures.__wrapped__(place / "live.h5")["errors"])


def squares(file: Path) -> np.ndarray:
    """Mean colours of the squares of a picture (rows, columns, 3)."""
    with Image.open(file) as image:
        colours = np.asarray(image.convert("RGB"), float)
    rows, columns = (size // SQUARE for size in colours.shape[:2])
    return colours[: rows * SQUARE, : columns * SQUARE].reshape(rows, SQUARE, columns, SQUARE, 3).mean(axis=(1, 3))


def apart(one: Path, other: Path) -> float:
    """How far two pictures are apart: by the square that differs most."""
    a, b = squares(one), squares(other)
    return float(np.abs(a - b).max()) if a.shape == b.shape else np.inf


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name == "evil" else []) for name in DRAWN]
)
def test_figures_are_those_of_before(name: str, place: Path, tmp_path: Path, pytestconfig: pytest.Config) -> None:
    file = place / f"{name}.h5"
    with printing.printed(HOW):
        found = {key: drawn(figure, tmp_path / f"{name}_{key}.png") for key, figure in figures(file).items()}
    plans = [ax for figure in figures(file).values() for ax in figure.axes if ax.get_ylabel() == PLAN]
    assert bool(plans) == (name in WITH_PLAN)
    assert all(ax.yaxis_inverted() and not ax.xaxis_inverted() for ax in plans), "a plan is a view from above"
    if pytestconfig.getoption("--baselines"):
        FOLDER.mkdir(exist_ok=True)
        for former in FOLDER.glob(f"{name}_*.png"):
            former.unlink()
        for file in found.values():
            with Image.open(file) as image:
                image.convert("RGB").save(FOLDER / file.name, optimize=True)
    before = {re.sub(f"^{name}_", "", file.stem): file for file in FOLDER.glob(f"{name}_*.png")}
    assert found.keys() == before.keys()
    far = {str(file): distance for key, file in found.items() if (distance := apart(file, before[key])) > FAR}
    assert not far, "look at them beside those of tests/baselines"


def test_every_picture_is_of_a_result() -> None:
    assert {file.stem.split("_")[0] for file in FOLDER.glob("*.png")} == set(DRAWN)


def _without_a_line(figure: Figure) -> None:
    max((line for ax in figure.axes for line in ax.lines), key=lambda line: len(np.ravel(line.get_xdata()))).remove()


def _in_another_colour(figure: Figure) -> None:
    figure.axes[0].lines[0].set_color("#999999")


def _a_tenth_larger(figure: Figure) -> None:
    for line in figure.axes[0].lines:
        line.set_ydata(1.1 * np.asarray(line.get_ydata()))


def _on_another_scale(figure: Figure) -> None:
    low, top = figure.axes[-1].get_ylim()
    figure.axes[-1].set_ylim(low, low + 1.25 * (top - low))


def _without_a_label(figure: Figure) -> None:
    figure.axes[0].set_ylabel("")


def _without_its_legend(figure: Figure) -> None:
    for legend in figure.legends:
        legend.remove()


@pytest.mark.parametrize(
    "change",
    in_brief(
        [
            _without_a_line, _in_another_colour, _a_tenth_larger, _on_another_scale, _without_a_label,
            _without_its_legend,
        ],
        0, 4,
    ),
)  # fmt: skip
def test_what_is_seen(change: Callable[[Figure], None], errors: bytes, tmp_path: Path) -> None:
    """Mistakes that people would see."""
    with printing.printed(HOW):
        figure = pickle.loads(errors)
        change(figure)
        file = drawn(figure, tmp_path / "errors.png")
    assert apart(file, FOLDER / "live_errors.png") > 2.0 * FAR


def test_a_requirement_and_the_box_are_two_limits(place: Path) -> None:
    """The box limits lateral and vertical errors, the requirement lateral ones alone: no rectangle is made of both."""
    lines = {line.get_label(): line for line in figures(place / "runs.h5")["touchdown"].axes[1].lines}
    assert np.ptp(lines["box"].get_xdata()) == np.ptp(lines["box"].get_ydata()) == 3.0
    assert list(lines["required: lateral ±1.2 m in 95 %"].get_xdata()) == [1.2, 1.2]
