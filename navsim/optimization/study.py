"""`kind: optimize`: best placements, sensitivity of the optimum, accuracy as a function of number.

Results are kept whenever the work is stopped. Evaluation of placements: `optimization.problem`; search:
`optimization.search`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from navsim.geodesy.earth import llh_from_ecef
from navsim.landing.beacons import FLAT_VDOP
from navsim.landing.confirmation import Candidate, Confirmation, confirm, put_requirements
from navsim.landing.requirements import statements
from navsim.optimization.best_placement import Found, NoPlacement
from navsim.optimization.placement import ObjectiveFunction, RunwayPlane
from navsim.optimization.prefetch import ObjectiveFunctions, Prefetcher
from navsim.optimization.problem import (
    PENALTY_CONSTRAINT,
    PENALTY_REQUIREMENT,
    PENALTY_UNSOLVED,
    PlacementProblem,
    penalised,
)
from navsim.optimization.progress import SearchMonitor, Step, TimeUp
from navsim.optimization.scenario import Optimize
from navsim.optimization.search import COARSE, FULL, GEOMETRY, Evaluator, search_one, steps
from navsim.optimization.search_log import SearchLog
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept
from navsim.results.result import Result
from navsim.results.schema import MET, OBJECTIVE_QUANTITIES, OPTIMIZE
from navsim.runner import findings as judging
from navsim.runner.attributes import root_attributes
from navsim.runner.checkpoint import Arrays, code_key
from navsim.runner.executor import RemoteExecutor
from navsim.scenario.load import resolved_yaml
from navsim.statistics.rounding import digits
from navsim.sweeps.outputs import beacon_outputs, dop_outputs

if TYPE_CHECKING:
    from navsim.landing.requirements import Fulfilment

BEARINGS = np.arange(0.0, 360.0, 45.0)
"""Directions in which the neighbourhood is explored, degrees from the landing direction, clockwise."""
LOSSES = (0.01, 0.05)
"""Losses of the objective that bound the neighbourhood."""
MAP_POINTS = 61
ANALYSED_MAP_POINTS, WATCHED_MAP_POINTS = 9, 17
_REACH = np.geomspace(1.0, 3000.0, 160)
"""Distances tried in the neighbourhood, m; where placements are analysed every doubling, and between by its curve."""
_ANALYSED_REACH = 32.0 * 2.0 ** np.arange(-5, 7)
_ANALYSED_FIRST = 5
"""Index of the first distance of the search outwards or inwards."""

TIME_LIMIT, INTERRUPTED = "time limit", "interrupted"


@dataclass
class SearchOutcome:
    """Outcome of a study, by number of pseudolites."""

    without: float
    """Objective without pseudolites."""
    found: dict[int, Found] = field(default_factory=dict)
    neighbourhoods: dict[int, np.ndarray] = field(default_factory=dict)
    """See `neighbourhood`."""
    maps: dict[int, np.ndarray] = field(default_factory=dict)
    """See `objective_map`."""
    confirmed: dict[int, Confirmation] = field(default_factory=dict)
    """Runs of the best placements."""
    stopped: str = ""
    """TIME_LIMIT or INTERRUPTED if the work ended early, else empty."""

    def undone(self, study: Optimize) -> list[str]:
        """Remaining work on the numbers of pseudolites, or beacons, of a study."""
        out = []
        for what, done in (
            ("the search", {count for count, found in self.found.items() if found.finished}),
            ("the neighbourhood", self.neighbourhoods.keys()),
            ("the map", self.maps.keys()),
        ):
            left = [count for count in study.counts if count not in done]
            if left:
                out.append(f"{what} for {', '.join(map(str, left))} {study.placed[:-1]}(s)")
        return out


def search(problem: PlacementProblem, seed: int, watch: SearchMonitor | None = None) -> dict[int, Found]:
    """The best placement for every number of pseudolites the study asks for. Raises NoPlacement."""
    watch = watch or SearchMonitor()
    watch.plan(_search_steps(problem))
    return dict(_searches(problem, seed, watch, SearchLog()))


def planned(problem: PlacementProblem) -> list[Step]:
    """All steps of the work, each with the largest number of placements."""
    return [
        *_search_steps(problem),
        *(Step(_flying(problem, count), {}) for count in problem.study.counts),
        *_later_steps(problem),
    ]


def _search_steps(problem: PlacementProblem) -> list[Step]:
    return [step for i, count in enumerate(problem.study.counts) for step in steps(problem, count, i > 0)]


def _searches(
    problem: PlacementProblem, seed: int, watch: SearchMonitor, journal: SearchLog
) -> Iterator[tuple[int, Found]]:
    earlier: np.ndarray | None = None
    for count in problem.study.counts:
        found = Found.of(journal.step(f"found-{count}", partial(_search_arrays, problem, count, seed, earlier, watch)))
        earlier = found.places
        yield count, found


def _search_arrays(
    problem: PlacementProblem, count: int, seed: int, earlier: np.ndarray | None, watch: SearchMonitor
) -> Arrays:
    return search_one(problem, count, seed, earlier, watch).arrays()


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
    if pool is not None and journal.keeps and problem.coarse is not None:
        problem = replace(problem, ahead=Prefetcher(_judges(problem), problem.rules, journal, pool, watch.look))
    if problem.coarse is not None:
        full, coarse = journal.remembering(FULL, problem.objective), journal.remembering(COARSE, problem.coarse)
        problem = replace(problem, objective=full, coarse=coarse)
    if problem.load is not None and problem.coarse_load is not None:
        full, coarse = (
            journal.remembering(f"{fidelity}-load", judge)
            for fidelity, judge in ((FULL, problem.load), (COARSE, problem.coarse_load))
        )
        problem = replace(problem, load=full, coarse_load=coarse)
    counts = problem.study.counts
    trials = Evaluator(problem, watch, searching=False)
    watch.plan(planned(problem))
    nothing = np.empty((1, 0, 2))
    if problem.coarse is not None:
        problem.coarse(nothing)  # so that the next timing does not include the loading of kernels
    outcome = SearchOutcome(float(problem.objective(nothing)[0]))

    def step(
        what: str, count: int, work: Callable[[PlacementProblem, Found, Evaluator], np.ndarray], best: Found
    ) -> np.ndarray:
        return journal.step(f"{what}-{count}", lambda: {what: work(problem, best, trials)})[what]

    try:
        if problem.coarse is not None:
            for fidelity, judge in ((FULL, problem.objective), (COARSE, problem.coarse)):
                with watch.trying(fidelity, 1):
                    judge(nothing)
        for count, found in _searches(problem, seed, watch, journal):
            outcome.found[count] = found
        for count in counts if runs else ():
            with watch.step(_flying(problem, count)):
                _fly_best(problem, outcome, count, seed, runs, journal)
        for count in counts:
            best = outcome.found[count]
            watch.best, watch.places = best.value, best.places
            with watch.step(_around(problem, count)):
                outcome.neighbourhoods[count] = step("around", count, neighbourhood, best)
        for count in counts:
            best = outcome.found[count]
            watch.best, watch.places = best.value, best.places
            with watch.step(_mapping(problem, count)):
                outcome.maps[count] = step("map", count, objective_map, best)
    except (TimeUp, KeyboardInterrupt) as stop:
        outcome.stopped = TIME_LIMIT if isinstance(stop, TimeUp) else INTERRUPTED
        _keep_unfinished(problem, outcome, counts, watch)
        if not outcome.found:
            if isinstance(stop, KeyboardInterrupt):
                raise
            raise NoPlacement("the time limit passed before any placement that keeps the rules was found") from None
        if runs and outcome.stopped == TIME_LIMIT:
            for count in outcome.found.keys() - outcome.confirmed.keys():
                _fly_best(problem, outcome, count, seed, runs, journal)
    return outcome


def _fly_best(
    problem: PlacementProblem, outcome: SearchOutcome, count: int, seed: int, runs: int, journal: SearchLog
) -> None:
    """Run the best placement of a number of pseudolites; the next best replaces it if runs contradict it."""
    best = outcome.found[count]

    def work() -> Arrays:
        assert problem.fly is not None
        others: list[Candidate] = [partial(_analysed, problem, one) for one in best.others]
        candidates: list[Candidate] = [lambda: (best.places, best.value), *others]
        met = problem.requirements.decided if problem.requirements is not None and best.met else None
        return confirm(candidates, problem.study.objective, problem.fly, seed, runs, met).arrays()

    # a continued search may reach another placement
    key = hashlib.sha256(best.places.tobytes()).hexdigest()[:16]
    found = outcome.confirmed[count] = Confirmation.of(journal.step(f"flown-{count}-{runs}-{key}", work))
    if found.rejected and not np.array_equal(found.best.choice, best.places):
        load = float(problem.judged(found.best.choice[None]).load[0])
        outcome.found[count] = replace(best, places=found.best.choice, value=found.best.analysed, load=load)


def _analysed(problem: PlacementProblem, places: np.ndarray) -> tuple[np.ndarray, float] | None:
    """A placement (k, 2) with its objective by the full analysis, None where it breaks a rule or misses a
    requirement."""
    found = problem.judged(places[None])
    return (places, float(found.objective[0])) if found.value[0] < PENALTY_REQUIREMENT else None


def _judges(problem: PlacementProblem) -> ObjectiveFunctions:
    """Evaluators of an analysed problem, by their names in the journal."""
    out: ObjectiveFunctions = {}
    for fidelity, judge, load in (
        (FULL, problem.objective, problem.load),
        (COARSE, problem.coarse, problem.coarse_load),
    ):
        assert judge is not None
        out[fidelity] = {fidelity: judge} | ({} if load is None else {f"{fidelity}-load": load})
    return out


def _keep_unfinished(
    problem: PlacementProblem, outcome: SearchOutcome, counts: tuple[int, ...], watch: SearchMonitor
) -> None:
    """The best so far of the number of pseudolites whose search was stopped."""
    if len(outcome.found) == len(counts) or watch.places is None:
        return
    best = problem.judged(watch.places[None])
    if best.value[0] < PENALTY_UNSOLVED:
        count, objective, load = len(watch.places), float(best.objective[0]), float(best.load[0])
        outcome.found[count] = Found(watch.places, objective, watch.tried_since(), False, finished=False, load=load)


def _flying(problem: PlacementProblem, count: int) -> str:
    return f"{problem.study.named(count)}, flying the best"


def _around(problem: PlacementProblem, count: int) -> str:
    return f"{problem.study.named(count)}, neighbourhood"


def _mapping(problem: PlacementProblem, count: int) -> str:
    return f"{problem.study.named(count)}, map"


def _later_steps(problem: PlacementProblem) -> list[Step]:
    counts = problem.study.counts
    fidelity = COARSE if problem.analysed else GEOMETRY
    reach = _ANALYSED_REACH.size if problem.analysed else _REACH.size
    points = _map_points(problem)
    return [
        *(Step(_around(problem, count), {fidelity: count * BEARINGS.size * reach}) for count in counts),
        *(Step(_mapping(problem, count), {fidelity: points * points}) for count in counts),
    ]


def _judged(problem: PlacementProblem, best: Found, trials: Evaluator) -> ObjectiveFunction:
    """Evaluator for neighbourhoods: the objective, or the coarse analysis scaled to be right at the best.

    inf without a solution or if requirements are not met.
    """
    if problem.coarse is None:
        return trials.at_once
    there = trials.coarse(best.places[None])
    scale = best.value / float(there.objective[0])
    heavier = best.load / float(there.load[0]) if problem.requirements is not None else 1.0

    def judge(places: np.ndarray) -> np.ndarray:
        found = trials.coarse(places)
        values = penalised(scale * found.objective, heavier * found.load)
        return np.where((found.value < PENALTY_CONSTRAINT) & (values < PENALTY_REQUIREMENT), values, np.inf)

    return judge


def neighbourhood(problem: PlacementProblem, best: Found, trials: Evaluator) -> np.ndarray:
    """Distance that each pseudolite may be moved alone before the objective worsens, by LOSSES and BEARINGS (k, 2, 8),
    m.

    Missed requirements end it, too. nan where the area or a rule ends it first, and if requirements were never met.
    """
    if not best.met:
        return np.full((len(best.places), len(LOSSES), BEARINGS.size), np.nan)
    judge = _judged(problem, best, trials)
    reach = _ANALYSED_REACH if problem.analysed else _REACH
    out = np.full((len(best.places), len(LOSSES), BEARINGS.size), np.nan)
    for k in range(len(best.places)):
        for b, bearing in enumerate(np.radians(BEARINGS)):
            moved = np.repeat(best.places[None], reach.size, axis=0)
            # s is right of landing, l1 against it
            moved[:, k, 0] += reach * np.sin(bearing)
            moved[:, k, 1] -= reach * np.cos(bearing)
            inside = np.full(reach.size, True)
            if problem.study.area is not None:
                (low, high), level = problem.limits(), moved[:, k, :2]
                inside = np.all((level >= low[:2]) & (level <= high[:2]), axis=1)
            usable = inside & (problem.rules.violation(moved) <= 0.0)
            blocked = int(np.argmin(usable)) if not usable.all() else reach.size
            if not blocked:
                continue
            if problem.analysed:
                out[k, :, b] = _reached(judge, moved[:blocked], reach, best.value)
                continue
            values = judge(moved[:blocked])
            for i, loss in enumerate(LOSSES):
                worse = np.flatnonzero(values > best.value * (1.0 + loss))
                if worse.size:
                    out[k, i, b] = reach[worse[0]]
    return out


def _reached(judge: ObjectiveFunction, moved: np.ndarray, reach: np.ndarray, value: float) -> np.ndarray:
    """Distances (2,) at which LOSSES are reached outwards through `moved` (n, k, 2), nan if they are not.

    From the middle outwards until the larger loss is exceeded, inwards until the smaller is not. Between two distances
    the loss is taken as a power of the distance, as near an optimum.
    """
    losses: dict[int, float] = {}

    def loss(i: int) -> float:
        if i not in losses:
            losses[i] = float(judge(moved[i : i + 1])[0]) / value - 1.0
        return losses[i]

    first = min(_ANALYSED_FIRST, len(moved) - 1)
    inward = first
    while loss(inward) > LOSSES[0] and inward > 0:
        inward -= 1
    outward = first
    while loss(outward) <= LOSSES[-1] and outward < len(moved) - 1:
        outward += 1
    out = np.full(len(LOSSES), np.nan)
    for j, wanted in enumerate(LOSSES):
        beyond = [i for i in range(inward, outward + 1) if loss(i) > wanted]
        if not beyond:
            continue
        i = beyond[0]
        if not np.isfinite(loss(i)):  # a cliff: the largest distance known to be on this side of it
            out[j] = reach[i - 1] if i else 0.0
            continue
        if i == 0 or loss(i - 1) <= 0.0:
            out[j] = reach[i]
            continue
        power = np.log(loss(i) / loss(i - 1)) / np.log(reach[i] / reach[i - 1])
        out[j] = reach[i] * (wanted / loss(i)) ** (1.0 / power)
    return out


def _map_points(problem: PlacementProblem) -> int:
    """Along each axis of a map."""
    return MAP_POINTS if not problem.analysed else WATCHED_MAP_POINTS if problem.quick else ANALYSED_MAP_POINTS


def map_axes(problem: PlacementProblem) -> tuple[np.ndarray, np.ndarray]:
    """The axes of maps of the objective: s (a,), l1 (b,), m."""
    low, high = problem.limits()
    points = _map_points(problem)
    return np.linspace(low[0], high[0], points), np.linspace(low[1], high[1], points)


def objective_map(problem: PlacementProblem, best: Found, trials: Evaluator) -> np.ndarray:
    """The objective with the first pseudolite moved over the area (a, b), nan where a rule is broken, or
    requirements are not met."""
    s, l1 = map_axes(problem)
    moved = np.repeat(best.places[None], s.size * l1.size, axis=0)
    moved[:, 0, :2] = np.stack(np.meshgrid(s, l1, indexing="ij"), axis=-1).reshape(-1, 2)
    if not best.met:
        return np.full((s.size, l1.size), np.nan)
    values = _judged(problem, best, trials)(moved)
    return np.where(values < PENALTY_UNSOLVED, values, np.nan).reshape(s.size, l1.size)


def _seen_from(problem: PlacementProblem, s: np.ndarray, l1: np.ndarray) -> np.ndarray:
    """Share of the glide's fixes (a, b) that see an antenna of the least height there is at places s (a,), l1 (b,)."""
    places = np.stack(np.meshgrid(s, l1, indexing="ij"), axis=-1).reshape(-1, 2)
    if problem.coordinates == 3:
        places = np.column_stack([places, np.full(len(places), problem.limits()[0][2])])
    return problem.geometry.seen(problem.rules.plane.ecef(places)).reshape(s.size, l1.size)


