"""The tightly coupled filter against closed forms, and against a loosely coupled one where they are the same."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.filter.covariance import gain, joseph
from navsim.filter.estimate import estimate
from navsim.filter.measurement_kinds import FIX, RANGE, Measurements, RangeTable
from navsim.filter.receiver_clock import ReceiverClock, propagate_clock_covariance
from navsim.filter.records import ESKF, FILTERS, FilterModel, History, ImuData, schedule, start
from navsim.geodesy.earth import RATE, ecef_from_llh, ned_matrix
from navsim.gnss.clock_noise import densities, step_covariance
from navsim.gnss.receiver import wander
from navsim.gnss.sky import unit_vector
from navsim.landing.study import Case, covariance_analysis
from navsim.simulation.flight import exact_clock
from navsim.simulation.measurement_tables import table_of_fixes, table_of_ranges
from navsim.simulation.measurements import receiver_fixes, without_noise
from navsim.simulation.run_inputs import draw_inputs
from tests.conftest import DATA, Within
from tests.helpers import case

DECLARED = states.declared(states.biases())
NO_GATE = np.full(states.MAX_MEASUREMENT_SIZE + 1, np.inf)
ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""From NED."""
SIGMA = np.repeat([3.0, 0.5, 0.02, 3e-3, 1e-2], 3)


@pytest.fixture(scope="module")
def cases() -> dict[str, Any]:
    return json.loads((DATA / "integrity.json").read_text())


@pytest.mark.validates("Growth of a receiver's clock error while it receives nothing", "closed form (Brown & Hwang)",
                       variance="1e-9 (relative)")  # fmt: skip
def test_outage(cases: dict[str, Any], within: Within) -> None:
    given = cases["tight_outage_clock"]
    density = np.array(densities(given["h0"], given["h_minus2"]))
    np.testing.assert_allclose(density, [given["s_f_m2_s"], given["s_g_m2_s3"]], rtol=within["variance"])
    for seconds, variance in given["variance_after_s"].items():
        # all at once, and in steps
        for steps in (1, 100):
            p = np.zeros((3, 3))
            for _ in range(steps):
                propagate_clock_covariance(0, 2, *density, float(seconds) / steps, p)
            np.testing.assert_allclose(p[:2, :2], np.full((2, 2), variance), rtol=within["variance"])


def test_the_clock_wanders_as_it_is_believed_to() -> None:
    """Sampled clocks against the covariance over two unequal steps: 99.99 % intervals of sums of squares."""
    density, time, count = (0.3, 0.7), np.array([0.0, 0.5, 2.5]), 4000
    random = np.random.default_rng(12)
    drawn = np.array([wander(density, time, random) for _ in range(count)])
    np.testing.assert_array_equal(drawn[:, 0], 0.0)
    step = 2.0
    bias, both, drift = step_covariance(np.array(density), np.array(step))
    news = drawn[:, 2] - drawn[:, 1]
    news[:, 0] -= step * drawn[:, 1, 1]
    expected = np.array([[bias, both], [both, drift]])
    found = news.T @ news / count
    spread = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / count)
    assert np.all(np.abs(found - expected) < 3.9 * spread)


@pytest.mark.validates("Filter update by two ranges with an unknown clock", "closed form", position_variance="5e-6 m2")
def test_two_sources(cases: dict[str, Any], within: Within) -> None:
    """Their difference is all that is seen; one source alone says where the clock is, and nothing else."""
    entry = cases["tight_two_sources"]
    given = entry["inputs"]
    azimuth, elevation = np.radians(np.array(given["azimuth_elevation_deg"], float)).T
    prior = np.array(given["prior_enu_m2"])
    after = seen(prior, unit_vector(azimuth, elevation), np.array(given["sigma_m"], float))
    np.testing.assert_allclose(
        ENU @ after[:3, :3] @ ENU.T, entry["expected"]["posterior_enu_m2"], rtol=0, atol=within["position_variance"]
    )
    alone = seen(prior, unit_vector(azimuth[:1], elevation[:1]), np.array([2.0]))
    np.testing.assert_allclose(ENU @ alone[:3, :3] @ ENU.T, prior, rtol=0, atol=within["position_variance"])
    towards = ENU @ unit_vector(azimuth[:1], elevation[:1])[0]
    assert alone[15, 15] == pytest.approx(4.0 + towards @ (ENU @ prior @ ENU.T) @ towards, rel=1e-6)


