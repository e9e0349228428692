"""Shared by all tests: where the outside material lies, and the shipped scenarios."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# the first example of a kernel may have to compile it
settings.register_profile("navsim", deadline=None)
settings.load_profile("navsim")

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
SCENARIOS = ROOT / "scenarios"
DATA = ROOT / "tests" / "data"
"""Figures of others that tests compare with."""
LANDINGS = sorted(p.stem for p in SCENARIOS.glob("*.yaml") if "kind: landing\n" in p.read_text())
"""Shipped scenarios of kind landing; the other files are studies."""


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of other people's files; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("needs the files in ../shared, which is not here")
    return SHARED


@pytest.fixture(scope="session")
def oracles() -> dict[str, Any]:
    """Published figures and worked examples; `tests/data/SOURCE.md` says whose."""
    return json.loads((DATA / "oracles.json").read_text())


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--validation", metavar="FILE", help="write the table of oracle tests to FILE")
    parser.addoption("--long", action="store_true", help="run the tests marked long, and no others")
    parser.addoption("--as-written", action="store_true", help="run documented commands with their own run counts")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests marked long are for `make validate`."""
    wanted = [item for item in items if bool(item.get_closest_marker("long")) == config.getoption("--long")]
    config.hook.pytest_deselected(items=[item for item in items if item not in wanted])
    items[:] = wanted


Row = tuple[str, int, list[str]]
_rows: dict[str, Row] = {}
"""Of each oracle test: its file and line, and claim, oracle, tolerance and result."""


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Gather the results of oracle tests, where several processes run them in the one that hears of all."""
    claim = dict(report.user_properties).get("validates")
    if claim is None or not (report.when == "call" or (report.when == "setup" and report.outcome != "passed")):
        return
    name = report.nodeid.split("[")[0]
    file, line, _ = report.location
    _, _, row = _rows.setdefault(name, (file, line or 0, [*claim, report.outcome]))
    if report.outcome == "failed":
        row[3] = report.outcome


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write docs/validation.md from the oracle tests that ran: claim, oracle, tolerance, result."""
    target = session.config.getoption("--validation")
    if not target or hasattr(session.config, "workerinput"):
        return
    lines = [
        "# Validation",
        "",
        "Made by `make docs` from the oracle tests; every claim is checked against something that is not navsim's own",
        "code, each time the tests run. Self-checks (unit, product and consistency tests) are not listed.",
        "",
        "| claim | oracle | tolerance | result | test |",
        "|---|---|---|---|---|",
        *(
            f"| {claim} | {oracle} | {tolerance} | {outcome} | `{name.split('/')[-1].split('::')[-1]}` |"
            for name, (_, _, (claim, oracle, tolerance, outcome)) in sorted(_rows.items(), key=lambda row: row[1][:2])
        ),
        "",
    ]
    Path(target).write_text("\n".join(lines))


def pytest_runtest_setup(item: pytest.Item) -> None:
    marker = item.get_closest_marker("validates")
    if marker is not None:
        item.user_properties.append(("validates", list(marker.args[:3])))
