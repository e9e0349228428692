"""Wind profiles, turbulence, gusts felt and flight-technical errors against closed forms, matrix exponentials and an
outside program."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest

from navsim.statistics.linear_processes import discretised, exponential, stationary
from navsim.trajectory import air
from navsim.trajectory.air import Process
from tests.conftest import DATA, Within
from tests.formulas import dryden_spectrum
from tests.helpers import in_brief

STEP = 0.02
"""Of the samples that spectra are made of, s: 50 Hz."""
FOOT, SPEED = 0.3048, 30.0


@pytest.fixture(scope="module")
def known() -> dict[str, Any]:
    return json.loads((DATA / "air.json").read_text())


def flown(process: Process, count: int, step: float, rng: np.random.Generator) -> np.ndarray:
    """Samples (count, n) of a process that has always been."""
    transition, root = discretised(process.a, process.b, step)
    noise = rng.standard_normal((count, root.shape[0])) @ root.T
    x = np.linalg.cholesky(process.covariance) @ rng.standard_normal(root.shape[0])
    out = np.empty_like(noise)
    for k in range(count):
        out[k] = x
        x = transition @ x + noise[k]
    return out


def banded(samples: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Welch's spectrum, one-sided by rad/s, averaged in bands of a quarter decade: of 0.28 to 28 rad/s, with means of
    omega (b, m) as a list of bands."""
    length = 2**14
    window = np.hanning(length + 1)[:-1]
    pieces = [samples[i : i + length] * window for i in range(0, samples.size - length + 1, length // 2)]
    power = np.mean([np.abs(np.fft.rfft(p)) ** 2 for p in pieces], axis=0) * 2.0 * step / np.sum(window**2)
    omega = 2.0 * math.pi * np.fft.rfftfreq(length, step)
    return omega, power / (2.0 * math.pi)


def ratios(samples: np.ndarray, transverse: bool) -> np.ndarray:
    """The spectrum of samples at 50 Hz over that of Dryden at V/L = 0.3, by bands of a quarter decade."""
    omega, power = banded(samples, STEP)
    expected = dryden_spectrum(omega, 0.3, 1.0, 1.0, transverse)
    edges = 0.28 * 10.0 ** (0.25 * np.arange(9))
    bands = [(omega >= low) & (omega < high) for low, high in itertools.pairwise(edges)]
    return np.array([power[b].mean() / expected[b].mean() for b in bands])


@pytest.mark.parametrize("transverse", in_brief([False, True], 1))
@pytest.mark.validates("Dryden turbulence: spectrum",
                       "closed form of the spectrum; estimated by Welch's method, V/L = 0.3",
                       spectrum="10 %")  # fmt: skip
def test_spectrum_of_turbulence(transverse: bool, within: Within) -> None:
    process, row = air.dryden(1.0 / 0.3, transverse)
    samples = flown(process, 2**20, STEP, np.random.default_rng(20)) @ row
    assert np.abs(ratios(samples, transverse) - 1.0).max() < within["spectrum"]


@pytest.mark.validates("Dryden turbulence: the spectrum's test finds the error of a handbook's difference equation",
                       "spectrum of MIL-STD-1797A's", ratio="0.1 %")  # fmt: skip
def test_difference_equation_fails(known: dict[str, Any], within: Within) -> None:
    """That of MIL-STD-1797A has a spectrum of first order: what the test above is there to find."""
    told = known["dryden_handbook_difference_equation"]
    rate, step = 0.3, 0.01
    omega = np.array(told["omega"])
    decay, kick = 1.0 - 2.0 * rate * step, math.sqrt(4.0 * rate * step)
    density = kick**2 * step / math.pi / np.abs(1.0 - decay * np.exp(-1j * omega * step)) ** 2
    found = density / dryden_spectrum(omega, rate, 1.0, 1.0, True)
    assert found == pytest.approx(told["ratio"], rel=within["ratio"] + 5e-5 / 0.8)
    noise = np.random.default_rng(20).standard_normal(2**20)
    samples, w = np.empty(2**20), 0.0
    decay, kick = 1.0 - 2.0 * rate * STEP, math.sqrt(4.0 * rate * STEP)
    for k, n in enumerate(noise.tolist()):
        samples[k] = w
        w = decay * w + kick * n
    assert np.abs(ratios(samples, True) - 1.0).max() > 0.1


@pytest.mark.validates("Dryden turbulence: variance", "variance 1, over 10 000 time scales", variance="5 %")
def test_variance_of_turbulence(within: Within) -> None:
    for transverse in (False, True):
        process, row = air.dryden(1.0, transverse)
        samples = flown(process, 200_000, 0.05, np.random.default_rng(21)) @ row
        assert np.mean(samples**2) == pytest.approx(1.0, rel=within["variance"])


@pytest.mark.validates("Dryden turbulence: scales and sigmas", "independent script by the formulas",
                       scale="3e-4 (relative)")  # fmt: skip
def test_scales(known: dict[str, Any], within: Within) -> None:
    for h, along, across, down, half_across, half_down, sigma, vertical in known["dryden_scales"]["rows"]:
        h = np.array(h)
        # the table has two decimals of the short lengths
        for form, expected in (
            (air.MIL_F_8785C, (along, across, down)),
            (air.MIL_HDBK_1797, (along, half_across, half_down)),
        ):
            assert air.dryden_scales(h, form) == pytest.approx(expected, rel=within["scale"])
        assert air.dryden_sigmas(h, 1.0) == pytest.approx([sigma, sigma, vertical], rel=within["scale"])


@pytest.mark.validates("Dryden turbulence: spectra of both specifications agree", "closed forms",
                       every_value="1e-5 (relative)")  # fmt: skip
def test_both_forms_are_one_model(known: dict[str, Any], within: Within) -> None:
    """With the lengths of the one in the form of the other they are not."""
    told = known["dryden_spectra"]
    v, length = told["V_m_s"], told["L_m"]
    omega = np.array([v / length])
    density = dryden_spectrum
    assert density(omega, v, length, 1.0, False)[0] == pytest.approx(
        told["phi_u_at_V_over_L"], rel=within["every_value"]
    )
    assert density(omega, v, length, 1.0, True)[0] == pytest.approx(
        told["phi_v_8785C_at_V_over_L"], rel=within["every_value"]
    )
    mixed = density(omega, v, length, 1.0, True, air.MIL_HDBK_1797)[0]
    assert mixed == pytest.approx(told["phi_v_1797_with_same_L_at_V_over_L"], rel=within["every_value"])
    omega, h = np.geomspace(0.01, 100.0, 50), np.array([3.0, 20.0, 152.4])
    one, other = air.dryden_scales(h, air.MIL_F_8785C), air.dryden_scales(h, air.MIL_HDBK_1797)
    for a, b in zip(one[:, 1:].ravel(), other[:, 1:].ravel(), strict=True):
        both = density(omega, v, a, 1.0, True), density(omega, v, b, 1.0, True, air.MIL_HDBK_1797)
        assert both[0] == pytest.approx(both[1], rel=1e-12)
        assert np.abs(density(omega, v, a, 1.0, True, air.MIL_HDBK_1797) / both[0] - 1.0).max() > 0.1


def autocorrelation(process: Process, row: np.ndarray, tau: list[float]) -> np.ndarray:
    """Of row x, by the exponential of its matrix and its stationary covariance."""
    p = process.covariance
    return np.array([row @ exponential(process.a * t) @ p @ row for t in tau])


@pytest.mark.validates("Dryden turbulence: autocorrelation", "closed form; JSBSim 1.3.3", autocorrelation="1e-8",
                       JSBSim="0.06")  # fmt: skip
def test_autocorrelation(known: dict[str, Any], within: Within) -> None:
    told = known["dryden_acf"]
    process, row = air.dryden(told["T_s"], True)
    assert process.covariance == pytest.approx(np.eye(2), abs=1e-12)
    assert autocorrelation(process, row, told["tau_s"]) == pytest.approx(told["R"], abs=within["autocorrelation"])
    flight = known["dryden_jsbsim"]
    speed, h = 274.0 * FOOT, np.array(200.0 * FOOT)
    for k, axis in enumerate("uvw"):
        gust = air.dryden(float(air.dryden_scales(h)[k]) / speed, k > 0)
        assert autocorrelation(*gust, flight["acf_tau_s"]) == pytest.approx(flight["acf"][axis], abs=within["JSBSim"])
    assert air.dryden_sigmas(h, 50.0) == pytest.approx(flight["sigma_ft_s"]["measured"], rel=0.05)


@pytest.mark.validates("Exact discretisation of Dryden turbulence", "matrix exponential of van Loan's block",
                       every_value="1e-6 (relative)")  # fmt: skip
def test_exact_discretisation(known: dict[str, Any], within: Within) -> None:
    """Of the controllable form, which states of unit variance are scaled from."""
    told = known["dryden_exact_discretisation"]
    t = told["T_s"]
    process, row = air.dryden(t, True)
    scale = np.array([math.sqrt(t**3 / 4.0), math.sqrt(t / 4.0)])
    transition, root = discretised(process.a, process.b, told["dt_s"])
    assert transition * scale[:, None] / scale == pytest.approx(np.array(told["Ad"]), rel=within["every_value"])
    noise = root @ root.T * np.outer(scale, scale)
    assert noise == pytest.approx(np.array(told["Qd"]), rel=within["every_value"])
    assert row / scale == pytest.approx(told["C"], rel=within["every_value"])
    assert scale**2 == pytest.approx(told["P0_diag"], rel=within["every_value"])
    # a step of many time constants leaves nothing but the stationary process
    transition, root = discretised(process.a, process.b, 40.0 * t)
    assert np.abs(transition).max() < 1e-12
    assert root @ root.T == pytest.approx(process.covariance, rel=1e-9, abs=1e-9)


@pytest.mark.validates("Variance of a gust behind a first-order lag", "closed forms", variance="1e-9")
def test_gust_through_lag(known: dict[str, Any], within: Within) -> None:
    told = known["gust_through_first_order_lag"]
    lag = told["tau_s"]
    for transverse, kind in ((False, "longitudinal"), (True, "transverse")):
        gust, row = air.dryden(told["T_s"], transverse)
        process = air.through(gust, row, air.carried(lag, 5.0, None))
        speed = row.size  # the first state of what is driven
        p, acceleration = process.covariance, process.a[speed]
        assert p[speed, speed] == pytest.approx(told[kind]["var_v"], abs=within["variance"])
        assert acceleration @ p @ acceleration == pytest.approx(told[kind]["var_a"], abs=within["variance"])
    assert air.gust_lag(200.0, np.array(30.0), 5.0) == pytest.approx(0.2220, abs=5e-5)


@pytest.mark.parametrize("transverse", [False, True])
@pytest.mark.validates("Sigma of an aircraft's motion in turbulence", "integrals of its spectrum by frequency",
                       sigma="1e-6 (relative)")  # fmt: skip
def test_aircraft_in_turbulence(transverse: bool, within: Within) -> None:
    """Place, speed, acceleration, and what the nose follows: density times the square of the response."""
    time_scale, lag, loop, nose = 1.5, 0.3, 5.0, 0.5
    gust, row = air.dryden(time_scale, transverse)
    process = air.through(gust, row, air.carried(lag, loop, nose))
    first = row.size
    p, rates = process.covariance, process.a
    x = np.linspace(math.log(1e-9), math.log(1e9), 40001)
    w = np.exp(x)
    s = 1j * w
    place = s / (1.0 + lag * s) / (s + 1.0 / loop) ** 2
    turned = (s * place - 1.0) / (1.0 + nose * s) ** 2
    density = dryden_spectrum(w, 1.0 / time_scale, 1.0, 1.0, transverse)
    responses = {first + 1: place, first + 2: s * place, first + 3: turned, first + 4: s * turned}
    for state, response in responses.items():
        variance = np.trapezoid(density * np.abs(response) ** 2 * w, x)
        assert math.sqrt(p[state, state]) == pytest.approx(math.sqrt(variance), rel=within["sigma"])
    variance = np.trapezoid(density * np.abs(s**2 * place) ** 2 * w, x)
    assert math.sqrt(rates[first + 2] @ p @ rates[first + 2]) == pytest.approx(math.sqrt(variance), rel=within["sigma"])


@pytest.mark.validates("Covariance and autocorrelation of the flight-technical error",
                       "Lyapunov equation, matrix exponential", every_value="1e-6 (relative)")  # fmt: skip
def test_flight_technical_error(known: dict[str, Any], within: Within) -> None:
    told = known["fte_third_order_markov"]
    error = air.Deviation(told["sigma_m"], told["correlation_time_s"])
    assert error.beta == pytest.approx(told["beta"], rel=within["every_value"])
    process = error.process()
    p = stationary(process.a, process.b) * error.sigma**2
    assert math.sqrt(p[0, 0]) == pytest.approx(error.sigma, rel=within["every_value"])
    assert math.sqrt(p[1, 1]) == pytest.approx(told["sigma_velocity"], rel=within["every_value"])
    assert math.sqrt(p[2, 2]) == pytest.approx(told["sigma_acceleration"], rel=within["every_value"])
    found = autocorrelation(process, np.array([1.0, 0.0, 0.0]), told["acf_tau_s"])
    assert found == pytest.approx(told["acf"], rel=within["every_value"])
    tau = np.linspace(0.0, 200.0, 20001).tolist()
    r = autocorrelation(process, np.array([1.0, 0.0, 0.0]), tau)
    assert np.trapezoid(r, tau) == pytest.approx(told["correlation_time_s"], rel=1e-5)


@pytest.mark.validates("Mean wind by height", "closed forms, independent script", share="6e-5")
def test_profiles(known: dict[str, Any], within: Within) -> None:
    rows = np.array(known["wind_profile"]["rows"])
    for column, kind, parameter in ((1, "log", 0.15 * FOOT), (2, "log", 2.0 * FOOT), (3, "power", 1.0 / 7.0)):
        speed = air.profiled(kind, 1.0, 0.0, parameter).at(rows[:, 0])[0]
        assert np.abs(speed - rows[:, column]).max() < within["share"]


@pytest.mark.validates("Heading and ground speed by the wind triangle", "vector sum, independent script",
                       every_value="1e-4")  # fmt: skip
def test_wind_triangle(known: dict[str, Any], within: Within) -> None:
    told = known["wind_triangle"]

    def wind(case: dict[str, float]) -> np.ndarray:
        return air.towards(
            np.array([case["wind"]]), np.radians([case["wind_from_deg"]]), math.radians(case["course_deg"])
        )

    case = told["fixed_ground_speed"]
    found = air.triangle(np.array([[case["ground_speed"], 0.0, 0.0]]), wind(case))
    assert found.airspeed[0] == pytest.approx(case["airspeed"], abs=within["every_value"])
    assert math.degrees(found.crab[0]) == pytest.approx(case["heading_deg"], abs=within["every_value"])
    for case in told["fixed_airspeed"]:
        ahead = np.array([[1.0, 0.0, 0.0]])
        speed = air.ground_speed(np.array([case["tas"]]), ahead, wind(case))
        assert speed[0] == pytest.approx(case["ground_speed"], abs=within["every_value"])
        found = air.triangle(speed[:, None] * ahead, wind(case))
        assert found.airspeed[0] == pytest.approx(case["tas"], abs=within["every_value"])
        assert abs(math.degrees(found.crab[0])) == pytest.approx(case["correction_deg"], abs=within["every_value"])
