"""Names of keys for completion: `keys.json`, written by `scripts/key_names.py`, so that the shell need not load the
models.

`navsim keys` has the meanings, from the models.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("keys.json")


def key_names() -> dict[str, dict[str, list[str]]]:
    """kind -> dotted key -> its choices, [] where it has none; without the sections, which `--set` does not take."""
    found: dict[str, dict[str, list[str]]] = json.loads(FILE.read_text(encoding="utf-8"))
    return found


def collected() -> dict[str, dict[str, list[str]]]:
    """`key_names` from the models."""
    from navsim.kinds import OF_FILES
    from navsim.scenario.keys import rows
    from navsim.scenario.load import section

    out: dict[str, dict[str, list[str]]] = {}
    for kind in OF_FILES:
        names = out.setdefault(kind, {})
        for row in rows(section(kind).model_json_schema()):
            if not row.section and row.key not in ("kind", "version"):
                choices = ["true", "false"] if row.kind.startswith("true or false") else list(map(_yaml, row.choices))
                names[row.key] = list(dict.fromkeys([*names.get(row.key, []), *choices]))
    return out


def _yaml(choice: Any) -> str:
    """A value as YAML has it."""
    return choice if isinstance(choice, str) else json.dumps(choice)


def text(names: dict[str, dict[str, list[str]]]) -> str:
    """Content of `FILE`, a key a line."""
    kinds = []
    for kind, keys in names.items():
        lines = ",\n".join(f"  {json.dumps(key)}: {json.dumps(choices)}" for key, choices in keys.items())
        kinds.append(f" {json.dumps(kind)}: {{\n{lines}\n }}")
    return "{\n" + ",\n".join(kinds) + "\n}\n"
