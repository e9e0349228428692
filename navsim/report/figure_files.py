"""Figures on disk: each contains the name of its result in its text, so that it is deleted with that result."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path
from urllib.parse import quote, unquote

from navsim.results import files
from navsim.results.result import ResultError

MARK = "navsim result"
"""Keyword of the PNG text that holds the stem of the result's name."""
_OF_TEXT = re.compile(rb"navsim result: ([A-Za-z0-9%._~-]+);")
_ENDS = 65536
"""Bytes at the beginning and end of a file that are searched for the mark: SVG has it at the beginning, PDF at
either."""


def mark_of_text(stem: str) -> str:
    """The mark of a figure in SVG or PDF: all of it ASCII that neither escapes."""
    return f"{MARK}: {quote(stem, safe='')};"


def remove_former(
    folder: Path, stem: str, kept: Collection[Path] = (), formats: Collection[str] = ("png", "svg", "pdf")
) -> None:
    """Remove the figures of an earlier result of this stem from a folder, of these formats, except those kept.

    Files without the mark, and those of other stems that begin alike, are not touched. Raises ResultError.
    """
    present = {path.resolve() for path in kept}
    for path in (path for ending in formats for path in folder.glob(f"*.{ending}")):
        if path.name.startswith(f"{stem}_") and path.resolve() not in present and _mark(path) == stem:
            try:
                path.unlink()
            except OSError as error:
                raise ResultError(f"{path}: an old figure cannot be removed: {error.strerror or error}") from None


def _mark(path: Path) -> str | None:
    """Stem of a picture's result; None for a picture that navsim did not write, whatever its name."""
    return _mark_of_png(path) if path.suffix == ".png" else _mark_of_text(path)


def _mark_of_text(path: Path) -> str | None:
    try:
        with files.open_regular(path) as file:
            begin = file.read(_ENDS)
            file.seek(max(0, path.stat().st_size - _ENDS))
            found = _OF_TEXT.search(begin) or _OF_TEXT.search(file.read(_ENDS))
    except OSError:
        return None
    return None if found is None else unquote(found[1].decode("ascii"))


def _mark_of_png(path: Path) -> str | None:
    from PIL import Image

    try:
        with files.open_regular(path) as file, Image.open(file) as image:
            found = image.info.get(MARK)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None  # no picture, a damaged or a huge one: ours can be opened
    return None if found is None else str(found)
