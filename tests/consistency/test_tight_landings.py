"""Landings of the tightly coupled filter: against the loose one, the covariance analysis and themselves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numba import typeof

from navsim.filter import states
from navsim.filter.measurement_kinds import FIX, RANGE, FixTable, Measurements, RangeTable
from navsim.filter.records import NOT_USED, REJECTED, USED
from navsim.integrity.monitoring import ALARM
from navsim.landing.result import result
from navsim.landing.study import Case, covariance_analysis, fly_all
from navsim.runner.executor import threads
from navsim.simulation.measurement_tables import table_of_ranges
from navsim.simulation.run import Run
from navsim.statistics import chi_square
from tests.helpers import case, in_brief

SEED = 907
SHORT = ("filter.coupling=tight", "duration_s=35", "receiver.rate_hz=2")


def flown(ready: Case, runs: int, seed: int = SEED) -> Run:
    """Runs along a first axis."""
    parts = list(ready.fly_runs(seed, 0, runs))
    return Run(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in Run.__dataclass_fields__})


def band(runs: int) -> tuple[float, float]:
    """99.99 % band of the mean NEES/6 of runs."""
    return tuple(chi_square.quantile(p, 6 * runs) / (6 * runs) for p in (5e-5, 1.0 - 5e-5))


def one_fix() -> FixTable:
    return FixTable(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 6, 6)), np.zeros(3))


def ranges() -> RangeTable:
    """The ranges of a landing."""
    flight = case(*SHORT).flight
    signals = flight.shared.signals
    return table_of_ranges(flight, signals.range, np.zeros(signals.range.shape))


def silence(*kept: str, begin: float, end: float) -> str:
    names = case("duration_s=5").shared.signals.names
    event = {"what": "silence", "sources": [n for n in names if n not in kept], "at_s": begin, "until_s": end}
    return f"events={json.dumps([event])}"


def test_ranges_are_of_the_types_that_no_ranges_are_of() -> None:
    """A filter of fixes is compiled with an empty table of ranges; the same machine code flies ranges."""
    loose, tight = (Measurements.of({kind: table}) for kind, table in ((FIX, one_fix()), (RANGE, ranges())))
    assert typeof(loose) == typeof(tight)


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("sky.source=nominal", "receiver.lever_arm_m=[1, 0.5, -0.7]", "receiver.latency_s=0.253"),
        ("pseudolites.clock=own", "receiver.smoothing_s=20"),
        ("sky.source=nominal", "signals.ephemeris={}", "receiver.smoothing_s=20", "altimeter.sigma_m=1.0"),
        (
            "radio_altimeter={sigma_floor_m: 0.3, latency_s: 0.1}",
            "barometric_altimeter={sigma_m: 0.8, lag_s: 0.3}",
            "runway.geoid_undulation_m=15.5",
        ),
        ("filter.clock.h0=2e-18", "filter.clock.h_minus2=2e-19", silence("R01", "R07", begin=12, end=30)),
    ],
    ids=[
        "as shipped",
        "late, lever arm, two systems",
        "own clock, smoothed",
        "messages",
        "altimeters",
        "another clock",
    ],
)
def test_covariance_analysis_tells_what_runs_show(settings: tuple[str, ...]) -> None:
    """RMS over 96 runs at some times against the analysis, whatever the filter believes: 4 standard errors of each of
    the numbers of position, velocity and clock; its innovations as expected."""
    runs = 96
    ready = case("filter.kind=eskf", "initial_errors.attitude_deg=0.5", *SHORT, *settings)
    analysis = covariance_analysis(ready)
    expected = analysis.variance.sum(axis=0) + analysis.mean**2
    errors = flown(ready, runs).error
    followed = [*range(states.ATT), *range(15, errors.shape[2])]
    for when in (5, 20, 45, 60):
        square = np.mean(errors[:, when, followed] ** 2, axis=0)
        assert np.all(np.abs(square / expected[when, followed] - 1.0) < 4.0 * np.sqrt(2.0 / runs)), when
    clock = analysis.sources.index("receiver_clock")
    assert analysis.variance[clock, 0, -1] == pytest.approx(1e4)


def test_a_filter_that_believes_what_is_true_expects_its_innovations() -> None:
    ready = case("filter.kind=eskf", *SHORT, "sky.source=nominal", "receiver.lever_arm_m=[1, 0.5, -0.7]")
    analysis = covariance_analysis(ready)
    np.testing.assert_allclose(analysis.nis / analysis.degrees, 1.0, atol=2e-3)
    believed = np.diagonal(analysis.assumed, axis1=1, axis2=2)
    np.testing.assert_allclose(believed[1:], analysis.variance.sum(axis=0)[1:], rtol=0.01)


def test_three_sources_bound_what_loose_coupling_loses() -> None:
    """Two satellites and a pseudolite left from 20 s on: NEES/6 within the band of its mean at each of some
    times, errors a third of those of the loose filter, which drifts as if nothing were left."""
    runs = 64
    event = silence("R01", "R07", "PL1", begin=20, end=40)
    nothing = silence(begin=20, end=40)
    settings = ("duration_s=40", "receiver.rate_hz=2", "filter.kind=gaussian-sum")
    tight, loose, blind = (
        flown(case(*settings, f"filter.coupling={coupling}", events), runs)
        for coupling, events in (("tight", event), ("loose", event), ("loose", nothing))
    )
    np.testing.assert_array_equal(loose.error, blind.error)
    low, high = band(runs)
    for when in (45, 60, 79):
        assert low < tight.nees_position_velocity[:, when].mean() / 6 < high
    size = [np.sqrt(np.mean(np.sum(one.error[:, -2, :2] ** 2, axis=1))) for one in (tight, loose)]
    assert size[0] < size[1] / 3.0
    assert np.all(tight.degrees[:, 45:79] == 6)
    np.testing.assert_array_equal(tight.status[:, 45:79], USED)
    np.testing.assert_array_equal(loose.status[:, 45:79], NOT_USED)


def test_without_a_source_sigma_is_that_of_the_inertial_sensors() -> None:
    """No source for the last 20 s: the clock does nothing to position, velocity, attitude; the statuses say so."""
    runs = 16
    events = silence(begin=20, end=50)
    settings = ("duration_s=40", "receiver.rate_hz=2", "filter.kind=eskf", events)
    tight = flown(case("filter.coupling=tight", *settings), runs)
    ready = case("filter.coupling=tight", "method=covariance", *settings)
    analysis = covariance_analysis(ready)
    np.testing.assert_array_equal(tight.status[:, 40:], NOT_USED)
    free = np.sqrt(np.diagonal(analysis.assumed[-1])[:6])
    np.testing.assert_allclose(np.sqrt(np.mean(tight.sigma[:, -1, :6] ** 2, axis=0)), free, rtol=0.1)
    grown = np.sqrt(np.diagonal(analysis.covariance[-1])[:6])
    np.testing.assert_allclose(free, grown, rtol=0.1)


def test_a_faulty_source_is_gated_alone() -> None:
    """A step of 100 m on one satellite: it is rejected, the others stay in use; after `max_rejected` it is taken."""
    event = json.dumps([{"what": "step", "sources": ["R07"], "at_s": 10, "until_s": 20, "error_m": 100.0}])
    runs = 8
    ready = case(*SHORT, f"events={event}", "filter.gate.max_rejected=100", "filter.kind=eskf")
    one = flown(ready, runs)
    names = ready.shared.signals.names
    at = slice(20, 38)
    which = names.index("R07")
    np.testing.assert_array_equal(one.range_status[:, at, which], REJECTED)
    others = one.range_status[:, at, [i for i, n in enumerate(names) if n != "R07"]]
    assert np.all(others != REJECTED)
    np.testing.assert_array_equal(one.status[:, at], USED)
    assert np.abs(one.error[:, at, :3]).max() < 5.0
    soon = flown(case(*SHORT, f"events={event}", "filter.gate.max_rejected=3", "filter.kind=eskf"), 1)
    assert (soon.range_status[0, at, which] == USED).sum() > 2


@pytest.mark.parametrize("kind", ["eskf", "gaussian-sum"])
def test_a_clock_that_jumps_is_forgotten(kind: str) -> None:
    """All ranges off alike by a kilometre, and the rates by 20 m/s: they are rejected once, then the clock is known
    anew; position and velocity are as if nothing had happened."""
    event = json.dumps([{"what": "spoof", "sources": ["all"], "at_s": 20, "clock_m": 1000.0, "drift_m_s": 20.0}])
    runs = 32
    settings = (*SHORT, f"filter.kind={kind}", "sky.source=nominal")
    calm, jumped = flown(case(*settings), runs), flown(case(*settings, f"events={event}"), runs)
    assert np.abs(jumped.error[:, 45:, :3] - calm.error[:, 45:, :3]).max() < 0.5
    low, high = band(runs)
    assert low < jumped.nees_position_velocity[:, 60].mean() / 6 < high
    first = 39  # the epoch at 20 s
    assert np.all(jumped.status[:, first] == REJECTED)
    assert np.all(jumped.status[:, first + 1 :] == USED)
    assert np.all(jumped.range_status[:, first + 1 :] != REJECTED)


def test_what_is_excluded_is_not_weighed() -> None:
    """A step that the gate would let in: the monitor excludes the satellite, and the tight filter does without it."""
    event = json.dumps([{"what": "step", "sources": ["R07"], "at_s": 20, "until_s": 60, "error_m": 120.0}])
    watched = ("integrity={method: chi2, exclusion: residual, on_alarm: drop}", "filter.gate.probability=0")
    settings = (*SHORT, "filter.kind=eskf", f"events={event}", "signals.range_sigma_m=1")
    excluded, taken = flown(case(*settings, *watched), 8), flown(case(*settings, watched[1]), 8)
    which = case(*SHORT).shared.signals.names.index("R07")
    at = slice(42, 68)
    assert (excluded.range_status[:, at, which] == NOT_USED).mean() > 0.95
    assert (taken.range_status[:, at, which] == USED).all()
    sizes = [np.sqrt(np.mean(np.sum(one.error[:, 45:, :3] ** 2, axis=2))) for one in (excluded, taken)]
    assert sizes[0] < 0.1 * sizes[1]


@pytest.mark.parametrize("sky", ["nominal-glonass", "nominal"])
@pytest.mark.parametrize("runs", [1, 2])
def test_figures_have_the_clock(sky: str, runs: int, tmp_path: Path) -> None:
    ready = case(*SHORT, f"sky.source={sky}")
    made = result(ready, fly_all(ready, SEED, 0, runs, threads(), keep="all"), SEED, keep="all")
    from navsim.report.figures import errors

    labels = [axis.get_ylabel() for figure in errors(made).values() for axis in figure.axes if axis.axison]
    scales = ["glonass"] if sky == "nominal-glonass" else ["glonass", "gps"]
    assert [label for label in labels if label.startswith("clock")] == [
        *(f"clock bias {scale}, m" for scale in scales), "clock drift, m/s",
    ]  # fmt: skip
    assert len(labels) == 15 + len(scales) + 1


@pytest.mark.parametrize("coupling", in_brief(["loose", "tight"], 1))
def test_innovations_see_a_spoofer_whom_no_fix_shows(coupling: str) -> None:
    """All satellites spoofed up by 2 m/s: no more alarms of single fixes than by chance, but of the innovations;
    without a spoofer those are as rare as they ought to be."""
    event = json.dumps([{"what": "spoof", "sources": ["glonass"], "at_s": 15, "rate_ned_m_s": [0, 0, -2]}])
    watched = "integrity={method: chi2, p_fa: 1.0e-3, innovations: {window_s: 5, p_fa: 1.0e-3}}"
    settings = ("duration_s=35", "receiver.rate_hz=2", "filter.kind=gaussian-sum", f"filter.coupling={coupling}")
    honest = flown(case(*settings, watched), 64)
    share = (honest.innovation_ratio > 1.0).mean()
    assert share < 8e-3  # windows of ten epochs go together
    spoofed = flown(case(*settings, watched, f"events={event}"), 16)
    late = slice(50, None)
    assert (spoofed.innovation_ratio[:, late] > 1.0).mean() > 0.9
    assert (spoofed.monitor_status[:, late] == ALARM).mean() > 0.9
    alone = flown(case(*settings, "integrity={method: chi2, p_fa: 1.0e-3}", f"events={event}"), 16)
    assert (alone.monitor_status[:, late] == ALARM).mean() < 0.02
    assert alone.innovation_ratio.size == 0
    made = case(*settings, watched)
    ensemble = fly_all(made, SEED, 0, 2, threads(), keep="errors")
    told = result(made, ensemble, SEED, keep="errors")
    assert told["/integrity/innovation_ratio"].shape == (2, 70)
    assert told["/summary/integrity/innovation_share"].shape == (3,)


def test_findings_and_results_of_ranges() -> None:
    """A stretch without any range is told; the result has the statuses and names of the states."""
    ready = case(*SHORT, silence(begin=20, end=25))
    ensemble = fly_all(ready, SEED, 0, 2, threads(), keep="all")
    made = result(ready, ensemble, SEED, keep="all")
    assert made["/filter/range_status"].shape == (2, ready.shared.signals.time.size, len(ready.shared.signals.names))
    assert list(made["/filter/state"])[15:] == ["clock_bias_glonass", "clock_drift"]
    assert "epochs_without_range" in list(made["/findings/finding"])
    assert "epochs_without_fix" not in list(made["/findings/finding"])


@pytest.mark.parametrize("kind", in_brief(["rts", "map"], 1))
def test_smoothers_take_ranges(kind: str) -> None:
    """Smoothed errors are those that the smoother believes in, and smaller than the filter's."""
    runs = 32
    smooth = flown(case(*SHORT, f"filter.kind={kind}", "initial_errors.attitude_deg=0.5"), runs)
    filtered = flown(case(*SHORT, "filter.kind=eskf", "initial_errors.attitude_deg=0.5"), runs)
    low, high = band(runs)
    for when in (20, 40, 60):
        assert low < smooth.nees_position_velocity[:, when].mean() / 6 < high
    sizes = [np.mean(one.error[:, 10:40, :3] ** 2) for one in (smooth, filtered)]
    assert sizes[0] < 0.7 * sizes[1]


