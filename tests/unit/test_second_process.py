"""A second process compiles the last pieces of a kernel, where there is room for it, and may be lost."""

from __future__ import annotations

import io
import os
import pickle
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from numba import float64, types
from numba.core import event

from navsim.compiler import jit, last_pieces, second_process
from navsim.compiler.kernel_pieces import Kernel, KernelCompiler
from navsim.geodesy.attitude_kernels import rotate_in_nav_axes
from navsim.runner import machine
from navsim.runner.reporter import Reporter
from navsim.runner.target import locked_target

ROTATION = {"dispatcher": rotate_in_nav_axes, "args": (types.float64[::1], float64, float64, float64)}


def uncached(function: Callable[[float], float]) -> Any:
    """A kernel without a file that keeps it."""
    return Kernel(function, targetoptions={"nopython": True}, pipeline_class=KernelCompiler)


def compiled_first(enough: Callable[[], bool]) -> list[str]:
    """Pieces of one kernel that the second process would compile, in its order."""
    names: list[str] = []

    class Finished(event.Listener):
        def on_start(self, _: Any) -> None:
            """A kernel begins before its pieces."""

        def on_end(self, event: Any) -> None:
            if event.data["dispatcher"].overloads:
                names.append(event.data["dispatcher"].py_func.__name__)

    @uncached
    def first(x: float) -> float:
        return x + 1.0

    @uncached
    def first_within(x: float) -> float:
        return x + 2.0

    @uncached
    def last_within(x: float) -> float:
        return x + 3.0

    @uncached
    def last(x: float) -> float:
        return float(first_within(x) + last_within(x))

    outer = uncached(lambda x: first(x) + last(x))
    order = last_pieces.LastFirst(enough)
    with order.installed(), event.install_listener("numba:compile", Finished()):
        order.compile_pieces(outer, (float64,))
    assert not outer.overloads
    assert outer(1.0) == 9.0, "it is compiled as usual afterwards"
    return names


def test_the_last_pieces_are_compiled_first() -> None:
    assert compiled_first(enough=lambda: False) == ["last_within", "first_within", "last", "first"]


def test_pieces_that_nobody_needs_any_more_are_not_compiled() -> None:
    assert compiled_first(enough=lambda: True) == []


def test_pieces_lie_on_disk_and_a_killed_second_process_is_not_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(second_process, "_WORTH_S", -1.0)
    second = second_process.SecondProcess(has_room=lambda: True)
    try:
        with event.install_listener("numba:compile", second):
            with event.trigger_event("numba:compile", data=ROTATION):
                until = time.monotonic() + 120.0
                while not list(tmp_path.rglob("*half_sinc*.nbc")) and time.monotonic() < until:
                    assert second.lives()
                    time.sleep(0.05)
                assert time.monotonic() < until
                assert second.process is not None
                second.process.send_signal(signal.SIGINT)  # Ctrl-C ends the first process, and it the second
                with pytest.raises(subprocess.TimeoutExpired):
                    second.process.wait(0.05)
                second.process.kill()
                second.process.wait()
            with event.trigger_event("numba:compile", data=ROTATION):
                assert not second.lives(), "one that died is not started again"
        second._tell(None)
    finally:
        second.end()
    assert second.process is not None
    assert second.process.stdin is not None
    assert second.process.stdin.closed, "its pipe is no longer open, although it took not all"


def test_the_second_process_ends_with_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[int] = []
    orders: SimpleQueue[bytes] = SimpleQueue()
    monkeypatch.setattr(os, "_exit", ended.append)
    last_pieces._listen(io.BytesIO(pickle.dumps(b"an order") + pickle.dumps(b"one cut off")[:-3]), orders)
    assert orders.get(timeout=0.0) == b"an order"
    assert ended == [0]


@pytest.mark.parametrize(("worth_s", "room"), [(60.0, True), (-1.0, False)])
def test_none_for_a_small_kernel_or_without_memory(worth_s: float, room: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_process, "_WORTH_S", worth_s)
    second = second_process.SecondProcess(has_room=lambda: room)
    with event.install_listener("numba:compile", second), event.trigger_event("numba:compile", data=ROTATION):
        assert second.process is None


@pytest.mark.parametrize(
    ("workers", "cores", "kept", "used"),
    [(2, 2.0, True, True), (1, 2.0, True, False), (2, 1.5, True, False), (2, 2.0, False, False)],
)
def test_only_where_two_workers_have_two_cores_and_code_is_kept(
    workers: int, cores: float, kept: bool, used: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began: list[bool] = []

    def begin(_: Callable[[], bool]) -> AbstractContextManager[None]:
        began.append(True)
        return nullcontext()

    monkeypatch.setattr(jit, "keeps", lambda: kept)
    monkeypatch.setattr(machine, "usable_cores", lambda: cores)
    monkeypatch.setattr(second_process, "second_process", begin)
    with locked_target(tmp_path / "a.h5", "a kind that nobody compiled", Reporter(print, print), workers):
        assert bool(began) == used
