"""The companion papers' systems, each computed by one call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from navsim.companions import budget as budgets
from navsim.companions.atc import study as atc
from navsim.companions.atc.scenario import Atc
from navsim.companions.azimuth import study as azimuth
from navsim.companions.azimuth.scenario import Azimuth
from navsim.companions.elevation import study as elevation
from navsim.companions.elevation.scenario import Elevation
from navsim.results.result import Result, ResultKind
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import Budget
from navsim.runner.executor import Executor
from navsim.runner.job import OptionError, Options, Outcome, Progress, ResourceCheck
from navsim.scenario_files.source import Document


class Compute(Protocol):
    """compute(scenario, seed, runs or None, done) -> result; `done(n)` receives the finished part."""

    def __call__(self, scenario: Any, seed: int, runs: int | None, done: Callable[[int], None]) -> Result: ...


class CompanionJob:
    """Job of a companion paper's system; quick, without partial work."""

    suffix, work, pieces = "", "", 0

    def __init__(
        self, section: Any, document: Document, options: Options, unit: str, extent: int, compute: Compute,
        budget: Callable[[Any, int | None], Budget], even: bool = False,
    ) -> None:  # fmt: skip
        if foreign := options.foreign("runs"):
            text = f"only for `kind: landing`; {document.file} is of kind {section.kind}"
            raise OptionError(f"{', '.join(foreign)}: {text}")
        self.section, self.document, self.options = section, document, options
        self.sort, self.kernels = ResultKind(section.kind), section.kind
        self.unit, self.extent, self.even = unit, extent, even
        self._compute, self._budget = compute, budget

    @property
    def warnings(self) -> list[str]:
        return []

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        allow(self.estimate())

    def estimate(self) -> Budget:
        return self._budget(self.section, self.options.runs)

    def described(self) -> str:
        return f"a study of kind {self.section.kind}"

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        return Outcome(self._compute(self.section, self.options.seed, self.options.runs, tell))


def mls_elevation(section: Elevation, document: Document, options: Options) -> CompanionJob:
    """The elevation filter and its proof."""
    count = section.montecarlo.experiments
    even = budgets.mostly_experiments(section, options.runs)
    return CompanionJob(
        section, document, options, "experiments", count, elevation.compute, budgets.mls_elevation, even
    )


def atc_tracking(section: Atc, document: Document, options: Options) -> CompanionJob:
    """The tracking filters."""
    return CompanionJob(section, document, options, "cases", atc.extent(section), atc.compute, budgets.atc_tracking)


def azimuth_tracking(section: Azimuth, document: Document, options: Options) -> CompanionJob:
    """The azimuth filter."""
    count = azimuth.extent(section)
    return CompanionJob(section, document, options, "cases", count, azimuth.compute, budgets.azimuth_tracking)
