"""Controlled estimates of synthetic errors whose truth is known: no bias, and intervals that cover it."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.runner import control_variates
from navsim.runner.control_variates import LEAST_RUNS, Controlled
from navsim.statistics import normal
from tests.helpers import in_brief

MEAN, SIGMA = 0.2, 1.0
LEVEL = 0.9


def below(size: float) -> float:
    return 1.0 - float(normal.exceedance(np.array(size), MEAN, SIGMA))


class Errors:
    """Errors e = x + b x^2 + (1 + |x| / 2) d z of a first-order error x; `lost`: how many are 4 sigma off."""

    def __init__(self, d: float, b: float, lost: float = 0.0) -> None:
        self.d, self.b, self.lost = d, b, lost
        x = np.linspace(-10.0, 10.0, 200_001)
        self.grid, self.weights = MEAN + SIGMA * x, np.exp(-0.5 * x**2)
        self.weights /= self.weights.sum()

    def draw(self, rng: np.random.Generator, runs: int) -> tuple[np.ndarray, np.ndarray]:
        x = MEAN + SIGMA * rng.standard_normal(runs)
        off = np.where(rng.random(runs) < self.lost, 4.0, 0.0)
        return x + self.b * x**2 + (1.0 + 0.5 * np.abs(x)) * self.d * rng.standard_normal(runs) + off, x

    def share_below(self, size: float) -> float:
        middle, sigma = self.grid + self.b * self.grid**2, (1.0 + 0.5 * np.abs(self.grid)) * self.d
        found = [1.0 - normal.outside(-size, size, middle + off, sigma) for off in (0.0, 4.0)]
        return float(self.weights @ ((1.0 - self.lost) * found[0] + self.lost * found[1]))

    def truths(self) -> dict[str, float]:
        middle, variance = self.grid + self.b * self.grid**2, ((1.0 + 0.5 * np.abs(self.grid)) * self.d) ** 2
        square = middle**2 + variance + self.lost * (8.0 * middle + 16.0)
        low, high = 0.0, 20.0
        for _ in range(50):
            at = 0.5 * (low + high)
            low, high = (at, high) if self.share_below(at) < LEVEL else (low, at)
        return {
            "mean": float(self.weights @ middle) + 4.0 * self.lost, "rms": float(np.sqrt(self.weights @ square)),
            "share": self.share_below(1.5), "percentile": high,
        }  # fmt: skip


def estimates(e: np.ndarray, x: np.ndarray) -> dict[str, Controlled]:
    controls = np.stack([x, x**2], axis=1)
    return {
        "mean": control_variates.mean(e, x[:, None], np.array([MEAN])),
        "rms": control_variates.mean(e**2, controls, np.array([MEAN, MEAN**2 + SIGMA**2])).root(),
        "share": control_variates.share(np.abs(e) < 1.5, np.abs(x) < 1.5, below(1.5)),
        "percentile": control_variates.percentile(np.abs(e), np.abs(x), LEVEL, below),
    }


@pytest.mark.parametrize(
    ("errors", "runs"),
    in_brief([((0.03, 0.01), 1000), ((0.1, 0.02), 200), ((1.0, 0.0), 300), ((0.03, 0.0, 0.05), 400)], 3),
)
def test_no_bias_and_intervals_that_cover(errors: tuple[float, ...], runs: int) -> None:
    """400 ensembles: within 4.5 standard errors of the truth (shares and percentiles: of their own); 95 % intervals
    that cover it in 92 to 100 % (shares and percentiles are cautious where few indicators differ)."""
    of, rng = Errors(*errors), np.random.default_rng(11)
    found = [estimates(*of.draw(rng, runs)) for _ in range(400)]
    for name, truth in of.truths().items():
        values = np.array([one[name].value for one in found])
        assert abs(values[:, 0].mean() - truth) < 4.5 * values[:, 0].std() / np.sqrt(len(values)) + (
            0.0 if name in ("mean", "share") else 0.05 * values[:, 0].std()
        ), name
        covers = np.mean((values[:, 1] <= truth) & (truth <= values[:, 2]))
        assert covers >= 0.92, (name, covers)
        if name in ("mean", "rms"):
            assert covers <= 0.98, (name, covers)


def test_the_gain_is_that_of_runs() -> None:
    """Estimates scatter as those of as many more runs would."""
    of, rng = Errors(0.05, 0.01), np.random.default_rng(5)
    drawn = [of.draw(rng, 200) for _ in range(400)]
    found = [control_variates.mean(e, x[:, None], np.array([MEAN])) for e, x in drawn]
    plain = np.var([e.mean() for e, _ in drawn])
    gain = plain / np.var([one.value[0] for one in found])
    assert gain == pytest.approx(np.median([one.gain for one in found]), rel=0.3)
    assert found[0].correlation == pytest.approx(np.corrcoef(*drawn[0])[0, 1], abs=0.01)
    assert all(one.helps for one in found)


def test_a_control_that_says_nothing_does_not_help() -> None:
    rng = np.random.default_rng(2)
    e, x = rng.standard_normal(1000), rng.standard_normal(1000)
    assert control_variates.mean(e**2, (x**2)[:, None], np.ones(1)).gain == pytest.approx(1.0, abs=0.02)
    alone = control_variates.share(np.abs(e) < 1.0, np.abs(x) < 1.0, below_standard(1.0))
    assert not alone.helps
    assert control_variates.percentile(np.abs(e), np.abs(x), 0.5, below_standard).gain < 1.0


def below_standard(size: float) -> float:
    return 1.0 - float(normal.exceedance(np.array(size), 0.0, 1.0))


@pytest.mark.parametrize("name", ["mean", "rms", "share", "percentile"])
def test_there_is_none_where_it_would_be_wrong(name: str) -> None:
    """Too few runs; runs that are not finite; a control whose mean is not the exact one."""
    rng = np.random.default_rng(3)
    few = Errors(0.05, 0.0).draw(rng, LEAST_RUNS - 1)
    assert np.isnan(estimates(*few)[name].value).all()
    e, x = Errors(0.05, 0.0).draw(rng, 1000)
    assert estimates(e, x)[name].helps
    assert np.isnan(estimates(e, x + 1.0)[name].gain)
    if name in ("mean", "rms"):
        lost = np.where(np.arange(1000) == 7, np.nan, e)
        assert np.isnan(estimates(lost, x)[name].value).all()


def test_two_indicators_that_never_differ_are_not_taken_for_exact() -> None:
    """Of 1000 runs: the probability may still be off by 3.8 in 1000."""
    hits = np.arange(1000) < 50
    value = control_variates.share(hits, hits, 0.05).value
    np.testing.assert_allclose(value, [0.05, 0.05 - 3.8415 / 1003.84, 0.05 + 3.8415 / 1003.84], rtol=1e-4)


@pytest.mark.parametrize(("more", "less", "runs"), [(1, 0, 44), (7, 3, 100), (0, 0, 64), (40, 55, 300)])
def test_intervals_of_pairs_by_their_likelihood(more: int, less: int, runs: int) -> None:
    """At each end the score is 1.96 with the variance where the likelihood under this difference is largest, found
    numerically."""
    from scipy.optimize import minimize_scalar

    for far in (-1.0, 1.0):
        end = control_variates._end(lambda d: control_variates._score(more, less, runs, d), (more - less) / runs, far)

        def cost(q: float, end: float = end) -> float:
            parts = ((more, q + end), (less, q), (runs - more - less, 1.0 - 2.0 * q - end))
            return -sum(count * np.log(max(p, 1e-300)) for count, p in parts if count)

        low, high = max(0.0, -end), 0.5 * (1.0 - end)
        q = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-12}).x
        variance = runs * (2.0 * q + end - end**2)
        assert abs(more - less - runs * end) / np.sqrt(variance) == pytest.approx(1.96, abs=2e-3)


def test_the_probability_of_a_box() -> None:
    """Against draws, and where the errors are independent against the product."""
    low, high = np.array([-1.0, -np.inf, -0.5]), np.array([1.5, 0.7, np.inf])
    mean, root = np.array([0.1, -0.2, 0.3]), np.array([[1.0, 0.0, 0.0], [0.6, 0.5, 0.0], [-0.3, 0.4, 0.8]])
    drawn = mean + np.random.default_rng(1).standard_normal((400_000, 3)) @ root.T
    counted = np.mean(((low <= drawn) & (drawn <= high)).all(axis=1))
    assert normal.inside_box(low, high, mean, root @ root.T) == pytest.approx(counted, abs=4.0 * 0.5 / np.sqrt(400_000))
    alone = np.prod(1.0 - normal.outside(low, high, mean, np.ones(3)))
    assert normal.inside_box(low, high, mean, np.eye(3)) == pytest.approx(float(alone), abs=1e-12)
    assert np.isnan(normal.inside_box(low, high, mean * np.nan, np.eye(3)))


def test_the_interval_that_more_runs_would_give() -> None:
    found = Controlled(np.array([1.0, 0.8, 1.2]), 5.0).with_runs(100, 400)
    np.testing.assert_allclose(found, [1.0, 0.9, 1.1])
