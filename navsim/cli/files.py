"""`navsim validate`, `navsim schema`, `navsim init`: scenario files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import leave, print_json
from navsim.cli.ending import BAD_INPUT, say
from navsim.cli.options import set_option
from navsim.kinds import KINDS, OF_FILES
from navsim.scenario import shipped
from navsim.scenario.shipped import names


def validate(
    scenario: Annotated[
        Path, typer.Argument(metavar="FILE.yaml", help="The scenario, study or log to check.", show_default=False)
    ],
    set_: Annotated[list[str] | None, set_option("file")] = None,
) -> None:
    """Check a scenario, study or log and say what is wrong with it."""
    from navsim.scenario.load import read_any, read_study
    from navsim.scenario.source import InputError

    try:
        _, document = read_any(scenario, set_ or [])
        kind = str(document.data["kind"])
        if kind == "sweep":
            from navsim.scenario.sweep import Sweep
            from navsim.study.sweep import plan

            plan(*read_study(scenario, Sweep, set_ or []), seed=1)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    print(f"{scenario}: a valid {KINDS[kind].noun} of kind {kind}")


def schema(
    kind: Annotated[
        str, typer.Argument(help=f"One of {', '.join(OF_FILES)}.", autocompletion=lambda: list(OF_FILES))
    ] = "landing",
) -> None:
    """Print the JSON Schema of a kind of file: every key, its unit, range, default."""
    from navsim.scenario.load import section

    if kind not in OF_FILES:
        leave(BAD_INPUT, f"{kind!r} is no kind of scenario; allowed: {', '.join(OF_FILES)}")
    print_json(section(kind).model_json_schema())


def init(
    template: Annotated[
        str, typer.Argument(help=f"One of {', '.join(names())}.", autocompletion=names)
    ] = "landing_smooth",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE.yaml",
            help="The file to write. Default: <template>.yaml.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write a commented scenario to start from, which runs as it is.

    Files it names, such as the base of a study, are written beside it where they are not there yet.
    """
    if template not in names():
        leave(BAD_INPUT, f"there is no template {template!r}; allowed: {', '.join(names())}")
    target = output or Path(f"{template}.yaml")
    if target.exists():
        leave(BAD_INPUT, f"{target}: exists already and stays untouched; choose another name with -o")
    if not target.parent.is_dir():
        leave(BAD_INPUT, f"{target.parent}: no such folder; create it first or choose another -o/--output")
    beside = {target.parent / name: shipped.content(name) for name in shipped.needs(template)}
    written = []
    for path, content in (*beside.items(), (target, shipped.text(template).encode())):
        try:
            if path != target:
                path.parent.mkdir(exist_ok=True)
            with open(path, "xb") as file:
                file.write(content)
            written.append(str(path))
        except FileExistsError:
            if not path.is_file() or path.read_bytes() != content:
                say(f"warning: {path} is not the shipped one and stays as it is; {target} names it")
        except OSError as error:
            leave(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}")
    print(f"{', '.join(written)} written; go on with: navsim {KINDS[shipped.kind(template)].command} {target}")
