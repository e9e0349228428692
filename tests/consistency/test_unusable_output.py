"""Recorded flights whose fixes or samples are not to be trusted: the gate, the way back of a filter that is lost, holes
in the samples, by the truth of a simulated recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.models import BoxAnnotation, Line, VArea
from typer.testing import CliRunner

from navsim.cli.main import app
from navsim.formats.recorded_data import Samples
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef
from navsim.replays import flight as simulated
from navsim.replays import recorded_flight
from navsim.replays import study as replay
from navsim.replays.findings import find_outliers
from navsim.replays.page import replays
from navsim.replays.report import figures, lost_spans, tables
from navsim.replays.tuning import LATENCY, TuningSearch
from navsim.report.table import Table
from navsim.results import findings
from navsim.results.result import Result
from navsim.scenario.load import read_replay
from navsim.trajectory.recorded import RecordedTrajectory
from tests.consistency.test_replay import GIVEN, errors, flown, without
from tests.helpers import in_brief
from tests.recordings import circuit, drive, quadrotor, record, ride, smooth_steps, write_flight, write_recording

Truth = tuple[np.ndarray, ...]


def shifted(path: Path, first: float, last: float, north: float) -> None:
    """Move the fixes of first <= time < last to the north, m."""
    head, *rows = path.read_text().splitlines()
    out = [head]
    for row in rows:
        cells = row.split(",")
        if first <= float(cells[0]) < last:
            cells[1] = f"{float(cells[1]) + north / 111300.0:.10f}"
        out.append(",".join(cells))
    path.write_text("\n".join(out) + "\n")


def scaled(result: Result, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Errors of position, velocity, attitude in their sigma (t, 9) at each output outside of the spans that are
    worthless, and the times (t,)."""
    position, velocity, attitude = errors(result, truth)
    time, sigma = result["/filter/time"], result["/filter/sigma"]
    sound = np.full(time.size, True)
    for begin, end in zip(result["/lost/start"], result["/lost/end"], strict=True):
        sound &= (time < begin) | (time > end)
    whole = np.concatenate([position, velocity, np.radians(attitude)], axis=1) / sigma[:, :9]
    return whole[sound], time[sound]


def told(result: Result, name: str) -> str:
    """The text of the one finding of a name."""
    (one,) = [found for found in findings.of(result) if found.name == name]
    return one.text


KINDS = ["tfg", "eskf", "left-invariant", "gaussian-sum", "rts", "map"]


@pytest.mark.parametrize("kind", in_brief(KINDS, 0, 3, 5))
def test_half_a_second_of_wild_fixes_does_no_damage(kind: str, tmp_path: Path) -> None:
    """1.1 km off: rejected by default, counted with their times."""
    truth = write_flight(tmp_path)
    shifted(tmp_path / "gnss.csv", 50.0, 51.0, 1100.0)
    result = flown(tmp_path / "log.yaml", *GIVEN, f"filter.kind={kind}")
    z, _ = scaled(result, truth)
    assert np.abs(z).max() < 4.5
    assert np.sqrt(np.mean(z**2, axis=0)).max() < 1.8
    assert result["/lost/start"].size == 0
    assert told(result, "rejected_fixes") == ("2 of 197 fixes were rejected by the innovation gate, at 50.1 to 50.6 s")
    assert int(result["/summary/count/rejected"]) == 2
    # the table says which rows leave them out, and has one that does not
    _, table, *_ = tables(result)
    assert isinstance(table, Table)
    assert [str(row.cells[0]) for row in table.rows] == ["accepted", "accepted, moving", "all, with rejected"]
    accepted, _, every = (row.cells[1].values for row in table.rows)
    assert max(every) > 2.0 * max(accepted)
    assert 0.7 < result["/summary/nis"][0] < 1.4


def test_wild_fixes_do_not_tune_the_noise(tmp_path: Path) -> None:
    truth = write_flight(tmp_path, duration=60.0)
    for first in (20.0, 40.0):
        shifted(tmp_path / "gnss.csv", first, first + 1.0, 1100.0)
    result = flown(tmp_path / "log.yaml", "checks=warn")
    assert float(result["/tuning/velocity_sigma_horizontal"]) == pytest.approx(0.1, rel=0.3)
    assert float(result["/tuning/latency"]) == pytest.approx(0.12, abs=0.02)
    z, _ = scaled(result, truth)
    assert np.abs(z).max() < 4.5


