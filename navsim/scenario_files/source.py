"""YAML 1.2 text to plain data that remembers the place of every key and value.

PyYAML reads YAML 1.1, in which `yes` is a boolean, `1e-3` a string, and keys may repeat. The resolver and the
constructor here follow the YAML 1.2 core schema (https://yaml.org/spec/1.2.2/, section 10.3.2). The minus may also be
any sign that editors write for one. Tags are refused.

The content of a text is bounded, only here, for files and `--set` alike: bytes, depth, nodes (aliases count with all
that they repeat), length of texts, digits and size of numbers.
"""

from __future__ import annotations

import copy
import datetime
import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from navsim.formats.text import as_ascii, decoded
from navsim.formats.yaml_text import resolve_core_schema
from navsim.results import files
from navsim.results.former_names import current, renew

KeyPath = tuple[str | int, ...]
MOST_BYTES = 1_000_000
"""Largest size of a file."""
MOST_NODES = 20_000
"""Keys and values."""
MOST_DEPTH = 40
"""Mappings and lists one in another."""
MOST_CHARACTERS = 4096
"""Largest size of a key or a value that is text."""
MOST_DIGITS = 60
"""Characters of a number."""
LARGEST, SMALLEST = 1e50, 1e-50
"""Range of magnitudes of numbers other than 0: others overflow or vanish when squared twice. Each key has its own
bounds besides."""
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""Characters that are not text: control characters except tabs and line ends, halves of surrogate pairs,
noncharacters."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
"""First bytes of every HDF5 file (HDF5 File Format Specification, section II.A)."""
_LOGS = (".bin", ".ulg", ".ubx", ".nmea", ".pos", ".tlog")
"""Suffixes of recordings, which `navsim import` reads or explains why it cannot."""
_TABLES = (".csv", ".tsv", ".gz", ".bz2", ".zip", ".obs", ".rnx")
"""Suffixes of tables and observations, which a scenario or log file names."""


@dataclass(frozen=True)
class Place:
    """Place of an item: file and line, or the command-line option that sets it."""

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


NOWHERE = Place("")
"""Place of an error outside of any file."""


