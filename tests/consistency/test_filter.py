"""The filter's covariance is the covariance of its errors, where the small-angle world holds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from navsim.filter.states import GYRO, PHI_D
from navsim.landing.study import Case, fly_all
from navsim.runner.executor import threads
from tests.conftest import LANDINGS
from tests.helpers import case, in_brief, outputs_at, squares_at

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1")
"""1 degree and 70 deg/h instead of the paper's 5 degrees and 700 deg/h, fixes at 1 Hz."""


KINDS = [
    *itertools.product((1, 2, 3), ("eskf", "tfg", "left-invariant"), ("true", "false")),
    *itertools.product((1,), ("first-estimates", "observability-constrained"), ("false",)),
]
SHORTER = 3.5
"""Sigma of the sampling of fewer runs by which their limits are wider."""


def by_chance(runs: int) -> np.ndarray:
    """1 sigma of the mean NEES/15 and NEES/6 of runs at one time, where the filter is true."""
    return np.sqrt(2.0 / (runs * np.array([15, 6])))


@pytest.mark.parametrize(
    ("seed", "kind", "velocity", "runs"),
    [
        (1, "eskf", "true", 240),
        (2, "tfg", "false", 240),
        (1, "first-estimates", "false", 240),
        *(pytest.param(*one, 1000, marks=pytest.mark.long) for one in KINDS),
    ],
)
def test_consistency(seed: int, kind: str, velocity: str, runs: int) -> None:
    """NEES and NIS of 1000 runs at 10, 20, ... 120 s: close to one for every kind in the small-angle world; of fewer,
    limits are wider by what they leave to chance."""
    flown = case(*GENTLE, f"filter.velocity={velocity}", f"filter.kind={kind}")
    ensemble = fly_all(flown, seed, 0, runs, threads())
    time = flown.shared.filter_time
    np.testing.assert_allclose(time[outputs_at(flown, range(10, 121, 10))], range(10, 121, 10))
    wider = SHORTER * (by_chance(runs) - by_chance(1000))
    for mean, by, least in zip(squares_at(flown, ensemble), wider, (0.92, 0.90), strict=True):
        assert np.all((mean > least - by) & (mean < 1.10 + by)), mean
        assert 0.95 - by < mean.mean() < 1.07 + by
    nis = ensemble["innovation_squared"].sum() / ensemble["degrees"].sum()
    assert abs(nis - 1.0) < (0.02 if runs == 1000 else 0.04)


FIXES = {
    "A": ("receiver.rate_hz=1", "filter.velocity=false"),
    "B": ("receiver.rate_hz=1", "filter.velocity=true"),
    "C": ("receiver.rate_hz=10", "filter.velocity=false"),
}
"""Fixes of position at 1 Hz, of position and velocity at 1 Hz, of position at 10 Hz."""


