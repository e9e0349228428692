"""Which documented commands have run at length, as their pages have them: a table with a digest of each.

A command whose digest is in the table runs in brief, any other as it is written. With `--as-written` each runs as it is
written, once however many pages have it, and the table is written anew: with the commands of pages that passed.

A digest covers what the page has its reader type; of the arguments of the command, and of the options that are given,
the names and the defaults, in Python the parameters of the functions; the shipped files that are named, and
what these name: of scenarios the settings, without comments, of others all. It covers no words of help, no code of
navsim and of the packages it needs, no key of scenarios that is not set, nor what earlier commands of a page have
written. A change of those is seen by the brief forms, which always run, and at length by `make validate`.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import re
from collections.abc import Iterable
from pathlib import Path

import typer
import yaml

import navsim
from navsim.cli.main import app

TABLE = Path(__file__).with_suffix(".txt")
SHIPPED = Path(__file__).resolve().parent.parent / "scenarios"


VERBS = typer.main.get_command(app).commands
"""Commands of navsim by their names."""


def parameters(command: str) -> list[str]:
    """The parameters of the functions that a program in Python calls; those of a command, of its options the given."""
    typed = _typed(command)
    found = [str(inspect.signature(getattr(navsim, name))) for name in re.findall(r"\bnavsim\.([a-z]\w*)\(", typed)]
    words = set(typed.split())
    for verb in re.findall(r"\bnavsim ([a-z][\w-]*)", typed):
        for one in VERBS[verb].params if verb in VERBS else ():
            if one.param_type_name == "argument":
                found.append(f"{verb} {one.default}")
            elif words & set(one.opts):
                found.append(f"{one.opts} {one.is_flag} {one.multiple} {one.default}")
    return found


def named(text: str, shipped: Path = SHIPPED) -> dict[str, str]:
    """Digests of the shipped files that a text names, by their names, and of those that these name; after `init` a
    scenario is named without the end of its name."""
    files = [file for file in sorted(shipped.rglob("*")) if file.is_file()]
    found: dict[str, str] = {}
    waiting = [text]
    while waiting:
        text = waiting.pop()
        for file in files:
            name = str(file.relative_to(shipped))
            if name in found or not re.search(rf"(?<!\w){re.escape(name)}(?!\w)|\binit {file.stem}(?!\w)", text):
                continue
            content = file.read_bytes()
            if file.suffix == ".yaml":
                waiting.append(_settings(content))
                content = waiting[-1].encode()
            found[name] = hashlib.sha256(content).hexdigest()
    return found


@functools.cache
def _settings(scenario: bytes) -> str:
    return json.dumps(yaml.safe_load(scenario), default=str)


def _typed(command: str) -> str:
    """A command without its remarks."""
    return re.sub(r" +# .*", "", command)


def digest(command: str, shipped: Path = SHIPPED) -> str:
    """Of what decides what a documented command does, as far as the text at the top says."""
    given = parameters(command)
    parts = [_typed(command).split(), given, named("\n".join([_typed(command), *given]), shipped)]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def stored(table: Path = TABLE) -> set[str]:
    """The digests of commands that have run at length."""
    return {line.split()[0] for line in table.read_text(encoding="utf-8").splitlines()}


def store(digests: set[str], commands: Iterable[str], table: Path = TABLE) -> None:
    """Write those of today's commands that have one of these digests."""
    lines = {of: " ".join(_typed(one).split())[:90] for one in commands if (of := digest(one)) in digests}
    table.write_text("".join(f"{of}  {one}\n" for of, one in lines.items()), encoding="utf-8")
