"""Parallel analysis of placements by remote workers, before a search evaluates them one by one.

Each step of a search depends on the one before, so the search itself stays here and is the same to the bit. The
placements that it will need next are analysed remotely and kept in its journal, where it finds them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait

import numpy as np

from navsim.optimization.placement import ObjectiveFunction, Rules
from navsim.optimization.search_log import SearchLog
from navsim.runner.executor import RemoteExecutor

WORTH_S = 0.5
"""Least duration of a task if there are enough placements, s."""
_LOOK_S = 0.5
"""Interval of progress reports while the search waits, s."""
ObjectiveFunctions = dict[str, dict[str, ObjectiveFunction]]
"""Evaluators of each fidelity, by their names in the journal."""


def _analysed(judges: ObjectiveFunctions, fidelity: str, places: np.ndarray) -> tuple[float, dict[str, np.ndarray]]:
    """Work of a remote worker: values of placements one by one, as the search computes them, and seconds a
    placement."""
    began = time.perf_counter()
    found = {
        name: np.concatenate([np.asarray(judge(places[i : i + 1]), np.float64) for i in range(len(places))])
        for name, judge in judges[fidelity].items()
    }
    return (time.perf_counter() - began) / len(places), found


class Prefetcher:
    """Has placements (n, k, 2) analysed by a fidelity; their values are in the journal then."""

    def __init__(
        self,
        judges: ObjectiveFunctions,
        rules: Rules,
        journal: SearchLog,
        pool: RemoteExecutor,
        look: Callable[[], None],
    ) -> None:
        """look: called while it waits; raises where the search is to end."""
        self._judges, self._rules, self._journal, self._pool, self._look = judges, rules, journal, pool, look
        self._shared = pool.share(judges)
        self._seconds: dict[str, float] = {}

    def __call__(self, places: np.ndarray, fidelity: str) -> None:
        """Analyse placements. Raises errors of the work, executor.WorkerLost, CheckpointError if the journal cannot be
        written."""
        names = tuple(self._judges[fidelity])
        kept = self._rules.violation(places) <= 0.0  # others are not analysed at all
        todo = [
            place
            for place, usable in zip(places, kept, strict=True)
            if usable and not all(self._journal.knows(name, place[None]) for name in names)
        ]
        seconds = self._seconds.get(fidelity, WORTH_S)
        size = max(1, int(np.ceil(WORTH_S / max(seconds, 1e-6))))
        if len(todo) <= size:  # a single task: the search does it itself
            return
        flying = {
            self._pool.submit(_analysed, self._shared, fidelity, some): some
            for some in (np.array(todo[i : i + size]) for i in range(0, len(todo), size))
        }
        try:
            while flying:
                ready, _ = wait(flying, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
                for future in ready:
                    some = flying.pop(future)
                    seconds, found = future.result()
                    self._seconds[fidelity] = min(seconds, self._seconds.get(fidelity, seconds))
                    for name, values in found.items():
                        for place, value in zip(some, values, strict=True):
                            self._journal.learn(name, place[None], np.array([value]))
                self._look()
        except BaseException:
            for future in flying:
                future.cancel()
            raise