@dataclass(frozen=True)
class Problem:
    """An error in the input: place, key, message with the correct form."""

    place: Place
    key: str
    message: str

    def __str__(self) -> str:
        place = "" if self.place == NOWHERE else f"{self.place}: "
        return f"{place}{self.key + ': ' if self.key else ''}{self.message}"

    @property
    def file(self) -> str:
        """The file, or the option; empty if there is none."""
        return self.place.file

    @property
    def line(self) -> int:
        """The line, from 1; 0 if there is none."""
        return self.place.line


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
    renamed: list[str] = field(default_factory=list)
    """Warnings about keys by their former names."""
    named: dict[tuple[KeyPath, str], Path] = field(default_factory=dict)
    """Files that were looked up, by the key and the name there; shared with copies."""
    elsewhere: dict[str, Path] = field(default_factory=dict)
    """Paths of files by their names, instead of those that follow from the names; shared with copies."""

    def __str__(self) -> str:
        return self.file

    def copy(self) -> Document:
        """Another document with the same contents, free to be changed."""
        return Document(
            self.file, self.folder, copy.deepcopy(self.data), dict(self.keys), dict(self.values), dict(self.folders),
            list(self.renamed), self.named, self.elsewhere,
        )  # fmt: skip

    def place(self, path: KeyPath) -> Place:
        """Place of the key of `path` if it is in the text, else of the nearest enclosing one."""
        for length in range(len(path), 0, -1):
            found = self.keys.get(path[:length]) or self.values.get(path[:length])
            if found:
                return found
        return self.values.get((), Place(self.file, 1, 1))

    def renew(self) -> None:
        """Give keys their present names (`results.former_names`), with a warning for each. Raises InputError if a key
        is there by both names."""
        try:
            for former, new in renew(self.data):
                self._rename(former, new)
        except KeyError as error:
            (path,) = error.args
            raise InputError(
                [Problem(self.place(path), dotted(path), "is given twice, also by its former name")]
            ) from None

    def present(self, former: KeyPath, place: Place, of: Any) -> KeyPath:
        """Path of a key of a kind of file by its present name, with a warning if that is another one."""
        if (new := current(of, former)) != former:
            self.note_former(former, new, place)
        return new

    def note_former(self, former: KeyPath, new: KeyPath, place: Place) -> None:
        """Warn of a key by its former name."""
        changed = next(after for before, after in zip(former, new, strict=True) if before != after)
        text = f"this key is called {changed} now; write the new name, a later version reads no other"
        self.renamed.append(str(Problem(place, dotted(former), text)))

    def _rename(self, former: KeyPath, new: KeyPath) -> None:
        self.note_former(former, new, self.place(former))
        tables: tuple[dict[KeyPath, Any], ...] = (self.keys, self.values, self.folders)
        for places in tables:
            for path in [path for path in places if path[: len(former)] == former]:
                places[*new, *path[len(former) :]] = places.pop(path)

    def resolve(self, path: KeyPath, name: str) -> Path:
        """A file named at `path`: relative to the document, or to the working folder if set from outside."""
        folder = next((self.folders[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.folders), None)
        try:
            found = self.elsewhere.get(name) or (folder or self.folder) / Path(name).expanduser()
        except RuntimeError:
            user = Path(name).parts[0]
            raise InputError([Problem(self.place(path), dotted(path), f"there is no user's folder {user!r}")]) from None
        self.named[path, name] = found
        return found


class _Refused(yaml.MarkedYAMLError):
    """YAML, and more than a scenario may hold."""


class _Loader(yaml.SafeLoader):
    """Composes nodes, no deeper and no more than allowed, and none with a tag."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._count = 0
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if getattr(event, "tag", None) is not None:
            raise _Refused(problem="tags (words with !) are not used here; write the plain value",
                           problem_mark=event.start_mark)  # fmt: skip
        self._count += 1
        if self._count > MOST_NODES:
            raise _Refused(problem=_TOO_MANY, problem_mark=event.start_mark)
        if self._depth > MOST_DEPTH:
            raise _Refused(problem=_TOO_DEEP, problem_mark=event.start_mark)
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


_INT = "tag:yaml.org,2002:int"
_TOO_MANY = f"more than {MOST_NODES:,} keys and values, counting what aliases repeat"
_TOO_DEEP = f"nested too deeply: mappings and lists more than {MOST_DEPTH} one in another"


resolve_core_schema(_Loader)


def _number(text: str) -> int | float:
    """A number of the core schema. Raises ValueError for one too long, too large, too small, or not finite."""
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number of {len(text)} characters; allowed are {MOST_DIGITS}")
    plain = as_ascii(text).lower().lstrip("+")
    try:
        value: int | float = int(plain, 0) if plain.startswith(("0x", "0o")) else int(plain)
    except ValueError:
        value = float(plain.replace(".inf", "inf").replace(".nan", "nan"))
    if plain.endswith("inf"):
        raise ValueError(f"a finite number is needed, not {text}")
    vanished = value == 0 and any(digit in plain.partition("e")[0] for digit in "123456789")
    return _bounded(value, text, vanished)


def _bounded(value: int | float, text: str, vanished: bool = False) -> int | float:
    """A checked number; text: its written form. Raises ValueError for one too large, too small, or not finite."""
    if math.isnan(value):
        raise ValueError("a finite number is needed, not nan")
    if vanished or abs(value) > LARGEST or 0 < abs(value) < SMALLEST:
        raise ValueError(f"a finite number is needed, 0 or of a size from {SMALLEST:g} to {LARGEST:g}, not {text}")
    return value + 0  # no negative zero


def _text(value: str) -> str:
    """A checked text. Raises ValueError for a value that is not text, or too long."""
    if len(value) > MOST_CHARACTERS:
        raise ValueError(f"a text of {len(value)} characters; allowed are {MOST_CHARACTERS}")
    found = _CONTROL.search(value)
    if found:
        raise ValueError(f"the character U+{ord(found.group()):04X} is not allowed in a text")
    return value


def _scalar(node: yaml.Node) -> Any:
    kind = node.tag.rsplit(":", 1)[-1]
    if kind == "null":
        return None
    if kind == "bool":
        return node.value.lower() == "true"
    if kind in ("int", "float"):
        return _number(node.value)
    return _text(node.value)


class _Builder:
    """Turns the node graph into data, notes places and finds duplicate keys."""

    def __init__(self, document: Document, place: Callable[[yaml.Mark], Place]) -> None:
        self.document = document
        self.problems: list[Problem] = []
        self._place = place
        self._count = 0

    def place(self, node: yaml.Node) -> Place:
        return self._place(node.start_mark)

    def build(self, node: yaml.Node, path: KeyPath) -> Any:
        """The data of a node. Raises _Refused where aliases make more of it than allowed."""
        self._count += 1
        if self._count > MOST_NODES:
            raise _Refused(problem=_TOO_MANY, problem_mark=node.start_mark)
        if len(path) > MOST_DEPTH:
            raise _Refused(problem=_TOO_DEEP, problem_mark=node.start_mark)
        self.document.values[path] = self.place(node)
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.build(child, (*path, i)) for i, child in enumerate(node.value)]
        try:
            return _scalar(node)
        except ValueError as error:
            self.problems.append(Problem(self.place(node), dotted(path), str(error)))
            return None

    def mapping(self, node: yaml.MappingNode, path: KeyPath) -> dict[str, Any]:
        out: dict[str, Any] = {}
        last: KeyPath = path
        before: yaml.Node = node
        for key_node, value_node in node.value:
            if node.flow_style and (number := _parted(before, key_node, value_node)):
                message = f"the comma of {number} ends the value; decimals take a point: {number.replace(',', '.')}"
                self.problems.append(Problem(self.place(key_node), dotted(last), message))
                continue
            if not isinstance(key_node, yaml.ScalarNode):
                self.problems.append(Problem(self.place(key_node), dotted(path), "a key must be plain text"))
                continue
            try:
                key = _text(key_node.value)
            except ValueError as error:
                self.problems.append(Problem(self.place(key_node), dotted(path), f"a key is wrong: {error}"))
                continue
            here = (*path, key)
            if key in out:
                first = self.document.keys[here]
                message = f"duplicate key, first on line {first.line}; keep one of them"
                self.problems.append(Problem(self.place(key_node), dotted(here), message))
                continue
            last, before = here, value_node
            self.document.keys[here] = self.place(key_node)
            out[key] = self.build(value_node, here)
        return out


def _parted(before: yaml.Node, key: yaml.Node, value: yaml.Node) -> str:
    """The number whose decimals a comma has made a key without a value of, as it was written; "" where that is none."""
    nothing = value.start_mark.index == value.end_mark.index
    if nothing and before.tag == key.tag == _INT and str(key.value).isdecimal():
        return f"{before.value},{key.value}"
    return ""


def compose(text: str) -> yaml.Node | None:
    """The nodes of a YAML text with their places; None for a text that holds nothing. Raises yaml.YAMLError."""
    node: yaml.Node | None = yaml.compose(text, Loader=_Loader)
    return node


def dotted(path: KeyPath) -> str:
    """`("a", 0, "b")` as text: `a.0.b`."""
    return ".".join(str(part) for part in path)


def _missing(path: Path) -> str:
    """Advice for a missing file: one of a similar name, or the command that makes one."""
    from navsim.scenario_files import shipped

    known = path.stem in shipped.names()
    if not path.parent.is_dir():
        return f"there is no folder {path.parent}" + (
            f"; 'navsim init {path.stem} -o {path.name}' writes this scenario here" if known else ""
        )

    here = {one.stem: one.name for one in sorted(path.parent.glob("*.y*ml"))}
    if near := difflib.get_close_matches(path.stem, here, n=1, cutoff=0.7):
        return f"there is no such file; did you mean {path.with_name(here[near[0]])}?"
    if path.name == "log.yaml" and [*path.parent.glob("imu*.csv"), *path.parent.glob("gnss*.csv")]:
        return "there is no such file: `navsim import` found no samples or no fixes for it, and names the missing part"
    template = f" {path.stem}" if known else ""
    return f"there is no such file; 'navsim init{template}' writes a scenario to start from"


def load(path: Path) -> Document:
    """Read a YAML file. Raises InputError: unreadable, not YAML, several documents, duplicate keys, more in it than
    this module allows."""
    name = str(path)
    try:
        with files.open_regular(path) as file:
            raw = file.read(MOST_BYTES + 1)
    except IsADirectoryError:
        raise InputError([Problem(Place(name), "", "this is a folder; a YAML file is needed")]) from None
    except FileNotFoundError:
        raise InputError([Problem(Place(name), "", _missing(path))]) from None
    except OSError as error:
        raise InputError([Problem(Place(name), "", f"cannot be read: {error.strerror or error}")]) from None
    if raw.startswith(_HDF5):
        message = f"is a result, not a scenario: use navsim show {path} or navsim plot {path}"
        raise InputError([Problem(Place(name), "", message)])
    if path.suffix.lower() in _LOGS:
        message = f"is a log, not a scenario: use navsim import {path}, which writes a log.yaml for navsim replay"
        raise InputError([Problem(Place(name), "", message)])
    if path.suffix.lower() in _TABLES:
        message = "is a table, not a scenario. A log file names it; navsim init recorded_flight -o log.yaml writes one"
        raise InputError([Problem(Place(name), "", message)])
    if len(raw) > MOST_BYTES:
        raise InputError([Problem(Place(name), "", f"more than {MOST_BYTES:,} bytes; that is not a scenario")])
    try:
        return parse(decoded(raw), name, path.resolve().parent)
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        place = Place(name, before.count(b"\n") + 1, len(before) - before.rfind(b"\n"))
        message = f"not a text file: byte {error.start} is not {error.encoding.upper()}"
        raise InputError([Problem(place, "", message)]) from None


def parse(text: str, name: str, folder: Path) -> Document:
    """Parse YAML text; `name` identifies it in messages. Raises InputError as `load`."""
    document = Document(file=name, folder=folder, data=None)

    def place(line: int, column: int) -> Place:
        return Place(name, line + 1, column + 1)

    if not _built(text, document, place):
        raise InputError([Problem(Place(name, 1, 1), "", "the file is empty; `navsim init` writes one to start from")])
    if not isinstance(document.data, dict):
        message = "a scenario is a mapping of keys to values, `kind: landing` among them"
        raise InputError([Problem(Place(name, 1, 1), "", message)])
    document.renew()
    return document


def _built(text: str, document: Document, place: Callable[[int, int], Place]) -> bool:
    """Put the content of a YAML text into a document; False for an empty text.

    place: converts a line and a column, both from 0, to a place. Raises InputError.
    """

    def of(mark: yaml.Mark | None) -> Place:
        return place(mark.line, mark.column) if mark else place(0, 0)

    builder = _Builder(document, of)
    try:
        node = compose(text)
        if node is not None:
            document.data = builder.build(node, ())
    except _Refused as error:
        raise InputError([Problem(of(error.problem_mark), "", str(error.problem))]) from None
    except yaml.MarkedYAMLError as error:
        mark, message = _misread(error, text)
        raise InputError([Problem(of(mark), "", f"not YAML: {message}")]) from None
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        where = place(before.count("\n"), len(before) - before.rfind("\n") - 1)
        message = f"not YAML: the character U+{ord(text[error.position]):04X} is not allowed"
        raise InputError([Problem(where, "", message)]) from None
    if builder.problems:
        raise InputError(builder.problems)
    return node is not None


_OPENED = {
    "while parsing a flow mapping": "the '{' here is not closed by '}'",
    "while parsing a flow sequence": "the '[' here is not closed by ']'",
    "while scanning a quoted scalar": "the quotation mark here has no second one",
}
"""Contexts in which PyYAML misses an end, and their explanation."""
_NO_COLON = "there is no colon here: write `key: value`"


def _misread(error: yaml.MarkedYAMLError, text: str) -> tuple[yaml.Mark | None, str]:
    """Place and reason of a YAML error in a text: for an unclosed item, or a key without a colon, its start, since the
    parser notices only further down."""
    begun, noticed = error.context_mark, error.problem_mark
    if error.context == "while scanning a simple key" and begun is not None:
        return begun, _NO_COLON
    if str(error.problem).startswith(("mapping values", "expected '<document start>'")) and noticed is not None:
        before = [line.partition(" #")[0].strip() for line in text.splitlines()[: noticed.line]]
        number = max((i for i, line in enumerate(before) if line and not line.startswith("#")), default=None)
        if number is not None and ":" not in before[number]:
            column = text.splitlines()[number].index(before[number])
            return yaml.Mark("", 0, number, column, None, 0), _NO_COLON
    if "\\t" in str(error.problem):
        return noticed, "a tab is not allowed here: write spaces instead"
    opened = _OPENED.get(error.context or "")
    if opened is None or begun is None or noticed is None:
        return noticed or begun, str(error.problem or error.context)
    at_end = "stream" in str(error.problem)
    if at_end:
        return begun, opened
    if begun.line == noticed.line:
        return noticed, str(error.problem)
    return begun, f"{opened}, or lacks a comma, before line {noticed.line + 1}: {error.problem}"


class _Taker:
    """Converts Python data to plain data as in a file, and finds values that cannot be converted."""

    def __init__(self) -> None:
        self.problems: list[tuple[KeyPath, str]] = []
        self._count = 0

    def take(self, value: Any, path: KeyPath = ()) -> Any:
        """Plain data of a value. Raises ValueError for too many of them."""
        self._count += 1
        if self._count > MOST_NODES:
            raise ValueError(_TOO_MANY)
        if len(path) > MOST_DEPTH:
            raise ValueError(_TOO_DEEP)
        if isinstance(value, Mapping):
            return {key: self.take(value[key], (*path, key)) for key in value if self._is_key(key, path)}
        if isinstance(value, list | tuple):
            return [self.take(one, (*path, i)) for i, one in enumerate(value)]
        if hasattr(value, "tolist"):  # numpy's arrays and numbers
            return self.take(value.tolist(), path)
        try:
            return _plain(value)
        except ValueError as error:
            self.problems.append((path, str(error)))
            return None

    def _is_key(self, key: object, path: KeyPath) -> bool:
        try:
            if isinstance(key, str):
                _text(key)
                return True
            wrong = f"a key must be a text, not {key!r:.60}"
        except ValueError as error:
            wrong = f"a key is wrong: {error}"
        self.problems.append((path, wrong))
        return False


def _plain(value: object) -> Any:
    """Plain form of a single value. Raises ValueError for an unsuitable one."""
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int | float):
        return _bounded(value, "a larger one" if abs(value) > LARGEST else repr(value))
    if isinstance(value, str | Path):
        return _text(str(value))
    if isinstance(value, datetime.datetime):
        if value.tzinfo is None:
            raise ValueError("a time needs its zone: datetime(..., tzinfo=timezone.utc)")
        return value.astimezone(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%S.%f").rstrip("0").rstrip(".") + "Z"
    kinds = "numbers, texts, booleans, lists and mappings are"
    raise ValueError(f"{type(value).__name__} is not a value for a key: {kinds}")


def of_data(data: Mapping[str, Any], name: str) -> Document:
    """A document from Python data; `name` identifies it in messages, file names are relative to the working folder.

    Raises InputError.
    """
    document = Document(name, Path.cwd(), _taken(data, Place(name)))
    document.values[()] = Place(name)
    document.renew()
    return document


def _taken(value: Any, place: Place, path: KeyPath = ()) -> Any:
    """A Python value at `path` as plain data. Raises InputError."""
    taker = _Taker()
    try:
        taken = taker.take(value)
    except ValueError as error:
        raise InputError([Problem(place, dotted(path), str(error))]) from None
    if taker.problems:
        raise InputError([Problem(place, dotted((*path, *below)), text) for below, text in taker.problems])
    return taken


@dataclass(frozen=True)
class Setting:
    """Assignment of a Python value, not text, to a dotted key."""

    key: str
    value: Any


_LONGEST_LABEL = 100


def assign(document: Document, assignment: str | Setting) -> None:
    """Set one value: `a.b.0.c=value`, the value read as YAML, or as it is. Raises InputError."""
    if isinstance(assignment, Setting):
        label = Place(f"--set {assignment.key}={assignment.value}")
        set_value(document, assignment.key, _taken(assignment.value, label), label, Path.cwd())
        return
    shown = assignment if len(assignment) <= _LONGEST_LABEL else assignment[:_LONGEST_LABEL] + "..."
    label = Place(f"--set {shown}")
    key, equals, text = assignment.partition("=")
    if not equals:
        raise InputError([Problem(label, "", "expected dotted.key=value")])
    value = Document(str(label), Path.cwd(), None)
    try:
        _built(text, value, lambda line, column: label)
    except InputError as error:
        within = [replace(p, key=f"{key}.{p.key}") if p.key else p for p in error.problems]
        raise InputError(within) from None
    set_value(document, key, value.data, label, Path.cwd())


def set_value(document: Document, key: str, value: Any, place: Place, folder: Path) -> None:
    """Set the value at a dotted key; `place` identifies it in messages, file names in it are relative to `folder`.

    Raises InputError if the key leads through a single value or a missing list item.
    """

    def fail(message: str) -> InputError:
        return InputError([Problem(place, "", message)])

    parts = key.split(".")
    if any(not part for part in parts):
        raise fail("expected a dotted.key")
    if len(parts) > MOST_DEPTH:
        raise fail(_TOO_DEEP)
    target = document.data
    kind = target.get("kind") if isinstance(target, dict) else None
    parts = [str(part) for part in document.present(tuple(parts), place, kind)]
    path: KeyPath = ()
    for depth, part in enumerate(parts):
        step: str | int = part
        if isinstance(target, list):
            if not part.isdecimal() or len(part) > len(str(MOST_NODES)) or int(part) >= len(target):
                raise fail(f"'{dotted(path)}' is a list of {len(target)}: '{part}' is not an index; the first is 0")
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
    document.renew()
