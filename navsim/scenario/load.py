"""From a file to a validated scenario of its kind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from navsim.scenario.base import Section, hint, validated
from navsim.scenario.landing import Landing
from navsim.scenario.source import Document, InputError, Problem, assign, load

KINDS: dict[str, type[Section]] = {"landing": Landing}
"""The scenario kinds this version can run."""


def read(path: Path, assignments: Sequence[str] = ()) -> tuple[Landing, Document]:
    """The scenario in a file, after `--set` assignments, and the document behind it.

    Raises InputError listing every problem found.
    """
    document = load(path)
    for assignment in assignments:
        assign(document, assignment)
    kind = document.data.get("kind")
    if kind not in KINDS:
        missing = "kind" not in document.data
        said = "this key is required; " if missing else f"{kind!r} is no kind of scenario; "
        raise InputError([Problem(document.place(("kind",)), "kind", said + hint(str(kind), list(KINDS)))])
    scenario = validated(KINDS[str(kind)], document)
    assert isinstance(scenario, Landing)
    return scenario, document


def resolved_yaml(scenario: Section) -> str:
    """The scenario with every default written out, as YAML that reads back to the same scenario."""
    import yaml

    return yaml.safe_dump(scenario.model_dump(mode="json", exclude_none=True), sort_keys=False, allow_unicode=True)
