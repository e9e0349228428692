"""`kind: azimuth-tracking` and the circuit, against a second program's figures and finite differences.

The figures: `docs/theory/circuit.md`, section 4; `docs/theory/azimuth.md`, section 4.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.linalg import expm

from navsim.companions.azimuth.report import growth_verdict, tables
from navsim.companions.azimuth.scenario import Azimuth
from navsim.companions.azimuth.study import compute, scans
from navsim.companions.circuit import at, fly
from navsim.companions.circuit_section import CircuitSection
from navsim.companions.reports import Onboard, draw, nodes, reported, stamped
from tests.conftest import Within

DEG = np.pi / 180.0
FLIGHT = fly(CircuitSection().circuit())
ORACLE = [
    (0.0, 4000.0, 7600.0, 100.0, 180.0, 62.2414594, 0.59035781, 6.40301318e-3, 0.0, -46.510842, 0.9112336),
    (160.0, -10500.0, 7600.0, 85.0, 180.0, 144.1026225, 0.22030280, -2.34057794e-3, 0.0, 68.814363, 0.1919542),
    (220.0, -12345.1553, 3747.4210, 76.6870, 269.999357, 163.1141244, 0.32588826, 6.18328306e-5, 1.24814563e-8,
     -22.260614, 0.4898122),
]  # fmt: skip


def scenario(**keys: object) -> Azimuth:
    return Azimuth.model_validate({"kind": "azimuth-tracking", "version": 1, **keys})


@pytest.mark.validates("The landing circuit: position, azimuth, range and their derivatives", "independent script",
                       position="1e-3 m", azimuth="1e-7 deg", rate="1e-8 deg/s", acceleration="1e-9 deg/s2",
                       **{"range rate": "1e-6 m/s", "range acceleration": "1e-6 m/s2"})  # fmt: skip
@pytest.mark.parametrize("row", ORACLE)
def test_circuit(row: tuple[float, ...], within: Within) -> None:
    t, north, east, speed, track, az, az1, az2, literal, range1, range2 = row
    i = round(t / 0.01)
    np.testing.assert_allclose(FLIGHT.position[i], [north, 450.0, east], rtol=0.0, atol=within["position"])
    assert FLIGHT.speed[i] == pytest.approx(speed, abs=5e-5)
    assert FLIGHT.track[i] / DEG == pytest.approx(track, abs=1e-6)
    assert FLIGHT.azimuth[i] / DEG == pytest.approx(az, abs=within["azimuth"])
    assert FLIGHT.azimuth1[i] / DEG == pytest.approx(az1, abs=within["rate"])
    assert FLIGHT.azimuth2[i] / DEG == pytest.approx(az2, abs=within["acceleration"])
    assert FLIGHT.azimuth2_literal[i] / DEG == pytest.approx(literal, abs=within["acceleration"])
    assert FLIGHT.range1[i] == pytest.approx(range1, abs=within["range rate"])
    assert FLIGHT.range2[i] == pytest.approx(range2, abs=within["range acceleration"])


def test_identities_against_finite_differences() -> None:
    """Fourth-order differences away from the ends of the ramps, where third derivatives jump."""
    step = 0.01
    f = FLIGHT

    def rate(values: np.ndarray) -> np.ndarray:
        return (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / (12 * step)

    smooth = np.ones(f.time.size, bool)
    for edge in (40, 80, 160, 166, 189.346, 195.346, 225.346, 241.652, 247.652, 267.907, 273.907, 277.907, 283.795,
                 291.795, 297.907):  # fmt: skip
        smooth &= np.abs(f.time - edge) > 0.05
    inner = smooth[2:-2]
    azimuth = np.unwrap(f.azimuth)
    for derived, values, tolerance in (
        (f.azimuth1, azimuth, 1e-9), (f.azimuth2, f.azimuth1, 1e-8), (f.range1, f.range, 1e-5),
        (f.range2, f.range1, 1e-5), (f.elevation1, f.elevation, 1e-8), (f.ground_range1, f.ground_range, 1e-5),
        (f.track1, f.track, 1e-8),
    ):  # fmt: skip
        gap = np.abs(rate(values) - derived[2:-2])[inner]
        assert gap.max() < tolerance, gap.max()
    ahead, right = f.level_acceleration()
    north = f.speed * np.cos(f.path_angle) * np.cos(f.track)
    expected = ahead * np.cos(f.track) - right * np.sin(f.track)
    assert np.abs(rate(north) - expected[2:-2])[inner].max() < 1e-7


SMALL = {"periods_s": [1.0, 2.0, 10.0], "latencies_s": [0.5]}
"""A part of the map."""


@pytest.fixture(scope="module", params=[250, pytest.param(1000, marks=pytest.mark.long)])
def result(request: Any) -> Any:
    return compute(scenario(runs=request.param, map=SMALL if request.param < 1000 else {}), 1, None)


def wider(result: Any) -> float:
    """How many times wider tolerances are than those of 1000 runs."""
    return float(np.sqrt(1000 / result["/run"].size))


def rmse(result: Any, name: str, period: int = 0, window: int = 0) -> float:
    return float(result["/summary/rmse"][period, list(result["/filter"]).index(name), window, 0])


def test_acceptance_at_one_second(result: Any) -> None:
    """`docs/theory/azimuth.md`, section 4; tolerances of 1000 runs."""
    for name, expected, reach in (("S1", 0.0618, 0.0010), ("S2", 0.0548, 0.0009), ("L4", 0.0351, 0.0010)):
        assert abs(rmse(result, name) - expected) <= wider(result) * reach, name
    s1, s2 = result["/summary/ratio_to_l4"][0, :, 0, 0]
    assert abs(s1 - 1.762) <= wider(result) * 0.042
    assert abs(s2 - 1.564) <= wider(result) * 0.040
    assert rmse(result, "S2") / rmse(result, "L1") < 0.2
    assert rmse(result, "S2") / rmse(result, "L2") < 0.8
    nis = dict(zip(result["/filter"], result["/summary/nis"][0, :, 1], strict=True))
    assert abs(nis["L4"] - 1.0) <= wider(result) * 0.05
    assert nis["S2"] < 1.0
    assert abs(rmse(result, "L3") - 0.04646) <= wider(result) * 0.0012
    for name, expected in (("S1", 0.04845), ("S2", 0.05407), ("L4", 0.03142)):
        assert abs(rmse(result, name, window=1) - expected) <= wider(result) * 0.001, name


def test_acceptance_at_four_seconds(result: Any) -> None:
    """The claim is not met."""
    s1, s2 = result["/summary/ratio_to_l4"][1, :, 0, 0]
    assert abs(s1 - 1.453) <= wider(result) * 0.033
    assert abs(s2 - 1.338) <= wider(result) * 0.034
    assert max(s1, s2) < 1.5
    assert "/cases/T4/filters/L4/error_deg" in result


def growth_by_covariance(period: float, sigma_a: float) -> tuple[float, float]:
    """Growth of Singer's error in the manoeuvre and its largest value, without a random number: the bias of a run free
    of noise and the covariance of what noise adds, the discretisation by scipy."""
    time = np.arange(0.0, 406.0 + 1e-9, period)
    true = at(FLIGHT, time)
    angle, ground = np.unwrap(true.azimuth), true.ground_range
    f = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -0.05]])
    fine = np.linspace(0.0, period, 401)
    steps = np.array([expm(f * s)[:, 2] for s in fine])
    phi, q = expm(f * period), simpson(np.einsum("ti,tj->tij", steps, steps), x=fine, axis=0) * 0.1 * sigma_a**2
    r, h = (0.08 * DEG) ** 2, np.array([[1.0, 0.0, 0.0]])
    x = np.array([angle[0], 0.0, 0.0])
    p = np.diag([r, (true.speed[0] / ground[0]) ** 2, (sigma_a / ground[0]) ** 2])
    s = np.diag([r, 0.0, 0.0])
    square = np.full(time.size, r)
    for k in range(1, time.size):
        x, p = phi @ x, phi @ p @ phi.T + q / ground[k] ** 2
        gain = p @ h.T / (p[0, 0] + r)
        keep = np.eye(3) - gain @ h
        x, p = x + gain[:, 0] * (angle[k] - x[0]), keep @ p
        s = keep @ phi @ s @ phi.T @ keep.T + r * gain @ gain.T
        square[k] = (x[0] - angle[k]) ** 2 + s[0, 0]
    turning = ((time >= 160) & (time < 195.346)) | ((time >= 241.652) & (time < 273.907))
    level = np.sqrt(square[(time >= 60) & (time < 160)].mean())
    return float(np.sqrt(square[turning].mean()) / level), float(np.sqrt(square[turning].max()) / level)


def test_growth_in_a_manoeuvre(result: Any) -> None:
    """The paper's "1.5 to 2 times larger" does not hold of the mean for the paper's own acceleration."""
    for i, period in enumerate((1.0, 4.0)):
        for j, sigma_a in enumerate((1.074264684, 2.504689245)):
            mean, peak = growth_by_covariance(period, sigma_a)
            assert result["/summary/growth"][i, j, 0] == pytest.approx(mean, rel=wider(result) * 0.015)
            # the largest of some 68 or 17 sample values lies above the largest of the true ones
            over = result["/summary/peak_growth"][i, j] / peak - 1.0
            assert -0.03 * wider(result) < over < 0.06 * wider(result)
    s1 = result["/summary/growth"][:, 0, 0]
    np.testing.assert_allclose(s1, [1.27, 1.16], atol=wider(result) * 0.02)
    grown = result["/map/growth"][list(result["/map/scan_period"]).index(1.0)]
    for sigma_a, found in zip(result["/map/singer_sigma"], grown, strict=True):
        assert found == pytest.approx(growth_by_covariance(1.0, sigma_a)[0], rel=0.06)
    growth = next(part for part in tables(result) if "larger in the manoeuvre than" in getattr(part, "title", ""))
    assert [row.texts()[-1] for row in growth.rows] == [
        "not met on average, met at the largest error", "not met", "not met", "not met"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("mean", "peak", "runs", "expected"),
    [
        (1.6, 1.9, 9, "met"), (1.2, 1.4, 9, "not met"), (2.5, 3.0, 9, "larger than claimed"),
        (1.2, 1.7, 9, "not met on average, met at the largest error"),
        (1.2, 2.7, 9, "not met on average, exceeded at the largest error"),
        (1.6, 1.9, 1, "none from a single run"),
    ],
)  # fmt: skip
def test_verdict_on_growth(mean: float, peak: float, runs: int, expected: str) -> None:
    assert growth_verdict(mean, peak, runs) == expected


def test_ages_of_reports(result: Any) -> None:
    """Monotone, and knowing the age helps."""
    for i, (expected, reach) in enumerate(
        (((0.0300, 0.0350, 0.0470, 0.0778), 0.0010), ((0.0543, 0.0557, 0.0609, 0.0791), 0.0015))
    ):
        unknown, known = result["/summary/latency_rmse"][i].T
        assert np.all(np.abs(unknown - expected) <= wider(result) * reach), unknown
        assert np.all(np.diff(unknown) > 0)
        assert np.all(known <= unknown + 1e-12)
    assert abs(result["/summary/latency_rmse"][0, 1, 1] - 0.0307) <= wider(result) * 0.001
    assert abs(result["/summary/latency_rmse"][0, 2, 1] - 0.0336) <= wider(result) * 0.0012


def test_roll_and_track_rate_do_as_well(result: Any) -> None:
    for name in ("L4 roll", "L4 track rate"):
        assert rmse(result, name) < 1.05 * rmse(result, "L4")


def test_map_has_the_claim_where_a_second_program_finds_it(result: Any) -> None:
    """Best Singer over best L4 within 6 % of a second program's map (its runs and grids are others)."""
    expected = {
        0.5: (1.51, 1.59, 1.67, 1.79, 1.96), 1.0: (1.44, 1.52, 1.61, 1.75, 1.97), 2.0: (1.32, 1.42, 1.53, 1.69, 1.88),
        10.0: (1.01, 1.02, 1.05, 1.11, 1.19),
    }  # fmt: skip
    for period, row in ((float(each), expected[each]) for each in result["/map/scan_period"] if each in expected):
        found = result["/map/ratio"][list(result["/map/scan_period"]).index(period)]
        np.testing.assert_allclose(found, row, rtol=0.06)
    assert np.all(result["/map/ratio"][-1] < 1.5)


