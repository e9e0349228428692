"""A search for the best placements."""

from __future__ import annotations

from dataclasses import replace

from navsim.gnss.signals import Environment
from navsim.results.result import Result, Sort
from navsim.results.schema import LARGE, OBJECTIVE_QUANTITIES
from navsim.scenario.landing import Landing
from navsim.scenario.load import base_of
from navsim.scenario.optimize import Optimize
from navsim.scenario.source import Document
from navsim.study import optimize
from navsim.study.budget import studies as estimates
from navsim.study.budget.estimate import Budget
from navsim.study.confirmation import RUNS
from navsim.study.executor import Away, Executor
from navsim.study.job import Allow, Options, Outcome, Tell
from navsim.study.journal import Journal
from navsim.study.objective import UNMET, PlacementProblem, load_of, problem
from navsim.study.partial import Store
from navsim.study.search import COARSE, FULL
from navsim.study.watch import Progress, Watch


class OptimizeJob:
    """Placements, their neighbourhoods, maps. The time limit counts from the preparation; an interrupt ends the work
    with what was found."""

    kernels, suffix, unit, extent, work = "optimize", "", "placements", 0, "analyses"
    pieces, even = 2, False  # it ends where it has converged
    posed: PlacementProblem

    def __init__(self, section: Optimize, document: Document, options: Options) -> None:
        self.section, self.document, self.options = section, document, options
        self.base = base_of(section, document)
        self.sort = Sort("optimize")

    @property
    def warnings(self) -> list[str]:
        return self.posed.warnings

    def prepare(self, executor: Executor, allow: Allow) -> None:
        self._watch = Watch(time_limit=self.options.time_limit)
        asked: list[Budget] = []

        def ask(scenario: Landing, sources: Environment) -> None:
            asked.append(estimates.posing(self.section, scenario, sources))
            allow(asked[0], final=False)

        self.posed = problem(self.section, self.document, self.base, ask)
        self._runs = RUNS if self.options.runs is None else self.options.runs
        time = asked[0].time_s + estimates.search_time(self.posed) + estimates.confirming_time(self.posed, self._runs)
        allow(replace(asked[0], time_s=time), at_most=True)

    def described(self) -> str:
        return f"{self.section.objective} for {list(self.section.counts)} pseudolites"

    def key(self) -> dict[str, object]:
        return optimize.partial_key(self.posed, self.options.seed)

    def run(self, executor: Executor, store: Store | None, tell: Tell) -> Outcome:
        unit = OBJECTIVE_QUANTITIES[self.section.objective][0]
        self._watch.tell = lambda progress: tell(
            0, said(progress, unit, self.section.objective in LARGE, self.posed.quick)
        )
        with executor.pool(executor.workers) as pool:
            away = pool if isinstance(pool, Away) else None
            found = optimize.solve(self.posed, self.options.seed, self._watch, Journal(store), away, self._runs)
        result = optimize.optimize_result(self.posed, found, self.options.seed)
        interrupted = found.stopped == optimize.INTERRUPTED
        why = "interrupted" if interrupted else f"time limit of {self.options.time_limit:g} s" if found.stopped else ""
        if why:
            why += f"; undone: {result.attributes['undone']}"
        failed = "no placement found meets the requirements" if _unmet(result) else ""
        return Outcome(result, stopped=why, interrupted=interrupted, failed=failed)


def _unmet(result: Result) -> bool:
    """Whether requirements are met with none of the numbers of pseudolites, although placements had to."""
    return "/front/met" in result and not result["/front/met"].any()


def said(progress: Progress, unit: str, large: bool = False, quick: bool = False) -> str:
    """Where a search stands in words; unit: of the objective, large: it is the reciprocal of what is made small; quick:
    levels are all that is analysed."""
    analysed = sum(progress.tried.get(fidelity, 0) for fidelity in (COARSE, FULL))
    tried = f"{sum(progress.tried.values())} placements tried"
    if analysed:
        tried += f", {analysed} by {'levels' if quick else 'covariance analysis'}"
    best = "none found yet"
    if progress.best is not None and progress.places is not None:
        at = ", ".join(f"({s:.0f}, {l1:.0f})" for s, l1 in progress.places)
        best = f"best {1.0 / progress.best if large else progress.best:.4g}{'' if unit == '1' else f' {unit}'}"
        if progress.best >= UNMET:
            best = f"requirements not met yet, the worst of them by a factor of {load_of(progress.best):.4g}"
        best += f" at s, l1 {at} m"
    remaining = "time left not known yet" if progress.remaining is None else f"at most {progress.remaining:.0f} s left"
    return f"{progress.step or 'preparing'}: {tried}; {best}; {progress.used:.0f} s used, {remaining}"
