"""`navsim verify`: is a result what its scenario gives by this code?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navsim.cli.common import leave, leaving, print_json, progress
from navsim.cli.exit_status import BAD_INPUT, CHECK_FAILED, print_message
from navsim.cli.options import WorkersOption

if TYPE_CHECKING:
    from navsim.runner.verification import Verification

_ALL = "all"


def verify(
    file: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="The result.", show_default=False)],
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the files that the scenario names. Default: that of the scenario when it was computed, "
            "the working folder, or that of the result.",
            show_default=False,
        ),
    ] = None,
    runs: Annotated[
        str,
        typer.Option(metavar="N|all", help="Number of runs of an ensemble to fly again, drawn at random."),
    ] = "96",
    workers: WorkersOption = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print differences only.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print all checks as JSON.")] = False,
) -> None:
    """Verify a result: file, inputs, code, and numbers, which are computed again.

    Exits with code 1 if the result or an input was changed, 2 if a file is lacking.
    """
    from navsim.results.result import ResultError
    from navsim.runner import verification
    from navsim.runner.executor import threads
    from navsim.runner.opening import scenario_instead

    if runs != _ALL and not (runs.isascii() and runs.isdigit() and int(runs) > 0):
        leave(BAD_INPUT, f"--runs {runs}: a number of runs from 1 on, or {_ALL}, is needed")
    if folder is not None and not folder.is_dir():
        leave(BAD_INPUT, f"--folder {folder}: no such folder")
    count = verification.ALL if runs == _ALL else int(runs)
    with leaving(), progress(0, "", not quiet) as tell:
        try:
            found = verification.verify(file, folder, count, threads(workers), tell)
        except ResultError as error:
            leave(BAD_INPUT, scenario_instead(file) or error)
    if json_:
        print_json(found.plain())
    else:
        _print(found, quiet)
    if found.differs:
        leave(CHECK_FAILED, f"{file}: is not what its scenario gives, or was changed: see above")
    if found.incomplete:
        leave(BAD_INPUT, f"{file}: could not be verified completely")
    if not quiet and not json_:
        print_message(f"{file}: verified")


def _print(found: Verification, quiet: bool) -> None:
    from navsim.runner.verification import DIFFERS, UNCHECKED

    shown = [check for check in found.checks if not quiet or check.verdict in (DIFFERS, UNCHECKED)]
    for check in shown:
        print(f"{check.subject:<11} {check.verdict:<12} {check.text}")
