"""The paper's Table 2: no file asks for it, the shipped calibrations are its scenarios."""

from __future__ import annotations

from navsim.environment.sources import environment
from navsim.landing.ensemble import HISTORIES, history_bytes
from navsim.landing.estimate import STATISTICS, extent, shared_memory, sums_bytes
from navsim.published_tables import table2
from navsim.results.result import ResultKind
from navsim.runner.batches import BATCH
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import NUMBER, VARIABLE, WRITING, Budget
from navsim.runner.executor import Executor
from navsim.runner.job import Options, Outcome, Progress, ResourceCheck
from navsim.scenario.landing import Landing
from navsim.scenario.load import read
from navsim.scenario_files.shipped import path
from navsim.scenario_files.source import Document

DEFAULT_RUNS = 400
"""Runs of each row."""


def job(section: Landing, document: Document, options: Options) -> Table2Job:
    """The job that computes a stored table again; its scenarios are the shipped ones."""
    return Table2Job(options.seed, options.runs or DEFAULT_RUNS)


class Table2Job:
    """All rows under every calibration, so many runs of each; it keeps no partial work."""

    sort = ResultKind("table2")
    kernels, suffix, unit, work, pieces = "table2", "", "rows", "", 0
    even = True
    extent = len(table2.CALIBRATIONS) * len(table2.ROWS)

    def __init__(self, seed: int, runs: int) -> None:
        self.seed, self.runs = seed, runs

    @property
    def warnings(self) -> list[str]:
        return []

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        allow(self.estimate())

    def estimate(self) -> Budget:
        """Table 2 of the paper: every row under every calibration."""
        runs = self.runs
        memory, points = 0.0, 0
        for calibration in table2.CALIBRATIONS:
            scenario, document = read(path(calibration.name), table2.ROWS[-1].assignments())
            sources, scenario, _ = environment(scenario, document)
            here = extent(scenario, sources)
            for i in range(len(table2.ROWS)):
                keep = "errors" if i in table2.CURVES else "none"
                # no partial work is kept: histories stay in memory
                held = runs * sum(history_bytes(name, here.sizes()) for name in HISTORIES[keep])
                sums = -(-runs // BATCH) * sums_bytes(here)
                memory = max(memory, shared_memory(here) + held + sums + 3 * STATISTICS * runs)
            points = max(points, here.epochs)
        result = NUMBER * points * (1 + 2 * len(table2.CURVES)) + 10_000 + 44 * VARIABLE
        return Budget(memory + WRITING * result, result)

    def described(self) -> str:
        return f"{self.extent} rows of {self.runs} run(s)"

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        found = table2.compute_all(self.seed, self.runs, executor, tell)
        return Outcome(table2.result(found, self.seed, self.runs))
