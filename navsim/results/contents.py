"""Digests of the contents of a result: one for each variable and root attribute, whatever the layout of the file.

`results.result` writes them into the root attribute `contents`, so that `navsim verify` can name what was changed in a
file afterwards. Whoever changes a file can also write new digests. So digests find changes, and flying again finds
forgeries.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

_DIGITS = 32
"""Hexadecimal digits of a digest: 128 bits of SHA-256."""


class VariableDigest:
    """Digest of a variable whose data come block by block."""

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any], dims: tuple[str, ...], about: Mapping[str, Any]):
        """about: its attributes, units and long name among them."""
        self._dtype, self._text = dtype, dtype.kind in "UO"
        head = [list(shape), "text" if self._text else dtype.str, list(dims), _plain(about)]
        self._sum = hashlib.sha256(json.dumps(head, sort_keys=True).encode())

    def add(self, block: np.ndarray) -> None:
        """Add the next rows."""
        if self._text:
            self._sum.update(json.dumps([str(value) for value in block.reshape(-1).tolist()])[1:-1].encode())
        else:
            self._sum.update(np.ascontiguousarray(block, self._dtype).reshape(-1).view(np.uint8).data)

    def text(self) -> str:
        return self._sum.hexdigest()[:_DIGITS]


def attribute_digest(value: object) -> str:
    """Digest of a root attribute."""
    return hashlib.sha256(json.dumps(_plain(value)).encode()).hexdigest()[:_DIGITS]


def _plain(value: Any) -> Any:
    """An attribute as it is read back: an array of one value is that value."""
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, str):
        return str(value)
    array = np.asarray(value)
    return array.reshape(-1)[0].item() if array.size == 1 else array.tolist()
