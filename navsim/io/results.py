"""Result files: HDF5 that is valid netCDF-4, written whole or not at all.

A result is a tree of variables by path, `/group/name`; a variable named like one of its dimensions is that
dimension's coordinate. Every dimension has one, so every dataset in the file has units and a long name.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np


class ResultError(Exception):
    """A file that is not a navsim result, or cannot be written."""


@dataclass(frozen=True)
class Stream:
    """Numbers too many to hold at once: blocks along the first axis, made anew each time they are asked for."""

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
class Sort:
    """What sort of result a file holds; results of different sorts do not take each other's place.

    kind: as its root attribute. method: that made it, "" for kinds that know only one. extent: `ONE_RUN` or
    `SEVERAL_RUNS` where runs were flown, else "".
    """

    kind: str
    method: str = ""
    extent: str = ""

    def __str__(self) -> str:
        method = f"method {self.method}" if self.method else ""
        return ", ".join(part for part in (f"kind {self.kind}", method, self.extent) if part)


ONE_RUN, SEVERAL_RUNS = "one run", "several runs"


def check_writable(path: Path) -> None:
    """Raise ResultError, before any work is done, where `path` could not be written."""
    if path.is_dir():
        raise ResultError(f"{path}: this is a folder; the result needs a file name")
    folder = path.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder):
            return
    except FileExistsError:
        raise ResultError(f"{folder}: is a file, not a folder") from None
    except OSError as error:
        raise ResultError(f"{folder}: results cannot be written there: {error.strerror or error}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all, line ends as they are. Raises ResultError."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8", newline="")
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ResultError(f"{path}: cannot be written: {error.strerror or error}") from None


IN_MEMORY = 64e6
"""Results up to this size, bytes, are built in memory and then written."""


def write(path: Path, result: Result) -> None:
    """Write the result under a temporary name beside `path`, then rename it. Raises ResultError.

    HDF5 does not survive a full disk, it crashes the process while closing the file. So a small file is built
    in memory and written by plain system calls; for a large one, which is written block by block, the space is
    claimed first.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    size = sum(v.data.nbytes for v in result.variables.values() if isinstance(v.data, Stream))
    try:
        if size < IN_MEMORY:
            image = _image(result)
            with open(temporary, "wb") as file:
                file.write(image)
                file.flush()
                os.fsync(file.fileno())
        else:
            _claim(temporary, int(1.05 * size + IN_MEMORY))
            import h5netcdf

            with h5netcdf.File(temporary, "w") as tree:
                _fill(tree, result)
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ResultError(f"{path}: cannot be written: {reason}; an earlier result there is untouched") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _claim(path: Path, size: int) -> None:
    """Find out whether the disk takes a file of this size; raises OSError where it does not."""
    with open(path, "wb") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
    path.unlink()


def _image(result: Result) -> memoryview:
    """The bytes of the HDF5 file."""
    import h5netcdf

    memory = io.BytesIO()
    with h5netcdf.File(memory, "w") as file:
        _fill(file, result)
    return memory.getbuffer()


def _fill(file: Any, result: Result) -> None:
    for name, value in result.attributes.items():
        file.attrs[name] = value

    # coordinates first: they create the dimensions their neighbours use
    def is_coordinate(item: tuple[str, Variable]) -> bool:
        return item[1].dims == (item[0].rsplit("/", 1)[-1],)

    ordered = sorted(result.variables.items(), key=lambda item: (not is_coordinate(item), item[0].count("/")))
    for path, variable in ordered:
        group_name, _, name = path.rpartition("/")
        group = file if not group_name else file[group_name] if group_name in file else file.create_group(group_name)
        if isinstance(variable.data, Stream):
            stream = variable.data
            stored = group.create_variable(name, variable.dims, stream.dtype)
            start = 0
            for block in stream.blocks():
                if block.size:
                    stored[start : start + block.shape[0]] = block
                start += block.shape[0]
            _describe(stored, variable)
            continue
        data = np.asarray(variable.data)
        if is_coordinate((path, variable)):
            group.dimensions[name] = data.shape[0]
        if data.dtype.kind in "UO":
            import h5py

            data = data.astype(object)
            stored = group.create_variable(name, variable.dims, h5py.string_dtype())
            if data.size:
                stored[...] = data
        else:
            stored = group.create_variable(name, variable.dims, data.dtype)
            if data.size:
                stored[...] = data
        _describe(stored, variable)


def _describe(stored: Any, variable: Variable) -> None:
    stored.attrs["units"] = variable.units
    stored.attrs["long_name"] = variable.long_name
    for key, value in variable.attributes.items():
        stored.attrs[key] = value


def read(path: Path) -> Result:
    """Read a result file. Raises ResultError for anything else."""
    with _opened(path) as file:
        attributes = {k: _plain(v) for k, v in file.attrs.items() if not k.startswith("_NC")}
        variables: dict[str, Variable] = {}
        file.visititems(lambda name, node: _collect(name, node, variables))
        return Result(attributes, variables)


def read_sort(path: Path) -> Sort:
    """The sort of a result file. Raises ResultError for anything else."""
    with _opened(path) as file:
        method = str(_plain(file.attrs["method"])) if "method" in file.attrs else ""
        extent = ""
        if method == "monte-carlo" and "run" in file:
            extent = SEVERAL_RUNS if file["run"].shape[0] > 1 else ONE_RUN
        return Sort(str(_plain(file.attrs["kind"])), method, extent)


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            if "navsim_version" not in file.attrs or "kind" not in file.attrs:
                raise ResultError(f"{path}: an HDF5 file, but not a navsim result (no navsim_version and kind)")
            yield file
    except (KeyError, RuntimeError, ValueError) as error:
        raise ResultError(f"{path}: a damaged HDF5 file ({str(error).splitlines()[0]})") from None
    except FileNotFoundError:
        raise ResultError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise ResultError(f"{path}: this is a folder; a result file is needed") from None
    except OSError as error:
        raise ResultError(f"{path}: not a readable HDF5 file ({str(error).splitlines()[0]})") from None


def _collect(name: str, node: Any, variables: dict[str, Variable]) -> None:
    import h5py

    if not isinstance(node, h5py.Dataset):
        return
    data = node.asstr()[()] if h5py.check_string_dtype(node.dtype) else node[()]
    own = {k: _plain(v) for k, v in node.attrs.items()}
    hidden = ("CLASS", "NAME", "REFERENCE_LIST", "DIMENSION_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates")
    extra = {k: v for k, v in own.items() if k not in (*hidden, "units", "long_name")}
    own_name = name.rsplit("/", 1)[-1]
    dims = (own_name,) if node.is_scale else tuple(scale[0].name.rsplit("/", 1)[-1] for scale in node.dims)
    variables[f"/{name}"] = Variable(dims, data, str(own.get("units", "")), str(own.get("long_name", "")), extra)


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode()
    if isinstance(value, np.ndarray) and value.size == 1:
        return value.reshape(-1)[0]
    return value
