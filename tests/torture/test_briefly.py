"""The trials of this folder, few of each; `make torture` takes ten seeds and thousands."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.forks import Forks, shared
from tests.torture import trials

QUICK = ("ensemble", "landing", "sweep", "replay", "elevation")
"""Studies that take about a second."""


@pytest.fixture(scope="module")
def commands() -> Forks:
    shared().prepare(trials.warming(QUICK))
    return shared()


@pytest.fixture(scope="module")
def scenarios(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trials.scenario_folder(tmp_path_factory.mktemp("mutants") / "at")


def test_mutants_are_refused_in_words_or_are_in_order(commands: Forks, scenarios: Path) -> None:
    """Which mutants a seed gives depends on the shipped files; about one of six is accepted."""
    tally = trials.mutated(commands, scenarios, 101, 6, each=2)
    assert tally.wrong == []
    assert min(tally.ended["accepted"], tally.ended["refused"]) >= 2


def test_mutants_are_computed_in_time(commands: Forks, scenarios: Path) -> None:
    tally = trials.computed(commands, scenarios, 102, 2)
    assert tally.wrong == []
    assert tally.ended["computed"] > 0


def test_killed_anywhere_and_resumed(commands: Forks, tmp_path: Path) -> None:
    assert trials.killed(commands, tmp_path, 103, 1, QUICK).wrong == []


@pytest.mark.parametrize("most", [3, pytest.param(1000, marks=pytest.mark.long)])
def test_full_disk_at_steps_of_a_study(most: int, commands: Forks, tmp_path: Path) -> None:
    """At each step, or at some. `test_ensemble` fills the disk of partial work."""
    whole = trials.filled(commands, tmp_path, 104, most, ("landing",))
    assert whole.wrong == []
    assert whole.count >= 3


def test_flipped_bytes_change_no_number(commands: Forks, tmp_path: Path) -> None:
    tally = trials.damaged(commands, tmp_path, 105, 8)
    assert tally.wrong == []
    assert tally.ended["refused"] > 2
