"""The options of the commands, each declared once, in groups that several commands take."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer

from navsim.cli.completion import assignments

MOST = 2**63 - 1
"""Largest seed and number of a run: `results.result.MOST_WHOLE`, which `--help` does without."""
_PLAIN = {int: re.compile("[0-9]{1,40}"), float: re.compile(r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")}
"""A plain number; Python itself also accepts `1_000`, `nan` and the digits of other scripts."""


def _is_integer(text: str, least: float, most: int) -> bool:
    """Whether a text is a number without decimals within limits, written with a point or an exponent."""
    if not _PLAIN[float].fullmatch(text):
        return False
    return float(text).is_integer() and least <= float(text) <= min(most, 1e15)


def number_option(
    kind: type[int] | type[float], least: float, meaning: str, *, most: int = MOST, show_default: bool = False
) -> Any:
    """An option with an integer, or with seconds, from `least` to `most`."""
    what, metavar = ("a whole number", "N") if kind is int else ("a number", "SECONDS")

    def parse(given: object) -> float:
        text = str(given)  # a default comes as a number
        if not _PLAIN[kind].fullmatch(text) or not least <= kind(text) <= most:
            instead = f": write {float(text):.0f}" if _is_integer(text, least, most) else ""
            large = _PLAIN[float].fullmatch(text) and float(text) > most
            bounds = f"from {least:g} to {most}" if large or most < MOST else f"of at least {least:g}"
            raise typer.BadParameter(f"expected {what} {bounds}, not {text[:40]!r}{instead}")
        return kind(text)

    return typer.Option(parser=parse, metavar=metavar, help=f"{meaning} [{least:g} or more]", show_default=show_default)


def choice_option(words: object, meaning: str) -> Any:
    """An option that takes one of the words of a Literal."""
    allowed = [str(word) for word in get_args(words)]

    def parse(given: str) -> str:
        if given not in allowed:
            from navsim.scenario_files.base import hint

            raise typer.BadParameter(f"{given[:40]!r} is not allowed; {hint(given, allowed)}")
        return given

    return typer.Option(parser=parse, metavar=f"<{'|'.join(allowed)}>", help=meaning, show_default=False,
                        autocompletion=lambda: allowed)  # fmt: skip


def value_option(metavar: str, meaning: str, *names: str, autocompletion: Any = None) -> Any:
    """An option with a value that has no default to show; names: without any that of the parameter."""
    return typer.Option(*names, metavar=metavar, help=meaning, show_default=False, autocompletion=autocompletion)


def argument(metavar: str, meaning: str) -> Any:
    """An argument of a command."""
    return typer.Argument(metavar=metavar, help=meaning, show_default=False)


def output_option(default: str) -> Any:
    """-o of a command whose result has this name unless given."""
    return value_option("FILE.h5", f"The result file. Default: {default}.", "--output", "-o")


def set_option(what: str) -> Any:
    """--set of a command that reads a scenario, a study or a log."""
    return value_option(
        "KEY=VALUE",
        f"Override a key of the {what}, as section.key=value. Repeat for more keys.",
        "--set",
        autocompletion=assignments,
    )


def figures_option(default: str = "that of the result; none with --quiet") -> Any:
    """--figures of a command with this default."""
    return value_option("FOLDER|none", f"Folder for figures; created if missing. Default: {default}.")


def dry_run_option(meaning: str) -> Any:
    """--dry-run of a command."""
    return typer.Option("--dry-run", help=meaning)


ScenarioArgument = Annotated[Path, argument("SCENARIO.yaml", "The scenario to read.")]
WorkersOption = Annotated[int | None, number_option(int, 1, "Threads. Default: all cores.")]
SchedulerOption = Annotated[
    str | None,
    value_option(
        "ADDRESS", "Compute on a Dask cluster: tcp://HOST:PORT of its scheduler, or its file. Default: this machine."
    ),
]
SeedOption = Annotated[int, number_option(int, 0, "Seed of all random numbers.", show_default=True)]
FreshOption = Annotated[bool, typer.Option("--fresh", help="Discard partial work of an earlier attempt.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the summary as JSON on standard output, and nothing else.")
]


@dataclass(frozen=True)
class OutputOptions:
    """Options on overwriting, resources, output and log."""

    force: Annotated[
        bool, typer.Option("--force", help="Overwrite a result that has another kind or method, or more runs.")
    ] = False
    over_budget: Annotated[
        bool,
        typer.Option("--over-budget", help="Start even if this machine seems to lack the memory or disk."),
    ] = False
    quiet: Annotated[
        bool,
        typer.Option("--quiet", "-q", help="Print warnings, errors and the names of long steps only."),
    ] = False
    log_: Annotated[
        Path | None,
        value_option(
            "FILE", "Append a log to this file, one JSON object per line: start, progress, warnings, end.", "--log"
        ),
    ] = None


@dataclass(frozen=True)
class Required:
    """Conditions on the result for exit code 0."""

    require_fix: Annotated[
        bool,
        typer.Option(
            "--require-fix",
            help="Exit with code 3 if an epoch has no fix or the filter could not use it (tight coupling: no range).",
        ),
    ] = False
    require_consistent: Annotated[
        bool,
        typer.Option(
            "--require-consistent",
            help="Exit with code 3 if errors or innovations exceed the filter's sigma, beyond chance and tolerances.",
        ),
    ] = False
    require: Annotated[
        bool,
        typer.Option("--require", help="Exit with code 3 if a requirement of the scenario is not met, or undecided."),
    ] = False


def _log_in(path: Path) -> None:
    """Keep a log to the end of the command."""
    from navsim.cli.exit_status import keep
    from navsim.cli.log import NoLog, logged

    try:
        keep(logged(path, sys.argv[1:]))
    except NoLog as error:
        raise typer.BadParameter(f"--log {error}") from None


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Convert a command for typer, which knows only single options.

    Each group of options among its parameters, a dataclass, becomes single parameters.
    """
    signature = inspect.signature(command, eval_str=True)
    groups: dict[str, Any] = {
        name: p.annotation for name, p in signature.parameters.items() if is_dataclass(p.annotation)
    }
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        if name not in groups:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        hints = get_type_hints(groups[name], include_extras=True)
        parameters += [
            inspect.Parameter(
                f.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if f.default is MISSING else f.default,
                annotation=hints[f.name],
            )
            for f in fields(groups[name])
        ]

    @wraps(command)
    def spread(**given: Any) -> None:
        made = {name: group(**{f.name: given.pop(f.name) for f in fields(group)}) for name, group in groups.items()}
        for group in made.values():
            if isinstance(group, OutputOptions) and group.log_ is not None:
                _log_in(group.log_)
        command(**given, **made)

    spread.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined] # typer reads it
    spread.__annotations__ = {p.name: p.annotation for p in parameters}
    return spread
