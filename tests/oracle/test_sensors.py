"""Every error of inertial sensors by itself against its closed form, and all of them together."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import allantools
import numpy as np
import pytest

from navsim.scenario.imu import G
from navsim.scenario_files.base import DEG, DEG_H, DEG_SQRT_H
from navsim.sensors.imu import (
    MARKOV_PEAK,
    ImuDraws,
    SensorErrors,
    Triad,
    density_from_sample_sigma,
    markov_of_lowest,
    simulate,
    simulate_lanes,
)
from navsim.sensors.imu_errors import Gains, ImuErrorModel, Vibration, Warming, apply_bandwidth, shaking
from navsim.statistics.noise import draw_normals
from navsim.statistics.random_streams import generator, normals
from tests.conftest import DATA, Within
from tests.formulas import allan_variance
from tests.helpers import scenario

RATE = 100.0
DT = 1.0 / RATE
PERFECT = Triad(bias=0.0, noise_density=0.0)


@pytest.fixture(scope="module")
def known() -> dict[str, Any]:
    return json.loads((DATA / "sensors.json").read_text())


def test_numbers_drawn_in_a_kernel_are_those_of_numpy() -> None:
    """In the tails, too, which the ziggurat algorithm draws in another way; the stream goes on as numpy's does."""
    own, numpys = generator(41, 3, "imu"), generator(41, 3, "imu")
    drawn = np.empty(2_000_000)
    draw_normals(own, drawn)
    np.testing.assert_array_equal(drawn, numpys.standard_normal(drawn.size), strict=True)
    assert np.abs(drawn).max() > 4.5, "no tail was drawn"
    after = normals((own, generator(41, 4, "imu")), 2, 3)
    expected = [numpys.standard_normal((2, 3)), generator(41, 4, "imu").standard_normal((2, 3))]
    np.testing.assert_array_equal(after, expected)


def measured(
    rate: np.ndarray, force: np.ndarray, gyro: ImuErrorModel, accel: ImuErrorModel, run: int = 0
) -> tuple[np.ndarray, np.ndarray, SensorErrors]:
    """Errors of measured rates and specific forces (n, 3) of sensors that are perfect beside, and what is behind
    them."""
    triads = (replace(PERFECT, further=what) for what in (gyro, accel))
    dtheta, dv, errors = simulate(generator(3, run, "imu"), rate * DT, force * DT, DT, *triads)
    return dtheta / DT - rate, dv / DT - force, errors


def drawn(what: ImuErrorModel, triad: int, run: int = 0) -> Gains:
    """The gains that `measured` has."""
    return Gains.drawn(what, triad, (generator(3, run, "imu"),))


def sine(peak: float, frequency: float = 1.0, seconds: float = 20.0) -> np.ndarray:
    """A rate (n, 3) about each axis, means over intervals."""
    omega, time = 2.0 * math.pi * frequency, DT * np.arange(round(seconds * RATE) + 1)
    return np.repeat((peak / omega / DT * -np.diff(np.cos(omega * time)))[:, None], 3, axis=1)


NONE = ImuErrorModel()


@pytest.mark.validates("Effect of scale factor, misalignment, asymmetry, nonlinearity and g-sensitivity",
                       "closed forms: a turn of 360 degrees, a sine", effect="1 %")  # fmt: skip
