"""Misalignments of gyros and accelerometers as twelve more states, and g-sensitivity, in the covariance analysis."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.filter import states
from navsim.landing.covariance import covariance_findings
from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from navsim.scenario.estimated_errors import gain_states
from navsim.scenario_files.source import InputError
from navsim.sensors.imu import SensorErrors
from navsim.simulation.inertial_states import true_values
from tests.helpers import case, ratios, scenario

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1", "duration_s=60")
ASKEW = ("imu.gyro.misalignment_mrad=10", "imu.accelerometer.misalignment_mrad=10")
FOLLOWED = "filter.misalignments=true"


@pytest.mark.parametrize("kind", ["eskf", "left-invariant", "tfg"])
def test_a_filter_that_follows_them_is_true(kind: str) -> None:
    """27 states in an S-turn, 200 runs: NEES of all, and of position and velocity, in the bands of the default; yaw
    rate and gravity show some, and none is seen that nothing excites. States are named by both axes."""
    flown = case(*GENTLE, *ASKEW, FOLLOWED, f"filter.kind={kind}", name="s_turn")
    assert flown.states[15:18] == tuple(f"gyro_misalignment_next_{axes}" for axes in ("xy", "yz", "zx"))
    assert flown.states[24:] == tuple(f"accelerometer_misalignment_previous_{axes}" for axes in ("xz", "yx", "zy"))
    runs = fly_all(flown, 104, 0, 200, threads())
    for name, size in (("nees", 27), ("nees_position_velocity", 6)):
        nees = runs[name].mean(axis=0)[10::10] / size
        assert np.all((nees > 0.9) & (nees < 1.15)), (name, nees)
    sigma = runs["sigma"][:, -1].mean(axis=0)
    for seen in ("gyro_misalignment_next_yz", "accelerometer_misalignment_previous_xz"):
        assert sigma[flown.states.index(seen)] < 0.75 * 0.01
    assert sigma[flown.states.index("accelerometer_misalignment_previous_zy")] > 0.99 * 0.01


def test_what_the_states_are_judged_by() -> None:
    """Each state has the gain from the axis that its name says."""
    flown = case(*ASKEW, FOLLOWED, "duration_s=5", name="s_turn")
    cross = np.arange(18.0).reshape(2, 3, 3, 1)

    errors = SensorErrors(
        np.zeros((1, 6, 1)), np.zeros((6, 1)), cross, force=np.zeros((3, 3, 1)), clipped=np.zeros((2, 1))
    )
    values = true_values(flown.design.sensors.blocks, errors)[0, :, 0]
    for value, name in zip(values[6:], flown.states[15:], strict=True):
        to, felt = ("xyz".index(axis) for axis in name[-2:])
        assert value == cross[int(name.startswith("acc")), to, felt, 0]


@pytest.mark.parametrize("tight", [(), ("filter.coupling=tight",)], ids=["loose", "tight"])
def test_the_analysis_of_what_is_followed_is_exact(tight: tuple[str, ...]) -> None:
    """A filter that follows what there is expects the innovations it gets, to 1e-6, without a run."""
    flown = case(*GENTLE, *ASKEW, FOLLOWED, *tight, "duration_s=30", name="s_turn")
    analysis = covariance_analysis(flown)
    assert analysis.sources[14:16] == ("gyro_misalignment", "accelerometer_misalignment")
    some = analysis.degrees > 0
    np.testing.assert_allclose(analysis.nis[some] / analysis.degrees[some], 1.0, atol=1e-6)


def test_runs_agree_with_the_analysis() -> None:
    """Not followed, and g-sensitivity, which no filter follows: 400 runs within 16 % (4.5 sigma of the sampling)."""
    small = "imu.gyro.misalignment_mrad=5", "imu.accelerometer.misalignment_mrad=5", "filter.misalignments=false"
    flown = case(*GENTLE, *small, "imu.gyro.g_sensitivity_deg_h_g=100", name="s_turn")
    runs = fly_all(flown, 13, 0, 400, threads())
    analysis = covariance_analysis(flown)
    assert analysis.sources[-3:] == ("gyro_misalignment", "accelerometer_misalignment", "gyro_g_sensitivity")
    for of_source in analysis.variance[-3:]:
        assert of_source[-1, states.VEL] > 0.01**2
    ratio = ratios(runs, analysis, [*range(10, 61, 10)])
    assert np.all(np.abs(ratio - 1.0) < 0.16), ratio


def test_sensors_without_some_have_no_states() -> None:
    """What the filter takes for none, of gyros or accelerometers, has no states, which would count as degrees of
    freedom; estimates of results count the same, and a filter that is told the truth is true."""
    half = case(FOLLOWED, "imu.gyro.misalignment_mrad=3", *GENTLE, name="s_turn")
    assert half.groups[5:] == ("gyro_misalignment_next", "gyro_misalignment_previous")
    assert len(half.states) == half.scenario.filter.states(1, gain_states(half.scenario)) == 21
    square = covariance_analysis(half).expected_square(slice(0, 21))
    np.testing.assert_allclose(square, 1.0, atol=1e-3)
    told = "filter.imu={gyro: {misalignment_mrad: 0, scale_ppm: 5}, accelerometer: {scale_ppm: 0}}"
    other = case(FOLLOWED, "filter.scale_factors=true", told, *ASKEW, "imu.accelerometer.scale_ppm=9", "duration_s=5")
    gains = ("gyro_scale", "accelerometer_misalignment_next", "accelerometer_misalignment_previous")
    assert other.groups[5:] == gains
    assert len(other.states) == other.scenario.filter.states(1, gain_states(other.scenario)) == 24


def test_a_range_that_the_route_meets_is_told() -> None:
    flown = case("imu.gyro.range_deg_s=2", "imu.accelerometer.range_g=8", "duration_s=60", name="s_turn")
    said = [finding.text for finding in covariance_findings(flown, covariance_analysis(flown))]
    assert sum("beyond imu.gyro.range_deg_s: the covariance analysis leaves" in text for text in said) == 1
    assert not any("imu.accelerometer.range_g" in text for text in said)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ((FOLLOWED,), "filter.misalignments"),
        (("filter.imu={gyro: {misalignment_mrad: 1}}",), "filter.imu.gyro.misalignment_mrad"),
        (("method=rare", "box={lateral_m: 1}", *ASKEW), "imu.gyro.misalignment_mrad"),
    ],
)
def test_refused(settings: tuple[str, ...], key: str) -> None:
    with pytest.raises(InputError) as caught:
        scenario(*settings)
    assert [problem.key for problem in caught.value.problems] == [key]
