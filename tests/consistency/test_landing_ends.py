"""Where runs touch down, what a pilot sees of their deviations, and go-arounds after their own alarms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.integrity.monitoring import ALARM
from navsim.landing.result import result as summarised
from navsim.landing.study import fly_all
from navsim.landing.total_errors import runs_beyond, scales_of
from navsim.report import figure_data
from navsim.report.box_rows import outside_box
from navsim.report.figure_data import PERCENTS, indicated_deviations
from navsim.report.summary_tables import summary_table
from navsim.results.result import Result
from navsim.results.schema import INDICATED
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.simulation.landing import fly
from navsim.sweeps.outputs import total_outputs
from navsim.sweeps.plan import lacking_of_ends
from navsim.sweeps.scenario import TOTAL_OUTPUTS
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.go_around import PullUp, with_go_around
from tests.consistency.test_flown_ways import mechanised, ways_of
from tests.helpers import case, scenario
from tests.layout import as_declared

MONITOR = ("integrity={method: chi2, p_fa: 1e-4}", "receiver.rate_hz=1", "duration_s=61")
SPOOF = "events=[{what: step, at_s: 45, until_s: 61, sources: [PL1], error_m: 300}]"
ON_ALARM = "approach.go_around={on_alarm: true, delay_s: 2, climb_deg: 4}"
STEERED = "approach.guidance=estimate"


def test_touchdowns_are_early_or_late_by_the_height() -> None:
    """A run that is too high goes on at its sink rate; one that is too low meets the runway before."""
    smooth = case("approach.flight_technical_error={vertical: {sigma_m: 1e-3}}", name="landing_smooth")
    end, ways = ways_of(smooth.shared).end, ways_of(smooth.shared)
    drawn = ways.departure(1, range(WIDTH), WIDTH)
    way = np.zeros_like(drawn.way)
    way[:, 1, 1], way[:, 0, 1] = 2.0, -3.0
    way[:, 2, 2], way[:, 2, 3] = -0.3, 0.3  # down is positive
    way[:, 5, 4], way[:, 2, 4] = -10.0, -0.3  # climbs
    found = end.endings(replace(drawn, way=way)).touchdown
    at = smooth.trajectory.path.events[TOUCHDOWN]
    jet = smooth.trajectory.path.jet(np.array([at]))[0]
    time, along, lateral, sink = found
    assert time[0] == pytest.approx(at, abs=1e-4)
    assert (along[0], lateral[0]) == pytest.approx((jet[0, 0], 0.0), abs=1e-2)
    assert sink[0] == pytest.approx(jet[1, 2], abs=1e-2)
    assert (along[1], lateral[1]) == pytest.approx((along[0] - 3.0, 2.0), abs=1e-2)
    assert time[2] - time[0] == pytest.approx(0.3 / jet[1, 2], rel=0.05)
    assert along[2] - along[0] == pytest.approx(0.3 / jet[1, 2] * jet[1, 0], rel=0.05)
    before = np.linspace(at - 3.0, at, 30_001)
    assert time[3] == pytest.approx(np.interp(-0.3, smooth.trajectory.path.jet(before)[:, 0, 2], before), abs=1e-3)
    assert np.isnan(found[:, 4]).all()


def test_what_a_pilot_sees() -> None:
    """Full scale by similar triangles, on both sides; the glide path has no deviation beyond its foot."""
    seen = case(STEERED, "approach.indicator={course_width_m: 100, course_origin_m: 2000, glide_full_scale: 0.25}",
                "runway.aim_point_m=300", "approach.glide_slope_deg=4")  # fmt: skip
    shown = scales_of(seen)
    assert shown is not None
    assert shown.foot == 0.0
    along = np.array([-300.0, -1000.0, -1000.0, 10.0])
    angle = np.radians(4.0)
    right = np.array([100.0, -100.0 / 2000.0 * 2700.0, 0.0, 0.0])
    up = np.array([0.0, np.tan(1.25 * angle) * np.hypot(1000.0, right[1]), 1000.0 * np.tan(0.5 * angle), 3.0])
    course, glide = shown.deviations(along, right, up).T
    np.testing.assert_allclose(course, [1.0, -1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(glide, [-4.0, 1.0, -2.0, np.nan], atol=1e-12)


def test_the_glide_path_of_a_flare() -> None:
    """Its foot is before the touchdown point, and who flies the route has no deviation until the flare."""
    keys = ("approach.indicator={}", "approach.flight_technical_error.lateral={sigma_m: 1}")
    flared, brief = case(*keys, name="landing_smooth"), case(*keys, "duration_s=20", name="landing_smooth")
    shown, path = scales_of(flared), flared.trajectory.path
    assert scales_of(brief).foot == pytest.approx(shown.foot, abs=2e-6)
    assert shown is not None
    assert shown.foot < -10.0
    at = np.linspace(path.events["glide_start"] + 6.01, path.events["flare"] - 0.5, 50)
    ahead, right, down = path.jet(at)[:, 0].T
    np.testing.assert_allclose(shown.deviations(ahead, right, -down)[:, 1], 0.0, atol=1e-6)


@pytest.fixture(scope="module")
def broken_off() -> Result:
    """Runs of which a false range of a pseudolite raises alarms."""
    one = case(*MONITOR, SPOOF, ON_ALARM, "approach.indicator={}", "box={error: touchdown, lateral_m: 30}",
               "integrity.limits={hal_m: 1000, val_m: 30, tta_s: 6}", "requirements=[{what: glide_path}]")  # fmt: skip
    return summarised(one, fly_all(one, 1, 0, WIDTH, threads(1), keep="all"), 1, keep="all")


def test_go_around_after_an_alarm(broken_off: Result) -> None:
    """It begins after the first alarm of the run, loses the height that the path of a planned one loses, and the run
    is as before until then."""
    as_declared(broken_off)
    planned = case(*MONITOR, SPOOF)
    status, time = broken_off["/integrity/status"], broken_off["/integrity/time"]
    first = time[np.argmax(status == ALARM, axis=1)]
    assert (first >= 45.0).all()
    begin = broken_off["/summary/go_around/time_run"]
    np.testing.assert_allclose(begin, first + 2.0, atol=0.011)
    climbing = with_go_around(planned.trajectory.path, float(first[0]) + 2.0, PullUp(1.2, np.radians(4.0), 1.0))
    height = -climbing.jet(np.linspace(begin[0], begin[0] + 8.0, 8001))[:, 0, 2]
    assert broken_off["/summary/go_around/lost_run"][0] == pytest.approx(height[0] - height.min(), abs=0.02)
    off = broken_off["/filter/deviation_vertical"]
    before = broken_off["/filter/time"] <= first[0]
    free = fly(planned.flight, 1, range(WIDTH))
    np.testing.assert_allclose(broken_off["/filter/error"][:, before], free.error[:, before], atol=1e-6)
    assert not off[:, before].any()
    assert (off[:, -1] > 30.0).all()


def test_runs_that_go_around_end_nowhere(broken_off: Result) -> None:
    assert int(broken_off["/summary/go_around/count"]) == WIDTH
    assert np.isnan(broken_off["/summary/at/vertical_run"][:, 0]).all()
    assert np.isnan(broken_off["/summary/at/vertical"][0]).all()
    assert int(broken_off["/summary/touchdown/landed"]) == 0
    assert int(broken_off["/summary/box/outside"]) == 0
    assert not outside_box(broken_off).any()
    assert np.isnan(broken_off["/summary/at/lateral_tse_run"][:, 0]).all()
    text = str(summary_table([("", broken_off)]))
    assert "Go-arounds after an alarm" in text
    assert "Touchdown" in text


def test_sensors_follow_the_go_around() -> None:
    """The increments of a run that is broken off lead along its own path; with wind, the nose as well."""
    one = case(*MONITOR, ON_ALARM, "wind.speed_m_s=5", "wind.from_deg=80", "imu.rate_hz=100")
    ways = ways_of(one.shared)
    begin = np.full(WIDTH, np.inf)
    begin[:2] = 30.0, 50.0
    flown = ways.flown(ways.commanded(ways.departure(1, range(WIDTH), WIDTH), WIDTH, begin=begin))
    for lane in range(2):
        position, turn = mechanised(one.shared, flown, lane)
        assert position < 0.02
        assert turn < 1e-5
    ends = ways.endings(flown)
    assert np.isfinite(ends.go_around[:, :2]).all()
    assert np.isnan(ends.go_around[:, 2:]).all()
    assert np.isfinite(ends.touchdown[:, 2:]).all()


def test_steered_runs_go_around() -> None:
    """The loop closes through the estimate and the alarm."""
    one = case(*MONITOR, SPOOF, ON_ALARM, STEERED, "imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1")
    runs = fly(one.flight, 1, range(2), measured=False)
    assert runs.loop_gap.max() < 0.01
    first = one.shared.signals.time[np.argmax(runs.monitor_status == ALARM, axis=1)]
    np.testing.assert_allclose(runs.go_around[:, 0], first + 2.0, atol=0.011)
    assert np.isfinite(runs.error[..., : states.ATT]).all()


def test_a_level_above_its_limit_breaks_nothing_off(broken_off: Result) -> None:
    """And is said, with the count of the Stanford diagram."""
    texts = [str(text) for text in broken_off["/findings/text"] if "`go_around.on_alarm`" in str(text)]
    above = broken_off["/summary/integrity/stanford_vertical"][3:5].sum()
    assert above > 0
    (text,) = texts
    assert f"the vertical protection level is above its alert limit without an alarm at {above} of" in text


def test_runs_that_never_fly_the_judged_part_count_nowhere() -> None:
    """Seen before: the table took them as within half scale, the requirement as beyond it."""
    assert runs_beyond(np.array([0.2, 0.5, 0.7, np.nan]), 0.5) == (1, 3)
    assert runs_beyond(np.array([np.nan]), 0.5) == (0, 0)


@pytest.mark.parametrize("system", ["ils", "gls"])
def test_deviations_along_the_approach(broken_off: Result, system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Percentiles of the aircraft are those of its path, until it goes around; those of the estimate differ by the
    error. At the heights of the table both are those of the table."""
    one = case(f"approach.indicator={{system: {system}, until_height_m: 5}}", "duration_s=61",
               "approach.flight_technical_error.lateral={sigma_m: 5}", "imu.rate_hz=50")  # fmt: skip
    flown = summarised(one, fly_all(one, 1, 0, WIDTH, threads(1), keep="errors"), 1, keep="errors")
    seen = indicated_deviations(flown, 10_000)
    assert seen is not None
    at = flown["/summary/at/height"]
    for k, name in enumerate(INDICATED):
        for kind, found in (("", seen.aircraft), ("_indicated", seen.estimate)):
            for i in np.flatnonzero((at > 5.0) & (at < 150.0)):
                due = np.percentile(flown[f"/summary/at/{name}{kind}_run"][:, i], PERCENTS)
                shown = [np.interp(-at[i], -seen.height, each) for each in found[:, :, k]]
                np.testing.assert_allclose(shown, due, atol=0.03)
        largest = np.abs(flown[f"/summary/indicator/{name}_largest_run"]).max()
        assert largest == pytest.approx(np.abs(seen.aircraft[[0, 4], :, k]).max(), rel=0.3)
    gone = indicated_deviations(broken_off, 10_000)
    assert gone is not None
    assert np.isfinite(gone.aircraft[:, 0]).all()
    assert gone.required == {"localizer": [], "glide_path": [0.5]}
    assert gone.reach(1) > 0.5
    nowhere = figure_data._percentiles(np.array([[[np.nan, 1.0]], [[np.nan, 3.0]]]))  # no run has a glide path there
    np.testing.assert_array_equal(nowhere[2, 0], [np.nan, 2.0])
    monkeypatch.setattr(figure_data, "MOST_NUMBERS", 1)
    assert indicated_deviations(flown).height.size <= 20