def test_gains(known: dict[str, Any], within: Within) -> None:
    """Scale factor, misalignment, asymmetry, nonlinearity and g-sensitivity by what they do for one sigma."""
    told, close = known["imu_single_terms"], within["effect"]
    turn, none = np.zeros((1000, 3)), np.zeros((1000, 3))
    turn[:, 2] = 36.0 * DEG
    scaled = replace(PERFECT, scale=500e-6)
    dtheta, _, errors = simulate(generator(3, 0, "imu"), turn * DT, none, DT, scaled, PERFECT)
    effect = (dtheta.sum(axis=0) - 360.0 * DEG * np.array([0, 0, 1]))[2] / (errors.scale[2] / 500e-6)
    assert effect / DEG == pytest.approx(told["scale_500ppm_360deg_deg"], rel=close)

    rate, _, errors = measured(turn, none, ImuErrorModel(misalignment=1e-3), NONE)
    effect = rate.sum(axis=0)[:2] * DT / (errors.cross[0, :2, 2] / 1e-3)
    assert effect / DEG == pytest.approx([told["misalignment_1mrad_360deg_deg"]] * 2, rel=close)
    assert np.all(errors.cross[:, range(3), range(3)] == 0.0)
    assert np.all(errors.cross[1] == 0.0)

    what = ImuErrorModel(asymmetry=200e-6)
    rate, _, _ = measured(sine(60.0 * DEG), np.zeros((2000, 3)), what, NONE)
    effect = rate.mean(axis=0) / (drawn(what, 0).uneven[:, 0] / 200e-6)
    assert effect / DEG == pytest.approx([told["asymmetry_200ppm_60deg_s_sine_mean_deg_s"]] * 3, rel=close)

    what = ImuErrorModel(nonlinearity=0.01)
    force = sine(2.0)
    _, rest, _ = measured(np.zeros_like(force), force, NONE, what)
    assert rest.mean(axis=0) == pytest.approx(drawn(what, 1).square[:, 0] * 2.0**2 / 2.0, rel=close)

    minute = np.zeros((6000, 3))
    force = minute.copy()
    force[:, 2] = -G
    what = ImuErrorModel(g_sensitivity=10.0 * DEG_H / G)
    rate, _, errors = measured(minute, force, what, NONE)
    effect = -rate.sum(axis=0) * DT / (errors.force[:, 2] / (10.0 * DEG_H / G))
    assert effect / DEG == pytest.approx([told["g_sensitivity_10deg_h_g_1g_60s_deg"]] * 3, rel=close)


def test_gains_are_drawn() -> None:
    """Their spread over runs is what is asked for, within 4 sigma of the sampling."""
    what = ImuErrorModel(misalignment=1e-3, asymmetry=1e-4, nonlinearity=2.0, g_sensitivity=3.0, ramp=4.0)
    rngs = [generator(7, run, "imu") for run in range(2000)]
    gains = Gains.drawn(what, 0, rngs)
    for values, size in (
        (gains.cross[~np.eye(3, dtype=bool)], 1e-3), (gains.uneven, 1e-4), (gains.square, 2.0), (gains.force, 3.0),
        (gains.slope, 4.0),
    ):  # fmt: skip
        assert values.std() == pytest.approx(size, rel=4.0 / math.sqrt(2.0 * values.size))


@pytest.mark.validates("Sensor bias by vibration and by temperature",
                       "formulas: K g_rms²; coefficient times the temperature difference", effect="1 %")  # fmt: skip
def test_rectification_and_temperature(known: dict[str, Any], within: Within) -> None:
    close, still = within["effect"], np.zeros((30000, 3))
    shaken = Vibration(lines=((3.0 * math.sqrt(2.0) * G, 20.0),))
    what = ImuErrorModel(rectification=100e-6 / G, vibration=shaken)
    _, rest, errors = measured(still, still, NONE, what)
    effect = rest.mean(axis=0) / (drawn(what, 1).rectified[:, 0] / (what.rectification * 9.0 * G**2))
    assert effect / (1e-6 * G) == pytest.approx([known["imu_single_terms"]["vre_100ug_g2_3grms_ug"]] * 3, rel=close)
    assert errors.bias[0, 3:] == pytest.approx(drawn(what, 1).rectified[:, 0])

    warming = Warming(ramp=2.0 / 60.0, warm_up=10.0, time=40.0)
    what = ImuErrorModel(temperature=1e-5, warming=warming)
    rate, _, errors = measured(still, still, what, NONE)
    end, gain = 300.0, drawn(what, 0).per_kelvin[:, 0]
    assert errors.bias[-1, :3] == pytest.approx(gain * (10.0 + 10.0 * (1.0 - math.exp(-end / 40.0))), rel=1e-9)
    turned = gain * (0.5 * 2.0 / 60.0 * end**2 + 10.0 * (end - 40.0 * (1.0 - math.exp(-end / 40.0))))
    assert rate.sum(axis=0) * DT == pytest.approx(turned, rel=close)


