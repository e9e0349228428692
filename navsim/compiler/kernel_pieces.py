"""Compile kernels that other kernels call only as far as linking needs, once.

numba creates machine code for every called function, and optimises its code again in each of its callers. Here only
kernels that Python calls are optimised, together with everything that is linked into them, and become machine code. The
pieces remain unoptimised LLVM code. A piece that Python calls later is then compiled as usual.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import llvmlite.binding as llvm
from numba.core import ir, sigutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, compile_result
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.environment import lookup_environment
from numba.core.ir_utils import get_definition, guard
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering

from navsim.compiler.lowering import DirectLower

_depth = 0
"""Nesting depth of kernels in compilation; protected by the compiler's lock."""


def within_another() -> bool:
    """Whether the kernel that is being compiled is a piece of another."""
    return _depth > 1


@contextmanager
def _one_deeper() -> Iterator[None]:
    global _depth
    with global_compiler_lock, _seldom_collected() if _depth == 0 else nullcontext():
        _depth += 1
        try:
            yield
        finally:
            _depth -= 1


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Python looks through a compiler's objects for garbage less often, and not through those from before: that would
    take an eighth of the time."""
    usual = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)
    try:
        yield
    finally:
        gc.set_threshold(*usual)
        gc.unfreeze()


class _Unfinished(JITCodeLibrary):
    """Code to be linked: not optimised as a whole, and without machine code."""

    def _optimize_final_module(self) -> None:
        """No operation: the library that links this code optimises it."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


def is_piece(result: Any) -> bool:
    """Whether it is code to be linked alone."""
    return isinstance(result.library, _Unfinished)


def piece_state(piece: Any) -> tuple[Any, ...]:
    """State of a piece for pickle."""
    described = piece.fndesc
    described.typemap = described.calltypes = None  # neither needed nor sure to be pickled
    code = piece.library.serialize_using_bitcode()
    return code, described, piece.environment, piece.signature, piece.reload_init


def restore_piece(target: Any, kept: tuple[Any, ...]) -> Any:
    """The piece with the state from `piece_state`."""
    (name, _, bitcode), described, environment, signature, reload_init = kept
    for reload in reload_init:
        reload()
    library = _Unfinished(target.codegen(), name)
    library._final_module = llvm.parse_bitcode(bitcode)
    library._finalize_final_module()
    return compile_result(
        typing_context=target.typing_context, target_context=target, entry_point=_entry(), signature=signature,
        objectmode=False, lifted=(), fndesc=described, library=library, environment=environment,
        reload_init=reload_init, referenced_envs=(),
    )  # fmt: skip


def _entry() -> Any:
    """Entry point of a piece, which is never called: numba identifies functions by their entry points, and takes a
    built-in one."""
    return [].append


_VIEWS = frozenset({
    "build_tuple", "cast", "exhaust_iter", "getattr", "getitem", "getiter", "iternext", "null", "pair_first",
    "pair_second", "phi", "static_getitem", "typed_getitem", "undef",
})  # fmt: skip
"""Expressions whose arrays have the memory of their operands."""


def _borrows_all(state: Any) -> bool:
    """Whether a function returns no array and owns none, so that it need not count references to its arrays.

    That is half of the code of a function, and some of its time.
    """
    from navsim.compiler.lanes import BORROWING  # not before something is compiled

    def has_owner(kind: Any) -> bool:
        return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())

    def borrows(value: Any) -> bool:
        if not isinstance(value, ir.Expr) or value.op in _VIEWS:
            return True
        if value.op != "call":
            return False
        called = guard(get_definition, state.func_ir, value.func)
        return isinstance(state.typemap[value.func.name], types.NamedTupleClass) or (
            isinstance(called, ir.Global | ir.FreeVar) and called.value in BORROWING
        )

    def keeps_count(step: Any) -> bool:
        if isinstance(step, ir.SetItem | ir.StaticSetItem):  # numba copies an array that it assigns
            return has_owner(state.typemap[step.value.name])
        return isinstance(step, ir.DynamicRaise) or (
            isinstance(step, ir.Assign) and has_owner(state.typemap[step.target.name]) and not borrows(step.value)
        )

    blocks = state.func_ir.blocks.values()
    return not has_owner(state.return_type) and not any(keeps_count(step) for block in blocks for step in block.body)


@register_pass(mutates_CFG=True, analysis_only=False)
class _PieceLowering(NativeLowering):
    """Lowering of pieces, which ends there."""

    _name = "navsim_piece_lowering"
    lowering_class = DirectLower

    def run_pass(self, state: Any) -> bool:
        if _borrows_all(state):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        state.library = _Unfinished(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags = state.flags.copy()
        for name in ("no_compile", "no_cpython_wrapper", "no_cfunc_wrapper"):
            setattr(state.flags, name, True)
        super().run_pass(state)
        lowered = state["cr"] = state["cr"]._replace(cfunc=_entry())
        state.targetctx.insert_user_function(lowered.cfunc, lowered.fndesc, [state.library])
        state.reload_init.extend(state.library._reload_init)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(NativeLowering):
    """Lowering of a kernel that Python calls; it passes information to its pieces as numba does for its own code."""

    _name = "navsim_kernel_lowering"
    lowering_class = DirectLower

    def run_pass(self, state: Any) -> bool:
        super().run_pass(state)
        for variable in state.library._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                state.library.codegen.set_env(variable.name, environment)
        return True


def _passes(state: Any, lowering: type[NativeLowering]) -> list[PassManager]:
    """numba's own passes, with another lowering."""
    passes = PassManager(lowering._name)
    passes.passes = [
        (lowering, text) if made is NativeLowering else (made, text)
        for build in (
            DefaultPassBuilder.define_untyped_pipeline,
            DefaultPassBuilder.define_typed_pipeline,
            DefaultPassBuilder.define_nopython_lowering_pipeline,
        )
        for made, text in build(state).passes
    ]
    passes.finalize()
    return [passes]


class PieceCompiler(CompilerBase):
    """Compiler for functions that only kernels call."""

    def define_pipelines(self) -> list[PassManager]:
        return _passes(self.state, _PieceLowering)


class KernelCompiler(CompilerBase):
    """Compiles kernels."""

    def define_pipelines(self) -> list[PassManager]:
        return _passes(self.state, _PieceLowering if within_another() else _KernelLowering)


class Kernel(CPUDispatcher):
    """A compiled function: a piece where another one calls it, machine code where Python does."""

    def compile(self, sig: Any) -> Any:
        """The entry for a signature."""
        with _one_deeper():
            arguments = tuple(sigutils.normalize_signature(sig)[0])
            known = self.overloads.get(arguments)
            if known is not None and is_piece(known) and not within_another():
                del self.overloads[arguments]
            return super().compile(sig)

    def add_overload(self, cres: Any) -> None:
        """Make a result known, to Python where it has an entry."""
        if is_piece(cres):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)
