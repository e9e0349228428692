"""Plain values of YAML: as navsim reads them (core schema of YAML 1.2), and as it writes them."""

from __future__ import annotations

import re
from typing import Any

import yaml

from navsim.formats.text import MINUS_SIGNS

_SIGN = f"[-+{MINUS_SIGNS}]?"


def resolve_core_schema(kind: Any) -> None:
    """Let a loader, or a dumper, of PyYAML take plain values for booleans, null and numbers as YAML 1.2 does."""
    for tag, pattern, first in (
        ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
        ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
        ("int", rf"{_SIGN}[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", f"-+{MINUS_SIGNS}0123456789"),
        ("float", rf"{_SIGN}(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE]{_SIGN}[0-9]+)?", f"-+{MINUS_SIGNS}.0123456789"),
        ("float", rf"{_SIGN}\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", f"-+{MINUS_SIGNS}."),
    ):
        kind.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", re.compile(rf"^(?:{pattern})$"), list(first))


class Dumper(yaml.SafeDumper):
    """Quotes also texts that only YAML 1.2 takes for numbers, such as 1e3."""


resolve_core_schema(Dumper)


def dump(data: Any, **how: Any) -> str:
    """YAML of plain data, keys in their order."""
    return str(yaml.dump(data, Dumper=Dumper, sort_keys=False, allow_unicode=True, **how))
