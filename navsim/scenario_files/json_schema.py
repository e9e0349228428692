"""The JSON Schemas of the kinds of files as others read them: editors, and programs that write scenarios."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import navsim
from navsim.kinds import KINDS, OF_FILES, named
from navsim.scenario_files import shipped

ANY = "any"
"""In place of a kind: the schema that takes a file of every kind."""
DIALECT = "https://json-schema.org/draft/2020-12/schema"
FORMAT = 1
"""The `version` of scenario files."""


def identity(kind: str) -> str:
    """The `$id` of a schema: another one wherever keys may be others."""
    return f"urn:navsim:schema:{kind}:{FORMAT}:{navsim.__version__}"


def published(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file, or of `ANY`, with a shipped file of each kind as example."""
    from pydantic.json_schema import models_json_schema

    kinds = OF_FILES if kind == ANY else (kind,)
    sections = {name: named(KINDS[name].section) for name in kinds}
    if kind == ANY:
        references, whole = models_json_schema([(section, "validation") for section in sections.values()])
        of_kind = {name: references[section, "validation"] for name, section in sections.items()}
        body: dict[str, Any] = {
            "title": "navsim: a file of any kind",
            "type": "object",
            "required": ["kind"],
            "discriminator": {
                "propertyName": "kind",
                "mapping": {name: reference["$ref"] for name, reference in of_kind.items()},
            },
            "anyOf": list(of_kind.values()),
            "$defs": whole["$defs"],
        }
    else:
        body = sections[kind].model_json_schema() | {"title": f"navsim: {KINDS[kind].noun} of kind {kind}"}
    return {"$schema": DIALECT, "$id": identity(kind)} | body | {"examples": [_example(name) for name in kinds]}


def _example(kind: str) -> Any:
    """First shipped file of a kind, as it is written."""
    from navsim.scenario_files.source import load

    return load(shipped.path(next(name for name in shipped.names() if shipped.kind(name) == kind))).data


def installed(kind: str) -> Path:
    """Path of the copy of a schema in the user's data folder (XDG Base Directory Specification), which need not
    exist."""
    given = os.environ.get("XDG_DATA_HOME", "")
    data = Path(given) if Path(given).is_absolute() else Path.home() / ".local" / "share"
    return data / "navsim" / "schema" / f"{kind}.json"


def modeline(kind: str) -> str:
    """The line by which a YAML file names its schema to editors, where a copy of it is installed, else ""."""
    path = installed(kind)
    return f"# yaml-language-server: $schema={path.as_uri()}\n" if path.is_file() else ""
