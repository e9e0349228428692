"""The commands of `navsim`. Heavy imports happen inside the commands, so that `--help` answers at once; a command that
is not asked for is not even read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer._click.exceptions import UsageError
from typer.core import TyperCommand, TyperGroup

from navsim.cli.exit_status import OK, ending
from navsim.cli.options import grouped
from navsim.kinds import named

if TYPE_CHECKING:
    from typer._click.core import Context
    from typer._click.formatting import HelpFormatter

PLACES = {
    "init": "navsim.cli.files:init",
    "run": "navsim.cli.run:run",
    "show": "navsim.cli.results:show",
    "plot": "navsim.cli.results:plot",
    "report": "navsim.cli.reports:report",
    "export": "navsim.cli.results:export",
    "validate": "navsim.cli.files:validate",
    "keys": "navsim.cli.files:keys",
    "variables": "navsim.cli.files:variables",
    "plan": "navsim.cli.plan:plan",
    "sweep": "navsim.cli.studies:sweep",
    "optimize": "navsim.cli.studies:optimize",
    "import": "navsim.cli.imports:import_log",
    "imu": "navsim.cli.imports:imu_sheet",
    "replay": "navsim.cli.recorded:replay",
    "live": "navsim.cli.recorded:live",
    "table2": "navsim.cli.studies:table2",
    "integrity-table": "navsim.cli.studies:integrity_table",
    "merge": "navsim.cli.merge:merge",
    "resume": "navsim.cli.resume:resume",
    "verify": "navsim.cli.verify:verify",
    "evidence": "navsim.cli.verify:evidence",
    "cite": "navsim.cli.reports:cite",
    "schema": "navsim.cli.files:schema",
}
"""The commands in the order of `--help`: by use."""


class _Command(TyperCommand):
    """A command that explains a value after `--require`, which takes none."""

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        asked = "--require" in args
        try:
            return super().parse_args(ctx, args)
        except UsageError as error:
            if asked and "unexpected extra argument" in error.message:
                error.message += ". --require takes no value: write limits in the scenario, in section requirements"
            raise


@cache
def command_named(name: str) -> Any:
    """A command as typer has it."""
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(name, cls=_Command)(ending(grouped(named(PLACES[name]))))
    command: Any = typer.main.get_command(alone)
    for parameter in command.params:
        if parameter.nargs == -1:  # files; typer would show Python's type
            vars(parameter)["display_type"] = lambda _: "<path>"
    return command


class _Commands(Mapping[str, Any]):
    """All commands by name, each made when it is asked for."""

    def __getitem__(self, name: str) -> Any:
        return command_named(name)

    def __iter__(self) -> Iterator[str]:
        return iter(PLACES)

    def __len__(self) -> int:
        return len(PLACES)


def _first_line(place: str) -> str:
    text = named(place).__doc__
    assert text is not None
    return str(text).partition("\n")[0]


class _Group(TyperGroup):
    """Chooses the command; `PLACES` is the only list of commands."""

    def __init__(self, **settings: Any) -> None:
        if settings.get("commands"):
            raise ValueError(f"commands belong in PLACES: {', '.join(settings['commands'])}")
        super().__init__(**settings | {"commands": _Commands()})

    def list_commands(self, ctx: Context) -> list[str]:
        """Their names: the usual way makes them all."""
        return list(PLACES)

    def resolve_command(self, ctx: Context, args: list[str]) -> Any:
        """The command; `help` is `--help`, alone or of the command that follows. The error of an unknown one names
        those that are spelt alike, otherwise all."""
        if args[0] == "help":
            args = [*args[1:2], "--help"]
        if args[0] == "--help":
            typer.echo(ctx.get_help())
            ctx.exit(OK)
        if args[0] not in PLACES:
            from difflib import get_close_matches

            if not get_close_matches(args[0], PLACES):
                ctx.fail(f"No such command {args[0]!r}. Commands: {', '.join(PLACES)}.")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Context, formatter: HelpFormatter) -> None:
        """List the commands with the first line of their functions' docstrings; the default would load them all."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _first_line(place)) for name, place in PLACES.items()])


app = typer.Typer(
    name="navsim",
    cls=_Group,
    help="Plan and check a landing navigation system: INS corrected by GNSS, pseudolites and beacons.",
    epilog="Start with: navsim init, which writes landing_open_sky.yaml; then navsim run landing_open_sky.yaml",
    invoke_without_command=True,
    rich_markup_mode=None,  # plain help: half the time, and flags are not shown with a type
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)


def _version(wanted: bool) -> None:
    if wanted:
        import navsim

        print(f"navsim {navsim.__version__}")
        raise typer.Exit(OK)


@app.callback()
def _root(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", "-V", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
