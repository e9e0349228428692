"""Keys without effect: each key of a landing changes its result, or navsim says why it does not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

from navsim.landing import study as landing
from navsim.results.result import Result
from navsim.runner.executor import threads
from navsim.scenario.load import section
from navsim.scenario_files.keys import ITEM, NAME, KeyRow, rows
from navsim.scenario_files.source import InputError
from tests.helpers import case, in_brief

PLAIN = ("receiver.rate_hz=2", "imu.rate_hz=20", "filter.kind=eskf", "duration_s=70")
EXCEPTIONS = {
    "approach.speed_is": "without wind both speeds are the same",
    "filter.gate.max_rejected": "no fix of this flight is rejected",
    "filter.gate.probability": "no fix of this flight is rejected",
    "filter.sigma_tolerance": "one run is not judged by it",
    "method": "this test flies runs",
    "pseudolites.carrier_mhz": "the noise of its ranges is given; for exports, multipath, eirp_dbm, interference",
    "receiver.single_clock": "this sky keeps one time scale",
    "runway.length_m": "drawn, and judged by warnings of pseudolites on the pavement",
    "runway.width_m": "drawn, and judged by warnings of pseudolites on the pavement",
    "signals.gps_offset_ns": "of exports; a clock unknown for each system takes it up, as its documentation says",
}
"""Keys that change nothing in a plain landing, and why that is right without a warning."""


@cache
def flown(*assignments: str) -> tuple[Result, frozenset[str]]:
    """The result of a run, and the warnings about its input."""
    c = case(*PLAIN, *assignments)
    return landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all"), frozenset(c.warnings)


def differ(one: Result, other: Result) -> bool:
    """Whether anything but the findings differs, which have the warnings."""
    paths = [{path for path in result.variables if not path.startswith("/findings")} for result in (one, other)]
    if paths[0] != paths[1]:
        return True
    values = ((np.asarray(one[path]), np.asarray(other[path])) for path in paths[0])
    return any(a.shape != b.shape or not np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in values)


def others(row: KeyRow, value: Any) -> Iterator[Any]:
    """Other values that a key may have."""
    if row.choices:
        yield from (choice for choice in row.choices if choice != value)
    elif isinstance(value, bool):
        yield not value
    elif isinstance(value, int | float):
        yield from (other for other in (value * 0.7, value * 1.3 + 0.01, value - 1, value + 1) if other != value)
    elif value is None and "number" in row.kind:
        yield from (0.4, 2.0, 10.0, 100.0)


def plain_keys(name: str) -> Iterator[tuple[KeyRow, Any]]:
    """Keys of a section that a plain landing has, with their values."""
    whole = case(*PLAIN).scenario.model_dump(mode="json")
    for row in rows(section("landing").model_json_schema()):
        parts, value = row.key.split("."), whole
        if parts[0] != name or ITEM in parts or NAME in parts:
            continue
        for part in parts:
            value = value.get(part) if isinstance(value, dict) else None
        if not isinstance(value, dict | list):
            yield row, value


SECTIONS = [name for name in type(case().scenario).model_fields if name not in ("kind", "version", "title", "epoch")]


@pytest.mark.parametrize("name", in_brief(SECTIONS, SECTIONS.index("signals"), SECTIONS.index("receiver")))
def test_every_key_has_an_effect_or_says_why_not(name: str) -> None:
    """Seen before: `signals.tracking`, `receiver.noise_figure_db` and `filter.gaussian_sum` changed nothing in a plain
    landing, without a word."""
    plain, told = flown()
    idle = []
    for row, value in plain_keys(name):
        outcomes = []
        for other in others(row, value):
            try:
                result, warnings = flown(f"{row.key}={json.dumps(other)}")
            except InputError:
                continue  # says why
            outcomes.append(differ(plain, result) or bool(warnings - told))
            if outcomes[-1]:
                break
        if outcomes and not any(outcomes):
            idle.append(row.key)
    assert idle == [key for key in sorted(EXCEPTIONS) if key in idle]


@pytest.mark.parametrize(
    ("assignment", "needed"),
    [
        ("signals.tracking.bandwidth_hz=2", "signals.range_law=cn0"),
        ("signals.tracking.gain_horizon_db=-3", "signals.range_law=cn0"),
        ("signals.tracking.spacing_chips=0.2", "pseudolites.range_law=cn0"),
        ("signals.tracking.integration_s=0.1", "pseudolites.range_law=cn0"),
        ("signals.range_scale_deg=20", "signals.range_law=exponential"),
        ("receiver.noise_figure_db=3", "pseudolites.eirp_dbm=-30"),
        ("filter.gaussian_sum.components=9", "filter.kind=gaussian-sum"),
    ],
)
def test_a_key_is_said_to_be_idle_where_it_is(assignment: str, needed: str) -> None:
    (plain, _), (idle, warnings) = flown(), flown(assignment)
    assert any(text.startswith(f"{assignment.partition('=')[0]} is not used: it needs ") for text in warnings)
    assert not differ(plain, idle)
    (without, _), (result, told) = flown(needed), flown(needed, assignment)
    assert not any(" is not used: it needs " in text for text in told)
    assert differ(without, result)
