"""`navsim resume`: a study that was interrupted or killed goes on."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import leave, leaving
from navsim.cli.ending import BAD_INPUT, say


def resume(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="The finished work that was left, RESULT.h5.partial.", show_default=False
        ),
    ],
) -> None:
    """Go on with a study that was interrupted or killed.

    The command that began it is given again, in the folder where it was given, and goes on from what is finished.
    Scenario, files and code must be those of before.
    """
    from navsim.cli.main import app
    from navsim.study.partial import PartialError, begun_by
    from navsim.work.errors import BadInput, said

    with leaving():
        try:
            begun = begun_by(folder)
        except PartialError as error:
            raise BadInput(said(error)) from None
    # what was to be discarded then was; another attempt's work is what is wanted now
    words = [word for word in begun.words if word != "--fresh"]
    say(f"navsim {shlex.join(words)}")
    try:
        os.chdir(begun.folder)
    except OSError as error:
        leave(BAD_INPUT, f"{begun.folder}: {error.strerror or error}")
    sys.argv[1:] = words
    app()
