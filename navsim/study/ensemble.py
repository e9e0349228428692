"""Many runs of one case: batches on threads, reduced in the order of runs, finished ones kept on disk.

A batch is a fixed number of runs. What it leaves is small (per-run statistics, sums over its runs) but for the
histories the user asked to keep; both go to one file of the folder `RESULT.partial`, each with its checksum. A
study that was killed resumes from the batches found whole there. Every run has its own random streams and
batches are added up in order, so no number depends on workers, order or interruptions.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

BATCH = 25
"""Runs a batch: some tenths of a second of work, a few megabytes of histories."""

_CHECKSUM = ".sha256"
_KEY_FILE = "key.json"


class PartialError(Exception):
    """A folder of partial work that belongs to another study, or cannot be written."""


Arrays = dict[str, np.ndarray]


class Study(Protocol):
    """What the engine needs of a study."""

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1: per-run statistics (count, ...), sums over the runs, histories
        to keep (count, ...)."""


@dataclass(frozen=True)
class Batch:
    """One finished batch; histories are in memory, or in `file` where there is one."""

    per_run: dict[str, np.ndarray]
    sums: dict[str, np.ndarray]
    kept: dict[str, np.ndarray] | None
    file: Path | None = None

    def history(self, name: str) -> np.ndarray:
        """A kept history (runs of the batch, ...)."""
        if self.kept is not None:
            return self.kept[name]
        assert self.file is not None
        with np.load(self.file, allow_pickle=False) as arrays:  # its checksum was seen when the batch was opened
            return arrays[f"k:{name}"]


@dataclass(frozen=True)
class Ensemble:
    """All runs, first_run, first_run + 1, ...; what statistics need is in memory, histories come batch by batch."""

    first_run: int
    runs: int
    batches: list[Batch]

    def per_run(self, name: str) -> np.ndarray:
        """A per-run statistic (runs, ...)."""
        return np.concatenate([b.per_run[name] for b in self.batches])

    def mean(self, name: str) -> np.ndarray:
        """A sum over runs, divided by their number."""
        total = np.zeros_like(self.batches[0].sums[name])
        for batch in self.batches:
            total = total + batch.sums[name]
        return total / self.runs

    def blocks(self, name: str) -> Iterator[np.ndarray]:
        """A kept history, batch by batch."""
        for batch in self.batches:
            yield batch.history(name)

    def __getitem__(self, name: str) -> np.ndarray:
        """A kept history of all runs at once (runs, ...)."""
        return np.concatenate(list(self.blocks(name)))


def _save(path: Path, batch: Batch) -> None:
    """Write a batch, then its checksum beside it: without the checksum the batch does not count."""
    memory = io.BytesIO()
    groups = {"r": batch.per_run, "s": batch.sums, "k": batch.kept or {}}
    arrays: dict[str, Any] = {f"{g}:{name}": a for g, members in groups.items() for name, a in members.items()}
    np.savez(memory, **arrays)
    content = memory.getbuffer()
    path.write_bytes(content)
    path.with_suffix(_CHECKSUM).write_text(hashlib.sha256(content).hexdigest())


def _load(path: Path) -> Batch:
    """Read a batch but for its histories; raises ValueError where the checksum does not fit, OSError where a
    file is missing or cannot be read."""
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != path.with_suffix(_CHECKSUM).read_text():
        raise ValueError(f"{path}: damaged")
    groups: dict[str, dict[str, np.ndarray]] = {"r": {}, "s": {}}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        for name in arrays.files:
            group, _, member = name.partition(":")
            if group in groups:
                groups[group][member] = arrays[name]
    return Batch(groups["r"], groups["s"], None, path)


