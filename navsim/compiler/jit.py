"""Interface to numba: compilation of all kernels of navsim and the folder of their machine code.

Compiled code is cached on disk. numba's own cache looks only at the file that holds a kernel, not at the kernels it
calls, so an edited callee would leave stale machine code behind. The cache folder is therefore named after a digest of
all kernel sources, the compiler and the processor. A kernel that it lacks is searched by the digest of its parts.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba.extending import overload, register_jitable

from navsim.compiler.kernel_cache import KERNEL_ROOMS, CacheAtFirstCall, load_remembered, loaded, remember
from navsim.compiler.kernel_parts import Overloads
from navsim.compiler.kernel_parts import digest as digest_of_parts
from navsim.compiler.linker import LINKED, Kernel, KernelCompiler, PieceCompiler
from navsim.compiler.protected_folder import ChangeableByOthersError, ProtectedFolder, open_below, open_protected_folder

_CONFIG: Any = numba.config
_PACKAGE = Path(__file__).resolve().parent.parent
_WARM_MARK = "complete"
"""Prefix of the files that list compiled kernels."""


_CODE = ".code"
"""Suffix of the files of machine code that are named by the digest of their parts."""
_Kept = tuple[ProtectedFolder, str] | None
_MADE_FOR = f"{numba.__version__} {llvmlite.__version__} {_CONFIG.CPU_NAME}{'' if LINKED else ' unlinked'}"
_UNUSED = 30 * 86400.0
"""After this time, in seconds, machine code is dropped."""


def digest() -> str:
    """Digest of everything that decides the machine code."""
    h = hashlib.sha256(_MADE_FOR.encode())
    for room in KERNEL_ROOMS:
        for source in sorted((_PACKAGE / room).rglob("*.py")):
            h.update(source.name.encode())
            h.update(source.read_bytes())
    return h.hexdigest()[:16]


def _base() -> Path | None:
    """Folder of the user's machine code; None if the home folder is unknown."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given).expanduser().absolute()
    place = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return place / "navsim" if place.is_absolute() else None


@dataclass(frozen=True)
class _Folders:
    """Open folders of machine code, or None: of all versions (base), of this version, and by digest of the parts."""

    base: ProtectedFolder
    version: ProtectedFolder
    parts: ProtectedFolder | None


def _open_folders() -> tuple[_Folders | None, str]:
    """Open the folders of machine code, and create missing ones; None if none is readable.

    Also returns why code cannot be kept, "" if it can.
    """
    path = _base()
    if path is None:
        return None, "no home folder is known, set NUMBA_CACHE_DIR"
    name = f"kernels-{digest()}"
    try:
        base = open_protected_folder(path)
        version = open_below(base, name)
    except ChangeableByOthersError as error:
        foreign = f"{error}, so the machine code below {path} might not be yours"
        return None, f"{foreign}; set NUMBA_CACHE_DIR to a folder that only you can change, such as one of `mktemp -d`"
    except OSError as error:
        why = error.strerror or error
        return None, f"{path / name} cannot be made ({why}), set NUMBA_CACHE_DIR to a folder that can be written"
    parts = None
    with suppress(OSError):
        parts = open_below(base, "parts")
    why_not = "" if version.is_writable() else f"{version} cannot be written, set NUMBA_CACHE_DIR to one that can"
    return _Folders(base, version, parts), why_not


_FOLDERS, _NOT_KEPT = _open_folders()
if _FOLDERS is not None:
    _CONFIG.CACHE_DIR = str(_FOLDERS.version)
_OVERLOADS: Overloads = {}
"""Kernel versions of functions, from `in_kernels`."""


def _by_parts(folder: ProtectedFolder | None, function: Callable[..., Any], key: Any) -> _Kept:
    """Place of the code for this signature and processor by the digest of its parts; None if unknown."""
    if folder is None:
        return None
    signature, processor, (_, _, *how) = key
    made_for = f"{_MADE_FOR} {sys.version_info[:2]} {processor} {how}"
    made_of = digest_of_parts(function, getattr(signature, "args", signature), _OVERLOADS, made_for)
    return (folder, f"{made_of}{_CODE}") if made_of is not None else None


