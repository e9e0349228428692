"""What levels must do whatever the geometry, and whether they bound errors at budgets that can be counted."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from navsim.gnss.sky import unit_vector
from navsim.integrity import residuals
from navsim.integrity.araim import Allocation, Fault, FixLevels, levels
from navsim.integrity.residuals import ChiSquareTest
from navsim.integrity.solution import Independent, rows_of, solve

BUDGET = Allocation(
    p_unmonitored=1e-3, p_hmi_vertical=1e-5, p_hmi_horizontal=1e-5, p_fa_vertical=1e-4, p_fa_horizontal=1e-4
)
GEOMETRY = st.tuples(st.integers(0, 10**6), st.integers(7, 11))


class Sky:
    """Sources all over the sky, their sigmas, bounds and faults: each by itself, and the last two together."""

    def __init__(self, drawn: tuple[int, int]) -> None:
        seed, self.count = drawn
        rng = np.random.default_rng(seed)
        azimuth = 2.0 * np.pi * (np.arange(self.count) + rng.uniform(0, 0.8, self.count)) / self.count
        self.azimuth, self.elevation = azimuth, rng.uniform(0.05, 1.4, self.count)
        self.sigma, self.nominal = rng.uniform(0.5, 4.0, self.count), rng.uniform(0.0, 1.0, self.count)
        self.priors = rng.uniform(1e-5, 1e-3, self.count + 1)

    def rows(self, turned: float = 0.0) -> np.ndarray:
        return rows_of(unit_vector(self.azimuth + turned, self.elevation)[None], np.zeros(self.count, int))

    def found(self, allocation: Allocation = BUDGET, order: np.ndarray | None = None, **other: Any) -> FixLevels:
        """Levels of an epoch; other: members in place of one's own, or `rows`."""
        order = np.arange(self.count) if order is None else order
        rows = other.get("rows", self.rows())[:, order]
        sigma, nominal, priors = (other.get(name, getattr(self, name)) for name in ("sigma", "nominal", "priors"))
        place = np.argsort(order)
        alone = [Fault((int(place[i]),), float(priors[i])) for i in range(self.count)]
        group = Fault((int(place[-2]), int(place[-1])), float(priors[-1]))
        noise = Independent(sigma[None, order])
        used = np.ones((1, self.count), bool)
        return levels(rows, used, noise, noise, nominal[None, order], [*alone, group], allocation, unlisted=1e-9)


@given(GEOMETRY, st.integers(0, 100), st.floats(1.0, 50.0))
def test_levels_never_fall_with_priors_and_biases(drawn: tuple[int, int], which: int, by: float) -> None:
    """Nor with a smaller budget. Of sigmas it is not so: a noisier source is a less dangerous one."""
    sky = Sky(drawn)
    here = sky.found()
    if not here.available[0]:
        return
    i = which % sky.count
    for name, step in (
        ("priors", sky.priors * (np.arange(sky.count + 1) == i) * (by - 1.0)),
        ("nominal", by * (np.arange(sky.count) == i)),
    ):
        more = sky.found(**{name: getattr(sky, name) + step})
        assert np.all(more.level >= here.level - 1e-7)
    less = sky.found(
        Allocation(
            p_unmonitored=1e-3,
            p_hmi_vertical=1e-5 / by,
            p_hmi_horizontal=1e-5 / by,
            p_fa_vertical=1e-4,
            p_fa_horizontal=1e-4,
        )
    )
    assert not less.available[0] or np.all(less.level >= here.level - 1e-7)


@given(GEOMETRY, st.floats(0.0, 6.28), st.floats(0.1, 30.0))
def test_what_levels_do_not_depend_on(drawn: tuple[int, int], turned: float, scale: float) -> None:
    """The order of sources; the unit of length. Turned about the vertical, the height's stays as it is."""
    sky = Sky(drawn)
    here = sky.found()
    order = np.random.default_rng(drawn[0]).permutation(sky.count)
    np.testing.assert_allclose(sky.found(order=order).level, here.level, rtol=1e-7)
    larger = sky.found(sigma=scale * sky.sigma, nominal=scale * sky.nominal)
    np.testing.assert_allclose(larger.level, scale * here.level, rtol=1e-7)
    np.testing.assert_allclose(sky.found(rows=sky.rows(turned)).vertical, here.vertical, rtol=1e-7)


@given(GEOMETRY, st.floats(0.0, 6.28), st.floats(0.1, 30.0))
def test_what_levels_of_residuals_do_not_depend_on(drawn: tuple[int, int], turned: float, scale: float) -> None:
    """The same of slopes, of which the horizontal one does not turn either."""
    sky, test = Sky(drawn), ChiSquareTest(1e-4, 1e-3)
    used = np.ones((1, sky.count), bool)

    def of(rows: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        return residuals.Monitor(solve(rows, used, Independent(sigma[None])), test).levels

    here, order = of(sky.rows(), sky.sigma), np.random.default_rng(drawn[0]).permutation(sky.count)
    np.testing.assert_allclose(of(sky.rows()[:, order], sky.sigma[order]), here, rtol=1e-7)
    np.testing.assert_allclose(of(sky.rows(), scale * sky.sigma), scale * here, rtol=1e-7)
    np.testing.assert_allclose(of(sky.rows(turned), sky.sigma), here, rtol=1e-7)


@given(GEOMETRY)
def test_a_source_out_is_a_line_of_arithmetic(drawn: tuple[int, int]) -> None:
    """sigma_ss is slope and sigma_i^2 = sigma_0^2 + slope^2 of optimal least squares; a source that only feeds its own
    clock changes nothing at all."""
    sky = Sky(drawn)
    found = sky.found()
    fix = solve(sky.rows(), np.ones((1, sky.count), bool), Independent(sky.sigma[None]))
    slope = np.abs(fix.estimator[0]) * sky.sigma / np.sqrt(fix.redundancy[0])
    for i in range(sky.count):
        if fix.redundancy[0, i] < 1e-6:
            continue
        np.testing.assert_allclose(found.spread.separation_sigma[i, 0], slope[:, i], rtol=1e-7)
        sigma = np.sqrt(found.spread.sigma[0] ** 2 + slope[:, i] ** 2)
        np.testing.assert_allclose(found.spread.separate_sigma[i, 0], sigma, rtol=1e-7)
    lone = rows_of(
        unit_vector(np.append(sky.azimuth, 1.0), np.append(sky.elevation, 0.5))[None], np.array([0] * sky.count + [5])
    )
    more = solve(lone, np.ones((1, sky.count + 1), bool), Independent(np.append(sky.sigma, 1.0)[None]))
    np.testing.assert_allclose(more.covariance, fix.covariance, rtol=1e-9, atol=1e-12)


def test_samples_divide_what_each_of_them_risks_but_not_the_budget_of_unmonitored_faults() -> None:
    once, often = Allocation(), Allocation(samples=25.0)
    np.testing.assert_allclose(often.p_hmi, once.p_hmi / 25.0)
    assert often.total == once.total == once.p_hmi.sum()
