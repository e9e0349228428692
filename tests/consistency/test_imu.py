"""Simulated sensor noise against the Allan variance, by allantools."""

from __future__ import annotations

import math
import re
from typing import get_args

import allantools
import numpy as np
import pytest

from navsim.landing.result import result
from navsim.landing.study import findings, fly_all
from navsim.runner.executor import threads
from navsim.scenario.imu import ImuPreset, TrueAccelerometer, TrueGyro
from navsim.scenario_files.base import DEG_H, MG
from navsim.scenario_files.presets import IMU_PRESETS, IMU_SHEETS
from navsim.scenario_files.source import InputError
from navsim.sensors.imu import (
    MARKOV_PEAK,
    Triad,
    flicker_of_lowest,
    simulate,
)
from navsim.sensors.imu_errors import ImuErrorModel
from navsim.statistics.random_streams import generator
from tests.formulas import allan_variance
from tests.helpers import case, scenario

RATE = 100.0
HOUR = int(3600 * RATE)


def static_rates(run: int, gyro: Triad, accel: Triad, n: int, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Angular rate and specific force errors (n, 3) of a standing IMU."""
    still = np.zeros((n, 3))
    dtheta, dv, _ = simulate(generator(1, run, "imu"), still, still, 1 / rate, gyro, accel)
    return dtheta * rate, dv * rate


def test_random_walk_coefficients_come_back() -> None:
    """ARW and VRW from one static hour within 3 %, from the -1/2 slope of the Allan deviation, 0.1-1 s."""
    imu = scenario("imu.gyro={noise_deg_h: 30}", "imu.accelerometer={noise_mg: 10}").imu
    triads = imu.gyro.triad(RATE), imu.accelerometer.triad(RATE)
    assert triads[0].noise_density * 180 / np.pi * 60 == pytest.approx(0.05)  # deg/sqrt(h)
    records = static_rates(0, *triads, HOUR, RATE)
    taus = np.geomspace(0.1, 1.0, 10)
    for record, triad in zip(records, triads, strict=True):
        for axis in range(3):
            tau, deviation, _, _ = allantools.oadev(record[:, axis], rate=RATE, data_type="freq", taus=taus)
            slope, _ = np.polyfit(np.log(tau), np.log(deviation), 1)
            assert slope == pytest.approx(-0.5, abs=0.03)
            coefficient = np.exp(np.mean(np.log(deviation * np.sqrt(tau))))
            assert coefficient == pytest.approx(triad.noise_density, rel=0.03)


def test_gauss_markov_follows_its_closed_form() -> None:
    """Mean Allan variance of 100 static hours of three axes, 1 s to 600 s: within 7 % of the closed form.

    At 20 Hz: what a second of samples adds up to does not depend on their rate.
    """
    rate = 20.0
    gyro = Triad(bias=1e-3, noise_density=3e-4, markov=5e-4, markov_time=40.0)
    accel = Triad(bias=1e-2, noise_density=1e-2, markov=2e-2, markov_time=150.0)
    taus = np.array([1, 2, 5, 10, 20, 50, 100, 200, 400, 600.0])
    total = np.zeros((2, taus.size))
    for run in range(100):
        for i, record in enumerate(static_rates(run, gyro, accel, int(3600 * rate), rate)):
            for axis in range(3):
                _, deviation, _, _ = allantools.oadev(record[:, axis], rate=rate, data_type="freq", taus=taus)
                total[i] += deviation**2
    ratio = total / 300 / np.array([allan_variance(gyro, taus), allan_variance(accel, taus)])
    np.testing.assert_allclose(ratio, 1.0, atol=0.07)


def sheet_triad(preset: str, name: str, rate: float = RATE) -> tuple[Triad, float]:
    """A sensor of a data sheet, its lowest Allan deviation as printed, SI; what the sheet lacks is 0."""
    section = {"gyro": TrueGyro, "accelerometer": TrueAccelerometer}[name].model_validate(IMU_PRESETS[preset][name])
    lowest = IMU_PRESETS[preset][name].get(f"bias_instability_{'deg_h' if name == 'gyro' else 'mg'}", 0.0)
    return section.triad(rate), lowest * (DEG_H if name == "gyro" else MG)


@pytest.mark.parametrize("name", ["gyro", "accelerometer"])
@pytest.mark.parametrize("preset", IMU_SHEETS)
def test_the_bottom_of_the_curve_is_flat(preset: str, name: str) -> None:
    """From where white noise ends (or four samples) to the peak of the slowest term the Allan deviation is what the
    sheet prints, within 10 %, and nowhere before that is it less. One Markov term dips to a tenth."""
    triad, lowest = sheet_triad(preset, name)
    if not lowest:
        pytest.skip("the sheet has none")
    end, white = MARKOV_PEAK[0] * triad.markov_time, (triad.noise_density / lowest) ** 2
    taus = np.geomspace(4.0 / RATE, end, 300)
    deviation = np.sqrt(allan_variance(triad, taus)) / lowest
    assert deviation.min() >= 0.9
    assert deviation[-1] == pytest.approx(1.0, abs=1e-6)
    flat = deviation[taus >= 4.0 * white]
    assert flat.max(initial=1.0) <= 1.13  # white noise is a fourth of the variance at the beginning, 12 %
    assert deviation[taus >= 6.0 * white].max(initial=1.0) <= 1.1
    assert len(triad.markovs) <= 4


@pytest.mark.parametrize("time", [53.0, 100.0, 300.0])
@pytest.mark.parametrize("interval", [0.0025, 0.01, 0.1])
def test_the_bottom_is_flat_with_any_white_noise(interval: float, time: float) -> None:
    """From none to as much as a single term allows."""
    for end_of_white in np.geomspace(1e-4, 1.8 * time, 25):
        terms = flicker_of_lowest(1.0, math.sqrt(end_of_white), time, interval)
        triad = Triad(0.0, math.sqrt(end_of_white), *terms[0], further=ImuErrorModel(flicker=terms[1:]))
        taus = np.geomspace(4.0 * interval, MARKOV_PEAK[0] * time, 200)
        deviation = np.sqrt(allan_variance(triad, taus))
        assert deviation.min() >= 0.89
        assert deviation[taus >= 6.0 * end_of_white].max(initial=1.0) <= 1.1


def test_what_a_filter_makes_of_flicker_noise() -> None:
    """One Markov bias of the variance and the growth of the slower terms, white noise for the faster ones."""
    triad = Triad(1.0, 0.1, 3.0, 100.0, further=ImuErrorModel(flicker=((2.0, 8.0), (1.5, 0.5))))
    merged = triad.merged()
    assert merged.markov == pytest.approx(math.sqrt(13.0))
    assert merged.drive() == pytest.approx(2.0 * 9.0 / 100.0 + 2.0 * 4.0 / 8.0)
    assert merged.noise_density == pytest.approx(math.sqrt(0.01 + 2.0 * 1.5**2 * 0.5))
    assert merged.further.flicker == ()
    plain = Triad(1.0, 0.1, 3.0, 100.0)
    assert plain.merged() is plain


@pytest.mark.parametrize(
    "sensor",
    ["imu={preset: adis16488}",
     "imu={preset: hg1700, gyro: {drift_deg_h: 3}, accelerometer: {bias_mg: 1}}"],
)  # fmt: skip
def test_a_filter_of_flicker_noise_is_consistent(sensor: str) -> None:
    """NEES of 48 runs between 0.8 and 1.1 per state: what the filter believes of flicker noise is a little too much."""
    rates = ("imu.rate_hz=50", "receiver.rate_hz=5", "initial_errors.attitude_deg=0.5")
    flown = case(sensor, *rates, name="landing_smooth")
    found = result(flown, fly_all(flown, 1, 0, 48, threads(1), keep="none"), 1, keep="none")
    assert 0.8 < np.nanmean(found["/summary/consistency/nees"]) < 1.1
    assert 0.8 < np.nanmean(found["/summary/consistency/nees_position_velocity"]) < 1.1


def test_flicker_noise_by_allantools() -> None:
    """Three static hours of three axes, of hg1700's and adis16488's accelerometers, at 20 Hz: 0.2 to 180 s within the
    sampling error of the closed form, and within 10 % of the sheet where it is flat."""
    rate, taus = 20.0, np.array([0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 180.0])
    (one, its), (other, lowest) = (sheet_triad(preset, "accelerometer", rate) for preset in ("hg1700", "adis16488"))
    total = np.zeros((2, taus.size))
    for run in range(12):
        for i, record in enumerate(static_rates(run, one, other, int(3600 * rate), rate)):
            for axis in range(3):
                total[i] += allantools.oadev(record[:, axis], rate=rate, data_type="freq", taus=taus)[1] ** 2
    deviation = np.sqrt(total / 36)
    sampling = 0.05 + 0.1 * np.sqrt(taus / 180.0)  # of the shortest the steps of the fastest term are a part
    for found, triad in zip(deviation, (one, other), strict=True):
        ratio = found / np.sqrt(allan_variance(triad, taus))
        assert (np.abs(ratio - 1.0) < sampling).all()
    np.testing.assert_allclose(deviation[0] / its, 1.0, atol=0.12)
    np.testing.assert_allclose(deviation[1, 2:] / lowest, 1.0, atol=0.12)


def test_gauss_markov_is_stationary() -> None:
    gyro = Triad(bias=0.0, noise_density=0.0, markov=1.0, markov_time=5.0)
    accel = Triad(bias=0.0, noise_density=0.0)
    still = np.zeros((2000, 3))
    biases = np.stack([simulate(generator(2, r, "imu"), still, still, 0.1, gyro, accel)[2].bias for r in range(300)])
    spread = biases[:, ::100, :3].std(axis=(0, 2))
    np.testing.assert_allclose(spread, 1.0, atol=0.1)
    lag = np.mean(biases[:, :-50, :3] * biases[:, 50:, :3])
    assert lag == pytest.approx(np.exp(-1.0), abs=0.03)


def test_the_two_spellings_of_noise_are_one() -> None:
    per_sample = scenario("imu.gyro={noise_deg_h: 30}").imu.gyro.triad(RATE)
    density = scenario("imu.gyro={arw_deg_sqrt_h: 0.05}").imu.gyro.triad(RATE)
    assert per_sample.noise_density == pytest.approx(density.noise_density, rel=1e-12)
    per_sample = scenario("imu.accelerometer={noise_mg: 10}").imu.accelerometer.triad(RATE)
    assert per_sample.noise_density == pytest.approx(0.0980665 / 10.0)


def test_biases_are_drawn_per_axis_or_fixed() -> None:
    imu = scenario("imu.gyro.drift_fixed_deg_h=[10, -20, 30]").imu
    gyro, accel = imu.gyro.triad(RATE), imu.accelerometer.triad(RATE)
    still = np.zeros((5, 3))
    drawn = []
    for run in range(2000):
        bias = simulate(generator(1, run, "imu"), still, still, 0.01, gyro, accel)[2].bias
        np.testing.assert_allclose(np.degrees(bias[0, :3]) * 3600, [10, -20, 30])
        assert np.all(bias == bias[0])
        drawn.append(bias[0, 3:])
    spread = np.std(drawn, axis=0) / 9.80665e-3
    np.testing.assert_allclose(spread, 1.0, atol=0.06)


def test_increments_carry_bias_and_truth() -> None:
    gyro = Triad(bias=0.0, noise_density=0.0, fixed_bias=(1e-3, 2e-3, -1e-3))
    accel = Triad(bias=0.0, noise_density=0.0, fixed_bias=(0.1, 0.0, -0.2))
    dtheta, dv = np.random.default_rng(0).standard_normal((2, 10, 3))
    out_theta, out_v, _ = simulate(generator(1, 1, "imu"), dtheta, dv, 0.01, gyro, accel)
    np.testing.assert_allclose(out_theta - dtheta, 0.01 * np.array([[1e-3, 2e-3, -1e-3]] * 10), atol=1e-16)
    np.testing.assert_allclose(out_v - dv, 0.01 * np.array([[0.1, 0.0, -0.2]] * 10), atol=1e-15)


FURTHER = (
    "imu.gyro={drift_deg_h: 70, arw_deg_sqrt_h: 0.05, misalignment_mrad: 0.5, asymmetry_ppm: 200, ramp_deg_h_h: 30, "
    "nonlinearity_ppm_deg_s: 5, g_sensitivity_deg_h_g: 3, rate_random_walk_deg_h_sqrt_h: 20, quantum_urad: 20, "
    "bandwidth_hz: 45, temperature_deg_h_k: 1, rectification_deg_h_g2: 1, sine_deg_h: 20, sine_hz: 0.5}",
    "imu.accelerometer={bias_mg: 1, vrw_m_s_sqrt_h: 0.1, misalignment_mrad: 0.5, asymmetry_ppm: 200, ramp_mg_h: 1, "
    "nonlinearity_ug_g2: 50, bias_random_walk_mg_sqrt_h: 1, quantum_mm_s: 0.5, bandwidth_hz: 45, "
    "temperature_mg_k: 0.01, rectification_ug_g2: 100, sine_mg: 0.2, sine_hz: 0.5}",
    "imu.vibration={lines: [{amplitude_g: 0.5, frequency_hz: 33}], psd: [[20, 0.001], [200, 0.001]]}",
    "imu.temperature={ramp_k_min: 1, warm_up_k: 10}",
)
"""All of them, of sizes that the filter bears without knowing of them."""


@pytest.mark.parametrize("kind", ["tfg", pytest.param("eskf", marks=pytest.mark.long)])
def test_landing_with_every_error(kind: str) -> None:
    """Position and velocity NEES/6 of 200 runs at every 10 s within 0.9 to 1.15."""
    gentle = "receiver.rate_hz=1", "initial_errors.attitude_deg=1"
    flown = case(*FURTHER, *gentle, f"filter.kind={kind}", name="s_turn")
    runs = fly_all(flown, 21, 0, 200, threads())
    nees = runs["nees_position_velocity"].mean(axis=0)[10::10] / 6
    assert np.all((nees > 0.9) & (nees < 1.15)), nees


def test_what_is_beyond_the_range_is_counted() -> None:
    """In runs, in the result and as a finding; without a range there is nothing of it."""
    limits = "imu.gyro.range_deg_s=2", "imu.accelerometer.range_g=5", "duration_s=60"
    flown = case(*limits, name="s_turn")
    ensemble = fly_all(flown, 1, 0, 10, threads(), keep="none")
    count = ensemble.per_run("clipped")
    assert count.shape == (10, 2)
    rates = np.abs(flown.shared.dtheta / np.diff(flown.shared.imu_time)[:, None]).max(axis=1)
    assert count[:, 0] == pytest.approx(np.full(10, np.sum(rates > np.radians(2.0))), rel=0.1)
    assert not count[:, 1].any()
    found = [f for f in findings(flown, ensemble) if f.name == "clipped_samples"]
    assert [f.count for f in found] == [count[:, 0].sum()]
    assert "of the gyros are beyond their range" in found[0].text
    free = fly_all(case("duration_s=60", name="s_turn"), 1, 0, 2, threads(), keep="none")
    with pytest.raises(KeyError):
        free.per_run("clipped")


RARE = "method=rare"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("imu.gyro={arw_deg_sqrt_h: 0.002, bias_instability_deg_h: 0.0035}",), "give a markov_time_s above 621 s"),
        (("imu.gyro={markov_deg_h: 1, bias_instability_deg_h: 1}",), "two spellings of one correlated drift"),
        (("imu.gyro={sine_deg_h: 1}",), "a sine needs its amplitude and its frequency"),
        (("imu.gyro={damping: 0.5}",), "is for sensors with a bandwidth_hz"),
        (("imu.accelerometer={rectification_ug_g2: 1}",), "is by imu.vibration, and there is none"),
        (("imu.accelerometer={temperature_mg_k: 1}",), "is by imu.temperature, and there is none"),
        (("imu.vibration={psd: [[20, 0.1]]}",), "needs two points or more"),
        (("imu.vibration={psd: [[20, 0.1], [10, 0.1]]}",), "frequencies must increase"),
        (("method=covariance", "imu.gyro.asymmetry_ppm=1"), "only Monte Carlo models it"),
        (("method=covariance", "imu.vibration={lines: []}"), "only Monte Carlo models it"),
        ((RARE, "imu.gyro.asymmetry_ppm=1"), "only Monte Carlo models it"),
        ((RARE, "imu.gyro.misalignment_mrad=1"), "covariance analysis has it.*: `misalignment_mrad: 0`"),
        ((RARE, "imu.accelerometer.range_g=10"), "covariance analysis has it.*: `range_g: null`"),
    ],
)
def test_refused(settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        scenario(*settings)


ASKED = {
    "imu.gyro.drift_deg_h": 10, "imu.accelerometer.bias_mg": 1, "imu.accelerometer.vrw_m_s_sqrt_h": 0.01,
    "imu.gyro.bias_instability_deg_h": 0, "imu.accelerometer.bias_instability_mg": 0,
}  # fmt: skip
"""What one data sheet or another does not give."""
BARE = "imu={preset: %s}"


@pytest.mark.parametrize("preset", IMU_SHEETS)
def test_presets_of_data_sheets(preset: str) -> None:
    """Ask for what they lack, one key after another, and then are what they say; the lowest point of the Allan
    deviation is the one printed."""
    settings, asked = [BARE % preset], []
    for _ in ASKED:
        try:
            imu = scenario(*settings).imu
        except InputError as error:
            (problem,) = error.problems
            assert f"data sheet of {preset}" in problem.message
            asked.append(problem.key)
            settings.append(f"{problem.key}={ASKED[problem.key]}")
    for sensor, name in ((imu.gyro, "gyro"), (imu.accelerometer, "accelerometer")):
        given = sensor.model_dump(exclude_none=True)
        values = IMU_PRESETS[preset][name]
        assert {key: given.pop(key) for key in values} == values
        assert {f"imu.{name}.{key}" for key in given} == {key for key in asked if f".{name}." in key}
        unit = DEG_H if name == "gyro" else MG
        lowest = next(value for key, value in sensor.model_dump().items() if key.startswith("bias_instability"))
        triad = sensor.triad(imu.rate_hz)
        if lowest:
            at = np.array([MARKOV_PEAK[0] * triad.markov_time])
            assert math.sqrt(allan_variance(triad, at)[0]) == pytest.approx(lowest * unit, rel=1e-6)


def test_the_paper_gives_nothing_unasked() -> None:
    """A sensor of which something is said has to be told in full, or to name the paper; what is null is not told."""
    own = "imu={gyro: {drift_deg_h: 5, arw_deg_sqrt_h: 0.1}, accelerometer: {bias_mg: 1, noise_mg: 0}}"
    whole = scenario(own).imu
    assert (whole.preset, whole.gyro.scale_ppm, whole.accelerometer.noise_mg) == ("none", None, 0.0)
    assert scenario("imu={rate_hz: 50, gyro: {}}").imu.gyro.drift_deg_h == 700.0
    assert scenario("imu={preset: paper, gyro: {drift_deg_h: 5}}").imu.gyro.noise_deg_h == 30.0
    assert scenario("imu={preset: stim300, gyro: {drift_deg_h: 5}, accelerometer: {range_g: ~}}").imu.limited() is False
    for settings, key, more in (
        ("imu={gyro: {scale_ppm: 100}}", "imu.gyro.drift_deg_h", "imu.gyro.arw_deg_sqrt_h (or noise_deg_h), imu.acc"),
        ("imu={gyro: {drift_fixed_deg_h: [1, 0, 0], noise_deg_h: 0}}", "imu.accelerometer.bias_mg", "vrw_m_s_sqrt_h"),
        ("imu={preset: paper, gyro: {noise_deg_h: ~}}", "imu.gyro.noise_deg_h", "give it or arw_deg_sqrt_h, 0"),
        (
            "imu={preset: stim300, gyro: {drift_deg_h: 5, bias_instability_deg_h: ~}}",
            "imu.gyro.bias_instability_deg_h",
            "removes a value of preset stim300; give it or markov_deg_h, 0",
        ),
    ):
        with pytest.raises(InputError, match=re.escape(more)) as caught:
            scenario(settings)
        assert [p.key for p in caught.value.problems] == [key]


UNFOLLOWED = "filter={scale_factors: false, misalignments: false}"


def test_gains_of_a_sheet_that_nobody_follows_are_told() -> None:
    sheet = ("duration_s=2", "receiver.rate_hz=1", "imu={preset: stim300, gyro: {drift_deg_h: 10}}")
    told = "imu.preset: stim300 has scale factors and misalignments, which the filter model lacks: give filter.scale"
    assert [said for said in case(*sheet, UNFOLLOWED).warnings if said.startswith(told)]
    followed = case(*sheet, UNFOLLOWED, "filter.scale_factors=true").warnings
    assert "has misalignments, which the filter model lacks: give filter.misalignments: true" in " ".join(followed)
    assert "imu.preset" not in " ".join(case(*sheet).warnings)


def test_gains_given_by_hand_that_nobody_follows_are_told() -> None:
    own = ("duration_s=2", "receiver.rate_hz=1", "imu={preset: paper, gyro: {scale_ppm: 300}}", UNFOLLOWED)
    told = "imu.gyro.scale_ppm: the sensors have scale factors, which the filter model lacks: give filter.scale_fact"
    assert [said for said in case(*own).warnings if said.startswith(told)]
    both = case(*own, "imu.accelerometer={scale_ppm: 100, misalignment_mrad: 1}", "filter.scale_factors=true").warnings
    told = "imu.accelerometer.misalignment_mrad: the sensors have misalignments, which the filter model lacks"
    assert [said for said in both if told in said]
    assert "imu." not in " ".join(case(*own, "filter.scale_factors=true", "imu.gyro.misalignment_mrad=0").warnings)


def test_names_of_presets() -> None:
    assert scenario("imu.preset=adis16488").imu.gyro.drift_deg_h == 720.0
    assert set(get_args(ImuPreset)) == {*IMU_PRESETS, "none"}
    assert IMU_SHEETS.keys() == IMU_PRESETS.keys() - {"paper", "perfect"}