def at_tens(flown: Case, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean NEES/15 (own coordinates) and NEES/6 at 10, 20, ... 120 s."""
    return squares_at(flown, fly_all(flown, 1, 0, runs, threads()))


@pytest.mark.parametrize(
    ("fixes", "runs"),
    [("A", 160), ("C", 160), *(pytest.param(fixes, 500, marks=pytest.mark.long) for fixes in FIXES)],
)
def test_tfg_is_true_at_the_papers_errors(fixes: str, runs: int) -> None:
    """5 degrees, 700 deg/h, constant pitch: NEES/15 and NEES/6 within 0.9-1.15 at every 10 s of 500 runs; of fewer,
    wider by what they leave to chance."""
    means = at_tens(case(*FIXES[fixes], "pseudolites.count=0", "approach.pitch=level", "filter.kind=tfg"), runs)
    for mean, by in zip(means, SHORTER * (by_chance(runs) - by_chance(500)), strict=True):
        assert np.all((mean > 0.9 - by) & (mean < 1.15 + by)), mean


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (FIXES["A"], "s_turn"),
        *(
            pytest.param((*FIXES["A"], "approach.pitch=level", twice), "landing_gnss_only", marks=pytest.mark.long)
            for twice in ("imu.gyro.drift_deg_h=1400", "initial_errors.attitude_deg=10")
        ),
    ],
    ids=["S-turn", "1400 deg/h", "10 deg"],
)
def test_tfg_beyond_the_papers_errors(settings: tuple[str, ...], name: str) -> None:
    """At most 1.4 in a 6 deg/s S-turn, at 1400 deg/h and at 10 degrees of initial attitude error."""
    full, part = at_tens(case(*settings, "filter.kind=tfg", name=name), 500)
    assert full.max() < 1.4, full
    assert part.max() < 1.4, part


TRUE = [
    ("A", FIXES["A"], "landing_gnss_only"),
    ("landing", (), "landing"),
    ("landing_smooth", (), "landing_smooth"),
    ("s_turn", (), "s_turn"),
]
TRUE_TOO = [
    ("B", FIXES["B"], "landing_gnss_only"),
    ("C", FIXES["C"], "landing_gnss_only"),
    ("landing_gnss_only", (), "landing_gnss_only"),
    ("1400 deg/h", (*FIXES["A"], "imu.gyro.drift_deg_h=1400"), "landing_gnss_only"),
    ("10 deg", (*FIXES["A"], "initial_errors.attitude_deg=10"), "landing_gnss_only"),
]


@pytest.mark.parametrize(
    ("settings", "name", "runs"),
    [
        *in_brief([pytest.param(s, n, 120, id=i) for i, s, n in TRUE], 1, 3),
        *(pytest.param(s, n, 500, id=f"{i}, 500 runs", marks=pytest.mark.long) for i, s, n in (*TRUE, *TRUE_TOO)),
    ],
)
def test_the_default_is_true_at_the_papers_errors(settings: tuple[str, ...], name: str, runs: int) -> None:
    """The nose follows the path: NEES/15 and NEES/6 within 0.9-1.15 at every 10 s of 500 runs, and no heading error
    beyond 6 sigma; of fewer runs, limits are wider by what they leave to chance."""
    flown = case(*settings, name=name)
    assert flown.scenario.filter.kind == "gaussian-sum"
    ensemble = fly_all(flown, 1, 0, runs, threads())
    for mean, by in zip(squares_at(flown, ensemble), SHORTER * (by_chance(runs) - by_chance(500)), strict=True):
        assert np.all((mean > 0.9 - by) & (mean < 1.15 + by)), mean
    assert np.abs(ensemble["error"][..., PHI_D] / ensemble["sigma"][..., PHI_D]).max() < 6.0


@pytest.mark.parametrize(("name", "before", "after"), [("landing", 59.0, 66.0), ("landing_smooth", 34.0, 46.0)])
def test_a_turn_takes_nothing_from_what_is_known_of_biases(name: str, before: float, after: float) -> None:
    """The body leaves the glide, or begins it, with heading unknown to 12 or 8 deg. The gyro about the axis of that
    turn has a constant bias, known to 2.5 deg/h: a turn cannot make it worse."""
    flown = case(name=name)
    time = flown.shared.filter_time
    sigma = fly_all(flown, 2, 0, 8, threads(), keep="errors")["sigma"][..., GYRO + 1]
    at, later = int(np.argmin(np.abs(time - before))), (time > before) & (time < after)
    assert np.all(sigma[:, later].max(axis=1) < 1.02 * sigma[:, at])


def test_late_fixes_with_a_lever_arm_are_used_as_well() -> None:
    """0.35 s of latency, off the IMU's grid, and a lever arm: still consistent."""
    flown = case(*GENTLE, "receiver.latency_s=0.353", "receiver.lever_arm_m=[1.2, 0.3, -0.6]")
    ensemble = fly_all(flown, 1, 0, 400, threads())
    settled = ensemble["nees"][:, 10:].mean() / 15
    assert 0.93 < settled < 1.07
    assert 0.98 < ensemble["innovation_squared"].sum() / ensemble["degrees"].sum() < 1.02
    np.testing.assert_allclose(flown.shared.filter_time[1:], np.arange(1, 120) + 0.353)


def test_latency_ignored_is_noticed() -> None:
    """A filter that takes late fixes for fresh ones is 10 m off at 30 m/s, and its NIS says so."""
    flown = case(*GENTLE, "receiver.latency_s=0.353", "filter.latency_s=0", "filter.gate.probability=0")
    ensemble = fly_all(flown, 1, 0, 50, threads())
    assert ensemble["innovation_squared"].sum() / ensemble["degrees"].sum() > 1.2
    north = ensemble["error"][:, 20:60, 0].mean()
    assert 7.0 < north < 13.0  # truth is ahead of the estimate


def test_mistuned_filter_is_noticed() -> None:
    flown = case(*GENTLE, "filter.fix_sigma_scale=0.5")
    ensemble = fly_all(flown, 1, 0, 50, threads())
    assert ensemble["innovation_squared"].sum() / ensemble["degrees"].sum() > 2.0
    flown = case(*GENTLE, "filter.imu.gyro={drift_deg_h: 7}")
    ensemble = fly_all(flown, 1, 0, 50, threads())
    assert ensemble["nees"][:, 5:].mean() / 15 > 2.0


def test_gate_rejects_blunders_and_lets_go() -> None:
    """Fixes believed hundred times too good are rejected, but not for ever."""
    flown = case(*GENTLE, "filter.fix_sigma_scale=0.01", "filter.gate.max_rejected=5")
    status = flown.fly(1, 0).status
    assert np.any(status == 2)
    runs_of_rejection = "".join(map(str, status)).split("1")
    assert max(map(len, runs_of_rejection)) <= 5
    assert not np.any(case(*GENTLE).fly(1, 0).status == 2)


@pytest.mark.parametrize(
    ("name", "kind"), in_brief(zip(LANDINGS, itertools.cycle(["eskf", "tfg", "left-invariant"])), 0, 4, 8)
)
def test_covariance_stays_positive_definite(name: str, kind: str) -> None:
    """Every output of every shipped scenario, each kind in its turn: NEES is nan where the Cholesky factorisation of P
    fails."""
    ensemble = fly_all(case(f"filter.kind={kind}", name=name), 1, 0, 8, threads())
    assert np.all(np.isfinite(ensemble["nees"]))
    assert np.all(ensemble["sigma"] > 0.0)


def test_markov_bias_is_followed() -> None:
    """An exponentially correlated bias, in truth and filter: consistent."""
    flown = case(
        *GENTLE, "imu.gyro.drift_deg_h=0", "imu.gyro.markov_deg_h=100", "imu.gyro.markov_time_s=40",
        "imu.accelerometer.bias_mg=0", "imu.accelerometer.markov_mg=2", "imu.accelerometer.markov_time_s=60",
    )  # fmt: skip
    ensemble = fly_all(flown, 2, 0, 400, threads())
    assert 0.94 < ensemble["nees"][:, 10:].mean() / 15 < 1.06


def test_batch_smoother_is_true() -> None:
    """As the next test, of 50 runs; limits are 3.5 sigma of their sampling (chi-square of 15 and 6) wider."""
    means = at_tens(case(*FIXES["B"], "filter.kind=map", name="landing_gnss_only"), 50)
    for square, by in zip(means, SHORTER * by_chance(50), strict=True):
        assert np.all((square > 0.95 - by) & (square < 1.08 + by)), square


@pytest.mark.long
@pytest.mark.parametrize("fixes", FIXES)
def test_batch_smoother_is_true_where_filters_are_not(fixes: str) -> None:
    """The paper's errors, the nose following the path, where `tfg` reaches 3: `map` stays within 0.9-1.15."""
    full, part = at_tens(case(*FIXES[fixes], "filter.kind=map", name="landing_gnss_only"), 300)
    assert np.all((full > 0.9) & (full < 1.15)), full
    assert np.all((part > 0.9) & (part < 1.15)), part


def test_smoothed_errors_are_smaller_and_the_last_is_the_filters() -> None:
    """In the small-angle world the last output is that of a filter; before it, later fixes help."""
    settings = ("imu.gyro.drift_deg_h=7", "initial_errors.attitude_deg=0.05", "receiver.rate_hz=1")
    filtered = case(*settings, "receiver.latency_s=0.253").fly(1, 0)
    smoothed = case(*settings, "receiver.latency_s=0.253", "filter.kind=map").fly(1, 0)
    np.testing.assert_allclose(smoothed.sigma[-1], filtered.sigma[-1], rtol=2e-3)
    np.testing.assert_allclose(smoothed.error[-1], filtered.error[-1], atol=1e-2 * filtered.sigma[-1].max(), rtol=0)
    assert np.all(np.abs(smoothed.error[-1] - filtered.error[-1]) < 0.02 * filtered.sigma[-1])
    assert np.all(smoothed.sigma[40, :6] < 0.9 * filtered.sigma[40, :6])


def test_one_backward_pass_is_nearly_the_iterated_smoother() -> None:
    """`rts` halves the filter's position error and comes within a few percent of `map`, which iterates it."""
    rms = []
    for kind in ("tfg", "rts", "map"):
        flown = case(f"filter.kind={kind}", "receiver.rate_hz=2", "approach.pitch=level")
        errors = fly_all(flown, 1, 0, 8, threads())["error"][:, 10:-10, :3]
        rms.append(np.sqrt(np.mean(errors**2)))
    assert rms[1] < 0.75 * rms[0]
    assert rms[1] == pytest.approx(rms[2], rel=0.05)
