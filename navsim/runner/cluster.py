"""Workers of an existing Dask cluster (dask.distributed [1]), an extra that is imported on request.

The client, that is this process, keeps finished work. Workers receive a study once, and tasks of it, and return arrays.
If a worker dies, others do its tasks. If the scheduler goes, the work ends with `executor.WorkerLost`, and the same
command continues from the finished work.

Source: [1] Rocklin, Dask: parallel computation with blocked algorithms and task scheduling, SciPy (2015).
"""

from __future__ import annotations

import itertools
import json
import logging
import pickle
import platform
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent import futures
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import cloudpickle
import distributed
import llvmlite.binding
import numba
import numpy as np
from distributed.scheduler import KilledWorker

import navsim
from navsim.compiler.lanes import WIDTH
from navsim.formats.text import decoded
from navsim.results import files
from navsim.runner.checkpoint import code_key
from navsim.runner.executor import Executor, RemoteExecutor, WorkerLost
from navsim.runner.job import OptionError

_CONFIG: Any = numba.config
CONNECT_S = 5.0
"""Time-out for a scheduler's answer, s."""
_CLOSE_S = 2.0
_AGAIN_S = 0.2
"""Time after which an incomplete scheduler file is read again, s."""
_MOST_BYTES = 1_000_000
"""Largest size of a scheduler file."""


@cache
def versions() -> dict[str, str]:
    """Versions, processor target of machine code, and digests of the package here, which must agree for equal
    numbers."""
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "navsim": navsim.__version__,
        "numba": numba.__version__,
        "numpy": np.__version__,
        "processor": _CONFIG.CPU_NAME or llvmlite.binding.get_host_cpu_name(),
        "lanes": str(WIDTH),
        "code of navsim": str(code_key()["sources"]),
    }


class VersionMismatch(Exception):
    """A worker that came later and has other versions."""


def _checked(due: dict[str, str], work: Callable[..., Any], *arguments: Any) -> Any:
    """Work of a worker, if it would compute the same numbers as this machine."""
    if unlike := _differences(versions(), due):
        raise VersionMismatch(f"{distributed.get_worker().address} has {unlike}")
    return work(*arguments)


def _differences(theirs: dict[str, str], ours: dict[str, str]) -> str:
    """Differences in words, "" for none."""
    return ", ".join(f"{name} {theirs.get(name)} where this machine has {ours[name]}" for name in ours
                     if theirs.get(name) != ours[name])  # fmt: skip


class _RemoteFuture(futures.Future[Any]):
    """A task with the interface of `concurrent.futures`; its result is fetched on request, one at a time."""

    def __init__(self, theirs: Any, fetch: Callable[[Any], Any]) -> None:
        super().__init__()
        self._theirs, self._fetch = theirs, fetch
        theirs.add_done_callback(self._ended)

    def _ended(self, _: Any) -> None:
        with suppress(futures.InvalidStateError):  # it was cancelled here
            self.set_result(None)

    def cancel(self) -> bool:
        self._theirs.cancel()
        return super().cancel()

    def result(self, timeout: float | None = None) -> Any:
        super().result(timeout)
        found = self._fetch(self._theirs)
        self._theirs.release()
        return found


def _address_in(name: str) -> str:
    """Address in a scheduler file. It may still be incomplete while the scheduler starts, and is then read again.

    Raises OptionError.
    """
    end = time.monotonic() + CONNECT_S
    while True:
        try:
            content = files.content(Path(name), _MOST_BYTES)
        except FileNotFoundError:
            problem = "neither an address as tcp://HOST:PORT nor a scheduler's file"
            raise OptionError(f"--scheduler {name}: {problem}") from None
        except OSError as error:
            raise OptionError(f"--scheduler {name}: cannot be read: {error.strerror or error}") from None
        try:
            address = json.loads(decoded(content))["address"]
            if isinstance(address, str) and "://" in address:
                return address
            problem = "its `address` is none, such as tcp://HOST:PORT"
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            problem = "it has no `address`" if isinstance(error, KeyError | TypeError) else f"it is not JSON ({error})"
            problem = problem if content.strip() else "it is empty"
        if time.monotonic() > end:
            cure = "start `dask scheduler --scheduler-file` with it, or give the address, tcp://HOST:PORT"
            raise OptionError(f"--scheduler {name}: no scheduler's file: {problem}, also after {CONNECT_S:g} s; {cure}")
        time.sleep(_AGAIN_S)


