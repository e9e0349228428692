"""The work of the second process (`second_process`): it compiles the pieces of a kernel, the last ones first.

Before a piece is compiled, its types are inferred once with its calls of kernels in the opposite order, which compiles
the last pieces within it first. The piece itself is then compiled as in any process, so that its code is the same.
"""

from __future__ import annotations

import itertools
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from inspect import getclosurevars
from queue import Empty, SimpleQueue
from threading import Thread
from types import ModuleType
from typing import Any, BinaryIO

from numba.core import event, types
from numba.core.bytecode import FunctionIdentity
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NopythonTypeInference
from numba.core.typeinfer import CallConstraint, ConstraintNetwork

_IDLE_S = 5.0
"""The process ends after this time without work, s."""
_FIRST_NUMBER = 1_000_000
"""Names of functions in machine code contain numbers. With these, no two functions of both processes have one name."""


class _Superseded(BaseException):
    """No more of this kernel is needed."""


class _Inferred(BaseException):
    """All types of a function are known."""


@register_pass(mutates_CFG=False, analysis_only=True)
class _End(FunctionPass):
    """The end of inference."""

    _name = "navsim_end"

    def __init__(self) -> None:
        """No state; numba asks for the method."""

    def run_pass(self, state: Any) -> bool:
        raise _Inferred


class _Inference(CompilerBase):
    """Infers types, which compiles the pieces."""

    def define_pipelines(self) -> list[PassManager]:
        passes = PassManager(_End._name)
        for build in (DefaultPassBuilder.define_untyped_pipeline, DefaultPassBuilder.define_typed_pipeline):
            passes.passes += build(self.state).passes
        last = next(i for i, (made, _) in enumerate(passes.passes) if made is NopythonTypeInference)
        passes.passes[last + 1 :] = [(_End, _End._name)]
        passes.finalize()
        return [passes]


def _calls_kernel(constraint: Any, inference: Any) -> bool | None:
    """Whether a constraint of the inference is a kernel's call; None for a call of a function that is not known yet."""
    if type(constraint) is not CallConstraint:
        return False
    called = inference.typevars[constraint.func]
    return isinstance(called.type, types.Dispatcher) if called.defined else None


def _has_pieces(function: Callable[..., Any]) -> bool:
    """Whether a function may call several kernels; those of one need no order."""
    named = getclosurevars(function)
    seen = [*named.nonlocals.values(), *named.globals.values()]
    kernels = sum(isinstance(value, Dispatcher) for value in seen)
    return kernels > 1 or any(isinstance(value, ModuleType) and value.__name__.startswith("navsim") for value in seen)


class LastFirst(event.Listener):
    """Compiles the last pieces of a kernel first; `enough` tells whether to stop before the next piece."""

    def __init__(self, enough: Callable[[], bool]) -> None:
        self._enough = enough
        self._backwards = False
        self._usual: list[bool] = []

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Context of its work."""
        network: Any = ConstraintNetwork
        usual = network.propagate

        def propagate(of_function: Any, inference: Any) -> Any:
            if not self._backwards:
                return usual(of_function, inference)
            every = of_function.constraints
            known = None
            try:
                while known != (known := inference.get_state_token()):
                    of_function.constraints = [one for one in every if _calls_kernel(one, inference) is False]
                    errors = usual(of_function, inference)
                of_function.constraints = [one for one in reversed(every) if _calls_kernel(one, inference)]
                return errors + usual(of_function, inference)
            finally:
                of_function.constraints = every

        network.propagate = propagate
        try:
            with event.install_listener("numba:compile", self):
                yield
        finally:
            network.propagate = usual

    def compile_pieces(self, kernel: Any, arguments: tuple[Any, ...]) -> None:
        """Compile the pieces of a kernel for arguments of these types."""
        with suppress(_Superseded):
            kernel.compile(arguments)
        self._usual.clear()
        self._backwards = False

    def on_start(self, event: Any) -> None:
        """A kernel or piece is begun."""
        outermost = not self._usual
        self._usual.append(self._backwards)
        begun = event.data["dispatcher"]
        if not self._enough() and (outermost or _has_pieces(begun.py_func)):
            self._infer(begun, event.data["args"])
        if outermost or self._enough():
            raise _Superseded
        self._backwards = False

    def on_end(self, event: Any) -> None:
        """It is finished."""
        self._backwards = self._usual.pop()

    def _infer(self, kernel: Any, arguments: tuple[Any, ...]) -> None:
        self._backwards = True
        compiler = kernel._compiler
        usual, compiler.pipeline_class = compiler.pipeline_class, _Inference
        try:
            # an error is that of the order: compiling it as usual decides
            with suppress(Exception, _Inferred):
                compiler._compile_core(arguments, None)
        finally:
            compiler.pipeline_class = usual


def _listen(told: BinaryIO, orders: SimpleQueue[bytes]) -> None:
    """Pass on what the first process tells; end with it."""
    with suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            orders.put(pickle.load(told))
    os._exit(0)


def serve() -> None:
    """Compile pieces of the kernels that standard input names, until nothing more comes."""
    orders: SimpleQueue[bytes] = SimpleQueue()
    Thread(target=_listen, args=(sys.stdin.buffer, orders), daemon=True).start()
    FunctionIdentity._unique_ids = itertools.count(_FIRST_NUMBER)
    last_first = LastFirst(enough=lambda: not orders.empty())
    with last_first.installed(), suppress(Empty):
        while True:
            order = pickle.loads(orders.get(timeout=_IDLE_S))
            if order is not None:
                module, name, arguments = order
                last_first.compile_pieces(getattr(import_module(module), name), arguments)
