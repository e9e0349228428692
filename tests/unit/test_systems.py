"""The table of satellite systems is the only place that knows them, and every constellation answers all it is asked."""

from __future__ import annotations

import ast
import functools
import re
from collections import Counter
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from navsim.gnss import timescales
from navsim.gnss.constellations import glonass_integration
from navsim.gnss.constellations.constellation import CachedConstellation, Constellation, carriers
from navsim.gnss.constellations.nominal import design
from navsim.gnss.constellations.systems import (
    BEIDOU,
    BY_LETTER,
    CLOCKS,
    GLONASS,
    GPS,
    LETTERS,
    NAMES,
    QZSS,
    SYSTEMS,
    System,
)
from navsim.gnss.dop import MAX_CLOCKS
from navsim.scenario import sky

PACKAGE = Path(__file__).resolve().parents[2] / "navsim"
UTC = timescales.posix(2018, 9, 13, 12)
LETTER = re.compile(r"[RGECJ](\d\d)?")
OTHER_MEANINGS = {
    ("formats/conventions.py", "SE"): "south, east",
    ("logs/ardupilot.py", "C"): "number of an estimator",
    ("formats/nmea.py", "E"): "east, estimated",
    ("formats/rinex_write.py", "E"): "exponents",
    ("formats/sp3.py", "E"): "a clock event",
    ("formats/text.py", "E"): "exponents",
    ("report/sky.py", "E"): "east",
    ("gnss/ground_accuracy.py", "C"): "a ground accuracy designator",
    ("published_tables/integrity_table_report.py", "G"): "the ground may be lost",
    ("replays/scenario.py", "SE"): "south, east",
    ("recording_checks/sensor_checks.py", "R"): "right",
    ("runner/checkpoint.py", "C"): "order of an array",
    ("scenario/integrity.py", "C"): "a GBAS approach service type",
    ("scenario/signals.py", "C"): "a ground accuracy designator",
}
"""Where a literal like a system's letter is none."""


@functools.cache
def walked(tree: ast.AST) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(tree))


