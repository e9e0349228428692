"""The one door to the linker of kernels (`kernel_pieces`), which saves half of the first run's time.

It stands on numba's inner classes. Where a version of numba has others, or with `NAVSIM_LINKER=off`, numba's own
compiler takes its place: the results are the same.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Any

from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

_pieces: Any = None
if os.environ.get("NAVSIM_LINKER") != "off":
    with suppress(ImportError, AttributeError):
        from navsim.compiler import kernel_pieces as _pieces

LINKED = _pieces is not None
"""Whether kernels are linked of pieces."""
Kernel: Any = _pieces.Kernel if LINKED else CPUDispatcher
KernelCompiler: Any = _pieces.KernelCompiler if LINKED else Compiler
PieceCompiler: Any = _pieces.PieceCompiler if LINKED else Compiler


def is_piece(result: Any) -> bool:
    """Whether it is code to be linked alone."""
    return LINKED and bool(_pieces.is_piece(result))


def within_another() -> bool:
    """Whether the kernel that is being compiled is a piece of another."""
    return LINKED and bool(_pieces.within_another())


def piece_state(piece: Any) -> tuple[Any, ...]:
    """State of a piece for pickle."""
    return _pieces.piece_state(piece)


def restore_piece(target: Any, kept: tuple[Any, ...]) -> Any:
    """The piece with the state from `piece_state`."""
    return _pieces.restore_piece(target, kept)
