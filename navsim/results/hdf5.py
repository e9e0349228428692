"""Check of an untrusted HDF5 file before any of it is read.

HDF5 can point outside of its file (external links and storage, virtual datasets) and to itself (soft links, several
hard links). It can also declare more than it contains: compression, chunks never written, shared text. navsim writes
none of it. So one rule bounds what reading takes: everything that a file declares fits into the file.
"""

from __future__ import annotations

import contextlib
import math
import re
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5i, h5l, h5o, h5r, h5s, h5t, h5z

from navsim.results.checksum import CorruptFile, Reader

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of every HDF5 file of navsim (HDF5 File Format Specification, section II.A)."""
MOST_DEPTH, MOST_OBJECTS, MOST_RANK, MOST_ATTRIBUTES, MOST_VALUES = 8, 10_000, 8, 100, 4096
"""Groups one in another; groups and datasets of a file; axes; attributes of an object, and values of one of them."""
_NUMBERS = {h5t.INTEGER: (1, 2, 4, 8), h5t.FLOAT: (4, 8)}
"""Sizes of numbers, bytes."""
_LAYOUTS = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED)
_POINTERS = ("DIMENSION_LIST", "REFERENCE_LIST")
_HIDDEN = (*_POINTERS, "CLASS", "NAME", "_Netcdf4Dimid", "_Netcdf4Coordinates", "_NCProperties")
"""Attributes that only dimension scales and netCDF-4 need."""
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters, which may act on a terminal."""
_AT_ONCE = 64e6
"""Bytes of text that may be read before it is counted."""


@dataclass(frozen=True)
class Dataset:
    """A checked dataset that is not yet read. dims: names of its axes. attributes: those that netCDF-4 does not
    hide."""

    path: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    dims: tuple[str, ...]
    attributes: dict[str, Any]


@dataclass
class _PendingDataset:
    """A dataset whose dimensions are known when all are seen. needed: bytes of its data in the file."""

    id: Any
    shape: tuple[int, ...]
    needed: int
    attributes: dict[str, Any]
    scale: bool


