"""Where several combinations of a sweep are as good as each other, none of them is named for no reason."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.report.table import Table
from navsim.results.result import Result, Variable
from navsim.sweeps.report import best_plain, indifferent, tables


def swept(cube: np.ndarray) -> Result:
    """A sweep over speeds and lengths by one output."""
    names = ("speed", "length")[: cube.ndim]
    variables = {"/sweep/hdop": Variable(names, cube, "1", "HDOP")}
    for name, size in zip(names, cube.shape, strict=True):
        numbers = 10.0 * np.arange(size)
        variables[f"/{name}"] = Variable((name,), numbers, "m", name)
        variables[f"/sweep/axes/{name}"] = Variable((name,), numbers, "m", name)
    attributes = {"kind": "sweep", "method": "dop", "combinations": cube.size, "refused": 0}
    return Result(attributes, variables)


def said(cube: np.ndarray) -> tuple[list[str], str]:
    (found,) = tables(swept(cube))
    assert isinstance(found, Table)
    return found.rows[0].texts()[4:], found.notes


def test_one_best_is_named() -> None:
    cube = np.array([[3.0, 2.0, 4.0], [5.0, 1.0, 6.0], [7.0, 8.0, 9.0]])
    assert said(cube) == (["10", "10"], "")
    cube[0, 2] = 0.5
    places, notes = said(cube)
    assert places == ["0 *", "20 *"]
    assert "the best may lie beyond" in notes


def test_what_does_not_matter_is_any() -> None:
    """All of an axis is as good; with what rounding leaves, too."""
    cube = np.array([[3.0, 2.0, 4.0]] * 3) * (1.0 + 1e-14 * np.arange(3)[:, None])
    assert said(cube) == (["any", "10"], "")
    assert said(np.full((2, 3), 1.5)) == (["any", "any"], "")
    plain = best_plain(swept(cube))["hdop"]
    assert isinstance(plain, dict)
    assert plain["alike"] == 3
    assert plain["at_end_of_range"] == []


def test_several_that_are_no_whole_axis_are_counted() -> None:
    cube = np.array([[1.0, 2.0], [2.0, 1.0]])
    places, notes = said(cube)
    assert places == ["0", "0"]
    assert notes == "HDOP: 2 combinations are equally good; this is the first one"


@pytest.mark.parametrize(
    ("tied", "free"),
    [
        ([[1, 0], [0, 0]], (False, False)),
        ([[1, 1], [0, 0]], (False, True)),
        ([[1, 1], [1, 1]], (True, True)),
        ([[1, 0], [0, 1]], None),
        ([[1, 1, 0], [0, 0, 0]], None),
        ([[1, 1, 1], [1, 0, 0]], None),
        ([[1]], (False, False)),
    ],
)
def test_axes_that_do_not_matter(tied: list[list[int]], free: tuple[bool, ...] | None) -> None:
    assert indifferent(np.array(tied, bool)) == free
