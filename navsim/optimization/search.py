"""Search for the best placement of one number of pseudolites or beacons.

Objectives of geometry in an area: differential evolution [1] (scipy's, whole populations at once in the geometry
kernel). It starts from several independent populations, and from the best position for one more pseudolite beside those
found before. Nelder-Mead refines each result down to centimetres. Placements that violate a rule rank behind all that
keep the rules, by the size of the violation [2], so the answer keeps them. A list of sites: every combination if there
are few; otherwise the best of many greedy choices, improved by exchanges.

Filter errors and protection levels: the accuracy of fixes over parts of the approach costs microseconds and predicts
most of the objective. A surrogate [3], linear in its logarithms with a Gaussian process on top, learns the rest from
coarse analyses. In each round, the placements that it predicts to be best are analysed, and it is fitted again. The
full analysis of the best ones alone decides. Requirements use a second surrogate for their load, with any objective. A
placement that is expected to miss them ranks behind all others [2].

If only levels are analysed, no surrogate is needed: differential evolution uses levels of whole populations at some
epochs, and Nelder-Mead refines the best ones. If the full analysis finds the best slightly beyond a limit, the coarse
limit is tightened by that much, and the best are evaluated again.

Sources:

- [1] Storn & Price, J. Global Optimization 11 (1997).
- [2] Deb, An efficient constraint handling method for genetic algorithms, Comput. Methods Appl. Mech. Engrg. 186
  (2000).
- [3] Jones, Schonlau & Welch, Efficient global optimization of expensive black-box functions, J. Global Optimization 13
  (1998).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navsim.landing.confirmation import APART, CANDIDATES
from navsim.optimization.best_placement import Found, NoPlacement
from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import (
    PENALTY_CONSTRAINT,
    PENALTY_REQUIREMENT,
    PENALTY_UNSOLVED,
    Evaluated,
    PlacementProblem,
)
from navsim.optimization.progress import SearchMonitor, Step
from navsim.optimization.scenario import BEACON_OBJECTIVES, LEVEL_OBJECTIVES
from navsim.optimization.surrogate import SurrogateFit, largest_shift

if TYPE_CHECKING:
    from scipy.optimize import Bounds

ALL_CHOICES = 2_000_000
"""Choices of sites up to which every one is tried for an objective of geometry; of a filter: ALL_ANALYSED, of levels:
ALL_WATCHED."""


ALL_ANALYSED, ALL_WATCHED = 50, 200


GEOMETRY, LEVELS, COARSE, FULL = "geometry", "levels", "coarse", "full"
"""Types of evaluation of a placement: geometry kernel, levels at some epochs, coarse and full analysis."""


CHUNK = 65_536
"""Choices of sites evaluated at a time."""


_POPULATION, _GENERATIONS = 30, 400
"""Differential evolution with an objective of geometry: members a coordinate, largest number of generations."""


_FINISHING = (100.0, 10.0, 1.0)
"""Sizes of the simplices of Nelder-Mead, m, and evaluations a coordinate with each."""


_FINISHING_TRIES = 200


_NEAR = 0.1
"""1 sigma of a population around a placement, as a share of the area."""


_MORE = 4000
"""Positions tried for one more pseudolite beside those found before."""


_SINGLES, _POOL = 4096, 3000
"""Places for one pseudolite, and placements put together of them, that the search for a filter begins with."""


_SCREEN_GENERATIONS = 25


_LEVEL_GENERATIONS, _LEVEL_MORE, _LEVEL_STARTS = 60, 400, 2
"""Settings for levels at some epochs, which the coarse analysis follows: generations; positions tried for one more;
starts in addition to those of the study's effort, so that feasible placements are not missed."""


_EXPLORATION = 0.0, 1.0
"""Optimism of a round about unknown values: standard deviations, in turn."""


_REGION = 4.0
"""Every second round stays around the best: how far, in distances that new placements keep from the old."""


_CHOOSING, _EVOLVING, _SCREENING = "choosing", "searching", "screening by geometry"
_LEARNING, _DECIDING = "coarse analysis", "full analysis"
"""Names of the steps of a search."""
_DIGITS = 2
"""Digits behind the point, of metres, that places have in tables and files."""


