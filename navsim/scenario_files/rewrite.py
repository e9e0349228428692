"""Change values in a scenario's text; comments, order and all other keys stay as written.

The parser's positions of nodes locate the values. Every new text is read again before it is returned. If it does not
have the intended content, a section or the whole text is written anew.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from navsim.formats.yaml_text import dump
from navsim.scenario_files.source import InputError, compose, parse

_BESIDE = 2
"""Indentation of the value of a key, columns."""


@dataclass(frozen=True)
class Rewritten:
    """A text, and whether comments may have been lost in it: in one of its sections, or in all."""

    text: str
    lost: bool


@dataclass(frozen=True)
class _Piece:
    """Characters start ... end - 1 of a text, and their replacement."""

    start: int
    end: int
    text: str


class _Entangled(Exception):
    """A change that cannot be made line by line."""


def rewritten(text: str, after: dict[str, Any]) -> Rewritten:
    """The YAML text, changed to mean `after`.

    Raises InputError for text that is not YAML.
    """
    before = parse(text, "", Path()).data
    if _same(before, after):
        return Rewritten(text, lost=False)
    root = compose(text)
    assert isinstance(root, yaml.MappingNode)
    for lost, pieces in ((False, _changes), (True, _sections)):
        try:
            found = _put(text, list(pieces(_Text(text), root, before, after)))
        except _Entangled:
            continue
        if _says(found, after):
            return Rewritten(found, lost)
    return Rewritten(dump(after), lost=True)


def _says(text: str, data: Any) -> bool:
    try:
        return _same(parse(text, "", Path()).data, data)
    except InputError:
        return False


def _same(one: Any, other: Any) -> bool:
    """Equality with distinct integers, other numbers and booleans."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return set(one) == set(other) and all(_same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)


def _put(text: str, pieces: list[_Piece]) -> str:
    """The text with its pieces put in; those at the same place one after the other."""
    at = len(text)
    for piece in sorted(pieces, key=lambda each: (each.start, each.end), reverse=True):
        if piece.end > at:
            raise _Entangled
        text = text[: piece.start] + piece.text + text[piece.end :]
        at = piece.start
    return text