def seen(prior_enu: np.ndarray, unit: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """P (17, 17) of a filter at rest after ranges to sources very far away; unit: (s, 3) ENU."""
    llh = np.array([0.7, 0.4, 100.0])
    nav = np.zeros(states.NAV_N + 2)
    nav[:3], nav[states.NAV_QUAT] = llh, 1.0
    distance = 1e12
    here, c_ne = ecef_from_llh(llh), ned_matrix(llh)
    places = here + distance * (unit @ ENU) @ c_ne
    count = sigma.size
    p = np.zeros((17, 17))
    p[:3, :3] = ENU @ prior_enu @ ENU.T
    p[np.arange(3, 15), np.arange(3, 15)] = 1e-12
    p[15, 15], p[16, 16] = 1e8, 1e-12
    state = start(nav, p, 0, count)
    flown(
        RangeTable(
            places, np.zeros((count, 3)), np.full(count, distance), sigma, sigma, np.arange(count),
            np.zeros(count, np.int64), np.linalg.norm(places - here, axis=1), np.full(count, np.nan), np.zeros(3),
            np.empty((count, 0)),
        ),
        ImuData(np.array([0.0, 0.01]), np.zeros((1, 3)), np.zeros((1, 3))),
        FilterModel(ESKF, np.zeros((1, 2)), DECLARED, NO_GATE, 0, clock=ReceiverClock(np.zeros(1, int), np.zeros(2))),
        state,
    )  # fmt: skip
    return state.covariance


def flown(table: Any, imu: ImuData, model: FilterModel, state: Any) -> History:
    """All rows of a table at the first moment."""
    kind = RANGE if isinstance(table, RangeTable) else FIX
    at = np.full((table.pseudorange if kind == RANGE else table.llh).shape[0], imu.time[0])
    return estimate(imu, Measurements.of({kind: table}), schedule(imu.time[:1], (kind, at, at)), state, model)


SKIES = {
    "as shipped": (),
    "two systems": ("sky.source=nominal",),
    "pseudolites on their own clock, lever arm": ("pseudolites.clock=own", "receiver.lever_arm_m=[2, 0.7, -1.1]"),
    "two systems, lever arm, scale factors": (
        "sky.source=nominal", "receiver.lever_arm_m=[2, 0.7, -1.1]", "filter.scale_factors=true",
        "imu.gyro.scale_ppm=1000", "imu.accelerometer.scale_ppm=1000",
    ),
}  # fmt: skip


def one_epoch(
    kind: int, moved: float, order: Sequence[int] | None, *assignments: str, own: bool = False
) -> tuple[Any, Any]:
    """States of a tight and of a loose filter after the ranges, or the fix, of one epoch of the glide, from the same
    start: as far off as `moved` (m, m/s, 0.1 rad), nothing known of the clock; order: of the ranges; own: whether
    the fix is the receiver's own."""
    ready = case("filter.coupling=tight", "duration_s=31", "receiver.rate_hz=1", *assignments)
    flight, world = ready.flight, ready.shared
    epoch = 29
    k = int(np.searchsorted(world.imu_time, world.signals.time[epoch] - 1e-9))
    n = flight.covariance.shape[0]
    first = n - flight.model.clock_states
    random = np.random.default_rng(3)
    sigma = np.concatenate([SIGMA, np.full(first - 15, 1e-3)])
    mixed = np.eye(first) + 0.3 * random.standard_normal((first, first)) / np.sqrt(first)
    p = np.zeros((n, n))
    p[:first, :first] = sigma[:, None] * (mixed @ mixed.T) * sigma
    p[first:, first:] = 1e8 * np.eye(n - first)
    nav = np.zeros(states.NAV_SENSORS + n - states.SENSORS)
    truth = world.truth
    nav[:3], nav[3:6], nav[6:10] = truth.llh[k], truth.velocity_ned[k], truth.quaternion[k]
    nav[0] += moved / 6.4e6
    nav[3:6] += moved
    nav[-flight.model.clock_states :] = exact_clock(flight)[epoch + 1]
    imu = ImuData(world.imu_time[k : k + 2], world.dtheta[k : k + 1], world.dv[k : k + 1])
    ranges, rates = without_noise(world)
    model = flight.model._replace(kind=kind, gate=NO_GATE, components=1)
    all_rows = table_of_ranges(flight, ranges, rates)
    rows = np.flatnonzero(np.nonzero(world.signals.used)[0] == epoch)
    rows = rows if order is None else rows[list(order)]
    table = RangeTable(*(m if m is all_rows.lever_arm or not m.size else m[rows] for m in all_rows))
    tight = start(nav, p, 1, len(world.signals.names))
    flown(table, imu, model, tight)
    llh, velocity, _, cov = receiver_fixes(world, ranges, rates)
    if flight.design.velocity and not own:
        velocity[epoch], cov[epoch] = of_all_unknowns(ready, epoch, k)
    fixes = table_of_fixes(flight.design, *(m[epoch : epoch + 1] for m in (llh, velocity, cov)))
    loose = start(nav[: states.NAV_SENSORS + first - states.SENSORS], p[:first, :first], 1)
    flown(fixes, imu, model._replace(clock=ReceiverClock(np.empty(0, np.int64), np.zeros(2))), loose)
    return tight, loose


def of_all_unknowns(ready: Case, epoch: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity of the antenna (3,), along the axes at the IMU, and covariance of position and velocity (6, 6), NED,
    solved from ranges and range rates at once: beside a near source a range rate knows of the place too. k: the sample
    of the IMU."""
    world, arm = ready.shared, ready.environment.lever_arm
    s, truth = world.signals.at(np.array([epoch])), world.truth
    heard = s.used[0]
    c_ne = ned_matrix(truth.llh[k])
    away = (s.position[0, heard] - s.antenna[0]) @ c_ne.T
    distance = np.linalg.norm(away, axis=1)
    u = away / distance[:, None]
    turning = truth.angular_rate[k] - truth.c_nb[k].T @ c_ne @ [0.0, 0.0, RATE]
    velocity = truth.velocity_ned[k] + truth.c_nb[k] @ np.cross(turning, arm)
    relative = s.velocity[0, heard] @ c_ne.T - velocity
    along = np.sum(u * relative, axis=1, keepdims=True)
    clocks = (s.time_scale[heard, None] == np.array(world.scales)).astype(float)
    none, one = np.zeros((u.shape[0], 1)), np.ones((u.shape[0], 1))
    by_range = np.hstack([-u, np.zeros_like(u), clocks, none]) / s.fix_sigma[0, heard, None]
    by_rate = np.hstack([(along * u - relative) / distance[:, None], -u, 0.0 * clocks, one])
    h = np.vstack([by_range, by_rate / s.rate_sigma[0, heard, None]])
    return velocity, np.linalg.inv(h.T @ h)[:6, :6]


@pytest.mark.parametrize("velocity", ["true", "false"])
@pytest.mark.parametrize("sky", SKIES)
@pytest.mark.parametrize("kind", FILTERS)
def test_with_an_unknown_clock_it_is_the_loose_one(sky: str, kind: int, velocity: str) -> None:
    """The weighted least squares of an epoch are all that it says: `docs/theory/tight-coupling.md`, section 3."""
    moved = 1e-5  # a fix is linearised where the receiver is, an epoch of ranges where the filter is
    tight, loose = one_epoch(kind, moved, None, f"filter.velocity={velocity}", *SKIES[sky])
    n = loose.covariance.shape[0]
    size = np.sqrt(np.diagonal(loose.covariance))
    np.testing.assert_allclose(
        tight.covariance[:n, :n] / np.outer(size, size), loose.covariance / np.outer(size, size), rtol=0, atol=1e-6
    )
    off = tight.navigation[: loose.navigation.size] - loose.navigation
    # a fix takes the lever arm along straight axes: its square over the Earth's radius
    assert np.abs(off[:2]).max() * 6.4e6 < 1e-6
    assert abs(off[2]) < 1e-6
    assert np.abs(off[3:6]).max() < 1e-7


def test_the_receivers_own_fix_knows_a_little_less() -> None:
    """It solves ranges and range rates one after the other; those of near sources know of the place, too."""
    tight, loose = one_epoch(ESKF, 0.0, None, own=True)
    size = np.sqrt(np.diagonal(loose.covariance))
    lost = 1.0 - np.diagonal(tight.covariance)[:3] / size[:3] ** 2
    assert 0.005 < lost.max() < 0.03
    assert lost.min() > -1e-6


@pytest.mark.parametrize("moved", [pytest.param(1e-5, marks=pytest.mark.long), 5.0])
@pytest.mark.parametrize("sky", SKIES)
@pytest.mark.parametrize("kind", FILTERS)
def test_the_order_of_sources_does_not_matter(sky: str, kind: int, moved: float) -> None:
    """However far the estimate moves, and its axes with it, an epoch is one measurement: as the fix it makes."""
    forwards, loose = one_epoch(kind, moved, None, *SKIES[sky])
    count = int(
        case("filter.coupling=tight", "duration_s=31", "receiver.rate_hz=1", *SKIES[sky]).shared.signals.used[29].sum()
    )
    backwards, _ = one_epoch(kind, moved, range(count - 1, -1, -1), *SKIES[sky])
    size = np.sqrt(np.diagonal(forwards.covariance))
    gap = np.abs(forwards.covariance - backwards.covariance) / np.outer(size, size)
    assert gap.max() < 1e-12
    turned = np.abs(forwards.navigation - backwards.navigation)[6:10] / size[6]
    assert turned.max() < 1e-9
    # by ranges one after the other attitude differed by 0.3 of its sigma, and by 0.5 with their order; what is left is
    # where a fix is linearised: at the receiver's own place
    n = loose.covariance.shape[0]
    gap = np.abs(forwards.covariance[:n, :n] - loose.covariance) / np.outer(size[:n], size[:n])
    assert gap.max() < 2e-3
    assert np.abs(forwards.navigation[6:10] - loose.navigation[6:10]).max() < 0.006 * size[6]


def test_a_component_that_dies_within_an_epoch_leaves_the_others_alone() -> None:
    """Of two, the first is half a kilometre off: ranges of one epoch end it, and the other ends as if by itself."""
    ready = case("filter.coupling=tight", "duration_s=1", "receiver.rate_hz=1", "filter.kind=gaussian-sum")
    flight, world = ready.flight, ready.shared
    ranges, rates = without_noise(world)
    rows = np.flatnonzero(np.nonzero(world.signals.used)[0] == 0)
    whole = table_of_ranges(flight, ranges, rates)
    table = RangeTable(*(m if m is whole.lever_arm or not m.size else m[rows] for m in whole))
    k = int(np.searchsorted(world.imu_time, world.signals.time[0] - 1e-9)) - 1
    imu = ImuData(world.imu_time[k : k + 2], world.dtheta[k : k + 1], world.dv[k : k + 1])
    truth, sources = world.truth, len(world.signals.names)
    nav = np.zeros(states.NAV_SENSORS + flight.covariance.shape[0] - states.SENSORS)
    nav[:3], nav[3:6], nav[6:10] = truth.llh[k], truth.velocity_ned[k], truth.quaternion[k]
    p = flight.covariance.copy()
    p[2, 2] = 1.0
    model = flight.model._replace(gate=NO_GATE)
    one, two = (start(nav, p, model.components, sources) for _ in range(2))
    mixture = two.components
    for member in (mixture.navigation, mixture.covariance):
        member[1] = member[0]
    mixture.navigation[0, 2] += 500.0
    mixture.weight[:2] = 0.5
    for state in (one, two):
        flown(table, imu, model, state)
    np.testing.assert_array_equal(two.components.weight, one.components.weight)
    np.testing.assert_allclose(two.components.navigation[0], one.components.navigation[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(two.components.covariance[0], one.components.covariance[0], rtol=1e-9, atol=1e-15)


def test_a_near_source_is_iterated() -> None:
    """A pseudolite 200 m away, the place uncertain by 30 m across and as far off: the estimate is the maximum a
    posteriori, found by a least-squares program, which a single linearisation misses by metres."""
    llh = np.array([0.7, 0.4, 100.0])
    sigma, known, across = 0.5, 2.0, 30.0
    nav = np.zeros(states.NAV_N + 2)
    nav[:3], nav[states.NAV_QUAT] = llh, 1.0
    p = np.diag(np.concatenate([[known**2, across**2, 1e-6], np.full(14, 1e-12)]))
    here, c_ne = ecef_from_llh(llh), ned_matrix(llh)
    towards = np.array([200.0, -30.0, 0.0])
    measured = np.array([200.0])
    table = RangeTable(
        (here + towards @ c_ne)[None], np.zeros((1, 3)), np.full(1, 200.0), np.full(1, sigma), np.full(1, 0.1),
        np.zeros(1, np.int64), np.zeros(1, np.int64), measured, np.full(1, np.nan), np.zeros(3),
        np.empty((1, 0)),
    )  # fmt: skip
    model = FilterModel(
        ESKF, np.zeros((1, 2)), DECLARED, NO_GATE, 0, clock=ReceiverClock(np.zeros(1, int), np.zeros(2))
    )
    imu = ImuData(np.array([0.0, 0.01]), np.zeros((1, 3)), np.zeros((1, 3)))

    def residuals(x: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(towards[:2] - x)
        return np.array([x[0] / known, x[1] / across, (measured[0] - distance) / sigma])

    solution = least_squares(residuals, np.zeros(2), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    gaps = []
    for far in (1.0, 1e9):
        state = start(nav, p, 0, 1)
        flown(table._replace(distance=far * table.distance), imu, model, state)
        moved = (ecef_from_llh(state.navigation[:3]) - here) @ c_ne.T
        gaps.append(float(np.linalg.norm(moved[:2] - solution.x)))
        if far == 1.0:
            expected = np.linalg.inv(solution.jac.T @ solution.jac)
            np.testing.assert_allclose(state.covariance[:2, :2], expected, rtol=0.03, atol=0.03)
    assert gaps[1] > 0.3
    assert gaps[0] < 0.1 * gaps[1], gaps


def test_an_unreceived_system_has_no_clock() -> None:
    """The states are those of the time scales that are there."""
    ready = case("filter.coupling=tight", "duration_s=20", "sky.source=nominal-gps", "pseudolites.count=0")
    assert ready.states[15:] == ("clock_bias_gps", "clock_drift")
    both = replace(ready.flight.design, clock=None)
    assert both.followed((0, 1)) == ()


@pytest.mark.validates("Covariance of the difference between a filter and one with fewer measurements", "closed form",
                       covariances="1e-9")  # fmt: skip
def test_filters_with_fewer_measurements(cases: dict[str, Any], within: Within) -> None:
    """The update of navsim's filters, scalar by scalar, in the worked case; the covariance of the difference is that of
    the covariances, by the joint recursion."""
    entry = cases["filter_solution_separation"]
    given = entry["inputs"]
    phi, q = np.array(given["phi"]), np.array(given["q"])
    both = ((np.array([given["h_a"]], float), given["r_a"]), (np.array([given["h_b"]], float), given["r_b"]))
    covariances = [np.array(given["p0"]) for _ in range(2)]
    # errors of the main filter and of the sub-filter, which begin alike
    joint = np.tile(covariances[0], (2, 2))
    for step in range(given["steps"] + 200):
        covariances = [phi @ p @ phi.T + q for p in covariances]
        joint = np.kron(np.eye(2), phi) @ joint @ np.kron(np.eye(2), phi).T + np.tile(q, (2, 2))
        for number, (h, r) in enumerate(both if step < given["steps"] else ()):
            turn, noise = np.eye(4), np.zeros((4, 1))
            for which in range(2):
                if which == 0 or number == 0:
                    k = weighed(covariances[which], h, r)
                    own = slice(2 * which, 2 * which + 2)
                    turn[own, own] -= k @ h
                    noise[own] = k
            joint = turn @ joint @ turn.T + r * noise @ noise.T
        expected = {given["steps"] - 1: entry["expected"], given["steps"] + 199: entry["coasting_200_steps"]}.get(step)
        if expected is None:
            continue
        apart = joint[:2, :2] + joint[2:, 2:] - joint[:2, 2:] - joint[2:, :2]
        for found, name in zip((*covariances, apart), ("p_main", "p_sub", "separation_covariance"), strict=True):
            np.testing.assert_allclose(found, expected[name], rtol=0, atol=within["covariances"])
        np.testing.assert_allclose(covariances[1] - covariances[0], apart, rtol=0, atol=within["covariances"])


def weighed(p: np.ndarray, h: np.ndarray, r: float) -> np.ndarray:
    """P (n, n) after a scalar measurement, in place, by navsim's kernels; returns its gain (n, 1)."""
    n = p.shape[0]
    rows, noise = (
        np.zeros((states.MAX_MEASUREMENT_SIZE, n)),
        np.full((states.MAX_MEASUREMENT_SIZE, states.MAX_MEASUREMENT_SIZE), r),
    )
    rows[:1] = h
    pht, k, work = (np.zeros((n, states.MAX_MEASUREMENT_SIZE)) for _ in range(3))
    assert gain(p, rows, noise, 1, pht, np.zeros((states.MAX_MEASUREMENT_SIZE, states.MAX_MEASUREMENT_SIZE)), k)
    joseph(p, rows, noise, 1, pht, k, work)
    return k[:, :1]


def test_a_filter_without_a_source_differs_by_the_difference_of_covariances() -> None:
    """Landings with and without a satellite and a pseudolite, the same noise of all else: the difference of their
    positions and velocities has the covariance P_sub - P_main that an optimal filter gives it, within 4.5 standard
    errors."""
    settings = (
        "filter.coupling=tight", "filter.kind=eskf", "duration_s=30", "receiver.rate_hz=2",
        "initial_errors.attitude_deg=0.5", "filter.gate.probability=0",
    )  # fmt: skip
    event = json.dumps([{"what": "silence", "sources": ["R07", "PL1"], "at_s": 0, "until_s": 30}])
    runs, pair = 160, (case(*settings), case(*settings, f"events={event}"))
    drawn = [draw_inputs(one.flight, 3, range(WIDTH)) for one in pair]
    heard = np.isfinite(drawn[1].ranges)
    np.testing.assert_array_equal(drawn[0].ranges[heard], drawn[1].ranges[heard])
    errors = [np.concatenate([run.error for run in one.fly_runs(3, 0, runs, False)]) for one in pair]
    believed = [covariance_analysis(one).assumed for one in pair]
    for when in (20, 40, 59):
        apart = (errors[1] - errors[0])[:, when, :6]
        expected = (believed[1] - believed[0])[when, :6, :6]
        found = apart.T @ apart / runs
        spread = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / runs)
        assert np.all(np.abs(found - expected) < 4.5 * spread), when
