"""Ranging beacons in filter, smoother and covariance analysis: each state's errors are as large as its sigma says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from navsim.compiler.lanes import WIDTH
from navsim.integrity.monitoring import ALARM, EXCLUDED, QUIET
from navsim.landing.integrity import count_epochs, level_warnings
from navsim.landing.study import covariance_analysis, fly_all
from navsim.results.notes import labelled
from navsim.runner.executor import threads
from navsim.simulation.landing import fly_inputs
from navsim.simulation.run_inputs import draw_inputs
from tests.consistency.test_watched_filters import AXES, bank_of, differences
from tests.consistency.test_watched_filters import weighed as given_to_bank
from tests.helpers import case, in_brief

BRIEF = ("duration_s=40", "receiver.rate_hz=1", "imu.rate_hz=20", "initial_errors.attitude_deg=1")
SITES = (
    "{s_m: 120, l1_m: 300, height_m: 10}, {s_m: -120, l1_m: 300}, {s_m: 150, l1_m: -400}, "
    "{s_m: -150, l1_m: -400, height_m: 15}"
)
ERRORS = (
    "weak_sigma_m: 0.2", "bias_sigma_m: 0.3", "growth_m: 0.4", "growth_sigma_m: 0.2", "growth_distance_m: 300",
    "survey_sigma_m: 0.2", "lever_arm_m: [1, 0.5, -0.3]",
)  # fmt: skip
NO_SATELLITES = "events=[{what: silence, sources: [all], at_s: 12}]"


def beacons(*keys: str) -> str:
    """Section of four beacons with these keys."""
    return f"beacons={{sites: [{SITES}], rate_hz: 10, range_limit_m: 3000, sigma_m: 0.1, {', '.join(keys)}}}"


@pytest.mark.parametrize(
    ("kind", "coupling", "runs", "clock"),
    in_brief([("eskf", "tight", 120, True), ("eskf", "tight", 120, False), ("gaussian-sum", "loose", 1000, False),
              ("gaussian-sum", "tight", 1000, False), ("left-invariant", "loose", 1000, False),
              ("rts", "loose", 500, False), ("gaussian-sum", "loose", 1000, True), ("rts", "loose", 500, True)], 0),
)  # fmt: skip
def test_every_state_is_consistent(kind: str, coupling: str, runs: int, clock: bool) -> None:
    """Satellites are lost on the way. RMS of error / sigma of every state, and sigma of the analysis over the filter's.

    Biases and survey errors are the same all the way, so each state has as many independent errors as there are runs.
    """
    own = ("clock: {}",) if clock else ()
    flown = case(*BRIEF, beacons(*ERRORS, "latency_s: 0.1", *own), NO_SATELLITES, f"filter.kind={kind}",
                 f"filter.coupling={coupling}")  # fmt: skip
    names = list(flown.states)
    assert sum(name.startswith("beacons_") for name in names) == (22 if clock else 20)
    result = fly_all(flown, 31, 0, runs, threads())
    z = np.sqrt(np.mean((result["error"] / result["sigma"]) ** 2, axis=0))[5:]
    z = np.sqrt(np.mean(z**2, axis=0))
    if kind == "rts":  # heading and gyro biases are off without beacons, too
        z = np.delete(z, [i for i, name in enumerate(names) if name.startswith(("attitude_", "gyro_"))])
    wide = 4.0 / np.sqrt(2.0 * runs)
    assert np.abs(z - 1.0).max() < max(0.07, wide), z.round(3)
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.03 + 0.1 * wide)
    squares, weighed = (result.per_run(f"aided_{name}").sum() for name in ("innovations", "weighed"))
    assert squares / weighed == pytest.approx(1.0, abs=0.02)
    if kind == "rts":  # a smoother has no covariance analysis
        return
    analysis = covariance_analysis(flown)
    named = {"beacons_bias", "beacons_bias_growth", "beacons_survey", "beacons", *(["beacons_clock"] if clock else [])}
    assert named < set(analysis.sources)
    ratio = np.sqrt(np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed))
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)


@pytest.mark.parametrize(("coupling", "clock"), in_brief([("loose", False), ("tight", True)], 0))
def test_refractivity_is_a_state(coupling: str, clock: bool) -> None:
    """Beacons at 5 to 8 km show more than half of a refractivity of 50 N-units; every state is consistent over 240
    runs."""
    far = "{s_m: 2000, l1_m: 5000, height_m: 10}, {s_m: -2500, l1_m: 3000}, {s_m: 3000, l1_m: -6000}, "
    far += "{s_m: -1500, l1_m: -8000, height_m: 15}"
    air = "air: {correction: refractivity, truth_refractivity_n: 315, refractivity_sigma_n: 50}"
    section = beacons(*ERRORS, air, *(("clock: {}",) if clock else ()))
    section = section.replace(SITES, far).replace("range_limit_m: 3000", "range_limit_m: 20000")
    flown = case(*BRIEF, section, NO_SATELLITES, "filter.kind=eskf", f"filter.coupling={coupling}")
    names, analysis = list(flown.states), covariance_analysis(flown)
    own = names.index("beacons_refractivity")
    ratio = np.sqrt(np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed))
    np.testing.assert_allclose(ratio, 1.0, atol=0.01)
    assert "beacons_air" in analysis.sources
    assert np.sqrt(analysis.assumed[0, own, own]) == pytest.approx(50.0)
    assert np.sqrt(analysis.assumed[-1, own, own]) < (50.0 if clock else 30.0)
    result = fly_all(flown, 61, 0, 240, threads())
    z = np.sqrt(np.mean((result["error"] / result["sigma"])[:, 5:] ** 2, axis=(0, 1)))
    assert np.abs(z - 1.0).max() < 4.0 / np.sqrt(480.0), z.round(3)


NEAR_ITS_HEIGHT = (
    "beacons={sites: [{s_m: 80, l1_m: 150, height_m: 60}, {s_m: -80, l1_m: 150, height_m: 60}], rate_hz: 10, "
    "range_limit_m: 3000, sigma_m: 0.03, bias_sigma_m: 0.1}", "signals.preset=open-sky", "pseudolites.count=0",
)  # fmt: skip
"""Two beacons whose ranges are not linear in an error of the height: at 500 m by 0.05 m on average."""


@pytest.mark.parametrize(
    ("kind", "coupling", "runs"),
    in_brief([("eskf", "tight", 120), ("eskf", "loose", 1000), ("left-invariant", "loose", 500),
              ("gaussian-sum", "tight", 500)], 0),
)  # fmt: skip
def test_ranges_that_are_not_linear(kind: str, coupling: str, runs: int) -> None:
    """With products of the position error as states sigma is right; a linear filter believes the height twice too
    well."""
    settings = (*BRIEF, *NEAR_ITS_HEIGHT, f"filter.kind={kind}", f"filter.coupling={coupling}")
    for second_order in ("true", "false"):
        flown = case(*settings, f"filter.beacons.second_order={second_order}")
        assert any("as linear" in text for text in flown.warnings) == (second_order == "false")
        result = fly_all(flown, 31, 0, runs, threads())
        z = np.sqrt(np.mean((result["error"] / result["sigma"])[:, 5:, :6] ** 2, axis=(0, 1)))
        if second_order == "true":
            assert np.abs(z - 1.0).max() < max(0.08, 2.5 / np.sqrt(2.0 * runs)), z.round(3)
    assert z[2] > 1.6


def test_one_beacon_alone() -> None:
    """Satellites lost, the position is known across the range to tens of metres: a linear filter takes its own turning
    of the line of sight for knowledge. By default the filter follows the second order."""
    alone = (*BRIEF, NO_SATELLITES, "pseudolites.count=0", "filter.kind=eskf", "filter.coupling=tight",
             "beacons={sites: [{s_m: 150, l1_m: -100, height_m: 10}], rate_hz: 10, range_limit_m: 3000, sigma_m: 0.1, "
             "bias_sigma_m: 0.1}")  # fmt: skip
    for keys, least, most in (((), 0.8, 1.4), (("filter.beacons.second_order=false",), 2.5, 20.0)):
        result = fly_all(case(*alone, *keys), 31, 0, 64, threads())
        z = np.sqrt(np.mean((result["error"] / result["sigma"])[:, 5:, :6] ** 2, axis=0))
        assert least < z.max() < most, z.max(axis=0).round(2)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["eskf", "gaussian-sum"])
def test_one_beacon_over_a_pad(kind: str) -> None:
    """70 s with one beacon, 20 s of them in a hover: linear, the position was off by up to 20 sigma."""
    alone = ("duration_s=95", "approach.hover_s=20", "beacons.sites=[{name: NW, s_m: -40, l1_m: 60, height_m: 2}]")
    flown = case(*alone, f"filter.kind={kind}", "filter.coupling=tight", name="beacons_pad")
    result = fly_all(flown, 88001, 0, 300, threads())
    z = np.sqrt(np.mean((result["error"] / result["sigma"])[:, 5:, :6] ** 2, axis=0))
    assert z.max() < 1.3, z.max(axis=0).round(2)
    assert (result["nees_position_velocity"].mean(axis=0) / 6.0).max() < 2.0


def test_they_hold_the_position_when_satellites_are_lost() -> None:
    """Sigmas at the end with and without beacons; a beacon without states for its bias believes itself too well."""
    lost = (*BRIEF, NO_SATELLITES, "filter.kind=eskf")
    without, held, bold = (
        covariance_analysis(case(*lost, *more))
        for more in ((), (beacons(*ERRORS),), (beacons(*ERRORS), "filter.beacons.errors=none"))
    )
    assert np.sqrt(held.assumed[-1, 0, 0]) < 0.2 * np.sqrt(without.assumed[-1, 0, 0])
    true, assumed = (np.sqrt(np.trace(m[-1, :2, :2])) for m in (bold.covariance, bold.assumed))
    assert true > 3.0 * assumed


@pytest.mark.long
def test_every_state_is_consistent_over_a_pad() -> None:
    """The shipped landing on a pad, whose satellites are lost before the hover, in 300 runs."""
    result = fly_all(case(name="beacons_pad"), 42, 0, 300, threads())
    z = np.sqrt(np.mean((result["error"] / result["sigma"]) ** 2, axis=0))[5:]
    assert np.abs(z - 1.0).max() < 0.22, z.round(3)
    assert np.abs(np.sqrt(np.mean(z**2, axis=0)) - 1.0).max() < 0.12


def test_outliers_and_lost_answers() -> None:
    """The gate keeps reflections out that are far longer than the noise."""
    keys = ("long_share: 0.05", "long_m: 400", "loss: 0.3")
    flown = case(*BRIEF, beacons(*ERRORS, *keys), "filter.kind=eskf", "filter.gate={probability: 1e-4}")
    result = fly_all(flown, 5, 0, 24, threads())
    questions = 24 * flown.shared.aids[0].time.size
    weighed, rejected = (result.per_run(f"aided_{name}").sum() for name in ("weighed", "rejected"))
    assert weighed / questions == pytest.approx(0.7, abs=0.02)
    assert rejected / weighed == pytest.approx(0.05, abs=0.01)
    z = np.sqrt(np.mean((result["error"][:, -1, :6] / result["sigma"][:, -1, :6]) ** 2))
    assert z == pytest.approx(1.0, abs=0.25)


MIXTURE = ("beacons.long_share=0.3", "filter.beacons.outliers=mixture")


@pytest.mark.parametrize(
    ("kind", "settings", "runs"),
    in_brief([("eskf", (), 24), ("eskf", MIXTURE, 40), ("gaussian-sum", MIXTURE, 200), ("rts", MIXTURE, 200)], 0, 1),
)
def test_nees_with_outliers(kind: str, settings: tuple[str, ...], runs: int) -> None:
    """NEES of position and velocity without satellites is right in spite of 2 % of reflections (5 without a gate), and
    of 30 % with a mixture (4 with the gate alone)."""
    flown = case(f"filter.kind={kind}", "imu.rate_hz=20", *settings, name="beacons_uav")
    alone = flown.shared.filter_time > 43.0
    nees = [run.nees_position_velocity[:, alone] for run in flown.fly_runs(9021, 0, runs, measured=False)]
    assert np.concatenate(nees).mean() / 6.0 == pytest.approx(1.0, abs=1.0 / np.sqrt(runs))


@pytest.mark.parametrize("kind", in_brief(["eskf", "gaussian-sum", "rts"], 0))
def test_a_filter_that_begins_at_a_wrong_place_comes_back(kind: str) -> None:
    """In run 287 the first ranges mislead the filter by 9 m: it took all clean ones after them for outliers (mean NEES
    1800)."""
    off = ("beacons.long_share=0", "beacons.long_m=0", "beacons.outlier_share=0.2", "beacons.outlier_sigma_m=20")
    flown = case(f"filter.kind={kind}", "imu.rate_hz=20", *off, "filter.beacons.outliers=mixture", name="beacons_uav")
    (run,) = flown.fly_runs(3, 287, 1, measured=False)
    assert run.nees_position_velocity[0, flown.shared.filter_time > 43.0].mean() < 12.0


def test_a_range_that_is_lost_does_not_keep_a_filter_at_a_wrong_place() -> None:
    """In run 764 no answer comes when the filter would widen its position; it waited for as many again (NEES 24)."""
    off = ("beacons.long_share=0", "beacons.long_m=0", "beacons.outlier_share=0.2", "beacons.outlier_sigma_m=20")
    few = ("imu.rate_hz=20", "beacons.loss=0.6", "filter.beacons.outliers=mixture", "filter.kind=eskf")
    flown = case(*off, *few, name="beacons_uav")
    (run,) = flown.fly_runs(11, 764, 1, measured=False)
    assert run.nees_position_velocity[0, flown.shared.filter_time > 43.0].mean() < 12.0


WATCHED = (*BRIEF, "receiver.rate_hz=2", "filter.kind=eskf", "sky.source=nominal", "pseudolites.count=0",
           beacons("bias_sigma_m: 0.3", "survey_sigma_m: 0.2"),
           "integrity={method: filter, p_constellation: 1.0e-8, p_satellite: 1.0e-7, "
           "innovations: {window_s: 4}}")  # fmt: skip


def test_filters_without_a_beacon_watch_the_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Differences after the loss of the satellites: those of filters that are really flown without the beacons."""
    flown = case(*WATCHED, NO_SATELLITES)
    bank, bare = bank_of(flown), replace(flown.flight, watching=None)
    (aid,) = flown.shared.aids
    faults = {k: fault for k, fault in enumerate(flown.flight.expected) if fault.sources[0][0] == "B" and not fault.of}
    assert [fault.name for fault in faults.values()] == ["B1", "B2", "B3", "B4", "B1+B2+B3+B4"]
    given, inputs = given_to_bank(flown, 78, range(WIDTH), monkeypatch), draw_inputs(bare, 78, range(WIDTH))
    whole, late = fly_inputs(bare, inputs, WIDTH), flown.shared.filter_time[1:] > 20.0
    for k, fault in faults.items():
        out = np.isin(aid.sensor.transmitter_at(aid.time), [int(name[1:]) - 1 for name in fault.sources])
        less = replace(inputs, aided=(np.where(out[:, None, None], np.nan, inputs.aided[0]),))
        apart = np.abs(whole.error - fly_inputs(bare, less, WIDTH).error)[:, 1:, :3]
        sigma = bank.found.spread.separation_sigma[k][:, AXES]
        ours = np.array(differences(bank, given, k, monkeypatch)).transpose(2, 1, 0)
        assert np.sqrt(np.mean(((ours - apart) / sigma)[:, late] ** 2)) < 0.1
        assert np.sqrt(np.mean((apart / sigma)[:, late] ** 2)) == pytest.approx(0.9, abs=0.3)


