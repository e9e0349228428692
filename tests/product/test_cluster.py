"""`--scheduler`: a real Dask scheduler and its workers on this machine, killed at will, and always the same numbers."""

from __future__ import annotations

import re
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from navsim.results.result import read
from navsim.runner.executor import WorkerLost
from navsim.scenario import load
from navsim.scenario_files.source import InputError
from tests import forks
from tests.conftest import SCENARIOS
from tests.forks import Running, navsim
from tests.product.test_run import stored

pytest.importorskip("distributed")

LIMIT_S = 300.0
"""Whatever takes longer hangs."""


def start(*words: object, cwd: Path) -> Running:
    """A command that ends with the test, whatever becomes of it."""
    return forks.shared().start(*words, cwd=cwd, limit_s=LIMIT_S)


class Cluster:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.file = folder / "scheduler.json"
        self.processes: list[Running] = []
        self.start()

    def start(self) -> None:
        """A scheduler, and two workers."""
        self.file.unlink(missing_ok=True)
        self.scheduler = self._dask(
            "scheduler", "--host", "127.0.0.1", "--port", self.port, "--no-dashboard", "--no-show",
            "--scheduler-file", self.file,
        )  # fmt: skip
        self.workers = [self.worker(), self.worker()]
        self.wait_for(2)

    def worker(self, *options: object) -> Running:
        return self._dask("worker", self.address, "--nthreads", 1, "--no-nanny", "--no-dashboard", *options)

    def _dask(self, *words: object) -> Running:
        made = forks.shared().start(*words, cwd=self.folder, program=forks.DASK, limit_s=2 * LIMIT_S)
        self.processes.append(made)
        return made

    def wait_for(self, workers: int) -> None:
        """Until so many workers are there."""
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)
            end = time.monotonic() + 60
            while len(client.scheduler_info(n_workers=-1)["workers"]) != workers and time.monotonic() < end:
                time.sleep(0.1)

    def close(self) -> None:
        for each in self.processes:
            each.send_signal(signal.SIGKILL)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cluster")


def swept(place: Path) -> Path:
    """A sweep by covariance analysis."""
    study = place / "sweep.yaml"
    study.write_text(
        f"kind: sweep\nversion: 1\nbase: {SCENARIOS / 'landing_gnss_only.yaml'}\nmethod: covariance\n"
        "outputs: [pdop, horizontal]\n"
        "set: {duration_s: 61, receiver.rate_hz: 1, imu.rate_hz: 10, pseudolites.frame: runway, pseudolites.count: 1}\n"
        "vary:\n  - {key: pseudolites.s_m, values: [100, 400]}\n  - {key: pseudolites.l1_m, values: [0, 500, 900]}\n"
    )
    return study


@pytest.fixture(scope="module")
def cluster(place: Path) -> Iterator[Cluster]:
    study = ("sweep", swept(place), "-q", "--figures", "none", "-o", place / "warm.h5")
    forks.shared().prepare([study], ["distributed.cli.dask_scheduler", "distributed.cli.dask_worker"])
    with ExitStack() as stack:
        made = Cluster(place)
        stack.callback(made.close)
        yield made


QUICK = ("--set", "duration_s=65", "--set", "receiver.rate_hz=1", "--set", "imu.rate_hz=20")
PLAIN = (*QUICK, "--set", "filter.kind=eskf")
"""A filter that flies ten times as fast, where it is all the same which."""
RUNS = 192
LONG = ("run", SCENARIOS / "landing.yaml", *QUICK, "--runs", RUNS, "--keep", "none", "-q")
"""Six batches, some seconds."""


@pytest.fixture(scope="module")
def undisturbed(place: Path) -> Path:
    file = place / "undisturbed.h5"
    navsim(*LONG, "-o", file, cwd=place)
    return file


def pieces(file: Path) -> dict[str, int]:
    """Finished pieces, and when each was written."""
    return {path.name: path.stat().st_mtime_ns for path in Path(f"{file}.partial").glob("*.npz")}


def ended(running: Running, code: int) -> str:
    """What a command said until its end, with this code."""
    done = running.ended(LIMIT_S)
    assert done.code == code, done.err
    assert "Traceback" not in done.err
    return done.err


def some_finished(running: Running, file: Path, number: int = 1) -> None:
    """Wait until a command has finished some pieces."""
    end = time.monotonic() + LIMIT_S
    while len(pieces(file)) < number and not running.has_ended() and time.monotonic() < end:
        time.sleep(0.005)


