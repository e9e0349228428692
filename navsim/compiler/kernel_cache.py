"""Safe disk cache for numba: a damaged file is deleted and compiled again; a full disk disables the cache.

numba loads any file that it finds. A file cut by a power failure, or with a flipped bit, ends the process within the
machine code or with a traceback, at every start until somebody removes the folder. Here each file begins with the
SHA-256 of its name and the rest, which is checked before the rest is read. Machine code is named by its signature,
without an index: of two processes at once, one could lose the other's entries or put its code under the other's name.

A second copy of the machine code is named by the digest of its parts (`kernel_parts`), beside the folders of all
versions: a new version compiles only changed kernels.

A process can write down the kernels that it used (`remember`), so that the next one loads them in advance.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any

from numba import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, UserProvidedCacheLocator
from numba.core.runtime.nrt import rtsys

from navsim.compiler.linker import is_piece, piece_state, restore_piece, within_another
from navsim.compiler.protected_folder import ProtectedFolder

KERNEL_ROOMS = (
    "compiler", "geodesy", "statistics", "trajectory", "gnss", "sensors", "filter",
    "error_propagation", "simulation", "integrity", "companions", "ranging",
)  # fmt: skip
"""Rooms of the package with kernels, or with data that kernels read."""
_DIGEST = 32
"""Bytes of a SHA-256."""

Parts = Callable[[Any], tuple[ProtectedFolder, str] | None]
"""Folder and file of a kernel's code for a signature, by digest of its parts; None if it is not kept."""

notes: list[str] = []
"""Messages about errors of the cache in this process, each once."""
_loaded: list[tuple[str, str, Any]] = []
"""Kernels that this process has loaded: module, name, and types of the arguments."""


def note(text: str) -> None:
    """Keep a message for the end of the command."""
    if text not in notes:
        notes.append(text)


class DamagedCode(OSError):
    """A file of the cache that is not as it was written; it is removed."""


class _CheckedFiles(IndexDataCacheFile):
    """The files of one kernel."""

    def __init__(self, folder: ProtectedFolder, filename_base: str, stamp: Any, parts: Parts | None = None) -> None:
        super().__init__(str(folder), filename_base, stamp)
        self._folder = folder
        self._parts = parts

    def _name(self, key: Any) -> str:
        made_for = hashlib.sha256(repr((self._version, self._source_stamp, key)).encode())
        return str(self._data_name(int(made_for.hexdigest()[:16], 16)))

    def load(self, key: Any) -> Any:
        """Cached code for a signature, None without a valid one."""
        try:
            return pickle.loads(_content(self._folder, self._name(key)))
        except FileNotFoundError:
            return self._take_over(key)
        except OSError:
            return None

    def _take_over(self, key: Any) -> Any:
        """Copy code of the same parts from another version into this version's folder."""
        if self._parts is None or (kept := self._parts(key)) is None:
            return None
        folder, name = kept
        try:
            content = _content(folder, name)
            folder.touch(name)
            with contextlib.suppress(OSError):  # a folder that cannot be written serves as well
                _write(self._folder, self._name(key), content)
        except OSError:
            return None
        return pickle.loads(content)

    def save(self, key: Any, data: Any) -> None:
        """Keep it. Raises OSError."""
        _write(self._folder, self._name(key), self._dump(data))
        if self._parts is not None and (kept := self._parts(key)) is not None:
            _write(*kept, pickle.dumps(data))


def _content(folder: ProtectedFolder, name: str, what: str | None = "machine code") -> bytes:
    """Content of a file; damage of `what`, if it has a name, is noted. Raises FileNotFoundError, OSError,
    DamagedCode."""
    written = folder.read(name)
    digest, content = written[:_DIGEST], written[_DIGEST:]
    if _digest(name, content) != digest:
        folder.remove(name)  # a folder that cannot be written keeps it; it is not used either way
        if what is not None:
            note(f"damaged {what} in {folder} was dropped and compiled again")
        raise DamagedCode(f"{folder}/{name}")
    return content


