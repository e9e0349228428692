"""A recorded flight."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from navsim.replays import study as replay
from navsim.replays.prediction import Prediction, predict, write_score
from navsim.replays.reading import ReplayError, read
from navsim.replays.scenario import Replay
from navsim.results.findings import several
from navsim.results.result import ResultKind
from navsim.runner.checkpoint import CheckpointStore
from navsim.runner.estimate import BASE_MEMORY, NUMBER, VARIABLE, WRITING, Budget
from navsim.runner.executor import Executor
from navsim.runner.job import BET_SUFFIX, OptionError, Options, Outcome, Progress, ResourceCheck
from navsim.scenario.filter import SMOOTHERS
from navsim.scenario_files.source import Document, InputError

_READ_MEMORY = 600
"""Memory for a sample or fix of a recording while it is read and checked, bytes."""
_SPAN_MEMORY = 400
"""An outage, bytes."""
_REPLAYED_MEMORY = 3000
"""An output or fix of a replayed flight, bytes."""


class ReplayJob:
    """Job of a recorded flight: read, align, tune, filter. It keeps no partial work."""

    unit, work, pieces, even = "", "", 0, False
    recording: replay.Recording

    def __init__(self, section: Replay, document: Document, options: Options) -> None:
        if options.require:
            raise OptionError("--require: a recorded flight has no requirements")
        self.section, self.document, self.options = section, document, options
        self.bet: Prediction | None = None
        self.until = np.inf
        if options.bet is not None:
            try:
                self.until = float(options.bet)
            except ValueError:
                self.bet = Prediction.read(Path(options.bet))
            else:
                if not np.isfinite(self.until):
                    raise OptionError(f"--bet {self.until}: expected a time in s of the recording")
        self.suffix = "" if options.bet is None else BET_SUFFIX
        self.sort = ResultKind("replay")
        self.kernels = f"replay-{section.filter.kind}-{section.filter.coupling}"

    @property
    def extent(self) -> int:
        return 0 if self.recording.free.size else 1  # the tuning ends where it has converged

    @property
    def warnings(self) -> list[str]:
        return self.recording.warnings

    def prepare(self, executor: Executor, allow: ResourceCheck) -> None:
        """Prepare the flight, or only its first part if that has to predict the rest."""
        section = self.section
        if self.until < np.inf:
            last = self.until if section.end_s is None else min(self.until, section.end_s)
            section = section.model_copy(update={"end_s": last, "outages": ()})
        try:
            self.recording = replay.prepare(section, self.document)
        except InputError as error:
            if section is not self.section and (cut := [one for one in error.problems if one.key == "end_s"]):
                raise OptionError(f"--bet {cut[0].message}") from None
            raise
        except ReplayError as error:
            if section is not self.section:
                cause = str(error).partition(";")[0]  # its remedies are those of a whole recording
                raise OptionError(f"--bet {self.until:.12g}: {cause}; give a later time") from None
            raise
        ends = self.recording.recorded[1] if self.section.end_s is None else self.section.end_s
        if self.until < np.inf and self.until >= ends:
            raise OptionError(f"--bet {self.until:.12g}: the recording ends at {ends:.1f} s; give an earlier time")
        allow(self.estimate())

    def estimate(self) -> Budget:
        """A recorded flight that was read and aligned."""
        recording = self.recording
        samples, fixes = recording.samples.time.size, recording.fixes.time.size
        lasts = float(recording.samples.time[-1]) - recording.alignment.time
        rate = recording.scenario.filter.output_rate_hz
        outputs = fixes + 1.0 if rate == "fixes" else lasts * rate
        outages = sum(len(outage.start_s) * len(outage.duration_s) for outage in recording.scenario.outages)
        smoothed = 3.0 if recording.scenario.filter.kind in SMOOTHERS else 1.0
        result = NUMBER * (31 * outputs + 23 * fixes + 5 * outages) + 44 * VARIABLE
        memory = (
            _READ_MEMORY * (samples + fixes)
            + _SPAN_MEMORY * outages
            + smoothed * _REPLAYED_MEMORY * (outputs + fixes)
            + WRITING * result
        )
        return Budget(BASE_MEMORY + memory, result)

    def described(self) -> str:
        here = self.recording
        unseen = "; ".join(item.partition(":")[0] for item in "; ".join(here.not_judged).split("; "))
        return (
            f"{several(here.samples.time.size, 'sample')}, {several(here.fixes.time.size, 'fix')}, "
            f"aligned at {here.alignment.time:.2f} s with data up to {here.alignment.until:.2f} s"
            f"{f' (not checked: {unseen})' if unseen else ''}"
        )

    def key(self) -> dict[str, object]:
        return {}

    def run(self, executor: Executor, store: CheckpointStore | None, tell: Progress) -> Outcome:
        def done(flown: int) -> None:
            tell(flown, f"{flown} passes of the filter")

        if self.options.bet is None:
            return Outcome(replay.compute(self.recording, done))
        if self.bet is None:
            self.bet = predict(self.recording, self.section, self.until, done)
            if self.options.bet_file is not None:
                self.bet.write(self.options.bet_file)
            self.recording = replay.prepare(self.section, self.document)  # only now the rest is read
        score = partial(write_score, prediction=self.bet, recording=self.recording)
        return Outcome(replay.compute(self.recording, done, self.bet.tuning(self.recording), score))


def check(section: Replay, document: Document) -> list[str]:
    """Warnings of a log, whose files are read. Raises InputError."""
    return read(section, document).warnings
