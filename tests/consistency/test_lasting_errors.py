"""Ranging errors that last: how they are drawn, what fixes and filters make of them, against closed forms and runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.filter import records, states
from navsim.filter.estimate import estimate
from navsim.filter.measurement_kinds import FIX, RANGE, FixTable, Measurements, RangeTable
from navsim.filter.receiver_clock import ReceiverClock
from navsim.geodesy.earth import ecef_from_llh, ned_matrix
from navsim.gnss.correlated_errors import CorrelatedErrors, mapped
from navsim.landing.study import covariance_analysis, fly_all
from navsim.results.result import read
from navsim.runner.executor import threads
from navsim.scenario.estimated_errors import correlated_states
from navsim.scenario_files.source import InputError
from navsim.simulation.flight import exact_start
from navsim.simulation.landing import fly
from navsim.statistics.random_streams import generator
from tests.conftest import SCENARIOS, Within
from tests.helpers import case, cross, in_brief
from tests.layout import as_declared
from tests.product.test_run import navsim

OPEN = "signals={preset: open-sky}"
GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1")
ALONE = ("sky.source=nominal", "signals.range_law=constant", "filter.velocity=false", "receiver.rate_hz=1")
"""Without pseudolites and range rates, and with satellites that are all alike, fixes weigh the same whatever lasts."""
PV = slice(0, 6)


def test_errors_are_gauss_markov_processes_of_each_satellite() -> None:
    """Variance 1, correlation exp(-d / tau) over unequal steps, and none between kinds and sources: 4.5 sigma."""
    time = np.array([0.0, 0.3, 5.0, 40.0])
    errors = CorrelatedErrors(("a", "b"), np.array([4.0, 60.0]), np.ones((2, 4, 3)))
    runs = 4000
    drawn = errors.drawn(time, [generator(5, run, "lasting") for run in range(runs)])
    assert drawn.shape == (2, 4, 3, runs)
    flat = drawn.transpose(0, 2, 1, 3).reshape(-1, runs)
    found = flat @ flat.T / runs
    expected = np.zeros((24, 24))
    for k, tau in enumerate(errors.time):
        for s in range(3):
            here = slice((3 * k + s) * 4, (3 * k + s) * 4 + 4)
            expected[here, here] = np.exp(-np.abs(time[:, None] - time) / tau)
    assert np.abs(found - expected).max() < 4.5 * np.sqrt(2.0 / runs)


def test_errors_grow_towards_the_horizon_as_their_sources_say() -> None:
    """Groves (2013), eqs. 9.79 and 9.80, at 90, 30 and 5 degrees; multipath by its law."""
    elevation = np.radians([90.0, 30.0, 5.0])
    np.testing.assert_array_equal(mapped("none", elevation), 1.0)
    np.testing.assert_allclose(mapped("ionosphere", elevation), [1.0, 1.752, 3.045], rtol=1e-3)
    np.testing.assert_allclose(mapped("troposphere", elevation), [1.0, 1.994, 10.216], rtol=1e-3)
    np.testing.assert_allclose(mapped("multipath", elevation), [1.0013, 1.1303, 1.8917], rtol=1e-3)


def test_presets_give_what_is_left_out() -> None:
    plain = case().scenario.signals
    assert plain.errors.models() == ()
    assert plain.range_sigma_m == pytest.approx(np.sqrt(5.0))
    given = case(OPEN, "signals.errors.ionosphere.sigma_m=3", "signals.errors.multipath=null").scenario.signals
    kinds = {kind.name: kind for kind in given.errors.models()}
    assert list(kinds) == ["orbit_clock", "ionosphere", "troposphere"]
    assert (kinds["ionosphere"].sigma, kinds["ionosphere"].time) == (3.0, 1800.0)
    assert (given.range_sigma_m, given.range_law) == (1.0, "constant")
    assert case(OPEN, "signals.range_sigma_m=0.4").scenario.signals.range_sigma_m == 0.4


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (("filter.fix_errors=states",), "fix_errors"),
        (("filter.coupling=tight", "filter.fix_errors=states"), "fix_errors"),
        ((OPEN, "integrity={method: filter}", "filter.coupling=tight", "filter.fix_errors=states"), "integrity.method"),
        ((OPEN, "integrity={exclusion: residual}"), "fix_errors"),
        ((OPEN, "integrity={method: filter}"), "integrity.method"),
        ((OPEN, "integrity={method: filter}", "filter.fix_errors=none"), "integrity.method"),
        ((OPEN, "integrity={method: filter}", "filter.coupling=tight", "filter.fix_errors=none"), "integrity.method"),
        (("signals.errors.ionosphere={sigma_m: 1}",), "correlation_time_s"),
        (("integrity={method: filter}", "pseudolites.survey_sigma_m=0.1"), "not possible with pseudolites.survey"),
        (("integrity={method: filter}", "pseudolites.clock_noise={h0: 1e-22, h_minus2: 0}"), "pseudolites.clock_n"),
        (("integrity={method: filter}", "filter.coupling=tight", "pseudolites.clock_sigma_ns=1"), "clock_sigma_ns"),
    ],
)
def test_what_cannot_be_is_refused(settings: tuple[str, ...], key: str) -> None:
    with pytest.raises(InputError, match=key):
        case(*settings)


@pytest.mark.validates("errors that last for ever", "constant errors of messages", variance="1e-4")
def test_for_ever_they_are_constant(within: Within) -> None:
    """A correlation time of 30 years does what a constant error of each satellite's clock does."""
    lasting = case(
        *ALONE, "signals.range_sigma_m=1", "pseudolites.count=0",
        "signals.errors.orbit_clock={sigma_m: 1.5, correlation_time_s: 1.0e9}", "filter.fix_errors=none",
    )  # fmt: skip
    # the filter of the other believes what this one's receiver says
    scale = np.hypot(1.0, 1.5)
    constant = case(
        *ALONE, "signals.range_sigma_m=1", "pseudolites.count=0", f"filter.fix_sigma_scale={scale}",
        "signals.ephemeris={orbit_sigma_m: [0, 0, 0], clock_sigma_m: 1.5}",
    )  # fmt: skip
    one, other = covariance_analysis(lasting), covariance_analysis(constant)
    mine = one.variance[one.sources.index("satellite_lasting_orbit_clock")]
    its = other.variance[other.sources.index("satellite_ephemeris")]
    assert its[-1, 0] > 0.5
    np.testing.assert_allclose(mine[1:, PV], its[1:, PV], rtol=within["variance"], atol=1e-9)


