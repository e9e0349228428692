"""`kind: optimize`: best placements, sensitivity of the optimum, accuracy as a function of number, or of cost.

Results are kept whenever the work is stopped. Evaluation of placements: `optimization.problem`; search:
`optimization.search`; result: `optimization.result`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from navsim.landing.confirmation import Candidate, Confirmation, confirm
from navsim.optimization.best_placement import Found, NoPlacement
from navsim.optimization.costs import HALVINGS, Member, cheaper, on_front
from navsim.optimization.evaluator import COARSE, FULL, GEOMETRY, Evaluator
from navsim.optimization.flatness import (
    BEARINGS,
    map_points,
    neighbourhood,
    objective_map,
    reaches,
)
from navsim.optimization.prefetch import ObjectiveFunctions, Prefetcher
from navsim.optimization.problem import (
    PENALTY_REQUIREMENT,
    PENALTY_UNSOLVED,
    PlacementProblem,
)
from navsim.optimization.progress import SearchMonitor, ShareUp, Step, TimeUp
from navsim.optimization.scenario import Optimize
from navsim.optimization.search import search_one, steps
from navsim.optimization.search_log import SearchLog
from navsim.runner.checkpoint import Arrays, code_key
from navsim.runner.executor import RemoteExecutor
from navsim.scenario.load import resolved_yaml

if TYPE_CHECKING:
    pass

TIME_LIMIT, INTERRUPTED = "time limit", "interrupted"


@dataclass
class SearchOutcome:
    """Outcome of a study, by search."""

    without: float
    """Objective without pseudolites."""
    found: dict[Member, Found] = field(default_factory=dict)
    neighbourhoods: dict[Member, np.ndarray] = field(default_factory=dict)
    """See `neighbourhood`."""
    maps: dict[Member, np.ndarray] = field(default_factory=dict)
    """See `objective_map`; of searches without a limit of the cost."""
    confirmed: dict[Member, Confirmation] = field(default_factory=dict)
    """Runs of the best placements."""
    impossible: dict[Member, NoPlacement] = field(default_factory=dict)
    """Searches without a placement, where another transmitter power has one."""
    cut: set[Member] = field(default_factory=set)
    """Searches that their shares of the time limit ended."""
    every_limit: bool = False
    """All searches with a limit of the cost are done."""
    stopped: str = ""
    """TIME_LIMIT or INTERRUPTED if the work ended early, else empty."""

    def undone(self, study: Optimize) -> list[str]:
        """Remaining work on the numbers of pseudolites, or beacons, of a study."""
        out = []
        unlimited = [one for one in _unlimited(study) if one not in self.impossible]
        limited = {one for one in self.found if one.number}
        for what, due, done in (
            ("the search", {*unlimited}, {one for one, found in self.found.items() if found.finished}),
            ("the neighbourhood", limited.union(unlimited), self.neighbourhoods.keys()),
            ("the map", {*unlimited}, self.maps.keys()),
        ):
            left = sorted({one.count for one in due - done})
            if left:
                out.append(f"{what} for {', '.join(map(str, left))} {study.placed[:-1]}(s)")
        if study.costs is not None and not self.every_limit:
            out.append("the front of accuracy against cost")
        return out


def _unlimited(study: Optimize) -> list[Member]:
    """The searches of a study without a limit of the cost, in order."""
    return [Member(count, power) for power in range(len(study.powers)) for count in study.counts]


def search(problem: PlacementProblem, seed: int, watch: SearchMonitor | None = None) -> dict[int, Found]:
    """The best placement for every number of pseudolites the study asks for. Raises NoPlacement."""
    watch = watch or SearchMonitor()
    watch.plan(_search_steps(problem))
    return {one.count: found for one, found in _searches(problem, seed, watch, SearchLog(), {}, set())}


def planned(problem: PlacementProblem) -> list[Step]:
    """All steps of the work, each with the largest number of placements."""
    study = problem.study
    each = (1 + _limited(study)) * len(study.powers)  # placements of each number
    return [
        *_search_steps(problem),
        *(
            step
            for one in _unlimited(study)
            for _ in range(_limited(study))
            for step in steps(problem.of(replace(one, number=1)), one.count, one.count > study.counts[0])
        ),
        *(Step(_flying(problem, count), {}) for count in study.counts for _ in range(each)),
        *_later_steps(problem, each),
    ]


def _halvings(study: Optimize) -> int:
    return HALVINGS if study.constraints.requirements else 1


def _limited(study: Optimize) -> int:
    """Largest number of searches with a limit of the cost, for each number of sources and each power."""
    return 0 if study.costs is None else study.costs.steps + _halvings(study)


def most_members(study: Optimize) -> int:
    """Largest number of placements of a study."""
    return len(_unlimited(study)) * (1 + _limited(study))


def _search_steps(problem: PlacementProblem) -> list[Step]:
    counts = problem.study.counts
    return [step for one in _unlimited(problem.study) for step in steps(problem, one.count, one.count > counts[0])]


def _searches(
    problem: PlacementProblem,
    seed: int,
    watch: SearchMonitor,
    journal: SearchLog,
    impossible: dict[Member, NoPlacement],
    cut: set[Member],
) -> Iterator[tuple[Member, Found]]:
    """Without a limit of the cost; they share the time limit. Adds to `impossible` and `cut`; raises NoPlacement for a
    number that no power can do."""
    earlier: np.ndarray | None = None
    last, every = len(problem.study.powers) - 1, _unlimited(problem.study)
    for i, one in enumerate(every):
        watch.allot(len(every) - i)
        earlier = None if one.count == problem.study.counts[0] else earlier
        try:
            found = _search(problem, one, seed, earlier, watch, journal)
        except ShareUp:
            cut.add(one)
            if (so_far := _unfinished(problem, one, watch)) is None:
                continue
            found = so_far
        except NoPlacement as error:
            impossible[one] = error
            if one.power == last and all(Member(one.count, power) in impossible for power in range(last)):
                raise
            continue
        earlier = found.places
        yield one, found


def _search(
    problem: PlacementProblem,
    one: Member,
    seed: int,
    earlier: np.ndarray | None,
    watch: SearchMonitor,
    journal: SearchLog,
    near: np.ndarray | None = None,
) -> Found:
    def work() -> Arrays:
        return search_one(problem.of(one), one.count, seed, earlier, watch, near).arrays()

    return Found.of(journal.step(f"found-{one.count}{one.suffix}", work))


def _below_limits(
    problem: PlacementProblem, outcome: SearchOutcome, seed: int, watch: SearchMonitor, journal: SearchLog
) -> None:
    """Add the placements below limits of the cost that are on the front."""
    costs, fewer = problem.study.costs, dict[int, Found]()
    if costs is None:
        return
    try:
        for one in sorted(outcome.found, key=lambda one: (one.power, one.count)):
            best, its = outcome.found[one], problem.of(one)
            assert its.rules.costs is not None
            earlier = fewer[one.power].places if one.power in fewer else None

            def seek(
                number: int, limit: float, near: Found, one: Member = one, earlier: np.ndarray | None = earlier
            ) -> Found:
                limited = replace(one, number=number, limit=limit)
                return _search(problem, limited, seed, earlier, watch, journal, near.places)

            least = its.rules.costs.least(one.count, problem.lowest)
            for number, limit, cheap in cheaper(
                best, least, costs.steps, _halvings(problem.study), partial(cost_of, its), seek
            ):
                outcome.found[replace(one, number=number, limit=limit)] = cheap
            fewer[one.power] = best
        outcome.every_limit = True
    finally:
        front = mark_front(problem, outcome.found)
        outcome.found = {one: each for one, each in outcome.found.items() if front[one] or not one.number}


def cost_of(problem: PlacementProblem, found: Found) -> float:
    return float(problem.costs(found.places).sum())


def mark_front(problem: PlacementProblem, found: dict[Member, Found]) -> dict[Member, bool]:
    """Which placements are on the front of accuracy against cost."""
    cost = np.array([cost_of(problem.of(one), each) for one, each in found.items()])
    value, met = (np.array([getattr(each, name) for each in found.values()]) for name in ("value", "met"))
    return dict(zip(found, on_front(cost, value, met).tolist(), strict=True))


def partial_key(problem: PlacementProblem, seed: int) -> dict[str, object]:
    """Data that partial work must match to be resumed."""
    text = resolved_yaml(problem.study) + resolved_yaml(problem.scenario)
    return {"study_sha256": hashlib.sha256(text.encode()).hexdigest(), "seed": seed, **code_key()}


def solve(
    problem: PlacementProblem,
    seed: int,
    watch: SearchMonitor | None = None,
    journal: SearchLog | None = None,
    pool: RemoteExecutor | None = None,
    runs: int = 0,
) -> SearchOutcome:
    """Find placements, then run the best, then compute neighbourhoods and maps.

    The time limit of `watch` or an interrupt ends the work. Results until then are kept, including the best of a search
    in progress; after the time limit it still gets its runs.

    - `runs`: of the best placement of each number of pseudolites; 0: none.
    - `journal`: of an earlier attempt; the search continues from it, with the same outcome.
    - `pool`: remote workers that analyse several placements at a time, if the journal keeps them.

    Raises NoPlacement without a placement, KeyboardInterrupt if there is none yet, CheckpointError if the journal
    cannot be written, executor.WorkerLost.
    """
    watch = watch or SearchMonitor()
    journal = journal or SearchLog()
    first, *others = (_remembering(each, i, journal, pool, watch) for i, each in enumerate((problem, *problem.powers)))
    problem = replace(first, powers=tuple(others))
    watch.plan(planned(problem))
    nothing = np.empty((1, 0, 2))
    if problem.coarse is not None:
        problem.coarse(nothing)  # so that the next timing does not include the loading of kernels
    outcome = SearchOutcome(float(problem.objective(nothing)[0]))

    def step(
        what: str, one: Member, work: Callable[[PlacementProblem, Found, Evaluator], np.ndarray], best: Found
    ) -> np.ndarray:
        its = problem.of(one)
        trials = Evaluator(its, watch, searching=False)
        return journal.step(f"{what}-{one.count}{one.suffix}", lambda: {what: work(its, best, trials)})[what]

    try:
        if problem.coarse is not None:
            for fidelity, judge in ((FULL, problem.objective), (COARSE, problem.coarse)):
                with watch.trying(fidelity, 1):
                    judge(nothing)
        for one, found in _searches(problem, seed, watch, journal, outcome.impossible, outcome.cut):
            outcome.found[one] = found
        _below_limits(problem, outcome, seed, watch, journal)
        members = sorted(outcome.found)
        for one in members if runs else ():
            with watch.step(_flying(problem, one.count)):
                _fly_best(problem, outcome, one, seed, runs, journal)
        for one in members:
            best = outcome.found[one]
            watch.best, watch.places = best.value, best.places
            with watch.step(_around(problem, one.count)):
                outcome.neighbourhoods[one] = step("around", one, neighbourhood, best)
        for one in (one for one in _unlimited(problem.study) if one in outcome.found):
            best = outcome.found[one]
            watch.best, watch.places = best.value, best.places
            with watch.step(_mapping(problem, one.count)):
                outcome.maps[one] = step("map", one, objective_map, best)
        outcome.stopped = TIME_LIMIT if outcome.cut else ""
    except (TimeUp, KeyboardInterrupt) as stop:
        outcome.stopped = TIME_LIMIT if isinstance(stop, TimeUp) else INTERRUPTED
        known = outcome.found.keys() | outcome.impossible | outcome.cut
        present = next((one for one in _unlimited(problem.study) if one not in known), None)
        if present is not None and (so_far := _unfinished(problem, present, watch)) is not None:
            outcome.found[present] = so_far
        if not outcome.found:
            if isinstance(stop, KeyboardInterrupt):
                raise
            text = f"the time limit passed during '{watch.doing}', before navsim had evaluated a placement"
            part = "" if watch.prepared is None else f"; preparing took {watch.prepared:.0f} s of it"
            raise NoPlacement(f"{text} that keeps the rules{part}; give a longer one") from None
        if runs and outcome.stopped == TIME_LIMIT:
            for one in sorted(outcome.found.keys() - outcome.confirmed.keys()):
                watch.conclude(_flying(problem, one.count))
                _fly_best(problem, outcome, one, seed, runs, journal)
    return outcome


def _remembering(
    problem: PlacementProblem, power: int, journal: SearchLog, pool: RemoteExecutor | None, watch: SearchMonitor
) -> PlacementProblem:
    """The problem of one power, which looks into the journal before it analyses a placement."""
    if problem.coarse is None:
        return problem
    judges = _judges(problem, f"-{power}" if power else "")
    if pool is not None and journal.keeps:
        problem = replace(problem, ahead=Prefetcher(judges, problem.rules, journal, pool, watch.look))
    known = {
        fidelity: [journal.remembering(name, judge) for name, judge in judges[fidelity].items()]
        for fidelity in (FULL, COARSE)
    }
    (full, *load), (coarse, *coarse_load) = known[FULL], known[COARSE]
    problem = replace(problem, objective=full, coarse=coarse)
    return replace(problem, load=load[0], coarse_load=coarse_load[0]) if load else problem


def _fly_best(
    problem: PlacementProblem, outcome: SearchOutcome, one: Member, seed: int, runs: int, journal: SearchLog
) -> None:
    """Run the best placement of a search; the next best replaces it if runs contradict it."""
    best, problem = outcome.found[one], problem.of(one)

    def work() -> Arrays:
        assert problem.fly is not None
        others: list[Candidate] = [partial(_analysed, problem, one) for one in best.others]
        candidates: list[Candidate] = [lambda: (best.places, best.value), *others]
        met = problem.requirements.decided if problem.requirements is not None and best.met else None
        return confirm(candidates, problem.study.objective, problem.fly, seed, runs, met).arrays()

    # a continued search may reach another placement
    key = hashlib.sha256(best.places.tobytes()).hexdigest()[:16]
    name = f"flown-{one.count}{one.suffix}-{runs}-{key}"
    found = outcome.confirmed[one] = Confirmation.of(journal.step(name, work))
    if found.rejected and not np.array_equal(found.best.choice, best.places):
        judged = problem.judged(found.best.choice[None])  # runs are compared with errors of the filter alone
        value, load = float(judged.objective[0]), float(judged.load[0])
        outcome.found[one] = replace(best, places=found.best.choice, value=value, load=load)


def _analysed(problem: PlacementProblem, places: np.ndarray) -> tuple[np.ndarray, float] | None:
    """A placement (k, 2) with its objective by the full analysis, None where it breaks a rule or misses a
    requirement."""
    found = problem.judged(places[None])
    return (places, float(found.objective[0])) if found.value[0] < PENALTY_REQUIREMENT else None


def _judges(problem: PlacementProblem, suffix: str) -> ObjectiveFunctions:
    """Evaluators of an analysed problem, by their names in the journal."""
    out: ObjectiveFunctions = {}
    for fidelity, judge, load in (
        (FULL, problem.objective, problem.load),
        (COARSE, problem.coarse, problem.coarse_load),
    ):
        assert judge is not None
        name = fidelity + suffix
        out[fidelity] = {name: judge} | ({} if load is None else {f"{name}-load": load})
    return out


def _unfinished(problem: PlacementProblem, one: Member, watch: SearchMonitor) -> Found | None:
    """The best so far of a search without a limit of the cost that was stopped."""
    if watch.places is None or len(watch.places) != one.count:
        return None
    best = problem.of(one).judged(watch.places[None])
    if best.value[0] >= PENALTY_UNSOLVED:
        return None
    objective, load = float(best.objective[0]), float(best.load[0])
    return Found(watch.places, objective, watch.tried_since(), False, finished=False, load=load)


def _flying(problem: PlacementProblem, count: int) -> str:
    return f"{problem.study.named(count)}, flying the best"


def _around(problem: PlacementProblem, count: int) -> str:
    return f"{problem.study.named(count)}, neighbourhood"


def _mapping(problem: PlacementProblem, count: int) -> str:
    return f"{problem.study.named(count)}, map"


def _later_steps(problem: PlacementProblem, each: int) -> list[Step]:
    counts = problem.study.counts
    fidelity = COARSE if problem.analysed else GEOMETRY
    reach, points = reaches(problem), map_points(problem)
    return [
        *(Step(_around(problem, n), {fidelity: n * BEARINGS.size * reach}) for n in counts for _ in range(each)),
        *(Step(_mapping(problem, one.count), {fidelity: points * points}) for one in _unlimited(problem.study)),
    ]