@pytest.mark.parametrize("kind", in_brief(["tfg", "gaussian-sum", "rts"], 1, 2))
def test_fixes_that_are_off_for_long_are_named(kind: str, tmp_path: Path) -> None:
    """25 m for half a minute: which fixes are right nobody knows by then; from when to when the output is unusable is
    said, and outside of it the sigmas are those of the errors."""
    truth = write_flight(tmp_path)
    shifted(tmp_path / "gnss.csv", 40.0, 70.0, 25.0)
    result = flown(tmp_path / "log.yaml", *GIVEN, f"filter.kind={kind}")
    np.testing.assert_allclose(result["/lost/start"], [40.12])
    np.testing.assert_allclose(result["/lost/end"], [80.12])
    text = told(result, "lost")
    assert text.startswith("the filter contradicted its fixes twice, and the fixes came back: its output is unusable")
    assert "from 40.1 to 80.1 s" in text
    z, time = scaled(result, truth)
    assert time.max() > 98.0
    assert np.abs(z).max() < 4.5
    assert np.sqrt(np.mean(z**2, axis=0)).max() < 1.8


def test_wild_fixes_at_the_start_do_no_damage(tmp_path: Path) -> None:
    """300 m off for three seconds: the latency is searched by fixes that agree, and what was flown by the wild ones is
    unusable from the start on."""
    truth = write_flight(tmp_path, duration=60.0)
    shifted(tmp_path / "gnss.csv", 0.0, 4.0, 300.0)
    recording = replay.prepare(*read_replay(tmp_path / "log.yaml"))
    assert abs(TuningSearch(recording, lambda _: None).begin(recording.free)[LATENCY] - 0.1) < 0.25
    result = flown(tmp_path / "log.yaml", *GIVEN)
    (begin,), (end,) = result["/lost/start"], result["/lost/end"]
    assert begin <= result["/filter/time"][0] + 1e-6 < 4.0
    assert end < 15.0
    assert np.abs(scaled(result, truth)[0]).max() < 4.5


def test_without_a_gate_wild_fixes_are_flown(tmp_path: Path) -> None:
    """As it was by default: the way it can still be had."""
    truth = write_flight(tmp_path)
    shifted(tmp_path / "gnss.csv", 50.0, 51.0, 1100.0)
    result = flown(tmp_path / "log.yaml", *GIVEN, "filter.gate.probability=0")
    assert np.abs(errors(result, truth)[0]).max() > 100.0
    assert int(result["/summary/count/rejected"]) == 0


@pytest.mark.parametrize(
    ("kind", "first", "length"),
    in_brief([(kind, *hole) for kind, hole in zip(KINDS, cycle([(36.0, 15.0), (50.0, 30.0)]))], 0, 3, 4),
)
def test_a_filter_starts_anew_after_a_hole_in_the_samples(
    kind: str, first: float, length: float, tmp_path: Path
) -> None:
    """Longer than the attitude survives: no output within, and errors of each state as large as their sigma after."""
    truth = write_flight(tmp_path)
    without(tmp_path / "imu.csv", first, first + length)
    result = flown(tmp_path / "log.yaml", *GIVEN, f"filter.kind={kind}")
    np.testing.assert_allclose(result["/lost/start"], [first], atol=0.03)
    np.testing.assert_allclose(result["/lost/end"], [first + length], atol=0.03)
    time = result["/filter/time"]
    assert not np.any((time > first + 0.05) & (time < first + length - 0.05))
    assert "longer than the attitude survives: there is no output" in told(result, "lost")
    z, time = scaled(result, truth)
    assert time.max() > 98.0
    assert np.abs(z).max() < 4.5
    assert np.sqrt(np.mean(z[time > first + length] ** 2, axis=0)).max() < 2.2