class Store:
    """The folder of partial work of one study."""

    def __init__(self, folder: Path, key: dict[str, Any], fresh: bool) -> None:
        """Open or create the folder. Raises PartialError where another study's work lies there."""
        self.folder = folder
        self.redone = 0
        if fresh and folder.is_dir():
            shutil.rmtree(folder)
        mine = json.dumps(key, sort_keys=True, indent=1)
        try:
            if (folder / _KEY_FILE).is_file():
                theirs = (folder / _KEY_FILE).read_text()
                if theirs != mine:
                    raise PartialError(_difference(folder, theirs, key))
            else:
                folder.mkdir(parents=True, exist_ok=True)
                (folder / _KEY_FILE).write_text(mine)
        except OSError as error:
            raise PartialError(f"{folder}: partial work cannot be kept there: {error.strerror or error}") from None

    def _path(self, first: int) -> Path:
        return self.folder / f"runs-{first:09d}.npz"

    def load(self, first: int) -> Batch | None:
        """The batch that begins with run `first`, its histories left on disk; None where it must be flown."""
        try:
            return _load(self._path(first))
        except FileNotFoundError:
            return None
        except (ValueError, OSError):
            self.redone += 1
            return None

    def save(self, first: int, batch: Batch) -> Batch:
        """Keep a finished batch. Raises PartialError where the disk does not take it."""
        path = self._path(first)
        try:
            _save(path, batch)
        except OSError as error:
            raise PartialError(
                f"{path}: cannot be written: {error.strerror or error}; the batches before it are kept and the same "
                "command goes on from there"
            ) from None
        return Batch(batch.per_run, batch.sums, None, path)

    def remove(self) -> None:
        """Delete the folder: the result is complete."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _difference(folder: Path, theirs: str, mine: dict[str, Any]) -> str:
    try:
        other = json.loads(theirs)
        parts = [f"{k} {other.get(k)!r} there, {v!r} here" for k, v in mine.items() if other.get(k) != v]
    except (ValueError, AttributeError):
        parts = ["its key is damaged"]
    return f"{folder}: partial work of another study lies there ({'; '.join(parts)}); --fresh discards it"


def fly_all(
    study: Study,
    first_run: int,
    runs: int,
    workers: int,
    store: Store | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
    size: int = BATCH,
) -> Ensemble:
    """Fly the runs in batches of `size` on `workers` threads (the kernels release the GIL).

    store: keeps finished batches and gives back those of an earlier attempt. `done(n)` is told how many runs are
    finished. enough: asked after every batch, in the order of runs, whether the ensemble so far will do; it then
    ends there, wherever the other workers are, so the end does not depend on them either. Raises what a batch
    raises, PartialError where the store is full; KeyboardInterrupt passes through once the batches in flight
    are kept.
    """
    starts = range(first_run, first_run + runs, size)
    finished: dict[int, Batch] = {}
    for first in starts:
        known = store.load(first) if store else None
        if known is not None:
            finished[first] = known

    def count(first: int) -> int:
        return min(size, first_run + runs - first)

    def job(first: int) -> tuple[int, Batch]:
        batch = Batch(*study.batch(first, count(first)))
        return first, store.save(first, batch) if store else batch

    def report() -> None:
        done(sum(count(first) for first in finished))

    checked = 0

    def settled() -> Ensemble | None:
        """The shortest ensemble that will do, as far as batches are finished without a gap."""
        nonlocal checked
        while enough and checked < len(starts) and starts[checked] in finished:
            checked += 1
            so_far = Ensemble(first_run, min(checked * size, runs), [finished[first] for first in starts[:checked]])
            if enough(so_far):
                return so_far
        return None

    report()
    if (ended := settled()) is not None:
        return ended
    todo = iter([first for first in starts if first not in finished])
    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        flying: set[Future[tuple[int, Batch]]] = set()
        try:
            while True:
                # no more than a batch in waiting per worker, so that memory does not grow with the number of runs
                while len(flying) < 2 * workers and (start := next(todo, None)) is not None:
                    flying.add(pool.submit(job, start))
                if not flying:
                    break
                ready, flying = wait(flying, return_when=FIRST_COMPLETED)
                for future in ready:
                    first, batch = future.result()
                    finished[first] = batch
                report()
                if (ended := settled()) is not None:
                    for future in flying:
                        future.cancel()
                    return ended
        except BaseException:
            for future in flying:
                future.cancel()
            raise
    return Ensemble(first_run, runs, [finished[first] for first in starts])
