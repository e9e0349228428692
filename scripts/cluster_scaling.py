"""Write docs/cluster-measured.md: what a task costs on this machine, and what follows for many workers.

    python scripts/cluster_scaling.py

It starts a Dask scheduler and two workers, measures tasks of the shipped landing, and simulates 10, 100 and 1000
workers, event by event, with one client and one scheduler, each a server that does one thing at a time. Nothing but the
figures of the first table goes into the simulation.
"""

from __future__ import annotations

import heapq
import pickle
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from measured import commit

from navsim.compiler.jit import is_warm
from navsim.landing import study as landing
from navsim.landing.ensemble import LandingStudy
from navsim.runner.batches import AHEAD, BATCH, TASK_BYTES, TASK_S, save
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.cluster import Cluster
from navsim.scenario.load import read

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "cluster-measured.md"
KEEPS = ("none", "errors", "all")
WORKERS = (1, 10, 100, 1000)
RUNS = 1_000_000
TASKS = 300
REPEATS = 5


@dataclass(frozen=True)
class Costs:
    """Of a batch: seconds a worker flies it, bytes it brings back, seconds the client keeps it. Of a task: seconds the
    client and the scheduler together hand out and take back one that does nothing, and seconds a megabyte takes."""

    flown_s: float
    size: float
    kept_s: float
    task_s: float
    megabyte_s: float

    @property
    def batches(self) -> int:
        """Batches of a task, as `runner.batches` makes them."""
        return max(1, int(min(TASK_S / self.flown_s, TASK_BYTES / self.size)))

    def client_s(self) -> float:
        """Seconds the client, with the scheduler that runs beside it, has to do with a task."""
        return self.task_s + self.batches * (self.kept_s + self.megabyte_s * self.size / 1e6)


def identity(what: bytes) -> bytes:
    """A task that does nothing."""
    return what


def quickest(times: list[float]) -> float:
    """The time that other work on this machine has lengthened least."""
    return min(times)


def measured(address: str) -> tuple[dict[str, Costs], int]:
    """The costs by `--keep`, and the bytes of the study that is sent once."""
    case = landing.prepare(*read(ROOT / "scenarios" / "landing.yaml"))
    pool = Cluster(address)
    try:
        task_s = quickest([_through(pool, b"", TASKS) / TASKS for _ in range(REPEATS)])
        large = bytes(8_000_000)
        megabyte_s = quickest([_through(pool, large, 4) / 4 / (2 * len(large) / 1e6) for _ in range(REPEATS)])
    finally:
        pool.close()
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        for keep in KEEPS:
            study = LandingStudy(case, 1, keep)
            study.batch(0, BATCH)
            flown, kept = [], []
            store = CheckpointStore(Path(folder) / keep, {}, False)
            for i in range(REPEATS):
                began = time.thread_time()  # of the processor alone: others may be at work here
                per_run, sums, histories = study.batch(i * BATCH, BATCH)
                flown.append(time.thread_time() - began)
                began = time.perf_counter()
                save(store, i * BATCH, r=per_run, s=sums, k=histories)
                kept.append(time.perf_counter() - began)
            size = sum(array.nbytes for group in (per_run, sums, histories) for array in group.values())
            out[keep] = Costs(quickest(flown), float(size), quickest(kept), task_s, megabyte_s)
    return out, len(pickle.dumps(LandingStudy(case, 1, "none")))


def _through(pool: Cluster, what: bytes, number: int) -> float:
    """Seconds for so many tasks that do nothing, all results fetched."""
    began = time.perf_counter()
    for future in [pool.submit(identity, what) for _ in range(number)]:
        future.result()
    return time.perf_counter() - began


