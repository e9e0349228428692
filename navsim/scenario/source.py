"""YAML 1.2 text to plain data that remembers where every key and value stands.

PyYAML reads YAML 1.1, where `yes` is a boolean, `1e-3` a string and a key may stand twice; the resolver and
the constructor here follow the YAML 1.2 core schema (https://yaml.org/spec/1.2.2/, section 10.3.2).
"""

from __future__ import annotations

import copy
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

KeyPath = tuple[str | int, ...]
_HDF5 = b"\x89HDF\r\n\x1a\n"
"""How every HDF5 file begins (HDF5 File Format Specification, section II.A)."""


@dataclass(frozen=True)
class Place:
    """Where something stands: file and line, or the command-line option that says it."""

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


@dataclass(frozen=True)
class Problem:
    """One thing wrong with the input: where, which key, what, and what would be right."""

    place: Place
    key: str
    message: str

    def __str__(self) -> str:
        return f"{self.place}: {self.key + ': ' if self.key else ''}{self.message}"


class InputError(Exception):
    """The input cannot be used; `problems` lists everything found wrong with it."""

    def __init__(self, problems: list[Problem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = problems


@dataclass
class Document:
    """Parsed data with the places of its keys and values, by key path."""

    file: str
    folder: Path
    data: Any
    keys: dict[KeyPath, Place] = field(default_factory=dict)
    values: dict[KeyPath, Place] = field(default_factory=dict)
    folders: dict[KeyPath, Path] = field(default_factory=dict)

    def copy(self) -> Document:
        """Another document with the same contents, free to be changed."""
        return Document(
            self.file, self.folder, copy.deepcopy(self.data), dict(self.keys), dict(self.values), dict(self.folders)
        )

    def place(self, path: KeyPath) -> Place:
        """The key of `path` if it stands in the text, else the nearest enclosing one."""
        for length in range(len(path), 0, -1):
            found = self.keys.get(path[:length]) or self.values.get(path[:length])
            if found:
                return found
        return self.values.get((), Place(self.file, 1, 1))

    def resolve(self, path: KeyPath, name: str) -> Path:
        """A file named at `path`: relative to the document, or to the working folder if set from outside."""
        folder = next((self.folders[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.folders), None)
        return (folder or self.folder) / Path(name).expanduser()


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012


for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    ("float", r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", "-+."),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_pattern})$"), list(_first))


def _number(text: str) -> int | float:
    plain = text.lower().lstrip("+")
    if plain.startswith(("0x", "0o")):
        return int(plain, 0)
    try:
        return int(plain)
    except ValueError:
        return float(plain.replace(".inf", "inf").replace(".nan", "nan"))


def _scalar(node: yaml.Node) -> Any:
    kind = node.tag.rsplit(":", 1)[-1]
    if kind == "null":
        return None
    if kind == "bool":
        return node.value.lower() == "true"
    if kind in ("int", "float"):
        return _number(node.value)
    return node.value


class _Builder:
    """Turns the node graph into data, noting places and finding duplicate keys on the way."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.problems: list[Problem] = []

    def place(self, node: yaml.Node) -> Place:
        return Place(self.document.file, node.start_mark.line + 1, node.start_mark.column + 1)

    def build(self, node: yaml.Node, path: KeyPath) -> Any:
        self.document.values[path] = self.place(node)
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.build(child, (*path, i)) for i, child in enumerate(node.value)]
        return _scalar(node)

    def mapping(self, node: yaml.MappingNode, path: KeyPath) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.problems.append(Problem(self.place(key_node), dotted(path), "a key must be plain text"))
                continue
            key = key_node.value
            here = (*path, key)
            if key in out:
                first = self.document.keys[here]
                message = f"the key stands twice, first on line {first.line}; keep one of them"
                self.problems.append(Problem(self.place(key_node), dotted(here), message))
                continue
            self.document.keys[here] = self.place(key_node)
            out[key] = self.build(value_node, here)
        return out


def dotted(path: KeyPath) -> str:
    """`("a", 0, "b")` as people write it: `a.0.b`."""
    return ".".join(str(part) for part in path)


def load(path: Path) -> Document:
    """Read a YAML file. Raises InputError: unreadable, not YAML, several documents, duplicate keys."""
    name = str(path)
    try:
        raw = path.read_bytes()
    except IsADirectoryError:
        raise InputError([Problem(Place(name), "", "this is a folder; a YAML file is needed")]) from None
    except OSError as error:
        raise InputError([Problem(Place(name), "", f"cannot be read: {error.strerror or error}")]) from None
    if raw.startswith(_HDF5):
        message = f"is a result, not a scenario: use navsim show {path} or navsim plot {path}"
        raise InputError([Problem(Place(name), "", message)])
    try:
        return parse(raw.decode("utf-8"), name, path.resolve().parent)
    except UnicodeDecodeError as error:
        message = f"not a text file: byte {error.start} is not UTF-8"
        raise InputError([Problem(Place(name), "", message)]) from None


def parse(text: str, name: str, folder: Path) -> Document:
    """Parse YAML text; `name` stands for it in messages. Raises InputError as `load`."""
    document = Document(file=name, folder=folder, data=None)
    try:
        node = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = Place(name, mark.line + 1, mark.column + 1) if mark else Place(name, 1, 1)
        raise InputError([Problem(place, "", f"not YAML: {error.problem or error.context}")]) from None
    except yaml.YAMLError as error:
        raise InputError([Problem(Place(name, 1, 1), "", f"not YAML: {error}".splitlines()[0])]) from None
    if node is None:
        raise InputError([Problem(Place(name, 1, 1), "", "the file is empty; `navsim init` writes one to start from")])
    builder = _Builder(document)
    try:
        document.data = builder.build(node, ())
    except RecursionError:
        raise InputError([Problem(Place(name, 1, 1), "", "not YAML: nested too deeply")]) from None
    if builder.problems:
        raise InputError(builder.problems)
    if not isinstance(document.data, dict):
        message = "a scenario is a mapping of keys to values, `kind: landing` among them"
        raise InputError([Problem(Place(name, 1, 1), "", message)])
    return document


def assign(document: Document, assignment: str) -> None:
    """Set one value from the command line, `a.b.0.c=value`, the value read as YAML. Raises InputError."""
    label = f"--set {assignment}"
    key, equals, text = assignment.partition("=")
    if not equals:
        raise InputError([Problem(Place(label), "", "expected dotted.key=value")])
    try:
        node = yaml.compose(text, Loader=_Loader)
    except yaml.YAMLError as error:
        reason = f"the value is not YAML: {getattr(error, 'problem', None) or error}"
        raise InputError([Problem(Place(label), "", reason)]) from None
    builder = _Builder(Document(label, Path.cwd(), None))
    value = builder.build(node, ()) if node is not None else None
    if builder.problems:
        raise InputError(builder.problems)
    set_value(document, key, value, Place(label), Path.cwd())


def set_value(document: Document, key: str, value: Any, place: Place, folder: Path) -> None:
    """Set the value at a dotted key; `place` stands for it in messages, file names in it are relative to `folder`.

    Raises InputError where the key leads through a single value or a missing list item.
    """

    def fail(message: str) -> InputError:
        return InputError([Problem(place, "", message)])

    parts = key.split(".")
    if any(not part for part in parts):
        raise fail("expected a dotted.key")
    target = document.data
    path: KeyPath = ()
    for depth, part in enumerate(parts):
        step: str | int = part
        if isinstance(target, list):
            if not part.isdecimal() or int(part) >= len(target):
                raise fail(f"'{dotted(path)}' is a list of {len(target)}: '{part}' is not one of its indices from 0")
            step = int(part)
        elif not isinstance(target, dict):
            raise fail(f"'{dotted(path)}' is a single value, it has no '{part}' in it")
        path = (*path, step)
        if depth == len(parts) - 1:
            target[step] = value
            for known in [k for k in (*document.keys, *document.values) if k[: len(path)] == path]:
                document.keys.pop(known, None)
                document.values.pop(known, None)
            document.keys[path] = document.values[path] = place
            document.folders[path] = folder
        else:
            if isinstance(target, dict) and target.get(step) is None:
                target[step] = {}
                document.keys[path] = place
            target = target[step]
