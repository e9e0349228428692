"""Mutated scenario files: changes of their tree or of their text, which a slip or malice might make."""

from __future__ import annotations

import copy
import datetime
import gzip
import math
import os
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from navsim.formats.yaml_text import dump

NUMBERS = (
    0, -0.0, 1, -1, 3.0, 0.1 + 0.2, 90, 90.0001, 89.9999999, 180, 360, 360.001, 2000, 2001, 3600, 3601, 1e6, 1e12,
    -1e12,
    1e-12, 1e-300, 5e-324, 1e300, 1e308, -1e308, 10**30, -(10**30), 2**31, 2**63 - 1, 2**63, 2**64,
    math.nan, math.inf, -math.inf,
)  # fmt: skip
TEXTS = (
    "", " ", "\0", "a\0b", "é", "日本語", "🛩", "\u202e", "\ufffe", "x" * 5000, "../../../etc/passwd", "/etc/shadow",
    "%s%n{0}", "$(touch executed)", "~", "~nosuchuser/x", "null", "yes", "no", "1e3", "0x10", "1_000", "0.1_0",
    "12:30:45",
    "2018-02-30T00:00:00Z", "0001-01-01T00:00:00Z", "9999-12-31T23:59:59Z", "2016-12-31T23:59:60Z",
    "2018-09-13T12:00:00+03:00", "[markup]", "[/red]", "[bold]x", "a:b", "..", ".", "\x1b[31mred", "nan", "inf", "1,5",
)  # fmt: skip
KINDS = (None, True, False, [], {}, [[]], {"a": 1}, [None], [1, 2, 3], "1", [math.inf], {"": None}, [True])
RAW = (
    "!!python/object/apply:os.system ['touch executed']", "!!python/name:os.system", "!!int abc", "!!float abc",
    "!!float ''",
    "!!bool maybe", "!!null 5", "!!binary 'AAAA'", "!!timestamp 2018-01-01", "!!set {a}", "!!omap [a: 1]", "!foo 5",
    "!foo:int 5",
    "!<tag:x:float> 1..2", "0x" + "f" * 5000, "9" * 5000, "0." + "1" * 5000, "0o777", "-0x10", "+1", "1.", ".5",
    "1e400", "-1e400",
    "1e-400", '"\\ud800"', '"\\uD83D\\uDE00"', '"\\x00"', "*nosuch", "&a [*a]", "&a {b: *a}", "? x", "[[[[[[[[[[",
    "{", "'", "|", ">-",
    "`x`", "@x", "%x", "- - -", "\t1", "<<", "=", "{<<: {a: 1}}", "1 2 3", "Yes", "NULL", "TRUE", ".inf", ".NaN",
    "190:20:30.15",
)  # fmt: skip
KEYS = (
    "", " ", "title", "kind", "<<", "=", "a.b", "0", "x" * 3000, "日本", "__class__", "constructor", "\0",
    "model_fields", "null",
    "1", "true",
)  # fmt: skip
FILES = (
    "/dev/zero", "/dev/urandom", "/dev/null", "/dev/stdin", "/dev/full", "/proc/self/mem", "/proc/self/fd/0", "PIPE",
    "FOLDER", "/",
    "", ".", "LOOP", "../../../../etc/passwd", "MUTANT.yaml", "LARGE", "BOMB.gz", "a\0b", "~nosuchuser/x", "~/x",
    "x" * 300,
    "x/" * 3000, "DANGLING", "BINARY", "/etc/shadow",
)  # fmt: skip
FILE_KEYS = {"base", "file", "almanac", "navigation", "orbits", "keep_out", "permission"}
NAME = "MUTANT.yaml"
"""What a mutant is to be called, for it may name itself."""


@dataclass(frozen=True)
class Mutant:
    """A changed file. of: its original. data: what it holds, where that is known, else None. note: what was changed."""

    of: str
    note: str
    text: bytes
    data: Any


def strange_files(folder: Path) -> None:
    """The files that mutants name."""
    (folder / "FOLDER").mkdir()
    os.mkfifo(folder / "PIPE")
    (folder / "LOOP").symlink_to("LOOP")
    (folder / "DANGLING").symlink_to("nowhere")
    (folder / "BINARY").write_bytes(bytes(range(256)) * 50)
    (folder / "LARGE").write_bytes(
        b"kind: landing\nversion: 1\ntitle: x\n" + b"# a line of many, to fill it.......\n" * 280_000
    )
    (folder / "BOMB.gz").write_bytes(gzip.compress(b"0" * 10 * 2**20) * 300)  # a file of many members


