"""The script that gates moves and renames notices a changed bit and a path that no table maps."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from navsim.runner.opening import checked
from tests.conftest import SCENARIOS
from tests.helpers import load_script

same_results = load_script("same_results")

_FLOWN = [name for name, line in same_results.CASES.items() if line.startswith("run ")]


def made(file: Path, value: float = 1.0, path: str = "/front/merit", created: str = "today") -> Path:
    with h5py.File(file, "w") as result:
        result[path] = np.array([value, np.nan])
        result[path].attrs["unit"] = "m"
        result.attrs["created"] = created
    return file


def test_a_changed_last_bit_is_found(tmp_path: Path) -> None:
    a, same = made(tmp_path / "a.h5"), made(tmp_path / "same.h5", created="tomorrow")
    assert same_results.differences(a, same, {}) == []
    b = made(tmp_path / "b.h5", np.nextafter(1.0, 2.0))
    assert same_results.differences(a, b, {}) == ["/front/merit: differs"]


def test_an_unmapped_path_is_found(tmp_path: Path) -> None:
    a, b = made(tmp_path / "a.h5"), made(tmp_path / "b.h5", path="/pareto/merit")
    assert same_results.differences(a, b, {"/front": "/pareto"}) == []
    assert "/pareto/merit@unit: only in B" in same_results.differences(a, b, {})


def test_the_longest_entry_of_the_table_counts() -> None:
    table = {"/front": "/pareto", "/front/merit": "/pareto/penalised"}
    found = [same_results.renamed(path, table) for path in ("/front/merit@unit", "/front/load", "/frontal")]
    assert found == ["/pareto/penalised@unit", "/pareto/load", "/frontal"]


@pytest.mark.parametrize(
    ("b", "found"), [("same", []), ("other", ["chi2.txt: differs"]), (None, ["chi2.txt: only in A"])]
)
def test_printed_tables_are_compared(b: str | None, found: list[str], tmp_path: Path) -> None:
    for side, text in (("a", "same"), ("b", b)):
        (tmp_path / side).mkdir()
        if text:
            (tmp_path / side / "chi2.txt").write_text(text)
    assert same_results.compare(tmp_path / "a", tmp_path / "b", ["chi2"]) == found


@pytest.mark.parametrize("name", _FLOWN)
def test_the_input_of_each_landing_is_valid(name: str) -> None:
    """A case that exits with an error in both checkouts compares nothing."""
    words = next(same_results.commands(name))
    settings = [words[i + 1] for i, word in enumerate(words) if word == "--set"]
    checked(SCENARIOS.parent / words[1], settings)


def test_both_landings_by_beacons_are_compared() -> None:
    assert {"beacons_pad", "beacons_uav"} <= same_results.CASES.keys()
