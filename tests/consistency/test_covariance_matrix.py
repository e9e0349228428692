"""The covariance analysis against runs where settings meet: every level of every factor once; all pairs of levels are
flown by `make validate` (scripts/covariance_matrix.py, docs/covariance-matrix.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import SHARED
from tests.helpers import case, in_brief, load_script

SHORT = ("duration_s=62", "imu.rate_hz=25")
"""Up to touchdown, with fewer samples: the errors of integration are in both."""


matrix: Any = load_script("covariance_matrix")


def each_level_once() -> list[tuple[str, ...]]:
    """Combinations in which every level of every factor stands, the factors out of step."""
    names = [list(levels) for levels in matrix.FACTORS.values()]
    return [
        tuple(levels[(i + place) % len(levels)] for place, levels in enumerate(names))
        for i in range(max(map(len, names)))
    ]


def test_every_level_is_flown_and_all_pairs_by_the_script() -> None:
    cells = each_level_once()
    for place, levels in enumerate(matrix.FACTORS.values()):
        assert {cell[place] for cell in cells} == set(levels)
    every = matrix.covering()
    for a, first in enumerate(matrix.FACTORS.values()):
        for b, second in enumerate(matrix.FACTORS.values()):
            if a < b:
                assert len({(cell[a], cell[b]) for cell in every}) == len(first) * len(second)


@pytest.mark.parametrize("cell", in_brief(each_level_once(), 0, 6, whole=True), ids=", ".join)
def test_a_thousand_runs_agree(cell: tuple[str, ...]) -> None:
    """Every component of position and velocity every 10 s within 1 +- 0.11, where the script takes 2000 and 0.08."""
    settings = matrix.settings(cell)
    if str(SHARED) in " ".join(settings) and not Path(SHARED).is_dir():
        pytest.skip("needs the files of satellites in ../shared, which is not here")
    ratio = matrix.ratios(case(*matrix.GENTLE, *SHORT, *settings), 1000)
    assert ratio.shape == (6, 6)
    assert np.all(np.abs(ratio - 1.0) < matrix.WITHIN * np.sqrt(2.0)), ratio
