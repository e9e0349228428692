"""Many runs of one case: batches on workers, reduced in the order of runs, finished ones kept on disk.

A batch is a fixed number of runs. What it leaves is small (per-run statistics, sums over its runs) but for the
histories the user asked to keep; both go to one piece of the study's partial work (`study.partial`). A study that was
killed resumes from the batches found whole there. Every run has its own random streams and batches are added up in
order, so no number depends on workers, order or interruptions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from navsim.study.executor import Executor
from navsim.study.partial import Arrays, Kept, Store

BATCH = 32
"""Runs a batch: some tenths of a second of work, a few megabytes of histories."""


class Study(Protocol):
    """What the engine needs of a study."""

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1: per-run statistics (count, ...), sums over the runs, histories
        to keep (count, ...)."""


@dataclass(frozen=True)
class Batch:
    """One finished batch; histories are in memory, or on disk."""

    per_run: dict[str, np.ndarray]
    sums: dict[str, np.ndarray]
    kept: Mapping[str, np.ndarray | Kept]


class Ensemble:
    """Runs first_run, first_run + 1, ..., so many as came so far; what statistics need is in memory, histories come
    batch by batch."""

    def __init__(self, first_run: int, most: int) -> None:
        """most: runs that will come; room for them is taken at once, and is no memory before they do."""
        self.first_run, self.runs, self._most = first_run, 0, most
        self._columns: dict[str, np.ndarray] = {}
        self._sums: dict[str, np.ndarray] = {}
        self._kept: list[Mapping[str, np.ndarray | Kept]] = []

    def add(self, batch: Batch) -> None:
        """The next batch, in the order of runs. Of the batch itself only its histories stay: there may be thousands."""
        count = self.runs
        for name, values in batch.per_run.items():
            count = self.runs + values.shape[0]
            if name not in self._columns:
                self._columns[name] = np.empty((self._most, *values.shape[1:]), values.dtype)
            self._columns[name][self.runs : count] = values
        for name, values in batch.sums.items():
            self._sums[name] = self._sums[name] + values if name in self._sums else values
        if batch.kept:
            self._kept.append(batch.kept)
        self.runs = count

    def per_run(self, name: str) -> np.ndarray:
        """A per-run statistic (runs, ...), not to be changed."""
        return self._columns[name][: self.runs]

    def mean(self, name: str) -> np.ndarray:
        """A sum over runs, divided by their number."""
        return self._sums[name] / self.runs

    def blocks(self, name: str) -> Iterator[np.ndarray]:
        """A kept history, batch by batch. Raises PartialError where its file is no longer whole."""
        for kept in self._kept:
            history = kept[name]
            yield history.read() if isinstance(history, Kept) else history

    def __getitem__(self, name: str) -> np.ndarray:
        """A kept history of all runs at once (runs, ...)."""
        return np.concatenate(list(self.blocks(name)))


def _piece(first: int) -> str:
    return f"runs-{first:09d}"


def _load(store: Store, first: int) -> Batch | None:
    """The batch that begins with run `first`, its histories left on disk; None where it must be flown. Raises
    PartialError where it was damaged just now."""
    found = store.find(_piece(first))
    if found is None:
        return None
    per_run, sums = ({name: kept.read() for name, kept in _group(found, group).items()} for group in "rs")
    return Batch(per_run, sums, _group(found, "k"))


def _save(store: Store, first: int, **groups: Arrays) -> dict[str, Kept]:
    """Keep a finished batch; its histories are on disk from then on. Raises PartialError."""
    arrays = {f"{group}:{name}": array for group, members in groups.items() for name, array in members.items()}
    return _group(store.write(_piece(first), arrays), "k")


def _group(found: dict[str, Kept], group: str) -> dict[str, Kept]:
    """The arrays of a piece that are of one group."""
    return {name[2:]: kept for name, kept in found.items() if name.startswith(f"{group}:")}


def _fly(study: Study, store: Store | None, first: int, count: int) -> tuple[int, Batch]:
    """What a worker does."""
    per_run, sums, kept = study.batch(first, count)
    return first, Batch(per_run, sums, _save(store, first, r=per_run, s=sums, k=kept) if store else kept)


def fly_all(
    study: Study,
    first_run: int,
    runs: int,
    executor: Executor,
    store: Store | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
    size: int = BATCH,
) -> Ensemble:
    """Fly the runs in batches of `size` on the executor's workers.

    store: keeps finished batches and gives back those of an earlier attempt. `done(n)` is told how many runs are
    finished. enough: asked after every batch, in the order of runs, whether the ensemble so far will do; it then
    ends there, wherever the other workers are, so the end does not depend on them either. Raises what a batch
    raises, PartialError where the store is full; KeyboardInterrupt passes through once the batches in flight
    are kept.
    """
    starts = range(first_run, first_run + runs, size)
    ensemble = Ensemble(first_run, runs)
    finished: dict[int, Batch] = {}
    flown = 0

    def count(first: int) -> int:
        return min(size, first_run + runs - first)

    def finish(first: int, batch: Batch) -> None:
        nonlocal flown
        finished[first] = batch
        flown += count(first)

    def settled() -> bool:
        """Whether the batches that are finished without a gap will do, in the order of runs."""
        while (first := first_run + ensemble.runs) in finished:
            ensemble.add(finished.pop(first))
            if enough and enough(ensemble):
                return True
        return False

    if store is not None:
        for first in starts:
            if (known := _load(store, first)) is not None:
                finish(first, known)
    done(flown)
    todo = iter([first for first in starts if first not in finished])
    if settled():
        return ensemble
    with executor.pool(executor.workers) as pool:
        flying: set[Future[tuple[int, Batch]]] = set()
        try:
            while True:
                # no more than a batch in waiting per worker, so that memory does not grow with the number of runs
                while len(flying) < 2 * executor.workers and (start := next(todo, None)) is not None:
                    flying.add(pool.submit(_fly, study, store, start, count(start)))
                if not flying:
                    break
                ready, flying = wait(flying, return_when=FIRST_COMPLETED)
                for future in ready:
                    finish(*future.result())
                done(flown)
                if settled():
                    for future in flying:
                        future.cancel()
                    return ensemble
        except BaseException:
            for future in flying:
                future.cancel()
            raise
    return ensemble