class Tree:
    """An open HDF5 file: its root attributes, and its datasets by path. Every method raises Damaged."""

    def __init__(self, file: BinaryIO) -> None:
        """file: open for reading, and the tree's own from now on."""
        try:
            self._source = Reader(file)
        except BaseException:
            file.close()
            raise
        self._left = self._source.size
        self._in_plane: dict[str, _PendingDataset] = {}
        try:
            with self._guarded():
                self._file = h5py.File(self._source, "r")
        except BaseException:
            self._source.close()
            raise
        # at the latest before the interpreter ends: HDF5 must not call into Python any more then
        weakref.finalize(self, _close, self._file, self._source)

    @property
    def sealed(self) -> bool:
        """Whether the file has checksums; then all that is read of it is checked."""
        return self._source.sealed

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """HDF5's errors as Damaged, those it keeps to itself too."""
        try:
            yield
        except (OSError, RuntimeError, ValueError, TypeError, KeyError, OverflowError) as error:
            text = self._source.damage or (str(error).splitlines() or [type(error).__name__])[0]
            raise CorruptFile(text) from None
        if self._source.damage is not None:
            raise CorruptFile(self._source.damage)

    def _spend(self, size: int, path: str) -> None:
        """Count declared bytes. Raises Damaged if they exceed the file."""
        self._left -= size
        if self._left < 0:
            raise CorruptFile(f"{path}: declares more data than the file can hold")

    @cached_property
    def attributes(self) -> dict[str, Any]:
        """Root attributes: numbers, arrays of them, text, lists of texts."""
        with self._guarded():
            return self._attributes(self._file.id, "/")

    @cached_property
    def datasets(self) -> dict[str, Dataset]:
        """All datasets, sorted, groups depth first."""
        with self._guarded():
            paths: dict[int, str] = {}
            self._walk(h5g.open(self._file.id, b"/"), "", 0, paths)
            return {path: self._dataset(path, seen, paths) for path, seen in self._in_plane.items()}

    def length(self, name: str) -> int | None:
        """Rows of a dataset of the root group, found without looking at others; None if it is missing."""
        with self._guarded():
            root = h5g.open(self._file.id, b"/")
            if name.encode() not in root:
                return None
            node = _child(root, name.encode(), f"/{name}")
            shape = self._judged(node, f"/{name}").shape if h5i.get_type(node) == h5i.DATASET else ()
        if not shape:
            raise CorruptFile(f"/{name}: has no rows")
        return shape[0]

    def _walk(self, group: Any, path: str, depth: int, paths: dict[int, str]) -> None:
        """Check a group and everything below it. paths: of all objects met so far by their addresses."""
        self._meet(group, path or "/", paths)
        if depth > MOST_DEPTH:
            raise CorruptFile(f"{path}: groups more than {MOST_DEPTH} one in another")
        if len(paths) + group.get_num_objs() > MOST_OBJECTS:
            raise CorruptFile(f"more than {MOST_OBJECTS} groups and datasets")
        for name in sorted(group):
            below = f"{path}/{_text(name, path or '/')}"
            node = _child(group, name, below)
            kind = h5i.get_type(node)
            if kind == h5i.GROUP:
                self._walk(node, below, depth + 1, paths)
            elif kind == h5i.DATASET:
                self._meet(node, below, paths)
                self._in_plane[below] = self._judged(node, below)
            else:
                raise CorruptFile(f"{below}: neither a group nor a dataset")

    def _meet(self, node: Any, path: str, paths: dict[int, str]) -> None:
        address = h5o.get_info(node).addr
        if address in paths:
            raise CorruptFile(f"{path}: is a second name of {paths[address]}")
        paths[address] = path

    def _judged(self, node: Any, path: str) -> _PendingDataset:
        """Declaration of a dataset. Raises Damaged for all that navsim does not write."""
        made = node.get_create_plist()
        if made.get_layout() not in _LAYOUTS or made.get_external_count():
            raise CorruptFile(f"{path}: its data are outside of the file")
        if any(made.get_filter(i)[0] != h5z.FILTER_FLETCHER32 for i in range(made.get_nfilters())):
            raise CorruptFile(f"{path}: is compressed, or passed another filter than checksums")
        width = _width(node.get_type(), path)
        shape = _shape(node.get_space(), path)
        if len(shape) > MOST_RANK:
            raise CorruptFile(f"{path}: has {len(shape)} axes")
        needed = width * math.prod(shape)
        if made.get_layout() == h5d.CHUNKED and needed:
            chunk = made.get_chunk()
            needed = width * math.prod(-(-n // c) * c for n, c in zip(shape, chunk, strict=True))
        self._spend(needed, path)
        attributes = self._attributes(node, path)
        scale = attributes.get("CLASS") == "DIMENSION_SCALE"
        return _PendingDataset(node, shape, needed, attributes, scale)

    def _dataset(self, path: str, seen: _PendingDataset, paths: dict[int, str]) -> Dataset:
        """A checked dataset with the names of its axes, which are scales of the same lengths in the same file."""
        dims: list[str] = []
        for axis, scale in enumerate([path] if seen.scale else self._scales(path, seen, paths)):
            found = self._in_plane.get(scale)
            if len(seen.shape) <= axis or found is None or not found.scale or found.shape != (seen.shape[axis],):
                raise CorruptFile(f"{path}: its shape is not that of its dimensions")
            dims.append(scale.rpartition("/")[2])
        if len(dims) != len(seen.shape):
            raise CorruptFile(f"{path}: its shape is not that of its dimensions")
        kept = {name: value for name, value in seen.attributes.items() if name not in _HIDDEN}
        kind = seen.id.get_type()
        dtype = np.dtype(object) if kind.get_class() == h5t.STRING else kind.dtype
        return Dataset(path, seen.shape, dtype, tuple(dims), kept)

    def _scales(self, path: str, seen: _PendingDataset, paths: dict[int, str]) -> list[str]:
        """Paths of the scales that a dataset's axes are attached to."""
        if not seen.shape:
            return []
        if not h5a.exists(seen.id, b"DIMENSION_LIST"):
            raise CorruptFile(f"{path}: its dimensions have no names")
        attribute = h5a.open(seen.id, b"DIMENSION_LIST")
        kind = attribute.get_type()
        plain = kind.get_class() == h5t.VLEN and kind.get_super().equal(h5t.STD_REF_OBJ)
        if not plain or attribute.shape != (len(seen.shape),):
            raise CorruptFile(f"{path}: its dimensions are damaged")
        found, listed = [], np.empty(attribute.shape, kind.dtype)
        attribute.read(listed)
        for references in listed:
            if len(references) != 1:
                raise CorruptFile(f"{path}: an axis has {len(references)} names")
            target = h5r.dereference(references[0], self._file.id)
            found.append(paths.get(h5o.get_info(target).addr, "") if target is not None else "")
        return found

    def _attributes(self, node: Any, path: str) -> dict[str, Any]:
        count = h5a.get_num_attrs(node)
        if count > MOST_ATTRIBUTES:
            raise CorruptFile(f"{path}: has {count} attributes")
        found = {}
        for i in range(count):
            attribute = h5a.open(node, index=i)
            name = _text(attribute.name, path)
            if name not in _POINTERS:
                found[name] = self._value(attribute, f"{path}@{name}")
        return found

    def _value(self, attribute: Any, path: str) -> Any:
        """An attribute: a number, an array, a text, or a list of texts."""
        kind = attribute.get_type()
        width = _width(kind, path, fixed=True)
        shape = _shape(attribute.get_space(), path)
        count = math.prod(shape)
        if not 0 < count <= MOST_VALUES:
            raise CorruptFile(f"{path}: has {count} values")
        # texts may share their place in the file: their total size is known when they are read
        if kind.get_class() == h5t.STRING and count > 1 and count * self._source.size > _AT_ONCE:
            raise CorruptFile(f"{path}: has {count} texts")
        values = np.empty(shape, kind.dtype)
        attribute.read(values)
        flat = values.reshape(-1)
        if kind.get_class() == h5t.STRING:
            texts = [_text(value, path) for value in flat.tolist()]
            self._spend(sum(map(len, texts)), path)
            return texts[0] if count == 1 else texts
        self._spend(width * count, path)
        return flat[0] if count == 1 else values

    def read(self, path: str, first: int = 0, last: int | None = None) -> np.ndarray:
        """Read a dataset, or its rows first ... last - 1."""
        seen = self._in_plane[path]
        with self._guarded():
            if seen.id.get_storage_size() < seen.needed:
                raise CorruptFile(f"{path}: declares more data than it has")
            node = h5py.Dataset(seen.id)
            if not seen.shape:
                text = node.dtype.kind == "O"
                return np.array(_text(node[()], path), dtype=object) if text else np.asarray(node[()])
            last = seen.shape[0] if last is None else last
            if node.dtype.kind == "O":
                return self._texts(node, path, first, last)
            return np.asarray(node[first:last])

    def _texts(self, node: Any, path: str, first: int, last: int) -> np.ndarray:
        """Rows of texts. Several can share one place in the file, so their size is counted while they are read."""
        row = math.prod(node.shape[1:])
        step = int(max(1, _AT_ONCE // max(1, row * self._source.size)))
        parts = [np.empty((0, *node.shape[1:]), dtype=object)]
        left = self._source.size
        for start in range(first, last, step):
            part = node.asstr()[start : min(start + step, last)]
            left -= sum(len(_text(value, path)) for value in part.ravel().tolist())
            if left < 0:
                raise CorruptFile(f"{path}: declares more text than the file can hold")
            parts.append(part)
        return np.concatenate(parts)


def _close(file: Any, source: Reader) -> None:
    with contextlib.suppress(RuntimeError, OSError):  # a damaged file may not close cleanly either; it was only read
        file.close()
    source.close()


def _child(group: Any, name: bytes, path: str) -> Any:
    """An object of a group. Raises Damaged for links that lead elsewhere."""
    if group.links.get_info(name).type != h5l.TYPE_HARD:
        raise CorruptFile(f"{path}: is a link, to somewhere else or to another file")
    return h5o.open(group, name)


def _width(kind: Any, path: str, fixed: bool = False) -> int:
    """Bytes of one value. fixed: accept text of constant length, too. Raises Damaged unless it is a number or text."""
    of = kind.get_class()
    if of == h5t.STRING and (fixed or kind.is_variable_str()):
        return int(kind.get_size())
    if of not in _NUMBERS or kind.get_size() not in _NUMBERS[of]:
        raise CorruptFile(f"{path}: is of a type that navsim does not write")
    return int(kind.get_size())


def _shape(space: Any, path: str) -> tuple[int, ...]:
    if space.get_simple_extent_type() not in (h5s.SCALAR, h5s.SIMPLE):
        raise CorruptFile(f"{path}: is empty")
    return tuple(space.get_simple_extent_dims())


def _text(value: str | bytes, path: str) -> str:
    """Text from a file. Raises Damaged unless it is text."""
    try:
        text = value.decode() if isinstance(value, bytes) else value
        found = _CONTROL.search(text)
    except UnicodeDecodeError:
        raise CorruptFile(f"{path}: not UTF-8") from None
    if found:
        raise CorruptFile(f"{path}: holds the character U+{ord(found.group()):04X}, which is not text")
    return text
