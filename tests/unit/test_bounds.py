"""Every number of every section has both ends, wherever it stands; no boolean passes for one."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from navsim.kinds import OF_FILES
from navsim.replays.scenario import Gnss
from navsim.replays.tuning import SEARCHED
from navsim.scenario.filter import FilterSection
from navsim.scenario.load import read_any, section
from navsim.scenario.signals import ReceiverSection
from navsim.scenario_files import shipped
from navsim.scenario_files.base import FIX_LATENCIES, Section, validated
from navsim.scenario_files.source import Document, InputError

FREE = ("set", "values")
"""Keys whose values are those of another file, which has the bounds."""


def unbounded(node: Any, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Places of a JSON schema with a number that lacks an end."""
    if isinstance(node, dict):
        if node.get("type") in ("number", "integer") and not {"const", "enum"} & node.keys():
            low, high = {"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}
            if not low & node.keys() or not high & node.keys():
                yield ".".join(path)
        for key, value in node.items():
            yield from unbounded(value, (*path, key))
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from unbounded(value, (*path, str(i)))


@pytest.mark.parametrize("kind", OF_FILES)
def test_every_number_has_both_ends(kind: str) -> None:
    assert list(unbounded(section(kind).model_json_schema())) == []


def test_the_walk_finds_what_it_is_for() -> None:
    """In lists, unions and values that may be left out."""

    class Inner(Section):
        x: float | str = 0.0

    class Outer(Section):
        inner: tuple[Inner, ...] = ()
        y: int | None = None
        z: tuple[float, ...] = ()

    assert len(list(unbounded(Outer.model_json_schema()))) == 3


def leaves(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, (list, tuple)) else ()
    for key, value in items:
        if key not in FREE:
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                yield (*path, key)
            yield from leaves(value, (*path, key))


TRIED: set[tuple[type, tuple[str, ...]]] = set()
"""Keys of scenarios whose numbers were tried: a key that several have is tried in the first of them."""


@pytest.mark.parametrize("name", shipped.names())
def test_no_boolean_and_no_absurd_number_is_accepted(name: str, tmp_path: Path) -> None:
    """In place of each number of the resolved scenario, `pseudolites.count` and `version` among them."""
    scenario, _ = read_any(shipped.path(name))
    data = scenario.model_dump(mode="json", exclude_none=True)
    found = list(leaves(data))
    assert ("version",) in found
    for path in found:
        key = type(scenario), tuple(part for part in path if isinstance(part, str))
        if key in TRIED:
            continue
        TRIED.add(key)
        for wrong in (False, True, 1e300, -1e300, 5e-324 if path[-1] == "version" else 10**30):
            changed = copy.deepcopy(data)
            target = changed
            for part in path[:-1]:
                target = target[part]
            target[path[-1]] = wrong
            with pytest.raises(InputError):
                validated(type(scenario), Document("s.yaml", tmp_path, changed))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_whole_numbers_to_choose_from_are_still_numbers(count: int, tmp_path: Path) -> None:
    scenario, _ = read_any(shipped.path("landing"), [f"pseudolites.count={count}"])
    assert scenario.model_dump()["pseudolites"]["count"] == count


def test_every_latency_of_a_simulated_fix_can_be_that_of_a_recorded_one() -> None:
    """A simulated run is exported as a recording: one pair of bounds, within which the tuning searches."""
    for simulated in (ReceiverSection, FilterSection):
        assert simulated.model_validate({"latency_s": FIX_LATENCIES[1]}).latency_s == FIX_LATENCIES[1]
    for latency in FIX_LATENCIES:
        assert Gnss.model_validate({"file": "fixes.csv", "latency_s": latency}).latency_s == latency
    for one, of_file in ((ReceiverSection, {}), (FilterSection, {}), (Gnss, {"file": "fixes.csv"})):
        with pytest.raises(ValidationError, match="latency_s"):
            one.model_validate(of_file | {"latency_s": FIX_LATENCIES[1] + 0.01})
    assert FIX_LATENCIES[0] <= SEARCHED[0] < SEARCHED[1] <= FIX_LATENCIES[1]