def optimize_result(problem: PlacementProblem, outcome: SearchOutcome, seed: int) -> Result:
    """The optima, their neighbourhoods and the front as a result of kind optimize."""
    study, found = problem.study, outcome.found
    counts = sorted(found)
    most = max(counts)
    unit, quantity = OBJECTIVE_QUANTITIES[study.objective]
    draft = ResultBuilder(OPTIMIZE, {"how": "; by the coarse analysis, in proportion" if problem.analysed else ""})
    draft["/pseudolites"] = np.array(counts)
    draft["/pseudolite"] = np.arange(1, most + 1)
    draft["/bearing"] = BEARINGS
    draft["/loss"] = np.array(LOSSES)
    draft["/plan/threshold_llh"] = problem.rules.plane.threshold
    values = problem.shown(np.array([found[c].value for c in counts]))
    without = {"without_pseudolites": float(problem.shown(np.array(outcome.without)))}
    draft.put("/pareto/objective", values, without, unit=unit, quantity=quantity)
    draft["/pareto/evaluations"] = np.array([sum(found[c].tried.values()) for c in counts])
    for fidelity in (COARSE, FULL):
        draft[f"/pareto/evaluations_{fidelity}"] = np.array([found[c].tried.get(fidelity, 0) for c in counts])
    for path, marks in (
        ("/pareto/every_choice", [found[c].every for c in counts]),
        ("/pareto/finished", [found[c].finished for c in counts]),
        ("/optimum/explored", [c in outcome.neighbourhoods for c in counts]),
        ("/map/computed", [c in outcome.maps for c in counts]),
    ):
        draft[path] = np.array(marks, dtype=np.int8)
    plane = problem.rules.plane
    axes = ("s", "l1", "up")[: problem.coordinates if plane.terrain is None else 3]
    places = np.full((len(counts), most, len(axes)), np.nan)
    llh = np.full((len(counts), most, 3), np.nan)
    around = np.full((len(counts), most, len(LOSSES), BEARINGS.size), np.nan)
    margin, tightest = np.empty(len(counts)), np.full(len(counts), "", dtype=object)
    for i, count in enumerate(counts):
        best = found[count]
        places[i, :count] = plane.above_runway(best.places)
        llh[i, :count] = llh_from_ecef(problem.rules.plane.ecef(best.places))
        if count in outcome.neighbourhoods:
            around[i, :count] = outcome.neighbourhoods[count]
        margin[i] = problem.rules.violation(best.places[None])[0]
        if excesses := problem.rules.excesses(best.places[None]):
            tightest[i] = max(excesses, key=lambda rule: float(excesses[rule][0]))
    for axis, name in enumerate(axes):
        draft[f"/optimum/{name}"] = places[..., axis]
    for axis, name in enumerate(("latitude", "longitude", "height")):
        draft[f"/optimum/{name}"] = llh[..., axis]
    draft["/optimum/neighbourhood"] = around
    draft["/optimum/violation"] = margin
    draft["/optimum/tightest_rule"] = tightest
    sites = [problem.rules.plane.ecef(found[c].places)[None] for c in counts]
    if problem.beacons is None:
        others = [dop_outputs(problem.geometry, each) for each in sites]
    else:
        others = [beacon_outputs(problem.beacons, each) for each in sites]
    for name in others[0]:
        draft[f"/optimum/{name}"] = np.array([o[name][0] for o in others])
    s, l1 = map_axes(problem)
    draft["/map/s"] = s
    draft["/map/l1"] = l1
    if problem.scenario.terrain:
        draft["/map/seen"] = _seen_from(problem, s, l1)
    maps = problem.shown(np.stack([outcome.maps.get(c, np.full((s.size, l1.size), np.nan)) for c in counts]))
    draft.put("/map/objective", maps, unit=unit, quantity=quantity)
    _flown(draft, outcome, plane, unit, quantity)
    unmet = _requirements(draft, problem, outcome) + _flown_requirements(draft, problem, outcome)
    attributes = root_attributes(
        "optimize", seed, problem.scenario, study=study, objective=study.objective, stopped=outcome.stopped,
        undone="; ".join(outcome.undone(study)),
    )  # fmt: skip
    out = draft.result(attributes)
    flown = [each for c, one in sorted(outcome.confirmed.items()) for each in one.findings(problem.study.named(c), _at)]
    told = judging.notes([*problem.warnings, *_on_pavement(problem, outcome)])
    if problem.beacons is not None:
        told += judging.notes(other_dop_warnings(problem, counts, others))
    out.variables.update(kept(told + _findings(problem, outcome) + flown + unmet))
    return out


