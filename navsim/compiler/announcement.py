"""Messages while kernels are compiled, which takes a minute at the first work of a kind."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from numba.core import event

_SAY_EVERY_S = 5.0

PARTS = {
    "companions": "the tracking filters", "compiler": "arithmetic", "error_propagation": "the covariance analysis",
    "filter": "the navigation filter",
    "geodesy": "positions and attitudes on the Earth", "gnss": "the satellite receiver",
    "integrity": "protection levels", "ranging": "the filter of ranges", "sensors": "the inertial sensors",
    "simulation": "the simulated measurements", "statistics": "noise and statistics", "trajectory": "the autopilot",
}  # fmt: skip
"""What the kernels of each package compute, in the words of a navigator."""


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
    """Context that says every few seconds (`every`) which part of navsim is being compiled, and for how long so far."""
    ended, begun, in_hand = Event(), time.monotonic(), _InHand()

    def watch() -> None:
        while not ended.wait(every):
            for module in in_hand.modules[:1]:
                part = PARTS.get(module.removeprefix("navsim.").partition(".")[0], "this computation")
                say(f"compiling the kernels of {part}, {time.monotonic() - begun:.0f} s so far")

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        with event.install_listener("numba:compile", in_hand):
            yield
    finally:
        ended.set()
        watcher.join()
