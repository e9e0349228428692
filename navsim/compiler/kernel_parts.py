"""Digest of the parts of a kernel's machine code: its own bytecode and that of all navsim code that it reaches.

With it, a version with other sources recognises its unchanged kernels. Code that cannot be followed has no digest and
is compiled again.
"""

from __future__ import annotations

import dis
import hashlib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, GenericAlias, ModuleType
from typing import Any

import numpy as np
from numba import types
from numba.core.dispatcher import Dispatcher

Overloads = dict[Callable[..., Any], Callable[..., Any]]
"""Kernel version of a function: receives the types and returns the function to compile."""

_LANGUAGE = ("jit.py", "kernel_pieces.py", "lanes.py", "lowering.py")
"""Files of this room that define compilation and lanes; their whole text is part of the digest."""
_LANES = "navsim.compiler.lanes"
_PLAIN = (int, float, complex, bool, str, bytes, type(None), np.generic)


class _CannotFollow(Exception):
    """A part whose content is not known."""


def digest(
    function: Callable[..., Any], arguments: Iterable[types.Type], overloads: Overloads, made_for: str
) -> str | None:
    """Digest of all that decides a kernel's machine code for arguments of these types; None where a part cannot be
    followed. `made_for` names compiler and processor."""
    h = hashlib.sha256(f"{made_for} {_language()}".encode())
    try:
        for line in (*_of_types(arguments), *_of_value(function, overloads, set())):
            h.update(line.encode())
            h.update(b"\n")
    except _CannotFollow:
        return None
    return h.hexdigest()


@cache
def _language() -> str:
    here = Path(__file__).resolve().parent
    return hashlib.sha256(b"\0".join((here / name).read_bytes() for name in _LANGUAGE)).hexdigest()


def _of_types(kinds: Iterable[types.Type]) -> Iterator[str]:
    """Types of arguments, with module and fields of tuples, which numba's type names omit: machine code names both."""
    for kind in kinds:
        yield str(kind)
        if isinstance(kind, types.NamedTuple | types.NamedUniTuple):
            yield f"{kind.instance_class.__module__} fields {kind.fields}"
        within: tuple[types.Type, ...] = getattr(kind, "types", ())
        yield from _of_types(within)


def _of_value(value: Any, overloads: Overloads, seen: set[int]) -> Iterator[str]:
    """Lines that describe a value and all that it reaches; each value once."""
    if isinstance(value, Dispatcher):
        yield f"kernel {sorted(value.targetoptions.items(), key=str)}"
        value = value.py_func
    if isinstance(value, FunctionType):
        yield from _of_function(value, overloads, seen)
    elif isinstance(value, _PLAIN):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, tuple | list):
        yield f"{type(value).__name__} of {len(value)} {getattr(value, '_fields', '')}"
        for item in value:
            yield from _of_value(item, overloads, seen)
    elif isinstance(value, np.ndarray) and value.dtype != object:
        yield f"array {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    elif isinstance(value, type):
        yield from _of_class(value, overloads, seen)
    elif isinstance(value, ModuleType):
        yield f"module {value.__name__}"
    elif isinstance(value, BuiltinFunctionType):
        yield f"builtin {value.__module__}.{value.__qualname__}"
    elif isinstance(value, np.ufunc | GenericAlias | types.Type):
        yield f"{type(value).__name__} {value!r}"
    elif getattr(value, "__module__", None) == _LANES:
        yield f"{value!r}"
    else:
        raise _CannotFollow(value)


def _of_class(kind: type, overloads: Overloads, seen: set[int]) -> Iterator[str]:
    yield f"class {kind.__module__}.{kind.__qualname__}"
    if not kind.__module__.startswith("navsim.") or id(kind) in seen:
        return
    seen.add(id(kind))
    fields = getattr(kind, "_fields", None)
    if fields is None:
        raise _CannotFollow(kind)
    yield f"fields {fields} {sorted(map(str, kind.__annotations__.items()))}"
    yield from _of_value(tuple(getattr(kind, "_field_defaults", {}).values()), overloads, seen)


def _of_function(function: FunctionType, overloads: Overloads, seen: set[int]) -> Iterator[str]:
    yield f"function {function.__module__}.{function.__qualname__}"
    if not function.__module__.startswith("navsim.") or id(function) in seen:
        return
    seen.add(id(function))
    yield from _of_value(function.__defaults__ or (), overloads, seen)
    if function.__kwdefaults__:
        raise _CannotFollow(function)
    for cell in function.__closure__ or ():
        yield from _of_value(cell.cell_contents, overloads, seen)
    yield from _of_code(function.__code__, function.__globals__, overloads, seen)
    if function in overloads:
        yield from _of_value(overloads[function], overloads, seen)


@cache
def _instructions(code: CodeType) -> tuple[dis.Instruction, ...]:
    """A function's bytecode: many kernels reach the same function."""
    return tuple(dis.get_instructions(code))


def _of_code(code: CodeType, names: dict[str, Any], overloads: Overloads, seen: set[int]) -> Iterator[str]:
    """Bytecode of a function with the values of its global names, without file names and line numbers."""
    within: Any = None
    for step in _instructions(code):
        if step.opname == "LOAD_CONST":
            if isinstance(step.argval, CodeType):
                yield from _of_code(step.argval, names, overloads, seen)
            else:
                yield f"const {step.argval!r}"
            within = None
        elif step.opname == "LOAD_GLOBAL":
            yield f"global {step.argval}"
            if step.argval in names:
                within = names[step.argval]
                yield from _of_value(within, overloads, seen)
            else:
                within = None
        elif step.opname in ("LOAD_ATTR", "LOAD_METHOD") and isinstance(within, ModuleType):
            yield f"attribute {step.argval}"
            within = getattr(within, step.argval)
            if within is None or not _outside(within):
                yield from _of_value(within, overloads, seen)
        elif step.opname not in ("PRECALL", "CACHE", "RESUME", "NOP"):
            if step.opname.startswith("IMPORT"):
                raise _CannotFollow(code)
            yield f"{step.opname} {step.argrepr}" if "JUMP" not in step.opname else f"{step.opname} {step.argval}"
            within = None


def _outside(value: Any) -> bool:
    """Whether it is another library's, which the compiler knows by name."""
    known = not isinstance(value, (*_PLAIN, tuple, list, np.ndarray))
    return known and not str(getattr(value, "__module__", "")).startswith("navsim.")
