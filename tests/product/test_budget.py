"""Estimates of memory and disk against result files and the memory that processes took."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from navsim.kinds import KINDS, named
from navsim.landing import study as landing
from navsim.landing.covariance import budget
from navsim.landing.estimate import estimate_landing as estimated
from navsim.landing.estimate import further
from navsim.published_tables.integrity_table_job import IntegrityTableJob
from navsim.published_tables.table2_job import Table2Job
from navsim.results.result import write
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import Budget
from navsim.runner.executor import threads
from navsim.runner.job import Job, Opener, Options
from navsim.scenario.load import read, read_for
from navsim.scenario_files import shipped
from navsim.simulation.error_sources import SOURCES
from tests.conftest import LANDINGS, SCENARIOS
from tests.helpers import case, in_brief

DISK = 0.05
"""Share by which files may differ from their estimate."""
MEMORY = 0.5, 2.0
"""The peak of a process over its estimate."""


@pytest.mark.parametrize(
    ("name", "method"),
    in_brief(
        [*((name, "monte-carlo") for name in LANDINGS), ("landing_open_sky", "covariance"), ("circuit", "covariance")],
        0,
        4,
        8,
        13,
    ),
)
def test_result_file_of_every_landing(name: str, method: str, tmp_path: Path) -> None:
    here = case(f"method={method}", name=name)
    if method == "covariance":
        result = landing.covariance_result(here, landing.covariance_analysis(here), 1)
    else:
        result = landing.result(here, landing.fly_all(here, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    write(tmp_path / "a.h5", result)
    told = estimated(here.scenario, here.environment)
    assert (tmp_path / "a.h5").stat().st_size == pytest.approx(told.result_bytes, rel=DISK)
    assert told.partial_bytes == 0.0


def test_result_file_of_gusts_alone(tmp_path: Path) -> None:
    """They draw nothing, and the run has a way of its own."""
    gust = "wind.gusts=[{amplitude_m_s: 5, towards: right, start_s: 10, ramp_s: 2}]"
    here = case("receiver.rate_hz=2", "duration_s=60", "imu.rate_hz=20", gust, name="landing_smooth")
    ensemble = landing.fly_all(here, 1, 0, 1, threads(1), keep="all")
    write(tmp_path / "a.h5", landing.result(here, ensemble, 1, keep="all"))
    told = estimated(here.scenario, here.environment)
    assert (tmp_path / "a.h5").stat().st_size == pytest.approx(told.result_bytes, rel=DISK)


def test_sources_of_an_analysis() -> None:
    """Each further one has its part of the estimate of a result file."""
    more = (
        "pseudolites.survey_sigma_m=0.1", "pseudolites.clock_sigma_ns=1",
        "pseudolites.clock_noise={h0: 1e-22, h_minus2: 0}", "imu.gyro.misalignment_mrad=1",
        "signals.preset=open-sky", "signals.system_offset_sigma_ns=1", "receiver.single_clock=true",
        "sky.source=nominal", "altimeter={}", "runway.geoid_undulation_m=15",
        "barometric_altimeter={sigma_m: 1, qnh_sigma_hpa: 1, drift_m: 1}",
    )  # fmt: skip
    for settings in ((), more):
        here = case("method=covariance", "duration_s=20", "receiver.rate_hz=1", "imu.rate_hz=20", *settings)
        found = budget(landing.covariance_analysis(here))
        assert 1 + len(SOURCES) + further(here.scenario, here.environment) == len(found)


@pytest.mark.parametrize("keep", in_brief(["none", "errors", "all"], 0, 2))
@pytest.mark.parametrize("runs", in_brief([3, 64], 1))
def test_result_and_partial_work_of_runs(keep: str, runs: int, tmp_path: Path) -> None:
    here = case("receiver.rate_hz=2", "sky.source=nominal")
    store = CheckpointStore(tmp_path / "partial", {}, False) if runs > 25 else None
    ensemble = landing.fly_all(here, 1, 0, runs, threads(2), keep=keep, store=store)
    write(tmp_path / "a.h5", landing.result(here, ensemble, 1, keep=keep))
    told = estimated(here.scenario, here.environment, runs, keep, 2)
    assert (tmp_path / "a.h5").stat().st_size == pytest.approx(told.result_bytes, rel=DISK)
    if store is not None:
        lies = sum(file.stat().st_blocks * 512 for file in store.folder.iterdir())
        assert lies == pytest.approx(told.partial_bytes, rel=0.3)


def estimate(line: str, keys: Sequence[str]) -> Budget:
    """What the job of a command line tells of itself before it begins, the last time it does."""
    told: list[Budget] = []
    command, *words = line.split()
    job: Job
    if command == "table2":
        job = Table2Job(1, 2)
    elif command == "integrity-table":
        job = IntegrityTableJob(*read(shipped.path("landing"), keys), 1)
    else:
        section, document = read_for(command, SCENARIOS / words[0], keys)
        given = dict(zip(words[1::2], words[2::2], strict=True))
        runs = int(given["--runs"]) if "--runs" in given else None
        opener: Opener = named(KINDS[document.data["kind"]].job)
        job = opener(section, document, Options(runs=runs, keep=given.get("--keep")))

    def allow(budget: Budget, at_most: bool = False) -> None:
        told.append(budget)

    job.prepare(threads(2), allow)
    return told[-1]


COMMANDS: dict[str, tuple[str, list[str]]] = {
    "one": ("run landing.yaml", []),
    "long": ("run landing.yaml", ["imu.rate_hz=1000", "duration_s=65", "receiver.rate_hz=1"]),
    "runs": ("run landing.yaml --runs 60 --keep all --workers 2", []),
    "covariance": ("run landing.yaml", ["method=covariance"]),
    "rare": ("run landing.yaml --runs 60", ["method=rare", "box.lateral_m=0.5"]),
    "atc": ("run atc_tracking.yaml --runs 300", []),
    "azimuth": ("run azimuth_tracking.yaml --runs 300", ["map.runs=0"]),
    "elevation": ("run mls_elevation.yaml --runs 5000", ["montecarlo.experiments=2", "montecarlo.steps=1000"]),
    "sweep": ("sweep placement_sweep.yaml", ["vary.1.grid.count=30", "vary.2.grid.count=50"]),
    "sweep, runs": ("sweep placement_sweep.yaml",
                    ["method=monte-carlo", "runs=5", "vary.1.grid.count=2", "vary.2.grid.count=2"]),
    "optimize": ("optimize placement_optimum.yaml", ["pseudolites=[2]", "effort=1"]),
    "table2": ("table2 --runs 2", []),
    "integrity-table": ("integrity-table", ["integrity={method: chi2, limits: {hal_m: 40, val_m: 60, tta_s: 2}}"]),
    "integrity-table, mhss": ("integrity-table",
                              ["integrity={p_constellation: 1.0e-8, limits: {operation: APV-I, tta_s: 10}}"]),
    "replay": ("replay recorded_flight.yaml", ["tuning=none"]),
    "ranges": ("replay recorded_ranges.yaml", ["tuning=none"]),
}  # fmt: skip
LONG = (
    "long", "covariance", "rare", "integrity-table", "ranges", "optimize", "replay", "azimuth", "atc", "elevation",
    "sweep", "sweep, runs", "table2", "integrity-table, mhss",
)  # fmt: skip
PEAK = """
import sys
from navsim.__main__ import main
try:
    main()