@pytest.mark.validates("Angle lost by a saturated gyro", "integral of the rate beyond the range", angle="1 %")
def test_saturation(within: Within) -> None:
    peak, limit, seconds = 200.0 * DEG, 125.0 * DEG, 20.0
    rate, _, errors = measured(sine(peak), np.zeros((2000, 3)), ImuErrorModel(largest=limit), NONE)
    lost = np.abs(rate).sum(axis=0) * DT
    where = math.acos(limit / peak)
    expected = seconds * 2.0 / math.pi * (peak * math.sin(where) - limit * where)
    assert lost == pytest.approx([expected] * 3, rel=within["angle"])
    assert errors.clipped[0] == pytest.approx(2000 * 2.0 * where / math.pi, abs=45)
    assert errors.clipped[1] == 0


@pytest.mark.validates("Delay and gain of a sensor's bandwidth",
                       "formulas: delay 2 zeta/omega0 of a ramp, -3 dB at its frequency", delay="1 %",
                       gain="1 %")  # fmt: skip
@pytest.mark.parametrize("damping", [0.5, 0.7071, 1.0])
def test_bandwidth(damping: float, within: Within) -> None:
    """Frequency, damping and delay by themselves: omega0 from the gain of a filter of second order."""
    what = ImuErrorModel(bandwidth=20.0, damping=damping)
    ramp = np.repeat(np.linspace(0.0, 10.0, 1000)[:, None], 3, axis=1)
    slope = (ramp[1, 0] - ramp[0, 0]) / DT
    behind = (ramp - apply_bandwidth(ramp * DT, DT, what) / DT)[-1, 0]
    omega = next(
        w for w in np.arange(10.0, 400.0, 0.001)
        if abs(w**2 / (w**2 - (40.0 * math.pi) ** 2 + 2j * damping * w * 40.0 * math.pi)) ** 2 > 0.5
    )  # fmt: skip
    assert behind / slope == pytest.approx(2.0 * damping / omega, rel=within["delay"])
    fine = 1e-4
    time = fine * np.arange(20001)
    u = np.diff(np.sin(2.0 * math.pi * 20.0 * time))[:, None]
    assert apply_bandwidth(u, fine, what)[10000:].std() / u[10000:].std() == pytest.approx(
        math.sqrt(0.5), rel=within["gain"]
    )


TAUS = np.array([0.1, 1.0, 10.0])


def deviations(further: ImuErrorModel, runs: int, seconds: float, white: float, markov: float) -> np.ndarray:
    """Ratio of Allan deviations at `TAUS` to their closed form: of the mean over runs and axes. The sensors are moved
    by many quanta a sample: what is left over of one knows nothing of what was left over before. A ramp is of the
    slopes that were drawn."""
    triad = replace(PERFECT, further=further, noise_density=white, markov=markov, markov_time=5.0)
    total, moving, slopes = np.zeros(3), np.random.default_rng(1), []
    for run in range(runs):
        moved = 1e-3 * moving.standard_normal((round(seconds * RATE), 3))
        dtheta, _, _ = simulate(generator(11, run, "imu"), moved, moved, DT, triad, PERFECT)
        error = (dtheta - moved) * RATE
        slopes.append(Gains.drawn(further, 0, (generator(11, run, "imu"),)).slope)
        for axis in range(3):
            _, deviation, _, _ = allantools.oadev(error[:, axis], rate=RATE, data_type="freq", taus=TAUS)
            total += deviation**2
    as_drawn = replace(triad, further=replace(further, ramp=float(np.sqrt(np.mean(np.square(slopes))))))
    return np.sqrt(total / (3 * runs) / allan_variance(as_drawn, TAUS))


@pytest.mark.validates("Allan deviation of every noise of inertial sensors", "IEEE Std 952, annex C", deviation="5 %")
@pytest.mark.parametrize(
    ("further", "white", "markov"),
    [
        (NONE, 3e-4, 0.0),
        (ImuErrorModel(quantum=1e-4), 0.0, 0.0),
        (ImuErrorModel(walk=1e-5), 0.0, 0.0),
        (ImuErrorModel(ramp=1e-6), 0.0, 0.0),
        (ImuErrorModel(lines=((1e-3, 0.33),)), 0.0, 0.0),
        (NONE, 0.0, 1e-4),
        (ImuErrorModel(quantum=1e-4, walk=1e-4, ramp=1e-5, lines=((1e-4, 0.33),)), 1e-4, 1e-4),
    ],
    ids=["white", "quantum", "walk", "ramp", "sine", "markov", "all"],
)
def test_allan_deviation(further: ImuErrorModel, white: float, markov: float, within: Within) -> None:
    """From 300 records of 100 s: 3000 clusters of 10 s, which lie side by side in three axes."""
    ratio = deviations(further, 100, 100.0, white, markov)
    np.testing.assert_allclose(ratio, 1.0, atol=within["deviation"])


