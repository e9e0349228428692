"""The commands of `navsim`. Heavy imports happen inside the commands, so that `--help` answers at once."""

from __future__ import annotations

from typing import Annotated

import typer

from navsim.cli.ending import OK, ending
from navsim.cli.files import init, schema, validate
from navsim.cli.options import grouped
from navsim.cli.recorded import live, replay
from navsim.cli.results import export, plot, show
from navsim.cli.run import run
from navsim.cli.studies import optimize, sweep, table2

app = typer.Typer(
    name="navsim",
    help="Plan and prove a landing navigation system: INS corrected by GNSS and ground pseudolites.",
    no_args_is_help=True,
    rich_markup_mode=None,  # plain help: half the time, and flags are not shown with a type
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)
for command in (run, table2, sweep, optimize, replay, live, show, plot, export, validate, schema, init):
    app.command()(ending(grouped(command)))


def _version(wanted: bool) -> None:
    if wanted:
        import navsim

        print(f"navsim {navsim.__version__}")
        raise typer.Exit(OK)


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", "-V", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    pass
