"""Choice of the best of listed sites: every combination, or greedy choices improved by exchanges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from navsim.optimization.best_placement import NoPlacement
from navsim.optimization.evaluator import CHOOSING, Evaluator, PlacementWithRivals, step_name
from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import PlacementProblem
from navsim.optimization.progress import SearchMonitor

ALL_CHOICES = 2_000_000
"""Choices of sites up to which every one is tried for an objective of geometry; of a filter: ALL_ANALYSED, of levels:
ALL_WATCHED."""
ALL_ANALYSED, ALL_WATCHED = 50, 200
CHUNK = 65_536
"""Choices of sites evaluated at a time."""
POOL = 3000
"""Placements that the search for a filter begins with."""


def most_choices(problem: PlacementProblem) -> int:
    """Choices of sites up to which every one is analysed in full."""
    return ALL_WATCHED if problem.quick else ALL_ANALYSED


def usable_sites(problem: PlacementProblem) -> np.ndarray:
    """Which sites keep the rules by themselves (n,) bool."""
    return problem.rules.violation(problem.sites()[:, None]) <= 0.0


def enough_sites(problem: PlacementProblem, count: int) -> np.ndarray:
    """Sites that keep the rules by themselves (n, k). Raises NoPlacement for fewer than `count`."""
    usable = problem.sites()[usable_sites(problem)]
    if len(usable) < count:
        total = len(problem.study.sites)
        text = f"only {len(usable)} of {total} sites keep the constraints, {count} are needed"
        raise NoPlacement(f"{text}; add sites, or relax `constraints`")
    return usable


def choices_in_chunks(number: int, count: int) -> Iterator[np.ndarray]:
    """All choices of `count` out of a number of sites, as indices (n, count)."""
    choices = itertools.combinations(range(number), count)
    while chunk := list(itertools.islice(choices, CHUNK)):
        yield np.array(chunk)


def choose_sites(
    problem: PlacementProblem, count: int, seed: int, trials: Evaluator, watch: SearchMonitor
) -> PlacementWithRivals:
    """The best `count` of the study's sites."""
    usable = enough_sites(problem, count)
    with watch.step(step_name(problem, count, CHOOSING)):
        if math.comb(len(usable), count) <= ALL_CHOICES:
            best, lowest = usable[:count], math.inf
            for chunk in choices_in_chunks(len(usable), count):
                values = trials.at_once(usable[chunk])
                i = int(np.argmin(values))
                if values[i] < lowest:
                    best, lowest = usable[chunk[i]], float(values[i])
            return PlacementWithRivals(best, lowest, every=True)
        ranked = exchanged(usable, count, seed, problem.study.effort, trials.at_once)
        return PlacementWithRivals(usable[ranked[0][1]], ranked[0][0])


def exchanged(
    usable: np.ndarray, count: int, seed: int, effort: int, judge: ObjectiveFunction
) -> list[tuple[float, list[int]]]:
    """Greedy choices of sites from several starts, each improved by exchanging one site at a time: values and choices,
    the best first."""

    def fill(others: list[int]) -> tuple[list[int], float]:
        """Best site in addition to the others, and its value."""
        free = [i for i in range(len(usable)) if i not in others]
        values = judge(usable[np.array([[*others, i] for i in free])])
        i = int(np.argmin(values))
        return [*others, free[i]], float(values[i])

    rng = np.random.default_rng([seed, count])
    out = []
    for start in range(5 * effort):
        chosen = [] if start == 0 else [int(i) for i in rng.choice(len(usable), count - 1, replace=False)]
        value = math.inf
        while len(chosen) < count:
            chosen, value = fill(chosen)
        improved = True
        while improved:
            improved = False
            for slot in range(count):
                other, reached = fill([c for i, c in enumerate(chosen) if i != slot])
                if reached < value * (1.0 - 1e-12):
                    chosen, value, improved = other, reached, True
        out.append((value, chosen))
    return sorted(out)


def screened_choices(usable: np.ndarray, count: int, seed: int, effort: int, judge: ObjectiveFunction) -> np.ndarray:
    """Best choices as indices (n, count), the best first: of all choices if feasible, otherwise by exchanges."""
    if math.comb(len(usable), count) > ALL_CHOICES:
        return np.array([chosen for _, chosen in exchanged(usable, count, seed, effort, judge)])
    best, values = np.empty((0, count), np.int64), np.empty(0)
    for chunk in choices_in_chunks(len(usable), count):
        best, values = np.concatenate([best, chunk]), np.concatenate([values, judge(usable[chunk])])
        order = np.argsort(values, kind="stable")[:POOL]
        best, values = best[order], values[order]
    return best


def neighbours(usable: np.ndarray, places: np.ndarray) -> np.ndarray:
    """All choices that differ from one by one site, as sorted indices (n, count)."""
    chosen = [int(np.flatnonzero(np.all(usable == place, axis=1))[0]) for place in places]
    free = [i for i in range(len(usable)) if i not in chosen]
    return np.sort([[*chosen[:slot], i, *chosen[slot + 1 :]] for slot in range(len(chosen)) for i in free], axis=1)
