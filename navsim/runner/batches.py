"""Run many runs of one case: batches on workers, reduced in the order of runs, finished ones kept on disk.

A batch is a fixed number of runs. Its output is small (statistics of each run, sums over its runs), except for
histories that the user keeps. Both go to one piece of the study's partial work (`runner.checkpoint`). A killed study
resumes from the batches found intact there. Every run has its own random streams and sums are those of
`runner.exact_sums`, so no number depends on workers, batches, order or interruptions.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent import futures
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from navsim.runner.checkpoint import Arrays, CheckpointStore, StoredArray
from navsim.runner.exact_sums import Sums
from navsim.runner.executor import Executor, RemoteExecutor

BATCH = 32
"""Runs a batch: some tenths of a second of work, a few megabytes of histories."""


class Study(Protocol):
    """Interface of a study for the engine."""

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1: per-run statistics (count, ...), sums over the runs as
        `sums.Sums.arrays` has them, histories to keep (count, ...)."""


@dataclass(frozen=True)
class Batch:
    """One finished batch; histories are in memory, or on disk."""

    per_run: dict[str, np.ndarray]
    sums: dict[str, np.ndarray]
    kept: Mapping[str, np.ndarray | StoredArray]


class Ensemble:
    """Runs first_run, first_run + 1, ... finished so far; statistics are in memory, histories are read batch by
    batch."""

    def __init__(self, first_run: int, most: int) -> None:
        """most: runs that will come; room for them is taken at once, and is no memory before they do."""
        self.first_run, self.runs, self._most = first_run, 0, most
        self._columns: dict[str, np.ndarray] = {}
        self._sums = Sums()
        self._kept: list[Mapping[str, np.ndarray | StoredArray]] = []

    def add(self, batch: Batch) -> None:
        """The next batch, in the order of runs. Of the batch itself only its histories stay: there may be thousands."""
        before = count = self.runs
        for name, values in batch.per_run.items():
            count = before + values.shape[0]
            if name not in self._columns:
                self._columns[name] = np.empty((self._most, *values.shape[1:]), values.dtype)
            self._columns[name][before:count] = values
        self._sums.extend(self.first_run + before, count - before, batch.sums)
        if batch.kept:
            self._kept.append(batch.kept)
        self.runs = count

    def per_run(self, name: str) -> np.ndarray:
        """A per-run statistic (runs, ...), not to be changed."""
        return self._columns[name][: self.runs]

    def total(self, name: str) -> np.ndarray:
        """A sum over runs."""
        return self._sums.total(name)

    def mean(self, name: str) -> np.ndarray:
        """A sum over runs, divided by their number."""
        return self.total(name) / self.runs

    def columns(self) -> Arrays:
        """All per-run statistics by name, not to be changed."""
        return {name: self.per_run(name) for name in self._columns}

    def sums(self) -> Arrays:
        """All sums over runs, see `sums.Sums.arrays`."""
        return self._sums.arrays()

    def blocks(self, name: str) -> Iterator[np.ndarray]:
        """A kept history, batch by batch. Raises CheckpointError if its file is damaged."""
        for kept in self._kept:
            history = kept[name]
            yield history.read() if isinstance(history, StoredArray) else history

    def __getitem__(self, name: str) -> np.ndarray:
        """A kept history of all runs at once (runs, ...)."""
        return np.concatenate(list(self.blocks(name)))


def _piece(first: int) -> str:
    return f"runs-{first:09d}"


def _load(store: CheckpointStore, first: int) -> Batch | None:
    """The batch that begins with run `first`, its histories left on disk; None where it must be flown. Raises
    CheckpointError where it was damaged just now."""
    found = store.find(_piece(first))
    if found is None:
        return None
    per_run, sums = ({name: kept.read() for name, kept in _group(found, group).items()} for group in "rs")
    return Batch(per_run, sums, _group(found, "k"))


def save(store: CheckpointStore, first: int, **groups: Arrays) -> dict[str, StoredArray]:
    """Keep a finished batch; its histories are on disk from then on. Raises CheckpointError."""
    arrays = {f"{group}:{name}": array for group, members in groups.items() for name, array in members.items()}
    return _group(store.write(_piece(first), arrays), "k")


def _group(found: dict[str, StoredArray], group: str) -> dict[str, StoredArray]:
    """The arrays of a piece that are of one group."""
    return {name[2:]: kept for name, kept in found.items() if name.startswith(f"{group}:")}


Stretch = tuple[int, int]
"""The first run of a batch, and how many it has."""


def _fly(study: Study, store: CheckpointStore | None, first: int, count: int) -> tuple[int, Batch]:
    """Work of a worker that can access the store."""
    per_run, sums, kept = study.batch(first, count)
    return first, Batch(per_run, sums, save(store, first, r=per_run, s=sums, k=kept) if store else kept)