def test_a_faulty_beacon_is_an_alarm_and_stays_within_the_level() -> None:
    """A step of 3 m at 20 s, or all beacons spoofed, noticed within 1 s; without it no alarm. Errors before an alarm
    are below their levels, which count the loss of every beacon and of all together. Without beacons and satellites the
    other filter drifts, until its difference shows no spoofer any more."""
    spoofed = ", {what: spoof, sources: [beacons], at_s: 20, rate_ned_m_s: [2, 0, 0]}"
    step = ", {what: step, sources: [B1], at_s: 20, error_m: 3}"
    for event, alarms, until in ((spoofed, 1.0, 30.0), ("", 0.0, 60.0), (step, 1.0, 60.0)):
        flown = case(*WATCHED, NO_SATELLITES[:-1] + event + "]", "filter.gate={probability: 0}")
        time, levels = flown.shared.signals.time, flown.flight.monitor.levels
        for run in flown.fly_runs(5, 0, 16, measured=False):
            alarm = run.monitor_status == ALARM
            assert not alarm[:, time < 20.0].any()
            assert alarm[:, (time > 21.0) & (time < until)].mean() == alarms
            assert (run.watched_error < levels)[~alarm].all()
    (aid,) = flown.shared.aids
    for e in (10, 50, 70):  # the fixes of four seconds, and the ranges since the fix before them
        fixes = (time > time[e] - 4.0 + 1e-6) & (time <= time[e])
        since = (aid.time > time[fixes][0] - 0.5 + 1e-6) & (aid.time <= time[e] + 1e-6)
        squares = np.nansum(run.innovation_squared[:, fixes], axis=1) + run.aided_squared[:, since].sum(axis=1)
        degrees = run.degrees[0, fixes].sum() + run.aided_degrees[0, since].sum()
        np.testing.assert_allclose(run.innovation_ratio[:, e], squares / chi2.isf(1e-5, degrees), rtol=1e-9)
    (said,) = level_warnings(flown)
    assert labelled(said).endswith("by integrity.ground_groups, integrity.p_beacon [levels_by_inertial_sensors]")
    alone = flown.flight.bank.found.spread.separate_sigma[-1]
    assert levels[-1, 0] > 5.0 * alone[-1, 0] > 0.0


