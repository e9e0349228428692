"""Messages while kernels are compiled, which takes a minute at the first work of a kind."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from numba.core import event

_SAY_EVERY_S = 5.0


class _InHand(event.Listener):
    """Kernels that are being compiled: one that Python calls, and those within it."""

    def __init__(self) -> None:
        self.modules: list[str] = []

    def on_start(self, event: Any) -> None:
        self.modules.append(event.data["dispatcher"].py_func.__module__)

    def on_end(self, event: Any) -> None:
        del self.modules[-1:]  # none where another thread began before this listened


@contextmanager
def announced(say: Callable[[str], None], every: float = _SAY_EVERY_S) -> Iterator[None]:
    """Context that says every few seconds (`every`) which kernel is being compiled, and how long it has taken so far;
    nothing while none is."""
    ended, begun, in_hand = Event(), time.monotonic(), _InHand()

    def watch() -> None:
        while not ended.wait(every):
            for module in in_hand.modules[:1]:
                say(f"compiling the kernels, {time.monotonic() - begun:.0f} s so far: now those of {module}")

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        with event.install_listener("numba:compile", in_hand):
            yield
    finally:
        ended.set()
        watcher.join()
