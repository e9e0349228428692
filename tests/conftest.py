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
LANDINGS = sorted(p.stem for p in SCENARIOS.glob("*.yaml") if "kind: landing\n" in p.read_text())
"""Shipped scenarios of kind landing; the other files are studies."""


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of oracle data; tests that need it skip where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("needs the oracle data in ../shared, which is not here")
    return SHARED


@pytest.fixture(scope="session")
def oracles(shared: Path) -> dict[str, Any]:
    """Worked examples with their sources and tolerances."""
    return json.loads((shared / "data" / "oracles" / "oracles.json").read_text())


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--validation", metavar="FILE", help="write the table of oracle tests to FILE")
    parser.addoption("--as-written", action="store_true", help="run documented commands with their own run counts")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write docs/validation.md from the oracle tests that ran: claim, oracle, tolerance, result."""
    target = session.config.getoption("--validation")
    if not target:
        return
    rows: dict[str, list[str]] = {}
    for item in session.items:
        marker = item.get_closest_marker("validates")
        if marker is None:
            continue
        report = getattr(item, "final_report", None)
        outcome = "skipped" if report is None else report.outcome
        name = item.nodeid.split("[")[0]
        row = rows.setdefault(name, [marker.args[0], marker.args[1], marker.args[2], outcome])
        if outcome == "failed":
            row[3] = outcome
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
            for name, (claim, oracle, tolerance, outcome) in rows.items()
        ),
        "",
    ]
    Path(target).write_text("\n".join(lines))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: Any, call: pytest.CallInfo[None]) -> Any:
    report = yield
    if report.when == "call" or (report.when == "setup" and report.outcome != "passed"):
        item.final_report = report
    return report