_ASIDE = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Shift of positions if rounding makes them violate a rule, m."""


@dataclass(frozen=True)
class _SearchBudget:
    """Amount of coarse analysis.

    first: times 16, and 8 a pseudolite, at the start. learning: in a round of the surrogate. finished: best placements
    that are refined. sizes: of their simplices, m. tries: a coordinate in each.
    """

    first: int
    learning: int
    finished: int
    sizes: tuple[float, ...]
    tries: int

    def finishing(self, coordinates: int) -> int:
        """Analyses that finish the best placements, which have so many coordinates."""
        return self.finished * len(self.sizes) * self.tries * coordinates


_FLOWN, _WATCHED = _SearchBudget(1, 3, 1, (20.0,), 6), _SearchBudget(3, 10, 3, (100.0, 20.0, 4.0), 15)
"""Budgets for covariance analyses, and for levels alone, which cost less."""


_AGAIN = 4
"""Largest number of times that the best are evaluated again, with stricter requirements in the coarse analysis."""


class _Best(NamedTuple):
    """A placement (k, 2) with its value; others, every: as of `Found`."""

    places: np.ndarray
    value: float
    others: tuple[np.ndarray, ...] = ()
    every: bool = False


def steps(problem: PlacementProblem, count: int, earlier: bool) -> list[Step]:
    """Steps of a search for `count` pseudolites, at most. earlier: there is a placement of fewer."""
    effort, pace = problem.study.effort, _pace(problem)
    rounds = _rounds(count) * effort
    if problem.study.sites:
        usable = int(np.sum(_usable(problem)))
        choices = math.comb(usable, count)
        if problem.analysed and choices <= _all(problem):
            return [Step(_step_name(problem, count, _CHOOSING), {FULL: choices})]
        # greedy choices, and some three rounds of exchanges of every site
        tried = choices if choices <= ALL_CHOICES else 5 * effort * 4 * count * usable
        if not problem.analysed:
            return [Step(_step_name(problem, count, _CHOOSING), {GEOMETRY: tried})]
        screening = Step(_step_name(problem, count, _CHOOSING), {GEOMETRY: len(problem.screens) * tried})
        pool = len(problem.screens) * min(tried, _POOL)
        learning = {GEOMETRY: rounds * pool, COARSE: _first(problem, count) + rounds * pace.learning}
        return [
            screening,
            Step(_step_name(problem, count, _LEARNING), learning),
            Step(_step_name(problem, count, _DECIDING), {FULL: _decisions(problem)}),
        ]
    if not problem.analysed:
        of_coordinate = _POPULATION * (_GENERATIONS + 1) + len(_FINISHING) * _FINISHING_TRIES
        per_start = problem.coordinates * count * of_coordinate
        return [Step(_step_name(problem, count, _EVOLVING), {GEOMETRY: effort * per_start + _MORE * earlier})]
    evolving = _members(count) * (_SCREEN_GENERATIONS + 1)
    most = {GEOMETRY: len(problem.screens) * (_POOL + evolving + _MORE * earlier)}
    learning = {COARSE: _first(problem, count) + pace.finishing(problem.coordinates * count)}
    if problem.level_screen is not None:
        most[LEVELS] = (_LEVEL_STARTS + effort) * _members(count) * (_LEVEL_GENERATIONS + 1) + _LEVEL_MORE * earlier
    else:
        learning[COARSE] += rounds * pace.learning
        learning[GEOMETRY] = rounds * (2 * _POOL + evolving)
    screening = Step(_step_name(problem, count, _SCREENING), most)
    anew = {} if problem.requirements is None else {COARSE: _AGAIN * pace.finishing(problem.coordinates * count)}
    return [
        screening,
        Step(_step_name(problem, count, _LEARNING), learning),
        Step(_step_name(problem, count, _DECIDING), {FULL: _decisions(problem), **anew}),
    ]


def _all(problem: PlacementProblem) -> int:
    """Choices of sites up to which every one is analysed in full."""
    return ALL_WATCHED if problem.quick else ALL_ANALYSED


def _pace(problem: PlacementProblem) -> _SearchBudget:
    return _WATCHED if problem.quick else _FLOWN


def _decisions(problem: PlacementProblem) -> int:
    """Number of full analyses at the end; the last is that of the placement at whole centimetres."""
    return (problem.study.effort + 1) * (1 if problem.requirements is None else 1 + _AGAIN) + 1


def _step_name(problem: PlacementProblem, count: int, what: str) -> str:
    return f"{problem.study.named(count)}, {what}"


def _members(count: int) -> int:
    """Size of the populations that look for the best by screens and surrogate."""
    return 12 * count + 12


def _first(problem: PlacementProblem, count: int) -> int:
    """Placements the surrogate begins to learn from."""
    return _pace(problem).first * (16 + 8 * count)


class Evaluator:
    """Evaluates placements as `PlacementProblem` does, and reports to a monitor. searching: report the best ones,
    too."""

    def __init__(self, problem: PlacementProblem, watch: SearchMonitor, searching: bool) -> None:
        self._here, self._watch, self._searching = problem, watch, searching

    def at_once(self, places: np.ndarray, judge: ObjectiveFunction | None = None, way: str = GEOMETRY) -> np.ndarray:
        """Values (n,) of placements (n, k, 2) by the objective of geometry or a replacement."""
        with self._watch.trying(way, len(places)):
            values = self._here.value(places) if judge is None else self._here.rough_value(places, judge)
        if judge is None:
            self._offer(places, values)
        return values

    def by(self, judge: ObjectiveFunction, way: str = GEOMETRY) -> ObjectiveFunction:
        """Function that evaluates placements with a replacement of the objective."""
        return lambda places: self.at_once(places, judge, way)

    def coarse(self, places: np.ndarray) -> Evaluated:
        """Placements (n, k, 2) by coarse analysis."""
        return self._one_by_one(places, COARSE)

    def full(self, places: np.ndarray) -> Evaluated:
        """Values by full analysis."""
        return self._one_by_one(places, FULL)

    def _one_by_one(self, places: np.ndarray, fidelity: str) -> Evaluated:
        ahead, out = self._here.ahead, []
        together = 1 if ahead is None else len(places)
        for first in range(0, len(places), together):
            some = places[first : first + together]
            with self._watch.trying(fidelity, len(some)):
                if ahead is not None:
                    ahead(some, fidelity)
                for i in range(len(some)):
                    out.append(self._here.judged(some[i : i + 1], coarse=fidelity == COARSE))
                    self._offer(some[i : i + 1], out[-1].value)
        return Evaluated(*map(np.concatenate, zip(*out, strict=True)))

    def _offer(self, places: np.ndarray, values: np.ndarray) -> None:
        best = int(np.argmin(values))
        if self._searching and values[best] < PENALTY_UNSOLVED:
            self._watch.offer(places[best], float(values[best]))


def search_one(
    problem: PlacementProblem,
    count: int,
    seed: int,
    earlier: np.ndarray | None,
    watch: SearchMonitor,
    near: np.ndarray | None = None,
) -> Found:
    """The best placement of `count` pseudolites. earlier: the best of fewer; near: one of as many, from which the
    search by an objective of geometry begins. Raises NoPlacement, TimeUp."""
    watch.begin()
    trials = Evaluator(problem, watch, searching=True)
    if problem.study.sites:
        choose = _choose_analysed if problem.analysed else _choose
        places, value, others, every = choose(problem, count, seed, trials, watch)
    elif problem.analysed or near is None:
        place = _place_analysed if problem.analysed else _place
        places, value, others, every = place(problem, count, seed, earlier, trials, watch)
    else:
        places, value, others, every = _place_near(problem, count, seed, near, trials, watch)
    if value >= PENALTY_CONSTRAINT or (value >= PENALTY_UNSOLVED and problem.requirements is None):
        what = "protection level" if problem.study.objective in LEVEL_OBJECTIVES else "fix"
        what = "position from the ranges of beacons" if problem.study.objective in BEACON_OBJECTIVES else what
        reason = "breaks a rule" if value >= PENALTY_CONSTRAINT else f"leaves epochs of the glide without a {what}"
        raise NoPlacement(f"{problem.study.named(count)}: every placement tried {reason}")
    if not problem.study.sites:
        judge = (lambda some: trials.full(some).value) if problem.analysed else trials.at_once
        places, value = _printed(places, value, judge)
    if problem.requirements is None:
        return Found(places, value, watch.tried_since(), every, finished=True, others=others)
    best = problem.judged(places[None])
    objective, load = float(best.objective[0]), float(best.load[0])
    return Found(places, objective, watch.tried_since(), every, finished=True, load=load, others=others)


def _printed(places: np.ndarray, value: float, judge: ObjectiveFunction) -> tuple[np.ndarray, float]:
    """A placement rounded to whole centimetres, as in tables and site files, and its value.

    It is the nearest, or the best neighbour if the nearest violates a rule or requirement that the placement itself
    meets.
    """
    nearest = np.round(places, _DIGITS)
    worst = next(limit for limit in (PENALTY_REQUIREMENT, PENALTY_UNSOLVED, PENALTY_CONSTRAINT) if value < limit)
    moves = np.eye(places.size).reshape(-1, *places.shape)
    best, lowest = nearest, float(judge(nearest[None])[0])
    for size in _ASIDE:
        if lowest < worst:
            break
        beside = np.round(nearest + size * np.concatenate([moves, -moves]), _DIGITS)
        values = judge(beside)
        i = int(np.argmin(values))
        if values[i] < lowest:
            best, lowest = beside[i], float(values[i])
    return (best, lowest) if lowest < worst else (places, value)


# --- objectives of geometry


def _place(
    problem: PlacementProblem,
    count: int,
    seed: int,
    earlier: np.ndarray | None,
    trials: Evaluator,
    watch: SearchMonitor,
) -> _Best:
    def value(x: np.ndarray) -> float:
        return float(trials.at_once(x.reshape(1, count, -1))[0])

    bounds = _bounds(problem, count)
    with watch.step(_step_name(problem, count, _EVOLVING)):
        candidates = [
            _evolve(
                problem, trials.at_once, bounds, np.random.default_rng([seed, count, start]), _GENERATIONS, _POPULATION
            )[0]
            for start in range(problem.study.effort)
        ]
        if earlier is not None and len(earlier) < count:
            candidates.append(_one_more(problem, count, earlier, np.random.default_rng([seed, count, 1000]), trials)[0])
        best, lowest = candidates[0], math.inf
        for candidate in candidates:
            x, reached = _finish(value, candidate.ravel(), bounds, _FINISHING, _FINISHING_TRIES)
            if reached < lowest:
                best, lowest = x.reshape(count, -1), reached
    return _Best(best, lowest)


def _place_near(
    problem: PlacementProblem, count: int, seed: int, near: np.ndarray, trials: Evaluator, watch: SearchMonitor
) -> _Best:
    """`_place` with one population, half of it around a placement."""
    rng, bounds = np.random.default_rng([seed, count, 2000]), _bounds(problem, count)
    size = (near.size * _POPULATION // 4, near.size)
    around = near.ravel() + _NEAR * (bounds.ub - bounds.lb) * rng.standard_normal(size)
    start = np.concatenate([np.clip(around, bounds.lb, bounds.ub), rng.uniform(bounds.lb, bounds.ub, size)])
    with watch.step(_step_name(problem, count, _EVOLVING)):
        best = _evolve(problem, trials.at_once, bounds, rng, _GENERATIONS // 2, 1, start)[0]
        x, reached = _finish(
            lambda x: float(trials.at_once(x.reshape(1, count, -1))[0]), best.ravel(), bounds, _FINISHING[1:],
            _FINISHING_TRIES // 2,
        )  # fmt: skip
    return _Best(x.reshape(count, -1), reached)


def _bounds(problem: PlacementProblem, count: int) -> Bounds:
    from scipy.optimize import Bounds

    low, high = problem.limits()
    return Bounds(np.tile(low, count), np.tile(high, count))


def _evolve(
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


def _one_more(
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
        tries = rng.uniform(low, high, (_MORE, low.size))
        whole = np.concatenate([np.broadcast_to(places, (len(tries), *places.shape)), tries[:, None]], axis=1)
        ranked = whole[np.argsort(trials.at_once(whole, judge), kind="stable")[:20]]
        places = ranked[0]
        if len(places) == count:
            return ranked


def _finish(
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


def _usable(problem: PlacementProblem) -> np.ndarray:
    """Which sites keep the rules by themselves (n,) bool."""
    return problem.rules.violation(problem.sites()[:, None]) <= 0.0


def _sites(problem: PlacementProblem, count: int) -> np.ndarray:
    usable = problem.sites()[_usable(problem)]
    if len(usable) < count:
        total = len(problem.study.sites)
        text = f"only {len(usable)} of {total} sites keep the constraints, {count} are needed"
        raise NoPlacement(f"{text}; add sites, or relax `constraints`")
    return usable


def _chunks(number: int, count: int) -> Iterator[np.ndarray]:
    """All choices of `count` out of a number of sites, as indices (n, count)."""
    choices = itertools.combinations(range(number), count)
    while chunk := list(itertools.islice(choices, CHUNK)):
        yield np.array(chunk)


def _choose(problem: PlacementProblem, count: int, seed: int, trials: Evaluator, watch: SearchMonitor) -> _Best:
    """The best `count` of the study's sites."""
    usable = _sites(problem, count)
    with watch.step(_step_name(problem, count, _CHOOSING)):
        if math.comb(len(usable), count) <= ALL_CHOICES:
            best, lowest = usable[:count], math.inf
            for chunk in _chunks(len(usable), count):
                values = trials.at_once(usable[chunk])
                i = int(np.argmin(values))
                if values[i] < lowest:
                    best, lowest = usable[chunk[i]], float(values[i])
            return _Best(best, lowest, every=True)
        ranked = _exchanged(usable, count, seed, problem.study.effort, trials.at_once)
        return _Best(usable[ranked[0][1]], ranked[0][0])


