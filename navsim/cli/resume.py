"""`navsim resume`: continue a study that was interrupted or killed."""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from navsim.cli.common import leave, leaving
from navsim.cli.exit_status import BAD_INPUT, print_message
from navsim.cli.options import OutputOptions, SchedulerOption, WorkersOption, argument, figures_option
from navsim.cli.terminal import resuming

_ClickException: Any = typer.BadParameter.__mro__[2]
"""click's exception for a wrong command line; typer has its own copy of click, or the common one."""
_RESUMED = ("run", "sweep", "optimize")
"""Commands that keep partial work."""
_GIVEN_ANEW = ("figures", "scheduler", "force", "over_budget", "quiet", "log_")
"""Options that write, connect or overwrite elsewhere, or print less: `resume` takes them only from its own command
line, since a folder of partial work may come from anybody, in an archive."""
_DROPPED = ("fresh", *_GIVEN_ANEW)
"""Options that discard earlier work, which have done so; now that work is to be continued."""


@dataclass(frozen=True)
class ResumeOptions:
    """Options of the continuation."""

    workers: WorkersOption = None
    scheduler: SchedulerOption = None
    figures: Annotated[str | None, figures_option("that of the result; none for several runs or with --quiet")] = None


def resume(
    folder: Annotated[
        Path,
        argument("FOLDER", "The folder of finished work, RESULT.h5.partial."),
    ],
    given: ResumeOptions,
    care: OutputOptions,
) -> None:
    """Continue a study that was interrupted or killed.

    navsim repeats the command that started the study, in its working folder, and continues from the finished work.
    Scenario, files and code must be unchanged. Give options on figures, clusters, overwriting and logs again.
    """
    from navsim.cli.main import app
    from navsim.runner.checkpoint import CheckpointError, command_of
    from navsim.runner.errors import BadInput, as_problems

    with leaving():
        try:
            begun = command_of(folder)
        except CheckpointError as error:
            raise BadInput(as_problems(error)) from None
    words, dropped = _read(folder, begun.words, given)
    words += _options(given, care)
    print_message(f"navsim {shlex.join(words)}")
    if dropped:
        print_message(f"options not repeated: {shlex.join(dropped)}. Add them to navsim resume if needed")
    with resuming(folder.absolute()):
        try:
            os.chdir(begun.folder)
        except OSError as error:
            leave(BAD_INPUT, f"{begun.folder}: {error.strerror or error}")
        sys.argv[1:] = words
        app()


def _read(folder: Path, words: tuple[str, ...], given: ResumeOptions) -> tuple[list[str], list[str]]:
    """Words of a command that determine the computation, and those of options that a file may not set."""
    from navsim.cli.main import command_named

    refused = f"{folder}: its command, navsim {shlex.join(words)},"
    if words[0] not in _RESUMED:
        leave(BAD_INPUT, f"{refused} keeps no partial work; only navsim {', '.join(_RESUMED)} can be resumed")
    command = command_named(words[0])
    try:
        context = command.make_context(words[0], list(words[1:]))
    except (_ClickException, typer.Exit) as error:
        why = error.format_message() if isinstance(error, _ClickException) else "it only prints help"
        leave(BAD_INPUT, f"{refused} is none of this version ({why}); repeat the command by hand")
    kept, dropped = [words[0]], list[str]()
    for parameter in command.params:
        source = context.get_parameter_source(parameter.name)
        if source is not None and source.name == "COMMANDLINE":
            name = parameter.name
            anew = name in _DROPPED or (name == "workers" and (given.workers or given.scheduler) is not None)
            (dropped if anew else kept).extend(_spell(parameter, context.params[name]))
    if "--scheduler" in dropped and given.scheduler is None and given.workers is None:
        asked = dropped[dropped.index("--scheduler") + 1]
        leave(
            BAD_INPUT,
            f"{folder}: its command worked on the cluster {asked}, an address that navsim resume does not take from a "
            f"file; give it, --scheduler {shlex.quote(asked)}, or --workers N for threads of this machine",
        )
    return kept, [word for word in dropped if word != "--fresh"]


def _spell(parameter: Any, value: Any) -> list[str]:
    """A parameter of a command line as words."""
    if parameter.param_type_name == "argument":
        return [f"./{value}" if str(value).startswith("-") else str(value)]
    name = str(parameter.opts[0])
    if parameter.is_flag:
        return [name]
    return [word for each in (value if parameter.multiple else [value]) for word in (name, str(each))]


def _options(given: ResumeOptions, care: OutputOptions) -> list[str]:
    """Options of `resume` as words for the command, with paths as of here: it works in another folder. The log is open
    already."""
    words = [name for name in ("force", "over_budget", "quiet") if getattr(care, name)]
    spelled = [f"--{name.replace('_', '-')}" for name in words]
    if given.workers is not None:
        spelled += ["--workers", str(given.workers)]
    if given.scheduler is not None:
        is_file = Path(given.scheduler).exists()
        spelled += ["--scheduler", os.path.abspath(given.scheduler) if is_file else given.scheduler]
    if given.figures is not None:
        spelled += ["--figures", given.figures if given.figures == "none" else os.path.abspath(given.figures)]
    return spelled