def test_a_faulty_beacon_is_excluded_and_the_filter_without_it_takes_over() -> None:
    """From the alarm on, runs are to the bit those of a filter that never had the beacon, within the levels of that
    filter's own monitor. By residuals alone every beacon is as suspect: one range more than a position needs."""
    watched = [key.replace("innovations: {window_s: 4}", "exclusion: residual") for key in WATCHED]
    step = ", {what: step, sources: [B3], at_s: 20, error_m: 1}"
    flown = case(*watched, NO_SATELLITES[:-1] + step + "]", "filter.gate={probability: 0}")
    (run,) = flown.fly_runs(5, 0, WIDTH, measured=False)
    time, status, names = flown.shared.signals.time, run.monitor_status, [c.name for c in flown.flight.candidates]
    after, counted = time > 24.0, count_epochs(flown, run)
    assert (status[:, time < 20.0] == QUIET).all()
    assert (status[:, after] == EXCLUDED).all()
    assert (run.monitor_excluded[:, after] == names.index("B3")).all()
    assert (counted["integrity_exclusions"][:, 1:] == 0).all(), "none but right ones"
    assert (run.watched_error < run.monitor_level)[:, after].all()
    (aid,) = flown.shared.aids
    bare = replace(flown.flight, watching=None, second_order=False)
    inputs, out = draw_inputs(bare, 5, range(WIDTH)), aid.sensor.transmitter_at(aid.time) == 2
    other = fly_inputs(bare, replace(inputs, aided=(np.where(out[:, None, None], np.nan, inputs.aided[0]),)), WIDTH)
    for name in ("error", "sigma"):
        np.testing.assert_array_equal(getattr(run, name)[:, 1:][:, after], getattr(other, name)[:, 1:][:, after])
