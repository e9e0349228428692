"""Job of the table of the capabilities of few satellites and pseudolites."""

from __future__ import annotations

from navsim.gnss.signals import SignalScenario
from navsim.landing import study as landing
from navsim.landing.estimate import extent, shared_memory
from navsim.published_tables import integrity_table
from navsim.results.result import ResultKind
from navsim.results.schema import MOST_LEVELS
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import NUMBER, TEXTS, VARIABLE, WRITING, Budget
from navsim.runner.executor import Executor
from navsim.runner.job import JobError, Options, Outcome, Progress, ResourceCheck
from navsim.scenario.landing import Landing
from navsim.scenario_files.source import Document, InputError, Problem

_LEVEL_MEMORY = 200
"""A pair of sources at an epoch then, bytes."""


def job(section: Landing, document: Document, options: Options) -> IntegrityTableJob:
    """The job that computes a stored table again."""
    return IntegrityTableJob(section, document, options.seed)


class IntegrityTableJob:
    """Capabilities by rank, and levels of subsets of the satellites of a landing; it keeps no partial work."""

    sort = ResultKind("integrity-table")
    kernels, suffix, unit, work, pieces = "integrity-table", "", "cells", "", 0
    extent = integrity_table.CELLS
    even = False  # there are more subsets of some numbers of satellites than of others
    case: landing.Case
    watched: integrity_table.MonitoredGlide

    def __init__(self, section: Landing, document: Document, seed: int) -> None:
        """Raises InputError for a scenario without limits."""
        self.section, self.document, self.seed = section, document, seed
        if section.integrity is None:
            raise self._without_limits("integrity", "integrity={method: chi2, limits: %s}")
        if section.integrity.limits is None:
            raise self._without_limits("integrity.limits", "integrity.limits=%s")

    def _without_limits(self, key: str, assigned: str) -> InputError:
        text = (
            "protection levels are compared with alert limits here, and the scenario has none; give for example "
            f"--set '{assigned % '{hal_m: 40, val_m: 60, tta_s: 2}'}'"
        )
        return InputError([Problem(self.document.place(tuple(key.split("."))), key, text)])

    @property
    def warnings(self) -> list[str]:
        return self.case.warnings

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        def ask(scenario: Landing, sources: SignalScenario) -> None:
            allow(self.estimate(scenario, sources))

        self.case = landing.prepare(self.section, self.document, ask)
        try:
            self.watched = integrity_table.watched(self.case)
        except ValueError as error:
            raise JobError(str(error)) from None

    def estimate(self, scenario: Landing, sources: SignalScenario) -> Budget:
        """Estimated memory and disk of the table."""
        here = extent(scenario, sources)
        separated = scenario.integrity is not None and scenario.integrity.method != "chi2"
        result = TEXTS + NUMBER * MOST_LEVELS + (20 if separated else 18) * VARIABLE
        return Budget(
            shared_memory(here) + _LEVEL_MEMORY * MOST_LEVELS * here.sources**2 + WRITING * result,
            result,
        )

    def described(self) -> str:
        here = self.watched
        return (
            f"{self.extent} cells, {here.satellites.size} satellites used throughout the glide, "
            f"{here.pseudolites.size} pseudolite(s), {here.signals.time.size} of {here.epochs} epochs"
        )

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        return Outcome(integrity_table.compute(self.case, self.watched, self.seed, tell))
