"""A second process that compiles the last pieces of a kernel while this process compiles the first.

The pieces of a kernel are the kernels that it calls. They are compiled before it and kept on disk (`kernel_cache`). The
second process (`last_pieces`) is told the kernel and the types of its arguments, and begins with the last piece. This
process finds what lies on disk by then, and nothing else passes between the two: if the second process fails, is killed
or never begins, this one compiles all.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core import event

_WORTH_S = 0.5
"""A kernel that is compiled after this time needs no second process, s; the start of one takes a second."""
_COMMAND = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); sys.path[:] = {path!r}; "
    "from navsim.compiler.last_pieces import serve; serve()"
)
SWITCH = "NAVSIM_SECOND_PROCESS"
"""With `off` in this variable of the environment there is no second process."""


class SecondProcess(event.Listener):
    """Starts the second process when a kernel takes long, and tells it which kernels are compiled."""

    def __init__(self, has_room: Callable[[], bool]) -> None:
        """has_room: whether there is memory for it now."""
        self._has_room = has_room
        self._in_hand: list[Any] = []
        self._begun = 0.0
        self._told = False
        self.process: subprocess.Popen[bytes] | None = None

    def on_start(self, event: Any) -> None:
        """A kernel that Python calls is begun, or one within it."""
        if not self._in_hand:
            self._begun, self._told = time.monotonic(), False
        self._in_hand.append(event.data)
        if not self._told and (self.lives() or time.monotonic() - self._begun > _WORTH_S):
            self._told = True
            if self.lives() or self._start():
                outermost = self._in_hand[0]
                function = outermost["dispatcher"].py_func
                self._tell((function.__module__, function.__qualname__, tuple(outermost["args"])))

    def on_end(self, event: Any) -> None:
        """It is finished."""
        del self._in_hand[-1:]  # none where another thread began before this listened
        if not self._in_hand and self.lives():
            self._tell(None)

    def lives(self) -> bool:
        """Whether there is a second process."""
        return self.process is not None and self.process.poll() is None

    def end(self) -> None:
        """End it and close its pipe."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            assert self.process.stdin is not None
            with suppress(OSError):  # of orders that it has not taken
                self.process.stdin.close()

    def _start(self) -> bool:
        """Whether it could be started; one that failed is not started again."""
        if (self.process is not None and self.process.returncode) or not self._has_room():
            return False
        self.end()
        command = [sys.executable, "-P", "-c", _COMMAND.format(path=sys.path)]
        nothing = subprocess.DEVNULL
        try:
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=nothing, stderr=nothing)
        except OSError:
            return False
        return True

    def _tell(self, order: tuple[str, str, tuple[Any, ...]] | None) -> None:
        """Name a kernel by module, name and types of arguments; None: the last one is finished."""
        assert self.process is not None
        assert self.process.stdin is not None
        with suppress(OSError):  # it has just ended
            pickle.dump(pickle.dumps(order), self.process.stdin)
            self.process.stdin.flush()


@contextmanager
def second_process(has_room: Callable[[], bool]) -> Iterator[None]:
    """Context in which kernels are compiled by two processes if they take long and there is room (memory)."""
    from navsim.compiler.linker import LINKED

    if not LINKED or not sys.executable or os.environ.get(SWITCH) == "off":
        yield
        return
    second = SecondProcess(has_room)
    try:
        with event.install_listener("numba:compile", second):
            yield
    finally:
        second.end()
