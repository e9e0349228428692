"""Record of a search on disk: analyses as they are made and steps as they are finished.

A search is reproducible to the bit. After a kill it starts again and reads its earlier results. A covariance analysis
is a line of a journal; a finished step is a piece of the study's partial work.
"""

from __future__ import annotations

import errno
import io
import os
import zlib
from collections.abc import Callable

import numpy as np

from navsim.runner.checkpoint import JOURNAL, Arrays, CheckpointError, CheckpointStore


class SearchLog:
    """The partial work of a search; without a store it forgets. Not for several threads."""

    def __init__(self, store: CheckpointStore | None = None) -> None:
        """Raises CheckpointError where the store's folder does not take the journal."""
        self._store = store
        self._known: dict[tuple[str, bytes], bytes] = {}
        self._file: io.FileIO | None = None
        if store is None:
            return
        path = store.folder / JOURNAL
        try:
            self._file = open(path, "a+b", buffering=0)  # noqa: SIM115 - as long as the search
            self._file.seek(0)
            self._file.truncate(self._read(self._file.read()))
        except OSError as error:
            raise CheckpointError(f"{path}: cannot be kept: {error.strerror or error}") from None

    def _read(self, content: bytes) -> int:
        """Read complete lines up to the first incomplete one; returns their end."""
        assert self._store is not None
        end = 0
        for line in content.splitlines(keepends=True):
            parts = line.decode("ascii", errors="replace").split()
            if len(parts) != 4 or not line.endswith(b"\n") or parts[3] != self._check(*parts[:3]):
                self._store.redone += 1
                break
            fidelity, places, value = parts[:3]
            self._known[fidelity, bytes.fromhex(places.strip("."))] = bytes.fromhex(value)
            end += len(line)
        return end

    def _check(self, fidelity: str, places: str, value: str) -> str:
        assert self._store is not None
        return f"{zlib.crc32(self._store.identity + f'{fidelity} {places} {value}'.encode()):08x}"

    def remembering(
        self, fidelity: str, judge: Callable[[np.ndarray], np.ndarray]
    ) -> Callable[[np.ndarray], np.ndarray]:
        """Evaluator of placements (n, k, 2) that looks into the journal first, one placement at a time.

        Its value of a placement must not depend on the others. Raises CheckpointError if the disk is full.
        """
        if self._store is None:
            return judge

        def remembered(places: np.ndarray) -> np.ndarray:
            return np.concatenate([self._value(fidelity, judge, places[i : i + 1]) for i in range(len(places))])

        return remembered

    @property
    def keeps(self) -> bool:
        """Whether it can return what it has recorded."""
        return self._store is not None

    def knows(self, fidelity: str, place: np.ndarray) -> bool:
        """Whether the value of a placement (1, k, 2) is known."""
        return _key(fidelity, place) in self._known

    def learn(self, fidelity: str, place: np.ndarray, value: np.ndarray) -> None:
        """Keep the value (1,) of a placement (1, k, 2). Raises CheckpointError where the disk is full."""
        key, known = _key(fidelity, place), np.asarray(value, np.float64).tobytes()
        if self._known.setdefault(key, known) is known:
            # the empty placement is a dot: a line has four words
            words = fidelity, key[1].hex() or ".", known.hex()
            self._append(f"{' '.join(words)} {self._check(*words)}\n")

    def _value(self, fidelity: str, judge: Callable[[np.ndarray], np.ndarray], place: np.ndarray) -> np.ndarray:
        if not self.knows(fidelity, place):
            self.learn(fidelity, place, judge(place))
        return np.frombuffer(self._known[_key(fidelity, place)])

    def _append(self, line: str) -> None:
        assert self._store is not None
        assert self._file is not None
        content = line.encode()
        try:
            written = self._file.write(content)
            if written != len(content):  # an incomplete line would hide those after it
                self._file.truncate(self._file.tell() - (written or 0))
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            path = self._store.folder / JOURNAL
            raise CheckpointError(f"{path}: cannot be written: {error.strerror or error}") from None

    def step(self, name: str, work: Callable[[], Arrays]) -> Arrays:
        """Arrays of a finished step, from the journal, or computed and recorded. Raises CheckpointError."""
        kept = self._store.read(name) if self._store is not None else None
        if kept is not None:
            return kept
        arrays = work()
        if self._store is not None:
            self._store.write(name, arrays)
        return arrays


def _key(fidelity: str, place: np.ndarray) -> tuple[str, bytes]:
    return fidelity, np.ascontiguousarray(place, np.float64).tobytes()