@pytest.mark.parametrize(("settings", "key"), [
    (("approach.go_around={on_alarm: true}",), "on_alarm"),
    (("approach.go_around={height_m: 30, on_alarm: true}",), "height_m"),
    (("approach.go_around={height_m: 30, delay_s: 3}",), "delay_s"),
    ((*MONITOR, ON_ALARM, "method=covariance"), "on_alarm"),
    ((STEERED, "box={error: touchdown, vertical_m: 3}"), "vertical_m"),
    (("box={error: touchdown, lateral_m: 3}",), "error"),
    (("approach.indicator={}",), "indicator"),
    (("approach={profile: s-turn, start: {lat_deg: 56, lon_deg: 37}, indicator: {}, guidance: estimate}",),
     "no glide path"),
    (("requirements=[{what: go_around, at_most: 0.1}]",), "what"),
    (("requirements=[{what: localizer}]",), "what"),
])  # fmt: skip
def test_what_does_not_go_together(settings: tuple[str, ...], key: str) -> None:
    with pytest.raises(InputError, match=key):
        scenario(*settings)


def test_sweeps_have_total_errors_and_ends(broken_off: Result) -> None:
    """Those of a landing's result; a study of a scenario without them is refused."""
    found = total_outputs(broken_off)
    names = {name.removesuffix("_low").removesuffix("_high") for name in found}
    assert names == set(TOTAL_OUTPUTS)
    assert [found[f"go_around{end}"] for end in ("", "_low", "_high")] == list(broken_off["/summary/go_around/share"])
    np.testing.assert_array_equal(found["along_total_200ft"], broken_off["/summary/at/along_tse"][3, 0])
    plain = case(*MONITOR).scenario
    for name, lacking in (("outside_box", "box"), ("go_around", "approach.go_around.on_alarm"), ("hmi", ""),
                          ("along_total_50ft", "approach.guidance: estimate")):  # fmt: skip
        assert lacking_of_ends(name, plain) == lacking


