"""A search for the best placements."""

from __future__ import annotations

import math

from navsim.environment.sources import glide_epochs
from navsim.gnss.signals import SignalScenario
from navsim.landing.confirmation import RUNS
from navsim.landing.preflight import fix_warnings
from navsim.landing.simulation_size import ANALYSED_MEMORY, SAMPLE_MEMORY, SIGNAL_MEMORY, simulation_size
from navsim.optimization import study as optimize
from navsim.optimization.evaluator import COARSE, FULL
from navsim.optimization.flatness import MAP_POINTS
from navsim.optimization.problem import PENALTY_REQUIREMENT, PlacementProblem, load_of, problem
from navsim.optimization.progress import PREPARING, SearchMonitor, SearchProgress
from navsim.optimization.result import optimize_result
from navsim.optimization.scenario import DOP_OBJECTIVES, Optimize
from navsim.optimization.search_log import SearchLog
from navsim.optimization.site_choice import CHUNK
from navsim.results.result import Result, ResultKind
from navsim.results.schema import LARGE, OBJECTIVE_QUANTITIES
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import BASE_MEMORY, NUMBER, VARIABLE, Budget
from navsim.runner.executor import Executor, RemoteExecutor
from navsim.runner.job import Options, Outcome, Progress, ResourceCheck
from navsim.scenario.landing import Landing
from navsim.scenario.load import base_of
from navsim.scenario_files.source import Document
from navsim.statistics.rounding import digits

_JUDGED_MEMORY = 70
"""Memory for a site of a placement at an epoch while rules are checked, bytes."""


class OptimizeJob:
    """Job of an optimisation: placements, their neighbourhoods, maps.

    The time limit counts from the preparation; an interrupt ends the work with the results so far.
    """

    kernels, suffix, unit, extent, work = "optimize", "", "placements", 0, "analyses"
    pieces, even = 2, False  # it ends where it has converged
    posed: PlacementProblem

    def __init__(self, section: Optimize, document: Document, options: Options) -> None:
        self.section, self.document, self.options = section, document, options
        self.base = base_of(section, document)
        self.sort = ResultKind("optimize")

    @property
    def warnings(self) -> list[str]:
        return self.posed.warnings

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        self._watch = SearchMonitor(time_limit=self.options.time_limit)

        def ask(scenario: Landing, sources: SignalScenario) -> None:
            allow(self.estimate(scenario, sources))

        self.posed = problem(self.section, self.document, self.base, ask, self.options.workers)
        self._runs = RUNS if self.options.runs is None else self.options.runs

    def estimate(self, scenario: Landing, sources: SignalScenario) -> Budget:
        """Estimated memory and disk of a search for placements."""
        study = self.section
        problem = simulation_size(scenario, sources)
        starts = 1 if study.period is None else study.period.count
        most = max(study.counts)
        # a map is evaluated in one call, choices of sites in chunks
        at_once = {k: min(math.comb(len(study.sites), k), CHUNK) if study.sites else 0 for k in study.counts}
        judged_places = max(k * max(MAP_POINTS**2, at_once[k]) for k in study.counts)
        signals = SIGNAL_MEMORY * problem.epochs * problem.sources * starts
        glide = int(glide_epochs(scenario, scenario.trajectory())[1].sum())  # epochs for the evaluation of placements
        ruled = study.constraints.distance_m is not None or study.constraints.near_far_db is not None
        judged = _JUDGED_MEMORY * judged_places * glide * ruled
        result = NUMBER * optimize.most_members(study) * (MAP_POINTS**2 + 30 * most) + 46 * VARIABLE
        flown = 0.0
        if study.objective not in DOP_OBJECTIVES or study.constraints.requirements:
            flown = 2.0 * SAMPLE_MEMORY * problem.samples + ANALYSED_MEMORY * problem.epochs
        return Budget(
            BASE_MEMORY + signals + judged + flown,
            result,
        )

    def described(self) -> str:
        *fewer, most = self.section.counts
        asked = f"{', '.join(map(str, fewer))} or " if fewer else ""
        out = f"{self.section.objective} for {asked}{self.section.named(most)}"
        if self.options.time_limit is None:
            return f"{out}, until the search converges; --time-limit ends it earlier"
        return f"{out}; the search ends after {self.options.time_limit:g} s at the latest, then navsim checks the best"

    def key(self) -> dict[str, object]:
        return optimize.partial_key(self.posed, self.options.seed)

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        unit = OBJECTIVE_QUANTITIES[self.section.objective][0]
        self._watch.tell = lambda progress: tell(
            0, progress_text(progress, unit, self.section.objective in LARGE, self.posed.quick)
        )
        with executor.pool(executor.workers) as pool:
            away = pool if isinstance(pool, RemoteExecutor) else None
            found = optimize.solve(self.posed, self.options.seed, self._watch, SearchLog(store), away, self._runs)
        result = optimize_result(self.posed, found, self.options.seed)
        interrupted = found.stopped == optimize.INTERRUPTED
        why = "interrupted" if interrupted else f"time limit of {self.options.time_limit:g} s" if found.stopped else ""
        if why:
            why += f"; undone: {result.attributes['undone']}"
        failed = "no placement found meets the requirements" if _unmet(result) else ""
        return Outcome(result, stopped=why, interrupted=interrupted, failed=failed)


def _unmet(result: Result) -> bool:
    """Whether requirements are met with none of the numbers of pseudolites, although placements had to."""
    return "/pareto/met" in result and not result["/pareto/met"].any()


def progress_text(progress: SearchProgress, unit: str, large: bool = False, quick: bool = False) -> str:
    """Progress of a search as text.

    unit: of the objective; large: the objective is the reciprocal of the minimised value; quick: only levels are
    analysed.
    """
    analysed = sum(progress.tried.get(fidelity, 0) for fidelity in (COARSE, FULL))
    tried = f"{sum(progress.tried.values())} placements tried"
    if analysed:
        tried += f", {analysed} by {'levels' if quick else 'covariance analysis'}"
    best = "none found yet"
    if progress.best is not None and progress.places is not None:
        at = ", ".join(f"({s:.0f}, {l1:.0f})" for s, l1 in progress.places[:, :2])
        best = f"best {digits(1.0 / progress.best if large else progress.best, 4)}{'' if unit == '1' else f' {unit}'}"
        if progress.best >= PENALTY_REQUIREMENT:
            best = f"requirements not met yet, the worst of them by a factor of {digits(load_of(progress.best), 4)}"
        best += f" at s, l1 {at} m"
    remaining = "time left not known yet"
    if progress.remaining is not None:
        remaining = f"at most {progress.remaining:.0f} s of search left"
        if not progress.remaining:
            remaining = "the search is over"
    return f"{progress.step or PREPARING}: {tried}; {best}; {progress.used:.0f} s used, {remaining}"


def check(section: Optimize, document: Document) -> list[str]:
    """Warnings about a search; its base scenario is checked with the values that the study sets. Raises InputError."""
    asked: list[tuple[Landing, SignalScenario]] = []
    posed = problem(section, document, base_of(section, document), lambda *each: asked.append(each))
    ((scenario, sources),) = asked
    more = max(section.counts) if section.beacons is None else 0
    return [*posed.warnings, *fix_warnings(scenario, sources, scenario.trajectory(), more)]