def test_runs_are_those_of_threads(cluster: Cluster, place: Path) -> None:
    command = ("run", SCENARIOS / "landing.yaml", *PLAIN, "--runs", 80, "--keep", "all", "-q")
    navsim(*command, "-o", "threads.h5", cwd=place)
    navsim(*command, "-o", "dask.h5", "--scheduler", cluster.file, cwd=place)
    assert stored(place / "dask.h5") == stored(place / "threads.h5")
    assert not (place / "dask.h5.partial").exists()


def test_pushed_runs_end_where_those_of_threads_end(cluster: Cluster, place: Path) -> None:
    """What `--until` finds enough depends on nobody's speed."""
    command = (
        "run", SCENARIOS / "landing.yaml", *PLAIN, "--until", "rms_horizontal within 25%", "--keep", "none", "-q",
        "--over-budget",
    )  # fmt: skip
    navsim(*command, "-o", "until-threads.h5", cwd=place)
    navsim(*command, "-o", "until-dask.h5", "--scheduler", cluster.address, cwd=place)
    assert stored(place / "until-dask.h5") == stored(place / "until-threads.h5")


@pytest.mark.long
def test_sweep_is_that_of_threads(cluster: Cluster, place: Path) -> None:
    study = swept(place)
    command = ("sweep", study, "-q", "--figures", "none")
    navsim(*command, "-o", "sweep-threads.h5", cwd=place)
    navsim(*command, "-o", "sweep-dask.h5", "--scheduler", cluster.address, cwd=place)
    assert stored(place / "sweep-dask.h5") == stored(place / "sweep-threads.h5")
    assert (place / "sweep-dask.csv").read_bytes() == (place / "sweep-threads.csv").read_bytes()


@pytest.mark.long
def test_search_is_that_of_one_machine(cluster: Cluster, place: Path) -> None:
    study = place / "optimize.yaml"
    study.write_text(
        f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing_gnss_only.yaml'}\n"
        "set: {duration_s: 61, receiver.rate_hz: 1, imu.rate_hz: 10}\npseudolites: [1]\nobjective: vertical\n"
        "effort: 1\nsites:\n" + "".join(f"  - {{s_m: {s}, l1_m: {l1}}}\n" for s in (100, 900) for l1 in (0, 400))
    )
    command = ("optimize", study, "-q", "--figures", "none", "--runs", 8)
    navsim(*command, "-o", "search-here.h5", cwd=place)
    navsim(*command, "-o", "search-dask.h5", "--scheduler", cluster.address, cwd=place)
    assert stored(place / "search-dask.h5") == stored(place / "search-here.h5")


def test_errors_of_workers_come_back_as_they_are(cluster: Cluster, tmp_path: Path) -> None:
    from navsim.runner.cluster import Cluster as Pool

    file = tmp_path / "a.yaml"
    file.write_text("kind: landing\nversion: 1\n")
    with pytest.raises(InputError) as here:
        load.read(file)
    pool = Pool(cluster.address)
    try:
        with pytest.raises(InputError) as there:
            pool.submit(load.read, file).result(60)
        assert list(map(str, there.value.problems)) == list(map(str, here.value.problems))
        assert f"{file}:1:1: epoch: this key is required" in map(str, there.value.problems)
    finally:
        pool.close()


def test_dry_run_asks_nothing_of_this_machine_that_workers_have(cluster: Cluster, place: Path) -> None:
    done = navsim(*LONG, "-o", "told.h5", "--dry-run", "--scheduler", cluster.address, cwd=place)
    assert f"on 2 workers of {cluster.address}" in done.stderr
    assert not (place / "told.h5").exists()


def test_a_worker_is_killed(cluster: Cluster, place: Path, undisturbed: Path) -> None:
    file = place / "worker-killed.h5"
    running = start(*LONG, "-o", file, "--scheduler", cluster.address, cwd=place)
    some_finished(running, file)
    cluster.workers[0].send_signal(signal.SIGKILL)
    said = ended(running, 0)
    assert "kept" not in said
    assert stored(file) == stored(undisturbed)
    cluster.workers[0] = cluster.worker()
    cluster.wait_for(2)


def test_interrupt_keeps_what_is_finished_and_leaves_the_scheduler(cluster: Cluster, place: Path) -> None:
    file = place / "interrupted.h5"
    running = start(*LONG, "-o", file, "--scheduler", cluster.address, cwd=place)
    some_finished(running, file)
    running.send_signal(signal.SIGINT)
    assert "the same command continues from there" in ended(running, 130)
    assert pieces(file)
    assert not cluster.scheduler.has_ended()