def _on_pavement(problem: PlacementProblem, outcome: SearchOutcome) -> list[str]:
    """Warnings about best placements on the runway."""
    study, runway, out = problem.study, problem.scenario.runway, []
    for count, best in sorted(outcome.found.items()):
        named = ((f"number {k}", -l1, s) for k, (s, l1, *_) in enumerate(best.places.tolist(), 1))
        out += [f"{study.named(count)}: {text}, or keep off it by `constraints.runway_strip`"
                for text in runway.on_pavement(study.placed, named)]  # fmt: skip
    return out


def other_dop_warnings(
    problem: PlacementProblem, counts: Sequence[int], dops: Sequence[dict[str, np.ndarray]]
) -> list[str]:
    """Warnings about best placements of beacons that show badly what the objective leaves out."""
    asked, out = problem.study.objective, []
    for count, its in zip(counts, dops, strict=True):
        for axis, other in (("hdop", "vdop"), ("vdop", "hdop")):
            dop = float(its[f"beacons_{axis}"][0])
            if asked.startswith(f"beacons_{other}") and dop > FLAT_VDOP:
                out.append(
                    f"{problem.study.named(count)}: {axis.upper()} is {digits(dop)} there, since {asked} does not ask "
                    "for it; minimise beacons_pdop"
                )
    return out


