"""`kind: mls-elevation` against a second program, chi-square tables, finite differences.

The figures: `docs/theory/elevation.md`, sections 1 to 4.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.stats import chi2

from navsim.companions.elevation import mls
from navsim.companions.elevation.filter import model
from navsim.companions.elevation.report import criterion_verdict, tables
from navsim.companions.elevation.scenario import Elevation
from navsim.companions.elevation.study import BANDS, Proof, audit, compute, coverage, nominal, prove, smallest_number
from navsim.companions.kalman import covariance_sequence, predict, singer, steady_state, update
from navsim.report.table import Table
from navsim.results.result import Result
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


@pytest.mark.validates("Covariance and gain of the elevation filter, step by step", "independent script", "(relative)",
                       covariance="1e-9", gain="5e-9")  # fmt: skip
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


@pytest.mark.validates("Steady state of the elevation filter", "closed form of the alpha-beta quartic", "(relative)",
                       covariance="1e-10")  # fmt: skip
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


@pytest.mark.validates("Exact Singer discretisation", "published MathWorks example; independent script", "(relative)",
                       **{"published digits": "5e-5", "script": "1e-9"})  # fmt: skip
def test_singer(within: Within) -> None:
    _, q = singer(1.0, 1.0 / 20.0, 1.0)
    np.testing.assert_allclose(
        q[np.triu_indices(3)],
        [0.0049, 0.0121, 0.0159, 0.0321, 0.0476, 0.0952],
        rtol=0.0,
        atol=within["published digits"],
    )
    phi, q = singer(PERIOD, 1.0, 1.0)
    np.testing.assert_allclose(phi[:, 2], [3.02548895276e-4, 0.0243974511047, 0.975602548895], rtol=within["script"])
    expected = [9.06853110875e-10, 9.1535834033e-8, 4.9006736131e-6, 9.86217014549e-6, 5.95235620407e-4, 0.048199666589]
    np.testing.assert_allclose(q[np.triu_indices(3)], expected, rtol=within["script"])


@pytest.mark.parametrize("ratio", [5.0, 24.7, 1e3, 6e4])
def test_singer_over_many_correlation_times(ratio: float) -> None:
    """The closed form, which keeps its digits there; van Loan's method overflowed."""
    t, e, alpha = 0.5, np.exp(-ratio), ratio / 0.5
    phi, q = singer(t, alpha, 2.0)
    x = ratio
    np.testing.assert_allclose(phi[:, 2], [(x - 1 + e) / alpha**2, (1 - e) / alpha, e], rtol=1e-10, atol=1e-30)
    closed = [
        (1 - e**2 + 2 * x + 2 * x**3 / 3 - 2 * x**2 - 4 * x * e) / (2 * alpha**5),
        (e**2 + 1 - 2 * e + 2 * x * e - 2 * x + x**2) / (2 * alpha**4), (1 - e**2 - 2 * x * e) / (2 * alpha**3),
        (4 * e - 3 - e**2 + 2 * x) / (2 * alpha**3), (e**2 + 1 - 2 * e) / (2 * alpha**2), (1 - e**2) / (2 * alpha),
    ]  # fmt: skip
    np.testing.assert_allclose(q[np.triu_indices(3)], 2 * alpha * 4.0 * np.array(closed), rtol=1e-9)


ANGLES = [
    (mls.level_leg, 0.0, (0.763898461, 0.007638079, 0.0001209091)),
    (mls.level_leg, 60.0, (1.607880370, 0.025374258, 0.0006596934)),
    (mls.level_leg, 80.0, (2.290610043, 0.045763402, 0.0015415906)),
    (mls.glide, 10.0, (2.290610043, 0.0, 0.0)),
    (lambda s: mls.flare(s, mls.FLARE_STATION), 0.0, (0.365434596, -0.059561180, 0.0098128977)),
    (lambda s: mls.flare(s, mls.FLARE_STATION), 5.0, (0.162385791, -0.026210683, 0.0042867331)),
    (lambda s: mls.flare(s, mls.FLARE_STATION), mls.FLARE, (0.032740442, -0.005144925, 0.0008255930)),
]