def _exchanged(
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


# --- errors of the filter, levels, requirements


def _in_turn(lists: Iterable[Iterable[np.ndarray]]) -> Iterator[np.ndarray]:
    """The first of every list, then the second of every list, and so on."""
    for row in itertools.zip_longest(*lists):
        yield from (one for one in row if one is not None)


def _rounds(count: int) -> int:
    """Rounds of the surrogate for each unit of the study's `effort`."""
    return 2 + 2 * count


def _gaps(problem: PlacementProblem, count: int) -> np.ndarray:
    """The distance new placements keep from those analysed, round by round, m."""
    low, high = problem.limits()
    return np.geomspace(0.02 * float(np.linalg.norm(high - low)), 2.0, _rounds(count) * problem.study.effort)


def _place_analysed(
    problem: PlacementProblem,
    count: int,
    seed: int,
    earlier: np.ndarray | None,
    trials: Evaluator,
    watch: SearchMonitor,
) -> _Best:
    rng = np.random.default_rng([seed, count])
    bounds = _bounds(problem, count)
    size, pace = _members(count), _pace(problem)
    with watch.step(_step_name(problem, count, _SCREENING)):
        pool = _pool(problem, count, rng)
        lists: list[Iterable[np.ndarray]] = []
        for screen in problem.screens:
            judge = trials.by(screen)
            ranked = pool[np.argsort(judge(pool), kind="stable")]
            lists += [_evolve(problem, judge, bounds, rng, _SCREEN_GENERATIONS, 1, ranked[:size]), ranked]
            if earlier is not None and len(earlier) < count:
                lists.append(_one_more(problem, count, earlier, rng, trials, screen))
        if problem.level_screen is not None:
            lists = _by_levels(problem, count, rng, lists, earlier, trials)
        lists.append(pool)
    learner = SurrogateFit(problem, trials)
    with watch.step(_step_name(problem, count, _LEARNING)):
        gaps = _gaps(problem, count)
        learner.analyse(
            learner.new(_in_turn(lists), _first(problem, count), gaps[0] if problem.level_screen is None else 1.0)
        )
        low, high = problem.limits()
        for i, gap in enumerate(gaps):
            if not learner.solved or problem.level_screen is not None:
                break
            best = np.array(learner.ranked()[: size // 3])
            if i % 2:  # around the best, and by turns around the best elsewhere
                around = learner.spaced(2, _REGION * gaps[0])[i // 2 % 2 - 1]
                near = np.clip(
                    around + _REGION * gap * rng.uniform(-1.0, 1.0, (_POOL // 3, count, low.size)), low, high
                )
                judge = trials.by(learner.surrogate(0.0, around))
                evolved = near[np.argsort(judge(near), kind="stable")][:size]
                learner.analyse(learner.new(evolved, pace.learning, 0.2 * gap))
                continue
            judge = trials.by(learner.surrogate(_EXPLORATION[i // 2 % len(_EXPLORATION)]))
            moved = best[rng.integers(min(len(best), 6), size=_POOL)]
            moved[np.arange(_POOL), rng.integers(count, size=_POOL)] = pool[rng.integers(len(pool), size=_POOL), 0]
            likely = [some[np.argsort(judge(some), kind="stable")][: size // 3] for some in (pool, moved)]
            evolved = _evolve(problem, judge, bounds, rng, _SCREEN_GENERATIONS, 1, np.concatenate([best, *likely]))
            learner.analyse(learner.new(evolved, pace.learning, gap))

        def value(x: np.ndarray) -> float:
            learner.analyse([x.reshape(count, -1)])
            return float(learner.values[-1])

        def refine() -> None:
            for best in learner.spaced(pace.finished, _REGION * gaps[-1]):
                _finish(value, best.ravel(), bounds, pace.sizes, pace.tries)

        refine()
    return _decided(learner, count, problem, trials, watch, refine)


def _by_levels(
    problem: PlacementProblem,
    count: int,
    rng: np.random.Generator,
    screened: list[Iterable[np.ndarray]],
    earlier: np.ndarray | None,
    trials: Evaluator,
) -> list[Iterable[np.ndarray]]:
    """Lists of placements, the best of each first, by levels at some epochs.

    They start from the best by screens, and from random ones.
    """
    judge, bounds, size = trials.by(problem.screened, LEVELS), _bounds(problem, count), _members(count)
    promising = np.array(list(itertools.islice(_in_turn(screened), size // 2)))
    pool = _pool(problem, count, rng)
    out: list[Iterable[np.ndarray]] = []
    for _ in range(_LEVEL_STARTS + problem.study.effort):
        start = np.concatenate([promising, pool[rng.integers(len(pool), size=size - len(promising))]])
        out.append(_evolve(problem, judge, bounds, rng, _LEVEL_GENERATIONS, 1, start))
    if earlier is not None and len(earlier) < count:
        added = pool[rng.integers(len(pool), size=(_LEVEL_MORE, count - len(earlier))), 0]
        whole = np.concatenate([np.repeat(earlier[None], len(added), axis=0), added], axis=1)
        out.append(whole[np.argsort(judge(whole), kind="stable")[:size]])
    return out


def _decided(
    learner: SurrogateFit,
    count: int,
    problem: PlacementProblem,
    trials: Evaluator,
    watch: SearchMonitor,
    refine: Callable[[], None] = lambda: None,
) -> _Best:
    """Best placement by full analysis of the best by the coarse one, 10 m apart.

    If none of them meets requirements that the coarse analysis finds met, the coarse limit is tightened accordingly,
    and the refined placements are evaluated again.
    """
    best, lowest = np.empty((0, problem.coordinates)), math.inf
    with watch.step(_step_name(problem, count, _DECIDING)):
        watch.judge_anew()
        for again in range(1 + _AGAIN):
            if again:
                refine()
            some = learner.spaced(problem.study.effort + 1, 10.0)
            found = trials.full(np.array(some))
            i = int(np.argmin(found.value))
            if found.value[i] < lowest:
                best, lowest = some[i], float(found.value[i])
            expected = np.array([learner.load_of(one) for one in some])
            if lowest < PENALTY_REQUIREMENT or not (expected <= learner.most).any():
                break
            learner.most = min(learner.most, float(np.fmin.reduce(expected / found.load)))
    others = (one for one in learner.spaced(CANDIDATES, APART) if largest_shift(one, best) > APART)
    return _Best(best, lowest, tuple(others)[: CANDIDATES - 1])


def _pool(problem: PlacementProblem, count: int, rng: np.random.Generator) -> np.ndarray:
    """Placements (n, k, 2) all over the area, with positions that keep the rules alone, if there are any."""
    from scipy.stats.qmc import Sobol

    low, high = problem.limits()
    singles = low + (high - low) * Sobol(low.size, rng=rng).random(_SINGLES)
    allowed = singles[problem.rules.violation(singles[:, None]) <= 0.0]
    source = allowed if len(allowed) else singles
    pool = source[rng.integers(len(source), size=(_POOL, count))]
    kept = pool[problem.rules.violation(pool) <= 0.0]
    # if hardly any placement keeps the rules, evolution starts with violations
    return kept if len(kept) >= _first(problem, count) + _members(count) else pool


def _choose_analysed(
    problem: PlacementProblem, count: int, seed: int, trials: Evaluator, watch: SearchMonitor
) -> _Best:
    """The best `count` of the study's sites by analyses."""
    usable = _sites(problem, count)
    if math.comb(len(usable), count) <= _all(problem):
        with watch.step(_step_name(problem, count, _CHOOSING)):
            choices = usable[np.concatenate(list(_chunks(len(usable), count)))]
            values = trials.full(choices).value
        best, *others = np.argsort(values, kind="stable")
        return _Best(choices[best], float(values[best]), tuple(choices[others[: CANDIDATES - 1]]), every=True)
    with watch.step(_step_name(problem, count, _CHOOSING)):
        ranked = [
            _screened_choices(usable, count, seed, problem.study.effort, trials.by(screen))
            for screen in problem.screens
        ]
    learner, pace = SurrogateFit(problem, trials), _pace(problem)
    pool = np.unique(np.sort(np.concatenate(ranked), axis=1), axis=0)
    with watch.step(_step_name(problem, count, _LEARNING)):
        starts = (usable[list(c)] for c in _in_turn([*ranked, np.random.default_rng([seed, count]).permutation(pool)]))
        learner.analyse(learner.new(starts, _first(problem, count), 0.0))
        for _ in range(_rounds(count) * problem.study.effort):
            if not learner.solved:
                break
            pool = np.unique(np.concatenate([pool, _neighbours(usable, learner.ranked()[0])]), axis=0)
            order = np.argsort(trials.at_once(usable[pool], learner.surrogate(0.0)), kind="stable")
            learner.analyse(learner.new((usable[c] for c in pool[order]), pace.learning, 0.0))
    return _decided(learner, count, problem, trials, watch)


def _screened_choices(usable: np.ndarray, count: int, seed: int, effort: int, judge: ObjectiveFunction) -> np.ndarray:
    """Best choices as indices (n, count), the best first: of all choices if feasible, otherwise by exchanges."""
    if math.comb(len(usable), count) > ALL_CHOICES:
        return np.array([chosen for _, chosen in _exchanged(usable, count, seed, effort, judge)])
    best, values = np.empty((0, count), np.int64), np.empty(0)
    for chunk in _chunks(len(usable), count):
        best, values = np.concatenate([best, chunk]), np.concatenate([values, judge(usable[chunk])])
        order = np.argsort(values, kind="stable")[:_POOL]
        best, values = best[order], values[order]
    return best


def _neighbours(usable: np.ndarray, places: np.ndarray) -> np.ndarray:
    """All choices that differ from one by one site, as sorted indices (n, count)."""
    chosen = [int(np.flatnonzero(np.all(usable == place, axis=1))[0]) for place in places]
    free = [i for i in range(len(usable)) if i not in chosen]
    return np.sort([[*chosen[:slot], i, *chosen[slot + 1 :]] for slot in range(len(chosen)) for i in free], axis=1)
