"""`navsim replay` and `navsim live`: recorded flights, and flights with a real block in the loop."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from navsim.cli.budget import OverBudgetOption, afford
from navsim.cli.common import (
    FiguresOption,
    ForceOption,
    JsonOption,
    QuietOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    begin,
    figure_folder,
    leave,
    number_option,
    output_option,
    print_result,
    progress,
    save,
    set_option,
    target_of,
)
from navsim.cli.ending import BAD_INPUT, RUN_FAILED, WORDS, say
from navsim.cli.findings import RequireConsistentOption, RequireFixOption, require, warn

if TYPE_CHECKING:
    from navsim.study.live import Session


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG.yaml", help="The recorded flight.", show_default=False)],
    output: Annotated[Path | None, output_option("results/<log stem>.h5")] = None,
    set_: Annotated[list[str] | None, set_option("log")] = None,
    figures: FiguresOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read, check and align; fly nothing.")] = False,
    require_fix: RequireFixOption = False,
    require_consistent: RequireConsistentOption = False,
    force: ForceOption = False,
    over_budget: OverBudgetOption = False,
    quiet: QuietOption = False,
    json_: JsonOption = False,
) -> None:
    """Fly recorded IMU and GNSS data through the filter.

    Alignment, tuning of the noise, innovations, drift in outages.
    """
    from navsim.io.results import ResultError, Sort
    from navsim.scenario.load import read_replay
    from navsim.scenario.source import InputError

    try:
        section, document = read_replay(log, set_ or [])
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    target = target_of(log, output, Sort("replay"), force)
    from navsim.core import jit
    from navsim.study import replay as flying
    from navsim.study.budget.studies import recorded

    try:
        recording = flying.prepare(section, document)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except flying.ReplayError as error:
        leave(RUN_FAILED, f"{log}: {error}")
    afford(log, recorded(recording), target, over_budget, shown=dry_run)
    if dry_run:
        for warning in recording.warnings:
            say(f"warning: {warning}")
        aligned = recording.alignment
        say(
            f"{log}: {recording.samples.time.size} samples, {recording.fixes.time.size} fixes, aligned at "
            f"{aligned.time:.2f} s with data up to {aligned.until:.2f} s; would write {target}"
        )
        return
    begin(target)
    drawing = figure_folder(figures, target, 1, quiet)
    try:
        with progress(flying.extent(recording), not quiet, "tuning flights") as done:
            result = flying.compute(recording, done)
        written = save(result, target, drawing)
    except (ResultError, flying.ReplayError) as error:
        leave(RUN_FAILED, error)
    jit.mark_warm()
    print_result(result, target, written, quiet, json_, ("/summary", "/tuning", "/outages"))
    warn(result)
    require(result, target, require_fix, require_consistent)


def live(
    scenario: ScenarioArgument,
    receiver: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="The receiver is real: NMEA or CSV lines from - (standard input), udp://HOST:PORT, tcp://HOST:PORT, "
            "tcp-listen://HOST:PORT, serial:///dev/NAME?baud=N, or a file. HOST to listen at: 0.0.0.0 or [::] hears "
            "every machine, none this one alone.",
            show_default=False,
        ),
    ] = None,
    imu: Annotated[
        str | None,
        typer.Option(metavar="SOURCE", help="The IMU is real: CSV lines from such a source.", show_default=False),
    ] = None,
    start_time: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="What the source's clock reads at time 0 of the flight: UTC as 2018-09-13T12:00:00Z, its count of "
            "seconds, or `first` (the first line is the scenario's first). Default: by the scenario's epoch where the "
            "source's times allow it, else first.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[Path | None, output_option("results/<scenario stem>_live.h5")] = None,
    seed: SeedOption = 1,
    set_: SetOption = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Hold lines of a fast source back until their time has come.")
    ] = False,
    silence: Annotated[
        float,
        number_option(float, 0.1, "End after so many seconds without a line.", most=10**9, show_default=True),
    ] = 10.0,
    force: ForceOption = False,
    over_budget: OverBudgetOption = False,
    quiet: QuietOption = False,
    json_: JsonOption = False,
) -> None:
    """Fly a landing whose receiver or IMU is a live stream.

    Late, lost and corrupt messages are survived and counted. Give --receiver or --imu.
    """
    from navsim.io.findings import kept
    from navsim.io.results import ResultError, Sort
    from navsim.io.stream import StreamError, opened
    from navsim.scenario.filter import SMOOTHERS
    from navsim.scenario.load import read
    from navsim.scenario.source import InputError
    from navsim.study import source_clock

    if (receiver is None) == (imu is None):
        leave(BAD_INPUT, "give exactly one of --receiver and --imu")
    try:
        section, document = read(scenario, set_ or [])
        target = target_of(scenario, output, Sort("live"), force, "_live")
        from navsim.core import jit
        from navsim.study import landing
        from navsim.study import live as flying
        from navsim.study.budget.landing import landing as estimated

        if section.filter.kind in SMOOTHERS:
            leave(BAD_INPUT, f"{scenario}: filter.kind {section.filter.kind} smooths with later fixes; choose a filter")
        if section.aiding():
            leave(BAD_INPUT, f"{scenario}: sensors beside the receiver (altimeter) cannot run live; take them out")
        start = None if start_time is None else source_clock.start_time(start_time)
        begin(target)

        def ask(section: Any, sources: Any) -> None:
            afford(scenario, estimated(section, sources), target, over_budget, shown=False)

        case = landing.prepare(section, document, ask)
        if not case.world.signals.time.size:
            leave(BAD_INPUT, f"{scenario}: duration_s {section.duration_s:g} is too short for one fix to come")
        session = flying.Session(case, "receiver" if receiver is not None else "imu", seed, realtime, start)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    except source_clock.StartError as error:
        leave(BAD_INPUT, f"--start-time {error}")
    session.tell = lambda message: None if quiet and not message.startswith("warning") else say(message)
    try:
        with opened(receiver or imu or "-") as lines, progress(int(section.duration_s), not quiet, "seconds") as done:
            session.tell(f"reading {lines.place}" + (f"; {lines.note}" if lines.note else ""))
            with _ended_by_signals(session) as came:
                why = session.pump(lines, silence, done)
        result = session.result()
        result.variables.update(kept(flying.findings(session, result, lines)))
        save(result, target, None)
    except StreamError as error:
        leave(BAD_INPUT, error)
    except ResultError as error:
        leave(RUN_FAILED, error)
    jit.mark_warm()
    print_result(result, target, [], quiet, json_, ("/summary", "/stream", "/clock"))
    session.tell(f"ended: {why}")
    warn(result)
    wrong = flying.failures(result)
    for failure in wrong:
        say(f"error: {failure}")
    if came:
        raise typer.Exit(128 + came[0])
    if wrong:
        leave(RUN_FAILED, f"what was flown is no result; what came is kept in {target}")


@contextmanager
def _ended_by_signals(session: Session) -> Iterator[list[int]]:
    """While it lasts, the first interrupt, termination or hangup ends the session with what has come; a second one ends
    the program. Signals that are ignored, as by nohup, stay so. Gives the signals that came."""
    came: list[int] = []
    names = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before: dict[int, Any] = {}
    terminals = [stream.fileno() for stream in (sys.stdout, sys.stderr) if stream.isatty()]

    def end(number: int, _: object) -> None:
        came.append(number)
        session.stopped = f"{WORDS[number]}; what came so far is kept"
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
