"""The digest of a documented command follows what the command says and does: see `tests/at_length.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import at_length

SWEEP = "navsim sweep scenarios/study.yaml --workers 2   # some seconds"


@pytest.fixture
def shipped(tmp_path: Path) -> Path:
    """A study, its base, and the table that this names; a scenario that nobody names."""
    (tmp_path / "data").mkdir()
    for name, text in {
        "study.yaml": "base: flight.yaml\nset: {duration_s: 60}\n",
        "flight.yaml": "title: a flight  # of a minute\nlog: data/log.csv\n",
        "data/log.csv": "t_s\n0\n",
        "other.yaml": "title: another\n",
    }.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def test_files_are_followed(shipped: Path) -> None:
    assert list(at_length.named(SWEEP, shipped)) == ["study.yaml", "flight.yaml", "data/log.csv"]
    assert list(at_length.named("navsim init flight", shipped)) == ["flight.yaml", "data/log.csv"]
    assert not at_length.named("navsim run my_study.yaml; navsim show results/flight.h5", shipped)
    assert "landing_open_sky.yaml" in at_length.named("\n".join(at_length.parameters("navsim init -o my.yaml")))


@pytest.mark.parametrize(
    ("file", "text", "same"),
    [
        ("study.yaml", "base: flight.yaml\nset: {duration_s: 61}\n", False),
        ("study.yaml", "# a study\nbase: flight.yaml\nset:\n  duration_s: 60\n", True),
        ("flight.yaml", "title: a flight\nlog: data/log.csv\nseed: 2\n", False),
        ("data/log.csv", "t_s\n1\n", False),
        ("other.yaml", "title: yet another\n", True),
    ],
)
def test_changed_files_change_it(shipped: Path, file: str, text: str, same: bool) -> None:
    before = at_length.digest(SWEEP, shipped)
    (shipped / file).write_text(text)
    assert (at_length.digest(SWEEP, shipped) == before) == same


@pytest.mark.parametrize(
    ("command", "same"),
    [
        ("navsim sweep scenarios/study.yaml --workers 2 # another remark", True),
        ("navsim sweep scenarios/study.yaml   --workers 2", True),
        ("navsim sweep scenarios/study.yaml --workers 3", False),
        ("navsim sweep scenarios/other.yaml --workers 2", False),
        ("navsim run scenarios/study.yaml --workers 2", False),
    ],
)
def test_another_command_has_another(shipped: Path, command: str, same: bool) -> None:
    assert (at_length.digest(command, shipped) == at_length.digest(SWEEP, shipped)) == same


@pytest.mark.parametrize(("option", "same"), [("--workers", False), ("--fresh", True)])
def test_options_given_count(shipped: Path, option: str, same: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """By their defaults, not by the words of their help."""
    before = at_length.digest(SWEEP, shipped)
    (of,) = [one for one in at_length.VERBS["sweep"].params if option in one.opts]
    monkeypatch.setattr(of, "help", "Says it in other words.")
    assert at_length.digest(SWEEP, shipped) == before
    monkeypatch.setattr(of, "default", 7)
    assert (at_length.digest(SWEEP, shipped) == before) == same


def test_the_table_keeps_what_pages_still_have(tmp_path: Path) -> None:
    table = tmp_path / "table.txt"
    kept, dropped = "navsim cite   # all", "python -c 'import navsim\nnavsim.run(1)  # one\nprint()'"
    digests = {at_length.digest(kept), at_length.digest(dropped)}
    at_length.store(digests, [kept, dropped, "navsim keys"], table)
    assert table.read_text().splitlines() == [
        f"{at_length.digest(kept)}  navsim cite",
        f"{at_length.digest(dropped)}  python -c 'import navsim navsim.run(1) print()'",
    ]
    assert at_length.stored(table) == digests
    at_length.store(digests, [kept], table)
    assert at_length.stored(table) == {at_length.digest(kept)}
