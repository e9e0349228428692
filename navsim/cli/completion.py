"""What typer's completion offers as values of options and arguments.

It reads only the list of keys, without models and numba, so that the answer comes while the user types.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from glob import escape
from pathlib import Path
from typing import Any

from navsim.kinds import KINDS, OF_FILES

UNTIL = ("rms_horizontal within 2%", "rms_vertical within 2%", "probability within 20%")
"""Values of `--until`, each as one word."""


def drawn_figures(ctx: Any, incomplete: str) -> list[str]:
    """Figures of the results that are given, without those that are named already."""
    before = incomplete[: incomplete.rfind(",") + 1]
    found = {
        path.stem.removeprefix(f"{result.stem}_")
        for result in map(Path, ctx.args) for ending in ("png", "svg", "pdf")
        for path in result.parent.glob(f"{escape(result.stem)}_*.{ending}")
    }  # fmt: skip
    return [f"{before}{name}" for name in sorted(found - {*before.split(",")})]


def assignments(ctx: Any, incomplete: str) -> Iterator[str]:
    """Keys for `--set`, or, behind a key and `=`, the values it may have."""
    from navsim.scenario_files.key_names import key_names

    known = key_names()
    keys: dict[str, list[str]] = {}
    for kind in _kinds_of(ctx):
        for key, choices in known[kind].items():
            keys.setdefault(key, []).extend(choice for choice in choices if choice not in keys.get(key, []))
    name, equals, _ = incomplete.partition("=")
    if equals:
        general = ".".join("N" if part.isdecimal() else part for part in name.split("."))
        yield from (f"{name}={choice}" for choice in keys.get(general, ()))
        return
    for key in keys:
        yield _as_typed(key.split("."), name.split("."))


def _as_typed(shown: list[str], parts: list[str]) -> str:
    """A key with the numbers of list items that were typed, else 0, up to a name that the user chooses."""
    for place, part in enumerate(shown):
        if part == "N":
            shown[place] = parts[place] if place < len(parts) and parts[place].isdecimal() else "0"
        elif part == "NAME":
            return ".".join(shown[:place]) + "."
    return ".".join(shown) + "="


def _kinds_of(ctx: Any) -> list[str]:
    """The kind of the file that is given, else the kinds that the command takes."""
    for path in map(Path, ctx.args):  # of an option without its value, typer has not gone on to the arguments
        if path.suffix in (".yaml", ".yml"):
            try:
                with path.open(encoding="utf-8", errors="replace") as file:
                    found = re.search(r"^kind:\s*[\"']?([\w-]+)", file.read(100_000), re.MULTILINE)
            except OSError:
                continue
            if found and found[1] in OF_FILES:
                return [found[1]]
    if ctx.info_name in ("live", "integrity-table"):
        return ["landing"]
    return [kind for kind in OF_FILES if KINDS[kind].command == ctx.info_name] or list(OF_FILES)