def test_the_scheduler_is_killed_and_another_goes_on(cluster: Cluster, place: Path, undisturbed: Path) -> None:
    file = place / "scheduler-killed.h5"
    running = start(*LONG, "-o", file, "--scheduler", cluster.address, cwd=place)
    some_finished(running, file)
    cluster.scheduler.send_signal(signal.SIGKILL)
    said = ended(running, 3)
    assert f"the scheduler {cluster.address} is gone" in said
    assert "the same command continues from there" in said
    before = pieces(file)
    assert 0 < len(before) < RUNS // 32
    cluster.close()
    cluster.start()
    running = start(*LONG, "-o", file, "--scheduler", cluster.address, cwd=place)
    some_finished(running, file, len(before) + 1)
    after = pieces(file) or before  # none where it was already done
    assert {name: after[name] for name in before} == before  # none was flown twice
    ended(running, 0)
    assert stored(file) == stored(undisturbed)
    assert read(file)["/summary/count/runs"] == RUNS


def test_a_worker_of_another_version_is_refused(cluster: Cluster, place: Path) -> None:
    preload = place / "other_version.py"
    preload.write_text("import navsim\nnavsim.__version__ = '0.0.9'\n")
    other = cluster.worker("--preload", preload)
    try:
        cluster.wait_for(3)
        done = navsim(*LONG, "-o", "refused.h5", "--scheduler", cluster.address, cwd=place, code=2)
        assert "has navsim 0.0.9 where this machine has" in done.stderr
    finally:
        other.send_signal(signal.SIGKILL)
        cluster.wait_for(2)


def test_a_late_worker_of_another_version_is_named(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    from navsim.runner import cluster as module

    pool = module.Cluster(cluster.address)
    try:
        ours = module.versions() | {"numba": "0.1"}
        monkeypatch.setattr(module, "versions", lambda: ours)
        with pytest.raises(WorkerLost, match=r"has numba .* where this machine has 0\.1"):
            pool.submit(len, [1]).result(60)
    finally:
        pool.close()


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    from navsim.runner import cluster as module
    from navsim.runner.job import OptionError

    monkeypatch.setattr(module, "CONNECT_S", 0.3)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
        with pytest.raises(OptionError, match=f"--scheduler {address}: no scheduler answers there"):
            module.Cluster(address)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scheduler", "nowhere.json"), "neither an address as tcp://HOST:PORT nor a scheduler's file"),
        (("--scheduler", "tcp://"), "no scheduler answers there"),
        (("--scheduler", "tcp://127.0.0.1:1", "--workers", 2), "--workers: threads of this machine"),
        (("--scheduler", "tcp://127.0.0.1:1", "--method", "covariance"), "--scheduler: only for method monte-carlo"),
    ],
)
def test_what_is_no_scheduler_is_refused(options: tuple[object, ...], words: str, place: Path) -> None:
    done = navsim("run", SCENARIOS / "landing.yaml", *options, "-o", "refused.h5", cwd=place, code=2)
    assert words in done.stderr


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "it is empty, also after 0.3 s; start `dask scheduler --scheduler-file` with it, or give the address"),
        (b'{"type": "Scheduler", "address": "tcp://127.0.', "it is not JSON"),
        (b"\x00\xff", "it is not JSON"),
        (b"[]", "it has no `address`"),
        (b'{"address": 5}', "its `address` is none, such as tcp://HOST:PORT"),
        (b"[" * 100_000, "it is not JSON"),
    ],
)
def test_a_schedulers_file_that_is_not_whole(
    content: bytes, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is read again for a while, since a scheduler may be about to write it."""
    from navsim.runner import cluster as module
    from navsim.runner.job import OptionError

    monkeypatch.setattr(module, "CONNECT_S", 0.3)
    file = tmp_path / "scheduler.json"
    file.write_bytes(content)
    with pytest.raises(OptionError, match=re.escape(said)):
        module.Cluster(str(file))
    monkeypatch.setattr(module, "CONNECT_S", 60.0)
    whole = b'{"type": "Scheduler", "address": "tcp://127.0.0.1:1"}'
    monkeypatch.setattr(module.time, "sleep", lambda seconds: file.write_bytes(whole))
    assert module._address_in(str(file)) == "tcp://127.0.0.1:1"


@pytest.mark.parametrize("file", ["/dev/zero", "/proc/self/pagemap", "."])
def test_a_schedulers_file_that_is_none(file: str) -> None:
    from navsim.runner import cluster as module
    from navsim.runner.job import OptionError

    with pytest.raises(OptionError, match="cannot be read: "):
        module.Cluster(file)


def test_without_dask_the_way_to_it_is_said(place: Path) -> None:
    code = "import sys; sys.modules['distributed'] = None; from navsim.__main__ import main; main()"
    words = ("-c", code, "run", SCENARIOS / "landing.yaml", "--scheduler", "tcp://127.0.0.1:1")
    done = forks.shared().run(*words, cwd=place, program=forks.PYTHON)
    assert done.code == 2
    assert "pip install '.[cluster]'" in done.err
