"""`kind: mls-elevation` against a second program, chi-square tables, finite differences.

The figures: `docs/theory/elevation.md`, sections 1 to 4.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from navsim.scenario.tracking.elevation import Elevation
from navsim.study.tracking.elevation import BANDS, Proof, audit, compute, coverage, nominal, prove, smallest_number
from navsim.tracking import mls
from navsim.tracking.elevation import model
from navsim.tracking.kalman import covariance_sequence, predict, singer, steady_state, update
from tests.conftest import Within

PERIOD, R, Q = 0.0247, 0.0036, 1e-4
P0 = np.diag([0.625, 0.006])


def scenario(**sections: object) -> Elevation:
    return Elevation.model_validate({"kind": "mls-elevation", "version": 1, **sections})


SEQUENCE = {
    1: (3.5793828754e-3, 8.4873829647e-7, 6.0999650603e-3, 0.99427302, 0.00023576),
    2: (1.7957766968e-3, 7.5936689288e-5, 6.1967690142e-3, 0.49882686, 0.02109352),
    5: (7.3430618005e-4, 3.0850320250e-4, 6.4341594594e-3, 0.20397394, 0.08569533),
}


@pytest.mark.validates(
    "Covariance and gain of the elevation filter, step by step",
    "a second program",
    "(relative)",
    covariance="1e-9",
    gain="5e-9",
)
def test_covariance_sequence(within: Within) -> None:
    m = model("paper", PERIOD, Q, 1.0, R)
    covariances, gains = covariance_sequence(m.phi, m.q, m.h, m.r, P0, 5)
    for k, (p11, p12, p22, k1, k2) in SEQUENCE.items():
        p = covariances[k - 1]
        np.testing.assert_allclose([p[0, 0], p[0, 1], p[1, 1]], [p11, p12, p22], rtol=within["covariance"])
        np.testing.assert_allclose(gains[k - 1, :, 0], [k1, k2], atol=within["gain"])


@pytest.mark.parametrize("sigma", [1e-9, 1e-4, 1.0, 1e6])
@pytest.mark.parametrize(("alpha", "period"), [(1e-9, 0.1), (1e-6, 0.001), (1e-3, 1.0), (1.0, 1.0), (1e3, 0.001)])
def test_steady_state_where_noises_differ_by_powers_of_ten(alpha: float, period: float, sigma: float) -> None:
    """Solves the Riccati equation, with variances; by eigenvalues some of these were negative, without a word."""
    decay = 1.0 - alpha * period
    phi, h = np.array([[1.0, period], [0.0, decay]]), np.array([[1.0, 0.0]])
    q = np.diag([0.0, sigma**2 * (1.0 - decay**2)])
    for measured in (1e-9, 1.0, 1e6):
        r = np.array([[measured**2]])
        p, gain = steady_state(phi, q, h, r)
        size = np.sqrt(np.diag(p))
        assert np.all(size > 0.0)
        before = phi @ p @ phi.T + q
        np.testing.assert_allclose(gain, before @ h.T / (before[0, 0] + r), rtol=1e-9)
        keep = np.eye(2) - gain @ h
        after = keep @ before @ keep.T + gain @ r @ gain.T
        np.testing.assert_allclose(after / np.outer(size, size), p / np.outer(size, size), atol=1e-9)


@pytest.mark.validates(
    "Steady state of the elevation filter", "closed form of the alpha-beta quartic", "(relative)", covariance="1e-10"
)
def test_steady_state_closed_form(within: Within) -> None:
    m = model("paper", PERIOD, Q, 1.0, R)
    p, gain = steady_state(m.phi, m.q, m.h, m.r)
    share = Q * PERIOD**2 / R
    roots = np.roots(np.polysub([1, 0, 0, 0, 0], share * np.polymul(np.polymul([-1, 2], [-1, 2]), [-1, 1])))
    a = float(next(r.real for r in roots if abs(r.imag) < 1e-12 and 0 < r.real < 1))
    b = a**2 / (2 - a)
    np.testing.assert_allclose(gain[:, 0], [a, b / PERIOD], rtol=within["covariance"])
    closed = [a * R, b / PERIOD * R, a * b * R / ((1 - a) * PERIOD**2)]
    np.testing.assert_allclose([p[0, 0], p[0, 1], p[1, 1]], closed, rtol=within["covariance"])
    np.testing.assert_allclose(
        [p[0, 0], p[0, 1], p[1, 1]], [3.12325186245e-4, 5.73382491340e-4, 2.20528958825e-3], rtol=1e-10
    )
    for kind, expected in (("full", 3.12274e-4), ("singer", 2.52982e-4)):
        m = model(kind, PERIOD, Q, 1.0, R)
        assert steady_state(m.phi, m.q, m.h, m.r)[0][0, 0] == pytest.approx(expected, rel=5e-6)
    for q, expected in ((8.398e-5, 2.995534e-4), (7.4622e-6, 1.667513e-4), (1.19395e-8, 3.398441e-5)):
        m = model("paper", PERIOD, q, 1.0, R)
        assert steady_state(m.phi, m.q, m.h, m.r)[0][0, 0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.validates(
    "Exact Singer discretisation",
    "published MathWorks example; a second program",
    "(relative)",
    **{"to its digits": "5e-5", "second program": "1e-9"},
)
def test_singer(within: Within) -> None:
    _, q = singer(1.0, 1.0 / 20.0, 1.0)
    np.testing.assert_allclose(
        q[np.triu_indices(3)], [0.0049, 0.0121, 0.0159, 0.0321, 0.0476, 0.0952], rtol=0.0, atol=within["to its digits"]
    )
    phi, q = singer(PERIOD, 1.0, 1.0)
    np.testing.assert_allclose(
        phi[:, 2], [3.02548895276e-4, 0.0243974511047, 0.975602548895], rtol=within["second program"]
    )
    expected = [9.06853110875e-10, 9.1535834033e-8, 4.9006736131e-6, 9.86217014549e-6, 5.95235620407e-4, 0.048199666589]
    np.testing.assert_allclose(q[np.triu_indices(3)], expected, rtol=within["second program"])


ANGLES = [
    (mls.level_leg, 0.0, (0.763898461, 0.007638079, 0.0001209091)),
    (mls.level_leg, 60.0, (1.607880370, 0.025374258, 0.0006596934)),
    (mls.level_leg, 80.0, (2.290610043, 0.045763402, 0.0015415906)),
    (mls.glide, 10.0, (2.290610043, 0.0, 0.0)),
    (lambda s: mls.flare(s, mls.FLARE_STATION), 0.0, (0.365434596, -0.059561180, 0.0098128977)),
    (lambda s: mls.flare(s, mls.FLARE_STATION), 5.0, (0.162385791, -0.026210683, 0.0042867331)),
    (lambda s: mls.flare(s, mls.FLARE_STATION), mls.FLARE, (0.032740442, -0.005144925, 0.0008255930)),
]


@pytest.mark.validates(
    "beta, beta', beta'' on the four segments",
    "a second program; finite differences",
    angles="1e-9",
    differences="1e-6",
)
@pytest.mark.parametrize(("leg", "t", "expected"), ANGLES)
def test_angles(leg, t: float, expected: tuple[float, float, float], within: Within) -> None:  # type: ignore[no-untyped-def]
    values = [float(x[0]) for x in mls.elevation(leg(np.array([t])))]
    np.testing.assert_allclose(values, expected, rtol=0, atol=within["angles"])
    step = 1e-3
    at = np.array([t - step, t, t + step]) + (step if t == 0.0 else 0.0)
    beta, rate, second = mls.elevation(leg(at))
    assert (beta[2] - beta[0]) / (2 * step) == pytest.approx(rate[1], rel=within["differences"], abs=1e-12)
    assert (rate[2] - rate[0]) / (2 * step) == pytest.approx(second[1], rel=within["differences"], abs=1e-12)


@pytest.mark.validates("Chances of the bands and the runs they need", "scipy.stats.chi2", chance="1e-12")
def test_bands(within: Within) -> None:
    table = {"std_theory": (0.955238645, 0.953041804, 48), "std_sample": (0.943881932, 0.941563968, 53),
             "variance": (0.685985351, 0.681086281, 191)}  # fmt: skip
    limits = {"std_theory": (0.64, 1.44), "std_sample": (1 / 1.44, 1 / 0.64), "variance": (0.8, 1.2)}
    for band, (fifty, less_one, needed) in table.items():
        assert coverage(band, 0.2, 50) == pytest.approx(fifty, abs=1e-8)
        assert coverage(band, 0.2, 49) == pytest.approx(less_one, abs=1e-8)
        low, high = limits[band]
        assert coverage(band, 0.2, 50) == pytest.approx(
            chi2.cdf(50 * high, 50) - chi2.cdf(50 * low, 50), abs=within["chance"]
        )
        assert smallest_number(band, 0.2, 0.95) == needed
        assert coverage(band, 0.2, needed) >= 0.95 > coverage(band, 0.2, needed - 1)
    assert [smallest_number("std_theory", 0.2, c) for c in (0.9, 0.99, 0.999)] == [34, 83, 135]
    assert [smallest_number("std_sample", 0.2, c) for c in (0.9, 0.99, 0.999)] == [37, 97, 166]


@pytest.fixture(scope="module")
def proof() -> Proof:
    return prove(scenario(), 1, 50, 200, lambda _: None)


def test_two_hundred_experiments(proof: Proof) -> None:
    """Shares of steps inside the bands, 3.5 standard errors; no single experiment far below."""
    for b, (mean, reach) in enumerate(((0.955, 0.009), (0.943, 0.011), (0.685, 0.021))):
        assert abs(proof.inside[:, b].mean() - mean) <= reach, BANDS[b]
    assert proof.inside[0, 0] >= 0.84


def test_twenty_thousand_runs() -> None:
    """Sample variance within 5 % of P11 at every step; NEES and NIS of them."""
    big = prove(scenario(), 2, 20_000, 1, lambda _: None)
    ratio = big.sample[:, 0, 0] / big.covariance[:, 0, 0]
    assert np.all(np.abs(ratio - 1.0) <= 0.05), ratio
    assert abs(big.nis - 1.0) <= 0.008
    assert abs(big.nees - 2.0) <= 0.05


@pytest.mark.parametrize("kind", ["full", "singer"])
def test_other_models_are_consistent(kind: str) -> None:
    found = prove(scenario(filter={"model": kind}), 1, 500, 4, lambda _: None)
    states = found.covariance.shape[1]
    assert abs(found.nees / states - 1.0) <= 0.03
    assert abs(found.nis - 1.0) <= 0.008


def test_nominal_approach() -> None:
    flown = nominal(scenario())
    before = int(np.searchsorted(flown.time, 80.0)) - 1
    assert flown.bias[0, before] == pytest.approx(-2.12451e-4, rel=1e-4)
    late = flown.time > 65.0
    for i, (peak, at, worst) in enumerate(
        ((0.0075357, 80.4269, 0.01716), (0.014497, 80.85, 0.01834), (0.06465, None, 0.06485))
    ):
        bias = np.where(late, flown.bias[i], 0.0)
        k = int(np.argmax(np.abs(bias)))
        assert bias[k] == pytest.approx(peak, rel=1e-4)
        if at is not None:
            assert flown.time[k] == pytest.approx(at, abs=0.01)
        assert np.hypot(flown.bias[i], flown.noise[i])[late].max() == pytest.approx(worst, rel=1e-3)
    assert flown.noise[0, -1] == pytest.approx(0.015418, rel=1e-4)


def test_every_number_of_the_paper_is_reported() -> None:
    printed = [row.published for row in audit()]
    for number in (2.4, 0.042, 0.0042, 0.0002, 0.032, 17e-4, 3.6e-8, 11.5e-4, 1e-4, 50):
        assert number in printed
    result = compute(scenario(montecarlo={"experiments": 2}), 1, None)
    assert list(result["/audit/published"]) == printed
    computed = dict(zip(result["/audit/statement"], result["/audit/computed"], strict=True))
    assert computed["sigma^2 of beta'' at 5000/200, along"] == pytest.approx(2.416903e-7, rel=1e-6)
    assert computed["Q at 1 km, up"] == pytest.approx(1.86555e-4, rel=1e-5)


def test_small_kernels_equal_matrix_algebra() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 5):
        root = rng.standard_normal((n, n))
        p, x, phi = root @ root.T + np.eye(n), rng.standard_normal(n), rng.standard_normal((n, n))
        moved, flat = x.copy(), p.copy()
        predict(moved, flat, phi, np.eye(n), np.empty((n, n)))
        np.testing.assert_allclose(moved, phi @ x, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(flat, phi @ p @ phi.T + np.eye(n), rtol=1e-12, atol=1e-12)
        for index in range(n):
            weighed, after, gain = x.copy(), p.copy(), np.empty(n)
            nis = update(weighed, after, index, 0.7, 0.3, gain)
            h = np.eye(n)[index : index + 1]
            k = p @ h.T / (p[index, index] + 0.3)
            keep = np.eye(n) - k @ h
            np.testing.assert_allclose(after, keep @ p @ keep.T + 0.3 * k @ k.T, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(weighed, x + 0.7 * k[:, 0], rtol=1e-12)
            assert nis == pytest.approx(0.49 / (p[index, index] + 0.3))
