"""`kind: atc-tracking` against a second program: `docs/theory/atc.md`, sections 3, 4."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from navsim.companions.atc.filter import NAMES, N, range_acceleration, range_rate
from navsim.companions.atc.report import tables
from navsim.companions.atc.scenario import Atc
from navsim.companions.atc.study import (
    compute,
    fly_case,
    group_limits,
    multiplications,
    quantised_reports,
    settings,
    truth,
)
from navsim.companions.circuit import fly
from navsim.companions.circuit_section import CircuitSection
from navsim.companions.kalman import update_row
from navsim.report.table import Table
from navsim.statistics.random_streams import generator
from tests.conftest import Within
from tests.oracle.test_azimuth import wider


def scenario(**keys: object) -> Atc:
    return Atc.model_validate({"kind": "atc-tracking", "version": 1, **keys})


@pytest.mark.validates("Range rate and acceleration from onboard and line-of-sight data",
                       "scipy's spline through the range", rate="1e-7 m/s", acceleration="1e-4 m/s2")  # fmt: skip
def test_range_acceleration_is_that_of_the_flight(within: Within) -> None:
    """On the circuit, half a second and more from the ends of its commands, where third derivatives jump."""
    flight = fly(CircuitSection().circuit())
    states = truth(flight)
    spline = make_interp_spline(flight.time, flight.range, 5)
    section = CircuitSection()
    commands = np.array([*section.roll_deg, *section.speed_change_m_s, *section.path_angle_deg])
    edges = np.concatenate([commands[:, 0], commands[:, 0] + commands[:, 1], [0.0, section.duration_s]])
    inner = np.min(np.abs(flight.time[:, None] - edges), axis=1) > 0.5
    slope = np.empty(N)
    some = np.flatnonzero(inner)[::97]
    assert some.size > 200
    found = np.array([(range_rate(states[i]), range_acceleration(states[i], slope)) for i in some])
    time = flight.time[some]
    np.testing.assert_allclose(found[:, 0], spline(time, 1), rtol=0.0, atol=within["rate"])
    np.testing.assert_allclose(found[:, 1], spline(time, 2), rtol=0.0, atol=within["acceleration"])
    np.testing.assert_allclose(found, states[some, 1:3], rtol=0.0, atol=1e-10)


def test_gradient_against_differences() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        x = rng.uniform(-1, 1, N) * np.array([1e4, 100, 2, 100, 2, 0.3, 0.1, 3, 0.1, 0.3, 0.1, 3, 0.1])
        slope, space = np.empty(N), np.empty(N)
        range_acceleration(x, slope)
        for i in range(N):
            step = 1e-6 * max(1.0, abs(x[i]))
            up, down = x.copy(), x.copy()
            up[i] += step
            down[i] -= step
            numeric = (range_acceleration(up, space) - range_acceleration(down, space)) / (2 * step)
            assert slope[i] == pytest.approx(numeric, rel=1e-6, abs=1e-6), NAMES[i]


LIMITS = {
    1.0: [(0.63709527, 0.40589039, 0.10004426), (0.08973580, 0.80525135, 0.49655388),
          (0.23805754, 0.90674225, 0.71750517), (0.05580582, 0.48660776, 0.15472830),
          (0.07108885, 0.78962889, 0.50802859)],
    4.0: [(0.88176128,), (0.09947785,), (0.24966509,), (0.07422619,), (0.07953350,)],
}  # fmt: skip


@pytest.mark.validates("Steady state of the five pairs of filters", "Riccati solver of an independent script",
                       **{"sigma and gain": "1e-7"})  # fmt: skip
@pytest.mark.parametrize("period", LIMITS)
def test_limits_of_the_pairs(period: float, within: Within) -> None:
    for (sigma, gain), expected, unit in zip(
        group_limits(settings(scenario(), period, False)), LIMITS[period], (1, *[180 / np.pi] * 4), strict=True
    ):
        found = [sigma * unit, *gain][: len(expected)]
        np.testing.assert_allclose(found, expected, rtol=0, atol=within["sigma and gain"])


def test_counts() -> None:
    assert multiplications(13, 6) == 5486
    assert 5 * multiplications(2, 1) + multiplications(3, 1) == 176
    assert 5486 / 176 >= 25


@pytest.fixture(scope="module", params=[250, pytest.param(1000, marks=pytest.mark.long)])
def result(request: Any) -> Any:
    """The study of the data link has its own test."""
    return compute(scenario(link={"study_runs": 0}, runs=request.param), 1, None)


def at(result: Any, path: str, case: str, *index: int) -> np.ndarray:
    return result[path][(list(result["/case"]).index(case), *index)]


def test_decoupled_against_full(result: Any) -> None:
    for case in result["/case"]:
        for level in ("speed", "path_angle", "track", "elevation", "azimuth"):
            value = at(result, "/summary/decoupled_to_full", case, 0, 0, NAMES.index(level), 0)
            assert abs(value - 1.0) <= wider(result) * 0.02, (case, level)
    d, rate = at(result, "/summary/decoupled_to_full", "T1_angles", 0, 0)[:2, 0]
    assert abs(d - 1.236) <= wider(result) * 0.045
    assert abs(rate - 1.954) <= wider(result) * 0.045
    assert abs(at(result, "/summary/decoupled_to_full", "T1_rates", 0, 0, 0, 0) - 0.913) <= wider(result) * 0.025


def test_singer_against_onboard(result: Any) -> None:
    """Tolerances are 3.5 sd at 1000 runs."""
    d, rate = at(result, "/summary/singer_to_adapt", "T1_angles", 0)[:, 0]
    assert abs(d - 1.749) <= wider(result) * 0.025
    assert abs(rate - 4.11) <= wider(result) * 0.06
    assert abs(at(result, "/summary/singer_to_adapt", "T1_rates", 0, 0, 0) - 2.40) <= wider(result) * 0.07


EXPECTED = {
    "T1_angles": ((11.28, 13.95, 19.34, 24.40), (1.173, 2.291, 3.051, 9.426)),
    "T1_rates": ((11.11, 10.15, 9.87, 24.40), (1.043, 0.741, 0.694, 9.426)),
    "T4_angles": ((25.29, 25.01, 45.84, 32.89), (2.715, 5.249, 8.884, 11.592)),
    "T4_rates": ((24.51, 18.94, 18.19, 32.89), (3.099, 1.633, 1.481, 11.592)),
}


@pytest.mark.parametrize("case", EXPECTED)
def test_errors_in_the_manoeuvre(result: Any, case: str) -> None:
    """The table, of another 1000 runs: within 3 % of 1000."""
    for m, row in enumerate(EXPECTED[case]):
        found = at(result, "/summary/rmse", case)[:4, 0, m, 0]
        np.testing.assert_allclose(found, row, rtol=wider(result) * 0.03)


def test_cartesian_filter(result: Any) -> None:
    """4.2 m, 0.55 m/s, 0.017 deg at 1 s; 8.5 m, 0.68 m/s at 4 s."""
    one, four = (at(result, "/summary/rmse", case, 4, 0) for case in ("T1_angles", "T4_angles"))
    assert one[0, 0] == pytest.approx(4.2, rel=wider(result) * 0.05)
    assert one[1, 0] == pytest.approx(0.55, rel=wider(result) * 0.05)
    assert np.degrees(one[NAMES.index("azimuth"), 0]) == pytest.approx(0.017, rel=wider(result) * 0.06)
    assert four[0, 0] == pytest.approx(8.5, rel=wider(result) * 0.06)
    assert four[1, 0] == pytest.approx(0.68, rel=wider(result) * 0.06)
    assert np.all(np.isnan(one[2]))  # it has no range acceleration of its own


def test_deterministic_run() -> None:
    """Without noise the straight leg is followed to a metre; in the turn the full filter lags behind its noises."""
    quiet = compute(scenario(noise="none", further_cases=[]), 1, None)
    time = quiet["/time"]
    straight, late = (time > 100) & (time < 160), time > 60
    assert np.abs(quiet["/filters/full/error"][0, straight, 0]).max() < 1.0
    assert np.abs(quiet["/filters/cartesian/error"][0, late, 0]).max() < 5.0


def test_update_by_a_full_row() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((4, 4))
    p, x, h = root @ root.T + np.eye(4), rng.standard_normal(4), rng.standard_normal(4)
    weighed, after = x.copy(), p.copy()
    nis = update_row(weighed, after, h, 0.4, 0.2, np.empty(4), np.empty(4))
    s = h @ p @ h + 0.2
    k = p @ h / s
    keep = np.eye(4) - np.outer(k, h)
    np.testing.assert_allclose(after, keep @ p @ keep.T + 0.2 * np.outer(k, k), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(weighed, x + 0.4 * k, rtol=1e-12)
    assert nis == pytest.approx(0.16 / s)


def vector_kalman(z: Any, r: Any, period: Any, decay: Any, rate_variance: Any, age: Any) -> Any:
    """Estimates (k,) of a level from reports `age` old: a plain filter at their time, predicted over the age."""
    phi, q = np.array([[1.0, period], [0.0, decay]]), np.diag([0.0, rate_variance])
    h = np.array([1.0, 0.0])
    x, p = np.array([z[0], 0.0]), np.diag([r, rate_variance / (1.0 - decay**2)])
    out = [x[0]]
    for value in z[1:]:
        x, p = phi @ x, phi @ p @ phi.T + q
        gain = p @ h / (h @ p @ h + r)
        x, p = x + gain * (value - h @ x), p - np.outer(gain, h @ p)
        out.append(x[0] + age * x[1])
    return np.array(out)


def linked(**link: object) -> Atc:
    return scenario(link=link, further_cases=[], runs=1)


@pytest.mark.validates("Track by reports of a data link with age and quantisation", "a plain numpy filter of the pair",
                       track="1e-10 rad")  # fmt: skip
@pytest.mark.parametrize("assumed", [0.0, 1.0])
def test_reports_of_the_data_link(assumed: float, within: Within) -> None:
    """The track pair of the decoupled filter, its reports drawn, aged and quantised here."""
    study = linked(latency_s=1.0, quantised=True, assumed_latency_s=assumed, assumed_quantised=assumed > 0.0)
    flight = fly(study.circuit.circuit())
    case = settings(study, 1.0, False)
    time, found = fly_case(study, flight, case, 3, 1)
    draws = generator(3, 0, "plots").standard_normal((time.size, 9))[:, 3]
    then = np.interp(np.maximum(time - 1.0, 0.0), flight.time, flight.track)
    lsb = np.radians(90 / 512)
    reports = lsb * np.floor((then + np.radians(0.25) * draws) / lsb + 0.5)
    r = np.radians(0.25) ** 2 + (lsb**2 / 12 if assumed else 0.0)
    estimate = vector_kalman(reports, r, 1.0, 0.95, np.radians(2.0) ** 2 * (1 - 0.95**2), assumed)
    expected = np.interp(time, flight.time, flight.track) - estimate
    for name in ("adapt", "fix"):
        error = found[name][0][0, :, NAMES.index("track")]
        np.testing.assert_allclose(error, (expected + np.pi) % (2 * np.pi) - np.pi, rtol=0, atol=within["track"])


def test_registers_of_the_data_link() -> None:
    """Steps of BDS 5,0 and 6,0; the path angle comes from the vertical rate and the speed as they are reported."""
    rng = np.random.default_rng(4)
    exact = np.column_stack([rng.uniform(-1, 1, 500) for _ in range(9)]) * [1e4, 5, 0.1, 3, 0.1, 3, 1, 0.01, 0.1]
    exact[:, 1] += 85.0
    found = quantised_reports(exact, linked().link)
    steps = {1: 2 * 1852 / 3600, 3: np.radians(90 / 512), 8: np.radians(8 / 256)}
    for column, step in steps.items():
        parts = found[:, column] / step
        np.testing.assert_allclose(parts, np.round(parts), atol=1e-3)
        gap = found[:, column] - exact[:, column]
        assert np.abs(gap).max() <= 0.5001 * step
        assert gap.std() == pytest.approx(step / np.sqrt(12), rel=0.1)
    up = found[:, 1] * np.sin(found[:, 2]) / (32 * 0.3048 / 60)
    np.testing.assert_allclose(up, np.round(up), atol=1e-9)
    np.testing.assert_array_equal(found[:, [0, 4, 5, 6, 7]], exact[:, [0, 4, 5, 6, 7]])


def test_cost_of_the_data_link() -> None:
    """Without age and steps nothing changes; cost grows with age, and less where the filters know it."""
    study = linked(study_runs=20, study_latencies_s=[0.0, 1.0, 2.0])
    found = compute(study, 1, None)
    none = compute(linked(study_runs=0, assumed_latency_s=0.0), 1, None)
    assert "/link/cost" not in none
    np.testing.assert_array_equal(found["/filters/full/error"], none["/filters/full/error"])
    rate = found["/link/cost"][0, :, :, :, 1, 0]  # levels alone: age, knowledge, filter
    assert np.all(np.diff(rate[:, 0], axis=0) > 0.0), rate
    assert np.all(rate[1:, 1, [0, 3]] < rate[1:, 0, [0, 3]]), rate
    titles = [part.title for part in tables(found) if isinstance(part, Table)]
    assert sum("Reports by data link" in title for title in titles) == 2
