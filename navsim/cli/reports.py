"""`navsim report`, `navsim cite`: the page of results, and its references."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import called, leave, make_folder, read_result
from navsim.cli.exit_status import BAD_INPUT, RUN_FAILED
from navsim.cli.options import argument, value_option
from navsim.cli.results import shown_as_stored

INSTALL = "pip install '.[report]' in the folder of navsim"
_BEGINNING = 2000
"""Bytes at the beginning of a page that contain its generator."""


def report(
    files: Annotated[list[Path], argument("RESULT.h5", "Results of the same kind.")],
    output: Annotated[
        Path | None,
        value_option("FILE.html", "The page. Default: the first result's name with .html.", "--output", "-o"),
    ] = None,
) -> None:
    """Write results as one page for any browser: verdicts, figures, tables, sources.

    The page is one file that needs no network. It overlays several results and lists what differs between them.
    """  # fmt: skip
    target = output or files[0].with_suffix(".html")
    results = [read_result(path) for path in files]
    make_folder(target)
    try:
        from navsim.page.document import GENERATOR, page
        from navsim.report.provenance import Read
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] not in ("bokeh", "jinja2", "markupsafe"):
            raise
        leave(BAD_INPUT, f"navsim report draws with Bokeh, which is not installed here: {INSTALL}")
    from navsim.results.result import ResultError, check_writable, write_text

    try:
        check_writable(target)
    except ResultError as error:
        leave(BAD_INPUT, error)
    _refuse(target, files, GENERATOR)
    with shown_as_stored(results, files):
        text = page([Read(*each) for each in zip(called(files), files, results, strict=True)])
    try:
        write_text(target, text)
    except ResultError as error:
        leave(RUN_FAILED, error)
    print(target)


def _refuse(target: Path, files: list[Path], generator: str) -> None:
    """Leave where the page would take the place of a result that it is of, or of anything but such a page."""
    if not target.exists():
        return
    if any(path.exists() and target.samefile(path) for path in files):
        leave(BAD_INPUT, f"{target}: is one of the results; choose another -o/--output")
    from navsim.results.files import open_regular

    try:
        with open_regular(target) as file:
            ours = f'name="generator" content="{generator}'.encode() in file.read(_BEGINNING)
    except OSError as error:
        leave(BAD_INPUT, f"{target}: {error.strerror or error}")
    if not ours:
        leave(BAD_INPUT, f"{target}: is not a page of navsim report and is not overwritten; choose another -o/--output")


def cite(
    files: Annotated[
        list[Path] | None,
        argument("[RESULT.h5]...", "Results whose methods to cite. Default: all methods."),
    ] = None,
    bibtex: Annotated[bool, typer.Option("--bibtex", help="Print the sources as BibTeX.")] = False,
) -> None:
    """Print references for the methods used in a result."""
    results = [read_result(path) for path in files or []]
    from navsim.report import citations

    with shown_as_stored(results, files or []):
        methods = citations.methods_of(results) if results else list(citations.METHODS)
        print(citations.bibtex(methods) if bibtex else citations.cited(methods), end="" if bibtex else "\n")
