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

import numpy as np

from navsim.landing.confirmation import APART, CANDIDATES
from navsim.optimization.best_placement import Found, NoPlacement
from navsim.optimization.differential_evolution import (
    FINISHING,
    FINISHING_TRIES,
    GENERATIONS,
    MORE,
    POPULATION,
    bounds_of,
    evolve,
    finish,
    one_more,
    search_area,
    search_near,
)
from navsim.optimization.evaluator import (
    CHOOSING,
    COARSE,
    DECIDING,
    EVOLVING,
    FULL,
    GEOMETRY,
    LEARNING,
    LEVELS,
    SCREENING,
    Evaluator,
    PlacementWithRivals,
    step_name,
)
from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import PENALTY_CONSTRAINT, PENALTY_REQUIREMENT, PENALTY_UNSOLVED, PlacementProblem
from navsim.optimization.progress import SearchMonitor, Step
from navsim.optimization.scenario import BEACON_OBJECTIVES, LEVEL_OBJECTIVES
from navsim.optimization.site_choice import (
    ALL_CHOICES,
    POOL,
    choices_in_chunks,
    choose_sites,
    enough_sites,
    most_choices,
    neighbours,
    screened_choices,
    usable_sites,
)
from navsim.optimization.surrogate import SurrogateFit, largest_shift

_SINGLES = 4096
"""Positions of one pseudolite, of which the first placements of a search for a filter are put together."""
_SCREEN_GENERATIONS = 25
_LEVEL_GENERATIONS, _LEVEL_MORE, _LEVEL_STARTS = 60, 400, 2
"""Settings for levels at some epochs, which the coarse analysis follows: generations; positions tried for one more;
starts in addition to those of the study's effort, so that feasible placements are not missed."""
_EXPLORATION = 0.0, 1.0
"""Optimism of a round about unknown values: standard deviations, in turn."""
_REGION = 4.0
"""Every second round stays around the best: how far, in distances that new placements keep from the old."""
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


def steps(problem: PlacementProblem, count: int, earlier: bool) -> list[Step]:
    """Steps of a search for `count` pseudolites, at most. earlier: there is a placement of fewer."""
    effort, pace = problem.study.effort, _pace(problem)
    rounds = _rounds(count) * effort
    if problem.study.sites:
        usable = int(np.sum(usable_sites(problem)))
        choices = math.comb(usable, count)
        if problem.analysed and choices <= most_choices(problem):
            return [Step(step_name(problem, count, CHOOSING), {FULL: choices})]
        # greedy choices, and some three rounds of exchanges of every site
        tried = choices if choices <= ALL_CHOICES else 5 * effort * 4 * count * usable
        if not problem.analysed:
            return [Step(step_name(problem, count, CHOOSING), {GEOMETRY: tried})]
        screening = Step(step_name(problem, count, CHOOSING), {GEOMETRY: len(problem.screens) * tried})
        pool = len(problem.screens) * min(tried, POOL)
        learning = {GEOMETRY: rounds * pool, COARSE: _first(problem, count) + rounds * pace.learning}
        return [
            screening,
            Step(step_name(problem, count, LEARNING), learning),
            Step(step_name(problem, count, DECIDING), {FULL: _decisions(problem)}),
        ]
    if not problem.analysed:
        of_coordinate = POPULATION * (GENERATIONS + 1) + len(FINISHING) * FINISHING_TRIES
        per_start = problem.coordinates * count * of_coordinate
        return [Step(step_name(problem, count, EVOLVING), {GEOMETRY: effort * per_start + MORE * earlier})]
    evolving = _members(count) * (_SCREEN_GENERATIONS + 1)
    most = {GEOMETRY: len(problem.screens) * (POOL + evolving + MORE * earlier)}
    learning = {COARSE: _first(problem, count) + pace.finishing(problem.coordinates * count)}
    if problem.level_screen is not None:
        most[LEVELS] = (_LEVEL_STARTS + effort) * _members(count) * (_LEVEL_GENERATIONS + 1) + _LEVEL_MORE * earlier
    else:
        learning[COARSE] += rounds * pace.learning
        learning[GEOMETRY] = rounds * (2 * POOL + evolving)
    screening = Step(step_name(problem, count, SCREENING), most)
    anew = {} if problem.requirements is None else {COARSE: _AGAIN * pace.finishing(problem.coordinates * count)}
    return [
        screening,
        Step(step_name(problem, count, LEARNING), learning),
        Step(step_name(problem, count, DECIDING), {FULL: _decisions(problem), **anew}),
    ]


def _pace(problem: PlacementProblem) -> _SearchBudget:
    return _WATCHED if problem.quick else _FLOWN


def _decisions(problem: PlacementProblem) -> int:
    """Number of full analyses at the end; the last is that of the placement at whole centimetres."""
    return (problem.study.effort + 1) * (1 if problem.requirements is None else 1 + _AGAIN) + 1


def _members(count: int) -> int:
    """Size of the populations that look for the best by screens and surrogate."""
    return 12 * count + 12