class _LocalBatches:
    """A pool whose workers reach the store: a batch is a task, and they keep it."""

    def __init__(self, pool: futures.Executor, workers: int, study: Study, store: CheckpointStore | None) -> None:
        self._pool, self._study, self._store = pool, study, store
        self.room = 2 * workers
        """Tasks at a time: no more than a batch in waiting per worker, so that memory does not grow with the runs."""

    def submit(self, todo: deque[Stretch]) -> Future[Any] | None:
        """The next task; None where nothing is left to do."""
        return self._pool.submit(_fly, self._study, self._store, *todo.popleft()) if todo else None

    def done(self, future: Future[Any]) -> list[tuple[int, Batch]]:
        """Batches of a finished task. Raises its errors."""
        return [future.result()]


TASK_S = 2.0
"""Duration of a task of remote workers, s; sending one takes some milliseconds."""
TASK_BYTES = 64e6
"""The most that one of them is to bring back, bytes."""
AHEAD = 2
"""Waiting tasks for each remote worker, in addition to the one in progress."""


def _fly_away(study: Study, stretches: list[Stretch]) -> tuple[float, list[tuple[Arrays, Arrays, Arrays]]]:
    """Work of a remote worker: the batches, and the seconds of the quickest of them."""
    found, seconds = [], []
    for first, count in stretches:
        began = time.perf_counter()
        found.append(study.batch(first, count))
        seconds.append(time.perf_counter() - began)
    return min(seconds), found


class _RemoteBatches:
    """Batches on workers without access to the store.

    A task has enough batches to be worth sending; its results are kept here.
    """

    def __init__(self, pool: RemoteExecutor, study: Study, store: CheckpointStore | None) -> None:
        self._pool, self._store = pool, store
        self._study = pool.share(study)
        self._stretches: dict[Future[Any], list[Stretch]] = {}
        self._most = 1

    @property
    def room(self) -> int:
        """Tasks at a time; workers come and go."""
        return (1 + AHEAD) * max(1, self._pool.workers)

    def submit(self, todo: deque[Stretch]) -> Future[Any] | None:
        """The next task; None where nothing is left to do."""
        if not todo:
            return None
        number = min(self._most, max(1, len(todo) // self.room))  # towards the end so few that all workers have some
        stretches = [todo.popleft() for _ in range(number)]
        future = self._pool.submit(_fly_away, self._study, stretches)
        self._stretches[future] = stretches
        return future

    def done(self, future: Future[Any]) -> list[tuple[int, Batch]]:
        """Batches of a finished task, now kept. Raises its errors, and CheckpointError if the store is full."""
        seconds, found = future.result()
        out = []
        for (first, _), (per_run, sums, kept) in zip(self._stretches.pop(future), found, strict=True):
            histories = save(self._store, first, r=per_run, s=sums, k=kept) if self._store else kept
            out.append((first, Batch(per_run, sums, histories)))
        size = sum(array.nbytes for group in found[0] for array in group.values())
        worth = TASK_S / max(seconds, 1e-6)
        # the first batch of a worker loads its kernels: later ones show better how long one takes
        self._most = max(self._most, int(min(worth, TASK_BYTES / max(size, 1))))
        return out


@dataclass
class Until:
    """Stopping rule of an ensemble. judge: returns whether it is met, and the progress, which `words` keeps."""

    judge: Callable[[Ensemble], tuple[bool, str]]
    words: str = ""

    def __call__(self, ensemble: Ensemble) -> bool:
        enough, self.words = self.judge(ensemble)
        return enough


def fly_all(
    study: Study,
    first_run: int,
    runs: int,
    executor: Executor,
    store: CheckpointStore | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
    size: int = BATCH,
) -> Ensemble:
    """Run all runs in batches of `size` on the executor's workers.

    - `store`: keeps finished batches and returns those of an earlier attempt.
    - `done(n)`: receives the number of finished runs.
    - `enough`: called after every batch, in the order of runs; True ends the work. The end does not depend on the
      progress
      of other workers.

    Raises what a batch raises, and CheckpointError if the store is full. KeyboardInterrupt passes through once the
    batches in progress are kept.
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
    todo = deque((first, count(first)) for first in starts if first not in finished)
    if settled():
        return ensemble
    with executor.pool(executor.workers) as pool:
        crew = (
            _RemoteBatches(pool, study, store)
            if isinstance(pool, RemoteExecutor)
            else _LocalBatches(pool, executor.workers, study, store)
        )
        flying: set[Future[Any]] = set()
        try:
            while True:
                while len(flying) < crew.room and (task := crew.submit(todo)) is not None:
                    flying.add(task)
                if not flying:
                    break
                ready, flying = wait(flying, return_when=FIRST_COMPLETED)
                for future in ready:
                    for first, batch in crew.done(future):
                        finish(first, batch)
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
