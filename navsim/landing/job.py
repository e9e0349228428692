"""Landings: Monte Carlo runs, and covariance analysis."""

from __future__ import annotations

from collections.abc import Callable

from navsim.gnss.signals import SignalScenario
from navsim.landing import rare_events
from navsim.landing import study as landing
from navsim.landing.estimate import estimate_landing as estimated
from navsim.results.result import MOST_WHOLE, ONE_RUN, SEVERAL_RUNS, ResultKind
from navsim.runner.batches import BATCH, Until, fly_all
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import Budget
from navsim.runner.executor import Executor
from navsim.runner.job import OptionError, Options, Outcome, Progress, ResourceCheck
from navsim.scenario.landing import Landing
from navsim.scenario_files.source import Document, InputError, Problem

MOST_RUNS = 1_000_000
"""Largest number of runs with `--until`, unless --runs is given."""


def job(section: Landing, document: Document, options: Options) -> MonteCarloJob | CovarianceJob | RareJob:
    """The job of a landing by its method."""
    if options.require and not section.requirements:
        raise OptionError("--require: the scenario has no requirements")
    if section.method == "rare":
        return RareJob(section, document, options)
    return (CovarianceJob if section.method == "covariance" else MonteCarloJob)(section, document, options)


class _Prepared:
    """Common preparation of both methods."""

    work = "runs"
    even = True
    case: landing.Case

    def __init__(self, section: Landing, document: Document) -> None:
        self.section, self.document = section, document
        self.kernels = f"landing-{section.method}-{section.filter.kind}-{section.filter.coupling}"

    def _prepare(self, runs: int, keep: str, executor: Executor, allow: ResourceCheck, at_most: bool) -> None:
        def ask(scenario: Landing, sources: SignalScenario) -> None:
            allow(self.estimate(scenario, sources, runs, keep, executor), at_most)

        self.case = landing.prepare(self.section, self.document, ask)

    def estimate(self, scenario: Landing, sources: SignalScenario, runs: int, keep: str, executor: Executor) -> Budget:
        return estimated(scenario, sources, runs, keep, executor.workers, executor.away)

    @property
    def warnings(self) -> list[str]:
        return self.case.warnings

    def _described(self, what: str) -> str:
        shared = self.case.shared
        used = int(shared.signals.used.any(axis=0).sum())
        return (
            f"{what} of {self.case.scenario.duration_s:g} s, {shared.dtheta.shape[0]} IMU samples, "
            f"{shared.signals.time.size} fix epochs, {used} of {len(shared.signals.names)} sources received"
        )


def _check_numbers(first: int, runs: int) -> None:
    """Raise OptionError for runs whose numbers a result cannot hold."""
    if first > MOST_WHOLE - runs:
        text = f"the last of {runs} run(s) would have a number beyond {MOST_WHOLE}"
        raise OptionError(f"--first-run {first}: {text}")


def _progress_of(tell: Progress, until: Until | None) -> Callable[[int], None]:
    """Progress of finished runs: their number, and the present width of the interval."""
    return lambda flown: tell(flown, "" if until is None else until.words)