finally:
    # what a process has been told of its peak is that of its parent, where that was larger
    peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    print("PEAK", peak.split()[1], file=sys.stderr)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs a system that tells the peak of a process")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name in LONG else name for name in COMMANDS]
)
def test_memory_and_files_of_a_command(name: str, tmp_path: Path) -> None:
    """Each estimate against the peak of a process that does nothing else, and against what it leaves on disk."""
    line, keys = COMMANDS[name]
    words = [str(SCENARIOS / word) if word.endswith(".yaml") else word for word in line.split()]
    words += [part for key in keys for part in ("--set", key)]
    without_figures = {"table2": ["-o", "out"], "integrity-table": ["-o", "out.h5"]}
    words += without_figures.get(line.split()[0], ["-o", "out.h5", "--figures", "none"])
    done = subprocess.run(
        [sys.executable, "-c", PEAK, *words, "-q"], capture_output=True, text=True, cwd=tmp_path, timeout=300
    )
    assert done.returncode == 0, done.stderr
    told = estimate(line, keys)
    peak = 1024.0 * int(done.stderr.split("PEAK")[1])
    assert MEMORY[0] < peak / told.memory_bytes < MEMORY[1]
    files = [file for file in tmp_path.iterdir() if file.is_file()] or [tmp_path / "out" / "table2.h5"]
    assert sum(file.stat().st_size for file in files) == pytest.approx(told.result_bytes, rel=DISK)