@pytest.mark.validates("Allan deviation of quantisation, and the peak of a Gauss-Markov bias", "closed forms",
                       deviation="1e-9 (relative)", peak="1e-5 (relative)")  # fmt: skip
def test_closed_forms(known: dict[str, Any], within: Within) -> None:
    told = known["imu_single_terms"]["quantisation_lsb_1e4rad_adev_1s"]
    quantum = replace(PERFECT, further=ImuErrorModel(quantum=1e-4))
    assert math.sqrt(allan_variance(quantum, np.array([1.0]))[0]) == pytest.approx(told, rel=within["deviation"])
    peak = known["allan_closed_forms"]["markov_peak"]
    assert (peak["tau_over_Tc"], peak["adev_over_sigma"]) == pytest.approx(MARKOV_PEAK, abs=2e-5)
    # bias instability as it is printed: the curve, white noise and all, has it at the peak
    lowest, white = 0.8 * DEG_H, 0.09 * DEG_SQRT_H
    triad = Triad(0.0, white, markov_of_lowest(lowest, white, 100.0), 100.0)
    at = MARKOV_PEAK[0] * 100.0 * np.array([0.5, 1.0, 2.0])
    curve = np.sqrt(allan_variance(triad, at))
    assert curve[1] == pytest.approx(lowest, rel=within["peak"])
    assert math.isnan(markov_of_lowest(0.0035 * DEG_H, 0.002 * DEG_SQRT_H, 100.0))


def test_lines_beyond_the_samples_are_aliased() -> None:
    """130 Hz at 100 samples a second: seen at 30 Hz, as large as a mean over a sample leaves it."""
    shaken = shaking(Vibration(lines=((1.0, 130.0),)), (generator(3, 0, "imu"),), 10000, DT)
    assert shaken is not None
    power = np.abs(np.fft.rfft(shaken[:, 0, 0] / DT)) / 5000.0
    assert np.fft.rfftfreq(10000, DT)[np.argmax(power)] == pytest.approx(30.0)
    assert power.max() == pytest.approx(abs(np.sinc(1.3)), rel=1e-6)


@pytest.mark.validates("Spectral density and mean square of random vibration",
                       "density and mean square that the scenario asks for", density="6 %",
                       mean_square="2 %")  # fmt: skip
def test_random_vibration(within: Within) -> None:
    """10-40 Hz are what is asked for less what a mean over a sample takes; with what is folded, all of it."""
    shaken = Vibration(density=((5.0, 0.01), (20.0, 0.04), (300.0, 0.004)))
    count, rngs = 20000, tuple(generator(5, run, "imu") for run in range(8))
    rate = 1000.0
    fine = shaking(shaken, rngs, count, 1.0 / rate)
    assert fine is not None
    samples = fine * rate
    frequency = np.fft.rfftfreq(count, 1.0 / rate)
    power = 2.0 / (rate * count) * np.mean(np.abs(np.fft.rfft(samples, axis=0)) ** 2, axis=(1, 2))
    for low, high in ((6.0, 12.0), (12.0, 40.0), (40.0, 120.0), (120.0, 290.0)):
        band = (frequency >= low) & (frequency < high)
        expected = np.mean(shaken.at(frequency[band]) * np.sinc(frequency[band] / rate) ** 2)
        assert power[band].mean() == pytest.approx(expected, rel=within["density"])
    grid = np.arange(5.0, 300.0, 0.01)
    assert shaken.mean_square() == pytest.approx(np.sum(shaken.at(grid)) * 0.01, rel=1e-3)
    # at 100 samples a second what is above 50 Hz is folded: the mean square of the means is the integral with sinc2
    coarse = shaking(shaken, rngs, count, DT)
    assert coarse is not None
    expected = np.sum(shaken.at(grid) * np.sinc(grid * DT) ** 2) * 0.01
    assert np.mean((coarse / DT) ** 2) == pytest.approx(expected, rel=within["mean_square"])


