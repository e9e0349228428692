"""`navsim replay` and `navsim live`: recorded flights, and flights with a real block in the loop."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from navsim.cli.common import AT_TERMINAL, leave, leaving, print_shown, progress
from navsim.cli.exit_status import BAD_INPUT, RUN_FAILED, WORDS, keep, print_message
from navsim.cli.findings import warn
from navsim.cli.options import (
    JsonOption,
    OutputOptions,
    Required,
    ScenarioArgument,
    SeedOption,
    argument,
    dry_run_option,
    figures_option,
    number_option,
    output_option,
    set_option,
    value_option,
)
from navsim.cli.terminal import TerminalRequest, run_job
from navsim.runner.executor import threads
from navsim.runner.opening import open_job, stem_of_log, target_of
from navsim.runner.resources import Request, check_resources
from navsim.runner.target import check_target, figure_folder, locked_target, save

if TYPE_CHECKING:
    from navsim.live.session import Session

_KERNELS = "live"
"""The name of those that a live session takes, as of `runner.job.Job`."""


@dataclass(frozen=True)
class ReplayOptions:
    """Input and output of a replay."""

    output: Annotated[Path | None, output_option("results/<log stem>.h5; results/X_log.h5 for X_log/log.yaml")] = None
    set_: Annotated[list[str] | None, set_option("log")] = None
    figures: Annotated[str | None, figures_option()] = None
    bet: Annotated[
        str | None,
        value_option(
            "SECONDS|FILE",
            "Predict innovations and drifts from the part up to this time, and compare them with the rest. The "
            "prediction, bands of 50 and 95 %, goes with its checksum to <result stem>_bet.json before the rest is "
            "used. FILE: such a prediction, to be tested on this recording. The result is <log stem>_bet.h5. A failed "
            "prediction is a warning, and with --require-consistent exit status 3. Example: --bet 70.",
        ),
    ] = None
    dry_run: Annotated[bool, dry_run_option("Read, check and align, then stop.")] = False
    json_: JsonOption = False


def replay(
    log: Annotated[Path, argument("LOG.yaml", "The recorded flight.")],
    given: ReplayOptions,
    required: Required,
    care: OutputOptions,
) -> None:
    """Run recorded IMU and GNSS data, or ranges, through the filter.

    navsim aligns the INS, tunes the noise, and reports innovations and the drift during simulated outages.
    """
    from navsim.runner.job import BET_SUFFIX, Options, prediction_of

    with leaving():
        target = target_of(given.output, stem_of_log(log) + ("" if given.bet is None else BET_SUFFIX))
        options = Options(require=required.require, bet=given.bet, bet_file=prediction_of(target))
        job, _ = open_job("replay", log, given.set_ or [], options, AT_TERMINAL.warn)
    run_job(log, job, target, TerminalRequest(care, required, options, given.figures, given.dry_run, given.json_))


@dataclass(frozen=True)
class LiveOptions:
    """Real block, start, and output of a live run."""

    receiver: Annotated[
        str | None,
        value_option(
            "SOURCE",
            "Take fixes from a real receiver, as NMEA or CSV lines: - (standard input), udp://HOST:PORT, "
            "tcp://HOST:PORT, tcp-listen://HOST:PORT, serial:///dev/NAME?baud=N, or a file. To listen to other "
            "machines write HOST as 0.0.0.0 or [::]; without HOST navsim listens to this machine alone.",
        ),
    ] = None
    imu: Annotated[
        str | None,
        value_option("SOURCE", "Take IMU samples from such a source, as CSV lines."),
    ] = None
    start_time: Annotated[
        str | None,
        value_option(
            "TIME",
            "Reading of the source's clock at time 0 of the flight: UTC as 2018-09-13T12:00:00Z, seconds, or "
            "`first` (the first line belongs to the scenario's first epoch). Default: the scenario's epoch if the "
            "source's times fit it, else first.",
        ),
    ] = None
    output: Annotated[Path | None, output_option("results/<scenario stem>_live.h5")] = None
    figures: Annotated[str | None, figures_option("none")] = None
    seed: SeedOption = 1
    set_: Annotated[list[str] | None, set_option("scenario")] = None
    realtime: Annotated[bool, typer.Option("--realtime", help="Delay the lines of a fast source to real time.")] = False
    lenient: Annotated[
        bool, typer.Option("--lenient", help="Accept NMEA sentences without a checksum (optional in NMEA 0183).")
    ] = False
    simulator_fixes: Annotated[
        bool,
        typer.Option("--simulator-fixes", help="Accept fixes marked as a simulator's (NMEA quality 8)."),
    ] = False
    silence: Annotated[
        float,
        number_option(float, 0.1, "End after this many seconds without a line.", most=10**9, show_default=True),
    ] = 10.0
    json_: JsonOption = False


def live(scenario: ScenarioArgument, given: LiveOptions, care: OutputOptions) -> None:
    """Simulate a landing with a real receiver or IMU.

    Give one of --receiver and --imu; the other sensor is simulated. navsim counts late, lost and corrupt messages
    and continues.
    """
    from navsim.formats.stream import StreamError, open_source
    from navsim.results.result import ResultError, ResultKind

    if (given.receiver is None) == (given.imu is None):
        leave(BAD_INPUT, "give exactly one of --receiver and --imu")
    sort = ResultKind("live")
    with leaving():
        target = target_of(given.output, f"{scenario.stem}_live")
        drawing = figure_folder(given.figures, target, skipped=True)
        check_target(target, sort, care.force)
        # a non-result does not replace a result, nor anything else
        failed = target if care.force or not target.exists() else target.with_stem(f"{target.stem}_failed")
        check_target(failed, sort, care.force)
    from navsim.compiler import jit
    from navsim.live import session as flying
    from navsim.results.findings import kept

    with leaving():
        session = _session(scenario, given, care, target)
    session.tell = lambda message: None if care.quiet and not message.startswith("warning") else print_message(message)
    extent = math.ceil(session.case.scenario.duration_s)
    try:
        with (
            open_source(given.receiver or given.imu or "-") as lines,
            progress(extent, "seconds", not care.quiet) as done,
        ):
            session.tell(f"reading {lines.place}" + (f"; {lines.note}" if lines.note else ""))
            with _ended_by_signals(session) as came:
                why = session.pump(lines, given.silence, done)
        result = session.result()
        result.variables.update(kept(flying.findings(session, result, lines)))
        wrong = flying.failures(result)
        if wrong:
            target = failed
        written = save(result, target, drawing)
    except StreamError as error:
        leave(BAD_INPUT, error)
    except ResultError as error:
        leave(RUN_FAILED, error)
    jit.mark_warm(_KERNELS)
    print_shown(result, target, written, care.quiet, given.json_)
    session.tell(f"ended: {why}")
    warn(result)
    for failure in wrong:
        print_message(f"error: {failure}")
    if came:
        raise typer.Exit(128 + came[0])
    if wrong:
        leave(RUN_FAILED, f"this is no valid result; the data are kept in {target}")


def _session(scenario: Path, given: LiveOptions, care: OutputOptions, target: Path) -> Session:
    """The landing, ready for live data."""
    from navsim.landing import study as landing
    from navsim.landing.estimate import estimate_landing as estimated
    from navsim.live.session import Block, Session
    from navsim.replays import source_clock
    from navsim.scenario.filter import SMOOTHERS
    from navsim.scenario.load import read
    from navsim.scenario_files.source import InputError

    def ask(section: Any, sources: Any) -> None:
        check_resources(Request(scenario, target, care.over_budget), estimated(section, sources), AT_TERMINAL)

    try:
        section, document = read(scenario, given.set_ or [])
        if section.filter.kind in SMOOTHERS:
            leave(BAD_INPUT, f"{scenario}: filter.kind {section.filter.kind} smooths with later fixes; choose a filter")
        if section.filter.tight:
            leave(
                BAD_INPUT,
                f"{scenario}: filter.coupling tight takes ranges, live receivers give fixes; make it loose",
            )
        if aiding := section.aiding_sections():
            leave(BAD_INPUT, f"{scenario}: {' and '.join(aiding)} cannot run live; remove them")
        if (air := section.air()) is not None:
            off = " and ".join(".".join(key) for key in air[1])
            leave(BAD_INPUT, f"{scenario}: runs off the route, by {off}, are not what live data are; take it out")
        for name in ("integrity", "requirements", "box"):
            if getattr(section, name):
                AT_TERMINAL.warn(f"{scenario}: {name} is not used: one live flight is not judged by it")
        start = None if given.start_time is None else source_clock.start_time(given.start_time)
        keep(locked_target(target, _KERNELS, AT_TERMINAL, threads().workers))
        case = landing.prepare(section, document, ask)
        if not case.shared.signals.time.size:
            leave(BAD_INPUT, f"{scenario}: duration_s {section.duration_s:g} is too short for one fix to come")
        block: Block = "receiver" if given.receiver is not None else "imu"
        return Session(case, block, given.seed, given.realtime, start, given.lenient, given.simulator_fixes)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except source_clock.StartError as error:
        leave(BAD_INPUT, f"--start-time {error}")


@contextmanager
def _ended_by_signals(session: Session) -> Iterator[list[int]]:
    """Context in which the first interrupt, termination or hangup ends the session with the data so far.

    A second one ends the program. Ignored signals, as by nohup, stay ignored. Returns the signals that came.
    """
    came: list[int] = []
    names = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before: dict[int, Any] = {}
    terminals = [stream.fileno() for stream in (sys.stdout, sys.stderr) if stream.isatty()]

    def end(number: int, _: object) -> None:
        came.append(number)
        session.stopped = f"{WORDS[number]}; the data so far are kept"
        if number == signal.SIGHUP:  # a terminal that hung up takes no more words, and fails at each
            for descriptor in terminals:
                os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in names:
        if signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, end)
    try:
        yield came
    finally:
        restore()
