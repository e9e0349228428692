"""A scenario's text with values changed keeps what people wrote around them."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from navsim.scenario_files.rewrite import rewritten
from navsim.scenario_files.source import parse
from tests.conftest import SCENARIOS

LANDING = (SCENARIOS / "landing.yaml").read_text(encoding="utf-8")
SITES = """\
kind: landing   # the kind
pseudolites:
  range_sigma_m: 2.2   # metres
  # where they stand
  sites:
    - {name: A, s_m: 100, l1_m: 200}   # the first
    - name: B                          # the second
      s_m: -100
      l1_m: 300
    - {lat_deg: 56.0, lon_deg: 37.0}
# the end
title: x
"""


def data(text: str) -> Any:
    return parse(text, "x.yaml", Path()).data


def changed_lines(before: str, after: str) -> tuple[set[str], set[str]]:
    old, new = before.splitlines(), after.splitlines()
    return set(old) - set(new), set(new) - set(old)


def test_nothing_changed_is_the_same_text() -> None:
    assert rewritten(LANDING, data(LANDING)).text == LANDING


def test_a_value_is_changed_where_it_stands() -> None:
    after = data(LANDING)
    after["epoch"] = "2018-09-13T06:30:00Z"
    found = rewritten(LANDING, after)
    assert not found.lost
    assert changed_lines(LANDING, found.text) == (
        {"epoch: 2018-09-13T12:00:00Z     # UTC of time 0"}, {"epoch: 2018-09-13T06:30:00Z     # UTC of time 0"},
    )  # fmt: skip


def test_keys_come_and_go() -> None:
    after = data(LANDING)
    for key in ("count", "s_m", "l1_m"):
        del after["pseudolites"][key]
    after["pseudolites"] |= {"frame": "runway", "sites": [{"s_m": 1.5, "l1_m": -2.0}, {"s_m": 3.0, "l1_m": 4.0}]}
    found = rewritten(LANDING, after)
    assert not found.lost
    assert data(found.text) == after
    gone, come = changed_lines(LANDING, found.text)
    assert {line.split(":")[0].strip() for line in gone} == {"count", "s_m", "l1_m", "frame"}
    (frame,) = (line for line in gone if "frame" in line)
    assert come == {
        "  sites:", "    - {s_m: 1.5, l1_m: -2.0}", "    - {s_m: 3.0, l1_m: 4.0}",
        frame.replace("frame: table1", "frame: runway"),
    }  # fmt: skip


@pytest.mark.parametrize("gone", [0, 1, 2])
def test_an_item_goes_with_its_lines(gone: int) -> None:
    after = data(SITES)
    del after["pseudolites"]["sites"][gone]
    found = rewritten(SITES, after)
    assert not found.lost
    assert data(found.text) == after
    assert ("# the first" in found.text, "# the second" in found.text) == (gone != 0, gone != 1)
    assert "# where they stand" in found.text
    assert changed_lines(SITES, found.text)[1] == set()


def test_an_item_is_changed_and_one_more_comes() -> None:
    after = data(SITES)
    after["pseudolites"]["sites"][1]["l1_m"] = 301.25
    after["pseudolites"]["sites"].append({"s_m": 5.0, "l1_m": 6.0})
    found = rewritten(SITES, after)
    assert not found.lost
    assert changed_lines(SITES, found.text) == (
        {"      l1_m: 300"}, {"      l1_m: 301.25", "    - {s_m: 5.0, l1_m: 6.0}"},
    )  # fmt: skip


HARD = {
    "anchors": "kind: landing # k\na: &x {s_m: 1, l1_m: 2}\nb: *x\n",
    "flow": "{kind: landing, pseudolites: {count: 1, s_m: 2, l1_m: 3}}\n",
    "flow within": "kind: landing # k\npseudolites: {count: 1, s_m: 2, l1_m: 3} # p\n",
    "no end of line": "kind: landing\npseudolites:\n  count: 1",
    "windows": "kind: landing\r\npseudolites:\r\n  count: 1 # p\r\n  s_m: 2\r\n",
    "empty value": "kind: landing\npseudolites:\ntitle: x # t\n",
    "text": "kind: landing\ntitle: |\n  several\n  lines\npseudolites:\n  count: 1\n",
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("change", ["sites", "title", "a", "gone"])
def test_whatever_the_text_it_says_what_it_is_meant_to(name: str, change: str) -> None:
    text = HARD[name]
    after = copy.deepcopy(data(text))
    if change == "sites":
        after["pseudolites"] = {"frame": "runway", "sites": [{"s_m": 1.0, "l1_m": 2.0}]}
    elif change == "title":
        after["title"] = "yes: <b>, # 'no'"
    elif change == "a":
        after["a"] = {"s_m": 7, "l1_m": 2}
    else:
        after.pop("pseudolites", None)
        after.pop("b", None)
    found = rewritten(text, after)
    assert data(found.text) == after
    assert found.lost or "# k" not in text or "# k" in found.text
