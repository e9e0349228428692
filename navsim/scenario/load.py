"""From a file to a validated scenario of its kind."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from navsim.formats.yaml_text import dump
from navsim.kinds import KINDS, OF_FILES, advice, named
from navsim.scenario_files.base import Section, hint, validated
from navsim.scenario_files.source import Document, InputError, Problem, Setting, assign, load, set_value

if TYPE_CHECKING:
    from navsim.scenario.landing import Landing

S = TypeVar("S", bound=Section)
Source = Path | Document
"""A file, or its content."""
Assignment = str | Setting
"""Assignment of a value to a key: `a.b=value` as text, or the two."""


class OverLandings(Protocol):
    """Section of a study over landings: base is the file of its scenario, set are keys with other values there."""

    base: str
    set: dict[str, Any]


def section(kind: str) -> type[Section]:
    """The model of files of a kind."""
    found: type[Section] = named(KINDS[kind].section)
    return found


def read_any(path: Source, assignments: Sequence[Assignment] = ()) -> tuple[Section, Document]:
    """The scenario or study in a file, after assignments, and the document behind it.

    Raises InputError listing every problem found.
    """
    document = path.copy() if isinstance(path, Document) else load(path)
    own = document.data.get("kind")
    _assign(document, assignments)
    kind = document.data.get("kind")
    if str(kind) not in OF_FILES:  # any value is possible, also a list
        missing = "kind" not in document.data
        text = "this key is required; " if missing else f"{kind!r} is not a kind of scenario; "
        raise InputError([Problem(document.place(("kind",)), "kind", text + hint(str(kind), list(OF_FILES)))])
    try:
        return validated(section(str(kind)), document), document
    except InputError as error:
        if own in (None, kind):
            raise
        message = f"the file is of kind {own}; that it is to be of kind {kind} is why"
        raise InputError([Problem(document.place(("kind",)), "kind", message), *error.problems]) from None


def _assign(document: Document, assignments: Sequence[Assignment]) -> None:
    for assignment in assignments:
        assign(document, assignment)


def own_method(path: Source, assignments: Sequence[Assignment] = ()) -> str | None:
    """The method a file itself asks for, None for kinds that know only one. Raises InputError as `load`.

    Nothing else is validated: a file may be right only under the method that the command line gives instead.
    """
    document = path.copy() if isinstance(path, Document) else load(path)
    _assign(document, assignments)
    data = document.data
    kind = str(data.get("kind"))
    fields = section(kind).model_fields if kind in OF_FILES else {}
    return str(data.get("method", fields["method"].default)) if "method" in fields else None


def _read(path: Source, assignments: Sequence[Assignment], wanted: Sequence[str]) -> tuple[Any, Document]:
    """`read_any` for the wanted kinds alone; the error for another kind names its command."""
    scenario, document = read_any(path, assignments)
    kind = str(document.data["kind"])
    if kind not in wanted:
        allowed = " or ".join(f"`kind: {name}`" for name in wanted)
        message = f"this is {advice(kind, path)}; {allowed} is needed here"
        raise InputError([Problem(document.place(("kind",)), "kind", message)])
    return scenario, document


def read_for(command: str, path: Source, assignments: Sequence[Assignment] = ()) -> tuple[Section, Document]:
    """`read_any` for the kinds that a command of `navsim` computes."""
    return _read(path, assignments, [kind for kind in OF_FILES if KINDS[kind].command == command])


def read(path: Path, assignments: Sequence[str] = ()) -> tuple[Landing, Document]:
    """`read_any` for landings."""
    return _read(path, assignments, ("landing",))


def read_replay(path: Path, assignments: Sequence[str] = ()) -> tuple[Any, Document]:
    """`read_any` for recorded flights."""
    return _read(path, assignments, ("replay",))


NO_RECORDED = "an approach of a file (approach.profile: recorded or track) is flown by `navsim run`, but by no study"


def read_study(path: Path, kind: type[S], assignments: Sequence[str] = ()) -> tuple[S, Document, Document]:
    """A study of the wanted kind, its document, and that of its base scenario. Raises InputError."""
    study, document = _read(path, assignments, [name for name in OF_FILES if section(name) is kind])
    return study, document, base_of(study, document)


def base_of(study: OverLandings, document: Document) -> Document:
    """Document of a study's base scenario with the study's `set`.

    It may be incomplete without the varied keys. Raises InputError.
    """
    try:
        base = load(document.resolve(("base",), study.base))
    except InputError as error:
        where = f" (named at {document.place(('base',))})"
        raise InputError([Problem(p.place, p.key, p.message + where) for p in error.problems]) from None
    base.named, base.elsewhere = document.named, document.elsewhere
    for key, value in study.set.items():
        set_value(base, key, copy.deepcopy(value), document.place(("set", key)), document.folder)
    document.renamed.extend(base.renamed)
    if base.data.get("kind") != "landing":
        message = f"the base of a study is a landing scenario; {study.base} is of kind {base.data.get('kind')!r}"
        raise InputError([Problem(document.place(("base",)), "base", message)])
    if isinstance(base.data.get("approach"), dict) and base.data["approach"].get("profile") in ("recorded", "track"):
        raise InputError([Problem(document.place(("base",)), "base", f"{study.base}: {NO_RECORDED}")])
    return base


def resolved_yaml(scenario: Section) -> str:
    """The scenario with every default written out, as YAML that reads back to the same scenario."""
    return dump(scenario.model_dump(mode="json", exclude_none=True))
