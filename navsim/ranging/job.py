"""The job of recorded ranges."""

from __future__ import annotations

from navsim.ranging import study
from navsim.ranging.scenario import RecordedRanges
from navsim.results.findings import several
from navsim.results.result import ResultKind
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import BASE_MEMORY, NUMBER, VARIABLE, WRITING, Budget
from navsim.runner.executor import Executor
from navsim.runner.job import OptionError, Options, Outcome, Progress, ResourceCheck
from navsim.scenario_files.source import Document

_COVARIANCES = 8
"""Covariances of each range that are held at once: two passes, each filtered and smoothed, and their copies."""


class RangeJob:
    """Read, started, tuned, filtered and smoothed; none of the work is kept."""

    suffix, unit, work, pieces, extent, even = "", "ranges", "", 0, 0, False
    recording: study.RangeStudy

    def __init__(self, section: RecordedRanges, document: Document, options: Options) -> None:
        if options.require:
            raise OptionError("--require: recorded ranges have no requirements")
        if options.bet is not None:
            raise OptionError("--bet: recorded ranges have no simulated outages")
        self.section, self.document = section, document
        self.sort = ResultKind("ranges")
        self.kernels = "ranges"

    @property
    def warnings(self) -> list[str]:
        return self.recording.warnings

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        self.recording = study.prepare(self.section, self.document)
        allow(self.estimate())

    def estimate(self) -> Budget:
        """Recorded ranges that were read."""
        model = self.recording.model
        count, size = model.data.time.size, model.size
        result = NUMBER * count * (7 + 4 * 6 + 4 * len(model.clocks) + 6) + 60 * VARIABLE
        return Budget(BASE_MEMORY + NUMBER * count * size * (_COVARIANCES * size + 20) + WRITING * result, result)

    def described(self) -> str:
        log = self.recording.log
        return (
            f"{several(log.time.size, 'range')} of {several(len(log.sources.names), 'source')} in "
            f"{log.time[-1] - log.time[0]:.1f} s"
        )

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        return Outcome(study.compute(self.recording, lambda words: tell(0, words)))


def check(section: RecordedRanges, document: Document) -> list[str]:
    """Warnings of a file, whose tables are read. Raises InputError."""
    return study.prepare(section, document).warnings
