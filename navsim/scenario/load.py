"""From a file to a validated scenario of its kind."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from navsim.scenario.atc import Atc
from navsim.scenario.azimuth import Azimuth
from navsim.scenario.base import Section, hint, validated
from navsim.scenario.elevation import Elevation
from navsim.scenario.kinds import COMMANDS, advice
from navsim.scenario.landing import Landing
from navsim.scenario.optimize import Optimize
from navsim.scenario.replay import Replay
from navsim.scenario.source import Document, InputError, Problem, assign, load, set_value
from navsim.scenario.sweep import Sweep

KINDS: dict[str, type[Section]] = {
    "landing": Landing,
    "mls-elevation": Elevation,
    "atc-tracking": Atc,
    "azimuth-tracking": Azimuth,
    "sweep": Sweep,
    "optimize": Optimize,
    "replay": Replay,
}
"""The kinds of files this version knows."""
S = TypeVar("S", Sweep, Optimize)


def read_any(path: Path, assignments: Sequence[str] = ()) -> tuple[Section, Document]:
    """The scenario or study in a file, after `--set` assignments, and the document behind it.

    Raises InputError listing every problem found.
    """
    document = _assigned(path, assignments)
    kind = document.data.get("kind")
    if str(kind) not in KINDS:  # anything may stand there, a list too
        missing = "kind" not in document.data
        said = "this key is required; " if missing else f"{kind!r} is no kind of scenario; "
        raise InputError([Problem(document.place(("kind",)), "kind", said + hint(str(kind), list(KINDS)))])
    return validated(KINDS[str(kind)], document), document


def _assigned(path: Path, assignments: Sequence[str]) -> Document:
    document = load(path)
    for assignment in assignments:
        assign(document, assignment)
    return document


def own_method(path: Path, assignments: Sequence[str] = ()) -> str | None:
    """The method a file itself asks for, None for kinds that know only one. Raises InputError as `load`.

    Nothing else is validated: a file may be right only under the method that the command line gives instead.
    """
    data = _assigned(path, assignments).data
    kind = str(data.get("kind"))
    fields = KINDS[kind].model_fields if kind in KINDS else {}
    return str(data.get("method", fields["method"].default)) if "method" in fields else None


def _read(path: Path, assignments: Sequence[str], *wanted: str) -> tuple[Any, Document]:
    """As `read_any`, for the wanted kinds alone; a file of another kind is sent to its command."""
    scenario, document = read_any(path, assignments)
    kind = str(document.data["kind"])
    if kind not in wanted:
        allowed = " or ".join(f"`kind: {name}`" for name in wanted)
        message = f"{allowed} is needed here; this is {advice(kind, path)}"
        raise InputError([Problem(document.place(("kind",)), "kind", message)])
    return scenario, document


def read_runnable(path: Path, assignments: Sequence[str] = ()) -> tuple[Section, Document]:
    """As `read_any`, for scenarios that `navsim run` flies."""
    return _read(path, assignments, *(kind for kind, command in COMMANDS.items() if command == "run"))


def read(path: Path, assignments: Sequence[str] = ()) -> tuple[Landing, Document]:
    """As `read_any`, for landings."""
    return _read(path, assignments, "landing")


def read_replay(path: Path, assignments: Sequence[str] = ()) -> tuple[Replay, Document]:
    """As `read_any`, for recorded flights."""
    return _read(path, assignments, "replay")


NO_RECORDED = "a recorded approach (approach.profile: recorded) is flown by `navsim run`, but by no study"


def read_study(path: Path, kind: type[S], assignments: Sequence[str] = ()) -> tuple[S, Document, Document]:
    """A study of the wanted kind after `--set` assignments, its document, and that of its base scenario.

    The base has the study's `set` in it; it need not be whole before the varied keys are in too. Raises InputError.
    """
    study, document = _read(path, assignments, next(name for name, section in KINDS.items() if section is kind))
    try:
        base = load(document.resolve(("base",), study.base))
    except InputError as error:
        named = f" (named at {document.place(('base',))})"
        raise InputError([Problem(p.place, p.key, p.message + named) for p in error.problems]) from None
    for key, value in study.set.items():
        set_value(base, key, copy.deepcopy(value), document.place(("set", key)), document.folder)
    if base.data.get("kind") != "landing":
        message = f"the base of a study is a landing scenario; {study.base} is of kind {base.data.get('kind')!r}"
        raise InputError([Problem(document.place(("base",)), "base", message)])
    if isinstance(base.data.get("approach"), dict) and base.data["approach"].get("profile") == "recorded":
        raise InputError([Problem(document.place(("base",)), "base", f"{study.base}: {NO_RECORDED}")])
    return study, document, base


def resolved_yaml(scenario: Section) -> str:
    """The scenario with every default written out, as YAML that reads back to the same scenario."""
    import yaml

    return yaml.safe_dump(scenario.model_dump(mode="json", exclude_none=True), sort_keys=False, allow_unicode=True)