def _at(places: np.ndarray) -> str:
    return f"the placement at s, l1 {', '.join(f'({s:.2f}, {l1:.2f})' for s, l1 in places[:, :2])} m"


def _flown(draft: ResultBuilder, outcome: SearchOutcome, plane: RunwayPlane, unit: str, quantity: str) -> None:
    """Write results of runs of the best placements, and of those that runs contradicted."""
    counts = sorted(outcome.found)
    errors, runs = np.full((len(counts), 3, 3), np.nan), np.zeros(len(counts), np.int64)
    known = {count: outcome.confirmed[count] for count in counts if count in outcome.confirmed}
    for i, count in enumerate(counts):
        if count in known:
            errors[i], runs[i] = known[count].best.errors, known[count].runs
    draft["/flown/runs"] = runs
    verdicts = [known[count].best.verdict if count in known else "" for count in counts]
    draft["/flown/verdict"] = np.array(verdicts, dtype=object)
    draft.put("/flown/objective", errors[:, 0], unit=unit, quantity=quantity)
    for i, name in enumerate(("horizontal", "vertical"), 1):
        draft[f"/flown/{name}"] = errors[:, i]
    rejected = [(count, one) for count, found in known.items() for one in found.rejected]
    if not rejected:
        return
    choices = [plane.above_runway(one.choice) for _, one in rejected]
    axes = ("s", "l1", "up")[: choices[0].shape[1]]
    places = np.full((len(rejected), max(counts), len(axes)), np.nan)
    for i, (choice, (count, _)) in enumerate(zip(choices, rejected, strict=True)):
        places[i, :count] = choice
    draft["/rejected/rejected"] = np.arange(1, len(rejected) + 1)
    draft["/rejected/pseudolites"] = np.array([count for count, _ in rejected])
    for axis, name in enumerate(axes):
        draft[f"/rejected/{name}"] = places[..., axis]
    draft.put("/rejected/analysed", np.array([one.analysed for _, one in rejected]), unit=unit, quantity=quantity)
    draft.put("/rejected/flown", np.array([one.errors[0] for _, one in rejected]), unit=unit, quantity=quantity)