def test_white_density_of_a_vibration() -> None:
    """White noise of that density gains as much velocity in an interval: S/2 of a flat spectrum; what is simulated."""
    flat = Vibration(density=((1e-5, 0.02), (2000.0, 0.02)))
    for interval in (0.5, 10.0):
        assert flat.white_density(interval) == pytest.approx(0.5 * 0.02, rel=0.01)
    slow = Vibration(density=((0.2, 0.02), (20.0, 0.02)))
    gained = shaking(slow, tuple(generator(7, run, "imu") for run in range(64)), 20000, DT)
    assert gained is not None
    gained = gained.reshape(20, 1000, 3, 64).sum(axis=1)
    assert np.mean(gained**2) == pytest.approx(slow.white_density(10.0) * 10.0, rel=0.05)


ALL = ImuErrorModel(
    misalignment=1e-3, asymmetry=1e-4, nonlinearity=1e-3, ramp=1e-6, temperature=1e-5, rectification=1e-6, walk=1e-5,
    lines=((1e-3, 7.0),), quantum=1e-5, largest=2.0, bandwidth=30.0,
    vibration=Vibration(((0.5, 33.0),), ((20.0, 0.01), (200.0, 0.01))), warming=Warming(0.01, 5.0, 60.0),
)  # fmt: skip


def test_all_together() -> None:
    """In the order of the page: the range is kept, what is measured is in quanta, and the sum is that of its parts."""
    rate, force = sine(1.5, 0.2), sine(3.0, 0.3) + np.array([0.0, 0.0, -G])
    gyro, accel = replace(ALL, g_sensitivity=1e-4), replace(ALL, quantum=1e-4, largest=12.0)
    both = [Triad(1e-3, 1e-4, 1e-4, 50.0, scale=1e-3, further=what) for what in (gyro, accel)]
    dtheta, dv, errors = simulate(generator(3, 1, "imu"), rate * DT, force * DT, DT, *both)
    for increments, what in ((dtheta, gyro), (dv, accel)):
        assert np.abs(increments).max() <= what.largest * DT * (1.0 + 1e-12)
        inside = np.abs(increments) < what.largest * DT * (1.0 - 1e-12)
        counts = increments[inside] / what.quantum
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert errors.clipped[1] > 0

    # without what is not linear in the errors, measured less felt is the sum of what each does alone
    linear = replace(gyro, quantum=0.0, largest=math.inf, bandwidth=math.inf)
    parts = np.zeros_like(rate)
    for name in ("misalignment", "asymmetry", "nonlinearity", "g_sensitivity", "ramp", "temperature", "walk", "lines"):
        kept = {name: getattr(linear, name), "vibration": linear.vibration, "warming": linear.warming}
        parts += measured(rate, force, ImuErrorModel(**kept), replace(NONE, vibration=linear.vibration), 1)[0]
    kept = {"rectification": linear.rectification, "vibration": linear.vibration}
    parts += measured(rate, force, ImuErrorModel(**kept), replace(NONE, vibration=linear.vibration), 1)[0]
    whole = measured(rate, force, linear, replace(NONE, vibration=linear.vibration), 1)[0]
    np.testing.assert_allclose(whole, parts, atol=1e-12)


def test_streams_of_their_own() -> None:
    """Further errors leave the numbers of the others what they are; a run's do not depend on its neighbours."""
    rate = sine(0.5)
    plain = Triad(1e-3, 1e-4, 1e-4, 50.0, scale=1e-3)
    more = replace(plain, further=ImuErrorModel(ramp=1e-6, walk=1e-6))
    a, _, before = simulate(generator(3, 0, "imu"), rate * DT, rate * DT, DT, plain, plain)
    b, _, after = simulate(generator(3, 0, "imu"), rate * DT, rate * DT, DT, more, plain)
    np.testing.assert_array_equal(before.scale, after.scale)
    added = measured(rate, rate, more.further, NONE)[0]
    np.testing.assert_allclose((b - a) / DT, added, atol=1e-12)

    at = np.array([0, 700, 2000])
    whole = [replace(plain, further=what) for what in (replace(ALL, g_sensitivity=1e-4), ALL)]
    draws = ImuDraws.of(tuple(generator(3, run, "imu") for run in range(8)), 8, len(rate), *whole)
    dtheta, dv, errors = simulate_lanes(draws, rate * DT, rate * DT, DT, *whole, at)
    # a way of each run's own, here the same to all
    own = np.repeat(rate[..., None] * DT, 8, axis=2)
    again = simulate_lanes(draws, own, own, DT, *whole, at)
    np.testing.assert_array_equal(again[0], dtheta)
    for run in (0, 5):
        one = simulate(generator(3, run, "imu"), rate * DT, rate * DT, DT, *whole)
        np.testing.assert_array_equal(one[0], dtheta[..., run])
        np.testing.assert_array_equal(one[1], dv[..., run])
        np.testing.assert_array_equal(one[2].bias[at], errors.bias[..., run])


