"""Write navsim/scenario_files/keys.json, the names of all keys, from the models: `make docs`."""

from __future__ import annotations

import json
from typing import Any

from navsim.kinds import OF_FILES
from navsim.scenario.load import section
from navsim.scenario_files.key_names import FILE
from navsim.scenario_files.keys import rows


def collected() -> dict[str, dict[str, list[str]]]:
    """Kind -> dotted key -> its choices, from the models."""
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


def main() -> None:
    FILE.write_text(text(collected()), encoding="utf-8")
    print(f"{FILE} written")


if __name__ == "__main__":
    main()
