"""Values and combinations of a sweep are counted before they are made."""

from __future__ import annotations

from pathlib import Path

import pytest

from navsim.scenario.load import read_any
from navsim.scenario_files.source import InputError
from navsim.sweeps.plan import axes
from navsim.sweeps.scenario import MOST_COMBINATIONS, Sweep

HEAD = "kind: sweep\nversion: 1\nbase: nowhere.yaml\n"


def swept(place: Path, text: str) -> Sweep:
    file = place / "study.yaml"
    file.write_text(HEAD + text)
    study, _ = read_any(file)
    assert isinstance(study, Sweep)
    return study


def grid(name: str, count: int) -> str:
    return f"{{key: {name}, grid: {{first: 0, last: 1, count: {count}}}}}"


MANY = [
    ("{first: 0, last: 1.0e+12, step: 1}", "step: gives 1e+12 values; at most 100000 are allowed on an axis"),
    ("{first: 0, last: 100000, step: 1}", "step: gives 100000 values; at most 100000 are allowed"),
    ("{first: -1.0e+12, last: 1.0e+12, step: 1.0e-12}", "step: gives 2e+24 values; at most 100000 are allowed"),
    ("{first: 0, last: 1.0e+13, step: 1}", "last: must be at most 1000000000000"),
]


@pytest.mark.parametrize(("text", "expected"), MANY)
def test_range_of_too_many_values_is_refused_at_its_line(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as refused:
        swept(tmp_path, f"vary:\n  - {{key: a.b, range: {text}}}\n")
    (problem,) = refused.value.problems
    assert f"vary.0.range.{expected}" in str(problem)
    assert problem.place.line == 5
    assert problem.place.column > 1


def test_combinations_are_counted_as_whole_numbers(tmp_path: Path) -> None:
    four = ", ".join(grid(f"a.b{i}", 100_000) for i in range(4))
    with pytest.raises(InputError) as refused:
        swept(tmp_path, f"vary: [{four}]\n")
    said = str(refused.value)
    assert "study.yaml:4:1: vary: 1e+20 combinations (100000 x 100000 x 100000 x 100000)" in said
    assert f"at most {MOST_COMBINATIONS} are allowed" in said
    study = swept(tmp_path, f"vary: [{grid('a.b', 10_000)}, {grid('a.c', 10_000)}]\n")
    assert study.combinations == MOST_COMBINATIONS
    with pytest.raises(InputError, match="32 axes; at most 31 are allowed"):
        swept(tmp_path, f"vary: [{', '.join(grid(f'a.b{i}', 2) for i in range(32))}]\n")


def test_shape_is_that_of_the_axes(tmp_path: Path) -> None:
    study = swept(
        tmp_path,
        "samples: 7\nvary:\n  - {key: a.a, lhs: {first: 0, last: 1}}\n  - {key: a.b, values: [1, x, true]}\n"
        "  - {key: a.c, lhs: {first: 2, last: 3}}\n  - {keys: [b.a, b.b], values: [[1, 2], [3, 4]]}\n"
        f"  - {grid('a.d', 5)}\n  - {{key: a.e, range: {{first: 0, last: 0.3, step: 0.1}}}}\n",
    )
    assert study.shape == tuple(len(axis.points) for axis in axes(study, 1)) == (7, 3, 2, 5, 4)
    assert study.combinations == 840