@pytest.mark.validates("Elevation beta and its derivatives on the four segments",
                       "independent script; finite differences", angles="1e-9",
                       differences="1e-6 (relative)")  # fmt: skip
@pytest.mark.parametrize(("leg", "t", "expected"), ANGLES)
def test_angles(leg: Any, t: float, expected: tuple[float, float, float], within: Within) -> None:
    values = [float(x[0]) for x in mls.elevation(leg(np.array([t])))]
    np.testing.assert_allclose(values, expected, rtol=0, atol=within["angles"])
    step = 1e-3
    at = np.array([t - step, t, t + step]) + (step if t == 0.0 else 0.0)
    beta, rate, second = mls.elevation(leg(at))
    assert (beta[2] - beta[0]) / (2 * step) == pytest.approx(rate[1], rel=within["differences"], abs=1e-12)
    assert (rate[2] - rate[0]) / (2 * step) == pytest.approx(second[1], rel=within["differences"], abs=1e-12)


@pytest.mark.validates("Probabilities of accuracy bands, and the runs that they need", "scipy.stats.chi2",
                       probability="1e-12")  # fmt: skip
def test_bands(within: Within) -> None:
    table = {"std_theory": (0.955238645, 0.953041804, 48), "std_sample": (0.943881932, 0.941563968, 53),
             "variance": (0.685985351, 0.681086281, 191)}  # fmt: skip
    limits = {"std_theory": (0.64, 1.44), "std_sample": (1 / 1.44, 1 / 0.64), "variance": (0.8, 1.2)}
    for band, (fifty, less_one, needed) in table.items():
        assert coverage(band, 0.2, 50) == pytest.approx(fifty, abs=1e-8)
        assert coverage(band, 0.2, 49) == pytest.approx(less_one, abs=1e-8)
        low, high = limits[band]
        assert coverage(band, 0.2, 50) == pytest.approx(
            chi2.cdf(50 * high, 50) - chi2.cdf(50 * low, 50), abs=within["probability"]
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


def kalman(phi: Any, q: Any, r: Any, p0: Any, x0: Any, angle: Any) -> Any:
    """A plain Kalman filter of one measured angle: bias (k,) without noise, and 1 sigma (k,) of what noise adds, which
    is the root of the sum of its squared responses to a unit error of each measurement."""
    n = len(x0)
    r = np.broadcast_to(r, angle.shape)
    x, p, carry = np.array(x0, dtype=float), np.array(p0, dtype=float), np.zeros((n, angle.size))
    bias, noise = np.empty(angle.size), np.empty(angle.size)
    for k, true in enumerate(angle):
        x, p, carry = phi @ x, phi @ p @ phi.T + q, phi @ carry
        gain = p[:, 0] / (p[0, 0] + r[k])
        x = x + gain * (true - x[0])
        p = p - np.outer(gain, p[0])
        carry -= np.outer(gain, carry[0])
        carry[:, k] += gain
        bias[k], noise[k] = x[0] - true, np.sqrt((carry[0] ** 2 * r).sum())
    return bias, noise


@pytest.fixture(scope="module")
def result() -> Result:
    return compute(scenario(montecarlo={"experiments": 2}), 1, None)


SECOND = np.array([[1.0, PERIOD], [0.0, 1.0]])


@pytest.mark.validates("First-order filters on the nominal approach", "a plain numpy filter; closed form of the lag",
                       bias="1e-9 deg", **{"lag (relative)": "5e-3"})  # fmt: skip
def test_first_order_filters(result: Result, within: Within) -> None:
    time = 60.0 + PERIOD * np.arange(1, scenario().nominal_steps + 1)
    angle = np.degrees(np.arctan2(np.where(time < 80, 200.0, 0.0), 15000 - 150 * time + 0.3125 * time**2))
    angle = np.where(time < 80, angle, np.degrees(np.arctan(0.04)))
    k1 = float(result["/filter/steady_gain"][0])
    np.testing.assert_allclose(result["/order/variance"][:3], [Q, 0.006 * PERIOD**2, k1**2 / (1 - k1) * R], rtol=1e-9)
    for i, variance in enumerate(result["/order/variance"]):
        if i == 0:
            bias, noise = kalman(SECOND, np.diag([0.0, Q]), R, P0, [2.4, 0.0042], angle)
        else:
            bias, noise = kalman(np.eye(1), np.array([[variance]]), R, [[0.625]], [2.4], angle)
            gain = result["/order/gain"][i]
            assert gain**2 / (1 - gain) * R == pytest.approx(variance, rel=1e-9)
            late = PERIOD * (1 - gain) / gain
            lag = -late * mls.approach(np.array([time[time < 80][-1] - late]))[1][0]
            assert result["/order/before"][i] == pytest.approx(lag, rel=within["lag (relative)"])
            assert result["/order/recovery"][i] == pytest.approx(-np.log(0.1) * -PERIOD / np.log(1 - gain), abs=0.05)
        np.testing.assert_allclose(result["/order/bias"][i], bias, rtol=0, atol=within["bias"])
        np.testing.assert_allclose(result["/order/noise"][i], noise, rtol=1e-8)
        late = time >= 65.0
        assert result["/order/worst_rmse"][i] == pytest.approx(np.hypot(bias, noise)[late].max(), rel=1e-8)
    np.testing.assert_array_equal(result["/order/bias"][0], result["/nominal/bias"][0])
    assert result["/order/sigma"][2] == pytest.approx(result["/order/sigma"][0], rel=1e-12)
    # no other first-order filter has less error before the capture
    least = np.hypot(result["/order/before"], result["/order/noise"][:, int((80 - 60) / PERIOD) - 1])[3]
    for factor in (0.5, 0.8, 1.25, 2.0):
        bias, noise = kalman(np.eye(1), factor * result["/order/variance"][3:, None], R, [[0.625]], [2.4], angle)
        assert np.hypot(bias, noise)[(time >= 65) & (time < 80)].max() > 0.999 * least
    rows = [row.texts() for row in titled(result, "First-order and second-order filter").rows]
    assert [row[-1].split(":")[0] for row in rows] == ["", "as claimed", "not as claimed", "not as claimed"]


def titled(result: Result, words: str) -> Table:
    return next(part for part in tables(result) if isinstance(part, Table) and words in part.title)


def test_criterion_of_the_second_order_model(result: Result) -> None:
    """Accelerations by differences of the angle on the paper's trajectory, the memory by the poles of its filter."""
    step = 1e-3
    expected = []
    for leg, end in ((mls.level_leg, 80.0), (lambda s: mls.flare(s, 3500.0 + 80 * mls.FLARE), 15.04)):
        t = np.arange(0.0, end, step)
        one = leg(t)
        beta = np.degrees(np.arctan2(one.h, one.d))
        expected.append(np.abs(np.diff(beta, 2)).max() / step**2)
    np.testing.assert_allclose(result["/criterion/acceleration"][[0, 2]], expected, rtol=1e-3)
    assert result["/criterion/acceleration"][1] < 1e-12
    assert result["/criterion/memory"] == pytest.approx(0.5443, abs=5e-5)
    np.testing.assert_allclose(result["/criterion/period_error"][0], 0.5 * PERIOD**2 * 0.0015415906, rtol=1e-6)
    assert result["/criterion/acceleration"][4] == pytest.approx(0.0015415, rel=1e-3)
    assert titled(result, "criterion").rows[0].texts()[-1] == "met, also over the filter's memory"
    assert criterion_verdict(1e4, 3.0) == "met over a period, not over the filter's memory"
    assert criterion_verdict(3.0, 1.0) == "not met"


@pytest.mark.validates("Model of a correlated acceleration, by its correlation time",
                       "closed form; scipy's Riccati solver", matrices="1e-6",
                       variance="1e-8 (relative)")  # fmt: skip
def test_limits_of_the_model(result: Result, within: Within) -> None:
    for i, tau in enumerate(result["/limit/correlation_time"]):
        x = PERIOD / tau
        e = np.exp(-x)
        assert result["/limit/ratio"][i] == pytest.approx(x, rel=1e-12)
        shares = np.array([2 * (x - 1 + e) / x**2, (1 - e) / x, e])
        assert result["/limit/to_velocity"][i] == pytest.approx(shares.max(), abs=within["matrices"])
        assert result["/limit/to_acceleration"][i] == pytest.approx((1 - shares).max(), abs=within["matrices"])
        assert result["/limit/drive"][i] == pytest.approx(1 - e**2, abs=within["matrices"])
        q11 = 3 * (1 - e**2 + 2 * x + 2 * x**3 / 3 - 2 * x**2 - 4 * x * e) / (2 * x**3)
        q12, q22 = (e**2 + 1 - 2 * e + 2 * x * e - 2 * x + x**2) / x**2, (4 * e - 3 - e**2 + 2 * x) / (2 * x)
        white = 1 - np.array([q11, q12, q22])
        if x > 0.02:  # below, the closed form cancels
            assert result["/limit/to_white"][i] == pytest.approx(np.abs(white).max(), abs=within["matrices"])
        phi, q = singer(PERIOD, 1 / tau, np.sqrt(Q / PERIOD / (2 * tau)))
        before = solve_discrete_are(phi.T, np.eye(3)[:, :1], q, np.array([[R]]))
        p11 = before[0, 0] - before[0, 0] ** 2 / (before[0, 0] + R)
        assert result["/limit/angle"][i] * 3.12325186245e-4 == pytest.approx(p11, rel=within["variance"])
    assert np.all(np.diff(result["/limit/to_velocity"]) < 0)
    assert np.all(np.diff(result["/limit/to_white"]) < 0)


@pytest.mark.parametrize(
    "keys",
    [{"nominal": {"to_s": 62.0}}, {"azimuth": {"to_s": 42.0}}, {"filter": {"period_s": 6.0}},
     {"nominal": {"from_s": 60.0, "to_s": 65.01}}],
)  # fmt: skip
def test_a_run_that_ends_before_it_is_judged_is_refused(keys: dict[str, object]) -> None:
    """It ended with a traceback."""
    with pytest.raises(ValueError, match=r"write at (least|most)"):
        scenario(**keys)


def test_azimuth_channel(result: Result) -> None:
    """A turn onto the centre line from two parabolas and a straight line, seen from 3954 m beyond the beacon."""
    time = 40.0 + 0.0741 * np.arange(1, scenario().azimuth_steps + 1)
    turn, left = 30.0 / 1.96133, np.maximum(75.0 - time, 0.0)
    y = np.where(left < turn, 0.5 * 1.96133 * left**2, 30.0 * left - 0.5 * 30.0 * turn)
    s = time - 80.0
    d = np.where(time < 80, 15000 - 150 * time + 0.3125 * time**2, 5000 - 100 * s + 0.2117647 * s**2) + 3953.577867
    angle = np.degrees(np.arctan(y / d))
    np.testing.assert_allclose(result["/azimuth/angle"], angle, rtol=0, atol=1e-9)
    phi = np.array([[1.0, 0.0741], [0.0, 1.0]])
    for i, q in enumerate((3e-4, 7e-6)):
        bias, noise = kalman(phi, np.diag([0.0, q]), R, P0, [3.5, -0.1], angle)
        np.testing.assert_allclose(result["/azimuth/bias"][i], bias, rtol=0, atol=1e-9)
        np.testing.assert_allclose(result["/azimuth/noise"][i], noise, rtol=1e-8)
        before = solve_discrete_are(phi.T, np.eye(2)[:, :1], np.diag([0.0, q]), np.array([[R]]))[0, 0]
        assert result["/azimuth/steady_sigma"][i] == pytest.approx(np.sqrt(before * R / (before + R)), rel=1e-8)
    step = 1e-3
    t = np.array([30.0, 65.0, 74.0, 90.0, 130.0])
    _, rate, second = mls.azimuth(t, 75.0, 30.0, 1.96133)
    above, here, below = (mls.azimuth(t + s, 75.0, 30.0, 1.96133)[0] for s in (step, 0.0, -step))
    np.testing.assert_allclose((above - below) / (2 * step), rate, atol=1e-8)
    np.testing.assert_allclose((above - 2 * here + below) / step**2, second, atol=1e-6)


@pytest.mark.validates("The flare guided by range and radio altimeter",
                       "a plain numpy filter fed with noisy ranges and heights", bias="1e-9 deg",
                       **{"touchdown, 400 runs (relative)": "0.12"})  # fmt: skip
def test_flare_guidance(result: Result, within: Within) -> None:
    """Noise of ranges and heights is drawn, and goes through the arctangent: no variance is linearised here."""
    since = PERIOD * np.arange(1, int(np.log(15) / 0.18 / PERIOD) + 1)
    h, d = 30 * np.exp(-0.18 * since), 3500 + 80 * np.log(15) / 0.18 - 80 * since
    beta = np.degrees(np.arctan(h / d))
    sigma_h = np.maximum(0.5, 0.02 * h)
    rng = np.random.default_rng(5)
    heights = h + sigma_h * rng.standard_normal((400, h.size))
    ranges = d + 15.0 * rng.standard_normal((400, h.size))
    onboard = np.degrees(np.arctan(heights / ranges))
    station = beta + 0.06 * rng.standard_normal((400, h.size))
    spread = (onboard - beta).std(axis=0)
    np.testing.assert_allclose(result["/flare/measured_sigma"][1], spread, rtol=0.2)
    assert np.mean(result["/flare/measured_sigma"][1] / spread) == pytest.approx(1.0, abs=0.01)
    weight = 1 / np.square(result["/flare/measured_sigma"][:2])
    both = (weight[0] * station + weight[1] * onboard) / weight.sum(axis=0)
    for i, (measured, r) in enumerate(
        ((station, R), (onboard, 1 / weight[1]), (both, 1 / weight.sum(axis=0)))
    ):  # fmt: skip
        for j, q in enumerate((1e-4, 8.46e-6)):
            bias, noise = kalman(SECOND, np.diag([0.0, q]), r, P0, [0.365, -0.06], beta)
            np.testing.assert_allclose(result["/flare/bias"][i, j], bias, rtol=0, atol=within["bias"])
            np.testing.assert_allclose(result["/flare/noise"][i, j], noise, rtol=1e-7)
            ends = np.array([kalman_end(SECOND, np.diag([0.0, q]), r, measured)])
            rmse = np.sqrt(np.mean((ends - beta[-1]) ** 2))
            assert result["/flare/touchdown_rmse"][i, j] == pytest.approx(
                rmse, rel=within["touchdown, 400 runs (relative)"]
            )
    lever = result["/flare/touchdown_height_rmse"] / result["/flare/touchdown_rmse"]
    np.testing.assert_allclose(lever, np.pi / 180 * d[-1] * (1 + (h[-1] / d[-1]) ** 2), rtol=1e-12)
    assert {row.texts()[-1] for row in titled(result, "flare").rows} == {"within"}


def kalman_end(phi: Any, q: Any, r: Any, measured: Any) -> Any:
    """The last estimate of the angle of each run; measured (run, k)."""
    r = np.broadcast_to(r, measured.shape[1:])
    x, p = np.tile([[0.365], [-0.06]], len(measured)), P0
    for k in range(measured.shape[1]):
        x, p = phi @ x, phi @ p @ phi.T + q
        gain = p[:, 0] / (p[0, 0] + r[k])
        x, p = x + np.outer(gain, measured[:, k] - x[0]), p - np.outer(gain, p[0])
    return x[0]


def test_every_number_of_the_paper_is_reported() -> None:
    printed = [row.published for row in audit()]
    for number in (2.4, 0.042, 0.0042, 0.0002, 0.032, 17e-4, 3.6e-8, 11.5e-4, 1e-4, 50):
        assert number in printed
    result = compute(scenario(montecarlo={"experiments": 2}), 1, None)
    assert list(result["/published/published"]) == printed
    computed = dict(zip(result["/published/statement"], result["/published/computed"], strict=True))
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


def test_the_aircraft_stands_after_its_roll_out() -> None:
    """40 s of braking from 80 m/s; a run may be longer, and the aircraft does not drive backwards."""
    stop = mls.GLIDE_END + mls.FLARE + 40.0
    late = mls.along(np.array([stop, stop + 1e-6, stop + 3600.0]))
    np.testing.assert_allclose(late.d, late.d[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(late.d1, 0.0, atol=1e-9)
    assert late.d2[0] == mls.ROLL_OUT
    np.testing.assert_array_equal(late.d2[1:], 0.0)
