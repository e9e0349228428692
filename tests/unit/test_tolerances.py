"""Tolerances of oracle tests: their units are those that the tests compute in."""

from __future__ import annotations

import pytest

from tests.conftest import UNITS, Within


@pytest.mark.parametrize("unit", UNITS)
def test_units_that_tests_compute_in_are_taken_as_they_are(unit: str) -> None:
    assert Within({"place": f"2e-3 {unit}"})["place"] == 2e-3


@pytest.mark.parametrize(("text", "value"), [("2", 2.0), ("2 %", 0.02), ("2 (relative)", 2.0)])
def test_shares_are_numbers(text: str, value: float) -> None:
    assert Within({"place": text})["place"] == value


@pytest.mark.parametrize("text", ["1 mm", "1 km", "1 mrad", "1 arcsec", "1 ms", "1 ft", "1 M", "1  m", "1 m "])
def test_units_that_no_test_computes_in_are_refused(text: str) -> None:
    """1 mm taken as 1 m would be a test that cannot fail."""
    with pytest.raises(pytest.UsageError, match=r"place='1 .*': unknown unit .* give it in one of m, m2"):
        Within({"place": text})
