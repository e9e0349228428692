"""Keys of scenario files as rows: read from a JSON Schema, shown by `navsim keys`, completion, and the reference pages.

Imports no model: any schema will do, from `json_schema` or from a file.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from navsim.formats.units import unit_of
from navsim.statistics.rounding import digits

Schema = Mapping[str, Any]

ITEM, NAME = "N", "NAME"
"""Placeholders in a dotted key for the number of an item of a list (from 0), and for a name that the user gives."""


@dataclass(frozen=True)
class KeyRow:
    """A key of a scenario."""

    key: str
    """Dotted, as for `--set` once `ITEM` and `NAME` are replaced."""
    section: bool
    """It has keys of its own, which follow."""
    kind: str
    """Type of its value, in words."""
    unit: str
    """"" for none."""
    range: str
    """Allowed numbers or lengths, "" for any."""
    choices: tuple[Any, ...]
    """Allowed values, () for any."""
    required: bool
    """It has no default."""
    default: Any
    """If it has one."""
    meaning: str
    """From the schema, one line."""
    when: tuple[str, ...] = ()
    """Conditions on other keys for this key to exist, () for always."""

    def facts(self) -> str:
        """All but the key and its meaning, in a line."""
        number = f"number, {self.range}, or " if self.choices and self.range else ""
        parts = [self.kind if not self.choices else f"{number}one of {', '.join(map(_plain, self.choices))}"]
        parts += [part for part in (self.unit, "" if number else self.range) if part]
        if self.required:
            parts.append("required")
        elif not self.section:
            parts.append(f"default {_plain(self.default)}")
        parts += [f"with {condition}" for condition in self.when]
        return "; ".join(parts)


def _plain(value: Any) -> str:
    """A value as YAML has it, in a line."""
    return value if isinstance(value, str) and value else json.dumps(value, ensure_ascii=False)


def rows(schema: Schema) -> list[KeyRow]:
    """All keys of a kind of file, each section before its keys, in the order of the schema."""
    return list(_properties(schema, schema, "", {}))


def matching(all_rows: Sequence[KeyRow], word: str) -> list[KeyRow]:
    """Rows whose key or meaning contains the word, in any case."""
    low = word.lower()
    return [row for row in all_rows if low in row.key.lower() or low in row.meaning.lower()]


def nearest(all_rows: Sequence[KeyRow], word: str, most: int = 5) -> list[str]:
    """Keys that are most similar to a word, as a whole, or in their last name or a part of it."""
    by_name: dict[str, list[str]] = {}
    for row in all_rows:
        last = row.key.rpartition(".")[2]
        for name in dict.fromkeys((row.key, last, *last.split("_"))):
            by_name.setdefault(name, []).append(row.key)
    found = difflib.get_close_matches(word, by_name, n=most, cutoff=0.6)
    return list(dict.fromkeys(key for name in found for key in by_name[name]))[:most]


def _properties(schema: Schema, node: Schema, prefix: str, above: Mapping[str, Any]) -> Iterator[KeyRow]:
    """Keys of a section.

    schema: the whole, for references. node: of the section. above: defaults of its keys if the section that contains it
    sets them.
    """
    required = node.get("required", ())
    for name, written in node.get("properties", {}).items():
        own = {**written, "default": above[name]} if above.get(name) is not None else written
        yield from _key(schema, own, prefix + name, name in required)
    further = node.get("additionalProperties")
    if isinstance(further, Mapping):
        yield from _key(schema, further, prefix + NAME, False)


def _key(schema: Schema, written: Schema, key: str, required: bool) -> Iterator[KeyRow]:
    forms = [_resolved(schema, form) for form in _forms(schema, written)]
    plain = [form for form in forms if form.get("type") != "null"]
    below = list(_below(schema, written, plain, key))
    choices = tuple(choice for form in forms for choice in _choices(form))
    kinds = list(dict.fromkeys(_kind(schema, form) for form in forms))
    yield KeyRow(
        key=key,
        section=bool(below),
        kind=" or ".join(kinds),
        unit=unit_of(key),
        range=next((text for form in plain if (text := _range(schema, form))), ""),
        choices=choices,
        required=required and "default" not in written,
        default=None if below else written.get("default"),
        meaning=" ".join(str(_meaning(schema, written, plain)).split()),
    )
    yield from below


def _meaning(schema: Schema, written: Schema, forms: Sequence[Schema]) -> str:
    """Meaning of the key itself, else of its one section."""
    if "description" in written or len(forms) != 1:
        return str(written.get("description", ""))
    (form,) = forms
    item = _resolved(schema, form.get("items", {})) if form.get("type") == "array" else form
    return str(item.get("description", ""))


def _below(schema: Schema, written: Schema, forms: Sequence[Schema], key: str) -> Iterator[KeyRow]:
    """The keys within a key: of a section, of the items of a list, of sections to choose from."""
    sections: list[tuple[str, Schema]] = []
    for form in forms:
        prefix = f"{key}."
        inner: Schema = form
        if form.get("type") == "array" and "items" in form:
            prefix, inner = f"{key}.{ITEM}.", form["items"]
        for one in _forms(schema, inner):
            found = _resolved(schema, one)
            if found.get("type") == "object":
                sections.append((prefix, found))
    tag = _tag(written) or next((t for form in forms if (t := _tag(form.get("items", {})))), "")
    given = written.get("default")
    # with several sections to choose from, the default is that of one; a preset supplies its own values
    alone = len(sections) == 1 and isinstance(given, Mapping) and "preset" not in sections[0][1].get("properties", {})
    above = given if alone and isinstance(given, Mapping) else {}
    variants = [(prefix, section, list(_properties(schema, section, prefix, above))) for prefix, section in sections]
    if len(variants) < 2 or not tag:
        for _, _, found_rows in variants:
            yield from found_rows
        return
    prefix = variants[0][0]
    tags = [_choices(section["properties"][tag]) for _, section, _ in variants]
    merged: list[tuple[KeyRow, list[str]]] = []
    for (_, _, found_rows), values in zip(variants, tags, strict=True):
        for row in found_rows:
            if row.key == prefix + tag:
                continue
            same = next((known for one, known in merged if one == row), None)
            if same is None:
                merged.append((row, same := []))
            same.extend(map(str, values))
    first = next(row for row in variants[0][2] if row.key == prefix + tag)
    chosen = tuple(value for values in tags for value in values)
    said = {str(value): row.meaning for (_, _, found_rows), values in zip(variants, tags, strict=True)
            for row in found_rows if row.key == first.key for value in values}  # fmt: skip
    values_of: dict[str, list[str]] = {}
    for value, text in said.items():
        values_of.setdefault(text, []).append(f"`{value}`")
    meaning = ". ".join(f"{', '.join(values)}: {text}" for text, values in values_of.items())
    meaning = first.meaning if len(values_of) == 1 else meaning
    yield replace(first, choices=chosen, kind="choice", meaning=meaning)
    for row, named in merged:
        always = len(named) == len(chosen)
        yield row if always else replace(row, when=(f"{prefix}{tag}: {', '.join(named)}", *row.when))


def _tag(node: Schema) -> str:
    """The key that chooses among sections, "" for none."""
    return str(node.get("discriminator", {}).get("propertyName", ""))


def _forms(schema: Schema, node: Schema) -> list[Schema]:
    """The forms a value may have, unions within unions flattened."""
    found = _resolved(schema, node)
    for union in ("anyOf", "oneOf"):
        if union in found:
            return [form for one in found[union] for form in _forms(schema, one)]
    return [found]


def _resolved(schema: Schema, node: Schema) -> Schema:
    """The node, or the definition that it refers to."""
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _choices(form: Schema) -> list[Any]:
    return [form["const"]] if "const" in form else list(form.get("enum", ()))


def _kind(schema: Schema, form: Schema) -> str:
    """Type of a value, in words."""
    if "const" in form or "enum" in form:
        return "choice"
    given = form.get("type")
    if given == "array":
        if "prefixItems" in form:
            return f"list of {len(form['prefixItems'])}"
        items = {_kind(schema, one) for one in _forms(schema, form.get("items", {}))}
        return f"list of {_PLURAL[items.pop()]}" if len(items) == 1 and items <= _PLURAL.keys() else "list"
    if given == "string":
        return "time, UTC" if form.get("format") == "date-time" else "text"
    return _WORDS.get(str(given), "any")


_WORDS = {
    "number": "number", "integer": "whole number", "boolean": "true or false", "null": "null", "object": "section",
}  # fmt: skip
_PLURAL = {
    "number": "numbers", "whole number": "whole numbers", "text": "texts", "section": "sections", "choice": "choices",
}  # fmt: skip


def _range(schema: Schema, form: Schema) -> str:
    """The numbers that are allowed, those of the items of a list; and how many there may be."""
    if form.get("type") == "array":
        items = form.get("prefixItems") or [form["items"]] if {"items", "prefixItems"} & form.keys() else []
        found = [_range(schema, one) for item in items[:1] for one in _forms(schema, item)]
        count = _ends(form.get("minItems"), form.get("maxItems"), str) if "prefixItems" not in form else ""
        return "; ".join(text for text in (next(filter(None, found), ""), f"{count} of them" if count else "") if text)
    low, high = form.get("minimum"), form.get("maximum")
    above, below = form.get("exclusiveMinimum"), form.get("exclusiveMaximum")
    if above is not None or below is not None:
        parts = [(above, "above "), (low, "from "), (high, "to "), (below, "below ")]
        return " ".join(f"{word}{number(value)}" for value, word in parts if value is not None)
    return _ends(low, high, number)


def number(value: float) -> str:
    """A number as text."""
    return digits(value, 6)


def _ends(low: float | None, high: float | None, text: Callable[[float], str]) -> str:
    if low is not None and high is not None:
        return f"{text(low)} to {text(high)}"
    if low is None and high is None:
        return ""
    return f"{text(low)} or more" if low is not None else f"at most {text(high or 0)}"
