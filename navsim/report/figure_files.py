"""Figures on disk: each says in its own text which result it is of, so that it goes when that result goes."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from navsim.io import files
from navsim.io.results import ResultError

MARK = "navsim result"
"""Keyword of the PNG text that holds the stem of the result's name."""


def remove_former(folder: Path, stem: str, kept: Collection[Path] = ()) -> None:
    """Remove the figures of an earlier result of this stem from a folder, but for those kept.

    Files without the mark, and those of other stems that begin alike, are not touched. Raises ResultError.
    """
    present = {path.resolve() for path in kept}
    for path in folder.glob("*.png"):
        if path.name.startswith(f"{stem}_") and path.resolve() not in present and _mark(path) == stem:
            try:
                path.unlink()
            except OSError as error:
                raise ResultError(f"{path}: an old figure cannot be removed: {error.strerror or error}") from None


def _mark(path: Path) -> str | None:
    """The stem of the result a picture is of; None for what is no picture of navsim's, whatever its name says."""
    from PIL import Image

    try:
        with files.opened(path) as file, Image.open(file) as image:
            found = image.info.get(MARK)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None  # no picture, a damaged or a huge one: ours can be opened
    return None if found is None else str(found)
