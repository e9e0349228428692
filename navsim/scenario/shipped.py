"""The shipped scenarios: `scenarios/*.yaml` of the source tree, packed into the wheel as `templates`."""

from __future__ import annotations

from pathlib import Path

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
