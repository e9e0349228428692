"""Whatever does the work of an ensemble, its numbers are the same to the bit."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from navsim.landing.ensemble import HISTORIES
from navsim.landing.study import fly_all
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.executor import Executor, threads
from tests.helpers import case, in_brief


def processes(workers: int) -> ProcessPoolExecutor:
    """Workers that share nothing with this process, as on another machine."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


@pytest.mark.parametrize("kept", in_brief([False, True], 1), ids=["in memory", "on disk"])
def test_processes_fly_what_threads_fly(kept: bool, tmp_path: Path) -> None:
    here = case("receiver.rate_hz=1")
    store = CheckpointStore(tmp_path / "partial", {}, False) if kept else None
    ours = fly_all(here, 3, 0, 30, threads(1), keep="all")
    theirs = fly_all(here, 3, 0, 30, Executor(2, processes), keep="all", store=store)
    for name in HISTORIES["all"]:
        np.testing.assert_array_equal(theirs[name], ours[name], err_msg=name)
    np.testing.assert_array_equal(theirs.mean("nees"), ours.mean("nees"))
    if store is not None:
        opened = CheckpointStore(tmp_path / "partial", {}, False)
        again = fly_all(here, 3, 0, 30, Executor(2, _none), keep="all", store=opened)
        np.testing.assert_array_equal(again["error"], ours["error"])


def _none(workers: int) -> ProcessPoolExecutor:
    class Idle(ProcessPoolExecutor):
        def submit(self, *_: object, **__: object) -> None:
            pytest.fail("all batches are in the store")

    return Idle(workers)
