"""Keys as rows, read from the schemas: every key a file may have is there, with what the models say of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest

from navsim.formats.units import unit_of
from navsim.kinds import OF_FILES
from navsim.scenario.load import read_any, section
from navsim.scenario_files import shipped
from navsim.scenario_files.keys import ITEM, NAME, KeyRow, matching, nearest, rows


@cache
def of(kind: str) -> list[KeyRow]:
    return rows(section(kind).model_json_schema())


def written(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every key of a file, dotted, with the mark of an item for its number."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield (*path, key)
            yield from written(value, (*path, key))
    elif isinstance(node, list):
        for value in node:
            yield from written(value, (*path, ITEM))


FREE = {"sweep": ("set", "vary.N.values"), "optimize": ("set",)}
"""Where a study has values of another file."""


@pytest.mark.parametrize("name", shipped.names())
def test_every_key_of_the_resolved_templates_has_a_row(name: str) -> None:
    scenario, document = read_any(shipped.path(name))
    kind = document.data["kind"]
    known = {row.key for row in of(kind)}
    patterns = [key.split(".") for key in known if NAME in key.split(".")]
    for path in written(scenario.model_dump(mode="json")):
        key = ".".join(path)
        named = any(len(p) == len(path) and all(a in (b, NAME) for a, b in zip(p, path, strict=True)) for p in patterns)
        assert key in known or named or key.startswith(FREE.get(kind, ("!",))), key


def test_rows_say_what_the_models_say() -> None:
    by_key = {row.key: row for row in of("landing")}
    assert by_key["duration_s"].range == "above 0 to 1000000"
    assert (by_key["duration_s"].unit, by_key["duration_s"].default) == ("s", 120.0)
    assert by_key["epoch"].required
    assert not by_key["duration_s"].required
    assert "eskf" in by_key["filter.kind"].choices
    assert by_key["approach.flare_height_m"].when == ("approach.profile: smooth, waypoints",)
    assert by_key["approach.profile"].choices == ("paper", "smooth", "pad", "s-turn", "waypoints", "recorded", "track")
    assert by_key["approach.profile"].when == ()
    assert by_key["imu.gyro.drift_fixed_deg_h"].kind == "list of 3 or null"
    assert by_key["integrity.p_constellations.NAME"].range == "0 to 0.1"
    assert {row.when for row in of("landing") if row.key == "requirements.N.of"} == {
        ("requirements.N.what: error",), ("requirements.N.what: rms",), ("requirements.N.what: level",),
    }  # fmt: skip


@pytest.mark.parametrize("kind", OF_FILES)
def test_a_section_stands_before_its_keys(kind: str) -> None:
    seen: set[str] = set()
    for row in of(kind):
        seen.add(row.key)
        above = [part for part in row.key.split(".")[:-1] if part not in (ITEM, NAME)]
        assert not above or any(key.split(".")[-1] == above[-1] for key in seen), row.key
        assert row.kind


def test_units_are_those_of_the_names() -> None:
    assert unit_of("imu.gyro.arw_deg_sqrt_h") == "°/√h"
    assert unit_of("imu.accelerometer.vrw_m_s_sqrt_h") == "m/s/√h"
    assert unit_of("a.wind.from_deg") == "°"
    assert unit_of("pseudolites.multipath.conductivity_s_m") == "S/m"
    assert unit_of("signals.lock.lose_db_hz") == "dB-Hz"
    assert unit_of("pseudolites.survey_error_m.1") == "m"
    for bare in ("initial_errors", "title", "p_fa_h", "further_cases", "p_constellations"):
        assert unit_of(bare) == "", bare


def test_words_find_keys_and_misspelt_ones_their_nearest() -> None:
    every = of("landing")
    assert "wind.from_deg" in {row.key for row in matching(every, "WIND")}
    assert matching(every, "no such word") == []
    assert "approach.glide_slope_deg" in nearest(every, "glide_slop_deg")
    assert nearest(every, "qqqqqq") == []
