"""The probability of leaving a box by pushed runs: against counting, against the closed form of a linear case."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.special import ndtri

from navsim.compiler.lanes import WIDTH
from navsim.landing import rare_events
from navsim.landing.rare_events import LimitState
from navsim.landing.study import Case, covariance_analysis, covariance_result, fly_all
from navsim.runner.executor import threads
from navsim.runner.statistics import share_interval, weighted_share
from navsim.simulation.importance_sampling import proposal, shift_inputs
from navsim.simulation.run_inputs import draw_inputs
from tests.helpers import case

LINEAR = (
    "filter.kind=eskf", "filter.velocity=false", "duration_s=61", "initial_errors.attitude_deg=0.01",
    "imu.gyro.drift_deg_h=1", "imu.accelerometer.bias_mg=0.01",
)  # fmt: skip
"""Small errors of attitude and sensors: the filter of every run is the one along the truth."""


def boxed(name: str, box: str, *settings: str) -> tuple[Case, LimitState]:
    flown = case(f"box={box}", *settings, name=name)
    return flown, rare_events.prepare(flown)


def sigmas(name: str, *settings: str) -> np.ndarray:
    """1 sigma of the lateral, along-track and vertical errors at touchdown by the covariance analysis, which does not
    know of pushes."""
    flown = case("box={lateral_m: 100}", *settings, name=name)
    return np.asarray(covariance_result(flown, covariance_analysis(flown), 1)["/summary/box/axis_sigma"])


@pytest.mark.parametrize(("runs", "within"), [(1000, 0.2), pytest.param(4000, 0.1, marks=pytest.mark.long)])
def test_a_linear_case_has_the_closed_form(runs: int, within: float) -> None:
    """A vertical error beyond its limit once in 1e7 landings by the covariance analysis: 4000 runs come within 10 %, a
    quarter of them within twice that, and within 3 of their own standard errors."""
    limit = float(-ndtri(0.5e-7) * sigmas("landing_gnss_only", *LINEAR)[2])
    flown, edge = boxed("landing_gnss_only", f"{{vertical_m: {limit!r}}}", *LINEAR)
    (value, low, high), relative, effective = rare_events.probability(
        edge, rare_events.fly_all(flown, edge, 3, 0, runs, threads())
    )
    assert abs(value / 1e-7 - 1.0) < within
    assert abs(value / 1e-7 - 1.0) < 3.0 * relative
    assert low < value < high
    assert effective > 0.1 * runs


HEIGHTS = (
    "radio_altimeter={sigma_floor_m: 0.3, latency_s: 0.1}",
    "barometric_altimeter={sigma_m: 0.8}",
    "runway.geoid_undulation_m=15.5",
    "initial_errors.attitude_deg=1",
)
"""Known to 7 cm, heights feel the second order of a tilt of 5 degrees, which the analysis that sizes the box lacks."""


@pytest.mark.parametrize(
    ("chance", "aids", "runs"),
    [
        pytest.param(1e-2, (), 2000, marks=pytest.mark.long), (1e-2, HEIGHTS, 400),
        pytest.param(1e-3, (), 2000, marks=pytest.mark.long),
        pytest.param(1e-2, HEIGHTS, 2000, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_counting_agrees(chance: float, aids: tuple[str, ...], runs: int) -> None:
    """5 degrees (1 with altimeters) and 700 deg/h, a box of all three errors, with altimeters wider to one side: the
    share of runs that are counted lies within 3 standard errors. `scripts/rare_events.py` does so for the default
    filter, with more runs."""
    settings = ("imu.rate_hz=50", "receiver.rate_hz=1", "filter.velocity=false", "filter.kind=eskf", *aids)
    near, far = (0.5, 1.5) if aids else (1.0, 1.0)
    sides = np.array([ndtri(near * chance / 6.0), -ndtri(far * chance / 6.0)])
    limits = (sides * sigmas("landing_gnss_only", *settings)[:, None]).tolist()
    box = "{{lateral_m: {}, along_m: {}, vertical_m: {}}}".format(*limits)
    flown, edge = boxed("landing_gnss_only", box, *settings)
    (value, *_), relative, _ = rare_events.probability(edge, rare_events.fly_all(flown, edge, 4, 0, 480, threads()))
    errors = fly_all(flown, 5, 0, runs, threads(), keep="none").per_run("at_box")[:, 0]
    share = float(edge.box.beyond(errors).any(axis=1).mean())
    assert abs(share - value) < 3.0 * math.hypot(relative * value, math.sqrt(value * (1.0 - value) / runs))
    assert 0.5 * chance < value < 2.0 * chance


def test_weights_belong_to_the_pushes() -> None:
    """Their mean is 1, none is above its bound, and a push moves errors to first order by what it says."""
    flown, edge = boxed("landing_gnss_only", "{lateral_m: 3, vertical_m: 5}", *LINEAR)
    tilt, mix = edge.tilt, edge.tilt.proposal
    assert mix.shares.sum() == pytest.approx(1.0)
    rng = np.random.default_rng(8)
    drawn = rng.choice(mix.shares.size, 200_000, p=mix.shares)
    root = np.linalg.cholesky(mix.covariance)
    off = root @ rng.standard_normal((3, drawn.size)) + mix.covariance @ mix.shifts[drawn].T
    weights = np.exp(mix.log_weights(off))
    assert weights.max() <= mix.most_weight * (1.0 + 1e-12)
    assert abs(weights.mean() - 1.0) < 4.5 * weights.std() / math.sqrt(drawn.size)

    inputs = draw_inputs(flown.flight, 1, range(WIDTH))
    still = shift_inputs(flown.flight, tilt, inputs, [mix.shares.size - 1] * WIDTH)[1]
    each = [k % mix.shares.size for k in range(WIDTH)]
    moved = shift_inputs(flown.flight, tilt, inputs, each)[1]
    np.testing.assert_allclose(moved - still, mix.covariance @ mix.shifts[each].T, atol=1e-9)
    to_lateral = mix.covariance @ mix.shifts[0]
    assert to_lateral[0] + tilt.mean[0] == pytest.approx(3.0)


def test_runs_do_not_depend_on_what_flies_beside_them() -> None:
    flown, edge = boxed("landing_gnss_only", "{lateral_m: 3}", *LINEAR)
    together = rare_events.fly_all(flown, edge, 3, 0, 40, threads(2))
    alone = rare_events.fly_all(flown, edge, 3, 13, 1, threads(1))
    for name in ("error", "first_order", "log_weight"):
        np.testing.assert_array_equal(together.per_run(name)[13:14], alone.per_run(name))


def test_errors_that_are_no_numbers_are_outside() -> None:
    _, edge = boxed("landing_gnss_only", "{lateral_m: 3}", *LINEAR)
    np.testing.assert_array_equal(
        edge.box.beyond(np.array([[0.0, 1e9, 1e9], [math.nan, 0.0, 0.0], [-3.1, 0.0, 0.0]])).any(axis=1),
        [False, True, True],
    )


def test_intervals_hold_what_they_promise() -> None:
    """95 % intervals of a chance of 1e-6 from 300 weighed draws each hold it in 92 to 98 of a hundred; so do counted
    ones, cautious by construction."""
    rng = np.random.default_rng(2)
    limit = -float(ndtri(0.5e-6))
    held = 0
    trials = 2000
    for _ in range(trials):
        sign = rng.choice((-1.0, 1.0), 300)
        x = rng.standard_normal(300) + sign * limit
        log_weights = 0.5 * limit**2 - np.log(np.cosh(limit * x))
        (_, low, high), _, _ = weighted_share(log_weights, np.abs(x) > limit, math.inf, 1.0)
        held += low < 1e-6 < high
    assert 0.92 < held / trials < 0.98
    value, low, high = share_interval(3, 1000)
    assert value == 0.003
    assert low == pytest.approx(6.19e-4, rel=1e-3)  # the exact limits of tables
    assert high == pytest.approx(8.74e-3, rel=1e-3)
    assert share_interval(0, 100)[2] == pytest.approx(1.0 - 0.025 ** (1 / 100))


def test_no_hit_gives_a_bound() -> None:
    (value, low, high), relative, effective = weighted_share(np.zeros(1000), np.zeros(1000, bool), 10.0, 1.0)
    assert (value, low, effective) == (0.0, 0.0, 0.0)
    assert math.isnan(relative)
    assert high == pytest.approx(10.0 * (1.0 - 0.025**1e-3))
    (value, low, high), relative, effective = weighted_share(np.zeros(1000), np.ones(1000, bool), 10.0, 1.0)
    assert (value, high, effective) == (1.0, 1.0, 1000.0)
    assert low == pytest.approx(0.025**1e-3)
    assert math.isnan(relative)


def test_one_inside_after_none_moves_the_interval_down() -> None:
    """Of 128 runs all, 127, 126, ... outside: never is one more inside a reason to believe in fewer of them."""
    ends = []
    for inside in range(6):
        (value, low, high), _, _ = weighted_share(np.zeros(128), np.arange(128) >= inside, 10.0, 1.0)
        assert low <= value <= high
        ends.append((value, low, high))
    assert all(later[:2] < earlier[:2] and later[2] <= earlier[2] for earlier, later in itertools.pairwise(ends))


def test_no_run_inside_is_no_certainty() -> None:
    """Runs that are all outside with small weights are of something rare; total weights above the number of runs make
    no chance above 1."""
    (value, low, high), relative, _ = weighted_share(
        np.full(8, -12.0) + 0.1 * np.arange(8), np.ones(8, bool), 10.0, 1.0
    )
    assert 0.0 < low < value < high < 1e-4
    assert relative > 0.0
    heavy = np.log(np.array([3.0, 3.0, 2.0, 2.0]))
    for hits in (np.array([True, True, False, False]), np.array([False, False, True, True])):
        (value, low, high), _, _ = weighted_share(heavy, hits, 10.0, 10.0)
        assert 0.0 <= low <= value <= high <= 1.0


def test_a_study_ends_by_the_interval_that_it_prints() -> None:
    """On both sides, and never where nothing is known of what is left."""
    assert rare_events.is_narrow(np.array([1e-6, 0.82e-6, 1.2e-6]), 50.0, 0.2)
    assert not rare_events.is_narrow(np.array([1e-6, 0.9e-6, 1.21e-6]), 50.0, 0.2)
    assert not rare_events.is_narrow(np.array([1e-6, 0.79e-6, 1.1e-6]), 50.0, 0.2)
    assert not rare_events.is_narrow(np.array([1e-6, 0.9e-6, 1.1e-6]), 29.0, 0.2)
    assert not rare_events.is_narrow(np.array([1.0, 0.0, 1.0]), 32.0, 0.01)
    assert not rare_events.is_narrow(np.array([1.0, math.nan, math.nan]), 32.0, 0.5)
    assert rare_events.is_narrow(np.array([math.nan, 0.0, 1e-300]), 32.0, 0.01)


def test_weights_within_a_box_are_bounded() -> None:
    """By what the pushes leave there, as no draw of it contradicts; the bound is close where the box is small."""
    mean, covariance = np.array([0.02, -0.1, 0.0]), np.diag([0.16, 0.15, 0.24]) ** 2
    rng = np.random.default_rng(6)
    of_size = ([0.05, 0.05, 0.05], [0.05, math.inf, math.inf], [0.3, math.inf, 0.4], [2.0, math.inf, math.inf])
    pairs = [(-np.array(size), np.array(size)) for size in of_size]
    pairs.append((np.array([-0.1, -math.inf, 0.02]), np.array([0.4, math.inf, 0.5])))
    for lower, upper in pairs:
        mix = proposal(mean, covariance, lower, upper)
        bound = mix.most_weight_between(lower - mean, upper - mean)
        errors = rng.uniform(np.maximum(lower, -3.0), np.minimum(upper, 3.0), (20_000, 3))
        found = float(np.exp(mix.log_weights((errors - mean).T)).max())
        assert found <= bound * (1.0 + 1e-9)
        assert bound <= 1.02 * found
        assert bound <= mix.most_weight * (1.0 + 1e-9)


@pytest.mark.parametrize("chance", [0.3, 0.5, 0.9, 0.999])
def test_chances_that_are_not_rare(chance: float) -> None:
    """Intervals stay between 0 and 1 and hold the truth as often as they say; weights of a half are no matter."""
    rng = np.random.default_rng(11)
    held = 0
    for _ in range(400):
        hits = rng.random(2000) < chance
        doubled = rng.random(2000) < 0.5
        (value, low, high), relative, _ = weighted_share(np.log(np.where(doubled, 1.5, 0.5)), hits, 1.5, 1.5)
        assert 0.0 <= low <= value <= high <= 1.0
        assert relative >= 0.0 or value == 1.0
        held += low <= chance <= high
    assert held > 0.9 * 400


def test_far_beyond_any_number() -> None:
    """Weights of 1e-400 or 1e-310 are of a chance below 1e-300, and no error; those of 1e-200 are of one."""
    hits = np.array([True, True, False, False])
    for log_weight in (-921.0, -714.0):
        (value, low, high), _, effective = weighted_share(np.full(4, log_weight), hits, 10.0, 10.0)
        assert math.isnan(value)
        assert (low, high, effective) == (0.0, 1e-300, 2.0)
    (value, low, high), relative, effective = weighted_share(np.full(4, -460.0), hits, 10.0, 10.0)
    assert 0.0 < low < value < high < 1e-198
    assert effective == pytest.approx(2.0)
    assert relative > 0.5
