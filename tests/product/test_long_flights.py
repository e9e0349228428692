"""Flights of hours: nothing but memory bounds a recorded trajectory, and what it takes is told before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import SCENARIOS
from tests.forks import navsim

HOURS = 1.5


@pytest.fixture(scope="module")
def holding(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An hour and a half in a holding pattern: circles of 6 km at 100 m/s."""
    folder = tmp_path_factory.mktemp("holding")
    time = np.arange(0.0, HOURS * 3600.0 + 20.0, 10.0)
    turn = time * 100.0 / 6000.0
    lat = 56.02 + np.degrees(6000.0 * np.sin(turn) / 6.39e6)
    lon = 37.01 + np.degrees(6000.0 * (1.0 - np.cos(turn)) / (6.39e6 * np.cos(np.radians(56.02))))
    rows = [f"{t:.0f},{a:.8f},{b:.8f},2000" for t, a, b in zip(time, lat, lon, strict=True)]
    (folder / "holding.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,h_m", *rows]))
    text = (SCENARIOS / "track.yaml").read_text()
    for old, new in (
        ("duration_s: 145", f"duration_s: {HOURS * 3600:g}"),
        ("data/circuit_track.csv", "holding.csv"),
        ("start_s: 62", "start_s: 0"),
        ("  touchdown_s: 200.5 ", "  # "),
        ("rate_hz: 100", "rate_hz: 10"),
        ("{rate_hz: 10}", "{rate_hz: 0.05}"),
        ("kind: gaussian-sum, ", ""),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "holding.yaml").write_text(
        f"{text}\nevents:\n  - {{what: silence, sources: [all], at_s: 5000, until_s: 5060}}\n"
    )
    return folder


def test_more_than_an_hour_is_flown(holding: Path) -> None:
    """With an event in the second hour; the sizes that are told before are those of the flight."""
    said = navsim("run", "holding.yaml", "--dry-run", "-o", "out.h5", cwd=holding).stderr
    assert "1 run(s) of 5400 s, 54000 IMU samples, 270 fix epochs" in said


def test_an_s_turn_says_how_long_it_is(tmp_path: Path) -> None:
    """Its path is made before the flight, and ends."""
    said = navsim("validate", SCENARIOS / "s_turn.yaml", cwd=tmp_path)
    assert "valid" in said.stdout
    done = navsim("run", SCENARIOS / "s_turn.yaml", "--set", "duration_s=3601", "--dry-run", cwd=tmp_path, code=2)
    assert "turns of `profile: s-turn` last 3600 s; give no more" in done.stderr