@pytest.mark.parametrize("length", [1.0, 2.0])
def test_a_short_hole_is_carried_across(length: float, tmp_path: Path) -> None:
    truth = write_flight(tmp_path)
    without(tmp_path / "imu.csv", 47.0, 47.0 + length)
    result = flown(tmp_path / "log.yaml", *GIVEN)
    assert result["/lost/start"].size == 0
    z, _ = scaled(result, truth)
    assert np.abs(z).max() < 4.5


def test_a_hole_over_the_alignment_is_not_aligned_across(tmp_path: Path) -> None:
    truth = write_flight(tmp_path)
    without(tmp_path / "imu.csv", 2.0, 13.7)
    result = flown(tmp_path / "log.yaml", *GIVEN)
    assert result.attributes["alignment_time"] >= 13.7 - 1e-6
    (unflown,) = (found.text for found in findings.of(result) if "are not replayed" in found.text)
    assert "there are no samples from 2.0 to 13.7 s, and the motion beside does not give the heading to" in unflown
    assert np.abs(scaled(result, truth)[0]).max() < 4.5


def test_a_flight_ends_where_nothing_aligns_it_again(tmp_path: Path) -> None:
    """Three seconds after the hole are not enough."""
    write_flight(tmp_path)
    without(tmp_path / "imu.csv", 60.0, 96.0)
    result = flown(tmp_path / "log.yaml", *GIVEN)
    assert result["/filter/time"][-1] <= 60.0
    assert "nothing after it is replayed, since no alignment was found" in told(result, "lost")


def test_a_filter_whose_attitude_is_lost_finds_it_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Carried across a hole in which it turned by more than it takes for possible, it contradicts the fixes: then the
    attitude is searched anew."""
    truth = write_flight(tmp_path)
    without(tmp_path / "imu.csv", 42.0, 54.0)
    monkeypatch.setattr(recorded_flight, "SURVIVED", np.inf)
    monkeypatch.setattr(simulated, "noise_of", lambda flight, beliefs: beliefs.sensors.noise[None])
    result = flown(tmp_path / "log.yaml", *GIVEN)
    assert result["/lost/start"].size >= 1
    assert set(result["/lost/cause"]) == {simulated.CONTRADICTION}
    z, time = scaled(result, truth)
    late = time > result["/lost/end"].max()
    assert late.sum() > 100
    assert np.abs(z[late]).max() < 4.5


def test_pauses_of_the_fixes_are_told(tmp_path: Path) -> None:
    write_flight(tmp_path)
    without(tmp_path / "gnss.csv", 30.0, 40.0)
    without(tmp_path / "gnss.csv", 60.0, 85.0)
    result = flown(tmp_path / "log.yaml", *GIVEN)
    text = told(result, "pauses")
    assert text.startswith("no fixes for 10.5 s from 29.6 s on, 25.5 s from 59.6 s on: ")


def test_the_table_and_the_exit_code_know_of_a_lost_filter(tmp_path: Path) -> None:
    """Worthless spans are in the table and shaded in the figures, rejected fixes are crosses."""
    write_flight(tmp_path)
    shifted(tmp_path / "gnss.csv", 40.0, 70.0, 25.0)
    keys = [word for key in GIVEN for word in ("--set", key)]
    quiet = ["--figures", "none", "--force", "-o", str(tmp_path / "out.h5")]
    command = ["replay", str(tmp_path / "log.yaml"), *quiet, *keys]
    assert CliRunner().invoke(app, command).exit_code == 0
    strict = CliRunner().invoke(app, [*command, "--require-consistent"])
    assert strict.exit_code == 3, strict.output
    result = flown(tmp_path / "log.yaml", *GIVEN)
    (worthless,) = [table for table in tables(result) if getattr(table, "title", "") == "Unusable output"]
    assert "40.1" in str(worthless.rows)
    drawn = figures(result)
    names = [text.get_text() for text in drawn["track"].legends[0].get_texts()]
    assert "rejected fixes" in names
    assert any(patch.get_alpha() is None for patch in drawn["innovations"].axes[0].patches)


@pytest.fixture(scope="module")
def pierced(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A flight with a hole of the samples, and fixes 25 m off later."""
    folder = tmp_path_factory.mktemp("pierced")
    write_flight(folder)
    without(folder / "imu.csv", 20.0, 35.0)
    shifted(folder / "gnss.csv", 55.0, 75.0, 25.0)
    return flown(folder / "log.yaml", *GIVEN)