def mutants(sources: dict[str, bytes], seed: int) -> Iterator[Mutant]:
    """Mutants without end. sources: scenario files by name."""
    draw = random.Random(seed)
    trees = {name: _plain(yaml.safe_load(text)) for name, text in sources.items()}
    while True:
        name = draw.choice(sorted(sources))
        yield _of_tree(name, trees, draw) if draw.random() < 0.8 else _of_text(name, sources[name], draw)


def _plain(node: Any) -> Any:
    """Times as the texts they were written as."""
    if isinstance(node, dict):
        return {key: _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(value) for value in node]
    return f"{node:%Y-%m-%dT%H:%M:%SZ}" if isinstance(node, datetime.datetime) else node


# --- changes of the tree

Place = tuple[Any, ...]


def _places(node: Any, place: Place = ()) -> Iterator[Place]:
    yield place
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from _places(value, (*place, key))


def _at(node: Any, place: Place) -> Any:
    for key in place:
        node = node[key]
    return node


class _Tree:
    """A scenario under change. raw: YAML that takes the place of texts."""

    def __init__(self, data: Any, draw: random.Random, others: list[Any]) -> None:
        self.data, self.draw, self.others = copy.deepcopy(data), draw, others
        self.raw: dict[str, str] = {}
        self.notes: list[str] = []

    def change(self) -> None:
        places = [place for place in _places(self.data) if place]
        leaves = [place for place in places if not isinstance(_at(self.data, place), (dict, list))]
        if leaves:
            change = self.draw.choice(_CHANGES)
            change(self, self.draw.choice(leaves), self.draw.choice(places))

    def put(self, place: Place, value: Any) -> None:
        self.notes.append(f"{'.'.join(map(str, place))[:60]} = {value!r:.60}")
        _at(self.data, place[:-1])[place[-1]] = value

    def number(self, leaf: Place, _: Place) -> None:
        self.put(leaf, self.draw.choice(NUMBERS))

    def scale(self, leaf: Place, _: Place) -> None:
        old = _at(self.data, leaf)
        if isinstance(old, (int, float)) and not isinstance(old, bool) and math.isfinite(old):
            new = old * self.draw.choice((-1, 0, 0.1, 0.5, 2, 10, 1e3, 1e-3, 1e6))
            whole = isinstance(old, int) and math.isfinite(new) and new == int(new)
            self.put(leaf, int(new) if whole else new)

    def text(self, leaf: Place, _: Place) -> None:
        self.put(leaf, self.draw.choice(TEXTS))

    def kind(self, _: Place, place: Place) -> None:
        self.put(place, copy.deepcopy(self.draw.choice(KINDS)))

    def drop(self, _: Place, place: Place) -> None:
        del _at(self.data, place[:-1])[place[-1]]
        self.notes.append(f"without {'.'.join(map(str, place))}")

    def rename(self, _: Place, place: Place) -> None:
        parent, old = _at(self.data, place[:-1]), place[-1]
        if isinstance(parent, dict):
            new = self.draw.choice((*KEYS, str(old)[:-1], f"{old}x", str(old).upper()))
            items = [(new if key == old else key, value) for key, value in parent.items()]
            parent.clear()
            parent.update(items)
            self.notes.append(f"{'.'.join(map(str, place))} renamed {new[:40]!r}")

    def graft(self, _: Place, place: Place) -> None:
        other = self.draw.choice(self.others)
        self.put(place, copy.deepcopy(_at(other, self.draw.choice(list(_places(other))))))

    def length(self, _: Place, place: Place) -> None:
        old = _at(self.data, place)
        self.put(place, old * self.draw.choice((0, 2, 100)) if isinstance(old, list) and old else [old])

    def yaml(self, leaf: Place, _: Place) -> None:
        self._in_place_of(leaf, self.draw.choice(RAW))

    def nest(self, leaf: Place, _: Place) -> None:
        depth = self.draw.choice((3, 50, 300, 900, 3000))
        self._in_place_of(leaf, "[" * depth + "]" * depth)

    def file(self, leaf: Place, place: Place) -> None:
        named = [p for p in _places(self.data) if p and FILE_KEYS & set(map(str, p))]
        self.put(self.draw.choice(named) if named else leaf, self.draw.choice(FILES))

    def _in_place_of(self, place: Place, raw: str) -> None:
        mark = f"RAW{len(self.raw)}WAR"
        self.raw[mark] = raw
        self.put(place, mark)
        self.notes.append(f"{mark} is {raw[:60]}")


