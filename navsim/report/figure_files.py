"""Figures on disk: each says in its own text which result it is of, so that it goes when that result goes."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from navsim.io.results import ResultError

MARK = "navsim result"
"""Keyword of the PNG text that holds the stem of the result's name."""


def remove_former(folder: Path, stem: str, kept: Collection[Path] = ()) -> None:
    """Remove the figures of an earlier result of this stem from a folder, but for those kept.

    Files without the mark, and those of other stems that begin alike, are not touched. Raises ResultError.
    """
    from PIL import Image, UnidentifiedImageError

    present = {path.resolve() for path in kept}
    try:
        for path in folder.glob("*.png"):
            if not path.name.startswith(f"{stem}_") or path.resolve() in present or not path.is_file():
                continue
            try:
                with Image.open(path) as image:
                    ours = image.info.get(MARK) == stem
            except UnidentifiedImageError:
                continue  # another program's, whatever its name says
            if ours:
                path.unlink()
    except OSError as error:
        raise ResultError(f"{folder}: old figures cannot be removed: {error.strerror or error}") from None
