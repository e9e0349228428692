"""Ground stations without satellites, as users run them: counts of lost measurements, sweeps, logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navsim.results.result import read
from tests.conftest import SCENARIOS
from tests.forks import navsim

BASE = SCENARIOS / "landing_ils.yaml"
BRIEF = ("--set", "imu.rate_hz=25", "--set", "receiver.rate_hz=1", "--set", "duration_s=30", "--set", "wind={}")


def test_runs_that_leave_the_beam_are_counted(tmp_path: Path) -> None:
    """Guided by their estimate, some pass beside a beam of a hundredth of a degree: counted by run, and those without
    any measurement are told of."""
    narrow = ("--set", "elevation_station.low_deg=2.6", "--set", "elevation_station.high_deg=2.605",
              "--set", "approach.guidance=estimate")  # fmt: skip
    done = navsim("run", BASE, *BRIEF, *narrow, "--runs", 8, "--keep", "all", "-o", "r.h5", "--figures", "none",
                  cwd=tmp_path)  # fmt: skip
    result = read(tmp_path / "r.h5")
    lost = result["/aiding/elevation_station/status"] == 0
    assert 0 < int(result["/summary/aiding/elevation_station/missing"]) == lost.sum()
    silent = np.flatnonzero(lost.all(axis=1))
    assert silent.size
    assert f"elevation_station: measured nothing in {silent.size} of 8 runs, the first run {silent[0]}" in done.stderr


def test_a_sweep_without_a_fix_has_the_errors_of_the_filter(tmp_path: Path) -> None:
    """Outputs of fixes are nan, those of the filter are there: the larger bias gives the larger error."""
    (tmp_path / "s.yaml").write_text(
        f"kind: sweep\nversion: 1\nbase: {BASE}\nset: {{imu.rate_hz: 25, receiver.rate_hz: 1}}\nmethod: covariance\n"
        "vary: [{key: azimuth_station.bias_m, values: [1, 9]}]\noutputs: [pdop, lateral_200ft]\n"
    )
    done = navsim("sweep", "s.yaml", "--runs", 0, "-o", "s.h5", "--figures", "none", cwd=tmp_path)
    result = read(tmp_path / "s.h5")
    assert "are nan" not in done.stderr
    assert np.isnan(result["/sweep/pdop"]).all()
    small, large = result["/sweep/lateral_200ft"]
    assert 0.0 < small < large


def test_a_log_without_a_fix_has_an_empty_table(tmp_path: Path) -> None:
    navsim("run", BASE, *BRIEF, "-o", "r.h5", "--figures", "none", cwd=tmp_path)
    done = navsim("export", "r.h5", "--imu", "--kml", cwd=tmp_path)
    kml, places = (tmp_path / "r.kml").read_text(), read(tmp_path / "r.h5")["/stations/position_llh"]
    assert all(f"{np.degrees(lon):.6f}"[:-1] in kml for _, lon, _ in places)
    assert kml.count("_station<") == 2
    assert len((tmp_path / "r_fixes.csv").read_text().splitlines()) == 1
    assert "has no fix, and a replay needs one" in done.stderr
