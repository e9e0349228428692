"""Solution separation of filters: against filters that are really given less, and against what runs show."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from navsim.compiler.lanes import WIDTH
from navsim.integrity import monitoring
from navsim.integrity.monitoring import ALARM, NO_FIX, QUIET
from navsim.landing import integrity
from navsim.landing.study import Case
from navsim.results.builder import ResultBuilder
from navsim.results.schema import COVARIANCE
from navsim.scenario_files.source import InputError
from navsim.simulation import landing as simulation
from navsim.simulation.filter_bank import LEAST, FilterBank
from navsim.simulation.flight import Flight
from navsim.simulation.landing import fly_inputs
from navsim.simulation.run_inputs import draw_inputs
from navsim.statistics import chi_square
from tests.consistency.test_tight_landings import flown, silence
from tests.helpers import case, in_brief

FILTER = "integrity={method: filter, p_constellation: 1.0e-8}"
SHORT = ("duration_s=25", "receiver.rate_hz=2", "filter.kind=eskf")
SETTINGS = [
    (),
    ("filter.coupling=tight",),
    ("sky.source=nominal", "receiver.lever_arm_m=[1, 0.5, -0.7]", "receiver.latency_s=0.253", "altimeter.sigma_m=1.0"),
    ("filter.coupling=tight", "receiver.latency_s=0.253", "altimeter.sigma_m=1.0", "filter.fix_sigma_scale=1.5"),
    ("filter.kind=gaussian-sum", "filter.velocity=false"),
    ("filter.kind=left-invariant",),
]
NAMES = [
    "as shipped",
    "tight",
    "late, lever arm, two systems, altimeter",
    "tight, late, altimeter",
    "sum, positions",
    "left-invariant",
]
AXES = (1, 0, 2)
"""North, east, down by east, north, up."""


def bank_of(c: Case) -> FilterBank:
    assert isinstance(c.flight.bank, FilterBank)
    return c.flight.bank


def weighed(c: Case, seed: int, runs: range, patch: pytest.MonkeyPatch) -> tuple[Any, ...]:
    """What the bank is asked about runs, at most a register full."""
    asked: list[tuple[Any, ...]] = []
    with patch.context() as here:
        here.setattr(
            FilterBank,
            "statistic",
            lambda _, *given: (asked.append(given), np.zeros((c.shared.signals.time.size, WIDTH)))[1],
        )
        fly_inputs(c.flight, draw_inputs(c.flight, seed, runs), len(runs))
    return asked[0]


def differences(bank: FilterBank, given: tuple[Any, ...], k: int, patch: pytest.MonkeyPatch) -> np.ndarray:
    """Sizes of the differences (3, e, W) of filter k, north, east, down: of a bank of that filter alone."""
    alone = replace(bank, taken=bank.taken[[k]], gains=np.ascontiguousarray(bank.gains[:, [k]]))
    fixes = alone._separations(*given[1:]) if (bank.fix >= 0).any() else None
    with patch.context() as here:
        here.setattr(FilterBank, "_separations", lambda *_: fixes)
        scales = np.eye(3)[:, None, None] * (np.arange(bank.scale.shape[0]) > 0)[:, None, None]
        return np.array([replace(alone, scale=np.ascontiguousarray(scale)).statistic(*given) for scale in scales])


@pytest.mark.parametrize("settings", in_brief(SETTINGS, 1, 2, 4, whole=True), ids=NAMES)
def test_differences_are_those_of_filters_that_are_given_less(
    settings: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The true bank, every filter flown by itself, in twenty-four runs: differences to a few hundredths of their sigma,
    the same alarms at 99 % of the epochs of thresholds of 2 sigma."""
    c = case(*SHORT, FILTER, *settings)
    bank, bare = bank_of(c), replace(c.flight, watching=None)
    monitored = np.flatnonzero(bank.found.monitored.any(axis=1) & [not f.of for f in c.flight.expected])
    off, same = [], []
    for first in range(0, 24, WIDTH):
        runs = range(first, first + WIDTH)
        given, inputs = weighed(c, 78, runs, monkeypatch), draw_inputs(bare, 78, runs)
        whole = fly_inputs(bare, inputs, WIDTH)
        for k in monitored:
            less = replace(inputs, ranges=np.where(bank.taken[k][None, :, None], np.nan, inputs.ranges))
            apart = np.abs(whole.error - fly_inputs(bare, less, WIDTH).error)[:, 1:, :3]
            for axis, size in enumerate(differences(bank, given, k, monkeypatch)):
                sigma = bank.found.spread.separation_sigma[k][:, AXES[axis]]
                ours = size.T / sigma
                off.append(np.sqrt(np.mean((ours - apart[..., axis] / sigma) ** 2)))
                same.append(np.mean((ours > 2.0) == (apart[..., axis] / sigma > 2.0)))
    assert np.median(off) < 0.08
    assert np.mean(same) > 0.99