def same_alone(ready: Case, together: Run, runs: tuple[int, ...], seed: int = SEED) -> None:
    for run in runs:
        (alone,) = ready.fly_runs(seed, run, 1)
        for name in Run.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(together, name)[run], err_msg=name)


@pytest.mark.parametrize("kind", ["eskf", "tfg", "gaussian-sum"])
def test_epochs_between_samples_of_the_imu(kind: str) -> None:
    """Seven fixes a second cut intervals of the IMU: components of a sum keep their places within an epoch. NEES/6 lies
    in the band of its mean, and runs are what they are alone."""
    runs = 12
    ready = case("filter.coupling=tight", "duration_s=20", "receiver.rate_hz=7", f"filter.kind={kind}")
    found = flown(ready, runs)
    same_alone(ready, found, (0, 5, 11))
    low, high = band(runs)
    for when in (69, 104, 139):
        assert low < found.nees_position_velocity[:, when].mean() / 6 < high


@pytest.mark.parametrize("kind", ["eskf", "left-invariant", "tfg", "gaussian-sum"])
def test_a_near_range_that_some_runs_reject(kind: str) -> None:
    """A pseudolite 150 m away, its first ranges 60 m too long, the position known to 150 m before: bent in all runs, it
    is rejected in some. Runs are what they are alone, and truer than their sigma says by nothing but the fault."""
    runs = 12
    ready = case(
        "filter.coupling=tight", "duration_s=5", "receiver.rate_hz=2", "filter.velocity=false", f"filter.kind={kind}",
        "initial_errors.position_m=150", "pseudolites={sites: [{s_m: 60, l1_m: 1650}]}",
        'events=[{what: step, sources: [PL1], at_s: 0, until_s: 2, error_m: 60}]', "filter.gate.max_rejected=100",
    )  # fmt: skip
    found = flown(ready, runs)
    first = found.range_status[:, 0, list(ready.shared.signals.names).index("PL1")]
    assert set(first) == {USED, REJECTED}
    same_alone(ready, found, (0, 3, 11))
    spared = first == REJECTED
    assert (found.nees_position_velocity[spared, -1] / 6).mean() < band(int(spared.sum()))[1]
