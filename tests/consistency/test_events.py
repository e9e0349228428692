"""What happens to signals, by what a receiver makes of them: fixes that land where a spoofer wants them, rates that are
the changes of ranges, silence that is no source."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss.events import Event, RangeFault, Scene, Silence, happened
from navsim.integrity.monitoring import ALARM, QUIET
from navsim.landing import study as landing
from navsim.landing.study import Case, covariance_analysis
from navsim.scenario.load import read
from navsim.scenario_files.source import InputError
from navsim.simulation import measurements
from tests.consistency.test_tight_landings import flown
from tests.helpers import SCENARIOS, case

BRIEF = ("duration_s=30", "receiver.rate_hz=2", "filter.kind=eskf")


def after(*events: dict[str, Any], settings: tuple[str, ...] = ()) -> Case:
    return case(*BRIEF, f"events={json.dumps(events)}", *settings)


def fixes(c: Case, when: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of fixes without noise, position in the NED of epoch `when` and velocity (e, 3), and the receiver's clock
    (e,), m."""
    ranges, rates = measurements.without_noise(c.shared)
    llh, velocity, clocks, _ = measurements.receiver_fixes(c.shared, ranges, rates)
    axes = ned_matrix(llh_from_ecef(c.shared.signals.antenna))
    off = (ecef_from_llh(llh) - c.shared.signals.antenna) @ axes[when].T
    return off, velocity - c.shared.at_filter.velocity_ned[1:], clocks[:, 0]


def test_a_spoofer_of_everything_puts_the_fix_where_he_wants() -> None:
    """Every source: the fix goes off as he says, velocity and clock too, and the residuals see nothing."""
    spoof = {"what": "spoof", "sources": ["all"], "offset_ned_m": [12.0, -5.0, -30.0], "rate_ned_m_s": [0.0, 1.5, -2.0],
             "clock_m": 40.0, "at_s": 10}  # fmt: skip
    watched = ("integrity={method: chi2, p_fa: 1.0e-2}",)
    plain, spoofed = after(settings=watched), after(spoof, settings=watched)
    time = plain.shared.signals.time
    on = time >= 10.0
    (true, v_true, clock), (off, v_off, moved) = (fixes(c, int(np.argmax(on))) for c in (plain, spoofed))
    np.testing.assert_allclose(true, 0.0, atol=1e-6)
    np.testing.assert_allclose(off[~on], true[~on], atol=1e-9)
    expected = np.array([12.0, -5.0, -30.0]) + np.array([0.0, 1.5, -2.0]) * (time[on, None] - 10.0)
    np.testing.assert_allclose(off[on], expected, atol=1e-4)
    np.testing.assert_allclose((moved - clock)[on], 40.0, atol=1e-4)
    np.testing.assert_allclose((v_off - v_true)[on], np.broadcast_to([0.0, 1.5, -2.0], (on.sum(), 3)), atol=2e-3)
    quiet, told = (flown(c, 8, 3) for c in (plain, spoofed))
    np.testing.assert_allclose(told.monitor_statistic, quiet.monitor_statistic, rtol=2e-2, atol=0.05)


def test_clean_pseudolites_see_what_they_measure() -> None:
    """80 m east are seen by two pseudolites that are not spoofed; 80 m up are not: they stand at the horizon."""
    watched = ("integrity={method: chi2, p_fa: 1.0e-5}",)
    alarms = {}
    for name, offset in (("across", [0.0, 80.0, 0.0]), ("up", [0.0, 0.0, -80.0])):
        c = after({"what": "spoof", "sources": ["glonass"], "offset_ned_m": offset}, settings=watched)
        run = flown(c, 8, 3)
        alarms[name] = float((run.monitor_status == ALARM).mean())
        assert set(np.unique(run.monitor_status)) <= {QUIET, ALARM}
    assert alarms["across"] > 0.95
    assert alarms["up"] < 0.01


def test_a_meacon_puts_every_fix_where_it_stands() -> None:
    place = {"lat_deg": 56.02, "lon_deg": 37.01}
    c = after({"what": "meacon", "sources": ["glonass"], "place": place, "height_m": 60, "delay_m": 700, "at_s": 5},
              settings=("pseudolites.count=0",))  # fmt: skip
    ranges, rates = measurements.without_noise(c.shared)
    llh, velocity, clocks, _ = measurements.receiver_fixes(c.shared, ranges, rates)
    on = c.shared.signals.time >= 5.0
    there = ecef_from_llh(np.array([np.radians(56.02), np.radians(37.01), 60.0]))
    assert np.linalg.norm(ecef_from_llh(llh[on]) - there, axis=1).max() < 0.5
    assert np.linalg.norm(velocity[on], axis=1).max() < 0.02
    onward = np.linalg.norm(c.shared.signals.antenna[on] - there, axis=1)
    assert np.abs(clocks[on, 0] - c.shared.clock[on, 0] - onward - 700.0).max() < 0.5
    assert np.linalg.norm(ecef_from_llh(llh[~on]) - c.shared.signals.antenna[~on], axis=1).max() < 1e-5