def is_warm(name: str) -> bool:
    """Whether work with kernels of this name has been done with this very code before: little is left to compile."""
    return _FOLDERS is not None and _FOLDERS.version.exists(f"{_WARM_MARK}-{name}")


_of_others = 0
"""Kernels that were loaded before the work in hand."""


def work_begins() -> None:
    """Begin to record loaded kernels for a work; `mark_warm` ends it."""
    global _of_others
    _of_others = loaded()


def load_ahead(name: str) -> None:
    """Load the kernels that the last work of this name used, before they are called."""
    if _FOLDERS is not None:
        load_remembered(_FOLDERS.version, f"{_WARM_MARK}-{name}")


def mark_warm(name: str) -> None:
    """Remember that the kernels of this name are in the cache, and which they are, and drop folders unused for a
    month. See `work_begins`."""
    if _FOLDERS is None:
        return
    # a full or read-only disk costs the next start some seconds, nothing else
    with suppress(OSError):
        # of work that found some loaded it is not known which it takes
        remember(_FOLDERS.version, f"{_WARM_MARK}-{name}", all_of_it=_of_others == 0)
        _drop_unused(_FOLDERS)


def _drop_unused(folders: _Folders) -> None:
    """Drop machine code that no work has used for a month. Raises OSError."""
    last = time.time() - _UNUSED
    for name in folders.base.names():
        if name.startswith("kernels-"):
            with suppress(ChangeableByOthersError), open_below(folders.base, name) as folder:
                used = [folder.time_of(mark) for mark in folder.names() if mark.startswith(_WARM_MARK)]
                if used and max(used) < last:
                    shutil.rmtree(name, ignore_errors=True, dir_fd=folders.base.descriptor)
    if folders.parts is not None:
        for name in folders.parts.names():
            if name.endswith(_CODE) and folders.parts.time_of(name) < last:
                folders.parts.remove(name)


def keeps() -> bool:
    """Whether machine code is kept on disk."""
    return _FOLDERS is not None and not _NOT_KEPT


def compiling() -> str:
    """Message before kernels are compiled: how long it takes, and where the machine code goes."""
    if _FOLDERS is None or _NOT_KEPT:
        return f"compiling the kernels, about a minute at every start: {_NOT_KEPT}"
    return (
        "compiling the kernels of this kind of computation, about a minute; the next computation finds them in "
        f"{_FOLDERS.version}"
    )


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` in strict IEEE arithmetic, releasing the GIL.

    fastmath stays off: it changes the last bits from one compilation to the next. Division by zero gives
    inf or nan as in numpy, which also lets loops vectorise.
    """
    return _compiled(function, inline=False)


def kernel_inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile like `kernel`, and have LLVM put the code into its callers: passing an array costs ten words."""
    return _compiled(function, inline=True)


def kernel_internal(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile only as part of kernels that call it: a function that returns arrays of lanes cannot be called from
    Python."""
    jitable: Callable[..., Any] = register_jitable(error_model="numpy", pipeline_class=PieceCompiler)(function)
    return jitable


def in_kernels(function: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Declare the kernel version of `function`.

    The decorated function receives the types of the arguments and returns the function to compile. It is compiled only
    if a kernel calls it.
    """
    options: Any = {"pipeline_class": PieceCompiler}
    register: Callable[[Callable[..., Any]], Callable[..., Any]] = overload(function, jit_options=options, strict=False)

    def decorated(by_types: Callable[..., Any]) -> Callable[..., Any]:
        _OVERLOADS[function] = by_types
        return register(by_types)

    return decorated


def _compiled(function: Callable[..., Any], inline: bool) -> Callable[..., Any]:
    options = {"nopython": True, "nogil": True, "error_model": "numpy", "forceinline": inline, "boundscheck": None}
    dispatcher: Any = Kernel(function, targetoptions=options, pipeline_class=KernelCompiler)
    if _FOLDERS is not None:
        # as numba's `cache=True`, with our own cache
        parts = partial(_by_parts, _FOLDERS.parts, function)
        dispatcher._cache = CacheAtFirstCall(function, _FOLDERS.version, parts)
    return dispatcher
