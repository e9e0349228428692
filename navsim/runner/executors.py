"""Choice of the executor of a job: threads of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from navsim.runner.errors import BadInput, as_problems, translate_errors
from navsim.runner.reporter import Reporter

if TYPE_CHECKING:
    from navsim.runner.executor import Executor
    from navsim.runner.job import Options

INSTALL = "pip install '.[cluster]' in the folder of navsim"


@contextmanager
def open_executor(options: Options, speech: Reporter) -> Iterator[Executor]:
    """Context of the executor that options request; a connection to a cluster ends with it.

    Raises BadInput, and RunFailed if there is no answer.
    """
    from navsim.runner.executor import threads

    if options.scheduler is None:
        yield threads(options.workers)
        return
    if options.workers is not None:
        raise BadInput(as_problems("--workers: threads of this machine; with --scheduler the cluster has its own"))
    try:
        from navsim.runner.cluster import Cluster, connected
        from navsim.runner.cluster import executor as of
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] not in ("cloudpickle", "dask", "distributed"):
            raise
        message = f"--scheduler works on a Dask cluster, and Dask is not installed here: {INSTALL}"
        raise BadInput(as_problems(message)) from None
    with translate_errors("--scheduler"):
        cluster = Cluster(options.scheduler)
    with connected(cluster):
        if not cluster.workers:
            speech.say(f"{options.scheduler}: no worker is there yet; waiting for one")
        yield of(cluster)