@pytest.mark.parametrize(
    "event",
    [
        {"what": "ramp", "sources": ["all"], "rate_m_s": 3.0},
        {"what": "survey", "sources": ["pseudolites"], "ned_m": [200.0, -90.0, 5.0]},
        {"what": "spoof", "sources": ["all"], "offset_ned_m": [500.0, 0.0, 80.0], "rate_ned_m_s": [-7.0, 2.0, 1.0],
         "drift_m_s": 4.0},
        {"what": "meacon", "sources": ["all"], "place": {"lat_deg": 56.02, "lon_deg": 37.1}, "delay_m": 10},
    ],
)  # fmt: skip
def test_range_rates_are_changes_of_ranges(event: dict[str, Any]) -> None:
    """By differences over 20 ms either side, of what the event adds: the times of ranges are rounded."""
    brief = ("duration_s=4", "receiver.rate_hz=50", "filter.kind=eskf")
    c = case(*brief, f"events={json.dumps([event])}")
    of_event, plain = (measurements.without_noise(world) for world in (c.shared, case(*brief).shared))
    ranges, rates = (told - true for told, true in zip(of_event, plain, strict=True))
    time = c.shared.signals.time
    change = (ranges[2:] - ranges[:-2]) / (time[2:] - time[:-2])[:, None]
    used = c.shared.signals.used.all(axis=0)
    assert np.abs(rates[:, used]).max() > 0.05
    np.testing.assert_allclose(change[:, used], rates[1:-1][:, used], atol=2e-4)


def test_a_survey_error_is_that_of_the_section() -> None:
    """The event and `pseudolites.survey_error_m` are two ways to say one thing."""
    told = after({"what": "survey", "sources": ["pseudolites"], "ned_m": [0.5, -0.4, 0.3]})
    given = after(settings=("pseudolites.survey_error_m=[0.5, -0.4, 0.3]",))
    # there north is that of each pseudolite, here of the aircraft: 5 km away 1e-3 rad
    for a, b in zip(measurements.without_noise(told.shared), measurements.without_noise(given.shared), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-3)


def test_silence_is_no_source() -> None:
    """A silenced satellite is left out of fixes and levels like an excluded one, and comes back."""
    silent = after({"what": "silence", "sources": ["R24", "PL2"], "at_s": 10, "until_s": 20})
    plain = after()
    s, time = silent.shared.signals, silent.shared.signals.time
    gone = np.isin(s.names, ["R24", "PL2"])
    on = (time >= 10.0) & (time < 20.0)
    assert plain.shared.signals.used[:, gone].all()
    assert not s.used[np.ix_(on, gone)].any()
    np.testing.assert_array_equal(s.used[~on], plain.shared.signals.used[~on])
    ranges, _ = measurements.measured(silent.shared, 1, 0)
    assert np.isnan(ranges[np.ix_(on, gone)]).all()
    # noise of the others is what it was
    np.testing.assert_array_equal(ranges[:, ~gone], measurements.measured(plain.shared, 1, 0)[0][:, ~gone])


def test_the_covariance_analysis_has_the_mean_of_runs() -> None:
    """A ramp of a pseudolite moves the mean error of 200 runs as the analysis says."""
    c = after({"what": "ramp", "sources": ["PL1"], "rate_m_s": 0.4, "at_s": 5}, settings=("filter.velocity=false",))
    errors = np.concatenate([run.error[:, -1, :3] for run in c.fly_runs(8, 0, 200)])
    expected = covariance_analysis(c).mean[-1, :3]
    assert np.abs(expected).max() > 1.0
    reach = 4.0 * errors.std(axis=0) / np.sqrt(200)
    assert (np.abs(errors.mean(axis=0) - expected) < reach + 0.02 * np.abs(expected)).all()