@pytest.mark.parametrize("settings", in_brief(SETTINGS, 0, 3, 4, whole=True), ids=NAMES)
def test_differences_are_as_large_as_their_sigma_says(
    settings: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At epochs far apart, of 160 runs: the mean square of each fault's differences within 99.998 % of chance, and of
    all together within 5 % of sigma."""
    c = case(*SHORT, FILTER, *settings)
    bank = bank_of(c)
    scale = c.design.sigma_scale
    epochs = np.arange(9, c.shared.signals.time.size, 10)
    monitored = np.flatnonzero(bank.found.monitored.all(axis=1))
    runs = 160
    squares = np.zeros((monitored.size, 3, epochs.size))
    spread = bank.found.spread
    counted = (spread.separation_sigma > 1.01 * LEAST * spread.separate_sigma)[monitored][:, epochs][
        ..., AXES
    ].swapaxes(1, 2)
    for first in range(0, runs, WIDTH):
        given = weighed(c, 85, range(first, first + WIDTH), monkeypatch)
        for i, k in enumerate(monitored):
            for axis, size in enumerate(differences(bank, given, k, monkeypatch)):
                sigma = bank.found.spread.separation_sigma[k][epochs, AXES[axis]] / scale
                squares[i, axis] += np.sum((size[epochs] / sigma[:, None]) ** 2, axis=1)
    low, high = (chi_square.quantile(p, runs) / runs for p in (1e-5, 1.0 - 1e-5))
    if scale == 1.0:
        assert counted.mean() > 0.8
        assert np.all((squares[counted] / runs > low) & (squares[counted] / runs < high))
        assert np.all(squares / runs < high)
        assert np.sqrt(squares[counted].mean() / runs) == pytest.approx(1.0, abs=0.05)
    else:  # sigmas that are believed too large are the differences', too, but not in proportion
        assert 0.6 < np.sqrt(squares[counted].mean() / runs) < 1.5


@pytest.mark.parametrize("settings", in_brief(SETTINGS, 2, 3, whole=True), ids=NAMES)
def test_the_statistic_is_the_largest_difference(settings: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    c = case(*SHORT, FILTER, *settings)
    bank = bank_of(c)
    given = weighed(c, 86, range(WIDTH), monkeypatch)
    each = [
        np.max(differences(bank, given, k, monkeypatch) * bank.scale[1:, k].T[..., None], axis=0)
        for k in range(len(bank.taken))
    ]
    np.testing.assert_allclose(bank.statistic(*given), np.max(each, axis=0), rtol=1e-12)


def test_tight_filters_differ_by_the_difference_of_their_covariances() -> None:
    """The excess of one variance in the other is of fixes alone, whose velocities come after their positions."""
    spread = bank_of(case(*SHORT, FILTER, "filter.coupling=tight")).found.spread
    plain = spread.separate_sigma**2 - spread.sigma**2
    np.testing.assert_allclose(
        spread.separation_sigma**2, np.maximum(plain, (LEAST * spread.separate_sigma) ** 2), rtol=1e-9
    )
    spread = bank_of(case(*SHORT, FILTER)).found.spread
    gap = np.abs(spread.separation_sigma**2 - (spread.separate_sigma**2 - spread.sigma**2)) / spread.separate_sigma**2
    assert 0.003 < gap.max() < 0.1


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_false_alarms_are_as_rare_as_asked(coupling: str) -> None:
    """The share that is asked for is no less than what comes, since the tests of faults go together."""
    wanted = "integrity={method: filter, p_constellation: 1.0e-8, p_fa_v: 1.0e-2, p_fa_h: 1.0e-2}"
    c = case(*SHORT, wanted, f"filter.coupling={coupling}")
    run = flown(c, 400, seed=81)
    share = float(np.mean(run.monitor_status == ALARM))
    assert 1e-3 < share < 2e-2
    # at one epoch runs are independent of each other
    late = int(np.sum(run.monitor_status[:, -1] == ALARM))
    assert late <= binom.ppf(0.9999, 400, 2e-2)


def test_nobody_is_touched_by_being_watched() -> None:
    plain, watched = (simulation.fly(case(*SHORT, *more).flight, 2, [4]).one(0) for more in ((), (FILTER,)))
    for name in ("fix_llh", "error", "sigma", "nees", "status", "innovation_squared"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(watched, name))
    off = np.abs(watched.error[1:, :3])
    np.testing.assert_allclose(watched.watched_error, np.stack([np.hypot(off[:, 0], off[:, 1]), off[:, 2]], axis=1))


@pytest.mark.parametrize("settings", in_brief(SETTINGS, 2, 4, whole=True), ids=NAMES)
def test_a_run_does_not_depend_on_its_neighbours(settings: tuple[str, ...]) -> None:
    c = case(*SHORT, FILTER, *settings)
    together = simulation.fly(c.flight, 5, range(WIDTH - 1))
    alone = simulation.fly(c.flight, 5, [2]).one(0)
    np.testing.assert_array_equal(together.one(2).monitor_statistic, alone.monitor_statistic)


def test_a_step_on_a_source_is_seen_sooner_than_by_fixes() -> None:
    """Filters average: a step that the ranges of an epoch do not show is seen after some, with levels below a half."""
    limits = "limits: {hal_m: 40, val_m: 60, tta_s: 6}"
    event = "events=[{what: step, sources: [R01], error_m: 18, at_s: 10}]"
    cases = [
        case(*SHORT, event, f"integrity={{method: {method}, p_constellation: 1.0e-8, {limits}}}")
        for method in ("filter", "mhss")
    ]
    seen = [float(np.mean(flown(c, 40).monitor_status[:, 25:] == ALARM)) for c in cases]
    assert seen[0] > 0.9
    assert seen[1] < 0.2
    heights = [integrity.level_outputs(c)["vpl_p95"] for c in cases]
    assert heights[0] < 0.5 * heights[1]


def bound(c: Case, runs: int, seed: int) -> np.ndarray:
    """Shares of epochs, east and north together, up, at which errors are beyond levels and there is no alarm."""
    bank, run = bank_of(c), flown(c, runs, seed)
    beyond = (run.watched_error > bank.levels) & (run.monitor_status != ALARM)[..., None]
    return beyond.mean(axis=(0, 1))


@pytest.mark.parametrize("source", in_brief(["R01", pytest.param("R08", marks=pytest.mark.long), "PL1", "none"], 0))
def test_levels_bound_errors_at_budgets_that_can_be_counted(source: str) -> None:
    """With p_HMI and priors at 1e-2: a fault that is always there may cause at most p_HMI by its prior."""
    chances = "p_hmi_v: 1.0e-3, p_hmi_h: 1.0e-3, p_fa_v: 1.0e-3, p_fa_h: 1.0e-3, p_unmonitored_max: 1.0e-3"
    priors = "p_satellite: 1.0e-2, p_pseudolite: 1.0e-2, p_constellation: 0, ground_groups: []"
    wanted = f"integrity={{method: filter, {chances}, {priors}, b_nom_m: 0, b_nom_pseudolite_m: 0}}"
    for size in (2.0, 4.0, 8.0) if source != "none" else (0.0,):
        what = {"what": "step", "sources": [source], "error_m": size, "at_s": 0.0}
        c = case(*SHORT, wanted, *([f"events={json.dumps([what])}"] if source != "none" else []))
        # a fault that is there has 1 / prior of the budget
        allowed = 1e-3 if source == "none" else 1e-3 / 1e-2
        assert np.all(bound(c, 200 if source == "none" else 104, 83) <= allowed)


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_who_loses_everything_says_so(coupling: str) -> None:
    """Nothing is received any more: an alert at once, nothing available, levels and sigma grow as the inertial sensors
    drift, and no number that looks fine."""
    limits = "limits: {hal_m: 40, val_m: 60, tta_s: 6}"
    c = case(
        "duration_s=60", "receiver.rate_hz=2", "filter.kind=eskf", f"filter.coupling={coupling}",
        silence(begin=40, end=90),
        f"integrity={{method: filter, p_constellation: 1.0e-8, {limits}}}",
    )  # fmt: skip
    run = flown(c, 64)
    lost = c.shared.signals.time >= 40.0
    assert np.all(run.monitor_status[:, lost] == NO_FIX)
    assert np.all(run.monitor_status[:, ~lost] == QUIET)
    counts = integrity.count_epochs(c, run)
    assert np.all(counts["integrity_lost"] == lost.sum())
    assert np.all(counts["integrity_available"] <= (~lost & integrity.glide_of(c)).sum())
    assert not counts["integrity_misled"].any()
    level = bank_of(c).levels[lost]
    assert np.all(np.diff(level[:, 0]) > 0.0)
    assert level[-1, 0] > 2.0 * level[0, 0]
    # sigma is that of the free inertial: the covariance analysis of the same flight, and what runs show
    sigma = run.sigma[0, 1:, :3][lost]
    spread = np.sqrt(np.mean(run.error[:, 1:, :3] ** 2, axis=0))[lost]
    assert np.sqrt(np.mean((spread[-1] / sigma[-1]) ** 2)) == pytest.approx(1.0, abs=0.2)
    np.testing.assert_allclose(np.sqrt(spread_of(c)[lost]), sigma, rtol=0.1)


def spread_of(c: Case) -> np.ndarray:
    """Variances of position (e, 3) north, east, down as the bank has them."""
    return bank_of(c).found.spread.sigma[:, AXES] ** 2


def test_levels_without_runs() -> None:
    c = case(*SHORT, FILTER, "method=covariance")
    draft = ResultBuilder(COVARIANCE)
    integrity.write_levels(draft, c)
    assert list(draft["/integrity/fault"]) == [fault.name for fault in c.flight.expected]
    assert float(draft["/summary/integrity/level_share"]) == 1.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("exclusion: rms", "integrity.exclusion"),
        ("on_alarm: drop", "integrity.on_alarm"),
        ("tails: {at_s: [5]}", "integrity.tails"),
        ("sigma_ratio_acc: 0.5", "integrity.sigma_ratio_acc"),
    ],
)
def test_what_is_of_fixes_alone_is_refused(wrong: str, said: str) -> None:
    with pytest.raises(InputError, match=f"{said}: must be .* with method filter"):
        case(*SHORT, f"integrity={{method: filter, {wrong}}}")


def test_smoothers_are_refused() -> None:
    with pytest.raises(InputError, match="is for a filter, rts is a smoother"):
        case("duration_s=25", FILTER, "filter.kind=rts")


@pytest.mark.parametrize(
    "what",
    in_brief(
        [
            {"what": "step", "sources": ["R01"], "error_m": 20, "at_s": 0},
            {"what": "step", "sources": ["R01"], "error_m": 3000, "at_s": 10},
            {"what": "ramp", "sources": ["PL1"], "rate_m_s": 50, "at_s": 5},
            {
                "what": "meacon",
                "sources": ["R01"],
                "place": {"lat_deg": 56.02, "lon_deg": 37.0},
                "delay_m": 300,
                "at_s": 5,
            },
            {"what": "spoof", "sources": ["glonass"], "rate_ned_m_s": [0, 0, -2], "at_s": 10},
            {"what": "survey", "sources": ["PL1"], "ned_m": [200, 0, 0]},
        ],
        0,
        1,
        2,
    ),
    ids=lambda what: f"{what['what']} {what.get('error_m', '')}",
)
def test_levels_know_nothing_of_the_fault(what: dict[str, Any]) -> None:
    there = case(*SHORT, FILTER, f"events={json.dumps([what])}")
    np.testing.assert_array_equal(bank_of(there).levels, bank_of(case(*SHORT, FILTER)).levels)
    assert np.isfinite(flown(there, 2).monitor_statistic).all()


def test_whom_nothing_can_befall_has_levels() -> None:
    """No fault of any probability, and none of a source that is heard."""
    none = "p_satellite: 0, p_constellation: 0, p_pseudolite: 0, ground_groups: []"
    assert np.isfinite(bank_of(case(*SHORT, f"integrity={{method: filter, {none}}}")).levels).all()
    silent = case(*SHORT, FILTER, silence(begin=0, end=90))
    assert np.all(flown(silent, 2).monitor_status == NO_FIX)


def test_two_pseudolites_that_are_no_fix_are_nothing_to_a_loose_filter() -> None:
    """Without a fix there is an alert, whatever is received; a tightly coupled filter takes what there is."""
    said = []
    for coupling in ("loose", "tight"):
        c = case(*SHORT, FILTER, f"filter.coupling={coupling}", silence("PL1", "PL2", begin=10, end=90))
        status = flown(c, 8).monitor_status[:, c.shared.signals.time >= 10.0]
        said.append(np.unique(status).tolist())
    assert said == [[NO_FIX], [QUIET]]


def test_levels_rise_with_priors_however_small_the_budget() -> None:
    """A fault is left out where half of the budget has room for it, else it is monitored by the inertial sensors."""
    small = "p_hmi_v: 1.0e-9, p_hmi_h: 1.0e-9, p_satellite: 1.0e-7, p_pseudolite: 1.0e-7"
    last = [
        bank_of(case(*SHORT, f"integrity={{method: filter, p_constellation: {p}, {small}}}")).levels[-1]
        for p in ("1.0e-10", "1.0e-8", "1.0e-7")
    ]
    assert np.all(np.diff(last, axis=0) > 0.0)
    (told,) = integrity.level_warnings(case(*SHORT, "integrity={method: filter}"))
    assert told.startswith("integrity: without glonass 0.0001")


def test_a_filter_that_coasts_behind_its_gate_is_no_silence() -> None:
    """All satellites spoofed up by 300 m: the gate rejects the fixes for good, the filter knows less and less, and its
    levels, which count on them, are worth nothing: an alarm."""
    event = {"what": "spoof", "sources": ["glonass"], "offset_ned_m": [0, 0, -300], "at_s": 8}
    c = case(*SHORT, FILTER, f"events={json.dumps([event])}", "filter.gate.max_rejected=1000")
    run = flown(c, 16)
    rejected = (run.status == 2) & (c.shared.signals.time > 12.0)
    assert rejected[:, -20:].mean() > 0.9
    assert np.mean(run.monitor_status[:, -10:] == ALARM) > 0.9


@pytest.mark.parametrize("method", ["filter", "mhss"])
def test_availability_without_runs_is_that_of_runs(method: str) -> None:
    """Epochs without a source are not available, however low the level."""
    limits = "limits: {hal_m: 60, val_m: 90, tta_s: 6}"
    wanted = f"integrity={{method: {method}, p_constellation: 1.0e-8, {limits}}}"
    c = case("duration_s=40", "receiver.rate_hz=2", "filter.kind=eskf", wanted, silence(begin=20, end=90))
    asked = integrity.approach_limits(c)
    assert asked is not None
    assert c.flight.monitor is not None
    by_levels = integrity.below_limits(asked, monitoring.tested_levels(c.flight.monitor)).all(axis=1)[asked.glide].sum()
    np.testing.assert_array_equal(integrity.count_epochs(c, flown(c, 4))["integrity_available"], by_levels)


def test_smoothed_ranges_are_refused() -> None:
    with pytest.raises(InputError, match="smoothing_s: smoothed ranges are correlated"):
        case(*SHORT, FILTER, "receiver.smoothing_s=10")


def test_a_flight_that_nobody_watches_has_no_bank() -> None:
    flight: Flight = case(*SHORT).flight
    assert flight.bank is None
    with pytest.raises(ValueError, match="shares"):
        FilterBank.of(flight)


@pytest.mark.parametrize("heading", [0.0, 37.0, 90.0])
def test_levels_in_axes_of_the_runway(heading: float) -> None:
    """East and north are the axes of runways that lie so; in between levels are no smaller than the spread there."""
    c = case(*SHORT, FILTER, "filter.coupling=tight", "pseudolites={}")
    bank, radians = bank_of(c), np.radians(heading)
    found = bank.along(radians)
    if heading != 37.0:
        turned = [0, 1] if heading == 0.0 else [1, 0]
        np.testing.assert_allclose(found, bank.found.level[:, turned], rtol=1e-6)
        return
    right = np.array([np.cos(radians), -np.sin(radians)])
    whole = bank.solutions[0]
    sigma = np.sqrt(np.einsum("i,eij,j->e", right, whole.covariance[:, :2, :2], right))
    bias = np.abs(np.einsum("i,eis->es", right, whole.reach[:, :2])).sum(axis=1)
    assert np.all(found[:, 0] > bias + 5.0 * sigma)
    assert np.all(found <= np.abs(bank.found.level[:, :1]) + np.abs(bank.found.level[:, 1:2]))


def test_a_system_that_is_lost_makes_levels_grow_and_not_jump() -> None:
    """The default prior of a system does not fit into what is tolerated: from 20 s on, when GPS is gone, the filter
    without GLONASS goes on by its inertial sensors, and levels grow with it. That without both has done so from the
    beginning, is off by hundreds of metres, and fits."""
    quiet = json.dumps([{"what": "silence", "sources": ["gps"], "at_s": 20}])
    c = case(*SHORT, "sky.source=nominal", "integrity={method: filter}", f"events={quiet}")
    bank = bank_of(c)
    levels = dict(zip(c.shared.signals.time.tolist(), bank.levels[:, 0].tolist(), strict=True))
    assert levels[20.0] < 1.1 * levels[19.5]
    assert levels[22.0] < 2.0 * levels[19.5]
    assert levels[24.5] > levels[22.0]
    assert (bank.found.unmonitored <= c.flight.watching.test.p_unmonitored).all()