@pytest.mark.validates("Conversion of the units of data sheets", "definitions of the units", converted_value="1e-6")
def test_units(known: dict[str, Any], within: Within) -> None:
    """Keys in the units of data sheets, as the models have them."""
    gyro = (
        "imu.gyro={drift_deg_h: 1, arw_deg_sqrt_h: 1, misalignment_mrad: 1, asymmetry_ppm: 1, "
        "nonlinearity_ppm_deg_s: 1, g_sensitivity_deg_h_g: 1, ramp_deg_h_h: 1, rate_random_walk_deg_h_sqrt_h: 1, "
        "quantum_urad: 1, range_deg_s: 1, "
        "sine_deg_h: 1, sine_hz: 2, bandwidth_hz: 50, temperature_deg_h_k: 1, rectification_deg_h_g2: 1}"
    )
    accel = (
        "imu.accelerometer={bias_mg: 1, vrw_m_s_sqrt_h: 1, nonlinearity_ug_g2: 1, ramp_mg_h: 1, quantum_mm_s: 1, "
        "bias_random_walk_mg_sqrt_h: 1, range_g: 1, sine_mg: 1, sine_hz: 2, temperature_mg_k: 1, "
        "rectification_ug_g2: 1}"
    )
    around = "imu.vibration={lines: [{amplitude_g: 2, frequency_hz: 30}]}", "imu.temperature={ramp_k_min: 60}"
    of_gyro, of_accel = scenario(gyro, accel, *around).imu.triads()
    units, told = known["unit_conversions"], within["converted_value"]
    deg_h, mg, g = DEG / 3600.0, 9.80665e-3, 9.80665
    assert (units["deg_h"], units["mg"]) == pytest.approx((of_gyro.bias, of_accel.bias), rel=told)
    assert units["deg_sqrt_h"] == pytest.approx(of_gyro.noise_density, rel=told)
    one = of_gyro.further
    expected = ImuErrorModel(
        misalignment=1e-3, asymmetry=1e-6, nonlinearity=1e-6 / DEG, g_sensitivity=deg_h / g, ramp=deg_h / 3600.0,
        temperature=deg_h, rectification=deg_h / g**2, walk=deg_h / 60.0, lines=((deg_h, 2.0),), quantum=1e-6,
        largest=DEG, bandwidth=50.0, vibration=Vibration(((2.0 * g, 30.0),)), warming=Warming(1.0, 0.0, 300.0),
    )  # fmt: skip
    for name in ImuErrorModel.__dataclass_fields__:
        if name not in ("lines", "vibration", "warming"):
            assert getattr(one, name) == pytest.approx(getattr(expected, name), rel=told), name
    assert one.lines[0] == pytest.approx(expected.lines[0], rel=told)
    assert one.vibration.lines[0] == pytest.approx(expected.vibration.lines[0], rel=told)
    assert (one.warming.ramp, one.warming.time) == (1.0, 300.0)
    two = of_accel.further
    assert two.nonlinearity == pytest.approx(1e-6 / g, rel=told)
    assert two.rectification == pytest.approx(1e-6 / g, rel=told)
    assert (two.ramp, two.walk, two.temperature) == pytest.approx((mg / 3600.0, mg / 60.0, mg), rel=told)
    assert (two.quantum, two.largest) == pytest.approx((1e-3, g), rel=told)
    assert density_from_sample_sigma(1.0, 100.0) == pytest.approx(0.1)