def test_events_add_up_and_end() -> None:
    time = np.arange(6.0)
    still = np.zeros((6, 2, 3))
    scene = Scene(time, ("R01", "PL1"), ("glonass", "pseudolites"), still + 1e7, still, still[:, 0], still[:, 0],
                  np.broadcast_to(np.eye(3), (6, 3, 3)))  # fmt: skip
    events = (
        Event(RangeFault(5.0, 0.0), ("glonass",), 1.0, 3.0),
        Event(RangeFault(0.0, 2.0), ("all",), 2.0, np.inf),
        Event(Silence(), ("PL1",), 4.0, 5.0),
        Event(RangeFault(0.0, 3.0), ("PL1",), 3.0, np.inf, code_only=True),
    )
    longer, faster, apart, silent = happened(events, scene)
    np.testing.assert_array_equal(longer[:, 0], [0.0, 5.0, 5.0, 2.0, 4.0, 6.0])
    np.testing.assert_array_equal(longer[:, 1], [0.0, 0.0, 0.0, 2.0, 7.0, 12.0])
    np.testing.assert_array_equal(faster[:, 1], [0.0, 0.0, 2.0, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(silent[:, 1], [False, False, False, False, True, False])
    assert not silent[:, 0].any()
    np.testing.assert_array_equal(apart[:, 1], [0.0, 0.0, 0.0, 0.0, 3.0, 6.0])
    assert not apart[:, 0].any()


@pytest.mark.parametrize("event", [{"what": "ramp", "rate_m_s": 2.0}, {"what": "step", "error_m": 30.0}])
def test_of_the_code_only(event: dict[str, Any]) -> None:
    """Ranges as without it, range rates and carriers as if nothing happened; a code that is smoothed by such a carrier
    follows by Hatch's recursion: y = c / n + (1 - 1 / n) y before."""
    both = {code_only: after(event | {"sources": ["R01"], "at_s": 10, "code_only": code_only},
                             settings=("receiver.smoothing_s=5",)) for code_only in (False, True)}  # fmt: skip
    plain = after(settings=("receiver.smoothing_s=5",))
    i, time = plain.shared.signals.names.index("R01"), plain.shared.signals.time
    wrong = {"ramp": 2.0 * np.maximum(time - 10.0, 0.0), "step": np.where(time >= 10.0, 30.0, 0.0)}[event["what"]]
    told, truth = both[True].shared.signals, plain.shared.signals
    np.testing.assert_array_equal(told.range_rate, truth.range_rate)
    np.testing.assert_allclose(told.range_bias[:, i] - truth.range_bias[:, i], wrong, atol=1e-9)
    np.testing.assert_allclose(both[False].shared.signals.range_bias, told.range_bias, atol=1e-9)
    smoothed, expected = np.empty((3, time.size)), np.zeros(time.size)
    for row, c in zip(smoothed, (plain, both[False], both[True]), strict=True):
        row[:] = measurements.without_noise(c.shared)[0][:, i]
    np.testing.assert_allclose(smoothed[1] - smoothed[0], wrong, atol=1e-6)
    for e in range(1, time.size):
        n = min(e + 1, 10)  # 5 s of two epochs a second
        expected[e] = wrong[e] / n + (1.0 - 1.0 / n) * expected[e - 1]
    np.testing.assert_allclose(smoothed[2] - smoothed[0], expected, atol=1e-6)
    assert np.abs(smoothed[2] - smoothed[1]).max() > 5.0


@pytest.mark.parametrize(
    ("event", "key", "says"),
    [
        ({"what": "step", "sources": ["R77"], "error_m": 3}, "events.0.sources.0", "'R77' is not a source"),
        ({"what": "step", "sources": [], "error_m": 3}, "events.0.sources", "at least 1"),
        ({"what": "stop", "sources": ["R01"]}, "events.0.what", "did you mean 'step'?"),
        ({"what": "spoof", "sources": ["R01"]}, "events.0.what", "changes nothing"),
        ({"what": "silence", "sources": ["R01"], "at_s": 9, "until_s": 9}, "events.0.until_s", "after at_s"),
        ({"what": "silence", "sources": ["R01"], "at_s": 90}, "events.0.at_s", "not within duration_s"),
        ({"what": "silence", "sources": ["R01"], "code_only": True}, "events.0.code_only", "unknown key"),
    ],
)
def test_what_cannot_happen_is_refused(tmp_path: Path, event: dict[str, Any], key: str, says: str) -> None:
    with pytest.raises(InputError) as error:
        landing.prepare(*read(SCENARIOS / "landing.yaml", (*BRIEF, f"events={json.dumps([event])}")))
    assert f"{key}:" in str(error.value)
    assert says in str(error.value)


def test_an_event_that_nobody_hears_is_told() -> None:
    hidden = after({"what": "step", "sources": ["R03"], "error_m": 9, "at_s": 2})
    (text,) = [warning for warning in hidden.warnings if "events" in warning]
    assert "events[0]: step of R03: none of them is received then" in text
    heard = after({"what": "step", "sources": ["glonass"], "error_m": 9, "at_s": 2})
    assert not [warning for warning in heard.warnings if "events" in warning]


def test_pseudolites_that_are_placed_later_are_told_by_what_they_are() -> None:
    """A search places its own beside those of its base: events and their warnings know them."""
    bare = landing.prepare(*read(SCENARIOS / "landing.yaml", (*BRIEF, "pseudolites.count=0")))
    assert bare.environment.systems_of(("R01", "PL1", "R24")) == ("glonass", "pseudolites", "glonass")