@pytest.mark.validates("errors that last for no time", "white noise", variance="1e-9")
def test_for_no_time_they_are_noise(within: Within) -> None:
    short = ("signals.errors.orbit_clock={sigma_m: 1.5, correlation_time_s: 0.001}", "signals.range_sigma_m=1")
    white = covariance_analysis(case(*ALONE, "pseudolites.count=0", f"signals.range_sigma_m={np.hypot(1.0, 1.5)}"))
    for how in ("none", "inflate"):
        analysis = covariance_analysis(case(*ALONE, "pseudolites.count=0", *short, f"filter.fix_errors={how}"))
        np.testing.assert_allclose(
            np.diagonal(analysis.covariance, axis1=1, axis2=2), np.diagonal(white.covariance, axis1=1, axis2=2),
            rtol=within["variance"],
        )  # fmt: skip


@pytest.mark.parametrize("name", in_brief(["landing", "landing_open_sky", "landing_gnss_only", "s_turn"], 1, 3))
def test_a_filter_that_follows_them_is_true(name: str) -> None:
    """To first order: expected NEES of position and velocity within 2 %, pseudolites near or far, where fixes taken for
    white are off by tens; its innovations have the size that it expects."""
    analysis = covariance_analysis(case(OPEN, "receiver.rate_hz=2", name=name))
    square = analysis.expected_square(PV)[4:]
    assert np.abs(square - 1.0).max() < 0.02
    some = analysis.degrees > 0
    assert np.abs(analysis.nis[some] / analysis.degrees[some] - 1.0).max() < 0.02
    told = covariance_analysis(case(OPEN, "receiver.rate_hz=2", "filter.fix_errors=none", name=name))
    assert told.expected_square(PV)[-1] > 5.0


