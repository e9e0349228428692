"""Estimates of memory and disk against result files and the memory that processes took."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from navsim.io.results import write
from navsim.scenario.load import read_any, read_replay, read_study
from navsim.scenario.sweep import Sweep
from navsim.study import landing, replay
from navsim.study.budget.companions import COMPANIONS
from navsim.study.budget.estimate import Budget
from navsim.study.budget.landing import landing as estimated
from navsim.study.budget.studies import posing, recorded, sweep, tables
from navsim.study.objective import problem
from navsim.study.partial import Store
from navsim.study.sweep import plan
from tests.conftest import LANDINGS, SCENARIOS
from tests.helpers import case

DISK = 0.05
"""Share by which files may differ from their estimate."""
MEMORY = 0.5, 2.0
"""The peak of a process over its estimate."""


@pytest.mark.parametrize("method", ["monte-carlo", "covariance"])
@pytest.mark.parametrize("name", LANDINGS)
def test_result_file_of_every_landing(name: str, method: str, tmp_path: Path) -> None:
    here = case(f"method={method}", name=name)
    if method == "covariance":
        result = landing.covariance_result(here, landing.covariance_analysis(here), 1)
    else:
        result = landing.result(here, landing.fly_all(here, 1, 0, 1, 1, keep="all"), 1, keep="all")
    write(tmp_path / "a.h5", result)
    told = estimated(here.scenario, here.environment)
    assert (tmp_path / "a.h5").stat().st_size == pytest.approx(told.result_bytes, rel=DISK)
    assert told.partial_bytes == 0.0


@pytest.mark.parametrize("keep", ["none", "errors", "all"])
@pytest.mark.parametrize("runs", [3, 60])
def test_result_and_partial_work_of_runs(keep: str, runs: int, tmp_path: Path) -> None:
    here = case("receiver.rate_hz=2", "sky.source=nominal")
    store = Store(tmp_path / "partial", {}, False) if runs > 25 else None
    ensemble = landing.fly_all(here, 1, 0, runs, 2, keep=keep, store=store)
    write(tmp_path / "a.h5", landing.result(here, ensemble, 1, keep=keep))
    told = estimated(here.scenario, here.environment, runs, keep, 2)
    assert (tmp_path / "a.h5").stat().st_size == pytest.approx(told.result_bytes, rel=DISK)
    if store is not None:
        lies = sum(file.stat().st_blocks * 512 for file in store.folder.iterdir())
        assert lies == pytest.approx(told.partial_bytes, rel=0.3)


def companion(name: str, runs: int | None, *keys: str) -> Budget:
    scenario: Any = read_any(SCENARIOS / f"{name}.yaml", keys)[0]
    return COMPANIONS[scenario.kind](scenario, runs)


def of_landing(runs: int, keep: str, *keys: str) -> Budget:
    here = case(*keys)
    return estimated(here.scenario, here.environment, runs, keep, 2)


def of_sweep(*keys: str) -> Budget:
    return sweep(plan(*read_study(SCENARIOS / "placement_sweep.yaml", Sweep, keys), seed=1), 2)


def of_optimum(*keys: str) -> Budget:
    from navsim.scenario.optimize import Optimize

    told: list[Budget] = []
    study, document, base = read_study(SCENARIOS / "placement_optimum.yaml", Optimize, keys)
    problem(study, document, base, lambda *found: told.append(posing(study, *found)))
    return told[0]


def of_replay(*keys: str) -> Budget:
    return recorded(replay.prepare(*read_replay(SCENARIOS / "recorded_flight.yaml", keys)))


Given = tuple[str, list[str], Callable[..., Budget]]
COMMANDS: dict[str, Given] = {
    "one": ("run landing.yaml", [], lambda *keys: of_landing(1, "all", *keys)),
    "long": ("run landing.yaml", ["imu.rate_hz=1000", "duration_s=65", "receiver.rate_hz=1"],
             lambda *keys: of_landing(1, "all", *keys)),
    "runs": ("run landing.yaml --runs 60 --keep all --workers 2", [], lambda *keys: of_landing(60, "all", *keys)),
    "covariance": ("run landing.yaml", ["method=covariance"], lambda *keys: of_landing(1, "all", *keys)),
    "atc": ("run atc_tracking.yaml --runs 300", [], lambda *keys: companion("atc_tracking", 300, *keys)),
    "azimuth": ("run azimuth_tracking.yaml --runs 300", ["map.runs=0"],
                lambda *keys: companion("azimuth_tracking", 300, *keys)),
    "elevation": ("run mls_elevation.yaml --runs 5000", ["montecarlo.experiments=2", "montecarlo.steps=1000"],
                  lambda *keys: companion("mls_elevation", 5000, *keys)),
    "sweep": ("sweep placement_sweep.yaml", ["vary.1.grid.count=30", "vary.2.grid.count=50"], of_sweep),
    "sweep, runs": ("sweep placement_sweep.yaml",
                    ["method=monte-carlo", "runs=5", "vary.1.grid.count=2", "vary.2.grid.count=2"], of_sweep),
    "optimize": ("optimize placement_optimum.yaml", ["pseudolites=[2]", "effort=1"], of_optimum),
    "table2": ("table2 --runs 2", [], lambda: tables(2, 2)),
    "replay": ("replay recorded_flight.yaml", ["tuning=none"], of_replay),
}  # fmt: skip
LONG = ("long", "azimuth", "elevation", "sweep, runs")
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
    line, keys, estimate = COMMANDS[name]
    words = [str(SCENARIOS / word) if word.endswith(".yaml") else word for word in line.split()]
    words += [part for key in keys for part in ("--set", key)]
    words += ["-o", "out"] if name == "table2" else ["-o", "out.h5", "--figures", "none"]
    done = subprocess.run(
        [sys.executable, "-c", PEAK, *words, "-q"], capture_output=True, text=True, cwd=tmp_path, timeout=300
    )
    assert done.returncode == 0, done.stderr
    told = estimate(*keys)
    peak = 1024.0 * int(done.stderr.split("PEAK")[1])
    assert MEMORY[0] < peak / told.memory_bytes < MEMORY[1]
    files = [file for file in tmp_path.iterdir() if file.is_file()] or [tmp_path / "out" / "table2.h5"]
    assert sum(file.stat().st_size for file in files) == pytest.approx(told.result_bytes, rel=DISK)
