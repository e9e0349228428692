"""A sweep over the settings of a scenario."""

from __future__ import annotations

from functools import partial
from typing import Any

from navsim.landing.confirmation import RUNS
from navsim.landing.estimate import STATISTICS, extent, shared_memory, sums_bytes
from navsim.landing.preflight import fix_warnings
from navsim.landing.simulation_size import ANALYSED_MEMORY, SIGNAL_MEMORY
from navsim.results.result import ResultKind
from navsim.runner.batches import BATCH
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import AXIS, BASE_MEMORY, BATCH_FILE, NUMBER, TEXTS, VARIABLE, WRITING, Budget
from navsim.runner.executor import Executor
from navsim.runner.job import OptionError, Options, Outcome, Progress, ResourceCheck
from navsim.scenario.landing import Landing
from navsim.scenario.load import base_of
from navsim.scenario_files.source import Document
from navsim.sweeps import study as sweep
from navsim.sweeps.plan import MOST_MAP_SITES, Axis, Plan
from navsim.sweeps.plan import plan as plan_sweep
from navsim.sweeps.scenario import REQUIREMENTS, Sweep

_WIDTHS = 100
"""Values of an axis that are written to see how long they are."""
_LOOKED_AT = 1000
"""Combinations of a sweep that are checked one by one."""
_SAMPLED = 20
"""Combinations of a sweep that are looked at for its sizes."""
_OUTPUT_WIDTH = 12
"""Characters of an output in the table of a sweep."""


class SweepJob:
    """Every combination of the settings."""

    suffix, unit, work, even = "", "combinations", "combinations", True
    plan: Plan

    def __init__(self, section: Sweep, document: Document, options: Options) -> None:
        if options.runs is not None and section.method == "dop":
            raise OptionError("--runs: this sweep is by geometry alone (method dop), which flies nothing")
        if options.runs == 0 and section.method == "monte-carlo":
            raise OptionError("--runs: method monte-carlo needs a run of each combination at least")
        if options.require and REQUIREMENTS not in section.wanted():
            raise OptionError(f"--require: {REQUIREMENTS} is none of the study's outputs")
        self.section, self.document, self.seed = section, document, options.seed
        self.confirming = 0
        if section.method == "covariance":
            self.confirming = RUNS if options.runs is None else options.runs
        self.base = base_of(section, document)
        self.sort = ResultKind("sweep", section.method)
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

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        self.plan = plan_sweep(self.section, self.document, self.base, self.seed)
        allow(self.estimate(executor))

    def estimate(self, executor: Executor) -> Budget:
        """All combinations of a study. Sizes are those of combinations spread over it that are valid."""
        planned = self.plan
        names = sweep.columns(planned)
        keys = sum(len(axis.keys) for axis in planned.axes)
        of_one = NUMBER * (len(names) + 2 * MOST_MAP_SITES)
        axes = sum(len(axis.points) * (len(axis.keys) + 1) for axis in planned.axes)
        variables = len(names) + keys + len(planned.axes) + 14
        row = _OUTPUT_WIDTH * len(names) + sum(_width(axis, i) for axis in planned.axes for i in range(len(axis.keys)))
        table = planned.size * row
        file = planned.size * of_one + NUMBER * (axes + 600) + variables * VARIABLE + TEXTS
        file += len(names) * (len(planned.axes) - 1) * AXIS
        workers = max(1, min(executor.workers, -(-planned.size // planned.batch)))
        memory = 0.0
        if planned.geometry_alone:
            here = extent(planned.first[0], planned.sources)
            memory = SIGNAL_MEMORY * here.epochs * here.sources
        elif not executor.away:
            memory = workers * max(_combination(planned, scenario) for scenario in planned.spread(_SAMPLED))
        batches = -(-planned.size // planned.batch)
        return Budget(
            BASE_MEMORY + memory + (2.0 + WRITING) * file + 6 * table + 200 * axes,
            file + table,
            planned.size * of_one + batches * BATCH_FILE if batches > 1 else 0.0,
        )

    def described(self) -> str:
        extent = " x ".join(f"{len(axis.points)} {axis.name}" for axis in self.plan.axes)
        return f"{self.plan.size} combinations ({extent}), method {self.section.method}"

    def key(self) -> dict[str, object]:
        return sweep.partial_key(self.plan)

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        found, confirmed = sweep.compute(self.plan, executor, store, tell), {}
        if self.confirming:
            confirmed = sweep.confirm_best(self.plan, found, self.confirming, store, partial(tell, self.plan.size))
        return Outcome(sweep.sweep_result(self.plan, found, confirmed))


def _width(axis: Axis, number: int) -> float:
    """Mean width of the values of a key in the table, characters."""
    some = axis.points[:: max(len(axis.points) // _WIDTHS, 1)]
    return 1.0 + sum(len(_written(point[number])) for point in some) / len(some)


def _written(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _combination(planned: Plan, scenario: Landing) -> float:
    """Memory of one combination, without the process itself, bytes."""
    here = extent(scenario, planned.sources)
    study, memory = planned.study, 0
    if study.method == "monte-carlo":
        memory = 3 * STATISTICS * study.runs + -(-study.runs // BATCH) * sums_bytes(here)
    elif study.method == "covariance":
        memory = ANALYSED_MEMORY * here.epochs
    return shared_memory(here) - BASE_MEMORY + memory


def check(section: Sweep, document: Document) -> list[str]:
    """Warnings about a study: its base scenario with the values that the study sets, and its combinations. Raises
    InputError."""
    whole = plan_sweep(section, document, base_of(section, document), seed=1)
    looked, wrong = whole.invalid(_LOOKED_AT)
    without = fix_warnings(whole.first[0], whole.sources, whole.trajectory)
    warnings = [*whole.warnings, *(f"the first combination: {text}" for text in without)]
    if not wrong:
        return warnings
    settings, error = wrong[0]
    where = ", ".join(f"{key} = {value}" for key, value in settings.items())
    of = f"all {looked}" if looked == whole.size else f"{looked} looked at, of {whole.size}"
    count = f"{len(wrong)} of {of} combinations are no valid scenario and would be left out"
    return [*warnings, f"{count}; the first, with {where}: {'; '.join(map(str, error.problems))}"]