@pytest.mark.parametrize(
    ("name", "setting"),
    [
        ("landing_gnss_only", "events=[{what: silence, sources: [R01], at_s: 60}]"),
        ("s_turn", "receiver.antenna={elevation_deg: [-90, -30, 0, 90], gain_dbi: [-25, -12, -4, 4], mask_deg: 5}"),
    ],
)
def test_it_is_true_where_satellites_are_lost(name: str, setting: str) -> None:
    """Without pseudolites, too; what three sums a group leave there would be 2.3 and 9."""
    square = covariance_analysis(case(OPEN, "receiver.rate_hz=1", setting, name=name)).expected_square(PV)[4:]
    assert np.abs(square - 1.0).max() < 0.02


def test_noise_of_their_size_is_cautious_at_first_and_right_at_last() -> None:
    square = covariance_analysis(case(OPEN, "filter.fix_errors=inflate")).expected_square(PV)
    assert np.all(square[100:] > 0.5)
    assert np.all(square[100:] < 1.15)


TIGHT = (OPEN, "filter.coupling=tight", "receiver.rate_hz=1")


def test_a_tightly_coupled_filter_may_take_ranges_for_noisier() -> None:
    found = covariance_analysis(case(*TIGHT, "filter.fix_errors=inflate")).expected_square(PV)
    assert found[10:].max() < 1.2
    assert covariance_analysis(case(*TIGHT, "filter.fix_errors=none")).expected_square(PV)[-1] > 5.0


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("landing", ("receiver.latency_s=0.3",)),
        ("landing_open_sky", ("sky.systems=[gps, glonass]", "sky.source=nominal")),
        ("landing_gnss_only", ("events=[{what: silence, sources: [R01], at_s: 40, until_s: 60}]", "duration_s=80")),
        ("landing_gnss_only", ("integrity={exclusion: residual}", "duration_s=20")),
        ("s_turn", (
            "receiver.antenna={elevation_deg: [-90, -30, 0, 90], gain_dbi: [-25, -12, -4, 4], mask_deg: 10}",)),
    ],
    ids=["late", "two systems", "silent for a while", "excluded", "masked in turns"],
)  # fmt: skip
def test_a_tightly_coupled_filter_follows_those_of_each_satellite(name: str, settings: tuple[str, ...]) -> None:
    """To first order: expected NEES of position and velocity, of all states and of the innovations within 2 %, also
    where satellites come and go, which six sums for all could not follow (1.4 in the last case)."""
    analysis = covariance_analysis(case(*TIGHT, *settings, name=name))
    for states_ in (PV, slice(None)):
        assert np.abs(analysis.expected_square(states_)[2:] - 1.0).max() < 0.02
    some = analysis.degrees > 0
    assert np.abs(analysis.nis[some] / analysis.degrees[some] - 1.0).max() < 0.02


