"""Result files: HDF5 that is valid netCDF-4, written atomically.

A result is a tree of variables by path, `/group/name`; a variable named like one of its dimensions is that dimension's
coordinate. Every dimension has one, so every dataset in the file has units and a long name.

Arrays of numbers have HDF5's own checksums (fletcher32), the file those of `navsim.results.checksum`. The root
attributes `checksums` and `contents` say so: a file that lost them is damaged; files of earlier versions have neither.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.results import files
from navsim.results.atomic_write import clean, destination, partial_folder, replacing, settle, write_atomically
from navsim.results.checksum import CorruptFile, checksum_trailer
from navsim.results.contents import VariableDigest, attribute_digest
from navsim.results.former_names import present_path, with_present_names
from navsim.results.schema import CHECKSUMS, CONTENTS

if TYPE_CHECKING:
    from navsim.results.hdf5 import Dataset, Tree
    from navsim.results.netcdf import Writer


class ResultError(Exception):
    """A file that is not a navsim result, or cannot be written."""


class DamagedResult(ResultError):
    """A result file whose content is not as it was written."""


@dataclass(frozen=True)
class Stream:
    """Numbers too large for memory: blocks along the first axis, computed each time they are requested."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    blocks: Callable[[], Iterable[np.ndarray]]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """All of it, for those who can hold it."""
        return np.concatenate(list(self.blocks())).astype(dtype or self.dtype)

    @property
    def nbytes(self) -> int:
        """Size of all blocks together, bytes."""
        return int(np.prod(self.shape)) * self.dtype.itemsize


BLOCK_BYTES = 16_000_000
"""Size of the blocks in which stored data are read, bytes."""


class Stored(Stream):
    """A variable of a result file, read when it is asked for, by blocks, by rows or all of it.

    Reading raises ResultError where the file is damaged there.
    """

    def __init__(
        self, shape: tuple[int, ...], dtype: np.dtype[Any], read: Callable[[int | None, int | None], np.ndarray]
    ) -> None:
        """read: rows from the first number up to the second; (None, None) all."""
        super().__init__(shape, dtype, self._in_blocks)
        object.__setattr__(self, "_read", read)
        object.__setattr__(self, "_whole", None)

    def _in_blocks(self) -> Iterator[np.ndarray]:
        step = max(1, BLOCK_BYTES * self.shape[0] // max(1, self.nbytes))
        for first in range(0, self.shape[0], step):
            yield self.rows(first, min(first + step, self.shape[0]))

    def rows(self, first: int, last: int) -> np.ndarray:
        """Entries first ... last - 1 along the first axis."""
        return self._read(first, last)  # type: ignore[attr-defined]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """All of it; cached unless it is large, and then read-only."""
        whole: np.ndarray | None = self._whole  # type: ignore[attr-defined]
        if whole is None:
            whole = self._read(None, None)  # type: ignore[attr-defined]
            if self.nbytes <= BLOCK_BYTES:
                whole.flags.writeable = False
                object.__setattr__(self, "_whole", whole)
        return whole.astype(dtype or self.dtype, copy=bool(copy))


def part(data: Any, first: int, last: int) -> Any:
    """Entries first ... last - 1 along the first axis of an array or a Stream; stored data are still read later."""
    if not isinstance(data, Stored):
        return np.asarray(data)[first:last]

    def read(low: int | None, high: int | None) -> np.ndarray:
        return data.rows(first + (low or 0), last if high is None else first + high)

    return Stored((last - first, *data.shape[1:]), data.dtype, read)


@dataclass(frozen=True)
class Variable:
    """Data (any shape; numbers, text or a Stream) with names for its dimensions."""

    dims: tuple[str, ...]
    data: Any
    units: str
    long_name: str
    attributes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """Root attributes and variables by path."""

    attributes: dict[str, Any]
    variables: dict[str, Variable]

    def __getitem__(self, path: str) -> np.ndarray:
        return np.asarray(self.variables[path].data)

    def __contains__(self, path: str) -> bool:
        return path in self.variables


@dataclass(frozen=True)
class ResultKind:
    """Kind of the result in a file. A result does not replace one of a different kind."""

    kind: str
    """Root attribute."""
    method: str = ""
    """"" for kinds with a single method."""
    runs: str = ""
    """`ONE_RUN` or `SEVERAL_RUNS`, "" without runs."""
    count: int = field(default=0, compare=False)
    """Number of runs, which does not change the kind; 0 without runs, or if it is unknown in advance."""

    def __str__(self) -> str:
        method = f"method {self.method}" if self.method else ""
        return ", ".join(part for part in (f"kind {self.kind}", method, self.runs) if part)


MOST_WHOLE = int(np.iinfo(np.int64).max)
"""Largest integer in a result, such as the number of a run."""
ONE_RUN, SEVERAL_RUNS = "one run", "several runs"


def scenario_of(result: Result, part: str = "scenario") -> Any:
    """The scenario stored in a result, defaults included, as plain data that nobody changes. part: or its `study`."""
    return _parsed(str(result.attributes[part]))


@functools.lru_cache(maxsize=16)
def _parsed(text: str) -> Any:
    """PyYAML takes 30 ms for a scenario, and a table asks for its settings one by one."""
    import yaml

    return with_present_names(yaml.safe_load(text))


def check_writable(path: Path) -> None:
    """Raise ResultError, before any work, if `path` or partial work beside it cannot be written."""
    try:
        target = destination(path)
        with contextlib.suppress(FileNotFoundError):
            partial_folder(path).stat()  # mostly not there; asked because its name is longer, perhaps too long
    except IsADirectoryError:
        raise ResultError(f"{path}: this is a folder; the result needs a file name") from None
    except NotADirectoryError:
        raise ResultError(f"{path.parent}: is a file, not a folder") from None
    except OSError as error:
        raise ResultError(f"{path}: cannot be written: {error.strerror or error}") from None
    folder = path.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=target.parent):
            return
    except FileExistsError:
        raise ResultError(f"{folder}: is a file, not a folder") from None
    except OSError as error:
        where = f"{path} -> {target}" if path.is_symlink() else folder
        raise ResultError(f"{where}: results cannot be written there: {error.strerror or error}") from None


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file atomically. Raises ResultError."""
    try:
        clean(path, owned=False)
        write_atomically(path, content)
    except OSError as error:
        raise ResultError(f"{path}: cannot be written: {error.strerror or error}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, with unchanged line ends. Raises ResultError."""
    write_bytes(path, text.encode())


CHUNK_BYTES = 524_288
"""Largest size of a chunk, unless a row is larger: half of HDF5's cache of a dataset."""
_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]{0,39}")
"""Kinds and versions."""
IN_MEMORY = 64e6
"""Results up to this size, bytes, are built in memory and then written."""


