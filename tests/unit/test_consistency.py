"""Consistency test of every state: its band and its words."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from navsim.runner import consistency
from navsim.runner.consistency import LIMITS, RatioBand, Ratios, correlation_of, evaluate, simultaneous_band

NAMES = ("position_north", "attitude_down", "gyro_bias_z")
BAND = RatioBand(0.9, 1.1, np.full(3, 50.0))


def ratios(z: np.ndarray, runs: int = 1000, correlation: float = 0.99) -> Ratios:
    return Ratios(np.arange(len(z)) / 2.0, NAMES[: z.shape[1]], z, runs, np.full(z.shape[1], correlation))


def right(*others: tuple[int, int, float]) -> np.ndarray:
    """z of three states at 121 outputs, one but for others (output, state, z)."""
    z = np.ones((121, 3))
    for output, state, value in others:
        z[output, state] = value
    return z


def drawn(trials: int, runs: int, outputs: int, states: int, correlation: float) -> np.ndarray:
    """z (trial, t, n) of errors that are sigma large, with this correlation from output to output."""
    rng = np.random.default_rng(3)
    z = rng.standard_normal((trials, runs, states))
    out = np.empty((trials, outputs, states))
    for t in range(outputs):
        out[:, t] = np.sqrt(np.mean(z**2, axis=1))
        z = correlation * z + np.sqrt(1.0 - correlation**2) * rng.standard_normal(z.shape)
    return out


@pytest.mark.parametrize(("runs", "correlation", "least"), [(40, 0.995, 0.4), (40, 0.9, 0.4), (1, 0.99, 0.15)])
def test_a_right_filter_leaves_the_band_as_seldom_as_told(runs: int, correlation: float, least: float) -> None:
    """With a chance of 10 %, by simulation: no more (4 sigma); above, where the correlation is used, at least this
    share of it, which is smaller for one run, whose squares are far from normal."""
    trials, chance = 1000 if runs > 1 else 4000, 0.1
    z = drawn(trials, runs, 120, 2, correlation)
    band = simultaneous_band(ratios(z[0], runs, correlation), chance)
    above, below = float((z > band.high).any(axis=(1, 2)).mean()), float((z < band.low).any(axis=(1, 2)).mean())
    error = np.sqrt(0.5 * chance / trials)
    assert above < 0.5 * chance + 4.0 * error
    assert below < 0.5 * chance + 4.0 * error
    assert above > least * 0.5 * chance
    assert band.looks.sum() < 0.8 * 240


@pytest.mark.parametrize(("level", "correlation"), [(1.0, 0.0), (3.0, 0.5), (4.0, 0.99), (4.5, 0.9999)])
def test_two_looks_beyond_a_level(level: float, correlation: float) -> None:
    """By scipy's bivariate normal distribution."""
    both = multivariate_normal([0, 0], [[1, correlation], [correlation, 1]], allow_singular=True)
    expected = both.cdf([-level, -level]) / multivariate_normal(0, 1).cdf(-level)
    found = consistency._conditional_exceedance(level, np.array([correlation]))
    assert found[0] == pytest.approx(expected, rel=2e-3)


def test_the_band_narrows_with_runs_and_correlation() -> None:
    bands = [simultaneous_band(ratios(right(), runs)) for runs in (1, 10, 100, 10000)]
    highs, lows = [b.high for b in bands], [b.low for b in bands]
    assert highs == sorted(highs, reverse=True)
    assert lows == sorted(lows)
    assert simultaneous_band(ratios(right(), 100, 0.9999)).high < simultaneous_band(ratios(right(), 100, 0.5)).high
    np.testing.assert_allclose(simultaneous_band(ratios(right(), 100, 1.0)).looks, 1.0)
    np.testing.assert_allclose(simultaneous_band(ratios(right(), 100, 0.0)).looks, 121.0, rtol=0.01)


def test_correlation_from_squares_and_steps() -> None:
    rng = np.random.default_rng(1)
    z = np.empty((2000, 300))
    z[:, 0] = rng.standard_normal(2000)
    for t in range(1, 300):
        z[:, t] = 0.97 * z[:, t - 1] + np.sqrt(1 - 0.97**2) * rng.standard_normal(2000)
    squares, steps = np.mean(z**2, axis=0)[:, None], np.array([np.mean(np.sum(np.diff(z) ** 2, axis=1))])
    assert correlation_of(squares, steps)[0] == pytest.approx(0.97, abs=0.001)
    assert np.isnan(correlation_of(np.full((5, 1), np.nan), np.zeros(1))[0])


