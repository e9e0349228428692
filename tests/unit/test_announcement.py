"""What is said while kernels are compiled."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

from numba.core import event

import navsim
from navsim.compiler.announcement import PARTS, announced
from navsim.compiler.kernel_pieces import Kernel, KernelCompiler


def uncached(function: Callable[[float], float]) -> Kernel:
    """A kernel without a file that keeps it."""
    return Kernel(function, targetoptions={"nopython": True}, pipeline_class=KernelCompiler)


def test_compilation_says_whose_kernel_and_for_how_long() -> None:
    """Nothing before and after it; a kernel within another counts as part of it."""
    inner = uncached(lambda x: 2.0 * x)
    outer = uncached(lambda x: inner(x) + 1.0)
    said: list[str] = []
    with announced(said.append, every=0.001):
        time.sleep(0.02)
        before = len(said)
        assert outer(1.0) == 3.0
        during = len(said)
        time.sleep(0.02)
    assert before == 0 < during == len(said)
    assert {re.sub(r"\d+ s", "0 s", line) for line in said} == {"compiling the kernels of this computation, 0 s so far"}


def test_each_package_with_kernels_has_a_name_for_navigators() -> None:
    package = Path(navsim.__file__).parent
    having = {f.relative_to(package).parts[0] for f in package.rglob("*.py") if "@kernel" in f.read_text("utf-8")}
    assert having - {"compiler"} <= PARTS.keys()
    assert len(having) > 5


def test_a_compilation_that_began_before_may_end() -> None:
    """That of another thread, whose kernel the context does not know."""
    made = uncached(lambda x: x)
    begun = event.trigger_event("numba:compile", data={"dispatcher": made})
    begun.__enter__()
    with announced(lambda _: None):
        begun.__exit__(None, None, None)
