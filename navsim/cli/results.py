"""`navsim show`, `navsim plot`: result files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import (
    BAD_INPUT,
    lacks,
    leave,
    print_table,
)


def show(
    files: Annotated[list[Path], typer.Argument(metavar="RESULT.h5 [MORE]", help="Result files.", show_default=False)],
    json_: Annotated[bool, typer.Option("--json", help="Print the summaries as JSON.")] = False,
) -> None:
    """Print the summary tables of results side by side."""
    from navsim.io.results import ResultError, read

    try:
        results = [(path.stem, read(path)) for path in files]
    except ResultError as error:
        leave(BAD_INPUT, error)
    if json_:
        import json

        from navsim.report.tables import summary_json

        summaries = [summary_json(result) for _, result in results]
        print(json.dumps(summaries[0] if len(summaries) == 1 else summaries, indent=1, allow_nan=False))
    else:
        try:
            print_table(results)
        except KeyError as error:
            leave(BAD_INPUT, *(lacks(result, name, error) for name, result in results))


def plot(
    file: Annotated[Path, typer.Argument(metavar="RESULT.h5", help="A result file.", show_default=False)],
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Default: beside the result.", show_default=False)
    ] = None,
) -> None:
    """Draw the figures of a result."""
    from navsim.io.results import ResultError, read

    try:
        result = read(file)
        from navsim.report.views import save

        for path in save(result, figures or file.parent, file.stem):
            print(path)
    except ResultError as error:
        leave(BAD_INPUT, error)
    except KeyError as error:
        leave(BAD_INPUT, lacks(result, file, error))