def test_deterministic_run_follows_the_truth() -> None:
    """Without noise, quantisation and latency L4 is right to its discretisation, the literal formula is not."""
    quiet = compute(scenario(noise="none", further_periods_s=[]), 1, None)
    time = quiet["/time"]
    late = time > 60
    assert np.abs(quiet["/filters/L4/error_deg"][0, late]).max() < 2e-3
    assert np.abs(quiet["/filters/L1/error_deg"][0, late]).max() > 0.5
    assert "/map/ratio" not in quiet


def test_stamped_nodes_are_the_true_values() -> None:
    """Reports without noise, half a second old: interpolated at the scan before, held and turned on at this one."""
    quiet = scans(scenario(noise="none"), FLIGHT, 1.0, draw(1, 1, 407), 0.5, 0.08)
    perfect, none = Onboard(np.zeros(8), np.zeros(8)), np.zeros((1, 407, 8))
    then = at(FLIGHT, np.maximum(quiet.time - 0.5, 0.0))
    before, now = stamped(nodes(reported(then, none, perfect), "load", 1.0), 1.0, 0.5)
    truth = nodes(reported(at(FLIGHT, quiet.time), none, perfect), "load", 1.0)
    k = np.arange(2, 407)
    assert np.abs(before[0, k, 3] - truth[0, k - 1, 3]).max() < 0.02
    assert np.abs(now[0, k, 3] - truth[0, k, 3]).max() < 0.01
