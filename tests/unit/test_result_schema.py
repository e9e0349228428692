"""The schema of results: whole, of one mind, published; and what a draft of a result refuses."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from navsim.defect import Defect
from navsim.results.builder import ResultBuilder
from navsim.results.findings import kept
from navsim.results.result import Stream
from navsim.results.schema import (
    ATC,
    COVARIANCE,
    FAMILIES,
    LANDING,
    LAYOUTS,
    LIVE,
    ONE_FLIGHT,
    REPLAY,
    SECTIONS,
    SWEEP,
    SWEEP_QUANTITIES,
    WORDS,
    Declared,
    declared,
    fields,
)
from navsim.sweeps.scenario import OUTPUTS
from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
from result_file import page

NAMED = tuple((family, ("one", "two")) for family in FAMILIES)
"""Families with members, as a study would name them."""
AS_NAMED = tuple((family, (f"<{family}>",)) for family in FAMILIES)
"""Families as the pages name them."""


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_page_of_a_layout_names_every_variable(layout: str) -> None:
    """Each as it is in a file, but for families that the study names; and the page explains these."""
    text = page(layout)
    there = set(re.findall(r"`(/[^`]+)`", "\n".join(line.split(" | ")[0] for line in text.splitlines())))
    assert there == set(declared(layout, AS_NAMED))
    assert "{" not in text
    assert layout not in ONE_FLIGHT or "| `run, " not in text
    for name in FAMILIES:
        assert (f"<{name}>" in text) == (f"| `<{name}>` |" in text), name


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_dimension_has_a_coordinate(layout: str) -> None:
    """Declared, and in the file whenever the variable is: of a stricter condition only by mistake."""
    due = declared(layout, NAMED)
    for path, one in due.items():
        for dim, coordinate in zip(one.dims, one.coordinates, strict=True):
            if dim == "{of_axis}":
                continue  # one of the dimensions that the study names
            assert coordinate, (path, dim)
            of_coordinate = due[coordinate].when  # a stricter condition begins with the words of the weaker
            assert one.when.startswith(of_coordinate) or of_coordinate == "unless `--keep none`", path


def test_what_stands_in_braces_is_explained() -> None:
    for entry in (entry for section in SECTIONS for entry in section.entries):
        assert set(fields(entry.path)) <= {*entry.each, *FAMILIES}, entry.path
        known = {*fields(entry.path), *(name.upper() for name in fields(entry.path)), *WORDS}
        assert set(fields(" ".join((entry.units, entry.meaning, *entry.dims)))) <= known, entry.path
        assert set(entry.each) <= set(fields(entry.path)), entry.path
        assert set(entry.layouts) <= set(LAYOUTS), entry.path


def test_one_path_is_one_quantity_in_all_flights() -> None:
    """The same dimensions (but for runs, of which a single flight has none), unit, type, attributes."""
    seen: dict[str, tuple[str, Declared]] = {}
    for layout in (LANDING, COVARIANCE, REPLAY, LIVE):
        for path, one in declared(layout, NAMED).items():
            first, other = seen.setdefault(path, (layout, one))
            there = [tuple(dim for dim in each.dims if dim != "run") for each in (one, other)]
            assert there[0] == there[1], (path, layout, first)
            assert (one.units, one.of) == (other.units, other.of), (path, layout, first)
            expected = path.startswith("/summary/consistency/")  # in an analysis, without a band of chance
            assert set(one.attributes) == set(other.attributes) or expected, (path, layout, first)


def test_every_output_of_a_sweep_is_declared() -> None:
    assert tuple(SWEEP_QUANTITIES) == OUTPUTS


def test_data_get_what_is_declared() -> None:
    draft = ResultBuilder(LANDING, {"mixed": "m, m/s"}, sensor=("altimeter",))
    draft["/run"] = np.arange(2)
    draft["/filter/time"] = np.arange(3.0)
    draft.put("/filter/state", ["north", "east"], {"state_units": "m, m/s"})
    draft["/filter/error"] = Stream((2, 3, 2), np.dtype(float), lambda: iter([np.zeros((2, 3, 2))]))
    error = draft.variables["/filter/error"]
    assert (error.dims, error.units) == (("run", "time", "state"), "m, m/s")
    assert error.long_name == "truth minus estimate, after the update"
    assert draft.variables["/filter/state"].attributes == {"state_units": "m, m/s"}
    assert list(draft["/interval"]) == ["value", "low", "high"]
    draft["/aiding/altimeter/time"] = np.arange(5.0)
    draft["/summary/dop/pdop"] = np.zeros(5)
    assert draft.variables["/summary/dop/pdop"].long_name == "PDOP over the fix epochs of the glide"


def test_what_a_draft_refuses() -> None:
    draft = ResultBuilder(LANDING, sensor=("altimeter",))
    draft["/filter/time"] = np.arange(3.0)
    for path, data, attributes, said in (
        ("/filter/tiem", np.zeros(3), {}, "not declared for results of layout landing"),
        ("/filter/attitude_rpy", np.zeros((3, 3)), {}, "not declared"),
        ("/aiding/baro/time", np.zeros(3), {}, "not declared"),
        ("/truth/time", np.zeros((3, 1)), {}, "2 dimensions where time are declared"),
        ("/filter/fix_status", np.zeros((1, 3)), {}, "float64 where whole number is declared"),
        ("/filter/epoch", np.arange(3), {}, "int64 where number is declared"),
        ("/truth/event", np.zeros(2), {}, "float64 where text is declared"),
        ("/filter/nees", np.zeros((1, 4)), {"degrees_of_freedom": 15}, "4 values along time, which has 3"),
        ("/filter/nees", np.zeros((1, 3)), {}, re.escape("attributes [] where ['degrees_of_freedom'] are declared")),
        ("/filter/error", np.zeros((1, 3, 2)), {}, "no word for mixed"),
        ("/summary/rms/horizontal", np.zeros(2), {}, "2 values along interval, which has 3"),
    ):
        with pytest.raises(Defect, match=said):
            draft.put(path, data, attributes)
    with pytest.raises(Defect, match=r"a result of layout landing without .*/truth/time"):
        draft.result({})
    with pytest.raises(Defect, match="no word for unit"):
        ResultBuilder(LANDING, {"mixed": "m"}, sensor=("altimeter",)).put(
            "/aiding/altimeter/measured", np.zeros((1, 3, 1))
        )


def test_a_coordinate_that_is_lacking_is_missed() -> None:
    """Though it is there on a condition: data along a dimension that nothing describes cannot be stored."""
    draft = ResultBuilder(SWEEP, dimension=("s_m",), varied=("s_m",))
    draft["/sweep/pdop"] = np.zeros(4)
    with pytest.raises(Defect, match=r"without .*/s_m"):
        draft.result({})


def test_a_case_may_be_named_twice() -> None:
    """As a scenario with the same further case twice does; the later data stand."""
    draft = ResultBuilder(ATC, case=("T4_angles", "T4_angles"))
    for end in (1.0, 2.0):
        draft["/cases/T4_angles/time"] = np.linspace(0.0, end, 3)
    assert draft["/cases/T4_angles/time"][-1] == 2.0


def test_findings_come_last() -> None:
    assert set(kept([])) == {path for path in declared(REPLAY) if path.startswith("/findings/")}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_scalar_has_the_name_of_a_dimension_above(layout: str) -> None:
    """netCDF takes a dimension from the group, or one above: a scalar with its name cannot be opened."""
    entries = [entry for section in SECTIONS for entry in section.entries if layout in entry.layouts]
    dims = {(entry.path.rsplit("/", 1)[0], dim) for entry in entries for dim in entry.dims
            if entry.path.rsplit("/", 1)[-1] == dim}  # fmt: skip
    for entry in entries:
        group, name = entry.path.rsplit("/", 1)
        above = [part for part, dim in dims if dim == name and group.startswith(part) and group != part]
        assert entry.dims or not above, (entry.path, above)
