"""Alignment of recorded flights: standstill only where there is one, the earliest start, what is not flown."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from navsim.filter.records import TFG
from navsim.formats.recorded_data import Fixes, Samples
from navsim.geodesy.attitude import dcm_from_quaternion
from navsim.replays import alignment
from navsim.replays import flight as simulated
from navsim.replays import study as replay
from navsim.replays.alignment import Alignment, Search
from navsim.replays.findings import find_off_course
from navsim.results import findings
from navsim.results.notes import CONSISTENT
from navsim.scenario.load import read_replay
from navsim.trajectory.recorded import RecordedTrajectory
from tests.conftest import SCENARIOS
from tests.helpers import in_brief
from tests.recordings import circuit, quadrotor, record, ride, smooth_steps, write_flight

SEARCH = Search(None, np.radians(10.0), 120.0, 5e-3, 5e-4, 0.1)
"""As of consumer sensors."""
Velocities = Literal["ned", "horizontal", "none"]


def turning(car: bool = False) -> RecordedTrajectory:
    """Weaving, then a steady turn from 40 to 80 s, then weaving."""
    return ride(
        120.0,
        lambda t: smooth_steps(t, [10.0, 25.0], [20.0, 26.0, 22.0], 8.0),
        lambda t: smooth_steps(
            t, [5.0, 12.0, 20.0, 28.0, 40.0, 80.0, 95.0], [0.0, 0.2, 0.0, -0.2, 0.0, 0.2, 0.0, -0.2]
        ),
        np.zeros_like,
        banked=np.zeros_like if car else np.ones_like,
    )


def without(fixes: Fixes, first: float, last: float) -> Fixes:
    """The fixes but those of first <= time < last."""
    return fixes.take((fixes.time < first) | (fixes.time >= last))


def found(samples: Samples, fixes: Fixes, first: float = 0.5) -> Alignment:
    out = alignment.find_alignment(samples, fixes.earlier(0.1), first, SEARCH)
    assert out is not None
    return out


def off(trajectory: RecordedTrajectory, aligned: Alignment) -> np.ndarray:
    """Error of the attitude about north, east, down in its 1 sigma."""
    true = trajectory.motion(np.array([aligned.time])).c_nb[0]
    turn = true @ dcm_from_quaternion(aligned.quaternion).T
    error = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return error / np.sqrt(np.diag(aligned.covariance))


@pytest.mark.parametrize(("velocities", "car"), in_brief([("ned", False), ("horizontal", True), ("none", False)], 0))
def test_a_pause_of_the_fixes_does_not_move_the_start(velocities: Velocities, car: bool) -> None:
    """The steady turn has the scatter of a body at rest; nor does a pause that hides the first motion."""
    trajectory = turning(car)
    samples, fixes = record(trajectory, 3, velocities=velocities, fix_rate=2.0)
    start = found(samples, fixes)
    for first, length in ((2.0, 10.0), (20.0, 25.0), (45.0, 25.0), (55.0, 10.0), (62.0, 5.0)):
        here = found(samples, without(fixes, first, first + length))
        assert here.time == start.time, (first, length)
        assert np.abs(off(trajectory, here)).max() < 3.0, (first, length)


@pytest.mark.parametrize("velocities", ["ned", "none"])
def test_a_start_in_the_turn_is_under_way(velocities: Velocities) -> None:
    """Also where the pause comes first of all that is looked at."""
    trajectory = turning()
    samples, fixes = record(trajectory, 4, velocities=velocities)
    for first, last in ((43.0, 68.0), (50.0, 62.0)):
        here = found(samples, without(fixes, first, last), 42.0)
        assert here.since == here.time
        assert np.abs(off(trajectory, here)).max() < 3.0


def test_flying_straight_without_fixes_is_no_standstill() -> None:
    """Rate and force are those of a body at rest; the fixes around are far from each other, or show speed."""
    flight = ride(90.0, lambda t: np.full_like(t, 25.0), lambda t: smooth_steps(t, [60.0, 70.0], [0.0, 0.2, 0.0]),
                  np.zeros_like)  # fmt: skip
    for velocities in ("ned", "none"):
        samples, fixes = record(flight, 5, velocities=velocities, gyro_bias=1e-4, accel_bias=0.01)
        lost = without(fixes, 10.0, 40.0)
        assert alignment.find_standstill(samples, lost.with_velocity()[0], 5.0, 45.0, SEARCH) is None


def test_a_body_that_stands_while_fixes_pause_is_at_rest() -> None:
    """Both ends at one place without speed, rate and force those of rest in between."""
    trajectory = circuit(standstill=40.0)
    samples, fixes = record(trajectory, 6)
    whole, paused = found(samples, fixes), found(samples, without(fixes, 8.0, 33.0))
    assert paused.time == whole.time
    assert paused.since == whole.since < 2.0
    assert np.abs(off(trajectory, paused)).max() < 3.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_onset_of_a_slow_motion_is_no_standstill(seed: int) -> None:
    """A drone that hovers, then tilts by 4 degrees within a second: by its speed and the scatter of its samples it
    stands for a second more."""
    drone = quadrotor()
    samples, fixes = record(drone, seed, fix_rate=5.0, accel_bias=0.01)
    known = replace(SEARCH, heading=0.7, heading_sigma=np.radians(5.0))
    aligned = alignment.find_alignment(samples, fixes.earlier(0.1), 0.5, known)
    assert aligned is not None
    assert 15.0 < aligned.until < 19.0
    assert np.all(np.abs(off(drone, aligned)[:2]) < 1.5)


def test_nothing_is_aligned_across_missing_samples() -> None:
    """The start comes after the gap where the motion before it is not enough, however long the gap."""
    trajectory = turning()
    samples, fixes = record(trajectory, 7)
    needed = found(samples, fixes).until
    for length in (1.5, 12.0, 40.0):
        keep = (samples.time < needed - 2.0) | (samples.time > needed - 2.0 + length)
        here = found(Samples(samples.time[keep], samples.rate[keep], samples.force[keep]), fixes)
        assert here.time >= needed - 2.0 + length - 0.1
        assert np.abs(off(trajectory, here)).max() < 3.0


def test_short_gaps_widen_the_alignment() -> None:
    trajectory = turning()
    samples, fixes = record(trajectory, 7)
    keep = (samples.time < 4.0) | (samples.time > 4.5)
    here = found(Samples(samples.time[keep], samples.rate[keep], samples.force[keep]), fixes)
    assert here.time == found(samples, fixes).time
    assert np.abs(off(trajectory, here)).max() < 3.0


def test_velocity_is_not_taken_across_a_pause() -> None:
    """A circle flown within the pause ends where it began: that is no speed of zero. A fix alone shows none."""
    trajectory = turning()
    _, fixes = record(trajectory, 8, velocities="none", position_noise=0.1)
    fixes = fixes.take((fixes.time < 42.0) | ((fixes.time > 57.5) & (fixes.time < 58.5)) | (fixes.time > 75.0))
    filled, over = fixes.with_velocity()
    true = trajectory.motion(fixes.time - 0.1).velocity_ned
    alone = np.flatnonzero((fixes.time > 57.0) & (fixes.time < 59.0))
    assert alone.size == 1
    assert np.isnan(filled.velocity[alone]).all()
    assert over.max() <= 2.1
    assert np.nanmax(np.linalg.norm(filled.velocity - true, axis=1)) < 4.0


@pytest.mark.parametrize(
    ("case", "assignments"),
    in_brief(
        [
            ("replay-gap-csv25", ()),
            ("replay-gap-csv5-novd", ()),
            ("replay-gap-late-novd", ()),
            ("replay-gap-none-novd", ()),
        ],
        0,
        3,
    ),
)
def test_the_cases_start_where_they_do_without_the_gap(
    case: str, assignments: tuple[str, ...], shared: Path, tmp_path: Path
) -> None:
    folder = shared / "cases" / case
    log = tmp_path / "log.yaml"
    log.write_text((folder / "log.yaml").read_text().replace("DATA", str(SCENARIOS / "data")))
    fixes = f"gnss.file={folder / 'gnss.csv'}"
    recording = replay.prepare(*read_replay(log, (fixes, "tuning=none", "gnss.latency_s=0.1", *assignments)))
    assert recording.alignment.time == pytest.approx(0.6)
    result = replay.compute(recording)
    north, east = result["/filter/velocity_ned"][:, :2].T
    aside = np.angle(np.exp(1j * (result["/filter/attitude_rpy"][:, 2] - np.arctan2(east, north))))
    assert np.degrees(np.abs(np.median(aside))) < 1.5
    assert not [f for f in findings.of(result) if f.name == "off_course"]


def test_what_is_not_flown_is_told(tmp_path: Path) -> None:
    """Samples before the first fix, fixes after the last sample; not what the user leaves out."""
    write_flight(tmp_path)
    head, *rows = (tmp_path / "gnss.csv").read_text().splitlines()
    (tmp_path / "gnss.csv").write_text("\n".join([head, *(r for r in rows if float(r.split(",")[0]) > 20.5)]) + "\n")
    head, *rows = (tmp_path / "imu.csv").read_text().splitlines()
    (tmp_path / "imu.csv").write_text("\n".join([head, *(r for r in rows if float(r.split(",")[0]) < 80.0)]) + "\n")
    told = replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",))).warnings
    assert [text.partition(" s of the recording")[0] for text in told] == ["0.0 to 20.6", "80.0 to 99.1"]
    assert all("are not replayed: there are" in text for text in told)
    cut = ("tuning=none", "start_s=30", "end_s=70")
    assert replay.prepare(*read_replay(tmp_path / "log.yaml", cut)).warnings == []


def test_a_time_without_motion_to_align_from_is_told() -> None:
    """Straight on for a minute gives no heading to two degrees."""
    flight = ride(120.0, lambda t: np.full_like(t, 25.0), lambda t: smooth_steps(t, [80.0, 90.0], [0.0, 0.2, 0.0]),
                  np.zeros_like)  # fmt: skip
    samples, fixes = record(flight, 9)
    narrow = replace(SEARCH, longest=20.0)
    here = alignment.find_alignment(samples, fixes.earlier(0.1), 0.5, narrow)
    assert here is not None
    assert here.since > 50.0
    assert np.abs(off(flight, here)).max() < 3.0


def test_a_heading_off_the_course_is_found(tmp_path: Path) -> None:
    """Turned round by hand at the start, where it cannot turn back: told with its times, and it is no consistent
    flight."""
    write_flight(tmp_path)
    assignments = ("tuning=none", "gnss.latency_s=0.12")
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml", assignments))
    assert not [f for f in findings.of(replay.compute(recording)) if f.name == "off_course"]
    flight = recording.flight(recording.settings)
    beliefs = recording.design(recording.settings, TFG)
    seen = simulated.fly(flight, beliefs, recording.fix_sigma(recording.settings), np.empty(0))
    turned = replace(flight, course=flight.course + np.radians(160.0))
    (told,) = find_off_course(turned, seen)
    assert told.against == (CONSISTENT,)
    assert re.match(r"heading 1[56]\d degrees off the course from 1\.1 to 99\.1 s \(median of 197 fixes", told.text)
    briefly = np.where((flight.arrival > 40.0) & (flight.arrival < 49.0), np.pi, 0.0)
    short = replace(flight, course=flight.course + briefly)
    assert find_off_course(short, seen) == []