def write(path: Path, result: Result) -> None:
    """Write the result under a temporary name beside `path`, then rename it. Raises ResultError.

    The name is on the disk afterwards, so that partial work can be deleted. On a full disk HDF5 crashes the process
    while it closes the file. So a small file is built in memory and written by plain system calls. For a large one,
    which is written block by block, the space is allocated first.
    """
    size = sum(v.data.nbytes for v in result.variables.values() if isinstance(v.data, Stream))
    try:
        if size < IN_MEMORY:
            image = _image(result)
            write_atomically(path, image, checksum_trailer(len(image), lambda start, end: image[start:end]))
        else:
            with replacing(path) as temporary:
                _claim(temporary, int(1.05 * size + IN_MEMORY))
                _fill(temporary, result)
                with open(temporary, "r+b") as file:
                    length = file.seek(0, os.SEEK_END)
                    file.write(checksum_trailer(length, lambda start, end: os.pread(file.fileno(), end - start, start)))
        settle(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultError(f"{path}: cannot be written: {reason}; an earlier result there is untouched") from None


def _claim(path: Path, size: int) -> None:
    """Find out whether the disk takes a file of this size; raises OSError where it does not."""
    with open(path, "wb") as file:
        if hasattr(os, "posix_fallocate"):  # macOS has none
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(0)


def _image(result: Result) -> memoryview:
    """The bytes of the HDF5 file."""
    memory = io.BytesIO()
    _fill(memory, result)
    return memory.getbuffer()


def _fill(file: Path | io.BytesIO, result: Result) -> None:
    """Write all of HDF5 into a file, or into memory."""
    from navsim.results.netcdf import Writer

    own = {CHECKSUMS: "SHA-256 of each 64 KiB, behind the end of HDF5"}
    contents = {f"@{name}": attribute_digest(value) for name, value in result.attributes.items()}
    with Writer(file) as tree:
        _describe(tree.root, "/", own | result.attributes)
        # coordinates first: they are the dimensions that their neighbours use; else by name, so that numbers of
        # dimensions do not depend on the order in which a result was built
        ordered = sorted(
            result.variables.items(), key=lambda item: (not _is_coordinate(*item), item[0].count("/"), item[0])
        )
        for path, variable in ordered:
            own = {"units": variable.units, "long_name": variable.long_name} | variable.attributes
            data = variable.data if isinstance(variable.data, Stream) else np.asarray(variable.data)
            digest = VariableDigest(data.shape, data.dtype, variable.dims, own)
            _describe(_store(tree, path, variable, digest), path, own)
            contents[path] = digest.text()
        _describe(tree.root, "/", {CONTENTS: json.dumps(contents, sort_keys=True, indent=0)})
        tree.finish()


def _is_coordinate(path: str, variable: Variable) -> bool:
    return variable.dims == (path.rsplit("/", 1)[-1],)


def _store(tree: Writer, path: str, variable: Variable, digest: VariableDigest) -> Any:
    """Write a variable without its attributes; returns its dataset. digest: receives the data."""
    data = variable.data

    def create(dtype: Any, **how: Any) -> Any:
        if _is_coordinate(path, variable):
            return tree.coordinate(path, data.shape, dtype, **how)
        return tree.variable(path, variable.dims, data.shape, dtype, **how)

    if not isinstance(data, Stream) or data.dtype.kind in "UO" or not data.shape:
        data = np.asarray(data)
        digest.add(data)
        text = data.dtype.kind in "UO"
        values = data.astype(object) if text else data
        return create(data.dtype, data=values if data.size else None, **({} if text else _checked(data, data)))
    with contextlib.closing(_ahead(data.blocks())) as pieces:
        first = next(pieces, np.empty((0, *data.shape[1:]), data.dtype))
        stored = create(data.dtype, **_checked(data, first))
        _fill_numbers(stored, first, pieces, digest)
    return stored


def _ahead(blocks: Iterable[np.ndarray]) -> Generator[np.ndarray, None, None]:
    """The same blocks, each computed on another thread while the one before it is in use."""
    source = iter(blocks)
    with ThreadPoolExecutor(1) as maker:
        coming = maker.submit(next, source, None)
        while (block := coming.result()) is not None:
            coming = maker.submit(next, source, None)
            yield block


def _fill_numbers(stored: Any, first: np.ndarray, others: Iterator[np.ndarray], digest: VariableDigest) -> None:
    """Numbers, block after block along their first axis."""
    start = 0
    for block in itertools.chain([first], others):
        digest.add(block)
        if block.size:
            stored[start : start + block.shape[0]] = block
        start += block.shape[0]


def _checked(data: np.ndarray | Stream, first: np.ndarray) -> dict[str, Any]:
    """Storage of numbers with checksums, which HDF5 keeps by chunks of rows along the first axis.

    Chunks divide the blocks, since a chunk written in two pieces would be read again for the second.
    """
    if not data.shape or 0 in data.shape:
        return {}
    most = max(1, CHUNK_BYTES // (data.dtype.itemsize * int(np.prod(data.shape[1:]))))
    chunks = -(-data.shape[0] // most)
    rows = -(-data.shape[0] // chunks)  # equal sizes, since the last one takes as much space as the others
    if isinstance(data, Stream):
        rows = next(n for n in range(min(rows, max(1, first.shape[0])), 0, -1) if first.shape[0] % n == 0)
    return {"chunks": (rows, *data.shape[1:]), "fletcher32": True}


def _describe(node: Any, path: str, attributes: dict[str, Any]) -> None:
    from navsim.results.netcdf import set_attribute

    for name, value in attributes.items():
        try:
            set_attribute(node, name, value)
        except (ValueError, TypeError, OverflowError) as error:  # text with NUL, numbers beyond 64 bits
            raise ResultError(f"the result cannot be stored: {path}, attribute {name}: {error}") from None


def read(path: Path) -> Result:
    """Read a result file: metadata now, numbers on request. Former paths of variables become the present ones.

    Raises ResultError for any other file, or damage, now or later.
    """
    tree = _open_tree(path)
    with _damage_of(path):
        attributes = {k: v for k, v in tree.attributes.items() if not _is_of_file(k)}
        variables = {present_path(name): _variable(path, tree, found) for name, found in tree.datasets.items()}
        return Result(attributes, variables)


def _is_of_file(name: str) -> bool:
    """Whether a root attribute belongs to the file instead of the result."""
    return name.startswith("_NC") or name in (CHECKSUMS, CONTENTS)


def read_unchecked(path: Path) -> tuple[Result, dict[str, str] | None, list[str]]:
    """Read a result for `navsim verify`, also without the checksums that it was written with.

    Returns the result, the digests of its contents as written (None in files of earlier versions), and what is wrong
    with the file. Raises ResultError for anything but a result that can be read.
    """
    tree = _open_tree(path, whole=False)
    with _damage_of(path):
        attributes = {k: v for k, v in tree.attributes.items() if not _is_of_file(k)}
        variables = {name: _variable(path, tree, found) for name, found in tree.datasets.items()}
        lost = _lost_checksums(tree)
        stated = tree.attributes.get(CONTENTS)
    wrong = ["its checksums are gone: it was cut off, or another program has written to it"] if lost else []
    try:
        contents = None if stated is None else {str(k): str(v) for k, v in json.loads(str(stated)).items()}
    except (ValueError, AttributeError):
        contents = None
        wrong.append(f"its root attribute {CONTENTS} is damaged")
    return Result(attributes, variables), contents, wrong


def contents_of(result: Result) -> dict[str, str]:
    """Digests of root attributes ("@name") and variables of a result; "" for damaged ones."""
    out = {f"@{name}": attribute_digest(value) for name, value in result.attributes.items()}
    for path, v in result.variables.items():
        about = {"units": v.units, "long_name": v.long_name} | v.attributes
        digest = VariableDigest(v.data.shape, v.data.dtype, v.dims, about)
        try:
            whole = not isinstance(v.data, Stream) or v.data.dtype.kind in "UO" or not v.data.shape
            for block in [np.asarray(v.data)] if whole else v.data.blocks():
                digest.add(block)
            out[path] = digest.text()
        except ResultError:
            out[path] = ""
    return out


def _variable(path: Path, tree: Tree, found: Dataset) -> Variable:
    def rows(first: int | None, last: int | None) -> np.ndarray:
        with _damage_of(path):
            return tree.read(found.path, first or 0, last)

    extra = dict(found.attributes)
    units, long_name = (str(extra.pop(name, "")) for name in ("units", "long_name"))
    return Variable(found.dims, Stored(found.shape, found.dtype, rows), units, long_name, extra)


def read_kind(path: Path) -> ResultKind:
    """Kind of a result file. Raises ResultError for any other file."""
    tree = _open_tree(path)
    with _damage_of(path):
        method = str(tree.attributes.get("method", ""))
        found = tree.length("run") if method in ("monte-carlo", "rare") else None
        count = 0 if found is None else found
        runs = "" if method != "monte-carlo" or found is None else SEVERAL_RUNS if count > 1 else ONE_RUN
        return ResultKind(tree.attributes["kind"], method, runs, count)


def _lost_checksums(tree: Tree) -> bool:
    """Whether a file was written with checksums, and has none now. Digests of contents are younger than checksums."""
    return not tree.sealed and not {CHECKSUMS, CONTENTS}.isdisjoint(tree.attributes)


def _open_tree(path: Path, whole: bool = True) -> Tree:
    """whole: refuse a file that lost its checksums."""
    from navsim.results.hdf5 import SIGNATURE, Tree

    try:
        file = files.open_regular(path, sys.maxsize)
        if file.read(len(SIGNATURE)) != SIGNATURE:
            file.close()
            raise ResultError(f"{path}: not a readable HDF5 file; a result of navsim (.h5) is needed")
    except FileNotFoundError:
        raise ResultError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ResultError(f"{path}: this is a folder; a result file is needed") from None
    except OSError as error:
        raise ResultError(f"{path}: not a readable HDF5 file ({error.strerror or error})") from None
    with _damage_of(path):
        tree = Tree(file)
        if "navsim_version" not in tree.attributes or "kind" not in tree.attributes:
            raise ResultError(f"{path}: an HDF5 file, but not a navsim result (no navsim_version and kind)")
        for name in ("navsim_version", "kind"):
            value = tree.attributes[name]
            if not isinstance(value, str) or not _WORD.fullmatch(value):
                raise ResultError(f"{path}: not a navsim result: {name} is {str(value)[:40]!r}")
        if whole and _lost_checksums(tree):
            raise CorruptFile("its checksums are gone: cut off, or another program has written to it")
        return tree


@contextlib.contextmanager
def _damage_of(path: Path) -> Iterator[None]:
    try:
        yield
    except CorruptFile as error:
        raise DamagedResult(f"{path}: a damaged HDF5 file ({error})") from None
