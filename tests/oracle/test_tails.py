"""Risks beyond levels by importance sampling, against closed forms and counts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from navsim.integrity.araim import Allocation, Fault, Levels, levels
from navsim.integrity.residuals import ChiSquareTest, Monitor
from navsim.integrity.risk import silent
from navsim.integrity.risk_sampling import (
    SeparationTest,
    TailCase,
    sampled,
    under_separations,
    under_squares,
    worst_size,
)
from navsim.integrity.solution import Independent, MonitoredFix, solve
from navsim.runner.statistics import share_interval
from navsim.statistics.random_streams import generator
from tests.conftest import Within
from tests.helpers import in_brief
from tests.oracle.test_integrity import CASE, UP, cases, raim, rows_towards

__all__ = ["cases"]  # the fixture

SOURCES = 8


def one(source: int, bias: float) -> np.ndarray:
    return np.where(np.arange(SOURCES) == source, bias, 0.0)


@pytest.mark.validates("Risk of a biased range, by importance sampling", "closed form", "standard errors",
                       difference="3")  # fmt: skip
@pytest.mark.parametrize(
    ("limit", "bias", "name"),
    [(20.0, 20.0, "at_20_m_bias_20"), (35.0, 30.0, "at_35_m_bias_30"), (45.0, 30.0, "at_45_m_bias_30")],
)
def test_sampled_risk(cases: dict[str, Any], within: Within, limit: float, bias: float, name: str) -> None:
    entry = cases["integrity_risk_exact"]
    case = under_squares(raim(cases, 1e-5), 0, UP)
    draws = sampled(
        case, case.biases(one(entry["inputs"]["fault_index"], bias)), limit, 100_000, generator(1, 0, "integrity")
    )
    assert abs(draws.probability - entry["expected"][name]) < within["difference"] * draws.error
    assert draws.effective > 1000
    assert draws.error < 0.03 * draws.probability


@pytest.mark.validates("Bias of a range with the largest risk", "closed form", bias="0.1 m")
def test_worst_bias(cases: dict[str, Any], within: Within) -> None:
    worst = cases["integrity_risk_exact"]["expected"]["at_vpl_we"]
    case = under_squares(raim(cases, 1e-5), 0, UP)
    direction = case.least_visible_bias(np.arange(SOURCES) == 0)
    found = worst_size(case, direction, np.zeros(SOURCES), worst["vpl"])
    assert found * case.unwhitened[0] == pytest.approx(worst["worst_bias_m"], abs=within["bias"])


@pytest.mark.validates("Risk under one ARAIM test, by importance sampling", "closed form", "standard errors",
                       difference="3")  # fmt: skip
def test_sampled_risk_of_one_separation(cases: dict[str, Any], within: Within) -> None:
    entry, solution = cases["integrity_risk_separation_one_mode"], raim(cases).solution
    source = entry["inputs"]["fault_index"]
    without = solve(
        rows_towards(cases[CASE]["inputs"]["azimuth_elevation_deg"]), np.arange(SOURCES)[None] != source, solution.noise
    )
    whole = under_squares(raim(cases), 0, UP)
    apart = (without.estimator - solution.estimator)[0, UP] * whole.unwhitened / entry["threshold_m"]
    case = TailCase(whole.estimate, whole.residual, whole.unwhitened, SeparationTest(apart[None]), whole.used)
    for i, row in enumerate(entry["expected"]):
        limit = row["level_m"]
        for j, (bias, name) in enumerate(((row["worst_bias_m"], "p_hmi"), (40.0, "at_bias_40"))):
            draws = sampled(case, case.biases(one(source, bias)), limit, 100_000, generator(2, i, "integrity", j))
            assert abs(draws.probability - row[name]) < within["difference"] * draws.error, (limit, name)
            assert draws.effective > 1000
            assert draws.probability < row["mhss_bound"]
        direction = case.least_visible_bias(np.arange(SOURCES) == source)
        worst = worst_size(case, direction, np.zeros(SOURCES), limit)
        assert worst * case.unwhitened[0] == pytest.approx(row["worst_bias_m"], abs=0.2)


def test_sampled_risks_are_counted_ones(cases: dict[str, Any]) -> None:
    """At some 1e-3, without weights, under all three kinds of tests; and without a bias."""
    chi2 = under_squares(raim(cases, 1e-3), 0, UP)
    found, fix = separated(cases, Allocation(p_fa_vertical=1e-3, p_fa_horizontal=1e-3))
    mhss = under_separations(fix, found, 0, UP)
    rng = np.random.default_rng(3)
    for case, bias, limit in ((chi2, one(0, 20.0), 25.0), (mhss, one(0, 20.0), 25.0), (mhss, one(0, 0.0), 8.0)):
        draws = sampled(case, case.biases(bias), limit, 100_000, generator(3, 0, "integrity"))
        hits = 0
        for _ in range(10):
            errors = rng.standard_normal((SOURCES, 100_000)) + case.biases(bias)[:, None]
            hits += int(((np.abs(case.estimate @ errors) > limit) & case.test.silent(errors)).sum())
        counted = hits / 1e6
        assert 2e-4 < counted < 5e-2
        assert abs(draws.probability - counted) < 4.0 * np.hypot(draws.error, np.sqrt(counted / 1e6))


PRIORS = (*[1e-5] * 6, *[1e-4] * 2, 1e-5)
GROUPS = (*((i,) for i in range(SOURCES)), (6, 7))


def separated(
    cases: dict[str, Any], allocation: Allocation, priors: tuple[float, ...] = PRIORS
) -> tuple[Levels, MonitoredFix]:
    """Levels of the worked case with its ground group, as its bounds have them."""
    given = cases["mhss_6_satellites_2_pseudolites"]["inputs"]
    rows, used = rows_towards(given["azimuth_elevation_deg"]), np.ones((1, SOURCES), bool)
    noise, nominal = Independent(np.array(given["sigma_int_m"])[None]), np.array(given["b_nom_m"])[None]
    faults = [Fault(group, prior) for group, prior in zip(GROUPS, priors, strict=True)]
    return levels(rows, used, noise, noise, nominal, faults, allocation, 0.0), solve(rows, used, noise)


def worst_of(
    cases: dict[str, Any], found: Levels, fix: MonitoredFix, axis: int
) -> Iterator[tuple[TailCase, np.ndarray, np.ndarray]]:
    """Nominal biases at their worst beside no fault, then beside each fault, whitened, and the worst of its own."""
    case, nominal = (
        under_separations(fix, found, 0, axis),
        np.array(cases["mhss_6_satellites_2_pseudolites"]["inputs"]["b_nom_m"]),
    )
    yield case, case.biases(np.sign(case.estimate) * nominal), np.zeros(SOURCES)
    for k, group in enumerate(GROUPS):
        faulty = np.isin(np.arange(SOURCES), group)
        apart = found.separator[k, 0, axis] + fix.estimator[0, axis]
        beside = case.biases(np.where(faulty, 0.0, np.sign(apart) * nominal))
        direction = case.least_visible_bias(faulty)
        yield case, beside, worst_size(case, direction, beside, float(found.level[0, axis])) * direction


@pytest.mark.parametrize("axis", in_brief([0, 1, 2], 2))
def test_levels_keep_their_budgets(cases: dict[str, Any], axis: int) -> None:
    """No fault, and each fault with its worst bias, by its prior, beside nominal biases at their worst: all of it stays
    below what is allowed, the upper 95 % bound of it, too."""
    allocation = Allocation()
    found, fix = separated(cases, allocation)
    budget = allocation.p_hmi_vertical if axis == UP else 0.5 * allocation.p_hmi_horizontal
    total, square = 0.0, 0.0
    priors = (1.0, *PRIORS)
    for k, (case, beside, worst) in enumerate(worst_of(cases, found, fix, axis)):
        risks = [
            sampled(
                case, beside + f * worst, float(found.level[0, axis]), 100_000, generator(5, k, "integrity", axis, i)
            )
            for i, f in enumerate((0.9, 1.0, 1.1))
        ]
        largest = max(risks, key=lambda draws: draws.probability)
        assert largest.effective > 1000
        total += priors[k] * largest.probability
        square += (priors[k] * largest.error) ** 2
    assert total + 1.645 * np.sqrt(square) <= budget
    assert total > 1e-3 * budget  # a bound, and no empty one


@pytest.mark.parametrize("axis", in_brief([0, 1, 2], 2))
def test_levels_keep_budgets_that_can_be_counted(cases: dict[str, Any], axis: int) -> None:
    """The same with a thousandth allowed, and faults of a hundredth: 1e5 draws of each, without weights."""
    priors = (*[1e-2] * 6, *[2e-2] * 2, 1e-2)
    found, fix = separated(cases, Allocation(1e-3, 2e-3, 1e-2, 1e-2, 1e-3), priors)
    limit, rng, total = float(found.level[0, axis]), np.random.default_rng(axis), 0.0
    for prior, (case, beside, worst) in zip((1.0, *priors), worst_of(cases, found, fix, axis), strict=True):
        errors = rng.standard_normal((SOURCES, 100_000)) + (beside + worst)[:, None]
        hits = int(((np.abs(case.estimate @ errors) > limit) & case.test.silent(errors)).sum())
        total += prior * float(share_interval(hits, 100_000)[2])
    assert total <= 1e-3


def test_tails_of_a_range_that_nothing_checks(cases: dict[str, Any]) -> None:
    """Its bias has no worst size; one that moves nothing has none either."""
    monitor = raim(cases)
    few = np.arange(SOURCES)[None] < 5
    rows = rows_towards(cases[CASE]["inputs"]["azimuth_elevation_deg"])
    alone = Monitor(solve(rows, few, monitor.solution.noise), ChiSquareTest(1e-3, 1e-3))
    case = under_squares(alone, 0, UP)
    direction = case.least_visible_bias(np.arange(SOURCES) == 7)
    assert not direction.any()
    assert worst_size(case, direction, np.zeros(5), 10.0) == 0.0
    draws = sampled(case, case.biases(one(0, 30.0)), 60.0, 20_000, generator(6, 0, "integrity"))
    assert draws.probability == pytest.approx(silent(alone, 0, 0, 30.0, 60.0), abs=3.0 * draws.error)