class Cluster(RemoteExecutor):
    """Workers of one scheduler, which stays open."""

    def __init__(self, address: str) -> None:
        """address: tcp://HOST:PORT, tls://HOST:PORT or the scheduler's file.

        Raises OptionError if there is no answer, or if workers would compute different numbers.
        """
        self.address = address
        self._numbers = itertools.count()
        for name in ("distributed", *(name for name in logging.root.manager.loggerDict if "distributed" in name)):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # important messages are errors
        where = address if "://" in address else _address_in(address)
        warnings.filterwarnings("ignore", module="distributed")
        try:
            self._client: Any = distributed.Client(
                where, timeout=CONNECT_S, set_as_default=False, name="navsim", heartbeat_interval="2s"
            )
        except (OSError, ValueError, TypeError, KeyError) as error:
            cause = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise OptionError(f"--scheduler {address}: no scheduler answers there ({cause})") from None
        try:
            self._compare()
        except BaseException:
            self.close()
            raise

    def _compare(self) -> None:
        """Raise OptionError where a worker is unlike this machine."""
        ours = versions()
        wrong = {}
        for worker, one in self._client.get_versions()["workers"].items():
            python = ".".join(str(one["host"]["python"]).split(".")[:2])
            wrong[worker] = _differences({"python": python}, {"python": ours["python"]})
        if not any(wrong.values()):
            for worker, theirs in self._client.run(versions, on_error="return").items():
                missing = f"no navsim that can be loaded ({theirs})" if isinstance(theirs, Exception) else ""
                wrong[worker] = missing or _differences(theirs, ours)
        said = [f"{worker} has {what}" for worker, what in wrong.items() if what]
        if said:
            text = f"workers that would compute different numbers: {'; '.join(said)}"
            raise OptionError(f"--scheduler {self.address}: {text}")

    @property
    def workers(self) -> int:
        with self._watched():
            return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def share(self, what: Any) -> Any:
        # a task without data elsewhere: if all its workers are gone, it is done again
        return self._client.submit(pickle.loads, cloudpickle.dumps(what), key=self._key("study"), pure=False)

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **named: Any) -> futures.Future[Any]:
        with self._watched():
            theirs = self._client.submit(
                _checked, versions(), work, *arguments, **named, key=self._key("task"), pure=False
            )
            return _RemoteFuture(theirs, self._fetched)

    def _key(self, what: str) -> str:
        return f"navsim-{what}-{self._client.id}-{next(self._numbers)}"

    def _fetched(self, theirs: Any) -> Any:
        with self._watched():
            try:
                return theirs.result()
            except VersionMismatch as error:
                raise WorkerLost(f"a worker that would not find the same numbers: {error}") from None
            except KilledWorker as error:
                raise WorkerLost(
                    f"workers died again and again at the same task, the last of them {error.last_worker.address}; "
                    "their own logs tell why, often it is too little memory"
                ) from None

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Raise Lost if the scheduler is gone."""
        try:
            if self._client.status != "running":
                raise OSError(self._client.status)
            yield
        except (OSError, futures.CancelledError, TimeoutError, distributed.client.FutureCancelledError):
            raise WorkerLost(f"the scheduler {self.address} is gone") from None

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """The pool has no more to do; the connection stays."""

    def close(self) -> None:
        """Leave the scheduler, and its workers, to others."""
        with suppress(OSError, TimeoutError, RuntimeError):
            self._client.close(timeout=_CLOSE_S)


@contextmanager
def connected(cluster: Cluster) -> Iterator[None]:
    """Leave it at the end."""
    try:
        yield
    finally:
        cluster.close()


def executor(cluster: Cluster) -> Executor:
    """The workers of a cluster as studies take them."""
    return Executor(max(1, cluster.workers), lambda _: cluster, cluster.address)
