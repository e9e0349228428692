"""A sweep over the settings of a scenario."""

from __future__ import annotations

from functools import partial

from navsim.results.result import Sort
from navsim.scenario.load import base_of
from navsim.scenario.source import Document
from navsim.scenario.sweep import REQUIREMENTS, Sweep
from navsim.study import sweep
from navsim.study.budget.studies import sweep as estimated
from navsim.study.confirmation import RUNS
from navsim.study.executor import Executor
from navsim.study.job import Allow, OptionError, Options, Outcome, Tell
from navsim.study.partial import Store
from navsim.words import option


class SweepJob:
    """Every combination of the settings."""

    suffix, unit, work, even = "", "combinations", "combinations", True
    plan: sweep.Plan

    def __init__(self, section: Sweep, document: Document, options: Options) -> None:
        if options.runs is not None and section.method == "dop":
            raise OptionError(f"{option('runs')}: this sweep is by geometry alone (method dop), which flies nothing")
        if options.runs == 0 and section.method == "monte-carlo":
            raise OptionError(f"{option('runs')}: method monte-carlo needs a run of each combination at least")
        if options.require and REQUIREMENTS not in section.wanted():
            raise OptionError(f"{option('require')}: {REQUIREMENTS} is none of the study's outputs")
        self.section, self.document, self.seed = section, document, options.seed
        self.confirming = 0
        if section.method == "covariance":
            self.confirming = RUNS if options.runs is None else options.runs
        self.base = base_of(section, document)
        self.sort = Sort("sweep", section.method)
        self.kernels = f"sweep-{section.method}"

    @property
    def extent(self) -> int:
        return self.plan.size

    @property
    def pieces(self) -> int:
        return -(-self.plan.size // self.plan.batch)

    @property
    def warnings(self) -> list[str]:
        return self.plan.warnings

    def prepare(self, executor: Executor, allow: Allow) -> None:
        self.plan = sweep.plan(self.section, self.document, self.base, self.seed)
        allow(estimated(self.plan, executor.workers, executor.away, self.confirming))

    def described(self) -> str:
        extent = " x ".join(f"{len(axis.points)} {axis.name}" for axis in self.plan.axes)
        return f"{self.plan.size} combinations ({extent}), method {self.section.method}"

    def key(self) -> dict[str, object]:
        return sweep.partial_key(self.plan)

    def run(self, executor: Executor, store: Store | None, tell: Tell) -> Outcome:
        found, confirmed = sweep.compute(self.plan, executor, store, tell), {}
        if self.confirming:
            confirmed = sweep.confirm_best(self.plan, found, self.confirming, store, partial(tell, self.plan.size))
        return Outcome(sweep.sweep_result(self.plan, found, confirmed))
