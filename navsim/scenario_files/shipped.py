"""The shipped scenarios and the data they name: `scenarios/` of the tree, packed into the wheel as `templates`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

_PACKED = Path(__file__).resolve().parent / "templates"
_IN_TREE = Path(__file__).resolve().parents[2] / "scenarios"


def _folder() -> Path:
    return _PACKED if _PACKED.is_dir() else _IN_TREE


def names() -> list[str]:
    """Names of the templates."""
    return sorted(path.stem for path in _folder().glob("*.yaml"))


def text(name: str) -> str:
    """The text of one template."""
    return path(name).read_text(encoding="utf-8")


def path(name: str) -> Path:
    """The file of one template."""
    return _folder() / f"{name}.yaml"


def kind(name: str) -> str:
    """The kind of one template."""
    return str(_data(name)["kind"])


def needs(name: str) -> list[str]:
    """Shipped files that a template names, and those that these name in turn, relative to the template."""
    found: list[str] = []
    for value in _values(_data(name)):
        if value not in found and (_folder() / value).is_file():
            further = needs(Path(value).stem) if value.endswith(".yaml") else []
            found += [value, *(other for other in further if other not in found)]
    return found


def content(file: str) -> bytes:
    """Content of a file of `needs`."""
    return (_folder() / file).read_bytes()


def _data(name: str) -> Any:
    import yaml

    return yaml.safe_load(text(name))


def _values(node: Any) -> Iterator[str]:
    """All text values of a tree."""
    if isinstance(node, dict):
        node = list(node.values())
    if isinstance(node, list):
        for child in node:
            yield from _values(child)
    elif isinstance(node, str):
        yield node