def test_states_of_ranges_are_those_of_the_satellites_that_are_received() -> None:
    """One a satellite for each group of kinds, none for pseudolites; true values of unit variance, those of a
    satellite by itself: what it adds to its range in the sigmas of its group."""
    flown = case(*TIGHT, "duration_s=120")
    signals, errors = flown.shared.signals, flown.flight.range_errors
    received = [n for n, used in zip(signals.names, signals.used.any(axis=0), strict=True) if used and n[0] != "P"]
    followed = [f"range_error_{speed}_{name}" for speed in ("slow", "fast") for name in received]
    assert [name for name in flown.states if name.startswith("range_error")] == followed
    assert len(flown.groups) == 5
    assert signals.correlated is not None
    drawn = signals.correlated.drawn(signals.time, [generator(5, run, "lasting") for run in range(300)])
    true = np.stack([errors.true_values(drawn[..., run]) for run in range(300)], axis=-1)
    assert np.abs(np.mean(true[-1] ** 2, axis=-1) - 1.0).max() < 4.5 * np.sqrt(2.0 / 300)
    added = np.einsum("kes,kesw->esw", signals.correlated.sigma, drawn)
    group, source = errors.states
    mine = np.zeros_like(added)
    for state, (g, s) in enumerate(zip(group, source, strict=True)):
        mine[:, s] += errors.size[:, s, g, None] * true[:, state]
    np.testing.assert_allclose(mine, added, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    "settings",
    in_brief(
        [("filter.fix_errors=states",), ("filter.fix_errors=inflate",), ("filter.coupling=tight",)], 0, whole=True
    ),
    ids=["states", "inflate", "tight"],
)
def test_runs_are_as_analysed(settings: tuple[str, ...]) -> None:
    """RMS of position and velocity at every 10 s over 300 runs within 17 % of the analysis (4.2 sigma of the sampling;
    the page of theory has 2000 runs), and NEES as it says."""
    flown = case(*GENTLE, OPEN, *settings)
    flights = fly_all(flown, 3, 0, 300, threads())
    analysis = covariance_analysis(flown)
    at = [int(np.argmin(np.abs(flown.shared.filter_time - t))) for t in range(10, 121, 10)]
    predicted = np.sqrt(np.diagonal(analysis.covariance, axis1=1, axis2=2))[at, PV]
    measured = np.sqrt(np.mean(flights["error"][:, at, PV] ** 2, axis=0))
    assert np.abs(measured / predicted - 1.0).max() < 0.17
    nees = flights["nees_position_velocity"][:, at].mean(axis=0) / 6.0
    np.testing.assert_allclose(nees, analysis.expected_square(PV)[at], rtol=0.15)


def test_a_run_is_the_same_beside_others() -> None:
    flown = case(OPEN, "duration_s=20", "signals.errors.multipath.correlation_time_s=5")
    alone, beside = fly(flown.flight, 4, [5]).one(0), fly(flown.flight, 4, range(4, 8)).one(1)
    for name in ("pseudorange", "error", "sigma", "nees"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(beside, name))
    assert len(flown.states) == 27
    more = {"": ("north", "east", "down"), "_more": ("1", "2", "3")}
    assert flown.states[-12:] == tuple(
        f"fix_error_{s}{also}_{a}" for s in ("slow", "fast") for also, axes in more.items() for a in axes
    )
    assert correlated_states(case(OPEN, "pseudolites.count=0").scenario, 8) == 12


def test_states_are_sums_of_errors_of_sources() -> None:
    """Of orthogonal shares: of variance one and independent; at the first fix the first three are what it is off by,
    the square root of its covariance; what they leave of fixes is small, and with them is all that there is."""
    flown = case(OPEN, "receiver.rate_hz=1", name="landing_open_sky")
    errors, believed = flown.shared.fix_errors, flown.flight.design.correlated
    assert believed is not None
    owed = errors.projections(believed.groups)
    e, count, k, s = owed.shape
    assert count == 6 * len(believed.groups)
    flat = owed.reshape(e, count, k * s)
    np.testing.assert_allclose(flat @ np.swapaxes(flat, 1, 2), np.broadcast_to(np.eye(count), (e, count, count)),
                               atol=1e-9)  # fmt: skip
    roots = errors.roots(believed.groups)
    whole = errors.of_kinds(np.ones(k))
    left = errors.beside(believed.groups)
    assert left[:, :3, :3].max() < 1e-5 * whole[:, :3, :3].max()
    # but for what they leave, whose root is of the order of 1e-3 of theirs
    np.testing.assert_allclose(roots[0, :3, :3], roots[0, :3, :3].T, atol=1e-4)
    np.testing.assert_allclose(roots[0, :3, 3:6], 0.0, atol=1e-4)
    np.testing.assert_allclose(roots @ np.swapaxes(roots, 1, 2) + left, whole, rtol=1e-9, atol=1e-12)


