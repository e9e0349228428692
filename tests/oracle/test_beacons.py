"""Ranging beacons against dense algebra, a free-space link and the fusion rule of an autopilot."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.stats import exponnorm, norm

from navsim.filter import states
from navsim.filter.error_products import move_products, start_products
from navsim.filter.measurement_kinds import BEACON, PRODUCT, Measurements
from navsim.filter.measurement_models import observe
from navsim.filter.outliers import outlier_moments
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.dop import dops
from navsim.gnss.ranging_geometry import mixed_dops, range_dops
from navsim.sensors.beacons import largest_range
from tests.conftest import Within
from tests.helpers import case


@pytest.mark.validates("DOPs of two-way and one-way ranges, alone and with satellites",
                       "numpy pseudoinverse, 1000 layouts", "(relative)", DOPs="1e-9")  # fmt: skip
def test_two_way_dops(within: Within) -> None:
    """The Fisher information of ranges of unit sigma is the sum of u u'; its inverse is the Cramer-Rao bound.

    Satellites add a column for each of their clocks, one-way ranges one of their own."""
    rng = np.random.default_rng(42)
    for _ in range(1000):
        away = rng.uniform(-1.0, 1.0, (int(rng.integers(4, 9)), 3)) * [800.0, 800.0, rng.uniform(30.0, 300.0)]
        u = away / np.sqrt((away**2).sum(axis=1))[:, None]
        bound = np.linalg.pinv(sum(np.outer(one, one) for one in u))
        expected = [bound.trace(), bound[0, 0] + bound[1, 1], bound[2, 2]]
        for own in (range_dops(away[None]), mixed_dops(away[None], np.empty((1, 0, 3)), np.empty(0, np.int64))):
            np.testing.assert_allclose(own[0], np.sqrt(expected), rtol=within["DOPs"])

        if len(u) > 4:
            h = np.column_stack([-u, np.ones(len(u))])
            bound = np.linalg.pinv(h) @ np.linalg.pinv(h).T
            expected = [bound[:3, :3].trace(), bound[0, 0] + bound[1, 1], bound[2, 2]]
            none = np.empty((1, 0, 3)), np.empty(0, np.int64)
            for own in (range_dops(away[None], one_way=True), mixed_dops(away[None], *none, 2)):
                np.testing.assert_allclose(own[0], np.sqrt(expected), rtol=within["DOPs"])

        count = int(rng.integers(0, 7))
        los, clock = rng.standard_normal((count, 3)), rng.integers(0, 3, count)
        los /= np.linalg.norm(los, axis=1, keepdims=True)
        columns = (clock[:, None] == np.unique(clock)).astype(float)
        h = np.block([[-u, np.zeros((len(u), columns.shape[1]))], [-los, columns]])
        bound = np.linalg.pinv(h, rcond=1e-15) @ np.linalg.pinv(h, rcond=1e-15).T
        expected = [bound[:3, :3].trace(), bound[0, 0] + bound[1, 1], bound[2, 2]]
        mixed = mixed_dops(away[None], los[None], clock)[0]
        np.testing.assert_allclose(mixed, np.sqrt(expected), rtol=within["DOPs"])


@pytest.mark.validates("DOPs of beacons, without and with a clock", "sidereon 3.0.4, 1000 layouts", "(relative)",
                       DOPs="1e-9")  # fmt: skip
def test_dops_of_another_program(within: Within) -> None:
    """It has a clock. With a beacon opposite of each that has no part in the position, whose information doubles."""
    sidereon = pytest.importorskip("sidereon", reason="the other program is not installed")
    rng = np.random.default_rng(7)
    equator = sidereon.Wgs84Geodetic(0.0, 0.0)  # up, east, north are ECEF's axes there
    for _ in range(1000):
        away = rng.uniform(-1.0, 1.0, (int(rng.integers(5, 9)), 3)) * [800.0, 800.0, rng.uniform(30.0, 300.0)]
        u = (away / np.sqrt((away**2).sum(axis=1))[:, None])[:, [2, 0, 1]]
        for one_way, lines in ((True, u), (False, np.concatenate([u, -u]))):
            theirs = sidereon.gnss_dop(lines, np.ones(len(lines)), equator)
            expected = np.sqrt(len(lines) / len(u)) * np.array([theirs.pdop, theirs.hdop, theirs.vdop])
            np.testing.assert_allclose(range_dops(away[None], one_way)[0], expected, rtol=within["DOPs"])


def test_three_beacons_are_enough_and_have_no_clock() -> None:
    """Three rows at right angles: each coordinate is a range. GDOP is PDOP, and there is no TDOP."""
    g, p, h, v, t = dops(np.eye(3)[None], np.full(3, -1))[0]
    assert (g, p, h, v) == pytest.approx((math.sqrt(3.0), math.sqrt(3.0), math.sqrt(2.0), 1.0), abs=1e-14)
    assert np.isnan(t)
    assert np.isnan(dops(np.eye(3)[None, :2], np.full(2, -1))).all()
    level = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, -0.8, 0.0]])
    assert np.isnan(dops(level[None], np.full(3, -1))).all(), "beacons at the aircraft's own height"


def test_link_budget() -> None:
    """Path loss in free space in dB, by the usual formula in km and MHz: 32.45 + 20 lg d + 20 lg f."""
    reach = largest_range(14.0, 2.0, -97.0, 868e6)
    loss = 32.4478 + 20.0 * math.log10(reach / 1e3) + 20.0 * math.log10(868.0)
    assert loss == pytest.approx(14.0 + 2.0 + 97.0, abs=1e-3)


@pytest.mark.validates("Filter update by a range that may be an outlier", "posterior by numerical integration",
                       "(relative)", moments="1e-6")  # fmt: skip
@pytest.mark.parametrize("mixture", [(0.0, 1.0, 0.3, 2.0), (0.1, 4.0, 0.0, 1.0), (0.05, 9.0, 0.2, 1.5)])
def test_update_with_a_mixture(within: Within, mixture: tuple[float, ...]) -> None:
    """Prior N(0, a), z = x + noise + D: mean and variance of x given z, and the likelihood of z."""
    wide, variance, long_share, long = mixture
    for a, r, z in itertools.product((0.01, 4.0), (0.01, 0.09), (-1.0, -0.1, 0.0, 0.4, 3.0)):
        s = a + r
        x = np.linspace(-16.0, 16.0, 20001) * math.sqrt(a)
        left = z - x
        clean = norm.pdf(left, scale=math.sqrt(r))
        both = norm.pdf(left, scale=math.sqrt(r + variance))
        late = exponnorm.pdf(left, long / math.sqrt(r), scale=math.sqrt(r))
        density = norm.pdf(x, scale=math.sqrt(a)) * (
            (1.0 - wide - long_share) * clean + wide * both + long_share * late
        )
        total = simpson(density, x=x)
        mean = simpson(density * x, x=x) / total
        second = simpson(density * (x - mean) ** 2, x=x) / total
        shift, spread, q, size, _ = outlier_moments(z, math.sqrt(s), np.array(mixture))
        gain = a / s
        assert gain * (z - shift) == pytest.approx(mean, rel=within["moments"], abs=1e-6 * math.sqrt(a))
        assert a - gain * a + gain**2 * spread == pytest.approx(second, rel=within["moments"])
        likelihood = math.exp(-0.5 * q) / size / math.sqrt(2.0 * math.pi)
        assert likelihood == pytest.approx(total, rel=within["moments"])


def test_products_of_the_position_error() -> None:
    """Covariance of products against drawn ones; a correction of the estimate against G P G'; second derivatives of a
    range with a growing bias against differences of ranges."""
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    rng, n, first = np.random.default_rng(8), states.SENSORS + 12, states.SENSORS + 6
    root = rng.standard_normal((n, n))
    p, nav = root @ root.T, np.zeros(states.NAV_SENSORS + 12)
    p[first:, :3] = p[:3, first:] = 0.0
    start_products(first, nav, p)
    drawn = rng.multivariate_normal(np.zeros(3), p[:3, :3], 100_000)
    products = np.array([drawn[:, i] * drawn[:, j] for i, j in pairs])
    scale = np.sqrt(np.diag(p)[first:])
    np.testing.assert_allclose(products.mean(axis=1), nav[-6:], atol=0.02 * scale.max())
    np.testing.assert_allclose(np.cov(products) / np.outer(scale, scale), p[first:, first:] / np.outer(scale, scale),
                               atol=0.03)  # fmt: skip
    assert not p[first:, :first].any()

    before, mean, x, g = root @ root.T, nav[-6:].copy(), rng.standard_normal(n), np.eye(n)
    p = before.copy()
    for row, (i, j) in enumerate(pairs):
        g[first + row, i] -= x[j]
        g[first + row, j] -= x[i]
    move_products(first, x, True, nav, p)
    np.testing.assert_allclose(p, g @ before @ g.T, rtol=1e-12, atol=1e-12 * np.abs(before).max())
    np.testing.assert_allclose(nav[-6:], mean - [x[i] * x[j] for i, j in pairs], rtol=1e-12)

    flown = case("duration_s=30", "receiver.rate_hz=1", "filter.kind=eskf", "filter.beacons.second_order=true",
                 "beacons={sites: [{s_m: 60, l1_m: 2500, height_m: 90}], rate_hz: 6, sigma_m: 0.4, "
                 "range_limit_m: 9000, bias_sigma_m: 0, growth_m: 3, growth_distance_m: 50}")  # fmt: skip
    (aid,) = flown.shared.aids
    tables, declared = Measurements.of({BEACON: aid.table(aid.measured(5, 0))}), flown.flight.model.declared
    assert (declared["sensor"][-6:] == PRODUCT).all()
    nav, zs = np.zeros(states.NAV_SENSORS + declared.size), []
    nav[states.NAV_QUAT] = 1.0
    nav[states.NAV_LLH : states.NAV_VEL] = here = flown.trajectory.llh(aid.time)[100]
    for products in (np.zeros(6), mean):
        nav[-6:] = products
        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, states.SENSORS + declared.size)), np.zeros((6, 6))
        observe(BEACON, 100, tables, nav, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r)
        zs.append(z[0])
    lat, lon = here[:2]
    north = [-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)]
    down = [-math.cos(lat) * math.cos(lon), -math.cos(lat) * math.sin(lon), -math.sin(lat)]
    axes = np.array([north, [-math.sin(lon), math.cos(lon), 0.0], down])
    away = axes @ (wgs84(*aid.sensor.positions(aid.frame)[0]) - wgs84(*here))

    def range_at(*moved: np.ndarray) -> float:
        d = float(np.linalg.norm(away - np.sum(moved, axis=0)))
        return d + 3.0 * (1.0 - math.exp(-d / 50.0))

    one, expected = 0.3 * np.eye(3), []
    for i, j in pairs:
        a, b = one[i], one[j]
        mixed = range_at(a, b) - range_at(a, -b) - range_at(-a, b) + range_at(-a, -b)
        expected.append(mixed / 0.36 * (0.5 if i == j else 1.0))
    np.testing.assert_allclose(h[0, -6:], expected, atol=1e-5 * np.abs(expected).max())
    assert zs[0] - zs[1] == pytest.approx(h[0, -6:] @ mean, rel=1e-8)


def wgs84(lat: float, lon: float, height: float) -> np.ndarray:
    """ECEF coordinates, written down anew."""
    a, f = 6378137.0, 1.0 / 298.257223563
    e2 = f * (2.0 - f)
    n = a / math.sqrt(1.0 - e2 * math.sin(lat) ** 2)
    level = (n + height) * math.cos(lat)
    return np.array([level * math.cos(lon), level * math.sin(lon), (n * (1.0 - e2) + height) * math.sin(lat)])


@pytest.mark.validates("Predicted range, its variance and gate, of a beacon without bias",
                       "fusion rule of PX4's EKF2, written anew", ranges="1e-11 (relative)",
                       variance="1e-9 (relative)")  # fmt: skip
def test_rule_of_an_autopilot(within: Within) -> None:
    """Innovation |p - p_beacon| - r in ECEF, R the larger of reported and configured noise, rejection where the squared
    innovation exceeds gate^2 (H P H' + R), H the unit vector from the beacon. The IMU is at the antenna."""
    sites = "[{s_m: 300, l1_m: 900, height_m: 20}, {s_m: -250, l1_m: 400}, {s_m: 50, l1_m: -600, height_m: 4}]"
    flown = case("duration_s=30", "receiver.rate_hz=1",
                 f"beacons={{sites: {sites}, rate_hz: 6, sigma_m: 0.4, range_limit_m: 9000}}")  # fmt: skip
    (aid,) = flown.shared.aids
    measured = aid.measured(5, 0)
    tables = Measurements.of({BEACON: aid.table(measured)})
    declared, llh = flown.flight.model.declared, aid.sensor.positions(aid.frame)
    n = states.SENSORS + declared.size
    rng, gate = np.random.default_rng(6), 5.0
    root = rng.standard_normal((n, n)) * 0.3
    p = root @ root.T
    truth, rejected = flown.trajectory.llh(aid.time), 0
    for row in range(aid.time.size):
        nav = np.zeros(states.NAV_SENSORS + declared.size)
        nav[states.NAV_QUAT] = 1.0
        nav[states.NAV_LLH : states.NAV_VEL] = truth[row] + np.array([1e-6, -2e-6, 5.0]) * rng.standard_normal(3)
        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, n)), np.zeros((6, 6))
        observe(BEACON, row, tables, nav, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r)

        lat, lon, height = nav[states.NAV_LLH : states.NAV_VEL]
        delta = wgs84(lat, lon, height) - wgs84(*llh[row % 3])
        innovation = math.sqrt(delta @ delta) - measured[row, 0]
        # both differ by rounding alone: a coordinate of 6e6 m is rounded to 9e-10 m
        assert measured[row, 0] - z[0] == pytest.approx(math.sqrt(delta @ delta), rel=within["ranges"])
        assert -z[0] == pytest.approx(innovation, abs=4e-9)
        reported = 0.4**2
        assert r[0, 0] == pytest.approx(max(reported, 0.1**2), abs=1e-15)
        north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
        east = np.array([-math.sin(lon), math.cos(lon), 0.0])
        up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
        unit = delta / math.sqrt(delta @ delta)
        along = np.array([unit @ north, unit @ east, -unit @ up])
        variance = along @ p[:3, :3] @ along + max(reported, 0.1**2)
        assert h[0] @ p @ h[0] + r[0, 0] == pytest.approx(variance, rel=within["variance"])
        ours = z[0] ** 2 > gate**2 * (h[0] @ p @ h[0] + r[0, 0])
        assert ours == (innovation**2 > gate**2 * variance)
        rejected += ours
    assert 0 < rejected < aid.time.size
    np.testing.assert_allclose(wgs84(*llh[0]), ecef_from_llh(llh[0]), atol=1e-8)