def test_deviations_count_from_where_the_route_is_established() -> None:
    """The capture of the glide path is no deviation of the aircraft; the figure shows what the table counts."""
    one = case("approach.indicator={}", "approach.flight_technical_error.lateral={sigma_m: 1}", "duration_s=80",
               "imu.rate_hz=50", name="landing_smooth")  # fmt: skip
    flown = summarised(one, fly_all(one, 1, 0, WIDTH, threads(1), keep="errors"), 1, keep="errors")
    assert 38.0 < float(flown["/summary/indicator/from_time"]) <= 41.0
    assert float(flown["/summary/indicator/glide_path_largest_run"].max()) < 0.03
    assert np.abs(indicated_deviations(flown, 10_000).aircraft[:, :, 1]).max() < 0.03


def test_deviations_that_never_count_decide_nothing() -> None:
    """Seen before: no run beyond half scale, and a requirement not met, of a flight that is never judged."""
    one = case("approach.indicator={until_height_m: 1000}", "approach.flight_technical_error.lateral={sigma_m: 1}",
               "duration_s=20", "imu.rate_hz=50", "requirements=[{what: localizer, within: 0.5}]")  # fmt: skip
    flown = summarised(one, fly_all(one, 1, 0, WIDTH, threads(1), keep="errors"), 1, keep="errors")
    assert np.isnan(flown["/summary/indicator/localizer_beyond_half"]).all()
    assert flown["/summary/requirements/verdict"].tolist() == ["undecided"]
    assert indicated_deviations(flown).height.size == 0
