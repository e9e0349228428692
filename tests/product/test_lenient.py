"""Damaged files named in scenarios and logs: refused with a hint, or read in part with warnings."""

from __future__ import annotations

import bz2
from pathlib import Path

import pytest

from navsim.environment.satellites import read_satellites
from navsim.gnss import timescales
from navsim.replays import study as replay
from navsim.scenario.load import read, read_replay
from navsim.scenario_files.source import InputError
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
    assert "`sky.skip_bad_records: true` takes the intact part" in problem.message
    names, warnings = satellites(*chosen, "sky.skip_bad_records=true")
    assert {"G01", "G03", "R01", "R02", "R03"} == set(names)
    (warning,) = warnings
    assert "1 messages left out; the first: " in warning
    assert f":{at + 4}:" in warning


def test_lenient_is_for_files_that_can_be_read_in_part() -> None:
    with pytest.raises(
        InputError, match=r"sky\.skip_bad_records: is for `source: navigation` and `orbits`, not for `nominal`"
    ):
        satellites("sky.source=nominal", "sky.skip_bad_records=true")


def test_a_replay_of_damaged_tables(tmp_path: Path) -> None:
    write_flight(tmp_path, duration=60.0)
    lines = (tmp_path / "imu.csv").read_text().split("\n")
    lines[40] = lines[40][:-20]
    (tmp_path / "imu.csv").write_text("\n".join(lines))
    (tmp_path / "gnss.csv").write_text((tmp_path / "gnss.csv").read_text()[:-25])
    log = tmp_path / "log.yaml"
    with pytest.raises(InputError, match=r"imu\.csv:41:.*`skip_bad_records: true` takes the intact part"):
        replay.prepare(*read_replay(log, ("tuning=none",)))
    recording = replay.prepare(*read_replay(log, ("tuning=none", "skip_bad_records=true")))
    said = [warning for warning in recording.warnings if "left out" in warning]
    assert len(said) == 2
    assert f"1 rows left out; the first: {tmp_path}/imu.csv:41:" in said[0]
    assert f"1 rows left out; the first: {tmp_path}/gnss.csv:" in said[1]


@pytest.mark.parametrize("lenient", ["false", "true"])
@pytest.mark.parametrize(("factor", "said"), [(57.29578, "gyro_unit: deg/s"), (206264.8, "gyro_unit: deg/h")])
def test_wrong_units_are_named_before_rows_are_left_out(factor: float, said: str, lenient: str, tmp_path: Path) -> None:
    """Values outside of limits by the hundred are no damage."""
    times_gyros(tmp_path, factor, slice(None))
    with pytest.raises(InputError) as caught:
        replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none", f"skip_bad_records={lenient}")))
    assert said in str(caught.value.problems[0])


def times_gyros(folder: Path, factor: float, rows: slice, duration: float = 60.0) -> None:
    """A flight of which the gyros are so many times too large in some rows of samples."""
    write_flight(folder, duration=duration)
    head, *lines = (folder / "imu.csv").read_text().strip().split("\n")
    for k in range(*rows.indices(len(lines))):
        t, *rates = lines[k].split(",")[:4]
        lines[k] = ",".join([t, *(f"{factor * float(w):.9g}" for w in rates), *lines[k].split(",")[4:]])
    (folder / "imu.csv").write_text("\n".join([head, *lines]) + "\n")


def test_nothing_but_values_outside_of_limits(tmp_path: Path) -> None:
    """Without checks a lenient reader is left with nothing, and says so; it is not proposed to one that is not."""
    times_gyros(tmp_path, 1e9, slice(None))
    log = tmp_path / "log.yaml"
    with pytest.raises(InputError, match=r"imu\.file: only 0 usable samples; 2999 rows left out; the first: "):
        replay.prepare(*read_replay(log, ("checks=off", "skip_bad_records=true")))
    with pytest.raises(InputError, match=r"imu\.csv:2:1: imu\.file: gx_rad_s is ") as caught:
        replay.prepare(*read_replay(log, ("checks=off",)))
    assert "skip_bad_records" not in str(caught.value.problems[0])


def test_a_few_values_outside_of_limits(tmp_path: Path) -> None:
    """They do not mislead the checks: refused at the first line with the way out, or left out, counted and said."""
    times_gyros(tmp_path, 1e9, slice(700, 730, 10))
    log = tmp_path / "log.yaml"
    with pytest.raises(InputError, match=r"imu\.csv:702:.* `skip_bad_records: true` takes the intact part"):
        replay.prepare(*read_replay(log, ("tuning=none",)))
    recording = replay.prepare(*read_replay(log, ("tuning=none", "skip_bad_records=true")))
    assert next(w for w in recording.warnings if "left out" in w).startswith("3 rows left out; the first: ")
    assert recording.samples.time.size < 2999

    lines = (tmp_path / "gnss.csv").read_text().split("\n")
    lines[30] = lines[30].replace("56.", "156.", 1)
    (tmp_path / "gnss.csv").write_text("\n".join(lines))
    recording = replay.prepare(*read_replay(log, ("tuning=none", "skip_bad_records=true")))
    assert sum("left out" in w for w in recording.warnings) == 2