_CHANGES: list[Callable[[_Tree, Place, Place], None]] = [
    *[_Tree.number] * 12, *[_Tree.scale] * 4, *[_Tree.text] * 8, *[_Tree.kind] * 8, *[_Tree.drop] * 8,
    *[_Tree.rename] * 8,
    *[_Tree.graft] * 8, *[_Tree.length] * 8, *[_Tree.yaml] * 12, _Tree.nest, *[_Tree.file] * 8,
]  # fmt: skip


def _of_tree(name: str, trees: dict[str, Any], draw: random.Random) -> Mutant:
    tree = _Tree(trees[name], draw, list(trees.values()))
    for _ in range(draw.choice((1, 1, 1, 1, 2, 3))):
        tree.change()
    text = dump(tree.data)
    for mark, raw in tree.raw.items():
        text = text.replace(mark, raw)
    return Mutant(name, "; ".join(tree.notes), text.encode("utf-8", "surrogatepass"), None if tree.raw else tree.data)


# --- changes of the text


def _of_text(name: str, text: bytes, draw: random.Random) -> Mutant:
    change = draw.choice(_TEXT_CHANGES)
    return Mutant(name, change.__name__.strip("_"), change(text, draw), None)


def _byte_order_mark(text: bytes, _: random.Random) -> bytes:
    return b"\xef\xbb\xbf" + text


def _line_ends(text: bytes, draw: random.Random) -> bytes:
    return text.replace(b"\n", draw.choice((b"\r\n", b"\r", b"\n\r", b"\x85", "\u2028".encode())))


def _encoding(text: bytes, draw: random.Random) -> bytes:
    return text.decode().encode(draw.choice(("utf-16", "utf-16-le", "utf-32", "cp037")))


def _cut(text: bytes, draw: random.Random) -> bytes:
    return text[: draw.randrange(len(text))]


def _bytes(text: bytes, draw: random.Random) -> bytes:
    content = bytearray(text)
    for _ in range(draw.choice((1, 1, 2, 8))):
        content[draw.randrange(len(content))] = draw.randrange(256)
    return bytes(content)


def _lines(text: bytes, draw: random.Random) -> bytes:
    lines = text.split(b"\n")
    i, j = draw.randrange(len(lines)), draw.randrange(len(lines))
    match draw.randrange(4):
        case 0:
            lines.insert(i, lines[j])
        case 1:
            lines[i], lines[j] = lines[j], lines[i]
        case 2:
            lines[i] = b"\t" + lines[i]
        case _:
            lines[i] = b" " * draw.randrange(6) + lines[i].lstrip()
    return b"\n".join(lines)


def _end(text: bytes, draw: random.Random) -> bytes:
    ends = (
        b"---\nkind: landing\n", b"x: \x00", b"# \xff\xfe", "x: \u2028\u2029\x85".encode(), b"x: \x1b[31m",
    b"%YAML 1.1\n", b"...\n",
        b"\x0c", b"\n_b: &b {x: 1}\nrunway:\n  <<: *b\n", b"\n? [a, b]\n: 1\n", b"\n? {a: 1}\n: 1\n",
    )  # fmt: skip
    return text + draw.choice(ends)


def _aliases(text: bytes, draw: random.Random) -> bytes:
    """A billion laughs."""
    levels = [b"\na0: &a0 [x,x,x,x,x,x,x,x]"]
    for k in range(1, draw.choice((5, 7, 9))):
        levels.append(b"a%d: &a%d [%s]" % (k, k, b",".join([b"*a%d" % (k - 1)] * 8)))
    return text + b"\n".join(levels) + b"\n"


def _depth(text: bytes, draw: random.Random) -> bytes:
    deep = (b"[" * 20000 + b"]" * 20000, b"{a: " * 5000 + b"1" + b"}" * 5000)
    return text + b"\nz: " + draw.choice(deep)


def _anchor(text: bytes, _: random.Random) -> bytes:
    return text.replace(b": ", b":  &x ", 1) + b"\ny: *x\n"


_TEXT_CHANGES: list[Callable[[bytes, random.Random], bytes]] = [
    _byte_order_mark, _line_ends, _encoding, *[_cut] * 3, *[_bytes] * 4, *[_lines] * 6, *[_end] * 3, _aliases, _depth,
    _anchor,
]  # fmt: skip