def test_figures_and_page_shade_unusable_output(pierced: Result) -> None:
    """In each panel against time; no line crosses the time without output."""
    spans = lost_spans(pierced)
    assert spans.shape == (2, 2)
    for name, count in (("track", 1), ("innovations", 6), ("attitude", 6)):
        panels = [ax for ax in figures(pierced)[name].axes if ax.get_xlabel() == "time, s" or len(ax.patches)]
        shaded = [[patch.get_extents().x0 for patch in ax.patches] for ax in panels]
        assert [len(each) for each in shaded if each] == [2] * count, name
    track, innovations, attitude = replays([("one", pierced)])
    for drawing, panels in ((track, track.panels[1:]), (innovations, innovations.panels), (attitude, attitude.panels)):
        assert "output unusable" in [key.text for key in drawing.keys]
        for panel in panels:
            boxes = [(box.left, box.right) for box in panel.center if isinstance(box, BoxAnnotation)]
            np.testing.assert_allclose(boxes, spans, err_msg=str(panel.name))
    for panel in (*track.panels, *attitude.panels):
        for drawn in (each for each in panel.renderers if isinstance(each.glyph, Line)):
            data = drawn.data_source.data
            time = data["time" if "time" in data else "x"]
            first = int(np.searchsorted(time, spans[0, 1] - 1e-3))
            assert np.isnan(data[drawn.glyph.y][first]), panel.name
    for panel in innovations.panels:
        areas = [r.data_source.data["x"] for r in panel.renderers if isinstance(r.glyph, VArea)]
        assert len(areas) > 1
        assert not any(x[0] < spans[0].mean() < x[-1] for x in areas)


@pytest.mark.parametrize("where", ["straight", "loop"])
def test_a_minute_without_samples(where: str, tmp_path: Path) -> None:
    """Flying straight and in a circle, the motion after it another one than before: aligned again after the hole, with
    nothing from before it; the time is told, and no result for those who want a consistent one."""
    turns = [20.0, 30.0, 38.0, 48.0, 125.0, 135.0, 142.0, 152.0] if where == "straight" else [20.0, 95.0]
    rates = [0.0, 0.2, 0.0, -0.2, 0.0, 0.2, 0.0, -0.2, 0.0] if where == "straight" else [0.0, 0.22, -0.22]
    flight = ride(
        170.0, lambda t: np.full_like(t, 30.0), lambda t: smooth_steps(t, turns, rates),
        lambda t: 2.0 * np.sin(0.15 * t),
    )  # fmt: skip
    samples, fixes = record(flight, 4, rate=25.0, fix_rate=2.0, position_noise=0.0, velocity_noise=0.05, latency=0.1)
    pierced = (samples.time <= 52.0) | (samples.time >= 112.0)
    log = write_recording(
        tmp_path, Samples(samples.time[pierced], samples.rate[pierced], samples.force[pierced]), fixes
    )
    keys = ("gnss.latency_s=0.1", "gnss.velocity_sigma_m_s=[0.05,0.05]", "gnss.position_sigma_m=[0.3,0.3]")
    result = flown(log, *keys)
    np.testing.assert_allclose(lost_spans(result), [[52.0, 112.0]], atol=0.1)
    assert "no samples for 60.0 s, longer than the attitude survives: there is no output" in told(result, "lost")
    at = result["/filter/time"]
    assert not np.any((at > 52.1) & (at < 111.9))
    motion = flight.motion(at)
    z, time = scaled(result, (at, motion.llh, motion.velocity_ned, motion.rpy))
    settled = time > result["/innovations/time"][9]
    assert np.mean(z[settled] ** 2) < 2.0
    assert np.mean(z[time > 112.0] ** 2, axis=1).max() < 5.0
    words = [word for key in keys for word in ("--set", key)]
    quiet = ["--figures", "none", "--force", "-o", str(tmp_path / "out.h5"), "--require-consistent"]
    strict = CliRunner().invoke(app, ["replay", str(log), *quiet, *words])
    assert strict.exit_code == 3, strict.output


