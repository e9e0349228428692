"""The paper's Table 2: no file asks for it, the shipped calibrations are its scenarios."""

from __future__ import annotations

from navsim.results.result import Sort
from navsim.study import table2
from navsim.study.budget.studies import tables
from navsim.study.executor import Executor
from navsim.study.job import Allow, Outcome, Tell
from navsim.study.partial import Store


class Table2Job:
    """All rows under every calibration, so many runs of each; none of the work is kept."""

    sort = Sort("table2")
    kernels, suffix, unit, work, pieces = "table2", "", "rows", "", 0
    even = True
    extent = len(table2.CALIBRATIONS) * len(table2.ROWS)

    def __init__(self, seed: int, runs: int) -> None:
        self.seed, self.runs = seed, runs

    @property
    def warnings(self) -> list[str]:
        return []

    def prepare(self, executor: Executor, allow: Allow) -> None:
        allow(tables(self.runs, executor.workers))

    def described(self) -> str:
        return f"{self.extent} rows of {self.runs} run(s)"

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: Store | None, tell: Tell) -> Outcome:
        found = table2.compute_all(self.seed, self.runs, executor, tell)
        return Outcome(table2.result(found, self.seed, self.runs))