def _write(folder: ProtectedFolder, name: str, content: bytes) -> None:
    """Write a file that `_content` reads, atomically. Raises OSError."""
    folder.write(name, (_digest(name, content), content))


def _digest(name: str, content: bytes) -> bytes:
    digest = hashlib.sha256(name.encode() + b"\0")
    digest.update(content)
    return digest.digest()


class _Place(UserProvidedCacheLocator):
    """The one folder of all kernels, wherever navsim is installed; all sources name it."""

    def get_cache_path(self) -> str:
        return str(config.CACHE_DIR)  # type: ignore[attr-defined]

    def ensure_cache_path(self) -> None:
        """Do nothing: `_CheckedFiles` writes into the folder that is open."""


class _Placed(CompileResultCacheImpl):
    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._locator_classes = [_Place]
        self._room = ".".join(py_func.__module__.split(".")[1:-1])
        super().__init__(py_func)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Name of a kernel's files: with that of its room, which has modules of the same names as others."""
        return f"{self._room}.{super().get_filename_base(fullname, abiflags)}"

    def reduce(self, cres: Any) -> Any:
        return piece_state(cres) if is_piece(cres) else super().reduce(cres)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        return (restore_piece if within_another() else super().rebuild)(target_context, payload)


class CheckedCache(FunctionCache):
    """The cache of one kernel, with checked files."""

    _impl_class = _Placed

    def __init__(self, function: Callable[..., Any], folder: ProtectedFolder, parts: Parts) -> None:
        super().__init__(function)
        self._kernel = function.__module__, function.__qualname__
        stamp = self._impl.locator.get_source_stamp()
        self._folder = folder
        self._cache_file = _CheckedFiles(folder, self._impl.filename_base, stamp, parts)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Load machine code from the cache; None if there is none.

        numba's own method first loads the whole typing machinery, including scipy's linear algebra. Cached code needs
        none of it, and the compiler loads it when it compiles.
        """
        rtsys.initialize(target)  # code that makes arrays asks for its memory there
        found = self._load_overload(signature, target)
        if found is not None and not within_another():
            _loaded.append((*self._kernel, signature))
        return found

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        signature, processor, hashes = super()._index_key(sig, codegen)
        return signature, processor, (*hashes, "piece") if within_another() else hashes

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep machine code; where the disk does not take it, it lives in memory alone."""
        try:
            super().save_overload(signature, data)
        except OSError as error:
            why = error.strerror or error
            failed = f"machine code could not be kept in {self._folder}: {why}"
            note(f"{failed}; every start compiles it again until it can be")
            self.disable()


class CacheAtFirstCall:
    """Cache of a kernel: a `CheckedCache` that is created at the kernel's first call.

    A command imports a hundred kernels and calls ten; the others are parts of those.
    """

    def __init__(self, function: Callable[..., Any], folder: ProtectedFolder, parts: Parts) -> None:
        self._function = function
        self._folder = folder
        self._parts = parts

    @cached_property
    def _cache(self) -> CheckedCache:
        return CheckedCache(self._function, self._folder, self._parts)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)


def loaded() -> int:
    """Number of kernels that this process has loaded."""
    return len(_loaded)


def remember(folder: ProtectedFolder, name: str, all_of_it: bool) -> None:
    """Write down the kernels that this process has loaded. Raises OSError.

    If `all_of_it` is False, an existing list is kept; without one, the file is empty.
    """
    if all_of_it or not folder.exists(name):
        _write(folder, name, pickle.dumps(_loaded if all_of_it else []))
    else:
        folder.touch(name)


def load_remembered(folder: ProtectedFolder, name: str) -> None:
    """Load the kernels that a process with the same code wrote down; nothing without such a file."""
    try:
        kernels = pickle.loads(_content(folder, name, what=None))
    except OSError:
        return
    for module, kernel, signature in kernels:
        getattr(import_module(module), kernel).compile(signature)
