"""A recorded flight."""

from __future__ import annotations

from navsim.results.findings import several
from navsim.results.result import Sort
from navsim.scenario.replay import Replay
from navsim.scenario.source import Document
from navsim.study import replay
from navsim.study.budget.studies import recorded
from navsim.study.executor import Executor
from navsim.study.job import Allow, OptionError, Options, Outcome, Tell
from navsim.study.partial import Store
from navsim.words import option


class ReplayJob:
    """Read, aligned, tuned, flown through the filter; none of the work is kept."""

    suffix, unit, work, pieces, even = "", "tuning flights", "", 0, False  # it ends where it has converged
    recording: replay.Recording

    def __init__(self, section: Replay, document: Document, options: Options) -> None:
        if options.require:
            raise OptionError(f"{option('require')}: a recorded flight has no requirements")
        self.section, self.document = section, document
        self.sort = Sort("replay")
        self.kernels = f"replay-{section.filter.kind}-{section.filter.coupling}"

    @property
    def extent(self) -> int:
        return replay.extent(self.recording)

    @property
    def warnings(self) -> list[str]:
        return self.recording.warnings

    def prepare(self, executor: Executor, allow: Allow) -> None:
        self.recording = replay.prepare(self.section, self.document)
        allow(recorded(self.recording))

    def described(self) -> str:
        here = self.recording
        return (
            f"{several(here.samples.time.size, 'sample')}, {several(here.fixes.time.size, 'fix')}, "
            f"aligned at {here.alignment.time:.2f} s with data up to {here.alignment.until:.2f} s"
        )

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: Store | None, tell: Tell) -> Outcome:
        return Outcome(replay.compute(self.recording, tell))