def _first(problem: PlacementProblem, count: int) -> int:
    """Placements the surrogate begins to learn from."""
    return _pace(problem).first * (16 + 8 * count)


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
        choose = _choose_analysed if problem.analysed else choose_sites
        places, value, others, every = choose(problem, count, seed, trials, watch)
    elif problem.analysed or near is None:
        place = _place_analysed if problem.analysed else search_area
        places, value, others, every = place(problem, count, seed, earlier, trials, watch)
    else:
        places, value, others, every = search_near(problem, count, seed, near, trials, watch)
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
) -> PlacementWithRivals:
    rng = np.random.default_rng([seed, count])
    bounds = bounds_of(problem, count)
    size, pace = _members(count), _pace(problem)
    with watch.step(step_name(problem, count, SCREENING)):
        pool = _pool(problem, count, rng)
        lists: list[Iterable[np.ndarray]] = []
        for screen in problem.screens:
            judge = trials.by(screen)
            ranked = pool[np.argsort(judge(pool), kind="stable")]
            lists += [evolve(problem, judge, bounds, rng, _SCREEN_GENERATIONS, 1, ranked[:size]), ranked]
            if earlier is not None and len(earlier) < count:
                lists.append(one_more(problem, count, earlier, rng, trials, screen))
        if problem.level_screen is not None:
            lists = _by_levels(problem, count, rng, lists, earlier, trials)
        lists.append(pool)
    learner = SurrogateFit(problem, trials)
    with watch.step(step_name(problem, count, LEARNING)):
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
                near = np.clip(around + _REGION * gap * rng.uniform(-1.0, 1.0, (POOL // 3, count, low.size)), low, high)
                judge = trials.by(learner.surrogate(0.0, around))
                evolved = near[np.argsort(judge(near), kind="stable")][:size]
                learner.analyse(learner.new(evolved, pace.learning, 0.2 * gap))
                continue
            judge = trials.by(learner.surrogate(_EXPLORATION[i // 2 % len(_EXPLORATION)]))
            moved = best[rng.integers(min(len(best), 6), size=POOL)]
            moved[np.arange(POOL), rng.integers(count, size=POOL)] = pool[rng.integers(len(pool), size=POOL), 0]
            likely = [some[np.argsort(judge(some), kind="stable")][: size // 3] for some in (pool, moved)]
            evolved = evolve(problem, judge, bounds, rng, _SCREEN_GENERATIONS, 1, np.concatenate([best, *likely]))
            learner.analyse(learner.new(evolved, pace.learning, gap))

        def value(x: np.ndarray) -> float:
            learner.analyse([x.reshape(count, -1)])
            return float(learner.values[-1])

        def refine() -> None:
            for best in learner.spaced(pace.finished, _REGION * gaps[-1]):
                finish(value, best.ravel(), bounds, pace.sizes, pace.tries)

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
    judge, bounds, size = trials.by(problem.screened, LEVELS), bounds_of(problem, count), _members(count)
    promising = np.array(list(itertools.islice(_in_turn(screened), size // 2)))
    pool = _pool(problem, count, rng)
    out: list[Iterable[np.ndarray]] = []
    for _ in range(_LEVEL_STARTS + problem.study.effort):
        start = np.concatenate([promising, pool[rng.integers(len(pool), size=size - len(promising))]])
        out.append(evolve(problem, judge, bounds, rng, _LEVEL_GENERATIONS, 1, start))
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
) -> PlacementWithRivals:
    """Best placement by full analysis of the best by the coarse one, 10 m apart.

    If none of them meets requirements that the coarse analysis finds met, the coarse limit is tightened accordingly,
    and the refined placements are evaluated again.
    """
    best, lowest = np.empty((0, problem.coordinates)), math.inf
    with watch.step(step_name(problem, count, DECIDING)):
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
    return PlacementWithRivals(best, lowest, tuple(others)[: CANDIDATES - 1])


def _pool(problem: PlacementProblem, count: int, rng: np.random.Generator) -> np.ndarray:
    """Placements (n, k, 2) all over the area, with positions that keep the rules alone, if there are any."""
    from scipy.stats.qmc import Sobol

    low, high = problem.limits()
    singles = low + (high - low) * Sobol(low.size, rng=rng).random(_SINGLES)
    allowed = singles[problem.rules.violation(singles[:, None]) <= 0.0]
    source = allowed if len(allowed) else singles
    pool = source[rng.integers(len(source), size=(POOL, count))]
    kept = pool[problem.rules.violation(pool) <= 0.0]
    # if hardly any placement keeps the rules, evolution starts with violations
    return kept if len(kept) >= _first(problem, count) + _members(count) else pool


def _choose_analysed(
    problem: PlacementProblem, count: int, seed: int, trials: Evaluator, watch: SearchMonitor
) -> PlacementWithRivals:
    """The best `count` of the study's sites by analyses."""
    usable = enough_sites(problem, count)
    if math.comb(len(usable), count) <= most_choices(problem):
        with watch.step(step_name(problem, count, CHOOSING)):
            choices = usable[np.concatenate(list(choices_in_chunks(len(usable), count)))]
            values = trials.full(choices).value
        best, *others = np.argsort(values, kind="stable")
        return PlacementWithRivals(
            choices[best], float(values[best]), tuple(choices[others[: CANDIDATES - 1]]), every=True
        )
    with watch.step(step_name(problem, count, CHOOSING)):
        ranked = [
            screened_choices(usable, count, seed, problem.study.effort, trials.by(screen)) for screen in problem.screens
        ]
    learner, pace = SurrogateFit(problem, trials), _pace(problem)
    pool = np.unique(np.sort(np.concatenate(ranked), axis=1), axis=0)
    with watch.step(step_name(problem, count, LEARNING)):
        starts = (usable[list(c)] for c in _in_turn([*ranked, np.random.default_rng([seed, count]).permutation(pool)]))
        learner.analyse(learner.new(starts, _first(problem, count), 0.0))
        for _ in range(_rounds(count) * problem.study.effort):
            if not learner.solved:
                break
            pool = np.unique(np.concatenate([pool, neighbours(usable, learner.ranked()[0])]), axis=0)
            order = np.argsort(trials.at_once(usable[pool], learner.surrogate(0.0)), kind="stable")
            learner.analyse(learner.new((usable[c] for c in pool[order]), pace.learning, 0.0))
    return _decided(learner, count, problem, trials, watch)
