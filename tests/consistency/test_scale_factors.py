"""Scale factors of gyros and accelerometers: as errors of the truth, and as six more states of the filter."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.filter import states
from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from tests.helpers import case, in_brief, ratios

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1", "duration_s=60")
SCALED = ("imu.gyro.scale_ppm=20000", "imu.accelerometer.scale_ppm=20000")
"""Two percent: large enough to be seen within a minute of turns."""
FOLLOWED, IGNORED = "filter.scale_factors=true", "filter.scale_factors=false"


@pytest.mark.parametrize("kind", in_brief(["eskf", "left-invariant", "tfg", "gaussian-sum"], 0, 3))
def test_a_filter_that_follows_them_is_true(kind: str) -> None:
    """21 states in an S-turn: NEES of all, and of each group at the end, in the bands of the default (0.9 to 1.15)."""
    flown = case(*GENTLE, *SCALED, FOLLOWED, f"filter.kind={kind}", name="s_turn")
    assert len(flown.states) == 21
    runs = fly_all(flown, 11, 0, 400, threads())
    full = runs["nees"].mean(axis=0)[[10, 20, 30, 40, 50, 60]] / 21
    assert np.all((full > 0.9) & (full < 1.15)), full
    groups = runs["nees_group"][:, 30:].mean(axis=(0, 1)) / 3
    assert np.all((groups > 0.85) & (groups < 1.2)), dict(zip(flown.groups, groups, strict=True))
    # what can be seen is seen: the gyro about the axis that turns, the accelerometer along gravity
    sigma = runs["sigma"][:, -1].mean(axis=0)
    assert sigma[flown.states.index("accelerometer_scale_z")] < 0.5 * 0.02
    assert sigma[flown.states.index("gyro_scale_x")] < 0.5 * 0.02


def test_a_filter_that_does_not_know_of_them_is_worse_and_untrue() -> None:
    wise = fly_all(case(*GENTLE, *SCALED, FOLLOWED, name="s_turn"), 12, 0, 150, threads())
    ignorant = fly_all(case(*GENTLE, *SCALED, IGNORED, name="s_turn"), 12, 0, 150, threads())
    np.testing.assert_array_equal(wise["pseudorange"], ignorant["pseudorange"])  # the same flights
    late = slice(30, None)
    attitude = slice(states.ATT, states.SENSORS)
    assert np.mean(wise["error"][:, late, attitude] ** 2) < 0.7 * np.mean(ignorant["error"][:, late, attitude] ** 2)
    assert ignorant["nees"].mean(axis=0)[late].mean() / 15 > 1.3


@pytest.mark.parametrize("settings", in_brief([(FOLLOWED,), (IGNORED,)], 0, whole=True), ids=["followed", "ignored"])
def test_runs_agree_with_the_analysis(settings: tuple[str, ...]) -> None:
    """Every component of position and velocity at every 10 s, 400 runs within 16 % (4.5 sigma of the sampling)."""
    small = ("imu.gyro.scale_ppm=5000", "imu.accelerometer.scale_ppm=5000")
    flown = case(*GENTLE, *small, *settings, name="s_turn")
    runs = fly_all(flown, 13, 0, 400, threads())
    analysis = covariance_analysis(flown)
    assert analysis.sources[-2:] == ("gyro_scale", "accelerometer_scale")
    ratio = ratios(runs, analysis, [*range(10, 61, 10)])
    assert np.all(np.abs(ratio - 1.0) < 0.16), ratio


PHONE = (
    "imu={preset: icm-42688-p, gyro: {bias_instability_deg_h: 10}, accelerometer: {bias_instability_mg: 0.05}}",
    "receiver.rate_hz=1",
)


def test_the_default_follows_those_that_are_large() -> None:
    """By size and flight: a phone's, whose accelerometer bias would be off by 40 sigma at the end; not those that noise
    hides, nor a gyro's where nothing turns; with them the filter is true to first order."""
    phone = case(*PHONE)
    assert phone.groups[5:] == ("gyro_scale", "accelerometer_scale")
    square = covariance_analysis(phone).expected_square(slice(0, 21))
    assert 0.9 < square.min() < square.max() < 1.02  # a little cautious: one state for constant and wandering bias
    bias = slice(states.ACCEL + 2, states.ACCEL + 3)
    assert covariance_analysis(case(*PHONE, IGNORED)).expected_square(bias)[-1] > 100.0
    tiny = ("imu.gyro.scale_ppm=1", "imu.accelerometer.scale_ppm=1")
    assert case(*tiny, "duration_s=20").groups[5:] == ()
    straight = case(*PHONE, "duration_s=20")  # before the flare, 5 deg down without a turn
    assert straight.groups[5:] == ("accelerometer_scale",)


def test_without_them_nothing_is_drawn() -> None:
    """A scale of zero takes no random numbers: flights are those without the key, to the bit."""
    a, b = (case("duration_s=20", *more).fly(1, 0) for more in ((), ("imu.gyro.scale_ppm=0",)))
    np.testing.assert_array_equal(a.error, b.error)