class _Text:
    """A text and its lines."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.end_of_line = "\r\n" if "\r\n" in text else "\n"

    def line(self, at: int) -> int:
        """Start of the line that contains a character."""
        return self.text.rfind("\n", 0, at) + 1

    def after(self, at: int) -> int:
        """Start of the line after it."""
        end = self.text.find("\n", at)
        return len(self.text) if end < 0 else end + 1

    def begins(self, at: int, opening: str = " ") -> bool:
        """Whether only these characters precede a character in its line."""
        return not self.text[self.line(at) : at].strip(opening)

    def lines(self, at: int, text: list[str]) -> _Piece:
        """Lines put in where the line after a character begins."""
        at = self.after(at)
        open_end = at == len(self.text) and self.text and not self.text.endswith("\n")
        return _Piece(at, at, (self.end_of_line if open_end else "") + "".join(s + self.end_of_line for s in text))


def _end(node: yaml.Node) -> int:
    """End of a node; the parser includes blank lines and comments after a block."""
    below = [n for pair in node.value for n in pair] if isinstance(node, yaml.MappingNode) else node.value
    if not isinstance(node, yaml.CollectionNode) or node.flow_style or not below:
        end: int = node.end_mark.index
        return end
    return max(map(_end, below))


def _changes(of: _Text, node: yaml.Node, before: Any, after: Any) -> Iterator[_Piece]:
    """Smallest changes that turn a node with the content `before` into `after`."""
    if _same(before, after):
        return
    if isinstance(node, yaml.MappingNode) and isinstance(after, dict) and not node.flow_style and after:
        yield from _of_mapping(of, node, before, after)
    elif isinstance(node, yaml.MappingNode) and isinstance(after, dict) and set(before) == set(after):
        for key, value in node.value:
            yield from _changes(of, value, before[key.value], after[key.value])
    elif isinstance(node, yaml.SequenceNode) and isinstance(after, list) and after:
        yield from _of_list(of, node, before, after)
    else:
        yield _replace_node(of, node, after)


def _replace_node(of: _Text, node: yaml.Node, after: Any) -> _Piece:
    start, end = node.start_mark.index, _end(node)
    before = of.text[start - 1 : start]
    return _Piece(start, end, ("" if before in (" ", "\n", "", "[", "{") else " ") + inline(after))


def _of_mapping(of: _Text, node: yaml.MappingNode, before: Any, after: Any) -> Iterator[_Piece]:
    kept = 0
    for key, value in node.value:
        if key.value in after:
            kept += 1
            yield from _changes(of, value, before[key.value], after[key.value])
        elif of.begins(key.start_mark.index):
            yield _Piece(of.line(key.start_mark.index), of.after(max(key.end_mark.index, _end(value))), "")
        else:
            raise _Entangled
    if not kept:
        raise _Entangled
    column = node.value[0][0].start_mark.column
    text = [line for key in after if key not in before for line in block(key, after[key], column)]
    if text:
        yield of.lines(_end(node) - 1, text)


def _of_list(of: _Text, node: yaml.SequenceNode, before: list[Any], after: list[Any]) -> Iterator[_Piece]:
    if node.flow_style and len(before) != len(after):
        yield _replace_node(of, node, after)
        return
    if len(after) == len(before) - 1:
        gone, pieces = _least(of, node, before, after)
        item = node.value[gone]
        if not of.begins(item.start_mark.index, " -"):
            raise _Entangled
        yield from pieces
        yield _Piece(of.line(item.start_mark.index), of.after(_end(item)), "")
        return
    if len(after) < len(before):
        raise _Entangled
    for item, old, new in zip(node.value, before, after, strict=False):
        yield from _changes(of, item, old, new)
    if len(after) > len(before):
        first = node.value[0].start_mark.index
        if not of.begins(first, " -"):
            raise _Entangled
        indent = of.text[of.line(first) : first].index("-")
        yield of.lines(_end(node) - 1, [" " * indent + "- " + inline(new) for new in after[len(before) :]])


def _least(of: _Text, node: yaml.SequenceNode, before: list[Any], after: list[Any]) -> tuple[int, list[_Piece]]:
    """Item to remove if one is missing, and the other changes: the choice with the fewest changes."""
    ways = []
    for gone in range(len(before)):
        rest = [i for i in range(len(before)) if i != gone]
        try:
            pieces = [
                piece for i, new in zip(rest, after, strict=True)
                for piece in _changes(of, node.value[i], before[i], new)
            ]  # fmt: skip
        except _Entangled:
            continue
        ways.append((len(pieces), gone, pieces))
    if not ways:
        raise _Entangled
    _, gone, pieces = min(ways, key=lambda way: way[:2])
    return gone, pieces


def _sections(of: _Text, node: yaml.MappingNode, before: Any, after: Any) -> Iterator[_Piece]:
    """Changes that write every changed section anew, and keep the others."""
    if node.flow_style:
        raise _Entangled
    for key, value in node.value:
        if key.value in after and _same(before[key.value], after[key.value]):
            continue
        text = block(key.value, after[key.value], 0) if key.value in after else []
        end = of.after(max(key.end_mark.index, _end(value)))
        yield _Piece(of.line(key.start_mark.index), end, "".join(line + of.end_of_line for line in text))
    text = [line for key in after if key not in before for line in block(key, after[key], 0)]
    if text:
        yield of.lines(_end(node) - 1, text)


def block(key: str, value: Any, column: int) -> list[str]:
    """Lines of a key and its value, lists with a line for each item."""
    before = " " * column
    if isinstance(value, list) and value and all(isinstance(item, (dict, list)) for item in value):
        return [f"{before}{inline(key)}:", *(f"{before}{' ' * _BESIDE}- {inline(item)}" for item in value)]
    if isinstance(value, dict) and value and column == 0:
        return [f"{inline(key)}:", *(line for name in value for line in block(name, value[name], _BESIDE))]
    return [f"{before}{inline(key)}: {inline(value)}"]


_FLOW = re.compile(r"[,\[\]{}#&*!|>'\"%@`:?]|^[-\s]|\s$")
"""Characters that a plain scalar must not contain, to be safe anywhere."""


def inline(value: Any) -> str:
    """A value in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{inline(key)}: {inline(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, str) and (not _FLOW.search(value) or re.fullmatch(r"[\dT:.-]+Z", value)):
        node = compose(value)
        if isinstance(node, yaml.ScalarNode) and node.tag.endswith(":str"):
            return value
    return dump(value, default_flow_style=True, width=float("inf")).removesuffix("\n").removesuffix("\n...")