def simulated(costs: Costs, workers: int, runs: int = RUNS) -> tuple[float, float]:
    """Seconds from the first task to the last result kept, and the share of them in which the client is busy.

    Workers take tasks from one queue. The client keeps what is finished, first come first served, and hands out one
    more task after each; at most 1 + `AHEAD` tasks a worker are out.
    """
    left = -(-runs // (BATCH * costs.batches))
    length = costs.batches * costs.flown_s
    handing = 0.5 * costs.task_s
    keeping = costs.client_s() - handing
    queue: deque[float] = deque()
    idle, done = workers, 0
    total = left
    clock = busy = 0.0
    running: list[float] = []
    room = (1 + AHEAD) * workers
    out = 0
    finished: deque[float] = deque()
    while done < total:
        # workers whose task is done by now, and those that find one in the queue
        while running and running[0] <= clock:
            at = heapq.heappop(running)
            finished.append(at)
            if queue:
                heapq.heappush(running, max(at, queue.popleft()) + length)
            else:
                idle += 1
        if left and out < room:
            clock, busy = clock + handing, busy + handing
            left, out = left - 1, out + 1
            if idle:
                idle -= 1
                heapq.heappush(running, clock + length)
            else:
                queue.append(clock)
        elif finished:
            finished.popleft()
            clock, busy = clock + keeping, busy + keeping
            done, out = done + 1, out - 1
        else:
            clock = running[0]
    return clock, busy / clock


def page(costs: dict[str, Costs], size: int) -> str:
    """The page."""
    some = costs["none"]
    lines = [
        "# How far a cluster reaches",
        "",
        f"Made by `python scripts/cluster_scaling.py` with the code of commit {commit()}.",
        "",
        "| | |",
        "|---|---|",
        "| first table | measured: one machine with a scheduler and two workers; `landing.yaml`, "
        f"batches of {BATCH} runs |",
        "| second table | an event-by-event simulation with these costs, without start of workers, transfer of "
        "the study, slow networks and disks |",
        f"| the study | {size / 1e6:.1f} MB, sent once to each worker |",
        f"| costs of client and scheduler | {1e3 * some.task_s:.1f} ms an empty task, "
        f"{1e3 * some.megabyte_s:.1f} ms a megabyte |",
        "",
        "| `--keep` | simulation of a batch, s | its result, MB | storing it, ms | batches a task | task, s | "
        "client's time a task, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    for keep, c in costs.items():
        lines.append(
            f"| {keep} | {c.flown_s:.3f} | {c.size / 1e6:.2f} | {1e3 * c.kept_s:.1f} | {c.batches} | "
            f"{c.batches * c.flown_s:.2f} | {1e3 * c.client_s():.1f} |"
        )
    lines += [
        "",
        "A million runs, by the number of workers of one thread each:",
        "",
        "| `--keep` | workers | time, s | speed-up | efficiency | client busy |",
        "|---|---|---|---|---|---|",
    ]
    for keep, c in costs.items():
        alone = simulated(c, 1)[0]
        for workers in WORKERS[1:]:
            seconds, busy = simulated(c, workers)
            gain = alone / seconds
            shares = f"{100 * gain / workers:.0f} % | {100 * busy:.0f} %"
            lines.append(f"| {keep} | {workers} | {seconds:.0f} | {gain:.0f} | {shares} |")
    most = (f"{c.batches * c.flown_s / c.client_s():.0f} (`{keep}`)" for keep, c in costs.items())
    lines += [
        "",
        f"The client keeps about this many workers busy: {', '.join(most)}. For more use a job array, `--first-run`",
        "and `navsim merge` ([beyond one machine](cluster.md)).",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, simulate, write."""
    if not is_warm("landing-monte-carlo-tfg"):
        print("the kernels are compiled first", file=sys.stderr)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "dask"]
    commands = [
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"],
        *([[*dask, "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]] * 2),
    ]
    started = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for command in commands]
    try:
        end = time.monotonic() + 60
        while time.monotonic() < end:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", int(port))) == 0:
                    break
            time.sleep(0.2)
        costs, size = measured(address)
    finally:
        for each in started:
            each.kill()
            each.wait()
    PAGE.write_text(page(costs, size))


if __name__ == "__main__":
    main()