FLIGHTS: dict[str, tuple[Callable[[], RecordedTrajectory], float, float, tuple[str, ...]]] = {
    "an aircraft, a fix a second": (circuit, 1.0, 0.1, ()),
    "an aircraft, fixes stamped a second too early": (circuit, 2.0, -1.0, ()),
    "a car": (drive, 2.0, 0.1, ()),
    "a drone that hovers": (quadrotor, 5.0, 0.1, ("alignment={heading_deg: 40.107, heading_sigma_deg: 5}",)),
}
"""Flights: rate of the fixes, latency, keys."""


@pytest.mark.parametrize("faults", ["none", "wild fixes, a pause and a hole"])
@pytest.mark.parametrize("name", in_brief(FLIGHTS, 1, 3))
def test_faults_come_together(name: str, faults: str, tmp_path: Path) -> None:
    """Wherever the squares of the errors are far beyond their sigma for more than five seconds it is told; of a flight
    without faults nothing is told."""
    flight, rate, latency, keys = FLIGHTS[name]
    trajectory = flight()
    samples, fixes = record(trajectory, 3, fix_rate=rate, position_noise=0.0, latency=latency)
    if faults != "none":
        ecef, velocity = ecef_from_llh(fixes.llh), fixes.velocity.copy()
        for k, begin in enumerate((32.0, 60.0, 85.0, 92.0)):
            wild = (fixes.time >= begin) & (fixes.time < begin + (0.7 if k == 1 else 1.6))
            ecef[wild] += (-1.0) ** k * np.array([700.0, -400.0, 750.0])
            velocity[wild] += [20.0, -20.0, 0.0]
        fixes = replace(fixes, llh=llh_from_ecef(ecef), velocity=velocity)
        fixes = fixes.take((fixes.time < 70.0) | (fixes.time > 80.0))
        kept = (samples.time < 100.0) | (samples.time > 104.0)
        samples = Samples(samples.time[kept], samples.rate[kept], samples.force[kept])
    log = write_recording(tmp_path, samples, fixes)
    given = ("gnss.velocity_sigma_m_s=[0.1,0.1]", "gnss.position_sigma_m=[0.1,0.1]", f"gnss.latency_s={latency}")
    result = flown(log, *given, *keys)
    at = result["/filter/time"]
    motion = trajectory.motion(at)
    z, time = scaled(result, (at, motion.llh, motion.velocity_ned, motion.rpy))
    settled = time > result["/innovations/time"][9]
    far = np.flatnonzero(np.diff(np.mean(z[settled] ** 2, axis=1) > 5.0, prepend=False, append=False)).reshape(-1, 2)
    assert np.all(np.diff(far, axis=1) <= 50)  # outputs, ten a second
    names = {one.name for one in findings.of(result)}
    if faults == "none":
        assert not names
    else:
        assert {"rejected_fixes", "pauses"} <= names
        assert names & {"gap", "lost"}
        assert "off_course" not in names


def test_a_sound_flight_needs_no_gate(tmp_path: Path) -> None:
    """With the gate and without it the same estimates, to the bit, where nothing is rejected."""
    write_flight(tmp_path)
    gated, free = (flown(tmp_path / "log.yaml", *GIVEN, f"filter.gate.probability={p}") for p in ("1e-6", "0"))
    for name in ("position_llh", "velocity_ned", "attitude_rpy", "sigma"):
        np.testing.assert_array_equal(gated[f"/filter/{name}"], free[f"/filter/{name}"])
    assert not [f for f in findings.of(gated) if f.name in ("lost", "rejected_fixes", "pauses")]


def test_fixes_rejected_while_lost_are_counted_apart() -> None:
    """The warning's count and that of the table differ by those: it says so."""
    flight = SimpleNamespace(arrival=np.arange(10.0))
    lost = SimpleNamespace(begin=4.0, end=7.0)
    states = {"status": np.zeros(10), "range_status": np.empty((0, 0))}
    flown = SimpleNamespace(rejected=np.array([0, 1, 0, 0, 1, 1, 1, 1, 0, 0]), lost=[lost], **states)
    (found,) = find_outliers(flight, flown)
    assert found.text.startswith("1 of ")
    assert found.text.endswith("; 4 more were rejected while the filter was lost")