@functools.cache
def texts(tree: ast.AST) -> list[str]:
    """All literals, those of f-strings by their parts, but for docstrings."""
    said = {
        id(node.value) for node in walked(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    return [
        node.value
        for node in walked(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said
    ]


def letters(tree: ast.AST) -> set[str]:
    """Literals that are a system's letter, or a satellite's name, or several letters to choose from."""
    return {
        text
        for text in texts(tree)
        if LETTER.fullmatch(text) or (len(text) > 1 and set(text) <= set(LETTERS) and len(set(text)) == len(text))
    }


def questions(tree: ast.AST, classes: set[str]) -> list[str]:
    """Calls that ask what kind of constellation something is."""
    found = []
    for node in walked(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id not in ("isinstance", "issubclass", "hasattr", "getattr", "type"):
                continue
            inner = [part for argument in node.args for part in ast.walk(argument)]
            named = {n.id for n in inner if isinstance(n, ast.Name)} | {
                n.attr for n in inner if isinstance(n, ast.Attribute)
            }
            if any("constellation" in name.lower() or name in classes for name in named):
                found.append(ast.unparse(node))
    return found


@functools.cache
def modules() -> dict[str, ast.Module]:
    return {str(path.relative_to(PACKAGE)): ast.parse(path.read_text()) for path in sorted(PACKAGE.glob("**/*.py"))}


def members() -> set[str]:
    """What the protocol asks for."""
    return {name for name in vars(Constellation) if not name.startswith("_")}


@functools.cache
def implementing() -> dict[str, list[str]]:
    """Classes of the package that fly satellites, with their modules."""
    found: dict[str, list[str]] = {}
    for name, tree in modules().items():
        for node in walked(tree):
            if isinstance(node, ast.ClassDef) and node.name != Constellation.__name__:
                own = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
                if {"clock", "state"} <= own:
                    found.setdefault(node.name, []).append(name)
    return found


def test_letters_of_systems_stand_in_the_table_alone() -> None:
    others = {name: tree for name, tree in modules().items() if name != "gnss/constellations/systems.py"}
    found = {(name, text) for name, tree in others.items() for text in letters(tree)}
    assert found == set(OTHER_MEANINGS)


def test_names_of_systems_stand_in_the_table_alone() -> None:
    found = {name for name, tree in modules().items() if set(texts(tree)) & set(NAMES)}
    assert found == {"gnss/constellations/systems.py"}


def test_nobody_asks_what_kind_a_constellation_is() -> None:
    classes = set(implementing())
    assert {name: said for name, tree in modules().items() if (said := questions(tree, classes))} == {}


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("x = name[0] == 'R'", {"R"}), ("f'G{n:02d}'", {"G"}), ("x = 'E11'", {"E11"}), ("for s in 'GR': pass", {"GR"}),
        ("'RGR'", set()), ("'''R'''", set()), ("x = 'RINEX'", set()),
    ],
)  # fmt: skip
def test_the_finder_of_letters_finds(code: str, found: set[str]) -> None:
    assert letters(ast.parse(code)) == found


@pytest.mark.parametrize(
    ("code", "count"),
    [
        ("hasattr(group.constellation, 'healthy')", 1), ("isinstance(found, tle.TwoLineElements)", 1),
        ("getattr(constellation, 'channels', {})", 1), ("type(c.constellations[0])", 1), ("isinstance(x, int)", 0),
    ],
)  # fmt: skip
def test_the_finder_of_questions_finds(code: str, count: int) -> None:
    assert len(questions(ast.parse(code), {"TwoLineElements"})) == count


def test_constellations_have_names_of_their_own() -> None:
    classes = Counter(
        node.name for tree in modules().values() for node in walked(tree) if isinstance(node, ast.ClassDef)
    )
    assert len(implementing()) > 5
    assert {name: classes[name] for name in (*implementing(), Constellation.__name__) if classes[name] > 1} == {}


def test_no_two_systems_share_what_tells_them_apart() -> None:
    for field in ("name", "title", "letter", "talker", "old_file"):
        told = [getattr(system, field) for system in SYSTEMS if getattr(system, field)]
        assert len(set(told)) == len(told), field
    assert all(system.name and system.title and system.letter and system.talker for system in SYSTEMS)
    assert {system.time_system for system in SYSTEMS} <= {*timescales.BEHIND_GPS, *timescales.LEAPING}
    assert set(BY_LETTER) <= set(LETTERS)
    assert list(BY_LETTER) == sorted(BY_LETTER)


def test_the_receivers_clocks_fit_the_kernels() -> None:
    assert len(CLOCKS) <= MAX_CLOCKS


def test_the_integration_flies_by_the_tables_constant() -> None:
    assert GLONASS.gm == glonass_integration.GM


def test_scenarios_allow_what_the_table_has() -> None:
    assert get_args(sky.Clock) == CLOCKS
    assert get_args(sky.Name) == NAMES
    assert {f"nominal-{name}" for name in NAMES} < set(get_args(sky.Source))


@pytest.mark.parametrize("system", SYSTEMS, ids=NAMES)
def test_a_design_answers_all_that_is_asked(system: System) -> None:
    constellation = design(system, UTC)
    count = len(constellation.names)
    gpst = timescales.gps_from_utc(UTC + np.array([0.0, 60.0]))
    for one in (constellation, CachedConstellation(constellation), constellation.broadcast(UTC, UTC + 60.0)):
        assert {name for name in members() if not hasattr(one, name)} == set()
        assert one.system is system
        assert one.names == constellation.names
        assert all(system.has(name) for name in one.names)
        assert one.usable.all()
        assert one.using_unhealthy().names == one.names
        for values in (*one.state(gpst), *one.clock(gpst)):
            assert values.shape[:2] == (2, count)
            assert np.isfinite(values).all()
        sent = one.messages(gpst)
        assert sent is not None
        assert sent.fields["healthy"].all()
        assert carriers(one).shape == (count,)
        np.testing.assert_allclose(carriers(one), system.carrier, rtol=0.003)
        assert (len(set(carriers(one))) > 1) == system.by_channel
    radius = np.linalg.norm(constellation.state(gpst)[0], axis=2)
    # circles, of BeiDou two of them; ellipses of QZSS
    near, far = (26500e3, 42200e3) if system is BEIDOU else (np.median(radius), np.median(radius))
    assert radius.min() > near * (0.9 if system is QZSS else 0.99)
    assert radius.max() < far * (1.1 if system is QZSS else 1.01)


@pytest.mark.parametrize(
    ("system", "good", "bad"),
    [
        (GLONASS, ("R01", "R24", "R730"), ("R00", "R25", "G01", "R1", "R", "", "Rxx", "R7301")),
        (GPS, ("G01", "G63"), ("G1", "G123", "R01", "Gxx", "G")),
        (BEIDOU, ("C01", "C63"), ("C1", "C123", "G01")),
    ],
)
def test_names_of_satellites(system: System, good: tuple[str, ...], bad: tuple[str, ...]) -> None:
    assert [name for name in good if not system.has(name)] == []
    assert [name for name in bad if system.has(name)] == []
    assert system.has(system.satellite(7))
