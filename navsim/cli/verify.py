"""`navsim verify`, `navsim evidence`: a result for a reviewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navsim.cli.common import leave, leaving, make_folder, print_json, progress, read_result
from navsim.cli.exit_status import BAD_INPUT, CHECK_FAILED, OTHER_CODE, print_message
from navsim.cli.options import WorkersOption, argument, value_option
from navsim.cli.results import shown_as_stored

if TYPE_CHECKING:
    from navsim.runner.verification import Verification

_ALL = "all"
FolderOption = Annotated[
    Path | None,
    value_option(
        "FOLDER",
        "Folder of the files that the scenario names. Default: that of the scenario when it was computed, "
        "the working folder, or that of the result.",
    ),
]


def _check_folder(folder: Path | None) -> None:
    if folder is not None and not folder.is_dir():
        leave(BAD_INPUT, f"--folder {folder}: no such folder")


def verify(
    file: Annotated[Path, argument("RESULT.h5", "The result.")],
    folder: FolderOption = None,
    runs: Annotated[
        str,
        typer.Option(metavar="N|all", help="About so many runs of an ensemble to repeat, in random blocks of 8."),
    ] = "96",
    workers: WorkersOption = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print differences only.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print all checks as JSON.")] = False,
) -> None:
    """Verify a result: file, inputs, code, and numbers, which are computed again.

    navsim exits with code 1 if the result or an input was changed, with 2 if a file is missing. It exits with code 4
    if result and inputs are intact, but other code computed numbers that this code does not repeat.
    """
    from navsim.results.result import ResultError
    from navsim.runner import verification
    from navsim.runner.executor import threads
    from navsim.runner.opening import scenario_instead

    if runs != _ALL and not (runs.isascii() and runs.isdigit() and int(runs) > 0):
        leave(BAD_INPUT, f"--runs {runs}: a number of runs from 1 on, or {_ALL}, is needed")
    _check_folder(folder)
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
        wrong = list(dict.fromkeys(check.subject for check in found.checks if check.verdict == verification.DIFFERS))
        only_inputs = "an input is not the one of the result"
        what = only_inputs if wrong == ["inputs"] else f"differences in {', '.join(wrong)}"
        leave(CHECK_FAILED, f"{file}: {what}; see above")
    if found.incomplete:
        leave(BAD_INPUT, f"{file}: could not be verified completely")
    if found.of_other_code:
        print_message(f"{file}: {verification.INTACT}; see above")
        raise typer.Exit(OTHER_CODE)
    if not quiet and not json_:
        print_message(f"{file}: verified")


def _print(found: Verification, quiet: bool) -> None:
    from navsim.runner.verification import EQUAL, NOTE

    shown = [check for check in found.checks if not quiet or check.verdict not in (EQUAL, NOTE)]
    for check in shown:
        print(f"{check.subject:<11} {check.verdict:<12} {check.text}")


def evidence(
    file: Annotated[Path, argument("RESULT.h5", "The result.")],
    output: Annotated[
        Path | None,
        value_option(
            "FOLDER", "New or empty folder. Default: <result stem>_evidence in the folder of the result.",
            "--output", "-o",
        ),
    ] = None,
    folder: FolderOption = None,
    licence: Annotated[
        str, typer.Option("--license", metavar="URL", help="Terms of use, such as a Creative Commons URL.")
    ] = "",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no names of files.")] = False,
) -> None:  # fmt: skip
    """Write a result with its inputs as a folder for a reviewer.

    A page has verdicts, warnings, tables, independent references of the methods, effects that are not modelled, and
    commands that repeat the result. The folder is an RO-Crate, for archives of research data.
    """
    from navsim.runner.evidence import write_evidence

    _check_folder(folder)
    result = read_result(file)
    target = output or file.with_name(f"{file.stem}_evidence")
    make_folder(target)
    with leaving(), shown_as_stored([result], [file]):
        for path in write_evidence(file, target, folder, licence):
            if not quiet:
                print(path)
