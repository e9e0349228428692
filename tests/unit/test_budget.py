"""Estimates of memory and disk: their parts against the arrays themselves, what the machine has, the words."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from navsim.cli.main import app
from navsim.companions.elevation import study as elevation
from navsim.landing import study as landing
from navsim.landing.ensemble import history_bytes
from navsim.landing.estimate import extent
from navsim.runner import machine as having
from navsim.runner.estimate import Budget, Machine, duration, estimate_text, lacking, size
from navsim.runner.executor import Executor
from navsim.scenario.load import read_any
from navsim.simulation.run import Run
from tests.conftest import SCENARIOS
from tests.helpers import case

FEW = ("duration_s=65", "imu.rate_hz=20", "receiver.rate_hz=2")


@pytest.mark.parametrize(
    "more",
    [
        (),
        ("duration_s=10.99", "imu.rate_hz=10", "altimeter={rate_hz: 9.1}"),
        ("receiver.latency_s=0.7",),
        ("sky.source=nominal", "receiver.single_clock=true"),
        ("imu.gyro.range_deg_s=100",),
    ],
)
def test_numbers_of_a_landing_are_those_of_its_arrays(more: tuple[str, ...]) -> None:
    here = case(*FEW, *more)
    told = extent(here.scenario, here.environment)
    run = here.fly(1, 0)
    assert told.samples == here.shared.dtheta.shape[0]
    assert (told.epochs, told.sources) == run.pseudorange.shape == here.shared.signals.range.shape
    assert told.clocks == len(set(here.shared.signals.time_scale[np.any(here.shared.signals.used, axis=0)].tolist()))
    for name in Run.__dataclass_fields__:
        assert history_bytes(name, told.sizes()) == getattr(run, name).nbytes, name


def test_a_scenario_is_asked_about_before_its_arrays_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    from navsim.landing import case as preparing

    class Refused(Exception):
        pass

    def refuse(*_: object) -> None:
        raise Refused

    monkeypatch.setattr(preparing, "world_of", lambda *_: pytest.fail("arrays were made"))
    scenario, document = read_any(SCENARIOS / "landing.yaml")
    with pytest.raises(Refused):
        landing.prepare(scenario, document, refuse)


# --- what there is


def files(root: Path, **contents: str) -> Path:
    for name, content in contents.items():
        file = root / name.replace("__", "/").replace("_DOT_", ".")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
    return root


MEMINFO = "MemTotal:       24000000 kB\nMemFree: 1 kB\nMemAvailable:    8000000 kB\n"
OWN = 1000 * 4096


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(having.os, "sysconf", lambda name: 4096)


@pytest.mark.usefixtures("page")
def test_memory_is_the_least_of_machine_and_groups(tmp_path: Path) -> None:
    proc, groups = tmp_path / "proc", tmp_path / "groups"
    files(proc, meminfo=MEMINFO, self__statm="90000 1000 5 1 0 9 0", self__cgroup="0::/a/b\n")
    assert having.available_memory(proc, groups) == 8_192_000_000 + OWN
    files(groups / "a", memory_DOT_max="3000000000", memory_DOT_current="1000000000", memory_DOT_stat="anon 5\n")
    files(groups / "a/b", memory_DOT_max="max", memory_DOT_current="1000000000")
    assert having.available_memory(proc, groups) == 2_000_000_000 + OWN
    files(groups / "a", memory_DOT_stat="anon 5\ninactive_file 300000000\n")
    assert having.available_memory(proc, groups) == 2_300_000_000 + OWN, "the cache of files is given up first"
    # a container that sees its own group as the root
    files(groups, memory_DOT_max="500000000", memory_DOT_current="100000000")
    assert having.available_memory(proc, groups) == 400_000_000 + OWN


@pytest.mark.usefixtures("page")
def test_memory_of_the_first_version_of_control_groups(tmp_path: Path) -> None:
    proc, groups = tmp_path / "proc", tmp_path / "groups"
    files(proc, meminfo=MEMINFO, self__statm="90000 1000 5", self__cgroup="5:cpu,cpuacct:/x\n4:memory:/x\n")
    files(groups / "cpu/x", memory_DOT_limit_in_bytes="1", memory_DOT_usage_in_bytes="0")
    files(groups / "memory/x", memory_DOT_limit_in_bytes="1000000000", memory_DOT_usage_in_bytes="400000000")
    files(groups / "memory", memory_DOT_limit_in_bytes=str(2**63 - 4096), memory_DOT_usage_in_bytes="4")
    assert having.available_memory(proc, groups) == 600_000_000 + OWN


def test_cores_are_those_of_the_affinity_and_of_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(having, "threads", lambda: Executor(4))
    proc, groups = tmp_path / "proc", tmp_path / "groups"
    assert having.usable_cores(proc, groups) == 4.0
    files(proc, self__cgroup="0::/a\n")
    files(groups / "a", cpu_DOT_max="max 100000\n")
    assert having.usable_cores(proc, groups) == 4.0
    files(groups / "a", cpu_DOT_max="150000 100000\n")
    assert having.usable_cores(proc, groups) == 1.5
    files(proc, self__cgroup="5:cpu,cpuacct:/x\n")
    files(groups / "cpu/x", cpu_DOT_cfs_quota_us="-1\n", cpu_DOT_cfs_period_us="100000\n")
    files(groups / "cpu", cpu_DOT_cfs_quota_us="50000\n", cpu_DOT_cfs_period_us="100000\n")
    assert having.usable_cores(proc, groups) == 0.5


def test_nothing_is_told_by_files_that_are_not_there(tmp_path: Path) -> None:
    told = having.available_memory(tmp_path, tmp_path)
    assert told is None or told > 1e6
    here = having.machine(tmp_path / "not" / "there" / "yet")
    assert here.disk_bytes is not None
    assert here.disk_bytes > 0.0
    assert here.cores >= 1


def test_a_limit_of_the_address_space_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    proc = files(tmp_path, meminfo=MEMINFO, self__statm="2000 1000 5")
    page = having.os.sysconf("SC_PAGE_SIZE")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (3000 * page, 3000 * page))
    assert having.available_memory(proc, tmp_path) == 2000 * page


# --- words


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "about 1 s"), (37.0, "about 40 s"), (100.0, "about 2 min"), (7000.0, "about 2 h"), (4e5, "about 5 days"),
     (1e8, "about 3 years"), (math.inf, "about inf years")],
)  # fmt: skip
def test_times_are_said_without_false_precision(seconds: float, words: str) -> None:
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("count", "words"),
    [(0.0, "0 bytes"), (999.0, "1000 bytes"), (1000.0, "1 kB"), (263_456_789.0, "260 MB"), (6.49e12, "6.5 TB"),
     (3e21, "3000 EB"), (math.inf, "inf EB")],
)  # fmt: skip
def test_bytes_in_words(count: float, words: str) -> None:
    assert size(count) == words


def test_what_is_lacking_is_said_with_what_there_is() -> None:
    budget, small = Budget(3e9, 2e9, 1e9), Machine(1e9, 2.5e9, 2)
    memory, disk = lacking(budget, small)
    assert memory == "about 3 GB of memory; 1 GB are free"
    assert disk == "about 3 GB on disk; 2.5 GB are free"
    assert lacking(budget, Machine(4e9, 2.5e9, 2), kept=0.6e9) == []
    assert lacking(budget, Machine(None, None, 2)) == []
    words = estimate_text(budget, small)
    assert words.startswith("about 3 GB of memory")
    timed = estimate_text(budget, small, seconds=40.0)
    assert timed.startswith("about 40 s on this machine's 2 cores (within a factor of 1.5, by a block that was timed)")
    assert timed.endswith(words)
    assert words.endswith("3 GB on disk, 1 GB of it until the result is complete")


# --- refused before anything is made

SHORTAGE = {
    "run": ["run", SCENARIOS / "landing.yaml", "--runs", 10_000_000, "--keep", "all"],
    "steps": ["run", SCENARIOS / "mls_elevation.yaml", "--runs", 10_000_000],
    "scans": ["run", SCENARIOS / "atc_tracking.yaml", "--set", "period_s=0.001", "--runs", 1000],
    "map": ["run", SCENARIOS / "azimuth_tracking.yaml", "--set", "map={runs: 10000, periods_s: [0.001]}"],
    "sweep": ["sweep", SCENARIOS / "placement_sweep.yaml", "--method", "monte-carlo", "--set",
              "vary.1.grid.count=9000", "--set", "vary.2.grid.count=5500"],
    "starts": ["optimize", SCENARIOS / "placement_optimum.yaml", "--set", "period={hours: 100, count: 10000}"],
    "table2": ["table2", "--runs", 10_000_000],
    "integrity-table": ["integrity-table", "--set", "integrity.limits={operation: NPA, tta_s: 10}"],
    "replay": ["replay", SCENARIOS / "recorded_flight.yaml"],
    "ranges": ["replay", SCENARIOS / "recorded_ranges.yaml"],
    "live": ["live", SCENARIOS / "landing.yaml", "--receiver", "-"],
}  # fmt: skip


def command(place: Path, arguments: list[object]) -> Result:
    target = place / "out" if arguments[0] == "table2" else place / "out.h5"
    return CliRunner().invoke(app, [*map(str, arguments), "-o", str(target)])


@pytest.mark.parametrize("name", SHORTAGE)
def test_a_study_beyond_the_machine_is_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    little = 1e6 if name in ("integrity-table", "replay", "ranges", "live") else 2e9
    monkeypatch.setattr(having, "machine", lambda _: Machine(little, 5e9, 2))
    done = command(tmp_path, SHORTAGE[name])
    assert done.exit_code == 2, done.output
    assert "--over-budget computes it nevertheless" in done.output
    assert "; 2 GB are free" in done.output or "; 5 GB are free" in done.output or little == 1e6
    assert not [file for file in tmp_path.rglob("*") if file.is_file()]


def test_over_budget_computes_and_warns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(having, "machine", lambda _: Machine(1e6, 5e9, 2))
    shipped = [SCENARIOS / "mls_elevation.yaml", "--set", "montecarlo.experiments=2", "--figures", "none"]
    assert command(tmp_path, ["run", *shipped]).exit_code == 2
    done = command(tmp_path, ["run", *shipped, "--over-budget"])
    assert done.exit_code == 0, done.output
    assert "warning:" in done.output
    assert "of memory; 1 MB are free" in done.output
    assert (tmp_path / "out.h5").is_file()


def test_partial_work_that_is_there_is_not_asked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments: list[object] = ["run", SCENARIOS / "landing.yaml", "--runs", 1000, "--keep", "all", "--dry-run"]
    monkeypatch.setattr(having, "machine", lambda _: Machine(4e9, 3.6e9, 2))
    assert "on disk; 3.6 GB are free" in command(tmp_path, arguments).output
    folder = tmp_path / "out.h5.partial"
    folder.mkdir()
    with open(folder / "runs", "wb") as file:
        file.truncate(1_000_000_000)
    assert command(tmp_path, arguments).exit_code == 0


def test_until_ends_early_so_that_its_most_is_only_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(having, "machine", lambda _: Machine(4e9, 5e9, 2))
    done = command(tmp_path, ["run", SCENARIOS / "landing.yaml", "--until", "rms_horizontal within 2%", "--dry-run"])
    assert done.exit_code == 0, done.output
    assert "at most about" in done.output
    assert "may need less if it ends early" in done.output


def test_steps_and_scans_are_those_of_the_study() -> None:
    usual, _ = read_any(SCENARIOS / "mls_elevation.yaml")
    assert elevation.nominal(usual).time.size == usual.nominal_steps
