"""numba's cache on disk, made safe: a file that is damaged is dropped and compiled again, a full disk does without.

numba loads what it finds. A file cut by a power failure, or with a flipped bit, ends the process within the machine
code or with a traceback, at every start until somebody removes the folder. Here each file begins with the SHA-256 of
its name and the rest, and is not looked into before that fits. Machine code is named by what it was compiled for,
without an index: of two processes at once, one could lose the other's entries or put its code under the other's name.

Machine code is kept a second time under what it was made of (`kernel_parts`), beside the folders of all versions: a new
version compiles what has changed.

What a process has loaded can be remembered (`remember`), so that the next one that does the same loads it beforehand.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import pickle
import uuid
from collections.abc import Callable, Iterator
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

from numba import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, UserProvidedCacheLocator
from numba.core.runtime.nrt import rtsys

from navsim.core.kernel_pieces import is_piece, put_together, taken_apart, within_another

_DIGEST = 32
"""Bytes of a SHA-256."""

Parts = Callable[[Any], Path | None]
"""Where the code for a signature is kept under what it was made of, of one kernel; None where it is not."""

notes: list[str] = []
"""What went wrong with the cache in this process, in words; each once."""
_loaded: list[tuple[str, str, Any]] = []
"""What this process has loaded: module and name of a kernel, and the types of its arguments."""


def note(text: str) -> None:
    """Remember something to be said."""
    if text not in notes:
        notes.append(text)


class DamagedCode(OSError):
    """A file of the cache that is not as it was written; it is removed."""


class _CheckedFiles(IndexDataCacheFile):
    """The files of one kernel."""

    def __init__(self, cache_path: str, filename_base: str, source_stamp: Any, parts: Parts | None = None) -> None:
        super().__init__(cache_path, filename_base, source_stamp)
        self._parts = parts

    def _name(self, key: Any) -> str:
        made_for = hashlib.sha256(repr((self._version, self._source_stamp, key)).encode())
        return str(self._data_name(int(made_for.hexdigest()[:16], 16)))

    def load(self, key: Any) -> Any:
        """What was kept for a signature, None where there is nothing that counts."""
        try:
            return self._load_data(self._name(key))
        except FileNotFoundError:
            return self._take_over(key)
        except OSError:
            return None

    def _take_over(self, key: Any) -> Any:
        """What another version has kept that was made of the same parts; from now on it is this version's too."""
        if self._parts is None or (path := self._parts(key)) is None:
            return None
        try:
            content = _content(str(path))
            path.touch()
            with contextlib.suppress(OSError):  # a folder that cannot be written serves as well
                _write(self._data_path(self._name(key)), content)
        except OSError:
            return None
        return pickle.loads(content)

    def save(self, key: Any, data: Any) -> None:
        """Keep it. Raises OSError."""
        self._save_data(self._name(key), data)
        if self._parts is not None and (path := self._parts(key)) is not None:
            _write(str(path), pickle.dumps(data))

    def _load_data(self, name: str) -> Any:
        return pickle.loads(_content(self._data_path(name)))

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        _write(filepath, content.getbuffer())


def _content(path: str, what: str | None = "machine code") -> bytes:
    """What was written to a file; damage of `what`, if it has a name, is noted. Raises FileNotFoundError, OSError,
    DamagedCode."""
    with open(path, "rb") as file:
        digest, content = file.read(_DIGEST), file.read()
    if _digest(path, content) != digest:
        with contextlib.suppress(OSError):  # a folder that cannot be written keeps it; it is not used either way
            os.unlink(path)
        if what is not None:
            note(f"damaged {what} in {_top()} was dropped and compiled again")
        raise DamagedCode(path)
    return content


def _top() -> str:
    """The folder of this version's machine code."""
    folder: Any = config
    return str(folder.CACHE_DIR)


def _write(path: str, content: bytes | memoryview) -> None:
    """Write a file that `_content` reads, whole or not at all. Raises OSError."""
    temporary = Path(f"{path}.tmp.{uuid.uuid4().hex[:16]}")
    try:
        with open(temporary, "wb") as file:
            file.write(_digest(path, content))
            file.write(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _digest(path: str, content: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(os.path.basename(path).encode() + b"\0")
    digest.update(content)
    return digest.digest()


class _Place(UserProvidedCacheLocator):
    """The folder of a kernel: that of its room, wherever navsim is installed; all sources name the folder above. One
    that cannot be written serves as well for what is in it."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._folder = os.path.join(_top(), *py_func.__module__.split(".")[1:-1])

    def get_cache_path(self) -> str:
        return self._folder

    def ensure_cache_path(self) -> None:
        with contextlib.suppress(OSError):
            os.makedirs(self._folder, exist_ok=True)


class _Placed(CompileResultCacheImpl):
    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._locator_classes = [_Place]
        super().__init__(py_func)

    def reduce(self, cres: Any) -> Any:
        return taken_apart(cres) if is_piece(cres) else super().reduce(cres)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        return (put_together if within_another() else super().rebuild)(target_context, payload)


class CheckedCache(FunctionCache):
    """The cache of one kernel, with checked files."""

    _impl_class = _Placed

    def __init__(self, function: Callable[..., Any], parts: Parts) -> None:
        super().__init__(function)
        self._kernel = function.__module__, function.__qualname__
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _CheckedFiles(self._cache_path, self._impl.filename_base, stamp, parts)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Machine code that was kept, None where there is none. numba's own method loads all that the compiler knows
        before it looks, scipy's linear algebra too; what is kept is compiled, and the compiler does that by itself."""
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
            note(f"machine code could not be kept in {_top()}: {why}; every start compiles it again until it can be")
            self.disable()


class CacheAtFirstCall:
    """What a kernel has for a cache: a `CheckedCache`, whose place is looked for when the kernel is first called. A
    command imports a hundred kernels and calls ten; the others are parts of those."""

    def __init__(self, function: Callable[..., Any], parts: Parts) -> None:
        self._function = function
        self._parts = parts

    @cached_property
    def _opened(self) -> CheckedCache:
        return CheckedCache(self._function, self._parts)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._opened, name)


def loaded() -> int:
    """How many kernels this process has loaded."""
    return len(_loaded)


def remember(path: Path, all_of_it: bool) -> None:
    """Write down what this process has loaded; where that is not all of it for what is remembered, nothing but that it
    was done, unless more is known already. Raises OSError."""
    if all_of_it or not path.exists():
        _write(str(path), pickle.dumps(_loaded if all_of_it else []))
    else:
        path.touch()


def load_remembered(path: Path) -> None:
    """Load what a process wrote down that had the same code; nothing where there is no such file."""
    try:
        kernels = pickle.loads(_content(str(path), what=None))
    except OSError:
        return
    for module, name, signature in kernels:
        getattr(import_module(module), name).compile(signature)