class MonteCarloJob(_Prepared):
    """Monte Carlo."""

    unit = "runs"

    def __init__(self, section: Landing, document: Document, options: Options) -> None:
        super().__init__(section, document)
        self.seed, self.until, self.first = options.seed, options.until, options.first_run or 0
        self.runs = options.runs or (1 if self.until is None else MOST_RUNS)
        _check_numbers(self.first, self.runs)
        try:
            self.enough = landing.stopping_rule(lambda: self.case, self.until) if self.until is not None else None
        except ValueError as error:
            raise OptionError(f"--until {error}") from None
        self.keep = options.keep or ("all" if self.runs == 1 else "errors")
        several = self.runs > 1
        count = self.runs if self.until is None else 0
        self.sort = ResultKind("landing", section.method, SEVERAL_RUNS if several else ONE_RUN, count)
        self.suffix = "" if not several else f"_runs{self.runs}" if self.until is None else "_until"
        self.extent = self.runs
        self.pieces = -(-self.runs // BATCH)

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        self._prepare(self.runs, self.keep, executor, allow, at_most=self.until is not None)

    def described(self) -> str:
        return self._described(f"{self.runs} run(s)")

    def key(self) -> dict[str, object]:
        return landing.partial_key(self.case, self.seed, self.first, self.runs, self.keep)

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        # parts of an ensemble need first-order errors however few their runs are
        linear = self.runs > 1 or self.first > 0
        study = landing.LandingStudy(self.case, self.seed, self.keep, self.case.first_order if linear else None)
        flown = fly_all(
            study, self.first, self.runs, executor,
            store=store, done=_progress_of(tell, self.enough), enough=self.enough,
        )  # fmt: skip
        reached = self.enough is None or self.enough(flown)
        warnings = () if reached else (f"--until {self.until}: not reached within {self.runs} runs",)
        return Outcome(landing.result(self.case, flown, self.seed, keep=self.keep), warnings)


class CovarianceJob(_Prepared):
    """Covariance analysis."""

    unit, suffix, extent, pieces = "analyses", "", 1, 0

    def __init__(self, section: Landing, document: Document, options: Options) -> None:
        super().__init__(section, document)
        if foreign := options.foreign("method", "workers", "require_fix", "require_consistent", "require"):
            text = "only for method monte-carlo; a covariance analysis has no runs"
            raise OptionError(f"{', '.join(foreign)}: {text}")
        self.seed = options.seed
        self.sort = ResultKind("landing", section.method)

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        self._prepare(1, "none", executor, allow, at_most=False)

    def described(self) -> str:
        return self._described("covariance analysis")

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        return Outcome(landing.covariance_result(self.case, landing.covariance_analysis(self.case), self.seed))


class RareJob(_Prepared):
    """The probability of leaving the box."""

    unit, suffix = "runs", ""
    edge: rare_events.LimitState

    def __init__(self, section: Landing, document: Document, options: Options) -> None:
        super().__init__(section, document)
        if options.keep is not None:
            text = "only for method monte-carlo; of pushed runs only the errors at the box are kept"
            raise OptionError(f"--keep: {text}")
        if options.require_consistent:
            text = "only for method monte-carlo; errors and innovations of pushed runs are off on purpose"
            raise OptionError(f"--require-consistent: {text}")
        self.seed, self.first = options.seed, options.first_run or 0
        # a fixed number of runs is completed
        usual = f"probability within {100.0 * rare_events.USUAL:g}%" if options.runs is None else None
        self.until = options.until or usual
        self.runs = options.runs or rare_events.MOST_RUNS
        _check_numbers(self.first, self.runs)
        try:
            self.enough = None if self.until is None else rare_events.stopping_rule(lambda: self.edge, self.until)
        except ValueError as error:
            raise OptionError(f"--until {error}") from None
        self.sort = ResultKind("landing", section.method, count=0 if self.until is not None else self.runs)
        self.extent = self.runs
        self.pieces = -(-self.runs // BATCH)

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        self._prepare(self.runs, "none", executor, allow, at_most=self.until is not None)
        try:
            self.edge = rare_events.prepare(self.case)
        except ValueError as error:
            raise InputError([Problem(self.document.place(("box",)), "box", str(error))]) from None

    def described(self) -> str:
        number = f"{self.runs} pushed run(s)"
        return self._described(number if self.until is None else f"at most {number}, until {self.until},")

    def key(self) -> dict[str, object]:
        return landing.partial_key(self.case, self.seed, self.first, self.runs, "none")

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        flown = rare_events.fly_all(
            self.case, self.edge, self.seed, self.first, self.runs, executor,
            store=store, done=_progress_of(tell, self.enough), enough=self.enough,
        )  # fmt: skip
        reached = self.enough is None or self.enough(flown)
        warnings = () if reached else (f"{self.until}: not reached within {self.runs} runs",)
        return Outcome(rare_events.result(self.case, self.edge, flown, self.seed), warnings)
