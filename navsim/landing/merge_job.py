"""Parts of an ensemble put together."""

from __future__ import annotations

from pathlib import Path

from navsim.landing import merge
from navsim.landing.study import Case
from navsim.results.result import ONE_RUN, SEVERAL_RUNS, ResultError, ResultKind
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import BASE_MEMORY, BUILT_IN_MEMORY, VARIABLE, WRITING, Budget
from navsim.runner.executor import Executor
from navsim.runner.job import OptionError, Outcome, Progress, ResourceCheck


class MergeJob:
    """Job that merges parts; quick, without partial work."""

    suffix, work, pieces, unit, extent, even = "", "", 0, "parts", 1, True
    case: Case

    def __init__(self, parts: merge.Parts, folder: Path) -> None:
        """parts: in any order. folder: where the files lie that the scenario names. Raises OptionError."""
        self.parts = merge.ordered(parts)
        self._folder = folder
        method = str(self.parts[0][1].attributes["method"])
        count = sum(one["/run"].size for _, one in self.parts)
        runs = "" if method == "rare" else SEVERAL_RUNS if count > 1 else ONE_RUN
        self.sort = ResultKind("landing", method, runs, count)
        self.kernels = f"merge-{method}"

    @property
    def warnings(self) -> list[str]:
        return self.case.warnings

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        allow(self.estimate())
        for file, one in self.parts:
            try:
                merge.read_through(one)
            except ResultError as error:
                raise OptionError(error) from None
            except ValueError as error:
                raise OptionError(f"{file}: {error}") from None
        self.case = merge.case_of(self.parts, self._folder)

    def estimate(self) -> Budget:
        size = sum(file.stat().st_size for file, _ in self.parts)
        numbers = sum(v.data.nbytes for _, one in self.parts for path, v in one.variables.items() if "/part/" in path)
        image = min(size, BUILT_IN_MEMORY) * WRITING
        variables = len(self.parts[0][1].variables) * VARIABLE
        return Budget(BASE_MEMORY + 3.0 * numbers + image, float(size + variables))

    def described(self) -> str:
        return merge.describe_parts(self.parts)

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        return Outcome(merge.merged(self.parts, self.case))