def _flown_requirements(draft: ResultBuilder, problem: PlacementProblem, outcome: SearchOutcome) -> list[Finding]:
    """Write the verdicts of runs on the base scenario's requirements; return those that a best placement misses."""
    asked, counts = statements(problem.scenario), sorted(outcome.found)
    if not asked or not outcome.confirmed:
        return []
    best = [outcome.confirmed[count].best.requirements if count in outcome.confirmed else None for count in counts]
    return [
        Finding("requirements", f"{problem.study.named(count)}: runs of the best placement don't meet: "
                f"{'; '.join(missed)}", (), len(missed), len(asked))
        for count, missed in zip(counts, put_requirements(draft, asked, best), strict=True) if missed
    ]  # fmt: skip


def _requirements(draft: ResultBuilder, problem: PlacementProblem, outcome: SearchOutcome) -> list[Finding]:
    """Write verdicts for each number of pseudolites and for none, and requirements that no placement meets.

    Writes nothing without requirements.
    """
    asked = problem.requirements
    if asked is None:
        return []
    counts = sorted(outcome.found)
    places = [np.empty((0, 2)), *(outcome.found[c].places for c in counts)]
    judged = [asked.judge(each) for each in places]
    analysed = np.array([asked.load(each) <= 1.0 for each in judged])
    missed = [count in outcome.confirmed and outcome.confirmed[count].best.missed for count in counts]
    met = analysed & ~np.array([False, *missed])
    statements = np.array([one.text for one in judged[0]], dtype=object)
    value = np.array([[one.value[0] for one in each] for each in judged])
    verdict = np.array([[one.verdict() for one in each] for each in judged], dtype=object)
    utilisation = np.array([[one.utilisation for one in each] for each in judged])
    draft["/requirements/requirement"] = np.arange(1, statements.size + 1)
    draft["/requirements/statement"] = statements
    draft["/requirements/limit"] = np.array([one.limit for one in judged[0]])
    draft["/requirements/decided"] = asked.decided.astype(np.int8)
    for name, data in (("value", value), ("verdict", verdict), ("utilisation", utilisation)):
        draft[f"/requirements/{name}"], draft[f"/requirements/{name}_without"] = data[1:], data[0]
    draft["/pareto/met"], draft["/pareto/met_without"] = met[1:].astype(np.int8), np.int8(met[0])
    fewest = next((number for number, good in zip((0, *counts), met, strict=True) if good), -1)
    draft["/pareto/fewest"] = np.int64(fewest)
    out = []
    for i, count in enumerate(counts, start=1):
        if analysed[i]:
            continue
        unmet = [
            f"{text} ({_missed(one)})"
            for text, one, decided in zip(statements, judged[i], asked.decided, strict=True)
            if decided and one.verdict() != MET
        ]
        every = "every choice of sites was tried" if outcome.found[count].every else "of those tried"
        text = f"no placement meets the requirements ({every}); the nearest misses {'; '.join(unmet)}"
        text = f"{problem.study.named(count)}: {text}"
        out.append(Finding("requirements", text, (), len(unmet), int(asked.decided.sum())))
    return out


def _missed(one: Fulfilment) -> str:
    """A missed requirement in words."""
    figure = f"{digits(one.value[0], 4)} of {one.limit:g}"
    if not np.isfinite(one.utilisation):
        return f"{figure}, no size would do"
    return f"{figure}; {digits(100.0 * (one.utilisation - 1.0))} % beyond the size"


def _findings(problem: PlacementProblem, outcome: SearchOutcome) -> list[Finding]:
    """Findings of the full analysis of the best placements; none for those evaluated by geometry."""
    if problem.found is None:
        return []
    counts = sorted(outcome.found)
    marked = np.array([judging.marks(f.name for f in problem.found(outcome.found[c].places)) for c in counts])
    return judging.among(marked, "best placements", lambda i: problem.study.named(counts[i]))
