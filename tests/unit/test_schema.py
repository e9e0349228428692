"""The published schema says what is accepted: files as they are written and as they are resolved, scalars for lists."""

from __future__ import annotations

import copy
import functools
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from navsim.scenario.load import read_any, section
from navsim.scenario_files import shipped
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import Document, InputError, load


@functools.cache
def published(kind: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(section(kind).model_json_schema())


@pytest.mark.parametrize("name", shipped.names())
def test_shipped_files_obey_it(name: str) -> None:
    """As written and as resolved."""
    scenario, _ = read_any(shipped.path(name))
    data = scenario.model_dump(mode="json", exclude_none=True)
    for form in (load(shipped.path(name)).data, data):
        published(data["kind"]).validate(form)


ONE_OR_MORE = [
    ("recorded_flight", ("outages", 0, "start_s"), 60.0),
    ("recorded_flight", ("outages", 0, "duration_s"), 10.0),
    ("landing", ("sky", "almanac"), "a.alm"),
    ("landing", ("sky", "almanac_sha256"), "0" * 64),
]


@pytest.mark.parametrize(("name", "path", "value"), ONE_OR_MORE, ids=[".".join(map(str, c[1])) for c in ONE_OR_MORE])
def test_one_value_may_stand_for_a_list_of_it(name: str, path: tuple[Any, ...], value: Any, tmp_path: Path) -> None:
    """The schema and the reader agree on one, on several and on what is none; one is written as one."""
    scenario, _ = read_any(shipped.path(name))
    data = scenario.model_dump(mode="json", exclude_none=True)
    if "sky" in path:
        data["sky"] |= {"source": "almanac", "almanac": "a.alm"}
    kind = data["kind"]

    def with_it(given: Any) -> dict[str, Any]:
        changed = copy.deepcopy(data)
        target: Any = changed
        for part in path[:-1]:
            target = target[part]
        target[path[-1]] = given
        return changed

    for given in (value, [value]):
        published(kind).validate(with_it(given))
        read = validated(section(kind), Document("s.yaml", tmp_path, with_it(given)))
        assert read.model_dump(mode="json", exclude_none=True) == with_it(value)
    for wrong in (True, {"a": value}, [[value]]):
        assert not published(kind).is_valid(with_it(wrong))
        with pytest.raises(InputError):
            validated(section(kind), Document("s.yaml", tmp_path, with_it(wrong)))
