"""`kind: atc-tracking` against a second program: `docs/theory/atc.md`, sections 3, 4."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from navsim.scenario.tracking.atc import Atc
from navsim.scenario.tracking.circuit import CircuitSection
from navsim.study.tracking.atc import compute, group_limits, multiplications, settings, truth
from navsim.tracking.atc import NAMES, N, range_acceleration, range_rate
from navsim.tracking.circuit import fly
from navsim.tracking.kalman import update_row
from tests.conftest import Within


def scenario(**keys: object) -> Atc:
    return Atc.model_validate({"kind": "atc-tracking", "version": 1, **keys})


@pytest.mark.validates(
    "Range rate and acceleration from onboard and line-of-sight data", "scipy's spline through the range",
    rate="1e-7 m/s", acceleration="1e-4 m/s2",
)  # fmt: skip
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


@pytest.mark.validates(
    "Steady state of the five pairs", "a second program's Riccati solver", **{"sigma and gain": "1e-7"}
)
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


@pytest.fixture(scope="module")
def result():  # type: ignore[no-untyped-def]
    return compute(scenario(), 1, None)


def at(result, path: str, case: str, *index: int) -> np.ndarray:  # type: ignore[no-untyped-def]
    return result[path][(list(result["/case"]).index(case), *index)]


def test_decoupled_against_full(result) -> None:  # type: ignore[no-untyped-def]
    for case in result["/case"]:
        for level in ("speed", "path_angle", "track", "elevation", "azimuth"):
            value = at(result, "/summary/decoupled_to_full", case, 0, 0, NAMES.index(level), 0)
            assert 0.98 <= value <= 1.02, (case, level)
    d, rate = at(result, "/summary/decoupled_to_full", "T1_angles", 0, 0)[:2, 0]
    assert abs(d - 1.236) <= 0.045
    assert abs(rate - 1.954) <= 0.045
    assert abs(at(result, "/summary/decoupled_to_full", "T1_rates", 0, 0, 0, 0) - 0.913) <= 0.025


def test_singer_against_onboard(result) -> None:  # type: ignore[no-untyped-def]
    """Tolerances are 3.5 sd at 1000 runs."""
    d, rate = at(result, "/summary/singer_to_adapt", "T1_angles", 0)[:, 0]
    assert abs(d - 1.749) <= 0.025
    assert abs(rate - 4.11) <= 0.06
    assert abs(at(result, "/summary/singer_to_adapt", "T1_rates", 0, 0, 0) - 2.40) <= 0.07


EXPECTED = {
    "T1_angles": ((11.28, 13.95, 19.34, 24.40), (1.173, 2.291, 3.051, 9.426)),
    "T1_rates": ((11.11, 10.15, 9.87, 24.40), (1.043, 0.741, 0.694, 9.426)),
    "T4_angles": ((25.29, 25.01, 45.84, 32.89), (2.715, 5.249, 8.884, 11.592)),
    "T4_rates": ((24.51, 18.94, 18.19, 32.89), (3.099, 1.633, 1.481, 11.592)),
}


@pytest.mark.parametrize("case", EXPECTED)
def test_errors_in_the_manoeuvre(result, case: str) -> None:  # type: ignore[no-untyped-def]
    """The table, of another 1000 runs: within 3 %."""
    for m, row in enumerate(EXPECTED[case]):
        found = at(result, "/summary/rmse", case)[:4, 0, m, 0]
        np.testing.assert_allclose(found, row, rtol=0.03)


def test_cartesian_filter(result) -> None:  # type: ignore[no-untyped-def]
    """4.2 m, 0.55 m/s, 0.017 deg at 1 s; 8.5 m, 0.68 m/s at 4 s."""
    one, four = (at(result, "/summary/rmse", case, 4, 0) for case in ("T1_angles", "T4_angles"))
    assert one[0, 0] == pytest.approx(4.2, rel=0.05)
    assert one[1, 0] == pytest.approx(0.55, rel=0.05)
    assert np.degrees(one[NAMES.index("azimuth"), 0]) == pytest.approx(0.017, rel=0.06)
    assert four[0, 0] == pytest.approx(8.5, rel=0.06)
    assert four[1, 0] == pytest.approx(0.68, rel=0.06)
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