def test_what_counts_twice_or_not_at_all_is_warned_of() -> None:
    warned = case(OPEN, "pseudolites.differential={}", "signals.system_offsets_ns={galileo: 3}").warnings
    assert any("does not reduce signals.errors" in text for text in warned)
    assert any("signals.system_offsets_ns.galileo changes nothing" in text for text in warned)
    assert not any("does not reduce" in text for text in case("pseudolites.differential={}").warnings)


KINDS = (*records.FILTERS, *records.SMOOTHERS)


def words(text: str) -> str:
    return " ".join(text.split())


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_follows_them_as_a_dense_filter_does(kind: int) -> None:
    """Perfect sensors, position unknown, fixes with an error that lasts through a matrix that changes: estimate and
    covariance at the end are those of a Kalman filter of six states, to a hundredth of a sigma."""
    world = case("imu.preset=perfect", "duration_s=20").shared
    time, step, tau = np.arange(1.0, 16.0), 0.01, 7.0
    random = np.random.default_rng(8)
    turn = np.array([np.eye(3) + 0.02 * t * cross(np.array([0.3, -0.5, 0.8])) for t in time])
    root = turn @ np.array([[2.0, 0.3, 0.0], [0.3, 1.5, -0.4], [0.0, -0.4, 3.0]])
    lasting = np.zeros((time.size, 6, 3))
    lasting[:, :3] = root
    noise, off = 0.3, random.standard_normal((time.size, 3)) * 2.0
    # metres north, east, down off the truth
    at = [round(100 * t) for t in time]
    llh = world.truth.llh[at] + off * np.array([1 / 6.37e6, 1 / (6.37e6 * np.cos(world.truth.llh[0, 0])), -1.0])
    blocks = (*states.biases(), states.correlated_triple("fix_error", FIX, tau, step))
    p = np.diag(np.repeat([10.0, 1e-5, 1e-9, 1e-12, 1e-12, 1.0], 3) ** 2)
    state = records.start(exact_start(world.at_filter), p, components=3 if kind == records.GAUSSIAN_SUM else 0)
    cov = np.tile(np.diag([noise**2] * 3 + [1.0] * 3), (time.size, 1, 1))
    history = estimate(
        records.ImuData(world.imu_time, world.dtheta.copy(), world.dv.copy()),
        Measurements.of({FIX: FixTable(llh, np.full((time.size, 3), np.nan), cov, np.zeros(3), lasting)}),
        records.schedule(time, (FIX, time, time)),
        state,
        records.FilterModel(
            kind, np.zeros((1, 2)), states.declared(blocks), np.full(7, np.inf), 0,
            3 if kind == records.GAUSSIAN_SUM else 0, 3.0,
        ),
    )  # fmt: skip
    x, dense = np.zeros(6), np.diag([100.0] * 3 + [1.0] * 3)
    kept = np.diag([1.0] * 3 + [np.exp(-1.0 / tau)] * 3)
    for i in range(time.size):
        x, dense = kept @ x, kept @ dense @ kept.T + np.diag([0.0] * 3 + [1.0 - np.exp(-2.0 / tau)] * 3)
        h = np.hstack([np.eye(3), root[i]])
        s = h @ dense @ h.T + noise**2 * np.eye(3)
        k = dense @ h.T @ np.linalg.inv(s)
        x, dense = x + k @ (off[i] - h @ x), dense - k @ h @ dense
    both = [0, 1, 2, 15, 16, 17]
    sigma = np.sqrt(np.diag(dense))
    found = history.covariance[-1][np.ix_(both, both)]
    np.testing.assert_allclose(found / sigma / sigma[:, None], dense / sigma / sigma[:, None], atol=0.01)
    nav, truth = history.navigation[-1], world.truth.llh[at[-1]]
    moved = (nav[:3] - truth) / np.array([1 / 6.37e6, 1 / (6.37e6 * np.cos(truth[0])), -1.0])
    np.testing.assert_allclose(np.concatenate([moved, nav[-3:]]) / sigma, x / sigma, atol=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_follows_those_of_ranges_as_a_dense_filter_does(kind: int) -> None:
    """Perfect sensors, position and clock unknown, six sources far away of which one rises and another sets: estimate
    and covariance at the end are those of a Kalman filter of 3 + 2 + 12 states, to a hundredth of a sigma."""
    world = case("imu.preset=perfect", "duration_s=20").shared
    time, step, taus, density = np.arange(1.0, 16.0), 0.01, (40.0, 3.0), (0.02, 0.01)
    random = np.random.default_rng(8)
    unit = np.array([[0.6, 0.3, -0.7], [-0.5, 0.6, -0.6], [0.1, -0.8, -0.6], [-0.7, -0.5, -0.5], [0.9, -0.1, -0.4],
                     [0.1, 0.1, -1.0]])  # fmt: skip
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    heard = np.ones((time.size, 6), bool)
    heard[:5, 3], heard[9:, 1] = False, False
    effect = np.stack([2.0 + 0.05 * np.outer(time, np.arange(6)), np.full((time.size, 6), 0.8)], axis=2)
    noise, distance = 0.3, 1e9
    at = [round(100 * t) for t in time]
    here = ecef_from_llh(world.truth.llh[at])
    axes = ned_matrix(world.truth.llh[at])
    places = here[:, None] + distance * unit @ axes
    off = random.standard_normal((time.size, 6)) * 2.0
    epoch, source = np.nonzero(heard)
    table = RangeTable(
        places[epoch, source], np.zeros((epoch.size, 3)), np.full(epoch.size, distance), np.full(epoch.size, noise),
        np.ones(epoch.size), source, np.zeros(epoch.size, np.int64), distance + off[heard],
        np.full(epoch.size, np.nan), np.zeros(3), effect[heard],
    )  # fmt: skip
    states_ = [(s, g) for g in range(2) for s in range(6)]
    blocks = (
        *states.biases(),
        *(states.correlated_single(f"{s}{g}", "1", RANGE, 2 * s + g, 1.0, taus[g], step) for s, g in states_),
    )  # fmt: skip
    sigma = [10.0] * 3 + [1e-5] * 3 + [1e-9] * 3 + [1e-12] * 6 + [1.0] * 12 + [30.0, 3.0]
    state = records.start(
        exact_start(world.at_filter), np.diag(np.square(sigma)), 3 if kind == records.GAUSSIAN_SUM else 0, 6
    )
    history = estimate(
        records.ImuData(world.imu_time, world.dtheta.copy(), world.dv.copy()),
        Measurements.of({RANGE: table}),
        records.schedule(time, (RANGE, time[epoch], time[epoch])),
        state,
        records.FilterModel(
            kind, np.zeros((1, 2)), states.declared(blocks), np.full(7, np.inf), 0,
            3 if kind == records.GAUSSIAN_SUM else 0, 3.0, ReceiverClock(np.zeros(1, np.int64), np.array(density)),
        ),
    )  # fmt: skip
    x, dense = np.zeros(17), np.diag(np.square([10.0] * 3 + [1.0] * 12 + [30.0, 3.0]))

    def run_on(dt: float) -> None:
        nonlocal x, dense
        on, new = np.eye(17), np.zeros((17, 17))
        for k, (_, g) in enumerate(states_):
            on[3 + k, 3 + k], new[3 + k, 3 + k] = np.exp(-dt / taus[g]), 1.0 - np.exp(-2.0 * dt / taus[g])
        on[15, 16] = dt
        f, g2 = density
        new[15:, 15:] = [[f * dt + g2 * dt**3 / 3.0, g2 * dt**2 / 2.0], [g2 * dt**2 / 2.0, g2 * dt]]
        x, dense = on @ x, on @ dense @ on.T + new

    for i in range(time.size):
        run_on(1.0)
        for s in np.flatnonzero(heard[i]):
            h = np.concatenate([-unit[s], np.zeros(12), [1.0, 0.0]])
            h[[3 + s, 9 + s]] = effect[i, s]
            k = dense @ h / (h @ dense @ h + noise**2)
            x, dense = x + k * (off[i, s] - h @ x), dense - np.outer(k, h @ dense)
    both = [0, 1, 2, *range(15, 29)]
    sigma_ = np.sqrt(np.diag(dense))
    found = history.covariance[-1][np.ix_(both, both)]
    np.testing.assert_allclose(found / sigma_ / sigma_[:, None], dense / sigma_ / sigma_[:, None], atol=0.01)
    nav, truth = history.navigation[-1], world.truth.llh[at[-1]]
    moved = (nav[:3] - truth) / np.array([1 / 6.37e6, 1 / (6.37e6 * np.cos(truth[0])), -1.0])
    np.testing.assert_allclose(np.concatenate([moved, nav[states.NAV_N :]]) / sigma_, x / sigma_, atol=0.02)


def test_results_name_them(tmp_path: Path) -> None:
    settings = ("duration_s=20", OPEN, "signals.errors.multipath.correlation_time_s=5", "receiver.rate_hz=2")
    brief = (*(part for setting in settings for part in ("--set", setting)), "-q")
    navsim("run", SCENARIOS / "landing.yaml", *brief, "--runs", 3, "--figures", "none", "-o", "a.h5", cwd=tmp_path)
    flown = read(tmp_path / "a.h5")
    as_declared(flown)
    groups = ["fix_error_slow", "fix_error_slow_more", "fix_error_fast", "fix_error_fast_more"]
    assert list(flown["/summary/consistency/group"])[-4:] == groups
    assert "ranging errors some time-correlated (open-sky)" in words(navsim("show", "a.h5", cwd=tmp_path).stdout)
    more = ("--method", "covariance", "-o", "c.h5", "--figures", ".")
    navsim("run", SCENARIOS / "landing.yaml", *brief, *more, cwd=tmp_path)
    analysed = read(tmp_path / "c.h5")
    as_declared(analysed)
    named = [name for name in analysed["/budget/source"] if name.startswith("satellite_lasting_")]
    assert [name.removeprefix("satellite_lasting_") for name in named] == [
        "orbit_clock", "ionosphere", "troposphere", "multipath",
    ]  # fmt: skip
    assert (tmp_path / "c_budget.png").exists()


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_states_count_in_the_sigmas_that_the_filter_believes_in(coupling: str) -> None:
    """A filter that takes the errors of its receiver for twice as large is cautious in every state: what a state of
    lasting errors truly is counts in the sigmas of the filter, in runs and in the covariance analysis."""
    brief = ("duration_s=20", "imu.rate_hz=10", "receiver.rate_hz=1", f"filter.coupling={coupling}")
    right, cautious = (case(*brief, f"filter.fix_sigma_scale={k}", name="landing_open_sky") for k in (1, 2))
    last = [i for i, name in enumerate(right.states) if name.startswith(("fix_error_", "range_error_"))]
    assert last
    analysis = covariance_analysis(cautious)
    second = np.diagonal(analysis.covariance, axis1=1, axis2=2)
    z = np.sqrt(second[:, last] / np.diagonal(analysis.assumed, axis1=1, axis2=2)[:, last])
    np.testing.assert_allclose(z[0], 0.5, rtol=1e-9)
    assert z.max() < 1.0
    # at time 0 an error is the truth
    one, other = (fly(each.flight, 7, range(2), measured=False).error[:, 0, last] for each in (right, cautious))
    assert np.abs(one).min() > 0.0
    np.testing.assert_allclose(other, 0.5 * one, rtol=1e-12)
