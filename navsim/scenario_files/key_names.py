"""Names of keys for completion: `keys.json`, written by `scripts/key_names.py`, so that the shell need not load the
models.

`navsim keys` has the meanings, from the models.
"""

from __future__ import annotations

import json
from pathlib import Path

FILE = Path(__file__).with_name("keys.json")


def key_names() -> dict[str, dict[str, list[str]]]:
    """kind -> dotted key -> its choices, [] where it has none; without the sections, which `--set` does not take."""
    found: dict[str, dict[str, list[str]]] = json.loads(FILE.read_text(encoding="utf-8"))
    return found
