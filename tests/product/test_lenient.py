"""Damaged files named in scenarios and logs: refused with a hint, or read in part with warnings."""

from __future__ import annotations

import bz2
from pathlib import Path

import pytest

from navsim.models import timescales
from navsim.scenario.load import read, read_replay
from navsim.scenario.source import InputError
from navsim.study import replay
from navsim.study.landing.sky import read_satellites
from tests.conftest import SCENARIOS
from tests.recordings import write_flight
from tests.rinex import in_version_4, navigation_3

UTC = timescales.posix(2018, 9, 13, 12)
EPOCH = "epoch=2018-09-13T12:00:00Z"


def satellites(*assignments: str) -> tuple[list[str], list[str]]:
    """Names of the satellites of a landing, and the warnings."""
    warnings: list[str] = []
    scenario, document = read(SCENARIOS / "landing.yaml", (EPOCH, "duration_s=10", *assignments))
    groups, _ = read_satellites(scenario, document, warnings)
    return [name for group in groups for name in group.names], warnings


@pytest.mark.parametrize("version", [3, 4])
def test_a_landing_under_damaged_messages(version: int, tmp_path: Path) -> None:
    text = navigation_3(UTC)
    text = in_version_4(text, "4.00", []) if version == 4 else text
    lines = text.split("\n")
    at = next(k for k, line in enumerate(lines) if line.startswith("G02"))
    path = tmp_path / "nav.rnx.bz2"
    chosen = ("sky.source=navigation", f"sky.navigation={path}")
    path.write_bytes(bz2.compress(text.encode()))
    names, warnings = satellites(*chosen)
    assert {"G01", "G02", "G03", "R01", "R02", "R03"} == set(names)
    assert not warnings
    lines[at + 3] = lines[at + 3].replace(".", "?", 1)
    path.write_bytes(bz2.compress("\n".join(lines).encode()))
    with pytest.raises(InputError) as caught:
        satellites(*chosen)
    (problem,) = caught.value.problems
    assert (problem.place.file, problem.place.line) == (str(path), at + 4)
    assert "`sky.lenient: true` takes what is whole" in problem.message
    names, warnings = satellites(*chosen, "sky.lenient=true")
    assert {"G01", "G03", "R01", "R02", "R03"} == set(names)
    (warning,) = warnings
    assert "1 messages left out; the first: " in warning
    assert f":{at + 4}:" in warning


def test_lenient_is_for_files_that_can_be_read_in_part() -> None:
    with pytest.raises(InputError, match=r"sky\.lenient: is for `source: navigation` and `orbits`, not for `nominal`"):
        satellites("sky.source=nominal", "sky.lenient=true")


def test_a_replay_of_damaged_tables(tmp_path: Path) -> None:
    write_flight(tmp_path, duration=60.0)
    lines = (tmp_path / "imu.csv").read_text().split("\n")
    lines[40] = lines[40][:-20]
    (tmp_path / "imu.csv").write_text("\n".join(lines))
    (tmp_path / "gnss.csv").write_text((tmp_path / "gnss.csv").read_text()[:-25])
    log = tmp_path / "log.yaml"
    with pytest.raises(InputError, match=r"imu\.csv:41:.*`lenient: true` takes what is whole"):
        replay.prepare(*read_replay(log, ("tuning=none",)))
    recording = replay.prepare(*read_replay(log, ("tuning=none", "lenient=true")))
    said = [warning for warning in recording.warnings if "left out" in warning]
    assert len(said) == 2
    assert f"1 rows left out; the first: {tmp_path}/imu.csv:41:" in said[0]
    assert f"1 rows left out; the first: {tmp_path}/gnss.csv:" in said[1]