SMALL = "sigma too small, errors 18 % above it"


@pytest.mark.parametrize(
    ("z", "words"),
    [
        (right((118, 1, 1.18), (4, 0, 1.12)), f"{SMALL}: heading at 59 s (z 1.18, 1000 runs)"),
        (right((10, 2, 0.75)), "sigma too large, errors 25 % below it: gyro bias z at 5 s (z 0.75, 1000 runs)"),
        (right((118, 1, 1.18), (10, 2, 0.75)),
         f"{SMALL}: heading at 59 s (z 1.18, 1000 runs); sigma too large, errors 25 % below it: gyro bias z at 5 s "
         "(z 0.75, 1000 runs)"),
        (right((3, 0, 1.04)), "sigma right as far as 1000 runs tell (z 0.90 to 1.10): largest z 1.04, position north "
         "at 1.5 s"),
        (right((3, 0, np.inf)), "sigma 0 where there are errors: position north at 1.5 s (z inf, 1000 runs)"),
        (right((3, 0, 19.0)), "sigma too small by a factor of 19: position north at 1.5 s (z 19, 1000 runs)"),
        (right((3, 0, 0.2)), "sigma too large by a factor of 5: position north at 1.5 s (z 0.20, 1000 runs)"),
        (right((3, 0, 1e-9)), "sigma over 1000 times too large: position north at 1.5 s (z 0.00, 1000 runs)"),
        (right((118, 1, 1.18), (30, 0, np.nan)), f"{SMALL}: heading at 59 s (z 1.18, 1000 runs); 1 of 121 "
         "outputs are not finite and not tested"),
        (np.full((4, 3), np.nan), "none: no uncertainty"),
    ],
)  # fmt: skip
def test_words(z: np.ndarray, words: str) -> None:
    found = evaluate(ratios(z), BAND, 0.05)
    assert found.words == words
    assert found.small == (" small" in words or "0 where" in words)


@pytest.mark.parametrize(
    ("most", "tolerance", "words", "small"),
    [
        (1.04, 0.05, "errors 4 % above sigma (significant, within the 5 % tolerance): heading at 59 s (z 1.04, 90000 "
         "runs)", False),
        (1.04, 0.03, "sigma too small, errors 4 % above it: heading at 59 s (z 1.04, 90000 runs)", True),
        (1.02, 0.05, "sigma right within 4 %: largest z 1.02, heading at 59 s (90000 runs)", False),
    ],
)  # fmt: skip
def test_significant_and_large_are_two_questions(most: float, tolerance: float, words: str, small: bool) -> None:
    found = evaluate(ratios(right((118, 1, most)), 90000), RatioBand(0.985, 1.015, BAND.looks), tolerance)
    assert (found.words, found.small) == (words, small)


def test_one_run_can_tell_gross_errors() -> None:
    z = np.abs(np.random.default_rng(2).standard_normal((121, 3)))
    z[20, 1] = 3.2
    band = simultaneous_band(ratios(z, 1))
    assert 4.0 < band.high < 5.0
    words = f"no error beyond {band.high:.1f}σ in one run: 3.20σ, heading at 10 s"
    assert evaluate(ratios(z, 1), band, 0.05).words == words
    z[30, 0] = 7.0
    found = evaluate(ratios(z, 1), band, 0.05)
    assert found.words == f"error beyond {band.high:.1f}σ in one run: 7.00σ, position north at 15 s"
    assert found.small


def test_an_expectation_has_no_band() -> None:
    z = right((118, 1, 1.18))
    expected = ratios(z, 0)
    assert evaluate(expected, simultaneous_band(expected), 0.05).words == (
        "sigma too small, errors 18 % above it: heading at 59 s (z 1.18, to first order)"
    )


@pytest.mark.parametrize(
    ("z", "runs", "words"),
    [
        (1.0004, 0, "not tested: filter and truth have the same model"),
        (1.006, 0, "sigma right within 0.6 %: largest z 1.01, heading at 59 s (to first order)"),
        (1.0004, 1000, "sigma right as far as 1000 runs tell (z 0.90 to 1.10): largest z 1.00, heading at 59 s"),
    ],
)
def test_equal_models_test_nothing(z: float, runs: int, words: str) -> None:
    expected = ratios(right((118, 1, z)), runs)
    assert evaluate(expected, BAND if runs else simultaneous_band(expected), 0.05).words == words


def test_limits_are_those_of_a_normal_error() -> None:
    from scipy.stats import norm

    np.testing.assert_allclose(LIMITS, norm.isf([0.025, 0.0005]), rtol=1e-12)
