"""Search for the best placement in an area by an objective of geometry: differential evolution [1], then Nelder-Mead.

Source: [1] Storn & Price, J. Global Optimization 11 (1997).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from navsim.optimization.evaluator import EVOLVING, Evaluator, PlacementWithRivals, step_name
from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import PlacementProblem
from navsim.optimization.progress import SearchMonitor

if TYPE_CHECKING:
    from scipy.optimize import Bounds


POPULATION, GENERATIONS = 30, 400
"""Differential evolution with an objective of geometry: members a coordinate, largest number of generations."""
FINISHING = (100.0, 10.0, 1.0)
"""Sizes of the simplices of Nelder-Mead, m, and evaluations a coordinate with each."""
FINISHING_TRIES = 200
_NEAR = 0.1
"""1 sigma of a population around a placement, as a share of the area."""
MORE = 4000
"""Positions tried for one more pseudolite beside those found before."""


def search_area(
    problem: PlacementProblem,
    count: int,
    seed: int,
    earlier: np.ndarray | None,
    trials: Evaluator,
    watch: SearchMonitor,
) -> PlacementWithRivals:
    """Best of several populations, and of one more pseudolite beside those found earlier, refined to centimetres."""

    def value(x: np.ndarray) -> float:
        return float(trials.at_once(x.reshape(1, count, -1))[0])

    bounds = bounds_of(problem, count)
    with watch.step(step_name(problem, count, EVOLVING)):
        candidates = [
            evolve(
                problem, trials.at_once, bounds, np.random.default_rng([seed, count, start]), GENERATIONS, POPULATION
            )[0]
            for start in range(problem.study.effort)
        ]
        if earlier is not None and len(earlier) < count:
            candidates.append(one_more(problem, count, earlier, np.random.default_rng([seed, count, 1000]), trials)[0])
        best, lowest = candidates[0], math.inf
        for candidate in candidates:
            x, reached = finish(value, candidate.ravel(), bounds, FINISHING, FINISHING_TRIES)
            if reached < lowest:
                best, lowest = x.reshape(count, -1), reached
    return PlacementWithRivals(best, lowest)


def search_near(
    problem: PlacementProblem, count: int, seed: int, near: np.ndarray, trials: Evaluator, watch: SearchMonitor
) -> PlacementWithRivals:
    """`search_area` with one population, half of it around a placement."""
    rng, bounds = np.random.default_rng([seed, count, 2000]), bounds_of(problem, count)
    size = (near.size * POPULATION // 4, near.size)
    around = near.ravel() + _NEAR * (bounds.ub - bounds.lb) * rng.standard_normal(size)
    start = np.concatenate([np.clip(around, bounds.lb, bounds.ub), rng.uniform(bounds.lb, bounds.ub, size)])
    with watch.step(step_name(problem, count, EVOLVING)):
        best = evolve(problem, trials.at_once, bounds, rng, GENERATIONS // 2, 1, start)[0]
        x, reached = finish(
            lambda x: float(trials.at_once(x.reshape(1, count, -1))[0]), best.ravel(), bounds, FINISHING[1:],
            FINISHING_TRIES // 2,
        )  # fmt: skip
    return PlacementWithRivals(x.reshape(count, -1), reached)


def bounds_of(problem: PlacementProblem, count: int) -> Bounds:
    """Limits of the coordinates of `count` positions, m."""
    from scipy.optimize import Bounds

    low, high = problem.limits()
    return Bounds(np.tile(low, count), np.tile(high, count))


def evolve(
    problem: PlacementProblem,
    judge: ObjectiveFunction,
    bounds: Bounds,
    rng: np.random.Generator,
    generations: int,
    popsize: int,
    init: np.ndarray | None = None,
) -> np.ndarray:
    """Differential evolution: the last population (n, k, 2), the best first."""
    from scipy.optimize import differential_evolution

    def values(x: np.ndarray, /) -> np.ndarray:
        return judge(x.T.reshape(x.shape[1], -1, problem.coordinates))

    found = differential_evolution(
        values,  # type: ignore[arg-type]  # vectorized: a population at once
        bounds, popsize=popsize, maxiter=generations, tol=1e-7, mutation=(0.4, 0.9), recombination=0.8,
        vectorized=True, updating="deferred", polish=False, rng=rng,
        init="sobol" if init is None else init.reshape(len(init), -1),
    )  # fmt: skip
    order = np.argsort(found.population_energies, kind="stable")
    return found.population[order].reshape(order.size, -1, problem.coordinates)


def one_more(
    problem: PlacementProblem,
    count: int,
    earlier: np.ndarray,
    rng: np.random.Generator,
    trials: Evaluator,
    judge: ObjectiveFunction | None = None,
) -> np.ndarray:
    """The placement found for fewer, with the best of many random places added one at a time; the best (20, k, 2)."""
    low, high = problem.limits()
    places = earlier
    while True:
        tries = rng.uniform(low, high, (MORE, low.size))
        whole = np.concatenate([np.broadcast_to(places, (len(tries), *places.shape)), tries[:, None]], axis=1)
        ranked = whole[np.argsort(trials.at_once(whole, judge), kind="stable")[:20]]
        places = ranked[0]
        if len(places) == count:
            return ranked


def finish(
    value: Callable[[np.ndarray], float], start: np.ndarray, bounds: Bounds, sizes: Iterable[float], tries: int
) -> tuple[np.ndarray, float]:
    """Nelder-Mead from simplices of these sizes, m, down to a centimetre; at most `tries` a coordinate and simplex."""
    from scipy.optimize import minimize

    x = np.asarray(start, dtype=float)
    low, high = bounds.lb, bounds.ub
    lowest = value(x)
    for size in sizes:
        most = np.minimum(size, 0.5 * (high - low))  # so that no step ends where it begins
        steps = np.where(x + most > high, -most, most)
        simplex = np.vstack([x, np.clip(x + np.diag(steps), low, high)])
        found = minimize(
            value, x, method="Nelder-Mead", bounds=bounds,
            options={"initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-9, "maxfev": tries * x.size,
                     "adaptive": True},
        )  # fmt: skip
        if found.fun < lowest:
            x, lowest = found.x, float(found.fun)
    return x, lowest
