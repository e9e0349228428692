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
